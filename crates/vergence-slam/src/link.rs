//! What the inertial unit says between two frames: residual and derivatives of preintegrated readings.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use vergence_geom::{Rigid, advance, left_jacobian_inverse, log, right_jacobian, right_jacobian_inverse};
use vergence_inertial::motion::Earth;
use vergence_inertial::preintegrate::{Biases, Course, NoiseDensities, Preintegrated};
use vergence_time::Span;

use crate::params::{Inertial, Params};

/// Velocity and biases of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// In the world, m/s.
    pub velocity_m_s: Vector3<f64>,
    /// Of the inertial unit.
    pub biases: Biases,
}

/// Pose and motion moved by a step: position, rotation (right), velocity, gyroscope's bias, accelerometer's bias.
pub(crate) fn moved_pose(pose: &Rigid, by: &[f64]) -> Rigid {
    let turn = Vector3::from_column_slice(&by[3..6]);
    Rigid::from_parts(
        (pose.translation.vector + Vector3::from_column_slice(&by[..3])).into(),
        advance(&pose.rotation, &turn),
    )
}

pub(crate) fn moved_motion(motion: &Motion, by: &[f64]) -> Motion {
    let at = |i: usize| Vector3::from_column_slice(&by[i..i + 3]);
    Motion {
        velocity_m_s: motion.velocity_m_s + at(0),
        biases: Biases {
            gyr_rad_s: motion.biases.gyr_rad_s + at(3),
            acc_m_s2: motion.biases.acc_m_s2 + at(6),
        },
    }
}

/// The step that leads from one pose to another; inverse of [`moved_pose`].
pub(crate) fn pose_step(from: &Rigid, to: &Rigid) -> SVector<f64, 6> {
    let mut step = SVector::<f64, 6>::zeros();
    step.fixed_rows_mut::<3>(0).copy_from(&(to.translation.vector - from.translation.vector));
    step.fixed_rows_mut::<3>(3).copy_from(&log(&(from.rotation.inverse() * to.rotation)));
    step
}

pub(crate) fn motion_step(from: &Motion, to: &Motion) -> SVector<f64, 9> {
    let mut step = SVector::<f64, 9>::zeros();
    step.fixed_rows_mut::<3>(0).copy_from(&(to.velocity_m_s - from.velocity_m_s));
    step.fixed_rows_mut::<3>(3).copy_from(&(to.biases.gyr_rad_s - from.biases.gyr_rad_s));
    step.fixed_rows_mut::<3>(6).copy_from(&(to.biases.acc_m_s2 - from.biases.acc_m_s2));
    step
}

/// Held readings and for how long.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Held {
    pub(crate) gyr_rad_s: Vector3<f64>,
    pub(crate) acc_m_s2: Vector3<f64>,
    pub(crate) span: Span,
    /// Made of a reading at the end of the gyroscope's range: the truth may be far beyond it.
    pub(crate) saturated: bool,
    /// Made of readings that are far apart.
    pub(crate) missing: bool,
}

/// Readings between two frames, summed up.
#[derive(Clone, Debug)]
pub(crate) struct Link {
    readings: Vec<Held>,
    sum: Preintegrated,
    noise: NoiseDensities,
    at: Biases,
    /// Rows of the root of the information of position, velocity, rotation.
    root: SMatrix<f64, 9, 9>,
    gyr_walk: f64,
    acc_walk: f64,
    gravity: Vector3<f64>,
}

/// Biases farther than this from those that were subtracted make the sum anew: rad/s, m/s².
const FAR: (f64, f64) = (0.01, 0.1);
/// White noise of a saturated gyroscope, rad/s/√Hz: an error of 4 rad/s held for 50 ms.
const SATURATED: f64 = 1.0;
/// White noise where readings are missing, rad/s/√Hz and m/s²/√Hz: an unknown motion of a hand.
const MISSING: NoiseDensities = NoiseDensities { gyr_rad_s_rthz: 1.0, acc_m_s2_rthz: 3.0 };

/// Readings that say how much they shake.
const SHAKEN: usize = 4;

/// White noise as strong as what changes from one reading to the next beside a steady course: readings are means of two neighbours, whose
/// second difference varies as much as one reading does. Zeros where there are too few.
fn shaking(readings: &[Held]) -> NoiseDensities {
    let (mut gyr, mut acc, mut count) = (0.0, 0.0, 0.0);
    for three in readings.windows(3) {
        gyr += (three[0].gyr_rad_s - three[1].gyr_rad_s * 2.0 + three[2].gyr_rad_s).norm_squared();
        acc += (three[0].acc_m_s2 - three[1].acc_m_s2 * 2.0 + three[2].acc_m_s2).norm_squared();
        count += 3.0;
    }
    if readings.len() < SHAKEN {
        return NoiseDensities { gyr_rad_s_rthz: 0.0, acc_m_s2_rthz: 0.0 };
    }
    let seconds: f64 = readings.iter().map(|r| r.span.as_secs_f64()).sum();
    let root = (seconds / readings.len() as f64 / count).sqrt();
    NoiseDensities { gyr_rad_s_rthz: gyr.sqrt() * root, acc_m_s2_rthz: acc.sqrt() * root }
}

impl Link {
    /// `None` where no reading could be used.
    pub(crate) fn new(readings: Vec<Held>, at: Biases, params: &Params, inertial: &Inertial) -> Option<Self> {
        let mut noise = inertial.noise;
        noise.gyr_rad_s_rthz *= params.noise_factor;
        noise.acc_m_s2_rthz *= params.noise_factor;
        let shaking = shaking(&readings);
        noise.gyr_rad_s_rthz = noise.gyr_rad_s_rthz.max(shaking.gyr_rad_s_rthz);
        noise.acc_m_s2_rthz = noise.acc_m_s2_rthz.max(shaking.acc_m_s2_rthz);
        if readings.iter().any(|r| r.saturated) {
            noise.gyr_rad_s_rthz = SATURATED;
        }
        if readings.iter().any(|r| r.missing) {
            noise = MISSING;
        }
        let mut link = Self {
            readings,
            sum: Preintegrated::new(at, noise),
            noise,
            at,
            root: SMatrix::zeros(),
            gyr_walk: inertial.gyr_walk,
            acc_walk: inertial.acc_walk,
            gravity: params.gravity(),
        };
        link.integrate(at).then_some(link)
    }

    /// This and the one that follows it as one; `None` where that cannot be.
    pub(crate) fn joined(&self, next: &Self) -> Option<Self> {
        let mut link = Self { readings: [&self.readings[..], &next.readings].concat(), ..next.clone() };
        link.noise.gyr_rad_s_rthz = self.noise.gyr_rad_s_rthz.max(next.noise.gyr_rad_s_rthz);
        link.noise.acc_m_s2_rthz = self.noise.acc_m_s2_rthz.max(next.noise.acc_m_s2_rthz);
        link.integrate(next.at).then_some(link)
    }

    fn integrate(&mut self, at: Biases) -> bool {
        self.sum = Preintegrated::new(at, self.noise);
        self.at = at;
        for held in &self.readings {
            // What is not finite is left out; its span is missing from the sum and is not bridged.
            let _ = self.sum.step(&held.gyr_rad_s, &held.acc_m_s2, held.span);
        }
        if self.sum.seconds() <= 0.0 {
            return false;
        }
        // A perfect unit still has an error of integration: a floor of 1e-6 keeps the root finite.
        let covariance = self.sum.covariance() + SMatrix::<f64, 9, 9>::identity() * 1e-12;
        let inverse = covariance.cholesky().and_then(|c| c.l().try_inverse());
        match inverse {
            Some(root) => {
                self.root = root;
                true
            }
            None => false,
        }
    }

    /// Sums anew where the biases have moved far since.
    pub(crate) fn refresh(&mut self, biases: &Biases) {
        let gyr = (biases.gyr_rad_s - self.at.gyr_rad_s).norm();
        let acc = (biases.acc_m_s2 - self.at.acc_m_s2).norm();
        if gyr > FAR.0 || acc > FAR.1 {
            self.integrate(*biases);
        }
    }

    /// Whether nothing is felt but gravity: no turning (0.05 rad/s) and no shaking (0.4 m/s²).
    pub(crate) fn is_quiet(&self, biases: &Biases, gravity_m_s2: f64) -> bool {
        let count = self.readings.len() as f64;
        let mean = self.readings.iter().map(|r| r.acc_m_s2).sum::<Vector3<f64>>() / count;
        let turning =
            self.readings.iter().map(|r| r.gyr_rad_s - biases.gyr_rad_s).sum::<Vector3<f64>>() / count;
        ((mean - biases.acc_m_s2).norm() - gravity_m_s2).abs() < 0.4
            && turning.norm() < 0.05
            && self.readings.iter().all(|r| (r.acc_m_s2 - mean).norm() < 1.5)
    }

    /// Where a body ends that began so.
    pub(crate) fn follow(&self, pose: &Rigid, motion: &Motion) -> (Rigid, Motion) {
        let earth = Earth { gravity_m_s2: self.gravity, field_ut: Vector3::zeros() };
        let start = Course {
            position_m: pose.translation.vector,
            velocity_m_s: motion.velocity_m_s,
            world_from_body: pose.rotation,
        };
        let end = self.sum.follow(&start, &self.sum.at_biases(&motion.biases), &earth);
        let pose = Rigid::from_parts(end.position_m.into(), end.world_from_body);
        (pose, Motion { velocity_m_s: end.velocity_m_s, biases: motion.biases })
    }

    /// White noise of the accelerometer, as it is taken, m/s²/√Hz.
    pub(crate) fn acc_noise(&self) -> f64 {
        self.noise.acc_m_s2_rthz
    }

    /// s.
    pub(crate) fn seconds(&self) -> f64 {
        self.sum.seconds()
    }

    /// As [`Self::follow`], without gravity.
    pub(crate) fn follow_free(&self, pose: &Rigid, motion: &Motion) -> (Rigid, Motion) {
        let (pose, mut motion) = self.follow(pose, motion);
        let t = self.sum.seconds();
        motion.velocity_m_s -= self.gravity * t;
        let position = pose.translation.vector - self.gravity * (0.5 * t * t);
        (Rigid::from_parts(position.into(), pose.rotation), motion)
    }

    /// Derivatives of position and velocity by the accelerometer's bias, in the axes of the first frame.
    pub(crate) fn by_acc_bias(&self) -> (Matrix3<f64>, Matrix3<f64>) {
        let by = self.sum.by_biases();
        (by.fixed_view::<3, 3>(0, 3).into_owned(), by.fixed_view::<3, 3>(3, 3).into_owned())
    }

    /// Not whitened: position, velocity, rotation, gyroscope's bias, accelerometer's bias.
    fn raw(&self, from: (&Rigid, &Motion), to: (&Rigid, &Motion)) -> SVector<f64, 15> {
        let delta = self.sum.at_biases(&from.1.biases);
        let t = self.sum.seconds();
        let back = from.0.rotation.inverse();
        let way = to.0.translation.vector
            - from.0.translation.vector
            - from.1.velocity_m_s * t
            - self.gravity * (0.5 * t * t);
        let gain = to.1.velocity_m_s - from.1.velocity_m_s - self.gravity * t;
        let mut r = SVector::<f64, 15>::zeros();
        r.fixed_rows_mut::<3>(0).copy_from(&(back * way - delta.position_m));
        r.fixed_rows_mut::<3>(3).copy_from(&(back * gain - delta.velocity_m_s));
        r.fixed_rows_mut::<3>(6).copy_from(&log(&(delta.rotation.inverse() * back * to.0.rotation)));
        r.fixed_rows_mut::<6>(9).copy_from(&motion_step(from.1, to.1).fixed_rows::<6>(3));
        r
    }

    fn whiten<const N: usize>(&self, raw: &SMatrix<f64, 15, N>) -> SMatrix<f64, 15, N> {
        let mut out = SMatrix::<f64, 15, N>::zeros();
        out.fixed_rows_mut::<9>(0).copy_from(&(self.root * raw.fixed_rows::<9>(0)));
        let time = self.sum.seconds().max(1e-4).sqrt();
        out.fixed_rows_mut::<3>(9).copy_from(&(raw.fixed_rows::<3>(9) / (self.gyr_walk * time).max(1e-9)));
        out.fixed_rows_mut::<3>(12).copy_from(&(raw.fixed_rows::<3>(12) / (self.acc_walk * time).max(1e-9)));
        out
    }

    /// Whitened residual.
    pub(crate) fn residual(&self, from: (&Rigid, &Motion), to: (&Rigid, &Motion)) -> SVector<f64, 15> {
        self.whiten(&self.raw(from, to))
    }

    /// Whitened derivatives by the first and by the second frame (pose, then motion), at these states.
    pub(crate) fn derivatives(
        &self,
        from: (&Rigid, &Motion),
        to: (&Rigid, &Motion),
    ) -> (SMatrix<f64, 15, 15>, SMatrix<f64, 15, 15>) {
        let t = self.sum.seconds();
        let raw = self.raw(from, to);
        let delta = self.sum.delta();
        let by_biases = self.sum.by_biases();
        let shift = motion_step(&Motion { biases: self.at, ..*from.1 }, from.1);
        let shift = shift.fixed_rows::<6>(3).into_owned();
        let bent: Vector3<f64> = by_biases.fixed_rows::<3>(6) * shift;
        let back = from.0.rotation.inverse().to_rotation_matrix().into_inner();
        let turned = raw.fixed_rows::<3>(6).into_owned();
        let at = self.sum.at_biases(&from.1.biases);
        let way = raw.fixed_rows::<3>(0) + at.position_m;
        let gain = raw.fixed_rows::<3>(3) + at.velocity_m_s;
        debug_assert!(delta.position_m.iter().all(|x| x.is_finite()));
        let one = Matrix3::identity();
        let (mut a, mut b) = (SMatrix::<f64, 15, 15>::zeros(), SMatrix::<f64, 15, 15>::zeros());
        let mut set = |m: usize, row: usize, column: usize, block: Matrix3<f64>| {
            let into = if m == 0 { &mut a } else { &mut b };
            into.fixed_view_mut::<3, 3>(row, column).copy_from(&block);
        };
        set(0, 0, 0, -back);
        set(0, 0, 3, way.cross_matrix());
        set(0, 0, 6, back * -t);
        set(0, 3, 3, gain.cross_matrix());
        set(0, 3, 6, -back);
        for row in 0..2 {
            for column in 0..2 {
                set(0, 3 * row, 9 + 3 * column, -by_biases.fixed_view::<3, 3>(3 * row, 3 * column));
            }
        }
        let inverse = right_jacobian_inverse(&turned);
        let relative = (to.0.rotation.inverse() * from.0.rotation).to_rotation_matrix().into_inner();
        set(0, 6, 3, -inverse * relative);
        let by_gyr = by_biases.fixed_view::<3, 3>(6, 0).into_owned();
        set(0, 6, 9, -(left_jacobian_inverse(&turned) * right_jacobian(&bent) * by_gyr));
        set(0, 9, 9, -one);
        set(0, 12, 12, -one);
        set(1, 0, 0, back);
        set(1, 3, 6, back);
        set(1, 6, 3, inverse);
        set(1, 9, 9, one);
        set(1, 12, 12, one);
        (self.whiten(&a), self.whiten(&b))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use vergence_geom::exp;
    use vergence_solve::numeric;

    use super::*;

    fn link(v: &[f64]) -> Link {
        let readings = (0..10)
            .map(|k| Held {
                gyr_rad_s: Vector3::new(v[0] + 0.1 * f64::from(k), v[1], v[2]),
                acc_m_s2: Vector3::new(v[3], 9.0 + v[4], v[5] - 0.2 * f64::from(k)),
                span: Span::from_millis(5),
                saturated: false,
                missing: false,
            })
            .collect();
        let params = Params::default();
        Link::new(readings, Biases::default(), &params, &Inertial::EUROC).unwrap()
    }

    /// A unit whose readings shake by so much, m/s² and rad/s, from one to the next.
    fn shaken(by: f64) -> Vec<Held> {
        let held = |k: i32| Held {
            gyr_rad_s: Vector3::new(0.1, 0.01 * f64::from(k), by * f64::from(1 - k % 2 * 2)),
            acc_m_s2: Vector3::new(by * f64::from(1 - k % 2 * 2), 9.8, 0.05 * f64::from(k)),
            span: Span::from_millis(5),
            saturated: false,
            missing: false,
        };
        (0..10).map(held).collect()
    }

    #[test]
    fn readings_that_shake_weigh_less_and_missing_ones_hardly_anything() {
        let weight = |readings: Vec<Held>| {
            Link::new(readings, Biases::default(), &Params::default(), &Inertial::EUROC).unwrap().root.norm()
        };
        let calm = weight(shaken(0.0));
        // A steady change is no vibration, and neither is the noise of the sheet.
        assert!((weight(shaken(0.001)) / calm - 1.0).abs() < 1e-9);
        assert!(weight(shaken(2.0)) < 0.2 * calm);
        let mut gap = shaken(0.0);
        gap[4].missing = true;
        assert!(weight(gap) < 0.01 * calm);
    }

    proptest! {
        #[test]
        fn derivatives_are_the_numerical_ones(v in proptest::collection::vec(-1.0..1f64, 36)) {
            let link = link(&v);
            let state = |v: &[f64]| {
                let three = |i: usize| Vector3::new(v[i], v[i + 1], v[i + 2]);
                let pose = Rigid::from_parts(three(0).into(), exp(&three(3)));
                let biases = Biases { gyr_rad_s: three(9) * 0.005, acc_m_s2: three(12) * 0.05 };
                (pose, Motion { velocity_m_s: three(6), biases })
            };
            let from = state(&v[6..21]);
            let (mut pose, motion) = link.follow(&from.0, &from.1);
            pose = moved_pose(&pose, &v[30..36].iter().map(|x| x * 0.01).collect::<Vec<_>>());
            let motion = moved_motion(&motion, &[0.01; 9]);
            let to = (pose, motion);
            let moved = |s: &(Rigid, Motion), by: &SVector<f64, 15>| {
                (moved_pose(&s.0, &by.as_slice()[..6]), moved_motion(&s.1, &by.as_slice()[6..]))
            };
            let (a, b) = link.derivatives((&from.0, &from.1), (&to.0, &to.1));
            let numeric_a = numeric::jacobian(1e-3, |by| { let f = moved(&from, by); link.residual((&f.0, &f.1), (&to.0, &to.1)) });
            let numeric_b = numeric::jacobian(1e-3, |by| { let t = moved(&to, by); link.residual((&from.0, &from.1), (&t.0, &t.1)) });
            prop_assert!(numeric::error(&a, &numeric_a) < 1e-6, "{}", numeric::error(&a, &numeric_a));
            prop_assert!(numeric::error(&b, &numeric_b) < 1e-6, "{}", numeric::error(&b, &numeric_b));
            // Following the readings is where the residual is zero.
            let end = link.follow(&from.0, &from.1);
            prop_assert!(link.residual((&from.0, &from.1), (&end.0, &end.1)).amax() < 1e-6);
            prop_assert!((moved_pose(&from.0, pose_step(&from.0, &to.0).as_slice()).to_homogeneous() - to.0.to_homogeneous()).amax() < 1e-12);
        }
    }
}
