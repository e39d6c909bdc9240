//! `vergence slam run`: follows a recording and writes where the rig was.

use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;
use vergence_session::RigLog;
use vergence_slam::dataset::{Calibration, Dataset, Opening, holes, say_holes};
use vergence_slam::follower::Follower;
use vergence_slam::playback::{Mode, Playback, z_up};
use vergence_slam::trajectory::Trajectory;
use vergence_slam::{Estimate, State, states};
use vergence_time::Timestamp;

use crate::devices::interrupted;
use crate::failure::Failure;
use crate::slam::knobs::Config;
use crate::timing;

/// Follows a recording: a causal pose for each frame, in a world with gravity along −z
///
/// The first pose comes with the first frame; poses are provisional until gravity and (with one camera) depth are known. The same
/// recording gives the same bits, whatever the number of threads. Ctrl-C ends it: what was followed is written.
#[derive(clap::Args)]
#[command(after_long_help = Config::help())]
pub struct Args {
    /// A EuRoC (ASL) folder, a 7-Scenes folder (pictures in PNG or JPEG), or a session log (.mcap) of a rig, as `log import euroc` writes it
    dataset: PathBuf,
    /// Kalibr's files in the place of the folder's sensor.yaml: camchain-imucam.yaml, and with an inertial unit its imu.yaml as a second
    /// `--calibration`; the time shift between cameras and unit is taken from there, too
    #[arg(long, value_name = "FILE.yaml")]
    calibration: Vec<PathBuf>,
    /// Which sensors take part
    #[arg(long, value_enum, default_value_t = Sensors::StereoInertial)]
    mode: Sensors,
    /// Knobs of the tracker and the estimator (TOML); what is missing there keeps its default, as below
    #[arg(long, value_name = "F.toml")]
    config: Option<PathBuf>,
    /// The poses, TUM format: of the inertial unit in a EuRoC folder, of the camera in a 7-Scenes folder
    #[arg(short, long, value_name = "TRAJ.tum")]
    output: PathBuf,
    /// How far each pose can be trusted (CSV): time, state, standard deviations of position and rotation since the start, points seen,
    /// points thrown away, keyframe, map (another one after it was lost), what is left over in pixels; `slam eval --states` takes it
    #[arg(long, value_name = "F.csv")]
    states: Option<PathBuf>,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
    /// With 2 or more, pictures are decoded ahead on a thread of its own; the poses are the same
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=64))]
    threads: u32,
}

/// Which sensors take part.
#[derive(Clone, Copy, clap::ValueEnum)]
pub enum Sensors {
    /// All cameras and the inertial unit
    StereoInertial,
    /// All cameras
    Stereo,
    /// The first camera and the inertial unit
    MonoInertial,
    /// The first camera: scale is a guess
    Mono,
    /// The first camera and its depth
    Rgbd,
}

impl Sensors {
    /// Of the library.
    pub fn mode(self) -> Mode {
        match self {
            Self::StereoInertial => Mode::StereoInertial,
            Self::Stereo => Mode::Stereo,
            Self::MonoInertial => Mode::MonoInertial,
            Self::Mono => Mode::Mono,
            Self::Rgbd => Mode::Rgbd,
        }
    }
}

/// What a run gave.
pub struct Outcome {
    /// One for each frame.
    pub estimates: Vec<Estimate>,
    /// CPU time of each frame without decoding, ms.
    pub cpu_ms: Vec<f64>,
}

impl Outcome {
    /// The poses, z up.
    pub fn trajectory(&self) -> Trajectory {
        let poses = self.estimates.iter().map(|e| (e.time, z_up(&e.world_from_body))).collect();
        Trajectory { poses }
    }

    /// What a user should know before believing the poses.
    fn doubts(&self) -> Vec<String> {
        let frames = self.estimates.len();
        let disagreeing = self.count(|state| state == State::Disagreeing);
        let blind = self.count(|state| state == State::FindingCorners);
        let say = |count: usize, state: State| format!("{count} of {frames} frames: {}", state.says());
        let mut all = Vec::new();
        // A moment is no reason to doubt the whole.
        if disagreeing * 20 > frames {
            all.push(say(disagreeing, State::Disagreeing));
        }
        if blind * 2 > frames {
            all.push(say(blind, State::FindingCorners));
        }
        if let Some(maps) = self.estimates.last().map(|last| last.map).filter(|maps| *maps > 0) {
            let first = self.estimates.iter().find(|estimate| estimate.map > 0);
            let begins = self.estimates.first().zip(first).and_then(|(a, b)| b.time.since(a.time));
            all.push(format!(
                "{maps} new map{} begun after it was lost, the first after {:.3} s: where it lies beside the one before is a guess",
                if maps == 1 { " was" } else { "s were" },
                begins.map_or(0.0, |span| span.as_secs_f64())
            ));
        }
        all
    }

    /// How many frames have each state, by its word; of those that any has.
    fn by_state(&self) -> serde_json::Map<String, serde_json::Value> {
        let counted = State::ALL.into_iter().map(|state| (state.word(), self.count(|other| other == state)));
        counted.filter(|(_, count)| *count > 0).map(|(word, count)| (word.to_owned(), count.into())).collect()
    }

    /// How many frames have such a state.
    pub fn count(&self, is: impl Fn(State) -> bool) -> usize {
        self.estimates.iter().filter(|e| is(e.state)).count()
    }

    /// A share of the frames took no longer than this, ms.
    pub fn quantile_ms(&self, share: f64) -> f64 {
        let mut sorted = self.cpu_ms.clone();
        sorted.sort_by(f64::total_cmp);
        let at = (share * sorted.len().saturating_sub(1) as f64).round() as usize;
        sorted.get(at).copied().unwrap_or(0.0)
    }
}

/// Plays a recording to its end, or until `stop`.
pub fn play(
    dataset: &Dataset,
    mode: Mode,
    config: &Config,
    threads: u32,
    bar: &ProgressBar,
    stop: &AtomicBool,
) -> Result<Outcome, Failure> {
    let (knobs, params) = config.resolve()?;
    let failed = |error: vergence_slam::Error| Failure::work(&error);
    let reduce = config.reduce.unwrap_or(1);
    let mut playback =
        Playback::reduced(dataset, mode, knobs, params, reduce).map_err(|error| Failure::call(&error))?;
    let mut outcome = Outcome { estimates: Vec::new(), cpu_ms: Vec::new() };
    let frames = dataset.frames.len();
    let mut follow = |frame: usize, loaded: &_| -> Result<(), Failure> {
        let before = timing::thread_cpu_ns();
        let estimate = playback.follow(frame, loaded).map_err(failed)?;
        outcome.cpu_ms.push((timing::thread_cpu_ns() - before) * 1e-6);
        outcome.estimates.push(estimate);
        bar.inc(1);
        Ok(())
    };
    if threads < 2 {
        for frame in (0..frames).take_while(|_| !stop.load(Ordering::Relaxed)) {
            follow(frame, &Playback::load(dataset, mode, frame).map_err(failed)?)?;
        }
    } else {
        std::thread::scope(|scope| {
            let (give, take) = std::sync::mpsc::sync_channel(2);
            scope.spawn(move || {
                for frame in 0..frames {
                    // The receiver has gone: a frame could not be followed.
                    if give.send(Playback::load(dataset, mode, frame)).is_err() {
                        break;
                    }
                }
            });
            for (frame, loaded) in take.iter().enumerate().take_while(|_| !stop.load(Ordering::Relaxed)) {
                follow(frame, &loaded.map_err(failed)?)?;
            }
            Ok(())
        })?;
    }
    Ok(outcome)
}

/// Plays a log to its end; says how many frames it had, and what is to be said of it.
fn play_log(
    log: &RigLog,
    mode: Mode,
    config: &Config,
    bar: &ProgressBar,
    stop: &AtomicBool,
) -> Result<(Outcome, u64, Vec<String>), Failure> {
    let (knobs, params) = config.resolve()?;
    let reduce = config.reduce.unwrap_or(1);
    let follower = Follower::new(log.path(), &log.rig, mode, knobs, params, reduce)
        .map_err(|error| Failure::call(&error))?
        .pairing_within(config.pair_within()?);
    let mut outcome = Outcome { estimates: Vec::new(), cpu_ms: Vec::new() };
    let follower = log
        .follow(follower, |follower| {
            loop {
                let before = timing::thread_cpu_ns();
                let Some(estimate) = follower.follow()? else { return Ok(!stop.load(Ordering::Relaxed)) };
                outcome.cpu_ms.push((timing::thread_cpu_ns() - before) * 1e-6);
                outcome.estimates.push(estimate);
                bar.inc(1);
            }
        })
        .map_err(|error| Failure::work(&error))?;
    let frames = outcome.estimates.len() as u64 + follower.incomplete();
    let mut doubts = Vec::new();
    if follower.incomplete() > 0 {
        doubts.push(format!(
            "{} of {frames} instants lack a picture of a camera within {} ms: left out",
            follower.incomplete(),
            config.pair_within()?.as_millis_f64()
        ));
    }
    let begins = outcome.estimates.first().map_or(Timestamp::default(), |estimate| estimate.time);
    let times = outcome.estimates.iter().map(|estimate| estimate.time);
    doubts.extend(say_holes("pictures", &holes(times), begins));
    Ok((outcome, frames, doubts))
}

/// Largest memory of this process so far, MB; 0 where the system does not say.
fn peak_rss_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kilobytes = line.and_then(|l| l.split_whitespace().next()).and_then(|n| n.parse::<f64>().ok());
    kilobytes.unwrap_or(0.0) / 1e3
}

impl Args {
    /// The files that are written, opened before any work is done: none of them the other one, nor one of the recording's.
    fn outputs(&self) -> Result<(BufWriter<File>, Option<File>), Failure> {
        let read = [std::slice::from_ref(&self.dataset), &self.calibration, self.config.as_slice()].concat();
        Failure::unless_own("--output", &self.output, &read)?;
        for (option, path) in [("--output", Some(&self.output)), ("--states", self.states.as_ref())] {
            let Some(path) = path else { continue };
            let inside = path.canonicalize().ok().zip(self.dataset.canonicalize().ok());
            if inside.is_some_and(|(file, folder)| file.starts_with(folder)) {
                let path = path.display();
                return Err(Failure::Call(format!(
                    "{option}: expected a file beside the recording's, found {path}, one of them"
                )));
            }
        }
        if self.states.as_ref().is_some_and(|states| states == &self.output) {
            let path = self.output.display();
            return Err(Failure::Call(format!(
                "--states: expected another file than --output, found {path}"
            )));
        }
        let create = |path: &PathBuf| File::create(path).map_err(|error| Failure::unwritable(path, &error));
        let poses = BufWriter::new(create(&self.output)?);
        if let Some(states) = &self.states {
            // The same file under another name.
            Failure::unless_own(
                "--states",
                states,
                &[&read[..], std::slice::from_ref(&self.output)].concat(),
            )?;
        }
        Ok((poses, self.states.as_ref().map(create).transpose()?))
    }

    /// Follows the recording, writes the poses, says how it went.
    pub fn run(self) -> Result<(), Failure> {
        let config = self.config.as_deref().map_or(Ok(Config::default()), Config::read)?;
        let mode = self.mode.mode();
        let bar = |frames: Option<u64>| {
            let bar = frames.map_or_else(ProgressBar::new_spinner, ProgressBar::new);
            let shown = if frames.is_some() {
                "{bar:40} {pos}/{len} frames, {eta}"
            } else {
                "{spinner} {pos} frames"
            };
            if let Ok(style) = ProgressStyle::with_template(shown) {
                bar.set_style(style);
            }
            bar
        };
        let stop = interrupted()?;
        let (mut poses, mut states) = self.outputs()?;
        let mut warnings = Vec::new();
        let (outcome, frames) = if RigLog::is_log(&self.dataset) {
            if !self.calibration.is_empty() {
                let name = self.dataset.display();
                return Err(Failure::Call(format!(
                    "{name}: expected a folder for --calibration, found a log"
                )));
            }
            let mut log = RigLog::open(&self.dataset).map_err(|error| Failure::work(&error))?;
            config.apply(log.rig.inertial.as_mut().map(|(unit, _)| unit));
            let bar = bar(None);
            let played = play_log(&log, mode, &config, &bar, &stop)?;
            bar.finish_and_clear();
            let (outcome, frames, doubts) = played;
            warnings.extend(doubts);
            (outcome, frames)
        } else {
            let calibration = Some(&self.calibration).filter(|files| !files.is_empty());
            let calibration = calibration.map(|files| Calibration::kalibr(files)).transpose();
            let calibration = calibration.map_err(|error| Failure::work(&error))?;
            let opening = Opening { calibration: calibration.as_ref(), pair_within: config.pair_within()? };
            let dataset = Dataset::open_as(&self.dataset, &opening);
            let mut dataset = dataset.map_err(|error| Failure::work(&error))?;
            config.apply(dataset.inertial.as_mut().map(|recording| &mut recording.unit));
            warnings.extend(dataset.doubts(mode.inertial()));
            let bar = bar(Some(dataset.frames.len() as u64));
            let outcome = play(&dataset, mode, &config, self.threads, &bar, &stop)?;
            bar.finish_and_clear();
            (outcome, dataset.pictures[0] as u64)
        };
        let failed = |path: &Path, error: std::io::Error| Failure::unwritable(path, &error);
        outcome.trajectory().write_tum(&mut poses).map_err(|error| failed(&self.output, error))?;
        poses.flush().map_err(|error| failed(&self.output, error))?;
        if let Some((file, path)) = states.as_mut().zip(self.states.as_deref()) {
            states::write(&outcome.estimates, BufWriter::new(file)).map_err(|error| failed(path, error))?;
        }
        if stop.load(Ordering::Relaxed) {
            warnings.push(format!("ended after {} of {frames} frames, as asked", outcome.estimates.len()));
        }
        warnings.extend(outcome.doubts());
        for warning in &warnings {
            eprintln!("vergence: {warning}");
        }
        let provisional = outcome.count(|s| !matches!(s, State::Tracked | State::Coasting | State::Lost));
        let (lost, coasting) = (outcome.count(|s| s == State::Lost), outcome.count(|s| s == State::Coasting));
        let keyframes = outcome.estimates.iter().filter(|e| e.keyframe).count();
        let (median, p95) = (outcome.quantile_ms(0.5), outcome.quantile_ms(0.95));
        let last = outcome.estimates.last().map_or(State::Waiting, |e| e.state);
        if self.json {
            let object = json!({
                "frames": frames,
                "poses": outcome.estimates.len(),
                "provisional_frames": provisional,
                "coasting_frames": coasting,
                "lost_frames": lost,
                "keyframes": keyframes,
                "cpu_ms_per_frame": { "median": median, "p95": p95, "max": outcome.quantile_ms(1.0) },
                "peak_rss_mb": peak_rss_mb(),
                "disagreeing_frames": outcome.count(|s| s == State::Disagreeing),
                "frames_by_state": outcome.by_state(),
                "maps": outcome.estimates.last().map_or(0, |estimate| estimate.map + 1),
                "state": last.word(),
                "says": last.says(),
                "warnings": warnings,
            });
            println!("{object}");
        } else {
            println!(
                "{} poses of {} frames: {provisional} provisional, {coasting} by the inertial unit alone, {lost} lost; {keyframes} keyframes",
                outcome.estimates.len(),
                frames
            );
            println!(
                "{median:.1} ms of CPU per frame without decoding (p95 {p95:.1}), {:.0} MB at most",
                peak_rss_mb()
            );
            println!("at the end: {}", last.says());
        }
        Ok(())
    }
}
