//! What a study's folder holds, and what is wrong with it.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use serde::Serialize;
use vergence_study::{CursorSample, Geometry};

use crate::error::Error;
use crate::folder::{Folder, MANIFEST, STUDY_FILE, Sitting, State};
use crate::journal::hash_of;
use crate::reading::SessionLog;
use crate::record::Record;
use crate::slip::slip;

/// The computer's clock and the session's may drift apart so much between two trials, seconds.
const JUMP_S: f64 = 1.0;
/// A movement has a gap where the cursor was not seen for so long, seconds, and so many usual intervals, and then came out so
/// many times as far away as it otherwise goes from one sample to the next: a mouse at rest says nothing, and is no gap.
const GAP_S: f64 = 0.1;
const GAP_INTERVALS: f64 = 5.0;
const GAP_STEPS: f64 = 2.0;
/// Two logs of which so many trials are the same are copies.
const COPIED_SHARE: f64 = 0.2;

/// What kind of thing was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// A file is missing, changed, unreadable or not of this study.
    Damaged,
    /// The same person is there twice.
    Duplicate,
    /// The same movements are there under two names.
    Copied,
    /// Trials or samples are missing.
    Gap,
    /// Values are in another unit than they should be.
    UnitSlip,
    /// The clock jumped or went back.
    ClockJump,
    /// A sitting ended before everything was done.
    Incomplete,
    /// Something that was done again, or is worth knowing.
    Note,
}

/// Something that was found.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// What kind.
    pub kind: Kind,
    /// In which file.
    pub file: String,
    /// In words: expected and found.
    pub text: String,
}

/// How far one participant is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Participant {
    /// Pseudonym.
    pub participant: String,
    /// Trials of the plan that are finished, repeats not counted.
    pub trials: usize,
    /// Trials of the plan.
    pub planned: usize,
    /// Everything is done.
    pub finished: bool,
    /// Logs.
    pub parts: usize,
    /// How the last of them ended.
    pub state: State,
    /// What they used: `mouse`, `controller`, `simulated:SEED`.
    pub input: String,
}

/// What a study's folder holds, and what is wrong with it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Status {
    /// Name of the study.
    pub study: String,
    /// People planned.
    pub planned_participants: u32,
    /// Who has begun, by name.
    pub participants: Vec<Participant>,
    /// People who were deleted.
    pub deleted: usize,
    /// Somebody writes now.
    pub in_use: bool,
    /// The worst first.
    pub findings: Vec<Finding>,
}

impl Status {
    /// Looks at everything in the folder: reads every log.
    ///
    /// # Errors
    /// Where the folder itself cannot be read; damage of logs is found, not failed on.
    pub fn of(folder: &Folder) -> Result<Self, Error> {
        let in_use = folder.is_in_use();
        let mut findings = Vec::new();
        let mut logs: Vec<(&Sitting, SessionLog)> = Vec::new();
        for sitting in folder.sittings() {
            let as_it_was = look_at_file(folder, sitting, in_use, &mut findings);
            match folder.log(sitting) {
                Ok(mut log) => {
                    // A log that ended suddenly, or on a full disk, is cut off where it is, and the manifest knows it so.
                    let open = matches!(sitting.state, State::CutOff | State::Open);
                    log.damage.retain(|damage| !((open || as_it_was) && damage.starts_with("cut off")));
                    logs.push((sitting, log));
                }
                Err(error) if folder.path().join(&sitting.file).exists() => {
                    findings.push(Finding::new(Kind::Damaged, &sitting.file, error.to_string()));
                }
                Err(_) => {}
            }
        }
        strangers(folder, &mut findings)?;
        if hash_of(folder.study_text().as_bytes()) != folder.manifest.study_hash {
            let text = "expected the study file of the manifest, found a changed one".to_owned();
            findings.push(Finding::new(Kind::Damaged, STUDY_FILE, text));
        }
        for (sitting, log) in &logs {
            look_inside(folder, sitting, log, &mut findings);
        }
        let participants = people(folder, &logs, in_use, &mut findings);
        twins(&participants, &mut findings);
        copies(&logs, &mut findings);
        findings.sort_by(|a, b| (a.kind, &a.file).cmp(&(b.kind, &b.file)));
        Ok(Self {
            study: folder.study().name.clone(),
            planned_participants: folder.study().participants,
            participants,
            deleted: folder.deleted().len(),
            in_use,
            findings,
        })
    }

    /// Whether anything is wrong: damage, doubles, copies, gaps, units, clocks. Who is not done yet is not.
    pub fn is_sound(&self) -> bool {
        self.findings.iter().all(|finding| finding.kind >= Kind::Incomplete)
    }
}

impl Finding {
    fn new(kind: Kind, file: &str, text: String) -> Self {
        Self { kind, file: file.to_owned(), text }
    }
}

/// Whether the file is the one that the manifest has a checksum of.
fn look_at_file(folder: &Folder, sitting: &Sitting, in_use: bool, findings: &mut Vec<Finding>) -> bool {
    let path = folder.path().join(&sitting.file);
    let mut add = |kind, text: String| findings.push(Finding::new(kind, &sitting.file, text));
    if !path.exists() {
        add(Kind::Damaged, format!("expected the log that {MANIFEST} names, found none"));
        return false;
    }
    match sitting.state {
        State::Open if in_use => add(Kind::Note, "is being written now".to_owned()),
        State::Open | State::CutOff => add(
            Kind::Incomplete,
            "ended without a word: killed, crashed, or out of power; what is finished is there".to_owned(),
        ),
        State::Stopped => add(Kind::Incomplete, format!("ended before everything was done: {}", sitting.why)),
        State::Finished => {}
    }
    if sitting.hash.is_empty() {
        return false;
    }
    let is_same = std::fs::read(&path).is_ok_and(|bytes| hash_of(&bytes) == sitting.hash);
    if !is_same {
        add(Kind::Damaged, format!("expected the checksum {}, found another: it was changed", sitting.hash));
    }
    is_same
}

/// Logs that the manifest does not know.
fn strangers(folder: &Folder, findings: &mut Vec<Finding>) -> Result<(), Error> {
    let entries = std::fs::read_dir(folder.path()).map_err(Error::io(folder.path()))?;
    for name in entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned()) {
        if name.ends_with(".mcap") && folder.sittings().iter().all(|sitting| sitting.file != name) {
            let text =
                format!("expected only logs that {MANIFEST} names, found one more: was it copied here?");
            findings.push(Finding::new(Kind::Copied, &name, text));
        }
    }
    Ok(())
}

fn look_inside(folder: &Folder, sitting: &Sitting, log: &SessionLog, findings: &mut Vec<Finding>) {
    let mut add = |kind, text: String| findings.push(Finding::new(kind, &sitting.file, text));
    let about = &log.about;
    if about.participant != sitting.participant {
        add(
            Kind::Copied,
            format!("expected trials of {}, found those of {}", sitting.participant, about.participant),
        );
    }
    if about.study_hash != folder.manifest.study_hash {
        add(
            Kind::Damaged,
            "expected a log of this study, found one of another (or of this one before it was changed)"
                .into(),
        );
    }
    if sitting.state != State::Open && sitting.trials != log.records.len() as u64 {
        add(Kind::Gap, format!("expected {} trials, found {}", sitting.trials, log.records.len()));
    }
    for damage in &log.damage {
        add(Kind::Damaged, damage.clone());
    }
    for (at, event) in &log.events {
        let seconds = at.as_nanos() as f64 * 1e-9;
        match event.name.as_ref() {
            "interrupted" => {
                add(Kind::Note, format!("at {seconds:.1} s a movement was made again: {}", event.text))
            }
            "clock_went_back" => add(Kind::Note, format!("at {seconds:.1} s the session was made anew")),
            // Which headset was found is known from the log's header.
            "headset" if event.text.starts_with(&format!("{}: ", about.headset)) => {}
            "headset" => add(Kind::Note, format!("at {seconds:.1} s: {}", event.text)),
            _ => {}
        }
    }
    times(log, &mut add);
    units(folder, log, &mut add);
}

/// Clocks and gaps.
fn times(log: &SessionLog, add: &mut dyn FnMut(Kind, String)) {
    for pair in log.records.windows(2) {
        let [before, after] = pair else { continue };
        let session_s = (after.began.as_nanos() - before.began.as_nanos()) as f64 * 1e-9;
        let at = after.began.as_nanos() as f64 * 1e-9;
        if session_s < 0.0 {
            add(
                Kind::ClockJump,
                format!("at {at:.1} s: expected ascending times, found {session_s:.3} s back"),
            );
            continue;
        }
        if log.about.clock == "virtual" {
            continue;
        }
        let end = |record: &Record| record.began.as_nanos() as f64 * 1e-9 + record.trial.mt_s;
        let wall_s = (i128::from(after.wall_ns) - i128::from(before.wall_ns)) as f64 * 1e-9;
        let apart = wall_s - (end(after) - end(before));
        if apart.abs() > JUMP_S {
            add(
                Kind::ClockJump,
                format!("at {at:.1} s the computer's clock jumped by {apart:+.1} s against the session's"),
            );
        }
    }
    let mut gaps = (0u64, 0.0f64);
    for record in &log.records {
        let samples = &record.trial.samples;
        let intervals: Vec<f64> = samples.windows(2).map(|pair| pair[1].t_s - pair[0].t_s).collect();
        if intervals.iter().any(|interval| *interval < 0.0) {
            add(
                Kind::ClockJump,
                format!(
                    "trial {} of block {}: samples go back in time",
                    record.place.trial + 1,
                    record.place.block + 1
                ),
            );
        }
        let mut sorted = intervals.clone();
        sorted.sort_unstable_by(f64::total_cmp);
        let usual = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
        let is_long = |interval: f64| interval > GAP_S && interval > GAP_INTERVALS * usual;
        let steps = || samples.windows(2).zip(&intervals).map(|(pair, t)| (*t, step(pair)));
        let step = steps().filter(|(t, _)| !is_long(*t)).fold(0.0, |most: f64, (_, step)| most.max(step));
        let gap = steps().filter(|(t, own)| is_long(*t) && *own > GAP_STEPS * step);
        let longest = gap.fold(0.0, |longest: f64, (t, _)| longest.max(t));
        if longest > 0.0 {
            gaps = (gaps.0 + 1, gaps.1.max(longest));
        }
    }
    if gaps.0 > 0 {
        add(
            Kind::Gap,
            format!(
                "{} movements have gaps between the cursor's samples, the longest of {:.0} ms",
                gaps.0,
                1e3 * gaps.1
            ),
        );
    }
}

/// How far it is from the one to the other.
fn step(pair: &[CursorSample]) -> f64 {
    let [a, b] = pair else { return 0.0 };
    (Vector3::from(b.position) - Vector3::from(a.position)).norm()
}

/// Of those that are numbers.
fn middle(mut values: Vec<f64>) -> Option<f64> {
    values.retain(|value| value.is_finite());
    vergence_stats::median(&values)
}

/// Sizes against the plan, times against each other, ends against targets.
fn units(folder: &Folder, log: &SessionLog, add: &mut dyn FnMut(Kind, String)) {
    let plan = folder.study().plan(&log.about.participant);
    let distance = |a: [f64; 3], b: [f64; 3]| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt();
    let (mut widths, mut amplitudes, mut durations, mut reaches) = (vec![], vec![], vec![], vec![]);
    for record in &log.records {
        let trial = &record.trial;
        let planned = plan
            .blocks
            .get(record.place.block as usize)
            .and_then(|block| block.trials.get(record.place.trial as usize));
        if let Some(planned) = planned {
            let ratio = |found: Option<f64>, planned: Option<f64>| found.zip(planned).map(|(a, b)| a / b);
            widths.extend(ratio(trial.width, planned.size.width));
            // A ring's movements are a little shorter than its diameter.
            let (from, to) = (planned.from.centre, planned.to.centre);
            let is_angle = matches!(folder.study().geometry, Geometry::Ray { .. });
            let angle = Vector3::from(from).angle(&Vector3::from(to));
            amplitudes
                .extend(ratio(trial.amplitude, Some(if is_angle { angle } else { distance(from, to) })));
        }
        if let Some(last) = trial.samples.last().filter(|last| last.t_s > 0.0) {
            durations.push(trial.mt_s / last.t_s);
        }
        if let (Some(start), Some(amplitude)) = (trial.start, trial.amplitude) {
            reaches.push(distance(start, trial.end) / amplitude);
        }
    }
    let checks = [
        ("widths", "the plan's", middle(widths)),
        ("amplitudes", "the plan's", middle(amplitudes)),
        ("movement times", "those of their samples", middle(durations)),
        ("movements", "their amplitudes", middle(reaches)),
    ];
    for (what, of, ratio) in checks {
        if let Some(text) = ratio.and_then(|ratio| slip(ratio, 1.0)) {
            let ratio = ratio.unwrap_or(1.0);
            add(
                Kind::UnitSlip,
                format!("{what}: expected as long as {of}, found {ratio:.4} times that: {text}"),
            );
        }
    }
}

/// Who has done what, and which trials are missing or there twice.
fn people(
    folder: &Folder,
    logs: &[(&Sitting, SessionLog)],
    in_use: bool,
    findings: &mut Vec<Finding>,
) -> Vec<Participant> {
    let mut by: BTreeMap<&str, Vec<&Sitting>> = BTreeMap::new();
    for sitting in folder.sittings() {
        by.entry(&sitting.participant).or_default().push(sitting);
    }
    let mut people = Vec::new();
    for (name, sittings) in by {
        let own: Vec<&Record> = logs
            .iter()
            .filter(|(sitting, _)| sitting.participant == name)
            .flat_map(|(_, log)| &log.records)
            .collect();
        let file = sittings.last().map_or("", |sitting| sitting.file.as_str());
        let input = logs.iter().rev().find(|(sitting, _)| sitting.participant == name);
        let input = input.map_or("", |(_, log)| log.about.input.as_str());
        let mut course = crate::Course::new(folder.study(), name);
        let mut fits = true;
        if let Err(error) = course.resume(own.iter().copied()) {
            fits = false;
            findings.push(Finding::new(Kind::Gap, file, error.to_string()));
        }
        let mut places: Vec<_> = own.iter().map(|record| record.place).collect();
        places.sort_unstable();
        let twice = places.windows(2).filter(|pair| pair[0] == pair[1]).count();
        if twice > 0 {
            let text = format!("{twice} trials of {name} are there twice: did somebody take part twice?");
            findings.push(Finding::new(Kind::Duplicate, file, text));
        }
        let planned = course.progress().1;
        places.dedup_by_key(|place| (place.block, place.trial));
        let mut distinct: Vec<(u32, u32)> = places.iter().map(|place| (place.block, place.trial)).collect();
        distinct.sort_unstable();
        distinct.dedup();
        let state = sittings.last().map_or(State::Open, |sitting| sitting.state);
        let finished = fits && course.is_done();
        if state == State::Finished && !finished {
            let text =
                format!("expected {planned} trials of {name}, who had finished, found {}", distinct.len());
            findings.push(Finding::new(Kind::Gap, file, text));
        } else if !finished && !in_use && fits {
            let text = format!(
                "{name} has finished {} of {planned} trials; `study run … --participant {name} --resume` goes on",
                distinct.len()
            );
            findings.push(Finding::new(Kind::Incomplete, file, text));
        }
        people.push(Participant {
            participant: name.to_owned(),
            trials: distinct.len(),
            planned,
            finished,
            parts: sittings.len(),
            state,
            input: input.to_owned(),
        });
        if finished {
            // How an earlier part ended is no longer of interest.
            let own = |finding: &&mut Finding| sittings.iter().any(|sitting| sitting.file == finding.file);
            for finding in findings.iter_mut().filter(own).filter(|one| one.kind == Kind::Incomplete) {
                finding.kind = Kind::Note;
                finding.text += " (everything was done later)";
            }
        }
    }
    people
}

/// Names that mean the same person: P7, P07 and p07.
fn twins(people: &[Participant], findings: &mut Vec<Finding>) {
    let plain = |name: &str| {
        let lower = name.to_ascii_lowercase();
        let digits = lower.len() - lower.trim_end_matches(|c: char| c.is_ascii_digit()).len();
        let (word, number) = lower.split_at(lower.len() - digits);
        let (word, number) = (word.trim_end_matches(['-', '_']), number.trim_start_matches('0'));
        format!("{word}{number}")
    };
    let mut seen: BTreeMap<String, &str> = BTreeMap::new();
    for one in people {
        if let Some(other) = seen.insert(plain(&one.participant), &one.participant) {
            let text =
                format!("{other} and {} may be the same person, and have the same order", one.participant);
            findings.push(Finding::new(Kind::Duplicate, MANIFEST, text));
        }
    }
}

/// The same movements under two names.
fn copies(logs: &[(&Sitting, SessionLog)], findings: &mut Vec<Finding>) {
    let movement = |record: &Record| {
        let trial = &record.trial;
        (trial.end.map(f64::to_bits), trial.mt_s.to_bits(), trial.start.map(|p| p.map(f64::to_bits)))
    };
    let mut seen: BTreeMap<_, usize> = BTreeMap::new();
    let mut shared: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    for (place, (_, log)) in logs.iter().enumerate() {
        for record in &log.records {
            let first = *seen.entry(movement(record)).or_insert(place);
            if first != place {
                *shared.entry((first, place)).or_default() += 1;
            }
        }
    }
    for ((first, second), count) in shared {
        let fewer = logs[first].1.records.len().min(logs[second].1.records.len()).max(1);
        // One movement may be like another by chance.
        if count > 1 && count as f64 / fewer as f64 > COPIED_SHARE {
            let text = format!("{count} of its trials are also in {}: it is a copy", logs[first].0.file);
            findings.push(Finding::new(Kind::Copied, &logs[second].0.file, text));
        }
    }
}
