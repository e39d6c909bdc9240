//! Rest, told by the means of windows: vibration and noise average out in them, motion does not.

use nalgebra::Vector3;

use super::params::{VergenceCoefficients, VergenceParams};
use crate::filter::saved::saved;

/// How long the first rest must last to be believed where the rate is beyond the limit of the bias, seconds. A drone warms its
/// rotors up no longer; an even turn of a hand or a turntable may last as long, so what it says stays open to doubt.
const FIRST_REST_S: f64 = 3.0;
/// How long a rest must last that says the first one was none, but an even turn, seconds.
const NO_TURN_S: f64 = 2.0;
/// The largest rate that the first rest may have, radians per second: no gyroscope in use is off by more.
const FIRST_LIMIT: f64 = 20.0 * std::f64::consts::PI / 180.0;

/// Windows that are taken together.
const BLOCK: f64 = 5.0;

/// Sums of the window so far, and what the windows before it were like.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rest {
    gyr: Vector3<f64>,
    acc: Vector3<f64>,
    samples: f64,
    /// Means over the last half second, once there was a window.
    gyr_mean: Vector3<f64>,
    acc_mean: Vector3<f64>,
    running: bool,
    /// Mean square of what the rate of one window differs from that, per axis.
    scatter: f64,
    still_s: f64,
    /// Sum over the windows of this block, their number, and the mean of the block before, if there was one: that is used once
    /// the unit still rests, so that the very beginning of a motion is no bias.
    block: Vector3<f64>,
    blocked: f64,
    before: Option<Vector3<f64>>,
    /// Whether there was a rest since the start.
    found: bool,
}

saved!(Rest {
    gyr,
    acc,
    samples,
    gyr_mean,
    acc_mean,
    running,
    scatter,
    still_s,
    block,
    blocked,
    before,
    found
});

/// What a window says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stillness {
    /// It moved, or it is not known yet.
    Moves,
    /// The unit rests. Now and then with a mean rate, which is its bias, and its variance for each axis.
    Rests { rate: Option<(Vector3<f64>, f64)> },
    /// It rests with a rate that no bias was expected to have: the first rest, or one that shows that the first was an even turn.
    RestsFarOff { rate: Vector3<f64> },
}

impl Rest {
    #[inline]
    pub(super) fn add(&mut self, gyr: &Vector3<f64>, acc: &Vector3<f64>) {
        self.gyr += gyr;
        self.acc += acc;
        self.samples += 1.0;
    }

    /// Ends a window; a bias lies within the limit about `centre`.
    pub(super) fn end(
        &mut self,
        centre: &Vector3<f64>,
        params: &VergenceParams,
        c: &VergenceCoefficients,
    ) -> Stillness {
        let whole = self.samples >= c.window;
        let scale = 1.0 / self.samples.max(1.0);
        let (gyr, acc) = (self.gyr * scale, self.acc * scale);
        self.gyr = Vector3::zeros();
        self.acc = Vector3::zeros();
        self.samples = 0.0;
        if !whole {
            // Without a specific force nothing tells rest from steady turning.
            *self = Self { found: self.found, ..Self::default() };
            return Stillness::Moves;
        }
        let share = if self.running { c.rest_share } else { 1.0 };
        self.running = true;
        self.gyr_mean += (gyr - self.gyr_mean) * share;
        self.acc_mean += (acc - self.acc_mean) * share;
        let turned = (gyr - self.gyr_mean).norm_squared();
        if turned > c.rest_gyr_squared || (acc - self.acc_mean).norm_squared() > c.rest_acc_squared {
            self.forget_rest();
            return Stillness::Moves;
        }
        self.scatter += (turned / 3.0 - self.scatter) * share;
        self.still_s += c.window_s;
        if (self.gyr_mean - centre).amax() > c.bias_limit {
            // Of two rates at rest the smaller one is the bias; the other was an even turn.
            let smaller = self.gyr_mean.norm_squared() < centre.norm_squared();
            let believed = if self.found {
                smaller && self.still_s >= NO_TURN_S
            } else {
                self.still_s >= FIRST_REST_S && self.gyr_mean.amax() <= FIRST_LIMIT
            };
            return if believed { Stillness::RestsFarOff { rate: self.gyr_mean } } else { Stillness::Moves };
        }
        if self.still_s < params.rest_min_s {
            return Stillness::Moves;
        }
        self.found = true;
        self.block += gyr;
        self.blocked += 1.0;
        if self.blocked < BLOCK {
            return Stillness::Rests { rate: None };
        }
        let block = self.block / BLOCK;
        self.block = Vector3::zeros();
        self.blocked = 0.0;
        let before = self.before.replace(block);
        Stillness::Rests { rate: before.map(|rate| (rate, (c.rest_r + self.scatter) / BLOCK)) }
    }

    /// Mean specific force over the last half second, sensor frame.
    pub(super) const fn acc_mean(&self) -> &Vector3<f64> {
        &self.acc_mean
    }

    /// Whether there was a rest since the start.
    pub(super) const fn found(&self) -> bool {
        self.found
    }

    fn forget_rest(&mut self) {
        self.still_s = 0.0;
        self.scatter = 0.0;
        self.block = Vector3::zeros();
        self.blocked = 0.0;
        self.before = None;
    }

    /// Nothing is known about the last moments.
    pub(super) fn lost(&mut self) {
        // What was a rest before the gap was one: an even turn after it is none.
        *self = Self { found: self.found, ..Self::default() };
    }
}
