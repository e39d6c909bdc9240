//! From trials to rows (participant × session × block × condition × instruction × other factors) to a summary.

use std::collections::{BTreeMap, BTreeSet};

use vergence_stats::{Moments, linear};

use crate::convention::{Axis, Conventions, Difficulty, Outliers};
use crate::measure::ends::{Effective, End, Ends, Sequence, end_of};
use crate::measure::fitts::{difficulty, width_from_errors};
use crate::measure::outlier::left_out;
use crate::measure::path::of_path;
use crate::tradeoff::{self, CafBin, ErrorModel, Stability, Who};
use crate::trial::{DataSet, PathMeasures, Trial};

/// What names a sequence.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Key {
    /// Pseudonym.
    pub participant: String,
    /// Sitting.
    pub session: String,
    /// Block.
    pub block: String,
    /// Condition.
    pub condition: String,
    /// The instruction, where there were several: ends of different instructions are never pooled.
    pub instruction: Option<String>,
    /// Levels of other factors, by name: nor are those of different levels.
    pub factors: BTreeMap<String, String>,
    /// Nominal amplitude and width (six digits of each): nor are those of targets that differ under one name of a condition.
    pub sizes: [Option<u64>; 2],
}

/// A nominal size to six digits, which real amplitudes of one ring share: its bits, so that sizes have an order.
pub(crate) fn nominal(size: Option<f64>) -> Option<u64> {
    let size = size.filter(|size| size.is_finite() && *size > 0.0)?;
    let scale = 10f64.powi(5 - size.log10().floor() as i32);
    Some(((size * scale).round() / scale).to_bits())
}

/// One sequence, analysed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Row {
    /// Whose and when.
    pub key: Key,
    /// Nominal amplitude, length unit.
    pub amplitude: Option<f64>,
    /// Nominal width, length unit.
    pub width: Option<f64>,
    /// Nominal index of difficulty, bits.
    pub id: Option<f64>,
    /// Trials analysed.
    pub n: u64,
    /// Trials that were not practice.
    pub trials: u64,
    /// Missed ones among them.
    pub errors: u64,
    /// Those among them of which it is known whether they missed.
    pub judged: u64,
    /// Left out among them.
    pub outliers: u64,
    /// Ends and times.
    pub ends: Ends,
    /// From the nominal sizes and the share of misses alone, as where ends were not recorded (see [`width_from_errors`]): no
    /// spread, and the nominal amplitude.
    pub by_errors: Effective,
    /// Means over the analysed trials.
    pub path: PathMeasures,
}

/// Least squares of mean movement time on effective difficulty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// Intercept, seconds.
    pub a: f64,
    /// Slope, seconds per bit; 1/b is the other throughput.
    pub b: f64,
    /// Correlation.
    pub r: Option<f64>,
    /// 95 % intervals of a and b.
    pub intervals: [Option<(f64, f64)>; 2],
    /// Rows.
    pub n: usize,
}

/// All of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Analysis {
    /// Unit of lengths.
    pub length_unit: String,
    /// Dimensions of the task.
    pub dimensions: usize,
    /// The knobs.
    pub conventions: Conventions,
    /// In the order of their keys; without those of too few trials.
    pub rows: Vec<Row>,
    /// Of all sequences, those of too few trials too.
    pub counts: Counts,
    /// What was left out and why, counted.
    pub exclusions: Vec<(String, u64)>,
    /// Over all rows, along the axis and in all dimensions.
    pub fit: Option<Fit>,
    /// As above.
    pub fit_xy: Option<Fit>,
    /// Of mean movement time on nominal difficulty: of tunnels, the steering law.
    pub fit_nominal: Option<Fit>,
    /// Of each participant and session with three rows or more.
    pub fits: Vec<(String, String, Fit)>,
    /// Means by instruction.
    pub stability: Option<Stability>,
    /// Means by each other factor of more than one level.
    pub factors: Vec<(String, Stability)>,
    /// The law of speed against accuracy; none where accuracy does not rise with time.
    pub who: Option<Who>,
    /// Predicted and observed errors.
    pub error_model: Option<ErrorModel>,
    /// Conditional accuracy by instruction (or of all, under an empty name), a mean over sequences; none where trials were
    /// streamed.
    pub accuracy: Vec<(String, Vec<CafBin>)>,
    /// What is doubtful about the conventions for these trials, in sentences.
    pub warnings: Vec<String>,
}

/// How many there were of all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Different participants.
    pub participants: usize,
    /// Sequences.
    pub sequences: usize,
    /// Trials that were not practice.
    pub trials: u64,
    /// Misses among them.
    pub errors: u64,
    /// Those among them of which it is known whether they missed.
    pub judged: u64,
}

/// How many were left out before anything was computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Left {
    /// Practice trials.
    pub practice: u64,
    /// Other trials of sequences that were made again.
    pub repeated: u64,
    /// Those sequences.
    pub sequences: u64,
}

impl Left {
    /// Counts a trial that does not count.
    pub fn add(&mut self, trial: &Trial) {
        self.practice += u64::from(trial.practice);
        self.repeated += u64::from(trial.repeated && !trial.practice);
        self.sequences += u64::from(trial.repeated && trial.index == 0);
    }

    /// As if those of `other` had been counted, too.
    pub fn merge(&mut self, other: Self) {
        self.practice += other.practice;
        self.repeated += other.repeated;
        self.sequences += other.sequences;
    }
}

impl Analysis {
    /// Mean over rows of their throughputs, bits/s: never of pooled points.
    pub fn tp_mean_of_means(&self) -> Option<f64> {
        self.mean(|row| row.ends.x.tp)
    }

    /// The same in all dimensions.
    pub fn tp_xy_mean_of_means(&self) -> Option<f64> {
        self.mean(|row| row.ends.xy.tp)
    }

    /// Mean over participants of the means of their rows, bits/s: the same where all have as many rows.
    pub fn tp_mean_of_participants(&self) -> Option<f64> {
        let mut by: BTreeMap<&str, Moments> = BTreeMap::new();
        for row in &self.rows {
            if let Some(tp) = row.ends.x.tp {
                by.entry(&row.key.participant).or_default().push(tp);
            }
        }
        by.values().filter_map(Moments::mean).collect::<Moments>().mean()
    }

    /// Share of misses among all trials that were not practice and of which it is known.
    pub fn error_rate(&self) -> Option<f64> {
        let Counts { errors, judged, .. } = self.counts;
        (judged > 0).then(|| errors as f64 / judged as f64)
    }

    /// Mean over rows of A/W per second: how fast tunnels are gone through, 1/s. None for what is no tunnel.
    pub fn steering_rate(&self) -> Option<f64> {
        if self.conventions.difficulty != Difficulty::Steering {
            return None;
        }
        self.mean(|row| row.id.zip(row.ends.mt_s).filter(|(_, mt)| *mt > 0.0).map(|(id, mt)| id / mt))
    }

    /// Mean over the rows that have a value.
    pub fn mean(&self, of: impl Fn(&Row) -> Option<f64>) -> Option<f64> {
        self.rows.iter().filter_map(of).collect::<Moments>().mean()
    }
}

/// One trial with what was computed of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Analysed<'a> {
    /// The trial.
    pub trial: &'a Trial,
    /// Its end; none for practice and for an axis without length.
    pub end: Option<End>,
    /// Its path.
    pub path: Option<PathMeasures>,
    /// Left out by the outlier policy.
    pub outlier: bool,
}

/// The key of a trial.
pub fn key_of(trial: &Trial) -> Key {
    Key {
        participant: trial.participant.clone(),
        session: trial.session.clone(),
        block: trial.block.clone(),
        condition: trial.condition.clone(),
        instruction: trial.instruction.clone(),
        factors: trial.factors.clone(),
        sizes: [trial.amplitude, trial.width].map(nominal),
    }
}

/// Computes every trial: ends (in serial tasks each with the one before it), paths, outliers. In the order of the set.
pub fn analyse_trials<'a>(data: &'a DataSet, conventions: &Conventions) -> Vec<Analysed<'a>> {
    trials_with(data, conventions, true)
}

/// As [`analyse_trials`]; paths, which cost most, only where they are wanted.
fn trials_with<'a>(data: &'a DataSet, conventions: &Conventions, paths: bool) -> Vec<Analysed<'a>> {
    let mut groups: BTreeMap<Key, Vec<usize>> = BTreeMap::new();
    for (i, trial) in data.trials.iter().enumerate() {
        groups.entry(key_of(trial)).or_default().push(i);
    }
    let mut analysed: Vec<Analysed<'a>> = data
        .trials
        .iter()
        .map(|trial| {
            let path = if paths { of_path(trial, conventions, data.dimensions) } else { None };
            Analysed { trial, end: None, path, outlier: false }
        })
        .collect();
    for members in groups.values() {
        let (mut before, mut last) = (0.0, None);
        for &i in members {
            // The movement before it in its sequence, where that is there.
            let index = data.trials[i].index;
            if last.is_some_and(|last: u32| last.checked_add(1) != Some(index)) {
                before = 0.0;
            }
            last = Some(index);
            let end = end_of(&data.trials[i], conventions, before);
            before = if conventions.axis == Axis::Serial { end.map_or(0.0, |end| end.dx) } else { 0.0 };
            analysed[i].end = end;
        }
        let counted: Vec<usize> = members.iter().copied().filter(|&i| data.trials[i].counts()).collect();
        let pairs: Vec<(&Trial, Option<End>)> =
            counted.iter().map(|&i| (&data.trials[i], analysed[i].end)).collect();
        for (&i, left) in counted.iter().zip(left_out(&pairs, conventions)) {
            analysed[i].outlier = left;
        }
    }
    analysed
}

/// Rows and summary of trials in memory.
pub fn analyse(data: &DataSet, conventions: &Conventions) -> Analysis {
    analyse_with(data, conventions, true)
}

/// As [`analyse`]; paths only where they are wanted.
pub(crate) fn analyse_with(data: &DataSet, conventions: &Conventions, paths: bool) -> Analysis {
    let analysed = trials_with(data, conventions, paths);
    let mut groups: BTreeMap<Key, (Row, Sequence, [Moments; 9])> = BTreeMap::new();
    let mut left = Left::default();
    for one in &analysed {
        let trial = one.trial;
        if !trial.counts() {
            left.add(trial);
            continue;
        }
        let (_, sequence, paths) = groups
            .entry(key_of(trial))
            .or_insert_with(|| (blank_row(trial), Sequence::default(), <_>::default()));
        sequence.count(trial.error);
        if one.outlier {
            sequence.outliers += 1;
            continue;
        }
        sequence.push(one.end, trial.mt_s);
        if let Some(path) = one.path {
            for (moments, value) in paths.iter_mut().zip(path.values()) {
                value.into_iter().for_each(|value| moments.push(value));
            }
        }
    }
    let without = analysed.iter().filter(|one| one.trial.counts() && one.end.is_none()).count() as u64;
    let rows = groups.into_iter().map(|(key, (row, sequence, paths))| {
        let path = PathMeasures::from_values(paths.map(|moments| moments.mean()));
        finished(Row { key, path, ..row }, &sequence, conventions, data.dimensions)
    });
    let rows = rows.collect();
    let mut accuracy: BTreeMap<Key, Vec<(f64, bool)>> = BTreeMap::new();
    for trial in data.trials.iter().filter(|trial| trial.counts()) {
        if let Some(error) = trial.error {
            accuracy.entry(key_of(trial)).or_default().push((trial.mt_s, error));
        }
    }
    let accuracy = tradeoff::mean_accuracy(accuracy, 5);
    let mut analysis = summarised(rows, conventions, &data.length_unit, data.dimensions, left);
    if without > 0 {
        analysis
            .exclusions
            .push(("trials whose start and target coincide: no effective measures".to_owned(), without));
    }
    analysis.accuracy = accuracy;
    analysis
}

fn blank_row(trial: &Trial) -> Row {
    Row { amplitude: trial.amplitude, width: trial.width, ..Row::default() }
}

/// The row of a sequence that is complete.
pub fn finished(row: Row, sequence: &Sequence, conventions: &Conventions, dimensions: usize) -> Row {
    let ends = sequence.measures(conventions, dimensions);
    let is_aim = conventions.difficulty != Difficulty::Steering;
    let known = row.width.zip(ends.error_rate).filter(|_| is_aim);
    let we = known.and_then(|(width, rate)| width_from_errors(width, rate));
    let ide = row.amplitude.zip(we).and_then(|(a, w)| difficulty(conventions.difficulty, a, w));
    let tp = ide.zip(ends.mt_s).filter(|(_, mt)| *mt > 0.0).map(|(ide, mt)| ide / mt);
    Row {
        by_errors: Effective { amplitude: row.amplitude, sd: None, we, ide, tp },
        id: row.amplitude.zip(row.width).and_then(|(a, w)| difficulty(conventions.difficulty, a, w)),
        n: sequence.n(),
        trials: sequence.trials,
        errors: sequence.errors,
        judged: sequence.judged,
        outliers: sequence.outliers,
        ends,
        ..row
    }
}

/// The summary of finished rows.
pub(crate) fn summarised(
    rows: Vec<Row>,
    conventions: &Conventions,
    length_unit: &str,
    dimensions: usize,
    left: Left,
) -> Analysis {
    let all = rows.len();
    let people: BTreeSet<&str> = rows.iter().map(|row| row.key.participant.as_str()).collect();
    let mut counts = Counts { participants: people.len(), sequences: all, ..Counts::default() };
    for row in &rows {
        counts.trials += row.trials;
        counts.errors += row.errors;
        counts.judged += row.judged;
    }
    let warnings = doubts(&rows, conventions);
    let rows: Vec<Row> = rows.into_iter().filter(|row| row.n >= conventions.least_trials as u64).collect();
    let fit = fit_of(&rows, |row| row.ends.x.ide);
    let mut by: BTreeMap<(&str, &str), Vec<Row>> = BTreeMap::new();
    for row in &rows {
        by.entry((&row.key.participant, &row.key.session)).or_default().push(row.clone());
    }
    let fits = by.iter().filter_map(|((participant, session), own)| {
        Some(((*participant).to_owned(), (*session).to_owned(), fit_of(own, |row| row.ends.x.ide)?))
    });
    let fits = fits.collect();
    let outliers: u64 = rows.iter().map(|row| row.outliers).sum();
    let mut exclusions = vec![("practice trials".to_owned(), left.practice)];
    if left.repeated > 0 {
        exclusions.extend([
            ("trials of sequences that were made again for too many misses".to_owned(), left.repeated),
            ("sequences that were made again for too many misses".to_owned(), left.sequences),
        ]);
    }
    exclusions.push((format!("trials by the outlier policy '{}'", conventions.outliers), outliers));
    exclusions.push((
        format!("sequences of fewer than {} analysed trials", conventions.least_trials),
        (all - rows.len()) as u64,
    ));
    Analysis {
        length_unit: length_unit.to_owned(),
        dimensions,
        conventions: conventions.clone(),
        exclusions,
        fit_xy: fit_of(&rows, |row| row.ends.xy.ide),
        fit_nominal: fit_of(&rows, |row| row.id),
        fits,
        stability: tradeoff::stability(&rows),
        factors: tradeoff::by_factors(&rows),
        who: tradeoff::who_of(&rows, conventions),
        error_model: fit
            .filter(|_| conventions.difficulty == Difficulty::Shannon)
            .map(|fit| tradeoff::error_model(&rows, fit.a, fit.b)),
        fit,
        accuracy: Vec::new(),
        counts,
        warnings,
        rows,
    }
}

/// Where a policy cannot do what its name says.
fn doubts(rows: &[Row], conventions: &Conventions) -> Vec<String> {
    // No value of n lies further from their mean than (n − 1)/√n SD (Samuelson 1968): 2.85 for ten.
    let short = rows.iter().filter(|row| row.n + row.outliers <= 10).count();
    let is_blind = conventions.outliers == Outliers::ThreeSd && short > 0;
    let warning = || {
        format!(
            "outlier policy '3sd' can leave nothing out of {short} of {} sequences, which have 10 trials or fewer: nothing \
             lies 3 SD from the mean of so few; '3mad' can",
            rows.len()
        )
    };
    is_blind.then(warning).into_iter().collect()
}

fn fit_of(rows: &[Row], bits: impl Fn(&Row) -> Option<f64>) -> Option<Fit> {
    let (x, y): (Vec<f64>, Vec<f64>) =
        rows.iter().filter_map(|row| Some((bits(row)?, row.ends.mt_s?))).unzip();
    if x.len() < 3 {
        return None;
    }
    let line = linear(&x, &y).ok()?;
    let b = line.coefficients[1];
    Some(Fit {
        a: line.coefficients[0],
        b,
        r: line.r2.map(|r2| r2.max(0.0).sqrt() * b.signum()),
        intervals: [line.interval(0, 0.95), line.interval(1, 0.95)],
        n: x.len(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trials(participant: &str, n: u32) -> impl Iterator<Item = Trial> {
        (0..n).map(move |index| Trial {
            participant: participant.to_owned(),
            index,
            amplitude: Some(10.0),
            width: Some(2.0),
            from: Some([0.0; 3]),
            to: [10.0, 0.0, 0.0],
            start: Some([0.0; 3]),
            end: [10.0 + 0.1 * f64::from(index % 5), 0.0, 0.0],
            mt_s: 0.5 + 0.01 * f64::from(index % 7),
            error: Some(index % 5 == 0),
            ..Trial::default()
        })
    }

    fn set(trials: impl Iterator<Item = Trial>) -> DataSet {
        DataSet { length_unit: "px".into(), dimensions: 1, trials: trials.collect() }
    }

    #[test]
    fn what_is_too_short_to_analyse_is_counted_all_the_same() {
        let data = set(trials("P1", 1).chain(trials("P2", 10)));
        let analysis = analyse(&data, &Conventions::default());
        assert_eq!(analysis.rows.len(), 1);
        let expected = Counts { participants: 2, sequences: 2, trials: 11, errors: 3, judged: 11 };
        assert_eq!((analysis.counts, analysis.error_rate()), (expected, Some(3.0 / 11.0)));
    }

    #[test]
    fn what_was_made_again_is_no_practice() {
        let first = trials("P1", 12).map(|trial| Trial {
            practice: trial.index < 2,
            repeated: true,
            mt_s: 9.0,
            ..trial
        });
        let last = trials("P1", 12).map(|trial| Trial { practice: trial.index < 2, attempt: 1, ..trial });
        let analysis = analyse(&set(first.chain(last)), &Conventions::default());
        let left = |what: &str| analysis.exclusions.iter().find(|(own, _)| own.starts_with(what)).unwrap().1;
        assert_eq!((analysis.counts.trials, analysis.rows[0].n), (10, 10));
        assert_eq!(
            (left("practice trials"), left("trials of sequences"), left("sequences that")),
            (4, 10, 1)
        );
        assert!(analysis.rows[0].ends.mt_s.unwrap() < 1.0);
    }

    #[test]
    fn three_sd_says_where_it_is_blind() {
        let conventions = Conventions { outliers: Outliers::ThreeSd, ..Conventions::default() };
        let with = |n: u32| {
            let mut data = set(trials("P1", n));
            data.trials[3].mt_s = 1e6;
            let analysis = analyse(&data, &conventions);
            (analysis.rows[0].outliers, analysis.warnings.len())
        };
        assert_eq!((with(10), with(11)), ((0, 1), (1, 0)));
    }
}
