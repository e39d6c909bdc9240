//! Passes that draw: attachments, what they hold before and after, resolves.

use std::sync::Arc;

use ash::vk;

use super::Encoder;
use crate::driver_clock::quick;
use crate::image::ImageView;
use crate::pipeline::MAX_COLORS;
use crate::sync::Use;

/// What an attachment holds when rendering begins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Load<T> {
    /// This value.
    Clear(T),
    /// What it held before.
    Keep,
    /// Anything.
    Discard,
}

impl<T> Load<T> {
    fn op(&self) -> vk::AttachmentLoadOp {
        match self {
            Self::Clear(_) => vk::AttachmentLoadOp::CLEAR,
            Self::Keep => vk::AttachmentLoadOp::LOAD,
            Self::Discard => vk::AttachmentLoadOp::DONT_CARE,
        }
    }
}

/// A colour attachment, in the layout of [`Use::ColorAttachment`].
#[derive(Clone, Copy)]
pub struct ColorAttachment<'a> {
    /// What is drawn to.
    pub view: &'a Arc<ImageView>,
    /// Where the average of the samples goes, if `view` has several.
    pub resolve: Option<&'a Arc<ImageView>>,
    /// Content at the beginning; linear red, green, blue, alpha.
    pub load: Load<[f32; 4]>,
    /// Whether the content of `view` is wanted afterwards (of the resolved image it always is).
    pub store: bool,
}

/// A depth attachment, in the layout of [`Use::DepthAttachment`] (or [`Use::DepthReadOnly`] where it is not written).
#[derive(Clone, Copy)]
pub struct DepthAttachment<'a> {
    /// What is tested against.
    pub view: &'a Arc<ImageView>,
    /// Where sample zero goes, if `view` has several.
    pub resolve: Option<&'a Arc<ImageView>>,
    /// Depth at the beginning.
    pub load: Load<f32>,
    /// Whether the content of `view` is wanted afterwards.
    pub store: bool,
    /// Only tested: the layout is the one of [`Use::DepthReadOnly`].
    pub read_only: bool,
}

/// Attachments and area of one pass.
#[derive(Clone, Copy)]
pub struct Rendering<'a> {
    /// Width and height in pixels, from the corner (0, 0).
    pub size: (u32, u32),
    /// Bit per view; 0 without multiview.
    pub view_mask: u32,
    /// Layers without multiview (1 is usual).
    pub layers: u32,
    /// Colour attachments, at most [`MAX_COLORS`].
    pub colors: &'a [ColorAttachment<'a>],
    /// Depth attachment.
    pub depth: Option<DepthAttachment<'a>>,
}

impl Encoder<'_> {
    /// Begins to render; viewport and scissor are set to the whole size.
    pub fn begin_rendering(&mut self, rendering: &Rendering<'_>) {
        if !self.ensure(!self.rendering, "rendering was begun inside of rendering")
            || !self.ensure(rendering.colors.len() <= MAX_COLORS, "too many colour attachments")
        {
            return;
        }
        let needed = if rendering.view_mask == 0 {
            rendering.layers
        } else {
            32 - rendering.view_mask.leading_zeros()
        };
        let fits = |view: &ImageView| {
            view.layers() >= needed && view.size().0 >= rendering.size.0 && view.size().1 >= rendering.size.1
        };
        let all_fit = rendering.colors.iter().all(|c| fits(c.view) && c.resolve.is_none_or(|r| fits(r)))
            && rendering.depth.is_none_or(|d| fits(d.view) && d.resolve.is_none_or(|r| fits(r)))
            && rendering.size.0 > 0
            && rendering.size.1 > 0;
        if !self.ensure(all_fit, "an attachment has fewer layers or texels than the pass") {
            return;
        }
        let mut colors = [vk::RenderingAttachmentInfo::default(); MAX_COLORS];
        for (raw, color) in colors.iter_mut().zip(rendering.colors) {
            if !self.keep(color.view) {
                return;
            }
            *raw = raw
                .image_view(color.view.raw)
                .image_layout(vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL)
                .load_op(color.load.op())
                .store_op(store_op(color.store));
            if let Load::Clear(float32) = color.load {
                *raw = raw.clear_value(vk::ClearValue { color: vk::ClearColorValue { float32 } });
            }
            if let Some(resolve) = color.resolve {
                if !self.keep(resolve) {
                    return;
                }
                *raw = raw
                    .resolve_mode(vk::ResolveModeFlags::AVERAGE)
                    .resolve_image_view(resolve.raw)
                    .resolve_image_layout(vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL);
            }
        }
        let mut depth_info = vk::RenderingAttachmentInfo::default();
        if let Some(depth) = rendering.depth {
            if !self.keep(depth.view) {
                return;
            }
            let used = if depth.read_only { Use::DepthReadOnly } else { Use::DepthAttachment };
            depth_info = depth_info
                .image_view(depth.view.raw)
                .image_layout(used.layout())
                .load_op(depth.load.op())
                .store_op(match (depth.store, depth.read_only) {
                    // Nothing is written, so that a reader elsewhere need not wait.
                    (_, true) => vk::AttachmentStoreOp::NONE,
                    (store, false) => store_op(store),
                });
            if let Load::Clear(depth) = depth.load {
                depth_info = depth_info.clear_value(vk::ClearValue {
                    depth_stencil: vk::ClearDepthStencilValue { depth, stencil: 0 },
                });
            }
            if let Some(resolve) = depth.resolve {
                if !self.keep(resolve) {
                    return;
                }
                depth_info = depth_info
                    .resolve_mode(vk::ResolveModeFlags::SAMPLE_ZERO)
                    .resolve_image_view(resolve.raw)
                    .resolve_image_layout(Use::DepthAttachment.layout());
            }
        }
        let extent = vk::Extent2D { width: rendering.size.0, height: rendering.size.1 };
        let area = vk::Rect2D { offset: vk::Offset2D::default(), extent };
        let mut info = vk::RenderingInfo::default()
            .render_area(area)
            .layer_count(if rendering.view_mask == 0 { rendering.layers } else { 1 })
            .view_mask(rendering.view_mask)
            .color_attachments(&colors[..rendering.colors.len()]);
        if rendering.depth.is_some() {
            info = info.depth_attachment(&depth_info);
        }
        self.rendering = true;
        // SAFETY: recording, outside of rendering; the attachments are kept and large enough.
        quick(|| unsafe { self.commands.device.raw.cmd_begin_rendering(self.commands.raw, &info) });
        self.viewport((0.0, 0.0), (rendering.size.0 as f32, rendering.size.1 as f32));
        self.scissor((0, 0), rendering.size);
    }

    /// Ends rendering.
    pub fn end_rendering(&mut self) {
        if !self.ensure(self.rendering, "rendering was ended that was not begun") {
            return;
        }
        self.rendering = false;
        // SAFETY: inside of rendering.
        quick(|| unsafe { self.commands.device.raw.cmd_end_rendering(self.commands.raw) });
    }
}

fn store_op(store: bool) -> vk::AttachmentStoreOp {
    if store { vk::AttachmentStoreOp::STORE } else { vk::AttachmentStoreOp::DONT_CARE }
}
