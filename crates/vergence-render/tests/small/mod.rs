//! A device under validation, and small scenes.
#![allow(dead_code, reason = "each test program uses a part")]
#![allow(clippy::unwrap_used, reason = "tests")]

use std::path::PathBuf;
use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use vergence_geom::{Fov, Trs, View};
use vergence_gpu::{Device, DeviceDesc, Instance, InstanceDesc};
use vergence_render::camera::look_at;
use vergence_render::{Offscreen, Quality, Renderer, Target};
use vergence_scene::Needs;
use vergence_scene::model::{Local, Material, Mesh, Node, Primitive, Scene};
use vergence_time::Span;

/// A device with the validation layer, or `None` (and a line that says so) where there is no Vulkan and none is
/// required.
pub fn device() -> Option<Arc<Device>> {
    let desc = InstanceDesc { app_name: "vergence-render tests", validation: true, surface: None };
    let made =
        Instance::new(&desc, None).and_then(|instance| Device::new(&instance, &DeviceDesc::default(), None));
    match made {
        Ok(device) => Some(device),
        Err(error) => {
            let required = std::env::var("VERGENCE_REQUIRE").unwrap_or_default();
            assert!(!required.split(',').any(|what| what == "vulkan"), "Vulkan is required: {error}");
            eprintln!("skipped: no Vulkan device ({error})");
            None
        }
    }
}

/// A scene of `VERGENCE_DATA`; `None`, said, where it is not set and not required.
pub fn data(name: &str) -> Option<PathBuf> {
    let Some(data) = std::env::var_os("VERGENCE_DATA") else {
        let required = std::env::var("VERGENCE_REQUIRE").unwrap_or_default();
        assert!(!required.split(',').any(|what| what == "data"), "data is required: set VERGENCE_DATA");
        eprintln!("skipped: no VERGENCE_DATA");
        return None;
    };
    Some(PathBuf::from(data).join("scenes").join(name))
}

/// Fails where the validation layer had something to say.
pub fn no_messages(device: &Device) {
    assert_eq!(device.validation_messages(), Vec::<String>::new());
}

/// An eye at (x, y, z) that looks along −z.
pub fn view_at(x: f64, y: f64, z: f64) -> View {
    let eye = Point3::new(x, y, z);
    let world_from_eye = look_at(&eye, &(eye - Vector3::z()));
    View { world_from_eye, fov: Fov::symmetric(60f64.to_radians(), 1.0).unwrap() }
}

/// A disc around the origin that faces +z.
pub fn disc(radius: f32) -> Primitive {
    const CORNERS: u32 = 256;
    let mut primitive = Primitive { positions: vec![[0.0; 3]], ..Primitive::default() };
    for corner in 0..CORNERS {
        let angle = corner as f32 / CORNERS as f32 * std::f32::consts::TAU;
        primitive.positions.push([radius * angle.cos(), radius * angle.sin(), 0.0]);
        primitive.indices.extend([0, 1 + corner, 1 + (corner + 1) % CORNERS]);
    }
    primitive.normals = vec![[0.0, 0.0, 1.0]; primitive.positions.len()];
    primitive
}

/// A square around the origin that faces +z, with texture coordinates (0, 0) at its upper left.
pub fn quad(side: f32) -> Primitive {
    let h = 0.5 * side;
    Primitive {
        positions: vec![[-h, -h, 0.0], [h, -h, 0.0], [h, h, 0.0], [-h, h, 0.0]],
        normals: vec![[0.0, 0.0, 1.0]; 4],
        uv0: vec![[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]],
        indices: vec![0, 1, 2, 0, 2, 3],
        ..Primitive::default()
    }
}

/// A scene of one mesh at the origin.
pub fn with_mesh(primitive: Primitive, material: Material) -> Scene {
    let mut scene = Scene::default();
    add(&mut scene, primitive, material, Local::Trs(Trs::identity()));
    scene
}

/// Adds a node with one mesh.
pub fn add(scene: &mut Scene, mut primitive: Primitive, material: Material, parent_from_node: Local) {
    primitive.material = scene.materials.len();
    scene.materials.push(material);
    scene.meshes.push(Mesh { name: String::new(), primitives: vec![primitive] });
    scene.nodes.push(Node {
        name: String::new(),
        parent: None,
        parent_from_node,
        mesh: Some(scene.meshes.len() - 1),
        skin: None,
        light: None,
        camera: None,
        label: None,
    });
}

/// One picture per view.
pub fn draw(
    device: &Arc<Device>,
    scene: Scene,
    quality: &Quality,
    size: (u32, u32),
    views: &[View],
) -> Vec<Vec<u8>> {
    draw_at(device, scene, quality, size, views, 0.0)
}

/// One picture per view, at a time of the animation.
pub fn draw_at(
    device: &Arc<Device>,
    scene: Scene,
    quality: &Quality,
    size: (u32, u32),
    views: &[View],
    secs: f64,
) -> Vec<Vec<u8>> {
    let scene = Arc::new(scene);
    let target = Target::new(size, views.len() as u32);
    let needs = Needs::of(&scene, quality.normal_maps);
    let mut renderer = Renderer::new(device, &scene, &needs, quality, &target, 1).unwrap();
    let mut offscreen = Offscreen::new(device, &target, false).unwrap();
    let time = Span::from_secs_f64(secs).unwrap();
    renderer.begin(0, time, views, &offscreen.attachments()).unwrap();
    renderer.latch(0, views).unwrap();
    renderer.submit(0).unwrap();
    offscreen.pictures().unwrap()
}

/// Red, green, blue, alpha.
pub fn pixel(picture: &[u8], size: (u32, u32), x: u32, y: u32) -> [u8; 4] {
    let at = 4 * (y * size.0 + x) as usize;
    [picture[at], picture[at + 1], picture[at + 2], picture[at + 3]]
}
