//! From a material and a primitive to a shader variant, packed parameters and texture coordinates.

use vergence_scene::model::{Alpha, Material, Primitive, Shading, Texture, TextureRef};
use vergence_scene::{Coverage, Law, Surface};
use vergence_shaders as shaders;

/// Base colour, metallic-roughness, normal, occlusion, emissive: the order of bindings and of texture coordinates.
pub(crate) const TEXTURE_KINDS: usize = 5;

/// `Material` of surface.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub(crate) struct PackedMaterial {
    base_color: [f32; 4],
    emissive: [f32; 4],
    law: [f32; 4],
    more: [f32; 4],
    uv_rows: [[f32; 4]; 2 * TEXTURE_KINDS],
    uv_offsets: [[f32; 4]; 3],
}

/// The textures that a surface samples, by kind.
pub(crate) fn used_textures(surface: &Surface, material: &Material) -> [Option<TextureRef>; TEXTURE_KINDS] {
    let metallic_roughness = match &material.shading {
        Shading::MetallicRoughness { texture, .. } => *texture,
        _ => None,
    };
    [
        material.base_color_texture.filter(|_| surface.base_color_texture),
        metallic_roughness.filter(|_| surface.metallic_roughness_texture),
        material.normal_texture.filter(|_| surface.normal_texture),
        material.occlusion_texture.filter(|_| surface.occlusion_texture),
        material.emissive_texture.filter(|_| surface.emissive_texture),
    ]
}

/// Whether a texture of this kind holds sRGB colour (else data).
pub(crate) const fn is_srgb(kind: usize) -> bool {
    kind == 0 || kind == 4
}

/// The shader variant that draws a surface.
pub(crate) fn variant(surface: &Surface, textures: &[Option<TextureRef>; TEXTURE_KINDS]) -> shaders::Variant {
    shaders::Variant {
        law: match surface.law {
            Law::Unlit => shaders::Law::Unlit,
            Law::MetallicRoughness => shaders::Law::MetallicRoughness,
            Law::BlinnPhong => shaders::Law::BlinnPhong,
        },
        coverage: match surface.coverage {
            Coverage::Opaque => shaders::Coverage::Opaque,
            Coverage::Mask => shaders::Coverage::Mask,
            Coverage::Blend => shaders::Coverage::Blend,
        },
        base_color_texture: surface.base_color_texture,
        metallic_roughness_texture: surface.metallic_roughness_texture,
        normal_texture: surface.normal_texture,
        occlusion_texture: surface.occlusion_texture,
        emissive_texture: surface.emissive_texture,
        vertex_colors: surface.vertex_colors,
        many_uvs: the_only_uv(textures).is_none() && textures.iter().flatten().count() > 1,
        handed_on: false,
        bounded_footprint: false,
    }
}

/// The coordinates that all textures share; `None` where they differ or there are none.
fn the_only_uv(textures: &[Option<TextureRef>; TEXTURE_KINDS]) -> Option<TextureRef> {
    let mut used = textures.iter().flatten();
    let first = used.next()?;
    let same = |t: &TextureRef| t.uv_set == first.uv_set && t.uv_from_uv == first.uv_from_uv;
    used.all(same).then_some(*first)
}

/// Floats per vertex: what moves with the vertex (position, normal, tangent) and what sticks to it (texture
/// coordinates, colour), in separate streams, so that skinning rewrites only the first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(crate) struct Layout {
    pub normal: bool,
    pub tangent: bool,
    /// 0, 1 or 2 sets.
    pub uvs: u8,
    pub color: bool,
}

impl Layout {
    pub fn of(variant: &shaders::Variant) -> Self {
        Self {
            normal: variant.lit(),
            tangent: variant.normal_texture,
            uvs: if variant.many_uvs { 2 } else { u8::from(variant.uses_uv()) },
            color: variant.vertex_colors,
        }
    }

    /// Floats per vertex of the stream that moves.
    pub fn moving(&self) -> usize {
        3 + if self.normal { 3 } else { 0 } + if self.tangent { 4 } else { 0 }
    }

    /// Floats per vertex of the stream that sticks.
    pub fn sticking(&self) -> usize {
        2 * usize::from(self.uvs) + if self.color { 4 } else { 0 }
    }
}

/// Appends vertex `vertex` of `primitive` to the two streams, its position relative to `centre` (mesh coordinates).
pub(crate) fn push_vertex(
    primitive: &Primitive,
    layout: Layout,
    textures: &[Option<TextureRef>; TEXTURE_KINDS],
    centre: &nalgebra::Point3<f64>,
    vertex: usize,
    moving: &mut Vec<f32>,
    sticking: &mut Vec<f32>,
) {
    let p = primitive.positions[vertex];
    moving.extend((0..3).map(|k| (f64::from(p[k]) - centre[k]) as f32));
    if layout.normal {
        moving.extend(primitive.normals.get(vertex).copied().unwrap_or([0.0, 0.0, 1.0]));
    }
    if layout.tangent {
        moving.extend(primitive.tangents.get(vertex).copied().unwrap_or([1.0, 0.0, 0.0, 1.0]));
    }
    let uv = |set: u8| {
        let all = if set == 0 { &primitive.uv0 } else { &primitive.uv1 };
        all.get(vertex).copied().unwrap_or([0.0; 2])
    };
    if layout.uvs == 1
        && let Some(texture) = the_only_uv(textures)
    {
        let [u, v] = uv(texture.uv_set);
        sticking.extend(texture.uv_from_uv.map(|row| row[0] * u + row[1] * v + row[2]));
    } else if layout.uvs == 2 {
        sticking.extend(uv(0));
        sticking.extend(uv(1));
    }
    if layout.color {
        sticking.extend(primitive.colors.get(vertex).copied().unwrap_or([1.0; 4]));
    }
}

/// The parameters of a material as the shader reads them.
pub(crate) fn pack(material: &Material, textures: &[Option<TextureRef>; TEXTURE_KINDS]) -> PackedMaterial {
    let cutoff = match material.alpha {
        Alpha::Mask { cutoff } => cutoff,
        _ => 0.0,
    };
    let [er, eg, eb] = material.emissive;
    let mut packed = PackedMaterial {
        base_color: material.base_color,
        emissive: [er, eg, eb, material.occlusion_strength],
        law: [0.0, 1.0, 0.0, cutoff],
        more: [material.normal_scale, 1.0, 0.0, 0.0],
        uv_rows: [[0.0; 4]; 2 * TEXTURE_KINDS],
        uv_offsets: [[0.0; 4]; 3],
    };
    match material.shading {
        Shading::Unlit => {}
        Shading::MetallicRoughness { metallic, roughness, ior, .. } => {
            let reflected = (ior - 1.0) / (ior + 1.0);
            let reflectance = reflected * reflected;
            packed.law = [
                clamped(metallic, 0.0, 1.0),
                clamped(roughness, 0.0, 1.0),
                if reflectance.is_finite() { reflectance } else { 0.04 },
                cutoff,
            ];
        }
        Shading::BlinnPhong { specular: [r, g, b], shininess } => {
            let exponent = clamped(shininess, 0.0, 1e4);
            packed.law = [r, g, b, cutoff];
            packed.more = [material.normal_scale, exponent, blinn_phong_norm(exponent), 0.0];
        }
    }
    for (kind, texture) in textures.iter().enumerate() {
        let texture =
            texture.unwrap_or(TextureRef { texture: 0, uv_set: 0, uv_from_uv: Texture::UNTRANSFORMED });
        for (row, [a, b, offset]) in texture.uv_from_uv.into_iter().enumerate() {
            packed.uv_rows[2 * kind + row] =
                if texture.uv_set == 0 { [a, b, 0.0, 0.0] } else { [0.0, 0.0, a, b] };
            packed.uv_offsets[kind / 2][2 * (kind % 2) + row] = offset;
        }
    }
    packed
}

/// What makes a half-vector lobe of exponent `n` reflect all light at normal incidence:
/// `(n + 2)(n + 4) / (8π (2^(−n/2) + n))` (Giesen 2009).
fn blinn_phong_norm(n: f32) -> f32 {
    (n + 2.0) * (n + 4.0) / (8.0 * std::f32::consts::PI * ((-0.5 * n).exp2() + n))
}

/// `value` held in a range; the lower end where it is not a number.
fn clamped(value: f32, least: f32, most: f32) -> f32 {
    if value.is_nan() { least } else { value.clamp(least, most) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texture(uv_set: u8, offset: f32) -> Option<TextureRef> {
        Some(TextureRef { texture: 0, uv_set, uv_from_uv: [[2.0, 0.0, offset], [0.0, 3.0, 0.0]] })
    }

    #[test]
    fn shared_coordinates_are_transformed_once_and_for_all() {
        let primitive = Primitive {
            positions: vec![[1.0, 2.0, 3.0]],
            normals: vec![[0.0, 1.0, 0.0]],
            uv0: vec![[0.5, 0.25]],
            ..Primitive::default()
        };
        let surface = Surface {
            law: Law::MetallicRoughness,
            base_color_texture: true,
            metallic_roughness_texture: true,
            normal_texture: false,
            occlusion_texture: false,
            emissive_texture: false,
            vertex_colors: false,
            coverage: Coverage::Opaque,
            double_sided: false,
        };
        let same = [texture(0, 0.125), texture(0, 0.125), None, None, None];
        assert!(!variant(&surface, &same).many_uvs);
        let differing = [texture(0, 0.125), texture(0, 0.25), None, None, None];
        assert!(variant(&surface, &differing).many_uvs);
        let layout = Layout::of(&variant(&surface, &same));
        let (mut moving, mut sticking) = (Vec::new(), Vec::new());
        let centre = nalgebra::Point3::new(1.0, 1.0, 1.0);
        push_vertex(&primitive, layout, &same, &centre, 0, &mut moving, &mut sticking);
        assert_eq!(moving, [0.0, 1.0, 2.0, 0.0, 1.0, 0.0]);
        assert_eq!(sticking, [1.125, 0.75]);
        assert_eq!((moving.len(), sticking.len()), (layout.moving(), layout.sticking()));
    }

    /// The lobe reflects all light that comes straight from above.
    #[test]
    fn the_blinn_phong_lobe_has_unit_albedo_at_normal_incidence() {
        for exponent in [0.0f32, 1.0, 10.0, 100.0, 1000.0] {
            let steps = 200_000;
            // ∫ norm · cos(θ/2)^n · cos θ dω over the hemisphere.
            let sum: f64 = (0..steps)
                .map(|i| {
                    let theta = (f64::from(i) + 0.5) / f64::from(steps) * std::f64::consts::FRAC_PI_2;
                    (0.5 * theta).cos().powf(f64::from(exponent)) * theta.cos() * theta.sin()
                })
                .sum::<f64>()
                * std::f64::consts::FRAC_PI_2
                / f64::from(steps)
                * std::f64::consts::TAU;
            let albedo = sum * f64::from(blinn_phong_norm(exponent));
            assert!((albedo - 1.0).abs() < 1e-3, "{exponent}: {albedo}");
        }
    }
}
