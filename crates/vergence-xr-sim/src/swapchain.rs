//! Swapchains: images on the application's device, handed out in turn.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use openxr_sys as sys;
use vergence_gpu::vk::{self, Handle as _};
use vergence_gpu::{Image, ImageDesc};

use crate::ffi::{Buffer, In, Out, XrResult};
use crate::graphics::{Graphics, failed};
use crate::handle::{self, Object};
use crate::headset::MAX_IMAGE_SIDE;
use crate::session::Session;

/// The formats that applications may use, the best first.
const FORMATS: [vk::Format; 6] = [
    vk::Format::R8G8B8A8_SRGB,
    vk::Format::B8G8R8A8_SRGB,
    vk::Format::R16G16B16A16_SFLOAT,
    vk::Format::R8G8B8A8_UNORM,
    vk::Format::B8G8R8A8_UNORM,
    vk::Format::D32_SFLOAT,
];

/// One is shown, one is ready, one is drawn to.
const IMAGES: usize = 3;

pub(crate) struct Swapchain {
    pub session: Arc<Session>,
    pub images: Vec<Arc<Image>>,
    pub size: (u32, u32),
    pub array_size: u32,
    is_static: bool,
    turns: Mutex<Turns>,
}

/// Whose turn each image is.
#[derive(Default)]
struct Turns {
    /// Acquired, the oldest first.
    acquired: VecDeque<usize>,
    /// The oldest of them was waited for.
    waited: bool,
    next: usize,
    /// Images that were acquired once: they are in their layout.
    ready: usize,
    /// The last that was released: what a layer shows.
    released: Option<usize>,
}

impl Object for Swapchain {
    type Handle = sys::Swapchain;
}

/// The swapchain behind a handle, if its session is not lost.
pub(crate) fn get(handle: sys::Swapchain) -> XrResult<Arc<Swapchain>> {
    let swapchain = handle::get::<Swapchain>(handle)?;
    swapchain.session.check_lost()?;
    Ok(swapchain)
}

impl Swapchain {
    fn turns(&self) -> std::sync::MutexGuard<'_, Turns> {
        self.turns.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The image that a layer which names this swapchain shows; `None` before the first release.
    pub(crate) fn shown(&self) -> Option<Arc<Image>> {
        self.turns().released.map(|index| self.images[index].clone())
    }

    fn graphics(&self) -> XrResult<&Graphics> {
        self.session.graphics.as_ref().ok_or(sys::Result::ERROR_RUNTIME_FAILURE)
    }
}

pub(crate) fn enumerate_swapchain_formats(session: &Session, mut buffer: Buffer<i64>) -> XrResult {
    let formats = FORMATS.map(|format| i64::from(format.as_raw()));
    buffer.give(if session.graphics.is_some() { &formats } else { &[] })
}

fn usage_of(flags: sys::SwapchainUsageFlags) -> XrResult<vk::ImageUsageFlags> {
    use sys::SwapchainUsageFlags as F;
    use vk::ImageUsageFlags as U;
    let table = [
        (F::COLOR_ATTACHMENT, U::COLOR_ATTACHMENT),
        (F::DEPTH_STENCIL_ATTACHMENT, U::DEPTH_STENCIL_ATTACHMENT),
        (F::UNORDERED_ACCESS, U::STORAGE),
        (F::TRANSFER_SRC, U::TRANSFER_SRC),
        (F::TRANSFER_DST, U::TRANSFER_DST),
        (F::SAMPLED, U::SAMPLED),
        (F::MUTABLE_FORMAT, U::empty()),
    ];
    let known = table.iter().fold(F::EMPTY, |known, (flag, _)| known | *flag);
    if !known.contains(flags) {
        return Err(sys::Result::ERROR_FEATURE_UNSUPPORTED);
    }
    Ok(table
        .iter()
        .filter(|(flag, _)| flags.contains(*flag))
        .fold(U::empty(), |usage, (_, bit)| usage | *bit))
}

pub(crate) fn create_swapchain(
    session: Arc<Session>,
    info: In<sys::SwapchainCreateInfo>,
    mut out: Out<sys::Swapchain>,
) -> XrResult {
    let info = info.get()?;
    out.check()?;
    let unsupported = Err(sys::Result::ERROR_FEATURE_UNSUPPORTED);
    let format = FORMATS
        .into_iter()
        .find(|format| i64::from(format.as_raw()) == info.format)
        .ok_or(sys::Result::ERROR_SWAPCHAIN_FORMAT_UNSUPPORTED)?;
    let graphics = session.graphics.as_ref().ok_or(sys::Result::ERROR_SWAPCHAIN_FORMAT_UNSUPPORTED)?;
    let sides = [info.width, info.height];
    let counts = [info.sample_count, info.face_count, info.array_size, info.mip_count];
    if sides.iter().any(|side| !(1..=MAX_IMAGE_SIDE).contains(side)) || counts.contains(&0) {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    if !sys::SwapchainCreateFlags::STATIC_IMAGE.contains(info.create_flags)
        || info.face_count != 1
        || info.sample_count != 1
    {
        return unsupported;
    }
    let depth = format == vk::Format::D32_SFLOAT;
    let mut usage = usage_of(info.usage_flags)? | vk::ImageUsageFlags::SAMPLED;
    let (fits, not) = (vk::ImageUsageFlags::DEPTH_STENCIL_ATTACHMENT, vk::ImageUsageFlags::COLOR_ATTACHMENT);
    let (fits, not) = if depth { (fits, not) } else { (not, fits) };
    if usage.contains(not) {
        return unsupported;
    }
    // The layouts that applications get images in are those of attachments; composition reads what is released.
    usage |= fits | vk::ImageUsageFlags::TRANSFER_SRC;
    let mutable = info.usage_flags.contains(sys::SwapchainUsageFlags::MUTABLE_FORMAT);
    let is_static = info.create_flags.contains(sys::SwapchainCreateFlags::STATIC_IMAGE);
    let desc = ImageDesc {
        name: if depth { "xr-sim depth swapchain" } else { "xr-sim colour swapchain" },
        format,
        width: info.width,
        height: info.height,
        layers: info.array_size,
        mips: info.mip_count,
        samples: 1,
        usage,
        flags: if mutable { vk::ImageCreateFlags::MUTABLE_FORMAT } else { vk::ImageCreateFlags::empty() },
    };
    let count = if is_static { 1 } else { IMAGES };
    let images = (0..count)
        .map(|_| Image::new(&graphics.device, &desc))
        .collect::<Result<Vec<_>, _>>()
        .map_err(failed)?;
    let parent = sys::Handle::into_raw(session.handle);
    let (size, array_size) = ((info.width, info.height), info.array_size);
    let (handle, _) = handle::insert(parent, |_| Swapchain {
        session,
        images,
        size,
        array_size,
        is_static,
        turns: Mutex::default(),
    });
    out.set(handle)?;
    Ok(sys::Result::SUCCESS)
}

/// The application has finished with the images; the runtime finishes here.
pub(crate) fn destroy_swapchain(handle: sys::Swapchain) -> XrResult {
    let swapchain = handle::remove::<Swapchain>(handle)?;
    swapchain.graphics()?.finish();
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn enumerate_swapchain_images(
    swapchain: &Swapchain,
    mut buffer: Buffer<sys::SwapchainImageVulkanKHR>,
) -> XrResult {
    buffer.give_typed(swapchain.images.len(), |index, place| {
        place.image = swapchain.images[index].handle().as_raw()
    })
}

pub(crate) fn acquire_swapchain_image(
    swapchain: &Swapchain,
    info: In<sys::SwapchainImageAcquireInfo>,
    mut out: Out<u32>,
) -> XrResult {
    info.optional()?;
    out.check()?;
    let turns = &mut *swapchain.turns();
    let used_up = swapchain.is_static && turns.ready > 0;
    if turns.acquired.len() >= swapchain.images.len() || used_up {
        return Err(sys::Result::ERROR_CALL_ORDER_INVALID);
    }
    let index = turns.next;
    if index >= turns.ready {
        swapchain.graphics()?.make_ready(&swapchain.images[index])?;
        turns.ready = index + 1;
    }
    turns.next = (index + 1) % swapchain.images.len();
    turns.acquired.push_back(index);
    out.set(index as u32)?;
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn wait_swapchain_image(swapchain: &Swapchain, info: In<sys::SwapchainImageWaitInfo>) -> XrResult {
    let info = info.get()?;
    if info.timeout.as_nanos() < 0 {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    let turns = &mut *swapchain.turns();
    if turns.acquired.is_empty() || turns.waited {
        return Err(sys::Result::ERROR_CALL_ORDER_INVALID);
    }
    // Composition has read an image before xrEndFrame returns: there is nothing left to wait for.
    turns.waited = true;
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn release_swapchain_image(
    swapchain: &Swapchain,
    info: In<sys::SwapchainImageReleaseInfo>,
) -> XrResult {
    info.optional()?;
    let turns = &mut *swapchain.turns();
    if !turns.waited {
        return Err(sys::Result::ERROR_CALL_ORDER_INVALID);
    }
    turns.waited = false;
    turns.released = turns.acquired.pop_front();
    Ok(sys::Result::SUCCESS)
}
