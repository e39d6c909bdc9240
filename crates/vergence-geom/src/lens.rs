//! Lens models: from points in front of a camera to pixels, back, and the derivative.
//!
//! A camera's own frame is the one of its pictures, unlike every other frame of the toolkit: x right, y **down**,
//! z **forward**, metres. Pixels are (right, down) from the centre of the pixel at the upper left.

use nalgebra::{Matrix2, Matrix2x3, UnitVector3, Vector2, Vector3};

use crate::Rigid;

/// How a lens bends rays before they meet the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distortion {
    /// Brown and Conrady's polynomial of the tangent, as OpenCV and EuRoC order it. For lenses below about 120°.
    Radtan {
        /// k₁, k₂, k₃, of r², r⁴, r⁶ (k₃ is 0 where a file has two only).
        radial: [f64; 3],
        /// p₁, p₂.
        tangential: [f64; 2],
    },
    /// Kannala and Brandt's polynomial of the angle, θ + k₁θ³ + k₂θ⁵ + k₃θ⁷ + k₄θ⁹: OpenCV's `fisheye`. Kannala and Brandt, "A generic
    /// camera model and calibration method", PAMI 28(8), 2006.
    KannalaBrandt {
        /// k₁ … k₄.
        k: [f64; 4],
    },
    /// Usenko, Demmel and Cremers, "The double sphere camera model", 3DV 2018: closed form both ways, beyond 180°.
    DoubleSphere {
        /// Distance between the centres of the two spheres, −1 < ξ < 2 (the inverse is unique there).
        xi: f64,
        /// Shift of the pinhole, 0 ≤ α ≤ 1.
        alpha: f64,
    },
}

/// No lens.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum LensError {
    /// A focal length that is none.
    #[error("expected focal lengths above 0 px and below 1e6 px, found {0} and {1}")]
    Focal(f64, f64),
    /// A principal point that is nowhere.
    #[error("expected a principal point within 1e6 px of the picture, found {0}, {1}")]
    Centre(f64, f64),
    /// Distortion that is no number, or of a sphere that cannot be.
    #[error("expected {expected}, found {found}")]
    Distortion {
        /// What it should be.
        expected: &'static str,
        /// What it is.
        found: f64,
    },
}

/// A lens in front of a picture, with the domain in which it can be inverted.
///
/// The domain is a cone about the forward axis. **Radtan**: z > 0, and the tangent of the angle below the first turning point of
/// the radial polynomial (beyond it two directions would share a pixel), at most [`Lens::LARGEST_TANGENT`]. **Kannala-Brandt**: the
/// angle below the first turning point of its polynomial, at most 180°. **Double sphere**: the half-space of the paper's equation
/// 43, also behind the camera. Outside of its domain, and for coordinates that are not finite, each function answers `None`.
///
/// ```
/// use vergence_geom::{Distortion, Lens};
/// let radtan = Distortion::Radtan { radial: [-0.283, 0.074, 0.0], tangential: [1.9e-4, 1.8e-5] };
/// let lens = Lens::new([458.7, 457.3], [367.2, 248.4], radtan).unwrap();
/// let pixel = lens.project(&nalgebra::Vector3::new(0.4, -0.1, 2.0)).unwrap();
/// let ray = lens.unproject(&pixel).unwrap();
/// assert!((ray.into_inner() - nalgebra::Vector3::new(0.4, -0.1, 2.0).normalize()).norm() < 1e-14);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    focal_px: Vector2<f64>,
    centre_px: Vector2<f64>,
    distortion: Distortion,
    /// Edge of the domain: of r² (radtan), of θ (Kannala-Brandt), the w₂ of the double sphere.
    edge: f64,
}

/// A camera on a body (a headset, a drone): one member of a rig.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// What it sees through.
    pub lens: Lens,
    /// Width and height of its pictures.
    pub size_px: [u32; 2],
    /// Takes coordinates of the camera (x right, y down, z forward, metres) to those of the body.
    pub body_from_camera: Rigid,
}

/// First positive root of 1 + Σ cᵢ tⁱ⁺¹ (a polynomial in t that is 1 at 0), searched up to `end`, else `end`.
fn first_root(c: &[f64], end: f64) -> f64 {
    const STEPS: u32 = 4096;
    let value = |t: f64| 1.0 + t * c.iter().rev().fold(0.0, |sum, c| sum * t + c);
    // Steps grow with the distance, so that roots at small t are found as well as those at large t.
    let at = |k: u32| end * (f64::from(k) / f64::from(STEPS)).powi(3);
    let Some(k) = (1..=STEPS).find(|k| value(at(*k)) <= 0.0) else { return end };
    let (mut low, mut high) = (at(k - 1), at(k));
    for _ in 0..80 {
        let middle = 0.5 * (low + high);
        if value(middle) > 0.0 { low = middle } else { high = middle }
    }
    low
}

impl Lens {
    /// Radtan's domain ends here at the latest: 87°, where a pinhole's pixels are twenty focal lengths from the centre.
    pub const LARGEST_TANGENT: f64 = 20.0;

    /// A lens of focal lengths `focal_px` (right, down), principal point `centre_px` and a distortion.
    ///
    /// # Errors
    /// Numbers that are not finite or that no lens has.
    pub fn new(focal_px: [f64; 2], centre_px: [f64; 2], distortion: Distortion) -> Result<Self, LensError> {
        let [fx, fy] = focal_px;
        if !(fx > 0.0 && fx < 1e6 && fy > 0.0 && fy < 1e6) {
            return Err(LensError::Focal(fx, fy));
        }
        let [cx, cy] = centre_px;
        if !(cx.abs() < 1e6 && cy.abs() < 1e6) {
            return Err(LensError::Centre(cx, cy));
        }
        let moderate = |all: &[f64]| match all.iter().find(|k| k.is_nan() || k.abs() >= 1e6) {
            None => Ok(()),
            Some(&found) => {
                Err(LensError::Distortion { expected: "coefficients between -1e6 and 1e6", found })
            }
        };
        let edge = match distortion {
            Distortion::Radtan { radial: [k1, k2, k3], tangential } => {
                moderate(&[k1, k2, k3])?;
                moderate(&tangential)?;
                first_root(&[3.0 * k1, 5.0 * k2, 7.0 * k3], Self::LARGEST_TANGENT.powi(2))
            }
            Distortion::KannalaBrandt { k } => {
                moderate(&k)?;
                let square = std::f64::consts::PI.powi(2);
                first_root(&[3.0 * k[0], 5.0 * k[1], 7.0 * k[2], 9.0 * k[3]], square).sqrt()
            }
            Distortion::DoubleSphere { xi, alpha } => {
                if !(xi > -1.0 && xi < 2.0) {
                    return Err(LensError::Distortion { expected: "xi between -1 and 2", found: xi });
                }
                if !(0.0..=1.0).contains(&alpha) {
                    return Err(LensError::Distortion { expected: "alpha of 0 to 1", found: alpha });
                }
                let w1 = if alpha <= 0.5 { alpha / (1.0 - alpha) } else { (1.0 - alpha) / alpha };
                (w1 + xi) / (2.0 * w1 * xi + xi * xi + 1.0).sqrt()
            }
        };
        Ok(Self { focal_px: focal_px.into(), centre_px: centre_px.into(), distortion, edge })
    }

    /// A lens without distortion.
    ///
    /// # Errors
    /// As [`Lens::new`].
    pub fn pinhole(focal_px: [f64; 2], centre_px: [f64; 2]) -> Result<Self, LensError> {
        Self::new(focal_px, centre_px, Distortion::Radtan { radial: [0.0; 3], tangential: [0.0; 2] })
    }

    /// Focal lengths, right and down, pixels.
    pub fn focal_px(&self) -> Vector2<f64> {
        self.focal_px
    }

    /// Principal point, pixels right and down of the centre of the upper left pixel.
    pub fn centre_px(&self) -> Vector2<f64> {
        self.centre_px
    }

    /// How it bends rays.
    pub fn distortion(&self) -> Distortion {
        self.distortion
    }

    /// The same lens over a picture whose sides are `factor` as long (a pyramid's level: 0.5): pixel centres stay centres.
    ///
    /// # Errors
    /// As [`Lens::new`].
    pub fn scaled(&self, factor: f64) -> Result<Self, LensError> {
        let centre = (self.centre_px.add_scalar(0.5) * factor).add_scalar(-0.5);
        Self::new((self.focal_px * factor).into(), centre.into(), self.distortion)
    }

    /// The pixel that a point is seen at: `point_in_camera` in metres, x right, y down, z forward; its length does not matter.
    /// `None` outside of the domain; the edge of the picture is none.
    #[inline]
    pub fn project(&self, point_in_camera: &Vector3<f64>) -> Option<Vector2<f64>> {
        let [x, y, z] = [point_in_camera.x, point_in_camera.y, point_in_camera.z];
        let normalised = match self.distortion {
            Distortion::Radtan { radial, tangential } => {
                if z <= 0.0 {
                    return None;
                }
                let p = Vector2::new(x / z, y / z);
                let square = p.norm_squared();
                if square >= self.edge || square.is_nan() {
                    return None;
                }
                radtan(&p, &radial, &tangential)
            }
            Distortion::KannalaBrandt { k } => {
                let r = (x * x + y * y).sqrt();
                let angle = r.atan2(z);
                if !(angle < self.edge && r + z.abs() > 0.0) {
                    return None;
                }
                let scale = if r > AXIS * z.abs() { odd(&k, angle) / r } else { 1.0 / z };
                Vector2::new(x * scale, y * scale)
            }
            Distortion::DoubleSphere { xi, alpha } => {
                let (_, _, _, denominator) = self.spheres(point_in_camera, xi, alpha)?;
                Vector2::new(x / denominator, y / denominator)
            }
        };
        let pixel = self.focal_px.component_mul(&normalised) + self.centre_px;
        (pixel.x.is_finite() && pixel.y.is_finite()).then_some(pixel)
    }

    /// [`project`](Self::project), and how the pixel moves with the point: ∂pixel/∂point, pixels per metre.
    #[inline]
    pub fn project_with_jacobian(
        &self,
        point_in_camera: &Vector3<f64>,
    ) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        let pixel = self.project(point_in_camera)?;
        let [x, y, z] = [point_in_camera.x, point_in_camera.y, point_in_camera.z];
        let [fx, fy] = [self.focal_px.x, self.focal_px.y];
        let mut jacobian = match self.distortion {
            Distortion::Radtan { radial, tangential } => {
                let inverse = 1.0 / z;
                let p = Vector2::new(x * inverse, y * inverse);
                let d: Matrix2<f64> = radtan_jacobian(&p, &radial, &tangential) * inverse;
                let along: Vector2<f64> = -(d * p);
                Matrix2x3::new(d.m11, d.m12, along.x, d.m21, d.m22, along.y)
            }
            Distortion::KannalaBrandt { k } => {
                let square = x * x + y * y;
                let r = square.sqrt();
                let (scale, by_r, by_z) = if r > AXIS * z.abs() {
                    let angle = r.atan2(z);
                    let slope = odd_slope(&k, angle) / (square + z * z);
                    let scale = odd(&k, angle) / r;
                    (scale, (slope * z - scale) / square, -slope)
                } else {
                    (1.0 / z, 2.0 * (k[0] - 1.0 / 3.0) / (z * z * z), -1.0 / (z * z))
                };
                Matrix2x3::new(
                    scale + x * x * by_r,
                    x * y * by_r,
                    x * by_z,
                    x * y * by_r,
                    scale + y * y * by_r,
                    y * by_z,
                )
            }
            Distortion::DoubleSphere { xi, alpha } => {
                let (d1, k, d2, denominator) = self.spheres(point_in_camera, xi, alpha)?;
                let inverse = 1.0 / denominator;
                // ∂denominator/∂(x, y) = c · (x, y) and ∂denominator/∂z.
                let shared = 1.0 + xi * k / d1;
                let c = alpha / d2 * shared + (1.0 - alpha) * xi / d1;
                let dk_dz = 1.0 + xi * z / d1;
                let by_z = alpha / d2 * (k * dk_dz) + (1.0 - alpha) * dk_dz;
                let s = -inverse * inverse;
                Matrix2x3::new(
                    inverse + s * x * x * c,
                    s * x * y * c,
                    s * x * by_z,
                    s * x * y * c,
                    inverse + s * y * y * c,
                    s * y * by_z,
                )
            }
        };
        jacobian.row_mut(0).scale_mut(fx);
        jacobian.row_mut(1).scale_mut(fy);
        Some((pixel, jacobian))
    }

    /// The direction of length 1 (camera frame) that is seen at `pixel`; `None` where no direction of the domain is. Its angle is right to
    /// 1e-12 rad and better away from the domain's very edge, where the picture stands still.
    pub fn unproject(&self, pixel: &Vector2<f64>) -> Option<UnitVector3<f64>> {
        let m = (pixel - self.centre_px).component_div(&self.focal_px);
        if !(m.x.is_finite() && m.y.is_finite()) {
            return None;
        }
        let ray = match self.distortion {
            Distortion::Radtan { radial, tangential } => {
                let p = radtan_inverse(&m, &radial, &tangential, self.edge)?;
                Vector3::new(p.x, p.y, 1.0)
            }
            Distortion::KannalaBrandt { k } => {
                let bent = m.norm();
                if bent < AXIS {
                    return Some(UnitVector3::new_normalize(Vector3::new(m.x, m.y, 1.0)));
                }
                let angle = odd_inverse(&k, bent, self.edge)?;
                let (sin, cos) = angle.sin_cos();
                Vector3::new(m.x / bent * sin, m.y / bent * sin, cos)
            }
            Distortion::DoubleSphere { xi, alpha } => {
                let square = m.norm_squared();
                let root = 1.0 - (2.0 * alpha - 1.0) * square;
                if root < 0.0 {
                    return None;
                }
                let z = (1.0 - alpha * alpha * square) / (alpha * root.sqrt() + 1.0 - alpha);
                let inner = z * z + (1.0 - xi * xi) * square;
                if inner < 0.0 {
                    return None;
                }
                let scale = (z * xi + inner.sqrt()) / (z * z + square);
                Vector3::new(scale * m.x, scale * m.y, scale * z - xi)
            }
        };
        let ray = UnitVector3::try_new(ray, 1e-300)?;
        if let Distortion::DoubleSphere { xi, alpha } = self.distortion {
            // Beyond the edge of the spheres the formulas give a direction that is seen elsewhere.
            self.spheres(&ray, xi, alpha)?;
        }
        Some(ray)
    }

    /// d₁, z + ξ d₁, d₂ and the denominator of the double sphere (the paper's equations 40 to 42), inside of its domain.
    #[inline]
    fn spheres(&self, p: &Vector3<f64>, xi: f64, alpha: f64) -> Option<(f64, f64, f64, f64)> {
        let square = p.x * p.x + p.y * p.y;
        let d1 = (square + p.z * p.z).sqrt();
        if !(p.z > -self.edge * d1 && d1 > 0.0) {
            return None;
        }
        let k = xi * d1 + p.z;
        let d2 = (square + k * k).sqrt();
        let denominator = alpha * d2 + (1.0 - alpha) * k;
        (denominator > 0.0).then_some((d1, k, d2, denominator))
    }
}

/// Tangent of the angle to the axis below which one term of the series is exact.
const AXIS: f64 = 1e-8;

#[inline]
fn radtan(p: &Vector2<f64>, [k1, k2, k3]: &[f64; 3], [p1, p2]: &[f64; 2]) -> Vector2<f64> {
    let square = p.norm_squared();
    let radial = 1.0 + square * (k1 + square * (k2 + square * k3));
    let cross = 2.0 * p.x * p.y;
    Vector2::new(
        p.x * radial + p1 * cross + p2 * (square + 2.0 * p.x * p.x),
        p.y * radial + p1 * (square + 2.0 * p.y * p.y) + p2 * cross,
    )
}

#[inline]
fn radtan_jacobian(p: &Vector2<f64>, [k1, k2, k3]: &[f64; 3], [p1, p2]: &[f64; 2]) -> Matrix2<f64> {
    let square = p.norm_squared();
    let radial = 1.0 + square * (k1 + square * (k2 + square * k3));
    let slope = 2.0 * (k1 + square * (2.0 * k2 + square * 3.0 * k3));
    let mixed = p.x * p.y * slope + 2.0 * (p1 * p.x + p2 * p.y);
    Matrix2::new(
        radial + p.x * p.x * slope + 2.0 * p1 * p.y + 6.0 * p2 * p.x,
        mixed,
        mixed,
        radial + p.y * p.y * slope + 6.0 * p1 * p.y + 2.0 * p2 * p.x,
    )
}

/// Newton's iteration, kept inside of the domain (`edge`: its largest r²).
fn radtan_inverse(
    bent: &Vector2<f64>,
    radial: &[f64; 3],
    tangential: &[f64; 2],
    edge: f64,
) -> Option<Vector2<f64>> {
    const STEPS: u32 = 50;
    // Of the larger of 1 and the bent radius: a few roundings.
    const CLOSE: f64 = 1e-14;
    let inside = |p: Vector2<f64>| {
        let square = p.norm_squared();
        if square < edge { p } else { p * (0.999_999 * edge / square).sqrt() }
    };
    let close = CLOSE * bent.norm().max(1.0);
    let mut p = inside(*bent);
    let mut residual = radtan(&p, radial, tangential) - bent;
    for _ in 0..STEPS {
        let norm = residual.norm();
        if norm == 0.0 {
            break;
        }
        let Some(inverse) = radtan_jacobian(&p, radial, tangential).try_inverse() else { break };
        let step = inverse * residual;
        // A step that does not come closer is halved.
        let mut length = 1.0;
        let (mut next, mut next_residual) = (p, residual);
        let mut closer = false;
        while length > 1e-4 {
            next = inside(p - step * length);
            next_residual = radtan(&next, radial, tangential) - bent;
            if next_residual.norm() < norm {
                closer = true;
                break;
            }
            length *= 0.5;
        }
        if !closer {
            break;
        }
        (p, residual) = (next, next_residual);
    }
    (residual.norm() <= close && radtan_jacobian(&p, radial, tangential).determinant() > 0.0).then_some(p)
}

/// θ + k₁θ³ + k₂θ⁵ + k₃θ⁷ + k₄θ⁹.
#[inline]
fn odd(k: &[f64; 4], angle: f64) -> f64 {
    let s = angle * angle;
    angle * (1.0 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3]))))
}

#[inline]
fn odd_slope(k: &[f64; 4], angle: f64) -> f64 {
    let s = angle * angle;
    1.0 + s * (3.0 * k[0] + s * (5.0 * k[1] + s * (7.0 * k[2] + s * 9.0 * k[3])))
}

/// The angle below `edge` whose polynomial is `bent` > 0: Newton's iteration between two bounds that close in.
fn odd_inverse(k: &[f64; 4], bent: f64, edge: f64) -> Option<f64> {
    let (mut low, mut high) = (0.0, edge);
    if bent >= odd(k, edge) || bent.is_nan() {
        return None;
    }
    let mut angle = bent.min(0.5 * edge);
    for _ in 0..100 {
        let excess = odd(k, angle) - bent;
        if excess > 0.0 {
            high = angle
        } else {
            low = angle
        }
        let newton = angle - excess / odd_slope(k, angle);
        let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
        if (next - angle).abs() <= 2e-16 * angle {
            return Some(next);
        }
        angle = next;
    }
    Some(angle)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Angle, radians, between a direction and where it comes back to.
    const INVERSE: f64 = 1e-12;
    /// Of a derivative by central differences of 1e-6, relative to the focal length.
    const DERIVATIVE: f64 = 1e-7;

    fn lenses() -> Vec<Lens> {
        let radtan = |radial, tangential| Distortion::Radtan { radial, tangential };
        let all = [
            radtan([-0.283_408_11, 0.073_959_07, 0.0], [1.935_9e-4, 1.761_871_14e-5]),
            radtan([0.262_383, -0.953_104, 1.163_314], [-0.005_358, 0.002_628]),
            radtan([0.0; 3], [0.0; 2]),
            Distortion::KannalaBrandt { k: [0.003_482, 0.000_715, -0.002_053, 0.000_203] },
            Distortion::KannalaBrandt { k: [-0.05, 0.01, -0.02, 0.002] },
            Distortion::DoubleSphere { xi: -0.2996, alpha: 0.5937 },
            Distortion::DoubleSphere { xi: 0.2, alpha: 0.3 },
            Distortion::DoubleSphere { xi: 0.0, alpha: 0.0 },
        ];
        all.into_iter().map(|d| Lens::new([458.0, 457.0], [367.0, 248.0], d).unwrap()).collect()
    }

    fn direction() -> impl Strategy<Value = Vector3<f64>> {
        (0.0..3.1f64, 0.0..6.3f64, -2.0..3.0f64).prop_map(|(angle, turn, scale)| {
            let (sin, cos) = angle.sin_cos();
            Vector3::new(sin * turn.cos(), sin * turn.sin(), cos) * 10f64.powf(scale)
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn what_is_projected_comes_back(lens in 0usize..8, point in direction()) {
            let lens = lenses()[lens];
            if let Some(pixel) = lens.project(&point) {
                let Some(ray) = lens.unproject(&pixel) else {
                    // Tangential terms fold the picture a little before the radial edge: there only is no way back.
                    let Distortion::Radtan { radial, tangential } = lens.distortion else {
                        return Err(TestCaseError::fail(format!("{point} {pixel} has no way back")));
                    };
                    let p = point.xy() / point.z;
                    prop_assert!(radtan_jacobian(&p, &radial, &tangential).determinant() < 0.02, "{point}");
                    return Ok(());
                };
                let angle = ray.cross(&point.normalize()).norm();
                // Where the lens hardly moves the picture, a rounded pixel is a larger angle.
                let (_, jacobian) = lens.project_with_jacobian(&point.normalize()).unwrap();
                let mut least = jacobian.svd(false, false).singular_values.min() / 458.0;
                if let Distortion::Radtan { .. } = lens.distortion { least *= (point.z / point.norm()).powi(2); }
                prop_assert!(angle <= INVERSE / least.clamp(1e-9, 1e2), "{point} {angle:e} {least}");
                prop_assert!(least < 1e-4 || ray.dot(&point) > 0.0);
            }
        }

        #[test]
        fn the_jacobian_is_the_derivative(lens in 0usize..8, point in direction()) {
            const STEP: f64 = 1e-6;
            let lens = lenses()[lens];
            if let Some((_, jacobian)) = lens.project_with_jacobian(&point) {
                for axis in 0..3 {
                    let mut step = Vector3::zeros();
                    step[axis] = STEP * point.norm();
                    let (Some(ahead), Some(behind)) = (lens.project(&(point + step)), lens.project(&(point - step)))
                    else { continue };
                    let difference = (ahead - behind) / (2.0 * step[axis]);
                    let bar = DERIVATIVE * (458.0 / point.norm()).max(jacobian.norm()) * (1.0 + ahead.norm() * 1e-3);
                    let cone = if let Distortion::Radtan { .. } = lens.distortion { point.norm() / point.z } else { 1.0 };
                    prop_assert!((jacobian.column(axis) - difference).norm() < bar * cone * cone,
                        "{axis} {point} {jacobian} {difference}");
                }
            }
        }

        #[test]
        fn every_pixel_has_one_direction_or_none(lens in 0usize..8, x in -4000.0..4000.0f64, y in -4000.0..4000.0f64) {
            let lens = lenses()[lens];
            let pixel = Vector2::new(x, y);
            if let Some(ray) = lens.unproject(&pixel) {
                prop_assert!((ray.norm() - 1.0).abs() < 1e-14);
                if let Some(back) = lens.project(&ray) {
                    prop_assert!((back - pixel).norm() < 1e-9 * (1.0 + pixel.norm()), "{} {}", back, pixel);
                }
            }
        }
    }

    #[test]
    fn the_axis_and_the_edges_have_stated_answers() {
        for lens in lenses() {
            let ahead = lens.project(&Vector3::new(0.0, 0.0, 1e-3)).unwrap();
            assert!((ahead - lens.centre_px()).norm() < 1e-12);
            let (_, jacobian) = lens.project_with_jacobian(&Vector3::new(0.0, 0.0, 2.0)).unwrap();
            assert!(jacobian.iter().all(|x| x.is_finite()) && jacobian.m11 > 0.0);
            assert!((lens.unproject(&lens.centre_px()).unwrap().z - 1.0).abs() < 1e-15);
            for bad in [
                Vector3::zeros(),
                Vector3::new(f64::NAN, 0.0, 1.0),
                Vector3::new(0.0, f64::INFINITY, 1.0),
                Vector3::new(0.0, 0.0, -1.0),
            ] {
                assert_eq!(lens.project(&bad), None, "{lens:?} {bad}");
                assert!(lens.project_with_jacobian(&bad).is_none());
            }
            assert_eq!(lens.unproject(&Vector2::new(f64::NAN, 0.0)), None);
        }
    }

    /// A lens whose radial polynomial turns: the fold is outside of the domain.
    #[test]
    fn beyond_the_turning_point_is_nothing() {
        let folds = Distortion::Radtan { radial: [-0.3, 0.0, 0.0], tangential: [0.0; 2] };
        let lens = Lens::new([400.0; 2], [320.0, 240.0], folds).unwrap();
        let edge = (1.0f64 / 0.9).sqrt();
        assert!(lens.project(&Vector3::new(edge - 1e-6, 0.0, 1.0)).is_some());
        assert!(lens.project(&Vector3::new(edge + 1e-6, 0.0, 1.0)).is_none());
        let last = 320.0 + 400.0 * edge * (1.0 - 0.3 * edge * edge);
        assert!(lens.unproject(&Vector2::new(last - 0.1, 240.0)).is_some());
        assert!(lens.unproject(&Vector2::new(last + 0.1, 240.0)).is_none());
    }

    /// OpenCV 4.11: `projectPoints` and `fisheye.projectPoints` of (0.3, -0.2, 1.1).
    #[test]
    fn pixels_are_those_of_opencv() {
        let point = Vector3::new(0.3, -0.2, 1.1);
        for (lens, expected) in [(0, REFERENCE[0]), (1, REFERENCE[1]), (3, REFERENCE[2])] {
            let found = lenses()[lens].project(&point).unwrap();
            assert!((found - Vector2::from(expected)).norm() < 1e-9, "{lens}: {found}");
        }
    }

    const REFERENCE: [[f64; 2]; 3] = [
        [488.205_667_957_327_5, 167.382_730_644_511_4],
        [494.788_004_715_034_6, 162.816_953_977_296_58],
        [487.746_483_359_344_2, 167.678_103_500_407_13],
    ];

    #[test]
    fn what_is_no_lens_is_refused() {
        let plain = Distortion::Radtan { radial: [0.0; 3], tangential: [0.0; 2] };
        for (focal, centre, distortion) in [
            ([0.0, 1.0], [0.0; 2], plain),
            ([1.0, f64::NAN], [0.0; 2], plain),
            ([1.0, 1.0], [f64::INFINITY, 0.0], plain),
            ([1.0, 1.0], [0.0; 2], Distortion::DoubleSphere { xi: -1.0, alpha: 0.5 }),
            ([1.0, 1.0], [0.0; 2], Distortion::DoubleSphere { xi: 0.0, alpha: 1.5 }),
            ([1.0, 1.0], [0.0; 2], Distortion::KannalaBrandt { k: [0.0, f64::NAN, 0.0, 0.0] }),
        ] {
            assert!(Lens::new(focal, centre, distortion).is_err(), "{focal:?} {centre:?} {distortion:?}");
        }
    }

    #[test]
    fn a_smaller_picture_keeps_its_corners() {
        let lens = lenses()[0];
        let half = lens.scaled(0.5).unwrap();
        let point = Vector3::new(0.3, -0.2, 1.1);
        let (full, half) = (lens.project(&point).unwrap(), half.project(&point).unwrap());
        assert!((half.add_scalar(0.5) * 2.0 - full.add_scalar(0.5)).norm() < 1e-12);
    }
}
