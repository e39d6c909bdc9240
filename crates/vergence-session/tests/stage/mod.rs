//! What the tests of runs share: a disc to look at, a small headset, a folder that goes away.

#![allow(dead_code, reason = "each test file uses its part")]

use std::path::PathBuf;
use std::sync::Arc;

use vergence_geom::{Affine, Rigid};
use vergence_scene::Scene;
use vergence_scene::model::{Local, Material, Mesh, Node, Primitive, Shading, Touchable};
use vergence_session::{HeadsetChoice, RunConfig};

/// Radius of the disc that is looked for, metres, at [`DISC_AHEAD_M`]: about 40 pixels across at 256 pixels for 90°.
pub const DISC_RADIUS_M: f64 = 0.3;
pub const DISC_AHEAD_M: f64 = 2.0;

pub fn has_vulkan() -> bool {
    let required =
        std::env::var("VERGENCE_REQUIRE").unwrap_or_default().split(',').any(|r| r.trim() == "vulkan");
    let instance = vergence_gpu::Instance::new(&vergence_gpu::InstanceDesc::default(), None);
    let device =
        instance.and_then(|i| vergence_gpu::Device::new(&i, &vergence_gpu::DeviceDesc::default(), None));
    match device {
        Ok(_) => true,
        Err(error) if required => panic!("VERGENCE_REQUIRE names vulkan, but: {error}"),
        Err(error) => {
            println!("skipped: no Vulkan device ({error})");
            false
        }
    }
}

/// A folder that is removed again.
pub struct Folder(pub PathBuf);

impl Folder {
    pub fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("vergence-session-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    /// A headset small enough for a machine without a GPU.
    pub fn profile(&self) -> Option<String> {
        let path = self.0.join("small.toml");
        let text = r#"
            name = "small"
            resolution = [256, 240]
            rates = ["72 Hz"]
            ipd = "64 mm"
            [left]
            fov = { left = "-48 deg", right = "42 deg", up = "44 deg", down = "-46 deg" }
        "#;
        std::fs::write(&path, text).unwrap();
        Some(path.to_str().unwrap().to_owned())
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

pub fn node(mesh: usize, parent_from_node: Rigid) -> Node {
    Node {
        name: "disc".into(),
        parent: None,
        parent_from_node: Local::Matrix(Affine::from(parent_from_node)),
        mesh: Some(mesh),
        skin: None,
        light: None,
        camera: None,
        label: None,
    }
}

/// A white disc that faces +z, ahead of a user who stands at the origin, at eye height.
pub fn disc(touchable: bool) -> Arc<Scene> {
    const CORNERS: u32 = 96;
    let mut positions = vec![[0.0; 3]];
    let mut indices = Vec::new();
    for corner in 0..CORNERS {
        let angle = f64::from(corner) / f64::from(CORNERS) * std::f64::consts::TAU;
        positions.push([(angle.cos() * DISC_RADIUS_M) as f32, (angle.sin() * DISC_RADIUS_M) as f32, 0.0]);
        indices.extend([0, 1 + corner, 1 + (corner + 1) % CORNERS]);
    }
    let normals = vec![[0.0, 0.0, 1.0]; positions.len()];
    let primitive = Primitive { positions, normals, indices, ..Primitive::default() };
    Arc::new(Scene {
        name: "disc".into(),
        nodes: vec![node(0, Rigid::translation(0.0, 1.6, -DISC_AHEAD_M))],
        meshes: vec![Mesh { name: "disc".into(), primitives: vec![primitive] }],
        materials: vec![Material { shading: Shading::Unlit, ..Material::default() }],
        world_from_start: Some(Rigid::identity()),
        touchables: if touchable { vec![Touchable { name: "disc".into(), node: 0 }] } else { Vec::new() },
        ..Scene::default()
    })
}

pub fn config(folder: &Folder, frames: u64) -> RunConfig {
    RunConfig {
        headset: HeadsetChoice::Simulated,
        profile: folder.profile(),
        motion: Some("look-around.toml".into()),
        frames: Some(frames),
        quality: vergence_render::Quality { msaa: 1, ..Default::default() },
        validation: true,
        ..RunConfig::default()
    }
}
