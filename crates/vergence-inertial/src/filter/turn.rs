//! Turns small enough for a few terms of a series, and corrections that take one direction onto another.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

/// The unit quaternion of the turn by the rotation vector `angle_rad` (its direction the axis, its length the angle).
///
/// Up to half a radian five terms of the series are exact to the last bits; beyond, sine and cosine.
#[inline]
pub fn turn(angle_rad: &Vector3<f64>) -> Quaternion<f64> {
    let h = 0.25 * angle_rad.norm_squared();
    let (c, s) = if h < 0.0625 {
        (
            1.0 - h / 2.0 * (1.0 - h / 12.0 * (1.0 - h / 30.0 * (1.0 - h / 56.0 * (1.0 - h / 90.0)))),
            0.5 * (1.0
                - h / 6.0 * (1.0 - h / 20.0 * (1.0 - h / 42.0 * (1.0 - h / 72.0 * (1.0 - h / 110.0))))),
        )
    } else {
        let half = h.sqrt();
        (half.cos(), 0.5 * half.sin() / half)
    };
    Quaternion::new(c, s * angle_rad.x, s * angle_rad.y, s * angle_rad.z)
}

/// `q` scaled to unit length, where it is already close to it: one Newton step instead of a root and a division.
#[inline]
pub fn renormalised(q: Quaternion<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::new_unchecked(q * (1.5 - 0.5 * q.norm_squared()))
}

/// `q` scaled to unit length: four terms of the series where it is close to that, so that no root and no division is waited for;
/// beyond, both.
#[inline]
pub fn normalised(q: Quaternion<f64>) -> UnitQuaternion<f64> {
    let e = q.norm_squared() - 1.0;
    if e.abs() < 1e-3 {
        // In pairs: half the depth, so half the wait.
        let square = e * e;
        let rest = (0.375 - 0.3125 * e) + 0.273_437_5 * square;
        UnitQuaternion::new_unchecked(q * ((1.0 - 0.5 * e) + square * rest))
    } else {
        UnitQuaternion::new_normalize(q)
    }
}

/// The shortest turn that takes the unit vector `up` onto +z.
#[inline]
pub fn level(up: &Vector3<f64>) -> Quaternion<f64> {
    let w = ((up.z + 1.0) * 0.5).max(0.0).sqrt();
    if w > 1e-6 {
        Quaternion::new(w, 0.5 * up.y / w, -0.5 * up.x / w, 0.0)
    } else {
        // Upside down to a microradian: any horizontal axis will do.
        Quaternion::new(0.0, 1.0, 0.0, 0.0)
    }
}

/// `earth` turned by `heading_rad` about +z, from the left.
#[inline]
pub fn headed(heading_rad: f64, earth: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    let (s, c) = (0.5 * heading_rad).sin_cos();
    UnitQuaternion::new_unchecked(Quaternion::new(c, 0.0, 0.0, s) * earth.quaternion())
}

/// An orientation in the earth frame whose x is north and y is west as one in ENU: a quarter turn about +z.
#[inline]
pub fn enu_from_nwu(q: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    const HALF: f64 = std::f64::consts::FRAC_1_SQRT_2;
    UnitQuaternion::new_unchecked(Quaternion::new(q.w - q.k, q.i - q.j, q.j + q.i, q.k + q.w) * HALF)
}

/// `angle_rad` brought into −π…π; for angles within a few turns.
#[inline]
pub fn wrapped(angle_rad: f64) -> f64 {
    const TURN: f64 = 2.0 * std::f64::consts::PI;
    angle_rad - TURN * (angle_rad / TURN).round()
}

/// The orientation whose +z is along the specific force and, where a field is given, whose +y is along its horizontal part: ENU.
/// Identity, or a heading of zero, where a vector says nothing.
pub fn from_directions(
    acc_m_s2: Option<&Vector3<f64>>,
    mag_ut: Option<&Vector3<f64>>,
) -> UnitQuaternion<f64> {
    let tilt = match acc_m_s2.and_then(|acc| acc.try_normalize(1e-6)) {
        Some(up) => UnitQuaternion::new_normalize(level(&up)),
        None => UnitQuaternion::identity(),
    };
    match mag_ut.map(|mag| tilt * mag) {
        Some(field) if field.xy().norm() > 1e-9 => headed(field.x.atan2(field.y), &tilt),
        _ => tilt,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two units in the last place of the largest coordinate.
    const LAST_BITS: f64 = 4.5e-16;

    #[test]
    fn the_series_equals_sine_and_cosine() {
        for angle in [0.0, 1e-300, 1e-12, 1e-3, 0.1, 0.3, 0.499_999, 0.500_001, 1.0, 3.1] {
            let axis = Vector3::new(0.36, -0.48, 0.8);
            let expected = UnitQuaternion::new(axis * angle);
            let off = (turn(&(axis * angle)) - expected.quaternion()).norm();
            assert!(off <= LAST_BITS, "{angle}: {off}");
        }
    }

    #[test]
    fn near_unit_length_the_series_equals_the_root() {
        for length in [0.3, 0.9994, 0.9996, 1.0 - 1e-9, 1.0, 1.0 + 1e-5, 1.000_499, 1.000_51, 2.0] {
            let q = Quaternion::new(0.5, -0.5, 0.1, 0.7);
            let q = q * (length / q.norm());
            assert!((normalised(q).norm() - 1.0).abs() <= LAST_BITS, "{length}");
        }
    }

    #[test]
    fn north_becomes_y() {
        let q = UnitQuaternion::from_euler_angles(0.3, -0.2, 0.9);
        let expected = headed(std::f64::consts::FRAC_PI_2, &q);
        assert!((enu_from_nwu(&q).coords - expected.coords).norm() < LAST_BITS);
    }

    #[test]
    fn levelling_takes_a_direction_up() {
        for up in [Vector3::new(0.6, 0.0, 0.8), Vector3::z(), -Vector3::z(), Vector3::new(-0.8, 0.6, 0.0)] {
            let levelled = UnitQuaternion::new_normalize(level(&up)) * up;
            assert!((levelled - Vector3::z()).norm() < 1e-15, "{up}");
        }
    }
}
