//! The client and the session against the simulated headset: whole runs, every loss, what is shown and what is not made.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod stage;

use nalgebra::{Point3, UnitQuaternion, Vector3};
use stage::{DISC_AHEAD_M, DISC_RADIUS_M, Folder, config, disc, has_vulkan};
use vergence_geom::{Fov, Rigid, project};
use vergence_session::{CaptureConfig, Happening, HeadsetChoice, RunConfig, RunReport, run};
use vergence_xr_sim::{Control, Presence};

/// Runs, and does something with the headset when so many frames have been shown.
fn run_and(config: &RunConfig, at_frame: u64, act: impl Fn(&Control)) -> RunReport {
    let mut done = false;
    let report = run(&disc(false), config, &mut |happening| {
        if let Happening::Frame { shown, .. } = happening
            && shown >= at_frame
            && !std::mem::replace(&mut done, true)
        {
            act(&config.control);
        }
    });
    report.unwrap()
}

fn assert_quiet(report: &RunReport) {
    assert!(report.validation_messages.is_none_or(|count| count == 0), "{:?}", report.validation_messages);
}

#[test]
fn three_hundred_frames_with_motion() {
    if !has_vulkan() {
        return;
    }
    let folder = Folder::new("whole");
    let poses = folder.0.join("poses.jsonl");
    let config = RunConfig { log_poses: Some(poses.clone()), ..config(&folder, 300) };
    let report = run(&disc(false), &config, &mut |_| {}).unwrap();
    assert_eq!((report.frames, report.missed, report.losses), (300, 0, 0));
    assert_eq!(report.state, "exiting");
    assert_eq!(&report.states[..3], ["running", "visible", "focused"]);
    assert!(report.depth_layer);
    assert_eq!(std::fs::read_to_string(poses).unwrap().lines().count(), 300);
    assert_quiet(&report);
}

/// The views that are submitted are those that the picture was drawn with, and those are where the eyes are: the middle
/// of a disc in the composed picture is where the geometry of each eye puts it.
#[test]
fn a_disc_is_seen_where_the_geometry_of_each_eye_puts_it() {
    const TOLERANCE_PX: f64 = 0.1;
    if !has_vulkan() {
        return;
    }
    let folder = Folder::new("disc");
    let capture = CaptureConfig { dir: folder.0.join("pictures"), every: Some(10) };
    let config = RunConfig { capture: Some(capture.clone()), ..config(&folder, 60) };
    let report = run(&disc(false), &config, &mut |_| {}).unwrap();
    assert_quiet(&report);
    let poses = std::fs::read_to_string(capture.dir.join("poses.jsonl")).unwrap();
    let mut compared = 0;
    let mut heads = Vec::new();
    for line in poses.lines() {
        let line: serde_json::Value = serde_json::from_str(line).unwrap();
        let path = capture.dir.join(format!("frame-{:06}.png", line["frame"].as_u64().unwrap()));
        let mut reader = png::Decoder::new(std::io::BufReader::new(std::fs::File::open(path).unwrap()))
            .read_info()
            .unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut pixels).unwrap();
        let (width, height) = (info.width as usize / 2, info.height as usize);
        heads.push(line["head"][3].as_f64().unwrap());
        for eye in 0..2 {
            let numbers = |value: &serde_json::Value| -> Vec<f64> {
                value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
            };
            let pose = numbers(&line["eyes"][eye]["pose"]);
            let angles = numbers(&line["eyes"][eye]["fov"]);
            let q = nalgebra::Quaternion::new(pose[6], pose[3], pose[4], pose[5]);
            let local_from_eye = Rigid::from_parts(
                Vector3::new(pose[0], pose[1], pose[2]).into(),
                UnitQuaternion::new_normalize(q),
            );
            let fov =
                Fov { left_rad: angles[0], right_rad: angles[1], up_rad: angles[2], down_rad: angles[3] };
            // LOCAL's origin is at eye height; the scene's start is on the floor.
            let truth = truth_px(&local_from_eye, &fov, (width, height));
            let found = centroid_px(&pixels, eye * width, (width, height), 2 * width);
            let (Some(truth), Some(found)) = (truth, found) else { continue };
            let off = (truth.0 - found.0).hypot(truth.1 - found.1);
            assert!(off <= TOLERANCE_PX, "{line}: eye {eye}: expected {truth:?}, found {found:?}");
            compared += 1;
        }
    }
    assert!(compared >= 8, "the disc was seen in {compared} pictures only");
    assert!(heads.iter().any(|x| (x - heads[0]).abs() > 1e-3), "the head did not move");
}

/// Where the disc's centroid is, in pixels, by integrating the projected disc; `None` unless all of it is well inside.
fn truth_px(local_from_eye: &Rigid, fov: &Fov, (width, height): (usize, usize)) -> Option<(f64, f64)> {
    const RINGS: usize = 60;
    const SPOKES: usize = 120;
    let eye_from_local = local_from_eye.inverse();
    let (mut sum, mut x, mut y) = (0.0, 0.0, 0.0);
    let pixel = |p: &Point3<f64>| {
        project(fov, &(eye_from_local * p))
            .map(|ndc| (0.5 * (ndc.x + 1.0) * width as f64, 0.5 * (ndc.y + 1.0) * height as f64))
    };
    // Area of a cell in the picture: the cross product of its diagonals.
    let at = |ring: f64, spoke: usize| {
        let angle = spoke as f64 / SPOKES as f64 * std::f64::consts::TAU;
        let radius = DISC_RADIUS_M * ring / RINGS as f64;
        Point3::new(radius * angle.cos(), radius * angle.sin(), -DISC_AHEAD_M)
    };
    for ring in 0..RINGS {
        for spoke in 0..SPOKES {
            let (inner, outer) = (ring as f64, ring as f64 + 1.0);
            let (a, b) = (pixel(&at(inner, spoke))?, pixel(&at(outer, spoke))?);
            let (c, d) = (pixel(&at(outer, spoke + 1))?, pixel(&at(inner, spoke + 1))?);
            let area = 0.5 * ((c.0 - a.0) * (d.1 - b.1) - (c.1 - a.1) * (d.0 - b.0)).abs();
            sum += area;
            x += area * 0.25 * (a.0 + b.0 + c.0 + d.0);
            y += area * 0.25 * (a.1 + b.1 + c.1 + d.1);
            let inside = |p: (f64, f64)| {
                (2.0..width as f64 - 2.0).contains(&p.0) && (2.0..height as f64 - 2.0).contains(&p.1)
            };
            if !(inside(b) && inside(c)) {
                return None;
            }
        }
    }
    Some((x / sum, y / sum))
}

/// Centroid of what is bright, in pixels of one eye; light is added up linearly.
fn centroid_px(rgba: &[u8], left: usize, (width, height): (usize, usize), row: usize) -> Option<(f64, f64)> {
    let (mut sum, mut x, mut y) = (0.0, 0.0, 0.0);
    for v in 0..height {
        for u in 0..width {
            let coded = f64::from(rgba[4 * (v * row + left + u)]) / 255.0;
            let light = if coded <= 0.04045 { coded / 12.92 } else { ((coded + 0.055) / 1.055).powf(2.4) };
            sum += light;
            x += light * (u as f64 + 0.5);
            y += light * (v as f64 + 0.5);
        }
    }
    (sum > 0.0).then(|| (x / sum, y / sum))
}

/// The headset is off for a while: the session is idle, says so, and goes on when it is put on again.
#[test]
fn the_headset_is_taken_off_and_put_on_again() {
    if !has_vulkan() {
        return;
    }
    let folder = Folder::new("presence");
    let config = config(&folder, 60);
    let (mut took_off, control) = (false, config.control.clone());
    let report = run(&disc(false), &config, &mut |happening| match happening {
        Happening::Frame { shown: 20, .. } if !std::mem::replace(&mut took_off, true) => {
            control.set_presence(Presence::Away);
        }
        Happening::Said(sentence) if sentence.contains("put the headset on") => {
            control.set_presence(Presence::Focused);
        }
        _ => {}
    })
    .unwrap();
    assert!(took_off);
    assert_eq!((report.frames, report.losses), (60, 0), "{:?}", report.states);
    let idle = report.states.iter().position(|state| state == "idle").unwrap();
    assert!(report.states[idle..].iter().any(|state| state == "focused"), "{:?}", report.states);
    assert_quiet(&report);
}

/// Who has worn the headset may put it down for longer than the patience with one that nobody puts on.
#[test]
fn the_headset_may_be_off_for_long_once_it_was_worn() {
    if !has_vulkan() {
        return;
    }
    let folder = Folder::new("long-away");
    let config = RunConfig { patience_s: 2.0, ..config(&folder, 60) };
    let (mut took_off, control) = (false, config.control.clone());
    let report = run(&disc(false), &config, &mut |happening| match happening {
        Happening::Frame { shown: 20, .. } if !std::mem::replace(&mut took_off, true) => {
            control.set_presence(Presence::Away);
            let control = control.clone();
            std::thread::spawn(move || {
                std::thread::sleep(std::time::Duration::from_secs(4));
                control.set_presence(Presence::Focused);
            });
        }
        _ => {}
    })
    .unwrap();
    assert!(took_off);
    assert_eq!((report.frames, report.losses), (60, 0), "{:?}", report.states);
    assert_quiet(&report);
}

/// A headset that nobody puts on is not waited for without end.
#[test]
fn nobody_puts_the_headset_on() {
    if !has_vulkan() {
        return;
    }
    let folder = Folder::new("away");
    let config = RunConfig { patience_s: 1.0, ..config(&folder, 60) };
    config.control.set_presence(Presence::Away);
    let error = run(&disc(false), &config, &mut |_| {}).unwrap_err();
    assert!(error.to_string().contains("no frame was shown for 1 s"), "{error}");
}

#[test]
fn a_lost_session_is_asked_for_anew_and_so_is_a_lost_instance() {
    if !has_vulkan() {
        return;
    }
    for lose in [Control::lose_session as fn(&Control), Control::lose_instance] {
        let folder = Folder::new("loss");
        let report = run_and(&config(&folder, 60), 20, lose);
        assert_eq!((report.frames, report.losses), (60, 1), "{:?}", report.notices);
        assert_eq!(report.state, "exiting");
        assert!(report.states.iter().any(|state| state == "lost"), "{:?}", report.states);
        assert!(report.notices.iter().any(|notice| notice.contains("anew")), "{:?}", report.notices);
        assert_quiet(&report);
    }
}

#[test]
fn a_session_that_is_lost_too_often_is_given_up() {
    if !has_vulkan() {
        return;
    }
    let folder = Folder::new("lost-often");
    let config = RunConfig { retries: 2, ..config(&folder, 1000) };
    let control = config.control.clone();
    let error = run(&disc(false), &config, &mut |happening| {
        if matches!(happening, Happening::Frame { shown, .. } if shown % 5 == 0) {
            control.lose_session();
        }
    })
    .unwrap_err();
    assert!(error.to_string().contains("lost"), "{error}");
    assert!(!error.is_wrong_call());
}

#[test]
fn the_runtime_asks_the_application_to_end() {
    if !has_vulkan() {
        return;
    }
    let folder = Folder::new("exit");
    let report = run_and(&config(&folder, 1000), 10, Control::ask_to_exit);
    assert!(report.frames < 100, "{}", report.frames);
    assert_eq!(report.state, "exiting");
}

#[test]
fn recentring_is_followed() {
    if !has_vulkan() {
        return;
    }
    let folder = Folder::new("recentre");
    let report = run_and(&config(&folder, 40), 20, Control::recentre);
    assert_eq!(report.frames, 40);
    assert!(report.notices.iter().any(|notice| notice.contains("recentred")), "{:?}", report.notices);
}

/// What is not in the plan is not asked for: no actions without something to touch, no streams that nobody wants.
#[test]
fn what_is_not_in_the_plan_is_not_asked_for() {
    if !has_vulkan() {
        return;
    }
    let folder = Folder::new("plan");
    let config = config(&folder, 5);
    let plain = run(&disc(false), &config, &mut |_| {}).unwrap();
    assert!(plain.actions.is_empty() && plain.profiles.is_empty() && plain.touches.is_empty());
    let touchable = run(&disc(true), &config, &mut |_| {}).unwrap();
    assert!(touchable.actions.iter().any(|name| name == "aim"), "{:?}", touchable.actions);
    assert!(!touchable.profiles.is_empty());
    for (scene, report) in [(disc(false), &plain), (disc(true), &touchable)] {
        let plan = vergence_plan::Plan::of(&scene, &vergence_plan::Requests::default());
        // What the GPU did is what was planned (timestamps are not there on every device).
        let passes: Vec<&str> = plan.passes.iter().map(|pass| pass.name()).collect();
        let done: Vec<&str> = report.gpu_ms.iter().map(|pass| pass.name.as_str()).collect();
        assert!(done.is_empty() || done == passes, "{done:?} {passes:?}");
        let planned = |name: &String| plan.extensions.iter().any(|extension| extension.name == name);
        assert!(report.extensions.iter().all(planned), "{:?}", report.extensions);
        for unplanned in ["XR_EXT_hand_tracking", "XR_EXT_eye_gaze_interaction"] {
            assert!(!report.extensions.iter().any(|name| name == unplanned));
        }
    }
}

/// A quality that the device cannot give is a wrong call that says what there is.
#[test]
fn impossible_wishes_are_refused_with_what_is_possible() {
    if !has_vulkan() {
        return;
    }
    let folder = Folder::new("wishes");
    let quality = vergence_render::Quality { msaa: 3, ..Default::default() };
    let error = run(&disc(false), &RunConfig { quality, ..config(&folder, 1) }, &mut |_| {}).unwrap_err();
    assert!(error.is_wrong_call() && error.to_string().contains("MSAA 1"), "{error}");
    let profile = Some("no-such-headset".into());
    let error = run(&disc(false), &RunConfig { profile, ..config(&folder, 1) }, &mut |_| {}).unwrap_err();
    assert!(error.is_wrong_call() && error.to_string().contains("quest3"), "{error}");
    let real = RunConfig { headset: HeadsetChoice::OpenXr, ipd_m: Some(0.06), ..config(&folder, 1) };
    let error = run(&disc(false), &real, &mut |_| {}).unwrap_err();
    assert!(error.is_wrong_call() && error.to_string().contains("--ipd"), "{error}");
}
