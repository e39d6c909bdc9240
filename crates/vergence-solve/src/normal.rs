//! The normal equations: a dense, symmetric matrix and a gradient.

use nalgebra::{DMatrix, DVector, SMatrix, SVector};

use crate::factor::Factor;

/// `hessian · step = −gradient`. Of the matrix only the lower triangle is read.
#[derive(Clone, Debug, Default)]
pub struct Normal {
    pub(crate) hessian: DMatrix<f64>,
    pub(crate) gradient: DVector<f64>,
    factor: Factor,
    step: DVector<f64>,
}

impl Normal {
    /// All zero, for `dimension` unknowns; takes memory only where the dimension has changed.
    pub fn reset(&mut self, dimension: usize) {
        if self.gradient.len() != dimension {
            self.hessian = DMatrix::zeros(dimension, dimension);
            self.factor.reset(dimension);
            self.gradient = DVector::zeros(dimension);
            self.step = DVector::zeros(dimension);
        } else {
            self.hessian.fill(0.0);
            self.gradient.fill(0.0);
        }
    }

    /// Unknowns.
    pub fn dimension(&self) -> usize {
        self.gradient.len()
    }

    /// The matrix; only its lower triangle means something.
    pub fn hessian(&self) -> &DMatrix<f64> {
        &self.hessian
    }

    /// The gradient of the cost.
    pub fn gradient(&self) -> &DVector<f64> {
        &self.gradient
    }

    /// Adds a block to rows from `row` and columns from `column`, and its transpose to the other side. On the diagonal
    /// (`row == column`) the block is the whole symmetric block.
    #[inline]
    pub fn add_block<const R: usize, const C: usize>(
        &mut self,
        row: usize,
        column: usize,
        block: &SMatrix<f64, R, C>,
    ) {
        if row >= column {
            let mut into = self.hessian.fixed_view_mut::<R, C>(row, column);
            into += block;
        } else {
            let mut into = self.hessian.fixed_view_mut::<C, R>(column, row);
            into += block.transpose();
        }
    }

    /// Adds to the gradient from `row`.
    #[inline]
    pub fn add_gradient<const R: usize>(&mut self, row: usize, part: &SVector<f64, R>) {
        let mut into = self.gradient.fixed_rows_mut::<R>(row);
        into += part;
    }

    /// Adds ½ weight |jacobian · step + residual|², whose unknowns begin at `at`.
    pub fn add_square<const D: usize, const N: usize>(
        &mut self,
        at: usize,
        jacobian: &SMatrix<f64, D, N>,
        residual: &SVector<f64, D>,
        weight: f64,
    ) {
        let scaled = jacobian.transpose() * weight;
        self.add_block(at, at, &(scaled * jacobian));
        self.add_gradient(at, &(scaled * residual));
    }

    /// The step for this damping: `(hessian + damping · diagonal) · step = −gradient`, each diagonal entry at least
    /// `floor` in the damping term. `None` where the matrix is not positive definite or the step not finite.
    pub fn solve(&mut self, damping: f64, floor: f64) -> Option<&[f64]> {
        let hessian = &self.hessian;
        let damped = |i: usize, j: usize| {
            let entry = hessian[(i, j)];
            if i == j { entry + damping * entry.max(floor) } else { entry }
        };
        if !self.factor.set(damped) {
            return None;
        }
        self.step.copy_from(&self.gradient);
        self.step.neg_mut();
        self.factor.solve(self.step.as_mut_slice());
        self.step.iter().all(|x| x.is_finite()).then_some(self.step.as_slice())
    }

    /// Variances of `N` unknowns, all others free: entries of the diagonal of the inverse, by one factorisation. `None` where the
    /// matrix is not positive definite, or has no such unknowns.
    pub fn variances<const N: usize>(&mut self, of: &[usize; N]) -> Option<[f64; N]> {
        let dimension = self.dimension();
        if of.iter().any(|i| *i >= dimension) {
            return None;
        }
        if !self.factor.set(|i, j| self.hessian[(i, j)]) {
            return None;
        }
        let found = of.map(|i| self.factor.variance(i, self.step.as_mut_slice()));
        Some(found)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Vector2};

    use super::*;

    #[test]
    fn blocks_on_both_sides_of_the_diagonal_are_one_symmetric_matrix() {
        let block = Matrix2::new(1.0, 2.0, 3.0, 4.0);
        let (mut a, mut b) = (Normal::default(), Normal::default());
        a.reset(4);
        b.reset(4);
        a.add_block(2, 0, &block);
        b.add_block(0, 2, &block.transpose());
        assert_eq!(a.hessian().lower_triangle(), b.hessian().lower_triangle());
    }

    #[test]
    fn steps_and_covariances_are_those_of_the_inverse() {
        let mut normal = Normal::default();
        normal.reset(4);
        let rows = nalgebra::Matrix4::new(
            2.0, 1.0, 0.0, 0.5, 0.0, 3.0, 1.0, 0.0, 0.3, 0.0, 1.0, 2.0, 1.0, 1.0, -1.0, 4.0,
        );
        let residual = nalgebra::Vector4::new(1.0, -2.0, 0.5, 3.0);
        normal.add_square(0, &rows, &residual, 1.0);
        let step = nalgebra::Vector4::from_column_slice(normal.solve(0.0, 0.0).unwrap());
        assert!((rows * step + residual).norm() < 1e-12);
        let inverse = (rows.transpose() * rows).try_inverse().unwrap();
        let variances = normal.variances(&[3, 0, 2]).unwrap();
        assert!((variances[0] - inverse[(3, 3)]).abs() < 1e-12);
        assert!((variances[1] - inverse[(0, 0)]).abs() < 1e-12);
        assert!((variances[2] - inverse[(2, 2)]).abs() < 1e-12);
        assert!(normal.variances(&[4]).is_none());
        // Damped without bound, the step is none.
        assert!(normal.solve(1e12, 1.0).unwrap().iter().all(|x| x.abs() < 1e-9));
    }

    #[test]
    fn what_cannot_be_solved_is_said() {
        let mut normal = Normal::default();
        normal.reset(2);
        assert!(normal.solve(0.0, 0.0).is_none());
        normal.add_square(0, &Matrix2::identity(), &Vector2::new(f64::NAN, 0.0), 1.0);
        assert!(normal.solve(0.0, 0.0).is_none());
    }
}
