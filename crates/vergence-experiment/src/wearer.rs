//! The simulated person as the wearer of the simulated headset, or as the hand on the mouse.

use std::sync::{Arc, Mutex, PoisonError};

use nalgebra::{Point3, UnitQuaternion, Vector3};
use vergence_geom::Rigid;
use vergence_sense::Hand;
use vergence_session::{Controller, PoseProvider, Presence, Tracked};
use vergence_sim::person::{Geometry as Reach, Params, Person, Selection, Target as Seen};
use vergence_study::{Geometry, Instruction, Study, Trigger};
use vergence_time::{Span, Timestamp};

use crate::course::Goal;

/// Height of the eyes, metres.
const EYES_M: f64 = 1.6;
/// From a controller's aim to the tip that touches, metres ahead: the handle is below the fingers, the tip before them.
pub(crate) const TIP_M: f64 = 0.1;
/// Where the hand is held that points a ray, metres, on the floor's coordinates.
const POINTING_FROM_M: [f64; 3] = [0.2, 1.25, -0.3];
/// Who has pressed and sees the same target still tries again after this time.
const NOTICES: Span = Span::from_millis(250);
/// Who rests beside a target corrects that after the time of a dwell and this, seconds.
const RESTS_IN_VAIN_S: f64 = 1.0;
/// So many widths of a tunnel the eye is ahead of the hand.
const PIECE_OF_WIDTH: f64 = 2.0;
/// Spread of people's skill: standard deviation of its logarithm.
const SKILL_SPREAD: f64 = 0.15;

/// A person who takes part: the goals that they see, and what their hand does.
#[derive(Debug)]
pub(crate) struct Actor {
    person: Person,
    params: Params,
    reach: Reach,
    seed: u64,
    /// Sequences begun: each is a person of its own seed, so that none has to remember a whole session.
    begun: u64,
    goal: Option<Goal>,
    /// When it was seen last.
    seen: Timestamp,
    /// How far the eye is in the tunnel that the hand goes through, metres along x; the hand follows.
    ahead_m: f64,
}

impl Actor {
    /// The person of this seed and pseudonym, before the study. `flat`: the cursor moves on a screen.
    pub(crate) fn new(
        study: &Study,
        participant: &str,
        seed: u64,
        flat: bool,
    ) -> Result<Self, vergence_sim::Error> {
        let bytes = participant.bytes().chain(seed.to_le_bytes());
        let seed = u64::from_le_bytes(
            *blake3::hash(&bytes.collect::<Vec<u8>>()).as_bytes().first_chunk().unwrap_or(&[0; 8]),
        );
        let reach = match (study.geometry, flat) {
            (Geometry::Reciprocal | Geometry::Edge, _) => Reach::Line { axis: Vector3::x_axis() },
            (Geometry::Ray { .. }, _) => Reach::Directions,
            (_, true) => Reach::Plane { normal: Vector3::z_axis() },
            (_, false) => Reach::Volume,
        };
        // The sum of twelve uniform numbers is nearly normal.
        let uniform = |i: u64| (mixed(seed.wrapping_add(i)) >> 11) as f64 / (1u64 << 53) as f64;
        let normal = (0..12).map(uniform).sum::<f64>() - 6.0;
        let skill = Params::default().noise_s * (SKILL_SPREAD * normal.clamp(-2.0, 2.0)).exp();
        let start_m = match study.geometry {
            Geometry::Ray { distance, .. } => Vector3::new(0.0, 0.0, -distance),
            _ => Vector3::zeros(),
        };
        let selection =
            if study.trigger == Trigger::Dwell { Selection::Dwell } else { Params::default().selection };
        let params = Params { noise_s: skill, start_m, selection, ..Params::default() };
        Ok(Self {
            person: Person::new(seed, reach, &params)?,
            params,
            reach,
            seed,
            begun: 0,
            goal: None,
            seen: Timestamp::default(),
            ahead_m: 0.0,
        })
    }

    /// Sees where to go, at session time `at`.
    pub(crate) fn see(
        &mut self,
        at: Timestamp,
        study: &Study,
        goal: Option<&Goal>,
    ) -> Result<(), vergence_sim::Error> {
        let Some(goal) = goal else {
            self.goal = None;
            return Ok(());
        };
        let since = |then: Timestamp| at.since(then).unwrap_or(Span::ZERO);
        if self.goal.as_ref() == Some(goal) {
            let tries_again = match study.trigger {
                // Who rests beside the target notices that nothing happens.
                Trigger::Dwell => since(self.seen).as_secs_f64() > study.dwell_s + RESTS_IN_VAIN_S,
                _ => self.person.presses().last().is_some_and(|pressed| since(*pressed) > NOTICES),
            };
            let goes_on = study.geometry == Geometry::Steering && !goal.is_start && self.goes_on(at, goal);
            if !tries_again && !goes_on {
                return Ok(());
            }
        } else if goal.is_start {
            self.begun += 1;
            let told = study.instructions.get(goal.instruction);
            let start_m = self.person.at(at).position_m;
            let params = Params { start_m, margin: told.map_or(Params::BALANCED, margin), ..self.params };
            self.person = Person::new(mixed(self.seed ^ mixed(self.begun)), self.reach, &params)?;
        }
        if self.goal.as_ref() != Some(goal) {
            self.ahead_m = self.person.at(at).position_m.x;
            self.goes_on(at, goal);
        }
        self.goal = Some(*goal);
        self.seen = at;
        let mut centre_m = Vector3::from(goal.centre);
        let mut width = goal.width;
        match study.geometry {
            // Piece by piece through the tunnel, and beyond its end.
            Geometry::Steering if !goal.is_start => centre_m.x = self.ahead_m,
            Geometry::Edge => {
                centre_m.x *= 1.1;
                width = Some(0.1 * goal.centre[0].abs());
            }
            // Into the corner, not onto its tip.
            Geometry::Corner => {
                centre_m *= 1.1;
                width = Some(0.1 * goal.centre[0].abs());
            }
            _ => {}
        }
        self.person.see(at, Seen { centre_m, width })
    }

    /// In a tunnel the eye is ahead of the hand by so much that the hand, which goes astray by a share of its way, stays
    /// inside: a piece in proportion to the width. Hence the steering law. Whether there is a next piece to go.
    fn goes_on(&mut self, at: Timestamp, goal: &Goal) -> bool {
        let direction = goal.centre[0].signum();
        let piece_m = PIECE_OF_WIDTH * goal.width.unwrap_or(0.02);
        let hand_m = self.person.at(at).position_m.x;
        let is_near = direction * (self.ahead_m - hand_m) < 0.5 * piece_m;
        let is_through = direction * (self.ahead_m - goal.centre[0]) > 0.0;
        if is_near && !is_through {
            self.ahead_m += direction * piece_m;
        }
        is_near && !is_through
    }

    /// Where the cursor is, in task coordinates, and whether the button is down.
    pub(crate) fn at(&self, at: Timestamp) -> (Vector3<f64>, bool) {
        let hand = self.person.at(at);
        (hand.position_m, hand.is_pressed)
    }
}

/// How careful an instruction asks to be: by its metronome, or the words of its name.
fn margin(instruction: &Instruction) -> f64 {
    // Who hears a metronome keeps to it.
    if let Some(pace) = instruction.metronome {
        return match pace {
            ..0.95 => Params::FAST,
            0.95..=1.05 => Params::BALANCED,
            _ => Params::ACCURATE,
        };
    }
    let name = instruction.name.to_lowercase();
    let says = |words: &[&str]| words.iter().any(|word| name.contains(word));
    if says(&["fast", "speed", "quick"]) {
        Params::FAST
    } else if says(&["accura", "precis", "careful", "slow"]) {
        Params::ACCURATE
    } else {
        Params::BALANCED
    }
}

/// SplitMix64's mixing (Steele, Lea and Flood 2014).
fn mixed(value: u64) -> u64 {
    let value = value.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let value = (value ^ (value >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let value = (value ^ (value >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    value ^ (value >> 31)
}

/// Wears the simulated headset: stands, looks ahead, and moves the right hand as the person does.
#[derive(Clone)]
pub(crate) struct Wearer(Arc<Mutex<Worn>>);

struct Worn {
    actor: Actor,
    is_ray: bool,
    stage_from_task: Option<Rigid>,
    /// The instant for which the head was asked for last, on the motion's clock.
    asked: Timestamp,
    pictures: bool,
    away: Option<(Timestamp, Timestamp)>,
}

impl Wearer {
    pub(crate) fn new(
        actor: Actor,
        study: &Study,
        pictures: bool,
        away: Option<(Timestamp, Timestamp)>,
    ) -> Self {
        let is_ray = matches!(study.geometry, Geometry::Ray { .. });
        let worn = Worn { actor, is_ray, stage_from_task: None, asked: Timestamp::default(), pictures, away };
        Self(Arc::new(Mutex::new(worn)))
    }

    fn with<R>(&self, look: impl FnOnce(&mut Worn) -> R) -> R {
        look(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Shows where to go now, on a task that stands there.
    pub(crate) fn see(
        &self,
        study: &Study,
        goal: Option<&Goal>,
        stage_from_task: &Rigid,
    ) -> Result<(), vergence_sim::Error> {
        self.with(|worn| {
            worn.stage_from_task = Some(*stage_from_task);
            worn.actor.see(worn.asked, study, goal)
        })
    }
}

impl PoseProvider for Wearer {
    fn head(&self, at: Timestamp) -> Tracked {
        self.with(|worn| worn.asked = worn.asked.max(at));
        Tracked::Seen(Rigid::translation(0.0, EYES_M, 0.0))
    }

    fn controller(&self, hand: Hand, at: Timestamp) -> Controller {
        let resting = Rigid::translation(if hand == Hand::Left { -0.2 } else { 0.2 }, 1.2, -0.4);
        let still = Controller::idle(Tracked::Seen(resting), Tracked::Seen(resting));
        if hand == Hand::Left {
            return still;
        }
        self.with(|worn| {
            let Some(stage_from_task) = worn.stage_from_task else { return still };
            let (place, pressed) = worn.actor.at(at);
            let tip = stage_from_task * Point3::from(place);
            let aim = if worn.is_ray {
                let from = Vector3::from(POINTING_FROM_M);
                let ahead = tip.coords - from;
                let turn = UnitQuaternion::rotation_between(&-Vector3::z(), &ahead).unwrap_or_default();
                Rigid::from_parts(from.into(), turn)
            } else {
                let turn = stage_from_task.rotation;
                Rigid::from_parts((tip.coords + turn * Vector3::z() * TIP_M).into(), turn)
            };
            let trigger = if pressed { 1.0 } else { 0.0 };
            Controller { trigger, ..Controller::idle(Tracked::Seen(aim), Tracked::Seen(aim)) }
        })
    }

    fn presence(&self, at: Timestamp) -> Presence {
        let is_away = self.with(|worn| worn.away.is_some_and(|(from, to)| from <= at && at < to));
        if is_away { Presence::Away } else { Presence::Focused }
    }

    fn renders(&self, _at: Timestamp) -> bool {
        self.with(|worn| worn.pictures)
    }
}
