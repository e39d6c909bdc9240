//! Eyes that look around, and a tracker that sees them: fixations, saccades, pursuit, blinks, noise.
//!
//! Saccades follow the main sequence (duration = 21 ms + 2.2 ms per degree; R. Carpenter, Movements of the Eyes, 1988) with
//! the profile of least jerk; what moves is followed with a gain below one and saccades that catch up.

use nalgebra::{Point3, UnitVector3, Vector3};
use vergence_inertial::Dice;
use vergence_sense::{Gaze, Sample};
use vergence_time::{Span, Timestamp};

use crate::Error;
use crate::smooth::{later, least_jerk, turn_between};

/// What there is to look at, from one time on. Directions are those of the head: x right, y up, −z ahead.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Look {
    /// Something that stays.
    At(UnitVector3<f64>),
    /// Something that turns about the head at a constant rate, from this direction on.
    Follow {
        /// Where it is when it appears.
        from: UnitVector3<f64>,
        /// About the direction of this vector, by its length, rad/s.
        rate_rad_s: Vector3<f64>,
    },
}

impl Look {
    fn direction(&self, since_s: f64) -> Vector3<f64> {
        match self {
            Self::At(direction) => direction.into_inner(),
            Self::Follow { from, rate_rad_s } => {
                vergence_geom::exp(&(rate_rad_s * since_s)) * from.into_inner()
            }
        }
    }
}

/// The knobs of eyes and tracker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// From a stimulus to the saccade, seconds, 0 to 5. People: 0.2.
    pub latency_s: f64,
    /// Wandering of a gaze that rests, radians (standard deviation), 0 to 0.1. People: 0.1 degrees.
    pub drift_rad: f64,
    /// Rate of the eye over that of what it follows, 0.5 to 1. People: 0.9.
    pub pursuit_gain: f64,
    /// What is followed is caught up with by a saccade when it is this far off, radians, 0.001 to 1.
    pub catch_up_rad: f64,
    /// Blinks per minute, 0 to 60. People: 15.
    pub blinks_per_min: f64,
    /// Length of a blink, seconds, 0 to 0.9. People: 0.15.
    pub blink_s: f64,
    /// The tracker's constant error, radians (standard deviation over seeds), 0 to 1. Head-worn: 1 degree.
    pub offset_rad: f64,
    /// The tracker's noise from sample to sample, radians, 0 to 1. Head-worn: 0.1 degrees.
    pub noise_rad: f64,
    /// Share of samples that the tracker loses besides blinks, 0 to 1.
    pub lost: f64,
    /// Samples per second, 1 to 10,000.
    pub rate_hz: f64,
    /// From capture to arrival, seconds, 0 to 1.
    pub transport_s: f64,
}

impl Default for Params {
    /// Healthy eyes behind a tracker in a headset, 120 samples per second.
    fn default() -> Self {
        Self {
            latency_s: 0.2,
            drift_rad: 0.1f64.to_radians(),
            pursuit_gain: 0.9,
            catch_up_rad: 1f64.to_radians(),
            blinks_per_min: 15.0,
            blink_s: 0.15,
            offset_rad: 1f64.to_radians(),
            noise_rad: 0.1f64.to_radians(),
            lost: 0.005,
            rate_hz: 120.0,
            transport_s: 0.01,
        }
    }
}

impl Params {
    fn check(&self) -> Result<(), Error> {
        let ranges: [(&'static str, f64, f64, f64, &'static str); 11] = [
            ("latency_s", self.latency_s, 0.0, 5.0, "0 to 5 s"),
            ("drift_rad", self.drift_rad, 0.0, 0.1, "0 to 0.1 rad"),
            ("pursuit_gain", self.pursuit_gain, 0.5, 1.0, "0.5 to 1"),
            ("catch_up_rad", self.catch_up_rad, 0.001, 1.0, "0.001 to 1 rad"),
            ("blinks_per_min", self.blinks_per_min, 0.0, 60.0, "0 to 60"),
            ("blink_s", self.blink_s, 0.0, 0.9, "0 to 0.9 s"),
            ("offset_rad", self.offset_rad, 0.0, 1.0, "0 to 1 rad"),
            ("noise_rad", self.noise_rad, 0.0, 1.0, "0 to 1 rad"),
            ("lost", self.lost, 0.0, 1.0, "0 to 1"),
            ("rate_hz", self.rate_hz, 1.0, 10_000.0, "1 to 10,000 Hz"),
            ("transport_s", self.transport_s, 0.0, 1.0, "0 to 1 s"),
        ];
        crate::in_ranges(&ranges)
    }
}

/// What the eyes do: the truth that a classifier is judged by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Rest on something.
    Fixation,
    /// Jump.
    Saccade,
    /// Follow something.
    Pursuit,
    /// Are shut.
    Blink,
}

/// A saccade.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Jump {
    begins: Timestamp,
    lasts_s: f64,
    /// The rotation, as a vector; done in full at the end.
    turns: Vector3<f64>,
}

/// The gaze between two jumps.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Stretch {
    /// From here on, until the next stretch: the jump, then what follows.
    jump: Jump,
    /// The gaze before the jump.
    before: Vector3<f64>,
    /// Rate of the eye during and after the jump, about the head, rad/s.
    rate_rad_s: Vector3<f64>,
}

/// Jumps in all, at most: what moves is followed no further.
const MOST: usize = 100_000;

/// Eyes and tracker. Pure in (scenario, seed, time).
#[derive(Clone, Debug)]
pub struct Eyes {
    seed: u64,
    params: Params,
    stretches: Vec<Stretch>,
}

impl Eyes {
    /// Eyes that look ahead, and from each given time on at what is given with it; the last thing for an hour at most where
    /// it moves.
    ///
    /// # Errors
    /// Where a parameter is out of its range, times do not ascend, or a rate is not finite or above 20 rad/s.
    pub fn new(seed: u64, looks: &[(Timestamp, Look)], params: &Params) -> Result<Self, Error> {
        params.check()?;
        let mut eyes = Self { seed, params: *params, stretches: Vec::new() };
        for (index, (appears, look)) in looks.iter().enumerate() {
            if let Some((before, _)) = index.checked_sub(1).map(|i| looks[i]).filter(|(t, _)| t >= appears) {
                return Err(Error::Order { latest_ns: before.as_nanos(), found_ns: appears.as_nanos() });
            }
            if let Look::Follow { rate_rad_s, .. } = look {
                let found = rate_rad_s.norm();
                if !(0.0..=20.0).contains(&found) {
                    return Err(Error::Parameter { what: "rate_rad_s", expected: "0 to 20 rad/s", found });
                }
            }
            let hour = appears.saturating_add(Span::from_secs_f64(3600.0).unwrap_or_default());
            let until = looks.get(index + 1).map_or(hour, |next| later(next.0, params.latency_s));
            eyes.look(*appears, look, until);
        }
        Ok(eyes)
    }

    /// Appends the jump to `look`, and those that catch up, until another look begins.
    fn look(&mut self, appears: Timestamp, look: &Look, until: Timestamp) {
        let mut begins = later(appears, self.params.latency_s);
        while begins < until && self.stretches.len() < MOST {
            let before = self.steady(begins);
            let since_s = |time: Timestamp| time.since(appears).map_or(0.0, Span::as_secs_f64);
            // Aimed at where it will be when the jump has ended; the jump's length hangs on that, weakly.
            let mut lasts_s = 0.03;
            let mut turns = Vector3::zeros();
            let rate_rad_s = match look {
                Look::At(_) => Vector3::zeros(),
                Look::Follow { rate_rad_s, .. } => rate_rad_s * self.params.pursuit_gain,
            };
            for _ in 0..3 {
                let aim = look.direction(since_s(begins) + lasts_s);
                // The eye already moves with it while it jumps.
                let carried = vergence_geom::exp(&(rate_rad_s * lasts_s)) * before;
                turns = turn_between(&carried, &aim);
                lasts_s = 0.021 + 0.0022 * turns.norm().to_degrees();
            }
            self.stretches.push(Stretch { jump: Jump { begins, lasts_s, turns }, before, rate_rad_s });
            let slip_rad_s = match look {
                Look::Follow { rate_rad_s: target, .. } => target.norm() * (1.0 - self.params.pursuit_gain),
                Look::At(_) => 0.0,
            };
            if slip_rad_s * 3600.0 < self.params.catch_up_rad {
                return;
            }
            begins = later(begins, lasts_s + self.params.catch_up_rad / slip_rad_s);
        }
    }

    /// The gaze without its wandering.
    fn steady(&self, time: Timestamp) -> Vector3<f64> {
        let next = self.stretches.partition_point(|stretch| stretch.jump.begins <= time);
        let Some(stretch) = next.checked_sub(1).map(|index| &self.stretches[index]) else {
            return -Vector3::z();
        };
        let passed_s = time.since(stretch.jump.begins).map_or(0.0, Span::as_secs_f64);
        let done = least_jerk(passed_s / stretch.jump.lasts_s);
        let carried = vergence_geom::exp(&(stretch.rate_rad_s * passed_s)) * stretch.before;
        // The jump turns with the pursuit that it is added to.
        let turns = vergence_geom::exp(&(stretch.rate_rad_s * (passed_s - stretch.jump.lasts_s)))
            * stretch.jump.turns;
        (vergence_geom::exp(&(turns * done)) * carried).normalize()
    }

    /// Where the eyes point, in the head's directions, also behind closed lids.
    pub fn direction(&self, time: Timestamp) -> UnitVector3<f64> {
        let gaze = self.steady(time);
        let t_s = time.as_nanos() as f64 * 1e-9;
        let wave = |axis: u64| {
            let dice = Dice::new(self.seed, 16 + axis);
            // Slow, of no period that anybody sees.
            [0.31, 0.83, 1.9]
                .iter()
                .zip(0..)
                .map(|(hz, k)| {
                    (2.0f64 / 3.0).sqrt()
                        * (std::f64::consts::TAU * (hz * t_s + dice.uniform(k)).fract()).sin()
                })
                .sum::<f64>()
        };
        let wander = Vector3::new(wave(0), wave(1), 0.0) * self.params.drift_rad;
        UnitVector3::new_normalize(vergence_geom::exp(&wander) * gaze)
    }

    /// What the eyes do.
    pub fn phase(&self, time: Timestamp) -> Phase {
        if self.blinks(time) {
            return Phase::Blink;
        }
        let next = self.stretches.partition_point(|stretch| stretch.jump.begins <= time);
        let Some(stretch) = next.checked_sub(1).map(|index| &self.stretches[index]) else {
            return Phase::Fixation;
        };
        let passed_s = time.since(stretch.jump.begins).map_or(0.0, Span::as_secs_f64);
        if passed_s < stretch.jump.lasts_s {
            Phase::Saccade
        } else if stretch.rate_rad_s.norm() > 0.0 {
            Phase::Pursuit
        } else {
            Phase::Fixation
        }
    }

    fn blinks(&self, time: Timestamp) -> bool {
        if self.params.blinks_per_min == 0.0 {
            return false;
        }
        // One in each slot, anywhere in it.
        let slot_s = 60.0 / self.params.blinks_per_min;
        let t_s = time.as_nanos() as f64 * 1e-9;
        let slot = (t_s / slot_s).floor();
        let from_s = Dice::new(self.seed, 1).uniform(slot as i64 as u64) * (slot_s - self.params.blink_s);
        let in_slot_s = t_s - slot * slot_s;
        (from_s..from_s + self.params.blink_s).contains(&in_slot_s)
    }

    /// What the tracker says in its sample number `index`, counted from time 0, in the head's directions with the point between
    /// the eyes as origin; `None` in blinks, and where it lost them.
    pub fn sample(&self, index: u64) -> Sample<Option<Gaze>> {
        let captured = later(Timestamp::from_nanos(0), index as f64 / self.params.rate_hz);
        let arrived = later(captured, self.params.transport_s);
        let [offsets, noise, luck] = [2, 3, 4].map(|stream| Dice::new(self.seed, stream));
        let is_lost = self.blinks(captured) || luck.uniform(index) < self.params.lost;
        let error = |axis: u64| {
            self.params.offset_rad * offsets.normal(axis)
                + self.params.noise_rad * noise.normal(2 * index + axis)
        };
        let value = (!is_lost).then(|| {
            let error = vergence_geom::exp(&Vector3::new(error(0), error(1), 0.0));
            Gaze {
                origin: Point3::origin(),
                direction: UnitVector3::new_normalize(error * self.direction(captured).into_inner()),
            }
        });
        Sample { captured, arrived, value }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn way(x_deg: f64, y_deg: f64) -> UnitVector3<f64> {
        let (x, y) = (x_deg.to_radians().tan(), y_deg.to_radians().tan());
        UnitVector3::new_normalize(Vector3::new(x, y, -1.0))
    }

    fn at_ms(ms: i64) -> Timestamp {
        Timestamp::from_nanos(ms * 1_000_000)
    }

    fn exact() -> Params {
        Params {
            drift_rad: 0.0,
            offset_rad: 0.0,
            noise_rad: 0.0,
            lost: 0.0,
            blinks_per_min: 0.0,
            ..Params::default()
        }
    }

    #[test]
    fn a_saccade_has_the_length_of_its_width_and_ends_on_its_goal() {
        let eyes = Eyes::new(1, &[(at_ms(0), Look::At(way(10.0, 0.0)))], &exact()).unwrap();
        let phases: Vec<Phase> = (0..600).map(|ms| eyes.phase(at_ms(ms))).collect();
        // 21 ms + 2.2 ms a degree, after 200 ms of latency.
        assert_eq!(phases.iter().filter(|phase| **phase == Phase::Saccade).count(), 43);
        assert_eq!(
            (phases[199], phases[200], phases[250]),
            (Phase::Fixation, Phase::Saccade, Phase::Fixation)
        );
        assert!((eyes.direction(at_ms(300)).into_inner() - way(10.0, 0.0).into_inner()).norm() < 1e-12);
        assert_eq!(eyes.direction(at_ms(100)).into_inner(), -Vector3::z());
    }

    #[test]
    fn what_moves_is_followed_within_the_slip_and_without_a_jump_of_the_model() {
        let rate_rad_s = Vector3::y() * 0.3;
        let look = Look::Follow { from: way(-20.0, 0.0), rate_rad_s };
        let eyes = Eyes::new(1, &[(at_ms(0), look)], &exact()).unwrap();
        for ms in 300..3000 {
            let off = eyes.direction(at_ms(ms)).angle(&look.direction(f64::from(ms as i32) * 1e-3));
            assert!(off < 1.05f64.to_radians(), "{ms} ms: {} deg", off.to_degrees());
            // 700 deg/s is what a saccade may reach.
            let step = eyes.direction(at_ms(ms)).angle(&eyes.direction(at_ms(ms + 1)));
            assert!(step < 0.7f64.to_radians(), "{ms} ms: {} deg", step.to_degrees());
        }
        let pursued = (300..3000).filter(|ms| eyes.phase(at_ms(*ms)) == Phase::Pursuit).count();
        assert!(pursued > 2200, "{pursued}");
    }

    #[test]
    fn blinks_and_losses_have_their_share_and_noise_its_size() {
        let params = Params { lost: 0.01, drift_rad: 0.0, offset_rad: 0.0, ..Params::default() };
        let eyes = Eyes::new(5, &[], &params).unwrap();
        let samples: Vec<_> = (0..120 * 600).map(|k| eyes.sample(k)).collect();
        let seen: Vec<Gaze> = samples.iter().filter_map(|sample| sample.value).collect();
        let lost = 1.0 - seen.len() as f64 / samples.len() as f64;
        // 15 blinks of 0.15 s a minute, and one in a hundred of the rest.
        assert!((lost - (0.0375 + 0.9625 * 0.01)).abs() < 0.002, "{lost}");
        let square =
            seen.iter().map(|gaze| (gaze.direction.x.powi(2) + gaze.direction.y.powi(2)) / 2.0).sum::<f64>();
        let noise = (square / seen.len() as f64).sqrt().to_degrees();
        assert!((noise - 0.1).abs() < 0.002, "{noise}");
        assert!(samples.iter().all(|s| s.arrived.since(s.captured) == Some(Span::from_millis(10))));
    }

    #[test]
    fn pure_in_seed_and_time_and_nonsense_is_refused() {
        let looks = [(at_ms(0), Look::At(way(10.0, 5.0))), (at_ms(700), Look::At(way(-10.0, 5.0)))];
        let eyes = |seed| Eyes::new(seed, &looks, &Params::default()).unwrap();
        assert_eq!(eyes(3).sample(100), eyes(3).sample(100));
        assert_ne!(eyes(3).sample(100), eyes(4).sample(100));
        assert!(Eyes::new(1, &[looks[1], looks[0]], &Params::default()).is_err());
        assert!(Eyes::new(1, &looks, &Params { noise_rad: f64::NAN, ..Params::default() }).is_err());
        let fast = Look::Follow { from: way(0.0, 0.0), rate_rad_s: Vector3::y() * 1e9 };
        assert!(Eyes::new(1, &[(at_ms(0), fast)], &Params::default()).is_err());
        // Behind the head, and after a look at what is opposite.
        let behind = [(at_ms(0), Look::At(UnitVector3::new_normalize(Vector3::z())))];
        let eyes = Eyes::new(1, &behind, &exact()).unwrap();
        assert!((eyes.direction(at_ms(5000)).into_inner() - Vector3::z()).norm() < 1e-9);
    }
}
