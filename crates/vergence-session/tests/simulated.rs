//! The client and the session against the simulated headset: whole runs, every loss, what is shown and what is not made.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod stage;

use stage::{Folder, config, disc, has_vulkan};
use vergence_session::{Happening, HeadsetChoice, RunConfig, RunReport, run};
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
