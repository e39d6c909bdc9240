//! Study files: raw TOML → a checked study → the plan of one participant.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;
use vergence_config::{Angle, Duration, Length};

use crate::Error;
use crate::convention::Difficulty;
use crate::design::{Order, mixed, number_of, shuffled};
use crate::measure::fitts::difficulty;
use crate::task::{Geometry, Plane, Target, layout};

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
    factors: BTreeMap<String, Vec<String>>,
    #[serde(default)]
    instructions: Vec<RawInstruction>,
    #[serde(default)]
    prediction: RawPrediction,
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
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawTask {
    kind: Kind,
    #[serde(default)]
    targets: Option<toml::Spanned<u32>>,
    #[serde(default)]
    plane: RawPlane,
    #[serde(default)]
    distance: Option<Length>,
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
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
enum RawPlane {
    #[default]
    Xy,
    Yz,
    Zx,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawSelection {
    #[serde(default)]
    by: Trigger,
    #[serde(default)]
    dwell: Option<Duration>,
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
    name: String,
    text: String,
    #[serde(default)]
    metronome: Option<toml::Spanned<f64>>,
    #[serde(default)]
    band: Option<toml::Spanned<[f64; 2]>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawPrediction {
    a: Duration,
    b: Duration,
}

impl Default for RawPrediction {
    fn default() -> Self {
        Self { a: Duration::new(0.1), b: Duration::new(0.2) }
    }
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
    #[serde(default = "once")]
    repetitions: u32,
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
    between_blocks: Option<Duration>,
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

/// One movement to come.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedTrial {
    /// Name of the condition.
    pub condition: String,
    /// Which size.
    pub size: Size,
    /// Levels of other factors.
    pub factors: BTreeMap<String, String>,
    /// Not analysed.
    pub practice: bool,
    /// Place in its sequence.
    pub index: u32,
    /// Where it comes from and where it goes.
    pub from: Target,
    /// As above.
    pub to: Target,
    /// Predicted movement time, seconds.
    pub predicted_s: f64,
}

/// The movements under one instruction.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedBlock {
    /// Place in [`Study::instructions`].
    pub instruction: usize,
    /// In order.
    pub trials: Vec<PlannedTrial>,
}

/// Everything one participant will do.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Pseudonym.
    pub participant: String,
    /// In order.
    pub blocks: Vec<PlannedBlock>,
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
        let sizes = |list: &toml::Spanned<Vec<toml::Spanned<String>>>| -> Result<Vec<f64>, Error> {
            if list.get_ref().is_empty() {
                return Err(wrong(list.span().start, "expected at least one size, found none"));
            }
            list.get_ref()
                .iter()
                .map(|text| {
                    let place = text.span().start;
                    let value = size(raw.task.kind == Kind::Ray, text.get_ref())
                        .map_err(|message| wrong(place, &message))?;
                    if value > 0.0 { Ok(value) } else { Err(wrong(place, "expected a size above zero")) }
                })
                .collect()
        };
        let amplitudes = sizes(&raw.task.amplitudes)?;
        let widths: Vec<Option<f64>> = match (&raw.task.widths, raw.task.kind) {
            (None, Kind::Edge) => vec![None],
            (Some(list), Kind::Edge) => {
                return Err(wrong(
                    list.span().start,
                    "expected no widths: a target at the edge has none along the axis",
                ));
            }
            (Some(list), _) => sizes(list)?.into_iter().map(Some).collect(),
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
        let distance = raw.task.distance.map_or(0.6, Length::metres);
        let plane = match raw.task.plane {
            RawPlane::Xy => Plane::Xy,
            RawPlane::Yz => Plane::Yz,
            RawPlane::Zx => Plane::Zx,
        };
        let geometry = match raw.task.kind {
            Kind::Ring => Geometry::Ring { targets, plane },
            Kind::Reciprocal => Geometry::Reciprocal,
            Kind::Depth => Geometry::Depth,
            Kind::Ray => Geometry::Ray { targets, distance },
            Kind::Steering => Geometry::Steering,
            Kind::Edge => Geometry::Edge,
        };
        let mut instructions = Vec::new();
        for one in raw.instructions {
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
                name: one.name,
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
        let cells = raw.factors.values().map(Vec::len).product::<usize>();
        if cells == 0 {
            return Err(wrong(
                text.find("[factors]").unwrap_or(0),
                "expected at least one level of each factor",
            ));
        }
        let conditions = amplitudes.len() * widths.len() * cells;
        let per_condition = *raw.trials.per_condition.get_ref();
        let all = (conditions * instructions.len())
            .saturating_mul((per_condition.saturating_add(raw.trials.practice)) as usize)
            .saturating_mul(raw.trials.repetitions as usize);
        if per_condition == 0 || all > MOST_TRIALS {
            let message = format!("expected from 1 to {MOST_TRIALS} trials in all, found {all}");
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
            geometry,
            distance,
            sizes: amplitudes
                .iter()
                .flat_map(|&amplitude| widths.iter().map(move |&width| Size { amplitude, width }))
                .collect(),
            trigger: raw.selection.by,
            dwell_s: raw.selection.dwell.map_or(0.5, Duration::seconds),
            factors: raw.factors,
            instruction_order: order(raw.order.instructions, Order::Williams, instructions.len())?,
            condition_order: order(raw.order.conditions, Order::Random, conditions)?,
            instructions,
            prediction: [raw.prediction.a.seconds(), raw.prediction.b.seconds()],
            practice: raw.trials.practice,
            per_condition,
            repetitions: raw.trials.repetitions.max(1),
            repeat_above_error: raw.trials.repeat_above_error.map(toml::Spanned::into_inner),
            most_repeats: raw.trials.most_repeats,
            break_s: raw.breaks.between_blocks.map_or(0.0, Duration::seconds),
        })
    }

    /// Sizes × levels of the other factors.
    pub fn conditions(&self) -> Vec<(Size, BTreeMap<String, String>)> {
        let mut cells: Vec<BTreeMap<String, String>> = vec![BTreeMap::new()];
        for (name, levels) in &self.factors {
            cells = cells
                .into_iter()
                .flat_map(|cell| {
                    levels.iter().map(move |level| {
                        let mut cell = cell.clone();
                        cell.insert(name.clone(), level.clone());
                        cell
                    })
                })
                .collect();
        }
        self.sizes.iter().flat_map(|size| cells.iter().map(move |cell| (*size, cell.clone()))).collect()
    }

    /// Predicted movement time of a size, seconds.
    pub fn predicted_s(&self, size: Size) -> f64 {
        let bits = size
            .width
            .and_then(|width| difficulty(Difficulty::Shannon, size.amplitude, width))
            .unwrap_or(1.0);
        self.prediction[0] + self.prediction[1] * bits
    }

    /// After how many participants the orders are balanced.
    pub fn balanced_after(&self) -> usize {
        let a = self.instruction_order.rows(self.instructions.len());
        let b = self.condition_order.rows(self.conditions().len());
        let gcd = |mut a: usize, mut b: usize| {
            while b > 0 {
                (a, b) = (b, a % b);
            }
            a
        };
        a / gcd(a, b).max(1) * b
    }

    /// What `pseudonym` will do: the same each time.
    pub fn plan(&self, pseudonym: &str) -> Plan {
        let number = number_of(pseudonym);
        let conditions = self.conditions();
        let blocks = self.instruction_order.of(self.instructions.len(), number, self.seed);
        let blocks = blocks.into_iter().enumerate().map(|(place, instruction)| {
            let mut trials = Vec::new();
            for repetition in 0..self.repetitions {
                let round = place as u64 * u64::from(self.repetitions) + u64::from(repetition);
                let order = match self.condition_order {
                    // A new shuffle each time: people must not learn it.
                    Order::Random => {
                        shuffled(conditions.len(), mixed(self.seed ^ mixed(number ^ mixed(round + 1))))
                    }
                    other => other.of(conditions.len(), number + round, self.seed),
                };
                for index in order {
                    self.sequence(&conditions[index], &mut trials);
                }
            }
            PlannedBlock { instruction, trials }
        });
        Plan { participant: pseudonym.to_owned(), blocks: blocks.collect() }
    }

    /// Appends one sequence: practice, then what counts, around the layout as often as needed.
    fn sequence(&self, (size, factors): &(Size, BTreeMap<String, String>), trials: &mut Vec<PlannedTrial>) {
        let targets = layout(self.geometry, size.amplitude, size.width.unwrap_or(0.0));
        let round = targets.len() - 1;
        let unit = if matches!(self.geometry, Geometry::Ray { .. }) { "rad" } else { "m" };
        let mut parts: Vec<String> = factors.values().cloned().collect();
        let rounded = |value: f64| (value * 1e6).round() / 1e6;
        parts.push(format!("A{}{unit}", rounded(size.amplitude)));
        parts.extend(size.width.map(|width| format!("W{}{unit}", rounded(width))));
        let condition = parts.join("-");
        for index in 0..self.practice + self.per_condition {
            trials.push(PlannedTrial {
                condition: condition.clone(),
                size: *size,
                factors: factors.clone(),
                practice: index < self.practice,
                index,
                from: targets[index as usize % round],
                to: targets[index as usize % round + 1],
                predicted_s: self.predicted_s(*size),
            });
        }
    }

    /// Predicted length of one session, seconds: movements as predicted (times the metronome where there is one), half a
    /// second between sequences, breaks. Repeats are not counted.
    pub fn session_s(&self) -> f64 {
        let each = f64::from((self.practice + self.per_condition) * self.repetitions);
        let dwell = if self.trigger == Trigger::Dwell { self.dwell_s } else { 0.0 };
        let cells = (self.conditions().len() / self.sizes.len().max(1)) as f64;
        let block = |pace: f64| {
            self.sizes
                .iter()
                .map(|size| cells * (0.5 + each * (pace * self.predicted_s(*size) + dwell)))
                .sum::<f64>()
        };
        let blocks: f64 = self.instructions.iter().map(|one| block(one.metronome.unwrap_or(1.0))).sum();
        blocks + self.break_s * (self.instructions.len() - 1) as f64
    }

    /// What is allowed but doubtful, in sentences.
    pub fn warnings(&self) -> Vec<String> {
        let mut found = Vec::new();
        let balanced = self.balanced_after();
        if !(self.participants as usize).is_multiple_of(balanced) {
            found.push(format!(
                "{} participants are no multiple of {balanced}: orders are not balanced",
                self.participants
            ));
        }
        if self.per_condition < 10 {
            found.push(format!("{} trials per condition: effective widths of fewer than 10 ends are uncertain by 25 % and more", self.per_condition));
        }
        if let Geometry::Ring { targets, .. } | Geometry::Ray { targets, .. } = self.geometry
            && !self.per_condition.is_multiple_of(targets)
        {
            found.push(format!(
                "{} trials are no whole rounds of {targets} targets: directions come unequally often",
                self.per_condition
            ));
        }
        for size in &self.sizes {
            if size.width.is_some_and(|width| width > size.amplitude) {
                found.push(format!(
                    "width {} is larger than amplitude {}: targets overlap",
                    size.width.unwrap_or(0.0),
                    size.amplitude
                ));
            }
        }
        found
    }
}

/// A length or an angle with its unit, in metres or radians.
fn size(angle: bool, text: &str) -> Result<f64, String> {
    #[derive(Deserialize)]
    struct Both<T> {
        v: T,
    }
    let document = format!("v = {:?}", text);
    let value = if angle {
        vergence_config::parse::<Both<Angle>>("", &document).map(|both| both.v.radians())
    } else {
        vergence_config::parse::<Both<Length>>("", &document).map(|both| both.v.metres())
    };
    value.map_err(|error| match error {
        vergence_config::Error::Invalid { message, .. } => message,
        other => other.to_string(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
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
        assert!(error("per_condition = 15", "per_condition = 0").contains("from 1 to"));
        assert!(error("# band = [75, 125]", "band = [125, 75]").contains("ascending"));
        assert!(error("kind = \"ring\"", "kind = \"edge\"").contains("expected no widths"));
        assert!(error("kind = \"ring\"", "kind = \"ray\"").contains("expected an angle"));
    }

    proptest! {
        #[test]
        fn damage_is_an_error_and_no_panic(at in 0usize..2500, byte in 1u8..127) {
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
