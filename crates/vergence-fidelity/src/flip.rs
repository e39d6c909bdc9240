//! FLIP for pictures of low dynamic range, after Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström, Fairchild:
//! "FLIP: A Difference Evaluator for Alternating Images" (2020). Section numbers below are that paper's.

use crate::{Error, Picture, convolve::Plane, srgb::linear_from_encoded};

/// What the paper assumes: a display of 3840 pixels, 0.70 m wide, seen from 0.70 m.
pub const DEFAULT_PIXELS_PER_DEGREE: f64 = 67.0;

/// Least angular resolution that is accepted: about a pixel per degree, below which the filters vanish.
const LEAST_PIXELS_PER_DEGREE: f64 = 1.0;
/// Largest: the filters are wider than most pictures there.
const LARGEST_PIXELS_PER_DEGREE: f64 = 1000.0;

/// The reference white of XYZ, Y = 1: D65 as the paper gives it.
const WHITE: [f64; 3] = [0.950_428_545, 1.0, 1.088_900_371];
/// Chromaticities (x, y) of the sRGB primaries.
const PRIMARIES: [[f64; 2]; 3] = [[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]];

/// Contrast sensitivity as sums of Gaussians `a √(π/b) exp(−π² x² / b)`, x in degrees (§4.1, table 1).
const SENSITIVITY_Y: [[f64; 2]; 2] = [[1.0, 0.0047], [0.0, 1e-5]];
const SENSITIVITY_CX: [[f64; 2]; 2] = [[1.0, 0.0053], [0.0, 1e-5]];
const SENSITIVITY_CZ: [[f64; 2]; 2] = [[34.1, 0.04], [13.5, 0.025]];
/// The widest Gaussian of the three: decides the window of all.
const WIDEST_B: f64 = 0.04;

/// Exponent of the colour difference (§4.1).
const Q_C: f64 = 0.7;
/// Fraction of the largest colour difference up to which the curve is steep (§4.1).
const P_C: f64 = 0.4;
/// Error at that place (§4.1).
const P_T: f64 = 0.95;
/// Exponent of the feature difference (§4.2).
const Q_F: f32 = 0.5;
/// Width of the feature detector, degrees of visual angle (§4.2).
const FEATURE_WIDTH_DEG: f64 = 0.082;

/// The error of every pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorMap {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `width · height` errors in 0…1, rows from the top.
    pub errors: Vec<f32>,
    /// Their mean, 0…1.
    pub mean: f64,
}

/// Pixels per degree of a flat display: `width_px` pixels across `width_m` metres, seen from `distance_m` metres.
pub fn pixels_per_degree(distance_m: f64, width_px: f64, width_m: f64) -> f64 {
    distance_m * (width_px / width_m) * 1f64.to_radians()
}

/// How different two pictures look when one flips between them: 0 (the same) … 1.
///
/// `pixels_per_degree` (1…1000, default [`DEFAULT_PIXELS_PER_DEGREE`]) is the angular resolution of the display:
/// small sees pixels large, and so forgives less. Takes about half a second for 1024² pixels.
///
/// # Errors
/// Where the sizes differ, or the angular resolution is out of its range.
pub fn flip(reference: &Picture, test: &Picture, pixels_per_degree: f64) -> Result<ErrorMap, Error> {
    reference.same_size(test)?;
    if !(LEAST_PIXELS_PER_DEGREE..=LARGEST_PIXELS_PER_DEGREE).contains(&pixels_per_degree) {
        let expected = "1 to 1000";
        return Err(Error::Parameter { name: "pixels per degree", expected, found: pixels_per_degree });
    }
    let space = ColorSpace::new();
    let color = color_difference(&space, reference, test, pixels_per_degree);
    let feature = feature_difference(&space, reference, test, pixels_per_degree);
    let errors: Vec<f32> = color.iter().zip(&feature).map(|(c, f)| c.powf(1.0 - f)).collect();
    let mean = errors.iter().map(|&e| f64::from(e)).sum::<f64>() / errors.len() as f64;
    Ok(ErrorMap { width: reference.width(), height: reference.height(), errors, mean })
}

type Matrix = [[f32; 3]; 3];

/// Linear sRGB to XYZ relative to the white, and back.
struct ColorSpace {
    relative_xyz_from_rgb: Matrix,
    rgb_from_relative_xyz: Matrix,
}

impl ColorSpace {
    /// From the primaries and the white: each primary is scaled so that together they make the white.
    fn new() -> Self {
        let primary = |[x, y]: [f64; 2]| [x / y, 1.0, (1.0 - x - y) / y];
        let columns = PRIMARIES.map(primary);
        let unscaled = std::array::from_fn(|row| std::array::from_fn(|column| columns[column][row]));
        let scale = apply(&inverse(&unscaled), WHITE);
        let relative_xyz_from_rgb = std::array::from_fn(|row| {
            std::array::from_fn(|column| columns[column][row] * scale[column] / WHITE[row])
        });
        let cast = |m: &[[f64; 3]; 3]| m.map(|row| row.map(|v| v as f32));
        Self {
            rgb_from_relative_xyz: cast(&inverse(&relative_xyz_from_rgb)),
            relative_xyz_from_rgb: cast(&relative_xyz_from_rgb),
        }
    }

    /// The linear opponent space YCxCz of a picture, one plane each (§4.1).
    fn opponent_planes(&self, picture: &Picture) -> [Plane<f32>; 3] {
        let mut planes = [(); 3].map(|()| Vec::with_capacity(picture.width() * picture.height()));
        for pixel in picture.rgb().chunks_exact(3) {
            let rgb = [pixel[0], pixel[1], pixel[2]].map(linear_from_encoded);
            let [x, y, z] = apply32(&self.relative_xyz_from_rgb, rgb);
            let opponent = [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)];
            planes.iter_mut().zip(opponent).for_each(|(plane, value)| plane.push(value));
        }
        planes.map(|values| Plane::new(picture.width(), picture.height(), values))
    }

    /// Linear RGB, clamped to what a display shows, of a colour in YCxCz.
    fn rgb_from_opponent(&self, [y, cx, cz]: [f32; 3]) -> [f32; 3] {
        let y = (y + 16.0) / 116.0;
        apply32(&self.rgb_from_relative_xyz, [cx / 500.0 + y, y, y - cz / 200.0]).map(|v| v.clamp(0.0, 1.0))
    }

    /// CIE L*a*b*, with the chroma scaled by lightness for Hunt's effect (§4.1).
    fn hunt_lab(&self, rgb: [f32; 3]) -> [f32; 3] {
        const DELTA: f32 = 6.0 / 29.0;
        let [x, y, z] = apply32(&self.relative_xyz_from_rgb, rgb).map(|t| {
            if t > DELTA * DELTA * DELTA { t.cbrt() } else { t / (3.0 * DELTA * DELTA) + 4.0 / 29.0 }
        });
        let lightness = 116.0 * y - 16.0;
        [lightness, 0.01 * lightness * 500.0 * (x - y), 0.01 * lightness * 200.0 * (y - z)]
    }
}

/// City-block distance in lightness plus Euclidean distance in chroma (HyAB, §4.1).
fn hyab(a: [f32; 3], b: [f32; 3]) -> f32 {
    (a[0] - b[0]).abs() + ((a[1] - b[1]).powi(2) + (a[2] - b[2]).powi(2)).sqrt()
}

/// §4.1: difference of the colours that are left after the eye's contrast sensitivity, redistributed to 0…1.
fn color_difference(space: &ColorSpace, reference: &Picture, test: &Picture, ppd: f64) -> Vec<f32> {
    let reference = seen(space, reference, ppd);
    let test = seen(space, test, ppd);
    let extreme = hyab(space.hunt_lab([0.0, 1.0, 0.0]), space.hunt_lab([0.0, 0.0, 1.0]));
    let largest = f64::from(extreme).powf(Q_C) as f32;
    let (knee, at_knee) = (P_C as f32 * largest, P_T as f32);
    let redistribute = |(a, b): (&[f32; 3], &[f32; 3])| {
        let difference = hyab(*a, *b).powf(Q_C as f32);
        let error = if difference < knee {
            at_knee / knee * difference
        } else {
            at_knee + (difference - knee) / (largest - knee) * (1.0 - at_knee)
        };
        error.min(1.0)
    };
    reference.iter().zip(&test).map(redistribute).collect()
}

/// The picture after the contrast sensitivity filters, in Hunt-adjusted L*a*b*.
fn seen(space: &ColorSpace, picture: &Picture, ppd: f64) -> Vec<[f32; 3]> {
    let planes = space.opponent_planes(picture);
    let sensitivities = [SENSITIVITY_Y, SENSITIVITY_CX, SENSITIVITY_CZ];
    let filtered: Vec<Vec<f32>> = planes
        .iter()
        .zip(&sensitivities)
        .map(|(plane, gaussians)| sensitivity_filtered(plane, gaussians, ppd))
        .collect();
    let pixels = filtered[0].iter().zip(&filtered[1]).zip(&filtered[2]);
    pixels.map(|((&y, &cx), &cz)| space.hunt_lab(space.rgb_from_opponent([y, cx, cz]))).collect()
}

/// A sum of Gaussians is a sum of separable filters; the weights make the whole sum to one.
fn sensitivity_filtered(plane: &Plane<f32>, gaussians: &[[f64; 2]; 2], ppd: f64) -> Vec<f32> {
    use std::f64::consts::PI;
    let radius = (3.0 * (WIDEST_B / (2.0 * PI * PI)).sqrt() * ppd).ceil() as i64;
    let kernels = gaussians.map(|[a, b]| {
        let kernel: Vec<f64> =
            (-radius..=radius).map(|i| (-PI * PI * (i as f64 / ppd).powi(2) / b).exp()).collect();
        let sum: f64 = kernel.iter().sum();
        (a * (PI / b).sqrt() * sum * sum, kernel.iter().map(|k| k / sum).collect::<Vec<_>>())
    });
    let total: f64 = kernels.iter().map(|(weight, _)| weight).sum();
    let mut values = vec![0.0; plane.values.len()];
    for (weight, kernel) in kernels.iter().filter(|(weight, _)| *weight > 0.0) {
        let horizontal: Vec<f32> = kernel.iter().map(|k| (k * weight / total) as f32).collect();
        let vertical: Vec<f32> = kernel.iter().map(|&k| k as f32).collect();
        let filtered = plane.filtered(&horizontal, &vertical);
        values.iter_mut().zip(&filtered.values).for_each(|(sum, value)| *sum += value);
    }
    values
}

/// §4.2: the larger of the differences in edges and in points, 0…1.
fn feature_difference(space: &ColorSpace, reference: &Picture, test: &Picture, ppd: f64) -> Vec<f32> {
    let reference = features(space, reference, ppd);
    let test = features(space, test, ppd);
    let difference = |(a, b): (&[f32; 2], &[f32; 2])| {
        let larger = (a[0] - b[0]).abs().max((a[1] - b[1]).abs());
        (larger * std::f32::consts::FRAC_1_SQRT_2).powf(Q_F).min(1.0)
    };
    reference.iter().zip(&test).map(difference).collect()
}

/// Strength of edge and of point at every pixel: first and second derivatives of a Gaussian on achromatic Y.
fn features(space: &ColorSpace, picture: &Picture, ppd: f64) -> Vec<[f32; 2]> {
    let [mut achromatic, _, _] = space.opponent_planes(picture);
    achromatic.values.iter_mut().for_each(|y| *y = (*y + 16.0) / 116.0);
    let sigma = 0.5 * FEATURE_WIDTH_DEG * ppd;
    let radius = (3.0 * sigma).ceil() as i64;
    let sample = |f: &dyn Fn(f64) -> f64| -> Vec<f64> {
        (-radius..=radius).map(|i| f(i as f64) * (-0.5 * (i as f64 / sigma).powi(2)).exp()).collect()
    };
    let gaussian = balanced(&sample(&|_| 1.0));
    let edge = balanced(&sample(&|x| -x));
    let point = balanced(&sample(&|x| (x / sigma).powi(2) - 1.0));
    let smooth_rows = achromatic.rows_filtered(&gaussian);
    let strength = |kernel: &[f32]| -> Vec<f32> {
        let across = achromatic.rows_filtered(kernel).columns_filtered(&gaussian);
        let along = smooth_rows.columns_filtered(kernel);
        across.values.iter().zip(&along.values).map(|(x, y)| (x * x + y * y).sqrt()).collect()
    };
    strength(&edge).into_iter().zip(strength(&point)).map(|(edge, point)| [edge, point]).collect()
}

/// Scaled so that the positive weights sum to 1 and the negative ones to −1 (§4.2).
fn balanced(kernel: &[f64]) -> Vec<f32> {
    let positive: f64 = kernel.iter().filter(|k| **k > 0.0).sum();
    let negative: f64 = -kernel.iter().filter(|k| **k < 0.0).sum::<f64>();
    // Either sum may be zero where the kernel has no weight of that sign: nothing is divided then.
    let scaled = |&k: &f64| {
        if k > 0.0 {
            k / positive
        } else if k < 0.0 {
            k / negative
        } else {
            0.0
        }
    };
    kernel.iter().map(|k| scaled(k) as f32).collect()
}

fn apply(m: &[[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
    m.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

fn apply32(m: &Matrix, v: [f32; 3]) -> [f32; 3] {
    m.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

/// By cofactors; only called for the two constant, well-conditioned matrices above.
fn inverse(m: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    let cofactor = |r: usize, c: usize| {
        let (r1, r2, c1, c2) = ((r + 1) % 3, (r + 2) % 3, (c + 1) % 3, (c + 2) % 3);
        m[r1][c1] * m[r2][c2] - m[r1][c2] * m[r2][c1]
    };
    let determinant: f64 = (0..3).map(|c| m[0][c] * cofactor(0, c)).sum();
    std::array::from_fn(|r| std::array::from_fn(|c| cofactor(c, r) / determinant))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_is_zero_and_black_to_white_is_large() {
        let black = Picture::from_rgb8(40, 30, &[0; 3600]).unwrap();
        let white = Picture::from_rgb8(40, 30, &[255; 3600]).unwrap();
        assert_eq!(flip(&black, &black, DEFAULT_PIXELS_PER_DEGREE).unwrap().mean, 0.0);
        let worst = flip(&black, &white, DEFAULT_PIXELS_PER_DEGREE).unwrap();
        assert!(worst.mean > 0.9 && worst.errors.iter().all(|e| (0.0..=1.0).contains(e)), "{}", worst.mean);
    }

    #[test]
    fn one_pixel_and_extreme_resolutions_are_finite() {
        let a = Picture::from_rgb8(1, 1, &[255, 0, 7]).unwrap();
        let b = Picture::from_rgb8(1, 1, &[0, 255, 70]).unwrap();
        for ppd in [1.0, 10.0, 1000.0] {
            assert!((0.0..=1.0).contains(&flip(&a, &b, ppd).unwrap().mean), "{ppd}");
        }
        for ppd in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(flip(&a, &b, ppd).is_err(), "{ppd}");
        }
    }

    #[test]
    fn the_default_resolution_is_the_papers_display() {
        assert!((pixels_per_degree(0.70, 3840.0, 0.70) - DEFAULT_PIXELS_PER_DEGREE).abs() < 0.03);
    }
}
