//! Householder's triangularisation in place, on columns that lie one after another.

/// Rotates the rows of the column-major matrix `data` (`rows` each) so that the first `pivots` columns become upper
/// triangular; the columns behind them are rotated along. Columns whose length is below `tiny` are taken as zero: they
/// get no row, and the next column uses it. Returns the number of rows that pivots took.
///
/// After G. Golub, C. Van Loan, "Matrix Computations", algorithm 5.2.1, with the reflectors applied at once.
///
/// # Panics
///
/// Where `data` is no whole number of columns, or has fewer than `pivots`.
pub fn triangularise(data: &mut [f64], rows: usize, pivots: usize, tiny: f64) -> usize {
    if rows == 0 {
        return 0;
    }
    assert!(
        data.len().is_multiple_of(rows) && data.len() / rows >= pivots,
        "{} values, {rows} rows, {pivots}",
        data.len()
    );
    let mut top = 0;
    for pivot in 0..pivots {
        if top == rows {
            break;
        }
        let (left, right) = data.split_at_mut((pivot + 1) * rows);
        let column = &mut left[pivot * rows + top..];
        let length = norm(column);
        if length <= tiny {
            column.fill(0.0);
            continue;
        }
        let head = column[0];
        let becomes = if head > 0.0 { -length } else { length };
        // The reflector v, scaled so that vᵀv = 2 − … is not needed: H = I − v vᵀ / h with h = length (length + |head|).
        column[0] = head - becomes;
        let h = length * (length + head.abs());
        for other in right.chunks_exact_mut(rows) {
            let other = &mut other[top..];
            let along = dot(column, other) / h;
            if along != 0.0 {
                other.iter_mut().zip(column.iter()).for_each(|(x, v)| *x -= along * v);
            }
        }
        column[0] = becomes;
        column[1..].fill(0.0);
        top += 1;
    }
    top
}

/// Four sums side by side, so that the compiler may use vectors: the same order on every machine.
#[inline]
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 8];
    let (a8, b8) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest: f64 = a8.remainder().iter().zip(b8.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in a8.zip(b8) {
        for i in 0..8 {
            sums[i] += x[i] * y[i];
        }
    }
    sums.iter().sum::<f64>() + rest
}

/// Length without overflow or underflow of the squares.
fn norm(column: &[f64]) -> f64 {
    let plain = dot(column, column);
    if plain > 1e-280 && plain < 1e280 {
        return plain.sqrt();
    }
    let largest = column.iter().fold(0.0f64, |m, x| m.max(x.abs()));
    if largest == 0.0 || !largest.is_finite() {
        return largest;
    }
    largest * column.iter().map(|x| (x / largest).powi(2)).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use nalgebra::DMatrix;
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn the_square_is_kept_and_the_pivots_are_triangular(
            rows in 1usize..24, columns in 1usize..9, seed in proptest::collection::vec(-3.0..3f64, 24 * 9),
            dead in 0usize..9,
        ) {
            let mut matrix = DMatrix::from_fn(rows, columns, |i, j| if j == dead { 0.0 } else { seed[i * 9 + j] });
            let before = matrix.transpose() * &matrix;
            let pivots = columns.min(5);
            let top = triangularise(matrix.as_mut_slice(), rows, pivots, 1e-12);
            prop_assert!((matrix.transpose() * &matrix - before).amax() < 1e-11);
            prop_assert!(top <= rows.min(pivots));
            // Nothing of the pivots is left below their rows.
            let below = matrix.view((top, 0), (rows - top, pivots)).amax_or_zero();
            prop_assert!(below == 0.0, "{}", below);
        }
    }

    trait AmaxOrZero {
        fn amax_or_zero(&self) -> f64;
    }

    impl AmaxOrZero for nalgebra::DMatrixView<'_, f64> {
        fn amax_or_zero(&self) -> f64 {
            self.iter().fold(0.0, |m: f64, x| m.max(x.abs()))
        }
    }

    #[test]
    fn lengths_at_the_ends_of_the_range_are_right() {
        assert!((norm(&[3e200, 4e200]) / 5e200 - 1.0).abs() < 1e-15);
        assert!((norm(&[3e-200, 4e-200]) / 5e-200 - 1.0).abs() < 1e-15);
        assert_eq!(norm(&[0.0, 0.0]), 0.0);
    }
}
