//! A session log in which a rig was recorded: its streams, and its calibration beside them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use vergence_log::{LogSource, Reader, Recorder};
use vergence_sense::{Progress, Source};
use vergence_slam::dataset::Rig;
use vergence_slam::follower::{Feed, Follower};
use vergence_time::Timestamp;

use crate::error::Error;

/// Under this name a log keeps the calibrations of the rig whose streams (`…/imu0`, `…/cam0`, …) it has, as metadata: EuRoC's
/// `sensor.yaml`, each under the name that it has in a folder (`cam0/sensor.yaml`).
pub const RIG: &str = "vergence.rig";

/// A log with a rig.
#[derive(Clone, Debug)]
pub struct RigLog {
    path: PathBuf,
    /// As calibrated.
    pub rig: Rig,
}

impl RigLog {
    /// Whether a path names a log, and not a folder.
    pub fn is_log(path: &Path) -> bool {
        path.extension().is_some_and(|end| end == "mcap") && !path.is_dir()
    }

    /// Reads the rig of a log; its metadata stand before its first samples.
    ///
    /// # Errors
    /// What cannot be read; a log without a rig; a calibration that cannot be.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let mut reader = Reader::open(path)?;
        let sheets = loop {
            let found =
                reader.metadata().iter().find(|(name, _)| name == RIG).map(|(_, sheets)| sheets.clone());
            if let Some(sheets) = found {
                break sheets;
            }
            if reader.next()?.is_none() {
                return Err(Error::NoRig { path: path.to_owned() });
            }
        };
        Ok(Self { path: path.to_owned(), rig: Rig::from_sheets(path, &sheets)? })
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Its samples, from the first on.
    ///
    /// # Errors
    /// What cannot be read.
    pub fn source(&self) -> Result<LogSource, Error> {
        Ok(LogSource::new(Reader::open(&self.path)?))
    }

    /// Follows it to its end with a follower of its rig; `ready` follows what is ready, and is called after each sample, until it wants no
    /// more. Gives the follower back.
    ///
    /// # Errors
    /// What cannot be read or decoded, and what `ready` says.
    pub fn follow(
        &self,
        follower: Follower,
        ready: impl FnMut(&mut Follower) -> Result<bool, vergence_slam::Error>,
    ) -> Result<Follower, Error> {
        let mut source = self.source()?;
        let mut feed = Feed::new(follower, source.streams(), ready);
        let mut until = Timestamp::from_nanos(i64::MIN);
        // In steps, so that a failure ends it soon.
        while !feed.is_over() {
            match source.advance(until, &mut feed) {
                Progress::Ended => break,
                Progress::Gave => {}
                Progress::Idle => until = source.next_arrival().unwrap_or(until),
            }
            until = until.saturating_add(vergence_time::Span::from_millis(100));
        }
        if let Some(failure) = source.failure() {
            return Err(failure.into());
        }
        Ok(feed.finish()?)
    }
}

/// Says in a recording which rig its streams are of; cameras take `frames_hz` frames per second. Before its first sample.
pub fn annotate_rig(recorder: &Recorder, rig: &Rig, frames_hz: f64) {
    let sheets: BTreeMap<String, String> = rig.sheets(frames_hz).into_iter().collect();
    recorder.annotate(RIG, &sheets);
}
