//! `vergence replay`: lives through a recorded session again.

use std::path::PathBuf;
use std::sync::Arc;

use indicatif::{ProgressBar, ProgressStyle};
use vergence_session::{CaptureConfig, Happening, HeadsetChoice, ReplayConfig, SessionLog};

use crate::failure::Failure;
use crate::loading;

/// Lives through a recorded session again: the same client and renderer, on a simulated headset that says what was said
#[derive(clap::Args)]
pub struct Args {
    /// A session that `vergence run --record` wrote
    log: PathBuf,
    /// The scene [default: where it was recorded, else, or where it has changed since, as attached to the log]
    #[arg(long, value_name = "PATH")]
    scene: Option<PathBuf>,
    /// How fast: 1 as recorded, N times as fast, or max
    #[arg(long, value_name = "1|N|max", default_value = "max", value_parser = speed, allow_negative_numbers = true)]
    speed: Speed,
    /// Writes stereo pictures, the poses they were seen from, and the report into a folder
    #[arg(long, value_name = "DIR")]
    capture: Option<PathBuf>,
    /// Compares every call, event, submitted view and picture with the recording; a difference is a failure
    #[arg(long)]
    verify: bool,
    /// On which headset
    #[arg(long, value_enum, default_value_t = Headset::Simulated)]
    headset: Headset,
    /// Runs under Vulkan validation with synchronization validation; a message is a failure
    #[arg(long)]
    validate: bool,
    /// Of a recording without a scene: prints this stream, a line per sample (captured and arrived in ns, values)
    #[arg(long, value_name = "STREAM")]
    print: Option<String>,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Headset {
    /// The one of the recording, simulated
    Simulated,
    /// A real one; refused, since its clock does not follow a recording's
    Openxr,
}

/// As fast as the machine can where there is no number.
#[derive(Clone, Copy, Debug)]
struct Speed(Option<f64>);

fn speed(text: &str) -> Result<Speed, String> {
    if text == "max" {
        return Ok(Speed(None));
    }
    match text.parse::<f64>() {
        Ok(speed) if speed > 0.0 && speed.is_finite() => Ok(Speed(Some(speed))),
        _ => Err("expected max or a positive number".into()),
    }
}

impl Args {
    /// Replays the session and prints how that went.
    pub fn run(self) -> Result<(), Failure> {
        if self.print.is_some() || crate::record::is_of_devices(&self.log) {
            let drawn = [
                ("--verify", self.verify),
                ("--validate", self.validate),
                ("--capture", self.capture.is_some()),
                ("--scene", self.scene.is_some()),
            ];
            if let Some((option, _)) = drawn.iter().find(|(_, given)| *given) {
                let why =
                    if self.print.is_some() { "--print draws nothing" } else { "this one has no scene" };
                return Err(Failure::Call(format!("{option} is for a recording of a scene: {why}")));
            }
            return crate::record::replay(&self.log, self.speed.0, self.print.as_deref(), self.json);
        }
        let failed = |error: vergence_session::Error| {
            if let vergence_session::Error::Log(error) = &error {
                crate::log::failed(error)
            } else if error.is_wrong_call() {
                Failure::call(&error)
            } else {
                Failure::work(&error)
            }
        };
        let headset = match self.headset {
            Headset::Openxr => HeadsetChoice::OpenXr,
            Headset::Simulated => HeadsetChoice::Simulated,
        };
        let log = SessionLog::open(&self.log).map_err(failed)?;
        let unpacked = tempfile::tempdir().map_err(|error| Failure::work(&error))?;
        let scene = match (&self.scene, log.scene_path()) {
            (Some(path), _) => loading::scene(path)?,
            (None, Some(path)) if path.is_file() => {
                let there = loading::scene(path)?;
                let changed = log.check_scene(&there).is_err();
                // What was attached is what was recorded, whatever became of the file since.
                match if changed { log.unpack_scene(unpacked.path()).map_err(failed)? } else { None } {
                    Some(attached) => {
                        eprintln!(
                            "{} is another one by now: taking the scene attached to the log",
                            path.display()
                        );
                        loading::scene(&attached)?
                    }
                    None => there,
                }
            }
            (None, recorded) => match log.unpack_scene(unpacked.path()).map_err(failed)? {
                Some(path) => loading::scene(&path)?,
                None => {
                    let found = recorded.map_or_else(
                        || "a recording without a scene".to_owned(),
                        |path| format!("none at {} and none attached", path.display()),
                    );
                    return Err(Failure::Call(format!(
                        "expected the recorded scene, found {found}: name it with --scene"
                    )));
                }
            },
        };
        let config = ReplayConfig {
            speed: self.speed.0,
            capture: self.capture.as_ref().map(|dir| CaptureConfig { dir: dir.clone(), every: None }),
            verify: self.verify,
            headset,
            validation: self.validate,
        };
        let bar = ProgressBar::new_spinner();
        if let Ok(style) = ProgressStyle::with_template("{spinner} {pos} frames, {per_sec}") {
            bar.set_style(style);
        }
        let mut watch = |happening: Happening<'_>| match happening {
            Happening::Said(sentence) => bar.suspend(|| eprintln!("{sentence}")),
            Happening::Frame { shown, .. } => bar.set_position(shown),
        };
        let replayed = vergence_session::replay(&log, &Arc::new(scene), &config, &mut watch);
        bar.finish_and_clear();
        let report = replayed.map_err(failed)?;
        if self.json {
            println!("{}", serde_json::to_string(&report).map_err(|error| Failure::work(&error))?);
        } else {
            print!("{report}");
        }
        if report.run.paced == 0 {
            return Err(Failure::Work("the recording holds no frame: nothing was replayed".into()));
        }
        if let (Some(damage), true) = (&report.damage, report.comparison.is_equal()) {
            return Err(Failure::Work(format!(
                "the recording is damaged, and was replayed up to there: {damage}"
            )));
        }
        if let (Some(failure), false) = (&report.failure, self.verify) {
            return Err(Failure::Work(format!("the replay failed, as the recorded run may have: {failure}")));
        }
        match (&report.comparison.first_difference, report.run.validation_messages) {
            (Some(difference), _) => {
                Err(Failure::Work(format!("the replay differs from the recording: {difference}")))
            }
            (None, Some(count @ 1..)) => {
                Err(Failure::Work(format!("Vulkan validation: expected no message, found {count}")))
            }
            (None, _) => Ok(()),
        }
    }
}
