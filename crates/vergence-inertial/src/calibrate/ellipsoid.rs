//! The ellipsoid that a triad's readings of a vector of one length lie on.
//!
//! Maximum a posteriori by Gauss and Newton on the lengths: `r = |matrix⁻¹ (m − offset)| − length` with a symmetric
//! matrix. Ten unknowns and a weak prior need no solver of their own. The posterior says what the readings do not tell: that
//! is put back to its usual value. The others are not fitted again with it held there: what they then take over to explain
//! the readings is worse than nothing (an offset along a vertical that never turned went into the offsets across it).

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// What units of this kind have before anything is seen of them: standard deviations, as shares of the length.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prior {
    /// Of the offset.
    pub offset: f64,
    /// Of scale factors about 1 and cross-axis terms about 0.
    pub matrix: f64,
    /// A number counts as seen where its deviation is less than this. Larger errors than that are what a calibration is
    /// made against: a hundredth of gravity is half a degree of tilt.
    pub enough: f64,
    /// Whether the deviations that are given with the readings hold; otherwise their scatter may widen them.
    pub exact: bool,
}

impl Prior {
    /// Half a metre per second squared, five in a hundred.
    pub(super) const ACCELEROMETER: Self = Self { offset: 0.05, matrix: 0.05, enough: 0.01, exact: false };
    /// Hard and soft iron may be as large as the field.
    pub(super) const MAGNETOMETER: Self = Self { offset: 3.0, matrix: 0.3, enough: 0.02, exact: true };
}

/// One reading.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reading {
    pub vector: Vector3<f64>,
    /// Standard deviation of its noise, each axis.
    pub noise: f64,
    /// What it is worth: one over a variance of its length.
    pub weight: f64,
}

/// A fitted ellipsoid.
#[derive(Clone, Debug)]
pub(super) struct Ellipsoid {
    pub offset: Vector3<f64>,
    pub offset_sd: Vector3<f64>,
    /// Symmetric.
    pub matrix: Matrix3<f64>,
    pub matrix_sd: Matrix3<f64>,
    pub length: f64,
    pub residual: f64,
    pub offset_seen: [bool; 3],
    pub scale_seen: [bool; 3],
    /// Of the pairs x y, x z, y z.
    pub cross_seen: [bool; 3],
}

/// Offset (3), matrix (xx yy zz xy xz yz), length.
const UNKNOWNS: usize = 10;
/// All but the length have a usual value.
pub(super) const HOLDABLE: usize = UNKNOWNS - 1;
const PAIRS: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];

type Unknowns = SVector<f64, UNKNOWNS>;

fn symmetric(x: &Unknowns) -> Matrix3<f64> {
    Matrix3::new(x[3], x[6], x[7], x[6], x[4], x[8], x[7], x[8], x[5])
}

impl Ellipsoid {
    /// Which unknowns the readings do not tell.
    pub(super) fn unseen(&self) -> [bool; HOLDABLE] {
        let seen = [self.offset_seen, self.scale_seen, self.cross_seen].concat();
        std::array::from_fn(|i| !seen[i])
    }

    /// With the unknowns `back` put back to their usual values, exactly 0 or 1, and the rest as it is. `length` is that of the
    /// true vector, where it is known; otherwise the readings give it anew.
    pub(super) fn put_back(
        mut self,
        back: &[bool; HOLDABLE],
        points: &[Reading],
        length: Option<f64>,
    ) -> Option<Self> {
        for i in (0..HOLDABLE).filter(|i| back[*i]) {
            if i < 3 {
                self.offset[i] = 0.0;
            } else {
                let (row, column) = PAIRS[i - 3];
                let usual = if row == column { 1.0 } else { 0.0 };
                (self.matrix[(row, column)], self.matrix[(column, row)]) = (usual, usual);
            }
        }
        let inverse = self.matrix.try_inverse()?;
        let (mut sum, mut weights, mut squares) = (0.0, 0.0, 0.0);
        for point in points {
            let left = self.left(&inverse, point);
            sum += point.weight * left;
            weights += point.weight;
            squares += left * left;
        }
        let shift = if length.is_some() { 0.0 } else { sum / weights.max(f64::MIN_POSITIVE) };
        self.length += shift;
        if back.contains(&true) {
            self.residual = (squares / points.len().max(1) as f64 - shift * shift).max(0.0).sqrt();
        }
        Some(self)
    }

    /// What is left of the length of a reading, without the lengthening by its noise.
    pub(super) fn left(&self, inverse: &Matrix3<f64>, reading: &Reading) -> f64 {
        let truth = inverse * (reading.vector - self.offset);
        let norm = truth.norm();
        let along = (inverse * truth).norm_squared() / (norm * norm).max(f64::MIN_POSITIVE);
        let longer = 0.5 * reading.noise * reading.noise * (inverse.norm_squared() - along) / norm;
        norm - self.length - longer
    }

    /// Fits `points`, from an ellipsoid that is near, where one is known; `length` is that of the true vector, where it is
    /// known. `None` where there is no vector to fit.
    pub(super) fn fit(
        points: &[Reading],
        length: Option<f64>,
        prior: &Prior,
        near: Option<&Self>,
    ) -> Option<Self> {
        let centre = points.iter().map(|p| p.vector).sum::<Vector3<f64>>() / points.len().max(1) as f64;
        let size = points.iter().map(|p| p.vector.norm()).sum::<f64>() / points.len().max(1) as f64;
        // Without a length: the radius about the middle of the readings, or, where they hardly turn, about zero.
        let (low, high) =
            points.iter().fold((centre, centre), |(low, high), p| (low.inf(&p.vector), high.sup(&p.vector)));
        let radius = (high - low).amax() * 0.5;
        let turned = length.is_none() && radius > 0.5 * size.min((high - low).norm());
        let start_length = length.unwrap_or(if turned { radius } else { size });
        if !(start_length.is_finite() && start_length > 0.0 && size > 0.0) {
            return None;
        }
        // In units of the length.
        let unit = start_length;
        let start_offset =
            if prior.offset > 1.0 && turned { (low + high) * (0.5 / unit) } else { Vector3::zeros() };
        let mut x = Unknowns::zeros();
        x.fixed_rows_mut::<3>(0).copy_from(&start_offset);
        (3..6).for_each(|i| x[i] = 1.0);
        x[9] = 1.0;
        let mut believed = x;
        if let Some(near) = near {
            x.fixed_rows_mut::<3>(0).copy_from(&(near.offset / unit));
            PAIRS.iter().enumerate().for_each(|(i, pair)| x[3 + i] = near.matrix[*pair]);
            x[9] = near.length / unit;
        }
        (0..3).for_each(|i| believed[i] = 0.0);
        let mut deviations = Unknowns::repeat(prior.matrix);
        (0..3).for_each(|i| deviations[i] = prior.offset);
        deviations[9] = if length.is_some() { 1e-7 } else { 1.0 };
        let mut information = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::zeros();
        let mut squares = 0.0;
        for round in 0..30 {
            let inverse = symmetric(&x).try_inverse()?;
            information.fill(0.0);
            let mut gradient = Unknowns::zeros();
            squares = 0.0;
            for Reading { vector, noise, weight } in points {
                let truth = inverse * (vector / unit - x.fixed_rows::<3>(0));
                let norm = truth.norm();
                if norm < 1e-6 {
                    continue;
                }
                let noise = noise / unit;
                let back = inverse * (truth / norm);
                let along = back.norm_squared();
                // Noise across the vector lengthens it.
                let longer = 0.5 * noise * noise * (inverse.norm_squared() - along) / norm;
                let left = norm - x[9] - longer;
                // In the derivatives the vector has the length that it should have: the one that was measured shares
                // its noise with what is left.
                let truth = truth * (x[9] / norm);
                let mut row = Unknowns::zeros();
                row.fixed_rows_mut::<3>(0).copy_from(&-back);
                for (i, (j, k)) in PAIRS.iter().enumerate() {
                    let both = back[*j] * truth[*k] + if j == k { 0.0 } else { back[*k] * truth[*j] };
                    row[3 + i] = -both;
                }
                row[9] = -1.0;
                let weight = (weight * unit * unit).min(1e18) / along;
                information.ger(weight, &row, &row, 1.0);
                gradient.axpy(-weight * left, &row, 1.0);
                squares += weight * left * left;
            }
            for i in 0..UNKNOWNS {
                let weight = deviations[i].powi(-2);
                information[(i, i)] += weight;
                gradient[i] += weight * (believed[i] - x[i]);
            }
            if length.is_none() {
                // The mean scale is 1: scale and length cannot be told apart.
                let row = Unknowns::from_fn(|i, _| if (3..6).contains(&i) { 1.0 / 3.0 } else { 0.0 });
                let left = (x[3] + x[4] + x[5]) / 3.0 - 1.0;
                information.ger(1e12, &row, &row, 1.0);
                gradient.axpy(-1e12 * left, &row, 1.0);
            }
            let step = information.cholesky()?.solve(&gradient);
            // Far from the answer a whole step may leave the ellipsoid.
            let most = step.amax();
            x += step * (0.3 / most).min(1.0);
            if most < 1e-10 && round > 0 {
                break;
            }
        }
        if !x.iter().all(|value| value.is_finite()) {
            return None;
        }
        let freedom = points.len() as f64 - 9.0;
        // Where the readings scatter more than their noise says, nothing is known as well as it says.
        let wider = if freedom >= 3.0 && !prior.exact { (squares / freedom).max(1.0) } else { 1.0 };
        let covariance = information.try_inverse()?;
        let posterior = |i: usize| (covariance[(i, i)] * wider).sqrt().min(deviations[i]);
        let seen = |i: usize| posterior(i) < prior.enough;
        let mut matrix_sd = Matrix3::zeros();
        for (i, (j, k)) in PAIRS.iter().enumerate() {
            matrix_sd[(*j, *k)] = posterior(3 + i);
            matrix_sd[(*k, *j)] = posterior(3 + i);
        }
        let matrix = symmetric(&x);
        let inverse = matrix.try_inverse()?;
        let offset = x.fixed_rows::<3>(0) * unit;
        let length = x[9] * unit;
        let left = |p: &Reading| ((inverse * (p.vector - offset)).norm() - length).powi(2);
        Some(Self {
            offset,
            offset_sd: Vector3::from_fn(|i, _| posterior(i) * unit),
            matrix,
            matrix_sd,
            length,
            residual: (points.iter().map(left).sum::<f64>() / points.len() as f64).sqrt(),
            offset_seen: std::array::from_fn(seen),
            scale_seen: std::array::from_fn(|i| seen(3 + i)),
            cross_seen: std::array::from_fn(|i| seen(6 + i)),
        })
    }

    /// Where a reading's true vector points, in the frame in which the matrix is symmetric.
    pub(super) fn direction(&self, reading: &Vector3<f64>) -> Option<Vector3<f64>> {
        (self.matrix.try_inverse()? * (reading - self.offset)).try_normalize(1e-9)
    }
}
