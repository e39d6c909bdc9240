#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod affine;
mod fov;
mod frustum;
mod lens;
mod ray;
mod rotation;

pub use affine::{Affine, Trs};
pub use fov::{Fov, FovError, clip_from_eye, eye_depth_from_clip_depth, project};
pub use frustum::{Frustum, Plane};
pub use lens::{Camera, Distortion, Lens, LensError};
pub use ray::Ray;
pub use rotation::{
    advance, exp, interpolate, left_jacobian, left_jacobian_inverse, log, mean, right_jacobian,
    right_jacobian_inverse, slerp, stumpff, yaw,
};

/// A rigid transform: rotation (unit Hamilton quaternion, stored x y z w) and translation in metres.
pub type Rigid = nalgebra::Isometry3<f64>;

/// A rigid transform as files write it: translation x, y, z in metres, then the quaternion x, y, z, w.
pub fn components(a_from_b: &Rigid) -> [f64; 7] {
    let (t, q) = (a_from_b.translation.vector, a_from_b.rotation.coords);
    [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
}

/// Takes coordinates of a world whose z points up (x, y level: EuRoC, TUM, east-north-up) to one of ours (y up, −z forward): x stays,
/// what pointed up still does, and y, which pointed ahead, becomes −z.
pub fn y_up_from_z_up() -> Rigid {
    Rigid::rotation(nalgebra::Vector3::x() * -std::f64::consts::FRAC_PI_2)
}

/// One eye of one frame: where it is and what it sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Takes eye coordinates (x right, y up, −z forward, metres) to world coordinates.
    pub world_from_eye: Rigid,
    /// Angles of the four sides of the image, as seen from the eye.
    pub fov: Fov,
}
