//! Simulated motion whose rates and accelerations are exact derivatives, and the earth that it happens on.

use nalgebra::Vector3;
use vergence_geom::{Rigid, exp, right_jacobian};
use vergence_time::Timestamp;

use crate::dice::Dice;

/// Gravity and magnetic field, in the frame of the world that a motion is told in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Earth {
    /// Acceleration of free fall, m/s²: points down.
    pub gravity_m_s2: Vector3<f64>,
    /// Magnetic field, µT.
    pub field_ut: Vector3<f64>,
}

impl Earth {
    /// East, (magnetic) north, up, at mid latitude: 49 µT that dip by 67°.
    pub const MID_LATITUDE: Self =
        Self { gravity_m_s2: Vector3::new(0.0, 0.0, -9.81), field_ut: Vector3::new(0.0, 19.146, -45.105) };
}

/// Where a body is and how it moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kinematics {
    /// Its pose.
    pub world_from_body: Rigid,
    /// Of the body's origin, in world axes, m/s.
    pub velocity_m_s: Vector3<f64>,
    /// Of the body's origin, in world axes, m/s².
    pub acceleration_m_s2: Vector3<f64>,
    /// Angular rate in body axes, rad/s: `d/dt world_from_body = world_from_body · [rate]×`.
    pub rate_in_body_rad_s: Vector3<f64>,
}

impl Kinematics {
    /// What an accelerometer at the body's origin feels, in body axes, m/s²: acceleration minus gravity.
    pub fn specific_force_m_s2(&self, earth: &Earth) -> Vector3<f64> {
        self.world_from_body.rotation.inverse_transform_vector(&(self.acceleration_m_s2 - earth.gravity_m_s2))
    }
}

/// A body's motion, pure in time.
pub trait Motion {
    /// Pose, velocity, acceleration and rate at `time`.
    fn at(&self, time: Timestamp) -> Kinematics;
}

/// Stays where it is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Still(pub Rigid);

impl Motion for Still {
    fn at(&self, _: Timestamp) -> Kinematics {
        Kinematics {
            world_from_body: self.0,
            velocity_m_s: Vector3::zeros(),
            acceleration_m_s2: Vector3::zeros(),
            rate_in_body_rad_s: Vector3::zeros(),
        }
    }
}

/// How a [`Wander`] moves.
#[derive(Clone, Debug, PartialEq)]
pub struct WanderParams {
    /// Size of the tilting, rad: the root of the mean square of each axis of the rotation vector.
    pub tilt_rad: f64,
    /// Size of the turning about the vertical, rad; 0 turns nowhere.
    pub turn_rad: f64,
    /// Size of the way along each axis, m.
    pub way_m: f64,
    /// Frequency that most of the motion has, Hz. Human hands: 0.3 (slow) to 2 (as fast as one can).
    pub frequency_hz: f64,
    /// Rests: from, to, in seconds, ascending; the motion slows down before and picks up after within `ramp_s`.
    pub rests_s: Vec<(f64, f64)>,
    /// How long slowing down takes, s; neighbouring rests must leave room for two.
    pub ramp_s: f64,
}

impl Default for WanderParams {
    fn default() -> Self {
        Self {
            tilt_rad: 0.5,
            turn_rad: 0.7,
            way_m: 0.15,
            frequency_hz: 0.7,
            rests_s: Vec::new(),
            ramp_s: 1.0,
        }
    }
}

/// Waves per axis.
const WAVES: usize = 5;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Wave {
    amplitude: f64,
    pulsation_rad_s: f64,
    phase_rad: f64,
}

/// A smooth random motion: sums of waves for rotation and position, in a time that stands still in the rests. All
/// derivatives exist and are exact; same seed, same motion.
#[derive(Clone, Debug, PartialEq)]
pub struct Wander {
    /// Three of tilt, one of turn, three of position.
    waves: [[Wave; WAVES]; 7],
    rests_s: Vec<(f64, f64)>,
    ramp_s: f64,
}

impl Wander {
    /// The motion of `seed`; `None` where a parameter is not finite or negative, or rests overlap with their ramps.
    pub fn new(seed: u64, params: &WanderParams) -> Option<Self> {
        let sizes = [params.tilt_rad, params.turn_rad, params.way_m, params.frequency_hz, params.ramp_s];
        let apart = |w: &[(f64, f64)]| w[0].1 + params.ramp_s <= w[1].0 - params.ramp_s;
        let fits = sizes.iter().all(|x| x.is_finite() && *x >= 0.0)
            && params.ramp_s > 0.0
            && params.rests_s.iter().all(|(from, to)| from <= to && to.is_finite() && from.is_finite())
            && params.rests_s.windows(2).all(apart);
        let waves = |axis: u64| {
            let dice = Dice::new(seed, 256 + axis);
            let size = match axis {
                0..3 => params.tilt_rad,
                3 => params.turn_rad,
                _ => params.way_m,
            };
            std::array::from_fn(|k| {
                // From a third of the frequency to thrice it, the faster the smaller, as of hands.
                let ratio = 3f64.powf((k as f64 - 2.0) / 2.0 + 0.3 * (dice.uniform(2 * k as u64) - 0.5));
                Wave {
                    amplitude: size * (2.0 / WAVES as f64).sqrt() * ratio.powf(-0.5),
                    pulsation_rad_s: std::f64::consts::TAU * params.frequency_hz * ratio,
                    phase_rad: std::f64::consts::TAU * dice.uniform(2 * k as u64 + 1),
                }
            })
        };
        fits.then(|| Self {
            waves: std::array::from_fn(|axis| waves(axis as u64)),
            rests_s: params.rests_s.clone(),
            ramp_s: params.ramp_s,
        })
    }

    /// The motion's own time at `t` seconds, with its first and second derivative.
    fn own_time(&self, t: f64) -> [f64; 3] {
        let r = self.ramp_s;
        let smooth = |x: f64| x * x * x * (10.0 - 15.0 * x + 6.0 * x * x);
        let slope = |x: f64| 30.0 * x * x * (1.0 - x) * (1.0 - x);
        let area = |x: f64| x * x * x * x * (2.5 - 3.0 * x + x * x);
        let (mut lost, mut slowed, mut slowing) = (0.0, 0.0, 0.0);
        for &(from, to) in &self.rests_s {
            if t <= from - r {
                break;
            } else if t < from {
                let x = (t - from) / r + 1.0;
                lost += r * area(x);
                slowed = smooth(x);
                slowing = slope(x) / r;
            } else if t <= to {
                lost += r / 2.0 + (t - from);
                slowed = 1.0;
            } else if t < to + r {
                let x = (t - to) / r;
                lost += r / 2.0 + (to - from) + r * (x - area(x));
                slowed = 1.0 - smooth(x);
                slowing = -slope(x) / r;
            } else {
                lost += r + (to - from);
            }
        }
        [t - lost, 1.0 - slowed, -slowing]
    }

    /// Value and two derivatives of one axis, by real time.
    fn axis(&self, axis: usize, [t, speed, speeding]: [f64; 3]) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for wave in &self.waves[axis] {
            let w = wave.pulsation_rad_s;
            let (sin, cos) = (w * t + wave.phase_rad).sin_cos();
            let (first, second) = (w * cos, -w * w * sin);
            sum[0] += wave.amplitude * sin;
            sum[1] += wave.amplitude * first * speed;
            sum[2] += wave.amplitude * (second * speed * speed + first * speeding);
        }
        sum
    }
}

impl Motion for Wander {
    fn at(&self, time: Timestamp) -> Kinematics {
        let own = self.own_time(time.as_nanos() as f64 * 1e-9);
        let axes: [[f64; 3]; 7] = std::array::from_fn(|axis| self.axis(axis, own));
        let part = |first: usize, order: usize| Vector3::from_fn(|i, _| axes[first + i][order]);
        let (tilt, tilting) = (part(0, 0), part(0, 1));
        let (turn, turning) = (Vector3::z() * axes[3][0], Vector3::z() * axes[3][1]);
        let tilted = exp(&tilt);
        Kinematics {
            world_from_body: Rigid::from_parts(part(4, 0).into(), exp(&turn) * tilted),
            velocity_m_s: part(4, 1),
            acceleration_m_s2: part(4, 2),
            // Of the product exp(turn) exp(tilt): the outer rate seen from inside, and the inner one.
            rate_in_body_rad_s: tilted.inverse_transform_vector(&turning) + right_jacobian(&tilt) * tilting,
        }
    }
}

#[cfg(test)]
mod tests {
    use vergence_geom::{advance, log};
    use vergence_time::Span;

    use super::*;

    fn motions() -> Vec<Wander> {
        let rests = vec![(0.0, 2.0), (6.0, 7.5)];
        let params = |vigour: f64| WanderParams {
            tilt_rad: vigour,
            frequency_hz: 0.5 + vigour,
            rests_s: rests.clone(),
            ..WanderParams::default()
        };
        [0.2, 0.6, 1.5].iter().zip(1..).map(|(v, seed)| Wander::new(seed, &params(*v)).unwrap()).collect()
    }

    fn seconds(t: f64) -> Timestamp {
        Timestamp::default().saturating_add(Span::from_secs_f64(t).unwrap())
    }

    /// Angle between the truth and the gyroscope integrated by the midpoint rule over 10 s.
    fn integration_error(motion: &Wander, step_ns: i64) -> f64 {
        let mut q = motion.at(seconds(0.0)).world_from_body.rotation;
        for k in 0..10_000_000_000 / step_ns {
            let middle = Timestamp::from_nanos(k * step_ns + step_ns / 2);
            q = advance(&q, &(motion.at(middle).rate_in_body_rad_s * (step_ns as f64 * 1e-9)));
        }
        log(&(q.inverse() * motion.at(seconds(10.0)).world_from_body.rotation)).norm()
    }

    #[test]
    fn the_integrated_gyroscope_is_the_orientation() {
        for motion in motions() {
            let (coarse, fine) =
                (integration_error(&motion, 2_000_000), integration_error(&motion, 1_000_000));
            // Nothing is left but the error of the rule, which falls with the square of the step.
            assert!(fine < 2e-3 && (coarse / fine - 4.0).abs() < 0.05, "{coarse} {fine}");
        }
    }

    #[test]
    fn the_accelerometer_is_the_second_derivative_minus_gravity() {
        let earth = Earth::MID_LATITUDE;
        const H: f64 = 2e-3;
        for motion in motions() {
            for k in 0..400 {
                let t = f64::from(k) * 0.031;
                let position = |k: f64| motion.at(seconds(t + k * H)).world_from_body.translation.vector;
                let (one, two) = (position(1.0) + position(-1.0), position(2.0) + position(-2.0));
                let second = (16.0 * one - two - 30.0 * position(0.0)) / (12.0 * H * H);
                let first =
                    (8.0 * (position(1.0) - position(-1.0)) - (position(2.0) - position(-2.0))) / (12.0 * H);
                let at = motion.at(seconds(t));
                assert!((at.velocity_m_s - first).norm() < 1e-5, "{t}: {}", (at.velocity_m_s - first).norm());
                let felt = at.world_from_body.rotation * at.specific_force_m_s2(&earth) + earth.gravity_m_s2;
                // Where a ramp begins or ends, the third derivative of the motion's own time jumps.
                assert!((felt - second).norm() < 1e-3, "{t}: {}", (felt - second).norm());
            }
        }
    }

    #[test]
    fn rests_are_at_rest_and_the_rest_is_not() {
        for motion in motions() {
            for t in [0.5, 1.9, 6.3, 7.4] {
                let at = motion.at(seconds(t));
                assert_eq!(
                    at.rate_in_body_rad_s.norm() + at.acceleration_m_s2.norm() + at.velocity_m_s.norm(),
                    0.0
                );
            }
            let moving = motion.at(seconds(4.0));
            assert!(moving.rate_in_body_rad_s.norm() > 0.05 && moving.velocity_m_s.norm() > 1e-3);
        }
    }

    #[test]
    fn what_cannot_be_moved_is_refused() {
        let near = WanderParams { rests_s: vec![(0.0, 1.0), (2.0, 3.0)], ..WanderParams::default() };
        assert_eq!(Wander::new(1, &near), None);
        let nan = WanderParams { tilt_rad: f64::NAN, ..WanderParams::default() };
        assert_eq!(Wander::new(1, &nan), None);
    }
}
