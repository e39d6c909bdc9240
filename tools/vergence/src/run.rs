//! `vergence run`: shows a scene on a headset.

use std::path::PathBuf;
use std::sync::Arc;

use indicatif::{ProgressBar, ProgressStyle};
use signal_hook::consts::{SIGINT, SIGTERM};
use vergence_session::{
    CaptureConfig, Fault, FaultPlan, Happening, HeadsetChoice, RecordConfig, RecordReport, RunConfig,
};

use crate::failure::Failure;
use crate::framing;
use crate::loading;
use crate::quality::QualityFile;
use crate::stream::Stream;

/// Seconds that a run takes where nothing else is said.
const DEFAULT_SECONDS: f64 = 10.0;

/// Shows a scene on a headset: a real one where there is one, else the simulated one
#[derive(clap::Args)]
pub struct Args {
    /// A .glb, .gltf, .obj, .ply or scene .toml
    scene: PathBuf,
    /// Which headset
    #[arg(long, value_enum, default_value_t = Headset::Auto)]
    headset: Headset,
    /// Simulated headset: default, quest3, index, or a file
    #[arg(long, value_name = "NAME|FILE.toml")]
    profile: Option<String>,
    /// Simulated headset: how its user moves: still, a motion or script that comes with it (look-around, room1, tour), a
    /// motion or script file, a recorded session, or as our odometry says of a recorded rig (a EuRoC or 7-Scenes folder)
    /// [default: still]. A real headset is moved by its user: there our odometry is kept beside it and compared
    #[arg(long, value_name = "NAME|FILE.toml|FILE.mcap|slam:DATASET")]
    motion: Option<String>,
    /// Simulated headset: distance between the eyes [default: the profile's]
    #[arg(long, value_name = "MM", value_parser = framing::ipd_mm, allow_negative_numbers = true)]
    ipd: Option<f64>,
    /// Simulated headset: what its runtime does wrong, as in xrWaitFrame=ERROR_SESSION_LOST@100, also @100-120 or @100+
    #[arg(long, value_name = "FUNCTION=CODE[@CALL]")]
    fault: Vec<String>,
    /// Simulated headset: keeps to the wall clock instead of running as fast as it can
    #[arg(long)]
    real_time: bool,
    /// Ends after so many frames
    #[arg(long, value_name = "N", conflicts_with = "seconds")]
    frames: Option<u64>,
    /// Ends after so many seconds [default: 10; with --window: never]
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    seconds: Option<f64>,
    /// Waits for a headset that is not there yet
    #[arg(long, value_name = "S", default_value_t = 0.0, allow_negative_numbers = true)]
    wait: f64,
    /// Gives up where no first frame is shown for so long
    #[arg(long, value_name = "S", default_value_t = 60.0, allow_negative_numbers = true)]
    patience: f64,
    /// Mirrors the pictures in a window until it is closed; drag to look, W A S D and Q E to go, right button
    /// or space to take what the dot is on: its frame turns green
    #[arg(long)]
    window: bool,
    /// Writes stereo pictures, the poses they were seen from, and the report into a folder; those of an earlier run
    /// there are replaced
    #[arg(long, value_name = "DIR")]
    capture: Option<PathBuf>,
    /// Writes every Nth picture [default: all of up to 300 frames, else the first and the last]
    #[arg(long, value_name = "N", requires = "capture")]
    capture_every: Option<u64>,
    /// Writes every frame's head and eye poses and angles, as located, a JSON object per line
    #[arg(long, value_name = "FILE")]
    log_poses: Option<PathBuf>,
    /// Records the session; `vergence replay` lives through it again
    #[arg(long, value_name = "FILE.mcap")]
    record: Option<PathBuf>,
    /// Replaces the recording where there is one already
    #[arg(long, requires = "record")]
    overwrite: bool,
    /// Asks the disk to have each part of the recording before the next: as safe from a power cut as from a kill
    #[arg(long, requires = "record")]
    durable: bool,
    /// Hashes every picture, so that a replay can tell whether it draws the same [default: on the simulated headset only]
    #[arg(long, requires = "record", value_name = "BOOL", num_args = 0..=1, default_missing_value = "true")]
    hash_frames: Option<bool>,
    /// Puts the scene's files into the recording
    #[arg(long, requires = "record")]
    attach_scene: bool,
    /// Quality, as `vergence trade render` writes it
    #[arg(long, value_name = "FILE.toml")]
    quality: Option<PathBuf>,
    /// Samples per pixel [default: the quality file's, else 4]
    #[arg(long, value_name = "N")]
    msaa: Option<u32>,
    /// Reads further streams
    #[arg(long, value_delimiter = ',', value_name = "STREAM")]
    with: Vec<Stream>,
    /// The display's rate: one that the headset offers [default: the headset's]
    #[arg(long, value_name = "HZ", allow_negative_numbers = true)]
    refresh_rate: Option<f32>,
    /// Runs under Vulkan validation with synchronization validation; a message is a failure
    #[arg(long)]
    validate: bool,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Headset {
    /// A real runtime with a headset where there is one, else the simulated one
    Auto,
    /// The system's OpenXR runtime
    Openxr,
    /// The simulated one
    Simulated,
}

/// Lets Ctrl-C and a request to terminate end the run as it should; a second one ends the process at once.
pub fn stop_on_signals(stop: &vergence_session::Stop) -> Result<(), Failure> {
    for signal in [SIGINT, SIGTERM] {
        // In this order: a signal that comes while the switch is on already does not wait.
        signal_hook::flag::register_conditional_shutdown(signal, 128 + signal, stop.switch())
            .and_then(|_| signal_hook::flag::register(signal, stop.switch()))
            .map_err(|error| Failure::work(&error))?;
    }
    Ok(())
}

impl Args {
    /// Runs the scene and prints the report.
    pub fn run(self) -> Result<(), Failure> {
        let config = self.config()?;
        let scene = Arc::new(loading::scene(&self.scene)?);
        if let Some(quality) = &self.quality {
            let outputs = [("--log-poses", self.log_poses.as_deref()), ("--record", self.record.as_deref())];
            for (option, path) in outputs {
                let Some(path) = path else { continue };
                Failure::unless_own(option, path, std::slice::from_ref(quality))?;
            }
        }
        if let Some(record) = &self.record {
            Failure::unless_kept(record, self.overwrite)?;
        }
        stop_on_signals(&config.stop)?;
        let bar = self.bar();
        let mut watch = |happening: Happening<'_>| match happening {
            Happening::Said(sentence) => bar.suspend(|| eprintln!("{sentence}")),
            Happening::Frame { shown, seconds } => {
                bar.set_position(self.frames.map_or((seconds * 1e3) as u64, |_| shown));
            }
        };
        let ran = vergence_session::run(&scene, &config, &mut watch);
        bar.finish_and_clear();
        let report =
            ran.map_err(
                |error| {
                    if error.is_wrong_call() { Failure::call(&error) } else { Failure::work(&error) }
                },
            )?;
        if self.json {
            let json = serde_json::to_string(&report).map_err(|error| Failure::work(&error))?;
            println!("{json}");
        } else {
            print!("{report}");
            if let (Some(dir), Some(last)) = (&self.capture, report.pictures.last()) {
                println!("stereo picture {}", dir.join(last).display());
                println!("summary        {}", dir.join("summary.json").display());
            }
        }
        if let Some(count @ 1..) = report.validation_messages {
            return Err(Failure::Work(format!("Vulkan validation: expected no message, found {count}")));
        }
        // The session went on without its recording; who asked for one must know all the same.
        match report.recording.as_ref().and_then(RecordReport::shortfall) {
            Some(sentence) => Err(Failure::Work(sentence)),
            None => Ok(()),
        }
    }

    fn config(&self) -> Result<RunConfig, Failure> {
        let mut quality = vergence_render::Quality::default();
        if let Some(path) = &self.quality {
            let knobs = QualityFile::read(path).map_err(|error| Failure::call(&error))?.quality;
            quality.msaa = knobs.msaa.unwrap_or(quality.msaa);
            quality.anisotropy = knobs.anisotropy.or(quality.anisotropy);
            quality.render_scale = knobs.render_scale.unwrap_or(quality.render_scale);
            quality.normal_maps = knobs.normal_maps.unwrap_or(quality.normal_maps);
        }
        quality.msaa = self.msaa.unwrap_or(quality.msaa);
        let faults = self.fault.iter().map(|text| Fault::parse(text)).collect::<Result<Vec<_>, _>>();
        let faults = faults.map_err(|error| Failure::call(&error))?;
        Ok(RunConfig {
            faults: if faults.is_empty() { FaultPlan::default() } else { FaultPlan::new(faults) },
            headset: match self.headset {
                Headset::Auto => HeadsetChoice::Auto,
                Headset::Openxr => HeadsetChoice::OpenXr,
                Headset::Simulated => HeadsetChoice::Simulated,
            },
            profile: self.profile.clone(),
            motion: self.motion.clone(),
            ipd_m: self.ipd.map(|mm| mm * 1e-3),
            real_time: self.real_time,
            frames: self.frames,
            seconds: self.seconds.or((self.frames.is_none() && !self.window).then_some(DEFAULT_SECONDS)),
            window: self.window,
            wait_s: self.wait,
            patience_s: self.patience,
            quality,
            capture: self
                .capture
                .as_ref()
                .map(|dir| CaptureConfig { dir: dir.clone(), every: self.capture_every }),
            log_poses: self.log_poses.clone(),
            record: self.record.as_ref().map(|path| RecordConfig {
                path: path.clone(),
                durable: self.durable,
                hash_frames: self.hash_frames,
                attach_scene: self.attach_scene,
            }),
            hand_joints: self.with.contains(&Stream::Hands),
            eye_gaze: self.with.contains(&Stream::Gaze),
            refresh_rate_hz: self.refresh_rate,
            validation: self.validate,
            ..RunConfig::default()
        })
    }

    /// Drawn only where stderr is a terminal.
    fn bar(&self) -> ProgressBar {
        let length = self.frames.unwrap_or((self.seconds.unwrap_or(DEFAULT_SECONDS).max(0.0) * 1e3) as u64);
        let bar = ProgressBar::new(length);
        let unit = if self.frames.is_some() { "frames" } else { "ms" };
        if let Ok(style) = ProgressStyle::with_template(&format!("{{bar:40}} {{pos}}/{{len}} {unit}")) {
            bar.set_style(style);
        }
        bar
    }
}
