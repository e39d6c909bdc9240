//! What a user hears of a run, how a run is ended from outside, and what it leaves in its folder.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod stage;

use stage::{Folder, config, disc, has_vulkan};
use vergence_session::{CaptureConfig, Happening, RecordConfig, RunConfig, run};

/// Starting, ending and recentring are the user's own doing: of them nothing is said.
#[test]
fn a_run_without_trouble_says_only_which_headset_it_took() {
    if !has_vulkan() {
        return;
    }
    let folder = Folder::new("quiet");
    let config = config(&folder, 20);
    let mut said = Vec::new();
    let report = run(&disc(true), &config, &mut |happening| match happening {
        Happening::Said(sentence) => said.push(sentence.to_owned()),
        Happening::Frame { shown: 5, .. } => config.control.recentre(),
        Happening::Frame { .. } => {}
    })
    .unwrap();
    assert_eq!(said.len(), 1, "{said:?}");
    assert!(said[0].contains("simulated"), "{said:?}");
    assert!(report.notices.iter().any(|notice| notice.contains("recentred")), "{:?}", report.notices);
    assert!(report.warnings.is_empty(), "{:?}", report.warnings);
}

#[test]
fn a_run_that_is_stopped_ends_as_it_should() {
    if !has_vulkan() {
        return;
    }
    let folder = Folder::new("stop");
    let capture = CaptureConfig { dir: folder.0.join("pictures"), every: None };
    let config = RunConfig { frames: None, capture: Some(capture.clone()), ..config(&folder, 1) };
    let report = run(&disc(false), &config, &mut |happening| {
        if matches!(happening, Happening::Frame { shown: 10, .. }) {
            config.stop.stop();
        }
    })
    .unwrap();
    assert_eq!((report.frames, report.state.as_str()), (10, "exiting"));
    assert_eq!(report.pictures, ["frame-000000.png", "frame-000009.png"]);
    assert!(capture.dir.join("summary.json").is_file());
}

/// After a loss the headset counts from 0 again; pictures of before are not overwritten.
#[test]
fn pictures_are_numbered_through_a_loss() {
    if !has_vulkan() {
        return;
    }
    let folder = Folder::new("loss-pictures");
    let capture = CaptureConfig { dir: folder.0.join("pictures"), every: Some(1) };
    let config = RunConfig { capture: Some(capture.clone()), ..config(&folder, 20) };
    let report = run(&disc(false), &config, &mut |happening| {
        if matches!(happening, Happening::Frame { shown: 8, .. }) {
            config.control.lose_session();
        }
    })
    .unwrap();
    assert_eq!((report.frames, report.losses), (20, 1));
    let expected: Vec<String> = (0..20).map(|number| format!("frame-{number:06}.png")).collect();
    assert_eq!(report.pictures, expected);
    assert_eq!(std::fs::read_to_string(capture.dir.join("poses.jsonl")).unwrap().lines().count(), 20);
}

#[test]
fn an_earlier_runs_pictures_are_replaced_and_others_are_not_touched() {
    if !has_vulkan() {
        return;
    }
    let folder = Folder::new("again");
    let dir = folder.0.join("pictures");
    let shoot = |frames| {
        let capture = Some(CaptureConfig { dir: dir.clone(), every: Some(1) });
        run(&disc(false), &RunConfig { capture, ..config(&folder, frames) }, &mut |_| {})
    };
    shoot(6).unwrap();
    std::fs::write(dir.join("notes.txt"), "mine").unwrap();
    shoot(2).unwrap();
    let mut names: Vec<String> =
        dir.read_dir().unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    assert_eq!(names, ["frame-000000.png", "frame-000001.png", "notes.txt", "poses.jsonl", "summary.json"]);
    // Pictures that no run has left there are refused, and stay.
    std::fs::remove_file(dir.join("poses.jsonl")).unwrap();
    let error = shoot(2).unwrap_err();
    assert!(error.is_wrong_call() && error.to_string().contains("found 2 pictures"), "{error}");
    assert!(dir.join("frame-000001.png").is_file());
}

/// A run that cannot begin leaves what an earlier one has written.
#[test]
fn an_earlier_run_stays_where_the_next_one_cannot_begin() {
    if !has_vulkan() {
        return;
    }
    let folder = Folder::new("kept");
    let dir = folder.0.join("pictures");
    let capture = Some(CaptureConfig { dir: dir.clone(), every: Some(1) });
    let log_poses = Some(folder.0.join("poses.jsonl"));
    let good = RunConfig { capture, log_poses, ..config(&folder, 2) };
    run(&disc(false), &good, &mut |_| {}).unwrap();
    let files = [
        dir.join("frame-000001.png"),
        dir.join("poses.jsonl"),
        dir.join("summary.json"),
        folder.0.join("poses.jsonl"),
    ];
    let read = || files.each_ref().map(|file| std::fs::read(file).unwrap());
    let before = read();
    let quality = vergence_render::Quality { msaa: 3, ..good.quality.clone() };
    let fault = vergence_session::Fault::parse("xrCreateSession=ERROR_LIMIT_REACHED").unwrap();
    let faults = vergence_session::FaultPlan::new(vec![fault]);
    for wrong in [
        RunConfig { motion: Some("no-such-motion.toml".into()), ..good.clone() },
        RunConfig { quality, ..good.clone() },
        RunConfig { faults, ..good.clone() },
    ] {
        run(&disc(false), &wrong, &mut |_| {}).unwrap_err();
        assert!(read() == before, "{:?} {:?}", wrong.motion, wrong.faults);
    }
}

/// Whatever a run writes must not be what it reads, nor two things one file.
#[test]
fn a_run_refuses_to_write_what_it_reads() {
    let folder = Folder::new("own-files");
    let motion = folder.0.join("motion.toml");
    std::fs::write(&motion, "not read before it is refused").unwrap();
    let base = RunConfig { motion: Some(motion.display().to_string()), ..config(&folder, 1) };
    let record = |path| Some(RecordConfig { path, durable: false, hash_frames: None, attach_scene: false });
    let capture = Some(CaptureConfig { dir: folder.0.clone(), every: None });
    let new = folder.0.join("new");
    let wrong = [
        ("--log-poses", RunConfig { log_poses: Some(motion.clone()), ..base.clone() }),
        ("--record", RunConfig { record: record(motion.clone()), ..base.clone() }),
        ("--log-poses", RunConfig { record: record(new.clone()), log_poses: Some(new), ..base.clone() }),
        ("--capture", RunConfig { capture, log_poses: Some(folder.0.join("poses.jsonl")), ..base.clone() }),
    ];
    for (option, wrong) in wrong {
        let error = run(&disc(false), &wrong, &mut |_| {}).unwrap_err();
        assert!(error.is_wrong_call() && error.to_string().starts_with(option), "{option}: {error}");
    }
    assert_eq!(std::fs::read_to_string(&motion).unwrap(), "not read before it is refused");
}

#[test]
fn a_rate_that_the_display_lacks_is_refused_with_what_it_has() {
    if !has_vulkan() {
        return;
    }
    let folder = Folder::new("rate");
    let wish = |refresh_rate_hz| RunConfig { refresh_rate_hz, ..config(&folder, 3) };
    let error = run(&disc(false), &wish(Some(50.0)), &mut |_| {}).unwrap_err();
    assert!(error.is_wrong_call(), "{error}");
    assert_eq!(error.to_string(), "the display cannot run at 50 Hz: expected one of 72 Hz");
    assert_eq!(run(&disc(false), &wish(Some(72.0)), &mut |_| {}).unwrap().frames, 3);
}

#[test]
fn streams_that_the_runtime_lacks_are_warned_of() {
    if !has_vulkan() {
        return;
    }
    let folder = Folder::new("streams");
    let sees = config(&folder, 3).profile.unwrap();
    let blind = folder.0.join("blind.toml");
    let text = std::fs::read_to_string(sees).unwrap();
    std::fs::write(&blind, format!("hands = false\ngaze = false\n{text}")).unwrap();
    let profile = Some(blind.to_str().unwrap().to_owned());
    let config = RunConfig { hand_joints: true, eye_gaze: true, profile, ..config(&folder, 3) };
    let report = run(&disc(false), &config, &mut |_| {}).unwrap();
    assert_eq!(report.frames, 3);
    for stream in ["joints", "gaze"] {
        assert_eq!(report.warnings.iter().filter(|w| w.contains(stream)).count(), 1, "{:?}", report.warnings);
    }
}
