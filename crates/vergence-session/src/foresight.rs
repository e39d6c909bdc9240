//! Where the eyes will be while the runtime does not say: what has been seen of their motion goes on.

use nalgebra::Vector3;
use vergence_geom::{Rigid, log};
use vergence_inertial::predict::{Method, PosePredictor};
use vergence_sense::Velocity;
use vergence_stream::{Ahead, PoseHistory, Reach};
use vergence_time::Timestamp;

/// The history that a session's eyes are asked of: as far ahead as [`Reach`] says, by the adaptive predictor.
pub fn history() -> PoseHistory {
    // What lies behind is never asked for.
    let reach = Reach { readings: 2, ..Reach::default() };
    PoseHistory::foretold(&reach, Box::<Foresight>::default())
}

/// The adaptive predictor on poses alone: a runtime says where the eyes are, not how fast they turn.
struct Foresight {
    predictor: PosePredictor,
    last: Option<(Timestamp, Rigid)>,
}

impl Default for Foresight {
    fn default() -> Self {
        Self { predictor: PosePredictor::new(Method::Adaptive), last: None }
    }
}

impl std::fmt::Debug for Foresight {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Foresight").field("last", &self.last).finish_non_exhaustive()
    }
}

impl Ahead for Foresight {
    fn observe(&mut self, at: Timestamp, here: &Rigid, velocity: Option<&Velocity>) {
        let rate = match (velocity, self.last) {
            (Some(velocity), _) => here.rotation.inverse() * velocity.angular_rad_s,
            (None, Some((before, there))) => {
                let passed = at.since(before).map_or(f64::INFINITY, |passed| passed.as_secs_f64());
                log(&(there.rotation.inverse() * here.rotation)) / passed
            }
            (None, None) => Vector3::zeros(),
        };
        self.predictor.observe(at, here, &rate);
        self.last = Some((at, *here));
    }

    fn at(&self, instant: Timestamp) -> Option<Rigid> {
        self.predictor.predict(instant)
    }

    fn clear(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use vergence_inertial::motion::{Motion, Wander, WanderParams};
    use vergence_sense::Pose;

    use super::*;

    /// Mean errors of the pose some milliseconds after the last one of 90 a second: degrees and millimetres.
    fn errors(mut history: PoseHistory, ahead_ms: i64) -> (f64, f64) {
        let head = WanderParams { tilt_rad: 0.3, turn_rad: 0.6, way_m: 0.1, ..WanderParams::default() };
        let motion = Wander::new(3, &head).unwrap();
        let (mut turned, mut moved, mut count) = (0.0, 0.0, 0.0);
        for frame in 0..1800i64 {
            let at = Timestamp::from_nanos(frame * 11_111_111);
            history.push(at, Pose::tracked(motion.at(at).world_from_body), None);
            if frame < 180 {
                continue;
            }
            let then = at.saturating_add(vergence_time::Span::from_millis(ahead_ms));
            let found = history.at(then).pose.reference_from_device().unwrap();
            let truth = motion.at(then).world_from_body;
            turned += log(&(found.rotation.inverse() * truth.rotation)).norm().to_degrees();
            moved += (found.translation.vector - truth.translation.vector).norm() * 1e3;
            count += 1.0;
        }
        (turned / count, moved / count)
    }

    #[test]
    fn it_errs_less_than_the_velocity_does() {
        for ahead_ms in [11, 22, 44, 89] {
            let (ours, plain) =
                (errors(history(), ahead_ms), errors(PoseHistory::new(&Reach::default()), ahead_ms));
            println!("{ahead_ms} ms: {ours:.3?} deg, mm; the velocity {plain:.3?}");
            assert!(ours.0 < 0.7 * plain.0 && ours.1 < 0.7 * plain.1, "{ahead_ms} ms: {ours:?} {plain:?}");
        }
    }

    #[test]
    fn after_an_end_of_what_was_known_it_starts_anew() {
        let mut history = history();
        history.push(Timestamp::from_nanos(5), Pose::tracked(Rigid::translation(1.0, 0.0, 0.0)), None);
        history.clear();
        history.push(Timestamp::from_nanos(1), Pose::tracked(Rigid::translation(2.0, 0.0, 0.0)), None);
        let found = history.at(Timestamp::from_nanos(2)).pose.reference_from_device().unwrap();
        assert_eq!(found.translation.x, 2.0);
    }
}
