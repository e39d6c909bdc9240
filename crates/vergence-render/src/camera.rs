//! Views where there is no headset: a head, a field of view, and eyes a stated distance apart.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use vergence_geom::{Fov, View};

/// A head at `eye` that looks at `target` (both world coordinates, metres) with its x axis level; straight up or
/// down the head's y points along −z or z. Where both are the same point it looks along −z.
pub fn look_at(eye: &Point3<f64>, target: &Point3<f64>) -> Isometry3<f64> {
    let ahead = (target - eye).try_normalize(1e-12).unwrap_or(-Vector3::z());
    // Half-way round, level is any way.
    let up = if ahead.y.abs() > 1.0 - 1e-12 { Vector3::new(0.0, 0.0, -ahead.y) } else { Vector3::y() };
    let rotation = UnitQuaternion::face_towards(&-ahead, &up);
    Isometry3::from_parts(Translation3::from(eye.coords), rotation)
}

/// Left and right eye, `ipd_m` apart along the head's x axis, looking the same way through the same field of view.
pub fn stereo(world_from_head: &Isometry3<f64>, ipd_m: f64, fov: Fov) -> [View; 2] {
    [-0.5, 0.5].map(|side| {
        let head_from_eye = Translation3::new(side * ipd_m, 0.0, 0.0);
        View { world_from_eye: world_from_head * head_from_eye, fov }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_head_looks_along_its_minus_z() {
        for target in [Point3::new(3.0, 1.0, -2.0), Point3::new(1.0, 9.0, 1.0), Point3::new(1.0, -9.0, 1.0)] {
            let eye = Point3::new(1.0, 2.0, 1.0);
            let world_from_head = look_at(&eye, &target);
            let ahead = world_from_head * -Vector3::z();
            assert!((ahead - (target - eye).normalize()).norm() < 1e-12, "{target}");
            assert!((world_from_head * Vector3::x()).y.abs() < 1e-12, "{target}");
        }
    }

    #[test]
    fn eyes_are_the_stated_distance_apart() {
        let fov = Fov::symmetric(1.0, 1.0).unwrap();
        let head = look_at(&Point3::new(1.0, 2.0, 3.0), &Point3::origin());
        let [left, right] = stereo(&head, 0.063, fov);
        let offset = left.world_from_eye.inverse() * right.world_from_eye;
        assert!((offset.translation.vector - Vector3::new(0.063, 0.0, 0.0)).norm() < 1e-12);
    }
}
