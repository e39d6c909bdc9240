//! Robust kernels: how much a residual counts, by its length.

/// ρ(s) of a squared, whitened residual s = rᵀr: the cost is ½ ρ(s), and a row counts with the weight ρ'(s) (iteratively
/// reweighted least squares).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kernel {
    /// ρ(s) = s.
    Square,
    /// Huber's: quadratic up to this length, linear beyond it. P. Huber, "Robust Estimation of a Location Parameter", 1964.
    Huber(f64),
    /// Cauchy's: c² ln(1 + s/c²), which grows ever more slowly beyond this length c.
    Cauchy(f64),
}

impl Kernel {
    /// ρ(s) and ρ'(s) for s ≥ 0.
    #[inline]
    pub fn of(self, square: f64) -> (f64, f64) {
        match self {
            Self::Square => (square, 1.0),
            Self::Huber(bound) if square <= bound * bound => (square, 1.0),
            Self::Huber(bound) => {
                let length = square.sqrt();
                (2.0 * bound * length - bound * bound, bound / length)
            }
            Self::Cauchy(scale) => {
                let (c2, ratio) = (scale * scale, square / (scale * scale));
                (c2 * ratio.ln_1p(), 1.0 / (1.0 + ratio))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn the_weight_is_the_derivative(length in 1e-6..50f64, bound in 0.3..4f64) {
            for kernel in [Kernel::Square, Kernel::Huber(bound), Kernel::Cauchy(bound)] {
                let (s, h) = (length * length, 1e-6 * length * length);
                let numeric = (kernel.of(s + h).0 - kernel.of(s - h).0) / (2.0 * h);
                prop_assert!((kernel.of(s).1 - numeric).abs() < 1e-5, "{kernel:?} {s}: {numeric}");
                prop_assert!(kernel.of(s).0 <= s * (1.0 + 1e-12));
            }
        }
    }
}
