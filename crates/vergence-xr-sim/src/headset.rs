//! What the simulated headset is: resolution, fields of view, eyes, rates, hidden area.

use std::path::Path;

use nalgebra::{Point2, UnitQuaternion, Vector3};
use vergence_config::{Angle, Frequency, Length};
use vergence_geom::{Fov, Rigid};
use vergence_time::Span;

use crate::Error;
use crate::interaction;

/// The headsets that come with the crate, by name: each is also a file under `headsets/`.
pub const BUILT_IN_HEADSETS: [(&str, &str); 3] = [
    ("default", include_str!("../headsets/default.toml")),
    ("quest3", include_str!("../headsets/quest3.toml")),
    ("index", include_str!("../headsets/index.toml")),
];

/// Largest picture of one eye, in pixels per side.
pub const MAX_IMAGE_SIDE: u32 = 8192;

/// A headset.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// What `xrGetSystemProperties` says.
    pub name: String,
    /// Pixels of one eye: width, height. What applications are recommended to render and what is composed.
    pub resolution: (u32, u32),
    /// Frames per second, the default first.
    pub rates_hz: Vec<f64>,
    /// Distance between the eyes, metres.
    pub ipd_m: f64,
    /// The left eye, then the right one.
    pub eyes: [Eye; 2],
    /// The interaction profile of the controllers that the simulated user holds.
    pub controllers: String,
    /// It sees the joints of bare hands, and of those that hold controllers.
    pub hands: bool,
    /// It sees where its user looks.
    pub gaze: bool,
}

/// One eye of a headset.
#[derive(Clone, Debug, PartialEq)]
pub struct Eye {
    /// Takes eye coordinates to head coordinates (the point between the eyes).
    pub head_from_eye: Rigid,
    /// What the eye sees.
    pub fov: Fov,
    /// What the lens shows: a convex outline on the plane z = −1, counter-clockwise as the eye sees it; empty where
    /// all of the image is visible.
    pub visible: Vec<Point2<f64>>,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    name: String,
    resolution: (u32, u32),
    rates: Vec<Frequency>,
    ipd: Length,
    #[serde(default)]
    controllers: Option<String>,
    #[serde(default = "yes")]
    hands: bool,
    #[serde(default = "yes")]
    gaze: bool,
    left: RawEye,
    /// The mirror image of the left one unless said otherwise.
    #[serde(default)]
    right: Option<RawEye>,
}

#[derive(Clone, serde::Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct RawEye {
    fov: RawFov,
    #[serde(default)]
    turned_out: Option<Angle>,
    #[serde(default)]
    visible: Vec<[f64; 2]>,
}

#[derive(Clone, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct RawFov {
    left: Angle,
    right: Angle,
    up: Angle,
    down: Angle,
}

/// A simulated headset sees everything unless its profile says otherwise.
const fn yes() -> bool {
    true
}

impl Default for Profile {
    /// The built-in profile `default`.
    fn default() -> Self {
        Self::parse(Path::new("default.toml"), BUILT_IN_HEADSETS[0].1)
            .expect("the built-in profile is right: a test reads it")
    }
}

impl Profile {
    /// The built-in headset `name`, or that in the file `name`.
    ///
    /// # Errors
    /// Where there is neither, or as [`Profile::parse`].
    pub fn open(name: &str) -> Result<Self, Error> {
        if let Some((_, text)) = BUILT_IN_HEADSETS.iter().find(|(built_in, _)| *built_in == name) {
            return Self::parse(Path::new(&format!("{name}.toml")), text);
        }
        let path = Path::new(name);
        if path.is_file() {
            return Self::parse(path, &vergence_config::read_text(path)?);
        }
        let known = BUILT_IN_HEADSETS.map(|(name, _)| name).join(", ");
        Err(Error::Unknown { kind: "headset profile", name: name.to_owned(), known })
    }

    /// The headset that `text`, the content of the file `path`, describes.
    ///
    /// # Errors
    /// Where the text is wrong or no headset can be so: the file and what was expected are named.
    pub fn parse(path: &Path, text: &str) -> Result<Self, Error> {
        let raw: Raw = vergence_config::parse(path, text)?;
        let value = |key: &str, expected: String, found: String| {
            Error::value(path, text, key, &format!("expected {expected}, found {found}"))
        };
        let (width, height) = raw.resolution;
        if !(1..=MAX_IMAGE_SIDE).contains(&width) || !(1..=MAX_IMAGE_SIDE).contains(&height) {
            let expected = format!("a resolution of 1 to {MAX_IMAGE_SIDE} pixels per side");
            return Err(value("resolution", expected, format!("{width} x {height}")));
        }
        let rates_hz: Vec<f64> = raw.rates.iter().map(|rate| rate.hertz()).collect();
        if rates_hz.is_empty() || rates_hz.iter().any(|rate| !(1.0..=1000.0).contains(rate)) {
            let expected = "at least one rate, each 1 to 1000 Hz".to_owned();
            return Err(value("rates", expected, format!("{rates_hz:?} Hz")));
        }
        let ipd_m = raw.ipd.metres();
        if !(0.0..=1.0).contains(&ipd_m) {
            return Err(value("ipd", "an ipd of 0 to 1 m".into(), format!("{ipd_m} m")));
        }
        let controllers =
            raw.controllers.unwrap_or_else(|| "/interaction_profiles/oculus/touch_controller".into());
        if interaction::profile(&controllers).is_none() {
            let expected = "an interaction profile of core OpenXR".to_owned();
            return Err(value("controllers", expected, controllers));
        }
        // What is wrong with a mirror image is so with the left eye.
        let right = raw.right.clone().unwrap_or_else(|| raw.left.mirrored());
        let resolve = |eye: RawEye, name: &str, side: f64| {
            let wrong = |(key, message): Wrong| Error::value(path, text, &format!("{name}.{key}"), &message);
            eye.resolve(side, ipd_m).map_err(wrong)
        };
        let eyes = [resolve(raw.left, "left", -1.0)?, resolve(right, "right", 1.0)?];
        Ok(Self {
            name: raw.name,
            resolution: raw.resolution,
            rates_hz,
            ipd_m,
            eyes,
            controllers,
            hands: raw.hands,
            gaze: raw.gaze,
        })
    }

    /// The same headset on somebody whose eyes are `ipd_m` metres apart.
    pub fn with_ipd(mut self, ipd_m: f64) -> Self {
        for (eye, side) in self.eyes.iter_mut().zip([-1.0, 1.0]) {
            eye.head_from_eye.translation.vector = Vector3::new(0.5 * side * ipd_m, 0.0, 0.0);
        }
        self.ipd_m = ipd_m;
        self
    }

    /// The time from one frame to the next at `rate_hz`, to the nearest nanosecond.
    pub(crate) fn period(rate_hz: f64) -> Span {
        Span::from_secs_f64(1.0 / rate_hz).unwrap_or(Span::from_millis(11))
    }
}

/// A key of an eye, and what was expected there and what was found.
type Wrong = (&'static str, String);

impl RawEye {
    fn mirrored(&self) -> Self {
        let negative = |angle: Angle| Angle::new(-angle.radians());
        let fov =
            RawFov { left: negative(self.fov.right), right: negative(self.fov.left), ..self.fov.clone() };
        // The mirror image runs the other way round.
        let visible = self.visible.iter().rev().map(|&[x, y]| [1.0 - x, y]).collect();
        Self { fov, visible, ..self.clone() }
    }

    fn resolve(self, side: f64, ipd_m: f64) -> Result<Eye, Wrong> {
        let fov = Fov {
            left_rad: self.fov.left.radians(),
            right_rad: self.fov.right.radians(),
            up_rad: self.fov.up.radians(),
            down_rad: self.fov.down.radians(),
        };
        let fov = fov.checked().map_err(|error| ("fov", error.to_string()))?;
        let turned_out = self.turned_out.map_or(0.0, Angle::radians);
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -side * turned_out);
        let head_from_eye = Rigid::from_parts(Vector3::new(0.5 * side * ipd_m, 0.0, 0.0).into(), rotation);
        let [l, r, u, d] = fov.tangents();
        let mut visible: Vec<Point2<f64>> =
            self.visible.iter().map(|&[x, y]| Point2::new(l + (r - l) * x, u + (d - u) * y)).collect();
        // Files list the outline clockwise or not, as seen: bring it to counter-clockwise.
        if signed_area(&visible) < 0.0 {
            visible.reverse();
        }
        let inside = self.visible.iter().flatten().all(|fraction| (0.0..=1.0).contains(fraction));
        let is_outline = inside && visible.len() >= 3 && is_convex(&visible);
        if !visible.is_empty() && !is_outline {
            let expected = "expected a convex outline of at least three points in 0 to 1";
            return Err(("visible", format!("{expected}, found {:?}", self.visible)));
        }
        Ok(Eye { head_from_eye, fov, visible })
    }
}

fn cross(a: &Point2<f64>, b: &Point2<f64>, c: &Point2<f64>) -> f64 {
    (b - a).perp(&(c - a))
}

fn signed_area(outline: &[Point2<f64>]) -> f64 {
    let Some(first) = outline.first() else { return 0.0 };
    outline.windows(2).map(|pair| 0.5 * cross(first, &pair[0], &pair[1])).sum()
}

fn is_convex(outline: &[Point2<f64>]) -> bool {
    let n = outline.len();
    (0..n).all(|i| cross(&outline[i], &outline[(i + 1) % n], &outline[(i + 2) % n]) >= 0.0)
        && signed_area(outline) > 0.0
}

/// A mesh on the plane z = −1, triangles counter-clockwise as the eye sees them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MaskMesh {
    /// Tangents: x right, y up.
    pub vertices: Vec<Point2<f64>>,
    /// Three per triangle (or the outline, one after the other, for a line loop).
    pub indices: Vec<u32>,
}

impl Eye {
    /// What is visible: a fan over the outline.
    pub fn visible_mesh(&self) -> MaskMesh {
        let indices = (2..self.visible.len() as u32).flat_map(|last| [0, last - 1, last]).collect();
        MaskMesh { vertices: self.visible.clone(), indices }
    }

    /// The outline of what is visible, as a loop.
    pub fn outline(&self) -> MaskMesh {
        MaskMesh { vertices: self.visible.clone(), indices: (0..self.visible.len() as u32).collect() }
    }

    /// What is hidden: the ring between the outline and the border of the image. It is cut along the rays from the
    /// middle of the outline through the outline's corners and through those of the image, so that each piece is a
    /// quadrilateral with straight sides.
    pub fn hidden_mesh(&self) -> MaskMesh {
        if self.visible.is_empty() {
            return MaskMesh::default();
        }
        let [l, r, u, d] = self.fov.tangents();
        let middle: Point2<f64> = (self.visible.iter().map(|p| p.coords).sum::<nalgebra::Vector2<f64>>()
            / self.visible.len() as f64)
            .into();
        let corners = [(l, u), (r, u), (r, d), (l, d)].map(|(x, y)| Point2::new(x, y));
        let mut rays: Vec<nalgebra::Vector2<f64>> =
            self.visible.iter().chain(&corners).map(|p| p - middle).collect();
        rays.sort_by(|a, b| a.y.atan2(a.x).total_cmp(&b.y.atan2(b.x)));
        let mut mesh = MaskMesh::default();
        for ray in &rays {
            let to_border = [(l, r, ray.x, middle.x), (d, u, ray.y, middle.y)]
                .into_iter()
                .filter(|(_, _, along, _)| *along != 0.0)
                .map(|(low, high, along, from)| (if along > 0.0 { high } else { low } - from) / along)
                .fold(f64::INFINITY, f64::min);
            let to_outline = self.along_ray(&middle, ray).min(to_border);
            mesh.vertices.extend([middle + ray * to_outline, middle + ray * to_border]);
        }
        let n = rays.len() as u32;
        for i in 0..n {
            let (inner, outer) = (2 * i, 2 * i + 1);
            let (inner_next, outer_next) = (2 * ((i + 1) % n), 2 * ((i + 1) % n) + 1);
            for triangle in [[inner, outer, outer_next], [inner, outer_next, inner_next]] {
                let [a, b, c] = triangle.map(|index| mesh.vertices[index as usize]);
                // Where the outline touches the border there is nothing between them.
                if cross(&a, &b, &c) > 1e-12 {
                    mesh.indices.extend(triangle);
                }
            }
        }
        mesh
    }

    /// How many times `ray` leads from `middle` to the outline.
    fn along_ray(&self, middle: &Point2<f64>, ray: &nalgebra::Vector2<f64>) -> f64 {
        let n = self.visible.len();
        (0..n)
            .filter_map(|i| {
                let (a, b) = (self.visible[i], self.visible[(i + 1) % n]);
                let side = b - a;
                let denominator = ray.perp(&side);
                let along = (a - middle).perp(&side) / denominator;
                (denominator != 0.0 && along > 0.0).then_some(along)
            })
            .fold(f64::INFINITY, f64::min)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn area(mesh: &MaskMesh) -> f64 {
        mesh.indices
            .chunks(3)
            .map(|t| {
                0.5 * cross(
                    &mesh.vertices[t[0] as usize],
                    &mesh.vertices[t[1] as usize],
                    &mesh.vertices[t[2] as usize],
                )
            })
            .sum()
    }

    #[test]
    fn built_in_headsets_are_right_and_mirror_symmetric() {
        for (name, _) in BUILT_IN_HEADSETS {
            let profile = Profile::open(name).unwrap();
            let [left, right] = &profile.eyes;
            assert_eq!(left.fov.left_rad, -right.fov.right_rad, "{name}");
            let between = right.head_from_eye.translation.vector - left.head_from_eye.translation.vector;
            assert_eq!(between, Vector3::new(profile.ipd_m, 0.0, 0.0), "{name}");
        }
        let index = Profile::open("index").unwrap();
        // Turned outwards: the left eye looks to the left.
        assert!((index.eyes[0].head_from_eye.rotation * -Vector3::z()).x < -0.05);
    }

    #[test]
    fn hidden_and_visible_area_make_the_image() {
        for name in ["quest3", "index"] {
            for eye in &Profile::open(name).unwrap().eyes {
                let [l, r, u, d] = eye.fov.tangents();
                let (hidden, visible) = (area(&eye.hidden_mesh()), area(&eye.visible_mesh()));
                assert!(hidden > 0.005 * visible && visible > 0.0, "{name}");
                assert!(
                    ((hidden + visible) / ((r - l) * (u - d)) - 1.0).abs() < 1e-12,
                    "{name} {hidden} {visible}"
                );
            }
        }
        assert!(Profile::default().eyes[0].hidden_mesh().indices.is_empty());
    }

    #[test]
    fn wrong_values_are_named() {
        let text = BUILT_IN_HEADSETS[0].1;
        for (old, new, said) in [
            (
                "1024, 1024",
                "0, 1024",
                "x.toml:3:14: expected a resolution of 1 to 8192 pixels per side, found 0 x 1024",
            ),
            ("90 Hz", "0 Hz", "expected at least one rate, each 1 to 1000 Hz, found [0.0] Hz"),
            ("63 mm", "2 m", "expected an ipd of 0 to 1 m, found 2 m"),
            ("\"45 deg\", down", "\"-46 deg\", down", "field of view: expected left < right and down < up"),
            ("oculus/touch", "oculus/tuch", "expected an interaction profile"),
            ("[left]", "[left]\nvisible = [[0,0],[1,1],[0.4,0.5],[1,0]]", "expected a convex outline"),
        ] {
            let error = Profile::parse(Path::new("x.toml"), &text.replace(old, new)).unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
        }
        assert!(Profile::open("rift").unwrap_err().to_string().contains("one of default, quest3, index"));
    }
}
