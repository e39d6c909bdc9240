//! What the cases stand on: scenes made in memory, drawn into pictures of floating-point numbers.

use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};
use vergence_geom::{Affine, Fov, Rigid, Trs, View};
use vergence_scene::model::{
    Alpha, Light, LightKind, Local, Material, Mesh, Node, Primitive, Scene, Shading,
};

/// Metres; what the renderer draws with unless a case says otherwise.
pub const NEAR_M: f64 = 0.05;

/// A node that shows nothing yet.
pub fn node(parent_from_node: Affine) -> Node {
    Node {
        name: String::new(),
        parent: None,
        parent_from_node: Local::Matrix(parent_from_node),
        mesh: None,
        skin: None,
        light: None,
        camera: None,
        label: None,
    }
}

/// A surface without light.
pub fn unlit(color: [f32; 4]) -> Material {
    Material { shading: Shading::Unlit, base_color: color, alpha: Alpha::Opaque, ..Material::default() }
}

/// A surface that reflects diffusely only.
pub fn matt(color: [f32; 4]) -> Material {
    let shading = Shading::BlinnPhong { specular: [0.0; 3], shininess: 1.0 };
    Material { shading, base_color: color, ..Material::default() }
}

/// The square −½…½ in x and y, facing +z, with one normal; its vertex colours are (u, v, 1), both 0…1.
pub fn square() -> Primitive {
    let corners = [[-0.5f32, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]];
    Primitive {
        positions: corners.map(|[x, y]| [x, y, 0.0]).to_vec(),
        normals: vec![[0.0, 0.0, 1.0]; 4],
        colors: corners.map(|[x, y]| [x + 0.5, y + 0.5, 1.0, 1.0]).to_vec(),
        indices: vec![0, 1, 2, 0, 2, 3],
        ..Primitive::default()
    }
}

/// Adds a primitive with its own material and node; returns the node.
pub fn add(
    scene: &mut Scene,
    parent_from_node: Affine,
    mut primitive: Primitive,
    material: Material,
) -> usize {
    primitive.material = scene.materials.len();
    scene.materials.push(material);
    scene.meshes.push(Mesh { name: String::new(), primitives: vec![primitive] });
    let mesh = Some(scene.meshes.len() - 1);
    scene.nodes.push(Node { mesh, ..node(parent_from_node) });
    scene.nodes.len() - 1
}

/// Adds a light at infinity from the (unit) direction `towards`, `color` times `intensity` lux.
pub fn add_sun(scene: &mut Scene, towards: &Vector3<f64>, color: [f32; 3], intensity: f32) {
    // A light shines along −z of its node, so its +z points towards where the light comes from.
    let rotation = UnitQuaternion::rotation_between(&Vector3::z(), towards)
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
    scene.lights.push(Light { color, intensity, kind: LightKind::Directional });
    let light = Some(scene.lights.len() - 1);
    scene
        .nodes
        .push(Node { light, ..node(Affine::from(Rigid::from_parts(Vector3::zeros().into(), rotation))) });
}

/// A square of `width` × `height` metres at `place`.
pub fn sized(place: &Rigid, width: f64, height: f64) -> Affine {
    Affine::from(*place) * Trs { scale: Vector3::new(width, height, 1.0), ..Trs::identity() }.to_affine()
}

/// An eye at `eye` that looks at `target`, y up.
pub fn looking(eye: &Point3<f64>, target: &Point3<f64>, fov: Fov) -> View {
    let forward = (target - eye).normalize();
    let right = forward.cross(&Vector3::y()).normalize();
    let up = right.cross(&forward);
    let rotation = nalgebra::Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[right, up, -forward]));
    View { world_from_eye: Rigid::from_parts(eye.coords.into(), rotation.into()), fov }
}

/// A view of a square picture, the same angle in all directions.
pub fn square_fov(degrees: f64) -> Fov {
    Fov::symmetric(degrees.to_radians(), 1.0).expect("between 0 and 180 degrees")
}

/// Where the middle of a pixel looks to, in eye coordinates at depth 1 (z = −1).
pub fn ray_of_pixel(fov: &Fov, size: (u32, u32), x: u32, y: u32) -> Vector3<f64> {
    let [l, r, u, d] = fov.tangents();
    let (s, t) = ((f64::from(x) + 0.5) / f64::from(size.0), (f64::from(y) + 0.5) / f64::from(size.1));
    Vector3::new(l + (r - l) * s, u + (d - u) * t, -1.0)
}

/// Angle between two directions that are nearly equal, radians.
pub fn angle(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.cross(b).norm().atan2(a.dot(b))
}
