#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod body;
mod control;
mod happening;
mod image;
mod imu;
mod pose;
mod raw;
mod said;
mod source;

pub use body::{Gaze, HandJoint, HandJoints, JOINTS_PER_HAND, JointPose};
pub use control::{Axis, Button, Haptic, Touch, TouchPhase, Vector2};
pub use happening::{CallResult, Event, FrameHash, FrameTiming, Scalar};
pub use image::Image;
pub use imu::Imu;
pub use pose::{Pose, Tracking, Velocity};
pub use raw::{RawJoint, RawJoints, RawLocation, RawPose, RawVelocity, RawView, RawViews, Validity};
pub use said::{Body, ControlState, Said};
pub use source::{Progress, Reading, ReadingKind, Sink, Source, SourceStream};

use vergence_time::Timestamp;

/// One reading of one stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample<T> {
    /// The instant for which the value holds, session time.
    pub captured: Timestamp,
    /// The instant at which it reached us, session time.
    pub arrived: Timestamp,
    /// What was read.
    pub value: T,
}

/// Which hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Hand {
    /// The user's left.
    Left,
    /// The user's right.
    Right,
}

impl Hand {
    /// Both, left first; the order of every pair of values for hands.
    pub const BOTH: [Self; 2] = [Self::Left, Self::Right];

    /// Place in a pair of values for hands: 0 left, 1 right.
    pub const fn index(self) -> usize {
        match self {
            Self::Left => 0,
            Self::Right => 1,
        }
    }

    /// The hand on the other side.
    pub const fn other(self) -> Self {
        match self {
            Self::Left => Self::Right,
            Self::Right => Self::Left,
        }
    }

    /// `left` or `right`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Left => "left",
            Self::Right => "right",
        }
    }
}

impl std::fmt::Display for Hand {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}
