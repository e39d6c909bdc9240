//! Cholesky's factor of a dense symmetric matrix, by rows.
//!
//! Own code, because nalgebra's goes by columns and writes each entry once for every column to its left: over the windows of odometry
//! it took three quarters of all time. Here each entry is one dot product of two rows, eight at a time; and what is zero to the left of a
//! row's first entry stays zero and is left out. Unknowns are eliminated from the last to the first: those that hang on few others (the
//! motion of each frame on its neighbours') should come last.

/// A lower triangle by rows, `dimension` entries apart; what is above the diagonal means nothing.
#[derive(Clone, Debug, Default)]
pub(crate) struct Factor {
    dimension: usize,
    /// The last unknown first.
    rows: Vec<f64>,
    /// Before this column (a multiple of [`ACROSS`]) a row has nothing but zeros.
    begins: Vec<usize>,
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
        self.begins.clear();
        for row in 0..n {
            let entries = &mut self.rows[row * n..=row * n + row];
            for (column, entry) in entries.iter_mut().enumerate() {
                *entry = of(n - 1 - column, n - 1 - row);
            }
            let begin = entries.iter().position(|entry| *entry != 0.0).unwrap_or(row);
            self.begins.push(begin - begin % ACROSS);
        }
        for first in (0..n).step_by(DOWN) {
            let down = DOWN.min(n - first);
            let begin = self.begins[first].min(self.begins[first + down - 1]);
            let (above, below) = self.rows.split_at_mut(first * n);
            for left in (begin..first - first % ACROSS).step_by(ACROSS) {
                let others = self.begins[left..left + ACROSS].iter().min();
                let from = others.map_or(begin, |others| begin.max(*others));
                let b: [&[f64]; ACROSS] =
                    std::array::from_fn(|k| &above[(left + k) * n + from..(left + k) * n + left]);
                // An odd last row is multiplied twice.
                let at = |k: usize| k.min(down - 1) * n;
                let sums = tile(std::array::from_fn(|k| &below[at(k) + from..at(k) + left]), b);
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
                    let begin = self.begins[row].max(self.begins[column]);
                    if column < row {
                        let other = &before[column * n..];
                        let rest = from[column] - dot(&from[begin..column], &other[begin..column]);
                        from[column] = rest / other[column];
                    } else {
                        let square = from[row] - dot(&from[begin..row], &from[begin..row]);
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
        x.reverse();
        self.forward(0, x);
        for row in (0..n).rev() {
            let begin = self.begins[row];
            let of = &self.rows[row * n + begin..row * n + row];
            let value = x[row] / self.rows[row * n + row];
            x[row] = value;
            for (x, l) in x[begin..row].iter_mut().zip(of) {
                *x -= l * value;
            }
        }
        x.reverse();
    }

    fn forward(&self, from: usize, x: &mut [f64]) {
        let n = self.dimension;
        for row in from..n {
            let of = &self.rows[row * n..=row * n + row];
            let begin = from.max(self.begins[row]).min(row);
            x[row] = (x[row] - dot(&of[begin..row], &x[begin..row])) / of[row];
        }
    }

    /// An entry of the diagonal of the inverse; `work` has room for all unknowns.
    pub(crate) fn variance(&self, of: usize, work: &mut [f64]) -> f64 {
        // The inverse is L⁻ᵀ L⁻¹: the square of a column of L⁻¹, which begins at the diagonal.
        let of = self.dimension - 1 - of;
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

        /// A chain at the end that hangs on what comes before it, as motions do on poses: zeros are left out and change nothing.
        #[test]
        fn chains_are_solved_as_if_they_were_full(
            dense in 1usize..14, links in 1usize..12, seed in proptest::collection::vec(-1.0..1f64, 600),
        ) {
            const LINK: usize = 3;
            let n = dense + LINK * links;
            let mut matrix = DMatrix::<f64>::identity(n, n) * 0.5;
            let mut next = 0;
            for link in 0..=links {
                // The dense part by itself, then each link with the one before and two of the dense ones.
                let of: Vec<usize> = if link == 0 {
                    (0..dense).collect()
                } else {
                    let from = dense + LINK * (link - 1);
                    let before = if link > 1 { from - LINK..from } else { from..from };
                    before.chain(from..from + LINK).chain([(link * 5) % dense, (link * 7 + 1) % dense]).collect()
                };
                let row = DVector::from_fn(n, |i, _| {
                    next += 1;
                    if of.contains(&i) { seed[(next * 13) % seed.len()] } else { 0.0 }
                });
                matrix += &row * row.transpose();
            }
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
        }
    }
}
