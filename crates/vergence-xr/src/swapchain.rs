//! Images that the runtime owns and the renderer draws into.

use std::sync::Arc;

use openxr::{SwapchainUsageFlags, sys};
use vergence_gpu::{
    Device, Image, ImageDesc, ImageView,
    vk::{self, Handle},
};

use crate::error::{Error, In};
use crate::list::list;
use crate::tap::{Call, Ear};

/// How long to wait for an image that the compositor still reads.
const PATIENCE_NS: i64 = 2_000_000_000;

/// One layer per view.
pub(crate) struct Swapchain {
    // Views and images before the swapchain whose images they borrow: fields are dropped in this order.
    views: Vec<Arc<ImageView>>,
    raw: openxr::Swapchain<openxr::Vulkan>,
    instance: openxr::Instance,
    held: Option<Held>,
}

/// An image that was acquired and not released yet.
#[derive(Clone, Copy)]
struct Held {
    index: u32,
    /// Whether the compositor has let go of it.
    waited: bool,
}

/// What to make.
pub(crate) struct SwapchainDesc<'a> {
    pub(crate) name: &'a str,
    pub(crate) format: vk::Format,
    pub(crate) size: (u32, u32),
    pub(crate) layers: u32,
    pub(crate) is_depth: bool,
}

impl Swapchain {
    pub(crate) fn new(
        session: &openxr::Session<openxr::Vulkan>,
        device: &Arc<Device>,
        desc: &SwapchainDesc<'_>,
    ) -> Result<Self, Error> {
        let (usage_flags, usage) = if desc.is_depth {
            (
                SwapchainUsageFlags::DEPTH_STENCIL_ATTACHMENT | SwapchainUsageFlags::SAMPLED,
                vk::ImageUsageFlags::DEPTH_STENCIL_ATTACHMENT | vk::ImageUsageFlags::SAMPLED,
            )
        } else {
            // Transfer: the picture can be captured and mirrored.
            (
                SwapchainUsageFlags::COLOR_ATTACHMENT
                    | SwapchainUsageFlags::SAMPLED
                    | SwapchainUsageFlags::TRANSFER_SRC,
                vk::ImageUsageFlags::COLOR_ATTACHMENT
                    | vk::ImageUsageFlags::SAMPLED
                    | vk::ImageUsageFlags::TRANSFER_SRC,
            )
        };
        let raw = session
            .create_swapchain(&openxr::SwapchainCreateInfo {
                create_flags: openxr::SwapchainCreateFlags::EMPTY,
                usage_flags,
                format: desc.format.as_raw() as u32,
                sample_count: 1,
                width: desc.size.0,
                height: desc.size.1,
                face_count: 1,
                array_size: desc.layers,
                mip_count: 1,
            })
            .during("xrCreateSwapchain")?;
        let enumerate = session.instance().fp().enumerate_swapchain_images;
        let empty = sys::SwapchainImageVulkanKHR {
            ty: sys::SwapchainImageVulkanKHR::TYPE,
            next: std::ptr::null_mut(),
            image: 0,
        };
        let images = list("xrEnumerateSwapchainImages", empty, |capacity, count, items| {
            // SAFETY: the swapchain lives; `items` is null or has `capacity` initialised elements, of the type for Vulkan.
            unsafe { enumerate(raw.as_raw(), capacity, count, items.cast()) }
        })?;
        let mut views = Vec::with_capacity(images.len());
        for image in images.into_iter().map(|image| image.image) {
            let image_desc = ImageDesc {
                name: desc.name,
                format: desc.format,
                width: desc.size.0,
                height: desc.size.1,
                layers: desc.layers,
                usage,
                ..ImageDesc::default()
            };
            // SAFETY: the runtime made the image on this device as described; it lives as long as the swapchain, which
            // is dropped after the views (here), and whoever else uses a view is waited for before (the client's rule).
            let image = unsafe { Image::borrowed(device, vk::Image::from_raw(image), &image_desc) };
            views.push(image.view()?);
        }
        if views.is_empty() {
            return Err(Error::Unsupported {
                what: "images of a swapchain",
                expected: "at least one".into(),
                found: "none".into(),
            });
        }
        Ok(Self { views, raw, instance: session.instance().clone(), held: None })
    }

    /// An image to draw into, once the compositor has let go of it; `None` where it does not in time. Until its release it
    /// is always the same image, however often it is asked for: a compositor has few.
    pub(crate) fn acquire(&mut self, ear: &mut Ear) -> Result<Option<&Arc<ImageView>>, Error> {
        let held = match self.held {
            // The frame before ended between acquire and release: the image is still ours.
            Some(held) => held,
            None => {
                let mut index = 0;
                // SAFETY: the swapchain lives; a null acquire info is allowed.
                let result = unsafe {
                    (self.instance.fp().acquire_swapchain_image)(
                        self.raw.as_raw(),
                        std::ptr::null(),
                        &mut index,
                    )
                };
                ear.check(Call::AcquireSwapchainImage, result)?;
                *self.held.insert(Held { index, waited: false })
            }
        };
        if !held.waited {
            let info = sys::SwapchainImageWaitInfo {
                ty: sys::SwapchainImageWaitInfo::TYPE,
                next: std::ptr::null(),
                timeout: openxr::Duration::from_nanos(PATIENCE_NS),
            };
            // SAFETY: the swapchain lives and has an image that is acquired and not waited for.
            let result = unsafe { (self.instance.fp().wait_swapchain_image)(self.raw.as_raw(), &info) };
            if ear.check(Call::WaitSwapchainImage, result)? == sys::Result::TIMEOUT_EXPIRED {
                log::warn!("the compositor keeps image {} for longer than 2 s", held.index);
                return Ok(None);
            }
            self.held = Some(Held { waited: true, ..held });
        }
        let view = self.views.get(held.index as usize).ok_or_else(|| Error::Contradiction {
            call: "xrAcquireSwapchainImage",
            expected: format!("an index below {}, as many images as there are", self.views.len()),
            found: held.index.to_string(),
        })?;
        Ok(Some(view))
    }

    /// Gives the image to the compositor; one that it has not let go of stays held.
    pub(crate) fn release(&mut self, ear: &mut Ear) -> Result<(), Error> {
        if !self.held.is_some_and(|held| held.waited) {
            return Ok(());
        }
        // SAFETY: the swapchain lives and has an image that is acquired and waited for; null info is allowed.
        let result =
            unsafe { (self.instance.fp().release_swapchain_image)(self.raw.as_raw(), std::ptr::null()) };
        ear.check(Call::ReleaseSwapchainImage, result)?;
        // One that the runtime did not take back is still ours.
        self.held = None;
        Ok(())
    }

    /// One layer of the image that was released last, for a composition layer.
    pub(crate) fn sub_image(&self, layer: u32, (width, height): (u32, u32)) -> sys::SwapchainSubImage {
        sys::SwapchainSubImage {
            swapchain: self.raw.as_raw(),
            image_rect: openxr::Rect2Di {
                offset: openxr::Offset2Di { x: 0, y: 0 },
                extent: openxr::Extent2Di {
                    width: i32::try_from(width).unwrap_or(i32::MAX),
                    height: i32::try_from(height).unwrap_or(i32::MAX),
                },
            },
            image_array_index: layer,
        }
    }
}
