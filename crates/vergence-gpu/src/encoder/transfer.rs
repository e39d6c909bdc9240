//! Recording copies, blits and clears.

use std::sync::Arc;

use ash::vk;

use super::{Encoder, ImageBarrier};
use crate::buffer::Buffer;
use crate::driver_clock::quick;
use crate::format::texel_bytes;
use crate::image::Image;
use crate::sync::Use;

/// A rectangle of texels of one mip level of one layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Area {
    /// Layer.
    pub layer: u32,
    /// Mip level.
    pub mip: u32,
    /// Left, top.
    pub min: (u32, u32),
    /// Right, bottom (exclusive).
    pub max: (u32, u32),
}

impl Area {
    /// All of a layer at a mip level of `image`.
    pub fn whole(image: &Image, layer: u32, mip: u32) -> Self {
        Self { layer, mip, min: (0, 0), max: image.size(mip) }
    }

    fn fits(&self, image: &Image) -> bool {
        let (width, height) = image.size(self.mip);
        self.layer < image.layers()
            && self.mip < image.mips()
            && self.min.0 < self.max.0
            && self.min.1 < self.max.1
            && self.max.0 <= width
            && self.max.1 <= height
    }

    fn subresource(&self, image: &Image) -> vk::ImageSubresourceLayers {
        // Copies name one aspect; of a depth and stencil image the depth is meant.
        let aspect = match image.aspect() {
            both if both.contains(vk::ImageAspectFlags::DEPTH) => vk::ImageAspectFlags::DEPTH,
            other => other,
        };
        vk::ImageSubresourceLayers {
            aspect_mask: aspect,
            mip_level: self.mip,
            base_array_layer: self.layer,
            layer_count: 1,
        }
    }

    fn offset(&self) -> vk::Offset3D {
        vk::Offset3D { x: self.min.0 as i32, y: self.min.1 as i32, z: 0 }
    }

    fn end(&self) -> vk::Offset3D {
        vk::Offset3D { x: self.max.0 as i32, y: self.max.1 as i32, z: 1 }
    }

    fn extent(&self) -> vk::Extent3D {
        vk::Extent3D { width: self.max.0 - self.min.0, height: self.max.1 - self.min.1, depth: 1 }
    }

    fn texels(&self) -> u64 {
        u64::from(self.max.0 - self.min.0) * u64::from(self.max.1 - self.min.1)
    }
}

impl Encoder<'_> {
    /// Copies bytes between buffers.
    pub fn copy_buffer(
        &mut self,
        from: &Arc<Buffer>,
        from_offset: u64,
        to: &Arc<Buffer>,
        to_offset: u64,
        bytes: u64,
    ) {
        let fits = bytes > 0
            && from_offset.checked_add(bytes).is_some_and(|end| end <= from.size())
            && to_offset.checked_add(bytes).is_some_and(|end| end <= to.size());
        if !self.ensure(fits && !self.rendering, "a copy outside of a buffer, or inside of rendering") {
            return;
        }
        if !self.keep(from) || !self.keep(to) {
            return;
        }
        let region = [vk::BufferCopy { src_offset: from_offset, dst_offset: to_offset, size: bytes }];
        // SAFETY: recording; both are kept, the ranges within them.
        quick(|| unsafe {
            self.commands.device.raw.cmd_copy_buffer(self.commands.raw, from.raw, to.raw, &region)
        });
    }

    fn texels_fit(&mut self, image: &Image, area: &Area, buffer: &Buffer, offset: u64) -> bool {
        // Of a compressed format the driver checks; a texel then takes at most one byte.
        let texel = texel_bytes(image.format()).unwrap_or(1);
        let right = area.fits(image)
            && offset.is_multiple_of(4)
            && (area.texels().checked_mul(texel))
                .and_then(|bytes| bytes.checked_add(offset))
                .is_some_and(|end| end <= buffer.size())
            && !self.rendering;
        self.ensure(right, "a copy outside of an image or buffer, or inside of rendering")
    }

    /// Copies tightly packed texels from a buffer to an image in the use [`Use::TransferDestination`].
    pub fn copy_buffer_to_image(&mut self, from: &Arc<Buffer>, offset: u64, to: &Arc<Image>, area: Area) {
        if !self.texels_fit(to, &area, from, offset) {
            return;
        }
        if !self.keep(from) || !self.keep(to) {
            return;
        }
        let region = [vk::BufferImageCopy {
            buffer_offset: offset,
            buffer_row_length: 0,
            buffer_image_height: 0,
            image_subresource: area.subresource(to),
            image_offset: area.offset(),
            image_extent: area.extent(),
        }];
        // SAFETY: recording; both are kept, the ranges within them.
        quick(|| unsafe {
            self.commands.device.raw.cmd_copy_buffer_to_image(
                self.commands.raw,
                from.raw,
                to.raw,
                Use::TransferDestination.layout(),
                &region,
            );
        });
    }

    /// Copies texels of an image in the use [`Use::TransferSource`] to a buffer, tightly packed.
    pub fn copy_image_to_buffer(&mut self, from: &Arc<Image>, area: Area, to: &Arc<Buffer>, offset: u64) {
        if !self.texels_fit(from, &area, to, offset) {
            return;
        }
        if !self.keep(from) || !self.keep(to) {
            return;
        }
        let region = [vk::BufferImageCopy {
            buffer_offset: offset,
            buffer_row_length: 0,
            buffer_image_height: 0,
            image_subresource: area.subresource(from),
            image_offset: area.offset(),
            image_extent: area.extent(),
        }];
        // SAFETY: recording; both are kept, the ranges within them.
        quick(|| unsafe {
            self.commands.device.raw.cmd_copy_image_to_buffer(
                self.commands.raw,
                from.raw,
                Use::TransferSource.layout(),
                to.raw,
                &region,
            );
        });
    }

    /// Copies texels between images of the same format size ([`Use::TransferSource`] to [`Use::TransferDestination`]); `to` has the
    /// size of `from_area`.
    pub fn copy_image(&mut self, from: &Arc<Image>, from_area: Area, to: &Arc<Image>, to_area: Area) {
        let right = from_area.fits(from)
            && to_area.fits(to)
            && from_area.extent() == to_area.extent()
            && from.samples() == to.samples()
            && !self.rendering;
        if !self.ensure(
            right,
            "a copy between areas that differ or are outside of an image, or inside of rendering",
        ) {
            return;
        }
        if !self.keep(from) || !self.keep(to) {
            return;
        }
        let region = [vk::ImageCopy {
            src_subresource: from_area.subresource(from),
            src_offset: from_area.offset(),
            dst_subresource: to_area.subresource(to),
            dst_offset: to_area.offset(),
            extent: from_area.extent(),
        }];
        // SAFETY: recording; both are kept, the ranges within them.
        quick(|| unsafe {
            self.commands.device.raw.cmd_copy_image(
                self.commands.raw,
                from.raw,
                Use::TransferSource.layout(),
                to.raw,
                Use::TransferDestination.layout(),
                &region,
            );
        });
    }

    /// Copies and scales texels ([`Use::TransferSource`] to [`Use::TransferDestination`]); sRGB formats are filtered in linear light.
    pub fn blit(
        &mut self,
        from: &Arc<Image>,
        from_area: Area,
        to: &Arc<Image>,
        to_area: Area,
        filter: vk::Filter,
    ) {
        let right = from_area.fits(from)
            && to_area.fits(to)
            && from.samples() == 1
            && to.samples() == 1
            && !self.rendering;
        if !self.ensure(right, "a blit outside of an image, of several samples, or inside of rendering") {
            return;
        }
        if !self.keep(from) || !self.keep(to) {
            return;
        }
        let region = [vk::ImageBlit {
            src_subresource: from_area.subresource(from),
            src_offsets: [from_area.offset(), from_area.end()],
            dst_subresource: to_area.subresource(to),
            dst_offsets: [to_area.offset(), to_area.end()],
        }];
        // SAFETY: recording; both are kept, the ranges within them.
        quick(|| unsafe {
            self.commands.device.raw.cmd_blit_image(
                self.commands.raw,
                from.raw,
                Use::TransferSource.layout(),
                to.raw,
                Use::TransferDestination.layout(),
                &region,
                filter,
            );
        });
    }

    /// Fills a colour image in the use [`Use::TransferDestination`] with one value (linear red, green, blue, alpha).
    pub fn clear(&mut self, image: &Arc<Image>, color: [f32; 4]) {
        let right = image.aspect() == vk::ImageAspectFlags::COLOR && !self.rendering;
        if !self.ensure(right, "a clear of an image without colour, or inside of rendering") {
            return;
        }
        if !self.keep(image) {
            return;
        }
        let range = [vk::ImageSubresourceRange {
            aspect_mask: vk::ImageAspectFlags::COLOR,
            base_mip_level: 0,
            level_count: vk::REMAINING_MIP_LEVELS,
            base_array_layer: 0,
            layer_count: vk::REMAINING_ARRAY_LAYERS,
        }];
        // SAFETY: recording; the image is kept.
        quick(|| unsafe {
            self.commands.device.raw.cmd_clear_color_image(
                self.commands.raw,
                image.raw,
                Use::TransferDestination.layout(),
                &vk::ClearColorValue { float32: color },
                &range,
            );
        });
    }

    /// Fills mips 1, 2, … of an image from mip 0 by halving. All of it must be in the use [`Use::TransferDestination`]; afterwards all
    /// of it is in the use `then`.
    pub fn fill_mips(&mut self, image: &Arc<Image>, then: Use) {
        for mip in 1..image.mips() {
            let source =
                ImageBarrier::new(image, Use::TransferDestination, Use::TransferSource).mips(mip - 1, 1);
            self.barrier(&[source], &[]);
            for layer in 0..image.layers() {
                let (from, to) = (Area::whole(image, layer, mip - 1), Area::whole(image, layer, mip));
                self.blit(image, from, image, to, vk::Filter::LINEAR);
            }
        }
        let last = image.mips() - 1;
        let upper = ImageBarrier::new(image, Use::TransferSource, then).mips(0, last);
        let lowest = ImageBarrier::new(image, Use::TransferDestination, then).mips(last, 1);
        if last == 0 {
            self.barrier(&[lowest], &[]);
        } else {
            self.barrier(&[upper, lowest], &[]);
        }
    }
}
