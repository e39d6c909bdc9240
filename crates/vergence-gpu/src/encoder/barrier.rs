//! What comes after waits for what came before.

use std::sync::Arc;

use ash::vk;

use super::Encoder;
use crate::buffer::Buffer;
use crate::driver_clock::quick;
use crate::image::Image;
use crate::sync::Use;

/// Barriers given to the driver at once.
const BARRIERS_AT_ONCE: usize = 8;

/// A change of use of an image, or a part of it.
#[derive(Clone, Copy)]
pub struct ImageBarrier<'a> {
    image: &'a Arc<Image>,
    from: Use,
    to: Use,
    discard: bool,
    layers: (u32, u32),
    mips: (u32, u32),
}

impl<'a> ImageBarrier<'a> {
    /// All of `image`, from one use to another.
    pub fn new(image: &'a Arc<Image>, from: Use, to: Use) -> Self {
        Self {
            image,
            from,
            to,
            discard: false,
            layers: (0, vk::REMAINING_ARRAY_LAYERS),
            mips: (0, vk::REMAINING_MIP_LEVELS),
        }
    }

    /// Waits for `from`, but gives up the content.
    pub fn discard(self) -> Self {
        Self { discard: true, ..self }
    }

    /// Only `count` layers from `base`.
    pub fn layers(self, base: u32, count: u32) -> Self {
        Self { layers: (base, count), ..self }
    }

    /// Only `count` mip levels from `base`.
    pub fn mips(self, base: u32, count: u32) -> Self {
        Self { mips: (base, count), ..self }
    }
}

/// A change of use of a buffer.
#[derive(Clone, Copy)]
pub struct BufferBarrier<'a> {
    /// The buffer.
    pub buffer: &'a Arc<Buffer>,
    /// What it was used for.
    pub from: Use,
    /// What it will be used for.
    pub to: Use,
}

impl Encoder<'_> {
    /// Orders what comes after the changes of use behind what came before; not inside of rendering.
    pub fn barrier(&mut self, images: &[ImageBarrier<'_>], buffers: &[BufferBarrier<'_>]) {
        if !self.ensure(!self.rendering, "a barrier inside of rendering") {
            return;
        }
        for images in images.chunks(BARRIERS_AT_ONCE) {
            let mut raw = [vk::ImageMemoryBarrier2::default(); BARRIERS_AT_ONCE];
            for (raw, barrier) in raw.iter_mut().zip(images) {
                if !self.keep(barrier.image) {
                    return;
                }
                let (from_stages, from_access) = barrier.from.source();
                let (to_stages, to_access) = barrier.to.scope();
                *raw = vk::ImageMemoryBarrier2::default()
                    .src_stage_mask(from_stages)
                    .src_access_mask(from_access)
                    .dst_stage_mask(to_stages)
                    .dst_access_mask(to_access)
                    .old_layout(if barrier.discard {
                        vk::ImageLayout::UNDEFINED
                    } else {
                        barrier.from.layout()
                    })
                    .new_layout(barrier.to.layout())
                    .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
                    .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
                    .image(barrier.image.raw)
                    .subresource_range(vk::ImageSubresourceRange {
                        aspect_mask: barrier.image.aspect(),
                        base_mip_level: barrier.mips.0,
                        level_count: barrier.mips.1,
                        base_array_layer: barrier.layers.0,
                        layer_count: barrier.layers.1,
                    });
            }
            let info = vk::DependencyInfo::default().image_memory_barriers(&raw[..images.len()]);
            // SAFETY: recording, outside of rendering; the images are kept.
            quick(|| unsafe { self.commands.device.raw.cmd_pipeline_barrier2(self.commands.raw, &info) });
        }
        for buffers in buffers.chunks(BARRIERS_AT_ONCE) {
            let mut raw = [vk::BufferMemoryBarrier2::default(); BARRIERS_AT_ONCE];
            for (raw, barrier) in raw.iter_mut().zip(buffers) {
                if !self.keep(barrier.buffer) {
                    return;
                }
                let (from_stages, from_access) = barrier.from.source();
                let (to_stages, to_access) = barrier.to.scope();
                *raw = vk::BufferMemoryBarrier2::default()
                    .src_stage_mask(from_stages)
                    .src_access_mask(from_access)
                    .dst_stage_mask(to_stages)
                    .dst_access_mask(to_access)
                    .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
                    .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
                    .buffer(barrier.buffer.raw)
                    .offset(0)
                    .size(vk::WHOLE_SIZE);
            }
            let info = vk::DependencyInfo::default().buffer_memory_barriers(&raw[..buffers.len()]);
            // SAFETY: recording, outside of rendering; the buffers are kept.
            quick(|| unsafe { self.commands.device.raw.cmd_pipeline_barrier2(self.commands.raw, &info) });
        }
    }

    /// One image, all of it, from one use to another.
    pub fn transition(&mut self, image: &Arc<Image>, from: Use, to: Use) {
        self.barrier(&[ImageBarrier::new(image, from, to)], &[]);
    }
}
