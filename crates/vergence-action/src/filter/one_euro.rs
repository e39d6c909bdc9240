use super::low_pass::weight;
use super::{KnobError, first_fault};

/// Knobs of the one euro filter (G. Casiez, N. Roussel, D. Vogel, CHI 2012): a low-pass whose cutoff rises with speed. As
/// published, speed is that from the last smoothed value to the new sample, which is more than the true one where the filter lags,
/// the more the higher the rate: `beta` is tuned for one rate. Cost: about 10 ns a sample of three numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OneEuroParams {
    /// Cutoff at rest, Hz, 0.001 to 10,000. Small: steady at rest, slow movements lag. Turn this one first, holding still.
    pub least_cutoff_hz: f64,
    /// By how much the cutoff rises with speed, Hz per (unit/s), which is 1/unit; 0 to 1,000,000. Large: fast movements do not
    /// lag, and jitter. Turn this one second, moving fast. For metres and hands: 10 to 1000.
    pub beta: f64,
    /// Cutoff of the speed itself, Hz, 0.001 to 10,000. Small: the filter notices late that a movement has begun.
    pub speed_cutoff_hz: f64,
}

impl Default for OneEuroParams {
    /// For positions in metres of hands and heads.
    fn default() -> Self {
        Self { least_cutoff_hz: 1.5, beta: 30.0, speed_cutoff_hz: 1.0 }
    }
}

impl OneEuroParams {
    pub(super) fn fault(&self) -> Option<KnobError> {
        first_fault(&[
            ("least_cutoff", self.least_cutoff_hz, 0.001, 10_000.0, "0.001 to 10,000 Hz"),
            ("beta", self.beta, 0.0, 1e6, "0 to 1,000,000 Hz per unit/s"),
            ("speed_cutoff", self.speed_cutoff_hz, 0.001, 10_000.0, "0.001 to 10,000 Hz"),
        ])
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct OneEuro<const N: usize> {
    params: OneEuroParams,
    smooth: [f64; N],
    velocity: [f64; N],
}

impl<const N: usize> OneEuro<N> {
    pub(super) fn new(params: OneEuroParams) -> Self {
        Self { params, smooth: [0.0; N], velocity: [0.0; N] }
    }

    pub(super) fn update(&mut self, passed_s: Option<f64>, value: [f64; N]) -> [f64; N] {
        let Some(passed_s) = passed_s else {
            (self.smooth, self.velocity) = (value, [0.0; N]);
            return value;
        };
        let newer = weight(self.params.speed_cutoff_hz, passed_s);
        let mut square = 0.0;
        for ((velocity, value), smooth) in self.velocity.iter_mut().zip(value).zip(self.smooth) {
            *velocity = newer * ((value - smooth) / passed_s) + (1.0 - newer) * *velocity;
            square += *velocity * *velocity;
        }
        let cutoff_hz = self.params.least_cutoff_hz + self.params.beta * square.sqrt();
        let weight = weight(cutoff_hz, passed_s);
        for (smooth, value) in self.smooth.iter_mut().zip(value) {
            *smooth = weight * value + (1.0 - weight) * *smooth;
        }
        self.smooth
    }
}
