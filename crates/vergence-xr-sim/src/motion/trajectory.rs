use vergence_geom::{Rigid, interpolate};
use vergence_time::{Span, Timestamp};

use super::Tracked;

/// One pose of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// When, on the clock of the trajectory.
    pub at: Timestamp,
    /// Takes coordinates of the tracked body to coordinates of the trajectory's world.
    pub world_from_body: Rigid,
}

/// What happens after the last pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AtEnd {
    /// The last pose stays.
    Hold,
    /// The trajectory starts again, at once.
    Loop,
    /// The last pose stays and the session is asked to end.
    Stop,
}

/// What happens between two poses that are too far apart in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Gaps {
    /// The pose before the gap stays, not tracked.
    Hold,
    /// Nothing is known.
    Lost,
    /// As between any two poses.
    Interpolate,
}

/// Poses over time: exact at each sample, between two of them on the shortest way (position linear, rotation
/// spherical: Shoemake 1985), at both ends as asked for.
#[derive(Clone, Debug)]
pub struct Trajectory {
    samples: Vec<Sample>,
    start: Timestamp,
    at_end: AtEnd,
    gaps: Gaps,
    longest_step: Span,
}

impl Trajectory {
    /// `samples` with strictly rising times; time 0 of the motion is `start` on their clock. Steps longer than
    /// `longest_step` are gaps. `None` where there is no sample, times do not rise, or they span more than i64.
    pub fn new(
        samples: Vec<Sample>,
        start: Timestamp,
        at_end: AtEnd,
        gaps: Gaps,
        longest_step: Span,
    ) -> Option<Self> {
        let rising = samples.windows(2).all(|pair| pair[0].at < pair[1].at);
        let spans = samples.last()?.at.since(samples.first()?.at).and(samples.last()?.at.since(start));
        (rising && spans.is_some()).then_some(Self { samples, start, at_end, gaps, longest_step })
    }

    /// The first pose that is shown: that at motion time 0.
    pub fn first(&self) -> Rigid {
        self.at(Timestamp::default()).pose().unwrap_or(self.samples[0].world_from_body)
    }

    /// How long the motion lasts, from motion time 0 to the last pose.
    pub fn duration(&self) -> Span {
        // `new` keeps at least one sample, and spans that fit.
        self.samples[self.samples.len() - 1].at.since(self.start).unwrap_or(Span::ZERO)
    }

    /// When the session is to end.
    pub fn end(&self) -> Option<Timestamp> {
        (self.at_end == AtEnd::Stop).then(|| Timestamp::from_nanos(self.duration().as_nanos()))
    }

    /// The pose at motion time `at`. Before the trajectory the first pose is held; both that and what is held
    /// after the end count as tracked, since nothing was lost.
    pub fn at(&self, at: Timestamp) -> Tracked {
        let mut nanos = at.as_nanos();
        let duration = self.duration().as_nanos();
        if self.at_end == AtEnd::Loop && nanos > duration && duration > 0 {
            nanos %= duration;
        }
        let instant = self.start.saturating_add(Span::from_nanos(nanos));
        let after = self.samples.partition_point(|sample| sample.at <= instant);
        let (Some(before), next) = (after.checked_sub(1), self.samples.get(after)) else {
            return Tracked::Seen(self.samples[0].world_from_body);
        };
        let before = &self.samples[before];
        let Some(next) = next.filter(|_| before.at < instant) else {
            return Tracked::Seen(before.world_from_body);
        };
        let (step, into) = (span(before.at, next.at), span(before.at, instant));
        if step > self.longest_step.as_nanos() as f64 {
            match self.gaps {
                Gaps::Hold => return Tracked::Held(before.world_from_body),
                Gaps::Lost => return Tracked::Lost,
                Gaps::Interpolate => {}
            }
        }
        Tracked::Seen(interpolate(&before.world_from_body, &next.world_from_body, into / step))
    }
}

fn span(from: Timestamp, to: Timestamp) -> f64 {
    to.since(from).map_or(f64::INFINITY, |span| span.as_nanos() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};

    fn at(millis: i64) -> Timestamp {
        Timestamp::from_nanos(millis * 1_000_000)
    }

    fn pose(x: f64, yaw: f64) -> Rigid {
        Rigid::new(Vector3::new(x, -x, 2.0 * x), Vector3::y() * yaw)
    }

    fn trajectory(at_end: AtEnd, gaps: Gaps) -> Trajectory {
        let samples = [(1000, 0.0, 0.0), (1010, 1.0, 0.2), (1020, 3.0, 0.1), (1220, 5.0, 2.0)]
            .map(|(ms, x, yaw)| Sample { at: at(ms), world_from_body: pose(x, yaw) });
        Trajectory::new(samples.to_vec(), at(1000), at_end, gaps, Span::from_millis(100)).unwrap()
    }

    #[test]
    fn a_sample_is_given_back_bit_for_bit() {
        let t = trajectory(AtEnd::Hold, Gaps::Lost);
        for (ms, x, yaw) in [(0, 0.0, 0.0), (10, 1.0, 0.2), (20, 3.0, 0.1), (220, 5.0, 2.0)] {
            assert_eq!(t.at(at(ms)), Tracked::Seen(pose(x, yaw)), "{ms}");
        }
    }

    #[test]
    fn between_samples_position_is_linear_and_rotation_spherical() {
        let t = trajectory(AtEnd::Hold, Gaps::Lost);
        let Tracked::Seen(found) = t.at(Timestamp::from_nanos(2_500_000)) else { panic!("tracked") };
        assert!((found.translation.vector - pose(0.25, 0.0).translation.vector).norm() < 1e-15);
        assert!(found.rotation.angle_to(&pose(0.0, 0.05).rotation) < 1e-15);
    }

    #[test]
    fn the_short_arc_is_taken_and_a_half_turn_is_finite() {
        let a = pose(0.0, 0.1);
        let flipped = Rigid::from_parts(
            a.translation,
            UnitQuaternion::new_unchecked(-pose(0.0, 0.3).rotation.into_inner()),
        );
        assert!(interpolate(&a, &flipped, 0.5).rotation.angle_to(&pose(0.0, 0.2).rotation) < 1e-12);
        let half = interpolate(&pose(0.0, 0.0), &pose(0.0, std::f64::consts::PI), 0.5);
        assert!(half.rotation.coords.iter().all(|c| c.is_finite()));
        // Samples a rounding error apart must not divide by the sine of nothing.
        let close = interpolate(&a, &pose(0.0, 0.1 + 1e-12), 0.3);
        assert!(close.rotation.angle_to(&a.rotation) < 1e-11);
    }

    #[test]
    fn gaps_do_what_was_asked_for() {
        assert_eq!(trajectory(AtEnd::Hold, Gaps::Lost).at(at(120)), Tracked::Lost);
        assert_eq!(trajectory(AtEnd::Hold, Gaps::Hold).at(at(120)), Tracked::Held(pose(3.0, 0.1)));
        let Tracked::Seen(found) = trajectory(AtEnd::Hold, Gaps::Interpolate).at(at(120)) else {
            panic!("seen")
        };
        assert!((found.translation.vector.x - 4.0).abs() < 1e-12);
    }

    #[test]
    fn ends_do_what_was_asked_for() {
        let far = at(1_000_000);
        assert_eq!(trajectory(AtEnd::Hold, Gaps::Lost).at(far), Tracked::Seen(pose(5.0, 2.0)));
        assert_eq!(trajectory(AtEnd::Hold, Gaps::Lost).end(), None);
        assert_eq!(trajectory(AtEnd::Stop, Gaps::Lost).end(), Some(at(220)));
        assert_eq!(trajectory(AtEnd::Loop, Gaps::Lost).at(at(220 * 3 + 10)), Tracked::Seen(pose(1.0, 0.2)));
        assert_eq!(trajectory(AtEnd::Loop, Gaps::Lost).at(at(-50)), Tracked::Seen(pose(0.0, 0.0)));
    }

    #[test]
    fn what_is_no_trajectory_is_refused() {
        let sample = |nanos| Sample { at: Timestamp::from_nanos(nanos), world_from_body: Rigid::identity() };
        for samples in [vec![], vec![sample(1), sample(1)], vec![sample(i64::MIN), sample(i64::MAX)]] {
            let made = Trajectory::new(samples, Timestamp::default(), AtEnd::Hold, Gaps::Lost, Span::ZERO);
            assert!(made.is_none());
        }
        let one =
            Trajectory::new(vec![sample(7)], Timestamp::from_nanos(7), AtEnd::Loop, Gaps::Lost, Span::ZERO)
                .unwrap();
        assert_eq!(one.at(at(5)), Tracked::Seen(Rigid::identity()));
    }
}
