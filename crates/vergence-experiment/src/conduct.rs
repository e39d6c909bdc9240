//! One sitting of one participant: course and journal together.

use vergence_study::Study;
use vergence_time::{Span, Timestamp};

use crate::course::{Course, Reading, Step};
use crate::error::Error;
use crate::folder::{Folder, Lock, State};
use crate::journal::{About, Journal};
use crate::metronome::Metronome;

/// A clock that went back goes on so long behind its latest instant: longer than any movement survives.
const BEHIND: Span = Span::from_millis(1000);

/// How a sitting ended.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Ended {
    /// Pseudonym.
    pub participant: String,
    /// The log's file.
    pub log: std::path::PathBuf,
    /// Trials that this sitting has added.
    pub trials: u64,
    /// Trials of the plan that are behind now, and all of them.
    pub progress: (usize, usize),
    /// Everything is done.
    pub finished: bool,
    /// Why it ended before.
    pub why: Option<String>,
    /// Movements that had to be made again.
    pub interrupted: u64,
    /// How long trials waited for the disk: median and longest, milliseconds.
    pub disk_ms: (f64, f64),
}

/// A sitting in progress. Where it is dropped without [`Conduct::finish`], the folder knows that it did not end well.
#[derive(Debug)]
pub struct Conduct {
    folder: Folder,
    _lock: Lock,
    journal: Journal,
    course: Course,
    file: String,
    participant: String,
    offset_ns: i64,
    latest: Timestamp,
    interrupted: u64,
    metronome: Option<Metronome>,
    /// Of the clicks that are heard now, seconds.
    period_s: Option<f64>,
}

impl Conduct {
    /// Begins, or with `resume` goes on with the next trial. `about` says participant, device, clock and conventions; what
    /// the folder and the study know is filled in. `flat`: on a screen.
    ///
    /// # Errors
    /// As the participant's state demands: they have begun, have not, or have done everything; or somebody else writes.
    pub fn begin(mut folder: Folder, mut about: About, resume: bool, flat: bool) -> Result<Self, Error> {
        let mut course = Course::new(folder.study(), &about.participant);
        about.length_unit = course.length_unit().to_owned();
        about.dimensions = course.dimensions(flat);
        about.conventions.difficulty = folder.study().difficulty();
        let participant = about.participant.clone();
        let (lock, mut journal, records) = folder.begin(&mut about, resume)?;
        let file = format!("{participant}.{}.mcap", about.part);
        if let Err(error) = course.resume(&records) {
            drop(journal);
            folder.end(&file, State::Stopped, "its earlier logs do not fit together")?;
            return Err(error);
        }
        if resume {
            let text = format!("after {} trials", records.len());
            journal.event(Timestamp::default(), "resumed", &text);
        }
        Ok(Self {
            folder,
            _lock: lock,
            journal,
            course,
            file,
            participant,
            offset_ns: 0,
            latest: Timestamp::default(),
            interrupted: 0,
            metronome: None,
            period_s: None,
        })
    }

    /// Lets the participant hear this: while there is somewhere to go, at the pace that the instruction asks for.
    #[must_use]
    pub fn with_metronome(self, metronome: Option<Metronome>) -> Self {
        Self { metronome, ..self }
    }

    /// What happens next.
    pub fn course(&self) -> &Course {
        &self.course
    }

    /// Pseudonym.
    pub fn participant(&self) -> &str {
        &self.participant
    }

    /// Trials that this sitting has added so far.
    pub fn written(&self) -> u64 {
        self.journal.written()
    }

    /// Whether this sitting is over before everything is done: as many trials as were asked for, or all of its session.
    pub fn is_enough(&self, most_trials: Option<u64>) -> bool {
        most_trials.is_some_and(|most| self.written() >= most) || self.is_session_done()
    }

    /// Why, in words.
    pub fn why_enough(&self) -> String {
        if self.is_session_done() {
            "this session is done: --resume begins the next".to_owned()
        } else {
            "as many trials as were asked for".to_owned()
        }
    }

    fn is_session_done(&self) -> bool {
        self.written() > 0 && self.course.is_between_sessions()
    }

    /// The study.
    pub fn study(&self) -> &Study {
        self.course.study()
    }

    /// Follows one reading. A trial that ends by it is on the disk when this returns.
    ///
    /// # Errors
    /// Where the trial could not be written: it does not count, and the sitting is over.
    pub fn follow(&mut self, reading: &Reading) -> Result<Step, Error> {
        let mut at = reading.at.saturating_add(Span::from_nanos(self.offset_ns));
        if at < self.latest {
            // A session that was made anew counts from its own beginning.
            let next = self.latest.saturating_add(BEHIND);
            self.offset_ns = self.offset_ns.saturating_add(next.as_nanos().saturating_sub(at.as_nanos()));
            self.journal.event(self.latest, "clock_went_back", "");
            at = next;
        }
        self.latest = at;
        let mut step = self.course.follow(&Reading { at, ..*reading });
        match &mut step {
            Step::Trial(record) => self.journal.trial(record)?,
            Step::Interrupted(why) => {
                self.interrupted += 1;
                self.journal.event(at, "interrupted", why);
            }
            Step::Began | Step::Nothing => {}
        }
        self.keep_time()?;
        Ok(step)
    }

    fn keep_time(&mut self) -> Result<(), Error> {
        let Some(metronome) = &self.metronome else { return Ok(()) };
        let goal = self.course.goal();
        let pace = goal.and_then(|_| self.course.instruction()?.metronome);
        let period_s = goal.zip(pace).map(|(goal, pace)| pace * goal.predicted_s);
        metronome.set(period_s)?;
        if self.period_s != period_s {
            self.period_s = period_s;
            let text = period_s.map_or_else(|| "silent".to_owned(), |s| format!("every {:.1} ms", 1e3 * s));
            self.journal.event(self.latest, "metronome", &text);
        }
        Ok(())
    }

    /// Writes down that something happened to the device.
    pub fn happened(&mut self, name: &'static str, text: &str) {
        self.journal.event(self.latest, name, text);
    }

    /// Ends the sitting; `why` where that is before everything was done.
    ///
    /// # Errors
    /// Where log or manifest cannot be written to their end. Trials are safe all the same.
    pub fn finish(self, why: Option<&str>) -> Result<Ended, Error> {
        let Self { mut folder, _lock, journal, course, file, participant, latest, interrupted, .. } = self;
        let finished = course.is_done();
        let why = if finished { None } else { Some(why.unwrap_or("stopped").to_owned()) };
        let (trials, disk_ms, log) = (journal.written(), journal.waited_ms(), journal.path().to_owned());
        let ended = journal.finish(latest, why.as_deref());
        let state = if finished { State::Finished } else { State::Stopped };
        folder.end(&file, state, why.as_deref().unwrap_or(""))?;
        ended?;
        Ok(Ended {
            participant,
            log,
            trials,
            progress: course.progress(),
            finished,
            why,
            interrupted,
            disk_ms,
        })
    }
}
