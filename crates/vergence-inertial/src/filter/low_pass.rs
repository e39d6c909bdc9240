//! The second-order Butterworth low-pass that starts with a plain mean.

use nalgebra::SVector;

use super::saved::Saved;

/// Coefficients of a low-pass with time constant `tau`, for one sampling period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LowPassCoefficients {
    b0: f64,
    a1: f64,
    a2: f64,
    /// Samples whose mean starts the filter.
    start_samples: f64,
}

impl LowPassCoefficients {
    /// A Butterworth low-pass of second order whose cutoff is `1 / (√2 π tau)` hertz, by the bilinear transform; `tau_s` and
    /// `period_s` in seconds. At least two samples per cutoff period are kept, so that a slow stream does not make it ring.
    /// Source: Laidig and Seel, VQF (2023), section 3.3; the transform is in any text on digital filters.
    pub fn new(tau_s: f64, period_s: f64) -> Self {
        let cutoff = std::f64::consts::SQRT_2 / (2.0 * std::f64::consts::PI * tau_s);
        let c = (std::f64::consts::PI * (cutoff * period_s).min(0.4)).tan();
        let d = c * c + std::f64::consts::SQRT_2 * c + 1.0;
        Self {
            b0: c * c / d,
            a1: 2.0 * (c * c - 1.0) / d,
            a2: (1.0 - std::f64::consts::SQRT_2 * c + c * c) / d,
            start_samples: (tau_s / period_s).max(1.0),
        }
    }
}

/// State of a low-pass over `N` channels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LowPass<const N: usize> {
    /// Before the start is over: the sum of the samples. After it: the first delay.
    first: SVector<f64, N>,
    second: SVector<f64, N>,
    /// Samples seen while it starts; negative once it runs.
    started: f64,
}

impl<const N: usize> Default for LowPass<N> {
    fn default() -> Self {
        Self { first: SVector::zeros(), second: SVector::zeros(), started: 0.0 }
    }
}

impl<const N: usize> LowPass<N> {
    /// Feeds one sample and gives the filtered value: over the first time constant the mean, then the low-pass that starts
    /// from it at rest.
    #[inline]
    pub fn step(&mut self, x: &SVector<f64, N>, c: &LowPassCoefficients) -> SVector<f64, N> {
        if self.started < 0.0 {
            let y = x * c.b0 + self.first;
            self.first = x * (2.0 * c.b0) - y * c.a1 + self.second;
            self.second = x * c.b0 - y * c.a2;
            return y;
        }
        self.start(x, c)
    }

    #[cold]
    fn start(&mut self, x: &SVector<f64, N>, c: &LowPassCoefficients) -> SVector<f64, N> {
        self.started += 1.0;
        self.first += x;
        let mean = self.first / self.started;
        if self.started >= c.start_samples {
            *self = Self::resting(&mean, c);
        }
        mean
    }

    /// The state of a filter that has seen `value` for ever.
    pub fn resting(value: &SVector<f64, N>, c: &LowPassCoefficients) -> Self {
        Self { first: value * (1.0 - c.b0), second: value * (c.b0 - c.a2), started: -1.0 }
    }
}

impl<const N: usize> Saved for LowPass<N> {
    fn put(&self, out: &mut Vec<u8>) {
        self.first.put(out);
        self.second.put(out);
        self.started.put(out);
    }
    fn take(from: &mut &[u8]) -> Option<Self> {
        Some(Self { first: Saved::take(from)?, second: Saved::take(from)?, started: Saved::take(from)? })
    }
}
