//! What a frame is drawn to.

use std::sync::Arc;

use vergence_gpu::vk;
use vergence_gpu::{Device, ImageView, Use};

/// What is drawn to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Target {
    /// Of the single-sampled colour image; an sRGB format, since shaders write linear light.
    pub color_format: vk::Format,
    /// A float format: reversed depth needs one to be exact far away.
    pub depth_format: vk::Format,
    /// Width and height of each view, pixels.
    pub size: (u32, u32),
    /// Number of views, 1…[`MAX_VIEWS`](crate::MAX_VIEWS): layers of the images.
    pub views: u32,
}

impl Target {
    /// 8-bit sRGB and 32-bit depth for `views` views of `size` pixels.
    pub fn new(size: (u32, u32), views: u32) -> Self {
        Self { color_format: vk::Format::R8G8B8A8_SRGB, depth_format: vk::Format::D32_SFLOAT, size, views }
    }

    /// The views of one pass, one bit each; 0 where each view has its own pass.
    pub(crate) fn view_mask(&self, device: &Device) -> u32 {
        if self.views == 1 || has_sound_multiview(device) { (1 << self.views) - 1 } else { 0 }
    }

    pub(crate) fn views_per_pass(&self, device: &Device) -> u32 {
        self.view_mask(device).count_ones().max(1)
    }
}

/// Whether one pass may draw all views. Mesa's software device draws the views of a multiview pass one after the
/// other in any case, and puts triangles that it clips into the wrong view (seen in 22.3.6: the vertices that
/// clipping makes are flushed after the view has changed), so it gets one pass per view.
fn has_sound_multiview(device: &Device) -> bool {
    !device.limits().software
}

/// The images of one frame: an array layer per view.
#[derive(Clone, Copy)]
pub struct Attachments<'a> {
    /// Colour, one sample; what the picture is resolved to where there are more.
    pub color: &'a Arc<ImageView>,
    /// Its use before (its content is given up) and after.
    pub color_before: Use,
    /// See [`Attachments::color_before`].
    pub color_after: Use,
    /// Depth, one sample, where it is wanted: sample zero where there are more.
    pub depth: Option<&'a Arc<ImageView>>,
    /// Its use before (its content is given up) and after.
    pub depth_before: Use,
    /// See [`Attachments::depth_before`].
    pub depth_after: Use,
}

impl<'a> Attachments<'a> {
    /// Images that are, and stay, in the layouts of attachments: those of an OpenXR swapchain.
    pub fn swapchain(color: &'a Arc<ImageView>, depth: Option<&'a Arc<ImageView>>) -> Self {
        Self {
            color,
            color_before: Use::ColorAttachment,
            color_after: Use::ColorAttachment,
            depth,
            depth_before: Use::DepthAttachment,
            depth_after: Use::DepthAttachment,
        }
    }
}
