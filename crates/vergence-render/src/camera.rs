//! Views where there is no headset: a head, a field of view, and eyes a stated distance apart.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use vergence_geom::{Fov, View};

/// A head at `eye` that looks at `target` (both world coordinates, metres); see [`look_along`]. Where both are the same
/// point it looks along −z.
pub fn look_at(eye: &Point3<f64>, target: &Point3<f64>) -> Isometry3<f64> {
    look_along(eye, &(target - eye))
}

/// A head at `eye` (world coordinates, metres) that looks along `ahead` (in world, of any length that a number has) with
/// its x axis level; straight up or down as one gets there from −z (the head's y points along z or −z). Where `ahead` says no direction (zero, not
/// finite), it is −z.
pub fn look_along(eye: &Point3<f64>, ahead: &Vector3<f64>) -> Isometry3<f64> {
    // By its largest component first: the square of a length beyond 1e±154 is no number.
    let largest = ahead.amax();
    let ahead = if largest.is_normal() { (ahead / largest).normalize() } else { -Vector3::z() };
    // Half-way round, level is any way.
    let up = if ahead.y.abs() > 1.0 - 1e-12 { Vector3::new(0.0, 0.0, ahead.y) } else { Vector3::y() };
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
    fn any_direction_that_a_number_has_is_looked_along() {
        let eye = Point3::new(1e7, -1e7, 1e7);
        for direction in
            [[0.0, 0.0, -1.0], [0.6, 0.0, 0.8], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [1e-9, 1.0, -1e-8]]
        {
            let direction = Vector3::from(direction);
            for length in [1e-300, 1e-200, 1e-13, 1.0, 1e200, 1e300] {
                let world_from_head = look_along(&eye, &(direction * length));
                let off = world_from_head * -Vector3::z() - direction.normalize();
                assert!(off.norm() < 1e-9, "{direction} of length {length}: {off}");
                assert!((world_from_head.rotation.norm() - 1.0).abs() < 1e-12);
            }
        }
        // Straight up is next to nearly up, and nothing says no direction.
        let (up, nearly) = (Vector3::y(), Vector3::new(0.0, 1.0, -1e-5));
        let turned = look_along(&eye, &up).rotation.angle_to(&look_along(&eye, &nearly).rotation);
        assert!(turned < 2e-5, "{turned}");
        for none in [Vector3::zeros(), Vector3::repeat(f64::NAN), Vector3::new(f64::INFINITY, 0.0, 0.0)] {
            let ahead = look_along(&eye, &none).rotation * -Vector3::z();
            assert!((ahead + Vector3::z()).norm() < 1e-12, "{none}: {ahead}");
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
