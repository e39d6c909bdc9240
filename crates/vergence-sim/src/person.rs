//! A person who points at targets: submovements with noise that grows with speed.
//!
//! Sources: noise, R. Schmidt et al., Psychological Review 86 (1979); submovements that take the least time together,
//! D. Meyer et al., Psychological Review 95 (1988); shape, T. Flash and N. Hogan, Journal of Neuroscience 5 (1985); a
//! second movement added to a running one, T. Flash and E. Henis, Journal of Cognitive Neuroscience 3 (1991).

use nalgebra::{UnitVector3, Vector3};
use vergence_inertial::Dice;
use vergence_time::{Span, Timestamp};

use crate::Error;
use crate::smooth::{across, later, least_jerk, turn_between};

/// Where the cursor can be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Geometry {
    /// On a line: 1D tasks.
    Line {
        /// Its direction.
        axis: UnitVector3<f64>,
    },
    /// In a plane: 2D tasks.
    Plane {
        /// Its normal.
        normal: UnitVector3<f64>,
    },
    /// Anywhere: 3D tasks.
    Volume,
    /// On a sphere around the viewer, who stands at the origin: rays. Widths are angles.
    Directions,
}

/// Where to point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Its centre, metres; for [`Geometry::Directions`] relative to the viewer, at any distance but 0.
    pub centre_m: Vector3<f64>,
    /// How wide it is along the movement, metres, for [`Geometry::Directions`] radians; `None` where it has no end
    /// (the edge of a screen).
    pub width: Option<f64>,
}

/// How the person selects.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Selection {
    /// Presses a button at the end of the movement, held this long.
    Press(Span),
    /// Stays, and corrects until the cursor is inside.
    Dwell,
}

/// The knobs of a person.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// **Skill.** Spread of a submovement's end per mean speed, seconds, 0.001 to 1. Small: both fast and accurate.
    /// Throughput is about 6.1 bits/s at 0.022, 4.6 at 0.036, 2.9 at 0.075 (see the table in the crate's documentation).
    pub noise_s: f64,
    /// **Speed against accuracy.** How many standard deviations of the last submovement's end fit into half of the
    /// target, 0.2 to 10. Small: fast, many misses. 1.3 misses one in five, 2.07 one in 25, 3 one in 370. Throughput
    /// hardly hangs on it.
    pub margin: f64,
    /// From the stimulus to the first movement, seconds, 0 to 10 (median). 0.05 where the next target is known
    /// before, as in tasks with a fixed order; about 0.25 where it is not.
    pub onset_s: f64,
    /// From the end of a submovement to the start of the next, seconds, 0 to 10 (median): seeing how far it is off,
    /// and planning.
    pub correction_s: f64,
    /// Shortest submovement, seconds, 0.001 to 10.
    pub shortest_s: f64,
    /// Spread of all these times: standard deviation of their logarithms, 0 to 1. 0: a person like clockwork.
    pub unevenness: f64,
    /// Spread of an end across the movement over that along it, 0 to 1.
    pub across: f64,
    /// Standard deviation of the hand's trembling (8 to 12 Hz) along each axis, metres, 0 to 0.1. Nobody hits what is
    /// smaller.
    pub tremor_m: f64,
    /// The same for [`Geometry::Directions`], radians, 0 to 0.1.
    pub tremor_rad: f64,
    /// How targets are selected.
    pub selection: Selection,
    /// Where the cursor is at first, metres.
    pub start_m: Vector3<f64>,
}

impl Default for Params {
    /// An able adult with a good pointing device: 4.6 bits/s, one miss in 25.
    fn default() -> Self {
        Self {
            noise_s: 0.036,
            margin: Self::BALANCED,
            onset_s: 0.05,
            correction_s: 0.3,
            shortest_s: 0.08,
            unevenness: 0.12,
            across: 0.5,
            tremor_m: 2e-4,
            tremor_rad: 3e-4,
            selection: Selection::Press(Span::from_millis(80)),
            start_m: Vector3::new(0.0, 0.0, 0.0),
        }
    }
}

impl Params {
    /// [`Params::margin`] of who was told to be fast.
    pub const FAST: f64 = 1.3;
    /// [`Params::margin`] of who was told to be both.
    pub const BALANCED: f64 = 2.07;
    /// [`Params::margin`] of who was told to be accurate.
    pub const ACCURATE: f64 = 3.0;

    fn check(&self) -> Result<(), Error> {
        let ranges: [(&'static str, f64, f64, f64, &'static str); 9] = [
            ("noise_s", self.noise_s, 0.001, 1.0, "0.001 to 1 s"),
            ("margin", self.margin, 0.2, 10.0, "0.2 to 10"),
            ("onset_s", self.onset_s, 0.0, 10.0, "0 to 10 s"),
            ("correction_s", self.correction_s, 0.0, 10.0, "0 to 10 s"),
            ("shortest_s", self.shortest_s, 0.001, 10.0, "0.001 to 10 s"),
            ("unevenness", self.unevenness, 0.0, 1.0, "0 to 1"),
            ("across", self.across, 0.0, 1.0, "0 to 1"),
            ("tremor_m", self.tremor_m, 0.0, 0.1, "0 to 0.1 m"),
            ("tremor_rad", self.tremor_rad, 0.0, 0.1, "0 to 0.1 rad"),
        ];
        crate::in_ranges(&ranges)?;
        near("start_m", &self.start_m)
    }
}

/// Nothing is farther.
const FAR_M: f64 = 1e6;

/// Refuses what is too far, or no number.
fn near(what: &'static str, place_m: &Vector3<f64>) -> Result<(), Error> {
    match place_m.iter().find(|x| !(-FAR_M..=FAR_M).contains(*x)) {
        Some(found) => Err(Error::Parameter { what, expected: "at most 1000 km", found: *found }),
        None => Ok(()),
    }
}

/// Submovements to one target, at most: enough for targets of a billionth of their distance.
const MOST: usize = 16;

/// Frequencies that a hand trembles with, Hz, and their shares of the variance.
const TREMOR: [(f64, f64); 3] = [(8.3, 0.3), (9.7, 0.4), (11.6, 0.3)];

/// What the hand does at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hand {
    /// Where the cursor is, metres; for [`Geometry::Directions`] at the distance of the target.
    pub position_m: Vector3<f64>,
    /// Whether the button is down.
    pub is_pressed: bool,
}

/// One smooth movement that is added to the others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Submovement {
    /// When it begins.
    pub begins: Timestamp,
    /// How long it takes, seconds; above 0.
    pub lasts_s: f64,
    /// By what it moves the cursor, metres; for [`Geometry::Directions`] a rotation vector, radians.
    pub moves: Vector3<f64>,
}

impl Submovement {
    /// When it has ended.
    pub fn ends(&self) -> Timestamp {
        later(self.begins, self.lasts_s)
    }

    /// How much of it is done, 0 to 1: the polynomial of least jerk.
    fn done(&self, time: Timestamp) -> f64 {
        let passed_s = time.since(self.begins).map_or(0.0, Span::as_secs_f64);
        least_jerk(passed_s / self.lasts_s)
    }
}

/// What a person plans next: how many submovements there will be in all, and how long this one takes, seconds.
///
/// With `ratio` = distance over wanted spread of the end, n submovements of one length T leave a spread of
/// distance · (k/T)ⁿ · cⁿ⁻¹, k the noise and c = √(2/π) the mean of the normal distribution's absolute value; that T is
/// solved for, and the n taken whose n T and n − 1 corrections take least time.
fn plan(ratio: f64, params: &Params) -> (usize, f64) {
    let c = std::f64::consts::FRAC_2_PI.sqrt();
    let mut best = (1, f64::INFINITY, f64::INFINITY);
    for n in 1..=MOST {
        let more = (n - 1) as f64;
        let each_s = params.noise_s * (ratio * c.powf(more)).powf(1.0 / n as f64);
        let each_s = each_s.max(params.shortest_s);
        let all_s = n as f64 * each_s + more * params.correction_s;
        if all_s < best.2 {
            best = (n, each_s, all_s);
        }
    }
    (best.0, best.1)
}

/// Somebody who points at what they are shown. Pure in the seed and the stimuli so far: [`Person::at`] may be asked
/// for any time in any order. What has been done before the last stimulus is not changed by it.
#[derive(Clone, Debug)]
pub struct Person {
    seed: u64,
    geometry: Geometry,
    params: Params,
    /// The cursor's place, or direction, before all submovements.
    origin: Vector3<f64>,
    /// Of [`Geometry::Directions`]: from when on the cursor is how far away, metres.
    distances: Vec<(Timestamp, f64)>,
    submovements: Vec<Submovement>,
    presses: Vec<Timestamp>,
    stimuli: Vec<(Timestamp, Target)>,
}

impl Person {
    /// A person who has seen nothing yet.
    ///
    /// # Errors
    /// Where a parameter is out of its range.
    pub fn new(seed: u64, geometry: Geometry, params: &Params) -> Result<Self, Error> {
        params.check()?;
        let (origin, distance_m) = match geometry {
            Geometry::Directions => {
                let ahead = -Vector3::z();
                let distance_m = params.start_m.norm();
                (params.start_m.try_normalize(1e-9).unwrap_or(ahead), distance_m.max(1e-9))
            }
            _ => (params.start_m, 0.0),
        };
        Ok(Self {
            seed,
            geometry,
            params: *params,
            origin,
            distances: vec![(Timestamp::from_nanos(i64::MIN), distance_m)],
            submovements: Vec::new(),
            presses: Vec::new(),
            stimuli: Vec::new(),
        })
    }

    /// Shows a target: from `at` (and [`Params::onset_s`]) on the person goes there. What the hand was about to do is
    /// dropped; a submovement that runs is finished, with the new one added to it.
    ///
    /// # Errors
    /// Where `at` is before the last stimulus, the target too far or its width negative, or not finite.
    pub fn see(&mut self, at: Timestamp, target: Target) -> Result<(), Error> {
        if let Some((latest, _)) = self.stimuli.last().filter(|(latest, _)| at < *latest) {
            return Err(Error::Order { latest_ns: latest.as_nanos(), found_ns: at.as_nanos() });
        }
        near("target's centre", &target.centre_m)?;
        if let Some(found) = target.width.filter(|width| !(0.0..=FAR_M).contains(width)) {
            return Err(Error::Parameter { what: "target's width", expected: "0 to 1000 km", found });
        }
        if self.geometry == Geometry::Directions {
            let found = target.centre_m.norm();
            if found < 1e-9 {
                let expected = "at least 1 nm from the viewer";
                return Err(Error::Parameter { what: "target's centre", expected, found });
            }
            self.distances.push((at, found));
        }
        let dice = Dice::new(self.seed, 16 + self.stimuli.len() as u64);
        self.stimuli.push((at, target));
        let onset = later(at, self.params.onset_s * self.uneven(dice, 0));
        self.submovements.retain(|submovement| submovement.begins < onset);
        self.presses.retain(|press| *press <= at);
        self.go(onset, &target, dice);
        Ok(())
    }

    fn uneven(&self, dice: Dice, index: u64) -> f64 {
        // Beyond three standard deviations nobody is.
        (self.params.unevenness * dice.normal(index).clamp(-3.0, 3.0)).exp()
    }

    /// Appends the submovements that lead to `target`, and the press.
    fn go(&mut self, onset: Timestamp, target: &Target, dice: Dice) {
        let mut begins = onset;
        let mut wanted = None;
        for step in 0..MOST as u64 {
            let aim = self.way(self.settled(), target.centre_m);
            let distance = aim.norm();
            let wanted = *wanted.get_or_insert_with(|| self.wanted_spread(target, distance));
            let (left, planned_s) = plan(distance / wanted.max(distance * 1e-9), &self.params);
            let index = 8 * (step + 1);
            let lasts_s = planned_s * self.uneven(dice, index);
            let spread = self.params.noise_s * distance / lasts_s;
            let submovement =
                Submovement { begins, lasts_s, moves: aim + self.miss(&aim, spread, dice, index + 1) };
            self.submovements.push(submovement);
            let ends = submovement.ends();
            begins = later(ends, self.params.correction_s * self.uneven(dice, index + 4));
            match self.params.selection {
                Selection::Press(_) if left == 1 || step + 1 == MOST as u64 => {
                    self.presses.push(ends);
                    return;
                }
                Selection::Dwell if left == 1 => {
                    let off = self.way(self.settled(), target.centre_m).norm();
                    // Who rests there stays inside while they tremble, where there is room for that.
                    let room = |width: f64| (0.5 * width - 3.0 * self.tremor()).max(0.25 * width);
                    if target.width.is_none_or(|width| off <= room(width)) {
                        return;
                    }
                }
                _ => {}
            }
        }
    }

    /// The standard deviation that the last submovement's end should have.
    fn wanted_spread(&self, target: &Target, distance: f64) -> f64 {
        // Without an end, any stop beyond the target's edge will do: a tenth of the way is aimed at.
        let whole = target.width.map_or(0.1 * distance, |width| 0.5 * width / self.params.margin);
        // Trembling takes its share, and leaves at least a quarter.
        (whole * whole - self.tremor().powi(2)).max(0.0).sqrt().max(0.25 * whole)
    }

    fn tremor(&self) -> f64 {
        if self.geometry == Geometry::Directions { self.params.tremor_rad } else { self.params.tremor_m }
    }

    /// From where the cursor is to where it should be, as far as the geometry lets it: metres, or a rotation vector.
    fn way(&self, from: Vector3<f64>, to_m: Vector3<f64>) -> Vector3<f64> {
        match self.geometry {
            Geometry::Directions => turn_between(&from, &to_m.normalize()),
            _ => self.held(to_m - from),
        }
    }

    /// The part of a displacement that the geometry allows.
    fn held(&self, displacement: Vector3<f64>) -> Vector3<f64> {
        match self.geometry {
            Geometry::Line { axis } => axis.into_inner() * axis.dot(&displacement),
            Geometry::Plane { normal } => displacement - normal.into_inner() * normal.dot(&displacement),
            Geometry::Volume | Geometry::Directions => displacement,
        }
    }

    /// By how much a movement along `aim` ends elsewhere.
    fn miss(&self, aim: &Vector3<f64>, spread: f64, dice: Dice, index: u64) -> Vector3<f64> {
        let Some(along) = aim.try_normalize(1e-300) else { return Vector3::zeros() };
        let [first, second] = across(&along);
        let sideways = self.params.across * spread;
        let mut miss = along * (spread * dice.normal(index));
        match self.geometry {
            // About the axis of the aim's rotation is along; about the direction itself nothing moves.
            Geometry::Directions => {
                let tilt = along.cross(&self.settled()).try_normalize(1e-12).unwrap_or(first);
                miss += tilt * (sideways * dice.normal(index + 1));
            }
            _ => {
                miss += first * (sideways * dice.normal(index + 1));
                miss += second * (sideways * dice.normal(index + 2));
            }
        }
        self.held(miss)
    }

    /// Where the cursor will be when all submovements are done: a place in metres, or a direction.
    fn settled(&self) -> Vector3<f64> {
        self.moved(|_| 1.0)
    }

    fn moved(&self, done: impl Fn(&Submovement) -> f64) -> Vector3<f64> {
        let begun = self.submovements.iter().map(|s| (s, done(s))).filter(|(_, done)| *done > 0.0);
        match self.geometry {
            Geometry::Directions => begun
                .fold(self.origin, |direction, (s, done)| vergence_geom::exp(&(s.moves * done)) * direction)
                .normalize(),
            _ => begun.fold(self.origin, |place, (s, done)| place + s.moves * done),
        }
    }

    /// Trembling of each axis at `time`.
    fn trembling(&self, time: Timestamp) -> Vector3<f64> {
        let t_s = time.as_nanos() as f64 * 1e-9;
        Vector3::from_fn(|axis, _| {
            let dice = Dice::new(self.seed, axis as u64);
            let wave = |(k, (hz, share)): (usize, &(f64, f64))| {
                let phase = std::f64::consts::TAU * (hz * t_s + dice.uniform(k as u64)).fract();
                (2.0 * share).sqrt() * phase.sin()
            };
            self.tremor() * TREMOR.iter().enumerate().map(wave).sum::<f64>()
        })
    }

    /// What the hand does at `time`, given the stimuli so far. Takes time in proportion to the stimuli.
    pub fn at(&self, time: Timestamp) -> Hand {
        let moved = self.moved(|submovement| submovement.done(time));
        let trembling = self.trembling(time);
        let position_m = match self.geometry {
            Geometry::Directions => {
                let direction = vergence_geom::exp(&(trembling - moved * moved.dot(&trembling))) * moved;
                let distance = self.distances.iter().rev().find(|(from, _)| *from <= time);
                direction * distance.map_or(1.0, |(_, metres)| *metres)
            }
            _ => moved + self.held(trembling),
        };
        let is_pressed = match self.params.selection {
            Selection::Press(held) => {
                let down = |press: &Timestamp| {
                    time.since(*press).is_some_and(|passed| passed >= Span::default() && passed < held)
                };
                self.presses.iter().any(down)
            }
            Selection::Dwell => false,
        };
        Hand { position_m, is_pressed }
    }

    /// When the button goes down, ascending, as far as the stimuli so far say; the last one may lie ahead, and the next
    /// stimulus may still forestall it. None with [`Selection::Dwell`].
    pub fn presses(&self) -> &[Timestamp] {
        &self.presses
    }

    /// What the movement is made of, ascending.
    pub fn submovements(&self) -> &[Submovement] {
        &self.submovements
    }

    /// The stimuli so far.
    pub fn stimuli(&self) -> &[(Timestamp, Target)] {
        &self.stimuli
    }
}
