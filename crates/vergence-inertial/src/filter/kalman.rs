use nalgebra::{SMatrix, SVector};

use super::saved::Saved;

/// What is believed about `N` quantities: mean and covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate<const N: usize> {
    /// Mean.
    pub x: SVector<f64, N>,
    /// Covariance, symmetric.
    pub p: SMatrix<f64, N, N>,
}

impl<const N: usize> Estimate<N> {
    /// Takes one scalar observation `y = row · x + noise` of variance `r` (the update of any text on Kalman filters; no matrix
    /// is inverted).
    #[inline]
    pub fn observe(&mut self, row: &SVector<f64, N>, y: f64, r: f64) {
        let p_row = self.p * row;
        let s = r + row.dot(&p_row);
        // A variance that is not positive has nothing to say (also where rounding ate it up).
        if s.is_nan() || s <= 0.0 {
            return;
        }
        let scale = 1.0 / s;
        self.x += p_row * ((y - row.dot(&self.x)) * scale);
        for j in 0..N {
            let factor = p_row[j] * scale;
            for i in 0..N {
                self.p[(i, j)] -= p_row[i] * factor;
            }
        }
    }

    /// Lets the variance of quantity `i` grow by `by`, up to `limit`.
    #[inline]
    pub fn widen(&mut self, i: usize, by: f64, limit: f64) {
        let p = &mut self.p[(i, i)];
        if *p < limit {
            *p = (*p + by).min(limit);
        }
    }

    /// Forgets how quantity `i` hangs together with the others; its variance becomes `variance`.
    pub fn forget(&mut self, i: usize, variance: f64) {
        self.p.fill_row(i, 0.0);
        self.p.fill_column(i, 0.0);
        self.p[(i, i)] = variance;
    }
}

impl<const N: usize> Saved for Estimate<N> {
    fn put(&self, out: &mut Vec<u8>) {
        self.x.put(out);
        self.p.put(out);
    }
    fn take(from: &mut &[u8]) -> Option<Self> {
        Some(Self { x: Saved::take(from)?, p: Saved::take(from)? })
    }
}
