//! Replays a session log: the same client and the same renderer, on a simulated headset that says again what was said.

use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use serde::Serialize;
use vergence_action::{Control, POINT_AND_GRASP};
use vergence_log::{Ending, Header, Reader};
use vergence_scene::Scene;
use vergence_sense::{Event, Said};
use vergence_xr::Without;
use vergence_xr_sim::motion::{Part, RUN_ENDED, SESSION_BEGINS};
use vergence_xr_sim::{Fault, FaultPlan, Replay, Script};

use crate::config::{CaptureConfig, HeadsetChoice, RunConfig};
use crate::error::Error;
use crate::provenance::scene_hash;
use crate::recording::name;
use crate::resolved::Resolved;
use crate::run::{Again, Happening, Lived, MakeVerifier, run_again};
use crate::said_log::{Frames, Outcome};
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
    /// How the replay failed, where it did: a recording of a run that failed fails in the same way.
    pub failure: Option<String>,
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
        let mut file = std::fs::File::open(&self.path).map_err(Error::read(&self.path))?;
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
            let head = attachment.content_offset().unwrap_or(attachment.length);
            if !attachment.is_whole(&self.path)? {
                let (log, name) = (self.path.display(), &attachment.name);
                return Err(Error::Call(format!("{log}: the attached {name} is damaged")));
            }
            let mut unpack = || -> std::io::Result<()> {
                if let Some(parent) = to.parent() {
                    std::fs::create_dir_all(parent)?;
                }
                file.seek(SeekFrom::Start(attachment.offset + head))?;
                // A checksum comes behind it.
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
        let outcome = Outcome::default();
        let parts: Vec<Option<Part>> = self.resolved.actions.iter().map(|name| part_of(name)).collect();
        let script = Script::of_session(self.frames(&outcome)?, &parts);
        if let Some(error) = outcome.trouble() {
            log::warn!("{error}; going on with what is before that");
        } else if !outcome.is_complete() {
            log::warn!("{}: was cut off; its motion ends there", self.path.display());
        }
        Ok(script)
    }

    fn frames(&self, outcome: &Outcome) -> Result<Frames, Error> {
        Ok(Frames::open(&self.path, Arc::new(self.resolved.actions.clone()), outcome.clone())?)
    }

    /// # Errors
    /// Where the log begins in the middle of a session, or has no frame.
    fn check_beginning(&self) -> Result<(), Error> {
        let outcome = Outcome::default();
        let first = self.frames(&outcome)?.next().unwrap_or_default();
        let is_event = |said: &Said, name: &str| matches!(said, Said::Event(event) if event.name == name);
        let found = if !first.iter().any(|said| matches!(said, Said::Frame { .. })) {
            if let Some(error) = outcome.trouble() {
                return Err(error.into());
            }
            "one without a whole frame"
        } else if !first.iter().any(|said| is_event(said, SESSION_BEGINS)) {
            "one that begins in the middle of it"
        } else {
            return Ok(());
        };
        Err(Error::Call(format!(
            "{}: expected a recording from the beginning of a session on, with all its streams, found {found}; \
             'vergence run --motion' takes it as the user's motion",
            self.path.display()
        )))
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
    if log.resolved.views != 2 {
        return Err(Error::Call(format!(
            "{}: expected a session with two views, as the simulated headset has, found {}",
            log.path.display(),
            log.resolved.views
        )));
    }
    log.check_scene(scene)?;
    log.check_beginning()?;
    let faults = log.resolved.faults.iter().map(|text| Fault::parse(text)).collect::<Result<Vec<_>, _>>()?;
    let (said, compared) = (Outcome::default(), Outcome::default());
    let replay = Replay::new(log.frames(&said)?, log.resolved.actions.clone(), config.speed);
    let expected = if config.verify { Some(log.frames(&compared)?) } else { None };
    let again = Again {
        replay,
        profile: log.resolved.profile.profile(),
        without: Without { clock: log.resolved.without_clock, floor: log.resolved.without_floor },
        hash: config.verify && log.resolved.hash_frames,
        verifier: expected.map(|expected| {
            let (log, compared) = (log.clone(), compared.clone());
            let made: MakeVerifier = Box::new(move |device| {
                let why_not = log.images_not_compared(device);
                Verifier::new(expected, compared, log.resolved.has_results, why_not)
            });
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
        faults: if faults.is_empty() { FaultPlan::default() } else { FaultPlan::new(faults) },
        ..RunConfig::default()
    };
    let began = Instant::now();
    let Lived { report: run, comparison, ended } = run_again(scene, &run_config, again, watch)?;
    let host_seconds = began.elapsed().as_secs_f64();
    let mut reader = Reader::open(&log.path)?;
    // A damaged file is no complete one.
    let mut damage = said.trouble().or_else(|| compared.trouble());
    // A file that was mended is whole, and its recording may not be.
    let mut has_end = false;
    while damage.is_none() {
        match reader.next() {
            Ok(Some(entry)) => {
                has_end |= entry.stream.name == name::EVENTS
                    && entry.decode::<Event>().is_ok_and(|event| event.value.name == RUN_ENDED);
            }
            Ok(None) => break,
            Err(error) => damage = Some(error),
        }
    }
    let was_compared = comparison.is_some();
    let comparison: Comparison = comparison.unwrap_or_default();
    let failure = match ended {
        Ok(()) => None,
        // A run that failed is lived through to its failure: where it is compared, that is equal or a difference.
        Err(error @ Error::Headset(_)) if was_compared || run.paced > 0 => Some(error.to_string()),
        Err(error) => return Err(error),
    };
    Ok(ReplayReport {
        frames_per_second: run.paced as f64 / host_seconds.max(1e-9),
        verified: config.verify,
        complete: reader.ending() == Some(Ending::Complete) && (has_end || !log.resolved.has_results),
        damage: damage.map(|error| error.to_string()),
        failure,
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
        if let Some(failure) = &self.failure {
            writeln!(f, "ended          {failure}")?;
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
            let Comparison { extra_frames, extra_events, .. } = self.comparison;
            if extra_frames + extra_events > 0 {
                writeln!(f, "after the end  {extra_frames} frames and {extra_events} events more")?;
            }
            if let Some(difference) = &self.comparison.first_difference {
                writeln!(f, "difference     {difference}")?;
            }
        }
        Ok(())
    }
}
