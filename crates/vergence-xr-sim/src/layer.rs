//! Composition layers: what an application submits, checked.

use std::sync::Arc;

use openxr_sys as sys;
use vergence_geom::{Fov, Rigid};

use crate::extension::Extension;
use crate::ffi::{XrResult, array, chained};
use crate::pose::{fov_from_xr, from_xr};
use crate::session::Session;
use crate::space::{self, Space};
use crate::swapchain::{self, Swapchain};
use crate::system::MAX_LAYERS;

/// A layer that can be composed.
pub(crate) struct Layer {
    pub space: Arc<Space>,
    /// Source alpha counts.
    pub blend: bool,
    /// Colours are not multiplied by their alpha yet.
    pub straight_alpha: bool,
    pub content: Content,
}

pub(crate) enum Content {
    /// One picture for each eye.
    Projection([ProjectionView; 2]),
    /// A rectangle in space, for the left eye, the right one, or both.
    Quad { pose: Rigid, size_m: (f64, f64), image: SubImage, eyes: [bool; 2] },
}

pub(crate) struct ProjectionView {
    /// Eye coordinates to those of the layer's space.
    pub pose: Rigid,
    pub fov: Fov,
    pub image: SubImage,
}

/// A part of the image that a swapchain shows.
pub(crate) struct SubImage {
    pub swapchain: Arc<Swapchain>,
    /// Left, top, in pixels.
    pub offset: (u32, u32),
    pub size: (u32, u32),
    pub array_index: u32,
}

pub(crate) fn check_blend_mode(mode: sys::EnvironmentBlendMode) -> XrResult<()> {
    use sys::EnvironmentBlendMode as B;
    match mode {
        B::OPAQUE => Ok(()),
        B::ADDITIVE | B::ALPHA_BLEND => Err(sys::Result::ERROR_ENVIRONMENT_BLEND_MODE_UNSUPPORTED),
        _ => Err(sys::Result::ERROR_VALIDATION_FAILURE),
    }
}

/// The layers of a frame, the farthest first.
pub(crate) fn read(session: &Session, info: &sys::FrameEndInfo) -> XrResult<Vec<Layer>> {
    if info.layer_count > MAX_LAYERS {
        return Err(sys::Result::ERROR_LAYER_LIMIT_EXCEEDED);
    }
    // SAFETY: the application hands over as many pointers as it says.
    let layers = unsafe { array(info.layers, info.layer_count) }?;
    if session.graphics.is_none() && !layers.is_empty() {
        return Err(sys::Result::ERROR_LAYER_INVALID);
    }
    layers.iter().map(|&layer| read_one(session, layer)).collect()
}

fn read_one(session: &Session, layer: *const sys::CompositionLayerBaseHeader) -> XrResult<Layer> {
    if layer.is_null() || !layer.is_aligned() {
        return Err(sys::Result::ERROR_LAYER_INVALID);
    }
    // SAFETY: not null and aligned; every layer starts with this header, and the application keeps it alive.
    let header = unsafe { &*layer };
    use sys::CompositionLayerFlags as F;
    let known = F::CORRECT_CHROMATIC_ABERRATION | F::BLEND_TEXTURE_SOURCE_ALPHA | F::UNPREMULTIPLIED_ALPHA;
    if !known.contains(header.layer_flags) {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    let content = match header.ty {
        sys::StructureType::COMPOSITION_LAYER_PROJECTION => {
            // SAFETY: it says that it is a projection layer.
            projection(session, unsafe { &*layer.cast::<sys::CompositionLayerProjection>() })?
        }
        sys::StructureType::COMPOSITION_LAYER_QUAD => {
            // SAFETY: it says that it is a quad layer.
            quad(session, unsafe { &*layer.cast::<sys::CompositionLayerQuad>() })?
        }
        _ => return Err(sys::Result::ERROR_LAYER_INVALID),
    };
    let space = space::get(header.space)?;
    if !std::ptr::eq(&*space.session, session) {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    Ok(Layer {
        space,
        blend: header.layer_flags.contains(F::BLEND_TEXTURE_SOURCE_ALPHA),
        straight_alpha: header.layer_flags.contains(F::UNPREMULTIPLIED_ALPHA),
        content,
    })
}

fn projection(session: &Session, layer: &sys::CompositionLayerProjection) -> XrResult<Content> {
    if layer.view_count != 2 {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    // SAFETY: the application hands over as many views as it says.
    let views = unsafe { array(layer.views, layer.view_count) }?;
    let [left, right] = views else { return Err(sys::Result::ERROR_VALIDATION_FAILURE) };
    Ok(Content::Projection([projection_view(session, left)?, projection_view(session, right)?]))
}

fn projection_view(
    session: &Session,
    view: &sys::CompositionLayerProjectionView,
) -> XrResult<ProjectionView> {
    if view.ty != sys::CompositionLayerProjectionView::TYPE {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    let pose = from_xr(&view.pose)?;
    let fov = fov_from_xr(&view.fov);
    // A picture may be mirrored (left and right exchanged) but not empty or wider than a half-space.
    let angles = [fov.left_rad, fov.right_rad, fov.up_rad, fov.down_rad];
    let drawable = angles.iter().all(|angle| angle.abs() < std::f64::consts::FRAC_PI_2)
        && fov.left_rad != fov.right_rad
        && fov.up_rad != fov.down_rad;
    if !drawable {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    let image = sub_image(session, &view.sub_image)?;
    if session.instance.has(Extension::CompositionLayerDepth)
        && let Some(depth) = chained::<sys::CompositionLayerDepthInfoKHR>(view.next)
    {
        check_depth(session, depth)?;
    }
    Ok(ProjectionView { pose, fov, image })
}

/// Depth is checked and not used: composition turns pictures, it does not move them.
fn check_depth(session: &Session, depth: &sys::CompositionLayerDepthInfoKHR) -> XrResult<()> {
    sub_image(session, &depth.sub_image)?;
    let range = 0.0 <= depth.min_depth && depth.min_depth <= depth.max_depth && depth.max_depth <= 1.0;
    // Infinite is legal for either plane; reversed depth exchanges them; NaN and equal planes are not.
    let planes = depth.near_z >= 0.0 && depth.far_z >= 0.0 && depth.near_z != depth.far_z;
    if range && planes { Ok(()) } else { Err(sys::Result::ERROR_VALIDATION_FAILURE) }
}

fn quad(session: &Session, layer: &sys::CompositionLayerQuad) -> XrResult<Content> {
    let pose = from_xr(&layer.pose)?;
    let size_m = (f64::from(layer.size.width), f64::from(layer.size.height));
    if !(size_m.0 >= 0.0 && size_m.1 >= 0.0 && size_m.0.is_finite() && size_m.1.is_finite()) {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    let eyes = match layer.eye_visibility {
        sys::EyeVisibility::BOTH => [true, true],
        sys::EyeVisibility::LEFT => [true, false],
        sys::EyeVisibility::RIGHT => [false, true],
        _ => return Err(sys::Result::ERROR_VALIDATION_FAILURE),
    };
    Ok(Content::Quad { pose, size_m, image: sub_image(session, &layer.sub_image)?, eyes })
}

fn sub_image(session: &Session, image: &sys::SwapchainSubImage) -> XrResult<SubImage> {
    let swapchain = swapchain::get(image.swapchain)?;
    if !std::ptr::eq(&*swapchain.session, session) || image.image_array_index >= swapchain.array_size {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    let (offset, extent) = (image.image_rect.offset, image.image_rect.extent);
    let side = |offset: i32, extent: i32, limit: u32| {
        let (offset, extent) =
            (u32::try_from(offset).ok()?, u32::try_from(extent).ok().filter(|&extent| extent > 0)?);
        offset.checked_add(extent).filter(|&end| end <= limit).map(|_| (offset, extent))
    };
    let invalid = sys::Result::ERROR_SWAPCHAIN_RECT_INVALID;
    let (x, width) = side(offset.x, extent.width, swapchain.size.0).ok_or(invalid)?;
    let (y, height) = side(offset.y, extent.height, swapchain.size.1).ok_or(invalid)?;
    if swapchain.shown().is_none() {
        return Err(sys::Result::ERROR_LAYER_INVALID);
    }
    Ok(SubImage { swapchain, offset: (x, y), size: (width, height), array_index: image.image_array_index })
}
