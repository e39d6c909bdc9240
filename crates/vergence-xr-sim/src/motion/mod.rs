//! What moves the simulated headset: pose providers, pure functions of time.

mod file;
mod hand;
mod replay;
mod script;
mod still;
mod track;
mod trajectory;
mod tum;

use std::path::Path;

use vergence_geom::Rigid;
use vergence_time::Timestamp;

use crate::Error;

pub use file::{BUILT_IN_MOTIONS, Motion};
pub use hand::{BONES_MM, HandPose};
pub use replay::{EXIT_REQUESTED, HUNG, RUN_ENDED, Replay, SESSION_BEGINS};
pub(crate) use replay::{Next, result_of};
pub use script::{Part, Script};
pub use still::Still;
pub use trajectory::{AtEnd, Gaps, Sample, Trajectory};
pub use tum::{parse_tum, read_tum};
pub use vergence_sense::Hand;

/// The scripts that come with the crate, by name: each is also a file under `motions/`.
pub const BUILT_IN_SCRIPTS: [(&str, &str); 1] = [("tour.toml", include_str!("../../motions/tour.toml"))];

/// What moves the headset, by name: `still`, a motion file or a script, be it a file or one that comes with the crate.
///
/// # Errors
/// Where there is neither, or as [`Motion::parse`] and [`Script::parse`].
pub fn open(name: &str) -> Result<Box<dyn PoseProvider>, Error> {
    /// A file with a trajectory is a motion.
    #[derive(serde::Deserialize)]
    struct Kind {
        #[serde(default)]
        trajectory: Option<serde::de::IgnoredAny>,
    }
    let path = Path::new(name);
    let is_file = path.is_file();
    if name == "still" && !is_file {
        return Ok(Box::new(Still::default()));
    }
    let built_in = BUILT_IN_SCRIPTS.iter().find(|(built_in, _)| {
        let stem = built_in.trim_end_matches(".toml");
        !is_file && path.file_name().is_some_and(|file| file == *built_in || file == stem)
    });
    if let Some((built_in, text)) = built_in {
        return Ok(Box::new(Script::parse(Path::new(built_in), text)?));
    }
    if is_file && vergence_config::read::<Kind>(path)?.trajectory.is_none() {
        return Ok(Box::new(Script::parse(path, &vergence_config::read_text(path)?)?));
    }
    Ok(Box::new(Motion::open(name)?))
}

/// The names that [`open`] knows without a file, for errors.
fn built_in_names() -> String {
    let files = BUILT_IN_MOTIONS.iter().chain(&BUILT_IN_SCRIPTS);
    let names: Vec<&str> = files.map(|(name, _)| name.trim_end_matches(".toml")).collect();
    format!("still, {}", names.join(", "))
}

/// How far the user attends to the application, the least first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Presence {
    /// The headset is off the head: the session stops, and is ready again when it is put on.
    Away,
    /// The headset shows something else: frames are paced, and none is asked for (`shouldRender` is false).
    Hidden,
    /// The application is seen, but a menu of the system has the input.
    Visible,
    /// The application has the user's attention.
    #[default]
    Focused,
}

/// Where a tracked body is, as far as the tracking knows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Tracked {
    /// Tracked: takes body coordinates to stage coordinates (floor level, y up, metres).
    Seen(Rigid),
    /// Not tracked now; the last that is known.
    Held(Rigid),
    /// Nothing is known.
    Lost,
}

impl Tracked {
    /// The pose, tracked or held.
    pub fn pose(&self) -> Option<Rigid> {
        match *self {
            Self::Seen(pose) | Self::Held(pose) => Some(pose),
            Self::Lost => None,
        }
    }

    /// The same knowledge about another body that is fixed to this one.
    pub fn map(self, change: impl FnOnce(Rigid) -> Rigid) -> Self {
        match self {
            Self::Seen(pose) => Self::Seen(change(pose)),
            Self::Held(pose) => Self::Held(change(pose)),
            Self::Lost => Self::Lost,
        }
    }
}

/// One controller at one instant.
#[derive(Clone, Debug, PartialEq)]
pub struct Controller {
    /// Switched on and connected; otherwise its actions are inactive.
    pub connected: bool,
    /// The grip: palm centre, +x out of the palm of the left hand and into that of the right one, −z along the closed
    /// fingers' tube to the thumb (the "grip" pose of OpenXR).
    pub grip: Tracked,
    /// The aim: −z points (the "aim" pose of OpenXR).
    pub aim: Tracked,
    /// How far the trigger is pulled, 0…1.
    pub trigger: f32,
    /// How far the grip is squeezed, 0…1.
    pub squeeze: f32,
    /// Thumbstick (or trackpad), right and up positive, each −1…1.
    pub stick: [f32; 2],
    /// The thumbstick is pressed.
    pub stick_click: bool,
    /// The lower face button (X, A) is pressed.
    pub primary: bool,
    /// The upper face button (Y, B) is pressed.
    pub secondary: bool,
    /// The menu button is pressed.
    pub menu: bool,
    /// Fingers touch the trigger, the thumbstick, the lower and the upper face button.
    pub touches: [bool; 4],
}

impl Controller {
    /// A controller that is not there.
    pub fn absent() -> Self {
        Self { connected: false, ..Self::idle(Tracked::Lost, Tracked::Lost) }
    }

    /// A connected controller at these poses, on which nothing is pressed.
    pub fn idle(grip: Tracked, aim: Tracked) -> Self {
        Self {
            connected: true,
            grip,
            aim,
            trigger: 0.0,
            squeeze: 0.0,
            stick: [0.0; 2],
            stick_click: false,
            primary: false,
            secondary: false,
            menu: false,
            touches: [false; 4],
        }
    }
}

/// What moves the simulated headset and its controllers.
///
/// Pure in time: the same instant always gives the same answer, whoever asks and in whatever order. Instants are
/// counted from the first `xrBeginSession` (0); earlier ones are negative and legal.
pub trait PoseProvider: Send + Sync {
    /// Where the head is: the point between the eyes, x right, y up, −z where the face looks.
    fn head(&self, at: Timestamp) -> Tracked;

    /// What a hand holds.
    fn controller(&self, hand: Hand, at: Timestamp) -> Controller;

    /// The joints of a hand, where it is seen; unless said otherwise it closes around what it holds.
    fn hand(&self, hand: Hand, at: Timestamp) -> Option<HandPose> {
        HandPose::holding(&self.controller(hand, at), hand)
    }

    /// Where the user looks: from between the eyes along −z, in stage coordinates; unless said otherwise straight ahead.
    fn gaze(&self, at: Timestamp) -> Tracked {
        self.head(at)
    }

    /// How far the user attends to the application.
    fn presence(&self, _at: Timestamp) -> Presence {
        Presence::Focused
    }

    /// Whether the application is asked to draw (`shouldRender`) while it is visible.
    fn renders(&self, _at: Timestamp) -> bool {
        true
    }

    /// How often the user has recentred the headset from motion time 0 to `at`.
    fn recentrings(&self, _at: Timestamp) -> u64 {
        0
    }

    /// The recording that is said again, where this is one: its answers go before all else.
    fn replay(&self) -> Option<&Replay> {
        None
    }

    /// When the motion is over and the runtime asks the application to end; `None` for a motion without end.
    fn end(&self) -> Option<Timestamp> {
        None
    }
}

/// The same provider, shared: a session that is lost goes on with what moved it before.
impl<T: PoseProvider + ?Sized> PoseProvider for std::sync::Arc<T> {
    fn head(&self, at: Timestamp) -> Tracked {
        (**self).head(at)
    }

    fn controller(&self, hand: Hand, at: Timestamp) -> Controller {
        (**self).controller(hand, at)
    }

    fn hand(&self, hand: Hand, at: Timestamp) -> Option<HandPose> {
        (**self).hand(hand, at)
    }

    fn gaze(&self, at: Timestamp) -> Tracked {
        (**self).gaze(at)
    }

    fn presence(&self, at: Timestamp) -> Presence {
        (**self).presence(at)
    }

    fn renders(&self, at: Timestamp) -> bool {
        (**self).renders(at)
    }

    fn recentrings(&self, at: Timestamp) -> u64 {
        (**self).recentrings(at)
    }

    fn replay(&self) -> Option<&Replay> {
        (**self).replay()
    }

    fn end(&self) -> Option<Timestamp> {
        (**self).end()
    }
}

/// Controllers held in front of the body: a hand's width beside and below the head and at arm's length, turned
/// with the head about the vertical only.
pub(crate) fn held_in_front(stage_from_head: &Tracked, hand: Hand) -> Controller {
    let side = match hand {
        Hand::Left => -1.0,
        Hand::Right => 1.0,
    };
    let stage_from_grip = stage_from_head.map(|stage_from_head| {
        let stage_from_body = Rigid::from_parts(stage_from_head.translation, yaw_of(&stage_from_head));
        stage_from_body * Rigid::translation(0.2 * side, -0.35, -0.4)
    });
    Controller::idle(stage_from_grip, aim_of(&stage_from_grip))
}

/// Where a controller points that is held so: on most, 40° below the tube that the hand closes around.
pub(crate) fn aim_of(stage_from_grip: &Tracked) -> Tracked {
    let grip_from_aim = Rigid::rotation(nalgebra::Vector3::new(-40f64.to_radians(), 0.0, 0.0));
    stage_from_grip.map(|stage_from_grip| stage_from_grip * grip_from_aim)
}

/// See [`vergence_geom::yaw`].
pub(crate) fn yaw_of(pose: &Rigid) -> nalgebra::UnitQuaternion<f64> {
    vergence_geom::yaw(&pose.rotation)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn yaw_is_what_is_left_when_pitch_and_roll_are_taken_away() {
        for yaw in [-3.0, -1.0, 0.0, 0.5, 3.1] {
            for (pitch, roll) in [(0.0, 0.0), (0.7, -0.4), (-1.5, 2.0)] {
                let turn = |axis: nalgebra::Vector3<f64>, angle: f64| Rigid::rotation(axis * angle);
                let pose = turn(nalgebra::Vector3::y(), yaw)
                    * turn(nalgebra::Vector3::x(), pitch)
                    * turn(nalgebra::Vector3::z(), roll);
                let found = yaw_of(&pose);
                let truth = nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Vector3::y_axis(), yaw);
                assert!(found.angle_to(&truth) < 1e-7, "{yaw} {pitch} {roll}");
            }
        }
        let straight_down = Rigid::rotation(nalgebra::Vector3::x() * -std::f64::consts::FRAC_PI_2);
        assert!(yaw_of(&straight_down).angle() < 1e-7);
    }
}
