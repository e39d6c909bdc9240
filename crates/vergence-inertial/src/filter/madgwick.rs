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
        let mut slope = q * Quaternion::from_imag(sample.gyr_rad_s * 0.5);
        if let Some(acc) = &sample.acc_m_s2 {
            let mut down = gradient(&q, &Vector3::z(), &acc.normalize());
            if let Some(mag) = &sample.mag_ut {
                let mag = mag.normalize();
                let field = unit * mag;
                // Half the length: see above.
                down += gradient(&q, &(Vector3::new(field.xy().norm(), 0.0, field.z) * 0.5), &mag);
            }
            let length = down.norm();
            if length > 1e-30 {
                slope -= down * (self.params.beta / length);
            }
        }
        self.state.nwu_from_sensor = Some(normalised(q + slope * sample.step_s));
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
