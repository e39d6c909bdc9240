//! The joints of the hands (XR_EXT_hand_tracking).

use vergence_sense::{
    Hand, HandJoints, JOINTS_PER_HAND, JointPose, RawJoint, RawJoints, RawPose, Said, Validity,
};
use vergence_time::Timestamp;

use crate::Connection;
use crate::convert;
use crate::error::Error;
use crate::tap::{Call, Ear, raw_location};

/// Trackers of both hands.
pub(crate) struct Hands {
    trackers: [openxr::HandTracker; 2],
    joints: [Option<HandJoints>; 2],
}

impl Hands {
    /// `None` where the runtime or the headset cannot see hands.
    pub(crate) fn new(
        connection: &Connection,
        session: &openxr::Session<openxr::Vulkan>,
    ) -> Result<Option<Self>, Error> {
        let offered = connection.has("XR_EXT_hand_tracking")
            && connection.instance.supports_hand_tracking(connection.system).unwrap_or(false);
        if !offered {
            log::info!("the headset does not see hands");
            return Ok(None);
        }
        let tracker = |hand| session.create_hand_tracker(hand);
        let trackers = tracker(openxr::Hand::LEFT).and_then(|left| Ok([left, tracker(openxr::Hand::RIGHT)?]));
        match trackers {
            Ok(trackers) => Ok(Some(Self { trackers, joints: [None; 2] })),
            // It offers what it does not do: a session without hands is one.
            Err(
                result @ (openxr::sys::Result::ERROR_FEATURE_UNSUPPORTED
                | openxr::sys::Result::ERROR_FUNCTION_UNSUPPORTED),
            ) => {
                log::info!("the headset does not see hands: {result}");
                Ok(None)
            }
            Err(result) => Err(Error::of("xrCreateHandTrackerEXT", result)),
        }
    }

    pub(crate) fn locate(
        &mut self,
        local: &openxr::Space,
        at: Timestamp,
        ear: &mut Ear,
    ) -> Result<(), Error> {
        let time = openxr::Time::from_nanos(at.as_nanos());
        for (hand, (tracker, joints)) in
            Hand::BOTH.into_iter().zip(self.trackers.iter().zip(&mut self.joints))
        {
            let located = ear.answer(Call::LocateHandJoints, local.locate_hand_joints(tracker, time))?;
            ear.hear(|| Said::Joints { hand, at, joints: raw_joints(located.as_ref()) });
            *joints = located.map(|located| {
                HandJoints(located.map(|joint| JointPose {
                    pose: convert::pose(joint.location_flags, &joint.pose),
                    radius_m: if joint.radius.is_finite() { joint.radius.max(0.0) } else { 0.0 },
                }))
            });
        }
        Ok(())
    }

    pub(crate) fn joints(&self, hand: Hand) -> Option<&HandJoints> {
        self.joints[hand.index()].as_ref()
    }
}

fn raw_joints(located: Option<&openxr::HandJointLocations>) -> RawJoints {
    let none = RawJoint { pose: RawPose::IDENTITY, validity: Validity(0), radius_m: 0.0 };
    let mut joints = [none; JOINTS_PER_HAND];
    for (joint, located) in joints.iter_mut().zip(located.into_iter().flatten()) {
        let place = raw_location(located.location_flags, &located.pose);
        *joint = RawJoint { pose: place.pose, validity: place.validity, radius_m: located.radius };
    }
    RawJoints { is_active: located.is_some(), joints }
}
