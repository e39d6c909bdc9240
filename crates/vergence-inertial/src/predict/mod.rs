//! Where a body will be: orientation and position some milliseconds ahead, from what was seen so far.
//!
//! All methods are causal, deterministic, read no clock and allocate nothing per sample. A method is chosen by
//! [`Method`]; which one is best, and by how much, is measured by [`judge`].

mod adaptive;
mod desp;
mod judge;
mod learner;
mod slope;

use nalgebra::{UnitQuaternion, Vector3};
use vergence_geom::Rigid;
use vergence_time::{Span, Timestamp};

pub use adaptive::{AdaptivePosition, AdaptiveRotation};
pub use desp::{DespPosition, DespRotation};
pub use judge::{AtHorizon, Judgement, Track, judge};
pub use learner::LearnerParams;
pub use slope::{SlopePosition, SlopeRotation};

/// Nobody is predicted further than this: at a longer horizon the pose at this one is given.
pub const MOST_AHEAD: Span = Span::from_millis(250);

/// After a pause of the observations longer than this, what was before does not count.
pub const LONGEST_GAP: Span = Span::from_millis(250);

/// Says where a body will be turned to.
pub trait PredictRotation {
    /// At `time` the body had this orientation and this rate (in its own axes, rad/s, bias removed). What is not
    /// finite or not later than what was seen before is ignored.
    fn observe(
        &mut self,
        time: Timestamp,
        world_from_body: &UnitQuaternion<f64>,
        rate_in_body_rad_s: &Vector3<f64>,
    );

    /// The orientation at `time`; that of the last observation for earlier times, at most [`MOST_AHEAD`] beyond it.
    /// `None` before the first observation.
    fn predict(&self, time: Timestamp) -> Option<UnitQuaternion<f64>>;
}

/// Says where a body will be.
pub trait PredictPosition {
    /// At `time` the body was here, m. What is not finite or not later than what was seen before is ignored.
    fn observe(&mut self, time: Timestamp, position_m: &Vector3<f64>);

    /// The position at `time`, m; that of the last observation for earlier times, at most [`MOST_AHEAD`] beyond it.
    /// `None` before the first observation.
    fn predict(&self, time: Timestamp) -> Option<Vector3<f64>>;
}

/// How to predict.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Method {
    /// It stays where it is.
    Hold,
    /// It goes on at the last rate.
    Constant,
    /// The rate goes on changing as over the last 28 ms, at half that slope: what is seen of a hand's acceleration does
    /// not last.
    Damped,
    /// Double exponential smoothing of the poses alone (J. LaViola, IPT/EGVE 2003), a = 0.7.
    Desp,
    /// The mean rate until then is a weighted sum of the rates of the last 70 ms, with weights that are learnt, for
    /// each horizon, from how the body moved in the last seconds. Noise and horizon lower them by themselves.
    Adaptive,
}

impl Method {
    /// All, from the simplest.
    pub const ALL: [Self; 5] = [Self::Hold, Self::Constant, Self::Damped, Self::Desp, Self::Adaptive];

    /// As on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Hold => "hold",
            Self::Constant => "constant",
            Self::Damped => "damped",
            Self::Desp => "desp",
            Self::Adaptive => "adaptive",
        }
    }

    /// The method of this [`Self::name`].
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|method| method.name() == name)
    }

    /// Ready for the first observation.
    pub fn rotation(self) -> Box<dyn PredictRotation + Send> {
        match self {
            Self::Hold => Box::new(SlopeRotation::new(0.0, None)),
            Self::Constant => Box::new(SlopeRotation::new(1.0, None)),
            Self::Damped => Box::new(SlopeRotation::new(1.0, Some(slope::DAMPED))),
            Self::Desp => Box::new(DespRotation::new(desp::SMOOTHING)),
            Self::Adaptive => Box::new(AdaptiveRotation::new(LearnerParams::ROTATION)),
        }
    }

    /// Ready for the first observation.
    pub fn position(self) -> Box<dyn PredictPosition + Send> {
        match self {
            Self::Hold => Box::new(SlopePosition::new(0.0, None)),
            Self::Constant => Box::new(SlopePosition::new(1.0, None)),
            Self::Damped => Box::new(SlopePosition::new(1.0, Some(slope::DAMPED))),
            Self::Desp => Box::new(DespPosition::new(desp::SMOOTHING)),
            Self::Adaptive => Box::new(AdaptivePosition::new(LearnerParams::POSITION)),
        }
    }
}

/// Predicts whole poses: orientation from the gyroscope, position from the positions.
pub struct PosePredictor {
    rotation: Box<dyn PredictRotation + Send>,
    position: Box<dyn PredictPosition + Send>,
}

impl PosePredictor {
    /// By `method`.
    pub fn new(method: Method) -> Self {
        Self { rotation: method.rotation(), position: method.position() }
    }

    /// At `time` the body had this pose and this rate (in its own axes, rad/s, bias removed).
    pub fn observe(&mut self, time: Timestamp, world_from_body: &Rigid, rate_in_body_rad_s: &Vector3<f64>) {
        self.rotation.observe(time, &world_from_body.rotation, rate_in_body_rad_s);
        self.position.observe(time, &world_from_body.translation.vector);
    }

    /// The pose at `time`; `None` before the first observation.
    pub fn predict(&self, time: Timestamp) -> Option<Rigid> {
        Some(Rigid::from_parts(self.position.predict(time)?.into(), self.rotation.predict(time)?))
    }
}

/// Seconds from `from` to `to`, held in 0..=[`MOST_AHEAD`].
fn ahead_s(from: Timestamp, to: Timestamp) -> f64 {
    let ahead = match to.since(from) {
        Some(ahead) => ahead,
        None if to > from => MOST_AHEAD,
        None => Span::ZERO,
    };
    ahead.clamp(Span::ZERO, MOST_AHEAD).as_secs_f64()
}

/// Whether an observation at `time` with these numbers may follow one at `last`; and if so, the seconds between, `None`
/// where there is none before or the gap is too long.
fn follows<'a>(
    last: Option<Timestamp>,
    time: Timestamp,
    numbers: impl IntoIterator<Item = &'a f64>,
) -> Option<Option<f64>> {
    if !numbers.into_iter().all(|x| x.is_finite()) || last.is_some_and(|last| time <= last) {
        return None;
    }
    let since = last.and_then(|last| time.since(last)).filter(|since| *since <= LONGEST_GAP);
    Some(since.map(Span::as_secs_f64))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dice::Dice;
    use crate::motion::{Motion, Wander, WanderParams};
    use vergence_geom::log;

    /// What every method owes.
    #[test]
    fn nonsense_and_gaps_leave_every_method_finite() {
        let bad = [f64::NAN, f64::INFINITY, -1e300, 1e300, 0.0, 1e-300, 35.0];
        for method in Method::ALL {
            let (mut rotation, mut position) = (method.rotation(), method.position());
            assert_eq!(
                (rotation.predict(Timestamp::default()), position.predict(Timestamp::default())),
                (None, None)
            );
            let dice = Dice::new(1, method as u64);
            let mut q = UnitQuaternion::identity();
            let mut time = 0i64;
            for k in 0..3000u64 {
                let step = match k % 97 {
                    0 => -5_000_000,
                    1 => 0,
                    2 => 3_600_000_000_000,
                    3 => i64::MAX / 4,
                    4 => 1,
                    _ => 3_500_000,
                };
                time = time.wrapping_add(step);
                let number = |i: u64| match dice.uniform(10 * k + i) {
                    u if u < 0.05 => bad[(u * 20.0 * 7.0) as usize],
                    u => 10.0 * (u - 0.5),
                };
                let v = Vector3::new(number(0), number(1), number(2));
                q = vergence_geom::advance(&q, &(v * 0.0035));
                rotation.observe(Timestamp::from_nanos(time), &q, &v);
                position.observe(Timestamp::from_nanos(time), &v);
                for ahead in [i64::MIN / 2, -1, 0, 1, 21_000_000, 100_000_000, i64::MAX / 2] {
                    let at = Timestamp::from_nanos(time).saturating_add(Span::from_nanos(ahead));
                    if let Some(q) = rotation.predict(at) {
                        assert!((q.quaternion().norm() - 1.0).abs() < 1e-9, "{method:?} {k}: {q:?}");
                    }
                    if let Some(p) = position.predict(at) {
                        assert!(p.iter().all(|x| x.is_finite()), "{method:?} {k}: {p:?}");
                    }
                }
            }
        }
    }

    /// Mean errors at 30 ms over 20 s of simulated motion: degrees and millimetres.
    fn errors(method: Method, noise_rad_s: f64, noise_m: f64) -> (f64, f64) {
        let params = WanderParams { frequency_hz: 1.0, ..WanderParams::default() };
        let motion = Wander::new(4, &params).unwrap();
        let (mut rotation, mut position) = (method.rotation(), method.position());
        let (mut turned, mut moved, mut count) = (0.0, 0.0, 0.0);
        let normal = |k: i64, axis: u64| Dice::new(9, axis).normal(k as u64);
        for k in 0..5000i64 {
            let time = Timestamp::from_nanos(k * 4_000_000);
            let at = motion.at(time);
            let noise = |first: u64| Vector3::from_fn(|i, _| normal(k, first + i as u64));
            rotation.observe(
                time,
                &at.world_from_body.rotation,
                &(at.rate_in_body_rad_s + noise(0) * noise_rad_s),
            );
            position.observe(time, &(at.world_from_body.translation.vector + noise(3) * noise_m));
            if k > 1000 {
                let then = time.saturating_add(Span::from_millis(30));
                let truth = motion.at(then).world_from_body;
                turned +=
                    log(&(rotation.predict(then).unwrap().inverse() * truth.rotation)).norm().to_degrees();
                moved += (position.predict(then).unwrap() - truth.translation.vector).norm() * 1e3;
                count += 1.0;
            }
        }
        (turned / count, moved / count)
    }

    #[test]
    fn the_adaptive_method_is_the_best_with_little_noise_and_with_much() {
        for (noise_rad_s, noise_m) in [(0.0, 0.0), (0.003, 1e-4), (0.1, 2e-3)] {
            let adaptive = errors(Method::Adaptive, noise_rad_s, noise_m);
            for method in [Method::Hold, Method::Constant, Method::Damped, Method::Desp] {
                let other = errors(method, noise_rad_s, noise_m);
                println!(
                    "{noise_rad_s} rad/s, {noise_m} m: {} {other:?}, adaptive {adaptive:?}",
                    method.name()
                );
                assert!(adaptive.0 < other.0 && adaptive.1 < other.1, "{method:?}: {adaptive:?} {other:?}");
            }
        }
    }

    #[test]
    fn a_constant_rate_is_predicted_exactly_by_all_that_know_rates() {
        let rate = Vector3::new(1.0, -2.0, 0.5);
        let velocity = Vector3::new(0.3, 0.0, -1.0);
        for method in [Method::Constant, Method::Damped, Method::Adaptive] {
            let (mut rotation, mut position) = (method.rotation(), method.position());
            let at = |t: f64| (vergence_geom::exp(&(rate * t)), velocity * t);
            for k in 0..500i64 {
                let (q, p) = at(k as f64 * 0.005);
                rotation.observe(Timestamp::from_nanos(k * 5_000_000), &q, &rate);
                position.observe(Timestamp::from_nanos(k * 5_000_000), &p);
            }
            let (q, p) = at(499.0 * 0.005 + 0.042);
            let then = Timestamp::from_nanos(499 * 5_000_000 + 42_000_000);
            assert!(log(&(rotation.predict(then).unwrap().inverse() * q)).norm() < 1e-9, "{method:?}");
            assert!((position.predict(then).unwrap() - p).norm() < 1e-9, "{method:?}");
        }
    }
}
