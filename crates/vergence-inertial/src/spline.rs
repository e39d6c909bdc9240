//! A recorded way made smooth: a motion whose rates and accelerations are exact derivatives.

use nalgebra::{UnitQuaternion, Vector3};
use vergence_geom::{Rigid, exp, log};
use vergence_time::{Span, Timestamp};

use crate::motion::{Kinematics, Motion};

/// A uniform cubic B-spline through the neighbourhood of recorded poses (it smooths them a little: the spline itself is
/// the truth, not the recording). Twice continuously differentiable; outside of its span it stays at its ends, at rest.
///
/// Cumulative form: M.-J. Kim, M.-S. Kim, S. Y. Shin, "A general construction scheme for unit quaternion curves with
/// simple high order derivatives", SIGGRAPH 1995.
#[derive(Clone, Debug, PartialEq)]
pub struct SplineMotion {
    positions_m: Vec<Vector3<f64>>,
    rotations: Vec<UnitQuaternion<f64>>,
    /// Rotation vectors from each control rotation to the next.
    turns: Vec<Vector3<f64>>,
    start: Timestamp,
    knot: Span,
}

impl SplineMotion {
    /// Control poses every `knot` (20 to 100 ms suit heads and drones), interpolated in ascending `poses`; `None` where
    /// there are fewer than four, or times do not ascend.
    pub fn new(poses: &[(Timestamp, Rigid)], knot: Span) -> Option<Self> {
        let ascending = poses.windows(2).all(|w| w[0].0 < w[1].0);
        let (first, last) = (poses.first()?.0, poses.last()?.0);
        let length = last.since(first)?;
        let step = knot.as_nanos();
        if !ascending || step <= 0 || length.as_nanos() / step < 4 {
            return None;
        }
        let (mut positions_m, mut rotations) = (Vec::new(), Vec::new());
        let mut at = 0;
        for k in 0..=length.as_nanos() / step {
            let time = first.checked_add(Span::from_nanos(k * step))?;
            while at + 2 < poses.len() && poses[at + 1].0 <= time {
                at += 1;
            }
            let (a, b) = (&poses[at], &poses[at + 1]);
            let share = time.since(a.0)?.as_secs_f64() / b.0.since(a.0)?.as_secs_f64();
            let pose = vergence_geom::interpolate(&a.1, &b.1, share);
            positions_m.push(pose.translation.vector);
            rotations.push(pose.rotation);
        }
        let turns = rotations.windows(2).map(|w| log(&(w[0].inverse() * w[1]))).collect();
        Some(Self { positions_m, rotations, turns, start: first, knot })
    }

    /// When it begins to follow the recording.
    pub fn start(&self) -> Timestamp {
        self.start.saturating_add(self.knot)
    }

    /// When it has followed it to the end.
    pub fn end(&self) -> Timestamp {
        self.start
            .saturating_add(Span::from_nanos(self.knot.as_nanos() * (self.positions_m.len() as i64 - 2)))
    }
}

impl Motion for SplineMotion {
    fn at(&self, time: Timestamp) -> Kinematics {
        let last = self.positions_m.len() - 4;
        let dt = self.knot.as_secs_f64();
        let (from, to) = (self.start(), self.end());
        let held = time.max(from).min(to);
        let since = held.since(from).unwrap_or(Span::ZERO).as_nanos();
        let segment = ((since / self.knot.as_nanos()).max(0) as usize).min(last);
        let u = (since - segment as i64 * self.knot.as_nanos()) as f64 / self.knot.as_nanos() as f64;
        let resting = time < from || time > to;
        // Cumulative basis, its first and its second derivative (by time).
        let (u2, u3) = (u * u, u * u * u);
        let basis = [
            [(5.0 + 3.0 * u - 3.0 * u2 + u3) / 6.0, (1.0 + 3.0 * u + 3.0 * u2 - 2.0 * u3) / 6.0, u3 / 6.0],
            [(3.0 - 6.0 * u + 3.0 * u2) / 6.0, (3.0 + 6.0 * u - 6.0 * u2) / 6.0, u2 / 2.0],
            [u - 1.0, 1.0 - 2.0 * u, u],
        ];
        let steps: [Vector3<f64>; 3] =
            std::array::from_fn(|j| self.positions_m[segment + j + 1] - self.positions_m[segment + j]);
        let sum = |order: usize| (0..3).map(|j| steps[j] * basis[order][j]).sum::<Vector3<f64>>();
        let mut rotation = self.rotations[segment];
        let mut rate = Vector3::zeros();
        for (turn, (share, speed)) in self.turns[segment..].iter().zip(basis[0].iter().zip(&basis[1])) {
            let part = exp(&(turn * *share));
            rotation *= part;
            rate = part.inverse() * rate + turn * (speed / dt);
        }
        let moving = if resting { 0.0 } else { 1.0 };
        Kinematics {
            world_from_body: Rigid::from_parts((self.positions_m[segment] + sum(0)).into(), rotation),
            velocity_m_s: sum(1) * (moving / dt),
            acceleration_m_s2: sum(2) * (moving / (dt * dt)),
            rate_in_body_rad_s: rate * moving,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{Wander, WanderParams};

    fn nanos(t: i64) -> Timestamp {
        Timestamp::from_nanos(t)
    }

    fn spline() -> (Wander, SplineMotion) {
        let wander = Wander::new(4, &WanderParams { tilt_rad: 0.6, ..WanderParams::default() }).unwrap();
        let poses: Vec<_> = (0..200)
            .map(|k| (nanos(k * 20_000_000), wander.at(nanos(k * 20_000_000)).world_from_body))
            .collect();
        (wander, SplineMotion::new(&poses, Span::from_millis(50)).unwrap())
    }

    #[test]
    fn it_stays_near_what_was_recorded() {
        let (wander, spline) = spline();
        for k in 5..70 {
            let (a, b) = (wander.at(nanos(k * 51_000_000)), spline.at(nanos(k * 51_000_000)));
            assert!(
                (a.world_from_body.translation.vector - b.world_from_body.translation.vector).norm() < 0.02
            );
            assert!(a.world_from_body.rotation.angle_to(&b.world_from_body.rotation) < 0.08);
        }
    }

    #[test]
    fn its_derivatives_are_the_numerical_ones() {
        const H: i64 = 1_000_000;
        let (_, spline) = spline();
        let h = H as f64 * 1e-9;
        for k in 0..300 {
            let t = 200_000_000 + k * 10_300_000;
            let (a, m, b) = (spline.at(nanos(t - H)), spline.at(nanos(t)), spline.at(nanos(t + H)));
            let [pa, pm, pb] = [&a, &m, &b].map(|x| x.world_from_body.translation.vector);
            assert!(((pb - pa) / (2.0 * h) - m.velocity_m_s).norm() < 1e-3);
            assert!(((b.velocity_m_s - a.velocity_m_s) / (2.0 * h) - m.acceleration_m_s2).norm() < 0.3);
            assert!(((pb + pa - pm * 2.0) / (h * h) - m.acceleration_m_s2).norm() < 0.3);
            let turned =
                log(&(a.world_from_body.rotation.inverse() * b.world_from_body.rotation)) / (2.0 * h);
            assert!((turned - m.rate_in_body_rad_s).norm() < 1e-2);
        }
    }

    #[test]
    fn outside_of_its_span_it_rests_at_its_ends() {
        let (_, spline) = spline();
        let far = spline.at(nanos(i64::MAX));
        assert_eq!(far.velocity_m_s.norm(), 0.0);
        assert!(
            (far.world_from_body.translation.vector
                - spline.at(spline.end()).world_from_body.translation.vector)
                .norm()
                < 1e-9
        );
        let before = spline.at(nanos(i64::MIN));
        assert_eq!(before.world_from_body, spline.at(spline.start()).world_from_body);
        assert!(SplineMotion::new(&[], Span::from_millis(50)).is_none());
    }
}
