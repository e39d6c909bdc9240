//! A place to listen: what the runtime says and is told, in the order of the calls.

use std::any::Any;

use openxr::{Fovf, Posef, SpaceLocationFlags, ViewStateFlags};
use vergence_sense::{RawLocation, RawPose, RawView, RawViews, Said, Validity};

/// Hears what a session's calls say, in their order, on the thread of the frame loop. Must neither wait nor fail: what it
/// cannot keep it drops and counts.
pub trait Tap: Any + Send {
    /// One answer, or what the runtime was told.
    fn hear(&mut self, said: &Said);
}

/// Where a tap may be; costs a test where there is none.
#[derive(Default)]
pub(crate) struct Ear(pub(crate) Option<Box<dyn Tap>>);

impl Ear {
    pub(crate) fn hear(&mut self, said: impl FnOnce() -> Said) {
        if let Some(tap) = &mut self.0 {
            tap.hear(&said());
        }
    }
}

pub(crate) fn raw_pose(pose: &Posef) -> RawPose {
    let (p, q) = (pose.position, pose.orientation);
    RawPose { position_m: [p.x, p.y, p.z], orientation_xyzw: [q.x, q.y, q.z, q.w] }
}

pub(crate) fn raw_location(flags: SpaceLocationFlags, pose: &Posef) -> RawLocation {
    // The four flags have the values of ours.
    let validity = Validity((flags.into_raw() & 15) as u8);
    RawLocation { pose: raw_pose(pose), validity, velocity: None }
}

/// As many views as there are; what would not fit is left out.
pub(crate) fn raw_views(flags: ViewStateFlags, views: impl Iterator<Item = (Posef, Fovf)>) -> RawViews {
    let mut raw = [RawView { pose: RawPose::IDENTITY, fov_rad: [0.0; 4] }; RawViews::MOST];
    let mut count = 0;
    for ((pose, fov), place) in views.zip(&mut raw) {
        let fov_rad = [fov.angle_left, fov.angle_right, fov.angle_up, fov.angle_down];
        *place = RawView { pose: raw_pose(&pose), fov_rad };
        count += 1;
    }
    RawViews::new(Validity((flags.into_raw() & 15) as u8), &raw[..count]).unwrap_or(RawViews::NONE)
}
