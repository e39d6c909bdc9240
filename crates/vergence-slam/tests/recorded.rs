//! Odometry on recorded and half-real data.

#![allow(clippy::unwrap_used, reason = "in a test, what is missing fails it")]

mod support;

use nalgebra::Vector3;
use support::{Run, cpu_ms, recording, skip};
use vergence_geom::{Distortion, Lens, Rigid};
use vergence_slam::dataset::{Dataset, Picture};
use vergence_slam::evaluate::{Align, Evaluation, evaluate};
use vergence_slam::follower::Follower;
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
    // Slow and even: it takes ten seconds to know the scale. Seen: 0.034 m, 1.015.
    let (_, found) = follow(&dataset, Mode::MonoInertial, Align::Se3);
    assert!(found.ate_rmse_m < 0.05 && (found.scale - 1.0).abs() < 0.04, "{}", found.ate_rmse_m);
    let (_, found) = follow(&dataset, Mode::Mono, Align::Sim3);
    assert!(found.ate_rmse_m < 0.05, "{}", found.ate_rmse_m);
}

/// One camera that begins anywhere in the flight, at 0.1 to 0.4 m/s. Seen: 14 to 27 mm over six seconds, provisional poses included; where the
/// way that looks the same the other way round is not tried, 2.1 m and 0.2 m from the last two on.
#[test]
fn one_camera_begins_in_motion() {
    let Some(folder) = recording("half_real_v101_14s") else { return skip("no half-real flight") };
    let whole = Dataset::open(&folder).unwrap();
    for begin in [50, 75, 100, 125] {
        let mut part = whole.clone();
        part.frames = part.frames[begin..begin + 120].to_vec();
        let first = part.frames[0].at;
        let samples = &mut part.inertial.as_mut().unwrap().samples;
        samples.retain(|(at, _)| at.since(first).is_some_and(|since| since.as_secs_f64() > -0.06));
        let (run, found) = follow(&part, Mode::MonoInertial, Align::Se3);
        assert!(found.ate_rmse_m < 0.045, "from frame {begin}: {} m", found.ate_rmse_m);
        let tracked = run.estimates.iter().position(|e| e.state == State::Tracked).unwrap();
        assert!(tracked <= 40, "from frame {begin}: tracked after {tracked} frames");
    }
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

/// The first seconds of the flight with a calibration whose cameras are turned; what is said of it.
fn turned(
    dataset: &Dataset,
    turns: [Vector3<f64>; 2],
    frames: usize,
    mode: Mode,
    check_mounting: bool,
) -> Option<vergence_slam::Misfit> {
    let mut dataset = dataset.clone();
    for (camera, turn) in dataset.cameras.iter_mut().zip(turns) {
        camera.body_from_camera *= Rigid::rotation(turn);
    }
    let params = Params { check_mounting, ..Params::default() };
    let mut playback = Playback::new(&dataset, mode, TrackerKnobs::default(), params).unwrap();
    for frame in 0..frames {
        let loaded = Playback::load(&dataset, mode, frame).unwrap();
        match playback.follow(frame, &loaded) {
            Ok(_) => {}
            Err(vergence_slam::Error::Mounting { misfit, .. }) => {
                println!("frame {frame}: {misfit}");
                return Some(misfit);
            }
            Err(error) => panic!("{error}"),
        }
    }
    println!("{turns:?}: nothing is said");
    None
}

#[test]
fn cameras_that_sit_otherwise_are_named() {
    let Some(folder) = recording("half_real_v101_14s") else { return skip("no half-real flight") };
    let dataset = Dataset::open(&folder).unwrap();
    let none = Vector3::zeros();
    for turn in [Vector3::y() * 0.09, Vector3::x() * -0.3, Vector3::z() * std::f64::consts::PI] {
        let said =
            turned(&dataset, [none, turn], 40, Mode::Stereo, true).expect("the second camera is turned");
        assert_eq!((said.camera, said.beside), (1, Some(0)));
        assert!((said.turned_rad - turn.norm()).abs() < 0.04, "{said} for {turn}");
    }
    // Against the gyroscope it takes turns about two axes.
    for turn in
        [Vector3::y() * 0.5, Vector3::z() * std::f64::consts::FRAC_PI_2, Vector3::x() * std::f64::consts::PI]
    {
        let said =
            turned(&dataset, [turn, none], 280, Mode::MonoInertial, true).expect("the camera is turned");
        assert_eq!((said.camera, said.beside), (0, None));
        assert!((said.turned_rad - turn.norm()).abs() < 0.06, "{said} for {turn}");
    }
    assert_eq!(turned(&dataset, [none, none], 60, Mode::StereoInertial, true), None);
    // A baseline that points the wrong way: the calibrations of two cameras in each other's place.
    let mut swapped = dataset.clone();
    swapped.cameras.swap(0, 1);
    let said = turned(&swapped, [none, none], 40, Mode::Stereo, true).expect("they are swapped");
    assert!(said.turned_rad > 1.5, "{said}");
    // Transforms the wrong way round.
    let mut inverted = dataset.clone();
    inverted
        .cameras
        .iter_mut()
        .for_each(|camera| camera.body_from_camera = camera.body_from_camera.inverse());
    let said = turned(&inverted, [none, none], 40, Mode::Stereo, true).expect("they are inverted");
    assert!(said.inverted && said.to_string().contains("inverted extrinsics"), "{said}");
    // Who knows better can have it left alone.
    assert_eq!(turned(&swapped, [none, none], 40, Mode::Stereo, false), None);
}

#[test]
fn a_map_that_begins_after_a_loss_is_another_one() {
    let Some(folder) = recording("half_real_v101_14s") else { return skip("no half-real flight") };
    let dataset = Dataset::open(&folder).unwrap();
    let black = Picture { width: 752, height: 480, pixels: vec![0; 752 * 480] };
    let mut follower = Follower::new(
        &dataset.root,
        &dataset.rig(),
        Mode::Stereo,
        TrackerKnobs::default(),
        Params::default(),
        1,
    )
    .unwrap();
    let mut estimates = Vec::new();
    for frame in 0..60 {
        for camera in 0..2 {
            let taken = if (30..40).contains(&frame) {
                black.clone()
            } else {
                dataset.picture(frame, camera).unwrap()
            };
            follower.picture(camera, dataset.frames[frame].at, taken);
        }
        estimates.push(follower.follow().unwrap().unwrap());
    }
    assert!(estimates[..30].iter().all(|e| e.map == 0 && e.state != State::Lost));
    assert!(estimates[32..40].iter().all(|e| e.state == State::Lost), "{:?}", estimates[35].state);
    assert!(estimates[42..].iter().all(|e| e.map == 1 && e.state == State::Tracked));
    println!("sigma {} m before, {} m after", estimates[29].position_sigma_m, estimates[59].position_sigma_m);
    // How far it went meanwhile nobody knows.
    assert!(estimates[29].position_sigma_m < 0.05 && estimates[59].position_sigma_m > 0.3);
}

/// The beginning of the flight, with other pictures in a part of it; errors after alignment up to each of `until` frames, and the states.
fn disturbed(
    dataset: &Dataset,
    frames: usize,
    part: std::ops::Range<usize>,
    picture: impl Fn(usize, usize) -> Picture,
    until: &[usize],
) -> (Vec<f64>, Vec<State>) {
    let (knobs, params) = (TrackerKnobs::default(), Params::default());
    let mode = Mode::StereoInertial;
    let mut follower = Follower::new(&dataset.root, &dataset.rig(), mode, knobs, params, 1).unwrap();
    for (at, imu) in &dataset.inertial.as_ref().unwrap().samples {
        follower.imu(*at, imu);
    }
    let mut estimates = Vec::new();
    for frame in 0..frames {
        for camera in 0..2 {
            let taken = if part.contains(&frame) {
                picture(frame, camera)
            } else {
                dataset.picture(frame, camera).unwrap()
            };
            follower.picture(camera, dataset.frames[frame].at, taken);
        }
        estimates.push(follower.follow().unwrap().unwrap());
    }
    let errors = until.iter().map(|until| {
        let poses = estimates[..*until].iter().map(|e| (e.time, z_up(&e.world_from_body))).collect();
        let found = evaluate(&Trajectory { poses }, dataset.truth.as_ref().unwrap(), Align::Se3).unwrap();
        found.ate_max_m
    });
    (errors.collect(), estimates.iter().map(|e| e.state).collect())
}

/// The beginning of the flight with other lenses; states.
fn behind(dataset: &Dataset, lens: impl Fn(&Lens) -> Lens, frames: usize) -> Vec<State> {
    let mut dataset = dataset.clone();
    dataset.cameras.iter_mut().for_each(|camera| camera.lens = lens(&camera.lens));
    let (knobs, params) = (TrackerKnobs::default(), Params { check_mounting: false, ..Params::default() });
    let mut playback = Playback::new(&dataset, Mode::StereoInertial, knobs, params).unwrap();
    let follow = |frame| {
        playback.follow(frame, &Playback::load(&dataset, Mode::StereoInertial, frame).unwrap()).unwrap().state
    };
    (0..frames).map(follow).collect()
}

#[test]
fn a_lens_that_did_not_take_the_pictures_is_not_trusted() {
    let Some(folder) = recording("half_real_v101_14s") else { return skip("no half-real flight") };
    let dataset = Dataset::open(&folder).unwrap();
    let none = Distortion::Radtan { radial: [0.0; 3], tangential: [0.0; 2] };
    let of = |lens: &Lens, share: f64, distortion| {
        let (focal, centre) = (lens.focal_px() * share, lens.centre_px());
        Lens::new([focal.x, focal.y], [centre.x, centre.y], distortion).unwrap()
    };
    for (share, without) in [(1.0, true), (0.9, false)] {
        let states =
            behind(&dataset, |lens| of(lens, share, if without { none } else { lens.distortion() }), 60);
        let tracked = states.iter().filter(|state| **state == State::Tracked).count();
        println!("focal length times {share}, distortion left out: {without}: {tracked} of 60 tracked");
        assert!(tracked < 30 && states[30..].iter().all(|state| *state == State::Disagreeing), "{states:?}");
    }
    let black = |_, _| Picture { width: 752, height: 480, pixels: vec![0; 752 * 480] };
    let (_, states) = disturbed(&dataset, 40, 0..40, black, &[]);
    assert!(states[5..].iter().all(|state| *state == State::FindingCorners), "{states:?}");
}

#[test]
fn pictures_that_freeze_or_go_black_are_bridged() {
    let Some(folder) = recording("half_real_v101_14s") else { return skip("no half-real flight") };
    let dataset = Dataset::open(&folder).unwrap();
    let (errors, states) =
        disturbed(&dataset, 80, 40..52, |_, camera| dataset.picture(39, camera).unwrap(), &[40, 52, 80]);
    println!("frozen: {errors:?} m, {:?}", &states[38..55]);
    assert!(states[40..52].iter().all(|state| *state == State::Coasting), "{:?}", &states[40..52]);
    assert!(errors[2] < 0.06, "{errors:?}");
    let black = |_, _| Picture { width: 752, height: 480, pixels: vec![0; 752 * 480] };
    let (errors, states) = disturbed(&dataset, 80, 40..52, black, &[40, 46, 52, 80]);
    println!("black: {errors:?} m, {:?}", &states[38..55]);
    assert!(states[41..52].iter().all(|state| *state == State::Coasting), "{:?}", &states[40..52]);
    // No jump when the last frame that saw something grows old.
    assert!(errors[1] < 0.015 && errors[3] < 0.06, "{errors:?}");
}
