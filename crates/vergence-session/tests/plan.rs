//! What is in the plan is built, and what is not costs nothing: no pass, no pipeline, no byte on the GPU.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::path::PathBuf;
use std::sync::Arc;

use vergence_plan::{Pass, Plan, Requests};
use vergence_scene::{Limits, Scene};
use vergence_session::{Cost, cost_of};

fn is_required(what: &str) -> bool {
    std::env::var("VERGENCE_REQUIRE").unwrap_or_default().split(',').any(|entry| entry.trim() == what)
}

fn data() -> Option<PathBuf> {
    let folder = std::env::var_os("VERGENCE_DATA").map(PathBuf::from).filter(|folder| folder.is_dir());
    assert!(
        folder.is_some() || !is_required("data"),
        "VERGENCE_REQUIRE names data, but VERGENCE_DATA is no folder"
    );
    if folder.is_none() {
        println!("skipped: no data");
    }
    folder
}

/// `None` where there is no Vulkan device.
fn built(scene: &Arc<Scene>, plan: &Plan) -> Option<Cost> {
    match cost_of(scene, plan) {
        Ok(cost) => Some(cost),
        Err(error) if is_required("vulkan") => panic!("VERGENCE_REQUIRE names vulkan, but: {error}"),
        Err(error) => {
            println!("skipped: no Vulkan device ({error})");
            None
        }
    }
}

fn load(name: &str) -> Option<(Arc<Scene>, Plan)> {
    let scene = Arc::new(vergence_scene::load(&data()?.join(name), &Limits::default()).unwrap());
    let plan = Plan::of(&scene, &Requests::default());
    Some((scene, plan))
}

#[test]
fn nothing_costs_nothing() {
    let scene = Arc::new(Scene::default());
    let plan = Plan::of(&scene, &Requests::default());
    assert!(plan.passes.is_empty() && plan.needs.surfaces.is_empty());
    let Some(cost) = built(&scene, &plan) else { return };
    assert_eq!(cost, Cost { device: cost.device.clone(), ..Cost::default() });
}

#[test]
fn a_box_costs_one_way_to_draw_and_no_texture() {
    let Some((scene, plan)) = load("scenes/gltf/Box.glb") else { return };
    assert_eq!(plan.passes, [Pass::Draw]);
    let Some(cost) = built(&scene, &plan) else { return };
    assert_eq!((cost.graphics_pipelines, cost.compute_pipelines), (1, 0), "{cost:?}");
    assert_eq!((cost.images, cost.image_bytes, cost.samplers), (0, 0, 0), "{cost:?}");
    // 24 vertices, 36 indices, one material, one transform for two eyes: a few kilobytes with all alignment.
    assert!((1..64_000).contains(&cost.buffer_bytes), "{cost:?}");
}

#[test]
fn joints_and_textures_cost_what_they_need() {
    let Some((scene, plan)) = load("scenes/gltf/CesiumMan.glb") else { return };
    assert_eq!(plan.passes, [Pass::Skin, Pass::Draw]);
    let Some(cost) = built(&scene, &plan) else { return };
    assert!(cost.compute_pipelines >= 1 && cost.images >= 1, "{cost:?}");
    let texels: usize = plan.needs.images.iter().map(|(image, _)| scene.images[*image].rgba.len()).sum();
    // A chain of halves adds a third; allocation rounds up.
    assert!((texels as u64..2 * texels as u64 + 1_000_000).contains(&cost.image_bytes), "{cost:?} {texels}");
}

/// A knob that leaves normal maps out leaves their images out.
#[test]
fn normal_maps_that_are_off_cost_nothing() {
    let Some((scene, with)) = load("scenes/gltf/NormalTangentTest.glb") else { return };
    let without = Plan::of(&scene, &Requests { normal_maps: false, ..Requests::default() });
    assert!(without.needs.images.len() < with.needs.images.len());
    let (Some(with), Some(without)) = (built(&scene, &with), built(&scene, &without)) else { return };
    assert!(without.image_bytes < with.image_bytes, "{without:?} {with:?}");
}
