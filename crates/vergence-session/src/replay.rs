//! Replays a session log: the same client and the same renderer, on a simulated headset that says again what was said.

use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use serde::Serialize;
use vergence_action::{Control, POINT_AND_GRASP};
use vergence_log::{Ending, Header, Reader};
use vergence_scene::Scene;
use vergence_xr_sim::motion::Part;
use vergence_xr_sim::{Replay, Script};

use crate::config::{CaptureConfig, HeadsetChoice, RunConfig};
use crate::error::Error;
use crate::provenance::scene_hash;
use crate::resolved::Resolved;
use crate::run::{Again, Happening, MakeVerifier, run_again};
use crate::said_log::{Frames, Trouble};
use crate::verify::{Comparison, Verifier};
use crate::{RunReport, provenance};

/// A session log that can be replayed.
#[derive(Clone, Debug)]
pub struct SessionLog {
    path: PathBuf,
    header: Header,
    resolved: Resolved,
}

/// How to replay.
#[derive(Clone, Debug, Default)]
pub struct ReplayConfig {
    /// How fast: 1 as recorded, `None` as fast as the machine can.
    pub speed: Option<f64>,
    /// Pictures, poses and the report as files.
    pub capture: Option<CaptureConfig>,
    /// Compares everything that is said and submitted with the recording.
    pub verify: bool,
    /// On what; anything but the simulated headset is refused with the reason.
    pub headset: HeadsetChoice,
    /// Vulkan validation, where it is installed.
    pub validation: bool,
}

/// What a replay was like. Its JSON is an interface.
#[derive(Clone, Debug, Serialize)]
pub struct ReplayReport {
    /// How it compares with the recording; empty where that was not asked for.
    #[serde(flatten)]
    pub comparison: Comparison,
    /// Whether it was compared.
    pub verified: bool,
    /// Whether the recording has its end; one that was cut off is replayed as far as it goes.
    pub complete: bool,
    /// What is wrong with the recording, where something is: it is replayed up to there.
    pub damage: Option<String>,
    /// Session time of the frames that were shown, seconds.
    pub seconds: f64,
    /// Host time of the whole replay, seconds.
    pub host_seconds: f64,
    /// Frames that were paced, drawn or not, per second of host time.
    pub frames_per_second: f64,
    /// The run itself.
    pub run: RunReport,
}

impl SessionLog {
    /// Opens a log.
    ///
    /// # Errors
    /// Where it cannot be read, is no log, or was not recorded by a session of ours.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let reader = Reader::open(path)?;
        let none = || {
            Error::Call(format!(
                "{}: expected a session that vergence recorded, found a log of something else",
                path.display()
            ))
        };
        let header =
            reader.header().cloned().filter(|header| !header.configuration.is_empty()).ok_or_else(none)?;
        let resolved = serde_json::from_str(&header.configuration).map_err(|error| {
            Error::Call(format!(
                "{}: expected the configuration of a session, found one by {} that cannot be read: {error}",
                path.display(),
                header.application
            ))
        })?;
        Ok(Self { path: path.to_owned(), header, resolved })
    }

    /// Where the scene was when it was recorded; `None` for a scene without a file.
    pub fn scene_path(&self) -> Option<&Path> {
        Some(Path::new(&self.header.scene_path)).filter(|path| !path.as_os_str().is_empty())
    }

    /// Unpacks the scene that is attached to the log into `folder` and says where it begins; `None` where none is attached.
    ///
    /// # Errors
    /// Where the log cannot be read or the files not be written.
    pub fn unpack_scene(&self, folder: &Path) -> Result<Option<PathBuf>, Error> {
        let mut reader = Reader::open(&self.path)?;
        // What is attached whole is there also where something else is damaged.
        while !matches!(reader.next(), Ok(None) | Err(vergence_log::Error::Read { .. })) {}
        let mut first = None;
        let mut file = std::fs::File::open(&self.path).map_err(Error::write(&self.path))?;
        for attachment in reader.attachments() {
            let relative = Path::new(&attachment.name);
            let inside = relative.components().all(|part| matches!(part, std::path::Component::Normal(_)));
            if !inside {
                let name = &attachment.name;
                return Err(Error::Call(format!(
                    "{}: expected attached files inside of the scene's folder, found {name:?}",
                    self.path.display()
                )));
            }
            let to = folder.join(relative);
            let mut unpack = || -> std::io::Result<()> {
                if let Some(parent) = to.parent() {
                    std::fs::create_dir_all(parent)?;
                }
                // Opcode and length, two times, two texts with their lengths, the length of the content; then the content,
                // and a checksum.
                let texts = attachment.name.len() + attachment.media_type.len();
                let head = 9 + 16 + 8 + texts as u64 + 8;
                file.seek(SeekFrom::Start(attachment.offset + head))?;
                let length = attachment.length.saturating_sub(head + 4);
                std::io::copy(&mut (&mut file).take(length), &mut std::fs::File::create(&to)?)?;
                Ok(())
            };
            unpack().map_err(Error::write(&to))?;
            first.get_or_insert(to);
        }
        Ok(first)
    }

    /// # Errors
    /// Where the scene is another one than was recorded.
    pub fn check_scene(&self, scene: &Scene) -> Result<(), Error> {
        let (expected, found) = (&self.header.scene_hash, scene_hash(scene)?);
        if *expected == found {
            return Ok(());
        }
        let place =
            scene.files.first().map_or_else(|| "the scene".to_owned(), |file| file.display().to_string());
        Err(Error::Call(format!(
            "{place}: expected the scene that {} was recorded with ({expected}), found other content ({found})",
            self.path.display()
        )))
    }

    /// Why pictures of this log mean nothing on a device, where they do not.
    fn images_not_compared(&self, device: &str) -> Option<String> {
        let build = provenance::build();
        if !self.resolved.hash_frames {
            Some("the recording has no hashes of them".to_owned())
        } else if self.header.device != device {
            Some(format!("recorded on {}, replayed on {device}", self.header.device))
        } else if self.resolved.build != build {
            Some(format!("recorded by build {}, replayed by build {build}", self.resolved.build))
        } else {
            None
        }
    }

    /// What the user of the recording did, to be done again in any scene on any simulated headset; at its end the session is
    /// asked to end.
    ///
    /// # Errors
    /// Where the log cannot be read.
    pub fn motion(&self) -> Result<Script, Error> {
        let trouble = Trouble::default();
        let parts: Vec<Option<Part>> = self.resolved.actions.iter().map(|name| part_of(name)).collect();
        let script = Script::of_session(self.frames(&trouble)?, &parts);
        if let Some(error) = trouble.take() {
            log::warn!("{error}; going on with what is before that");
        }
        Ok(script)
    }

    fn frames(&self, trouble: &Trouble) -> Result<Frames, Error> {
        Ok(Frames::open(&self.path, Arc::new(self.resolved.actions.clone()), trouble.clone())?)
    }
}

/// The part of a controller that an action of ours is read from.
fn part_of(action: &str) -> Option<Part> {
    let action = POINT_AND_GRASP.iter().find(|known| known.name == action)?;
    Some(match action.control {
        Control::Aim => Part::Aim,
        Control::Grip => Part::Grip,
        Control::Trigger => Part::Trigger,
        Control::Squeeze => Part::Squeeze,
        Control::Thumbstick => Part::Stick,
        Control::ThumbstickClick => Part::StickClick,
        Control::Primary => Part::Primary,
        Control::Secondary => Part::Secondary,
        Control::Menu => Part::Menu,
        Control::Haptic => return None,
    })
}

/// Replays `log` with its scene.
///
/// # Errors
/// A live headset (the clock of a replay is its own), another scene than was recorded, a log that cannot be read, and what
/// [`run`](crate::run) refuses.
pub fn replay(
    log: &SessionLog,
    scene: &Arc<Scene>,
    config: &ReplayConfig,
    watch: &mut dyn FnMut(Happening<'_>),
) -> Result<ReplayReport, Error> {
    if config.headset == HeadsetChoice::OpenXr {
        return Err(Error::Call(
            "a live headset cannot be replayed: expected the simulated one, whose clock is the recording's; found one that \
             keeps to the wall clock and whose user moves it"
                .into(),
        ));
    }
    if let Some(speed) = config.speed.filter(|speed| !(*speed > 0.0 && speed.is_finite())) {
        return Err(Error::Call(format!("--speed: expected max or a positive number, found {speed}")));
    }
    log.check_scene(scene)?;
    let (said_trouble, compared_trouble) = (Trouble::default(), Trouble::default());
    let replay = Replay::new(log.frames(&said_trouble)?, log.resolved.actions.clone(), config.speed);
    let expected = if config.verify { Some(log.frames(&compared_trouble)?) } else { None };
    let again = Again {
        replay,
        profile: log.resolved.profile.profile(),
        hash: config.verify && log.resolved.hash_frames,
        verifier: expected.map(|expected| {
            let log = log.clone();
            let made: MakeVerifier =
                Box::new(move |device| Verifier::new(expected, log.images_not_compared(device)));
            made
        }),
    };
    let run_config = RunConfig {
        headset: HeadsetChoice::Simulated,
        patience_s: f64::MAX,
        // However long the recording's user was away, the runtime answers.
        hang_s: f64::MAX,
        retries: log.resolved.retries,
        quality: log.resolved.quality.quality(),
        capture: config.capture.clone(),
        hand_joints: log.resolved.hand_joints,
        eye_gaze: log.resolved.eye_gaze,
        refresh_rate_hz: log.resolved.refresh_rate_hz,
        validation: config.validation,
        ..RunConfig::default()
    };
    let began = Instant::now();
    let (run, compared) = run_again(scene, &run_config, again, watch)?;
    let host_seconds = began.elapsed().as_secs_f64();
    let mut reader = Reader::open(&log.path)?;
    // A damaged file is no complete one.
    while matches!(reader.next(), Ok(Some(_))) {}
    let comparison: Comparison = compared.unwrap_or_default();
    Ok(ReplayReport {
        frames_per_second: run.paced as f64 / host_seconds.max(1e-9),
        verified: config.verify,
        complete: reader.ending() == Some(Ending::Complete),
        damage: said_trouble.take().or_else(|| compared_trouble.take()).map(|error| error.to_string()),
        seconds: run.seconds,
        host_seconds,
        comparison,
        run,
    })
}

impl std::fmt::Display for ReplayReport {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.run.fmt(f)?;
        writeln!(f, "replayed       {} frames in {:.2} s", self.run.paced, self.host_seconds)?;
        if !self.complete {
            writeln!(f, "recording      was cut off: replayed as far as it goes")?;
        }
        if let Some(damage) = &self.damage {
            writeln!(f, "recording      {damage}")?;
        }
        if self.verified {
            let Comparison { frames, frames_equal, events, events_equal, .. } = self.comparison;
            writeln!(f, "frames         {frames_equal} of {frames} equal")?;
            writeln!(f, "events         {events_equal} of {events} equal")?;
            match &self.comparison.images_not_compared {
                Some(why) => writeln!(f, "pictures       not compared: {why}")?,
                None => {
                    let Comparison { images, images_equal, .. } = self.comparison;
                    writeln!(f, "pictures       {images_equal} of {images} equal")?;
                }
            }
            if let Some(difference) = &self.comparison.first_difference {
                writeln!(f, "difference     {difference}")?;
            }
        }
        Ok(())
    }
}
