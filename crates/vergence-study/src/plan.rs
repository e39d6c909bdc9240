//! From a checked study to the plan of one participant, and what that plan means: its length, and what is doubtful in it.

use std::collections::BTreeMap;

use crate::convention::Difficulty;
use crate::design::{Order, mixed, number_of, shuffled};
use crate::measure::fitts::difficulty;
use crate::study_file::{Size, Study, Trigger};
use crate::task::{Geometry, Target, layout};

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
    /// Which sitting, counted from 0.
    pub session: u32,
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
    /// Combinations of the other factors' levels: at least one, which is empty where there are no others.
    pub fn cells(&self) -> Vec<BTreeMap<String, String>> {
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
        cells
    }

    /// Sizes × levels of the other factors.
    pub fn conditions(&self) -> Vec<(Size, BTreeMap<String, String>)> {
        let cells = self.cells();
        self.sizes.iter().flat_map(|size| cells.iter().map(move |cell| (*size, cell.clone()))).collect()
    }

    /// What was done, in sentences for a paper.
    pub fn described(&self) -> Vec<String> {
        let unit = if matches!(self.geometry, Geometry::Ray { .. }) { "rad" } else { "m" };
        let listed = |mut values: Vec<f64>| {
            values.sort_by(f64::total_cmp);
            values.dedup();
            let values: Vec<String> =
                values.iter().map(|value| ((value * 1e5).round() / 1e5).to_string()).collect();
            format!("{} {unit}", values.join(", "))
        };
        let kind = match self.geometry {
            Geometry::Reciprocal => "Reciprocal movements between two targets (1D)".to_owned(),
            Geometry::Ring { targets, plane } => {
                format!("A ring of {targets} targets (ISO 9241-411), {}", plane.described())
            }
            Geometry::Depth => "Movements between a near and a far ball, along the line of sight".to_owned(),
            Geometry::Ray { targets, .. } => {
                format!("Pointing with a ray at a ring of {targets} targets; sizes are angles")
            }
            Geometry::Steering => "Steering through straight tunnels".to_owned(),
            Geometry::Edge => "Targets at the edges of the screen".to_owned(),
            Geometry::Corner => "Targets in the corners of the screen".to_owned(),
        };
        let widths: Vec<f64> = self.sizes.iter().filter_map(|size| size.width).collect();
        let widths = if widths.is_empty() { String::new() } else { format!(", widths {}", listed(widths)) };
        let mut found = vec![format!(
            "{kind}, at {} m; amplitudes {}{widths}. Selection by {}.",
            self.distance,
            listed(self.sizes.iter().map(|size| size.amplitude).collect()),
            match self.trigger {
                Trigger::Trigger => "a press".to_owned(),
                Trigger::Tap => "a tap".to_owned(),
                Trigger::Dwell => format!("resting for {} s (there are no misses by design)", self.dwell_s),
            }
        )];
        for (name, levels) in &self.factors {
            found.push(format!("Factor {name}: {}.", levels.join(", ")));
        }
        for one in &self.instructions {
            let pace = one.metronome.map_or_else(String::new, |pace| {
                format!(" A metronome clicked at {:.0} % of the predicted time.", 100.0 * pace)
            });
            found.push(format!("Instruction {}: “{}”{pace}", one.name, one.text));
        }
        let repeats = self.repeat_above_error.map_or_else(String::new, |share| {
            format!(
                " A sequence with more than {:.0} % misses was repeated, at most {}; the last complete attempt counts.",
                100.0 * share,
                if self.most_repeats == 1 { "once".to_owned() } else { format!("{} times", self.most_repeats) }
            )
        });
        let counted = |count: u32, of: &str| format!("{count} {of}{}", if count == 1 { "" } else { "s" });
        found.push(format!(
            "{} and {} that count per sequence; {} per condition in a block, {} in each of {}, {} s of rest between blocks. Order of \
             instructions: {}; of conditions: {}.{repeats}",
            counted(self.practice, "practice movement"),
            self.per_condition,
            counted(self.repetitions, "sequence"),
            counted(self.instructions.len() as u32, "block"),
            counted(self.sessions, "session"),
            self.break_s,
            self.instruction_order,
            self.condition_order
        ));
        found
    }

    /// What makes the task hard: A/W of tunnels, else Shannon's bits.
    pub fn difficulty(&self) -> Difficulty {
        if self.geometry == Geometry::Steering { Difficulty::Steering } else { Difficulty::Shannon }
    }

    /// Predicted movement time a + b ID of a size, seconds; for tunnels ID is A/W.
    pub fn predicted_s(&self, size: Size) -> f64 {
        let bits =
            size.width.and_then(|width| difficulty(self.difficulty(), size.amplitude, width)).unwrap_or(1.0);
        self.prediction[0] + self.prediction[1] * bits
    }

    /// After how many participants the orders are balanced.
    pub fn balanced_after(&self) -> usize {
        // Each row of the conditions' orders comes with each row of the instructions'.
        self.instruction_order
            .rows(self.instructions.len())
            .saturating_mul(self.condition_order.rows(self.conditions().len()))
    }

    /// What `pseudonym` will do: the same each time.
    pub fn plan(&self, pseudonym: &str) -> Plan {
        let number = number_of(pseudonym);
        let conditions = self.conditions();
        // Conditions turn when the instructions' orders have been through, and one further from instruction to instruction:
        // under each of them every order of conditions comes equally often.
        let rows = self.instruction_order.rows(self.instructions.len()) as u64;
        let turns = number / rows.max(1);
        let told = self.instructions.len() as u64;
        let repetitions = u64::from(self.repetitions);
        let blocks = (0..self.sessions).flat_map(|session| {
            // The next session has the next row of the square, so that sessions are balanced too.
            let order =
                self.instruction_order.of(self.instructions.len(), number + u64::from(session), self.seed);
            order.into_iter().map(move |instruction| (session, instruction))
        });
        let blocks = blocks.enumerate().map(|(place, (session, instruction))| {
            let mut trials = Vec::new();
            for repetition in 0..self.repetitions {
                let round = place as u64 * repetitions + u64::from(repetition);
                let fixed = (u64::from(session) * told + instruction as u64) * repetitions;
                let order = match self.condition_order {
                    // A new shuffle each time: people must not learn it.
                    Order::Random => {
                        shuffled(conditions.len(), mixed(self.seed ^ mixed(number ^ mixed(round + 1))))
                    }
                    other => other.of(
                        conditions.len(),
                        turns.wrapping_add(fixed + u64::from(repetition)),
                        self.seed,
                    ),
                };
                for index in order {
                    self.sequence(&conditions[index], &mut trials);
                }
            }
            PlannedBlock { session, instruction, trials }
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
        if self.distance < 0.1 {
            found.push(format!("targets are {} m away: nobody sees them sharply", self.distance));
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
