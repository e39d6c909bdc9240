use nalgebra::UnitQuaternion;

use super::saved::saved;
use super::turn::{from_directions, level, renormalised, turn, wrapped};
use super::{Clean, Core};

/// Knobs of the complementary filter.
#[derive(Clone, Copy, Debug, PartialEq, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ComplementaryParams {
    /// Time constant of the pull towards the accelerometer's up, seconds; 0.1 to 30. Small: acceleration of the sensor tilts
    /// it. Large: gyroscope bias does. Default 3. Costs nothing.
    pub tau_acc_s: f64,
    /// Time constant of the pull towards the magnetometer's north, seconds; 0.1 to 100. Default 9. Costs nothing.
    pub tau_mag_s: f64,
}

impl Default for ComplementaryParams {
    fn default() -> Self {
        Self { tau_acc_s: 3.0, tau_mag_s: 9.0 }
    }
}

/// The gyroscope integrated, with a first-order pull towards up and north: the simplest filter that does not drift.
#[derive(Clone, Debug)]
pub struct Complementary {
    params: ComplementaryParams,
    state: ComplementaryState,
}

/// The orientation so far, if it has started.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ComplementaryState {
    earth_from_sensor: Option<UnitQuaternion<f64>>,
}

saved!(ComplementaryState { earth_from_sensor });

impl Complementary {
    /// A filter that starts with its first sample.
    pub fn new(params: ComplementaryParams) -> Self {
        Self { params, state: ComplementaryState::default() }
    }
}

impl Core for Complementary {
    type State = ComplementaryState;

    fn step(&mut self, sample: &Clean) {
        let Some(q) = self.state.earth_from_sensor else {
            if sample.acc_m_s2.is_some() {
                self.state.earth_from_sensor =
                    Some(from_directions(sample.acc_m_s2.as_ref(), sample.mag_ut.as_ref()));
            }
            return;
        };
        let mut q = renormalised(q.into_inner() * turn(&(sample.gyr_rad_s * sample.step_s)));
        if let Some(up) = sample.acc_m_s2.map(|acc| (q * acc).normalize()) {
            let full = UnitQuaternion::new_normalize(level(&up)).scaled_axis();
            let gain = 1.0 - (-sample.step_s / self.params.tau_acc_s).exp();
            q = renormalised(turn(&(full * gain)) * q.into_inner());
        }
        if let Some(field) = sample.mag_ut.map(|mag| q * mag) {
            let gain = 1.0 - (-sample.step_s / self.params.tau_mag_s).exp();
            let heading = gain * wrapped(field.x.atan2(field.y));
            q = renormalised(turn(&nalgebra::Vector3::new(0.0, 0.0, heading)) * q.into_inner());
        }
        self.state.earth_from_sensor = Some(q);
    }

    fn lost(&mut self, _gap_s: f64) {
        self.state.earth_from_sensor = None;
    }

    fn earth_from_sensor(&self) -> UnitQuaternion<f64> {
        self.state.earth_from_sensor.unwrap_or_default()
    }

    fn state(&self) -> &ComplementaryState {
        &self.state
    }

    fn set_state(&mut self, state: ComplementaryState) {
        self.state = state;
    }
}
