//! A target that can be read back: one layer per view.

use std::sync::Arc;

use vergence_gpu::vk;
use vergence_gpu::{
    Area, Buffer, BufferBarrier, CommandBuffer, Device, Image, ImageDesc, ImageView, Memory, Use,
};

use crate::Error;
use crate::target::{Attachments, Target};

/// Colour (and depth, where it is wanted) of all views, and a buffer that the host reads.
pub struct Offscreen {
    device: Arc<Device>,
    target: Target,
    color: Arc<ImageView>,
    depth: Option<Arc<ImageView>>,
    commands: CommandBuffer,
    buffer: Arc<Buffer>,
}

impl Offscreen {
    /// Makes images and buffer for `target`; with depth where `with_depth`.
    ///
    /// # Errors
    /// No memory, or a size or format that the device does not have.
    pub fn new(device: &Arc<Device>, target: &Target, with_depth: bool) -> Result<Self, Error> {
        let image = |name, format, usage| -> Result<Arc<ImageView>, Error> {
            let image = Image::new(
                device,
                &ImageDesc {
                    name,
                    format,
                    width: target.size.0,
                    height: target.size.1,
                    layers: target.views,
                    usage: usage | vk::ImageUsageFlags::TRANSFER_SRC,
                    ..ImageDesc::default()
                },
            )?;
            let kind = Some(vk::ImageViewType::TYPE_2D_ARRAY);
            Ok(ImageView::new(&image, &vergence_gpu::ViewDesc { kind, ..Default::default() })?)
        };
        let color = image("offscreen colour", target.color_format, vk::ImageUsageFlags::COLOR_ATTACHMENT)?;
        let depth = if with_depth {
            let usage = vk::ImageUsageFlags::DEPTH_STENCIL_ATTACHMENT;
            Some(image("offscreen depth", target.depth_format, usage)?)
        } else {
            None
        };
        let bytes = 4 * u64::from(target.size.0) * u64::from(target.size.1) * u64::from(target.views);
        Ok(Self {
            device: Arc::clone(device),
            target: *target,
            color,
            depth,
            commands: CommandBuffer::new(device, "offscreen", 0)?,
            buffer: Buffer::new(device, "offscreen", bytes, vk::BufferUsageFlags::empty(), Memory::ReadBack)?,
        })
    }

    /// What the renderer draws to.
    pub fn attachments(&self) -> Attachments<'_> {
        Attachments {
            color: &self.color,
            // The content is given up, but a copy of the frame before may still be reading it.
            color_before: Use::TransferSource,
            color_after: Use::TransferSource,
            depth: self.depth.as_ref(),
            depth_before: Use::TransferSource,
            depth_after: Use::TransferSource,
        }
    }

    /// Waits for everything submitted before and gives the views' colours (four bytes per pixel, rows from the
    /// top, view after view) to `look`.
    ///
    /// # Errors
    /// A lost device, or a colour format of another size.
    pub fn read<R>(&mut self, look: impl FnOnce(&[u8]) -> R) -> Result<R, Error> {
        let color = Arc::clone(self.color.image());
        self.copy(&color)?;
        Ok(self.buffer.with_bytes(0, self.buffer.size(), |bytes| look(bytes))?)
    }

    /// As [`Offscreen::read`], one picture per view.
    ///
    /// # Errors
    /// As there.
    pub fn pictures(&mut self) -> Result<Vec<Vec<u8>>, Error> {
        let bytes = 4 * self.target.size.0 as usize * self.target.size.1 as usize;
        self.read(|all| all.chunks_exact(bytes).map(<[u8]>::to_vec).collect())
    }

    /// The depth of all views (1 at the near plane, 0 at infinity); only for a 32-bit float format.
    ///
    /// # Errors
    /// Where it was made without depth or with another format, or the device is lost.
    pub fn depths(&mut self) -> Result<Vec<Vec<f32>>, Error> {
        let Some(depth) = self.depth.as_ref().filter(|d| d.format() == vk::Format::D32_SFLOAT) else {
            return Err(Error::range("depth to read", "an offscreen target with 32-bit float depth", "none"));
        };
        let depth = Arc::clone(depth.image());
        self.copy(&depth)?;
        let pixels = self.target.size.0 as usize * self.target.size.1 as usize;
        let all = self.buffer.with_bytes(0, self.buffer.size(), |bytes| {
            let values = bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
            values.collect::<Vec<f32>>()
        })?;
        Ok(all.chunks_exact(pixels).map(<[f32]>::to_vec).collect())
    }

    fn copy(&mut self, image: &Arc<Image>) -> Result<(), Error> {
        let layer_bytes = 4 * u64::from(self.target.size.0) * u64::from(self.target.size.1);
        let mut encoder = self.commands.record()?;
        for layer in 0..self.target.views {
            let offset = u64::from(layer) * layer_bytes;
            encoder.copy_image_to_buffer(image, Area::whole(image, layer, 0), &self.buffer, offset);
        }
        let host = BufferBarrier { buffer: &self.buffer, from: Use::TransferDestination, to: Use::HostRead };
        encoder.barrier(&[], &[host]);
        encoder.finish()?;
        let submission = self.device.submit(&mut self.commands, &[], &[])?;
        Ok(self.device.wait(submission)?)
    }
}
