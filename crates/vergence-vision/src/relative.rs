//! What two views of the same points say of each other: essential matrix and homography.

use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, UnitQuaternion, Vector3};
use vergence_geom::Rigid;

use crate::{RansacKnobs, consensus, epipolar_angle};

/// Directions of length 1 to the same point in the first and in the second camera.
pub type RayPair = (Vector3<f64>, Vector3<f64>);

/// The vector that all rows send nearest to zero, by the sum of their squares.
fn nearest_to_null(square: SMatrix<f64, 9, 9>) -> SVector<f64, 9> {
    let eigen = square.symmetric_eigen();
    eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned()
}

fn matrix(of: &SVector<f64, 9>) -> Matrix3<f64> {
    Matrix3::from_row_slice(of.as_slice())
}

/// The essential matrix with `first · E second = 0` for eight matches or more; `None` with fewer. After H. Longuet-Higgins, "A Computer
/// Algorithm for Reconstructing a Scene from Two Projections", 1981; directions need no scaling of pixels.
pub fn essential(matches: &[RayPair], of: &[usize]) -> Option<Matrix3<f64>> {
    if of.len() < 8 {
        return None;
    }
    let mut square = SMatrix::<f64, 9, 9>::zeros();
    for &k in of {
        let (first, second) = &matches[k];
        let row = SVector::<f64, 9>::from_fn(|i, _| first[i / 3] * second[i % 3]);
        square += row * row.transpose();
    }
    let svd = matrix(&nearest_to_null(square)).svd(true, true);
    let (u, vt) = (svd.u?, svd.v_t?);
    // The nearest with two equal singular values and one of zero.
    Some(u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 0.0)) * vt)
}

/// The four relative poses (first from second, translation of length 1) of an essential matrix.
pub fn poses_of_essential(essential: &Matrix3<f64>) -> Option<[Rigid; 4]> {
    let svd = essential.svd(true, true);
    let (mut u, mut vt) = (svd.u?, svd.v_t?);
    u *= u.determinant().signum();
    vt *= vt.determinant().signum();
    let quarter = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    let turn =
        |w: Matrix3<f64>| UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * w * vt));
    let (a, b, way) = (turn(quarter), turn(quarter.transpose()), u.column(2).into_owned());
    Some([(a, 1.0), (a, -1.0), (b, 1.0), (b, -1.0)].map(|(r, s)| Rigid::from_parts((way * s).into(), r)))
}

/// Whether both rays meet before both cameras.
fn before_both(pose: &Rigid, pair: &RayPair) -> bool {
    let second = pose.rotation * pair.1;
    let (cosine, way) = (pair.0.dot(&second), &pose.translation.vector);
    let (a, b) = (pair.0.dot(way), second.dot(way));
    // Distances along the rays, times one minus the square of the cosine.
    a - cosine * b > 0.0 && cosine * a - b > 0.0
}

/// The relative pose of two views (first from second, translation of length 1) for matches of which some may be wrong, and which of them are
/// right: those within `angle_rad` of their epipolar planes and before both cameras. `None` where no more than eight agree. Points on one
/// plane do not determine it, and views without parallax do not determine the translation: see [`homography`].
pub fn relative_pose(
    matches: &[RayPair],
    angle_rad: f64,
    knobs: &RansacKnobs,
) -> Option<(Rigid, Vec<usize>)> {
    let agrees = |pose: &Rigid, k: usize| {
        let (first, second) = &matches[k];
        let there = epipolar_angle(&pose.inverse(), first, second);
        let here = epipolar_angle(pose, second, first);
        there.zip(here).is_some_and(|(a, b)| a.abs().max(b.abs()) < angle_rad)
            && before_both(pose, &matches[k])
    };
    let best = |of: &[usize]| {
        let poses = poses_of_essential(&essential(matches, of)?)?;
        let fine = |pose: &Rigid| of.iter().filter(|k| before_both(pose, &matches[**k])).count();
        poses.into_iter().max_by_key(fine)
    };
    let guess = |of: &[usize], into: &mut Vec<Rigid>| into.extend(best(of));
    let (mut pose, mut fine) = consensus(matches.len(), 8, knobs, guess, agrees)?;
    for _ in 0..2 {
        let Some(next) = best(&fine) else { break };
        let agreeing: Vec<usize> = (0..matches.len()).filter(|k| agrees(&next, *k)).collect();
        if agreeing.len() < fine.len() {
            break;
        }
        (pose, fine) = (next, agreeing);
    }
    Some((pose, fine))
}

/// The matrix that takes directions of the first camera to those of the second, of points on one plane or without parallax, for matches of
/// which some may be wrong; and which of them are right, within `angle_rad`. Its determinant is 1. `None` where no more than four agree.
pub fn homography(
    matches: &[RayPair],
    angle_rad: f64,
    knobs: &RansacKnobs,
) -> Option<(Matrix3<f64>, Vec<usize>)> {
    let fit = |of: &[usize]| {
        let mut square = SMatrix::<f64, 9, 9>::zeros();
        for &k in of {
            let (first, second) = &matches[k];
            let cross = second.cross_matrix();
            let rows = SMatrix::<f64, 3, 9>::from_fn(|i, j| cross[(i, j / 3)] * first[j % 3]);
            square += rows.tr_mul(&rows);
        }
        let found = matrix(&nearest_to_null(square));
        let size = found.determinant().cbrt();
        (size.abs() > 1e-6).then(|| found / size)
    };
    let cosine = angle_rad.clamp(0.0, std::f64::consts::FRAC_PI_2).cos();
    let agrees = |h: &Matrix3<f64>, k: usize| {
        let carried = h * matches[k].0;
        carried.dot(&matches[k].1) > cosine * carried.norm()
    };
    let guess = |of: &[usize], into: &mut Vec<Matrix3<f64>>| into.extend(fit(of));
    let (mut found, mut fine) = consensus(matches.len(), 4, knobs, guess, agrees)?;
    if let Some(next) = fit(&fine) {
        let agreeing: Vec<usize> = (0..matches.len()).filter(|k| agrees(&next, *k)).collect();
        if agreeing.len() >= fine.len() {
            (found, fine) = (next, agreeing);
        }
    }
    Some((found, fine))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use vergence_geom::exp;

    use super::*;

    /// Of points at random depth or on a plane, the first `wrong` of them by chance.
    fn matches(first_from_second: &Rigid, plane: bool, wrong: usize) -> Vec<RayPair> {
        let wave = |k: usize, f: f64| (k as f64 * f).sin();
        (0..80)
            .map(|k| {
                let (x, y) = (wave(k, 1.7) * 2.0, wave(k, 2.3) * 1.5);
                let z = if plane { 3.0 + 0.2 * x - 0.1 * y } else { 3.0 + wave(k, 0.9) };
                let point = Vector3::new(x, y, z);
                let second = (first_from_second.inverse() * nalgebra::Point3::from(point)).coords.normalize();
                let chance = Vector3::new(wave(k, 3.3), wave(k, 4.1), 1.0).normalize();
                (point.normalize(), if k < wrong { chance } else { second })
            })
            .collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn relative_poses_are_found_among_wrong_matches(v in proptest::collection::vec(-1.0..1.0f64, 6)) {
            let way = Vector3::new(v[0], v[1], v[2]);
            prop_assume!(way.norm() > 0.3);
            let truth = Rigid::from_parts((way * 0.4).into(), exp(&(Vector3::new(v[3], v[4], v[5]) * 0.2)));
            let (pose, fine) = relative_pose(&matches(&truth, false, 16), 2e-3, &RansacKnobs::default()).unwrap();
            prop_assert!(pose.rotation.angle_to(&truth.rotation) < 1e-2, "{pose}");
            prop_assert!((pose.translation.vector - way.normalize()).norm() < 5e-2, "{pose} {way}");
            prop_assert!((16..80).filter(|k| fine.contains(k)).count() >= 60, "{fine:?}");

            let pairs = matches(&truth, true, 24);
            let (h, fine) = homography(&pairs, 1e-3, &RansacKnobs::default()).unwrap();
            prop_assert!((h.determinant() - 1.0).abs() < 1e-9);
            prop_assert!((24..80).all(|k| fine.contains(&k)), "{fine:?}");
            for (first, second) in &pairs[24..] {
                prop_assert!(((h * first).normalize() - second).norm() < 1e-4);
            }
        }
    }

    #[test]
    fn too_few_or_equal_matches_give_nothing() {
        let knobs = RansacKnobs::default();
        assert!(relative_pose(&[], 1e-3, &knobs).is_none() && homography(&[], 1e-3, &knobs).is_none());
        // No translation: whatever is said of it, nothing is said of the rotation that is not so.
        let same = matches(&Rigid::identity(), false, 0);
        assert!(relative_pose(&same, 1e-3, &knobs).is_none_or(|(pose, _)| pose.rotation.angle() < 1e-2));
        // A turn alone is a homography.
        let turn = Rigid::from_parts(Vector3::zeros().into(), exp(&Vector3::new(0.1, -0.2, 0.05)));
        let (h, fine) = homography(&matches(&turn, false, 10), 1e-3, &knobs).unwrap();
        assert!(fine.len() >= 70);
        assert!((h - turn.rotation.inverse().to_rotation_matrix().matrix()).norm() < 1e-6);
    }
}
