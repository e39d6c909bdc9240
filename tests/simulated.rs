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

/// Both eyes are the same offset from the head in every frame; how far they are apart, metres.
fn eyes_keep_their_offset(frames: &[Located]) -> f64 {
    let offset = eye_offset_in_head(&frames[0]);
    for (number, frame) in frames.iter().enumerate() {
        let found = eye_offset_in_head(frame);
        let error = (0..3).map(|i| (found[i] - offset[i]).abs()).fold(0.0, f64::max);
        assert!(error <= TOLERANCE, "frame {number}: the eyes' offset is {error:e} m off");
        for eye in 0..2 {
            // The middle between the eyes is the head: each eye is half the offset away, and turned as the head.
            let side = if eye == 0 { -0.5 } else { 0.5 };
            let from_head = [0, 1, 2].map(|i: usize| frame.eyes[eye][i] - frame.head[i]);
            let error = turned_back(&frame.head, from_head);
            let error = (0..3).map(|i| (error[i] - side * offset[i]).abs()).fold(0.0, f64::max);
            assert!(error <= TOLERANCE, "frame {number}: eye {eye} is {error:e} m off");
            let turned = (3..7).map(|i| (frame.eyes[eye][i] - frame.head[i]).abs()).fold(0.0, f64::max);
            assert!(turned <= TOLERANCE, "frame {number}: eye {eye} is turned by {turned:e}");
        }
    }
    offset.iter().map(|c| c * c).sum::<f64>().sqrt()
}

#[test]
fn a_walk_through_the_colonnade_is_seen_with_two_eyes() {
    let Some(data) = vergence_tests::data() else { return };
    if !vulkan() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder for the run");
    // A scene file reads nothing outside of its folder.
    std::fs::copy(data.join("scenes/gltf/colonnade.glb"), folder.path().join("colonnade.glb"))
        .expect("a copy of the scene");
    let model = "[[model]]\nname = \"colonnade\"\nfile = \"colonnade.glb\"\n";
    let (scene, profile) = vergence_tests::disc::write(folder.path(), model, 25.0);
    let motion = vergence_tests::checkout().join("crates/vergence-xr-sim/motions/room1.toml");
    let pictures = folder.path().join("pictures");
    let [motion, profile, capture] =
        [&motion, &profile, &pictures].map(|path| path.to_str().expect("a path in UTF-8"));
    let (report, frames) = run(
        &scene,
        folder.path(),
        &["--motion", motion, "--profile", profile, "--frames", "300", "--capture", capture],
    );

    assert_eq!(report["frames"], 300, "{report}");
    for name in ["headset", "state", "missed", "device"] {
        assert!(!report[name].is_null(), "{name} is missing in {report}");
    }
    for name in ["p50", "p95", "p99"] {
        assert!(report["frame_cpu_ms"][name].is_number(), "frame_cpu_ms.{name} is missing in {report}");
    }
    for name in ["p50", "p99"] {
        assert!(report["pose_age_ms"][name].is_number(), "pose_age_ms.{name} is missing in {report}");
    }

    // What the client located, and what was submitted with the pictures.
    let (submitted, compared, worst) = vergence_tests::disc::compare(&pictures, |_| -1.6);
    println!("the disc was {worst:.3} px at most from its projection in {compared} pictures");
    assert_eq!((frames.len(), submitted.len(), compared), (300, 300, 600));
    for frames in [&frames, &submitted] {
        let between = eyes_keep_their_offset(frames);
        assert!((between - 0.064).abs() <= TOLERANCE, "the eyes are {between} m apart");
    }
    let way: f64 = frames
        .windows(2)
        .map(|w| (0..3).map(|i| (w[1].head[i] - w[0].head[i]).powi(2)).sum::<f64>().sqrt())
        .sum();
    // In its first three seconds the rig is held almost still: the recorded path is 7 cm.
    assert!((0.05..0.1).contains(&way), "the head went {way} m, the recording 0.07 m");
}

/// The same with nothing around the disc and a user who looks around.
#[test]
fn a_disc_is_seen_where_the_geometry_of_each_eye_puts_it() {
    if !vulkan() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder for the run");
    let (scene, profile) = vergence_tests::disc::write(folder.path(), "", 45.0);
    let pictures = folder.path().join("pictures");
    let [profile, capture] = [&profile, &pictures].map(|path| path.to_str().expect("a path in UTF-8"));
    let knobs = ["--frames", "60", "--capture-every", "4", "--motion", "look-around", "--validate"];
    run(&scene, folder.path(), &[&knobs[..], &["--profile", profile, "--capture", capture]].concat());
    let (frames, compared, worst) = vergence_tests::disc::compare(&pictures, |_| -1.6);
    println!("the disc was {worst:.3} px at most from its projection in {compared} pictures");
    assert!(compared >= 8, "the disc was seen in {compared} pictures only");
    assert!(frames.iter().any(|f| (f.head[3] - frames[0].head[3]).abs() > 1e-3), "the head did not move");
    eyes_keep_their_offset(&frames);
}

/// A user of a metre and a quarter who turns, goes a step and is recentred.
const RECENTRED: &str = r#"
at-end = "stop"
duration = "3 s"
[[head]]
time = "0 s"
position = ["0 m", "1.25 m", "0 m"]
turned = { yaw = "0 deg", pitch = "5 deg" }
[[head]]
time = "200 ms"
position = ["0.3 m", "1.15 m", "-0.2 m"]
turned = { yaw = "20 deg", pitch = "10 deg" }
[[headset]]
time = "300 ms"
recentre = true
"#;

/// Shows the disc for 40 frames to the user of [`RECENTRED`], and compares.
fn recentred(faults: &[&str], floor_y_m: impl Fn(usize) -> f64) -> Vec<Located> {
    let folder = tempfile::tempdir().expect("a folder for the run");
    let (scene, profile) = vergence_tests::disc::write(folder.path(), "", 45.0);
    let (motion, pictures) = (folder.path().join("recentred.toml"), folder.path().join("pictures"));
    std::fs::write(&motion, RECENTRED).expect("the test's own folder is writable");
    let [profile, motion, capture] =
        [&profile, &motion, &pictures].map(|path| path.to_str().expect("a path in UTF-8"));
    let mut knobs = vec!["--frames", "40", "--profile", profile, "--motion", motion, "--capture", capture];
    faults.iter().for_each(|fault| knobs.extend(["--fault", fault]));
    run(&scene, folder.path(), &knobs);
    let (frames, compared, worst) = vergence_tests::disc::compare(&pictures, floor_y_m);
    println!("the disc was {worst:.3} px at most from its projection in {compared} pictures");
    assert_eq!(compared, 80);
    frames
}

/// The frame from which on LOCAL's origin is where the user was recentred.
const RECENTRED_AT: usize = 27;

#[test]
fn the_scene_follows_a_user_who_is_recentred_late() {
    if !vulkan() {
        return;
    }
    let frames = recentred(&[], |frame| if frame < RECENTRED_AT { -1.25 } else { -1.15 });
    // In the new LOCAL the head is at its origin, and looks ahead.
    let head = frames[RECENTRED_AT].head;
    assert!(head[..3].iter().all(|x| x.abs() < 1e-6) && head[4].abs() < 1e-6, "{head:?}");
    assert!(frames[RECENTRED_AT - 1].head[0] > 0.2, "{:?}", frames[RECENTRED_AT - 1].head);
}

/// While no floor is located the eyes are taken to be 1.6 m above it; once one is, the user stands on that.
#[test]
fn a_floor_that_is_known_late_is_stood_on_from_then() {
    if !vulkan() {
        return;
    }
    // In each frame the floor and the head are asked for until the floor is known.
    const UNKNOWN: usize = 15;
    recentred(&["xrLocateSpace=NAN_POSE@1-30"], |frame| match frame {
        0..UNKNOWN => -1.6,
        UNKNOWN..RECENTRED_AT => -1.25,
        _ => -1.15,
    });
    // A runtime that has no floor to offer.
    recentred(&["xrEnumerateReferenceSpaces=NOTHING"], |_| -1.6);
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

/// What a shell's `ulimit -f` does is a full disk to the recording, and nothing to the session.
#[test]
fn a_recording_that_may_not_grow_takes_nothing_from_the_session() {
    let Some(data) = vergence_tests::data() else { return };
    if !vulkan() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let output = Command::new("bash")
        .args(["-c", "ulimit -f 8; exec \"$0\" \"$@\""])
        .arg(vergence_tests::vergence())
        .args(["run".as_ref(), data.join("scenes/gltf/Box.glb").as_os_str()])
        .args(["--headset", "simulated", "--frames", "40", "--msaa", "1", "--json", "--record"])
        .arg(folder.path().join("s.mcap"))
        .output()
        .expect("bash is there");
    assert_eq!(output.status.code(), Some(1), "{}", told(&output));
    let report = vergence_tests::last_object(&String::from_utf8_lossy(&output.stdout)).expect("one object");
    assert_eq!(report["frames"], 40, "{report}");
    assert!(report["recording"]["error"].as_str().is_some_and(|error| error.contains("s.mcap")), "{report}");
}

#[test]
fn who_has_read_enough_is_not_told_of_a_panic() {
    let mut plan = Command::new(vergence_tests::vergence())
        .args(["plan".as_ref(), sample().as_os_str()])
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .expect("the vergence binary starts");
    // Nobody reads, as behind `| head` once it has its lines.
    drop(plan.stdout.take());
    let ended = plan.wait_with_output().expect("it ends");
    assert_eq!(ended.status.code(), Some(141), "{}", told(&ended));
    assert!(ended.stderr.is_empty(), "{}", told(&ended));
}

#[test]
fn a_full_disk_behind_what_is_printed_is_one_sentence() {
    let Ok(full) = std::fs::OpenOptions::new().write(true).open("/dev/full") else {
        println!("skipped: no /dev/full");
        return;
    };
    let ended = Command::new(vergence_tests::vergence())
        .args(["plan".as_ref(), sample().as_os_str()])
        .stdout(full)
        .output()
        .expect("the vergence binary starts");
    assert_eq!(ended.status.code(), Some(1), "{}", told(&ended));
    let said = String::from_utf8_lossy(&ended.stderr);
    assert!(said.lines().count() == 1 && said.starts_with("vergence: printing failed: stdout"), "{said}");
}

#[test]
fn a_recording_is_not_written_over_by_mistake() {
    let folder = tempfile::tempdir().expect("a folder");
    let (log, kept) = (folder.path().join("kept.mcap"), b"somebody's hour");
    std::fs::write(&log, kept).expect("a file");
    let table = folder.path().join("t.csv");
    std::fs::write(&table, "t_s,x\n0,1\n").expect("a file");
    let log = log.to_str().expect("a path in UTF-8");
    let room = sample();
    let calls: [Vec<&str>; 3] = [
        vec!["record", log, "--device", "serial:/dev/no-such-port"],
        vec!["run", room.to_str().expect("a path in UTF-8"), "--headset", "simulated", "--record", log],
        vec!["log", "import", "csv", table.to_str().expect("a path in UTF-8"), "-o", log],
    ];
    for call in calls {
        let ended = Command::new(vergence_tests::vergence())
            .args(&call)
            .output()
            .expect("the vergence binary starts");
        assert_eq!(ended.status.code(), Some(2), "{call:?}: {}", told(&ended));
        assert!(
            String::from_utf8_lossy(&ended.stderr).contains("--overwrite replaces it"),
            "{}",
            told(&ended)
        );
        assert_eq!(std::fs::read(log).expect("it is there"), kept, "{call:?}");
    }
    let ended = Command::new(vergence_tests::vergence())
        .args(["log", "import", "csv", table.to_str().expect("a path in UTF-8"), "--overwrite", "-o", log])
        .output()
        .expect("the vergence binary starts");
    assert_eq!(ended.status.code(), Some(0), "{}", told(&ended));
    assert_ne!(std::fs::read(log).expect("it is there"), kept);
}

/// The manifest of our runtime, for the system's loader; `None`, and the test says that it is skipped, without a loader.
fn runtime() -> Option<String> {
    let loader = Command::new("hello_xr").stdin(std::process::Stdio::null()).output();
    if loader.is_err() {
        vergence_tests::skip("openxr", "hello_xr, package libopenxr-utils, is missing");
        return None;
    }
    let built =
        Command::new(vergence_tests::checkout().join("tools/xr-runtime")).output().expect("bash is there");
    assert!(built.status.success(), "{}", told(&built));
    Some(String::from_utf8(built.stdout).expect("a path").trim().to_owned())
}

/// What `tools/run` asks for, where a real runtime is found: ours, opened by the system's loader.
#[test]
fn a_real_headset_does_without_the_motion_of_the_simulated_one() {
    if !vulkan() {
        return;
    }
    let Some(manifest) = runtime() else { return };
    let run = |headset: &str| {
        Command::new(vergence_tests::vergence())
            .args(["run".as_ref(), sample().as_os_str()])
            .args(["--headset", headset, "--motion", "look-around.toml", "--frames", "3"])
            .env("XR_RUNTIME_JSON", &manifest)
            .env("VERGENCE_XR_CLOCK", "virtual")
            .output()
            .expect("the vergence binary starts")
    };
    let auto = run("auto");
    assert_eq!(auto.status.code(), Some(0), "{}", told(&auto));
    assert!(told(&auto).contains("openxr: "), "not the real one: {}", told(&auto));
    assert_eq!(
        told(&auto).matches("--motion look-around.toml is for the simulated headset").count(),
        1,
        "{}",
        told(&auto)
    );
    let asked = run("openxr");
    assert_eq!(asked.status.code(), Some(2), "{}", told(&asked));
}

/// Our odometry moves the simulated headset; beside a real one it is kept and compared. Here the real one is ours, opened by
/// the system's loader and moved by the same odometry, so that the two differ by what is predicted from frame to frame.
#[test]
fn odometry_moves_the_simulated_headset_and_is_compared_with_a_real_one() {
    let Some(data) = vergence_tests::data() else { return };
    if !vulkan() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let motion = format!("slam:{}", data.join("slam/half_real_v101_14s").display());
    let run = |headset: &str, log: &str, manifest: &str| {
        let output = Command::new(vergence_tests::vergence())
            .args(["run".as_ref(), data.join("scenes/gltf/Box.glb").as_os_str()])
            .args(["--headset", headset, "--motion", &motion, "--frames", "40", "--json", "--record"])
            .arg(folder.path().join(log))
            .env("XR_RUNTIME_JSON", manifest)
            .env("VERGENCE_XR_MOTION", &motion)
            .output()
            .expect("the vergence binary starts");
        assert!(output.status.success(), "{}", told(&output));
        vergence_tests::last_object(&String::from_utf8_lossy(&output.stdout)).expect("one object")
    };
    let simulated = run("simulated", "simulated.mcap", "");
    assert_eq!(simulated["frames"].as_u64(), Some(40));
    let followed = &simulated["odometry"];
    assert_eq!(
        (followed["frames"].as_u64(), followed["compared"].as_u64()),
        (Some(280), Some(0)),
        "{simulated}"
    );
    assert!(
        followed["frames_by_state"]["tracked"].as_u64() > Some(250) && followed["says"] == "tracked",
        "{simulated}"
    );
    let notices = simulated["notices"].to_string();
    assert!(notices.contains("the motion ends after 13.95 s, and the session with it"), "{notices}");

    let Some(manifest) = runtime() else { return };
    let real = run("openxr", "real.mcap", &manifest);
    let beside = &real["odometry"];
    assert_eq!(beside["mode"], "stereo-inertial", "{real}");
    assert!(beside["frames"].as_u64() > Some(0), "{real}");
    let most = |name: &str, most: f64| beside[name].as_f64().is_some_and(|found| found < most);
    assert!(most("position_rms_m", 0.05) && most("rotation_rms_deg", 3.0), "{real}");
    let info = vergence(arguments!["log", "info", &folder.path().join("real.mcap"), "--json"]);
    let info = vergence_tests::last_object(&String::from_utf8_lossy(&info.stdout)).expect("one object");
    let streams = info["streams"].as_array().expect("streams");
    let kept = streams.iter().find(|stream| stream["name"] == "/odometry/head").expect("it is kept");
    assert!(
        beside["compared"].as_u64() > Some(0) && kept["count"].as_u64() >= beside["compared"].as_u64(),
        "{real}"
    );
}

/// Outputs that name an input are refused by every verb that would write over it.
#[test]
fn what_is_read_is_not_written_over() {
    let folder = tempfile::tempdir().expect("a folder for the inputs");
    let table = folder.path().join("unit.csv");
    std::fs::write(&table, "t_s,gyr_x,gyr_y,gyr_z,acc_x,acc_y,acc_z\n0,0,0,0,0,0,9.81\n").expect("written");
    let before = std::fs::read(&table).expect("read");
    let scene = folder.path().join("scene.obj");
    std::fs::write(&scene, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").expect("written");
    // The same file under a name that pictures may have.
    let picture = folder.path().join("picture.png");
    std::fs::hard_link(&scene, &picture).expect("linked");
    let quality = folder.path().join("quality.toml");
    std::fs::write(&quality, "[quality]\nmsaa = 1\n").expect("written");
    let calls: [&[&std::ffi::OsStr]; 9] = [
        arguments!["imu", "run", &table, "--axes", "6", "--out", &table],
        arguments!["imu", "calibrate", &table, "--out", &table],
        arguments!["slam", "eval", &table, &scene, "--output", &table],
        arguments!["study", "report", &table, "--output", &table],
        arguments!["study", "import", "csv", &table, "--output", &table],
        arguments!["render", &scene, "-o", &picture],
        arguments!["run", &scene, "--headset", "simulated", "--log-poses", &scene],
        arguments!["run", &scene, "--headset", "simulated", "--quality", &quality, "--record", &quality],
        arguments!["record", &table, "--config", &table],
    ];
    for call in calls {
        let refused = vergence(call);
        assert_eq!(refused.status.code(), Some(2), "{call:?}: {}", told(&refused));
        assert!(told(&refused).contains("expected a file of its own"), "{call:?}: {}", told(&refused));
    }
    assert_eq!(std::fs::read(&table).expect("still there"), before);
    assert!(std::fs::read_to_string(&scene).expect("still there").starts_with("v 0 0 0"));
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
