//! The joints of the hands (XR_EXT_hand_tracking).

use vergence_sense::{Hand, HandJoints, JointPose};
use vergence_time::Timestamp;

use crate::Connection;
use crate::convert;
use crate::error::{Error, In};

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
            log::warn!("the headset does not see hands");
            return Ok(None);
        }
        let tracker = |hand| session.create_hand_tracker(hand).during("xrCreateHandTrackerEXT");
        let trackers = [tracker(openxr::Hand::LEFT)?, tracker(openxr::Hand::RIGHT)?];
        Ok(Some(Self { trackers, joints: [None; 2] }))
    }

    pub(crate) fn locate(&mut self, local: &openxr::Space, time: Timestamp) -> Result<(), Error> {
        let time = openxr::Time::from_nanos(time.as_nanos());
        for (tracker, joints) in self.trackers.iter().zip(&mut self.joints) {
            let located = local.locate_hand_joints(tracker, time).during("xrLocateHandJointsEXT")?;
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
