//! `vergence` as its users call it, on the simulated headset: what it prints, what it writes, how it ends.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use vergence_tests::located::{Located, located};

/// Poses pass through f32 once, in OpenXR's types: 8 ulp at 1.
const TOLERANCE: f64 = 1e-6;

fn sample() -> PathBuf {
    vergence_tests::checkout().join("crates/vergence-scene/samples/room.toml")
}

fn vergence(arguments: &[&std::ffi::OsStr]) -> Output {
    Command::new(vergence_tests::vergence()).args(arguments).output().expect("the binary runs")
}

macro_rules! arguments {
    ($($argument:expr),* $(,)?) => { &[$(std::ffi::OsStr::new($argument)),*] };
}

fn told(output: &Output) -> String {
    format!(
        "{}\n{}\n{}",
        output.status,
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    )
}

/// Whether the tool finds a Vulkan device; where not, the test says that it is skipped.
fn vulkan() -> bool {
    let output = vergence(arguments!["doctor", "--json"]);
    let report = vergence_tests::last_object(&String::from_utf8_lossy(&output.stdout))
        .expect("doctor prints an object");
    let findings = report["findings"].as_array().expect("a list of findings");
    let device =
        findings.iter().find(|finding| finding["topic"] == "Vulkan device").expect("a finding on Vulkan");
    let usable = device["usable"] == true;
    if !usable {
        vergence_tests::skip("vulkan", &device["missing"].to_string());
    }
    usable
}

/// Turns `v` by the inverse of the quaternion x, y, z, w.
fn turned_back(q: &[f64; 7], v: [f64; 3]) -> [f64; 3] {
    let (u, w) = ([-q[3], -q[4], -q[5]], q[6]);
    let cross = |a: [f64; 3], b: [f64; 3]| {
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    };
    let inner = cross(u, v);
    let outer = cross(u, [0, 1, 2].map(|i: usize| inner[i] + w * v[i]));
    [0, 1, 2].map(|i: usize| v[i] + 2.0 * outer[i])
}

/// From the left eye to the right one, in the head's frame, metres.
fn eye_offset_in_head(frame: &Located) -> [f64; 3] {
    turned_back(&frame.head, [0, 1, 2].map(|i: usize| frame.eyes[1][i] - frame.eyes[0][i]))
}

fn run(scene: &Path, folder: &Path, extra: &[&str]) -> (serde_json::Value, Vec<Located>) {
    let poses = folder.join("poses.jsonl");
    let mut words =
        arguments!["run", scene, "--headset", "simulated", "--json", "--log-poses", &poses].to_vec();
    words.extend(extra.iter().map(std::ffi::OsStr::new));
    let output = vergence(&words);
    assert!(output.status.success(), "{}", told(&output));
    let report = vergence_tests::last_object(&String::from_utf8_lossy(&output.stdout));
    (report.unwrap_or_else(|| panic!("no JSON object at the end of {}", told(&output))), located(&poses))
}

#[test]
fn a_walk_through_the_colonnade_is_seen_with_two_eyes() {
    let Some(data) = vergence_tests::data() else { return };
    if !vulkan() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder for the run");
    let motion = vergence_tests::checkout().join("crates/vergence-xr-sim/motions/room1.toml");
    let motion = motion.to_str().expect("a path in UTF-8");
    let capture = folder.path().join("pictures");
    let capture = capture.to_str().expect("a path in UTF-8");
    let scene = data.join("scenes/gltf/colonnade.glb");
    let (report, frames) = run(
        &scene,
        folder.path(),
        &["--motion", motion, "--frames", "300", "--msaa", "1", "--capture", capture],
    );

    assert_eq!(report["frames"], 300, "{report}");
    assert_eq!(frames.len(), 300);
    for name in ["headset", "state", "missed", "device"] {
        assert!(!report[name].is_null(), "{name} is missing in {report}");
    }
    for name in ["p50", "p95", "p99"] {
        assert!(report["frame_cpu_ms"][name].is_number(), "frame_cpu_ms.{name} is missing in {report}");
    }
    for name in ["p50", "p99"] {
        assert!(report["pose_age_ms"][name].is_number(), "pose_age_ms.{name} is missing in {report}");
    }

    let offset = eye_offset_in_head(&frames[0]);
    let between = offset.iter().map(|c| c * c).sum::<f64>().sqrt();
    assert!((0.05..0.08).contains(&between), "the eyes are {between} m apart");
    for (number, frame) in frames.iter().enumerate() {
        let found = eye_offset_in_head(frame);
        let error = (0..3).map(|i| (found[i] - offset[i]).abs()).fold(0.0, f64::max);
        assert!(error <= TOLERANCE, "frame {number}: the eyes' offset is {error:e} m off");
        for eye in 0..2 {
            // The middle between the eyes is the head: each eye is half the offset away.
            let side = if eye == 0 { -0.5 } else { 0.5 };
            let from_head = [0, 1, 2].map(|i: usize| frame.eyes[eye][i] - frame.head[i]);
            let error = turned_back(&frame.head, from_head);
            let error = (0..3).map(|i| (error[i] - side * offset[i]).abs()).fold(0.0, f64::max);
            assert!(error <= TOLERANCE, "frame {number}: eye {eye} is {error:e} m off");
        }
    }
    let way: f64 = frames
        .windows(2)
        .map(|w| (0..3).map(|i| (w[1].head[i] - w[0].head[i]).powi(2)).sum::<f64>().sqrt())
        .sum();
    // In its first three seconds the rig is held almost still: the recorded path is 7 cm.
    assert!((0.05..0.1).contains(&way), "the head went {way} m, the recording 0.07 m");
    let pictures = std::fs::read_dir(capture).expect("the folder of pictures").count();
    assert!(pictures > 0, "no picture was written");
}

#[test]
fn the_virtual_clock_does_not_know_the_load() {
    if !vulkan() {
        return;
    }
    let folders = [0, 1].map(|_| tempfile::tempdir().expect("a folder for the run"));
    let [quiet, loaded] = folders.each_ref().map(tempfile::TempDir::path);
    let first = run(&sample(), quiet, &["--frames", "20"]).1;
    let done = std::sync::atomic::AtomicBool::new(false);
    let second = std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while !done.load(std::sync::atomic::Ordering::Relaxed) {
                    std::hint::spin_loop()
                }
            });
        }
        let frames = run(&sample(), loaded, &["--frames", "20"]).1;
        done.store(true, std::sync::atomic::Ordering::Relaxed);
        frames
    });
    assert_eq!(first.len(), 20);
    assert_eq!(first, second);
    let step = first[1].predicted_display_ns - first[0].predicted_display_ns;
    assert!(
        first
            .windows(2)
            .all(|pair| (pair[1].predicted_display_ns - pair[0].predicted_display_ns - step).abs() <= 1)
    );
}

#[test]
fn plans_differ_as_scenes_do() {
    let Some(data) = vergence_tests::data() else { return };
    let plan = |scene: &Path| {
        let output = vergence(arguments!["plan", scene, "--json"]);
        assert!(output.status.success(), "{}", told(&output));
        vergence_tests::last_object(&String::from_utf8_lossy(&output.stdout)).expect("plan prints an object")
    };
    let (small, room) = (plan(&data.join("scenes/gltf/Box.glb")), plan(&sample()));
    assert!(small["plan"].is_object(), "plan prints no plan: {small}");
    // The scene's name differs anyway: what it requires must.
    assert_ne!(small["plan"], room["plan"]);
}

#[test]
fn a_wrong_call_is_told_from_failed_work() {
    let scene = sample();
    let wrong = vergence(arguments!["run", &scene, "--no-such-option"]);
    assert_eq!(wrong.status.code(), Some(2), "{}", told(&wrong));
    let missing = vergence(arguments!["plan", "no-such-file.glb"]);
    assert!(matches!(missing.status.code(), Some(1 | 2)), "{}", told(&missing));
    assert!(told(&missing).contains("no-such-file.glb"), "the message names no file: {}", told(&missing));
    if !vulkan() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder for the picture");
    let picture = folder.path().join("picture.png");
    let fine = vergence(arguments!["render", &scene, "--size", "64x64", "--msaa", "3", "-o", &picture]);
    assert_eq!(fine.status.code(), Some(2), "{}", told(&fine));
    assert!(
        told(&fine).contains("can give MSAA 1"),
        "the message does not say what the device can give: {}",
        told(&fine)
    );
}
