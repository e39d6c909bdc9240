//! The ellipsoid that a triad's readings of a vector of one length lie on.
//!
//! Maximum a posteriori by Gauss and Newton on the lengths: `r = |matrix⁻¹ (m − offset)| − length` with a symmetric
//! matrix. Ten unknowns and a weak prior need no solver of their own; the prior keeps what the readings do not tell at
//! its usual value, and the posterior says what that was.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// What units of this kind have before anything is seen of them: standard deviations, as shares of the length.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prior {
    /// Of the offset.
    pub offset: f64,
    /// Of scale factors about 1 and cross-axis terms about 0.
    pub matrix: f64,
    /// Whether the readings' own scatter says what each is worth, not the deviation given with it.
    pub scatter_is_noise: bool,
}

impl Prior {
    /// Half a metre per second squared, five in a hundred.
    pub(super) const ACCELEROMETER: Self = Self { offset: 0.05, matrix: 0.05, scatter_is_noise: false };
    /// Hard and soft iron may be as large as the field.
    pub(super) const MAGNETOMETER: Self = Self { offset: 3.0, matrix: 0.3, scatter_is_noise: true };
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
const PAIRS: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];

type Unknowns = SVector<f64, UNKNOWNS>;

fn symmetric(x: &Unknowns) -> Matrix3<f64> {
    Matrix3::new(x[3], x[6], x[7], x[6], x[4], x[8], x[7], x[8], x[5])
}

impl Ellipsoid {
    /// Fits `points` (reading, standard deviation of each of its axes); `length` is that of the true vector, where it is
    /// known. `None` where there is no vector to fit.
    pub(super) fn fit(points: &[(Vector3<f64>, f64)], length: Option<f64>, prior: &Prior) -> Option<Self> {
        let centre = points.iter().map(|(m, _)| *m).sum::<Vector3<f64>>() / points.len().max(1) as f64;
        let size = points.iter().map(|(m, _)| m.norm()).sum::<f64>() / points.len().max(1) as f64;
        // Without a length: the radius about the middle of the readings, or, where they hardly turn, about zero.
        let (low, high) =
            points.iter().fold((centre, centre), |(low, high), (m, _)| (low.inf(m), high.sup(m)));
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
        (0..3).for_each(|i| believed[i] = 0.0);
        let mut deviations = Unknowns::repeat(prior.matrix);
        (0..3).for_each(|i| deviations[i] = prior.offset);
        deviations[9] = if length.is_some() { 1e-7 } else { 1.0 };
        let mut noise = 0.02;
        let mut information = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::zeros();
        let mut squares = 0.0;
        for round in 0..30 {
            let inverse = symmetric(&x).try_inverse()?;
            information.fill(0.0);
            let mut gradient = Unknowns::zeros();
            let mut unweighted = 0.0;
            squares = 0.0;
            for (reading, deviation) in points {
                let truth = inverse * (reading / unit - x.fixed_rows::<3>(0));
                let norm = truth.norm();
                if norm < 1e-6 {
                    continue;
                }
                let deviation = if prior.scatter_is_noise { noise } else { (deviation / unit).max(1e-9) };
                let back = inverse * (truth / norm);
                let along = back.norm_squared();
                // Noise across the vector lengthens it.
                let longer = 0.5 * deviation * deviation * (inverse.norm_squared() - along) / norm;
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
                let weight = 1.0 / (deviation * deviation * along);
                information.ger(weight, &row, &row, 1.0);
                gradient.axpy(-weight * left, &row, 1.0);
                squares += weight * left * left;
                unweighted += left * left / along;
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
            if prior.scatter_is_noise {
                let freedom = (points.len() as f64 - 10.0).max(1.0);
                noise = (unweighted / freedom).sqrt().max(1e-6);
            }
            if most < 1e-12 && round > 3 {
                break;
            }
        }
        if !x.iter().all(|value| value.is_finite()) {
            return None;
        }
        let freedom = points.len() as f64 - 9.0;
        // Where the readings scatter more than their noise says, nothing is known as well as it says.
        let wider = if freedom >= 3.0 { (squares / freedom).max(1.0) } else { 1.0 };
        let covariance = information.try_inverse()?;
        let posterior = |i: usize| (covariance[(i, i)] * wider).sqrt().min(deviations[i]);
        let seen = |i: usize| posterior(i) < 0.5 * deviations[i];
        let mut matrix_sd = Matrix3::zeros();
        for (i, (j, k)) in PAIRS.iter().enumerate() {
            matrix_sd[(*j, *k)] = posterior(3 + i);
            matrix_sd[(*k, *j)] = posterior(3 + i);
        }
        let matrix = symmetric(&x);
        let inverse = matrix.try_inverse()?;
        let offset = x.fixed_rows::<3>(0) * unit;
        let length = x[9] * unit;
        let left = |(m, _): &(Vector3<f64>, f64)| ((inverse * (m - offset)).norm() - length).powi(2);
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
