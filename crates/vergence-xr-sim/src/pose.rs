//! Between the poses of OpenXR (`f32`) and ours (`f64`).

use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use openxr_sys as sys;
use vergence_geom::{Fov, Rigid};

use crate::ffi::XrResult;

/// How far the norm of a quaternion may be from 1: the specification says 1 %.
const NORM_TOLERANCE: f64 = 0.01;

pub(crate) fn to_xr(pose: &Rigid) -> sys::Posef {
    let (q, p) = (pose.rotation.coords, pose.translation.vector);
    sys::Posef {
        orientation: sys::Quaternionf { x: q.x as f32, y: q.y as f32, z: q.z as f32, w: q.w as f32 },
        position: to_xr_vector(&p),
    }
}

/// Every bit as it was said.
pub(crate) fn from_raw(pose: &vergence_sense::RawPose) -> sys::Posef {
    let ([px, py, pz], [x, y, z, w]) = (pose.position_m, pose.orientation_xyzw);
    sys::Posef {
        orientation: sys::Quaternionf { x, y, z, w },
        position: sys::Vector3f { x: px, y: py, z: pz },
    }
}

pub(crate) fn to_xr_vector(v: &nalgebra::Vector3<f64>) -> sys::Vector3f {
    sys::Vector3f { x: v.x as f32, y: v.y as f32, z: v.z as f32 }
}

/// # Errors
/// `XR_ERROR_POSE_INVALID` where a number is not finite or the quaternion not of length 1.
pub(crate) fn from_xr(pose: &sys::Posef) -> XrResult<Rigid> {
    let (q, p) = (pose.orientation, pose.position);
    let quaternion = Quaternion::new(f64::from(q.w), f64::from(q.x), f64::from(q.y), f64::from(q.z));
    let translation = Translation3::new(f64::from(p.x), f64::from(p.y), f64::from(p.z));
    // A comparison with NaN is false: not finite means not within the tolerance.
    let unit = (quaternion.norm() - 1.0).abs() <= NORM_TOLERANCE;
    if unit && translation.vector.iter().all(|c| c.is_finite()) {
        Ok(Rigid::from_parts(translation, UnitQuaternion::new_normalize(quaternion)))
    } else {
        Err(sys::Result::ERROR_POSE_INVALID)
    }
}

pub(crate) fn fov_to_xr(fov: &Fov) -> sys::Fovf {
    sys::Fovf {
        angle_left: fov.left_rad as f32,
        angle_right: fov.right_rad as f32,
        angle_up: fov.up_rad as f32,
        angle_down: fov.down_rad as f32,
    }
}

pub(crate) fn fov_from_xr(fov: &sys::Fovf) -> Fov {
    Fov {
        left_rad: f64::from(fov.angle_left),
        right_rad: f64::from(fov.angle_right),
        up_rad: f64::from(fov.angle_up),
        down_rad: f64::from(fov.angle_down),
    }
}
