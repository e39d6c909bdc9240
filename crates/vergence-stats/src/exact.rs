//! Whole-number linear algebra: what is computed here is not rounded.

use num_bigint::BigInt;
use num_rational::BigRational;
use num_traits::{One as _, Zero as _};

use crate::{Decimal, Error, decimal::to_f64};

/// A column of numbers over one common power of ten.
pub(crate) struct Scaled {
    pub values: Vec<BigInt>,
    /// A value is `values[i] / 10^places`.
    pub places: i32,
}

impl Scaled {
    pub fn new(column: &[Decimal]) -> Self {
        let places = column.iter().map(Decimal::places).max().unwrap_or(0).max(0);
        Self { values: column.iter().map(|value| value.scaled(places)).collect(), places }
    }

    pub fn ones(count: usize) -> Self {
        Self { values: vec![BigInt::one(); count], places: 0 }
    }

    pub fn dot(&self, other: &Self) -> BigInt {
        self.values.iter().zip(&other.values).map(|(a, b)| a * b).sum()
    }
}

/// Square root of a rational that is not negative, to the last digit of a double.
pub(crate) fn root(value: &BigRational) -> f64 {
    // The root of a double's range is inside it, so only the quotient can leave it: take it apart by powers of four.
    let double = to_f64(value);
    if double.is_normal() || double == 0.0 && value.is_zero() {
        return double.sqrt();
    }
    let shift = (value.numer().bits() as i64 - value.denom().bits() as i64) / 2;
    let scale = BigInt::one() << (2 * shift.unsigned_abs());
    let scaled = if shift > 0 { value / scale } else { value * scale };
    to_f64(&scaled).sqrt() * 2f64.powi(shift.clamp(-1100, 1100) as i32)
}

/// Solves `matrix · solution = right` and inverts the matrix, both as numerators over one determinant, by Bareiss'
/// fraction-free elimination (Bareiss 1968, "Sylvester's identity and multistep integer-preserving Gaussian
/// elimination"). The matrix is a Gram matrix: symmetric, not indefinite.
///
/// # Errors
/// [`Error::Dependent`] where a column follows from those before it.
pub(crate) fn solve(matrix: &[Vec<BigInt>], right: &[BigInt]) -> Result<Solved, Error> {
    let n = matrix.len();
    let mut rows: Vec<Vec<BigInt>> = (0..n)
        .map(|i| {
            let unit = (0..n).map(|j| if i == j { BigInt::one() } else { BigInt::zero() });
            matrix[i].iter().cloned().chain([right[i].clone()]).chain(unit).collect()
        })
        .collect();
    let mut previous = BigInt::one();
    for k in 0..n {
        let pivot = rows[k].clone();
        if pivot[k].is_zero() {
            return Err(Error::Dependent { column: k });
        }
        for (i, row) in rows.iter_mut().enumerate() {
            if i == k {
                continue;
            }
            let factor = row[k].clone();
            for (value, over) in row.iter_mut().zip(&pivot) {
                *value = (&pivot[k] * &*value - &factor * over) / &previous;
            }
        }
        previous = pivot[k].clone();
    }
    Ok(Solved {
        solution: rows.iter().map(|row| row[n].clone()).collect(),
        inverse_diagonal: rows.iter().enumerate().map(|(i, row)| row[n + 1 + i].clone()).collect(),
        determinant: previous,
    })
}

/// Numerators; divide by the determinant.
pub(crate) struct Solved {
    pub solution: Vec<BigInt>,
    pub inverse_diagonal: Vec<BigInt>,
    pub determinant: BigInt,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hilbert_like_system_is_solved_exactly() {
        // Gram matrix of (1, x, x²) over x = 1..4 and of y = 3 + 2 x.
        let n = |value: i64| BigInt::from(value);
        let matrix = vec![vec![n(4), n(10), n(30)], vec![n(10), n(30), n(100)], vec![n(30), n(100), n(354)]];
        let right = vec![n(3 * 4 + 2 * 10), n(3 * 10 + 2 * 30), n(3 * 30 + 2 * 100)];
        let solved = solve(&matrix, &right).unwrap();
        let answer: Vec<BigInt> = solved.solution.iter().map(|v| v / &solved.determinant).collect();
        assert_eq!(answer, [n(3), n(2), n(0)]);
        let dependent = vec![vec![n(4), n(8)], vec![n(8), n(16)]];
        assert!(matches!(solve(&dependent, &[n(1), n(2)]), Err(Error::Dependent { column: 1 })));
    }

    #[test]
    fn roots_beyond_a_doubles_range() {
        let huge = BigRational::from(BigInt::from(10).pow(500));
        assert!((root(&huge) / 1e250 - 1.0).abs() < 1e-15);
        let tiny = BigRational::new(BigInt::one(), BigInt::from(10).pow(500));
        assert!((root(&tiny) / 1e-250 - 1.0).abs() < 1e-15);
        assert_eq!(root(&BigRational::zero()), 0.0);
    }
}
