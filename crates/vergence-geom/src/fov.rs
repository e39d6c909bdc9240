use nalgebra::{Matrix4, Point3};

/// The field of view of one eye: signed angles, in radians, of the four sides of the image from the −z axis, as
/// OpenXR gives them (left and down are negative for an eye that looks through the middle).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fov {
    /// Angle of the left side, radians.
    pub left_rad: f64,
    /// Angle of the right side, radians; larger than `left_rad`.
    pub right_rad: f64,
    /// Angle of the upper side, radians; larger than `down_rad`.
    pub up_rad: f64,
    /// Angle of the lower side, radians.
    pub down_rad: f64,
}

/// Why a field of view cannot be drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FovError(pub Fov);

impl std::fmt::Display for FovError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Fov { left_rad, right_rad, up_rad, down_rad } = self.0;
        write!(
            f,
            "field of view: expected left < right and down < up, each strictly between -90 and 90 degrees; found \
             left {:.4}, right {:.4}, up {:.4}, down {:.4} degrees",
            left_rad.to_degrees(),
            right_rad.to_degrees(),
            up_rad.to_degrees(),
            down_rad.to_degrees()
        )
    }
}

impl std::error::Error for FovError {}

impl Fov {
    /// A view through the middle: vertical angle `fov_y_rad`, image `aspect` times as wide as high.
    ///
    /// # Errors
    /// Where the angle is not strictly between 0 and π, or the aspect is not positive and finite.
    pub fn symmetric(fov_y_rad: f64, aspect: f64) -> Result<Self, FovError> {
        let up_rad = 0.5 * fov_y_rad;
        let right_rad = (up_rad.tan() * aspect).atan();
        Self { left_rad: -right_rad, right_rad, up_rad, down_rad: -up_rad }.checked()
    }

    /// This field of view, if it can be drawn: sides in order, all angles finite and inside ±90°.
    ///
    /// # Errors
    /// Where it cannot.
    pub fn checked(self) -> Result<Self, FovError> {
        let half_turn = std::f64::consts::FRAC_PI_2;
        let inside = |angle: f64| angle.abs() < half_turn;
        let all_inside = [self.left_rad, self.right_rad, self.up_rad, self.down_rad].into_iter().all(inside);
        if all_inside && self.left_rad < self.right_rad && self.down_rad < self.up_rad {
            Ok(self)
        } else {
            Err(FovError(self))
        }
    }

    /// Tangents of left, right, up, down: where the sides cut the plane z = −1.
    pub fn tangents(&self) -> [f64; 4] {
        [self.left_rad.tan(), self.right_rad.tan(), self.up_rad.tan(), self.down_rad.tan()]
    }
}

/// The projection of the toolkit: eye coordinates to Vulkan clip coordinates (x right, **y down**, depth 1 at the
/// near plane, 0 at infinity: reversed, with no far plane).
///
/// With `[l, r, u, d]` the tangents of `fov`: `x' = 2x/(r−l) + z(r+l)/(r−l)`, `y' = −2y/(u−d) − z(u+d)/(u−d)`,
/// `z' = near_m`, `w' = −z`. Source: the limit far → ∞ of the usual matrix with depth reversed (Upchurch &
/// Desbrun 2012).
pub fn clip_from_eye(fov: &Fov, near_m: f64) -> Matrix4<f64> {
    let [l, r, u, d] = fov.tangents();
    let (width, height) = (r - l, u - d);
    #[rustfmt::skip]
    let matrix = Matrix4::new(
        2.0 / width, 0.0,           (r + l) / width,   0.0,
        0.0,         -2.0 / height, -(u + d) / height, 0.0,
        0.0,         0.0,           0.0,               near_m,
        0.0,         0.0,           -1.0,              0.0,
    );
    matrix
}

/// Distance in front of the eye (along −z, metres) of a point with depth `depth` in the depth buffer; 0 gives
/// infinity.
pub fn eye_depth_from_clip_depth(depth: f64, near_m: f64) -> f64 {
    near_m / depth
}

/// Where a point in eye coordinates (metres) falls in the image: normalised device coordinates, x to the right
/// and y **down**, both −1…1 inside the image. `None` behind or in the plane of the eye.
pub fn project(fov: &Fov, point_in_eye: &Point3<f64>) -> Option<nalgebra::Point2<f64>> {
    let [l, r, u, d] = fov.tangents();
    let depth = -point_in_eye.z;
    (depth > 0.0).then(|| {
        let (x, y) = (point_in_eye.x / depth, point_in_eye.y / depth);
        nalgebra::Point2::new((2.0 * x - (r + l)) / (r - l), ((u + d) - 2.0 * y) / (u - d))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const ASYMMETRIC: Fov = Fov { left_rad: -0.9, right_rad: 0.7, up_rad: 0.75, down_rad: -0.8 };

    #[test]
    fn the_matrix_and_the_formula_agree_and_the_sides_are_at_one() {
        let clip = clip_from_eye(&ASYMMETRIC, 0.05);
        for p in [Point3::new(0.3, -0.2, -1.0), Point3::new(-4e4, 1e4, -1e5), Point3::new(0.01, 0.02, -0.05)]
        {
            let c = clip * p.to_homogeneous();
            let ndc = project(&ASYMMETRIC, &p).unwrap();
            assert!((c.x / c.w - ndc.x).abs() < 1e-12 && (c.y / c.w - ndc.y).abs() < 1e-12);
            let depth = eye_depth_from_clip_depth(c.z / c.w, 0.05);
            assert!((depth / -p.z - 1.0).abs() < 1e-15);
        }
        let [l, r, u, d] = ASYMMETRIC.tangents();
        assert!(
            (project(&ASYMMETRIC, &Point3::new(l, u, -1.0)).unwrap() - Point3::new(-1.0, -1.0, 0.0).xy())
                .norm()
                < 1e-12
        );
        assert!(
            (project(&ASYMMETRIC, &Point3::new(r, d, -1.0)).unwrap() - Point3::new(1.0, 1.0, 0.0).xy())
                .norm()
                < 1e-12
        );
    }

    #[test]
    fn what_cannot_be_drawn_is_refused() {
        for fov_y in [0.0, std::f64::consts::PI, -1.0, f64::NAN] {
            assert!(Fov::symmetric(fov_y, 1.0).is_err(), "{fov_y}");
        }
        assert!(Fov { right_rad: -1.0, ..ASYMMETRIC }.checked().is_err());
        assert!(
            Fov::symmetric(179f64.to_radians(), 1.0).is_ok()
                && Fov::symmetric(1f64.to_radians(), 1.0).is_ok()
        );
        assert_eq!(project(&ASYMMETRIC, &Point3::new(0.0, 0.0, 0.0)), None);
    }
}
