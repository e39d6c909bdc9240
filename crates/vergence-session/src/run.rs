//! A run: from the plan to the report, through every loss that can be recovered from.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use vergence_plan::{Plan, Requests};
use vergence_scene::Scene;
use vergence_sense::{Event, Said};
use vergence_time::Timestamp;
use vergence_xr::{State, Tap, Without};
use vergence_xr_sim::motion::{HUNG, RUN_ENDED};
use vergence_xr_sim::{PoseProvider, Profile, Replay};

use crate::book::Book;
use crate::capture::Capture;
use crate::config::{HeadsetChoice, RunConfig};
use crate::desk::Desk;
use crate::error::Error;
use crate::frame_loop::{self, End};
use crate::guest::Guest;
use crate::headset::{self, Handed};
use crate::markers::with_markers;
use crate::odometry::{self, Beside};
use crate::own_file::own_file;
use crate::place;
use crate::pose_log::PoseLog;
use crate::report::RunReport;
use crate::tally::Tally;
use crate::verify::{Comparison, Verifier};

/// How long a real runtime is given to come back after it was lost, seconds.
const COME_BACK_S: f64 = 10.0;
/// Notices that the report keeps.
const NOTICES_KEPT: usize = 1000;

/// Something that happened while a scene runs, for whoever shows progress.
#[derive(Clone, Copy, Debug)]
pub enum Happening<'a> {
    /// A sentence for the user.
    Said(&'a str),
    /// A frame was shown.
    Frame {
        /// How many so far.
        shown: u64,
        /// Session time so far, seconds.
        seconds: f64,
    },
}

/// What all sessions of a run share.
pub(crate) struct Run<'a> {
    /// As it was given: what can be pointed at.
    pub(crate) scene: Arc<Scene>,
    /// As it is drawn: with markers, where something can be touched.
    pub(crate) marked: Arc<Scene>,
    pub(crate) plan: Plan,
    pub(crate) start: place::Start,
    pub(crate) config: RunConfig,
    pub(crate) tally: Tally,
    pub(crate) capture: Option<Capture>,
    /// From the first frame on.
    pub(crate) pose_log: Option<PoseLog>,
    /// Whether earlier files were replaced by this run's.
    pub(crate) has_begun: bool,
    pub(crate) desk: Option<Desk>,
    /// What moves the simulated headset, once it is open.
    pub(crate) motion: Option<Arc<dyn PoseProvider>>,
    /// Our odometry beside a real headset, where it is asked for.
    pub(crate) beside: Option<Beside>,
    /// How far session time has come, where a session has run.
    pub(crate) session_time: Option<Timestamp>,
    /// What the session keeps of itself; with the client while one runs.
    pub(crate) book: Option<Box<Book>>,
    /// Whether it was seen to that there is one, where one is asked for: the first session that can be made does.
    pub(crate) has_booked: bool,
    /// A recording that is lived through again.
    pub(crate) again: Option<Again>,
    pub(crate) report: RunReport,
    pub(crate) watch: &'a mut dyn FnMut(Happening<'_>),
    /// Who takes part.
    pub(crate) guest: Option<&'a mut dyn Guest>,
    /// The guest wants the run to end.
    pub(crate) guest_leaves: bool,
}

/// Makes the comparison for a device of this name.
pub(crate) type MakeVerifier = Box<dyn FnOnce(&str) -> Verifier>;

/// What a replay adds to a run.
pub(crate) struct Again {
    /// Moves the simulated headset.
    pub(crate) replay: Replay,
    /// The headset of the recording.
    pub(crate) profile: Profile,
    /// What its runtime lacked.
    pub(crate) without: Without,
    /// Whether pictures are hashed.
    pub(crate) hash: bool,
    /// Makes the comparison once it is known on which device; `None` where none is asked for.
    pub(crate) verifier: Option<MakeVerifier>,
}

impl Run<'_> {
    /// Replaces what an earlier run has written, now that everything that may fail is open.
    pub(crate) fn begin_files(&mut self) -> Result<(), Error> {
        if std::mem::replace(&mut self.has_begun, true) {
            return Ok(());
        }
        if let Some(capture) = &mut self.capture {
            capture.begin()?;
        }
        self.pose_log = self.config.log_poses.as_deref().map(PoseLog::create).transpose()?;
        Ok(())
    }

    /// Says a sentence that the user can act on, and keeps it for the report.
    pub(crate) fn say(&mut self, sentence: &str) {
        (self.watch)(Happening::Said(sentence));
        self.note(sentence);
    }

    /// Says a sentence that the user must know of to trust the result, and keeps it among the report's warnings.
    pub(crate) fn warn(&mut self, sentence: &str) {
        if !self.report.warnings.iter().any(|known| known == sentence) {
            (self.watch)(Happening::Said(sentence));
            self.report.warnings.push(sentence.to_owned());
        }
    }

    /// Keeps for the report what happened without the user's doing.
    pub(crate) fn note(&mut self, sentence: &str) {
        if self.report.notices.len() < NOTICES_KEPT {
            self.report.notices.push(sentence.to_owned());
        } else {
            self.report.notices_left_out += 1;
        }
    }
}

/// Shows `scene` on a headset until the frames or seconds of `config` are over, or the user or the runtime ends it.
///
/// `watch` hears what happens, on this thread, between frames.
///
/// # Errors
/// A call that makes no sense or asks for what the machine cannot give ([`Error::is_wrong_call`]), no headset, a headset
/// that is lost for good, or files that cannot be written.
pub fn run(
    scene: &Arc<Scene>,
    config: &RunConfig,
    watch: &mut dyn FnMut(Happening<'_>),
) -> Result<RunReport, Error> {
    let Lived { report, ended, .. } = whole(scene, config, None, None, watch)?;
    ended.map(|()| report)
}

/// As [`run`], with somebody who takes part: hands are read, and the guest changes what is shown.
///
/// # Errors
/// As [`run`].
pub fn run_with(
    scene: &Arc<Scene>,
    config: &RunConfig,
    guest: &mut dyn Guest,
    watch: &mut dyn FnMut(Happening<'_>),
) -> Result<RunReport, Error> {
    let Lived { report, ended, .. } = whole(scene, config, None, Some(guest), watch)?;
    ended.map(|()| report)
}

/// As [`run`], but what happens is that of a recording; with how it compares, where that is asked for.
pub(crate) fn run_again(
    scene: &Arc<Scene>,
    config: &RunConfig,
    again: Again,
    watch: &mut dyn FnMut(Happening<'_>),
) -> Result<Lived, Error> {
    whole(scene, config, Some(again), None, watch)
}

/// What came of a run.
pub(crate) struct Lived {
    pub(crate) report: RunReport,
    /// How it compares with a recording, where that is asked for.
    pub(crate) comparison: Option<Comparison>,
    /// How it failed, where it did.
    pub(crate) ended: Result<(), Error>,
}

fn whole<'a>(
    scene: &Arc<Scene>,
    config: &RunConfig,
    again: Option<Again>,
    mut guest: Option<&'a mut dyn Guest>,
    watch: &'a mut dyn FnMut(Happening<'_>),
) -> Result<Lived, Error> {
    check(config)?;
    check_outputs(scene, config)?;
    let requests = Requests {
        normal_maps: config.quality.normal_maps,
        hand_joints: config.hand_joints,
        eye_gaze: config.eye_gaze,
        hands: guest.is_some(),
    };
    let capture = config.capture.as_ref().map(|c| Capture::prepare(c, config.frames)).transpose()?;
    let marked = with_markers(scene);
    let mut run = Run {
        scene: Arc::clone(scene),
        plan: Plan::of(&marked, &requests),
        marked,
        start: place::start(scene),
        config: config.clone(),
        tally: Tally::default(),
        capture,
        pose_log: None,
        has_begun: false,
        desk: if config.window { Some(Desk::open()?) } else { None },
        motion: guest.as_mut().and_then(|guest| guest.wearer()),
        beside: None,
        session_time: None,
        book: None,
        has_booked: false,
        again,
        report: RunReport { warnings: scene.warnings.clone(), ..RunReport::default() },
        watch,
        guest,
        guest_leaves: false,
    };
    let result = sessions(&mut run);
    if let Some(book) = &mut run.book {
        let end = match &result {
            Ok(()) => run.report.state.clone(),
            Err(error @ (Error::Headset(vergence_xr::Error::Hung { .. }) | Error::Stalled { .. })) => {
                format!("{HUNG}: {error}")
            }
            Err(error) => format!("failed: {error}"),
        };
        book.hear(&Said::Event(Event { text: end.into(), ..Event::new(RUN_ENDED, "") }));
    }
    // What was written so far is finished also where the run failed: the run's own failure is the one to report.
    let comparison = close_book(&mut run);
    let written = finish(&mut run);
    Ok(Lived { report: run.report, comparison, ended: result.and(written) })
}

/// What the run reads must not be what it writes.
fn check_outputs(scene: &Scene, config: &RunConfig) -> Result<(), Error> {
    let named = [&config.motion, &config.profile].into_iter().flatten().map(PathBuf::from);
    let mut read: Vec<PathBuf> = scene.files.iter().cloned().chain(named).collect();
    let record = config.record.as_ref().map(|record| ("--record", record.path.as_path()));
    let log_poses = config.log_poses.as_deref().map(|path| ("--log-poses", path));
    for (option, path) in [record, log_poses].into_iter().flatten() {
        own_file(option, path, &read)?;
        // The next one must not be this one either.
        read.push(path.to_owned());
    }
    if let Some(capture) = &config.capture {
        for name in Capture::FILES {
            own_file("--capture", &capture.dir.join(name), &read)?;
        }
    }
    Ok(())
}

fn check(config: &RunConfig) -> Result<(), Error> {
    let positive = |name: &str, value: Option<f64>| match value {
        Some(value) if !(value > 0.0 && value.is_finite()) => {
            Err(Error::Call(format!("{name}: expected a positive number, found {value}")))
        }
        _ => Ok(()),
    };
    positive("--seconds", config.seconds)?;
    if !(config.wait_s >= 0.0 && config.wait_s.is_finite()) {
        return Err(Error::Call(format!("--wait: expected 0 or more seconds, found {}", config.wait_s)));
    }
    positive("--patience", Some(config.patience_s))?;
    positive("hang_s", Some(config.hang_s))?;
    positive("--refresh-rate", config.refresh_rate_hz.map(f64::from))?;
    if config.frames == Some(0) {
        return Err(Error::Call("--frames: expected 1 or more, found 0".into()));
    }
    let given = |option: Option<&String>| option.is_some();
    if config.headset == HeadsetChoice::OpenXr && !config.faults.is_empty() {
        return Err(Error::Call("--fault is for the simulated headset: a real runtime has its own".into()));
    }
    if config.headset == HeadsetChoice::OpenXr
        && (config.ipd_m.is_some() || headset::moves_a_head(config) || given(config.profile.as_ref()))
    {
        return Err(Error::Call(
            "--ipd, --motion and --profile are for the simulated headset: on a real runtime the eye poses are the \
             user's own"
                .into(),
        ));
    }
    Ok(())
}

/// One session after the other until one ends by itself.
fn sessions(run: &mut Run<'_>) -> Result<(), Error> {
    loop {
        let lost = match one(run) {
            Ok(End::Over(state)) => {
                run.report.state = state.name().to_owned();
                return Ok(());
            }
            Ok(End::Lost(error)) => error,
            Err(Error::Headset(error)) if error.state() == (State::Lost { retry: true }) => error,
            Err(error) => return Err(error),
        };
        // A call that failed with the loss leaves no time to ask for the state's notice.
        let lost_state = State::Lost { retry: true }.name();
        if run.report.states.last().is_none_or(|last| last != lost_state) {
            run.report.states.push(lost_state.to_owned());
        }
        run.tally.losses += 1;
        run.tally.pause();
        if run.tally.losses > run.config.retries {
            run.report.state = State::Lost { retry: false }.name().to_owned();
            run.say(&format!("{lost}; lost {} times, giving up", run.tally.losses));
            return Err(Error::Headset(lost));
        }
        run.say(&format!("{lost}; asking for it anew"));
        if run.config.stop.is_stopped() {
            run.report.state = lost_state.to_owned();
            return Ok(());
        }
        if run.config.headset == HeadsetChoice::OpenXr {
            std::thread::sleep(Duration::from_secs(1));
        }
    }
}

/// One session, from the headset on.
fn one(run: &mut Run<'_>) -> Result<End, Error> {
    let config = run.config.clone();
    let (watch, notices) = (&mut *run.watch, &mut run.report.notices);
    let by_hand = run.desk.as_ref().map(Desk::user);
    if let Some(capture) = &run.capture {
        capture.continue_at(run.tally.frames);
    }
    let handed = Handed {
        capture: run.capture.as_ref(),
        by_hand,
        again: run.again.as_ref(),
        motion: &mut run.motion,
        odometry: &mut run.report.odometry,
        begins: run.session_time,
    };
    let chosen = headset::choose(&config, &run.plan, handed, &mut |sentence| {
        watch(Happening::Said(sentence));
        notices.push(sentence.to_owned());
    })?;
    run.config.headset = if chosen.is_simulated { HeadsetChoice::Simulated } else { HeadsetChoice::OpenXr };
    if !chosen.is_simulated {
        if let Some(folder) = run.config.motion.as_deref().and_then(odometry::folder) {
            run.beside = Some(Beside::start(folder)?);
        }
        // Neither the recording nor a session after a loss is to know of what was not used.
        run.config.motion = None;
    }
    run.config.wait_s = run.config.wait_s.max(COME_BACK_S);
    if run.report.headset.is_empty() {
        let description = chosen.connection.description();
        let kind = if chosen.is_simulated { "simulated" } else { "openxr" };
        run.report.headset = format!("{kind}: {}", description.headset);
        run.report.why = chosen.why.clone();
        run.report.runtime = description.runtime.clone();
        run.report.api = description.api.clone();
        let sentence = format!("{} ({})", run.report.headset, chosen.why);
        run.say(&sentence);
        if let Some(chosen) = run.start.chosen.clone() {
            run.say(&chosen);
        }
    }
    frame_loop::play(run, &chosen)
}

/// Ends the recording, and says how the session compares with an earlier one.
fn close_book(run: &mut Run<'_>) -> Option<Comparison> {
    let mut book = run.book.take()?;
    if let Some(recording) = book.recording.take() {
        let frame_us = book.cost_us();
        let (status, failure) = recording.close();
        let report = run.report.recording.get_or_insert_default();
        report.frame_us = frame_us;
        let was_said = report.error.is_some();
        report.end(status, failure.as_ref());
        if let Some(sentence) = report.shortfall().filter(|_| !was_said) {
            run.say(&sentence);
        }
    }
    book.verifier.take().map(Verifier::finish)
}

fn finish(run: &mut Run<'_>) -> Result<(), Error> {
    if let Some(beside) = run.beside.take() {
        let (report, failure) = beside.finish();
        run.report.odometry = Some(report);
        if let Some(sentence) = failure {
            run.warn(&sentence);
        }
    }
    let report = &mut run.report;
    report.frames = run.tally.frames;
    report.paced = run.tally.paced;
    report.missed = run.tally.missed;
    report.losses = run.tally.losses;
    report.seconds = run.tally.elapsed().as_secs_f64();
    report.frame_cpu_ms = run.tally.frame_cpu.percentiles();
    report.pose_age_ms = run.tally.pose_age.percentiles();
    let log_written = run.pose_log.take().map_or(Ok(()), PoseLog::finish);
    if let Some(capture) = &mut run.capture {
        report.pictures = capture.finish()?;
        capture.write_summary(report)?;
    }
    log_written
}
