//! A bright disc on a black board ahead of the user, and where geometry puts it in the pictures that `vergence run --capture`
//! writes: what is submitted is what was drawn, and that is seen from where each eye is.

use std::path::{Path, PathBuf};

use nalgebra::{Point3, Quaternion, UnitQuaternion, Vector3};
use vergence_geom::{Fov, Rigid, project};

use crate::located::{Located, located};

/// Ahead of the user's start, metres.
const AHEAD_M: f64 = 2.0;
/// Over the user's floor, metres.
pub const HEIGHT_M: f64 = 1.6;
/// What is one metre wide and one metre away.
const PIXELS: f64 = 256.0;
/// 40 pixels across.
const RADIUS_M: f64 = 20.0 / PIXELS * AHEAD_M;
/// Half the side of what is looked at around the disc, pixels: within the board, and larger than the disc.
const AROUND_PX: usize = 32;
/// How far the disc's middle in a picture may be from its projection.
const TOLERANCE_PX: f64 = 0.1;

/// Writes a scene into `folder`, where `models` (lines of a scene file) stand around the disc, and a headset whose eyes see
/// about `half_angle_deg` to each side; gives the files' names.
///
/// # Panics
/// When the folder cannot be written.
#[must_use]
pub fn write(folder: &Path, models: &str, half_angle_deg: f64) -> (PathBuf, PathBuf) {
    // The user stands at a place of no round numbers and looks along +x; the board is half a millimetre behind the disc.
    let (x, y, z) = (-10.53, 0.2, 0.11);
    let rotation = r#"rotation = { yaw = "-90 deg" }"#;
    let scene = format!(
        r##"
background = "#000000"
ambient = [0.5, 0.5, 0.5]
[start]
position = [{x}, {y}, {z}]
yaw = "-90 deg"
[material.black]
color = "#000000"
unlit = true
[material.white]
color = "#ffffff"
unlit = true
[[shape]]
name = "board"
kind = "rectangle"
size = [0.7, 0.7]
material = "black"
position = [{board}, {eye}, {z}]
{rotation}
[[shape]]
name = "disc"
kind = "cylinder"
radius = {RADIUS_M}
height = 0.0001
segments = 96
material = "white"
position = [{disc}, {eye}, {z}]
rotation = {{ yaw = "-90 deg", pitch = "90 deg" }}
{models}
"##,
        eye = y + HEIGHT_M,
        board = x + AHEAD_M + 5e-4,
        disc = x + AHEAD_M + 1e-4,
    );
    let profile = format!(
        r#"
name = "small"
resolution = [{pixels}, {pixels}]
rates = ["90 Hz"]
ipd = "64 mm"
[left]
fov = {{ left = "{} deg", right = "{} deg", up = "{} deg", down = "{} deg" }}
"#,
        -half_angle_deg - 3.0,
        half_angle_deg - 3.0,
        half_angle_deg - 1.0,
        -half_angle_deg - 1.0,
        pixels = (2.0 * PIXELS * half_angle_deg.to_radians().tan()) as u32,
    );
    let files = (folder.join("disc.toml"), folder.join("small.toml"));
    std::fs::write(&files.0, scene).expect("the test's own folder is writable");
    std::fs::write(&files.1, profile).expect("the test's own folder is writable");
    files
}

/// Compares every picture in `capture` with the projection of the disc, for each eye that sees all of it. `floor_y_m` says how high
/// the floor on which the scene was drawn is in LOCAL when the frame of that number was shown. Gives the poses, how many pictures
/// of an eye were compared, and the largest distance found, pixels.
///
/// # Panics
/// When a disc is more than a tenth of a pixel away from where geometry puts it, or a file is missing.
#[must_use]
pub fn compare(capture: &Path, floor_y_m: impl Fn(usize) -> f64) -> (Vec<Located>, usize, f64) {
    let frames = located(&capture.join("poses.jsonl"));
    let mut pictures: Vec<PathBuf> = std::fs::read_dir(capture)
        .expect("the folder of pictures")
        .map(|entry| entry.expect("a readable entry").path())
        .filter(|path| path.extension().is_some_and(|ending| ending == "png"))
        .collect();
    pictures.sort();
    assert_eq!(frames.len(), pictures.len(), "poses and pictures");
    let (mut compared, mut worst) = (0, 0f64);
    for (number, (frame, path)) in frames.iter().zip(&pictures).enumerate() {
        let picture = Picture::read(path);
        let middle_in_local = Point3::new(0.0, HEIGHT_M + floor_y_m(number), -AHEAD_M);
        for eye in 0..2 {
            let Some(truth) = truth_px(&middle_in_local, &frame.eyes[eye], &frame.fovs[eye], picture.size)
            else {
                continue;
            };
            let Some(found) = picture.centroid_px(eye, truth) else { continue };
            let off = (truth.0 - found.0).hypot(truth.1 - found.1);
            assert!(
                off <= TOLERANCE_PX,
                "{}: eye {eye}: {truth:?} expected, {found:?} found",
                path.display()
            );
            (compared, worst) = (compared + 1, worst.max(off));
        }
    }
    (frames, compared, worst)
}

/// Both eyes side by side, 8-bit sRGB RGBA.
struct Picture {
    rgba: Vec<u8>,
    /// Of one eye.
    size: (usize, usize),
}

impl Picture {
    fn read(path: &Path) -> Self {
        let file = std::fs::File::open(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let mut reader = png::Decoder::new(std::io::BufReader::new(file)).read_info().expect("a PNG");
        let mut rgba = vec![0; reader.output_buffer_size().expect("a picture that fits")];
        let info = reader.next_frame(&mut rgba).expect("a whole PNG");
        Self { rgba, size: (info.width as usize / 2, info.height as usize) }
    }

    /// Centroid of the light around `near`, pixels from the upper left corner of the eye's picture; light is added up linearly.
    /// `None` where that is not all inside the picture.
    fn centroid_px(&self, eye: usize, near: (f64, f64)) -> Option<(f64, f64)> {
        let (width, height) = self.size;
        let (left, top) =
            ((near.0 as usize).checked_sub(AROUND_PX)?, (near.1 as usize).checked_sub(AROUND_PX)?);
        if left + 2 * AROUND_PX > width || top + 2 * AROUND_PX > height {
            return None;
        }
        let (mut sum, mut x, mut y) = (0.0, 0.0, 0.0);
        for v in top..top + 2 * AROUND_PX {
            for u in left..left + 2 * AROUND_PX {
                let coded = f64::from(self.rgba[4 * (v * 2 * width + eye * width + u)]) / 255.0;
                let light =
                    if coded <= 0.04045 { coded / 12.92 } else { ((coded + 0.055) / 1.055).powf(2.4) };
                sum += light;
                x += light * (u as f64 + 0.5);
                y += light * (v as f64 + 0.5);
            }
        }
        assert!(sum > 0.0, "no light where the disc is expected, around {near:?}");
        Some((x / sum, y / sum))
    }
}

/// Where the disc's centroid is, pixels, by integrating the projected disc; `None` where part of it is behind the eye.
fn truth_px(
    middle_in_local: &Point3<f64>,
    eye: &[f64; 7],
    fov: &[f64; 4],
    (width, height): (usize, usize),
) -> Option<(f64, f64)> {
    const RINGS: usize = 24;
    const SPOKES: usize = 96;
    let turned = UnitQuaternion::new_normalize(Quaternion::new(eye[6], eye[3], eye[4], eye[5]));
    let eye_from_local = Rigid::from_parts(Vector3::new(eye[0], eye[1], eye[2]).into(), turned).inverse();
    let fov = Fov { left_rad: fov[0], right_rad: fov[1], up_rad: fov[2], down_rad: fov[3] };
    let at = |ring: usize, spoke: usize| {
        let angle = spoke as f64 / SPOKES as f64 * std::f64::consts::TAU;
        let radius = RADIUS_M * ring as f64 / RINGS as f64;
        let point_in_local = middle_in_local + Vector3::new(radius * angle.cos(), radius * angle.sin(), 0.0);
        let ndc = project(&fov, &(eye_from_local * point_in_local))?;
        Some((0.5 * (ndc.x + 1.0) * width as f64, 0.5 * (ndc.y + 1.0) * height as f64))
    };
    let (mut sum, mut x, mut y) = (0.0, 0.0, 0.0);
    for ring in 0..RINGS {
        for spoke in 0..SPOKES {
            let (a, b) = (at(ring, spoke)?, at(ring + 1, spoke)?);
            let (c, d) = (at(ring + 1, spoke + 1)?, at(ring, spoke + 1)?);
            // The cross product of its diagonals is twice the area of a cell.
            let area = ((c.0 - a.0) * (d.1 - b.1) - (c.1 - a.1) * (d.0 - b.0)).abs();
            sum += area;
            x += area * 0.25 * (a.0 + b.0 + c.0 + d.0);
            y += area * 0.25 * (a.1 + b.1 + c.1 + d.1);
        }
    }
    Some((x / sum, y / sum))
}
