//! Study files: raw TOML → a checked study.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;
use vergence_config::{Angle, Duration, Length};

use crate::Error;
use crate::design::Order;
use crate::task::{Geometry, Plane};

/// A commented study file.
pub const TEMPLATE: &str = include_str!("../template.toml");
/// Most trials of one participant.
const MOST_TRIALS: usize = 1_000_000;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    study: RawStudy,
    task: RawTask,
    #[serde(default)]
    selection: RawSelection,
    #[serde(default)]
    factors: BTreeMap<String, toml::Spanned<Vec<String>>>,
    #[serde(default)]
    instructions: Vec<RawInstruction>,
    #[serde(default)]
    prediction: Option<RawPrediction>,
    #[serde(default)]
    order: RawOrder,
    trials: RawTrials,
    #[serde(default)]
    breaks: RawBreaks,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawStudy {
    name: String,
    #[serde(default)]
    seed: u64,
    participants: u32,
    #[serde(default)]
    sessions: Option<toml::Spanned<u32>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawTask {
    kind: Kind,
    #[serde(default)]
    targets: Option<toml::Spanned<u32>>,
    #[serde(default)]
    plane: Option<RawPlane>,
    #[serde(default)]
    distance: Option<toml::Spanned<Length>>,
    amplitudes: toml::Spanned<Vec<toml::Spanned<String>>>,
    #[serde(default)]
    widths: Option<toml::Spanned<Vec<toml::Spanned<String>>>>,
}

#[derive(Clone, Copy, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Kind {
    Ring,
    Reciprocal,
    Depth,
    Ray,
    Steering,
    Edge,
    Corner,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(
    untagged,
    expecting = "expected a plane: \"xy\", \"yz\", \"zx\", or angles as in { yaw = \"30 deg\", pitch = \"45 deg\" }"
)]
enum RawPlane {
    Named(NamedPlane),
    Turned(RawTurned),
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum NamedPlane {
    Xy,
    Yz,
    Zx,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawTurned {
    #[serde(default)]
    yaw: Option<Angle>,
    #[serde(default)]
    pitch: Option<Angle>,
}

impl RawPlane {
    fn resolved(self) -> Plane {
        match self {
            Self::Named(NamedPlane::Xy) => Plane::Xy,
            Self::Named(NamedPlane::Yz) => Plane::Yz,
            Self::Named(NamedPlane::Zx) => Plane::Zx,
            Self::Turned(RawTurned { yaw, pitch }) => {
                let radians = |angle: Option<Angle>| angle.map_or(0.0, Angle::radians);
                Plane::Turned { yaw_rad: radians(yaw), pitch_rad: radians(pitch) }
            }
        }
    }
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawSelection {
    #[serde(default)]
    by: Trigger,
    #[serde(default)]
    dwell: Option<toml::Spanned<Duration>>,
}

/// How a target is selected.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Trigger {
    /// A button.
    #[default]
    Trigger,
    /// Resting on it.
    Dwell,
    /// Touching it.
    Tap,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawInstruction {
    name: toml::Spanned<String>,
    text: String,
    #[serde(default)]
    metronome: Option<toml::Spanned<f64>>,
    #[serde(default)]
    band: Option<toml::Spanned<[f64; 2]>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawPrediction {
    a: toml::Spanned<Duration>,
    b: toml::Spanned<Duration>,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawOrder {
    #[serde(default)]
    instructions: Option<toml::Spanned<String>>,
    #[serde(default)]
    conditions: Option<toml::Spanned<String>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawTrials {
    #[serde(default)]
    practice: u32,
    per_condition: toml::Spanned<u32>,
    #[serde(default)]
    repetitions: Option<toml::Spanned<u32>>,
    #[serde(default)]
    repeat_above_error: Option<toml::Spanned<f64>>,
    #[serde(default = "once")]
    most_repeats: u32,
}

fn once() -> u32 {
    1
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawBreaks {
    #[serde(default)]
    between_blocks: Option<toml::Spanned<Duration>>,
}

/// A size of the task.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Size {
    /// Metres, or radians for rays.
    pub amplitude: f64,
    /// Metres, or radians for rays; none for edges.
    pub width: Option<f64>,
}

/// What people are told.
#[derive(Clone, Debug, PartialEq)]
pub struct Instruction {
    /// Its name in logs.
    pub name: String,
    /// As it is shown.
    pub text: String,
    /// Pace, share of the predicted movement time.
    pub metronome: Option<f64>,
    /// Accepted times, shares of the predicted movement time.
    pub band: Option<[f64; 2]>,
}

/// A checked study.
#[derive(Clone, Debug, PartialEq)]
pub struct Study {
    /// Its name.
    pub name: String,
    /// Behind every random choice.
    pub seed: u64,
    /// People planned.
    pub participants: u32,
    /// Sittings of each of them, each with all blocks.
    pub sessions: u32,
    /// The task.
    pub geometry: Geometry,
    /// From the viewer, metres.
    pub distance: f64,
    /// Amplitudes × widths.
    pub sizes: Vec<Size>,
    /// How targets are selected.
    pub trigger: Trigger,
    /// Rest for a dwell, seconds.
    pub dwell_s: f64,
    /// Other factors.
    pub factors: BTreeMap<String, Vec<String>>,
    /// At least one.
    pub instructions: Vec<Instruction>,
    /// Predicted movement time a + b ID: seconds, and seconds per bit.
    pub prediction: [f64; 2],
    /// Order of blocks.
    pub instruction_order: Order,
    /// Order of conditions within a block.
    pub condition_order: Order,
    /// Movements before those that count, per condition.
    pub practice: u32,
    /// Movements that count, per condition.
    pub per_condition: u32,
    /// How often each condition comes in a block.
    pub repetitions: u32,
    /// Share of misses above which a sequence is repeated.
    pub repeat_above_error: Option<f64>,
    /// How often.
    pub most_repeats: u32,
    /// Between blocks, seconds.
    pub break_s: f64,
}

impl Study {
    /// Reads a study file; `path` is for errors.
    ///
    /// # Errors
    /// File, line, column, and what was expected.
    pub fn parse(path: &Path, text: &str) -> Result<Self, Error> {
        let raw: Raw = vergence_config::parse(path, text)?;
        let wrong = |offset: usize, message: &str| -> Error {
            vergence_config::invalid_at(path, text, offset, message).into()
        };
        let sizes =
            |list: &toml::Spanned<Vec<toml::Spanned<String>>>, distance: f64| -> Result<Vec<f64>, Error> {
                if list.get_ref().is_empty() {
                    return Err(wrong(list.span().start, "expected at least one size, found none"));
                }
                list.get_ref()
                    .iter()
                    .map(|text| {
                        let place = text.span().start;
                        let value = size(raw.task.kind == Kind::Ray, distance, text.get_ref())
                            .map_err(|message| wrong(place, &message))?;
                        if value > 0.0 { Ok(value) } else { Err(wrong(place, "expected a size above zero")) }
                    })
                    .collect()
            };
        // Two alike would be one condition, analysed as one sequence of twice the length.
        let different = |list: &toml::Spanned<Vec<toml::Spanned<String>>>, sizes: &[f64]| {
            let again = (1..sizes.len()).find(|&i| sizes[..i].contains(&sizes[i]));
            again.and_then(|i| list.get_ref().get(i)).map_or(Ok(()), |text| {
                let message = format!("expected sizes that differ, found {} twice", text.get_ref());
                Err(wrong(text.span().start, &message))
            })
        };
        let seconds = |value: &Option<toml::Spanned<Duration>>, default: f64, least: f64| {
            let Some(value) = value else { return Ok(default) };
            let seconds = value.get_ref().seconds();
            if seconds.is_finite() && seconds >= least {
                return Ok(seconds);
            }
            let expected = if least > 0.0 { "above zero" } else { "of zero or more" };
            Err(wrong(value.span().start, &format!("expected a time {expected}, found {seconds} s")))
        };
        let distance = match &raw.task.distance {
            None => 0.6,
            Some(length) if length.get_ref().metres() > 0.0 => length.get_ref().metres(),
            Some(length) => {
                let message =
                    format!("expected a distance above zero, found {} m", length.get_ref().metres());
                return Err(wrong(length.span().start, &message));
            }
        };
        let amplitudes = sizes(&raw.task.amplitudes, distance)?;
        different(&raw.task.amplitudes, &amplitudes)?;
        let widths: Vec<Option<f64>> = match (&raw.task.widths, raw.task.kind) {
            (None, Kind::Edge | Kind::Corner) => vec![None],
            (Some(list), Kind::Edge | Kind::Corner) => {
                return Err(wrong(
                    list.span().start,
                    "expected no widths: a target at an edge or in a corner has none along the axis",
                ));
            }
            (Some(list), _) => {
                let widths = sizes(list, distance)?;
                different(list, &widths)?;
                widths.into_iter().map(Some).collect()
            }
            (None, _) => {
                return Err(wrong(raw.task.amplitudes.span().start, "expected widths beside the amplitudes"));
            }
        };
        let targets = raw.task.targets.as_ref().map_or(11, |targets| *targets.get_ref());
        if matches!(raw.task.kind, Kind::Ring | Kind::Ray)
            && (targets < 3 || targets.is_multiple_of(2) || targets > 999)
        {
            let place = raw.task.targets.as_ref().map_or(0, |targets| targets.span().start);
            return Err(wrong(
                place,
                &format!("expected an odd number of targets from 3 to 999, found {targets}"),
            ));
        }
        let plane = raw.task.plane.map_or(Plane::Xy, RawPlane::resolved);
        let geometry = match raw.task.kind {
            Kind::Ring => Geometry::Ring { targets, plane },
            Kind::Reciprocal => Geometry::Reciprocal,
            Kind::Depth => Geometry::Depth,
            Kind::Ray => Geometry::Ray { targets, distance },
            Kind::Steering => Geometry::Steering,
            Kind::Edge => Geometry::Edge,
            Kind::Corner => Geometry::Corner,
        };
        let mut instructions: Vec<Instruction> = Vec::new();
        for one in raw.instructions {
            let (name, place) = (one.name.get_ref(), one.name.span().start);
            if name.trim().is_empty() || instructions.iter().any(|other| other.name == *name) {
                let message = format!("expected a name that no other instruction has, found {name:?}");
                return Err(wrong(place, &message));
            }
            if let Some(pace) =
                one.metronome.as_ref().filter(|pace| !(10.0..=1000.0).contains(pace.get_ref()))
            {
                return Err(wrong(
                    pace.span().start,
                    "expected a metronome from 10 to 1000 (percent of the predicted time)",
                ));
            }
            if let Some(band) = one
                .band
                .as_ref()
                .filter(|band| band.get_ref()[0] < 0.0 || band.get_ref()[0] >= band.get_ref()[1])
            {
                return Err(wrong(band.span().start, "expected a band [least, most] in percent, ascending"));
            }
            instructions.push(Instruction {
                name: one.name.into_inner(),
                text: one.text,
                metronome: one.metronome.map(|pace| pace.into_inner() / 100.0),
                band: one.band.map(|band| band.into_inner().map(|percent| percent / 100.0)),
            });
        }
        if instructions.is_empty() {
            let text = "Be as fast and as accurate as you can.".to_owned();
            instructions.push(Instruction { name: "balanced".to_owned(), text, metronome: None, band: None });
        }
        let order =
            |text: Option<toml::Spanned<String>>, default: Order, levels: usize| -> Result<Order, Error> {
                let Some(text) = text else { return Ok(default) };
                let order: Order = text
                    .get_ref()
                    .parse()
                    .map_err(|error: Error| wrong(text.span().start, &error.to_string()))?;
                if order == Order::Permutation && levels > 8 {
                    let message = format!("expected at most 8 levels for all permutations, found {levels}");
                    return Err(wrong(text.span().start, &message));
                }
                Ok(order)
            };
        for (factor, levels) in &raw.factors {
            let place = levels.span().start;
            let levels = levels.get_ref();
            if crate::export::is_column(factor) {
                let message =
                    format!("expected a factor whose name no column of our tables has, found {factor:?}");
                return Err(wrong(place, &message));
            }
            if levels.is_empty() {
                return Err(wrong(place, &format!("expected at least one level of {factor}, found none")));
            }
            if let Some(i) = (1..levels.len()).find(|&i| levels[..i].contains(&levels[i])) {
                let message = format!("expected levels of {factor} that differ, found {:?} twice", levels[i]);
                return Err(wrong(place, &message));
            }
        }
        let cells = raw.factors.values().map(|levels| levels.get_ref().len()).product::<usize>();
        let repetitions = raw.trials.repetitions.as_ref().map_or(1, |times| *times.get_ref());
        if let Some(times) = raw.trials.repetitions.as_ref().filter(|_| repetitions == 0) {
            return Err(wrong(times.span().start, "expected at least one repetition, found 0"));
        }
        let prediction = match raw.prediction {
            None => [0.1, 0.2],
            Some(RawPrediction { a, b }) => {
                let place = b.span().start;
                let both = [seconds(&Some(a), 0.0, 0.0)?, seconds(&Some(b), 0.0, 0.0)?];
                if both == [0.0; 2] {
                    return Err(wrong(place, "expected a predicted time above zero, found a = b = 0 s"));
                }
                both
            }
        };
        let conditions = amplitudes.len() * widths.len() * cells;
        let per_condition = *raw.trials.per_condition.get_ref();
        let sessions = raw.study.sessions.as_ref().map_or(1, |sessions| *sessions.get_ref());
        if sessions == 0 {
            let place = raw.study.sessions.map_or(0, |sessions| sessions.span().start);
            return Err(wrong(place, "expected at least one session, found 0"));
        }
        let all = (conditions * instructions.len())
            .saturating_mul(sessions as usize)
            .saturating_mul((per_condition.saturating_add(raw.trials.practice)) as usize)
            .saturating_mul(repetitions as usize);
        if per_condition == 0 || all > MOST_TRIALS {
            let message = if per_condition == 0 {
                "expected at least one trial per condition that is no practice, found 0".to_owned()
            } else {
                format!("expected at most {MOST_TRIALS} trials in all, found {all}")
            };
            return Err(wrong(raw.trials.per_condition.span().start, &message));
        }
        if let Some(share) =
            raw.trials.repeat_above_error.as_ref().filter(|share| !(0.0..=1.0).contains(share.get_ref()))
        {
            return Err(wrong(share.span().start, "expected a share from 0 to 1"));
        }
        if raw.study.participants == 0 {
            return Err(wrong(text.find("participants").unwrap_or(0), "expected at least one participant"));
        }
        Ok(Self {
            name: raw.study.name,
            seed: raw.study.seed,
            participants: raw.study.participants,
            sessions,
            geometry,
            distance,
            sizes: amplitudes
                .iter()
                .flat_map(|&amplitude| widths.iter().map(move |&width| Size { amplitude, width }))
                .collect(),
            trigger: raw.selection.by,
            dwell_s: seconds(&raw.selection.dwell, 0.5, f64::MIN_POSITIVE)?,
            factors: raw.factors.into_iter().map(|(name, levels)| (name, levels.into_inner())).collect(),
            instruction_order: order(raw.order.instructions, Order::Williams, instructions.len())?,
            condition_order: order(raw.order.conditions, Order::Random, conditions)?,
            instructions,
            prediction,
            practice: raw.trials.practice,
            per_condition,
            repetitions,
            repeat_above_error: raw.trials.repeat_above_error.map(toml::Spanned::into_inner),
            most_repeats: raw.trials.most_repeats,
            break_s: seconds(&raw.breaks.between_blocks, 0.0, 0.0)?,
        })
    }
}

/// A size with its unit: of a ray an angle, in radians; of anything else a length, in metres, which may be given as the angle
/// under which it is seen from `distance`, its middle straight ahead.
fn size(of_ray: bool, distance: f64, text: &str) -> Result<f64, String> {
    #[derive(Deserialize)]
    struct Both<T> {
        v: T,
    }
    let document = format!("v = {:?}", text);
    let angle = vergence_config::parse::<Both<Angle>>("", &document).map(|both| both.v.radians());
    let value = match angle {
        _ if of_ray => angle,
        Ok(angle) if angle >= std::f64::consts::PI => {
            return Err("expected an angle below 180 degrees, or a length".to_owned());
        }
        Ok(angle) => return Ok(2.0 * distance * (0.5 * angle).tan()),
        Err(_) => vergence_config::parse::<Both<Length>>("", &document).map(|both| both.v.metres()),
    };
    value.map_err(|error| match error {
        vergence_config::Error::Invalid { message, .. } => message,
        other => other.to_string(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::PlannedBlock;
    use proptest::prelude::*;

    fn template() -> Study {
        Study::parse(Path::new("t.toml"), TEMPLATE).unwrap()
    }

    #[test]
    fn the_template_is_a_study() {
        let study = template();
        assert_eq!((study.conditions().len(), study.instructions.len(), study.balanced_after()), (12, 3, 6));
        assert!(study.warnings().is_empty(), "{:?}", study.warnings());
        let plan = study.plan("P07");
        assert_eq!(plan.blocks.iter().map(|block| block.trials.len()).sum::<usize>(), 3 * 12 * 15);
        assert_eq!(plan, study.plan("P07"));
        assert_ne!(plan.blocks[0].trials, study.plan("P08").blocks[0].trials);
        let firsts: Vec<usize> =
            (1..=6).map(|i| study.plan(&format!("P{i}")).blocks[0].instruction).collect();
        for instruction in 0..3 {
            assert_eq!(firsts.iter().filter(|first| **first == instruction).count(), 2, "{firsts:?}");
        }
        assert!((300.0..1200.0).contains(&study.session_s()), "{}", study.session_s());
    }

    #[test]
    fn sessions_have_all_blocks_in_other_orders() {
        let parse = |text: &str| Study::parse(Path::new("t.toml"), text).unwrap();
        let (one, two) = (template(), parse(&TEMPLATE.replace("# sessions = 2", "sessions = 2")));
        let (one, two) = (one.plan("P04"), two.plan("P04"));
        assert_eq!((one.blocks.len(), two.blocks.len()), (3, 6));
        // What was planned for one session is not changed by another one behind it.
        assert_eq!(one.blocks, two.blocks[..3]);
        let sessions: Vec<u32> = two.blocks.iter().map(|block| block.session).collect();
        assert_eq!(sessions, [0, 0, 0, 1, 1, 1]);
        let order =
            |blocks: &[PlannedBlock]| blocks.iter().map(|block| block.instruction).collect::<Vec<_>>();
        assert_ne!(order(&two.blocks[..3]), order(&two.blocks[3..]));
        assert_ne!(two.blocks[0].trials, two.blocks[3].trials);
    }

    #[test]
    fn orders_are_balanced_under_each_instruction() {
        let text = TEMPLATE
            .replace("conditions = \"random\"", "conditions = \"williams\"")
            .replace("[\"0.15 m\", \"0.25 m\", \"0.35 m\"]", "[\"0.15 m\", \"0.25 m\"]")
            .replace(", \"0.03 m\", \"0.04 m\"]", "]")
            .replace("# sessions = 2", "sessions = 2");
        let study = Study::parse(Path::new("t.toml"), &text).unwrap();
        assert_eq!((study.conditions().len(), study.balanced_after()), (4, 6 * 4));
        let mut places = BTreeMap::new();
        for number in 1..=study.balanced_after() {
            for block in study.plan(&format!("P{number:02}")).blocks {
                for (place, first) in block.trials.iter().step_by(15).enumerate() {
                    let cell = (block.session, block.instruction, place, first.condition.clone());
                    *places.entry(cell).or_insert(0) += 1;
                }
            }
        }
        // Each condition in each place equally often, in each session under each instruction.
        assert_eq!(places.len(), 2 * 3 * 4 * 4);
        assert!(places.values().all(|count| *count == 6), "{places:?}");
        assert_ne!(study.plan("P00").blocks, study.plan("P01").blocks);
    }

    #[test]
    fn sizes_may_be_the_angles_under_which_they_are_seen() {
        let text = TEMPLATE.replace("\"0.04 m\"]", "\"5 deg\"]");
        let study = Study::parse(Path::new("t.toml"), &text).unwrap();
        let widest = study.sizes.iter().filter_map(|size| size.width).fold(0.0, f64::max);
        assert!((widest - 2.0 * 0.6 * 2.5f64.to_radians().tan()).abs() < 1e-12, "{widest}");
        let wrong = Study::parse(Path::new("t.toml"), &text.replace("5 deg", "180 deg")).unwrap_err();
        assert!(wrong.to_string().contains("expected an angle below 180 degrees"), "{wrong}");
    }

    #[test]
    fn a_plane_has_any_direction() {
        let text = TEMPLATE.replace("plane = \"xy\"", "plane = { yaw = \"90 deg\", pitch = \"30 deg\" }");
        let study = Study::parse(Path::new("t.toml"), &text).unwrap();
        let Geometry::Ring { plane: Plane::Turned { yaw_rad, pitch_rad }, .. } = study.geometry else {
            panic!("{:?}", study.geometry)
        };
        assert!((yaw_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        assert!((pitch_rad - std::f64::consts::FRAC_PI_6).abs() < 1e-12);
    }

    #[test]
    fn mistakes_are_named_with_their_place() {
        let error = |from: &str, to: &str| {
            let text = TEMPLATE.replace(from, to);
            assert_ne!(text, TEMPLATE);
            Study::parse(Path::new("t.toml"), &text).unwrap_err().to_string()
        };
        let line = |what: &str| 1 + TEMPLATE[..TEMPLATE.find(what).unwrap()].matches('\n').count();
        assert!(
            error("targets = 15", "targets = 14")
                .starts_with(&format!("t.toml:{}:11: expected an odd", line("targets = 15")))
        );
        assert!(error("\"0.25 m\"", "\"0.25 s\"").contains("expected a length such as"));
        assert!(error("\"0.25 m\"", "\"-0.25 m\"").contains("above zero"));
        assert!(error("kind = \"ring\"", "kind = \"rings\"").contains("unknown variant"));
        assert!(error("seed = 1", "sead = 1").contains("unknown field `sead`"));
        assert!(error("\"williams\"", "\"latin\"").contains("fixed, williams, permutation, random"));
        assert!(error("conditions = \"random\"", "conditions = \"permutation\"").contains("at most 8"));
        assert!(
            error("per_condition = 15", "per_condition = 0").contains("at least one trial per condition")
        );
        assert!(error("# band = [75, 125]", "band = [125, 75]").contains("ascending"));
        assert!(error("kind = \"ring\"", "kind = \"edge\"").contains("expected no widths"));
        assert!(error("kind = \"ring\"", "kind = \"corner\"").contains("expected no widths"));
        let plane = error("plane = \"xy\"", "plane = \"yx\"");
        assert!(
            plane.starts_with(&format!("t.toml:{}:", line("plane = \"xy\"")))
                && plane.contains("expected a plane: \"xy\""),
            "{plane}"
        );
        assert!(error("plane = \"xy\"", "plane = { yaw = \"3 m\" }").contains("expected a plane"));
        assert!(error("# sessions = 2", "sessions = 0").contains("at least one session"));
        for (from, to, expected) in [
            ("dwell = \"500 ms\"", "dwell = \"-1 s\"", "expected a time above zero, found -1 s"),
            ("a = \"0.1 s\"", "a = \"-5 s\"", "expected a time of zero or more, found -5 s"),
            ("between_blocks = \"60 s\"", "between_blocks = \"-60 s\"", "found -60 s"),
            ("distance = \"0.6 m\"", "distance = \"-0.6 m\"", "expected a distance above zero"),
            (
                "name = \"fast\"",
                "name = \"balanced\"",
                "expected a name that no other instruction has, found \"balanced\"",
            ),
            ("repetitions = 1", "repetitions = 0", "at least one repetition"),
            (
                "[\"0.15 m\", \"0.25 m\"",
                "[\"0.15 m\", \"15 cm\"",
                "expected sizes that differ, found 15 cm twice",
            ),
            (
                "# [factors]\n# hand = [\"left\", \"right\"]",
                "[factors]\nhand = [\"left\", \"left\"]",
                "found \"left\" twice",
            ),
            (
                "# [factors]\n# hand = [\"left\", \"right\"]",
                "[factors]\nhand = []",
                "at least one level of hand",
            ),
            (
                "# [factors]\n# hand = [\"left\", \"right\"]",
                "[factors]\nwidth = [\"left\", \"right\"]",
                "whose name no column of our tables has, found \"width\"",
            ),
            (
                "a = \"0.1 s\"\nb = \"0.2 s\"",
                "a = \"0 s\"\nb = \"0 s\"",
                "expected a predicted time above zero",
            ),
        ] {
            let (found, first) = (error(from, to), from.lines().last().unwrap_or(from));
            let place = format!("t.toml:{}:", line(first));
            assert!(found.starts_with(&place) && found.contains(expected), "{place} {found}");
        }
        assert!(error("kind = \"ring\"", "kind = \"ray\"").contains("expected an angle"));
    }

    proptest! {
        #[test]
        fn damage_is_an_error_and_no_panic(at in 0usize..4000, byte in 1u8..127) {
            let mut text = TEMPLATE.as_bytes().to_vec();
            let at = at % text.len();
            text[at] = byte;
            if let Ok(text) = String::from_utf8(text)
                && let Ok(study) = Study::parse(Path::new("t"), &text) {
                    let _ = (study.plan("P1"), study.warnings(), study.session_s());
            }
        }
    }
}
