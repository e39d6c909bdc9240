//! The one system: a head-mounted display with two views.

use openxr_sys as sys;

use crate::ffi::{Buffer, In, Out, XrResult, chained_out, text_field};
use crate::headset::MAX_IMAGE_SIDE;
use crate::instance::Instance;

/// The identity of the headset: there is one.
pub(crate) const SYSTEM: u64 = 1;

/// How many layers a frame may have.
pub(crate) const MAX_LAYERS: u32 = sys::MIN_COMPOSITION_LAYERS_SUPPORTED as u32;

/// # Errors
/// `XR_ERROR_SYSTEM_INVALID` for any but the one system.
pub(crate) fn check_system(system: sys::SystemId) -> XrResult<()> {
    if system.into_raw() == SYSTEM { Ok(()) } else { Err(sys::Result::ERROR_SYSTEM_INVALID) }
}

/// # Errors
/// For a type that is none, and for one that the headset does not have.
pub(crate) fn check_view_configuration(ty: sys::ViewConfigurationType) -> XrResult<()> {
    if ty == sys::ViewConfigurationType::PRIMARY_STEREO {
        Ok(())
    } else if format!("{ty:?}").parse::<i32>().is_ok() {
        Err(sys::Result::ERROR_VALIDATION_FAILURE)
    } else {
        Err(sys::Result::ERROR_VIEW_CONFIGURATION_TYPE_UNSUPPORTED)
    }
}

pub(crate) fn get_system(
    _: &Instance,
    info: In<sys::SystemGetInfo>,
    mut out: Out<sys::SystemId>,
) -> XrResult {
    let info = info.get()?;
    out.check()?;
    match info.form_factor {
        sys::FormFactor::HEAD_MOUNTED_DISPLAY => {
            out.set(sys::SystemId::from_raw(SYSTEM))?;
            Ok(sys::Result::SUCCESS)
        }
        sys::FormFactor::HANDHELD_DISPLAY => Err(sys::Result::ERROR_FORM_FACTOR_UNSUPPORTED),
        _ => Err(sys::Result::ERROR_VALIDATION_FAILURE),
    }
}

pub(crate) fn get_system_properties(
    instance: &Instance,
    system: sys::SystemId,
    mut out: Out<sys::SystemProperties>,
) -> XrResult {
    check_system(system)?;
    let properties = out.fill()?;
    properties.system_id = system;
    properties.vendor_id = 0;
    properties.system_name = text_field(&instance.config.profile.name);
    properties.graphics_properties = sys::SystemGraphicsProperties {
        max_swapchain_image_height: MAX_IMAGE_SIDE,
        max_swapchain_image_width: MAX_IMAGE_SIDE,
        max_layer_count: MAX_LAYERS,
    };
    properties.tracking_properties =
        sys::SystemTrackingProperties { orientation_tracking: sys::TRUE, position_tracking: sys::TRUE };
    if let Some(hands) = chained_out::<sys::SystemHandTrackingPropertiesEXT>(properties.next) {
        hands.supports_hand_tracking = instance.sees_hands().into();
    }
    if let Some(gaze) = chained_out::<sys::SystemEyeGazeInteractionPropertiesEXT>(properties.next) {
        gaze.supports_eye_gaze_interaction = instance.sees_gaze().into();
    }
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn enumerate_view_configurations(
    _: &Instance,
    system: sys::SystemId,
    mut buffer: Buffer<sys::ViewConfigurationType>,
) -> XrResult {
    check_system(system)?;
    buffer.give(&[sys::ViewConfigurationType::PRIMARY_STEREO])
}

pub(crate) fn get_view_configuration_properties(
    _: &Instance,
    system: sys::SystemId,
    ty: sys::ViewConfigurationType,
    mut out: Out<sys::ViewConfigurationProperties>,
) -> XrResult {
    check_system(system)?;
    check_view_configuration(ty)?;
    let properties = out.fill()?;
    properties.view_configuration_type = ty;
    properties.fov_mutable = sys::TRUE;
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn enumerate_view_configuration_views(
    instance: &Instance,
    system: sys::SystemId,
    ty: sys::ViewConfigurationType,
    mut buffer: Buffer<sys::ViewConfigurationView>,
) -> XrResult {
    check_system(system)?;
    check_view_configuration(ty)?;
    let (width, height) = instance.config.profile.resolution;
    buffer.give_typed(2, |_, view| {
        view.recommended_image_rect_width = width;
        view.max_image_rect_width = MAX_IMAGE_SIDE;
        view.recommended_image_rect_height = height;
        view.max_image_rect_height = MAX_IMAGE_SIDE;
        view.recommended_swapchain_sample_count = 1;
        view.max_swapchain_sample_count = 1;
    })
}

pub(crate) fn enumerate_environment_blend_modes(
    _: &Instance,
    system: sys::SystemId,
    ty: sys::ViewConfigurationType,
    mut buffer: Buffer<sys::EnvironmentBlendMode>,
) -> XrResult {
    check_system(system)?;
    check_view_configuration(ty)?;
    buffer.give(&[sys::EnvironmentBlendMode::OPAQUE])
}
