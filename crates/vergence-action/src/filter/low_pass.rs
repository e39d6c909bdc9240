use super::{KnobError, first_fault};

/// Knobs of the first-order low-pass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LowPassParams {
    /// What swings faster is damped, Hz, 0.001 to 10,000. Small: steady, but everything lags by 1/(2π cutoff): 16 ms at 10 Hz,
    /// 160 ms at 1 Hz. Cost: one multiplication a number.
    pub cutoff_hz: f64,
}

impl Default for LowPassParams {
    fn default() -> Self {
        Self { cutoff_hz: 10.0 }
    }
}

impl LowPassParams {
    pub(super) fn fault(&self) -> Option<KnobError> {
        first_fault(&[("cutoff", self.cutoff_hz, 0.001, 10_000.0, "0.001 to 10,000 Hz")])
    }
}

/// The weight of a new sample after `passed_s`, of a low-pass with this cutoff; positive, at most 1.
pub(super) fn weight(cutoff_hz: f64, passed_s: f64) -> f64 {
    let relative = std::f64::consts::TAU * cutoff_hz * passed_s;
    if relative.is_finite() { relative / (1.0 + relative) } else { 1.0 }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct LowPass<const N: usize> {
    params: LowPassParams,
    smooth: [f64; N],
}

impl<const N: usize> LowPass<N> {
    pub(super) fn new(params: LowPassParams) -> Self {
        Self { params, smooth: [0.0; N] }
    }

    pub(super) fn update(&mut self, passed_s: Option<f64>, value: [f64; N]) -> [f64; N] {
        let weight = passed_s.map_or(1.0, |passed_s| weight(self.params.cutoff_hz, passed_s));
        for (smooth, value) in self.smooth.iter_mut().zip(value) {
            *smooth = weight * value + (1.0 - weight) * *smooth;
        }
        self.smooth
    }
}
