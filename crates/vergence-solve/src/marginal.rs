//! What is left of the knowledge about unknowns that are dropped: marginalisation in square-root form.
//!
//! After N. Demmel, D. Schubert, C. Sommer, D. Cremers, V. Usenko, "Square Root Marginalization for Sliding-Window
//! Bundle Adjustment", ICCV 2021: rows are rotated, never squared, so the condition number stays that of the rows.

use nalgebra::{DMatrix, DVector};

use crate::normal::Normal;
use crate::qr::triangularise;

/// Columns shorter than this carry nothing (whitened rows: one standard deviation of 1e10 units).
const TINY: f64 = 1e-10;

/// Rows `jacobian · step + residual` (whitened) that are gathered to be compressed or marginalised.
#[derive(Clone, Debug, Default)]
pub struct Stack {
    /// Row by row, each with the residual as its last entry.
    rows: Vec<f64>,
    columns: usize,
    scratch: Vec<f64>,
}

impl Stack {
    /// No rows, for `dimension` unknowns; memory is kept.
    pub fn reset(&mut self, dimension: usize) {
        self.rows.clear();
        self.columns = dimension + 1;
    }

    /// Appends `count` rows of zeros; gives them row by row, the residual at the end of each (index `dimension`).
    pub fn append(&mut self, count: usize) -> &mut [f64] {
        let from = self.rows.len();
        self.rows.resize(from + count * self.columns, 0.0);
        &mut self.rows[from..]
    }

    /// Rows so far.
    pub fn rows(&self) -> usize {
        self.rows.len().checked_div(self.columns).unwrap_or(0)
    }

    /// Unknowns.
    pub fn dimension(&self) -> usize {
        self.columns.saturating_sub(1)
    }

    /// One row.
    pub fn row(&self, row: usize) -> &[f64] {
        &self.rows[row * self.columns..(row + 1) * self.columns]
    }

    /// Eliminates the first `dropped` unknowns from the rows from `from` on: rotates, and removes the rows that took
    /// them. What remains of those rows are zeros in these columns.
    pub fn eliminate(&mut self, from: usize, dropped: usize) {
        let rows = self.rows() - from;
        self.by_columns(from);
        let taken = triangularise(&mut self.scratch, rows, dropped, TINY);
        self.by_rows(from, rows, taken, rows);
    }

    /// Rotates all rows so that at most `dimension` + 1 of them are left, the last one holding the residual that no step
    /// removes (dropped here: it changes no minimum).
    pub fn compress(&mut self) {
        let (rows, dimension) = (self.rows(), self.dimension());
        self.by_columns(0);
        let taken = triangularise(&mut self.scratch, rows, dimension, TINY);
        self.by_rows(0, rows, 0, taken);
    }

    /// Marginalises the first `dropped` unknowns: the rows that remain, compressed, over the others.
    pub fn marginalise(&mut self, dropped: usize) -> Prior {
        let (rows, dimension) = (self.rows(), self.dimension());
        self.by_columns(0);
        let above = triangularise(&mut self.scratch, rows, dropped, TINY);
        // The others, below the rows that were taken, in a matrix of their own.
        let (left, kept) = (rows - above, dimension - dropped);
        let mut rest = Vec::with_capacity(left * (kept + 1));
        if rows > 0 {
            for column in self.scratch[dropped * rows..].chunks_exact(rows) {
                rest.extend_from_slice(&column[above..]);
            }
        }
        let taken = triangularise(&mut rest, left, kept, TINY);
        Prior {
            root: DMatrix::from_fn(taken, kept, |i, j| rest[j * left + i]),
            rest: DVector::from_fn(taken, |i, _| rest[kept * left + i]),
        }
    }

    fn by_columns(&mut self, from: usize) {
        let rows = self.rows() - from;
        self.scratch.clear();
        self.scratch.resize(rows * self.columns, 0.0);
        for (i, row) in self.rows[from * self.columns..].chunks_exact(self.columns.max(1)).enumerate() {
            row.iter().enumerate().for_each(|(j, value)| self.scratch[j * rows + i] = *value);
        }
    }

    /// Writes rows `top..bottom` of the scratch back behind the first `from`.
    fn by_rows(&mut self, from: usize, rows: usize, top: usize, bottom: usize) {
        self.rows.truncate(from * self.columns);
        for i in top..bottom {
            for j in 0..self.columns {
                self.rows.push(self.scratch[j * rows + i]);
            }
        }
    }
}

/// ½ |root · step + rest|², about a fixed point of linearisation that its owner remembers.
#[derive(Clone, Debug, PartialEq)]
pub struct Prior {
    root: DMatrix<f64>,
    rest: DVector<f64>,
}

impl Default for Prior {
    fn default() -> Self {
        Self { root: DMatrix::zeros(0, 0), rest: DVector::zeros(0) }
    }
}

impl Prior {
    /// Independent knowledge: standard deviations about zero; an infinite one says nothing.
    pub fn from_deviations(deviations: &[f64]) -> Self {
        let n = deviations.len();
        Self {
            root: DMatrix::from_fn(n, n, |i, j| if i == j { 1.0 / deviations[i] } else { 0.0 }),
            rest: DVector::zeros(n),
        }
    }

    /// Rows (whitened), one for each direction that is known.
    pub fn root(&self) -> &DMatrix<f64> {
        &self.root
    }

    /// The residual of each row where the step is zero.
    pub fn rest(&self) -> &DVector<f64> {
        &self.rest
    }

    /// Unknowns.
    pub fn dimension(&self) -> usize {
        self.root.ncols()
    }

    /// The cost at `step` from the point of linearisation.
    pub fn cost(&self, step: &DVector<f64>) -> f64 {
        0.5 * (&self.root * step + &self.rest).norm_squared()
    }

    /// The same knowledge about steps from another origin: `step` there is `step + by` here.
    pub fn move_origin(&mut self, by: &DVector<f64>) {
        self.rest += &self.root * by;
    }

    /// Adds this to normal equations about `step`; unknown i of the prior is unknown `places[i]` there. Returns the cost.
    pub fn add_to(&self, normal: &mut Normal, step: &DVector<f64>, places: &[usize]) -> f64 {
        let residual = &self.root * step + &self.rest;
        let gradient = self.root.tr_mul(&residual);
        let square = self.root.tr_mul(&self.root);
        for (j, &column) in places.iter().enumerate() {
            normal.gradient[column] += gradient[j];
            for (i, &row) in places.iter().enumerate() {
                if row >= column {
                    normal.hessian[(row, column)] += square[(i, j)];
                }
            }
        }
        0.5 * residual.norm_squared()
    }

    /// Appends the rows, with the residual at `step`, to a stack; unknown i is column `places[i]` there.
    pub fn append_to(&self, stack: &mut Stack, step: &DVector<f64>, places: &[usize]) {
        let residual = &self.root * step + &self.rest;
        let columns = stack.columns;
        let rows = stack.append(self.root.nrows());
        for (i, row) in rows.chunks_exact_mut(columns).enumerate() {
            places.iter().enumerate().for_each(|(j, &place)| row[place] = self.root[(i, j)]);
            row[columns - 1] = residual[i];
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// The marginal's minimum and curvature are those of the whole problem with the dropped ones at their best.
        #[test]
        fn the_marginal_is_schurs_complement(values in proptest::collection::vec(-2.0..2f64, 20 * 8), dropped in 1usize..6) {
            const ROWS: usize = 20;
            const N: usize = 7;
            let mut stack = Stack::default();
            stack.reset(N);
            stack.append(ROWS).copy_from_slice(&values);
            let full = DMatrix::from_row_slice(ROWS, N + 1, &values);
            let (jacobian, residual) = (full.columns(0, N).into_owned(), full.column(N).into_owned());
            let (hessian, gradient) = (jacobian.tr_mul(&jacobian), jacobian.tr_mul(&residual));
            let kept = N - dropped;
            let inverse = hessian.view((0, 0), (dropped, dropped)).into_owned().try_inverse();
            prop_assume!(inverse.as_ref().is_some_and(|m| m.amax() < 1e3));
            let across = hessian.view((dropped, 0), (kept, dropped)) * inverse.unwrap();
            let square = hessian.view((dropped, dropped), (kept, kept)) - &across * hessian.view((0, dropped), (dropped, kept));
            let slope = gradient.rows(dropped, kept) - &across * gradient.rows(0, dropped);
            let prior = stack.marginalise(dropped);
            prop_assert!((prior.root().tr_mul(prior.root()) - square).amax() < 1e-7);
            prop_assert!((prior.root().tr_mul(prior.rest()) - slope).amax() < 1e-7);
        }

        #[test]
        fn compressing_keeps_every_minimum(values in proptest::collection::vec(-2.0..2f64, 12 * 5)) {
            let mut stack = Stack::default();
            stack.reset(4);
            stack.append(12).copy_from_slice(&values);
            let before = DMatrix::from_row_slice(12, 5, &values);
            stack.compress();
            prop_assert_eq!(stack.rows(), 4);
            let after = DMatrix::from_fn(4, 5, |i, j| stack.row(i)[j]);
            let (a, b) = (after.tr_mul(&after), before.tr_mul(&before));
            prop_assert!((a.view((0, 0), (4, 5)) - b.view((0, 0), (4, 5))).amax() < 1e-11);
        }
    }

    #[test]
    fn what_is_not_seen_stays_unknown() {
        // Two unknowns, of which only the sum is measured: dropping one leaves nothing of the other.
        let mut stack = Stack::default();
        stack.reset(2);
        stack.append(1).copy_from_slice(&[1.0, 1.0, 0.5]);
        let prior = stack.marginalise(1);
        assert_eq!(prior.root().nrows(), 0);
        // A column of zeros is passed over, and the other one is kept.
        stack.reset(2);
        stack.append(1).copy_from_slice(&[0.0, 2.0, 1.0]);
        let prior = stack.marginalise(1);
        assert_eq!((prior.root()[(0, 0)].abs(), prior.rest()[0].abs()), (2.0, 1.0));
    }

    #[test]
    fn a_prior_gives_the_same_in_normal_equations_and_in_a_stack() {
        let prior = Prior {
            root: DMatrix::from_row_slice(2, 2, &[1.0, 2.0, 0.0, 3.0]),
            rest: DVector::from_vec(vec![0.1, -0.4]),
        };
        let step = DVector::from_vec(vec![0.5, -0.2]);
        let mut normal = Normal::default();
        normal.reset(3);
        let cost = prior.add_to(&mut normal, &step, &[2, 0]);
        assert!((cost - prior.cost(&step)).abs() < 1e-15);
        let mut stack = Stack::default();
        stack.reset(3);
        prior.append_to(&mut stack, &step, &[2, 0]);
        let rows = DMatrix::from_fn(2, 4, |i, j| stack.row(i)[j]);
        let square = rows.tr_mul(&rows);
        assert!(
            (square.view((0, 0), (3, 3)).lower_triangle() - normal.hessian().lower_triangle()).amax() < 1e-14
        );
        assert!((square.view((0, 3), (3, 1)) - normal.gradient()).amax() < 1e-14);
    }
}
