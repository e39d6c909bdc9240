//! `vergence`: our own filter. See [`Vergence`].

mod field;
mod fields;
mod params;
mod rates;
mod rest;
mod start;

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::low_pass::LowPass;
use super::saved::saved;
use super::turn::{level, renormalised, turn};
use super::{Clean, Core};
use field::{Calmness, FieldWindow};
use fields::Fields;
use rates::{Rates, TiltWindow};
use rest::{Rest, Stillness};
use start::Start;

pub use params::{VergenceCoefficients, VergenceParams};

/// Below this length the low-passed specific force says nothing about up, metres per second squared: free fall.
const NO_GRAVITY: f64 = 1.0;

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
    /// Instead of the low-pass and the rates' own learning, at first and after a loss.
    start: Start,
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
    start,
    samples,
    tilted,
    tilt_window,
    field_window,
});

/// Our own filter. The tilt is found as in VQF: the accelerometer low-passed in an almost inertial frame, where the motion's
/// acceleration averages out. What is different:
///
/// - **It starts in motion**: until the first rest, or for 20 s, up, velocity and bias are found together, from what accelerations are
///   like (9 unknowns, some 70 times a second).
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
            start: Start::new(&Vector3::zeros(), &Vector3::repeat(coefficients.bias_p), &params),
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
        s.start = Start::new(&s.rates.bias(), &s.rates.bias_p(), &next.params);
        // Not the field: whatever misled it is met from the other side with an open mind.
        next
    }

    /// Offset of the magnetometer as far as it is known, microteslas, sensor frame.
    pub fn mag_offset_ut(&self) -> Vector3<f64> {
        self.state.field.offset_ut()
    }

    /// Turns the level frame so that `up`, of the inertial frame, is up in it. The field and its readings stay as they are in space.
    fn level_to(&mut self, up: &Vector3<f64>) {
        let s = &mut self.state;
        let up = s.level_from_inertial * up;
        let length = up.norm();
        if length > NO_GRAVITY {
            let turn = renormalised(level(&(up / length)));
            s.level_from_inertial = renormalised(turn.into_inner() * s.level_from_inertial.into_inner());
            s.field.turned(&turn);
            s.field_window.turned(&turn);
        }
        self.find_north();
    }

    /// Turns the level frame to north: where the field says, or, before there is one, where the first readings say.
    fn find_north(&mut self) {
        let s = &mut self.state;
        if let Some(heading) = s.field.heading_rad().or(s.field_window.heading_rad()) {
            s.earth_from_level = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading);
        }
    }

    /// Goes on from what the start has found.
    fn end_start(&mut self) {
        let (s, c) = (&mut self.state, &self.coefficients);
        s.rates.begin(s.start.bias(), &s.start.bias_p(), c);
        s.acc_low = LowPass::resting(&s.start.gravity(), &c.acc);
        s.tilt_window = TiltWindow::default();
        s.tilted = 0.0;
    }

    fn end_window(&mut self) {
        let (s, p, c) = (&mut self.state, &self.params, &self.coefficients);
        let stillness = s.rest.end(s.rates.centre(), p, c);
        if let Stillness::RestsFarOff { rate } = stillness {
            // What was thought to be motion was bias: all but that starts anew.
            s.rates.centre_on(rate, c);
            let rest = s.rest.clone();
            self.lost(0.0);
            self.state.rest = rest;
            return;
        }
        let rested = matches!(stillness, Stillness::Rests { .. });
        let calmness = match rested {
            true => Calmness::Rests,
            false if s.start.runs() => Calmness::Settles,
            false => Calmness::Moves,
        };
        if s.start.runs() {
            if rested {
                s.start.rest(&(s.inertial_from_sensor * s.rest.acc_mean()));
                self.end_start();
                let gravity = self.state.start.gravity();
                self.level_to(&gravity);
            }
        } else if s.tilted >= c.window {
            // A window with holes says what it says about fewer samples; it is not used.
            s.rates.learn(&s.tilt_window, stillness, s.rest.found(), p, c);
        }
        let (s, p, c) = (&mut self.state, &self.params, &self.coefficients);
        // A slow magnetometer says something in some windows only.
        s.field_window.length_s = (s.field_window.length_s + c.window_s).min(FIELD_LONGEST_S);
        if s.field_window.samples > 0.0 {
            s.field.learn(&s.field_window, calmness, p, c);
            s.field_window = FieldWindow::default();
            self.find_north();
        }
        let s = &mut self.state;
        s.tilt_window = TiltWindow::default();
        s.samples = 0.0;
        s.tilted = 0.0;
    }

    /// Adds a reading of the magnetometer, if there is one, to its window.
    #[inline]
    fn add_field(&mut self, r: &Matrix3<f64>, mag_ut: Option<&Vector3<f64>>) {
        if let Some(mag) = mag_ut {
            let s = &mut self.state;
            s.field_window.add(r, &caught_up(mag, &s.rate, self.coefficients.mag_lag_s), s.rate.norm());
        }
    }

    /// A sample of the start.
    #[cold]
    fn step_start(&mut self, sample: &Clean, inertial: &Rotation3<f64>, felt: bool) {
        let (s, p, c) = (&mut self.state, &self.params, &self.coefficients);
        let acc = felt.then_some(&s.acc_inertial);
        let changed = s.start.add(inertial.matrix(), acc, sample.step_s, p, c);
        if felt {
            let level = s.level_from_inertial.to_rotation_matrix();
            self.add_field(&(level * inertial).into_inner(), sample.mag_ut.as_ref());
        }
        if changed {
            let s = &mut self.state;
            s.rates.set_bias(s.start.bias());
            if !s.start.runs() {
                self.end_start();
            }
            let gravity = self.state.start.gravity();
            self.level_to(&gravity);
        }
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
        let mut felt = true;
        if let Some(acc) = &sample.acc_m_s2 {
            s.acc = *acc;
            s.acc_inertial = inertial * caught_up(acc, &rate, c.acc_lag_s);
            s.acc_left_s = HELD_S;
        } else {
            // What stands still while readings are missing is the direction in space, not in the sensor.
            felt = s.acc_left_s > 0.0;
            s.acc_left_s -= sample.step_s;
        }
        if s.start.runs() {
            self.step_start(sample, &inertial, felt);
        } else if felt {
            let up = s.level_from_inertial * s.acc_low.step(&s.acc_inertial, &c.acc);
            let length = up.norm();
            if length > NO_GRAVITY {
                let up = up / length;
                s.level_from_inertial = renormalised(level(&up) * s.level_from_inertial.into_inner());
                let level = s.level_from_inertial.to_rotation_matrix();
                let r = (level * inertial).into_inner();
                s.tilt_window.add(&r, &unbiased, &up, &(level * s.acc_inertial));
                s.tilted += 1.0;
                self.add_field(&r, sample.mag_ut.as_ref());
            }
        }
        let s = &mut self.state;
        if felt {
            s.rest.add(&sample.gyr_rad_s, &s.acc);
        }
        if s.samples >= self.coefficients.window {
            self.end_window();
        }
    }

    fn lost(&mut self, gap_s: f64) {
        let (s, c) = (&mut self.state, &self.coefficients);
        s.acc_low = LowPass::default();
        s.acc_left_s = 0.0;
        s.rest.lost();
        s.samples = 0.0;
        s.tilted = 0.0;
        s.tilt_window = TiltWindow::default();
        s.field_window = FieldWindow::default();
        s.rates.lost(gap_s, c);
        s.start = Start::new(&s.rates.bias(), &s.rates.bias_p(), &self.params);
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
