//! `vergence`: our own filter. See [`Vergence`].

mod field;
mod fields;
mod params;
mod rates;
mod rest;

use nalgebra::{UnitQuaternion, Vector3};

use super::low_pass::LowPass;
use super::saved::saved;
use super::turn::{level, renormalised, turn};
use super::{Clean, Core};
use field::{Calmness, FieldWindow};
use fields::Fields;
use rates::{Rates, TiltWindow};
use rest::{Rest, Stillness};

pub use params::{VergenceCoefficients, VergenceParams};

/// Below this length the low-passed specific force says nothing about up, metres per second squared: free fall.
const NO_GRAVITY: f64 = 1.0;

/// After so many time constants of the accelerometer's low-pass the tilt is right also from a start in motion.
const SETTLED: f64 = 2.0;

/// The longest time that one reading of the magnetometer stands for, seconds.
const FIELD_LONGEST_S: f64 = 1.0;

/// The longest time that a reading of the accelerometer stands for those that are missing, seconds: it may be slower than the
/// gyroscope.
const HELD_S: f64 = 0.25;

/// All that changes from sample to sample.
#[derive(Clone, Debug, PartialEq)]
pub struct VergenceState {
    inertial_from_sensor: UnitQuaternion<f64>,
    level_from_inertial: UnitQuaternion<f64>,
    earth_from_level: UnitQuaternion<f64>,
    /// The newest corrected rate, by which the answer is turned on.
    rate: Vector3<f64>,
    rates: Rates,
    field: Fields,
    acc_low: LowPass<3>,
    /// The newest reading of the accelerometer, in the sensor and in the inertial frame, and how much longer it may stand in.
    acc: Vector3<f64>,
    acc_inertial: Vector3<f64>,
    acc_left_s: f64,
    rest: Rest,
    /// Whether up has been seen since the start or the last loss.
    started: bool,
    /// Seconds since then.
    levelled_s: f64,
    samples: f64,
    /// Samples of the window that had a specific force.
    tilted: f64,
    tilt_window: TiltWindow,
    field_window: FieldWindow,
}

saved!(VergenceState {
    inertial_from_sensor,
    level_from_inertial,
    earth_from_level,
    rate,
    rates,
    field,
    acc_low,
    acc,
    acc_inertial,
    acc_left_s,
    rest,
    started,
    levelled_s,
    samples,
    tilted,
    tilt_window,
    field_window,
});

/// Our own filter. The tilt is found as in VQF: the accelerometer low-passed in an almost inertial frame, where the motion's
/// acceleration averages out. What is different:
///
/// - **The sensors' lag is taken out**: the answer is for now, not for when the reading was true.
/// - **Scale and cross-axis errors of the gyroscope are learned** with its bias, from the tilt that they cause (12 unknowns,
///   corrected ten times a second). What is learned about an axis while it lies also serves when it stands: the heading's
///   drift, which gravity does not see.
/// - **Field and offset of the magnetometer are learned together** (6 unknowns): a magnet on the device is an offset that turns
///   with it, the earth's field is not. The heading follows the field's estimate. A deviation that stays with the sensor is
///   a magnet attached or removed, and only the offset follows; one that does not is a magnet in the room, and has little weight.
#[derive(Clone, Debug)]
pub struct Vergence {
    params: VergenceParams,
    coefficients: VergenceCoefficients,
    state: VergenceState,
}

impl Vergence {
    /// A filter at its start, for samples every `period_s` seconds.
    pub fn new(params: VergenceParams, period_s: f64) -> Self {
        let coefficients = VergenceCoefficients::new(&params, period_s);
        let state = VergenceState {
            inertial_from_sensor: UnitQuaternion::identity(),
            level_from_inertial: UnitQuaternion::identity(),
            earth_from_level: UnitQuaternion::identity(),
            rate: Vector3::zeros(),
            rates: Rates::new(&params, &coefficients),
            field: Fields::new(&params),
            acc_low: LowPass::default(),
            acc: Vector3::zeros(),
            acc_inertial: Vector3::zeros(),
            acc_left_s: 0.0,
            rest: Rest::default(),
            started: false,
            levelled_s: 0.0,
            samples: 0.0,
            tilted: 0.0,
            tilt_window: TiltWindow::default(),
            field_window: FieldWindow::default(),
        };
        Self { params, coefficients, state }
    }

    /// A filter with other parameters that starts with what this one learned about the gyroscope; with `backwards`, for the same
    /// recording from its end.
    pub(crate) fn learned(&self, params: VergenceParams, backwards: bool) -> Self {
        let mut next = Self::new(params, self.coefficients.period_s);
        let s = &mut next.state;
        if backwards {
            s.rates = self.state.rates.reversed(&next.coefficients);
        } else {
            s.rates = self.state.rates.clone();
            s.rates.lost(0.0, &next.coefficients);
        }
        // Not the field: whatever misled it is met from the other side with an open mind.
        next
    }

    /// Offset of the magnetometer as far as it is known, microteslas, sensor frame.
    pub fn mag_offset_ut(&self) -> Vector3<f64> {
        self.state.field.offset_ut()
    }

    fn end_window(&mut self) {
        let (s, p, c) = (&mut self.state, &self.params, &self.coefficients);
        let stillness = s.rest.end(s.rates.centre(), p, c);
        if let Stillness::RestsFarOff { rate } = stillness {
            // What was thought to be motion was bias: all but that starts anew.
            let rest = s.rest.clone();
            self.lost(0.0);
            self.state.rest = rest;
            self.state.rates.centre_on(rate, &self.coefficients);
            return;
        }
        let rested = matches!(stillness, Stillness::Rests { .. });
        s.levelled_s = if s.started { s.levelled_s + c.window_s } else { 0.0 };
        let calmness = match rested {
            true => Calmness::Rests,
            false if s.levelled_s < SETTLED * p.tau_acc_s => Calmness::Settles,
            false => Calmness::Moves,
        };
        // A window with holes says what it says about fewer samples; it is not used.
        if s.tilted >= c.window {
            s.rates.learn(&s.tilt_window, stillness, s.rest.found(), p, c);
        }
        // A slow magnetometer says something in some windows only.
        s.field_window.length_s = (s.field_window.length_s + c.window_s).min(FIELD_LONGEST_S);
        if s.field_window.samples > 0.0 {
            s.field.learn(&s.field_window, calmness, p, c);
            s.earth_from_level = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), s.field.heading_rad());
            s.field_window = FieldWindow::default();
        }
        s.tilt_window = TiltWindow::default();
        s.samples = 0.0;
        s.tilted = 0.0;
    }
}

/// A reading of a fixed direction as it is now, when it was true `lag_s` ago.
#[inline]
fn caught_up(reading: &Vector3<f64>, rate: &Vector3<f64>, lag_s: f64) -> Vector3<f64> {
    reading - rate.cross(reading) * lag_s
}

impl Core for Vergence {
    type State = VergenceState;

    #[inline]
    fn step(&mut self, sample: &Clean) {
        let (s, c) = (&mut self.state, &self.coefficients);
        let unbiased = s.rates.unbiased(&sample.gyr_rad_s);
        let rate = s.rates.corrected(&unbiased);
        s.rate = rate;
        s.inertial_from_sensor =
            renormalised(s.inertial_from_sensor.into_inner() * turn(&(rate * sample.step_s)));
        s.samples += 1.0;
        let inertial = s.inertial_from_sensor.to_rotation_matrix();
        if let Some(acc) = &sample.acc_m_s2 {
            s.acc = *acc;
            s.acc_inertial = inertial * caught_up(acc, &rate, c.acc_lag_s);
            s.acc_left_s = HELD_S;
        } else if s.acc_left_s > 0.0 {
            // What stands still while readings are missing is the direction in space, not in the sensor.
            s.acc_left_s -= sample.step_s;
        } else {
            if s.samples >= c.window {
                self.end_window();
            }
            return;
        }
        let acc_inertial = s.acc_inertial;
        let mean = s.acc_low.step(&acc_inertial, &c.acc);
        let up = s.level_from_inertial * mean;
        let length = up.norm();
        if length > NO_GRAVITY {
            let up = up / length;
            s.level_from_inertial = renormalised(level(&up) * s.level_from_inertial.into_inner());
            let level = s.level_from_inertial.to_rotation_matrix();
            let r = (level * inertial).into_inner();
            // The first one is no correction, but where it all starts.
            let up = if s.started { up } else { Vector3::z() };
            s.started = true;
            s.tilt_window.add(&r, &unbiased, &up, &(level * acc_inertial));
            s.tilted += 1.0;
            if let Some(mag) = &sample.mag_ut {
                s.field_window.add(&r, &caught_up(mag, &rate, c.mag_lag_s), rate.norm());
            }
        }
        s.rest.add(&sample.gyr_rad_s, &s.acc);
        if s.samples >= c.window {
            self.end_window();
        }
    }

    fn lost(&mut self, gap_s: f64) {
        let (s, c) = (&mut self.state, &self.coefficients);
        s.acc_low = LowPass::default();
        s.acc_left_s = 0.0;
        s.rest.lost();
        s.started = false;
        s.levelled_s = 0.0;
        s.samples = 0.0;
        s.tilted = 0.0;
        s.tilt_window = TiltWindow::default();
        s.field_window = FieldWindow::default();
        s.rates.lost(gap_s, c);
        s.field.lost();
    }

    #[inline]
    fn earth_from_sensor(&self) -> UnitQuaternion<f64> {
        let s = &self.state;
        let now = s.inertial_from_sensor.into_inner() * turn(&(s.rate * self.coefficients.ahead_s));
        renormalised(s.earth_from_level.into_inner() * s.level_from_inertial.into_inner() * now)
    }

    fn gyro_bias_rad_s(&self) -> Vector3<f64> {
        self.state.rates.bias()
    }

    fn state(&self) -> &VergenceState {
        &self.state
    }

    fn set_state(&mut self, state: VergenceState) {
        self.state = state;
    }
}
