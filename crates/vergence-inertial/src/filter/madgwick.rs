use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::saved::saved;
use super::turn::{enu_from_nwu, from_directions, headed, normalised};
use super::{Clean, Core};

/// The knob of the Madgwick filter.
#[derive(Clone, Copy, Debug, PartialEq, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MadgwickParams {
    /// Speed of the pull towards the measured directions, radians per second of quaternion; 0.005 to 1. Large: follows
    /// acceleration. Small: follows gyroscope bias. Default 0.12.
    pub beta: f64,
}

impl Default for MadgwickParams {
    fn default() -> Self {
        Self { beta: 0.12 }
    }
}

/// The gradient-descent filter of Madgwick, Harrison and Vaidyanathan (ICORR 2011), in the form that most devices run, to which
/// published gains belong: it enters the magnetic reference at half its length, which halves the pull of the magnetometer and
/// tilts it a little (9D, recorded motion: 4.50° of error; with the whole length 4.73°).
#[derive(Clone, Debug)]
pub struct Madgwick {
    params: MadgwickParams,
    state: MadgwickState,
}

/// The orientation so far, if it has started.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MadgwickState {
    /// North-west-up earth: x along the horizontal field.
    nwu_from_sensor: Option<UnitQuaternion<f64>>,
}

saved!(MadgwickState { nwu_from_sensor });

impl Madgwick {
    /// A filter that starts with its first sample.
    pub fn new(params: MadgwickParams) -> Self {
        Self { params, state: MadgwickState::default() }
    }
}

/// Half the gradient over the four coordinates of `q` of `|conj(q) reference q - measured|²`, where the diagonal of the
/// rotation is written with ones (as in the paper). `reference` has no y.
#[inline]
fn gradient(q: &Quaternion<f64>, reference: &Vector3<f64>, measured: &Vector3<f64>) -> Quaternion<f64> {
    let (w, x, y, z) = (q.w, q.i, q.j, q.k);
    let (bx, bz) = (2.0 * reference.x, 2.0 * reference.z);
    let f = Vector3::new(
        bx * (0.5 - y * y - z * z) + bz * (x * z - w * y) - measured.x,
        bx * (x * y - w * z) + bz * (w * x + y * z) - measured.y,
        bx * (w * y + x * z) + bz * (0.5 - x * x - y * y) - measured.z,
    );
    Quaternion::new(
        -bz * y * f.x + (bz * x - bx * z) * f.y + bx * y * f.z,
        bz * z * f.x + (bx * y + bz * w) * f.y + (bx * z - 2.0 * bz * x) * f.z,
        -(2.0 * bx * y + bz * w) * f.x + (bx * x + bz * z) * f.y + (bx * w - 2.0 * bz * y) * f.z,
        (bz * x - 2.0 * bx * z) * f.x + (bz * y - bx * w) * f.y + bx * x * f.z,
    )
}

/// The same for a `reference` of +z, whose zeros are known.
#[inline]
fn gradient_up(q: &Quaternion<f64>, measured: &Vector3<f64>) -> Quaternion<f64> {
    let (w, x, y, z) = (2.0 * q.w, 2.0 * q.i, 2.0 * q.j, 2.0 * q.k);
    let fx = x * q.k - w * q.j - measured.x;
    let fy = w * q.i + y * q.k - measured.y;
    let fz = 2.0 * (1.0 - x * q.i - y * q.j - measured.z);
    Quaternion::new(x * fy - y * fx, z * fx + w * fy - x * fz, z * fy - w * fx - y * fz, x * fx + y * fy)
}

/// `q` times the pure quaternion `v`, whose zero is known.
#[inline]
fn times_imaginary(q: &Quaternion<f64>, v: &Vector3<f64>) -> Quaternion<f64> {
    let (w, x, y, z) = (q.w, q.i, q.j, q.k);
    Quaternion::new(
        -(x * v.x + y * v.y + z * v.z),
        w * v.x + y * v.z - z * v.y,
        w * v.y + z * v.x - x * v.z,
        w * v.z + x * v.y - y * v.x,
    )
}

impl Core for Madgwick {
    type State = MadgwickState;

    #[inline]
    fn step(&mut self, sample: &Clean) {
        let Some(unit) = self.state.nwu_from_sensor else {
            if sample.acc_m_s2.is_some() {
                let enu = from_directions(sample.acc_m_s2.as_ref(), sample.mag_ut.as_ref());
                self.state.nwu_from_sensor = Some(headed(-std::f64::consts::FRAC_PI_2, &enu));
            }
            return;
        };
        let q = unit.into_inner();
        let mut next = q + times_imaginary(&q, &(sample.gyr_rad_s * (0.5 * sample.step_s)));
        if let Some(acc) = &sample.acc_m_s2 {
            let mut down = gradient_up(&q, &(acc * (1.0 / acc.norm())));
            if let Some(mag) = &sample.mag_ut {
                let mag = mag * (1.0 / mag.norm());
                let field = unit * mag;
                // Half the length: see above.
                down += gradient(&q, &(Vector3::new(field.xy().norm(), 0.0, field.z) * 0.5), &mag);
            }
            let length = down.norm();
            if length > 1e-30 {
                next -= down * (self.params.beta * sample.step_s / length);
            }
        }
        self.state.nwu_from_sensor = Some(normalised(next));
    }

    fn lost(&mut self, _gap_s: f64) {
        self.state.nwu_from_sensor = None;
    }

    fn earth_from_sensor(&self) -> UnitQuaternion<f64> {
        match &self.state.nwu_from_sensor {
            Some(q) => enu_from_nwu(q),
            None => UnitQuaternion::identity(),
        }
    }

    fn state(&self) -> &MadgwickState {
        &self.state
    }

    fn set_state(&mut self, state: MadgwickState) {
        self.state = state;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_zeros_change_nothing() {
        let q = UnitQuaternion::from_euler_angles(0.7, -1.2, 2.1).into_inner();
        let v = Vector3::new(0.36, -0.48, 0.8);
        assert!((gradient_up(&q, &v) - gradient(&q, &Vector3::z(), &v)).norm() < 1e-15);
        assert!((times_imaginary(&q, &v) - q * Quaternion::from_imag(v)).norm() < 1e-15);
    }
}
