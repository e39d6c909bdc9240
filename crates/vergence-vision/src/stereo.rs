use nalgebra::{Vector2, Vector3};
use vergence_geom::{Camera, Rigid};

use crate::{Flow, Pyramid};

/// Sine of the angle between what camera `b` sees and the epipolar plane of what camera `a` sees: 0 where both may be the same
/// point. `ray_in_a` and `ray_in_b` are of length 1 in their cameras' frames; `b_from_a` takes coordinates of the first camera to those
/// of the second. `None` where the plane is not defined: no baseline, or the ray lies along it.
pub fn epipolar_angle(b_from_a: &Rigid, ray_in_a: &Vector3<f64>, ray_in_b: &Vector3<f64>) -> Option<f64> {
    let normal = b_from_a.translation.vector.cross(&(b_from_a.rotation * ray_in_a));
    let length = normal.norm();
    (length > 1e-9).then(|| ray_in_b.dot(&normal) / length)
}

/// What finds the points of one camera in another at the same instant.
#[derive(Clone, Debug)]
pub(crate) struct Stereo {
    here: Camera,
    there: Camera,
    there_from_here: Rigid,
    /// Places along one epipolar line, and their inverse distances.
    places: Vec<Vector2<f64>>,
    inverse_m: Vec<f64>,
}

/// What a match says.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    /// Inverse distance along the ray, 1/m, at least 0.
    pub inverse_m: f64,
    /// Distance from the epipolar line, pixels (of one focal length).
    pub off_px: f64,
}

/// Level on which the line is searched.
const SEARCH_LEVEL: usize = 2;
/// Largest number of places on one line.
const MOST_PLACES: usize = 64;

impl Stereo {
    pub fn new(here: &Camera, there: &Camera) -> Self {
        Self {
            here: *here,
            there: *there,
            there_from_here: there.body_from_camera.inverse() * here.body_from_camera,
            places: Vec::with_capacity(MOST_PLACES),
            inverse_m: Vec::with_capacity(MOST_PLACES),
        }
    }

    /// Where a point at this inverse distance along `ray` is seen by the other camera.
    pub fn at(&self, ray: &Vector3<f64>, inverse_m: f64) -> Option<Vector2<f64>> {
        let point = self.there_from_here.rotation * ray + self.there_from_here.translation.vector * inverse_m;
        self.there.lens.project(&point)
    }

    /// The best of the places along the epipolar line from infinity to `nearest_m`.
    pub fn search(
        &mut self,
        flow: &mut Flow,
        here: &Pyramid,
        there: &Pyramid,
        pixel: &Vector2<f64>,
        nearest_m: f64,
    ) -> Option<Vector2<f64>> {
        let level = SEARCH_LEVEL.min(here.levels().len() - 1).min(there.levels().len() - 1);
        let scale = 1.0 / f64::from(1u32 << level);
        let ray = self.here.lens.unproject(pixel)?.into_inner();
        self.places.clear();
        self.inverse_m.clear();
        let size = self.there.size_px.map(f64::from);
        let mut inverse_m = 0.0;
        let largest = 1.0 / nearest_m;
        // Steps of two pixels of the level.
        let stride = 2.0 / scale;
        let baseline_px = self.there_from_here.translation.vector.norm() * self.there.lens.focal_px().max();
        let mut step = stride / baseline_px.max(1e-9);
        for _ in 0..4 * MOST_PLACES {
            if inverse_m > largest || self.places.len() == MOST_PLACES {
                break;
            }
            let Some(place) = self.at(&ray, inverse_m) else {
                inverse_m += step;
                if step > largest {
                    break;
                }
                continue;
            };
            if let Some(before) = self.places.last() {
                let moved = (place * scale - before).norm() / scale;
                if moved > 2.0 * stride && step > 1e-6 {
                    inverse_m -= 0.5 * step;
                    step *= 0.5;
                    continue;
                }
                if moved < 0.5 * stride {
                    step *= 1.5;
                }
            }
            let inside =
                place.x > -8.0 && place.y > -8.0 && place.x < size[0] + 8.0 && place.y < size[1] + 8.0;
            if !inside && !self.places.is_empty() {
                break;
            }
            if inside {
                self.places.push(place * scale);
                self.inverse_m.push(inverse_m);
            }
            inverse_m += step;
        }
        let (best, _) = flow.likeliest(here, there, level, &(pixel * scale), &self.places)?;
        Some(self.places[best] / scale)
    }

    /// Where on its ray the point seen at `pixel` here and `found` there is; `None` where it would be behind the cameras.
    pub fn place(&self, pixel: &Vector2<f64>, found: &Vector2<f64>) -> Option<Place> {
        let ray = self.here.lens.unproject(pixel)?.into_inner();
        let seen = self.there.lens.unproject(found)?.into_inner();
        let focal_px = self.there.lens.focal_px().max();
        let off_px = epipolar_angle(&self.there_from_here, &ray, &seen)?.abs() * focal_px;
        // Distances along both rays to where they come closest.
        let turned = self.there_from_here.rotation * ray;
        let normal = turned.cross(&seen);
        let across = self.there_from_here.translation.vector.cross(&seen);
        // turned · d + t = seen · e: the cross product with `seen` leaves d (turned × seen) = −(t × seen).
        let inverse_m = -normal.norm_squared() / normal.dot(&across);
        let (inverse_m, behind) =
            if inverse_m.is_finite() && inverse_m >= 0.0 { (inverse_m, false) } else { (0.0, true) };
        // Behind the cameras is allowed as far as noise takes what is far away.
        if behind {
            let far = self.at(&ray, 0.0)?;
            if (far - found).norm() > 2.0 {
                return None;
            }
        }
        Some(Place { inverse_m, off_px })
    }
}
