use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use vergence_geom::Rigid;

/// How far one part of a pose can be trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Tracking {
    /// Not known: the value must not be read.
    Lost,
    /// Not measured now: a model, a prediction over a long gap, or the last known value.
    Inferred,
    /// Measured.
    Measured,
}

impl Tracking {
    /// From the pair of flags that runtimes give: whether the value may be read, and whether it is measured.
    pub const fn from_flags(is_valid: bool, is_tracked: bool) -> Self {
        match (is_valid, is_tracked) {
            (false, _) => Self::Lost,
            (true, false) => Self::Inferred,
            (true, true) => Self::Measured,
        }
    }
}

/// Where a device is in its reference frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    reference_from_device: Rigid,
    /// Trust in the position.
    pub position_tracking: Tracking,
    /// Trust in the orientation.
    pub orientation_tracking: Tracking,
}

/// How a device moves in its reference frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Velocity {
    /// Metres per second, in reference coordinates.
    pub linear_m_s: Vector3<f64>,
    /// Radians per second about the axis, in reference coordinates.
    pub angular_rad_s: Vector3<f64>,
}

impl Pose {
    /// Nothing is known.
    pub const LOST: Self = Self {
        reference_from_device: Rigid {
            rotation: UnitQuaternion::new_unchecked(Quaternion::new(1.0, 0.0, 0.0, 0.0)),
            translation: nalgebra::Translation3 { vector: Vector3::new(0.0, 0.0, 0.0) },
        },
        position_tracking: Tracking::Lost,
        orientation_tracking: Tracking::Lost,
    };

    /// A pose that is measured in full.
    pub fn tracked(reference_from_device: Rigid) -> Self {
        Self {
            reference_from_device,
            position_tracking: Tracking::Measured,
            orientation_tracking: Tracking::Measured,
        }
    }

    /// From what a runtime says: position in metres and orientation as x y z w. A part whose flag says that it may
    /// not be read is not read. A part that is not finite, or a quaternion of a length that is not near 1 (0.1
    /// either way), counts as lost; a small error of the length is normalised away.
    pub fn from_parts(
        position_m: [f64; 3],
        position_tracking: Tracking,
        orientation_xyzw: [f64; 4],
        orientation_tracking: Tracking,
    ) -> Self {
        let mut pose = Self::LOST;
        if position_tracking != Tracking::Lost && position_m.iter().all(|x| x.is_finite()) {
            pose.reference_from_device.translation = Vector3::from(position_m).into();
            pose.position_tracking = position_tracking;
        }
        let [x, y, z, w] = orientation_xyzw;
        let length = (x * x + y * y + z * z + w * w).sqrt();
        // Written so that NaN fails.
        if orientation_tracking != Tracking::Lost && (0.9..=1.1).contains(&length) {
            pose.reference_from_device.rotation = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
            pose.orientation_tracking = orientation_tracking;
        }
        pose
    }

    /// Exactly these numbers, as [`Pose::to_exact`] gave them: nothing is judged and nothing normalised.
    pub fn from_exact(
        position_m: [f64; 3],
        position_tracking: Tracking,
        orientation_xyzw: [f64; 4],
        orientation_tracking: Tracking,
    ) -> Self {
        let [x, y, z, w] = orientation_xyzw;
        let rotation = UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z));
        let reference_from_device = Rigid::from_parts(Vector3::from(position_m).into(), rotation);
        Self { reference_from_device, position_tracking, orientation_tracking }
    }

    /// Position in metres and orientation as x y z w, for keeping: also the parts that may not be read.
    pub fn to_exact(&self) -> ([f64; 3], [f64; 4]) {
        let p = self.reference_from_device.translation.vector;
        let q = self.reference_from_device.rotation.coords;
        ([p.x, p.y, p.z], [q.x, q.y, q.z, q.w])
    }

    /// The pose where both of its parts may be read.
    pub fn reference_from_device(&self) -> Option<Rigid> {
        (self.position_tracking != Tracking::Lost && self.orientation_tracking != Tracking::Lost)
            .then_some(self.reference_from_device)
    }

    /// The orientation where it may be read (a headset that lost its position often still knows it).
    pub fn orientation(&self) -> Option<UnitQuaternion<f64>> {
        (self.orientation_tracking != Tracking::Lost).then_some(self.reference_from_device.rotation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MEASURED: Tracking = Tracking::Measured;

    #[test]
    fn what_may_not_be_read_is_not_read() {
        let pose = Pose::from_parts([f64::NAN; 3], Tracking::Lost, [0.0, 0.0, 0.0, 1.0], MEASURED);
        assert_eq!((pose.reference_from_device(), pose.position_tracking), (None, Tracking::Lost));
        assert!(pose.orientation().is_some());
    }

    #[test]
    fn nonsense_from_a_runtime_counts_as_lost() {
        for quaternion in [[0.0; 4], [f64::NAN, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, f64::INFINITY], [2.0; 4]] {
            let pose = Pose::from_parts([0.0; 3], MEASURED, quaternion, MEASURED);
            assert_eq!(pose.orientation_tracking, Tracking::Lost, "{quaternion:?}");
        }
        let pose = Pose::from_parts([0.0, f64::INFINITY, 0.0], MEASURED, [0.0, 0.0, 0.0, 1.0], MEASURED);
        assert_eq!(pose.position_tracking, Tracking::Lost);
    }

    #[test]
    fn a_quaternion_that_is_nearly_of_unit_length_is_normalised() {
        let pose = Pose::from_parts([1.0, 2.0, 3.0], MEASURED, [0.0, 0.6001, 0.0, 0.8], MEASURED);
        let rigid = pose.reference_from_device().unwrap();
        assert!((rigid.rotation.quaternion().norm() - 1.0).abs() < 1e-15);
        assert_eq!(rigid.translation.vector, Vector3::new(1.0, 2.0, 3.0));
    }
}
