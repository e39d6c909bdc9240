//! A window that mirrors pictures: swapchain, letterboxed blits, presentation that never makes the headset wait.

use std::sync::Arc;

use ash::vk;
use raw_window_handle::{HasDisplayHandle, HasWindowHandle};

use crate::buffer::{Buffer, Memory};
use crate::census::Counters;
use crate::command::CommandBuffer;
use crate::device::Device;
use crate::driver_clock::blocking;
use crate::encoder::{Area, Encoder, ImageBarrier};
use crate::error::{At, Error};
use crate::image::{Image, ImageDesc};
use crate::sync::Use;

/// Frames that may be on their way to the window at once.
const FRAMES: usize = 2;
/// Around the pictures: black.
const BARS: [f32; 4] = [0.0, 0.0, 0.0, 1.0];

/// Something that can be presented to; kept alive as long as the mirror. A shared window of any toolkit is one.
pub trait Presentable: HasWindowHandle + HasDisplayHandle + Send + Sync {}
impl<T: HasWindowHandle + HasDisplayHandle + Send + Sync> Presentable for T {}

/// What became of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shown {
    /// It is on its way to the screen.
    Yes,
    /// The window was not ready for another one (or has no area); nothing was waited for.
    NotReady,
}

struct Frame {
    commands: CommandBuffer,
    acquired: vk::Semaphore,
    staging: Option<Arc<Buffer>>,
}

struct Target {
    image: Arc<Image>,
    /// Waited for by the presentation, and free again when the image is acquired again.
    drawn: vk::Semaphore,
}

/// Presents pictures to a window, side by side and letterboxed.
pub struct Mirror {
    frames: Vec<Frame>,
    next: usize,
    targets: Vec<Target>,
    swapchain: vk::SwapchainKHR,
    extent: (u32, u32),
    wanted: (u32, u32),
    srgb: bool,
    stale: bool,
    pixels: Option<Arc<Image>>,
    surface: vk::SurfaceKHR,
    device: Arc<Device>,
    _window: Arc<dyn Presentable>,
}

impl Mirror {
    /// Makes a mirror on a window of `size` pixels. The instance must have been made with the window's display, the device with
    /// [`DeviceDesc::present`](crate::DeviceDesc::present).
    ///
    /// # Errors
    ///
    /// An instance or device that was not made for windows, or a window that the device cannot present to.
    pub fn new(device: &Arc<Device>, window: Arc<dyn Presentable>, size: (u32, u32)) -> Result<Self, Error> {
        let Some(functions) = device.instance.surface.as_ref().filter(|_| device.swapchain.is_some()) else {
            return Err(Error::Surface { detail: "the device was made without presentation".into() });
        };
        let handle_error = |e: raw_window_handle::HandleError| Error::Surface { detail: e.to_string() };
        let display = window.display_handle().map_err(handle_error)?.as_raw();
        let handle = window.window_handle().map_err(handle_error)?.as_raw();
        // SAFETY: the handles are of a live window, which the mirror keeps alive longer than the surface.
        let surface = unsafe {
            ash_window::create_surface(&device.instance.entry, &device.instance.raw, display, handle, None)
        }
        .at("vkCreateSurfaceKHR")?;
        // From here on the destructor undoes everything.
        let mut this = Self {
            frames: Vec::new(),
            next: 0,
            targets: Vec::new(),
            swapchain: vk::SwapchainKHR::null(),
            extent: (0, 0),
            wanted: size,
            srgb: true,
            stale: true,
            pixels: None,
            surface,
            device: Arc::clone(device),
            _window: window,
        };
        // SAFETY: the surface and the physical device are of one instance.
        let supported = unsafe {
            functions.get_physical_device_surface_support(device.physical, device.queue_family, surface)
        }
        .at("vkGetPhysicalDeviceSurfaceSupportKHR")?;
        if !supported {
            return Err(Error::Surface {
                detail: format!("{} does not present to it", device.limits().name),
            });
        }
        for i in 0..FRAMES {
            let commands = CommandBuffer::new(device, &format!("mirror {i}"), 0)?;
            this.frames.push(Frame { commands, acquired: vk::Semaphore::null(), staging: None });
        }
        Counters::add(&device.counters.swapchains, 1);
        Ok(this)
    }

    /// Says that the window now has `size` pixels.
    pub fn resize(&mut self, size: (u32, u32)) {
        if self.wanted != size {
            self.wanted = size;
            self.stale = true;
        }
    }

    /// Width and height of what is presented, in pixels; (0, 0) before the first picture.
    pub fn size(&self) -> (u32, u32) {
        self.extent
    }

    /// Shows the first `views` layers of an image side by side. The image was in the use `used` and is so again afterwards; it needs
    /// `TRANSFER_SRC`. It is read after everything that was submitted before.
    ///
    /// # Errors
    ///
    /// More views than layers, a lost surface, or a lost device.
    pub fn present(&mut self, image: &Arc<Image>, views: u32, used: Use) -> Result<Shown, Error> {
        if views == 0 || views > image.layers() {
            return Err(Error::range("views to show", format_args!("1 to {}", image.layers()), views));
        }
        let srgb = matches!(image.format(), vk::Format::R8G8B8A8_SRGB | vk::Format::B8G8R8A8_SRGB);
        self.show(srgb, |encoder, _, target| {
            let to_source = ImageBarrier::new(image, used, Use::TransferSource).layers(0, views);
            encoder.barrier(&[to_source], &[]);
            blit_views(encoder, image, views, target);
            let back = ImageBarrier::new(image, Use::TransferSource, used).layers(0, views);
            encoder.barrier(&[back], &[]);
            Ok(())
        })
    }

    /// Shows pictures that the host has: tightly packed sRGB bytes (red, green, blue, alpha), all of `size` pixels.
    ///
    /// # Errors
    ///
    /// No pictures or one of another size, a lost surface, or a lost device.
    pub fn present_pixels(&mut self, views: &[&[u8]], size: (u32, u32)) -> Result<Shown, Error> {
        let bytes = 4 * size.0 as usize * size.1 as usize;
        let count = views.len() as u32;
        if count == 0 || bytes == 0 || views.iter().any(|v| v.len() != bytes) {
            let found = views.iter().map(|v| v.len()).collect::<Vec<_>>();
            return Err(Error::range("bytes of each picture", bytes, format_args!("{found:?}")));
        }
        let image = match &self.pixels {
            Some(image) if image.size(0) == size && image.layers() == count => Arc::clone(image),
            _ => {
                let desc = ImageDesc {
                    name: "mirrored pixels",
                    format: vk::Format::R8G8B8A8_SRGB,
                    width: size.0,
                    height: size.1,
                    layers: count,
                    usage: vk::ImageUsageFlags::TRANSFER_SRC | vk::ImageUsageFlags::TRANSFER_DST,
                    ..Default::default()
                };
                let image = Image::new(&self.device, &desc)?;
                self.pixels = Some(Arc::clone(&image));
                image
            }
        };
        let device = Arc::clone(&self.device);
        self.show(true, |encoder, staging, target| {
            let total = bytes as u64 * u64::from(count);
            let buffer = match staging.take().filter(|b| b.size() == total) {
                Some(buffer) => buffer,
                None => Buffer::new(
                    &device,
                    "mirrored pixels",
                    total,
                    vk::BufferUsageFlags::TRANSFER_SRC,
                    Memory::Upload,
                )?,
            };
            for (i, view) in views.iter().enumerate() {
                buffer.write((i * bytes) as u64, view)?;
            }
            // The other frame may still read the image.
            let fill = ImageBarrier::new(&image, Use::TransferSource, Use::TransferDestination).discard();
            encoder.barrier(&[fill], &[]);
            for layer in 0..count {
                let offset = u64::from(layer) * bytes as u64;
                encoder.copy_buffer_to_image(&buffer, offset, &image, Area::whole(&image, layer, 0));
            }
            encoder.transition(&image, Use::TransferDestination, Use::TransferSource);
            blit_views(encoder, &image, count, target);
            *staging = Some(buffer);
            Ok(())
        })
    }

    fn show(
        &mut self,
        srgb: bool,
        draw: impl FnOnce(&mut Encoder<'_>, &mut Option<Arc<Buffer>>, &Arc<Image>) -> Result<(), Error>,
    ) -> Result<Shown, Error> {
        if (self.stale || self.srgb != srgb) && !self.rebuild(srgb)? {
            return Ok(Shown::NotReady);
        }
        let device = Arc::clone(&self.device);
        let Some(functions) = &device.swapchain else { return Ok(Shown::NotReady) };
        let slot = self.next % FRAMES;
        self.next = self.next.wrapping_add(1);
        let acquired = self.frames[slot].acquired;
        // The semaphore is free when the submission that waited for it is complete.
        self.frames[slot].commands.wait()?;
        // SAFETY: `&mut self` synchronises the swapchain; the semaphore is not in use. Nothing is waited for.
        let result = blocking(|| unsafe {
            functions.acquire_next_image(self.swapchain, 0, acquired, vk::Fence::null())
        });
        let index = match result {
            Ok((index, suboptimal)) => {
                self.stale |= suboptimal;
                index as usize
            }
            Err(vk::Result::NOT_READY | vk::Result::TIMEOUT) => return Ok(Shown::NotReady),
            Err(vk::Result::ERROR_OUT_OF_DATE_KHR) => {
                self.stale = true;
                return Ok(Shown::NotReady);
            }
            Err(result) => return Err(surface_error(result, "vkAcquireNextImageKHR")),
        };
        // An error below leaves the semaphore signalled: everything is then made anew.
        let stale = std::mem::replace(&mut self.stale, true);
        let Some(target) = self.targets.get(index) else { return Ok(Shown::NotReady) };
        let (image, drawn) = (Arc::clone(&target.image), target.drawn);
        let frame = &mut self.frames[slot];
        let mut encoder = frame.commands.record()?;
        // The source scope is the stage that waits for the semaphore.
        let fresh = ImageBarrier::new(&image, Use::TransferDestination, Use::TransferDestination);
        encoder.barrier(&[fresh.discard()], &[]);
        encoder.clear(&image, BARS);
        encoder.barrier(&[fresh], &[]);
        draw(&mut encoder, &mut frame.staging, &image)?;
        encoder.transition(&image, Use::TransferDestination, Use::Present);
        encoder.finish()?;
        let waits = [vk::SemaphoreSubmitInfo::default()
            .semaphore(acquired)
            .stage_mask(vk::PipelineStageFlags2::ALL_TRANSFER)];
        let mut signals = [
            vk::SemaphoreSubmitInfo::default()
                .semaphore(drawn)
                .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS),
            vk::SemaphoreSubmitInfo::default(),
        ];
        device.submit_raw(&mut frame.commands, &waits, &mut signals)?;
        let (semaphores, swapchains, indices) = ([drawn], [self.swapchain], [index as u32]);
        let info = vk::PresentInfoKHR::default()
            .wait_semaphores(&semaphores)
            .swapchains(&swapchains)
            .image_indices(&indices);
        let result = {
            let _queue = device.lock_queue();
            // SAFETY: the queue is locked, the swapchain is synchronised by `&mut self`; the semaphore was submitted above.
            blocking(|| unsafe { functions.queue_present(device.queue, &info) })
        };
        match result {
            Ok(suboptimal) => self.stale = stale || suboptimal,
            Err(vk::Result::ERROR_OUT_OF_DATE_KHR) => {}
            Err(result) => return Err(surface_error(result, "vkQueuePresentKHR")),
        }
        Ok(Shown::Yes)
    }

    /// Makes the swapchain anew; says whether there is one now (a window without area has none).
    fn rebuild(&mut self, srgb: bool) -> Result<bool, Error> {
        let device = Arc::clone(&self.device);
        let (Some(surfaces), Some(functions)) = (&device.instance.surface, &device.swapchain) else {
            return Ok(false);
        };
        // SAFETY: the surface and the physical device are of one instance; so for the following two.
        let can = unsafe { surfaces.get_physical_device_surface_capabilities(device.physical, self.surface) }
            .map_err(|r| surface_error(r, "vkGetPhysicalDeviceSurfaceCapabilitiesKHR"))?;
        let (width, height) = extent(&can, self.wanted);
        // A window without area (one that is put away) is asked again with every picture; nothing is waited for.
        if width == 0 || height == 0 {
            return Ok(false);
        }
        self.clear()?;
        // SAFETY: as above.
        let formats = unsafe { surfaces.get_physical_device_surface_formats(device.physical, self.surface) }
            .map_err(|r| surface_error(r, "vkGetPhysicalDeviceSurfaceFormatsKHR"))?;
        // SAFETY: as above.
        let modes =
            unsafe { surfaces.get_physical_device_surface_present_modes(device.physical, self.surface) }
                .map_err(|r| surface_error(r, "vkGetPhysicalDeviceSurfacePresentModesKHR"))?;
        if !can.supported_usage_flags.contains(vk::ImageUsageFlags::TRANSFER_DST) {
            return Err(Error::Surface { detail: "its images cannot be copied to".into() });
        }
        let format = choose_format(&formats, srgb)?;
        // Without a wait for the screen, where that is offered: the headset sets the pace.
        let mode = [vk::PresentModeKHR::MAILBOX, vk::PresentModeKHR::IMMEDIATE]
            .into_iter()
            .find(|mode| modes.contains(mode))
            .unwrap_or(vk::PresentModeKHR::FIFO);
        let most = if can.max_image_count == 0 { u32::MAX } else { can.max_image_count };
        let alpha = [vk::CompositeAlphaFlagsKHR::OPAQUE, vk::CompositeAlphaFlagsKHR::INHERIT]
            .into_iter()
            .find(|&alpha| can.supported_composite_alpha.contains(alpha))
            .unwrap_or(vk::CompositeAlphaFlagsKHR::PRE_MULTIPLIED);
        let info = vk::SwapchainCreateInfoKHR::default()
            .surface(self.surface)
            .min_image_count((can.min_image_count + 1).min(most))
            .image_format(format.format)
            .image_color_space(format.color_space)
            .image_extent(vk::Extent2D { width, height })
            .image_array_layers(1)
            .image_usage(vk::ImageUsageFlags::TRANSFER_DST)
            .image_sharing_mode(vk::SharingMode::EXCLUSIVE)
            .pre_transform(can.current_transform)
            .composite_alpha(alpha)
            .present_mode(mode)
            .clipped(true);
        // SAFETY: the surface has no other swapchain (it was destroyed above), and offers all of this.
        self.swapchain = unsafe { functions.create_swapchain(&info, None) }
            .map_err(|r| surface_error(r, "vkCreateSwapchainKHR"))?;
        // SAFETY: the swapchain was just made.
        let images =
            unsafe { functions.get_swapchain_images(self.swapchain) }.at("vkGetSwapchainImagesKHR")?;
        for raw in images {
            let desc = ImageDesc {
                name: "window",
                format: format.format,
                width,
                height,
                usage: vk::ImageUsageFlags::TRANSFER_DST,
                ..Default::default()
            };
            // SAFETY: the image is the swapchain's, which is destroyed only after its users (see `clear`).
            let image = unsafe { Image::borrowed(&device, raw, &desc) };
            self.targets.push(Target { image, drawn: vk::Semaphore::null() });
        }
        let info = vk::SemaphoreCreateInfo::default();
        for semaphore in self
            .targets
            .iter_mut()
            .map(|t| &mut t.drawn)
            .chain(self.frames.iter_mut().map(|f| &mut f.acquired))
        {
            // SAFETY: the create info is complete.
            *semaphore = unsafe { device.raw.create_semaphore(&info, None) }.at("vkCreateSemaphore")?;
        }
        self.extent = (width, height);
        self.srgb = srgb;
        self.stale = false;
        Ok(true)
    }

    /// Destroys the swapchain and its semaphores, after everything that uses them; on a lost device too, which allows it.
    fn clear(&mut self) -> Result<(), Error> {
        let device = Arc::clone(&self.device);
        let mut result = device.wait_idle();
        for frame in &mut self.frames {
            // The recording refers to an image of the swapchain.
            result = result.and_then(|()| frame.commands.record()?.finish());
            // SAFETY: the queue is idle or its device lost; a null handle is allowed.
            unsafe { device.raw.destroy_semaphore(std::mem::take(&mut frame.acquired), None) };
        }
        for target in self.targets.drain(..) {
            // SAFETY: as above.
            unsafe { device.raw.destroy_semaphore(target.drawn, None) };
        }
        if let Some(functions) = &device.swapchain {
            // SAFETY: as above; its images are used by nothing any more.
            unsafe { functions.destroy_swapchain(std::mem::take(&mut self.swapchain), None) };
        }
        result
    }
}

impl Drop for Mirror {
    fn drop(&mut self) {
        if let Err(error) = self.clear() {
            log::error!("mirror: {error}");
        }
        if self.frames.len() == FRAMES {
            Counters::sub(&self.device.counters.swapchains, 1);
        }
        if let Some(functions) = &self.device.instance.surface {
            // SAFETY: its swapchain was destroyed above; the window is still alive.
            unsafe { functions.destroy_surface(self.surface, None) };
        }
    }
}

/// The window's size where the surface knows it, else the wanted one within the surface's bounds.
fn extent(can: &vk::SurfaceCapabilitiesKHR, wanted: (u32, u32)) -> (u32, u32) {
    if can.current_extent.width != u32::MAX {
        return (can.current_extent.width, can.current_extent.height);
    }
    (
        wanted.0.min(can.max_image_extent.width).max(can.min_image_extent.width),
        wanted.1.min(can.max_image_extent.height).max(can.min_image_extent.height),
    )
}

fn choose_format(formats: &[vk::SurfaceFormatKHR], srgb: bool) -> Result<vk::SurfaceFormatKHR, Error> {
    let wanted = if srgb {
        [vk::Format::B8G8R8A8_SRGB, vk::Format::R8G8B8A8_SRGB]
    } else {
        [vk::Format::B8G8R8A8_UNORM, vk::Format::R8G8B8A8_UNORM]
    };
    let space = vk::ColorSpaceKHR::SRGB_NONLINEAR;
    formats
        .iter()
        .find(|f| wanted.contains(&f.format) && f.color_space == space)
        .copied()
        .ok_or_else(|| Error::Surface { detail: format!("it offers none of {wanted:?}") })
}

fn surface_error(result: vk::Result, call: &'static str) -> Error {
    match result {
        vk::Result::ERROR_SURFACE_LOST_KHR => Error::Surface { detail: "it was closed".into() },
        vk::Result::ERROR_DEVICE_LOST => Error::DeviceLost { call },
        result => Error::Vulkan { call, result },
    }
}

/// Blits layers side by side, as large as fits, in the middle.
fn blit_views(encoder: &mut Encoder<'_>, image: &Arc<Image>, views: u32, target: &Arc<Image>) {
    for view in 0..views {
        if let Some((min, max)) = place(image.size(0), views, view, target.size(0)) {
            let to = Area { layer: 0, mip: 0, min, max };
            encoder.blit(image, Area::whole(image, view, 0), target, to, vk::Filter::LINEAR);
        }
    }
}

/// Where view `view` of `views` pictures of `size` goes in a window: corner and opposite corner; `None` if nothing of it would be seen.
fn place(size: (u32, u32), views: u32, view: u32, window: (u32, u32)) -> Option<((u32, u32), (u32, u32))> {
    let (width, height) = (f64::from(size.0) * f64::from(views), f64::from(size.1));
    let scale = (f64::from(window.0) / width).min(f64::from(window.1) / height);
    let left = 0.5 * (f64::from(window.0) - width * scale);
    let top = 0.5 * (f64::from(window.1) - height * scale);
    let column = |i: u32| ((left + f64::from(size.0) * scale * f64::from(i)).round() as u32).min(window.0);
    let min = (column(view), (top.round() as u32).min(window.1));
    let max = (column(view + 1), ((top + height * scale).round() as u32).min(window.1));
    (min.0 < max.0 && min.1 < max.1).then_some((min, max))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_letterboxed_side_by_side() {
        // Two squares in a wide window: bars left and right.
        assert_eq!(place((100, 100), 2, 0, (400, 100)), Some(((100, 0), (200, 100))));
        assert_eq!(place((100, 100), 2, 1, (400, 100)), Some(((200, 0), (300, 100))));
        // In a high one: bars above and below.
        assert_eq!(place((100, 100), 2, 0, (100, 200)), Some(((0, 75), (50, 125))));
        // One that fits exactly fills the window.
        assert_eq!(place((64, 32), 1, 0, (128, 64)), Some(((0, 0), (128, 64))));
        // So thin that nothing is left.
        assert_eq!(place((1, 100_000), 1, 0, (10, 10)), None);
    }
}
