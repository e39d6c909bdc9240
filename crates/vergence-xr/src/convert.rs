//! OpenXR's poses and angles (single precision) to ours and back.

use openxr::{Fovf, Posef, SpaceLocationFlags, ViewStateFlags};
use vergence_geom::{Fov, Rigid};
use vergence_sense::{Pose, Tracking};

/// The pose in which nothing is moved or turned.
pub(crate) const IDENTITY: Posef = Posef {
    orientation: openxr::Quaternionf { x: 0.0, y: 0.0, z: 0.0, w: 1.0 },
    position: openxr::Vector3f { x: 0.0, y: 0.0, z: 0.0 },
};

/// A located pose: parts that may not be read are lost.
pub(crate) fn pose(flags: SpaceLocationFlags, raw: &Posef) -> Pose {
    let position = Tracking::from_flags(
        flags.contains(SpaceLocationFlags::POSITION_VALID),
        flags.contains(SpaceLocationFlags::POSITION_TRACKED),
    );
    let orientation = Tracking::from_flags(
        flags.contains(SpaceLocationFlags::ORIENTATION_VALID),
        flags.contains(SpaceLocationFlags::ORIENTATION_TRACKED),
    );
    parts(raw, position, orientation)
}

/// An eye's pose: one set of flags holds for all eyes.
pub(crate) fn view_pose(flags: ViewStateFlags, raw: &Posef) -> Pose {
    let position = Tracking::from_flags(
        flags.contains(ViewStateFlags::POSITION_VALID),
        flags.contains(ViewStateFlags::POSITION_TRACKED),
    );
    let orientation = Tracking::from_flags(
        flags.contains(ViewStateFlags::ORIENTATION_VALID),
        flags.contains(ViewStateFlags::ORIENTATION_TRACKED),
    );
    parts(raw, position, orientation)
}

fn parts(raw: &Posef, position: Tracking, orientation: Tracking) -> Pose {
    let (p, q) = (raw.position, raw.orientation);
    Pose::from_parts(
        [p.x, p.y, p.z].map(f64::from),
        position,
        [q.x, q.y, q.z, q.w].map(f64::from),
        orientation,
    )
}

/// A pose as a runtime would say it.
pub(crate) fn said(reference_from_device: &Rigid) -> Posef {
    let (p, q) = (
        reference_from_device.translation.vector.cast::<f32>(),
        reference_from_device.rotation.cast::<f32>(),
    );
    Posef {
        orientation: openxr::Quaternionf { x: q.i, y: q.j, z: q.k, w: q.w },
        position: openxr::Vector3f { x: p.x, y: p.y, z: p.z },
    }
}

/// Angles of the sides, where they can be drawn.
pub(crate) fn fov(raw: &Fovf) -> Option<Fov> {
    let fov = Fov {
        left_rad: f64::from(raw.angle_left),
        right_rad: f64::from(raw.angle_right),
        up_rad: f64::from(raw.angle_up),
        down_rad: f64::from(raw.angle_down),
    };
    fov.checked().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flags_decide_what_may_be_read() {
        let raw = Posef { position: openxr::Vector3f { x: 1.0, y: 2.0, z: 3.0 }, ..IDENTITY };
        let all = SpaceLocationFlags::POSITION_VALID | SpaceLocationFlags::ORIENTATION_VALID;
        let found = pose(all, &raw);
        assert_eq!(found.position_tracking, Tracking::Inferred);
        assert_eq!(found.reference_from_device().unwrap().translation.vector.z, 3.0);
        assert!(pose(SpaceLocationFlags::ORIENTATION_VALID, &raw).reference_from_device().is_none());
        assert_eq!(pose(SpaceLocationFlags::EMPTY, &raw), Pose::LOST);
    }

    #[test]
    fn a_field_of_view_that_cannot_be_drawn_is_none() {
        assert!(fov(&Fovf::default()).is_none());
        let nan = Fovf { angle_left: f32::NAN, angle_right: 0.5, angle_up: 0.5, angle_down: -0.5 };
        assert!(fov(&nan).is_none());
    }
}
