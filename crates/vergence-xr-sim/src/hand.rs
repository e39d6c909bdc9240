//! The joints of the hands (XR_EXT_hand_tracking).

use std::sync::Arc;

use openxr_sys as sys;
use vergence_geom::Rigid;
use vergence_sense::JOINTS_PER_HAND;
use vergence_time::{Span, Timestamp};

use crate::clock::valid_time;
use crate::fault::bent_pose;
use crate::ffi::{In, Out, XrResult, chained_out};
use crate::handle::{self, Object};
use crate::instance::Instance;
use crate::motion::{Hand, HandPose, Tracked};
use crate::pose::{from_raw, to_xr, to_xr_vector};
use crate::session::Session;
use crate::space::{self, Space, VELOCITY_STEP, flags_of, velocity_between, velocity_flags};

/// What an application follows a hand by.
pub(crate) struct HandTracker {
    session: Arc<Session>,
    hand: Hand,
}

impl Object for HandTracker {
    type Handle = sys::HandTrackerEXT;
}

impl Instance {
    /// Whether the headset sees hands; where a recording is said again it does, for it sees what it saw then.
    pub(crate) fn sees_hands(&self) -> bool {
        self.config.profile.hands || self.config.motion.replay().is_some()
    }

    /// Whether the headset sees where its user looks; as for hands.
    pub(crate) fn sees_gaze(&self) -> bool {
        self.config.profile.gaze || self.config.motion.replay().is_some()
    }
}

/// The tracker behind a handle, if its session is not lost.
pub(crate) fn get(handle: sys::HandTrackerEXT) -> XrResult<Arc<HandTracker>> {
    let tracker = handle::get::<HandTracker>(handle)?;
    tracker.session.check_lost()?;
    Ok(tracker)
}

pub(crate) fn create_hand_tracker(
    session: Arc<Session>,
    info: In<sys::HandTrackerCreateInfoEXT>,
    mut out: Out<sys::HandTrackerEXT>,
) -> XrResult {
    let info = info.get()?;
    out.check()?;
    let hand = match info.hand {
        sys::HandEXT::LEFT => Hand::Left,
        sys::HandEXT::RIGHT => Hand::Right,
        _ => return Err(sys::Result::ERROR_VALIDATION_FAILURE),
    };
    if info.hand_joint_set != sys::HandJointSetEXT::DEFAULT {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    if !session.instance.sees_hands() {
        return Err(sys::Result::ERROR_FEATURE_UNSUPPORTED);
    }
    let parent = sys::Handle::into_raw(session.handle);
    let (handle, _) = handle::insert(parent, |_| HandTracker { session, hand });
    out.set(handle)?;
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn destroy_hand_tracker(tracker: sys::HandTrackerEXT) -> XrResult {
    handle::remove::<HandTracker>(tracker)?;
    Ok(sys::Result::SUCCESS)
}

/// The joints in `base` at an instant, and whether they are measured; `None` where the hand is not seen.
fn joints(tracker: &HandTracker, base: &Space, at: Timestamp) -> Option<(HandPose, bool)> {
    let session = &tracker.session;
    let motion_time = session.lock().motion_time(at);
    let mut pose = session.instance.config.motion.hand(tracker.hand, motion_time)?;
    let stage_from_base = base.stage_from_space(at);
    let base_from_stage: Rigid = stage_from_base.pose()?.inverse();
    for (joint, _) in &mut pose.joints {
        *joint = base_from_stage * *joint;
    }
    let is_tracked = pose.is_tracked && matches!(stage_from_base, Tracked::Seen(_));
    Some((pose, is_tracked))
}

pub(crate) fn locate_hand_joints(
    tracker: &HandTracker,
    info: In<sys::HandJointsLocateInfoEXT>,
    mut out: Out<sys::HandJointLocationsEXT>,
) -> XrResult {
    let info = info.get()?;
    let locations = out.fill()?;
    let base = space::get(info.base_space)?;
    if !Arc::ptr_eq(&base.session, &tracker.session) {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    let at = valid_time(info.time)?;
    let room = locations.joint_locations;
    if locations.joint_count as usize != JOINTS_PER_HAND || room.is_null() || !room.is_aligned() {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    let velocities = chained_out::<sys::HandJointVelocitiesEXT>(locations.next);
    if velocities.as_ref().is_some_and(|v| {
        v.joint_count as usize != JOINTS_PER_HAND
            || v.joint_velocities.is_null()
            || !v.joint_velocities.is_aligned()
    }) {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    let nowhere = sys::HandJointLocationEXT {
        location_flags: sys::SpaceLocationFlags::EMPTY,
        pose: sys::Posef::IDENTITY,
        radius: 0.0,
    };
    let replay = tracker.session.replay().filter(|_| base.is_local());
    let said = replay.and_then(|replay| replay.joints(tracker.hand, at));
    let found = if said.is_none() { joints(tracker, &base, at) } else { None };
    let is_active = said.map_or(found.is_some(), |said| said.is_active);
    locations.is_active = is_active.into();
    for index in 0..JOINTS_PER_HAND {
        let location = match (&said, &found) {
            (Some(said), _) => {
                let joint = &said.joints[index];
                sys::HandJointLocationEXT {
                    location_flags: sys::SpaceLocationFlags::from_raw(u64::from(joint.validity.0)),
                    pose: bent_pose(from_raw(&joint.pose)),
                    radius: joint.radius_m,
                }
            }
            (None, Some((hand, is_tracked))) => {
                let (pose, radius_m) = &hand.joints[index];
                sys::HandJointLocationEXT {
                    location_flags: flags_of(*is_tracked),
                    pose: bent_pose(to_xr(pose)),
                    radius: *radius_m as f32,
                }
            }
            (None, None) => nowhere,
        };
        // SAFETY: the application lends room for `joint_count` joints, which is their number.
        unsafe { room.add(index).write(location) };
    }
    if let Some(velocities) = velocities {
        let around = found.as_ref().and_then(|_| {
            let (before, after) = (
                at.saturating_add(Span::from_nanos(-VELOCITY_STEP.as_nanos())),
                at.saturating_add(VELOCITY_STEP),
            );
            Some((joints(tracker, &base, before)?.0, joints(tracker, &base, after)?.0))
        });
        for index in 0..JOINTS_PER_HAND {
            let velocity =
                around.as_ref().map(|(a, b)| velocity_between(&a.joints[index].0, &b.joints[index].0));
            let (linear, angular) = velocity.unwrap_or_default();
            let velocity = sys::HandJointVelocityEXT {
                velocity_flags: velocity.map_or(sys::SpaceVelocityFlags::EMPTY, |_| velocity_flags()),
                linear_velocity: to_xr_vector(&linear),
                angular_velocity: to_xr_vector(&angular),
            };
            // SAFETY: as above, with the velocities' own `joint_count`.
            unsafe { velocities.joint_velocities.add(index).write(velocity) };
        }
    }
    Ok(sys::Result::SUCCESS)
}
