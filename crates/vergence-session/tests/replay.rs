//! A session is recorded, and lived through again: the same in every bit, or it is said where not.

#![allow(unsafe_code, reason = "an allocator that counts is an unsafe trait")]
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod stage;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::path::PathBuf;
use std::sync::Arc;

use stage::has_vulkan;
use vergence_geom::{Affine, Rigid};
use vergence_scene::Scene;
use vergence_scene::model::{Local, Material, Mesh, Node, Primitive, Shading, Touchable};
use vergence_session::{
    Fault, FaultPlan, Happening, HeadsetChoice, RecordConfig, ReplayConfig, ReplayReport, RunConfig,
    SessionLog, replay, run,
};

struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

// SAFETY: every call goes to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let _ = ALLOCATIONS.try_with(|n| n.set(n.get() + 1));
        // SAFETY: as the caller's.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as the caller's.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

/// A triangle that can be touched, ahead of the user.
fn triangle() -> Arc<Scene> {
    let node = Node {
        name: "triangle".into(),
        parent: None,
        parent_from_node: Local::Matrix(Affine::from(Rigid::translation(0.0, 1.6, -1.5))),
        mesh: Some(0),
        skin: None,
        light: None,
        camera: None,
        label: None,
    };
    let primitive = Primitive {
        positions: vec![[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.0, 0.5, 0.0]],
        normals: vec![[0.0, 0.0, 1.0]; 3],
        indices: vec![0, 1, 2],
        ..Primitive::default()
    };
    Arc::new(Scene {
        name: "triangle".into(),
        nodes: vec![node],
        meshes: vec![Mesh { name: "triangle".into(), primitives: vec![primitive] }],
        materials: vec![Material { shading: Shading::Unlit, ..Material::default() }],
        world_from_start: Some(Rigid::identity()),
        touchables: vec![Touchable { name: "triangle".into(), node: 0 }],
        ..Scene::default()
    })
}

/// What the user does in so many milliseconds: everything that there is.
fn script(ms: u32, headset: &str) -> String {
    format!(
        r#"
        at-end = "stop"
        duration = "{ms} ms"
        [[head]]
        time = "0 s"
        position = ["0 m", "1.6 m", "0 m"]
        turned = {{ yaw = "-20 deg" }}
        [[head]]
        time = "{ms} ms"
        position = ["0.1 m", "1.5 m", "-0.2 m"]
        turned = {{ yaw = "25 deg", pitch = "-10 deg", roll = "3 deg" }}
        [[right]]
        time = "0 s"
        position = ["0.2 m", "1.4 m", "-0.3 m"]
        turned = {{ pitch = "40 deg" }}
        trigger = 0.0
        squeeze = 0.0
        [[right]]
        time = "100 ms"
        trigger = 0.9
        squeeze = 0.3
        primary = true
        [[right]]
        time = "200 ms"
        trigger = 0.1
        tracking = "held"
        [[left]]
        time = "50 ms"
        stick = [0.1, -1.0]
        menu = true
        [[left]]
        time = "250 ms"
        stick = [0.7, 0.2]
        [[right-hand]]
        time = "0 s"
        position = ["0.2 m", "1.4 m", "-0.3 m"]
        curl = 0.1
        [[right-hand]]
        time = "220 ms"
        position = ["0.1 m", "1.3 m", "-0.3 m"]
        curl = [0.9, 0.0, 0.8, 0.8, 1.0]
        [[right-hand]]
        time = "240 ms"
        tracking = "lost"
        [[gaze]]
        time = "0 s"
        turned = {{ yaw = "15 deg" }}
        [[gaze]]
        time = "230 ms"
        turned = {{ yaw = "-10 deg", pitch = "5 deg" }}
        {headset}
        "#
    )
}

struct Bench {
    folder: tempfile::TempDir,
    log: PathBuf,
}

impl Bench {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let log = folder.path().join("session.mcap");
        Self { folder, log }
    }

    fn config(&self, script: &str) -> RunConfig {
        let (profile, motion) =
            (self.folder.path().join("small.toml"), self.folder.path().join("script.toml"));
        let text = r#"
            name = "small"
            resolution = [64, 60]
            rates = ["90 Hz"]
            ipd = "64 mm"
            [left]
            fov = { left = "-48 deg", right = "42 deg", up = "44 deg", down = "-46 deg" }
        "#;
        std::fs::write(&profile, text).unwrap();
        std::fs::write(&motion, script).unwrap();
        RunConfig {
            headset: HeadsetChoice::Simulated,
            profile: Some(profile.to_str().unwrap().to_owned()),
            motion: Some(motion.to_str().unwrap().to_owned()),
            quality: vergence_render::Quality { msaa: 1, timestamps: false, ..Default::default() },
            hand_joints: true,
            eye_gaze: true,
            record: Some(RecordConfig {
                path: self.log.clone(),
                durable: false,
                hash_frames: None,
                attach_scene: false,
            }),
            ..RunConfig::default()
        }
    }

    fn replay(&self, speed: Option<f64>) -> ReplayReport {
        let log = SessionLog::open(&self.log).unwrap();
        let config = ReplayConfig { verify: true, speed, ..ReplayConfig::default() };
        replay(&log, &triangle(), &config, &mut |_| {}).unwrap()
    }
}

fn assert_equal(report: &ReplayReport, frames: u64) {
    let c = &report.comparison;
    assert_eq!(c.first_difference, None);
    assert_eq!((c.frames, c.frames_equal), (frames, frames));
    assert_eq!(c.events, c.events_equal);
    assert!(c.events >= 7, "{} events", c.events);
    assert!(report.complete && report.damage.is_none());
}

/// How many messages each stream has.
fn kinds(log: &std::path::Path) -> std::collections::BTreeMap<String, usize> {
    let mut reader = vergence_log::Reader::open(log).unwrap();
    let mut counts = std::collections::BTreeMap::new();
    while let Some(entry) = reader.next().unwrap() {
        *counts.entry(entry.stream.name.clone()).or_default() += 1;
    }
    counts
}

#[test]
fn a_whole_session_is_lived_through_again() {
    if !has_vulkan() {
        return;
    }
    let bench = Bench::new();
    let headset = r#"
        [[headset]]
        time = "150 ms"
        recentre = true
        [[headset]]
        time = "300 ms"
        presence = "hidden"
        [[headset]]
        time = "350 ms"
        presence = "away"
        [[headset]]
        time = "450 ms"
        presence = "focused"
    "#;
    let report = run(&triangle(), &bench.config(&script(600, headset)), &mut |_| {}).unwrap();
    let recording = report.recording.as_ref().unwrap();
    assert_eq!((recording.dropped, recording.error.as_ref()), (0, None));
    assert!(report.frames > 20 && report.paced > report.frames);
    assert!(report.touches.iter().any(|touch| touch.what == "pointed"), "{:?}", report.touches);

    // Everything that a session says is in it: hands that are seen and not, the gaze, controls of every kind, pulses.
    let kinds = kinds(&bench.log);
    for stream in [
        "/hand/left/joints",
        "/hand/right/joints",
        "/gaze",
        "/action/aim/right",
        "/action/select/right",
        "/action/grab/right",
        "/action/move/left",
        "/action/menu/left",
        "/action/pulse/right",
    ] {
        assert!(kinds.get(stream).is_some_and(|count| *count > 3), "{stream}: {kinds:?}");
    }

    let again = bench.replay(None);
    assert_equal(&again, report.paced);
    let c = &again.comparison;
    assert_eq!(
        (c.images_not_compared.as_ref(), c.images, c.images_equal),
        (None, 2 * report.frames, c.images)
    );
    assert_eq!((again.run.frames, &again.run.states), (report.frames, &report.states));
    assert_eq!(again.run.touches, report.touches);
    // At the speed of the recording it takes as long as that did: 0.6 s less the time off the head.
    let slow = bench.replay(Some(1.0));
    assert_equal(&slow, report.paced);
    assert!(slow.host_seconds >= 0.5, "{} s", slow.host_seconds);

    // What the user did moves another headset, in another scene, as well: the head's way is the same.
    let poses = |name: &str| bench.folder.path().join(name);
    let other = RunConfig {
        motion: Some(bench.log.to_str().unwrap().to_owned()),
        log_poses: Some(poses("other.jsonl")),
        record: None,
        ..bench.config(&script(600, headset))
    };
    let moved = run(&Arc::new(Scene::default()), &other, &mut |_| {}).unwrap();
    assert!(moved.frames > 20 && std::fs::read_to_string(poses("other.jsonl")).unwrap().lines().count() > 20);

    // A live headset has a clock of its own.
    let log = SessionLog::open(&bench.log).unwrap();
    let live = ReplayConfig { headset: HeadsetChoice::OpenXr, ..ReplayConfig::default() };
    let refused = replay(&log, &triangle(), &live, &mut |_| {}).unwrap_err();
    assert!(refused.is_wrong_call() && refused.to_string().contains("wall clock"), "{refused}");
}

/// Where the application leaves is part of the recording, whatever its session was doing: the headset lies on the table, or
/// the runtime does not answer the farewell.
#[test]
fn leaving_without_the_runtime_is_replayed() {
    if !has_vulkan() {
        return;
    }
    let bench = Bench::new();
    let away = "[[headset]]\ntime = \"100 ms\"\npresence = \"away\"";
    let config = RunConfig { ..bench.config(&script(60_000, away)) };
    let stop = config.stop.clone();
    let report = run(&triangle(), &config, &mut |happening| {
        if matches!(happening, Happening::Said(said) if said.contains("nobody wears")) {
            stop.stop();
        }
    });
    let report = report.unwrap();
    assert!(report.frames > 3 && report.state == "exiting", "{report:?}");
    assert_equal(&bench.replay(None), report.paced);

    let silent = RunConfig {
        frames: Some(5),
        faults: FaultPlan::new(vec![Fault::parse("xrPollEvent=EVENT_UNAVAILABLE@14+").unwrap()]),
        ..bench.config(&script(60_000, ""))
    };
    let report = run(&triangle(), &silent, &mut |_| {}).unwrap();
    assert!(report.notices.iter().any(|said| said.contains("did not end the session in time")), "{report:?}");
    assert_equal(&bench.replay(None), report.paced);
}

/// Where the runtime's clock cannot be read, what passed is the host's time: a replay goes by what was taken then.
#[test]
fn times_that_the_host_measured_are_replayed() {
    if !has_vulkan() {
        return;
    }
    let bench = Bench::new();
    let faults = ["xrConvertTimespecTimeToTimeKHR=ERROR_RUNTIME_FAILURE", "xrWaitFrame=TIME_NEGATIVE@12-15"];
    let config = RunConfig {
        frames: Some(30),
        faults: FaultPlan::new(faults.iter().map(|fault| Fault::parse(fault).unwrap())),
        ..bench.config(&script(60_000, ""))
    };
    // Each frame takes its time, so that what is taken is no whole number of periods.
    let mut slow = |happening: Happening<'_>| {
        if let Happening::Frame { .. } = happening {
            std::thread::sleep(std::time::Duration::from_millis(15));
        }
    };
    let report = run(&triangle(), &config, &mut slow).unwrap();
    assert!(report.notices.iter().any(|said| said.contains("predicted display time")), "{report:?}");
    assert_equal(&bench.replay(None), report.paced);
}

/// The headset is taken off between waiting for a frame and beginning it, which had failed.
#[test]
fn a_frame_that_was_waited_for_when_the_session_stopped_is_replayed() {
    if !has_vulkan() {
        return;
    }
    let bench = Bench::new();
    let away = "[[headset]]\ntime = \"100 ms\"\npresence = \"away\"\n[[headset]]\ntime = \"300 ms\"\npresence = \"focused\"";
    for call in 1..20 {
        let fault = format!("xrBeginFrame=ERROR_RUNTIME_FAILURE@{call}");
        let config = RunConfig {
            faults: FaultPlan::new(vec![Fault::parse(&fault).unwrap()]),
            ..bench.config(&script(500, away))
        };
        run(&triangle(), &config, &mut |_| {}).unwrap();
        let again = bench.replay(None);
        let c = &again.comparison;
        assert_eq!((c.first_difference.as_ref(), c.frames), (None, c.frames_equal), "{fault}");
    }
}

/// A recording that is cut off anywhere is replayed as far as it goes; what is there is equal.
#[test]
fn a_recording_that_was_cut_off_goes_as_far_as_it_goes() {
    if !has_vulkan() {
        return;
    }
    let bench = Bench::new();
    let undrawn = "[[headset]]\ntime = \"0 s\"\nrender = false";
    // Long enough for more than two chunks of a mebibyte, however fast the machine is.
    let config = bench.config(&script(8000, undrawn));
    run(&triangle(), &config, &mut |_| {}).unwrap();
    let whole = std::fs::read(&bench.log).unwrap();
    // From the first byte behind what makes it a log of a session, a chunk that is not whole: no frame is left.
    let mut opened = 0;
    for part in [0.1, 0.2, 0.3, 0.5, 0.9] {
        std::fs::write(&bench.log, &whole[..(whole.len() as f64 * part) as usize]).unwrap();
        let Ok(log) = SessionLog::open(&bench.log) else { continue };
        let config = ReplayConfig { verify: true, ..ReplayConfig::default() };
        let report = match replay(&log, &triangle(), &config, &mut |_| {}) {
            Ok(report) => report,
            Err(error) => {
                assert!(error.to_string().contains("without a whole frame"), "{part}: {error}");
                continue;
            }
        };
        opened += 1;
        assert!(!report.complete, "{part}");
        let c = &report.comparison;
        assert_eq!((c.first_difference.as_ref(), c.frames), (None, c.frames_equal), "{part}");
        assert_eq!(report.run.state, "exiting", "{part}");
    }
    assert!(opened >= 2, "{opened} of 5 opened");

    // A recording does not write over what it reads.
    let onto_itself = RunConfig { motion: Some(bench.log.to_str().unwrap().to_owned()), ..config };
    let refused = run(&triangle(), &onto_itself, &mut |_| {}).unwrap_err();
    assert!(refused.is_wrong_call() && refused.to_string().contains("a file of its own"), "{refused}");
}

/// So many replays as `VERGENCE_REPLAYS` says, by default fewer than a release asks for: nothing is drawn.
#[test]
fn thirty_frames_over_and_over() {
    if !has_vulkan() {
        return;
    }
    let bench = Bench::new();
    let undrawn = "[[headset]]\ntime = \"0 s\"\nrender = false";
    let report = run(&triangle(), &bench.config(&script(323, undrawn)), &mut |_| {}).unwrap();
    assert_eq!((report.frames, report.paced), (0, 30));
    let times = std::env::var("VERGENCE_REPLAYS").ok().and_then(|n| n.parse().ok()).unwrap_or(30);
    let began = std::time::Instant::now();
    for _ in 0..times {
        assert_equal(&bench.replay(None), 30);
    }
    println!("{times} replays of 30 frames: equal, {:.1} s", began.elapsed().as_secs_f64());
}

/// While the runtime wants no pictures none is missed, and the time until it wants them again is nobody's.
#[test]
fn frames_that_nobody_looks_at_are_not_missed() {
    if !has_vulkan() {
        return;
    }
    let bench = Bench::new();
    let hidden = "[[headset]]\ntime = \"0 s\"\nrender = true\n[[headset]]\ntime = \"100 ms\"\nrender = false\n\
                  [[headset]]\ntime = \"200 ms\"\nrender = true";
    let config = RunConfig { record: None, ..bench.config(&script(300, hidden)) };
    let report = run(&triangle(), &config, &mut |_| {}).unwrap();
    assert!(report.frames > 10 && report.paced >= report.frames + 8, "{report:?}");
    assert_eq!(report.missed, 0);
    assert!(report.seconds < 0.25, "{} s", report.seconds);
}

/// A recording that cannot be made is said once, and the session goes on.
#[test]
fn a_path_that_cannot_be_written_takes_nothing_from_the_session() {
    if !has_vulkan() {
        return;
    }
    for path in ["/proc/no-such-folder/session.mcap", "/dev/full"] {
        let bench = Bench::new();
        let mut config = bench.config(&script(400, ""));
        config.record.as_mut().unwrap().path = path.into();
        let mut said = Vec::new();
        let report = run(&triangle(), &config, &mut |happening| {
            if let Happening::Said(sentence) = happening {
                said.push(sentence.to_owned());
            }
        })
        .unwrap();
        assert!(report.frames > 30, "{path}");
        let error = report.recording.unwrap().error.unwrap();
        assert_eq!(said.iter().filter(|sentence| sentence.contains(path)).count(), 1, "{said:?}");
        assert!(error.contains(path), "{error}");
    }
}

/// After the first second, recording allocates nothing on the frame's thread: frames allocate as they do without it.
#[test]
fn recording_allocates_nothing_per_frame() {
    if !has_vulkan() {
        return;
    }
    let bench = Bench::new();
    let mut config = bench.config(&script(3000, ""));
    let count = |config: &RunConfig| {
        let (mut before, mut all, mut frames) = (0, 0, 0u64);
        let report = run(&triangle(), config, &mut |happening| {
            let now = ALLOCATIONS.get();
            if let Happening::Frame { shown: 100.., .. } = happening {
                all += now - before;
                frames += 1;
            }
            before = now;
        });
        (all, frames, report.unwrap())
    };
    let (recorded, frames, report) = count(&config);
    assert!(frames > 100);
    let cost = report.recording.unwrap();
    println!("recording: p50 {:.1}, p95 {:.1} us per frame", cost.frame_us.p50, cost.frame_us.p95);
    config.record = None;
    let (plain, plain_frames, _) = count(&config);
    assert_eq!(frames, plain_frames);
    println!("{recorded} allocations in {frames} frames with a recording, {plain} without");
    assert_eq!(recorded, plain, "allocations in {frames} frames, with and without a recording");
}
