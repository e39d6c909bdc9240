//! XR_FB_display_refresh_rate.

use openxr_sys as sys;

use crate::event::Event;
use crate::ffi::{Buffer, Out, XrResult};
use crate::session::Session;

fn rates(session: &Session) -> Vec<f32> {
    let mut rates: Vec<f32> =
        session.instance.config.profile.rates_hz.iter().map(|&rate| rate as f32).collect();
    rates.sort_by(f32::total_cmp);
    rates
}

pub(crate) fn enumerate_display_refresh_rates(session: &Session, mut buffer: Buffer<f32>) -> XrResult {
    buffer.give(&rates(session))
}

pub(crate) fn get_display_refresh_rate(session: &Session, mut out: Out<f32>) -> XrResult {
    let rate = session.lock().rate_hz as f32;
    out.set(rate)?;
    Ok(sys::Result::SUCCESS)
}

/// 0 is "whatever the runtime likes": its default.
pub(crate) fn request_display_refresh_rate(session: &Session, rate: f32) -> XrResult {
    let profile = &session.instance.config.profile;
    let wanted = if rate == sys::FREQUENCY_UNSPECIFIED {
        profile.rates_hz[0]
    } else {
        let known = profile.rates_hz.iter().find(|&&known| known as f32 == rate);
        *known.ok_or(sys::Result::ERROR_DISPLAY_REFRESH_RATE_UNSUPPORTED_FB)?
    };
    let inner = &mut *session.lock();
    let before = std::mem::replace(&mut inner.rate_hz, wanted);
    if before != wanted {
        let event = Event::RefreshRateChanged { from_hz: before as f32, to_hz: wanted as f32 };
        session.instance.push_event(event);
    }
    Ok(sys::Result::SUCCESS)
}
