//! Khronos's own sample application, unmodified and through the Khronos loader: it runs, ends when the runtime asks it to, and
//! its cubes are seen where they are, in their colours.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use nalgebra::{Point3, Quaternion, UnitQuaternion, Vector3};
use vergence_geom::{Fov, Rigid, project};

/// Frames after which the runtime ends the session: hello_xr itself would go on until a key is pressed.
const FRAMES: usize = 60;
/// Longer than a machine without a GPU needs.
const PATIENCE: Duration = Duration::from_secs(120);
/// How far from an edge a point is looked at, pixels: at the edge itself either colour is right.
const MARGIN_PX: f64 = 1.0;
/// Rounding of the conversion to sRGB, in the application's driver and in the composition's.
const TOLERANCE: u8 = 1;

type Rgb = [u8; 3];
// hello_xr's colours are linear: dark slate grey, and faces of 1 and 0.25.
const BACKGROUND: Rgb = [119, 151, 151];
const RED: Rgb = [255, 0, 0];
const DARK_RED: Rgb = [137, 0, 0];
const GREEN: Rgb = [0, 255, 0];
const BLUE: Rgb = [0, 0, 255];

/// The head starts where LOCAL and the floor are known, and turns and goes ahead: around LOCAL is a cube, too.
const SCRIPT: &str = r#"
at-end = "hold"
duration = "60 s"
[[head]]
time = "0 s"
position = ["0 m", "1.6 m", "0 m"]
turned = { yaw = "0 deg" }
[[head]]
time = "0.6 s"
position = ["0.1 m", "1.5 m", "-0.3 m"]
turned = { yaw = "12 deg", pitch = "-15 deg" }
# The hands, where nothing is hidden behind the cubes that they hold.
[[left]]
time = "0 s"
position = ["-0.2 m", "1.2 m", "2 m"]
turned = { yaw = "0 deg" }
[[right]]
time = "0 s"
position = ["0.2 m", "1.2 m", "2 m"]
turned = { yaw = "0 deg" }
"#;

const PROFILE: &str = r#"
name = "small"
resolution = [256, 256]
rates = ["90 Hz"]
ipd = "63 mm"
[left]
fov = { left = "-50 deg", right = "45 deg", up = "45 deg", down = "-50 deg" }
"#;

fn skip(what: &str, why: &str) {
    let list = std::env::var("VERGENCE_REQUIRE").unwrap_or_default();
    assert!(!list.split(',').any(|entry| entry.trim() == what), "VERGENCE_REQUIRE names {what}, but: {why}");
    println!("skipped: no {what} ({why})");
}

fn manifest(folder: &Path) -> PathBuf {
    // Beside the test: …/target/PROFILE/deps.
    let test = std::env::current_exe().unwrap();
    let library = test.parent().unwrap().join("libvergence_xr_runtime.so");
    assert!(library.is_file(), "expected {}, found no such file", library.display());
    let path = folder.join("vergence_xr_runtime.json");
    let manifest = serde_json::json!({
        "file_format_version": "1.0.0",
        "runtime": { "name": "Vergence simulated headset", "library_path": library },
    });
    std::fs::write(&path, manifest.to_string()).unwrap();
    path
}

fn rigid(value: &serde_json::Value) -> Rigid {
    let v: Vec<f64> = value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    let rotation = UnitQuaternion::new_normalize(Quaternion::new(v[6], v[3], v[4], v[5]));
    Rigid::from_parts(Vector3::new(v[0], v[1], v[2]).into(), rotation)
}

/// One eye of a picture: its pixels, and what it sees.
struct Eye {
    pixels: Vec<u8>,
    size: (usize, usize),
    eye_from_local: Rigid,
    fov: Fov,
}

impl Eye {
    /// What is seen of a point, with what lies around it; `None` outside of the picture.
    fn at(&self, point_in_local: &Point3<f64>) -> Option<Vec<Rgb>> {
        let ndc = project(&self.fov, &(self.eye_from_local * point_in_local))?;
        let (width, height) = (self.size.0 as f64, self.size.1 as f64);
        let (x, y) = (0.5 * (ndc.x + 1.0) * width, 0.5 * (ndc.y + 1.0) * height);
        let inside = |v: f64, limit: f64| (MARGIN_PX..limit - MARGIN_PX).contains(&v);
        if !(inside(x, width) && inside(y, height)) {
            return None;
        }
        let steps = [-MARGIN_PX, 0.0, MARGIN_PX - 0.01];
        let pixel = |dx: f64, dy: f64| {
            let start = 4 * ((y + dy) as usize * self.size.0 + (x + dx) as usize);
            [self.pixels[start], self.pixels[start + 1], self.pixels[start + 2]]
        };
        Some(steps.iter().flat_map(|&dy| steps.map(|dx| pixel(dx, dy))).collect())
    }
}

fn same(found: &Rgb, expected: &Rgb) -> bool {
    found.iter().zip(expected).all(|(a, b)| a.abs_diff(*b) <= TOLERANCE)
}

#[test]
fn hello_xr_runs_unmodified_and_its_cubes_are_where_they_are() {
    if Command::new("hello_xr").stdin(Stdio::null()).output().is_err() {
        return skip("openxr", "hello_xr, package libopenxr-utils, is missing");
    }
    let folder = tempfile::tempdir().unwrap();
    let pictures = folder.path().join("pictures");
    std::fs::write(folder.path().join("head.toml"), SCRIPT).unwrap();
    std::fs::write(folder.path().join("small.toml"), PROFILE).unwrap();
    let output = std::fs::File::create(folder.path().join("output")).unwrap();
    let mut child = Command::new("hello_xr")
        .args(["-g", "Vulkan2"])
        .env("XR_RUNTIME_JSON", manifest(folder.path()))
        .env("VERGENCE_XR_PROFILE", folder.path().join("small.toml"))
        .env("VERGENCE_XR_MOTION", folder.path().join("head.toml"))
        .env("VERGENCE_XR_CLOCK", "virtual")
        .env("VERGENCE_XR_FRAMES", FRAMES.to_string())
        .env("VERGENCE_XR_CAPTURE", &pictures)
        // Held open: a byte or the end of it would end the application.
        .stdin(Stdio::piped())
        .stderr(output.try_clone().unwrap())
        .stdout(output)
        .spawn()
        .unwrap();
    let started = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        if started.elapsed() > PATIENCE {
            child.kill().unwrap();
            panic!("hello_xr did not end:\n{}", said(folder.path()));
        }
        std::thread::sleep(Duration::from_millis(20));
    };
    let said = said(folder.path());
    if said.contains("VK_ERROR_INCOMPATIBLE_DRIVER") || said.contains("failed to find a suitable device") {
        return skip("vulkan", "hello_xr finds no device");
    }
    assert!(status.success(), "{status}\n{said}");
    for state in ["READY", "SYNCHRONIZED", "VISIBLE", "FOCUSED", "STOPPING", "IDLE", "EXITING"] {
        assert!(said.contains(&format!("->XR_SESSION_STATE_{state} ")), "{state} is missing:\n{said}");
    }
    // It loads the validation layer by itself where that is installed.
    assert!(!said.contains("VUID-"), "{said}");

    let poses = std::fs::read_to_string(pictures.join("poses.jsonl")).unwrap();
    assert_eq!(poses.lines().count(), FRAMES);
    let (mut seen, mut heads) = ([0usize; 6], Vec::new());
    for line in poses.lines().skip(2) {
        let line: serde_json::Value = serde_json::from_str(line).unwrap();
        let local_from_head = rigid(&line["head"]);
        heads.push(local_from_head);
        for (eye, view) in eyes(&pictures, &line).iter().zip(["left", "right"]) {
            let mut check = |kind: usize, point: Point3<f64>, expected: Rgb| {
                let Some(found) = eye.at(&point) else { return };
                let ok = found.iter().all(|found| same(found, &expected));
                assert!(ok, "{line}, {view}: at {point} expected {expected:?}, found {found:?}");
                seen[kind] += 1;
            };
            // A cube of 25 cm, two metres in front of the head: its near face, up to its corners, and beside them.
            let in_head = |x: f64, y: f64| local_from_head * Point3::new(x, y, -1.875);
            for (x, y) in [(0.0, 0.0), (0.09, 0.09), (-0.09, 0.09), (0.09, -0.09), (-0.09, -0.09)] {
                check(0, in_head(x, y), BLUE);
            }
            for (x, y) in [(0.17, 0.0), (-0.17, 0.0), (0.0, 0.17), (0.0, -0.17)] {
                check(1, in_head(x, y), BACKGROUND);
            }
            // Cubes of 25 cm on the floor, 1.6 m below LOCAL, at two metres ahead and to both sides.
            let on_floor = |x: f64, y: f64, z: f64| Point3::new(x, y - 1.6, z);
            check(2, on_floor(-1.875, 0.0, -2.0), RED);
            check(3, on_floor(1.875, 0.0, -2.0), DARK_RED);
            for x in [-2.0, 2.0] {
                check(4, on_floor(x, 0.125, -2.0), GREEN);
                check(5, on_floor(x, 0.0, -1.875), BLUE);
            }
        }
    }
    assert!(seen.iter().all(|&count| count > 20), "points that were seen of each kind: {seen:?}");
    println!("points that were compared: {seen:?}");
    let moved = heads[0].inverse() * heads[heads.len() - 1];
    assert!(moved.translation.vector.norm() > 0.1 && moved.rotation.angle() > 0.15, "the head did not move");
}

fn said(folder: &Path) -> String {
    String::from_utf8_lossy(&std::fs::read(folder.join("output")).unwrap()).into_owned()
}

/// Both eyes of a picture, side by side in its file.
fn eyes(folder: &Path, line: &serde_json::Value) -> [Eye; 2] {
    let file = std::fs::File::open(folder.join(line["file"].as_str().unwrap())).unwrap();
    let mut reader = png::Decoder::new(std::io::BufReader::new(file)).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    let size = (info.width as usize / 2, info.height as usize);
    [0, 1].map(|index| {
        let view = &line["eyes"][index];
        let angle = |side: usize| view["fov"][side].as_f64().unwrap();
        let half = |row: &[u8]| row[4 * size.0 * index..4 * size.0 * (index + 1)].to_vec();
        Eye {
            pixels: pixels.chunks_exact(8 * size.0).flat_map(half).collect(),
            size,
            eye_from_local: rigid(&view["pose"]).inverse(),
            fov: Fov { left_rad: angle(0), right_rad: angle(1), up_rad: angle(2), down_rad: angle(3) },
        }
    })
}

/// A wrong environment is one sentence, and the loader reports that there is no runtime.
#[test]
fn a_wrong_environment_is_said() {
    if Command::new("hello_xr").stdin(Stdio::null()).output().is_err() {
        return skip("openxr", "hello_xr, package libopenxr-utils, is missing");
    }
    let folder = tempfile::tempdir().unwrap();
    let output = Command::new("hello_xr")
        .args(["-g", "Vulkan2"])
        .env("XR_RUNTIME_JSON", manifest(folder.path()))
        .env("VERGENCE_XR_PROFILE", "no-such-headset")
        .stdin(Stdio::null())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("VERGENCE_XR_PROFILE") && said.contains("quest3"), "{said}");
}
