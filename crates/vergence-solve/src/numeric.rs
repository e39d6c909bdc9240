//! Derivatives by central differences, to check those that are written down.

use nalgebra::{SMatrix, SVector};

/// The derivative of `residual` by its argument at zero, by Richardson's extrapolation of central differences with steps of
/// `h` and `h`/2: the error falls with h⁴. `residual` takes a step from the state it was made with.
pub fn jacobian<const D: usize, const N: usize>(
    h: f64,
    mut residual: impl FnMut(&SVector<f64, N>) -> SVector<f64, D>,
) -> SMatrix<f64, D, N> {
    let mut found = SMatrix::<f64, D, N>::zeros();
    let mut slope = |column: usize, h: f64| {
        let mut by = SVector::<f64, N>::zeros();
        by[column] = h;
        (residual(&by) - residual(&-by)) / (2.0 * h)
    };
    for column in 0..N {
        let (coarse, fine) = (slope(column, h), slope(column, 0.5 * h));
        found.set_column(column, &((fine * 4.0 - coarse) / 3.0));
    }
    found
}

/// The largest difference between a derivative and the numerical one, as a share of 1 and of the largest entry.
pub fn error<const D: usize, const N: usize>(
    written: &SMatrix<f64, D, N>,
    numeric: &SMatrix<f64, D, N>,
) -> f64 {
    (written - numeric).amax() / (1.0 + numeric.amax())
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Vector3};
    use vergence_geom::{advance, exp, log, right_jacobian_inverse};

    use super::*;

    #[test]
    fn a_right_derivative_passes_and_a_wrong_one_does_not() {
        let at = Vector3::new(0.3, -1.1, 0.7);
        let numeric: Matrix3<f64> = jacobian(1e-3, |by| log(&advance(&exp(&at), by)));
        assert!(error(&right_jacobian_inverse(&at), &numeric) < 1e-10);
        assert!(error(&right_jacobian_inverse(&-at), &numeric) > 1e-2);
    }
}
