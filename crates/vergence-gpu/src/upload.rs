//! Bringing data to the device when a scene is built, and back when a picture is wanted.

use std::sync::Arc;

use ash::vk;
use bytemuck::Pod;

use crate::buffer::{Buffer, Memory};
use crate::command::CommandBuffer;
use crate::device::Device;
use crate::encoder::{Area, BufferBarrier, ImageBarrier};
use crate::error::Error;
use crate::format::texel_bytes;
use crate::image::{Image, ImageDesc};
use crate::sync::Use;

/// Makes device-local buffers and sampled images with content; each call waits until the copy is complete.
///
/// For building a scene, not for frames.
pub struct Upload {
    device: Arc<Device>,
    commands: CommandBuffer,
    staging: Option<Arc<Buffer>>,
}

impl Upload {
    /// Makes an uploader.
    ///
    /// # Errors
    ///
    /// No memory.
    pub fn new(device: &Arc<Device>) -> Result<Self, Error> {
        let commands = CommandBuffer::new(device, "upload", 0)?;
        Ok(Self { device: Arc::clone(device), commands, staging: None })
    }

    /// A staging buffer of at least `bytes`, not in use.
    fn staging(&mut self, bytes: u64) -> Result<Arc<Buffer>, Error> {
        if let Some(staging) = self.staging.as_ref().filter(|s| s.size() >= bytes) {
            return Ok(Arc::clone(staging));
        }
        self.staging = None;
        let size = bytes.next_power_of_two().max(1 << 16);
        let staging =
            Buffer::new(&self.device, "staging", size, vk::BufferUsageFlags::TRANSFER_SRC, Memory::Upload)?;
        self.staging = Some(Arc::clone(&staging));
        Ok(staging)
    }

    /// A device-local buffer with this content, ready for `usage`.
    ///
    /// # Errors
    ///
    /// No memory, no content, or a lost device.
    pub fn buffer<T: Pod>(
        &mut self,
        name: &str,
        data: &[T],
        usage: vk::BufferUsageFlags,
    ) -> Result<Arc<Buffer>, Error> {
        let bytes: &[u8] = bytemuck::cast_slice(data);
        let buffer = Buffer::new(&self.device, name, bytes.len() as u64, usage, Memory::Device)?;
        let staging = self.staging(bytes.len() as u64)?;
        staging.write(0, bytes)?;
        let mut encoder = self.commands.record()?;
        encoder.copy_buffer(&staging, 0, &buffer, 0, bytes.len() as u64);
        let barrier = BufferBarrier { buffer: &buffer, from: Use::TransferDestination, to: Use::General };
        encoder.barrier(&[], &[barrier]);
        encoder.finish()?;
        let submission = self.device.submit(&mut self.commands, &[], &[])?;
        self.device.wait(submission)?;
        Ok(buffer)
    }

    /// An image with this content, ready for `then` (usually [`Use::SampledAny`]).
    ///
    /// `levels[layer * mips + mip]` are tightly packed texels; `TRANSFER_DST` is added to the usage. With `fill_mips`, only mip 0 of
    /// each layer is given (`levels[layer]`), and the others are made by halving.
    ///
    /// # Errors
    ///
    /// Levels of another number or size than the image has, no memory, or a lost device.
    pub fn image(
        &mut self,
        desc: &ImageDesc<'_>,
        levels: &[&[u8]],
        fill_mips: bool,
        then: Use,
    ) -> Result<Arc<Image>, Error> {
        let mut desc = *desc;
        desc.usage |= vk::ImageUsageFlags::TRANSFER_DST;
        if fill_mips {
            desc.usage |= vk::ImageUsageFlags::TRANSFER_SRC;
        }
        let given_mips = if fill_mips { 1 } else { desc.mips };
        let expected = desc.layers as usize * given_mips as usize;
        if levels.len() != expected {
            return Err(Error::range("levels of an image", expected, levels.len()));
        }
        let image = Image::new(&self.device, &desc)?;
        // Offsets of copies are multiples of 16, the largest texel.
        let mut offsets = Vec::with_capacity(levels.len());
        let mut total = 0u64;
        for (i, level) in levels.iter().enumerate() {
            let (width, height) = image.size(i as u32 % given_mips);
            if let Some(texel) = texel_bytes(desc.format) {
                let bytes = u64::from(width) * u64::from(height) * texel;
                if level.len() as u64 != bytes {
                    return Err(Error::range("bytes of an image level", bytes, level.len()));
                }
            }
            offsets.push(total);
            total += (level.len() as u64).next_multiple_of(16);
        }
        let staging = self.staging(total.max(1))?;
        for (level, offset) in levels.iter().zip(&offsets) {
            staging.write(*offset, level)?;
        }
        let mut encoder = self.commands.record()?;
        encoder.transition(&image, Use::Undefined, Use::TransferDestination);
        for (i, offset) in offsets.iter().enumerate() {
            let (layer, mip) = (i as u32 / given_mips, i as u32 % given_mips);
            encoder.copy_buffer_to_image(&staging, *offset, &image, Area::whole(&image, layer, mip));
        }
        if fill_mips {
            encoder.fill_mips(&image, then);
        } else {
            encoder.transition(&image, Use::TransferDestination, then);
        }
        encoder.finish()?;
        let submission = self.device.submit(&mut self.commands, &[], &[])?;
        self.device.wait(submission)?;
        Ok(image)
    }
}

/// Brings images back to the host. Keeps its buffer, so that repeated read-backs of one size allocate nothing on the device.
pub struct ReadBack {
    device: Arc<Device>,
    commands: CommandBuffer,
    buffer: Option<Arc<Buffer>>,
}

impl ReadBack {
    /// Makes a reader.
    ///
    /// # Errors
    ///
    /// No memory.
    pub fn new(device: &Arc<Device>) -> Result<Self, Error> {
        let commands = CommandBuffer::new(device, "read back", 0)?;
        Ok(Self { device: Arc::clone(device), commands, buffer: None })
    }

    /// Reads all texels of mip 0 of one layer into `texels` (cleared first), row by row from the top, tightly packed. The image was in
    /// the use `used` and is so again afterwards; everything submitted before is waited for.
    ///
    /// # Errors
    ///
    /// A layer outside of the image, a block-compressed format, no memory, or a lost device.
    pub fn layer(
        &mut self,
        image: &Arc<Image>,
        layer: u32,
        used: Use,
        texels: &mut Vec<u8>,
    ) -> Result<(), Error> {
        texels.clear();
        self.look(image, layer, used, |mapped| texels.extend_from_slice(mapped))
    }

    /// As [`ReadBack::layer`], but shows the texels where they were read to: nothing is copied.
    ///
    /// # Errors
    ///
    /// As [`ReadBack::layer`].
    pub fn look(
        &mut self,
        image: &Arc<Image>,
        layer: u32,
        used: Use,
        see: impl FnOnce(&[u8]),
    ) -> Result<(), Error> {
        let Some(texel) = texel_bytes(image.format()) else {
            return Err(Error::range(
                "format to read back",
                "not compressed",
                format_args!("{:?}", image.format()),
            ));
        };
        let (width, height) = image.size(0);
        let bytes = u64::from(width) * u64::from(height) * texel;
        if self.buffer.as_ref().is_none_or(|b| b.size() < bytes) {
            self.buffer = None;
            let usage = vk::BufferUsageFlags::TRANSFER_DST;
            self.buffer = Some(Buffer::new(&self.device, "read back", bytes, usage, Memory::ReadBack)?);
        }
        let Some(buffer) = self.buffer.as_ref().map(Arc::clone) else { return Ok(()) };
        let mut encoder = self.commands.record()?;
        let to = ImageBarrier::new(image, used, Use::TransferSource).layers(layer, 1);
        encoder.barrier(&[to], &[]);
        encoder.copy_image_to_buffer(image, Area::whole(image, layer, 0), &buffer, 0);
        let back = ImageBarrier::new(image, Use::TransferSource, used).layers(layer, 1);
        let host = BufferBarrier { buffer: &buffer, from: Use::TransferDestination, to: Use::HostRead };
        encoder.barrier(&[back], &[host]);
        encoder.finish()?;
        let submission = self.device.submit(&mut self.commands, &[], &[])?;
        self.device.wait(submission)?;
        buffer.with_bytes(0, bytes, |mapped| see(mapped))
    }
}
