//! Poses to compare: of a text file, a recording's folder, or a stream of a session's log.

use std::path::{Path, PathBuf};

use vergence_log::{LogSource, Reader};
use vergence_sense::{Progress, Reading, ReadingKind, Sample, Sink, Source, SourceStream};
use vergence_session::RigLog;
use vergence_slam::dataset::{Dataset, truth_file};
use vergence_slam::trajectory::{Rotations, Trajectory};
use vergence_time::{Span, Timestamp};

use crate::failure::Failure;

/// What poses are wanted for.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Role {
    Estimate,
    Truth,
}

impl Role {
    /// The last parts of the names of streams that are meant, the likeliest first.
    fn names(self) -> &'static [&'static str] {
        match self {
            Self::Estimate => &["estimate", "body", "odometry/head"],
            Self::Truth => &["truth", "state_groundtruth_estimate0", "mocap0", "vicon0"],
        }
    }
}

/// Poses, and how they say rotations.
pub struct Poses {
    pub trajectory: Trajectory,
    /// How rotations are written, where they were read from text.
    pub written: Option<Rotations>,
    /// Where they come from.
    pub from: PathBuf,
}

impl Poses {
    /// The file that is read of `path`: itself, or what a recording's folder calls its truth.
    pub fn file(path: &Path) -> PathBuf {
        truth_file(path).unwrap_or_else(|| path.to_owned())
    }

    pub fn read(path: &Path, role: Role) -> Result<Self, Failure> {
        let from = Self::file(path);
        let failed = |error: vergence_slam::Error| Failure::work(&error);
        let (trajectory, written) = if RigLog::is_log(&from) {
            (of_log(&from, role)?, None)
        } else if from.is_dir() {
            let nothing = || Failure::Work(format!("{}: expected a truth, found none", from.display()));
            (Dataset::open(&from).map_err(failed)?.truth.ok_or_else(nothing)?, None)
        } else {
            let (trajectory, written) = Trajectory::read_places(&from).map_err(failed)?;
            (trajectory, Some(written))
        };
        Ok(Self { trajectory, written, from })
    }

    /// Whether there are rotations.
    pub fn is_turned(&self) -> bool {
        self.written != Some(Rotations::None)
    }
}

/// All streams of poses of a log.
#[derive(Default)]
struct Streams {
    /// By their place among all streams.
    names: Vec<(usize, String)>,
    poses: Vec<(usize, Timestamp, vergence_geom::Rigid)>,
}

impl Sink for Streams {
    fn appears(&mut self, place: usize, stream: &SourceStream) {
        if stream.kind == ReadingKind::Pose && self.names.iter().all(|(known, _)| *known != place) {
            self.names.push((place, stream.name.to_string()));
        }
    }

    fn take(&mut self, stream: usize, sample: Sample<Reading<'_>>) {
        if let Reading::Pose(pose) = sample.value {
            self.poses.extend(pose.reference_from_device().map(|pose| (stream, sample.captured, pose)));
        }
    }
}

fn of_log(path: &Path, role: Role) -> Result<Trajectory, Failure> {
    let reader = Reader::open(path).map_err(|error| Failure::work(&error))?;
    let mut source = LogSource::new(reader);
    let mut streams = Streams::default();
    for (place, stream) in source.streams().iter().enumerate() {
        streams.appears(place, stream);
    }
    let mut until = Timestamp::from_nanos(i64::MIN);
    loop {
        match source.advance(until, &mut streams) {
            Progress::Ended => break,
            Progress::Gave => {}
            Progress::Idle => until = source.next_arrival().unwrap_or(until),
        }
        until = until.saturating_add(Span::from_millis(1000));
    }
    if let Some(failure) = source.failure() {
        return Err(Failure::work(&failure));
    }
    let meant = |name: &&str| {
        let is = |stream: &str| stream == *name || stream.ends_with(&format!("/{name}"));
        streams.names.iter().find(|(_, stream)| is(stream))
    };
    let found = match (role.names().iter().find_map(meant), &streams.names[..]) {
        (Some(found), _) => found.0,
        (None, [only]) => only.0,
        (None, several) => {
            let names: Vec<&str> = several.iter().map(|(_, name)| name.as_str()).collect();
            let found = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
            return Err(Failure::Work(format!(
                "{}: expected a stream of poses called /{}, found {found}",
                path.display(),
                role.names()[0]
            )));
        }
    };
    let mut poses: Vec<_> =
        streams.poses.iter().filter(|pose| pose.0 == found).map(|pose| (pose.1, pose.2)).collect();
    poses.sort_by_key(|pose| pose.0);
    poses.dedup_by_key(|pose| pose.0);
    if poses.is_empty() {
        return Err(Failure::Work(format!(
            "{}: expected poses that are tracked, found none",
            path.display()
        )));
    }
    Ok(Trajectory { poses })
}
