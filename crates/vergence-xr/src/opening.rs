//! How a session is opened: on which device, with which pictures, at which rate.

use std::sync::Arc;

use vergence_gpu::{Device, vk, vk::Handle as _};

use crate::client::SessionDesc;
use crate::connection::Connection;
use crate::error::{Error, In};
use crate::list::list;

/// Colour formats in the order in which they are liked; both store sRGB.
const COLOR_FORMATS: [vk::Format; 2] = [vk::Format::R8G8B8A8_SRGB, vk::Format::B8G8R8A8_SRGB];
/// Depth formats in the order in which they are liked.
const DEPTH_FORMATS: [vk::Format; 1] = [vk::Format::D32_SFLOAT];

pub(crate) const REFRESH_RATE: &str = "XR_FB_display_refresh_rate";
/// Rates nearer than this are one: 90 Hz is 89.9 on some displays.
const SAME_RATE_HZ: f32 = 0.5;

/// What the pictures of a session are like.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pictures {
    /// Format of the colour images.
    pub color_format: vk::Format,
    /// Format of the depth images; `None` where no depth is submitted.
    pub depth_format: Option<vk::Format>,
    /// Width and height of each view, pixels.
    pub size: (u32, u32),
    /// Number of views, one array layer each.
    pub views: u32,
}

pub(crate) fn create_session(
    connection: &Connection,
    device: &Arc<Device>,
) -> Result<(openxr::Session<openxr::Vulkan>, openxr::FrameWaiter), Error> {
    let raw = device.raw();
    let pointer = |handle: u64| handle as usize as *const std::ffi::c_void;
    let info = openxr::vulkan::SessionCreateInfo {
        instance: pointer(raw.instance.as_raw()),
        physical_device: pointer(raw.physical_device.as_raw()),
        device: pointer(raw.device.as_raw()),
        queue_family_index: raw.queue_family,
        queue_index: raw.queue_index,
    };
    // SAFETY: the handles are of a device that the runtime made (the caller's rule), and the guard keeps it alive until
    // the session is destroyed.
    let made = unsafe {
        connection.instance.create_session_with_guard::<openxr::Vulkan>(
            connection.system,
            &info,
            Box::new(Arc::clone(device)),
        )
    };
    let (session, waiter, _stream) = made.during("xrCreateSession")?;
    Ok((session, waiter))
}

pub(crate) fn choose_pictures(
    connection: &Connection,
    session: &openxr::Session<openxr::Vulkan>,
    device: &Device,
    desc: &SessionDesc<'_>,
) -> Result<Pictures, Error> {
    let enumerate = session.instance().fp().enumerate_swapchain_formats;
    let offered = list("xrEnumerateSwapchainFormats", 0i64, |capacity, count, items| {
        // SAFETY: the session lives; `items` is null or has `capacity` elements.
        unsafe { enumerate(session.as_raw(), capacity, count, items) }
    })?;
    let choose = |liked: &[vk::Format]| {
        liked.iter().copied().find(|format| offered.contains(&i64::from(format.as_raw())))
    };
    let color_format = choose(&COLOR_FORMATS).ok_or_else(|| Error::Unsupported {
        what: "colour formats of swapchains",
        expected: "R8G8B8A8_SRGB or B8G8R8A8_SRGB".into(),
        found: format!("{:?}", offered.iter().map(|&f| vk::Format::from_raw(f as i32)).collect::<Vec<_>>()),
    })?;
    let depth_format =
        if connection.has("XR_KHR_composition_layer_depth") { choose(&DEPTH_FORMATS) } else { None };
    let largest_image = device.limits().max_image_size;
    let scaled = |recommended: u32, largest: u32| {
        let wanted = (f64::from(recommended) * desc.render_scale).round();
        // A cast from f64 is held at the ends of u32; zero would be no picture.
        (wanted as u32).clamp(1, largest.min(largest_image).max(1))
    };
    // All views share one image, so it must fit each of them.
    let size = connection.views().iter().fold((1, 1), |(width, height), view| {
        (
            width.max(scaled(view.recommended.0, view.largest.0)),
            height.max(scaled(view.recommended.1, view.largest.1)),
        )
    });
    let views = u32::try_from(connection.views().len()).unwrap_or(1);
    Ok(Pictures { color_format, depth_format, size, views })
}

/// Asks for a rate that the display has.
pub(crate) fn choose_refresh_rate(
    connection: &Connection,
    session: &openxr::Session<openxr::Vulkan>,
    wanted_hz: Option<f32>,
) -> Result<(), Error> {
    let Some(wanted_hz) = wanted_hz else { return Ok(()) };
    let rates = if connection.has(REFRESH_RATE) {
        session.enumerate_display_refresh_rates().during("xrEnumerateDisplayRefreshRatesFB")?
    } else {
        Vec::new()
    };
    let near = rates.iter().copied().find(|rate| (rate - wanted_hz).abs() <= SAME_RATE_HZ);
    let Some(rate_hz) = near else {
        let offered: Vec<String> = rates.iter().map(|rate| format!("{rate} Hz")).collect();
        let offered =
            if offered.is_empty() { "none, the runtime decides".into() } else { offered.join(", ") };
        return Err(Error::RefreshRate { wanted_hz, offered });
    };
    session.request_display_refresh_rate(rate_hz).during("xrRequestDisplayRefreshRateFB")
}
