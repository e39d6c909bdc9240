//! Rotations as unit quaternions: exponential, logarithm, interpolation, averaging, Jacobians.
//!
//! nalgebra has most of these names; what is here differs where it matters: `slerp` there panics at a half turn, its
//! exponential always takes a sine and a square root (the small angles of one sensor sample need neither), and nothing
//! there keeps the length of a product over hours.

use nalgebra::{Matrix3, Matrix4, Quaternion, SymmetricEigen, UnitQuaternion, Vector3};

use crate::Rigid;

/// Half angles below this (its square) take the power series, which is as exact there and needs no sine.
const SERIES_BELOW: f64 = 0.0625;

/// The part of a rotation that turns about the vertical: where the −z axis points, seen from above. Where it points
/// straight up or down, where +y does (of a head: its top).
pub fn yaw(rotation: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    let forward = rotation * -Vector3::z();
    let up = rotation * Vector3::y();
    let ahead = if forward.x.hypot(forward.z) > 1e-6 { forward } else { up * -forward.y.signum() };
    UnitQuaternion::from_axis_angle(&Vector3::y_axis(), (-ahead.x).atan2(-ahead.z))
}

/// The rotation about `rotation_rad`'s direction by its length (radians): the exponential of so(3).
///
/// Error of each component at most a few 1e-16 for lengths up to 2π, growing with the length as that of `sin` does. A
/// vector that is not finite, or longer than 1e153, is no rotation: it gives the identity.
///
/// ```
/// let quarter = vergence_geom::exp(&(nalgebra::Vector3::z() * std::f64::consts::FRAC_PI_2));
/// assert!((quarter * nalgebra::Vector3::x() - nalgebra::Vector3::y()).norm() < 1e-15);
/// ```
#[inline]
pub fn exp(rotation_rad: &Vector3<f64>) -> UnitQuaternion<f64> {
    let square = 0.25 * rotation_rad.norm_squared();
    let (w, half_sinc) = if square < SERIES_BELOW {
        let s = square;
        let sinc = 1.0 - s / 6.0 * (1.0 - s / 20.0 * (1.0 - s / 42.0 * (1.0 - s / 72.0 * (1.0 - s / 110.0))));
        let cos = 1.0 - s / 2.0 * (1.0 - s / 12.0 * (1.0 - s / 30.0 * (1.0 - s / 56.0 * (1.0 - s / 90.0))));
        (cos, 0.5 * sinc)
    } else if square.is_finite() {
        let half = square.sqrt();
        let (sin, cos) = half.sin_cos();
        (cos, 0.5 * sin / half)
    } else {
        return UnitQuaternion::identity();
    };
    UnitQuaternion::new_unchecked(Quaternion::from_parts(w, rotation_rad * half_sinc))
}

/// The shortest rotation vector (radians, length at most π) whose [`exp`] is `rotation`: the logarithm.
///
/// `q` and `−q` are one rotation and give one vector, except at exactly half a turn, where both directions of the axis
/// are right and that of the quaternion's vector part is given. Never NaN for finite input; all zeros give zero.
///
/// ```
/// let v = nalgebra::Vector3::new(1e-12, 0.0, -2e-12);
/// assert!((vergence_geom::log(&vergence_geom::exp(&v)) - v).norm() < 1e-27);
/// ```
#[inline]
pub fn log(rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
    let (vector, w) = (rotation.imag(), rotation.w);
    let (vector, w) = if w < 0.0 { (-vector, -w) } else { (vector, w) };
    let sine = vector.norm();
    // Below, the square of the sine is lost (or all of it): there the ratio is 2 to the last bit.
    let angle_over_sine = if sine > 1e-150 { 2.0 * sine.atan2(w) / sine } else { 2.0 };
    vector * angle_over_sine
}

/// `rotation` turned further, in its own frame, by [`exp`] of `rotation_rad` (radians); of unit length whatever the
/// number of steps: one step of Newton's iteration per call keeps the length within 2e-16 of 1.
#[inline]
pub fn advance(rotation: &UnitQuaternion<f64>, rotation_rad: &Vector3<f64>) -> UnitQuaternion<f64> {
    let mut next = rotation * exp(rotation_rad);
    next.renormalize_fast();
    next
}

/// The rotation that is `t` of the way from `from` to `to`, at constant speed, the shorter way round; `t` outside of
/// 0..=1 goes on. At half a turn both ways are as short: the one along the axis of `from⁻¹ to` as it is stored is taken.
pub fn slerp(from: &UnitQuaternion<f64>, to: &UnitQuaternion<f64>, t: f64) -> UnitQuaternion<f64> {
    advance(from, &(log(&(from.inverse() * to)) * t))
}

/// The pose that is `t` of the way from `from` to `to`: rotation by [`slerp`], the origin along the straight line, both
/// at constant speed. Equal to following the poses of a tracked body between two readings; it is not the screw motion.
pub fn interpolate(from: &Rigid, to: &Rigid, t: f64) -> Rigid {
    let translation = from.translation.vector.lerp(&to.translation.vector, t);
    Rigid::from_parts(translation.into(), slerp(&from.rotation, &to.rotation, t))
}

/// The weighted mean rotation: the one whose matrix has the least weighted sum of squared differences (Frobenius) from
/// the others. The signs of the quaternions do not matter.
///
/// `None` where there is none to tell: no rotation, a weight that is negative or not finite, all weights zero, or
/// rotations that cancel (two half a turn apart).
///
/// The dominant eigenvector of Σ w q qᵀ: F. L. Markley et al., "Averaging Quaternions", J. Guidance 30(4), 2007.
pub fn mean<'a>(
    weighted: impl IntoIterator<Item = (f64, &'a UnitQuaternion<f64>)>,
) -> Option<UnitQuaternion<f64>> {
    /// Relative distance of the two largest eigenvalues below which the mean is made of rounding errors.
    const AMBIGUOUS: f64 = 1e-12;
    let mut sum = Matrix4::zeros();
    for (weight, rotation) in weighted {
        if !(weight >= 0.0 && weight.is_finite()) {
            return None;
        }
        sum += weight * rotation.coords * rotation.coords.transpose();
    }
    if !sum.iter().all(|entry| entry.is_finite()) {
        return None;
    }
    let eigen = SymmetricEigen::new(sum);
    let largest = eigen.eigenvalues.imax();
    let top = eigen.eigenvalues[largest];
    let second = (0..4).filter(|&i| i != largest).map(|i| eigen.eigenvalues[i]).fold(0.0, f64::max);
    (top - second > AMBIGUOUS * top).then(|| {
        UnitQuaternion::new_normalize(Quaternion::from_vector(
            eigen.eigenvectors.column(largest).into_owned(),
        ))
    })
}

/// Stumpff's functions c₀ … c₇ at `square` = θ² ≥ 0: cₙ = Σ (−θ²)ᵏ / (2k + n)!, so c₀ = cos θ, c₁ = sin θ / θ, c₂ =
/// (1 − cos θ) / θ², and so on: the coefficients of every integral of a rotation, without cancellation at small angles.
/// Error at most 4e-15 of 1/n!. Their derivatives are dcₙ/d(θ²) = ½ (n cₙ₊₂ − cₙ₊₁).
pub fn stumpff(square: f64) -> [f64; 8] {
    /// 1/n!.
    const INVERSE_FACTORIAL: [f64; 8] =
        [1.0, 1.0, 1.0 / 2.0, 1.0 / 6.0, 1.0 / 24.0, 1.0 / 120.0, 1.0 / 720.0, 1.0 / 5040.0];
    let mut c = [0.0; 8];
    if square < 16.0 {
        // The last terms left out are below 1e-16 of the first.
        let terms = if square < 0.25 { 5 } else { 16 };
        for n in [6usize, 7] {
            let mut sum = 1.0;
            for k in (1..=terms).rev() {
                let m = (2 * k + n) as f64;
                sum = 1.0 - square / (m * (m - 1.0)) * sum;
            }
            c[n] = sum * INVERSE_FACTORIAL[n];
        }
        for n in (0..6).rev() {
            c[n] = INVERSE_FACTORIAL[n] - square * c[n + 2];
        }
    } else {
        let angle = square.sqrt();
        c[0] = angle.cos();
        c[1] = angle.sin() / angle;
        for n in 2..8 {
            c[n] = (INVERSE_FACTORIAL[n - 2] - c[n - 2]) / square;
        }
    }
    c
}

/// The left Jacobian of [`exp`] at `rotation_rad` (radians): `exp(v + d) ≈ exp(J d) exp(v)`; also the mean of the
/// rotation matrices `exp(s v)` over s in 0..1. The right one, `exp(v + d) ≈ exp(v) exp(J d)`, is its transpose.
pub fn left_jacobian(rotation_rad: &Vector3<f64>) -> Matrix3<f64> {
    let c = stumpff(rotation_rad.norm_squared());
    let cross = rotation_rad.cross_matrix();
    Matrix3::identity() + cross * c[2] + cross * cross * c[3]
}

/// The right Jacobian of [`exp`] at `rotation_rad` (radians): `exp(v + d) ≈ exp(v) exp(J d)`.
pub fn right_jacobian(rotation_rad: &Vector3<f64>) -> Matrix3<f64> {
    left_jacobian(rotation_rad).transpose()
}

/// The inverse of [`left_jacobian`], for lengths below 2π (where there is none).
pub fn left_jacobian_inverse(rotation_rad: &Vector3<f64>) -> Matrix3<f64> {
    let square = rotation_rad.norm_squared();
    let c = stumpff(square);
    let cross = rotation_rad.cross_matrix();
    // (1 − c₁ / (2 c₂)) / θ² with the leading terms cancelled by the recursion cₙ = 1/n! − θ² cₙ₊₂.
    let factor = (0.5 * c[3] - c[4]) / c[2];
    Matrix3::identity() - cross * 0.5 + cross * cross * factor
}

/// The inverse of [`right_jacobian`], for lengths below 2π (where there is none).
pub fn right_jacobian_inverse(rotation_rad: &Vector3<f64>) -> Matrix3<f64> {
    left_jacobian_inverse(rotation_rad).transpose()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use proptest::prelude::*;

    use super::*;

    /// Bar of every angle up to just below half a turn.
    const EXACT: f64 = 1e-14;
    /// Bar at half a turn, where the axis hangs on the last bits of the angle.
    const AT_HALF_TURN: f64 = 1e-13;

    /// A number as a sum of two, with about 31 digits: the truth for what has 16.
    #[derive(Clone, Copy)]
    struct Double(f64, f64);

    impl Double {
        fn sum(a: f64, b: f64) -> Self {
            let s = a + b;
            let t = s - a;
            Self(s, (a - (s - t)) + (b - t))
        }

        fn add(self, b: Self) -> Self {
            let s = Self::sum(self.0, b.0);
            Self::sum(s.0, s.1 + self.1 + b.1)
        }

        fn mul(self, b: Self) -> Self {
            let p = self.0 * b.0;
            Self::sum(p, self.0.mul_add(b.0, -p) + self.0 * b.1 + self.1 * b.0)
        }

        fn over(self, d: f64) -> Self {
            let q = self.0 / d;
            Self::sum(q, ((-q).mul_add(d, self.0) + self.1) / d)
        }
    }

    /// w, x, y, z of the exponential by its power series with 31 digits.
    fn truth(v: &Vector3<f64>) -> [f64; 4] {
        let half = [v.x, v.y, v.z].map(|x| Double(x * 0.5, 0.0));
        let square = half.iter().fold(Double(0.0, 0.0), |sum, &x| sum.add(x.mul(x)));
        let series = |first: f64| {
            let (mut term, mut sum) = (Double(1.0, 0.0), Double(1.0, 0.0));
            for k in 1..30 {
                let n = 2.0 * f64::from(k) + first;
                term = term.mul(square).over(-n * (n - 1.0));
                sum = sum.add(term);
            }
            sum
        };
        let (cos, sinc) = (series(0.0), series(1.0));
        [cos.0, half[0].mul(sinc).0, half[1].mul(sinc).0, half[2].mul(sinc).0]
    }

    fn parts(q: &UnitQuaternion<f64>) -> [f64; 4] {
        [q.w, q.i, q.j, q.k]
    }

    /// Angles from 1e-12 to π, with the neighbours of the end.
    fn angles() -> Vec<f64> {
        let mut all: Vec<f64> = (0..=1250).map(|k| 1e-12 * 10f64.powf(f64::from(k) / 100.0)).collect();
        all.retain(|angle| *angle < PI);
        all.extend([0.0, 5e-324, 1e-200, 1e-100, 0.4999, 0.5, 0.5001, PI - 1e-3, PI - 1e-8, PI - 1e-15, PI]);
        all
    }

    fn axes() -> [Vector3<f64>; 4] {
        [
            Vector3::x(),
            -Vector3::z(),
            Vector3::new(1.0, 2.0, -3.0).normalize(),
            Vector3::new(1e-9, -1.0, 1e-5).normalize(),
        ]
    }

    #[test]
    fn exponential_and_logarithm_are_exact_from_nothing_to_half_a_turn() {
        let (mut worst_exp, mut worst_log, mut worst_half) = (0f64, 0f64, 0f64);
        for angle in angles() {
            for axis in axes() {
                let v = axis * angle;
                let q = exp(&v);
                let error = parts(&q).iter().zip(truth(&v)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                worst_exp = worst_exp.max(error);
                let negated = UnitQuaternion::new_unchecked(-q.into_inner());
                for q in [q, negated] {
                    let back = log(&q);
                    assert!(back.iter().all(|x| x.is_finite()), "{angle}");
                    if PI - angle < 1e-7 {
                        // Either direction of the axis.
                        worst_half = worst_half.max((back - v).norm().min((back + v).norm()));
                    } else {
                        worst_log = worst_log.max((back - v).norm());
                        assert!((back - v).norm() <= 1e-15 * angle, "{angle}: {}", (back - v).norm());
                    }
                }
            }
        }
        println!("worst error: exp {worst_exp:e}, log {worst_log:e}, log at half a turn {worst_half:e}");
        assert!(worst_exp <= EXACT && worst_log <= EXACT && worst_half <= AT_HALF_TURN);
    }

    #[test]
    fn what_is_no_rotation_has_a_stated_answer() {
        for v in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e200] {
            assert_eq!(exp(&Vector3::new(0.0, v, 1.0)), UnitQuaternion::identity());
        }
        let zero = UnitQuaternion::new_unchecked(Quaternion::new(0.0, 0.0, 0.0, 0.0));
        assert_eq!(log(&zero), Vector3::zeros());
        let tiny = UnitQuaternion::new_unchecked(Quaternion::new(1.0, 1e-300, 0.0, 0.0));
        assert_eq!(log(&tiny), Vector3::new(2e-300, 0.0, 0.0));
    }

    /// Length and orthogonality after `steps` steps of changing size.
    fn drift(steps: u64) -> (f64, f64) {
        let mut q = UnitQuaternion::identity();
        let mut v = Vector3::new(0.003, -0.0071, 0.0113);
        let turn = exp(&Vector3::new(1e-3, 2e-3, -5e-4));
        for k in 0..steps {
            if k % 64 == 0 {
                v = turn * v;
            }
            q = advance(&q, &v);
        }
        let m = q.to_rotation_matrix().into_inner();
        ((q.quaternion().norm() - 1.0).abs(), (m.transpose() * m - Matrix3::identity()).norm())
    }

    #[test]
    fn steps_keep_length_and_orthogonality() {
        let (length, orthogonality) = drift(1_000_000);
        assert!(length <= 1e-15 && orthogonality <= 1e-14, "{length:e} {orthogonality:e}");
    }

    /// Seconds in release: `cargo test --release -p vergence-geom -- --ignored --nocapture`.
    #[test]
    #[ignore = "a hundred million steps"]
    fn a_hundred_million_steps_keep_length_and_orthogonality() {
        let (length, orthogonality) = drift(100_000_000);
        println!("after 1e8 steps: length off by {length:e}, orthogonality by {orthogonality:e}");
        assert!(length <= 1e-12 && orthogonality <= 1e-12);
    }

    #[test]
    fn stumpff_has_no_cancellation() {
        for k in 0..400 {
            let square = 1e-18 * 10f64.powf(f64::from(k) * 0.05);
            let c = stumpff(square);
            for (n, found) in c.iter().enumerate().filter(|_| square < 40.0) {
                let mut term = Double(1.0 / (1..=n).map(|i| i as f64).product::<f64>(), 0.0);
                let mut sum = term;
                for k in 1..60 {
                    let m = f64::from(2 * k) + n as f64;
                    term = term.mul(Double(square, 0.0)).over(-m * (m - 1.0));
                    sum = sum.add(term);
                }
                let scale = 1.0 / (1..=n).map(|i| i as f64).product::<f64>();
                assert!((found - sum.0).abs() <= 4e-15 * scale, "c{n}({square:e}): {found} {}", sum.0);
            }
        }
    }

    fn vector(length: f64) -> impl Strategy<Value = Vector3<f64>> {
        [-1.0..1.0f64, -1.0..1.0, -1.0..1.0].prop_map(move |v| Vector3::from(v) * length)
    }

    proptest! {
        #[test]
        fn slerp_has_constant_speed(from in vector(3.0), way in vector(1.8), n in 2usize..40) {
            let from = exp(&from);
            let to = from * exp(&way);
            let to = if n % 2 == 0 { to } else { UnitQuaternion::new_unchecked(-to.into_inner()) };
            let step = way.norm() / n as f64;
            prop_assume!(way.norm() < PI - 1e-6);
            for k in 0..n {
                let at = |k: usize| slerp(&from, &to, k as f64 / n as f64);
                let length = log(&(at(k).inverse() * at(k + 1))).norm();
                prop_assert!((length - step).abs() <= 1e-12, "{} {}", length, step);
            }
            prop_assert!(log(&(slerp(&from, &to, 1.0).inverse() * to)).norm() < 1e-14);
        }

        #[test]
        fn jacobians_are_derivatives(v in vector(2.5), d in vector(1.0)) {
            const STEP: f64 = 1e-5;
            let difference = log(&(exp(&(v - d * STEP)).inverse() * exp(&(v + d * STEP)))) / (2.0 * STEP);
            prop_assert!((right_jacobian(&v) * d - difference).norm() < 1e-8);
            let left = log(&(exp(&(v + d * STEP)) * exp(&(v - d * STEP)).inverse())) / (2.0 * STEP);
            prop_assert!((left_jacobian(&v) * d - left).norm() < 1e-8);
            prop_assert!((left_jacobian(&v) * left_jacobian_inverse(&v) - Matrix3::identity()).norm() < 1e-12);
            prop_assert!((right_jacobian(&v) * right_jacobian_inverse(&v) - Matrix3::identity()).norm() < 1e-12);
        }

        #[test]
        fn the_mean_of_symmetric_deviations_is_their_centre(centre in vector(3.0), d in vector(0.8), e in vector(0.8)) {
            let centre = exp(&centre);
            let all: Vec<_> = [d, -d, e, -e].iter().map(|v| centre * exp(v)).collect();
            let flipped = |(k, q): (usize, &UnitQuaternion<f64>)| {
                if k % 2 == 1 { UnitQuaternion::new_unchecked(-q.into_inner()) } else { *q }
            };
            let all: Vec<_> = all.iter().enumerate().map(flipped).collect();
            let found = mean(all.iter().map(|q| (0.25, q))).unwrap();
            prop_assert!(log(&(found.inverse() * centre)).norm() < 1e-13);
        }
    }

    #[test]
    fn slerp_takes_the_shorter_arc_at_constant_speed_for_all_angles() {
        let axis = Vector3::y_axis();
        for angle in [0.0, 1e-300, 1e-8, 1e-4, 3e-4, 0.1, 1.0, 3.0, std::f64::consts::PI - 1e-6] {
            let (from, to) = (UnitQuaternion::identity(), UnitQuaternion::from_axis_angle(&axis, angle));
            let opposite = UnitQuaternion::new_unchecked(-to.into_inner());
            for i in 0..=10 {
                let fraction = f64::from(i) * 0.1;
                let truth = UnitQuaternion::from_axis_angle(&axis, angle * fraction);
                for end in [to, opposite] {
                    let found = slerp(&from, &end, fraction);
                    let error = (found.coords - truth.coords).norm();
                    assert!(error < 1e-15, "angle {angle}, fraction {fraction}: {error:e}");
                }
            }
        }
        let half_turn = UnitQuaternion::from_axis_angle(&axis, std::f64::consts::PI);
        assert!((slerp(&UnitQuaternion::identity(), &half_turn, 0.5).norm() - 1.0).abs() < 1e-15);
    }

    #[test]
    fn half_a_turn_can_be_interpolated() {
        let from = exp(&Vector3::new(0.3, -0.2, 0.9));
        let to = from * UnitQuaternion::new_unchecked(Quaternion::new(0.0, 0.0, 1.0, 0.0));
        let middle = slerp(&from, &to, 0.5);
        assert!((log(&(from.inverse() * middle)).norm() - PI / 2.0).abs() < 1e-15);
    }

    #[test]
    fn what_cancels_has_no_mean() {
        let one = UnitQuaternion::identity();
        let half_turn = UnitQuaternion::new_unchecked(Quaternion::new(0.0, 1.0, 0.0, 0.0));
        assert_eq!(mean([(1.0, &one), (1.0, &half_turn)]), None);
        assert_eq!(mean([]), None);
        assert_eq!(mean([(0.0, &one)]), None);
        assert_eq!(mean([(f64::NAN, &one)]), None);
        assert_eq!(mean([(-1.0, &one)]), None);
        assert!(log(&mean([(3.0, &one), (1.0, &half_turn)]).unwrap()).norm() < 1e-15);
    }

    #[test]
    fn a_pose_half_way_is_half_way() {
        let from = Rigid::from_parts(Vector3::new(1.0, 2.0, 3.0).into(), exp(&Vector3::new(0.1, 0.0, 0.0)));
        let to = Rigid::from_parts(Vector3::new(3.0, 2.0, -1.0).into(), exp(&Vector3::new(0.5, 0.0, 0.0)));
        let middle = interpolate(&from, &to, 0.5);
        assert!((middle.translation.vector - Vector3::new(2.0, 2.0, 1.0)).norm() < 1e-15);
        assert!((log(&middle.rotation) - Vector3::new(0.3, 0.0, 0.0)).norm() < 1e-15);
    }
}
