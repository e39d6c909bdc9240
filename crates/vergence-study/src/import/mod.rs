//! Readers of other tools' recordings: text in, trials out. They open no file (but DataFusion does, behind the feature `sql`).

mod columns;
mod fittsstudy;
mod gofitts;
#[cfg(feature = "parquet")]
mod parquet;
#[cfg(feature = "sql")]
mod sql;
mod stream;
mod threedfitts;

pub(crate) use columns::is_known;
pub use columns::{Column, ColumnMap, Maps, Scaled};
#[cfg(feature = "parquet")]
pub use parquet::{ParquetText, parquet_text, write_parquet};
#[cfg(feature = "sql")]
pub use sql::{SqlText, TABLE, sql_text};
pub use stream::{Streamed, stream};

use crate::Error;
use crate::convention::Conventions;
use crate::trial::DataSet;

/// What an importer found.
#[derive(Clone, Debug, PartialEq)]
pub struct Imported {
    /// The trials.
    pub data: DataSet,
    /// The conventions of the tool that recorded them.
    pub conventions: Conventions,
    /// What is doubtful, in sentences.
    pub warnings: Vec<String>,
}

/// A tool whose recordings can be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tool {
    /// FittsStudy's results (.csv, .txt) and logs (.xml).
    FittsStudy,
    /// 3DFitts' tests (.json).
    ThreeDFitts,
    /// GoFitts' and FittsTaskTwo's trials (.sd1) and traces (.sd3).
    GoFitts,
    /// Columns by name, with a map.
    Csv,
}

impl Tool {
    /// Guesses from a file's first bytes; [`Tool::Csv`] where nothing else fits.
    pub fn guess(head: &str) -> Self {
        let head = head.trim_start_matches('\u{feff}').trim_start();
        if head.starts_with('{') {
            Self::ThreeDFitts
        } else if head.starts_with('<') || head.contains("Circular?,") || head.starts_with("FittsStudy log") {
            Self::FittsStudy
        } else if head.starts_with("TRACE DATA") || gofitts::is_trials(head) {
            Self::GoFitts
        } else {
            Self::Csv
        }
    }
}

/// Reads one recording. `name` (the file's name without folder) is its session where the recording names none;
/// `map` is needed for [`Tool::Csv`] alone.
///
/// # Errors
/// Where the text is not what the tool writes: line and what was expected.
pub fn import(tool: Tool, name: &str, text: &str, map: &ColumnMap) -> Result<Imported, Error> {
    let stem = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
    match tool {
        Tool::FittsStudy => fittsstudy::read(stem, text),
        Tool::ThreeDFitts => threedfitts::read(stem, text),
        Tool::GoFitts => gofitts::read(stem, text),
        Tool::Csv => columns::read(text, map),
    }
}

/// Puts the trials of several recordings of one tool together.
///
/// # Errors
/// Where units or dimensions differ.
pub fn together(parts: Vec<Imported>) -> Result<Imported, Error> {
    let mut parts = parts.into_iter();
    let Some(mut all) = parts.next() else {
        return Err(Error::Empty { what: "recordings" });
    };
    for part in parts {
        let units = (&part.data.length_unit, part.data.dimensions);
        if units != (&all.data.length_unit, all.data.dimensions) {
            return Err(Error::Mixed {
                expected: format!("{} dimensions in {}", all.data.dimensions, all.data.length_unit),
                found: format!("{} dimensions in {}", part.data.dimensions, part.data.length_unit),
            });
        }
        all.data.trials.extend(part.data.trials);
        all.warnings.extend(part.warnings);
    }
    all.warnings.extend(duplicates(&all.data));
    let times: Vec<f64> = all.data.trials.iter().map(|trial| trial.mt_s).collect();
    all.warnings.extend(time_slip(&times));
    all.warnings.extend(length_slip(&all.data));
    all.warnings.extend(nobody_in_particular(&all.data));
    let backward = times.iter().filter(|mt_s| **mt_s <= 0.0).count();
    if backward > 0 {
        all.warnings.push(format!("{backward} trials have a movement time of zero or less"));
    }
    all.warnings.dedup();
    Ok(all)
}

/// Sequences that hold the same movements: copied sessions.
fn duplicates(data: &DataSet) -> Option<String> {
    let mut seen = std::collections::BTreeMap::new();
    let mut copies = 0;
    for trial in &data.trials {
        let movement = (
            trial.end.map(f64::to_bits),
            trial.mt_s.to_bits(),
            trial.to.map(f64::to_bits),
            trial.start.map(|p| p.map(f64::to_bits)),
        );
        let session = (&trial.participant, &trial.session, &trial.block);
        if *seen.entry(movement).or_insert(session) != session {
            copies += 1;
        }
    }
    // One coincidence is chance; a fifth of all trials is a copy.
    (copies * 5 > data.trials.len() && copies > 1)
        .then(|| format!("{copies} trials are in more than one session: is a session there twice?"))
}

/// Movement times that nobody needs, and that are usual in another unit.
fn time_slip(times_s: &[f64]) -> Option<String> {
    let usual = vergence_stats::median(times_s)?;
    let in_what = match usual {
        50.0.. => "milliseconds that are read as seconds",
        ..0.02 => "seconds that are read as milliseconds",
        _ => return None,
    };
    Some(format!("the median movement time is {usual:.4} s: are these {in_what}?"))
}

/// Movements that are many times as long as their targets are apart, or as short.
fn length_slip(data: &DataSet) -> Option<String> {
    let ratio = |trial: &crate::Trial| {
        let (start, amplitude) = (trial.start?, trial.amplitude.filter(|a| *a > 0.0)?);
        let reach = (0..3).map(|i| (trial.end[i] - start[i]).powi(2)).sum::<f64>().sqrt();
        Some(reach / amplitude)
    };
    let ratios: Vec<f64> = data.trials.iter().filter_map(ratio).collect();
    let usual = vergence_stats::median(&ratios).filter(|usual| !(0.1..10.0).contains(usual))?;
    Some(format!(
        "movements are {usual:.4} times as long as their amplitudes (median): are ends and amplitudes in one unit?"
    ))
}

/// One name in nearly all of many recordings.
fn nobody_in_particular(data: &DataSet) -> Option<String> {
    let mut sessions: std::collections::BTreeMap<&str, std::collections::BTreeSet<&str>> = Default::default();
    for trial in &data.trials {
        sessions.entry(&trial.participant).or_default().insert(&trial.session);
    }
    let all: usize = sessions.values().map(std::collections::BTreeSet::len).sum();
    let (name, most) = sessions.iter().map(|(name, own)| (*name, own.len())).max_by_key(|(_, n)| *n)?;
    (sessions.len() > 1 && all > 4 && 5 * most > 4 * all && name != "unknown").then(|| {
        format!(
            "{most} of {all} sessions are of participant {name:?}: if they are of different people, counts of participants and \
             means over them are not (sequences are told apart by session)"
        )
    })
}

/// The cell of a row, as a number.
fn number(cell: &str, column: &str, line: u64) -> Result<f64, Error> {
    let parsed = cell.trim().parse::<f64>().ok().filter(|value| value.is_finite());
    parsed.ok_or_else(|| Error::Cell {
        line,
        column: column.to_owned(),
        expected: "a finite number",
        found: cell.chars().take(40).collect(),
    })
}

/// `1`, `true`, `yes`, `miss` … or their opposites.
fn truth(cell: &str, column: &str, line: u64) -> Result<bool, Error> {
    match cell.trim().to_ascii_lowercase().as_str() {
        "1" | "1.0" | "true" | "yes" | "y" | "t" => Ok(true),
        "0" | "0.0" | "false" | "no" | "n" | "f" | "" => Ok(false),
        _ => Err(Error::Cell {
            line,
            column: column.to_owned(),
            expected: "true, false, 1 or 0",
            found: cell.chars().take(40).collect(),
        }),
    }
}
