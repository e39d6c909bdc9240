//! Whatever the runtime does, at whichever call: no panic, no hang, and a typed end that the table below says.
//!
//! Every entry point that the client calls, with every result that the registry documents for it and every bad value, at its
//! first, its second and a late call. A whole run each: scene, device, session, a dozen frames. Which cells were reached,
//! which not, and which passed is printed.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod stage;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, mpsc};
use std::time::{Duration, Instant};

use stage::has_vulkan;
use vergence_geom::{Affine, Rigid};
use vergence_scene::Scene;
use vergence_scene::model::{Local, Material, Mesh, Node, Primitive, Shading, Touchable};
use vergence_session::{
    Error, Fault, FaultPlan, HeadsetChoice, RecordConfig, ReplayConfig, RunConfig, SessionLog, replay, run,
};
use vergence_xr::State;
use vergence_xr_sim::fault;

/// Frames of a run.
const FRAMES: u64 = 12;
/// A cell that takes longer hangs.
const WATCHDOG: Duration = Duration::from_secs(10);
/// For `HANG`: how long the client itself waits.
const HANG_S: f64 = 0.5;
/// Runs at a time: Vulkan's loader lets one instance or device come or go after the other.
const WORKERS: usize = 2;

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum End {
    /// All frames were shown, in one session.
    On,
    /// All frames were shown, after a new session or instance.
    Anew,
    /// No headset that can be used.
    Flat,
    /// A runtime or headset may come.
    Waiting,
    /// Given up.
    Lost,
}

/// The table: how a run ends after a fault.
fn expected(entry_point: &str, what: &str, call: u64) -> End {
    let lost = matches!(what, "ERROR_SESSION_LOST" | "ERROR_INSTANCE_LOST" | "ERROR_RUNTIME_UNAVAILABLE");
    let refusal = what.ends_with("_UNSUPPORTED") || what.ends_with("_NOT_PRESENT");
    let is_error = what.starts_with("ERROR_");
    if what == "HANG" {
        return End::Lost;
    }
    match entry_point {
        // OpenXR 1.1 is asked for first, then 1.0.
        "xrCreateInstance" if what == "ERROR_API_VERSION_UNSUPPORTED" && call == 1 => End::On,
        // Whoever lacks one of these functions is no runtime.
        "xrGetInstanceProcAddr" | "xrCreateInstance" if is_error => End::Waiting,
        "xrEnumerateInstanceExtensionProperties" => match what {
            "ERROR_SIZE_INSUFFICIENT" | "COUNT_GROWS" | "COUNT_SHRINKS" => End::On,
            "NOTHING" => End::Flat,
            _ => End::Waiting,
        },
        "xrGetSystem" if what.starts_with("ERROR_FORM_FACTOR") => End::Waiting,
        // What is only asked for people, or to save time, is not missed.
        "xrGetCurrentInteractionProfile"
        | "xrPathToString"
        | "xrGetDisplayRefreshRateFB"
        | "xrConvertTimespecTimeToTimeKHR" => End::On,
        "xrGetVisibilityMaskKHR" | "xrSuggestInteractionProfileBindings" if !lost => End::On,
        // After the first call only whether hands and gaze are seen is asked; what is lost shows in the next call.
        "xrGetSystemProperties" if call > 1 => End::On,
        // A session without hands is one.
        "xrCreateHandTrackerEXT" if refusal => End::On,
        // Nothing can be done about what is taken down.
        name if name.starts_with("xrDestroy") => End::On,
        "xrEndSession" | "xrRequestExitSession" => End::On,
        _ if lost => End::Anew,
        // A shorter list than the headset's is a headset that cannot be used.
        // One less than one is none.
        "xrEnumerateViewConfigurations" if matches!(what, "NOTHING" | "COUNT_SHRINKS") => End::Flat,
        "xrEnumerateViewConfigurationViews"
            if what == "NOTHING" || (what == "COUNT_SHRINKS" && call == 2) =>
        {
            End::Flat
        }
        "xrEnumerateSwapchainFormats" | "xrEnumerateSwapchainImages" if what == "NOTHING" => End::Flat,
        // An image is handed out that is not in the list.
        "xrEnumerateSwapchainImages" if what == "COUNT_SHRINKS" && call.is_multiple_of(2) => End::Anew,
        _ if !is_error || what == "ERROR_SIZE_INSUFFICIENT" => End::On,
        // A frame in which something fails is left out.
        "xrPollEvent"
        | "xrWaitFrame"
        | "xrBeginFrame"
        | "xrEndFrame"
        | "xrLocateViews"
        | "xrLocateSpace"
        | "xrLocateHandJointsEXT"
        | "xrAcquireSwapchainImage"
        | "xrWaitSwapchainImage"
        | "xrReleaseSwapchainImage"
        | "xrSyncActions"
        | "xrGetActionStateBoolean"
        | "xrGetActionStateFloat"
        | "xrGetActionStateVector2f"
        | "xrGetActionStatePose"
        | "xrApplyHapticFeedback"
        | "xrStopHapticFeedback" => End::On,
        // A path that is only suggested may be unknown to the runtime; those of the hands may not.
        "xrStringToPath" if call > 2 => End::On,
        // What the runtime says that it never does is not asked for again; what failed is.
        _ if refusal => End::Flat,
        _ => End::Anew,
    }
}

/// A floor that the hands point at, so that they feel something.
fn floor() -> Arc<Scene> {
    let corners = [[-9.0, 0.0, -9.0], [-9.0, 0.0, 9.0], [9.0, 0.0, 9.0], [9.0, 0.0, -9.0]];
    let primitive = Primitive {
        positions: corners.to_vec(),
        normals: vec![[0.0, 1.0, 0.0]; 4],
        indices: vec![0, 1, 2, 0, 2, 3],
        ..Primitive::default()
    };
    Arc::new(Scene {
        name: "floor".into(),
        nodes: vec![Node {
            name: "floor".into(),
            parent: None,
            parent_from_node: Local::Matrix(Affine::from(Rigid::identity())),
            mesh: Some(0),
            skin: None,
            light: None,
            camera: None,
            label: None,
        }],
        meshes: vec![Mesh { name: "floor".into(), primitives: vec![primitive] }],
        materials: vec![Material { shading: Shading::Unlit, ..Material::default() }],
        world_from_start: Some(Rigid::identity()),
        touchables: vec![Touchable { name: "floor".into(), node: 0 }],
        ..Scene::default()
    })
}

/// The smallest headset; beside it, what its user does: what lies still is no hand that points, so it pulls the trigger.
fn profile(folder: &std::path::Path) -> PathBuf {
    let pull = |ms: u32, pull: f32| format!("[[right]]\ntime = \"{ms} ms\"\ntrigger = {pull:.1}\n");
    let pulls = [(0, 0.0), (20, 0.9), (40, 0.0), (60, 0.9), (80, 0.0), (100, 0.9)];
    let user = pulls.map(|(ms, to)| pull(ms, to)).concat();
    std::fs::write(folder.join("user.toml"), format!("at-end = \"hold\"\nduration = \"1 s\"\n{user}"))
        .unwrap();
    let path = folder.join("tiny.toml");
    let text = "name = \"tiny\"\nresolution = [8, 8]\nrates = [\"90 Hz\"]\nipd = \"63 mm\"\n[left]\n\
                fov = { left = \"-45 deg\", right = \"45 deg\", up = \"45 deg\", down = \"-45 deg\" }\n";
    std::fs::write(&path, text).unwrap();
    path
}

fn config(profile: &std::path::Path, faults: FaultPlan, hang_s: f64) -> RunConfig {
    RunConfig {
        headset: HeadsetChoice::Simulated,
        profile: Some(profile.to_str().unwrap().to_owned()),
        motion: Some(profile.with_file_name("user.toml").to_str().unwrap().to_owned()),
        frames: Some(FRAMES),
        hand_joints: true,
        eye_gaze: true,
        quality: vergence_render::Quality { msaa: 1, ..Default::default() },
        faults,
        hang_s,
        ..RunConfig::default()
    }
}

#[derive(Clone, Debug)]
struct Cell {
    entry_point: &'static str,
    what: String,
    call: u64,
}

impl std::fmt::Display for Cell {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}={}@{}", self.entry_point, self.what, self.call)
    }
}

/// Everything that can be done to the entry points that a run calls so often.
fn all_cells(calls: &BTreeMap<&'static str, u64>) -> Vec<Cell> {
    let mut cells = Vec::new();
    for (&entry_point, &count) in calls {
        let late = (count * 6 / 10).max(3);
        let mut what = fault::documented(entry_point);
        what.extend(fault::bad_values(entry_point));
        if entry_point == "xrWaitFrame" {
            what.push("HANG".into());
        }
        for what in what {
            for call in [1, 2, late] {
                cells.push(Cell { entry_point, what: what.clone(), call });
            }
        }
    }
    cells
}

#[derive(Debug)]
enum Outcome {
    Unreached,
    Ended(End, String),
    Wrong(String),
    Hung,
}

/// Whether all poses and angles in a run's log of poses are those of eyes, and its times run on.
fn is_seeable(poses: &str) -> Result<(), String> {
    let mut last = None;
    for line in poses.lines() {
        let wrong = |what: &str| Err(format!("submitted {what}: {line}"));
        let frame: serde_json::Value =
            serde_json::from_str(line).map_err(|error| format!("{error}: {line}"))?;
        let display = frame["predicted_display_ns"].as_i64().unwrap_or(0);
        // From 1 s on, the simulated clock's first instant; no frame takes so long.
        let step = display - last.replace(display).unwrap_or(1_000_000_000);
        if !(1..=2_000_000_000).contains(&step) {
            return wrong("a time that does not run on");
        }
        let eyes = frame["eyes"].as_array().cloned().unwrap_or_default();
        if eyes.len() != 2 {
            return wrong("no two eyes");
        }
        for eye in eyes {
            let numbers = |name: &str| -> Vec<f64> {
                let list = eye[name].as_array().cloned().unwrap_or_default();
                list.iter().map(|number| number.as_f64().unwrap_or(f64::NAN)).collect()
            };
            let (pose, fov) = (numbers("pose"), numbers("fov"));
            let ([x, y, z, q @ ..], [left, right, up, down]) = (&pose[..], &fov[..]) else {
                return wrong("something else");
            };
            if !(0.0..100.0).contains(&x.hypot(*y).hypot(*z)) {
                return wrong("a place out of the room");
            }
            let norm = q.iter().map(|c| c * c).sum::<f64>().sqrt();
            if !(0.999..1.001).contains(&norm) {
                return wrong("a quaternion that is no rotation");
            }
            if !((0.1..3.1).contains(&(right - left)) && (0.1..3.1).contains(&(up - down))) {
                return wrong("a field of view that is none");
            }
        }
    }
    Ok(())
}

/// Runs a cell on a thread of its own: the runtime is configured per thread, and what hangs is left behind.
fn play(scene: &Arc<Scene>, profile: &std::path::Path, cell: &Cell) -> Outcome {
    let fault = Fault::parse(&cell.to_string()).unwrap();
    let plan = FaultPlan::new([fault]);
    let hang_s = if cell.what == "HANG" { HANG_S } else { 9.0 };
    let poses = profile.with_file_name(format!("{cell}.jsonl"));
    let config = RunConfig { log_poses: Some(poses.clone()), ..config(profile, plan.clone(), hang_s) };
    let scene = Arc::clone(scene);
    let (send, receive) = mpsc::channel();
    std::thread::spawn(move || {
        let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            let said = Mutex::new(Vec::new());
            let result = run(&scene, &config, &mut |happening| {
                if let vergence_session::Happening::Said(sentence) = happening {
                    said.lock().unwrap().push(sentence.to_owned());
                }
            });
            (result, said.into_inner().unwrap())
        }));
        let _ = send.send(result);
    });
    let (result, said) = match receive.recv_timeout(WATCHDOG) {
        Ok(Ok(ended)) => ended,
        Ok(Err(_)) => return Outcome::Wrong("panicked".into()),
        Err(_) => return Outcome::Hung,
    };
    let drawn = std::fs::read_to_string(&poses).unwrap_or_default();
    std::fs::remove_file(&poses).ok();
    if plan.hits().is_empty() {
        return Outcome::Unreached;
    }
    // Whatever the runtime said: what was drawn with and handed over is what eyes can be, at times that run on.
    if let Err(why) = is_seeable(&drawn) {
        return Outcome::Wrong(why);
    }
    match result {
        Ok(report) if report.frames != FRAMES || report.state != "exiting" => {
            Outcome::Wrong(format!("ended {} after {} frames", report.state, report.frames))
        }
        Ok(report) if report.losses == 0 => Outcome::Ended(End::On, String::new()),
        Ok(report) if report.losses == 1 => {
            let sentence = said.iter().find(|sentence| sentence.contains("anew")).cloned();
            sentence.map_or(Outcome::Wrong("not a word".into()), |s| Outcome::Ended(End::Anew, s))
        }
        Ok(report) => Outcome::Wrong(format!("lost {} times", report.losses)),
        Err(Error::Headset(error)) => {
            let end = match error.state() {
                State::Flat => End::Flat,
                State::WaitingForRuntime => End::Waiting,
                State::Lost { retry: false } => End::Lost,
                state => return Outcome::Wrong(format!("{error} ({state:?})")),
            };
            Outcome::Ended(end, error.to_string())
        }
        Err(error) => Outcome::Wrong(format!("{error:?}")),
    }
}

#[test]
fn every_fault_at_every_call_ends_in_the_state_that_the_table_says() {
    if !has_vulkan() {
        return;
    }
    let started = Instant::now();
    let folder = std::env::temp_dir().join(format!("vergence-faults-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let (scene, profile) = (floor(), profile(&folder));

    // What a run without faults calls.
    let counted = FaultPlan::new([]);
    let report = run(&scene, &config(&profile, counted.clone(), 9.0), &mut |_| {}).unwrap();
    assert_eq!((report.frames, report.losses), (FRAMES, 0));
    let calls: BTreeMap<&'static str, u64> = counted.calls();
    assert!(
        calls.get("xrApplyHapticFeedback").is_some_and(|count| *count >= 3),
        "nothing is felt: {calls:?}"
    );
    println!("a run without faults takes {:?} and calls:", started.elapsed());
    for (entry_point, count) in &calls {
        println!("    {count:>5} x {entry_point}");
    }
    let never: Vec<&str> = fault::entry_points().filter(|name| !calls.contains_key(name)).collect();
    println!("the client never calls: {}", never.join(", "));

    let mut cells = all_cells(&calls);
    if let Ok(only) = std::env::var("VERGENCE_FAULTS_ONLY") {
        cells.retain(|cell| cell.to_string().contains(&only));
        assert!(
            !cells.is_empty(),
            "VERGENCE_FAULTS_ONLY={only}: expected a part of a cell's name, found none"
        );
    }

    let next = AtomicUsize::new(0);
    let outcomes: Mutex<Vec<(Cell, Outcome)>> = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..WORKERS {
            scope.spawn(|| {
                while let Some(cell) = cells.get(next.fetch_add(1, Ordering::Relaxed)) {
                    // A fault at the nth call changes nothing before it.
                    let reachable = cell.call <= calls[cell.entry_point];
                    let outcome = if reachable { play(&scene, &profile, cell) } else { Outcome::Unreached };
                    if let Outcome::Wrong(why) = &outcome {
                        println!("{cell}: {why}");
                    }
                    let done = &mut *outcomes.lock().unwrap();
                    done.push((cell.clone(), outcome));
                    if done.len().is_multiple_of(200) {
                        println!("{} of {} cells after {:?}", done.len(), cells.len(), started.elapsed());
                    }
                }
            });
        }
    });
    let mut outcomes = outcomes.into_inner().unwrap();
    // A cell that took too long beside others, on a machine with more to do, is run again alone: what hangs, hangs again.
    let mut again = 0;
    for (cell, outcome) in &mut outcomes {
        if matches!(outcome, Outcome::Hung) {
            again += 1;
            *outcome = play(&scene, &profile, cell);
        }
    }
    println!("{again} cells took longer than {WATCHDOG:?} beside others, and were run again alone");
    outcomes
        .sort_by(|(a, _), (b, _)| (a.entry_point, &a.what, a.call).cmp(&(b.entry_point, &b.what, b.call)));
    let (mut ends, mut unreached, mut wrong) = (BTreeMap::<End, usize>::new(), Vec::new(), Vec::new());
    for (cell, outcome) in &outcomes {
        let name = cell.to_string();
        match outcome {
            Outcome::Unreached => unreached.push(name),
            Outcome::Ended(end, sentence) => {
                let expected = expected(cell.entry_point, &cell.what, cell.call);
                if *end == expected {
                    *ends.entry(*end).or_default() += 1;
                } else {
                    wrong.push(format!("{name}: expected {expected:?}, found {end:?} {sentence}"));
                }
            }
            Outcome::Wrong(why) => wrong.push(format!("{name}: {why}")),
            Outcome::Hung => wrong.push(format!("{name}: hung")),
        }
    }
    println!("unreached: {}", unreached.join(" "));
    for line in &wrong {
        println!("FAILED {line}");
    }
    let (all, reached) = (outcomes.len(), outcomes.len() - unreached.len());
    println!(
        "{all} cells of {} entry points: {reached} reached, {} unreached, {} passed {ends:?}, {} failed, in {:.0} s",
        calls.len(),
        unreached.len(),
        reached - wrong.len(),
        wrong.len(),
        started.elapsed().as_secs_f64()
    );
    assert!(wrong.is_empty(), "{} cells failed", wrong.len());
}

/// A picture that the runtime does not take back is not shown: its frame is ended all the same, and not said to be seen.
#[test]
fn a_frame_whose_picture_is_not_released_is_ended_without_it() {
    if !has_vulkan() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let (scene, profile) = (floor(), profile(folder.path()));
    let log = folder.path().join("session.mcap");
    let record = RecordConfig { path: log.clone(), durable: false, hash_frames: None, attach_scene: false };
    let plan = FaultPlan::new([Fault::parse("xrReleaseSwapchainImage=ERROR_RUNTIME_FAILURE@5").unwrap()]);
    let config = RunConfig { record: Some(record), ..config(&profile, plan.clone(), 9.0) };
    let report = run(&scene, &config, &mut |_| {}).unwrap();
    assert_eq!((plan.hits().len(), report.frames, report.losses), (1, FRAMES, 0));
    let calls = plan.calls();
    assert_eq!(calls["xrEndFrame"], calls["xrBeginFrame"], "{calls:?}");
    let mut reader = vergence_log::Reader::open(&log).unwrap();
    let mut submitted = 0;
    while let Some(entry) = reader.next().unwrap() {
        submitted += u64::from(entry.stream.name == "/views/submitted");
    }
    assert_eq!(submitted, report.frames, "pictures that were handed over");
}

/// How a recording under a fault was lived through again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Again {
    /// The fault did not come.
    Unreached,
    /// There was no session to record.
    NoSession,
    /// The session had no whole frame, and the replay says so.
    NoFrame,
    /// All frames, events and pictures are equal.
    Equal,
}

/// Records a run with a fault and verifies the recording.
fn record_and_verify(scene: &Arc<Scene>, profile: &std::path::Path, cell: &Cell) -> Result<Again, String> {
    let log = profile.with_file_name(format!("{cell}.mcap"));
    let plan = FaultPlan::new([Fault::parse(&cell.to_string()).unwrap()]);
    let hang_s = if cell.what == "HANG" { HANG_S } else { 9.0 };
    let record =
        RecordConfig { path: log.clone(), durable: false, hash_frames: Some(true), attach_scene: false };
    let config = RunConfig { record: Some(record), ..config(profile, plan.clone(), hang_s) };
    // How it ends is the matrix's to judge.
    let ended = run(scene, &config, &mut |_| {});
    if plan.hits().is_empty() {
        std::fs::remove_file(&log).ok();
        return Ok(Again::Unreached);
    }
    if !log.exists() {
        return if ended.is_err() { Ok(Again::NoSession) } else { Err("no recording".into()) };
    }
    let verified = SessionLog::open(&log).and_then(|log| {
        let config = ReplayConfig { verify: true, ..ReplayConfig::default() };
        replay(&log, scene, &config, &mut |_| {})
    });
    std::fs::remove_file(&log).ok();
    let report = match verified {
        Ok(report) => report,
        Err(error) if error.to_string().contains("without a whole frame") => return Ok(Again::NoFrame),
        Err(error) => return Err(error.to_string()),
    };
    let c = &report.comparison;
    let equal = (c.frames_equal, c.events_equal, c.images_equal) == (c.frames, c.events, c.images);
    if !report.complete || !c.is_equal() || !equal || c.images_not_compared.is_some() || c.frames == 0 {
        return Err(format!("{c:?}"));
    }
    if cell.what != "HANG" && c.extra_frames + c.extra_events > 0 {
        return Err(format!("more than was recorded: {c:?}"));
    }
    Ok(Again::Equal)
}

/// A recording of whatever a runtime did wrong is lived through again, call by call. `VERGENCE_FAULTS_ALL` takes each cell of
/// the matrix, else so many of each entry point.
#[test]
fn what_was_recorded_under_a_fault_replays_equal() {
    const OF_EACH: usize = 2;
    if !has_vulkan() {
        return;
    }
    let started = Instant::now();
    let folder = tempfile::tempdir().unwrap();
    let (scene, profile) = (floor(), profile(folder.path()));
    let counted = FaultPlan::new([]);
    run(&scene, &config(&profile, counted.clone(), 9.0), &mut |_| {}).unwrap();
    let calls = counted.calls();
    let mut cells = all_cells(&calls);
    cells.retain(|cell| cell.call <= calls[cell.entry_point]);
    if std::env::var_os("VERGENCE_FAULTS_ALL").is_none() {
        // Evenly over what there is for an entry point, from its end on: errors, then bad values, come last.
        let mut of: BTreeMap<&str, Vec<Cell>> = BTreeMap::new();
        cells.into_iter().for_each(|cell| of.entry(cell.entry_point).or_default().push(cell));
        let some = |all: Vec<Cell>| {
            let step = all.len().div_ceil(OF_EACH).max(1);
            // No multiple of three, the number of calls of a fault.
            let step = if step > 1 && step.is_multiple_of(3) { step + 1 } else { step };
            all.into_iter().rev().step_by(step).collect::<Vec<_>>()
        };
        cells = of.into_values().flat_map(some).collect();
    }
    if let Ok(only) = std::env::var("VERGENCE_FAULTS_ONLY") {
        cells.retain(|cell| cell.to_string().contains(&only));
    }
    let (next, outcomes) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..WORKERS {
            scope.spawn(|| {
                while let Some(cell) = cells.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let again = record_and_verify(&scene, &profile, cell);
                    outcomes.lock().unwrap().push((cell.clone(), again));
                }
            });
        }
    });
    let (mut ways, mut wrong) = (BTreeMap::<Again, usize>::new(), Vec::new());
    for (cell, again) in outcomes.into_inner().unwrap() {
        match again {
            Ok(again) => *ways.entry(again).or_default() += 1,
            Err(why) => wrong.push(format!("{cell}: {why}")),
        }
    }
    wrong.sort();
    wrong.iter().for_each(|line| println!("FAILED {line}"));
    println!(
        "{} cells recorded and verified: {ways:?}, {} failed, in {:.0} s",
        cells.len(),
        wrong.len(),
        started.elapsed().as_secs_f64()
    );
    assert!(wrong.is_empty(), "{} cells failed", wrong.len());
    assert!(ways.get(&Again::Equal).copied().unwrap_or(0) * 2 > cells.len(), "{ways:?}");
}
