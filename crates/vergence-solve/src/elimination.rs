//! Points that are seen from blocks: their part of the problem, and the blocks' part without them (Schur's complement).

use nalgebra::{DMatrix, DVector, SMatrix, SVector};

/// Residuals of `D` rows that hang on one block of `B` unknowns and one point of `P` unknowns. The points are eliminated
/// one by one as they are added; what is left are dense equations of the blocks. No allocation once it has grown.
#[derive(Clone, Debug)]
pub struct Elimination<const B: usize, const P: usize> {
    blocks: usize,
    hessian: DMatrix<f64>,
    gradient: DVector<f64>,
    points: Vec<EliminatedPoint<P>>,
    /// For each point `P` columns of `blocks` · `B` values: block by point.
    across: Vec<f64>,
    point_hessian: SMatrix<f64, P, P>,
    point_gradient: SVector<f64, P>,
    /// Blocks that the point is seen from.
    touched: Vec<usize>,
    whitened: Vec<f64>,
}

/// From this many blocks on, those that a point is not seen from are left out where they are many: below, vectors of whole columns, zeros included,
/// are faster than a list.
const MANY: usize = 13;

/// What is remembered of a point for going back.
#[derive(Clone, Copy, Debug)]
pub struct EliminatedPoint<const P: usize> {
    inverse: SMatrix<f64, P, P>,
    gradient: SVector<f64, P>,
}

impl<const B: usize, const P: usize> Default for Elimination<B, P> {
    fn default() -> Self {
        Self {
            blocks: 0,
            hessian: DMatrix::zeros(0, 0),
            gradient: DVector::zeros(0),
            points: Vec::new(),
            across: Vec::new(),
            point_hessian: SMatrix::zeros(),
            point_gradient: SVector::zeros(),
            touched: Vec::new(),
            whitened: Vec::new(),
        }
    }
}

impl<const B: usize, const P: usize> Elimination<B, P> {
    /// Begins anew, for so many blocks.
    pub fn reset(&mut self, blocks: usize) {
        let n = blocks * B;
        if self.blocks != blocks || self.gradient.len() != n {
            self.blocks = blocks;
            self.hessian = DMatrix::zeros(n, n);
            self.gradient = DVector::zeros(n);
        } else {
            self.hessian.fill(0.0);
            self.gradient.fill(0.0);
        }
        self.whitened.resize(n * P, 0.0);
        self.points.clear();
        self.across.clear();
    }

    /// The next residuals are those of a new point.
    pub fn begin_point(&mut self) {
        self.across.resize((self.points.len() + 1) * self.blocks * B * P, 0.0);
        self.point_hessian = SMatrix::zeros();
        self.point_gradient = SVector::zeros();
        self.touched.clear();
    }

    /// Adds ½ weight |by_block · step + by_point · step + residual|²; without a block where the residual hangs on the
    /// point alone.
    #[inline]
    pub fn add<const D: usize>(
        &mut self,
        block: Option<(usize, &SMatrix<f64, D, B>)>,
        by_point: &SMatrix<f64, D, P>,
        residual: &SVector<f64, D>,
        weight: f64,
    ) {
        let point_scaled = by_point.transpose() * weight;
        self.point_hessian += point_scaled * by_point;
        self.point_gradient += point_scaled * residual;
        let Some((block, by_block)) = block else { return };
        if !self.touched.contains(&block) {
            self.touched.push(block);
        }
        let scaled = by_block.transpose() * weight;
        let mut square = self.hessian.fixed_view_mut::<B, B>(block * B, block * B);
        square += scaled * by_block;
        let mut gradient = self.gradient.fixed_rows_mut::<B>(block * B);
        gradient += scaled * residual;
        let across = scaled * by_point;
        let n = self.blocks * B;
        let from = self.points.len() * n * P;
        for p in 0..P {
            for (into, value) in
                self.across[from + p * n + block * B..][..B].iter_mut().zip(across.column(p).iter())
            {
                *into += value;
            }
        }
    }

    /// Eliminates the point whose residuals were added, its diagonal raised by `damping` times itself and at least by
    /// `damping · floor`. A point that nothing determines is held where it is.
    pub fn end_point(&mut self, damping: f64, floor: f64) {
        let mut hessian = self.point_hessian;
        for i in 0..P {
            hessian[(i, i)] += damping * hessian[(i, i)].max(floor) + f64::MIN_POSITIVE;
        }
        let inverse = hessian
            .cholesky()
            .map(|c| c.inverse())
            .filter(|m| m.iter().all(|x| x.is_finite()))
            .unwrap_or_else(SMatrix::zeros);
        let gradient = inverse * self.point_gradient;
        if self.blocks >= MANY && self.touched.len() * 4 <= self.blocks * 3 {
            self.subtract_touched(&inverse, &gradient);
        } else {
            self.subtract_all(&inverse, &gradient);
        }
        self.points.push(EliminatedPoint { inverse, gradient: self.point_gradient });
    }

    /// across · inverse · acrossᵀ, column by column, over all blocks.
    fn subtract_all(&mut self, inverse: &SMatrix<f64, P, P>, gradient: &SVector<f64, P>) {
        let n = self.blocks * B;
        let across = &self.across[self.points.len() * n * P..];
        for i in 0..n {
            for p in 0..P {
                self.whitened[p * n + i] = (0..P).map(|q| across[q * n + i] * inverse[(q, p)]).sum();
            }
        }
        for (column, mut target) in self.hessian.column_iter_mut().enumerate() {
            let scale: [f64; P] = std::array::from_fn(|p| across[p * n + column]);
            if scale.iter().all(|x| *x == 0.0) {
                continue;
            }
            // The lower triangle from the block of this column on.
            let from = column / B * B;
            let target = &mut target.as_mut_slice()[from..];
            for (scale, with) in scale.into_iter().zip(self.whitened.chunks_exact(n)) {
                target.iter_mut().zip(&with[from..]).for_each(|(t, w)| *t -= w * scale);
            }
        }
        for p in 0..P {
            let with = &across[p * n..(p + 1) * n];
            self.gradient.as_mut_slice().iter_mut().zip(with).for_each(|(t, w)| *t -= w * gradient[p]);
        }
    }

    /// The same over the blocks that the point is seen from.
    fn subtract_touched(&mut self, inverse: &SMatrix<f64, P, P>, gradient: &SVector<f64, P>) {
        let n = self.blocks * B;
        let across = &self.across[self.points.len() * n * P..];
        self.touched.sort_unstable();
        for i in self.touched.iter().flat_map(|block| block * B..(block + 1) * B) {
            for p in 0..P {
                self.whitened[p * n + i] = (0..P).map(|q| across[q * n + i] * inverse[(q, p)]).sum();
            }
        }
        for (k, &block) in self.touched.iter().enumerate() {
            for column in block * B..(block + 1) * B {
                let scale: [f64; P] = std::array::from_fn(|p| across[p * n + column]);
                let target = &mut self.hessian.as_mut_slice()[column * n..(column + 1) * n];
                for &row in &self.touched[k..] {
                    let Some((into, _)) = target[row * B..].split_first_chunk_mut::<B>() else { continue };
                    for (p, scale) in scale.iter().enumerate() {
                        let Some((with, _)) = self.whitened[p * n + row * B..].split_first_chunk::<B>()
                        else {
                            continue;
                        };
                        into.iter_mut().zip(with).for_each(|(t, w)| *t -= w * scale);
                    }
                }
                let down: f64 = scale.iter().zip(gradient.iter()).map(|(scale, g)| scale * g).sum();
                self.gradient[column] -= down;
            }
        }
    }

    /// The blocks' equations without the points: of the matrix only blocks on and below the diagonal mean something.
    pub fn reduced(&self) -> (&DMatrix<f64>, &DVector<f64>) {
        (&self.hessian, &self.gradient)
    }

    /// The step of the `index`-th point, given that of the blocks.
    pub fn point_step(&self, index: usize, blocks_step: &[f64]) -> SVector<f64, P> {
        let n = self.blocks * B;
        let across = &self.across[index * n * P..];
        let pulled =
            SVector::<f64, P>::from_fn(|p, _| crate::qr::dot(&across[p * n..(p + 1) * n], blocks_step));
        -(self.points[index].inverse * (self.points[index].gradient + pulled))
    }

    /// The covariance of the `index`-th point with the blocks held fixed.
    pub fn point_covariance(&self, index: usize) -> &SMatrix<f64, P, P> {
        &self.points[index].inverse
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2x3, SMatrix, Vector2};
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// Blocks and points solved together give the same steps as the reduced equations and going back.
        #[test]
        fn eliminating_changes_no_step(values in proptest::collection::vec(-1.0..1f64, 400)) {
            // Few blocks, and many of which a point is seen from some.
            no_step_changes::<3>(&values)?;
            no_step_changes::<20>(&values)?;
        }
    }

    fn no_step_changes<const BLOCKS: usize>(values: &[f64]) -> Result<(), TestCaseError> {
        const POINTS: usize = 2;
        let mut at = 0;
        let mut next = || {
            at += 1;
            values[at % values.len()] + 0.1 * (at as f64).sin()
        };
        let all = BLOCKS * 6;
        let n = all + POINTS * 3;
        let mut whole = DMatrix::<f64>::identity(n, n) * 0.01;
        whole.view_mut((all, all), (6, 6)).fill(0.0);
        let mut slope = DVector::<f64>::zeros(n);
        let mut elimination = Elimination::<6, 3>::default();
        elimination.reset(BLOCKS);
        for point in 0..POINTS {
            elimination.begin_point();
            for observation in 0..8 {
                // Not in order, and some twice.
                let block = (observation * 5 + point) % (BLOCKS + 1);
                let by_block = SMatrix::<f64, 2, 6>::from_fn(|_, _| next());
                let by_point = Matrix2x3::from_fn(|_, _| next());
                let residual = Vector2::from_fn(|_, _| next());
                let mut row = DMatrix::<f64>::zeros(2, n);
                row.view_mut((0, all + 3 * point), (2, 3)).copy_from(&by_point);
                if block < BLOCKS {
                    row.view_mut((0, 6 * block), (2, 6)).copy_from(&by_block);
                }
                whole += row.tr_mul(&row) * 0.7;
                slope += row.tr_mul(&residual) * 0.7;
                elimination.add((block < BLOCKS).then_some((block, &by_block)), &by_point, &residual, 0.7);
            }
            elimination.end_point(0.0, 0.0);
        }
        let (hessian, gradient) = elimination.reduced();
        let mut lower = hessian.clone() + DMatrix::<f64>::identity(all, all) * 0.01;
        lower.fill_upper_triangle_with_lower_triangle();
        let blocks = lower.lu().solve(&-gradient).unwrap();
        let together = whole.lu().solve(&-slope).unwrap();
        let scale = 1.0 + together.amax();
        prop_assert!((&blocks - together.rows(0, all)).amax() < 1e-6 * scale);
        for point in 0..POINTS {
            let step = elimination.point_step(point, blocks.as_slice());
            prop_assert!((step - together.fixed_rows::<3>(all + 3 * point)).amax() < 1e-6 * scale);
        }
        Ok(())
    }

    #[test]
    fn a_point_that_nothing_determines_stays() {
        let mut elimination = Elimination::<6, 3>::default();
        elimination.reset(1);
        elimination.begin_point();
        elimination.end_point(0.0, 0.0);
        assert_eq!(elimination.point_step(0, &[1.0; 6]).norm(), 0.0);
        assert!(elimination.reduced().0.iter().all(|x| *x == 0.0));
    }
}
