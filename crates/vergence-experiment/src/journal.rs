//! The log of one sitting, written trial by trial.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use vergence_log::{Header, Options, Recorder, Stream, StreamDesc, Times};
use vergence_sense::Event;
use vergence_study::Conventions;
use vergence_time::Timestamp;

use crate::date::wall_ns;
use crate::error::Error;
use crate::record::Record;

/// Streams of a study's log.
pub(crate) const TRIALS: &str = "/study/trials";
pub(crate) const EVENTS: &str = "/study/events";
/// The event that ends the log of a participant who has done everything, and that of one who has not.
pub(crate) const FINISHED: &str = "finished";
pub(crate) const STOPPED: &str = "stopped";

/// What a log says of itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct About {
    /// Who recorded, with version.
    pub application: String,
    /// Pseudonym.
    pub participant: String,
    /// Sitting, as in its trials.
    pub session: String,
    /// 1, and one more each time that it went on after an interruption.
    pub part: u32,
    /// Name of the study.
    pub study: String,
    /// The study file.
    pub study_file: String,
    /// Its hash, `blake3:…`.
    pub study_hash: String,
    /// `m`, `px`, `mm` or `rad`.
    pub length_unit: String,
    /// 1, 2 or 3.
    pub dimensions: usize,
    /// `openxr: NAME`, `simulated: NAME`, `desktop: …`; what is known of the device.
    pub headset: String,
    /// `mouse`, `controller`, `hand`, `gaze`, `simulated:SEED`.
    pub input: String,
    /// `virtual` or `monotonic`.
    pub clock: String,
    /// Under which measures are computed where nothing else is asked for.
    pub conventions: Conventions,
    /// Anything more, by name.
    pub notes: BTreeMap<String, String>,
}

/// The hash of a study file as logs and manifests name it.
pub(crate) fn hash_of(bytes: &[u8]) -> String {
    format!("blake3:{}", blake3::hash(bytes))
}

impl About {
    fn header(&self) -> Header {
        let mut notes = self.notes.clone();
        for (key, value) in [
            ("study", self.study.clone()),
            ("study_hash", self.study_hash.clone()),
            ("participant", self.participant.clone()),
            ("session", self.session.clone()),
            ("part", self.part.to_string()),
            ("length_unit", self.length_unit.clone()),
            ("dimensions", self.dimensions.to_string()),
            ("input", self.input.clone()),
        ] {
            notes.insert(key.to_owned(), value);
        }
        for (knob, value) in self.conventions.listed() {
            notes.insert(format!("convention.{knob}"), value);
        }
        Header {
            application: self.application.clone(),
            headset: self.headset.clone(),
            clock: self.clock.clone(),
            configuration: self.study_file.clone(),
            notes,
            ..Header::default()
        }
    }

    pub(crate) fn of(header: &Header) -> Result<Self, Error> {
        let mut notes = header.notes.clone();
        let mut take = |key: &str| notes.remove(key).unwrap_or_default();
        let mut about = Self {
            application: header.application.clone(),
            headset: header.headset.clone(),
            clock: header.clock.clone(),
            study_file: header.configuration.clone(),
            study: take("study"),
            study_hash: take("study_hash"),
            participant: take("participant"),
            session: take("session"),
            part: take("part").parse().unwrap_or(1),
            length_unit: take("length_unit"),
            dimensions: take("dimensions").parse().unwrap_or(3),
            input: take("input"),
            ..Self::default()
        };
        for (knob, value) in &notes {
            if let Some(knob) = knob.strip_prefix("convention.") {
                about.conventions.set(knob, value)?;
            }
        }
        notes.retain(|knob, _| !knob.starts_with("convention."));
        Ok(Self { notes, ..about })
    }
}

/// A log in progress.
#[derive(Debug)]
pub struct Journal {
    recorder: Recorder,
    trials: Stream<Record>,
    events: Stream<Event>,
    written: u64,
    waits: Vec<Duration>,
}

impl Journal {
    /// Begins the log at `path`; one that is there is not replaced.
    ///
    /// # Errors
    /// Where it is there, or cannot be made.
    pub fn create(path: &Path, about: &About) -> Result<Self, Error> {
        if path.exists() {
            return Err(Error::Call(format!("expected no {} yet, found one", path.display())));
        }
        let mut recorder = Recorder::create(path, &about.header(), &Options::default())?;
        let trials = recorder.stream(&StreamDesc::new(TRIALS).unit(about.length_unit.clone()))?;
        let events = recorder.stream(&StreamDesc::new(EVENTS))?;
        let journal = Self { recorder, trials, events, written: 0, waits: Vec::with_capacity(1024) };
        journal.recorder.sync()?;
        Ok(journal)
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        self.recorder.path()
    }

    /// Writes a trial that has ended and waits until it is on the disk.
    ///
    /// # Errors
    /// Where it is not: the trial does not count, and the log is whole up to the one before.
    pub fn trial(&mut self, record: &mut Record) -> Result<(), Error> {
        record.wall_ns = wall_ns();
        let mt = vergence_time::Span::from_secs_f64(record.trial.mt_s).unwrap_or(vergence_time::Span::ZERO);
        let ended = record.began.saturating_add(mt);
        self.put(ended, record);
        let asked = Instant::now();
        self.recorder.sync()?;
        self.waits.push(asked.elapsed());
        // The disk may be well, and the trial all the same too large for the way to it.
        if self.recorder.status().dropped > 0 {
            return Err(Error::Damaged {
                path: self.path().to_owned(),
                expected: "room for a trial".to_owned(),
                found: format!("none for one of {} samples of the cursor", record.trial.samples.len()),
            });
        }
        self.written += 1;
        Ok(())
    }

    pub(crate) fn put(&mut self, ended: Timestamp, record: &Record) {
        self.recorder.write(&self.trials, Times::at(ended), record);
    }

    /// Waits until all is on the disk.
    pub(crate) fn settle(&mut self) -> Result<(), Error> {
        Ok(self.recorder.sync()?)
    }

    /// Writes that something happened; on the disk with the next trial, or within a second.
    pub fn event(&mut self, at: Timestamp, name: &'static str, text: &str) {
        let event = Event { text: text.to_owned().into(), ..Event::new(name, "") };
        self.recorder.write(&self.events, Times::at(at), &event);
    }

    /// Trials that are on the disk.
    pub fn written(&self) -> u64 {
        self.written
    }

    /// How long trials waited for the disk: median and longest, milliseconds.
    pub fn waited_ms(&self) -> (f64, f64) {
        let mut sorted = self.waits.clone();
        sorted.sort_unstable();
        let ms = |wait: Option<&Duration>| wait.map_or(0.0, |wait| 1e3 * wait.as_secs_f64());
        (ms(sorted.get(sorted.len() / 2)), ms(sorted.last()))
    }

    /// Ends the log: the participant has done everything, or stopped because of `why`.
    ///
    /// # Errors
    /// Where the end cannot be written; trials are there all the same.
    pub fn finish(mut self, at: Timestamp, stopped: Option<&str>) -> Result<PathBuf, Error> {
        match stopped {
            None => self.event(at, FINISHED, ""),
            Some(why) => self.event(at, STOPPED, why),
        }
        let path = self.path().to_owned();
        self.recorder.finish()?;
        Ok(path)
    }
}
