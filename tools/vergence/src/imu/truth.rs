//! What orientations are scored against: the truth of a recording, or a track of orientations with times of its own.

use std::io::Read as _;
use std::path::{Path, PathBuf};

use nalgebra::UnitQuaternion;
use vergence_inertial::{Pair, Recording, paired, read_orientations};
use vergence_log::Reader;
use vergence_sense::Pose;
use vergence_slam::trajectory::Trajectory;
use vergence_time::Timestamp;

use super::input;
use crate::failure::Failure;
use crate::log::TRUTHS;

/// An instant and the orientation at it, earth from sensor.
pub type Stamped = (Timestamp, UnitQuaternion<f64>);

/// A truth.
pub enum Truth {
    /// Beside the samples of a recording, in an earth frame whose north is known.
    Rows(Box<Recording>),
    /// At times of its own.
    Track {
        /// In order of time.
        poses: Vec<Stamped>,
        /// Whether the world's y is north: of a trajectory's world nothing is known but its vertical.
        north: bool,
    },
}

/// What a text table is, by its first line that is no comment.
enum Kind {
    Recording,
    Orientations,
    Trajectory,
}

fn kind(path: &Path) -> Result<Kind, Failure> {
    let mut head = Vec::new();
    let file = std::fs::File::open(path).map_err(|e| Failure::Work(format!("{}: {e}", path.display())))?;
    file.take(1024).read_to_end(&mut head).map_err(|e| Failure::Work(format!("{}: {e}", path.display())))?;
    let text = String::from_utf8_lossy(&head);
    let head = text.lines().find(|line| !line.trim().is_empty()).unwrap_or_default();
    // Compressed tables are recordings: none of the others is read so.
    Ok(if head.contains("gyr_") || head.contains("w_RS_S") || text.starts_with("\u{1f}\u{fffd}") {
        Kind::Recording
    } else if head.contains("qw") && !head.starts_with('#') {
        Kind::Orientations
    } else {
        Kind::Trajectory
    })
}

/// The table of a folder's truth: EuRoC's, or what a recording's folder calls it.
fn table_of(folder: &Path) -> Option<PathBuf> {
    let euroc = TRUTHS.iter().flat_map(|name| [format!("mav0/{name}/data.csv"), format!("{name}/data.csv")]);
    let names = euroc.chain(["truth.tum", "gt_tum.txt", "data.csv"].map(str::to_owned));
    names.map(|name| folder.join(name)).find(|path| path.is_file())
}

/// Reads orientations with times of their own: a table `t_s,qw,qx,qy,qz`, a trajectory in TUM's format, EuRoC's truth. Whether north is known.
pub fn track(path: &Path) -> Result<(Vec<Stamped>, bool), Failure> {
    if let Kind::Trajectory = kind(path)? {
        let trajectory = Trajectory::read(path).map_err(|error| Failure::work(&error))?;
        return Ok((trajectory.poses.into_iter().map(|(at, pose)| (at, pose.rotation)).collect(), false));
    }
    Ok((read_orientations(path).map_err(|error| Failure::work(&error))?, true))
}

/// The truth that a session's log has at times of its own.
fn of_log(path: &Path) -> Result<Vec<Stamped>, Failure> {
    let failed = |error: vergence_log::Error| Failure::work(&error);
    let mut reader = Reader::open(path).map_err(failed)?;
    let mut poses: Vec<Stamped> = Vec::new();
    while let Some(entry) = reader.next().map_err(failed)? {
        if input::is_truth(&entry) {
            let sample = entry.decode::<Pose>().map_err(failed)?;
            poses.extend(input::said(&entry, &sample.value).earth_from_sensor.map(|q| (sample.captured, q)));
        }
    }
    poses.sort_by_key(|(at, _)| *at);
    Ok(poses)
}

impl Truth {
    /// Reads a recording with truth, a trajectory in TUM's format, EuRoC's truth (its table, or a folder around it), orientations
    /// `t_s,qw,qx,qy,qz`, or what of these a session's log has.
    pub fn read(path: &Path) -> Result<Self, Failure> {
        let none = || Failure::Work(format!("{}: expected a truth, found none", path.display()));
        if input::is_log(path) {
            return match input::read(path, None) {
                Ok(recording) if !recording.truth.is_empty() => Ok(Self::Rows(Box::new(recording))),
                _ => {
                    let poses = of_log(path)?;
                    if poses.is_empty() { Err(none()) } else { Ok(Self::Track { poses, north: false }) }
                }
            };
        }
        let table = if path.is_dir() { table_of(path).ok_or_else(none)? } else { path.to_owned() };
        if let Kind::Recording = kind(&table)? {
            let recording = Recording::read(&table).map_err(|error| Failure::work(&error))?;
            return if recording.truth.is_empty() {
                let expected = "a truth with columns gt_qw,gt_qx,gt_qy,gt_qz";
                Err(Failure::Work(format!("{}: expected {expected}, found none", table.display())))
            } else {
                Ok(Self::Rows(Box::new(recording)))
            };
        }
        let (poses, north) = track(&table)?;
        Ok(Self::Track { poses, north })
    }

    /// Whether headings can be compared as they are.
    pub const fn knows_north(&self) -> bool {
        match self {
            Self::Rows(_) => true,
            Self::Track { north, .. } => *north,
        }
    }

    /// Each instant that is scored with its estimate; how many have none. With the rows of the recording each row is its sample's estimate;
    /// else estimates are interpolated. `name` is the file of the estimate, `path` that of the truth.
    pub fn pairs(
        &self,
        estimate: &[Stamped],
        name: &Path,
        path: &Path,
    ) -> Result<(Vec<Pair>, usize), Failure> {
        let (pairs, missing) = match self {
            Self::Rows(recording) => {
                if is_of(recording, estimate) {
                    let pairs = recording.scored(estimate, name).map_err(|error| Failure::work(&error))?;
                    (pairs, 0)
                } else {
                    let truth = recording.samples.iter().zip(&recording.truth);
                    let moving = truth.filter(|(_, truth)| truth.movement);
                    paired(
                        estimate,
                        moving.filter_map(|((at, _), truth)| Some((*at, truth.earth_from_sensor?))),
                    )
                }
            }
            Self::Track { poses, .. } => paired(estimate, poses.iter().copied()),
        };
        if pairs.is_empty() && missing > 0 {
            let seconds = |at: Option<&Timestamp>| at.map_or(f64::NAN, |at| at.as_nanos() as f64 * 1e-9);
            let truth: Vec<Timestamp> = match self {
                Self::Rows(recording) => recording.samples.iter().map(|(at, _)| *at).collect(),
                Self::Track { poses, .. } => poses.iter().map(|(at, _)| *at).collect(),
            };
            let times: Vec<Timestamp> = estimate.iter().map(|(at, _)| *at).collect();
            return Err(Failure::Work(format!(
                "{}: expected orientations at times of {} ({:.3} to {:.3} s), found {:.3} to {:.3} s",
                name.display(),
                path.display(),
                seconds(truth.first()),
                seconds(truth.last()),
                seconds(times.first()),
                seconds(times.last())
            )));
        }
        Ok((pairs, missing))
    }
}

/// Whether the rows are those of the recording, to a microsecond.
fn is_of(recording: &Recording, estimate: &[Stamped]) -> bool {
    let same = |((at, _), (of, _)): (&Stamped, &(Timestamp, vergence_sense::Imu))| {
        at.as_nanos().abs_diff(of.as_nanos()) <= 1000
    };
    estimate.len() == recording.samples.len() && estimate.iter().zip(&recording.samples).all(same)
}
