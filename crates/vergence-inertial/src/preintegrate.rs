//! Many readings as one relative motion: preintegration on the manifold, with bias Jacobians and covariance.
//!
//! After C. Forster et al., "On-Manifold Preintegration for Real-Time Visual-Inertial Odometry", T-RO 33(1), 2017, but
//! each reading is held in the body's own frame and integrated exactly over its span (by Stumpff's functions) instead
//! of by Euler's rule, and so are its derivatives.

use nalgebra::{Matrix3, SMatrix, UnitQuaternion, Vector3};
use vergence_geom::{advance, exp, right_jacobian, stumpff};
use vergence_time::Span;

use crate::motion::Earth;

/// Covariance of position (m), velocity (m/s) and rotation (rad, perturbed on the right), in this order.
pub type Covariance = SMatrix<f64, 9, 9>;

/// White noise of the readings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseDensities {
    /// Of the gyroscope, rad/s/√Hz.
    pub gyr_rad_s_rthz: f64,
    /// Of the accelerometer, m/s²/√Hz.
    pub acc_m_s2_rthz: f64,
}

/// Biases of the readings.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Biases {
    /// Of the gyroscope, rad/s.
    pub gyr_rad_s: Vector3<f64>,
    /// Of the accelerometer, m/s².
    pub acc_m_s2: Vector3<f64>,
}

/// Pose and velocity of a body in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Course {
    /// In world coordinates, m.
    pub position_m: Vector3<f64>,
    /// In world axes, m/s.
    pub velocity_m_s: Vector3<f64>,
    /// The body's orientation.
    pub world_from_body: UnitQuaternion<f64>,
}

/// What readings say of the motion between two instants, free of gravity and of where and how fast the body began; in
/// the frame of the body at the beginning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Delta {
    /// m.
    pub position_m: Vector3<f64>,
    /// m/s.
    pub velocity_m_s: Vector3<f64>,
    /// The body at the beginning from the body at the end.
    pub rotation: UnitQuaternion<f64>,
}

/// Readings summed up; grows by [`Self::step`]. No allocation.
#[derive(Clone, Debug, PartialEq)]
pub struct Preintegrated {
    biases: Biases,
    noise: NoiseDensities,
    seconds: f64,
    delta: Delta,
    covariance: Covariance,
    /// Derivatives of position, velocity and rotation (rows) by the biases of gyroscope and accelerometer (columns).
    by_biases: SMatrix<f64, 9, 6>,
}

/// `integral · a` and its derivative by `angle`, where integral = constant I + c[n] [angle]× + c[n+1] [angle]×².
fn turned(
    angle: &Vector3<f64>,
    a: &Vector3<f64>,
    c: &[f64; 8],
    n: usize,
    constant: f64,
) -> (Vector3<f64>, Matrix3<f64>) {
    let once = angle.cross(a);
    let twice = angle.cross(&once);
    // 2 dcₙ/d(θ²).
    let slope = |n: usize| n as f64 * c[n + 2] - c[n + 1];
    let value = a * constant + once * c[n] + twice * c[n + 1];
    let of_twice =
        Matrix3::from_diagonal_element(angle.dot(a)) + angle * a.transpose() - a * angle.transpose() * 2.0;
    let derivative = a.cross_matrix() * -c[n]
        + once * angle.transpose() * slope(n)
        + of_twice * c[n + 1]
        + twice * angle.transpose() * slope(n + 1);
    (value, derivative)
}

impl Preintegrated {
    /// Nothing yet; `biases` are subtracted from each reading.
    pub fn new(biases: Biases, noise: NoiseDensities) -> Self {
        Self {
            biases,
            noise,
            seconds: 0.0,
            delta: Delta {
                position_m: Vector3::zeros(),
                velocity_m_s: Vector3::zeros(),
                rotation: UnitQuaternion::identity(),
            },
            covariance: Covariance::zeros(),
            by_biases: SMatrix::zeros(),
        }
    }

    /// Adds readings that hold for `span`: the rate in rad/s and the specific force in m/s², both in body axes (the
    /// mean of the readings at both ends is right to second order). False, and nothing is added, where a reading is
    /// not finite or the span not positive.
    #[must_use]
    pub fn step(&mut self, gyr_rad_s: &Vector3<f64>, acc_m_s2: &Vector3<f64>, span: Span) -> bool {
        let dt = span.as_secs_f64();
        let rate = gyr_rad_s - self.biases.gyr_rad_s;
        let force = acc_m_s2 - self.biases.acc_m_s2;
        if !(dt > 0.0 && rate.iter().chain(force.iter()).all(|x| x.is_finite())) {
            return false;
        }
        let angle = rate * dt;
        let c = stumpff(angle.norm_squared());
        let (gained, gained_by_angle) = turned(&angle, &force, &c, 2, 1.0);
        let (moved, moved_by_angle) = turned(&angle, &force, &c, 3, 0.5);
        let once = Matrix3::identity() + angle.cross_matrix() * c[2] + angle.cross_matrix().pow(2) * c[3];
        let twice = Matrix3::from_diagonal_element(0.5)
            + angle.cross_matrix() * c[3]
            + angle.cross_matrix().pow(2) * c[4];
        let start_from_here = self.delta.rotation.to_rotation_matrix().into_inner();

        // How the errors so far go on …
        let mut onward = SMatrix::<f64, 9, 9>::identity();
        onward.fixed_view_mut::<3, 3>(0, 3).copy_from(&Matrix3::from_diagonal_element(dt));
        onward.fixed_view_mut::<3, 3>(0, 6).copy_from(&(start_from_here * moved.cross_matrix() * -(dt * dt)));
        onward.fixed_view_mut::<3, 3>(3, 6).copy_from(&(start_from_here * gained.cross_matrix() * -dt));
        onward.fixed_view_mut::<3, 3>(6, 6).copy_from(exp(&-angle).to_rotation_matrix().matrix());
        // … and what an error of this reading adds.
        let mut added = SMatrix::<f64, 9, 6>::zeros();
        added.fixed_view_mut::<3, 3>(0, 0).copy_from(&(start_from_here * moved_by_angle * (dt * dt * dt)));
        added.fixed_view_mut::<3, 3>(0, 3).copy_from(&(start_from_here * twice * (dt * dt)));
        added.fixed_view_mut::<3, 3>(3, 0).copy_from(&(start_from_here * gained_by_angle * (dt * dt)));
        added.fixed_view_mut::<3, 3>(3, 3).copy_from(&(start_from_here * once * dt));
        added.fixed_view_mut::<3, 3>(6, 0).copy_from(&(right_jacobian(&angle) * dt));

        self.by_biases = onward * self.by_biases - added;
        let variance = |density: f64| density * density / dt;
        let (gyr, acc) = (variance(self.noise.gyr_rad_s_rthz), variance(self.noise.acc_m_s2_rthz));
        let mut scaled = added;
        scaled.fixed_columns_mut::<3>(0).scale_mut(gyr);
        scaled.fixed_columns_mut::<3>(3).scale_mut(acc);
        self.covariance = onward * self.covariance * onward.transpose() + scaled * added.transpose();

        let delta = &mut self.delta;
        delta.position_m += delta.velocity_m_s * dt + start_from_here * moved * (dt * dt);
        delta.velocity_m_s += start_from_here * gained * dt;
        delta.rotation = advance(&delta.rotation, &angle);
        self.seconds += dt;
        true
    }

    /// The span summed up, s.
    pub fn seconds(&self) -> f64 {
        self.seconds
    }

    /// At the biases that were subtracted.
    pub fn delta(&self) -> &Delta {
        &self.delta
    }

    /// Of [`Self::delta`], from the white noise.
    pub fn covariance(&self) -> &Covariance {
        &self.covariance
    }

    /// Derivatives of position, velocity and rotation (perturbed on the right; rows) by the biases of gyroscope and
    /// accelerometer (columns).
    pub fn by_biases(&self) -> &SMatrix<f64, 9, 6> {
        &self.by_biases
    }

    /// What the delta would be at other biases, to first order.
    pub fn at_biases(&self, biases: &Biases) -> Delta {
        let mut change = SMatrix::<f64, 6, 1>::zeros();
        change.fixed_rows_mut::<3>(0).copy_from(&(biases.gyr_rad_s - self.biases.gyr_rad_s));
        change.fixed_rows_mut::<3>(3).copy_from(&(biases.acc_m_s2 - self.biases.acc_m_s2));
        let change = self.by_biases * change;
        Delta {
            position_m: self.delta.position_m + change.fixed_rows::<3>(0),
            velocity_m_s: self.delta.velocity_m_s + change.fixed_rows::<3>(3),
            rotation: advance(&self.delta.rotation, &change.fixed_rows::<3>(6).into_owned()),
        }
    }

    /// Where a body that was at `start` is at the end, if its motion was `delta` (of this span) on `earth`.
    pub fn follow(&self, start: &Course, delta: &Delta, earth: &Earth) -> Course {
        let (t, gravity) = (self.seconds, earth.gravity_m_s2);
        Course {
            position_m: start.position_m
                + start.velocity_m_s * t
                + gravity * (0.5 * t * t)
                + start.world_from_body * delta.position_m,
            velocity_m_s: start.velocity_m_s + gravity * t + start.world_from_body * delta.velocity_m_s,
            world_from_body: start.world_from_body * delta.rotation,
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use vergence_geom::log;
    use vergence_time::Timestamp;

    use super::*;
    use crate::dice::Dice;
    use crate::model::ImuModel;
    use crate::motion::{Motion, Wander, WanderParams};

    const NOISE: NoiseDensities = NoiseDensities { gyr_rad_s_rthz: 2e-3, acc_m_s2_rthz: 3e-2 };

    type Reading = (Vector3<f64>, Vector3<f64>);

    /// Fast, so that every term counts: 200 readings at 100 Hz.
    fn readings(seed: u64) -> Vec<Reading> {
        let dice = |axis| Dice::new(seed, axis);
        let wave = |axis: u64, k: usize, size: f64| {
            let at = k as f64 * 0.01 * (1.0 + 3.0 * dice(axis).uniform(0)) + 9.0 * dice(axis).uniform(1);
            size * at.sin() + size * 0.5 * dice(axis).normal(2)
        };
        let reading = |k| {
            (
                Vector3::from_fn(|i, _| wave(i as u64, k, 3.0)),
                Vector3::from_fn(|i, _| wave(3 + i as u64, k, 8.0)),
            )
        };
        (0..200).map(reading).collect()
    }

    fn summed(readings: &[Reading], biases: Biases) -> Preintegrated {
        let mut sum = Preintegrated::new(biases, NOISE);
        for (gyr, acc) in readings {
            assert!(sum.step(gyr, acc, Span::from_millis(10)));
        }
        sum
    }

    fn difference(from: &Delta, to: &Delta) -> SMatrix<f64, 9, 1> {
        let mut d = SMatrix::<f64, 9, 1>::zeros();
        d.fixed_rows_mut::<3>(0).copy_from(&(to.position_m - from.position_m));
        d.fixed_rows_mut::<3>(3).copy_from(&(to.velocity_m_s - from.velocity_m_s));
        d.fixed_rows_mut::<3>(6).copy_from(&log(&(from.rotation.inverse() * to.rotation)));
        d
    }

    fn shifted(column: usize, by: f64) -> Biases {
        let mut biases = Biases::default();
        if column < 3 {
            biases.gyr_rad_s[column] += by
        } else {
            biases.acc_m_s2[column - 3] += by
        }
        biases
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        #[test]
        fn bias_jacobians_are_the_numerical_ones(seed in 0u64..1000) {
            const STEP: f64 = 1e-5;
            let readings = readings(seed);
            let at = summed(&readings, Biases::default());
            for column in 0..6 {
                let plus = summed(&readings, shifted(column, STEP));
                let minus = summed(&readings, shifted(column, -STEP));
                let forward = difference(at.delta(), plus.delta());
                let numeric = (forward - difference(at.delta(), minus.delta())) / (2.0 * STEP);
                let error = (at.by_biases().column(column) - numeric).norm();
                prop_assert!(error < 1e-7 * (1.0 + numeric.norm()), "{}: {} {}", column, error, numeric);
                // And the first order is what it says: the rest falls with the square.
                let corrected = at.at_biases(&shifted(column, 1e-3));
                let left = difference(&corrected, summed(&readings, shifted(column, 1e-3)).delta()).norm();
                prop_assert!(left < 2e-4, "{}: {}", column, left);
            }
        }
    }

    #[test]
    fn the_covariance_is_that_of_many_noisy_runs() {
        const RUNS: u64 = 800;
        let exact = readings(5);
        let at = summed(&exact, Biases::default());
        let mut sum = Covariance::zeros();
        let mut squares = 0.0;
        let inverse = at.covariance().try_inverse().unwrap();
        for run in 0..RUNS {
            let dice = |axis: usize| Dice::new(1000 + run, axis as u64);
            let noisy = |(k, (gyr, acc)): (usize, &Reading)| {
                let n = |axis: usize, density: f64| dice(axis).normal(k as u64) * density * 10.0;
                (
                    gyr + Vector3::from_fn(|i, _| n(i, NOISE.gyr_rad_s_rthz)),
                    acc + Vector3::from_fn(|i, _| n(3 + i, NOISE.acc_m_s2_rthz)),
                )
            };
            let noisy: Vec<Reading> = exact.iter().enumerate().map(noisy).collect();
            let error = difference(at.delta(), summed(&noisy, Biases::default()).delta());
            sum += error * error.transpose();
            squares += (error.transpose() * inverse * error).x;
        }
        let found = sum / RUNS as f64;
        for i in 0..9 {
            let ratio = found[(i, i)] / at.covariance()[(i, i)];
            assert!((ratio - 1.0).abs() < 5.0 * (2.0 / RUNS as f64).sqrt(), "{i}: {ratio}");
        }
        // All nine together, with their correlations: the mean of a χ² of 9.
        let consistency = squares / RUNS as f64;
        assert!((consistency - 9.0).abs() < 5.0 * (18.0 / RUNS as f64).sqrt(), "{consistency}");
    }

    #[test]
    fn it_agrees_with_direct_integration_of_the_motion() {
        let earth = Earth::MID_LATITUDE;
        let motion =
            Wander::new(8, &WanderParams { tilt_rad: 1.0, frequency_hz: 1.0, ..WanderParams::default() })
                .unwrap();
        let course = |time: Timestamp| {
            let at = motion.at(time);
            Course {
                position_m: at.world_from_body.translation.vector,
                velocity_m_s: at.velocity_m_s,
                world_from_body: at.world_from_body.rotation,
            }
        };
        // Errors of position, velocity and angle after the second second, at `rate` readings per second.
        let errors = |rate: u32| {
            let model = ImuModel::perfect(f64::from(rate));
            let read = |k| model.read(k, &motion, &earth).unwrap().value;
            let mut sum = Preintegrated::new(Biases::default(), NOISE);
            let (from, to) = (u64::from(rate), u64::from(2 * rate));
            for k in from..to {
                let (a, b) = (read(k), read(k + 1));
                let middle = ((a.gyr_rad_s + b.gyr_rad_s) * 0.5, (a.acc_m_s2 + b.acc_m_s2) * 0.5);
                assert!(sum.step(&middle.0, &middle.1, Span::from_nanos(i64::from(1_000_000_000 / rate))));
            }
            let end = sum.follow(&course(model.time(from)), sum.delta(), &earth);
            let truth = course(model.time(to));
            [
                (end.position_m - truth.position_m).norm(),
                (end.velocity_m_s - truth.velocity_m_s).norm(),
                log(&(end.world_from_body.inverse() * truth.world_from_body)).norm(),
            ]
        };
        let (coarse, fine) = (errors(500), errors(1000));
        for (coarse, fine) in coarse.iter().zip(fine) {
            // Nothing is left but the error of the trapezium rule, which falls with the square of the span.
            assert!(fine < 2e-3 && (coarse / fine - 4.0).abs() < 0.1, "{coarse} {fine}");
        }
    }

    #[test]
    fn one_constant_reading_is_the_same_in_one_step_and_in_many() {
        let (rate, force) = (Vector3::new(2.0, -3.0, 1.0), Vector3::new(1.0, 9.0, -4.0));
        let run = |steps: i64| {
            let mut sum = Preintegrated::new(Biases::default(), NOISE);
            (0..steps).for_each(|_| assert!(sum.step(&rate, &force, Span::from_millis(1000 / steps))));
            sum
        };
        let (one, many) = (run(1), run(500));
        assert!(difference(one.delta(), many.delta()).norm() < 1e-12);
        assert!((one.by_biases() - many.by_biases()).norm() < 1e-10);
    }

    #[test]
    fn nonsense_is_not_summed() {
        let mut sum = Preintegrated::new(Biases::default(), NOISE);
        let before = sum.clone();
        let fine = Vector3::zeros();
        for bad in [f64::NAN, f64::INFINITY] {
            assert!(!sum.step(&Vector3::new(bad, 0.0, 0.0), &fine, Span::from_millis(1)));
            assert!(!sum.step(&fine, &Vector3::new(0.0, bad, 0.0), Span::from_millis(1)));
        }
        assert!(!sum.step(&fine, &fine, Span::ZERO) && !sum.step(&fine, &fine, Span::from_millis(-1)));
        assert_eq!(sum, before);
    }
}
