use nalgebra::{Point3, UnitVector3, Vector3};

use crate::View;

/// A half-space: the points `p` with `normal · p + offset_m ≥ 0`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Points inwards.
    pub normal: UnitVector3<f64>,
    /// Signed distance of the origin from the plane, metres.
    pub offset_m: f64,
}

impl Plane {
    /// Signed distance of `point` from the plane, metres; positive inside.
    pub fn distance_m(&self, point: &Point3<f64>) -> f64 {
        self.normal.dot(&point.coords) + self.offset_m
    }
}

/// A convex region that encloses what all eyes of a frame can see: one test instead of one per eye.
#[derive(Clone, Debug, PartialEq)]
pub struct Frustum {
    planes: Vec<Plane>,
}

impl Frustum {
    /// A region that encloses the viewing pyramids of all `views`, each moved by up to `margin_m` metres and
    /// turned by up to `margin_rad` radians: so much may the head move between culling and the late views.
    ///
    /// Each side plane of each eye is turned outwards until every direction within the angle of the eye's pyramid
    /// is inside, and pushed out until every apex is. A plane from which another eye's pyramid does not keep that
    /// angle is dropped: the test is conservative, it never culls what an eye sees. There is no near or far plane.
    pub fn enclosing(views: &[View], margin_m: f64, margin_rad: f64) -> Self {
        let corners: Vec<Vector3<f64>> = views.iter().flat_map(corner_directions).collect();
        let mut planes = Vec::with_capacity(4 * views.len());
        for view in views {
            for normal_in_eye in side_normals(view, margin_rad) {
                let normal = view.world_from_eye.rotation * normal_in_eye;
                // A plane may only stand if every eye's pyramid keeps the margin from it.
                let least = margin_rad.sin() - 1e-12;
                if corners.iter().any(|corner| normal.dot(corner) < least) {
                    continue;
                }
                let farthest_apex = views
                    .iter()
                    .map(|other| normal.dot(&other.world_from_eye.translation.vector))
                    .fold(f64::INFINITY, f64::min);
                planes.push(Plane { normal, offset_m: margin_m - farthest_apex });
            }
        }
        Self { planes }
    }

    /// Whether a ball may be visible: `false` is certain, `true` is not.
    pub fn may_see_ball(&self, centre_in_world: &Point3<f64>, radius_m: f64) -> bool {
        self.planes.iter().all(|plane| plane.distance_m(centre_in_world) >= -radius_m)
    }

    /// The half-spaces whose intersection this is.
    pub fn planes(&self) -> &[Plane] {
        &self.planes
    }
}

fn corner_directions(view: &View) -> [Vector3<f64>; 4] {
    let [l, r, u, d] = view.fov.tangents();
    [(l, u), (r, u), (r, d), (l, d)]
        .map(|(x, y)| view.world_from_eye.rotation * Vector3::new(x, y, -1.0).normalize())
}

/// Inward normals of the four sides in eye coordinates, turned outwards so far that every direction within
/// `margin_rad` of the pyramid stays inside: at a corner, whose direction has the part `along` on the axis of
/// the turn, that takes `asin(sin margin / √(1 − along²))`. A side that would pass the eye's own plane is held there.
fn side_normals(view: &View, margin_rad: f64) -> [UnitVector3<f64>; 4] {
    let half_turn = std::f64::consts::FRAC_PI_2;
    let [l, r, u, d] = view.fov.tangents();
    let perpendicular = |along: f64, across: f64| {
        (1.0 + across * across).sqrt() / (1.0 + across * across + along * along).sqrt()
    };
    let (tall, wide) = (u.abs().max(d.abs()), l.abs().max(r.abs()));
    // Angles are counted outwards, so that a side beyond the axis (a canted eye) is negative.
    let outward = |side_rad: f64, sign: f64, along: f64| {
        let side = side_rad * sign;
        let turn = (margin_rad.sin() / perpendicular(along, side.tan())).min(1.0).asin();
        let angle = (side + turn).min(half_turn);
        (angle.cos(), angle.sin())
    };
    let (lc, ls) = outward(view.fov.left_rad, -1.0, tall);
    let (rc, rs) = outward(view.fov.right_rad, 1.0, tall);
    let (uc, us) = outward(view.fov.up_rad, 1.0, wide);
    let (dc, ds) = outward(view.fov.down_rad, -1.0, wide);
    [
        Vector3::new(lc, 0.0, -ls),
        Vector3::new(-rc, 0.0, -rs),
        Vector3::new(0.0, -uc, -us),
        Vector3::new(0.0, dc, -ds),
    ]
    .map(UnitVector3::new_normalize)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Fov, Rigid};
    use nalgebra::UnitQuaternion;

    fn stereo(cant_rad: f64) -> Vec<View> {
        let fov = Fov { left_rad: -0.9, right_rad: 0.75, up_rad: 0.8, down_rad: -0.85 };
        let mirrored = Fov { left_rad: -fov.right_rad, right_rad: -fov.left_rad, ..fov };
        let head = Rigid::from_parts(
            nalgebra::Translation3::new(5.0, 1.7, -2.0),
            UnitQuaternion::from_euler_angles(0.2, 2.0, 0.1),
        );
        let eye = |x: f64, yaw: f64| {
            head * Rigid::from_parts(
                nalgebra::Translation3::new(x, 0.0, 0.0),
                UnitQuaternion::from_euler_angles(0.0, yaw, 0.0),
            )
        };
        vec![
            View { world_from_eye: eye(-0.032, cant_rad), fov },
            View { world_from_eye: eye(0.032, -cant_rad), fov: mirrored },
        ]
    }

    /// Whatever any eye sees, also after moving and turning by the margins, lies inside.
    #[test]
    fn nothing_that_an_eye_sees_is_outside() {
        for cant_rad in [0.0, 0.1, -0.1] {
            let views = stereo(cant_rad);
            let frustum = Frustum::enclosing(&views, 0.05, 0.1);
            assert!(!frustum.planes().is_empty());
            for view in &views {
                for (i, j) in (0..=10).flat_map(|i| (0..=10).map(move |j| (i, j))) {
                    let lerp = |a: f64, b: f64, t: i32| a + (b - a) * f64::from(t) / 10.0;
                    let [l, r, u, d] = view.fov.tangents();
                    for (depth, yaw) in [(0.01, 0.0), (3.0, 0.099), (1e5, -0.099)] {
                        let moved = view.world_from_eye
                            * Rigid::from_parts(
                                nalgebra::Translation3::new(0.02, -0.02, 0.02),
                                UnitQuaternion::from_euler_angles(0.0, yaw, 0.0),
                            );
                        let p =
                            moved * Point3::from(Vector3::new(lerp(l, r, i), lerp(d, u, j), -1.0) * depth);
                        assert!(frustum.may_see_ball(&p, 1e-9), "{cant_rad} {i} {j} {depth} {yaw}");
                    }
                }
            }
        }
    }

    #[test]
    fn what_is_behind_or_far_aside_is_outside() {
        let views = stereo(0.0);
        let frustum = Frustum::enclosing(&views, 0.05, 0.1);
        let at = |x, y, z| views[0].world_from_eye * Point3::new(x, y, z);
        assert!(!frustum.may_see_ball(&at(0.0, 0.0, 10.0), 1.0));
        assert!(!frustum.may_see_ball(&at(100.0, 0.0, -10.0), 1.0));
        assert!(frustum.may_see_ball(&at(0.0, 0.0, 10.0), 20.0));
    }
}
