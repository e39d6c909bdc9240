//! Where a camera is, from points whose places are known: perspective-n-point, with and without gravity.

use nalgebra::{Matrix3, Matrix4, SMatrix, SVector, Translation3, Unit, UnitQuaternion, Vector3};
use vergence_geom::{Rigid, exp};

use crate::{RansacKnobs, consensus};

/// A point in the world, m, and the direction that it is seen in by the camera (of length 1).
pub type Landmark = (Vector3<f64>, Vector3<f64>);

/// `camera_from_world` for landmarks of which some may be wrong, and which of them are right: those that the camera sees within
/// `angle_rad`. `None` where fewer than five agree. Minimal solutions after J. Grunert, 1841, as told by R. Haralick et al., "Review and
/// Analysis of Solutions of the Three Point Perspective Pose Estimation Problem", 1994; then least squares over all that agree.
pub fn camera_pose(
    landmarks: &[Landmark],
    angle_rad: f64,
    knobs: &RansacKnobs,
) -> Option<(Rigid, Vec<usize>)> {
    let guess = |k: &[usize], into: &mut Vec<Rigid>| {
        three_points(&[landmarks[k[0]], landmarks[k[1]], landmarks[k[2]]], into);
    };
    settle(landmarks, 3, angle_rad, knobs, None, guess)
}

/// As [`camera_pose`], where the direction of gravity is known in both: `up_in_world` and `up_in_camera` (of length 1). Two points
/// make a guess, so that fewer guesses are needed, and the answer keeps to gravity. After Z. Kukelova, M. Bujnak, T. Pajdla, "Closed-Form
/// Solutions to Minimal Absolute Pose Problems with Known Vertical Direction", 2010.
pub fn camera_pose_upright(
    landmarks: &[Landmark],
    up_in_world: &Vector3<f64>,
    up_in_camera: &Vector3<f64>,
    angle_rad: f64,
    knobs: &RansacKnobs,
) -> Option<(Rigid, Vec<usize>)> {
    let up = Unit::try_new(*up_in_camera, 1e-9)?;
    let level = UnitQuaternion::rotation_between(up_in_world, up_in_camera).unwrap_or_else(|| {
        let across = up_in_world.cross(&Vector3::ith(up_in_world.iamin(), 1.0));
        UnitQuaternion::from_axis_angle(&Unit::new_normalize(across), std::f64::consts::PI)
    });
    let guess = |k: &[usize], into: &mut Vec<Rigid>| {
        two_points(&[landmarks[k[0]], landmarks[k[1]]], &level, &up, into);
    };
    settle(landmarks, 2, angle_rad, knobs, Some(&up), guess)
}

fn settle(
    landmarks: &[Landmark],
    sample: usize,
    angle_rad: f64,
    knobs: &RansacKnobs,
    about: Option<&Unit<Vector3<f64>>>,
    guess: impl FnMut(&[usize], &mut Vec<Rigid>),
) -> Option<(Rigid, Vec<usize>)> {
    const FEWEST: usize = 5;
    let cosine = angle_rad.clamp(0.0, std::f64::consts::FRAC_PI_2).cos();
    let agrees = |pose: &Rigid, k: usize| {
        let (point, ray) = &landmarks[k];
        let seen = pose.rotation * point + pose.translation.vector;
        seen.dot(ray) > cosine * seen.norm()
    };
    let (mut pose, mut fine) = consensus(landmarks.len(), sample, knobs, guess, agrees)?;
    for _ in 0..2 {
        pose = refined(landmarks, &fine, &pose, about);
        fine = (0..landmarks.len()).filter(|k| agrees(&pose, *k)).collect();
    }
    (fine.len() >= FEWEST).then_some((pose, fine))
}

/// Poses from three landmarks: up to four.
fn three_points(l: &[Landmark; 3], into: &mut Vec<Rigid>) {
    let square = |i: usize, j: usize| (l[i].0 - l[j].0).norm_squared();
    let (a, b, c) = (square(1, 2), square(0, 2), square(0, 1));
    let (cos_a, cos_b, cos_c) = (l[1].1.dot(&l[2].1), l[0].1.dot(&l[2].1), l[0].1.dot(&l[1].1));
    if a.min(b).min(c) < 1e-18 {
        return;
    }
    let (d, s, q, p) = ((a - c) / b, (a + c) / b, c / b, a / b);
    let coefficients = [
        (1.0 + d).powi(2) - 4.0 * p * cos_c * cos_c,
        4.0 * (-d * (1.0 + d) * cos_b + 2.0 * p * cos_c * cos_c * cos_b - (1.0 - s) * cos_a * cos_c),
        2.0 * (d * d - 1.0 + 2.0 * d * d * cos_b * cos_b + 2.0 * (1.0 - q) * cos_a * cos_a
            - 4.0 * s * cos_a * cos_b * cos_c
            + 2.0 * (1.0 - p) * cos_c * cos_c),
        4.0 * (d * (1.0 - d) * cos_b - (1.0 - s) * cos_a * cos_c + 2.0 * q * cos_a * cos_a * cos_b),
        (d - 1.0).powi(2) - 4.0 * q * cos_a * cos_a,
    ];
    for v in quartic(&coefficients).into_iter().flatten() {
        let below = 2.0 * (cos_c - v * cos_a);
        let u = ((d - 1.0) * v * v - 2.0 * d * cos_b * v + 1.0 + d) / below;
        let first = (b / (1.0 + v * v - 2.0 * v * cos_b)).sqrt();
        if !(v > 0.0 && u > 0.0 && u.is_finite() && first.is_finite()) {
            continue;
        }
        let seen = [l[0].1 * first, l[1].1 * (first * u), l[2].1 * (first * v)];
        let axes = |o: Vector3<f64>, x: Vector3<f64>, y: Vector3<f64>| {
            let normal = (x - o).cross(&(y - o)).try_normalize(1e-15)?;
            let along = (x - o).normalize();
            Some(Matrix3::from_columns(&[along, normal.cross(&along), normal]))
        };
        let (Some(there), Some(here)) = (axes(l[0].0, l[1].0, l[2].0), axes(seen[0], seen[1], seen[2]))
        else {
            continue;
        };
        let turn = here * there.transpose();
        let rotation =
            UnitQuaternion::from_rotation_matrix(&nalgebra::Rotation3::from_matrix_unchecked(turn));
        let place = seen[0] - rotation * l[0].0;
        into.push(Rigid::from_parts(place.into(), rotation));
    }
}

/// Real roots of c0 + c1 x + … + c4 x⁴, by the eigenvalues of its companion matrix and two of Newton's steps.
fn quartic(c: &[f64; 5]) -> [Option<f64>; 4] {
    let size = c.iter().fold(0.0f64, |most, x| most.max(x.abs()));
    if !(size.is_finite() && c[4].abs() > 1e-12 * size) {
        return [None; 4];
    }
    let mut companion = Matrix4::zeros();
    for i in 0..4 {
        companion[(i, 3)] = -c[i] / c[4];
        if i > 0 {
            companion[(i, i - 1)] = 1.0;
        }
    }
    let Some(schur) = nalgebra::Schur::try_new(companion, f64::EPSILON, 200) else { return [None; 4] };
    let roots = schur.complex_eigenvalues();
    std::array::from_fn(|k| {
        let root = roots[k];
        let near = root.im.abs() < 1e-4 * (1.0 + root.re.abs());
        near.then(|| {
            let mut x = root.re;
            for _ in 0..2 {
                let value = c.iter().rev().fold(0.0, |sum, k| sum * x + k);
                let slope = (1..5).rev().fold(0.0, |sum, k| sum * x + k as f64 * c[k]);
                let step = value / slope;
                if step.is_finite() && step.abs() < 0.1 * (1.0 + x.abs()) {
                    x -= step;
                }
            }
            x
        })
    })
}

/// Poses from two landmarks and gravity: up to two. d₁ r₁ − d₂ r₂ = R (X₁ − X₂) has no part along r₁ × r₂.
fn two_points(
    l: &[Landmark; 2],
    level: &UnitQuaternion<f64>,
    up: &Unit<Vector3<f64>>,
    into: &mut Vec<Rigid>,
) {
    let normal = l[0].1.cross(&l[1].1);
    let way = level * (l[0].0 - l[1].0);
    // Turned by θ about `up`: its part along it, cos θ times the rest, sin θ times the rest turned by a right angle.
    let along = up.into_inner() * up.dot(&way);
    let (still, cosine, sine) = (normal.dot(&along), normal.dot(&(way - along)), normal.dot(&up.cross(&way)));
    let size = cosine.hypot(sine);
    if size.is_nan() || size < 1e-12 || still.abs() > size {
        return;
    }
    let (middle, side) = (sine.atan2(cosine), (-still / size).acos());
    for angle in [middle + side, middle - side] {
        let rotation = UnitQuaternion::from_axis_angle(up, angle) * level;
        let turned = rotation * (l[0].0 - l[1].0);
        let rays = SMatrix::<f64, 3, 2>::from_columns(&[l[0].1, -l[1].1]);
        let Some(inverse) = (rays.transpose() * rays).try_inverse() else { continue };
        let distances = inverse * rays.tr_mul(&turned);
        if distances.x > 0.0 && distances.y > 0.0 {
            let place = l[0].1 * distances.x - rotation * l[0].0;
            into.push(Rigid::from_parts(place.into(), rotation));
        }
    }
}

/// Least squares of the angles (their sines) over the landmarks `of`, from `pose`; about one axis of the camera only where one is given.
fn refined(landmarks: &[Landmark], of: &[usize], pose: &Rigid, about: Option<&Unit<Vector3<f64>>>) -> Rigid {
    let mut pose = *pose;
    for _ in 0..8 {
        let (mut square, mut slope) = (SMatrix::<f64, 6, 6>::zeros(), SVector::<f64, 6>::zeros());
        for &k in of {
            let (point, ray) = &landmarks[k];
            let turned = pose.rotation * point;
            let seen = turned + pose.translation.vector;
            let length = seen.norm();
            if length < 1e-9 {
                continue;
            }
            let unit = seen / length;
            let residual = ray.cross(&unit);
            let across = ray.cross_matrix() * (Matrix3::identity() - unit * unit.transpose()) / length;
            let mut by = SMatrix::<f64, 3, 6>::zeros();
            by.fixed_columns_mut::<3>(0).copy_from(&across);
            by.fixed_columns_mut::<3>(3).copy_from(&(across * -turned.cross_matrix()));
            square += by.tr_mul(&by);
            slope += by.tr_mul(&residual);
        }
        let step = match about {
            None => square.cholesky().map(|c| -c.solve(&slope)),
            Some(axis) => {
                let mut onto = SMatrix::<f64, 6, 4>::zeros();
                onto.fixed_view_mut::<3, 3>(0, 0).fill_diagonal(1.0);
                onto.fixed_view_mut::<3, 1>(3, 3).copy_from(axis);
                let small = onto.transpose() * square * onto;
                small.cholesky().map(|c| -(onto * c.solve(&onto.tr_mul(&slope))))
            }
        };
        let Some(step) = step.filter(|s| s.iter().all(|x| x.is_finite())) else { break };
        let turn = exp(&step.fixed_rows::<3>(3).into_owned());
        let place = pose.translation.vector + step.fixed_rows::<3>(0);
        pose = Rigid::from_parts(Translation3::from(place), turn * pose.rotation);
        if step.norm() < 1e-12 {
            break;
        }
    }
    pose
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn landmarks(pose: &Rigid, count: usize, wrong: usize, noise_rad: f64) -> Vec<Landmark> {
        let wave = |k: usize, f: f64| (k as f64 * f).sin();
        (0..count)
            .map(|k| {
                let seen = Vector3::new(wave(k, 1.7) * 2.0, wave(k, 2.3) * 1.5, 3.0 + 1.5 * wave(k, 0.9));
                let world = pose.inverse() * nalgebra::Point3::from(seen);
                let ray = seen.normalize() + Vector3::new(wave(k, 5.1), wave(k, 7.7), 0.0) * noise_rad;
                let ray = if k < wrong { Vector3::new(wave(k, 3.3), wave(k, 4.1), 1.0) } else { ray };
                (world.coords, ray.normalize())
            })
            .collect()
    }

    proptest! {
        #[test]
        fn poses_are_found_among_wrong_landmarks(v in proptest::collection::vec(-1.0..1.0f64, 6)) {
            let turn = Vector3::new(v[0], v[1], v[2]) * 2.0;
            let truth = Rigid::from_parts(Translation3::new(v[3] * 5.0, v[4] * 5.0, v[5] * 5.0), exp(&turn));
            let seen = landmarks(&truth, 60, 20, 0.0);
            let up = Vector3::new(v[1], 1.0, v[4]).normalize();
            let knobs = RansacKnobs::default();
            let free = camera_pose(&seen, 2e-3, &knobs).unwrap();
            let level = camera_pose_upright(&seen, &up, &(truth.rotation * up), 2e-3, &knobs).unwrap();
            for (pose, fine) in [free, level] {
                let off = truth.inverse() * pose;
                prop_assert!(off.translation.vector.norm() < 1e-8 && off.rotation.angle() < 1e-8, "{off}");
                prop_assert!((20..60).all(|k| fine.contains(&k)) && fine.len() < 43, "{fine:?}");
            }
        }
    }

    #[test]
    fn noise_is_averaged_and_nothing_comes_of_nothing() {
        let truth = Rigid::new(Vector3::new(0.3, -0.2, 0.1), Vector3::new(0.1, 0.4, -0.2));
        let knobs = RansacKnobs::default();
        let (pose, fine) = camera_pose(&landmarks(&truth, 80, 30, 1e-3), 5e-3, &knobs).unwrap();
        assert!((truth.inverse() * pose).translation.vector.norm() < 2e-3 && fine.len() >= 50);
        let random = landmarks(&truth, 40, 40, 0.0);
        assert!(camera_pose(&random, 1e-3, &knobs).is_none());
        assert!(camera_pose(&[], 1e-3, &knobs).is_none());
        let same = vec![(Vector3::new(0.0, 0.0, 2.0), Vector3::z()); 10];
        assert!(camera_pose(&same, 1e-3, &knobs).is_none());
        assert!(camera_pose_upright(&same, &Vector3::y(), &Vector3::y(), 1e-3, &knobs).is_none());
    }
}
