use nalgebra::{Point3, UnitVector3};

use crate::Pose;

/// Number of joints of a hand.
pub const JOINTS_PER_HAND: usize = 26;

/// A joint of a hand, in the order of XR_EXT_hand_tracking.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
#[expect(missing_docs, reason = "the names of bones say it")]
pub enum HandJoint {
    Palm,
    Wrist,
    ThumbMetacarpal,
    ThumbProximal,
    ThumbDistal,
    ThumbTip,
    IndexMetacarpal,
    IndexProximal,
    IndexIntermediate,
    IndexDistal,
    IndexTip,
    MiddleMetacarpal,
    MiddleProximal,
    MiddleIntermediate,
    MiddleDistal,
    MiddleTip,
    RingMetacarpal,
    RingProximal,
    RingIntermediate,
    RingDistal,
    RingTip,
    LittleMetacarpal,
    LittleProximal,
    LittleIntermediate,
    LittleDistal,
    LittleTip,
}

/// Where a joint is and how thick the hand is there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointPose {
    /// In the reference frame of the hand.
    pub pose: Pose,
    /// Distance of the skin from the joint, metres; 0 where it is not known.
    pub radius_m: f32,
}

/// All joints of one hand, in the order of [`HandJoint`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandJoints(pub [JointPose; JOINTS_PER_HAND]);

impl HandJoints {
    /// No joint is known.
    pub const LOST: Self = Self([JointPose { pose: Pose::LOST, radius_m: 0.0 }; JOINTS_PER_HAND]);

    /// One joint.
    pub const fn joint(&self, joint: HandJoint) -> &JointPose {
        &self.0[joint as usize]
    }
}

/// Where the user looks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gaze {
    /// Between the eyes, in reference coordinates, metres.
    pub origin: Point3<f64>,
    /// In reference coordinates.
    pub direction: UnitVector3<f64>,
}

impl Gaze {
    /// The gaze of a pose that looks along its −z; `None` where the pose may not be read.
    pub fn of(pose: &Pose) -> Option<Self> {
        let reference_from_gaze = pose.reference_from_device()?;
        Some(Self {
            origin: Point3::from(reference_from_gaze.translation.vector),
            direction: reference_from_gaze.rotation * -nalgebra::Vector3::z_axis(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vergence_geom::Rigid;

    #[test]
    fn the_last_joint_is_the_tip_of_the_little_finger() {
        assert_eq!(HandJoint::LittleTip as usize, JOINTS_PER_HAND - 1);
        assert_eq!(HandJoints::LOST.joint(HandJoint::LittleTip).pose, Pose::LOST);
    }

    #[test]
    fn gaze_is_along_minus_z() {
        let turned_left = Rigid::rotation(nalgebra::Vector3::y() * std::f64::consts::FRAC_PI_2);
        let gaze = Gaze::of(&Pose::tracked(turned_left)).unwrap();
        assert!((gaze.direction.into_inner() - -nalgebra::Vector3::x()).norm() < 1e-15);
        assert_eq!(Gaze::of(&Pose::LOST), None);
    }
}
