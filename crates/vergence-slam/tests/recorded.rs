//! Odometry on recorded and half-real data.

#![allow(clippy::unwrap_used, reason = "in a test, what is missing fails it")]

mod support;

use support::{Run, cpu_ms, recording, skip};
use vergence_slam::dataset::Dataset;
use vergence_slam::evaluate::{Align, Evaluation, evaluate};
use vergence_slam::playback::{Mode, Playback, z_up};
use vergence_slam::trajectory::Trajectory;
use vergence_slam::{Params, State};
use vergence_vision::TrackerKnobs;

fn follow(dataset: &Dataset, mode: Mode, align: Align) -> (Run, Evaluation) {
    let mut playback = Playback::new(dataset, mode, TrackerKnobs::default(), Params::default()).unwrap();
    let mut run = Run::default();
    for frame in 0..playback.frames() {
        let loaded = Playback::load(dataset, mode, frame).unwrap();
        let start = cpu_ms();
        run.estimates.push(playback.follow(frame, &loaded).unwrap());
        run.frame_ms.push(cpu_ms() - start);
    }
    let poses = run.estimates.iter().map(|e| (e.time, z_up(&e.world_from_body))).collect();
    let found = evaluate(&Trajectory { poses }, dataset.truth.as_ref().unwrap(), align).unwrap();
    let lost = run.estimates.iter().filter(|e| e.state == State::Lost).count();
    println!(
        "{mode:?}: ATE {:.4} m, scale {:.3}, {} matched, {:.1} ms, tracked from {:?}, {lost} lost, rest {:?}",
        found.ate_rmse_m,
        found.scale,
        found.matched,
        run.mean_ms(),
        run.estimates.iter().position(|e| e.state == State::Tracked),
        found.rest,
    );
    (run, found)
}

#[test]
fn a_half_real_flight() {
    let Some(folder) = recording("half_real_v101_14s") else { return skip("no half-real flight") };
    let dataset = Dataset::open(&folder).unwrap();
    let (run, found) = follow(&dataset, Mode::StereoInertial, Align::Se3);
    assert!(found.ate_rmse_m < 0.01 && run.estimates.len() == 280, "{}", found.ate_rmse_m);
    assert!((found.scale - 1.0).abs() < 0.01);
    let (_, found) = follow(&dataset, Mode::Stereo, Align::Se3);
    assert!(found.ate_rmse_m < 0.015, "{}", found.ate_rmse_m);
}

#[test]
fn a_half_real_flight_with_one_camera() {
    let Some(folder) = recording("half_real_v101_14s") else { return skip("no half-real flight") };
    let dataset = Dataset::open(&folder).unwrap();
    // Slow and even: it takes ten seconds to know the scale. Seen: 0.057 m, 1.019.
    let (_, found) = follow(&dataset, Mode::MonoInertial, Align::Se3);
    assert!(found.ate_rmse_m < 0.08 && (found.scale - 1.0).abs() < 0.04, "{}", found.ate_rmse_m);
    let (_, found) = follow(&dataset, Mode::Mono, Align::Sim3);
    assert!(found.ate_rmse_m < 0.05, "{}", found.ate_rmse_m);
}

#[test]
fn standing_on_the_floor() {
    let Some(folder) = recording("euroc_v101_start") else { return skip("no recording of EuRoC") };
    let dataset = Dataset::open(&folder).unwrap();
    let (run, found) = follow(&dataset, Mode::StereoInertial, Align::Se3);
    let way = |e: &vergence_slam::Estimate| e.world_from_body.translation.vector.norm();
    let farthest = run.estimates.iter().map(way).fold(0.0, f64::max);
    println!("farthest {farthest:.5} m");
    assert!(farthest < 0.002);
    assert!(found.rest.is_none_or(|rest| rest.jitter_m < 0.0005));
    assert!(run.estimates.iter().position(|e| e.state == State::Tracked).unwrap() <= 3);
}

#[test]
fn a_hand_held_depth_camera() {
    let Some(folder) = recording("sevenscenes_rgbd") else { return skip("no 7-Scenes") };
    let dataset = Dataset::open(&folder).unwrap();
    let (_, found) = follow(&dataset, Mode::Rgbd, Align::Se3);
    assert!(found.ate_rmse_m < 0.03, "{}", found.ate_rmse_m);
    let (_, found) = follow(&dataset, Mode::Mono, Align::Sim3);
    assert!(found.ate_rmse_m < 0.05, "{}", found.ate_rmse_m);
}
