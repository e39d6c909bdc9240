use std::path::{Path, PathBuf};

use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use vergence_config::{Duration, Length};
use vergence_geom::{Rigid, y_up_from_z_up};
use vergence_time::{Span, Timestamp};

use super::{
    AtEnd, Controller, Gaps, Hand, PoseProvider, Sample, Tracked, Trajectory, held_in_front, parse_tum,
    read_tum, yaw_of,
};
use crate::Error;

/// The motions that come with the crate, by name: each is also a file under `motions/`.
pub const BUILT_IN_MOTIONS: [(&str, &str); 2] = [
    ("room1.toml", include_str!("../../motions/room1.toml")),
    ("look-around.toml", include_str!("../../motions/look-around.toml")),
];

/// Trajectories of our own, so that a built-in motion needs no file.
const BUILT_IN_TRAJECTORIES: [(&str, &str); 1] =
    [("look-around.tum.txt", include_str!("../../motions/look-around.tum.txt"))];

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct Raw {
    trajectory: String,
    world_axes: WorldAxes,
    placement: Placement,
    #[serde(default)]
    eye_height: Option<Length>,
    #[serde(default)]
    start: Option<Duration>,
    at_end: AtEnd,
    gaps: RawGaps,
    head_from_body: RawPose,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct RawGaps {
    longest_step: Duration,
    across: Gaps,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct RawPose {
    position: [Length; 3],
    rotation: [f64; 4],
}

/// Which axis of the trajectory's world points up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
enum WorldAxes {
    /// Already ours.
    YUp,
    /// EuRoC, TUM-VI, ROS.
    ZUp,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Placement {
    /// The motion begins at the user's start: eyes at eye height above the stage's origin, facing −z.
    StartRelative,
    /// The trajectory's world is the stage.
    Absolute,
}

/// A motion file: a trajectory, and how a head follows it.
#[derive(Clone, Debug)]
pub struct Motion {
    trajectory: Trajectory,
    stage_from_world: Rigid,
    body_from_head: Rigid,
}

impl Motion {
    /// The motion in the file `name`, or the built-in one of that name where there is no such file.
    ///
    /// # Errors
    /// Where there is neither, or as [`Motion::parse`].
    pub fn open(name: &str) -> Result<Self, Error> {
        let path = Path::new(name);
        if path.is_file() {
            return Self::parse(path, &vergence_config::read_text(path)?);
        }
        match BUILT_IN_MOTIONS
            .iter()
            .find(|(built_in, _)| *built_in == name || built_in.strip_suffix(".toml") == Some(name))
        {
            Some((built_in, text)) => Self::parse(Path::new(built_in), text),
            None => {
                Err(Error::Unknown { kind: "motion", name: name.to_owned(), known: super::built_in_names() })
            }
        }
    }

    /// The motion that `text`, the content of the file `path`, describes. The trajectory is looked for beside that
    /// file; `${VERGENCE_DATA}` in its name stands for the folder that the environment variable names.
    ///
    /// # Errors
    /// Where the text or the trajectory is wrong: file and line are named.
    pub fn parse(path: &Path, text: &str) -> Result<Self, Error> {
        let raw: Raw = vergence_config::parse(path, text)?;
        let samples = load(path, &raw.trajectory)?;
        let value = |key: &str, expected: &str, found: String| {
            Error::value(path, text, key, &format!("expected {expected}, found {found}"))
        };
        let span = |key: &str, duration: Duration| {
            let name = key.rsplit('.').next().unwrap_or(key);
            Span::from_secs_f64(duration.seconds()).filter(|span| span.as_nanos() >= 0).ok_or_else(|| {
                value(key, &format!("a {name} of at least 0 s"), format!("{} s", duration.seconds()))
            })
        };
        let begin = samples[0].at;
        let start = begin.saturating_add(span("start", raw.start.unwrap_or(Duration::new(0.0)))?);
        let last = samples[samples.len() - 1].at;
        if start > last {
            let length = last.since(begin).unwrap_or(Span::ZERO).as_secs_f64();
            let found = format!("{} s", raw.start.map_or(0.0, |start| start.seconds()));
            let expected = format!("a start within the {length} s of the trajectory");
            return Err(value("start", &expected, found));
        }
        let longest_step = span("gaps.longest-step", raw.gaps.longest_step)?;
        let trajectory = Trajectory::new(samples, start, raw.at_end, raw.gaps.across, longest_step)
            .ok_or_else(|| {
                value("trajectory", "a trajectory shorter than 292 years", raw.trajectory.clone())
            })?;

        let [i, j, k, w] = raw.head_from_body.rotation;
        let rotation = Quaternion::new(w, i, j, k);
        let unit = (rotation.norm() - 1.0).abs() < 1e-3;
        if !unit {
            let found = format!("{i} {j} {k} {w}");
            return Err(value("head-from-body.rotation", "a unit quaternion x y z w", found));
        }
        let [x, y, z] = raw.head_from_body.position.map(Length::metres);
        let head_from_body =
            Rigid::from_parts(Translation3::new(x, y, z), UnitQuaternion::new_normalize(rotation));
        let body_from_head = head_from_body.inverse();

        let y_up_from_world = match raw.world_axes {
            WorldAxes::YUp => Rigid::identity(),
            WorldAxes::ZUp => y_up_from_z_up(),
        };
        let eye_height_m = raw.eye_height.map_or(1.6, Length::metres);
        let stage_from_y_up = match raw.placement {
            Placement::Absolute => Rigid::identity(),
            Placement::StartRelative => {
                stage_from_start(&(y_up_from_world * trajectory.first() * body_from_head), eye_height_m)
            }
        };
        Ok(Self { trajectory, stage_from_world: stage_from_y_up * y_up_from_world, body_from_head })
    }

    /// A motion that begins at the user's start, eyes at eye height (metres) above the stage's origin and facing −z: a
    /// trajectory in a world with y up, and the head on the body that it is of.
    pub fn from_start(trajectory: Trajectory, body_from_head: Rigid, eye_height_m: f64) -> Self {
        let stage_from_world = stage_from_start(&(trajectory.first() * body_from_head), eye_height_m);
        Self { trajectory, stage_from_world, body_from_head }
    }
}

/// Puts a head's first pose, in a world with y up, at the user's start.
fn stage_from_start(world_from_head: &Rigid, eye_height_m: f64) -> Rigid {
    let world_from_start = Rigid::from_parts(world_from_head.translation, yaw_of(world_from_head));
    Rigid::translation(0.0, eye_height_m, 0.0) * world_from_start.inverse()
}

fn load(motion: &Path, name: &str) -> Result<Vec<Sample>, Error> {
    const DATA: &str = "${VERGENCE_DATA}";
    if let Some(rest) = name.strip_prefix(DATA) {
        let folder = std::env::var_os("VERGENCE_DATA").filter(|folder| !folder.is_empty()).map(PathBuf::from);
        let path = folder.clone().unwrap_or_else(|| DATA.into()).join(rest.trim_start_matches('/'));
        return read_tum(&path).map_err(|error| match (error, &folder) {
            (Error::Trajectory { path, source, .. }, None) => {
                let hint = format!(
                    "; {} asks for it: set VERGENCE_DATA to the folder of the data sets",
                    motion.display()
                );
                Error::Trajectory { path, source, hint }
            }
            (Error::Trajectory { path, source, .. }, Some(folder)) => {
                let hint =
                    format!("; VERGENCE_DATA is {}: is that the folder of the data sets?", folder.display());
                Error::Trajectory { path, source, hint }
            }
            (error, _) => error,
        });
    }
    let path = motion.parent().unwrap_or(Path::new("")).join(name);
    match BUILT_IN_TRAJECTORIES.iter().find(|(built_in, _)| *built_in == name && !path.is_file()) {
        Some((built_in, text)) => parse_tum(Path::new(built_in), text),
        None => read_tum(&path),
    }
}

impl PoseProvider for Motion {
    fn head(&self, at: Timestamp) -> Tracked {
        self.trajectory
            .at(at)
            .map(|world_from_body| self.stage_from_world * world_from_body * self.body_from_head)
    }

    fn controller(&self, hand: Hand, at: Timestamp) -> Controller {
        held_in_front(&self.head(at), hand)
    }

    fn end(&self) -> Option<Timestamp> {
        self.trajectory.end()
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    const HEAD: &str = "[head-from-body]\nposition = [\"0 m\", \"0 m\", \"0 m\"]\nrotation = [0, 0, 0, 1]\n";

    fn motion(folder: &Path, trajectory: &str, keys: &str) -> Result<Motion, Error> {
        std::fs::write(folder.join("t.txt"), trajectory).unwrap();
        let text = format!(
            "trajectory = \"t.txt\"\nat-end = \"hold\"\n{keys}\n[gaps]\nlongest-step = \"1 s\"\nacross = \"lost\"\n{HEAD}"
        );
        Motion::parse(&folder.join("m.toml"), &text)
    }

    #[test]
    fn up_stays_up_and_ahead_becomes_minus_z() {
        let turn = y_up_from_z_up();
        assert!((turn * Vector3::z() - Vector3::y()).norm() < 1e-15);
        assert!((turn * Vector3::y() + Vector3::z()).norm() < 1e-15);
    }

    #[test]
    fn start_relative_puts_the_eyes_at_the_start_and_keeps_every_movement() {
        let folder = tempfile::tempdir().unwrap();
        // A body that stands at (5, 6, 7) turned by 90° about the vertical z, then goes 1 m where its y axis points.
        let (s, c) = (std::f64::consts::FRAC_1_SQRT_2, std::f64::consts::FRAC_1_SQRT_2);
        let lines = format!("10 5 6 7 0 0 {s} {c}\n11 4 6 7 0 0 {s} {c}\n12 4 6 7.5 0 0 {s} {c}\n");
        let keys = "world-axes = \"z-up\"\nplacement = \"start-relative\"\neye-height = \"1.7 m\"";
        let mut motion = motion(folder.path(), &lines, keys).unwrap();
        // The head looks along the body's y, its top along the body's z.
        motion.body_from_head = Rigid::identity();
        let body_from_head = Rigid::rotation(Vector3::x() * std::f64::consts::FRAC_PI_2);
        let text = lines.clone();
        std::fs::write(folder.path().join("t.txt"), text).unwrap();
        let rotation = body_from_head.inverse().rotation;
        let q = rotation.coords;
        let file = format!(
            "trajectory = \"t.txt\"\nat-end = \"stop\"\n{keys}\n[gaps]\nlongest-step = \"2 s\"\nacross = \"lost\"\n[head-from-body]\nposition = [\"0 m\", \"0 m\", \"0 m\"]\nrotation = [{:?}, {:?}, {:?}, {:?}]\n",
            q.x, q.y, q.z, q.w
        );
        let motion = Motion::parse(&folder.path().join("m.toml"), &file).unwrap();
        let at = |secs: i64| motion.head(Timestamp::from_nanos(secs * 1_000_000_000)).pose().unwrap();
        let expected = [(0, [0.0, 1.7, 0.0]), (1, [0.0, 1.7, -1.0]), (2, [0.0, 2.2, -1.0])];
        for (secs, [x, y, z]) in expected {
            let found = at(secs);
            assert!((found.translation.vector - Vector3::new(x, y, z)).norm() < 1e-12, "{secs}: {found}");
            assert!(found.rotation.angle() < 1e-7, "{secs}: {found}");
        }
        assert_eq!(motion.end(), Some(Timestamp::from_nanos(2_000_000_000)));
    }

    #[test]
    fn absolute_leaves_the_trajectory_where_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let motion =
            motion(folder.path(), "0 1 2 3 0 0 0 1\n", "world-axes = \"y-up\"\nplacement = \"absolute\"")
                .unwrap();
        assert_eq!(motion.head(Timestamp::default()), Tracked::Seen(Rigid::translation(1.0, 2.0, 3.0)));
    }

    #[test]
    fn wrong_values_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let keys = "world-axes = \"y-up\"\nplacement = \"absolute\"\n";
        for (more, said) in [
            ("start = \"2 s\"", "m.toml:5:9: expected a start within the 1 s of the trajectory, found 2 s"),
            ("start = \"-2 s\"", "m.toml:5:9: expected a start of at least 0 s, found -2 s"),
            ("strat = \"2 s\"", "unknown field `strat`"),
        ] {
            let error = motion(folder.path(), "0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", &format!("{keys}{more}"))
                .unwrap_err();
            assert!(error.to_string().contains(said), "{error}");
        }
        let unknown = Motion::open("nowhere.toml").unwrap_err().to_string();
        assert!(unknown.contains("one of still, room1, look-around, tour"), "{unknown}");
    }

    #[test]
    fn the_synthetic_motion_needs_no_file_and_starts_at_the_start() {
        let motion = Motion::open("look-around.toml").unwrap();
        let head = motion.head(Timestamp::default()).pose().unwrap();
        assert!((head.translation.vector - Vector3::new(0.0, 1.6, 0.0)).norm() < 1e-9, "{head}");
    }

    /// The hand-held rig of TUM-VI room 1: eyes start at eye height, and stay in a room of 4 m.
    #[test]
    fn the_recorded_motion_is_found_through_the_data_folder() {
        if std::env::var_os("VERGENCE_DATA").is_none() {
            let required = std::env::var("VERGENCE_REQUIRE").unwrap_or_default();
            assert!(!required.split(',').any(|need| need == "data"), "VERGENCE_DATA is not set");
            println!("skipped: no VERGENCE_DATA");
            return;
        }
        let motion = Motion::open("room1.toml").unwrap();
        let mut last = motion.head(Timestamp::default()).pose().unwrap();
        assert!((last.translation.vector - Vector3::new(0.0, 1.6, 0.0)).norm() < 1e-9);
        for frame in 1..300 {
            let head = motion.head(Timestamp::from_nanos(frame * 11_111_111)).pose().unwrap();
            assert!(
                head.translation.vector.xz().norm() < 4.0 && (0.5..3.0).contains(&head.translation.y),
                "{head}"
            );
            assert!((head.translation.vector - last.translation.vector).norm() < 0.05, "{frame}: {head}");
            // The rig is held upright: the top of the head points up, more or less.
            assert!((head.rotation * Vector3::y()).y > 0.5, "{frame}: {head}");
            last = head;
        }
    }
}
