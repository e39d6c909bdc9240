//! The earth's magnetic field and the magnetometer's offset, told apart by turning.

use nalgebra::{Matrix3, SVector, UnitQuaternion, Vector3};

use super::params::{VergenceCoefficients, VergenceParams};
use crate::filter::kalman::Estimate;
use crate::filter::saved::saved;

/// Variance of a field that is not known, µT².
const UNKNOWN: f64 = 900.0;
/// Largest variance of the field, and of the offset, µT²: a magnet at the sensor may be as strong as it likes.
const WIDEST: f64 = 2500.0;
const WIDEST_OFFSET: f64 = 20_000.0;
/// Largest square of a deviation that counts for learning an attached magnet, µT².
const JUMP_MOST: f64 = 400.0;
/// Time constant over which a deviation must stay with the sensor, seconds.
const JUMP_TAU_S: f64 = 1.5;
/// The share of the deviation that stays with the sensor counts with this power: a magnet in the room has little.
const JUMP_POWER: i32 = 3;
/// Drift of the level frame's heading: standard deviation in degrees per second at rest in motion, and per degree of turn.
const DRIFT_DEG_S: f64 = 0.01;
const DRIFT_PER_TURN: f64 = 0.0003;
/// Over this time drift keeps its direction, seconds.
const DRIFT_TIME_S: f64 = 10.0;
/// Wander of field and offset, µT in one second.
const FIELD_WANDER: f64 = 0.02;
const OFFSET_WANDER: f64 = 0.01;
/// How much less all that is while nothing moves.
const REST_FACTOR: f64 = 0.1;
/// Power with which outliers lose weight, and the part of them that does not where all of it stays with the sensor: that is
/// learned, not waited out.
const OUTLIER_POWER: f64 = 0.8;
const OUTLIER_SPARED: f64 = 0.9;
/// Root mean square of the deviation below which the field counts as confirmed by turning, µT.
const CONFIRMED_UT: f64 = 4.0;
/// Seconds of turning after which it is fully confirmed, and the most that is kept for bad times.
const CONFIRMED_S: f64 = 5.0;
const CONFIRMED_MOST_S: f64 = 40.0;
/// How fast confirmation is lost while readings deviate, seconds per second.
const CONFIRMED_LOSS: f64 = 0.3;
/// While the tilt settles the field is the mean over this time at most, seconds.
const SETTLING_TAU_S: f64 = 3.0;
/// The rate from which turning counts, radians per second.
pub(super) const TURNING: f64 = 20.0 * std::f64::consts::PI / 180.0;

/// Field in the level frame (3) and offset in the sensor frame (3), microteslas.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    pub(super) estimate: Estimate<6>,
    pub(super) known: bool,
    /// Over how much of the start it is a mean, seconds.
    settled_s: f64,
    /// Low-passed deviation in the sensor frame, and its square.
    deviation: Vector3<f64>,
    deviation_squared: f64,
    /// Seconds of turning in agreement.
    confirmed_s: f64,
}

saved!(Field { estimate, known, settled_s, deviation, deviation_squared, confirmed_s });

/// What one window of samples says.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FieldWindow {
    /// Sums of the reading in the level frame and of that frame's rotation.
    field: Vector3<f64>,
    level: Matrix3<f64>,
    rate: f64,
    pub(super) samples: f64,
    /// How long it took to gather them, seconds: longer than a window where the magnetometer is slow.
    pub(super) length_s: f64,
}

saved!(FieldWindow { field, level, rate, samples, length_s });

/// How still the unit is, and whether it is known what is up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Calmness {
    /// It has just started: what is up may still be wrong.
    Settles,
    /// It moves.
    Moves,
    /// It rests.
    Rests,
}

/// What a deviation that stays with the sensor is taken for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Jump {
    /// A magnet attached or removed.
    Magnet,
    /// Another field, while nothing turns and turning has not confirmed the one that is known.
    Room,
}

impl FieldWindow {
    #[inline]
    pub(super) fn add(&mut self, r: &Matrix3<f64>, mag: &Vector3<f64>, rate: f64) {
        self.field += r * mag;
        self.level += r;
        self.rate += rate;
        self.samples += 1.0;
    }

    /// The level frame was turned by `turn`.
    pub(super) fn turned(&mut self, turn: &UnitQuaternion<f64>) {
        let turn = turn.to_rotation_matrix();
        self.field = turn * self.field;
        self.level = turn * self.level;
    }

    /// As [`Field::heading_rad`], of these readings alone.
    pub(super) fn heading_rad(&self) -> Option<f64> {
        (self.samples > 0.0).then(|| self.field.x.atan2(self.field.y))
    }

    /// Mean rate of turning, radians per second.
    pub(super) fn mean_rate(&self) -> f64 {
        self.rate / self.samples
    }
}

impl Field {
    pub(super) fn new(params: &VergenceParams) -> Self {
        let offset = params.offset_sigma_ut.powi(2);
        let p = SVector::from([UNKNOWN, UNKNOWN, UNKNOWN, offset, offset, offset]);
        Self {
            estimate: Estimate { x: SVector::zeros(), p: nalgebra::SMatrix::from_diagonal(&p) },
            known: false,
            settled_s: 0.0,
            deviation: Vector3::zeros(),
            deviation_squared: 0.0,
            confirmed_s: 0.0,
        }
    }

    /// The angle from the level frame's y to magnetic north, radians clockwise: what the frame must be turned by; once there was a field.
    pub(super) fn heading_rad(&self) -> Option<f64> {
        self.known.then(|| self.estimate.x[0].atan2(self.estimate.x[1]))
    }

    /// Learns from one window; gives the square of what it deviated by, µT².
    pub(super) fn learn(
        &mut self,
        window: &FieldWindow,
        calmness: Calmness,
        jump_is: Jump,
        params: &VergenceParams,
        c: &VergenceCoefficients,
    ) -> f64 {
        let step_s = window.length_s;
        let scale = 1.0 / window.samples;
        let (mean, level, rate) = (window.field * scale, window.level * scale, window.rate * scale);
        if !self.known {
            let field = mean - level * self.estimate.x.fixed_rows::<3>(3);
            self.estimate.x.fixed_rows_mut::<3>(0).copy_from(&field);
            self.known = true;
            self.settled_s = step_s;
            return 0.0;
        }
        if calmness == Calmness::Settles {
            // A tilt that is still wrong turns the field: that is no magnet.
            let field = mean - level * self.estimate.x.fixed_rows::<3>(3);
            self.settled_s = (self.settled_s + step_s).min(SETTLING_TAU_S);
            let share = (step_s / self.settled_s).min(1.0);
            for i in 0..3 {
                self.estimate.x[i] += (field[i] - self.estimate.x[i]) * share;
            }
            return 0.0;
        }
        let e = &mut self.estimate;
        let calm = if calmness == Calmness::Rests { REST_FACTOR } else { 1.0 };
        let drift = (DRIFT_DEG_S * calm).to_radians() + DRIFT_PER_TURN * rate;
        let drift = drift * drift * DRIFT_TIME_S * step_s;
        let tangent = [e.x[1], -e.x[0]];
        for i in 0..2 {
            for j in 0..2 {
                e.p[(i, j)] += drift * tangent[i] * tangent[j];
            }
        }
        let deviation = mean - e.x.fixed_rows::<3>(0) - level * e.x.fixed_rows::<3>(3);
        let squared = deviation.norm_squared();
        let share = (step_s / JUMP_TAU_S).min(1.0);
        self.deviation += (level.tr_mul(&deviation) - self.deviation) * share;
        self.deviation_squared += (squared - self.deviation_squared) * share;
        let stays = self.deviation.norm_squared();
        // A tenth of a microtesla squared keeps noise from looking like a magnet.
        let coherent = (stays / (self.deviation_squared + 0.1)).powi(JUMP_POWER);
        let jump = ((stays - c.jump_squared).max(0.0) * coherent).min(JUMP_MOST) * step_s;
        if self.deviation_squared < CONFIRMED_UT * CONFIRMED_UT {
            let gained = step_s * rate / (rate + TURNING);
            self.confirmed_s = (self.confirmed_s + gained).min(CONFIRMED_MOST_S);
        } else {
            self.confirmed_s = (self.confirmed_s - CONFIRMED_LOSS * step_s).max(0.0);
        }
        // A jump while nothing turns is a magnet at the sensor or near it, not another earth.
        let unsure = (1.0 - self.confirmed_s / CONFIRMED_S).max(0.0);
        let (field_jump, offset_jump) = if rate > TURNING {
            (params.jump_field * unsure, params.jump_offset)
        } else if jump_is == Jump::Room {
            (params.jump_offset * unsure, params.jump_offset * (1.0 - unsure))
        } else {
            (0.0, params.jump_offset)
        };
        let still = 1.0 + c.motion / (rate + 0.1 * c.motion);
        let r = c.field_r * (c.window_s / step_s) * still;
        let field_wander = FIELD_WANDER * FIELD_WANDER * calm * step_s + field_jump * jump;
        let offset_wander = OFFSET_WANDER * OFFSET_WANDER * step_s + offset_jump * jump;
        for i in 0..3 {
            e.widen(i, field_wander, WIDEST);
            e.widen(3 + i, offset_wander, WIDEST_OFFSET);
        }
        let strange = squared * (1.0 - OUTLIER_SPARED * coherent);
        let outlier = 1.0 + (strange / c.outlier_squared).powf(OUTLIER_POWER);
        let r = r * outlier;
        for i in 0..3 {
            let mut row = SVector::<f64, 6>::zeros();
            row[i] = 1.0;
            for j in 0..3 {
                row[3 + j] = level[(i, j)];
            }
            e.observe(&row, mean[i], r);
        }
        squared
    }

    /// The level frame was turned by `turn`.
    pub(super) fn turned(&mut self, turn: &UnitQuaternion<f64>) {
        let field = turn * self.estimate.x.fixed_rows::<3>(0).into_owned();
        self.estimate.x.fixed_rows_mut::<3>(0).copy_from(&field);
    }

    /// The heading is lost; the offset is not.
    pub(crate) fn lost(&mut self) {
        for i in 0..3 {
            self.estimate.forget(i, UNKNOWN);
        }
        self.known = false;
        self.settled_s = 0.0;
        self.deviation = Vector3::zeros();
        self.deviation_squared = 0.0;
    }
}
