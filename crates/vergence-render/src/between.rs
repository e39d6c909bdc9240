//! The images of a renderer's own between its passes and what is asked for: samples, and a depth that nobody asks for.

use std::sync::Arc;

use vergence_gpu::vk;
use vergence_gpu::{
    ColorAttachment, DepthAttachment, Device, Encoder, Image, ImageBarrier, ImageDesc, ImageView, Load,
    Rendering, Use, ViewDesc,
};

use crate::Error;
use crate::target::{Attachments, Target};

/// Images between the passes and the attachments, where there are more samples than one or no depth is asked for.
#[derive(Default)]
pub(crate) struct Between {
    pub color: Option<Arc<ImageView>>,
    depth: Option<Arc<ImageView>>,
    /// Views of single layers, for passes of single views.
    layers: Vec<(Arc<ImageView>, u32, Arc<ImageView>)>,
}

/// Most views of single layers that are kept: swapchains of a few images, colour and depth, some views.
const LAYER_VIEWS: usize = 64;

impl Between {
    pub fn new(device: &Arc<Device>, target: &Target, samples: u32) -> Result<Self, Error> {
        if samples == 1 {
            return Ok(Self::default());
        }
        Ok(Self {
            color: Some(attachment(device, target, target.color_format, samples)?),
            depth: Some(attachment(device, target, target.depth_format, samples)?),
            layers: Vec::new(),
        })
    }

    /// Makes the depth image that a pass without samples needs where nobody asks for its depth.
    pub fn complete(
        &mut self,
        device: &Arc<Device>,
        target: &Target,
        to: &Attachments<'_>,
    ) -> Result<(), Error> {
        if self.depth.is_none() && to.depth.is_none() {
            self.depth = Some(attachment(device, target, target.depth_format, 1)?);
        }
        Ok(())
    }

    /// The depth image of its own that passes to `to` use.
    fn own_depth(&self, to: &Attachments<'_>) -> Option<&Arc<ImageView>> {
        self.depth.as_ref().filter(|_| self.color.is_some() || to.depth.is_none())
    }

    /// Makes all images attachments; before the first pass of a frame.
    pub fn prepare<'a>(&'a self, encoder: &mut Encoder<'_>, to: &Attachments<'a>) {
        let discard =
            |view: &'a Arc<ImageView>, from, to| ImageBarrier::new(view.image(), from, to).discard();
        // At most four images, of which the first is always there; the others follow it.
        let mut barriers = [discard(to.color, to.color_before, Use::ColorAttachment); 4];
        let mut count = 1;
        let others = [
            to.depth.map(|view| discard(view, to.depth_before, Use::DepthAttachment)),
            self.color.as_ref().map(|view| discard(view, Use::ColorAttachment, Use::ColorAttachment)),
            self.own_depth(to).map(|view| discard(view, Use::DepthAttachment, Use::DepthAttachment)),
        ];
        for barrier in others.into_iter().flatten() {
            barriers[count] = barrier;
            count += 1;
        }
        encoder.barrier(&barriers[..count], &[]);
    }

    /// Between the passes to single layers and the one that resolves them all.
    pub fn before_resolve(&self, encoder: &mut Encoder<'_>, to: &Attachments<'_>) {
        if let Some(color) = &self.color {
            encoder.transition(color.image(), Use::ColorAttachment, Use::ColorAttachment);
        }
        if let Some(depth) = self.own_depth(to) {
            encoder.transition(depth.image(), Use::DepthAttachment, Use::DepthAttachment);
        }
    }

    /// Begins a pass to all layers (`layer` none), which also resolves samples, or to one, which does not: some
    /// drivers resolve the first layer only.
    pub fn begin(
        &mut self,
        encoder: &mut Encoder<'_>,
        to: &Attachments<'_>,
        target: &Target,
        layer: Option<u32>,
        clear: Option<[f32; 3]>,
    ) -> Result<(), Error> {
        let has_samples = self.color.is_some();
        let resolves = has_samples && layer.is_none();
        let own_depth = self.own_depth(to).cloned();
        let own_color = self.color.clone();
        let color_view = self.layer(own_color.as_ref().unwrap_or(to.color), layer)?;
        let depth_view = match own_depth.as_ref().or(to.depth) {
            Some(view) => Some(self.layer(view, layer)?),
            None => None,
        };
        let color = ColorAttachment {
            view: &color_view,
            resolve: Some(to.color).filter(|_| resolves),
            load: clear.map_or(Load::Keep, |[r, g, b]| Load::Clear([r, g, b, 1.0])),
            store: !resolves,
        };
        let depth = depth_view.as_ref().map(|view| DepthAttachment {
            view,
            resolve: to.depth.filter(|_| resolves),
            load: clear.map_or(Load::Keep, |_| Load::Clear(0.0)),
            // Depth of its own is wanted after a pass only to be resolved.
            store: own_depth.is_none() || (has_samples && !resolves && to.depth.is_some()),
            read_only: false,
        });
        let depth = depth.filter(|_| clear.is_some() || to.depth.is_some());
        let view_mask = if layer.is_none() { (1 << target.views) - 1 } else { 0 };
        encoder.begin_rendering(&Rendering {
            size: target.size,
            view_mask,
            layers: 1,
            colors: &[color],
            depth,
        });
        Ok(())
    }

    /// A view of one layer, made once for each image and layer that comes along again.
    fn layer(&mut self, view: &Arc<ImageView>, layer: Option<u32>) -> Result<Arc<ImageView>, Error> {
        let Some(layer) = layer else { return Ok(Arc::clone(view)) };
        let known = self.layers.iter().find(|(whole, at, _)| *at == layer && Arc::ptr_eq(whole, view));
        if let Some((_, _, single)) = known {
            return Ok(Arc::clone(single));
        }
        if self.layers.len() >= LAYER_VIEWS {
            self.layers.remove(0);
        }
        let desc = ViewDesc { base_layer: layer, layers: Some(1), ..ViewDesc::default() };
        let single = ImageView::new(view.image(), &desc)?;
        self.layers.push((Arc::clone(view), layer, Arc::clone(&single)));
        Ok(single)
    }

    /// Gives the attachments the uses that were asked for; after the last pass of a frame.
    pub fn finish(&self, encoder: &mut Encoder<'_>, to: &Attachments<'_>) {
        let color = ImageBarrier::new(to.color.image(), Use::ColorAttachment, to.color_after);
        if to.color_after != Use::ColorAttachment {
            encoder.barrier(&[color], &[]);
        }
        // A resolve writes depth in the colour stage, with colour's access. Who takes the image over expects writes of
        // the depth stage: the barrier brings one to the other, also where the use stays.
        let is_resolved = self.color.is_some();
        if let Some(depth) = to.depth.filter(|_| is_resolved || to.depth_after != Use::DepthAttachment) {
            encoder.transition(depth.image(), Use::DepthAttachment, to.depth_after);
        }
    }
}

fn attachment(
    device: &Arc<Device>,
    target: &Target,
    format: vk::Format,
    samples: u32,
) -> Result<Arc<ImageView>, Error> {
    let (name, usage) = if format == target.depth_format {
        ("depth", vk::ImageUsageFlags::DEPTH_STENCIL_ATTACHMENT)
    } else {
        ("colour samples", vk::ImageUsageFlags::COLOR_ATTACHMENT)
    };
    let image = Image::new(
        device,
        &ImageDesc {
            name,
            format,
            width: target.size.0,
            height: target.size.1,
            layers: target.views,
            samples,
            usage: usage | vk::ImageUsageFlags::TRANSIENT_ATTACHMENT,
            ..ImageDesc::default()
        },
    )?;
    let kind = Some(vk::ImageViewType::TYPE_2D_ARRAY);
    Ok(ImageView::new(&image, &ViewDesc { kind, ..ViewDesc::default() })?)
}
