//! The one internal model: every importer ends here, every consumer starts here.

use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use vergence_geom::{Affine, Rigid, Trs};

/// A scene: flat tables that refer to each other by index. Indices are valid: importers check them.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// For people: usually the file's name.
    pub name: String,
    /// Every parent stands before its children.
    pub nodes: Vec<Node>,
    /// What nodes show.
    pub meshes: Vec<Mesh>,
    /// How surfaces look.
    pub materials: Vec<Material>,
    /// An image and how it is sampled.
    pub textures: Vec<Texture>,
    /// Pictures, decoded; shared between copies of the scene.
    pub images: Vec<Arc<Image>>,
    /// Joints that move vertices.
    pub skins: Vec<Skin>,
    /// Clips that move nodes.
    pub animations: Vec<Animation>,
    /// Indices into [`Scene::animations`] of the clips that run, in loops, from the start.
    pub playing: Vec<usize>,
    /// Lights; nodes place them.
    pub lights: Vec<Light>,
    /// Cameras that the file brings; nodes place them.
    pub cameras: Vec<Camera>,
    /// Texts; nodes place them.
    pub labels: Vec<Label>,
    /// Irradiance from everywhere, linear RGB, W/m² up to the scene's photometric scale.
    pub ambient: [f32; 3],
    /// Linear RGB where nothing is drawn.
    pub background: [f32; 3],
    /// Where the user's floor origin is at the start (y up, −z ahead); `None` where the file does not say.
    pub world_from_start: Option<Rigid>,
    /// What can be pointed at and grasped.
    pub touchables: Vec<Touchable>,
    /// One sentence for each feature of the file that is not drawn.
    pub warnings: Vec<String>,
    /// The files that it was made from, in the order in which they were read: first the one that was asked for.
    pub files: Vec<std::path::PathBuf>,
}

/// A place in the hierarchy and what stands there.
#[derive(Clone, Debug)]
pub struct Node {
    /// May be empty, need not be unique.
    pub name: String,
    /// Index of the parent; smaller than the node's own.
    pub parent: Option<usize>,
    /// Where it stands, before animation.
    pub parent_from_node: Local,
    /// Index into [`Scene::meshes`].
    pub mesh: Option<usize>,
    /// Index into [`Scene::skins`]; its mesh is then placed by the joints, not by the node.
    pub skin: Option<usize>,
    /// Index into [`Scene::lights`]; shines along −z.
    pub light: Option<usize>,
    /// Index into [`Scene::cameras`]; looks along −z.
    pub camera: Option<usize>,
    /// Index into [`Scene::labels`]; read from +z, x to the right.
    pub label: Option<usize>,
}

impl Node {
    /// A node without a parent, where nothing stands yet.
    pub fn at(name: &str, parent_from_node: Local) -> Self {
        Self {
            name: name.to_owned(),
            parent: None,
            parent_from_node,
            mesh: None,
            skin: None,
            light: None,
            camera: None,
            label: None,
        }
    }
}

/// A local transform: what can be animated, or a matrix, which cannot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Local {
    /// Translation, rotation, scale.
    Trs(Trs),
    /// Any affine transform.
    Matrix(Affine),
}

impl Local {
    /// The transform as a matrix and an offset.
    pub fn to_affine(&self) -> Affine {
        match self {
            Self::Trs(trs) => trs.to_affine(),
            Self::Matrix(affine) => *affine,
        }
    }
}

/// Some primitives that are placed together.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// For people.
    pub name: String,
    /// One per material.
    pub primitives: Vec<Primitive>,
}

/// Indexed triangles of one material. Optional attributes are empty or as long as `positions`.
#[derive(Clone, Debug, Default)]
pub struct Primitive {
    /// Metres, in mesh coordinates.
    pub positions: Vec<[f32; 3]>,
    /// Unit length; always present (importers compute what is missing).
    pub normals: Vec<[f32; 3]>,
    /// Unit tangent and handedness (±1); present where the material has a normal map (MikkTSpace where the file
    /// has none).
    pub tangents: Vec<[f32; 4]>,
    /// First set of texture coordinates; (0, 0) is the top left corner of the image.
    pub uv0: Vec<[f32; 2]>,
    /// Second set.
    pub uv1: Vec<[f32; 2]>,
    /// Linear RGBA, multiplied onto the base colour.
    pub colors: Vec<[f32; 4]>,
    /// Indices into [`Skin::joints`], four per vertex.
    pub joints: Vec<[u16; 4]>,
    /// Sum to one (importers normalise them).
    pub weights: Vec<[f32; 4]>,
    /// Three per triangle, counter-clockwise seen from the front; each below `positions.len()`.
    pub indices: Vec<u32>,
    /// Index into [`Scene::materials`].
    pub material: usize,
}

/// How a surface looks.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// For people.
    pub name: String,
    /// The law of reflection.
    pub shading: Shading,
    /// Linear RGBA factor.
    pub base_color: [f32; 4],
    /// sRGB colour, multiplied onto the factor.
    pub base_color_texture: Option<TextureRef>,
    /// Linear, x and y scaled by `normal_scale`.
    pub normal_texture: Option<TextureRef>,
    /// Factor for x and y of the normal map.
    pub normal_scale: f32,
    /// Red channel: how much ambient light arrives.
    pub occlusion_texture: Option<TextureRef>,
    /// 0 ignores the occlusion texture, 1 applies it in full.
    pub occlusion_strength: f32,
    /// Linear RGB.
    pub emissive: [f32; 3],
    /// sRGB colour, multiplied onto the factor.
    pub emissive_texture: Option<TextureRef>,
    /// What alpha means.
    pub alpha: Alpha,
    /// Whether the back is drawn (and lit with the normal turned over).
    pub double_sided: bool,
}

/// The law of reflection.
#[derive(Clone, Debug, PartialEq)]
pub enum Shading {
    /// The colour as it is: no light.
    Unlit,
    /// glTF 2.0: GGX specular, Lambert diffuse.
    MetallicRoughness {
        /// Factor, 0…1.
        metallic: f32,
        /// Perceptual roughness, factor, 0…1.
        roughness: f32,
        /// Blue: metallic, green: roughness; linear.
        texture: Option<TextureRef>,
        /// Index of refraction, for the reflectance of what is not metal; glTF's default is 1.5.
        ior: f32,
    },
    /// Blinn-Phong, as OBJ materials mean it: Lambert diffuse and a normalised half-vector lobe.
    BlinnPhong {
        /// Linear RGB.
        specular: [f32; 3],
        /// Exponent of the half-vector cosine.
        shininess: f32,
    },
}

/// What alpha means.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Alpha {
    /// Nothing.
    Opaque,
    /// Below the cutoff nothing is drawn.
    Mask {
        /// 0…1.
        cutoff: f32,
    },
    /// Coverage: drawn back to front over what is behind.
    Blend,
}

/// A texture and how a material finds its place in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextureRef {
    /// Index into [`Scene::textures`].
    pub texture: usize,
    /// 0 or 1: which set of texture coordinates.
    pub uv_set: u8,
    /// KHR_texture_transform as two rows: `u' = m[0]·(u, v, 1)`, `v' = m[1]·(u, v, 1)`.
    pub uv_from_uv: [[f32; 3]; 2],
}

/// An image and how it is sampled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Texture {
    /// Index into [`Scene::images`].
    pub image: usize,
    /// How it repeats and is filtered.
    pub sampler: Sampler,
}

/// How a texture repeats and is filtered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Sampler {
    /// Across.
    pub wrap_u: Wrap,
    /// Down.
    pub wrap_v: Wrap,
    /// Linear (or nearest) where texels are larger than pixels.
    pub mag_linear: bool,
    /// Linear (or nearest) within a level where they are smaller.
    pub min_linear: bool,
    /// Between levels; `None` samples the full picture only.
    pub mip: Option<Mip>,
}

/// What happens outside of the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Wrap {
    /// Starts again.
    Repeat,
    /// Every other copy is mirrored.
    MirroredRepeat,
    /// The edge goes on.
    ClampToEdge,
}

/// What happens between levels of the mip chain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Mip {
    /// The nearer level.
    Nearest,
    /// Both, weighted.
    Linear,
}

/// A picture: 8-bit RGBA, rows from the top, colour as stored in the file (sRGB or data: the use decides).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// For people: the file's or the image's name.
    pub name: String,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `4 · width · height` bytes.
    pub rgba: Vec<u8>,
}

/// Joints that move vertices.
#[derive(Clone, Debug)]
pub struct Skin {
    /// For people.
    pub name: String,
    /// Indices into [`Scene::nodes`].
    pub joints: Vec<usize>,
    /// One per joint: mesh coordinates to the joint's, in the bind pose.
    pub joint_from_mesh: Vec<Affine>,
}

/// A clip: tracks that move nodes together.
#[derive(Clone, Debug)]
pub struct Animation {
    /// For people.
    pub name: String,
    /// What moves.
    pub tracks: Vec<Track>,
}

/// The keys of one property of one node.
#[derive(Clone, Debug)]
pub struct Track {
    /// Index into [`Scene::nodes`]; its local transform is [`Local::Trs`].
    pub node: usize,
    /// Seconds from the clip's start, ascending.
    pub times_secs: Vec<f32>,
    /// What happens between keys.
    pub interpolation: Interpolation,
    /// The keys.
    pub values: Values,
}

/// What happens between keys.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interpolation {
    /// The earlier key holds.
    Step,
    /// Straight line; the shorter arc for rotations.
    Linear,
    /// Hermite, with in-tangent, value, out-tangent for each key (three values per time).
    CubicSpline,
}

/// Keys of a track: one value per time, or three for [`Interpolation::CubicSpline`].
#[derive(Clone, Debug)]
pub enum Values {
    /// Metres.
    Translation(Vec<[f32; 3]>),
    /// Quaternions x y z w.
    Rotation(Vec<[f32; 4]>),
    /// Factors.
    Scale(Vec<[f32; 3]>),
}

/// A light; shines along −z of its node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// Linear RGB, multiplied by `intensity`.
    pub color: [f32; 3],
    /// Lux for directional lights, candela for the others.
    pub intensity: f32,
    /// Which kind.
    pub kind: LightKind,
}

/// Which kind of light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LightKind {
    /// Parallel, from infinity.
    Directional,
    /// From a point, in all directions.
    Point {
        /// Where it has faded to nothing, metres (KHR_lights_punctual's window); `None`: never.
        range_m: Option<f32>,
    },
    /// From a point, into a cone.
    Spot {
        /// As for points.
        range_m: Option<f32>,
        /// Half-angle up to which the light is full, radians.
        inner_rad: f32,
        /// Half-angle from which there is none, radians.
        outer_rad: f32,
    },
}

/// A camera that a file brings; looks along −z of its node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Vertical field of view, radians.
    pub fov_y_rad: f32,
    /// Width over height, where the file says so.
    pub aspect: Option<f32>,
}

/// A text in the scene: its node's x to the right, y up, readable from +z, centred on the node's origin.
#[derive(Clone, Debug, PartialEq)]
pub struct Label {
    /// May have several lines.
    pub text: String,
    /// Height of a capital letter, metres.
    pub cap_height_m: f32,
    /// Linear RGBA.
    pub color: [f32; 4],
    /// Always turned to the viewer (about the vertical axis).
    pub billboard: bool,
}

/// Something that can be pointed at and grasped.
#[derive(Clone, Debug, PartialEq)]
pub struct Touchable {
    /// Unique; what logs call it.
    pub name: String,
    /// Index into [`Scene::nodes`]: the node and everything below it.
    pub node: usize,
}

/// A box that encloses points, in metres; empty where `min > max`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Smallest coordinates.
    pub min: Point3<f64>,
    /// Largest coordinates.
    pub max: Point3<f64>,
}

impl Bounds {
    /// Encloses nothing.
    pub const EMPTY: Self = Self {
        min: Point3::new(f64::INFINITY, f64::INFINITY, f64::INFINITY),
        max: Point3::new(f64::NEG_INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY),
    };

    /// Grows to enclose `point`.
    pub fn add(&mut self, point: &Point3<f64>) {
        self.min = self.min.inf(point);
        self.max = self.max.sup(point);
    }

    /// Whether nothing is enclosed.
    pub fn is_empty(&self) -> bool {
        self.min.x > self.max.x
    }

    /// The middle; the origin where nothing is enclosed.
    pub fn centre(&self) -> Point3<f64> {
        if self.is_empty() { Point3::origin() } else { nalgebra::center(&self.min, &self.max) }
    }

    /// Length of the diagonal, metres; 0 where nothing is enclosed.
    pub fn diagonal_m(&self) -> f64 {
        if self.is_empty() { 0.0 } else { (self.max - self.min).norm() }
    }
}

impl Texture {
    /// The identity for [`TextureRef::uv_from_uv`].
    pub const UNTRANSFORMED: [[f32; 3]; 2] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
}

impl Default for Material {
    /// glTF's default material: white, fully metallic, fully rough.
    fn default() -> Self {
        Self {
            name: String::new(),
            shading: Shading::MetallicRoughness { metallic: 1.0, roughness: 1.0, texture: None, ior: 1.5 },
            base_color: [1.0; 4],
            base_color_texture: None,
            normal_texture: None,
            normal_scale: 1.0,
            occlusion_texture: None,
            occlusion_strength: 1.0,
            emissive: [0.0; 3],
            emissive_texture: None,
            alpha: Alpha::Opaque,
            double_sided: false,
        }
    }
}

/// Where every node of a scene is, in world coordinates (metres); as long as [`Scene::nodes`].
#[derive(Clone, Debug, Default)]
pub struct WorldTransforms {
    /// One per node.
    pub world_from_node: Vec<Affine>,
}

impl WorldTransforms {
    /// Multiplies local transforms down the hierarchy into `self`; allocates only where the scene has grown.
    /// `local` gives the present transform of a node (animated or as in the file). O(nodes).
    pub fn update(&mut self, scene: &Scene, mut local: impl FnMut(usize) -> Affine) {
        self.world_from_node.clear();
        for (index, node) in scene.nodes.iter().enumerate() {
            let parent_from_node = local(index);
            let world_from_node = match node.parent {
                Some(parent) => self.world_from_node[parent] * parent_from_node,
                None => parent_from_node,
            };
            self.world_from_node.push(world_from_node);
        }
    }

    /// The transforms of the scene at rest: as in the file, nothing animated.
    pub fn at_rest(scene: &Scene) -> Self {
        let mut world = Self::default();
        world.update(scene, |node| scene.nodes[node].parent_from_node.to_affine());
        world
    }
}

impl Scene {
    /// Whether some node shows a surface or a text.
    pub fn shows_something(&self) -> bool {
        let has_triangles = |mesh: usize| self.meshes[mesh].primitives.iter().any(|p| !p.indices.is_empty());
        self.nodes.iter().any(|node| node.label.is_some() || node.mesh.is_some_and(has_triangles))
    }

    /// The box around all vertices of all nodes at rest (skinned meshes in bind pose by their node), metres.
    /// O(vertices).
    pub fn bounds(&self) -> Bounds {
        let world = WorldTransforms::at_rest(self);
        let mut bounds = Bounds::EMPTY;
        for (node, world_from_node) in self.nodes.iter().zip(&world.world_from_node) {
            let Some(mesh) = node.mesh else { continue };
            for position in self.meshes[mesh].primitives.iter().flat_map(|p| &p.positions) {
                let position = Point3::from(Vector3::from(*position).cast::<f64>());
                bounds.add(&world_from_node.transform_point(&position));
            }
        }
        bounds
    }
}
