//! The bad value that the call on this thread is to give.

use std::cell::Cell;

use openxr_sys as sys;
use vergence_time::{Span, Timestamp};

use super::BadValue;

thread_local! {
    static ACTIVE: Cell<Option<BadValue>> = const { Cell::new(None) };
}

/// Holds for as long as it lives.
pub(crate) struct Active(());

impl Active {
    pub(crate) fn new(value: BadValue) -> Self {
        ACTIVE.set(Some(value));
        Self(())
    }
}

impl Drop for Active {
    fn drop(&mut self) {
        ACTIVE.set(None);
    }
}

/// How many an enumeration says that there are, where there are `found`.
pub(crate) fn bent_count(found: u32) -> u32 {
    match ACTIVE.get() {
        Some(BadValue::CountGrows) => found.saturating_add(1),
        Some(BadValue::CountShrinks) => found.saturating_sub(1),
        Some(BadValue::Nothing) => 0,
        _ => found,
    }
}

pub(crate) fn bent_pose(pose: sys::Posef) -> sys::Posef {
    let nan = f32::NAN;
    match ACTIVE.get() {
        Some(BadValue::NanPose) => sys::Posef {
            orientation: sys::Quaternionf { x: nan, y: nan, z: nan, w: nan },
            position: sys::Vector3f { x: nan, y: nan, z: nan },
        },
        Some(BadValue::ZeroQuaternion) => {
            sys::Posef { orientation: sys::Quaternionf { x: 0.0, y: 0.0, z: 0.0, w: 0.0 }, ..pose }
        }
        _ => pose,
    }
}

pub(crate) fn bent_fov(fov: sys::Fovf) -> sys::Fovf {
    let all =
        |half: f32| sys::Fovf { angle_left: -half, angle_right: half, angle_up: half, angle_down: -half };
    match ACTIVE.get() {
        Some(BadValue::FovZero) => all(0.0),
        Some(BadValue::Fov180) => all(std::f32::consts::FRAC_PI_2),
        _ => fov,
    }
}

const SECOND_NS: i64 = 1_000_000_000;

pub(crate) fn bent_time(display: Timestamp, period: Span) -> (Timestamp, Span) {
    let moved = |seconds: i64| display.saturating_add(Span::from_nanos(seconds * SECOND_NS));
    match ACTIVE.get() {
        Some(BadValue::TimeNegative) => (Timestamp::from_nanos(-display.as_nanos()), period),
        Some(BadValue::TimeBackwards) => (moved(-1), period),
        Some(BadValue::TimeFar) => (moved(27 * 86_400), period),
        Some(BadValue::PeriodHuge) => (display, Span::from_nanos(16_570 * 3_600 * SECOND_NS)),
        _ => (display, period),
    }
}
