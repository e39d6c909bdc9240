//! Where a device was, is and will be.

use std::collections::VecDeque;

use nalgebra::{UnitQuaternion, Vector3};
use vergence_geom::{Rigid, exp, log, slerp};
use vergence_sense::{Pose, Tracking, Velocity};
use vergence_time::{Span, Timestamp};

/// How far a history reaches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reach {
    /// Readings kept; the oldest go first. At least 2; 100 bytes each, all taken at the start.
    pub readings: usize,
    /// The longest time between two readings that is bridged. Larger bridges dropouts by a straight line, whose error
    /// grows with the square of the gap: a/8 · gap² at acceleration a (7 mm for 10 m/s² over 75 ms).
    pub gap: Span,
    /// The longest time ahead of the last reading that is predicted. The error grows with its square: a/2 · ahead².
    pub ahead: Span,
}

impl Default for Reach {
    /// Two seconds at 1 kHz; bridges 75 ms; looks 100 ms ahead.
    fn default() -> Self {
        Self { readings: 2048, gap: Span::from_millis(75), ahead: Span::from_millis(100) }
    }
}

/// How a pose is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum How {
    /// It was read at this very instant.
    Exact,
    /// It lies between two readings.
    Interpolated {
        /// Time between them.
        gap: Span,
    },
    /// It lies ahead of the last reading.
    Predicted {
        /// Time since then.
        ahead: Span,
    },
    /// It is not known: before the first reading kept, in a gap, too far ahead, or tracking was lost.
    Lost,
}

/// Says where a device will be, from the readings so far: what a [`PoseHistory`] asks beyond its last one.
pub trait Ahead: std::fmt::Debug + Send {
    /// At `at`, later than any before, the device was here; with its velocity, in reference coordinates, where it said it.
    fn observe(&mut self, at: Timestamp, reference_from_device: &Rigid, velocity: Option<&Velocity>);

    /// Where it will be at `instant`, after the last observation; `None` where nothing was observed.
    fn at(&self, instant: Timestamp) -> Option<Rigid>;

    /// Forgets everything.
    fn clear(&mut self);
}

/// A pose and how it is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answer {
    /// [`Pose::LOST`] where it is not known. A predicted pose is inferred, an interpolated one is as good as the worse
    /// of its neighbours.
    pub pose: Pose,
    /// How it is known.
    pub how: How,
}

impl Answer {
    const LOST: Self = Self { pose: Pose::LOST, how: How::Lost };

    /// Not known where no part of the pose may be read.
    fn known(pose: Pose, how: How) -> Self {
        let lost = (pose.position_tracking, pose.orientation_tracking) == (Tracking::Lost, Tracking::Lost);
        Self { pose, how: if lost { How::Lost } else { how } }
    }
}

#[derive(Clone, Copy, Debug)]
struct Reading {
    at: Timestamp,
    pose: Pose,
    velocity: Option<Velocity>,
}

/// The last readings of one device. Takes and answers without allocating; an answer costs a binary search. Ahead of the last
/// reading it answers by the velocity (the device's own, else between the last two), or by what it was given to ask.
#[derive(Debug)]
pub struct PoseHistory {
    reach: Reach,
    readings: VecDeque<Reading>,
    ahead: Option<Box<dyn Ahead>>,
}

impl PoseHistory {
    /// An empty history.
    pub fn new(reach: &Reach) -> Self {
        let reach = Reach { readings: reach.readings.max(2), ..*reach };
        Self { reach, readings: VecDeque::with_capacity(reach.readings), ahead: None }
    }

    /// An empty history that asks `ahead` for what comes after the last whole reading.
    pub fn foretold(reach: &Reach, ahead: Box<dyn Ahead>) -> Self {
        Self { ahead: Some(ahead), ..Self::new(reach) }
    }

    /// Takes the reading of an instant, with the velocity where the device says it. Whether it was taken: a reading
    /// that is not later than the last one is not.
    pub fn push(&mut self, at: Timestamp, pose: Pose, velocity: Option<Velocity>) -> bool {
        if self.readings.back().is_some_and(|last| last.at >= at) {
            return false;
        }
        if self.readings.len() == self.reach.readings {
            self.readings.pop_front();
        }
        self.readings.push_back(Reading { at, pose, velocity });
        if let (Some(ahead), Some(here)) = (&mut self.ahead, pose.reference_from_device()) {
            ahead.observe(at, &here, velocity.as_ref());
        }
        true
    }

    /// Forgets everything (the origin moved, the device is another).
    pub fn clear(&mut self) {
        self.readings.clear();
        if let Some(ahead) = &mut self.ahead {
            ahead.clear();
        }
    }

    /// The instants of the first and the last reading kept.
    pub fn extent(&self) -> Option<(Timestamp, Timestamp)> {
        Some((self.readings.front()?.at, self.readings.back()?.at))
    }

    /// Where the device is at `instant`, and how that is known.
    pub fn at(&self, instant: Timestamp) -> Answer {
        let next = self.readings.partition_point(|reading| reading.at < instant);
        match (next.checked_sub(1).map(|previous| &self.readings[previous]), self.readings.get(next)) {
            (_, Some(here)) if here.at == instant => Answer::known(here.pose, How::Exact),
            (Some(before), Some(after)) => self.between(before, after, instant),
            (Some(last), None) => self.beyond(last, instant),
            (None, _) => Answer::LOST,
        }
    }

    fn between(&self, before: &Reading, after: &Reading, instant: Timestamp) -> Answer {
        let (Some(gap), Some(into)) = (after.at.since(before.at), instant.since(before.at)) else {
            return Answer::LOST;
        };
        if gap > self.reach.gap {
            return Answer::LOST;
        }
        let t = into.as_nanos() as f64 / gap.as_nanos() as f64;
        let (p0, p1) = (position(&before.pose), position(&after.pose));
        let place = p0.zip(p1).map(|(p0, p1)| p0.lerp(&p1, t));
        let turned =
            before.pose.orientation().zip(after.pose.orientation()).map(|(q0, q1)| slerp(&q0, &q1, t));
        let trust = |a: Tracking, b: Tracking| if a == b { a } else { Tracking::Inferred };
        let pose = assemble(
            place,
            trust(before.pose.position_tracking, after.pose.position_tracking),
            turned,
            trust(before.pose.orientation_tracking, after.pose.orientation_tracking),
        );
        Answer::known(pose, How::Interpolated { gap })
    }

    fn beyond(&self, last: &Reading, instant: Timestamp) -> Answer {
        let Some(ahead) = instant.since(last.at).filter(|ahead| *ahead <= self.reach.ahead) else {
            return Answer::LOST;
        };
        let how = How::Predicted { ahead };
        // Where a part of the last reading is lost, what was foretold is about an earlier one.
        let foretold = self.ahead.as_ref().filter(|_| last.pose.reference_from_device().is_some());
        if let Some(there) = foretold.and_then(|foretold| foretold.at(instant)) {
            let (p, q) = (there.translation.vector, there.rotation.coords);
            let (place, turned) = (p.into(), [q.x, q.y, q.z, q.w]);
            let pose = Pose::from_exact(place, Tracking::Inferred, turned, Tracking::Inferred);
            return Answer::known(pose, how);
        }
        let velocity = last
            .velocity
            .or_else(|| self.last_velocity())
            .unwrap_or(Velocity { linear_m_s: Vector3::zeros(), angular_rad_s: Vector3::zeros() });
        let secs = ahead.as_secs_f64();
        // What is not finite is no velocity: the device is taken to stand still.
        let finite = |v: Vector3<f64>| if v.iter().all(|x| x.is_finite()) { v } else { Vector3::zeros() };
        let place = position(&last.pose).map(|p| p + finite(velocity.linear_m_s) * secs);
        // The velocity is in reference coordinates, so it turns from the left.
        let turned = last.pose.orientation().map(|q| exp(&(finite(velocity.angular_rad_s) * secs)) * q);
        let pose = assemble(place, Tracking::Inferred, turned, Tracking::Inferred);
        Answer::known(pose, how)
    }

    /// From the last two readings, where they are near enough.
    fn last_velocity(&self) -> Option<Velocity> {
        let mut newest = self.readings.iter().rev();
        let (last, before) = (newest.next()?, newest.next()?);
        let gap = last.at.since(before.at).filter(|gap| *gap <= self.reach.gap)?.as_secs_f64();
        let moved = position(&last.pose).zip(position(&before.pose)).map(|(p1, p0)| p1 - p0);
        let turned =
            last.pose.orientation().zip(before.pose.orientation()).map(|(q1, q0)| log(&(q1 * q0.inverse())));
        Some(Velocity {
            linear_m_s: moved.unwrap_or_default() / gap,
            angular_rad_s: turned.unwrap_or_default() / gap,
        })
    }
}

fn position(pose: &Pose) -> Option<Vector3<f64>> {
    (pose.position_tracking != Tracking::Lost).then(|| pose.to_exact().0.into())
}

/// A part that is none is lost.
fn assemble(
    place: Option<Vector3<f64>>,
    place_trust: Tracking,
    turned: Option<UnitQuaternion<f64>>,
    turned_trust: Tracking,
) -> Pose {
    let trust = |known: bool, trust| if known { trust } else { Tracking::Lost };
    let q = turned.unwrap_or_default().coords;
    Pose::from_exact(
        place.unwrap_or_default().into(),
        trust(place.is_some(), place_trust),
        [q.x, q.y, q.z, q.w],
        trust(turned.is_some(), turned_trust),
    )
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use vergence_geom::interpolate;

    use super::*;

    fn at(millis: i64) -> Timestamp {
        Timestamp::from_nanos(millis * 1_000_000)
    }

    fn turned(x: f64, angle: f64) -> Rigid {
        Rigid::new(Vector3::new(x, 1.6, 0.0), Vector3::y() * angle)
    }

    fn filled() -> PoseHistory {
        let mut history = PoseHistory::new(&Reach::default());
        for step in 0..10 {
            let step = step as f64;
            assert!(history.push(at(10 * step as i64), Pose::tracked(turned(0.02 * step, 0.1 * step)), None));
        }
        history
    }

    #[test]
    fn readings_come_back_and_between_them_motion_is_even() {
        let history = filled();
        let exact = history.at(at(30));
        assert_eq!((exact.how, exact.pose), (How::Exact, Pose::tracked(turned(0.06, 0.1 * 3.0))));
        let between = history.at(at(37));
        assert_eq!(between.how, How::Interpolated { gap: Span::from_millis(10) });
        let wanted = interpolate(&turned(0.06, 0.3), &turned(0.08, 0.4), 0.7);
        let found = between.pose.reference_from_device().unwrap();
        assert!((found.to_homogeneous() - wanted.to_homogeneous()).norm() < 1e-14);
        assert_eq!(between.pose.position_tracking, Tracking::Measured);
    }

    #[test]
    fn even_motion_is_predicted_exactly_and_no_further_than_allowed() {
        let history = filled();
        let ahead = history.at(at(130));
        assert_eq!(ahead.how, How::Predicted { ahead: Span::from_millis(40) });
        let found = ahead.pose.reference_from_device().unwrap();
        assert!((found.to_homogeneous() - turned(0.26, 1.3).to_homogeneous()).norm() < 1e-13);
        assert_eq!(ahead.pose.orientation_tracking, Tracking::Inferred);
        assert_eq!(history.at(at(191)), Answer::LOST);
        assert_eq!(history.at(at(-1)), Answer::LOST);
    }

    #[test]
    fn the_devices_own_velocity_is_taken_where_there_is_one() {
        let mut history = PoseHistory::new(&Reach::default());
        let velocity = Velocity { linear_m_s: Vector3::x(), angular_rad_s: Vector3::y() * 2.0 };
        history.push(at(0), Pose::tracked(turned(0.0, 0.5)), Some(velocity));
        let found = history.at(at(50)).pose.reference_from_device().unwrap();
        assert!((found.to_homogeneous() - turned(0.05, 0.6).to_homogeneous()).norm() < 1e-14);
        let mad = Velocity { linear_m_s: Vector3::x() * f64::NAN, ..velocity };
        history.push(at(60), Pose::tracked(turned(0.1, 0.5)), Some(mad));
        assert_eq!(history.at(at(70)).pose.reference_from_device().unwrap().translation.x, 0.1);
    }

    /// Wherever it was last, it will be a metre to the right.
    #[derive(Debug, Default)]
    struct Right(Option<Rigid>);

    impl Ahead for Right {
        fn observe(&mut self, _: Timestamp, here: &Rigid, _: Option<&Velocity>) {
            self.0 = Some(*here);
        }

        fn at(&self, _: Timestamp) -> Option<Rigid> {
            self.0.map(|here| Rigid::translation(1.0, 0.0, 0.0) * here)
        }

        fn clear(&mut self) {
            self.0 = None;
        }
    }

    #[test]
    fn who_is_asked_for_what_comes_is_asked_within_reach() {
        let mut history = PoseHistory::foretold(&Reach::default(), Box::<Right>::default());
        assert_eq!(history.at(at(0)), Answer::LOST);
        history.push(at(0), Pose::tracked(turned(0.0, 0.5)), None);
        history.push(at(10), Pose::tracked(turned(0.2, 0.5)), None);
        let ahead = history.at(at(30));
        assert_eq!(ahead.how, How::Predicted { ahead: Span::from_millis(20) });
        assert_eq!(ahead.pose.reference_from_device().unwrap().translation.x, 1.2);
        assert_eq!(history.at(at(5)).how, How::Interpolated { gap: Span::from_millis(10) });
        assert_eq!(history.at(at(111)), Answer::LOST);
        history.push(at(20), Pose::LOST, None);
        assert_eq!(history.at(at(30)), Answer::LOST);
        history.clear();
        history.push(at(30), Pose::LOST, None);
        assert_eq!(history.at(at(31)), Answer::LOST);
    }

    #[test]
    fn what_was_lost_stays_lost_part_by_part() {
        let mut history = PoseHistory::new(&Reach::default());
        let blind = Pose::from_parts([0.0; 3], Tracking::Lost, [0.0, 0.0, 0.0, 1.0], Tracking::Measured);
        history.push(at(0), Pose::tracked(turned(0.0, 0.0)), None);
        history.push(at(10), blind, None);
        history.push(at(20), Pose::LOST, None);
        history.push(at(200), Pose::tracked(turned(1.0, 1.0)), None);
        let half = history.at(at(5));
        assert_eq!(
            (half.pose.position_tracking, half.pose.orientation_tracking),
            (Tracking::Lost, Tracking::Measured)
        );
        for lost in [15, 20, 25, 100, 199] {
            assert_eq!(history.at(at(lost)).how, How::Lost, "{lost}");
        }
    }

    #[test]
    fn late_readings_are_refused_and_old_ones_forgotten() {
        let mut history = PoseHistory::new(&Reach { readings: 0, ..Reach::default() });
        assert!(history.push(at(5), Pose::LOST, None) && !history.push(at(5), Pose::LOST, None));
        assert!(!history.push(at(4), Pose::LOST, None));
        history.push(at(6), Pose::LOST, None);
        history.push(at(7), Pose::LOST, None);
        assert_eq!(history.extent(), Some((at(6), at(7))));
        history.clear();
        assert_eq!((history.extent(), history.at(at(6))), (None, Answer::LOST));
    }

    proptest! {
        #[test]
        fn any_times_give_finite_answers(times in proptest::collection::vec(any::<i64>(), 1..20), ask in any::<i64>(),
                                         near in -200_000_000i64..200_000_000) {
            let everything = Span::from_nanos(i64::MAX);
            let mut history = PoseHistory::new(&Reach { readings: 8, gap: everything, ahead: everything });
            for (step, &nanos) in times.iter().enumerate() {
                let step = step as f64;
                history.push(Timestamp::from_nanos(nanos), Pose::tracked(turned(1e6 * step, 3.0 * step)), None);
            }
            for ask in [ask, times[0].saturating_add(near), i64::MIN, i64::MAX] {
                let answer = history.at(Timestamp::from_nanos(ask));
                let (p, q) = answer.pose.to_exact();
                prop_assert!(p.iter().chain(&q).all(|x| x.is_finite()), "{answer:?}");
                let norm = q.iter().map(|x| x * x).sum::<f64>();
                prop_assert!((norm - 1.0).abs() < 1e-9);
            }
        }
    }
}
