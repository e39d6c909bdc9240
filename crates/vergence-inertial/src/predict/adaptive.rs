//! The learner on orientations and on positions.

use nalgebra::{UnitQuaternion, Vector3};
use vergence_geom::{advance, log};
use vergence_time::Timestamp;

use super::learner::{Learner, LearnerParams, Path};
use super::{PredictPosition, PredictRotation, ahead_s, follows};

/// The gyroscope alone, integrated: what corrections of the orientation do to it is no motion.
#[derive(Clone, Copy, Debug)]
struct Turned(UnitQuaternion<f64>);

impl Path for Turned {
    fn mean_rate_to(&self, later: &Self, seconds: f64) -> Vector3<f64> {
        log(&(self.0.inverse() * later.0)) / seconds
    }
}

#[derive(Clone, Copy, Debug)]
struct Moved(Vector3<f64>);

impl Path for Moved {
    fn mean_rate_to(&self, later: &Self, seconds: f64) -> Vector3<f64> {
        (later.0 - self.0) / seconds
    }
}

/// Orientation, from the last 70 ms of the gyroscope with learnt weights.
#[derive(Clone, Debug)]
pub struct AdaptiveRotation {
    learner: Learner<Turned>,
    last: Option<(Timestamp, UnitQuaternion<f64>)>,
    turned: UnitQuaternion<f64>,
}

impl AdaptiveRotation {
    /// With these knobs.
    pub fn new(params: LearnerParams) -> Self {
        Self { learner: Learner::new(params), last: None, turned: UnitQuaternion::identity() }
    }
}

impl PredictRotation for AdaptiveRotation {
    fn observe(
        &mut self,
        time: Timestamp,
        world_from_body: &UnitQuaternion<f64>,
        rate_in_body_rad_s: &Vector3<f64>,
    ) {
        let numbers = world_from_body.coords.iter().chain(rate_in_body_rad_s.iter());
        let Some(since) = follows(self.last.map(|(last, _)| last), time, numbers) else { return };
        match since {
            Some(seconds) => self.turned = advance(&self.turned, &(rate_in_body_rad_s * seconds)),
            None => self.learner.interrupt(),
        }
        self.last = Some((time, *world_from_body));
        if self.learner.wants(time) {
            self.learner.observe(time, Turned(self.turned), *rate_in_body_rad_s);
        }
    }

    fn predict(&self, time: Timestamp) -> Option<UnitQuaternion<f64>> {
        let (last, world_from_body) = self.last?;
        let ahead = ahead_s(last, time);
        let Some((learnt, Turned(then))) = self.learner.last().filter(|_| ahead > 0.0) else {
            return Some(world_from_body);
        };
        // From the last observation that was learnt, less what has been turned since.
        let whole = ahead + ahead_s(learnt, last);
        let way = log(&advance(&(self.turned.inverse() * then), &(self.learner.mean_rate(whole) * whole)));
        Some(advance(&world_from_body, &way))
    }
}

/// Position, from the last 70 ms of positions with learnt weights.
#[derive(Clone, Debug)]
pub struct AdaptivePosition {
    learner: Learner<Moved>,
    last: Option<(Timestamp, Vector3<f64>)>,
}

impl AdaptivePosition {
    /// With these knobs.
    pub fn new(params: LearnerParams) -> Self {
        Self { learner: Learner::new(params), last: None }
    }
}

impl PredictPosition for AdaptivePosition {
    fn observe(&mut self, time: Timestamp, position_m: &Vector3<f64>) {
        let Some(since) = follows(self.last.map(|(last, _)| last), time, position_m.iter()) else { return };
        if since.is_none() {
            self.learner.interrupt();
        }
        self.last = Some((time, *position_m));
        if self.learner.wants(time) {
            let before = self.learner.last();
            let velocity = before
                .and_then(|(then, Moved(from))| Some((position_m - from) / time.since(then)?.as_secs_f64()));
            let velocity =
                velocity.filter(|v| v.iter().all(|x| x.abs() < 1e6)).unwrap_or_else(Vector3::zeros);
            self.learner.observe(time, Moved(*position_m), velocity);
        }
    }

    fn predict(&self, time: Timestamp) -> Option<Vector3<f64>> {
        let (last, position_m) = self.last?;
        let ahead = ahead_s(last, time);
        let Some((learnt, Moved(then))) = self.learner.last().filter(|_| ahead > 0.0) else {
            return Some(position_m);
        };
        let whole = ahead + ahead_s(learnt, last);
        // The newest position is nearer to the truth than the way from the learnt one, by what was measured since.
        let way = self.learner.mean_rate(whole) * whole - (position_m - then);
        Some(position_m + way)
    }
}
