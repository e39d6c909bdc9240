//! What hands and eyes share: how they turn, and how smoothly.

use nalgebra::Vector3;
use vergence_time::{Span, Timestamp};

/// The instant `secs` later; the same one where that is no time.
pub(crate) fn later(time: Timestamp, secs: f64) -> Timestamp {
    time.saturating_add(Span::from_secs_f64(secs).unwrap_or_default())
}

/// The share done after the share `u` of a movement's time, held in 0..1: the polynomial of least jerk (Flash and Hogan 1985).
pub(crate) fn least_jerk(u: f64) -> f64 {
    let u = u.clamp(0.0, 1.0);
    u * u * u * (10.0 - 15.0 * u + 6.0 * u * u)
}

/// The rotation vector that turns the unit vector `from` into `to` the short way, about some axis across where they are
/// opposite.
pub(crate) fn turn_between(from: &Vector3<f64>, to: &Vector3<f64>) -> Vector3<f64> {
    let axis = from.cross(to);
    let angle = axis.norm().atan2(from.dot(to));
    match axis.try_normalize(1e-15) {
        Some(axis) => axis * angle,
        None if angle > 1.0 => across(from)[0] * angle,
        None => Vector3::zeros(),
    }
}

/// Two directions that are perpendicular to the unit vector `along` and to each other.
pub(crate) fn across(along: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let first = along.cross(&Vector3::ith(along.iamin(), 1.0)).normalize();
    [first, along.cross(&first)]
}
