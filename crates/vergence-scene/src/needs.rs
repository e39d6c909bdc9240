//! What a picture of a scene requires: the one place that decides which passes and pipelines exist.

use std::collections::BTreeSet;

use crate::model::{Alpha, Material, Primitive, Scene, Shading};

/// What a picture of the scene requires; nothing else is created. The renderer builds exactly this, the plan
/// prints it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Needs {
    /// One pipeline each.
    pub surfaces: BTreeSet<Surface>,
    /// Vertices are moved by joints, on the GPU, before anything is drawn.
    pub skinning: bool,
    /// Texts are drawn.
    pub text: bool,
    /// Something moves by itself: transforms are recomputed every frame.
    pub animation: bool,
    /// Images that are drawn, by index, and whether they hold sRGB colour (else data).
    pub images: BTreeSet<(usize, bool)>,
    /// Number of lights that nodes place.
    pub lights: usize,
}

/// One way to draw a surface: what the shader must do, and the fixed state of its pipeline.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Surface {
    /// The law of reflection.
    pub law: Law,
    /// Samples a base colour texture.
    pub base_color_texture: bool,
    /// Samples a metallic-roughness texture.
    pub metallic_roughness_texture: bool,
    /// Samples a normal map.
    pub normal_texture: bool,
    /// Samples an occlusion texture.
    pub occlusion_texture: bool,
    /// Samples an emissive texture.
    pub emissive_texture: bool,
    /// Multiplies vertex colours.
    pub vertex_colors: bool,
    /// Opaque, mask or blend.
    pub coverage: Coverage,
    /// Draws the back, too.
    pub double_sided: bool,
}

/// [`Shading`] without its parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Law {
    /// No light.
    Unlit,
    /// GGX and Lambert.
    MetallicRoughness,
    /// Half-vector lobe and Lambert.
    BlinnPhong,
}

/// [`Alpha`] without its parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Coverage {
    /// Alpha is ignored.
    Opaque,
    /// Below the cutoff nothing is drawn.
    Mask,
    /// Blended, back to front.
    Blend,
}

impl Surface {
    /// How a primitive with a material is drawn. Textures without coordinates, normal maps without tangents or
    /// with `normal_maps` off, are left out; so is everything that an unlit surface ignores.
    pub fn of(material: &Material, primitive: &Primitive, normal_maps: bool) -> Self {
        let law = match material.shading {
            Shading::Unlit => Law::Unlit,
            Shading::MetallicRoughness { .. } => Law::MetallicRoughness,
            Shading::BlinnPhong { .. } => Law::BlinnPhong,
        };
        let has_uv = |uv_set: u8| !if uv_set == 0 { &primitive.uv0 } else { &primitive.uv1 }.is_empty();
        let usable = |texture: &Option<crate::model::TextureRef>| texture.is_some_and(|t| has_uv(t.uv_set));
        let lit = law != Law::Unlit;
        let metallic_roughness_texture = match &material.shading {
            Shading::MetallicRoughness { texture, .. } => usable(texture),
            _ => false,
        };
        Self {
            law,
            base_color_texture: usable(&material.base_color_texture),
            metallic_roughness_texture,
            normal_texture: lit
                && normal_maps
                && !primitive.tangents.is_empty()
                && usable(&material.normal_texture),
            occlusion_texture: lit && usable(&material.occlusion_texture),
            emissive_texture: lit && usable(&material.emissive_texture),
            vertex_colors: !primitive.colors.is_empty(),
            coverage: match material.alpha {
                Alpha::Opaque => Coverage::Opaque,
                Alpha::Mask { .. } => Coverage::Mask,
                Alpha::Blend => Coverage::Blend,
            },
            double_sided: material.double_sided,
        }
    }
}

impl Needs {
    /// What a picture of `scene` requires, with or without normal maps (a quality knob). O(nodes + primitives).
    pub fn of(scene: &Scene, normal_maps: bool) -> Self {
        let mut needs = Self { animation: !scene.playing.is_empty(), ..Self::default() };
        for node in &scene.nodes {
            needs.lights += usize::from(node.light.is_some());
            needs.text |= node.label.is_some();
            let Some(mesh) = node.mesh else { continue };
            for primitive in &scene.meshes[mesh].primitives {
                let material = &scene.materials[primitive.material];
                let surface = Surface::of(material, primitive, normal_maps);
                needs.skinning |= node.skin.is_some() && !primitive.joints.is_empty();
                needs.add_images(scene, material, &surface);
                needs.surfaces.insert(surface);
            }
        }
        needs
    }

    fn add_images(&mut self, scene: &Scene, material: &Material, surface: &Surface) {
        let metallic_roughness = match &material.shading {
            Shading::MetallicRoughness { texture, .. } => *texture,
            _ => None,
        };
        let uses = [
            (surface.base_color_texture, material.base_color_texture, true),
            (surface.metallic_roughness_texture, metallic_roughness, false),
            (surface.normal_texture, material.normal_texture, false),
            (surface.occlusion_texture, material.occlusion_texture, false),
            (surface.emissive_texture, material.emissive_texture, true),
        ];
        for (used, texture, is_srgb) in uses {
            if let (true, Some(texture)) = (used, texture) {
                self.images.insert((scene.textures[texture.texture].image, is_srgb));
            }
        }
    }
}
