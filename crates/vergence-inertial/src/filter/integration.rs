use nalgebra::UnitQuaternion;

use super::saved::saved;
use super::turn::{from_directions, renormalised, turn};
use super::{Clean, Core};

/// Integration of the gyroscope alone, from an orientation taken from the first sample: what every other filter must beat.
#[derive(Clone, Debug, Default)]
pub struct Integration {
    state: IntegrationState,
}

/// The orientation so far, if it has started.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct IntegrationState {
    earth_from_sensor: Option<UnitQuaternion<f64>>,
}

saved!(IntegrationState { earth_from_sensor });

impl Core for Integration {
    type State = IntegrationState;

    fn step(&mut self, sample: &Clean) {
        let q = match self.state.earth_from_sensor {
            Some(q) => renormalised(q.into_inner() * turn(&(sample.gyr_rad_s * sample.step_s))),
            None if sample.acc_m_s2.is_none() => return,
            None => from_directions(sample.acc_m_s2.as_ref(), sample.mag_ut.as_ref()),
        };
        self.state.earth_from_sensor = Some(q);
    }

    fn lost(&mut self, _gap_s: f64) {
        self.state.earth_from_sensor = None;
    }

    fn earth_from_sensor(&self) -> UnitQuaternion<f64> {
        self.state.earth_from_sensor.unwrap_or_default()
    }

    fn state(&self) -> &IntegrationState {
        &self.state
    }

    fn set_state(&mut self, state: IntegrationState) {
        self.state = state;
    }
}
