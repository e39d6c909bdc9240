#![doc = include_str!("../README.md")]

mod anchor;
mod brief;
mod dice;
mod error;
mod fast;
mod flow;
mod orb;
mod picture;
mod pose;
mod pyramid;
mod ransac;
mod relative;
mod simd;
mod stereo;
mod tracker;

pub use brief::{Descriptor, Match, MatchKnobs, match_all};
pub use error::Error;
pub use fast::{Corner, FastDetector};
pub use flow::{Flow, FlowKnobs, Found};
pub use orb::{Keypoint, Orb, OrbKnobs};
pub use picture::Gray;
pub use pose::{Landmark, camera_pose, camera_pose_upright};
pub use pyramid::{Level, Pyramid};
pub use ransac::{RansacKnobs, consensus};
pub use relative::{RayPair, essential, homography, poses_of_essential, relative_pose};
pub use stereo::epipolar_angle;
pub use tracker::{Frame, Prediction, Seen, StereoCount, TrackId, Tracker, TrackerKnobs};
