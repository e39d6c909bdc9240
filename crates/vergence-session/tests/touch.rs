//! What a user sees of touching: what is pointed at gets a frame, what is taken another, and a hand that lies still nothing.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod stage;

use std::path::Path;
use std::sync::Arc;

use stage::{Folder, config, disc, has_vulkan};
use vergence_plan::{Plan, Requests};
use vergence_session::{
    CaptureConfig, RecordConfig, ReplayConfig, RunConfig, RunReport, SessionLog, cost_of, replay, run,
    with_markers,
};

/// The user looks ahead; the right hand comes up from below the disc, points at it, and takes it at the end.
const POINTING: &str = r#"
    at-end = "hold"
    [[head]]
    time = "0 s"
    position = ["0 m", "1.6 m", "0 m"]
    turned = { yaw = "0 deg" }
    [[right]]
    time = "0 s"
    aim = { position = ["0.15 m", "1.3 m", "-0.4 m"], turned = { pitch = "-60 deg" } }
    trigger = 0.0
    [[right]]
    time = "100 ms"
    aim = { position = ["0.15 m", "1.3 m", "-0.4 m"], turned = { yaw = "5 deg", pitch = "11 deg" } }
    [[right]]
    time = "250 ms"
    trigger = 0.0
    [[right]]
    time = "260 ms"
    trigger = 1.0
"#;

/// Pixels of both eyes, by the colours of the markers.
struct Seen {
    frame: usize,
    taken: usize,
    ray: usize,
}

fn seen(path: &Path) -> Seen {
    let file = std::io::BufReader::new(std::fs::File::open(path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    let channels = info.color_type.samples();
    let mut seen = Seen { frame: 0, taken: 0, ray: 0 };
    for pixel in pixels[..info.buffer_size()].chunks_exact(channels) {
        let [r, g, b] = [pixel[0], pixel[1], pixel[2]].map(i32::from);
        seen.frame += usize::from(r > 180 && r > b + 90 && r > g + 40);
        seen.taken += usize::from(g > 180 && g > r + 60 && g > b + 60);
        seen.ray += usize::from(b > 180 && b > r + 40);
    }
    seen
}

fn shoot(folder: &Folder, script: &str, frames: u64) -> (RunReport, Vec<Seen>) {
    let motion = folder.0.join("script.toml");
    std::fs::write(&motion, script).unwrap();
    let capture = CaptureConfig { dir: folder.0.join("pictures"), every: Some(1) };
    let config = RunConfig {
        motion: Some(motion.to_str().unwrap().to_owned()),
        capture: Some(capture.clone()),
        record: Some(RecordConfig {
            path: folder.0.join("session.mcap"),
            durable: false,
            hash_frames: None,
            attach_scene: false,
        }),
        ..config(folder, frames)
    };
    let report = run(&disc(true), &config, &mut |_| {}).unwrap();
    let pictures = report.pictures.iter().map(|name| seen(&capture.dir.join(name))).collect();
    (report, pictures)
}

#[test]
fn what_is_pointed_at_gets_a_frame_and_what_is_taken_another() {
    if !has_vulkan() {
        return;
    }
    let folder = Folder::new("touch");
    let (report, pictures) = shoot(&folder, POINTING, 30);
    let touched: Vec<&str> = report.touches.iter().map(|touch| touch.what).collect();
    assert_eq!(touched, ["pointed", "taken"], "{:?}", report.touches);
    let [pointed, taken] = [0, 1].map(|at| report.touches[at].frame as usize);
    for (number, seen) in pictures.iter().enumerate() {
        let Seen { frame, taken: green, ray } = *seen;
        let found = format!("frame {number}: {frame} orange, {green} green, {ray} blue");
        assert_eq!(frame > 40, (pointed..taken).contains(&number), "{found}");
        assert_eq!(green > 40, number >= taken, "{found}");
        assert!(ray > 20 || number < pointed, "{found}");
    }
    // All of it follows from what was recorded.
    let log = SessionLog::open(&folder.0.join("session.mcap")).unwrap();
    let config = ReplayConfig { verify: true, ..ReplayConfig::default() };
    let again = replay(&log, &disc(true), &config, &mut |_| {}).unwrap();
    assert_eq!((again.comparison.first_difference, &again.run.touches), (None, &report.touches));
    assert_eq!((again.comparison.images, again.comparison.images_equal), (60, 60));
}

/// A controller that lies on the table and happens to point at something, while the user looks around.
#[test]
fn a_hand_that_lies_still_touches_nothing() {
    if !has_vulkan() {
        return;
    }
    let folder = Folder::new("still");
    let still = r#"
        at-end = "hold"
        [[head]]
        time = "0 s"
        position = ["0 m", "1.6 m", "0 m"]
        turned = { yaw = "-15 deg" }
        [[head]]
        time = "300 ms"
        position = ["0.1 m", "1.6 m", "0 m"]
        turned = { yaw = "15 deg" }
        [[right]]
        time = "0 s"
        aim = { position = ["0 m", "1.5 m", "-0.4 m"], turned = { pitch = "4 deg" } }
    "#;
    let (report, pictures) = shoot(&folder, still, 25);
    assert!(report.touches.is_empty(), "{:?}", report.touches);
    for Seen { frame, taken, ray } in pictures {
        assert_eq!((frame, taken, ray), (0, 0, 0));
    }
}

/// Nothing exists of it on the GPU, or in the plan, where nothing can be touched.
#[test]
fn where_nothing_can_be_touched_it_costs_nothing() {
    if !has_vulkan() {
        return;
    }
    let (plain, touchable) = (disc(false), disc(true));
    let cost = |scene| cost_of(scene, &Plan::of(scene, &Requests::default())).unwrap();
    let marked = with_markers(&plain);
    assert!(Arc::ptr_eq(&marked, &plain));
    assert_eq!(cost(&marked), cost(&plain));
    // The count does see it where something can be.
    assert_eq!(cost(&touchable), cost(&plain));
    assert!(cost(&with_markers(&touchable)).buffer_bytes > cost(&plain).buffer_bytes);
}
