//! `vergence study run`: one sitting of one participant.

use std::path::PathBuf;

use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;
use vergence_experiment::{
    About, Conduct, Desk, Ended, Error, Folder, InHeadset, Input, Metronome, OnDesktop, Sound, check,
    in_headset, on_desktop, window_size,
};
use vergence_session::{
    CaptureConfig, Fault, FaultPlan, Happening, HeadsetChoice, RecordConfig, RecordReport, RunConfig,
    RunReport,
};
use vergence_study::{Conventions, Study};
use vergence_time::Timestamp;

use crate::failure::Failure;
use crate::run::stop_on_signals;

/// Runs a study with one participant
///
/// Every trial is on the disk before the next begins. Who was interrupted, however hard, goes on with --resume. There is no
/// falling back: a headset that is not there is an error.
#[derive(clap::Args)]
pub struct Run {
    /// Study file
    study: PathBuf,
    /// Pseudonym: letters, digits, - and _; the order of conditions follows from it
    #[arg(long, value_name = "NAME")]
    participant: String,
    /// Which headset, or the desktop
    #[arg(long, value_enum)]
    headset: Headset,
    /// mouse, controller, hand, gaze or simulated:SEED [default: controller on openxr, simulated:1 on simulated, mouse on
    /// desktop]
    #[arg(long, value_name = "INPUT")]
    input: Option<Input>,
    /// Goes on with the next trial of a participant who has begun
    #[arg(long)]
    resume: bool,
    /// Folder of the study's data [default: the study file's name with .data in place of .toml]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Ends after so many trials; --resume goes on
    #[arg(long, value_name = "N")]
    most_trials: Option<u64>,
    /// What plays the metronome of an instruction: auto (paplay, else aplay), none, or a program that reads 16-bit samples of
    /// one channel at 48 kHz. Simulated people hear it without
    #[arg(long, value_name = "auto|none|PROGRAM", default_value_t = Sound::Found)]
    sound: Sound,
    /// Desktop: pixels per inch of the screen, so that sizes are as the study says
    #[arg(long, value_name = "PIXELS", default_value_t = 96.0)]
    dpi: f64,
    /// Simulated headset: nobody looks (shouldRender is false): nothing is drawn, all else is the same
    #[arg(long)]
    no_pictures: bool,
    /// Simulated headset: default, quest3, index, or a file
    #[arg(long, value_name = "NAME|FILE.toml")]
    profile: Option<String>,
    /// Simulated headset: keeps to the wall clock instead of running as fast as it can
    #[arg(long)]
    real_time: bool,
    /// Simulated headset: what its runtime does wrong, as in xrWaitFrame=ERROR_SESSION_LOST@100, also @100-120 or @100+
    #[arg(long, value_name = "FUNCTION=CODE[@CALL]")]
    fault: Vec<String>,
    /// Simulated headset: its wearer takes it off and puts it on again, seconds of the session, as in 4-6.5
    #[arg(long, value_name = "FROM-TO", value_parser = away)]
    away: Option<(Timestamp, Timestamp)>,
    /// Headset: the display's rate [default: 90 on the simulated headset, else as it is]
    #[arg(long, value_name = "HZ")]
    refresh_rate: Option<f32>,
    /// Headset: samples per pixel
    #[arg(long, value_name = "N", default_value_t = 4)]
    msaa: u32,
    /// Headset: waits for one that is not there yet
    #[arg(long, value_name = "S", default_value_t = 0.0)]
    wait: f64,
    /// Headset: writes stereo pictures, the first and the last and every Nth, into a folder
    #[arg(long, value_name = "DIR")]
    capture: Option<PathBuf>,
    /// Headset: writes every Nth picture
    #[arg(long, value_name = "N", requires = "capture")]
    capture_every: Option<u64>,
    /// Headset: records the whole session (every pose and control) beside the study's own log
    #[arg(long, value_name = "FILE.mcap")]
    record: Option<PathBuf>,
    /// Print one JSON object at the end instead of text
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Headset {
    /// The system's OpenXR runtime
    Openxr,
    /// The simulated one, with a simulated person
    Simulated,
    /// A window on this computer's screen
    Desktop,
}

/// `4-6.5`.
fn away(text: &str) -> Result<(Timestamp, Timestamp), String> {
    let wrong = || format!("expected seconds from and to, as in 4-6.5, found {text:?}");
    let (from, to) = text.split_once('-').ok_or_else(wrong)?;
    let instant = |text: &str| -> Result<Timestamp, String> {
        let seconds = text.trim().parse::<f64>().ok().filter(|s| (0.0..1e6).contains(s)).ok_or_else(wrong)?;
        Ok(Timestamp::from_nanos((seconds * 1e9) as i64))
    };
    let (from, to) = (instant(from)?, instant(to)?);
    if from < to { Ok((from, to)) } else { Err(wrong()) }
}

pub(super) fn failed(error: &Error) -> Failure {
    if error.is_wrong_call() { Failure::call(error) } else { Failure::work(error) }
}

impl Run {
    /// Runs it.
    pub fn run(self) -> Result<(), Failure> {
        let data = self.data.clone().unwrap_or_else(|| self.study.with_extension("data"));
        let input = self.input.clone().unwrap_or(match self.headset {
            Headset::Openxr => Input::Controller,
            Headset::Simulated => Input::Simulated(1),
            Headset::Desktop => Input::Mouse,
        });
        if !self.study.is_file() {
            return Err(Failure::Call(format!("{}: no such study file", self.study.display())));
        }
        let how = InHeadset {
            run: self.config()?,
            input: input.clone(),
            pictures: !self.no_pictures,
            away: self.away,
            most_trials: self.most_trials,
        };
        let desktop = OnDesktop {
            input: input.clone(),
            dpi: self.dpi,
            most_trials: self.most_trials,
            stop: how.run.stop.clone(),
        };
        let is_desktop = self.headset == Headset::Desktop;
        // Before a folder is made, that the study can be done so.
        let text = super::text_of(&self.study)?;
        let study = Study::parse(&self.study, &text).map_err(|error| Failure::Work(error.to_string()))?;
        let checked = if is_desktop { window_size(&study, &desktop).map(drop) } else { check(&study, &how) };
        checked.map_err(|error| failed(&error))?;
        let desk = is_desktop.then(|| Desk::open(&study, &desktop)).transpose();
        let desk = desk.map_err(|error| failed(&error))?;
        let sound = if matches!(input, Input::Simulated(_)) { &Sound::Silent } else { &self.sound };
        let metronome = Metronome::of(&study, sound).map_err(|error| failed(&error))?;
        let mut notes = std::collections::BTreeMap::new();
        if is_desktop {
            notes.insert("dpi".to_owned(), self.dpi.to_string());
        }
        if study.instructions.iter().any(|one| one.metronome.is_some()) {
            notes.insert("sound".to_owned(), sound.to_string());
        }
        let folder = Folder::create(&data, &self.study).map_err(|error| failed(&error))?;
        let headset = match self.headset {
            Headset::Openxr => "openxr",
            Headset::Simulated => "simulated",
            Headset::Desktop => "desktop",
        };
        let about = About {
            application: concat!("vergence ", env!("CARGO_PKG_VERSION")).to_owned(),
            participant: self.participant.clone(),
            headset: headset.to_owned(),
            input: input.to_string(),
            clock: if self.headset == Headset::Simulated && !self.real_time {
                "virtual"
            } else {
                "monotonic"
            }
            .to_owned(),
            conventions: Conventions::default(),
            notes,
            ..About::default()
        };
        stop_on_signals(&how.run.stop)?;
        let conduct =
            Conduct::begin(folder, about, self.resume, is_desktop).map_err(|error| failed(&error))?;
        let conduct = conduct.with_metronome(metronome);
        let bar = bar(conduct.course().progress());
        let shown = bar.clone();
        let mut watch = |happening: Happening<'_>| {
            if let Happening::Said(sentence) = happening {
                shown.suspend(|| eprintln!("{sentence}"));
            }
        };
        let mut progress = |done: usize, _: usize| bar.set_position(done as u64);
        let ran: Result<(Ended, Option<RunReport>), Error> = if let Some(desk) = desk {
            on_desktop(conduct, desk, &desktop, &mut progress).map(|ended| (ended, None))
        } else {
            in_headset(conduct, &how, &mut watch, &mut progress).map(|(ended, report)| (ended, Some(report)))
        };
        bar.finish_and_clear();
        let (ended, report) = ran.map_err(|error| failed(&error))?;
        let recording = report.as_ref().and_then(|report| report.recording.clone());
        if self.json {
            let session = report.map(|report| {
                json!({
                    "headset": report.headset, "frames": report.frames, "paced": report.paced,
                    "seconds": report.seconds, "device": report.device, "warnings": report.warnings,
                    "recording": report.recording,
                })
            });
            let object = json!({
                "participant": ended.participant, "log": ended.log, "trials": ended.trials,
                "done": ended.progress.0, "planned": ended.progress.1, "finished": ended.finished, "why": ended.why,
                "interrupted": ended.interrupted, "disk_ms": {"median": ended.disk_ms.0, "longest": ended.disk_ms.1},
                "session": session,
            });
            println!("{object}");
        } else {
            println!(
                "{}: {} trials, {} of {} done{}; {}",
                ended.participant,
                ended.trials,
                ended.progress.0,
                ended.progress.1,
                ended.why.as_ref().map_or(String::new(), |why| format!(" ({why})")),
                ended.log.display()
            );
        }
        // Trials are safe without it; who asked for a recording of the whole session must know all the same.
        match recording.as_ref().and_then(RecordReport::shortfall) {
            Some(sentence) => Err(Failure::Work(sentence)),
            None => Ok(()),
        }
    }

    fn config(&self) -> Result<RunConfig, Failure> {
        let faults = self.fault.iter().map(|text| Fault::parse(text)).collect::<Result<Vec<_>, _>>();
        let faults = faults.map_err(|error| Failure::call(&error))?;
        let quality = vergence_render::Quality { msaa: self.msaa, ..vergence_render::Quality::default() };
        let is_simulated = self.headset == Headset::Simulated;
        Ok(RunConfig {
            headset: if is_simulated { HeadsetChoice::Simulated } else { HeadsetChoice::OpenXr },
            profile: self.profile.clone(),
            real_time: self.real_time,
            faults: if faults.is_empty() { FaultPlan::default() } else { FaultPlan::new(faults) },
            refresh_rate_hz: self.refresh_rate,
            wait_s: self.wait,
            quality,
            capture: self
                .capture
                .as_ref()
                .map(|dir| CaptureConfig { dir: dir.clone(), every: self.capture_every }),
            record: self.record.as_ref().map(|path| RecordConfig {
                path: path.clone(),
                durable: false,
                hash_frames: Some(false),
                attach_scene: false,
            }),
            ..RunConfig::default()
        })
    }
}

/// Drawn only where stderr is a terminal.
fn bar((done, all): (usize, usize)) -> ProgressBar {
    let bar = ProgressBar::new(all as u64);
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos}/{len} trials, {elapsed}") {
        bar.set_style(style);
    }
    bar.set_position(done as u64);
    bar
}
