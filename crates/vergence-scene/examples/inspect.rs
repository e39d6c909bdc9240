//! Prints what a scene holds: `cargo run -p vergence-scene --example inspect -- FILE…`
use std::path::Path;

fn main() {
    for path in std::env::args().skip(1) {
        match vergence_scene::load(Path::new(&path), &vergence_scene::Limits::default()) {
            Ok(scene) => {
                let triangles: usize = scene
                    .nodes
                    .iter()
                    .filter_map(|node| node.mesh)
                    .flat_map(|mesh| &scene.meshes[mesh].primitives)
                    .map(|primitive| primitive.indices.len() / 3)
                    .sum();
                let bounds = scene.bounds();
                println!(
                    "{}: {} nodes, {triangles} triangles drawn, {} materials, {} images, {} skins, {} clips, {} lights, \
                     {} cameras; box {:.3?} to {:.3?} m",
                    scene.name,
                    scene.nodes.len(),
                    scene.materials.len(),
                    scene.images.len(),
                    scene.skins.len(),
                    scene.animations.len(),
                    scene.lights.len(),
                    scene.cameras.len(),
                    bounds.min.coords.as_slice(),
                    bounds.max.coords.as_slice(),
                );
                for warning in &scene.warnings {
                    println!("    {warning}");
                }
            }
            Err(error) => println!("{error}"),
        }
    }
}
