//! What a plan costs on the GPU, counted by building it.

use std::sync::Arc;

use serde::Serialize;
use vergence_gpu as gpu;
use vergence_plan::Plan;
use vergence_render::{Quality, Renderer, Target};
use vergence_scene::Scene;

use crate::error::Error;

/// What exists on the GPU because of a scene; what every picture needs, whatever it shows, is not counted.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Cost {
    /// The Vulkan device that it was counted on.
    pub device: String,
    /// Ways to draw.
    pub graphics_pipelines: u64,
    /// Ways to compute.
    pub compute_pipelines: u64,
    /// Textures and atlases.
    pub images: u64,
    /// Their bytes.
    pub image_bytes: u64,
    /// Samplers.
    pub samplers: u64,
    /// Bytes of vertices, indices, materials and transforms.
    pub buffer_bytes: u64,
}

/// Builds what `plan` says for `scene`, counts it, and takes it down again.
///
/// # Errors
/// No Vulkan device, or a scene that cannot be drawn.
pub fn cost_of(scene: &Arc<Scene>, plan: &Plan) -> Result<Cost, Error> {
    let instance = gpu::Instance::new(&gpu::InstanceDesc::default(), None)?;
    let device = gpu::Device::new(&instance, &gpu::DeviceDesc::default(), None)?;
    let normal_maps = plan.needs.surfaces.iter().any(|surface| surface.normal_texture);
    let quality = Quality { msaa: 1, anisotropy: Some(1.0), normal_maps, ..Quality::default() };
    let target = Target::new((64, 64), 2);
    let build = |scene: &Arc<Scene>, plan: &Plan| -> Result<gpu::Census, Error> {
        let renderer = Renderer::new(&device, scene, &plan.needs, &quality, &target, 1)?;
        device.wait_idle()?;
        let census = device.census();
        drop(renderer);
        Ok(census)
    };
    // What a picture of nothing needs: its target.
    let nothing = build(&Arc::new(Scene::default()), &Plan::default())?;
    let all = build(scene, plan)?;
    Ok(Cost {
        device: device.limits().name.clone(),
        graphics_pipelines: all.graphics_pipelines.saturating_sub(nothing.graphics_pipelines),
        compute_pipelines: all.compute_pipelines.saturating_sub(nothing.compute_pipelines),
        images: all.images.saturating_sub(nothing.images),
        image_bytes: all.image_bytes.saturating_sub(nothing.image_bytes),
        samplers: all.samplers.saturating_sub(nothing.samplers),
        buffer_bytes: all.buffer_bytes.saturating_sub(nothing.buffer_bytes),
    })
}

impl std::fmt::Display for Cost {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "built on {}:", self.device)?;
        writeln!(
            f,
            "  {} graphics pipelines, {} compute pipelines, {} samplers",
            self.graphics_pipelines, self.compute_pipelines, self.samplers
        )?;
        let mb = |bytes: u64| bytes as f64 / 1e6;
        writeln!(
            f,
            "  {} images of {:.3} MB, buffers of {:.3} MB",
            self.images,
            mb(self.image_bytes),
            mb(self.buffer_bytes)
        )
    }
}
