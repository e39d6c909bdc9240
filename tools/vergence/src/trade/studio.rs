//! Draws a scene at a quality, and times it.

use std::sync::Arc;
use std::time::Instant;

use vergence_geom::View;
use vergence_gpu::{Device, DeviceDesc, Instance, InstanceDesc};
use vergence_render::{Offscreen, Quality, Renderer, Target};
use vergence_scene::{Needs, Scene};
use vergence_time::Span;

use crate::failure::Failure;
use crate::timing::{median, process_cpu_ms};

/// A device to draw with.
pub struct Studio {
    device: Arc<Device>,
}

/// What a stereo frame took: medians, milliseconds.
pub struct Costs {
    /// CPU time of all threads of the process.
    pub cpu_ms: f64,
    /// Time on the device, all passes; NaN where it has no timestamps, or is a processor, whose stamps are no such
    /// thing.
    pub gpu_ms: f64,
    /// From the first command until the device is done.
    pub wall_ms: f64,
}

/// A drawn and timed frame.
pub struct Drawn {
    /// Pixels of each picture.
    pub size: (u32, u32),
    /// One picture per view: four bytes per pixel, sRGB, rows from the top.
    pub rgba: Vec<Vec<u8>>,
    /// What it took.
    pub costs: Costs,
}

impl Studio {
    /// Opens the device that draws.
    pub fn open() -> Result<Self, Failure> {
        let desc = InstanceDesc { app_name: "vergence", ..InstanceDesc::default() };
        let instance = Instance::new(&desc, None).map_err(|e| Failure::work(&e))?;
        let device = Device::new(&instance, &DeviceDesc::default(), None).map_err(|e| Failure::gpu(&e))?;
        Ok(Self { device })
    }

    /// Name and driver.
    pub fn device_name(&self) -> String {
        let limits = self.device.limits();
        format!("{} ({})", limits.name, limits.driver)
    }

    /// Samples per pixel that it offers, ascending.
    pub fn msaa(&self) -> &[u32] {
        &self.device.limits().msaa
    }

    /// Most samples per pixel that the renderer may use.
    pub fn most_msaa(&self) -> u32 {
        self.msaa().last().copied().unwrap_or(1)
    }

    /// Largest anisotropy.
    pub fn most_anisotropy(&self) -> f32 {
        self.device.limits().max_anisotropy
    }

    /// Whether the device has timestamps and is no processor.
    pub fn gpu_times_mean_something(&self) -> bool {
        let limits = self.device.limits();
        limits.timestamp_period_ns > 0.0 && !limits.software
    }

    /// Draws `warm_up + frames` frames of the scene at rest and reads the last one back. The medians are over `frames`,
    /// and do not contain the read-back.
    pub fn draw(
        &mut self,
        scene: &Arc<Scene>,
        quality: &Quality,
        size: (u32, u32),
        views: &[View],
        warm_up: u32,
        frames: u32,
    ) -> Result<Drawn, Failure> {
        let most = self.device.limits().max_image_size;
        if size.0.max(size.1) > most {
            let name = self.device_name();
            return Err(Failure::Call(format!(
                "{} x {} pixels are needed, {name} draws at most {most} x {most}",
                size.0, size.1
            )));
        }
        self.draw_checked(scene, quality, size, views, warm_up, frames).map_err(|e| Failure::work(&e))
    }

    fn draw_checked(
        &mut self,
        scene: &Arc<Scene>,
        quality: &Quality,
        size: (u32, u32),
        views: &[View],
        warm_up: u32,
        frames: u32,
    ) -> Result<Drawn, vergence_render::Error> {
        let needs = Needs::of(scene, quality.normal_maps);
        let target = Target::new(size, views.len() as u32);
        let mut offscreen = Offscreen::new(&self.device, &target, false)?;
        let mut renderer = Renderer::new(&self.device, scene, &needs, quality, &target, 1)?;
        let (mut cpu, mut gpu, mut wall) = (Vec::new(), Vec::new(), Vec::new());
        for frame in 0..warm_up + frames {
            let (cpu_before, started) = (process_cpu_ms(), Instant::now());
            renderer.begin(0, Span::ZERO, views, &offscreen.attachments())?;
            renderer.latch(0, views)?;
            let submission = renderer.submit(0)?;
            self.device.wait(submission)?;
            if frame >= warm_up {
                wall.push(started.elapsed().as_secs_f64() * 1e3);
                cpu.push(process_cpu_ms() - cpu_before);
                gpu.push(renderer.timings(0)?.iter().map(|pass| pass.ms).sum());
            }
        }
        let gpu_ms = if self.gpu_times_mean_something() { median(&gpu) } else { f64::NAN };
        let costs = Costs { cpu_ms: median(&cpu), gpu_ms, wall_ms: median(&wall) };
        Ok(Drawn { size, rgba: offscreen.pictures()?, costs })
    }
}
