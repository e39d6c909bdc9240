//! Draws scenes made in memory into pictures of floating-point numbers, with their depth.

use std::sync::Arc;

use vergence_geom::View;
use vergence_gpu::{
    Device, DeviceDesc, Image, ImageDesc, ImageView, Instance, InstanceDesc, ReadBack, Use, ViewDesc, vk,
};
use vergence_render::{Attachments, Quality, Renderer, Target};
use vergence_scene::{Needs, Scene};
use vergence_time::Span;

/// A device to draw with, with validation where it is installed.
pub struct Bench {
    device: Arc<Device>,
    read: ReadBack,
}

/// What was drawn.
pub struct Shot {
    size: (u32, u32),
    color: Vec<Vec<f32>>,
    depth: Vec<Vec<f32>>,
}

impl Shot {
    fn index(&self, x: u32, y: u32) -> usize {
        assert!(x < self.size.0 && y < self.size.1, "pixel ({x}, {y}) of {:?}", self.size);
        (y * self.size.0 + x) as usize
    }

    /// Linear red, green, blue and alpha as the shader wrote them.
    #[must_use]
    pub fn color(&self, view: usize, x: u32, y: u32) -> [f32; 4] {
        let at = 4 * self.index(x, y);
        let values = &self.color[view][at..at + 4];
        [values[0], values[1], values[2], values[3]]
    }

    /// What the depth buffer holds: 1 at the near plane, 0 at infinity.
    #[must_use]
    pub fn depth(&self, view: usize, x: u32, y: u32) -> f32 {
        self.depth[view][self.index(x, y)]
    }
}

impl Bench {
    /// Opens the device. `None`, and the test says that it is skipped, where there is none.
    ///
    /// # Panics
    /// When `VERGENCE_REQUIRE` names `vulkan` and there is none.
    #[must_use]
    pub fn open() -> Option<Self> {
        let open = || {
            let desc =
                InstanceDesc { app_name: "vergence-tests", validation: true, ..InstanceDesc::default() };
            let device = Device::new(&Instance::new(&desc, None)?, &DeviceDesc::default(), None)?;
            let read = ReadBack::new(&device)?;
            Ok::<_, vergence_gpu::Error>(Self { device, read })
        };
        open().map_err(|error| crate::skip("vulkan", &error.to_string())).ok()
    }

    /// For titles.
    #[must_use]
    pub fn device_name(&self) -> String {
        self.device.limits().name.clone()
    }

    /// What validation has said since it was last asked.
    #[must_use]
    pub fn complaints(&self) -> Vec<String> {
        self.device.validation_messages()
    }

    /// Draws one frame of `scene` for all `views`, one sample per pixel, 32-bit float colour and depth.
    ///
    /// # Panics
    /// Where the renderer refuses.
    pub fn shoot(&mut self, scene: &Scene, near_m: f64, size: (u32, u32), views: &[View]) -> Shot {
        self.try_shoot(scene, near_m, size, views).expect("the renderer draws what tests make")
    }

    fn try_shoot(
        &mut self,
        scene: &Scene,
        near_m: f64,
        size: (u32, u32),
        views: &[View],
    ) -> Result<Shot, vergence_render::Error> {
        let scene = Arc::new(scene.clone());
        let quality = Quality { msaa: 1, near_m, ..Quality::default() };
        let target = Target {
            color_format: vk::Format::R32G32B32A32_SFLOAT,
            depth_format: vk::Format::D32_SFLOAT,
            size,
            views: views.len() as u32,
        };
        let image = |name, format, usage| {
            let usage = usage | vk::ImageUsageFlags::TRANSFER_SRC;
            let desc = ImageDesc {
                name,
                format,
                width: size.0,
                height: size.1,
                layers: target.views,
                usage,
                ..Default::default()
            };
            Image::new(&self.device, &desc)
        };
        let color = image("colour", target.color_format, vk::ImageUsageFlags::COLOR_ATTACHMENT)?;
        let depth = image("depth", target.depth_format, vk::ImageUsageFlags::DEPTH_STENCIL_ATTACHMENT)?;
        let all_layers = ViewDesc { kind: Some(vk::ImageViewType::TYPE_2D_ARRAY), ..ViewDesc::default() };
        let (color_view, depth_view) =
            (ImageView::new(&color, &all_layers)?, ImageView::new(&depth, &all_layers)?);
        let attachments = Attachments {
            color: &color_view,
            color_before: Use::Undefined,
            color_after: Use::TransferSource,
            depth: Some(&depth_view),
            depth_before: Use::Undefined,
            depth_after: Use::TransferSource,
        };
        let needs = Needs::of(&scene, quality.normal_maps);
        let mut renderer = Renderer::new(&self.device, &scene, &needs, &quality, &target, 1)?;
        renderer.begin(0, Span::ZERO, views, &attachments)?;
        renderer.latch(0, views)?;
        let submission = renderer.submit(0)?;
        self.device.wait(submission)?;
        let mut layers = |image| -> Result<Vec<Vec<f32>>, vergence_render::Error> {
            let mut layers = Vec::new();
            for layer in 0..target.views {
                let mut bytes = Vec::new();
                self.read.layer(image, layer, Use::TransferSource, &mut bytes)?;
                let value = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
                layers.push(bytes.chunks_exact(4).map(value).collect());
            }
            Ok(layers)
        };
        Ok(Shot { size, color: layers(&color)?, depth: layers(&depth)? })
    }
}
