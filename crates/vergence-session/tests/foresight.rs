//! A runtime that loses the eyes for some frames: what is drawn goes on as they moved.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod stage;

use stage::{Folder, config, disc, has_vulkan};
use vergence_geom::Rigid;
use vergence_session::{RunConfig, run};
use vergence_xr_sim::{Fault, FaultPlan};

/// Frames, and those of which the runtime says nothing that can be read: 56 ms.
const FRAMES: u64 = 100;
const LOST: std::ops::Range<usize> = 80..84;

/// The left eye of each frame that was shown.
fn eyes(folder: &Folder, faults: FaultPlan) -> Vec<Rigid> {
    let poses = folder.0.join("poses.jsonl");
    let config = RunConfig { log_poses: Some(poses.clone()), faults, ..config(folder, FRAMES) };
    let report = run(&disc(false), &config, &mut |_| {}).unwrap();
    assert_eq!((report.frames, report.losses), (FRAMES, 0));
    let text = std::fs::read_to_string(poses).unwrap();
    let eye = |line: &str| {
        let frame: serde_json::Value = serde_json::from_str(line).unwrap();
        let pose: [f64; 7] = serde_json::from_value(frame["eyes"][0]["pose"].clone()).unwrap();
        let [x, y, z, i, j, k, w] = pose;
        let rotation = nalgebra::UnitQuaternion::new_normalize(nalgebra::Quaternion::new(w, i, j, k));
        Rigid::from_parts([x, y, z].into(), rotation)
    };
    text.lines().map(eye).collect()
}

#[test]
fn eyes_that_the_runtime_loses_go_on_as_they_moved() {
    if !has_vulkan() {
        return;
    }
    let folder = Folder::new("foresight");
    let truth = eyes(&folder, FaultPlan::default());
    // Two calls for each frame that is drawn, and frames before the first are not.
    let fault = format!("xrLocateViews=NAN_POSE@{}-{}", 2 * LOST.start + 1, 2 * LOST.end);
    let found = eyes(&folder, FaultPlan::new([Fault::parse(&fault).unwrap()]));
    let off = |a: &Rigid, b: &Rigid| a.rotation.angle_to(&b.rotation).to_degrees();
    let wrong: Vec<usize> =
        (0..truth.len()).filter(|&frame| off(&truth[frame], &found[frame]) > 1e-5).collect();
    let (Some(&first), Some(&last)) = (wrong.first(), wrong.last()) else { panic!("no eye was lost") };
    assert!(first.abs_diff(LOST.start) < 12 && last - first < LOST.len() + 1, "{wrong:?}");
    let sums = wrong.iter().fold((0.0, 0.0), |(foretold, held), &frame| {
        (foretold + off(&truth[frame], &found[frame]), held + off(&truth[frame], &truth[first - 1]))
    });
    println!(
        "{} frames lost: {:.3} deg off in all, {:.3} where the eyes had stayed",
        wrong.len(),
        sums.0,
        sums.1
    );
    assert!(sums.0 < 0.3 * sums.1, "{sums:?}");
}
