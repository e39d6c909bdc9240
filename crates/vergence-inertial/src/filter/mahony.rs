use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::saved::saved;
use super::turn::{enu_from_nwu, from_directions, headed};
use super::{Clean, Core};

/// Knobs of the Mahony filter.
#[derive(Clone, Copy, Debug, PartialEq, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MahonyParams {
    /// Proportional gain, 1/s; 0.05 to 10. Large: follows acceleration. Small: follows gyroscope bias. Default 0.74.
    pub kp: f64,
    /// Integral gain, 1/s²; 0 to 0.1: how fast the bias is learned. Default 0.0012.
    pub ki: f64,
}

impl Default for MahonyParams {
    fn default() -> Self {
        Self { kp: 0.74, ki: 0.0012 }
    }
}

/// The explicit complementary filter with bias of Mahony, Hamel and Pflimlin (IEEE TAC 53(5), 2008), in the form that most
/// devices run: magnetic reference taken from the estimate, both directions weighted alike.
#[derive(Clone, Debug)]
pub struct Mahony {
    params: MahonyParams,
    state: MahonyState,
}

/// Orientation and what the integral has learned.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MahonyState {
    /// North-west-up earth: x along the horizontal field.
    nwu_from_sensor: Option<UnitQuaternion<f64>>,
    /// Radians per second, to be added to the readings.
    integral: Vector3<f64>,
}

saved!(MahonyState { nwu_from_sensor, integral });

impl Mahony {
    /// A filter that starts with its first sample.
    pub fn new(params: MahonyParams) -> Self {
        Self { params, state: MahonyState::default() }
    }
}

impl Core for Mahony {
    type State = MahonyState;

    fn step(&mut self, sample: &Clean) {
        let Some(q) = self.state.nwu_from_sensor else {
            if sample.acc_m_s2.is_some() {
                let enu = from_directions(sample.acc_m_s2.as_ref(), sample.mag_ut.as_ref());
                self.state.nwu_from_sensor = Some(headed(-std::f64::consts::FRAC_PI_2, &enu));
            }
            return;
        };
        let mut rate = sample.gyr_rad_s;
        if let Some(acc) = &sample.acc_m_s2 {
            let sensor_from_nwu = q.inverse();
            let mut error = acc.normalize().cross(&(sensor_from_nwu * Vector3::z()));
            if let Some(mag) = &sample.mag_ut {
                let mag = mag.normalize();
                let field = q * mag;
                let reference = Vector3::new(field.xy().norm(), 0.0, field.z);
                error += mag.cross(&(sensor_from_nwu * reference));
            }
            self.state.integral += error * (self.params.ki * sample.step_s);
            rate += error * self.params.kp + self.state.integral;
        }
        let slope = q.into_inner() * Quaternion::from_imag(rate * 0.5);
        self.state.nwu_from_sensor =
            Some(UnitQuaternion::new_normalize(q.into_inner() + slope * sample.step_s));
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

    fn gyro_bias_rad_s(&self) -> Vector3<f64> {
        -self.state.integral
    }

    fn state(&self) -> &MahonyState {
        &self.state
    }

    fn set_state(&mut self, state: MahonyState) {
        self.state = state;
    }
}
