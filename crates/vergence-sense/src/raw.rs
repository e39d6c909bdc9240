//! What a runtime says, bit for bit: the values before anybody judged, widened or normalised them. They are what a
//! session log keeps and what a replay gives back; [`Pose`](crate::Pose) is what they mean.

use crate::{JOINTS_PER_HAND, Pose, Tracking};

/// Which parts of a pose may be read and which are measured: the four flags of `XrSpaceLocationFlags` and
/// `XrViewStateFlags`, in their order and with their values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Validity(pub u8);

impl Validity {
    /// The orientation may be read.
    pub const ORIENTATION_VALID: u8 = 1;
    /// The position may be read.
    pub const POSITION_VALID: u8 = 2;
    /// The orientation is measured.
    pub const ORIENTATION_TRACKED: u8 = 4;
    /// The position is measured.
    pub const POSITION_TRACKED: u8 = 8;
    /// Everything is measured.
    pub const ALL: Self = Self(15);

    /// The flags that say this.
    pub const fn of(position: Tracking, orientation: Tracking) -> Self {
        const fn bits(tracking: Tracking, valid: u8, tracked: u8) -> u8 {
            match tracking {
                Tracking::Lost => 0,
                Tracking::Inferred => valid,
                Tracking::Measured => valid | tracked,
            }
        }
        Self(
            bits(position, Self::POSITION_VALID, Self::POSITION_TRACKED)
                | bits(orientation, Self::ORIENTATION_VALID, Self::ORIENTATION_TRACKED),
        )
    }

    /// Trust in the position.
    pub const fn position(self) -> Tracking {
        Tracking::from_flags(self.0 & Self::POSITION_VALID != 0, self.0 & Self::POSITION_TRACKED != 0)
    }

    /// Trust in the orientation.
    pub const fn orientation(self) -> Tracking {
        Tracking::from_flags(self.0 & Self::ORIENTATION_VALID != 0, self.0 & Self::ORIENTATION_TRACKED != 0)
    }
}

/// A pose as a runtime said it; equal only where every bit is (NaN equals itself, 0 differs from −0).
#[derive(Clone, Copy, Debug)]
pub struct RawPose {
    /// Metres, in the reference frame.
    pub position_m: [f32; 3],
    /// Hamilton quaternion, x y z w; of whatever length the runtime gave it.
    pub orientation_xyzw: [f32; 4],
}

/// A velocity as a runtime said it; equal only where every bit is.
#[derive(Clone, Copy, Debug)]
pub struct RawVelocity {
    /// Metres per second, in the reference frame.
    pub linear_m_s: [f32; 3],
    /// Radians per second about the axis, in the reference frame.
    pub angular_rad_s: [f32; 3],
    /// The linear part may be read.
    pub linear_valid: bool,
    /// The angular part may be read.
    pub angular_valid: bool,
}

/// Where something is, as a runtime said it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RawLocation {
    /// Where.
    pub pose: RawPose,
    /// What of it may be read.
    pub validity: Validity,
    /// How it moves, where that was asked for.
    pub velocity: Option<RawVelocity>,
}

/// One eye, as a runtime said it; equal only where every bit is.
#[derive(Clone, Copy, Debug)]
pub struct RawView {
    /// Where the eye is.
    pub pose: RawPose,
    /// Angles of the left, right, upper and lower side of the picture, radians.
    pub fov_rad: [f32; 4],
}

/// The eyes of one instant, as a runtime said them.
#[derive(Clone, Copy, Debug)]
pub struct RawViews {
    views: [RawView; Self::MOST],
    count: usize,
    /// What of them may be read; one set of flags holds for all.
    pub validity: Validity,
}

/// One joint of a hand, as a runtime said it; equal only where every bit is.
#[derive(Clone, Copy, Debug)]
pub struct RawJoint {
    /// Where.
    pub pose: RawPose,
    /// What of it may be read.
    pub validity: Validity,
    /// Distance of the skin from the joint, metres.
    pub radius_m: f32,
}

/// The joints of one hand as a runtime said them, in the order of [`HandJoint`](crate::HandJoint).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RawJoints {
    /// The hand is seen.
    pub is_active: bool,
    /// All of them.
    pub joints: [RawJoint; JOINTS_PER_HAND],
}

fn same<const N: usize>(a: [f32; N], b: [f32; N]) -> bool {
    a.map(f32::to_bits) == b.map(f32::to_bits)
}

impl RawPose {
    /// Nothing is moved or turned.
    pub const IDENTITY: Self = Self { position_m: [0.0; 3], orientation_xyzw: [0.0, 0.0, 0.0, 1.0] };

    /// What it means, under these flags.
    pub fn read(&self, validity: Validity) -> Pose {
        Pose::from_parts(
            self.position_m.map(f64::from),
            validity.position(),
            self.orientation_xyzw.map(f64::from),
            validity.orientation(),
        )
    }
}

impl PartialEq for RawPose {
    fn eq(&self, other: &Self) -> bool {
        same(self.position_m, other.position_m) && same(self.orientation_xyzw, other.orientation_xyzw)
    }
}

impl Eq for RawPose {}

impl PartialEq for RawVelocity {
    fn eq(&self, other: &Self) -> bool {
        same(self.linear_m_s, other.linear_m_s)
            && same(self.angular_rad_s, other.angular_rad_s)
            && (self.linear_valid, self.angular_valid) == (other.linear_valid, other.angular_valid)
    }
}

impl Eq for RawVelocity {}

impl PartialEq for RawView {
    fn eq(&self, other: &Self) -> bool {
        self.pose == other.pose && same(self.fov_rad, other.fov_rad)
    }
}

impl Eq for RawView {}

impl PartialEq for RawJoint {
    fn eq(&self, other: &Self) -> bool {
        self.pose == other.pose && self.validity == other.validity && same([self.radius_m], [other.radius_m])
    }
}

impl Eq for RawJoint {}

impl RawLocation {
    /// What it means.
    pub fn read(&self) -> Pose {
        self.pose.read(self.validity)
    }
}

impl RawViews {
    /// Two eyes, or four where the periphery has its own.
    pub const MOST: usize = 4;

    /// Nobody looks.
    pub const NONE: Self = Self {
        views: [RawView { pose: RawPose::IDENTITY, fov_rad: [0.0; 4] }; Self::MOST],
        count: 0,
        validity: Validity(0),
    };

    /// From one view per eye; `None` where there are more than [`RawViews::MOST`].
    pub fn new(validity: Validity, views: &[RawView]) -> Option<Self> {
        let mut all = Self { validity, count: views.len(), ..Self::NONE };
        all.views.get_mut(..views.len())?.copy_from_slice(views);
        Some(all)
    }

    /// One per eye.
    pub fn views(&self) -> &[RawView] {
        &self.views[..self.count]
    }
}

impl PartialEq for RawViews {
    fn eq(&self, other: &Self) -> bool {
        self.validity == other.validity && self.views() == other.views()
    }
}

impl Eq for RawViews {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equality_is_that_of_bits() {
        let nan = RawPose { position_m: [f32::NAN, 0.0, 0.0], ..RawPose::IDENTITY };
        assert_eq!(nan, nan);
        let minus = RawPose { position_m: [-0.0, 0.0, 0.0], ..RawPose::IDENTITY };
        assert_ne!(minus, RawPose::IDENTITY);
    }

    #[test]
    fn flags_are_openxrs() {
        let seen = Validity(Validity::ORIENTATION_VALID | Validity::ORIENTATION_TRACKED);
        assert_eq!((seen.orientation(), seen.position()), (Tracking::Measured, Tracking::Lost));
        assert_eq!(Validity(Validity::POSITION_VALID).position(), Tracking::Inferred);
        assert_eq!(RawPose::IDENTITY.read(Validity(0)), Pose::LOST);
    }

    #[test]
    fn more_views_than_there_can_be_are_refused() {
        let view = RawView { pose: RawPose::IDENTITY, fov_rad: [-0.5, 0.5, 0.5, -0.5] };
        assert!(RawViews::new(Validity::ALL, &[view; 5]).is_none());
        assert_eq!(RawViews::new(Validity::ALL, &[view; 2]).unwrap().views(), [view; 2]);
    }
}
