//! Odometry on simulated tracks along true flights.

#![allow(clippy::unwrap_used, reason = "in a test, what is missing fails it")]

mod support;

use nalgebra::{UnitQuaternion, Vector3};
use support::{Run, Tracks, box_room, euroc, euroc_imu, run, skip, tum};
use vergence_geom::Rigid;
use vergence_inertial::motion::{Motion, Wander, WanderParams};
use vergence_inertial::spline::SplineMotion;
use vergence_slam::{Odometry, Params, State};
use vergence_time::{Span, Timestamp};

fn motion(name: &str) -> Option<SplineMotion> {
    let folder = std::env::var_os("VERGENCE_DATA")?;
    let path = std::path::Path::new(&folder).join("trajectories").join(name);
    if !path.is_file() {
        return None;
    }
    let poses = tum(&path);
    // From zero, so that the model's sample numbers are small.
    let first = poses[0].0;
    let poses: Vec<(Timestamp, Rigid)> = poses
        .into_iter()
        .map(|(t, p)| (Timestamp::from_nanos(t.since(first).unwrap().as_nanos()), p))
        .collect();
    SplineMotion::new(&poses, Span::from_millis(50))
}

fn room(motion: &SplineMotion) -> Vec<Vector3<f64>> {
    let (mut low, mut high) = (Vector3::repeat(f64::MAX), Vector3::repeat(f64::MIN));
    let mut t = motion.start();
    while t < motion.end() {
        let p = motion.at(t).world_from_body.translation.vector;
        (low, high) = (low.inf(&p), high.sup(&p));
        t = t.saturating_add(Span::from_millis(100));
    }
    box_room(low.add_scalar(-2.0), high.add_scalar(2.0), 3000, 1)
}

/// Stereo-inertial along `motion`: true tracks with 1 px of noise, EuRoC's cameras and unit.
fn stereo_inertial(motion: &SplineMotion, seconds: f64) -> Run {
    let cameras = euroc();
    let mut tracks = Tracks::new(room(motion), cameras.clone(), 150, 1.0, 7);
    let params = Params { pixel_px: 1.0, ..Params::default() };
    let mut odometry = Odometry::new(params, cameras.iter().map(|c| c.body_from_camera).collect());
    run(&mut odometry, motion, &euroc_imu(3), &mut tracks, motion.start(), seconds, 20.0)
}

/// One camera and the unit along `motion` from `from_s` on: half a pixel of noise.
fn mono_inertial(motion: &SplineMotion, from_s: i64, seconds: f64) -> Run {
    let cameras = euroc()[..1].to_vec();
    let mut tracks = Tracks::new(room(motion), cameras.clone(), 120, 0.5, 7);
    let mut odometry = Odometry::new(Params::default(), cameras.iter().map(|c| c.body_from_camera).collect());
    let from = motion.start().saturating_add(Span::from_millis(1000 * from_s));
    run(&mut odometry, motion, &euroc_imu(3), &mut tracks, from, seconds, 20.0)
}

/// Seen: 0.030, 0.066 and 0.010 m, provisional poses included, and the scale within 0.5 % on all of them.
#[test]
fn true_flights_with_one_camera() {
    for (name, from_s, bar_m) in [
        ("V1_02_medium.tum.txt", 20, 0.06),
        ("MH_03_medium.tum.txt", 30, 0.12),
        ("dataset-room1_512_16.tum.txt", 31, 0.03),
    ] {
        let Some(motion) = motion(name) else { return skip("no trajectories") };
        let run = mono_inertial(&motion, from_s, 10.0);
        run.print(&format!("{name} from {from_s} s"));
        let length = |place: &dyn Fn(usize) -> Vector3<f64>| -> f64 {
            (100..run.truth.len()).map(|k| (place(k) - place(k - 1)).norm()).sum()
        };
        let found = length(&|k| run.estimates[k].world_from_body.translation.vector);
        let scale = found / length(&|k| run.truth[k].translation.vector);
        println!("scale after 5 s {scale:.4}");
        assert!((scale - 1.0).abs() < 0.02, "{name}: {scale}");
        assert!(run.ate_m() < bar_m, "{name}: {} m", run.ate_m());
        assert!(run.estimates.iter().all(|e| e.state != State::Lost));
        let tracked = run.estimates.iter().position(|e| e.state == State::Tracked).unwrap();
        assert!(tracked <= 40, "{name}: tracked after {tracked} frames");
    }
}

/// A slow slide: corners move by a tenth of a pixel from one frame to the next. Seen: 0.2 mm; 1.5 mm where two frames alone say what stands.
#[test]
fn what_creeps_does_not_stand_still() {
    let upright = UnitQuaternion::rotation_between(&Vector3::x(), &Vector3::z()).unwrap();
    let pose = |t: f64| Rigid::from_parts(Vector3::new(0.015 * t, 0.004 * t, 1.4).into(), upright);
    let poses: Vec<_> =
        (0..300).map(|k| (Timestamp::from_nanos(k * 50_000_000), pose(k as f64 * 0.05))).collect();
    let motion = SplineMotion::new(&poses, Span::from_millis(50)).unwrap();
    let cameras = euroc();
    let mut tracks = Tracks::new(room(&motion), cameras.clone(), 150, 0.1, 7);
    let mut odometry = Odometry::new(Params::default(), cameras.iter().map(|c| c.body_from_camera).collect());
    let from = motion.start().saturating_add(Span::from_millis(1000));
    let run = run(&mut odometry, &motion, &euroc_imu(3), &mut tracks, from, 12.0, 20.0);
    run.print("creeping");
    assert!(run.ate_m() < 0.001, "{} m", run.ate_m());
}

/// Over the whole 80 s (VERGENCE_SLAM_LONG=1): 0.0102, 0.0164, 0.0220, 0.0067 m. A peer's simulator of the same kind
/// (OpenVINS) has 0.034, 0.012 and 0.025 m on the first three.
#[test]
fn true_flights_with_a_pixel_of_noise() {
    let long = std::env::var_os("VERGENCE_SLAM_LONG").is_some();
    for (name, seconds, bar_m) in [
        ("V1_01_easy.tum.txt", 20.0, 0.02),
        ("V1_02_medium.tum.txt", 12.0, 0.025),
        ("MH_03_medium.tum.txt", 12.0, 0.03),
        ("dataset-room1_512_16.tum.txt", 12.0, 0.015),
    ] {
        let Some(motion) = motion(name) else { return skip("no trajectories") };
        let length = motion.end().since(motion.start()).unwrap().as_secs_f64().min(80.0);
        let run = stereo_inertial(&motion, if long { length } else { seconds });
        run.print(name);
        assert!(run.ate_m() < bar_m, "{name}: {} m", run.ate_m());
        assert!(run.estimates.iter().all(|e| e.state != State::Lost));
        // Gravity within two seconds, whether it starts in motion or not.
        let tracked = run.estimates.iter().position(|e| e.state == State::Tracked).unwrap();
        assert!(tracked <= 40, "{name}: tracked after {tracked} frames");
    }
}

#[test]
fn a_made_up_motion_without_any_data() {
    let wander =
        Wander::new(5, &WanderParams { way_m: 0.3, frequency_hz: 0.3, ..WanderParams::default() }).unwrap();
    let poses: Vec<_> = (0..300)
        .map(|k| Timestamp::from_nanos(k * 50_000_000))
        .map(|t| (t, wander.at(t).world_from_body))
        .collect();
    let run = stereo_inertial(&SplineMotion::new(&poses, Span::from_millis(50)).unwrap(), 10.0);
    run.print("made up");
    assert!(run.ate_m() < 0.012, "{}", run.ate_m());
}
