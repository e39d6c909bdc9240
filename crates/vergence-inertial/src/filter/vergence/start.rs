//! The start, at rest or in motion: which way is up while nothing has been seen before.
//!
//! An accelerometer feels gravity and acceleration. In a frame that the gyroscope carries along gravity stands still, and nobody's
//! acceleration has the same direction for long: it comes from a push and a pull. Here each component of it is a damped oscillation that
//! chance keeps alive, `a' = −2ζω a − ω² v + noise`, where the velocity `v` is the integral of `a`; with `f = g + a` felt and `g` and `v`
//! unknown that is one linear equation for each short window, and a Kalman filter finds gravity, velocity and the bias of the gyroscope,
//! which turns gravity in that frame. How strong the acceleration is, is taken from what was felt beside gravity so far.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::params::{VergenceCoefficients, VergenceParams};
use crate::filter::kalman::Estimate;
use crate::filter::saved::saved;

/// Gravity (3, as an accelerometer at rest feels it: up, m/s²) and velocity (3, m/s) in the inertial frame, bias (3, rad/s).
const N: usize = 9;

/// Damping of the oscillation, of the critical one: accelerations of a bandwidth of some 1.4 times the frequency.
const DAMPING: f64 = 0.7;
/// What the mean over a window differs by from the acceleration of the whole device, m/s²: vibration.
const VIBRATION: f64 = 0.5;
/// How fast the velocity that all this is about may itself wander (a walk, a flight), (m/s)²/s.
const WAY: f64 = 0.05;
/// Variance of the bias as it was supposed, of its own, with which it counts once more at the end of a start without rest.
const DOUBT: f64 = 0.25;
/// The strength of the acceleration that was supposed counts as if it had been seen for so long, and the longest that is looked back,
/// seconds.
const SUPPOSED_S: f64 = 1.0;
const REMEMBERED_S: f64 = 10.0;
/// The least that it becomes, m²/s⁴: no accelerometer is better than 0.01 m/s².
const LEAST: f64 = 1e-4;
/// Over longer windows than this the equation of the oscillation does not hold, seconds; what they say then counts as for this.
const LONGEST_S: f64 = 0.1;
/// Standard deviation of gravity as a rest shows it, m/s².
const AT_REST: f64 = 0.05;

/// Estimate and the window under way.
#[derive(Clone, Debug, PartialEq)]
pub struct Start {
    runs: bool,
    /// Seconds since gravity was first felt.
    age_s: f64,
    estimate: Estimate<N>,
    /// The bias as it was supposed, and the variances that it would have by now if nothing had been seen.
    supposed: Vector3<f64>,
    supposed_p: Vector3<f64>,
    /// The bias as it is taken out.
    applied: Vector3<f64>,
    /// Mean square of each component of the acceleration, m²/s⁴.
    acceleration: f64,
    /// Mean specific force of the window before in the inertial frame, if there was one without a hole.
    before: Option<Vector3<f64>>,
    /// Integrals over the window: the specific force and the rotation to the inertial frame; and how long both are.
    force: Vector3<f64>,
    felt_s: f64,
    rotation: Matrix3<f64>,
    window_s: f64,
}

saved!(Start {
    runs,
    age_s,
    estimate,
    supposed,
    supposed_p,
    applied,
    acceleration,
    before,
    force,
    felt_s,
    rotation,
    window_s
});

impl Start {
    /// Nothing is known but the bias of the gyroscope, with the variances `bias_p`.
    pub(super) fn new(bias: &Vector3<f64>, bias_p: &Vector3<f64>, params: &VergenceParams) -> Self {
        let mut estimate = Estimate { x: SVector::<f64, N>::zeros(), p: SMatrix::zeros() };
        estimate.x.fixed_rows_mut::<3>(6).copy_from(bias);
        estimate.p.fixed_view_mut::<3, 3>(6, 6).set_diagonal(bias_p);
        Self {
            runs: true,
            age_s: 0.0,
            estimate,
            supposed: *bias,
            supposed_p: *bias_p,
            applied: *bias,
            acceleration: params.start_acc_m_s2.powi(2),
            before: None,
            force: Vector3::zeros(),
            felt_s: 0.0,
            rotation: Matrix3::zeros(),
            window_s: 0.0,
        }
    }

    /// Whether this is still the start.
    #[inline]
    pub(super) const fn runs(&self) -> bool {
        self.runs
    }

    /// Gravity in the inertial frame, m/s²; before the end of the first window the mean of what was felt.
    pub(super) fn gravity(&self) -> Vector3<f64> {
        if self.age_s == 0.0 && self.felt_s > 0.0 {
            return self.force / self.felt_s;
        }
        self.estimate.x.fixed_rows::<3>(0).into_owned()
    }

    /// Bias of the gyroscope as far as it was seen, radians per second. About the vertical, where nothing shows it, the estimate is
    /// chance, and heading would drift by it: of what was found beyond the supposed one only that share counts by which the variance
    /// has become smaller.
    pub(super) const fn bias(&self) -> &Vector3<f64> {
        &self.applied
    }

    /// Its covariance.
    pub(super) fn bias_p(&self) -> Matrix3<f64> {
        self.estimate.p.fixed_view::<3, 3>(6, 6).into_owned()
    }

    /// Takes a sample, whose rate was corrected by [`Start::bias`]; says whether the estimate is another one now.
    pub(super) fn add(
        &mut self,
        inertial_from_sensor: &Matrix3<f64>,
        acc_inertial: Option<&Vector3<f64>>,
        step_s: f64,
        params: &VergenceParams,
        c: &VergenceCoefficients,
    ) -> bool {
        if let Some(acc) = acc_inertial {
            self.force += acc * step_s;
            self.felt_s += step_s;
        }
        self.rotation += inertial_from_sensor * step_s;
        self.window_s += step_s;
        if self.window_s < c.start_window_s {
            return self.age_s == 0.0;
        }
        self.end_window(params, c);
        self.runs = self.age_s < params.start_s;
        if !self.runs {
            self.doubt();
        }
        true
    }

    fn end_window(&mut self, params: &VergenceParams, c: &VergenceCoefficients) {
        let t = self.window_s;
        let force = (self.felt_s >= t).then(|| self.force / t);
        if let (Some(now), Some(before)) = (force, self.before) {
            self.feel(&now, &before, t, params);
        } else if let (Some(now), 0.0) = (force, self.age_s) {
            self.estimate.x.fixed_rows_mut::<3>(0).copy_from(&now);
            (0..3).for_each(|i| self.estimate.forget(i, self.acceleration));
            self.forget_velocity(params);
        } else {
            self.forget_velocity(params);
        }
        if force.is_some() || self.age_s > 0.0 {
            self.turn(t, c);
            self.age_s += t;
        }
        if let Some(force) = force {
            self.weigh(&force, t);
        }
        self.before = force;
        self.force = Vector3::zeros();
        self.felt_s = 0.0;
        self.rotation = Matrix3::zeros();
        self.window_s = 0.0;
    }

    /// The equation of the oscillation between the middles of two windows, and the velocity at the second.
    fn feel(&mut self, now: &Vector3<f64>, before: &Vector3<f64>, t: f64, params: &VergenceParams) {
        let e = &mut self.estimate;
        let pulse = params.start_pulse_rad_s;
        let counted = t.min(LONGEST_S);
        let (damped, pulled) = (2.0 * DAMPING * pulse * counted, pulse * pulse * counted);
        let middle = (now + before) * 0.5;
        // The velocity in the middle is that of before and half a window's acceleration.
        let of_gravity = damped + 0.5 * counted * pulled;
        let r = 2.0 * damped * self.acceleration + VIBRATION * VIBRATION;
        for i in 0..3 {
            let mut row = SVector::<f64, N>::zeros();
            row[i] = of_gravity;
            row[3 + i] = -pulled;
            e.observe(&row, now[i] - before[i] + of_gravity * middle[i], r);
        }
        for i in 0..3 {
            e.x[3 + i] += (middle[i] - e.x[i]) * t;
            e.p[(3 + i, 3 + i)] += WAY * t;
        }
        let gravity = e.p.fixed_rows::<3>(0) * t;
        let mut velocity = e.p.fixed_rows_mut::<3>(3);
        velocity -= gravity;
        let gravity = e.p.fixed_columns::<3>(0) * t;
        let mut velocity = e.p.fixed_columns_mut::<3>(3);
        velocity -= gravity;
    }

    /// A bias other than the one that was taken out turns gravity.
    fn turn(&mut self, t: f64, c: &VergenceCoefficients) {
        let gravity = self.gravity();
        let e = &mut self.estimate;
        let turned = -gravity.cross_matrix() * self.rotation;
        let by_bias = turned * e.p.fixed_rows::<3>(6);
        let mut rows = e.p.fixed_rows_mut::<3>(0);
        rows += by_bias;
        let by_bias = e.p.fixed_columns::<3>(6) * turned.transpose();
        let mut columns = e.p.fixed_columns_mut::<3>(0);
        columns += by_bias;
        let moved = turned * (e.x.fixed_rows::<3>(6) - self.applied);
        let drift = c.start_q * gravity.norm_squared() * t;
        let wander = c.bias_wander * (t / c.window_s);
        for i in 0..3 {
            e.x[i] += moved[i];
            e.p[(i, i)] += drift;
            e.p[(6 + i, 6 + i)] += wander;
            self.supposed_p[i] += wander;
        }
        let found = e.x.fixed_rows::<3>(6) - self.supposed;
        let share = found.component_div(&self.supposed_p.map(|p| p.max(f64::MIN_POSITIVE)));
        self.applied = self.supposed + found - e.p.fixed_view::<3, 3>(6, 6) * share;
    }

    /// Takes the strength of the acceleration from what was felt beside gravity; what is known of gravity and velocity is worth as much
    /// as that is wrong.
    fn weigh(&mut self, force: &Vector3<f64>, t: f64) {
        let seen = (force - self.gravity()).norm_squared() / 3.0;
        let supposed = self.acceleration;
        let share = t / (SUPPOSED_S + self.age_s).min(REMEMBERED_S).max(t);
        self.acceleration = (supposed + (seen - supposed) * share).max(LEAST);
        let scale = (self.acceleration / supposed).sqrt();
        let p = &mut self.estimate.p;
        let mut rows = p.fixed_rows_mut::<6>(0);
        rows *= scale;
        let mut columns = p.fixed_columns_mut::<6>(0);
        columns *= scale;
    }

    fn forget_velocity(&mut self, params: &VergenceParams) {
        for i in 3..6 {
            self.estimate.x[i] = 0.0;
            self.estimate.forget(i, self.acceleration / params.start_pulse_rad_s.powi(2));
        }
    }

    /// Pulls what nothing showed to what was supposed, which counts once more for what follows.
    fn doubt(&mut self) {
        for i in 0..3 {
            let mut row = SVector::<f64, N>::zeros();
            row[6 + i] = 1.0;
            self.estimate.observe(&row, self.supposed[i], self.supposed_p[i] * DOUBT);
        }
    }

    /// Ends the start in a rest, in which `force` was felt, in the inertial frame.
    pub(super) fn rest(&mut self, force: &Vector3<f64>) {
        for i in 0..3 {
            let mut row = SVector::<f64, N>::zeros();
            row[i] = 1.0;
            self.estimate.observe(&row, force[i], AT_REST * AT_REST);
        }
        self.runs = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ten seconds of pushing to and fro at 1.3 Hz with 5 m/s², not turning, with a bias; angle to up and what the bias errs by.
    fn pushed(bias: Vector3<f64>, holes: bool) -> (f64, f64) {
        let params = VergenceParams::default();
        let c = VergenceCoefficients::new(&params, 0.005);
        let mut start = Start::new(&Vector3::zeros(), &Vector3::repeat(1f64.to_radians().powi(2)), &params);
        // The inertial frame turns by the bias that is not taken out.
        let mut inertial = nalgebra::UnitQuaternion::identity();
        let up = Vector3::new(0.6, 0.0, 0.8) * 9.81;
        for k in 0..2000 {
            let t = f64::from(k) * 0.005;
            inertial *= vergence_geom::exp(&((bias - start.bias()) * 0.005));
            let push = Vector3::new(0.8, 0.0, -0.6) * (5.0 * (8.2 * t).cos());
            let felt = inertial * (up + push);
            let hole = holes && (300..340).contains(&(k % 500));
            let rotation = inertial.to_rotation_matrix();
            start.add(rotation.matrix(), (!hole).then_some(&felt), 0.005, &params, &c);
        }
        let true_up = inertial * up;
        let across = Vector3::new(0.6, 0.0, 0.8);
        let off = start.bias() - bias;
        (start.gravity().angle(&true_up).to_degrees(), (off - across * off.dot(&across)).norm().to_degrees())
    }

    #[test]
    fn up_and_bias_are_found_in_motion() {
        for bias in [Vector3::zeros(), Vector3::new(0.0, 0.01, 0.0), Vector3::new(0.04, -0.03, -0.03)] {
            for holes in [false, true] {
                let (up_deg, bias_deg_s) = pushed(bias, holes);
                println!("bias {:.3?}: up {up_deg:.2} deg, bias {bias_deg_s:.2} deg/s", bias.as_slice());
                // Each hole is a start of its own for the velocity.
                let most = if holes { (1.5, 0.6) } else { (0.6, 0.3) };
                assert!(up_deg < most.0 && bias_deg_s < most.1, "{bias:?} {holes}: {up_deg} {bias_deg_s}");
            }
        }
    }

    #[test]
    fn the_bias_about_the_vertical_stays_as_it_was_supposed() {
        let params = VergenceParams::default();
        let c = VergenceCoefficients::new(&params, 0.01);
        let supposed = Vector3::new(0.01, -0.02, 0.03);
        let mut start = Start::new(&supposed, &Vector3::repeat(1f64.to_radians().powi(2)), &params);
        for k in 0..1500 {
            let t = f64::from(k) * 0.01;
            let felt = Vector3::new(3.0 * (5.0 * t).sin(), 2.0 * (7.0 * t).cos(), 9.81);
            start.add(&Matrix3::identity(), Some(&felt), 0.01, &params, &c);
        }
        let moved = (start.bias() - supposed).z.to_degrees();
        assert!(moved.abs() < 1e-3, "{moved}");
        assert!(start.bias_p()[(2, 2)].sqrt().to_degrees() > 0.9);
    }
}
