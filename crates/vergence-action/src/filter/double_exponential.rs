use super::{KnobError, first_fault};

/// Knobs of Brown's double exponential smoothing (J. LaViola, EGVE 2003, on tracked motion): what moves evenly does not lag.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DoubleExponentialParams {
    /// Time over which level and slope are averaged, seconds, 0 to 100. Small: little is smoothed. Large: steady at rest and at
    /// constant speed, but it overshoots where the motion turns. Cost: as two low-passes.
    pub time_s: f64,
    /// How far ahead the slope carries the result, seconds, 0 to 1. More predicts, and multiplies the noise by about
    /// 1 + ahead/time.
    pub ahead_s: f64,
}

impl Default for DoubleExponentialParams {
    fn default() -> Self {
        Self { time_s: 0.02, ahead_s: 0.0 }
    }
}

impl DoubleExponentialParams {
    pub(super) fn fault(&self) -> Option<KnobError> {
        first_fault(&[
            ("time", self.time_s, 0.0, 100.0, "0 to 100 s"),
            ("ahead", self.ahead_s, 0.0, 1.0, "0 to 1 s"),
        ])
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct DoubleExponential<const N: usize> {
    params: DoubleExponentialParams,
    once: [f64; N],
    twice: [f64; N],
}

impl<const N: usize> DoubleExponential<N> {
    pub(super) fn new(params: DoubleExponentialParams) -> Self {
        Self { params, once: [0.0; N], twice: [0.0; N] }
    }

    pub(super) fn update(&mut self, passed_s: Option<f64>, value: [f64; N]) -> [f64; N] {
        let Some(passed_s) = passed_s else {
            (self.once, self.twice) = (value, value);
            return value;
        };
        // The share of the old that is left; 0 where nothing is averaged.
        let kept = (-passed_s / self.params.time_s).exp();
        let weight = 1.0 - kept;
        // Slope: what lies between the averages is what the second lags by, passed · kept / weight seconds.
        let ahead = self.params.ahead_s / passed_s * weight / kept.max(f64::MIN_POSITIVE);
        let ahead = if kept > 1e-9 { ahead } else { 0.0 };
        std::array::from_fn(|i| {
            self.once[i] += weight * (value[i] - self.once[i]);
            self.twice[i] += weight * (self.once[i] - self.twice[i]);
            let apart = self.once[i] - self.twice[i];
            self.once[i] + apart + ahead * apart
        })
    }
}
