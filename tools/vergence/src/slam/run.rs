//! `vergence slam run`: follows a recording and writes where the rig was.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;
use vergence_session::RigLog;
use vergence_slam::dataset::Dataset;
use vergence_slam::follower::Follower;
use vergence_slam::playback::{Mode, Playback, z_up};
use vergence_slam::trajectory::Trajectory;
use vergence_slam::{Estimate, Params, State};
use vergence_vision::TrackerKnobs;

use crate::failure::Failure;
use crate::timing;

/// Follows a recording: a causal pose for each frame, in a world with gravity along −z
///
/// The first pose comes with the first frame; poses are provisional until gravity and (with one camera) depth are known. The same
/// recording gives the same bits, whatever the number of threads.
#[derive(clap::Args)]
pub struct Args {
    /// A EuRoC (ASL) folder, a 7-Scenes folder, or a session log (.mcap) of a rig, as `log import euroc` writes it
    dataset: PathBuf,
    /// Which sensors take part
    #[arg(long, value_enum, default_value_t = Sensors::StereoInertial)]
    mode: Sensors,
    /// Knobs of the tracker and the estimator (TOML); what is missing there keeps its default
    #[arg(long, value_name = "F.toml")]
    config: Option<PathBuf>,
    /// The poses, TUM format: of the inertial unit in a EuRoC folder, of the camera in a 7-Scenes folder
    #[arg(short, long, value_name = "TRAJ.tum")]
    output: PathBuf,
    /// How far each pose can be trusted (CSV): time, state, standard deviations of position and rotation since the start, points seen,
    /// points thrown away, keyframe
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

/// A file of knobs.
#[derive(Clone, Debug, Default, serde::Deserialize, serde::Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Pictures are made smaller by this whole number first; pixels below are those of the smaller pictures.
    pub reduce: Option<usize>,
    /// Side of the cells that hold a point each, pixels.
    pub cell_px: Option<usize>,
    /// Points in a cell.
    pub per_cell: Option<usize>,
    /// Levels of the pyramids.
    pub levels: Option<usize>,
    /// Side of the patches, pixels.
    pub window_px: Option<usize>,
    /// FAST's threshold, grey levels.
    pub threshold: Option<u8>,
    /// Standard deviation of a tracked corner, pixels.
    pub pixel_px: Option<f64>,
    /// Factor on the inertial unit's noise.
    pub noise_factor: Option<f64>,
    /// Latest frames that are kept whole.
    pub states: Option<usize>,
    /// Keyframes.
    pub keyframes: Option<usize>,
    /// Steps of the minimisation per frame.
    pub iterations: Option<usize>,
    /// Share of known points below which a frame becomes a keyframe.
    pub known_share: Option<f64>,
}

impl Config {
    fn read(path: &Path) -> Result<Self, Failure> {
        let text = std::fs::read_to_string(path)
            .map_err(|error| Failure::Call(format!("{}: {error}", path.display())))?;
        toml::from_str(&text).map_err(|error| Failure::Call(format!("{}: {error}", path.display())))
    }

    /// The tracker's and the estimator's knobs.
    pub fn resolve(&self) -> Result<(TrackerKnobs, Params), Failure> {
        let (mut knobs, mut params) = (TrackerKnobs::default(), Params::default());
        let set = |into: &mut usize, value: Option<usize>| *into = value.unwrap_or(*into);
        set(&mut knobs.cell_px, self.cell_px);
        set(&mut knobs.per_cell, self.per_cell);
        set(&mut knobs.flow.levels, self.levels);
        set(&mut knobs.flow.window_px, self.window_px);
        knobs.threshold = self.threshold.unwrap_or(knobs.threshold);
        knobs.least_threshold = knobs.least_threshold.min(knobs.threshold);
        set(&mut params.states, self.states);
        set(&mut params.keyframes, self.keyframes);
        set(&mut params.iterations, self.iterations);
        params.pixel_px = self.pixel_px.unwrap_or(params.pixel_px);
        params.noise_factor = self.noise_factor.unwrap_or(params.noise_factor);
        params.known_share = self.known_share.unwrap_or(params.known_share);
        params.checked().map_err(|error| Failure::call(&error))?;
        Ok((knobs, params))
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

    /// A line for each frame.
    fn states(&self) -> String {
        let mut table =
            "#time_ns,state,position_sigma_m,rotation_sigma_rad,seen,thrown_away,keyframe\n".to_owned();
        for e in &self.estimates {
            let (at, state, sigma) = (e.time.as_nanos(), e.state, e.position_sigma_m);
            let (turn, key) = (e.rotation_sigma_rad, u8::from(e.keyframe));
            let _ = writeln!(table, "{at},{state:?},{sigma:.6},{turn:.6},{},{},{key}", e.known, e.outliers);
        }
        table
    }

    fn count(&self, is: impl Fn(State) -> bool) -> usize {
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

/// Plays a recording to its end.
pub fn play(
    dataset: &Dataset,
    mode: Mode,
    config: &Config,
    threads: u32,
    bar: &ProgressBar,
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
        for frame in 0..frames {
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
            for (frame, loaded) in take.iter().enumerate() {
                follow(frame, &loaded.map_err(failed)?)?;
            }
            Ok(())
        })?;
    }
    Ok(outcome)
}

/// Plays a log to its end; says how many frames it had.
fn play_log(log: &RigLog, mode: Mode, config: &Config, bar: &ProgressBar) -> Result<(Outcome, u64), Failure> {
    let (knobs, params) = config.resolve()?;
    let reduce = config.reduce.unwrap_or(1);
    let follower = Follower::new(log.path(), &log.rig, mode, knobs, params, reduce)
        .map_err(|error| Failure::call(&error))?;
    let mut outcome = Outcome { estimates: Vec::new(), cpu_ms: Vec::new() };
    let follower = log
        .follow(follower, |follower| {
            loop {
                let before = timing::thread_cpu_ns();
                let Some(estimate) = follower.follow()? else { return Ok(true) };
                outcome.cpu_ms.push((timing::thread_cpu_ns() - before) * 1e-6);
                outcome.estimates.push(estimate);
                bar.inc(1);
            }
        })
        .map_err(|error| Failure::work(&error))?;
    let frames = outcome.estimates.len() as u64 + follower.incomplete();
    Ok((outcome, frames))
}

/// Largest memory of this process so far, MB; 0 where the system does not say.
fn peak_rss_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kilobytes = line.and_then(|l| l.split_whitespace().next()).and_then(|n| n.parse::<f64>().ok());
    kilobytes.unwrap_or(0.0) / 1e3
}

impl Args {
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
        let (outcome, frames) = if RigLog::is_log(&self.dataset) {
            Failure::unless_own("--output", &self.output, std::slice::from_ref(&self.dataset))?;
            let log = RigLog::open(&self.dataset).map_err(|error| Failure::work(&error))?;
            let bar = bar(None);
            let played = play_log(&log, mode, &config, &bar)?;
            bar.finish_and_clear();
            played
        } else {
            let dataset = Dataset::open(&self.dataset).map_err(|error| Failure::work(&error))?;
            let bar = bar(Some(dataset.frames.len() as u64));
            let outcome = play(&dataset, mode, &config, self.threads, &bar)?;
            bar.finish_and_clear();
            (outcome, dataset.frames.len() as u64)
        };
        let file = std::fs::File::create(&self.output)
            .map_err(|error| Failure::Call(format!("{}: {error}", self.output.display())))?;
        outcome
            .trajectory()
            .write_tum(std::io::BufWriter::new(file))
            .map_err(|error| Failure::Work(format!("{}: {error}", self.output.display())))?;
        if let Some(path) = &self.states {
            std::fs::write(path, outcome.states())
                .map_err(|error| Failure::Call(format!("{}: {error}", path.display())))?;
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
                "cpu_ms_per_frame": { "median": median, "p95": p95 },
                "peak_rss_mb": peak_rss_mb(),
                "state": last.says(),
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
