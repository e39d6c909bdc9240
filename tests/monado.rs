//! `vergence run` on Monado, a real OpenXR runtime: that the client reaches the focused state, submits what it should, ends
//! cleanly, and locates exactly the poses that the runtime was given; all under Vulkan's and OpenXR's validation layers.

use std::ffi::OsStr;
use std::path::Path;
use std::time::{Duration, Instant};

use vergence_tests::located::{Located, located};
use vergence_tests::monado::{Driver, Run, available, free_port};
use vergence_tests::remote::{Eye, Pose, Script, State};

/// Monado's null compositor shows 20 frames a second; a busy machine without a GPU takes several times as long.
const PATIENCE: Duration = Duration::from_secs(600);

/// Positions (m), quaternion components and angles (rad) are f32 on the wire and in the runtime: 8 ulp at 1.
const TOLERANCE: f64 = 1e-6;

/// Monado's LOCAL space has its origin 1.6 m above the driver's own (its STAGE), with the same axes, whatever the head's pose
/// at the start was.
const LOCAL_ABOVE_ORIGIN_M: f64 = 1.6;

/// The specification of the test: each pose is located in at least this many frames in a row.
const FRAMES_HELD: usize = 5;

fn vergence_run(driver: Driver, folder: &Path, extra: &[&str]) -> Run {
    let binary = vergence_tests::vergence();
    let scene = vergence_tests::checkout().join("crates/vergence-scene/samples/room.toml");
    let poses = folder.join("poses.jsonl");
    let mut command: Vec<&OsStr> = vec![binary.as_os_str(), OsStr::new("run"), scene.as_os_str()];
    command.extend(["--headset", "openxr", "--json", "--log-poses"].map(OsStr::new));
    command.push(poses.as_os_str());
    command.extend(extra.iter().map(OsStr::new));
    Run::start(driver, folder, &command)
}

/// What the list of calls says of one frame's end.
fn frame_ends(calls: &str) -> Vec<&str> {
    let mut ends = Vec::new();
    for call in calls.split("\nXrResult ") {
        if call.starts_with("xrEndFrame") {
            ends.push(call);
        }
    }
    ends
}

#[test]
fn a_scene_runs_on_monado_to_focused_and_ends_cleanly() {
    if !available() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder for the run");
    let log = folder.path().join("session.mcap");
    let extra = ["--frames", "100", "--record", log.to_str().expect("a path in UTF-8")];
    let mut run = vergence_run(Driver::Simulated, folder.path(), &extra);
    let status = run.wait(PATIENCE);
    assert!(status.success(), "{status}\n{}", run.story());

    let report = vergence_tests::last_object(&run.stdout())
        .unwrap_or_else(|| panic!("no JSON object\n{}", run.story()));
    assert!(report["frames"].as_u64() >= Some(100), "{report}");
    assert_eq!(
        located(&folder.path().join("poses.jsonl")).len() as u64,
        report["frames"].as_u64().unwrap_or(0)
    );

    // What the runtime saw, by a witness that is not ours.
    let calls = run.calls();
    let with_layers: Vec<&str> = frame_ends(&calls)
        .into_iter()
        .filter(|end| end.contains("XR_TYPE_COMPOSITION_LAYER_PROJECTION\n"))
        .collect();
    assert!(
        with_layers.len() >= 100,
        "{} frames with a projection layer\n{}",
        with_layers.len(),
        run.story()
    );
    for end in &with_layers {
        for view in 0..2 {
            // The pointer's place in the list names the view; that it leads to a depth layer is said by its type.
            let depth = format!("views[{view}].next");
            assert!(end.contains(&depth), "{end}");
        }
        assert!(
            end.matches("XR_TYPE_COMPOSITION_LAYER_DEPTH_INFO_KHR").count() >= 2,
            "no depth layer per view in\n{end}"
        );
    }
    for call in ["xrRequestExitSession", "xrEndSession", "xrDestroySession", "xrDestroyInstance"] {
        assert!(calls.contains(&format!("XrResult {call}\n")), "{call} was never called\n{}", run.story());
    }
    let states: Vec<String> = report["states"]
        .as_array()
        .expect("a list of states")
        .iter()
        .map(|s| s.to_string().to_lowercase())
        .collect();
    assert!(states.iter().any(|state| state.contains("focused")), "never focused: {states:?}");
    assert!(report["state"].to_string().to_lowercase().contains("exiting"), "{report}");
    assert_eq!(run.complaints(), Vec::<String>::new());

    // What another runtime said is lived through again on ours.
    let replay = std::process::Command::new(vergence_tests::vergence())
        .args(["replay".as_ref(), log.as_os_str(), "--verify".as_ref(), "--json".as_ref()])
        .output()
        .expect("the vergence binary starts");
    let stderr = String::from_utf8_lossy(&replay.stderr);
    let again = vergence_tests::last_object(&String::from_utf8_lossy(&replay.stdout))
        .unwrap_or_else(|| panic!("no JSON object\n{stderr}"));
    assert!(replay.status.success(), "{again}\n{stderr}");
    assert_eq!(again["frames"], again["frames_equal"], "{again}");
    assert_eq!(again["events"], again["events_equal"], "{again}");
    assert!(again["frames"].as_u64() >= Some(100) && again["first_difference"].is_null(), "{again}");
}

/// Quaternion x, y, z, w of a turn about an axis.
fn turn(axis: [f64; 3], angle_rad: f64) -> [f64; 4] {
    let norm = axis.iter().map(|a| a * a).sum::<f64>().sqrt();
    let (sin, cos) = (angle_rad / 2.0).sin_cos();
    [axis[0] / norm * sin, axis[1] / norm * sin, axis[2] / norm * sin, cos]
}

fn script() -> Vec<State> {
    let eye = |x: f32, y: f32, z: f32, turned: f64, fov_rad: [f32; 4]| Eye {
        head_from_eye: Pose {
            position: [x, y, z],
            orientation: turn([0.0, 1.0, 0.0], turned).map(|v| v as f32),
        },
        fov_rad,
    };
    let state = |position: [f32; 3], orientation: [f64; 4], eyes: [Eye; 2]| State {
        origin_from_head: Pose { position, orientation: orientation.map(|v| v as f32) },
        eyes,
    };
    let plain = [
        eye(-0.0315, 0.0, 0.0, 0.0, [-0.80, 0.70, 0.75, -0.85]),
        eye(0.0315, 0.0, 0.0, 0.0, [-0.70, 0.80, 0.75, -0.85]),
    ];
    // Canted displays, uneven in every angle, and eyes that are not level: nothing that a client might assume holds.
    let uneven = [
        eye(-0.0333, 0.0021, -0.0110, 0.087, [-0.93, 0.61, 0.72, -0.88]),
        eye(0.0297, -0.0013, -0.0090, -0.087, [-0.58, 0.97, 0.69, -0.91]),
    ];
    vec![
        state([0.0, 1.6, 0.0], turn([0.0, 1.0, 0.0], 0.0), plain),
        state([0.25, 1.75, -0.5], turn([0.0, 1.0, 0.0], 0.7), plain),
        state([-0.4, 1.1, 0.3], turn([1.0, 0.0, 0.0], -0.5), uneven),
        state([0.9, 0.2, -0.9], turn([0.3, -0.8, 0.5], 2.4), uneven),
        state([0.0, 1.65, 0.0], turn([0.0, 0.0, 1.0], -3.0), plain),
        state([-1.0, 1.9, 1.0], turn([1.0, 1.0, 1.0], 1.1), uneven),
    ]
}

/// Hamilton product of quaternions x, y, z, w.
fn product(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    [
        a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
        a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
        a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
        a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
    ]
}

/// Written out here and not taken from the product's own geometry, which is among what is tested.
fn rotated(q: [f64; 4], v: [f64; 3]) -> [f64; 3] {
    let r = product(product(q, [v[0], v[1], v[2], 0.0]), [-q[0], -q[1], -q[2], q[3]]);
    [r[0], r[1], r[2]]
}

/// What a client must locate in LOCAL space while the script holds `state`.
fn expected(state: &State) -> Located {
    let orientation = state.origin_from_head.orientation.map(f64::from);
    let mut position = state.origin_from_head.position.map(f64::from);
    position[1] -= LOCAL_ABOVE_ORIGIN_M;
    let flat = |p: [f64; 3], q: [f64; 4]| [p[0], p[1], p[2], q[0], q[1], q[2], q[3]];
    let eyes = state.eyes.map(|eye| {
        let offset = rotated(orientation, eye.head_from_eye.position.map(f64::from));
        let position = [0, 1, 2].map(|axis: usize| position[axis] + offset[axis]);
        flat(position, product(orientation, eye.head_from_eye.orientation.map(f64::from)))
    });
    let fovs = state.eyes.map(|eye| eye.fov_rad.map(f64::from));
    Located { predicted_display_ns: 0, head: flat(position, orientation), eyes, fovs }
}

/// The largest difference of any number; q and −q are the same rotation.
fn difference(a: &Located, b: &Located) -> f64 {
    let pose = |a: &[f64; 7], b: &[f64; 7]| {
        let sign = (3..7).map(|i| a[i] * b[i]).sum::<f64>().signum();
        (0..7).map(|i| (a[i] - if i < 3 { b[i] } else { sign * b[i] }).abs()).fold(0.0, f64::max)
    };
    let fov = |a: &[f64; 4], b: &[f64; 4]| (0..4).map(|i| (a[i] - b[i]).abs()).fold(0.0, f64::max);
    let eyes = (0..2).map(|eye| pose(&a.eyes[eye], &b.eyes[eye]).max(fov(&a.fovs[eye], &b.fovs[eye])));
    eyes.fold(pose(&a.head, &b.head), f64::max)
}

#[test]
fn the_client_locates_the_poses_and_fields_of_view_that_the_runtime_was_given() {
    if !available() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder for the run");
    let poses = folder.path().join("poses.jsonl");
    let port = free_port();
    let script_states = script();
    // Frames enough for every pose, on a machine that shows some of them twice.
    let frames = 40 * script_states.len();
    let mut run = vergence_run(Driver::Remote(port), folder.path(), &["--frames", &frames.to_string()]);
    let mut script = match Script::connect(port, Duration::from_secs(30)) {
        Ok(script) => script,
        Err(error) => panic!("{error}\n{}", run.story()),
    };
    // The first pose lies far from the one that LOCAL might be set by, to prove that it is not.
    let held = FRAMES_HELD + 3;
    for state in &script_states {
        let before = located(&poses).len();
        script.send(state).expect("the driver listens");
        let sent = Instant::now();
        while located(&poses).len() < before + held {
            assert!(run.running(), "ended before the script did\n{}", run.story());
            assert!(
                sent.elapsed() < PATIENCE,
                "{held} frames took longer than {PATIENCE:?}\n{}",
                run.story()
            );
            std::thread::sleep(Duration::from_millis(10));
        }
    }
    let status = run.wait(PATIENCE);
    assert!(status.success(), "{status}\n{}", run.story());

    let frames = located(&poses);
    let mut from = 0;
    for (number, state) in script_states.iter().enumerate() {
        let expected = expected(state);
        let matches = |frame: &Located| difference(frame, &expected) <= TOLERANCE;
        let Some(first) = frames[from..].iter().position(matches).map(|at| from + at) else {
            let nearest =
                frames.iter().map(|frame| difference(frame, &expected)).fold(f64::INFINITY, f64::min);
            panic!(
                "pose {number} was never located; nearest: {nearest:e} off {expected:?}\nlocated {:#?}",
                frames.last()
            );
        };
        let run_length = frames[first..].iter().take_while(|frame| matches(frame)).count();
        assert!(run_length >= FRAMES_HELD, "pose {number} was located in {run_length} frames in a row");
        // Between two poses the runtime may be read while it is written: one frame of neither.
        let neither = if number == 0 { 0 } else { first - from };
        assert!(
            neither <= 1,
            "{neither} frames between pose {} and {number} equal neither",
            number.wrapping_sub(1)
        );
        let worst = frames[first..first + run_length]
            .iter()
            .map(|frame| difference(frame, &expected))
            .fold(0.0, f64::max);
        println!("pose {number}: {run_length} frames, largest difference {worst:.1e}");
        from = first + run_length;
    }
    assert_eq!(run.complaints(), Vec::<String>::new());
}
