//! Logs back into trials.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use vergence_log::{Ending, Reader};
use vergence_sense::Event;
use vergence_study::{DataSet, Error as StudyError, Imported, Study};
use vergence_time::{Span, Timestamp};

use crate::error::Error;
use crate::journal::{About, EVENTS, Journal, TRIALS};
use crate::record::{Place, Record};

/// What a study's log holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SessionLog {
    /// Which file.
    pub path: PathBuf,
    /// What it says of itself.
    pub about: About,
    /// In the order in which they ended.
    pub records: Vec<Record>,
    /// What happened, with session time.
    pub events: Vec<(Timestamp, Event)>,
    /// Where it is cut off or damaged: what was expected and found.
    pub damage: Vec<String>,
}

/// Reads a study's log as far as it is whole.
///
/// # Errors
/// Where it cannot be read at all, or is the log of something else.
pub fn read(path: &Path) -> Result<SessionLog, Error> {
    let mut reader = Reader::open(path)?;
    let header = reader.header().cloned().ok_or_else(|| Error::Damaged {
        path: path.to_owned(),
        expected: "the log of a study, with a header".to_owned(),
        found: "a log without one".to_owned(),
    })?;
    let about = About::of(&header)?;
    let mut log = SessionLog { path: path.to_owned(), about, ..SessionLog::default() };
    // Damage is passed over, but not for ever.
    while log.damage.len() < 100 {
        match reader.next() {
            Ok(None) => break,
            Ok(Some(entry)) if entry.stream.name == TRIALS && entry.is::<Record>() => {
                match entry.decode::<Record>() {
                    Ok(sample) => log.records.push(sample.value),
                    Err(error) => log.damage.push(with_causes(&error)),
                }
            }
            Ok(Some(entry)) if entry.stream.name == EVENTS && entry.is::<Event>() => {
                match entry.decode::<Event>() {
                    Ok(sample) => log.events.push((sample.arrived, sample.value)),
                    Err(error) => log.damage.push(with_causes(&error)),
                }
            }
            Ok(Some(_)) => {}
            Err(error) => log.damage.push(with_causes(&error)),
        }
    }
    // One whose recording failed is good so far, and its last record says that it is incomplete.
    if let Some(Ending::CutOff { at }) = reader.ending() {
        log.damage.push(format!("cut off after byte {at}"));
    }
    if log.about.participant.is_empty() && log.records.is_empty() {
        return Err(Error::Damaged {
            path: path.to_owned(),
            expected: format!("the log of a study, with a stream {TRIALS}"),
            found: "none".to_owned(),
        });
    }
    Ok(log)
}

fn with_causes(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(inner) = cause {
        text = format!("{text}: {inner}");
        cause = inner.source();
    }
    text
}

/// The trials of logs as analyses take them. Of a sequence that was repeated, only the last complete attempt is analysed.
///
/// # Errors
/// Where units, dimensions or conventions differ, or there is no trial.
pub fn imported(logs: &[SessionLog]) -> Result<Imported, Error> {
    // A log in which nothing was finished says nothing, and stands in nobody's way.
    let logs: Vec<&SessionLog> = logs.iter().filter(|log| !log.records.is_empty()).collect();
    let logs = logs.as_slice();
    let Some(first) = logs.first() else { return Err(StudyError::Empty { what: "trials" }.into()) };
    let kind = |about: &About| format!("{} dimensions in {}", about.dimensions, about.length_unit);
    let mut data = DataSet {
        length_unit: first.about.length_unit.clone(),
        dimensions: first.about.dimensions,
        trials: Vec::new(),
    };
    // How many trials each attempt at each sequence has.
    type Sequence<'a> = (&'a str, &'a str, u32, u32);
    let mut attempts: BTreeMap<Sequence<'_>, BTreeMap<u32, u32>> = BTreeMap::new();
    let mut seen: BTreeSet<(&str, &str, Place, [u64; 4])> = BTreeSet::new();
    let mut copies = 0u64;
    let mut kept: Vec<Vec<&Record>> = Vec::new();
    let mut lengths: Vec<u32> = Vec::new();
    for log in logs {
        if kind(&log.about) != kind(&first.about) {
            let (expected, found) = (kind(&first.about), kind(&log.about));
            return Err(StudyError::Mixed { expected, found }.into());
        }
        if log.about.conventions != first.about.conventions {
            let listed = |about: &About| {
                about
                    .conventions
                    .listed()
                    .iter()
                    .map(|(k, v)| format!("{k} {v}"))
                    .collect::<Vec<_>>()
                    .join(", ")
            };
            let (expected, found) = (listed(&first.about), listed(&log.about));
            return Err(StudyError::Mixed { expected, found }.into());
        }
        // A sequence is repeated as a whole.
        let study = Study::parse(Path::new("study.toml"), &log.about.study_file).ok();
        let length = study.map_or(1, |study| (study.practice + study.per_condition).max(1));
        let mut own = Vec::with_capacity(log.records.len());
        for record in &log.records {
            let (participant, session) = (record.trial.participant.as_str(), record.trial.session.as_str());
            // The same place and the same movement: imported logs may have one place twice.
            let [x, y, z] = record.trial.end;
            let movement = [record.trial.mt_s, x, y, z].map(f64::to_bits);
            if !seen.insert((participant, session, record.place, movement)) {
                copies += 1;
                continue;
            }
            let Place { block, trial, attempt } = record.place;
            let key = (participant, session, block, trial / length);
            *attempts.entry(key).or_default().entry(attempt).or_default() += 1;
            own.push(record);
        }
        kept.push(own);
        lengths.push(length);
    }
    // The last that is complete; where none is, the last.
    let chosen = |key: &Sequence<'_>, length: u32| {
        let own = attempts.get(key);
        let complete = own.and_then(|own| own.iter().rev().find(|(_, trials)| **trials >= length));
        complete.or_else(|| own.and_then(|own| own.iter().next_back())).map_or(0, |(attempt, _)| *attempt)
    };
    let mut warnings = Vec::new();
    for ((log, records), length) in logs.iter().zip(kept).zip(lengths) {
        for record in records {
            let Place { block, trial, attempt } = record.place;
            let key =
                (record.trial.participant.as_str(), record.trial.session.as_str(), block, trial / length);
            let mut own = record.trial.clone();
            own.repeated |= chosen(&key, length) != attempt;
            data.trials.push(own);
        }
        let name = log.path.file_name().unwrap_or_default().to_string_lossy();
        warnings
            .extend(log.damage.iter().map(|damage| format!("{name}: {damage}; what is whole is analysed")));
    }
    let of = |is: &dyn Fn(&SessionLog) -> bool| {
        let people: BTreeSet<&str> =
            logs.iter().filter(|log| is(log)).map(|log| log.about.participant.as_str()).collect();
        people.len()
    };
    let simulated = of(&|log| log.about.input.starts_with("simulated"));
    if simulated > 0 {
        warnings.push(format!("{simulated} of {} participants are simulated", of(&|_| true)));
    }
    if copies > 0 {
        warnings.push(format!("{copies} trials are there twice: is a log there twice? They are taken once"));
    }
    if data.trials.is_empty() {
        return Err(StudyError::Empty { what: "trials" }.into());
    }
    Ok(Imported { data, conventions: first.about.conventions.clone(), warnings })
}

/// Writes trials of another tool as a log of ours; one that is there is replaced.
///
/// # Errors
/// Where it cannot be written.
pub fn write_log(path: &Path, all: &Imported, application: &str) -> Result<(), Error> {
    if path.exists() {
        std::fs::remove_file(path).map_err(Error::io(path))?;
    }
    let about = About {
        application: application.to_owned(),
        study: "imported".to_owned(),
        session: "1".to_owned(),
        part: 1,
        length_unit: all.data.length_unit.clone(),
        dimensions: all.data.dimensions,
        clock: "virtual".to_owned(),
        conventions: all.conventions.clone(),
        ..About::default()
    };
    let mut journal = Journal::create(path, &about)?;
    let mut now = Timestamp::default();
    for (number, trial) in all.data.trials.iter().enumerate() {
        let began = now;
        now = now.saturating_add(Span::from_secs_f64(trial.mt_s).unwrap_or(Span::ZERO));
        let trial_number = u32::try_from(number).unwrap_or(u32::MAX);
        let place = Place { trial: trial_number, attempt: trial.attempt, ..Place::default() };
        let record = Record { trial: trial.clone(), place, began, wall_ns: 0 };
        journal.put(now, &record);
        if number % 256 == 255 {
            // The queue is bounded, and this is no frame loop.
            journal.settle()?;
        }
    }
    journal.finish(now, None).map(drop)
}
