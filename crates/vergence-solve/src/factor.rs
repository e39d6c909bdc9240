//! Cholesky's factor of a dense symmetric matrix, by rows.
//!
//! Own code, because nalgebra's goes by columns and writes each entry once for every column to its left: over the windows of odometry
//! it took three quarters of all time. Here each entry is one dot product of two rows, eight at a time.

/// A lower triangle by rows, `dimension` entries apart; what is above the diagonal means nothing.
#[derive(Clone, Debug, Default)]
pub(crate) struct Factor {
    dimension: usize,
    rows: Vec<f64>,
}

/// Rows and columns of a tile, and the terms that are summed side by side.
const DOWN: usize = 2;
const ACROSS: usize = 4;
const LANES: usize = 2;

/// All products of `DOWN` rows with `ACROSS` rows, over their first `length` entries.
#[inline]
fn tile(a: [&[f64]; DOWN], b: [&[f64]; ACROSS]) -> [[f64; ACROSS]; DOWN] {
    let mut sums = [[[0.0; LANES]; ACROSS]; DOWN];
    let length = a[0].len();
    let whole = length - length % LANES;
    let (a0, a1) = (&a[0][..whole], &a[1][..whole]);
    let (b0, b1, b2, b3) = (&b[0][..whole], &b[1][..whole], &b[2][..whole], &b[3][..whole]);
    for at in (0..whole).step_by(LANES) {
        for lane in 0..LANES {
            let (x0, x1) = (a0[at + lane], a1[at + lane]);
            let y = [b0[at + lane], b1[at + lane], b2[at + lane], b3[at + lane]];
            for (column, y) in y.into_iter().enumerate() {
                sums[0][column][lane] += x0 * y;
                sums[1][column][lane] += x1 * y;
            }
        }
    }
    let mut out = [[0.0; ACROSS]; DOWN];
    for (row, sums) in out.iter_mut().zip(&sums) {
        for (out, sum) in row.iter_mut().zip(sums) {
            *out = sum.iter().sum();
        }
    }
    for at in whole..length {
        for (row, a) in out.iter_mut().zip(&a) {
            for (out, b) in row.iter_mut().zip(&b) {
                *out += a[at] * b[at];
            }
        }
    }
    out
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 4];
    let (a4, b4) = (a.chunks_exact(4), b.chunks_exact(4));
    let rest: f64 = a4.remainder().iter().zip(b4.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in a4.zip(b4) {
        for lane in 0..4 {
            sums[lane] += a[lane] * b[lane];
        }
    }
    (sums[0] + sums[2]) + (sums[1] + sums[3]) + rest
}

impl Factor {
    /// For so many unknowns; takes memory only where there have never been as many.
    pub(crate) fn reset(&mut self, dimension: usize) {
        self.dimension = dimension;
        self.rows.resize(dimension * dimension, 0.0);
    }

    /// Factorises the matrix whose entry (row, column ≤ row) `of` says; `false` where it is not positive definite.
    pub(crate) fn set(&mut self, of: impl Fn(usize, usize) -> f64) -> bool {
        let n = self.dimension;
        for row in 0..n {
            for column in 0..=row {
                self.rows[row * n + column] = of(row, column);
            }
        }
        for first in (0..n).step_by(DOWN) {
            let down = DOWN.min(n - first);
            let (above, below) = self.rows.split_at_mut(first * n);
            for left in (0..first - first % ACROSS).step_by(ACROSS) {
                let b: [&[f64]; ACROSS] =
                    std::array::from_fn(|k| &above[(left + k) * n..(left + k) * n + left]);
                // An odd last row is multiplied twice.
                let at = |k: usize| k.min(down - 1) * n;
                let sums = tile(std::array::from_fn(|k| &below[at(k)..at(k) + left]), b);
                for (k, sums) in sums.iter().enumerate().take(down) {
                    let row = &mut below[k * n..];
                    for column in 0..ACROSS {
                        let other = &above[(left + column) * n..];
                        let own = dot(&row[left..left + column], &other[left..left + column]);
                        row[left + column] = (row[left + column] - sums[column] - own) / other[left + column];
                    }
                }
            }
            for row in first..first + down {
                for column in first - first % ACROSS..=row {
                    let (before, from) = self.rows.split_at_mut(row * n);
                    if column < row {
                        let other = &before[column * n..];
                        let rest = from[column] - dot(&from[..column], &other[..column]);
                        from[column] = rest / other[column];
                    } else {
                        let square = from[row] - dot(&from[..row], &from[..row]);
                        if square <= 0.0 || !square.is_finite() {
                            return false;
                        }
                        from[row] = square.sqrt();
                    }
                }
            }
        }
        true
    }

    /// Solves for a right side in place.
    pub(crate) fn solve(&self, x: &mut [f64]) {
        let n = self.dimension;
        self.forward(0, x);
        for row in (0..n).rev() {
            let of = &self.rows[row * n..row * n + row];
            let value = x[row] / self.rows[row * n + row];
            x[row] = value;
            for (x, l) in x[..row].iter_mut().zip(of) {
                *x -= l * value;
            }
        }
    }

    fn forward(&self, from: usize, x: &mut [f64]) {
        let n = self.dimension;
        for row in from..n {
            let of = &self.rows[row * n..=row * n + row];
            x[row] = (x[row] - dot(&of[from..row], &x[from..row])) / of[row];
        }
    }

    /// An entry of the diagonal of the inverse; `work` has room for all unknowns.
    pub(crate) fn variance(&self, of: usize, work: &mut [f64]) -> f64 {
        // The inverse is L⁻ᵀ L⁻¹: the square of a column of L⁻¹, which begins at the diagonal.
        work[of..].fill(0.0);
        work[of] = 1.0;
        self.forward(of, work);
        dot(&work[of..], &work[of..])
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn it_solves_and_inverts_any_size(n in 1usize..40, seed in proptest::collection::vec(-1.0..1f64, 1640)) {
            let root = DMatrix::from_fn(n, n + 1, |i, j| seed[i * 41 + j]);
            let matrix = &root * root.transpose() + DMatrix::identity(n, n) * 0.1;
            let mut factor = Factor::default();
            factor.reset(n);
            prop_assert!(factor.set(|i, j| matrix[(i, j)]));
            let right = DVector::from_fn(n, |i, _| seed[i]);
            let mut x = right.clone();
            factor.solve(x.as_mut_slice());
            prop_assert!((&matrix * &x - right).amax() < 1e-9);
            let inverse = matrix.clone().try_inverse().unwrap();
            let mut work = vec![0.0; n];
            for i in 0..n {
                prop_assert!((factor.variance(i, &mut work) - inverse[(i, i)]).abs() < 1e-9 * inverse[(i, i)]);
            }
            // One negative direction is found wherever it is.
            let bad = (seed[7].abs() * 0.999 * n as f64) as usize;
            let spoilt = factor.set(|i, j| if i == bad && j == bad { -1.0 } else { matrix[(i, j)] });
            prop_assert!(!spoilt);
        }
    }
}
