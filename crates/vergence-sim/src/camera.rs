//! A camera with a lens: what it makes of pinhole pictures that a renderer can draw.
//!
//! [`Optics`] says which pictures are wanted ([`Optics::views`]), and where in them each pixel of the camera looks; [`Shot`] collects light
//! over an exposure, and [`Film`] makes grey levels of it.

use nalgebra::{UnitQuaternion, Vector2, Vector3};
use vergence_geom::{Camera, Fov, Rigid, View};
use vergence_inertial::Dice;

use crate::{Error, in_ranges};

/// Up to this angle from its axis, a camera is drawn as one picture, radians; beyond it as sides of a cube.
const ONE_PICTURE_RAD: f64 = 1.1;
/// Places in a pixel that light is taken from, pixels from its centre: a fourth of it each.
const PLACES: [[f64; 2]; 4] = [[-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25], [0.25, 0.25]];

/// Where light comes from: a place in one of the pictures.
#[derive(Clone, Copy, Debug)]
struct Tap {
    picture: u32,
    x: f32,
    y: f32,
}

/// A pinhole picture, as wanted from the renderer.
#[derive(Clone, Copy, Debug)]
struct Side {
    /// Takes the renderer's eye axes (x right, y up, −z forward) to the camera's (x right, y down, z forward).
    camera_from_eye: UnitQuaternion<f64>,
    fov: Fov,
    /// Tangents of left, right, up, down.
    tangents: [f64; 4],
}

/// Takes pinhole pictures to the picture behind a lens.
#[derive(Clone, Debug)]
pub struct Optics {
    camera: Camera,
    sides: Vec<Side>,
    size_px: [u32; 2],
    /// Four for each pixel, or none where the lens sees nothing: `None` then for all four.
    taps: Vec<[Option<Tap>; 4]>,
}

impl Optics {
    /// For `camera`, from pictures with `oversampling` (1 to 4; 2 suits) pixels for each of the camera's in its middle.
    ///
    /// # Errors
    /// An oversampling out of its range; a lens that sees nothing.
    pub fn new(camera: &Camera, oversampling: f64) -> Result<Self, Error> {
        in_ranges(&[("oversampling", oversampling, 1.0, 4.0, "1 to 4")])?;
        let [width, height] = camera.size_px.map(|side| side as usize);
        let looks = |i: usize| {
            let centre = Vector2::new((i % width) as f64, (i / width) as f64);
            PLACES.map(|[x, y]| Some(camera.lens.unproject(&(centre + Vector2::new(x, y)))?.into_inner()))
        };
        let rays: Vec<[Option<Vector3<f64>>; 4]> = (0..width * height).map(looks).collect();
        let seen = || rays.iter().flatten().flatten();
        if seen().next().is_none() {
            return Err(Error::Parameter { what: "lens", expected: "one that sees something", found: 0.0 });
        }
        let widest = seen().map(|ray| ray.z).fold(1.0, f64::min).acos();
        let mut sides = if widest < ONE_PICTURE_RAD { vec![tight(seen())?] } else { cube()? };
        // Only the sides that something is seen of.
        let mut used = vec![false; sides.len()];
        seen().for_each(|ray| used[best(&sides, ray)] = true);
        let mut index = 0;
        sides.retain(|_| {
            index += 1;
            used[index - 1]
        });
        let focal_px = camera.lens.focal_px() * oversampling;
        let extent = |pick: fn(&[f64; 4]) -> f64, focal: f64| {
            let widest = sides.iter().map(|side| pick(&side.tangents)).fold(0.0, f64::max);
            (widest * focal).ceil().max(8.0) as u32
        };
        let size_px = [extent(|t| t[1] - t[0], focal_px.x), extent(|t| t[2] - t[3], focal_px.y)];
        let tap = |ray: &Option<Vector3<f64>>| {
            let ray = ray.as_ref()?;
            let picture = best(&sides, ray);
            let side = &sides[picture];
            let at = side.camera_from_eye.inverse_transform_vector(ray);
            let [left, right, up, down] = side.tangents;
            let (x, y) = (at.x / -at.z, at.y / -at.z);
            Some(Tap {
                picture: picture as u32,
                x: ((x - left) / (right - left) * f64::from(size_px[0]) - 0.5) as f32,
                y: ((up - y) / (up - down) * f64::from(size_px[1]) - 0.5) as f32,
            })
        };
        let taps = rays.iter().map(|four| std::array::from_fn(|k| tap(&four[k]))).collect();
        Ok(Self { camera: *camera, sides, size_px, taps })
    }

    /// Pixels of each of the pictures, width and height.
    pub fn size_px(&self) -> [u32; 2] {
        self.size_px
    }

    /// What to draw for a body at `world_from_body`; worlds of the renderer have y up.
    pub fn views(&self, world_from_body: &Rigid) -> impl Iterator<Item = View> {
        let world_from_camera = world_from_body * self.camera.body_from_camera;
        self.sides.iter().map(move |side| View {
            world_from_eye: Rigid::from_parts(
                world_from_camera.translation,
                world_from_camera.rotation * side.camera_from_eye,
            ),
            fov: side.fov,
        })
    }

    /// A picture without light.
    pub fn shot(&self) -> Shot {
        Shot { light: vec![0.0; self.taps.len()], exposures: 0.0 }
    }

    /// Adds what falls through the lens out of picture number `picture` of [`Optics::views`]: sRGB bytes, four a pixel, rows from
    /// the top. The last of them ends the exposure.
    ///
    /// # Panics
    /// Where there are not as many bytes as [`Optics::size_px`] says.
    pub fn expose(&self, picture: usize, srgb: &[u8], shot: &mut Shot) {
        let [width, height] = self.size_px.map(|side| side as usize);
        assert_eq!(srgb.len(), 4 * width * height, "bytes of the picture");
        let linear = Linear::new();
        let luma: Vec<f32> = srgb.chunks_exact(4).map(|pixel| linear.luma(pixel)).collect();
        let read = |tap: &Tap| {
            let (x, y) = (tap.x.clamp(0.0, (width - 1) as f32), tap.y.clamp(0.0, (height - 1) as f32));
            let (left, top) = ((x as usize).min(width - 2), (y as usize).min(height - 2));
            let (fx, fy) = (x - left as f32, y - top as f32);
            let at = top * width + left;
            let upper = luma[at] + (luma[at + 1] - luma[at]) * fx;
            let lower = luma[at + width] + (luma[at + width + 1] - luma[at + width]) * fx;
            upper + (lower - upper) * fy
        };
        for (light, taps) in shot.light.iter_mut().zip(&self.taps) {
            let here = taps.iter().flatten().filter(|tap| tap.picture as usize == picture);
            *light += here.map(read).sum::<f32>() * 0.25;
        }
        if picture + 1 == self.sides.len() {
            shot.exposures += 1.0;
        }
    }
}

/// One picture around all rays.
fn tight<'a>(rays: impl Iterator<Item = &'a Vector3<f64>>) -> Result<Side, Error> {
    let mut tangents = [0.0f64, 0.0, 0.0, 0.0];
    for ray in rays {
        let (x, y) = (ray.x / ray.z, -ray.y / ray.z);
        tangents = [tangents[0].min(x), tangents[1].max(x), tangents[2].max(y), tangents[3].min(y)];
    }
    // A little more than the outermost pixels need to be interpolated.
    let [left, right, up, down] = tangents.map(|t| t * 1.01 + t.signum() * 0.01);
    side(&Vector3::zeros(), [left, right, up, down])
}

/// Front, left, right, above, below, back; a little over a quarter turn each.
fn cube() -> Result<Vec<Side>, Error> {
    const REACH: f64 = 1.02;
    let quarter = std::f64::consts::FRAC_PI_2;
    let turns =
        [[0.0, 0.0], [0.0, -quarter], [0.0, quarter], [quarter, 0.0], [-quarter, 0.0], [0.0, 2.0 * quarter]];
    turns.iter().map(|[x, y]| side(&Vector3::new(*x, *y, 0.0), [-REACH, REACH, REACH, -REACH])).collect()
}

/// A picture along the camera's axis, turned by a rotation vector of the camera.
fn side(turn: &Vector3<f64>, tangents: [f64; 4]) -> Result<Side, Error> {
    let [left_rad, right_rad, up_rad, down_rad] = tangents.map(f64::atan);
    let fov = Fov { left_rad, right_rad, up_rad, down_rad }.checked().map_err(|_| Error::Parameter {
        what: "field of view",
        expected: "a lens that sees something on both sides of its axis",
        found: right_rad - left_rad,
    })?;
    let over = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    Ok(Side { camera_from_eye: vergence_geom::exp(turn) * over, fov, tangents })
}

/// The side whose axis is nearest.
fn best(sides: &[Side], ray: &Vector3<f64>) -> usize {
    let along = |side: &Side| (side.camera_from_eye * -Vector3::z()).dot(ray);
    (0..sides.len()).max_by(|a, b| along(&sides[*a]).total_cmp(&along(&sides[*b]))).unwrap_or(0)
}

/// Bytes of sRGB as light.
struct Linear([f32; 256]);

impl Linear {
    fn new() -> Self {
        // IEC 61966-2-1.
        Self(std::array::from_fn(|byte| {
            let value = byte as f32 / 255.0;
            if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
        }))
    }

    fn luma(&self, pixel: &[u8]) -> f32 {
        let of = |k: usize| self.0[pixel[k] as usize];
        0.2126 * of(0) + 0.7152 * of(1) + 0.0722 * of(2)
    }
}

/// Light that has fallen on each pixel.
#[derive(Clone, Debug)]
pub struct Shot {
    light: Vec<f32>,
    exposures: f32,
}

/// What makes grey levels of light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Film {
    /// Factor on the light, 0.01 to 100. Default 1: white is white.
    pub gain: f64,
    /// Standard deviation of the noise of each pixel, grey levels, 0 to 50. Default 2.
    pub noise: f64,
    /// Chooses the noise.
    pub seed: u64,
}

impl Default for Film {
    fn default() -> Self {
        Self { gain: 1.0, noise: 2.0, seed: 0 }
    }
}

impl Film {
    /// The film, where its numbers are in their ranges.
    ///
    /// # Errors
    /// Where they are not.
    pub fn checked(self) -> Result<Self, Error> {
        in_ranges(&[
            ("gain", self.gain, 0.01, 100.0, "0.01 to 100"),
            ("noise", self.noise, 0.0, 50.0, "0 to 50 grey levels"),
        ])?;
        Ok(self)
    }

    /// Grey levels of `shot`, with sRGB's curve; the noise is a function of seed, `camera`, `frame` and pixel.
    pub fn develop(&self, shot: &Shot, camera: u64, frame: u64) -> Vec<u8> {
        let dice = Dice::new(self.seed ^ camera.rotate_left(32), frame);
        let gain = self.gain as f32 / shot.exposures.max(1.0);
        let level = |(i, light): (usize, &f32)| {
            let light = (light * gain).clamp(0.0, 1.0);
            let value =
                if light <= 0.003_130_8 { 12.92 * light } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 };
            let noise = if self.noise > 0.0 { self.noise * dice.normal(i as u64) } else { 0.0 };
            (f64::from(value) * 255.0 + noise).round().clamp(0.0, 255.0) as u8
        };
        shot.light.iter().enumerate().map(level).collect()
    }
}

#[cfg(test)]
mod tests {
    use vergence_geom::{Distortion, Lens};

    use super::*;

    /// What a world says in a direction of the camera: 0 to 1.
    fn sky(ray: &Vector3<f64>) -> f64 {
        0.5 + 0.2 * (7.0 * ray.x).sin() + 0.2 * (6.0 * ray.y + 2.0 * ray.z).cos()
    }

    /// Draws the views as a renderer would, and takes the picture.
    fn taken(camera: &Camera, film: &Film) -> (Vec<u8>, usize) {
        let optics = Optics::new(camera, 2.0).unwrap();
        let [width, height] = optics.size_px().map(|side| side as usize);
        let mut shot = optics.shot();
        let views: Vec<View> = optics.views(&Rigid::identity()).collect();
        for (n, view) in views.iter().enumerate() {
            let [left, right, up, down] = view.fov.tangents();
            let pixel = |i: usize| {
                let x = left + (right - left) * ((i % width) as f64 + 0.5) / width as f64;
                let y = up + (down - up) * ((i / width) as f64 + 0.5) / height as f64;
                let ray = (view.world_from_eye.rotation * Vector3::new(x, y, -1.0)).normalize();
                let level = (sky(&ray) * 255.0).round() as u8;
                [level, level, level, 255]
            };
            let bytes: Vec<u8> = (0..width * height).flat_map(pixel).collect();
            optics.expose(n, &bytes, &mut shot);
        }
        (film.develop(&shot, 0, 0), views.len())
    }

    #[test]
    fn every_pixel_shows_what_its_ray_meets() {
        let narrow = Distortion::Radtan { radial: [-0.28, 0.07, 0.0], tangential: [2e-4, -1e-4] };
        let wide = Distortion::KannalaBrandt { k: [0.003, 0.0007, -0.002, 0.0002] };
        for (focal, distortion, sides) in [(180.0, narrow, 1), (80.0, wide, 6)] {
            let lens = Lens::new([focal, focal * 0.99], [130.0, 96.0], distortion).unwrap();
            let camera = Camera { lens, size_px: [256, 200], body_from_camera: Rigid::identity() };
            let (picture, views) = taken(&camera, &Film { noise: 0.0, ..Film::default() });
            assert_eq!(views, sides);
            for (i, level) in picture.iter().enumerate() {
                let pixel = Vector2::new((i % 256) as f64, (i / 256) as f64);
                let expected = lens.unproject(&pixel).map_or(0.0, |ray| sky(&ray) * 255.0);
                assert!((f64::from(*level) - expected).abs() < 2.5, "{pixel} {level} {expected}");
            }
        }
    }

    #[test]
    fn noise_has_its_size_and_hangs_on_the_frame() {
        let lens = Lens::pinhole([100.0, 100.0], [60.0, 50.0]).unwrap();
        let camera = Camera { lens, size_px: [120, 100], body_from_camera: Rigid::identity() };
        let (clean, _) = taken(&camera, &Film { noise: 0.0, ..Film::default() });
        let (noisy, _) = taken(&camera, &Film { noise: 3.0, ..Film::default() });
        let squares = clean.iter().zip(&noisy).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2));
        let deviation = (squares.sum::<f64>() / clean.len() as f64).sqrt();
        assert!((deviation - 3.0).abs() < 0.15, "{deviation}");
        let shot = Optics::new(&camera, 1.0).unwrap().shot();
        let film = Film { noise: 3.0, ..Film::default() };
        assert_eq!(film.develop(&shot, 1, 5), film.develop(&shot, 1, 5));
        assert_ne!(film.develop(&shot, 1, 5), film.develop(&shot, 1, 6));
        assert_ne!(film.develop(&shot, 1, 5), film.develop(&shot, 0, 5));
        assert!(Film { noise: f64::NAN, ..film }.checked().is_err());
        assert!(Optics::new(&camera, f64::NAN).is_err());
    }

    #[test]
    fn an_exposure_is_the_mean_of_what_was_seen() {
        let lens = Lens::pinhole([100.0, 100.0], [60.0, 50.0]).unwrap();
        let camera = Camera { lens, size_px: [120, 100], body_from_camera: Rigid::identity() };
        let optics = Optics::new(&camera, 1.0).unwrap();
        let [width, height] = optics.size_px().map(|side| side as usize);
        let mut shot = optics.shot();
        optics.expose(0, &vec![255; 4 * width * height], &mut shot);
        optics.expose(0, &vec![0; 4 * width * height], &mut shot);
        // Half the light is not half the grey level.
        let film = Film { noise: 0.0, ..Film::default() };
        assert!(film.develop(&shot, 0, 0).iter().all(|level| *level == 188));
        assert!(Film { gain: 4.0, ..film }.develop(&shot, 0, 0).iter().all(|level| *level == 255));
    }
}
