//! Odometry at the ends of its domain: no number that is none, and a state that can be believed. Prints a table.

#![allow(clippy::unwrap_used, reason = "in a test, what is missing fails it")]

mod support;

use nalgebra::Vector3;
use support::{Run, Tracks, box_room, euroc, euroc_imu, run};
use vergence_inertial::model::ImuModel;
use vergence_inertial::motion::{Wander, WanderParams};
use vergence_slam::{Inertial, Odometry, Params, State};
use vergence_time::Timestamp;

struct Case {
    name: &'static str,
    motion: WanderParams,
    room: Vec<Vector3<f64>>,
    imu: ImuModel,
    rate_hz: f64,
    start_ns: i64,
    /// Frames that see nothing.
    blind: std::ops::Range<usize>,
    /// Frames that are missing.
    dropped: std::ops::Range<usize>,
    /// The error that must not be passed, m.
    bar_m: f64,
}

fn room(half_m: f64) -> Vec<Vector3<f64>> {
    box_room(Vector3::repeat(-half_m), Vector3::repeat(half_m), 3000, 1)
}

fn hand() -> WanderParams {
    WanderParams { way_m: 0.2, frequency_hz: 0.3, ..WanderParams::default() }
}

fn usual(name: &'static str) -> Case {
    Case {
        name,
        motion: hand(),
        room: room(3.0),
        imu: euroc_imu(3),
        rate_hz: 20.0,
        start_ns: 0,
        blind: 0..0,
        dropped: 0..0,
        bar_m: 0.02,
    }
}

fn cases() -> Vec<Case> {
    let still = |mut p: WanderParams| {
        p.way_m = 0.0;
        p
    };
    let plane = (0..2000)
        .map(|k| Vector3::new(f64::from(k % 50) * 0.2 - 5.0, f64::from(k / 50) * 0.2 - 4.0, 2.5))
        .chain(room(3.0).into_iter().map(|p| Vector3::new(p.x, p.y, 2.5)))
        .collect();
    let mut saturated = euroc_imu(3);
    saturated.gyr.saturation = 0.8;
    vec![
        usual("a room"),
        Case {
            motion: WanderParams { way_m: 0.02, ..hand() },
            room: room(0.25),
            bar_m: 0.01,
            ..usual("depth 0.1 to 0.4 m")
        },
        Case { room: room(1000.0), bar_m: f64::INFINITY, ..usual("depth 1 km") },
        Case { motion: still(hand()), bar_m: 0.02, ..usual("pure rotation") },
        Case { motion: still(hand()), room: room(1e6), bar_m: f64::INFINITY, ..usual("no parallax at all") },
        Case { room: plane, ..usual("a plane") },
        Case { dropped: 60..65, ..usual("5 dropped frames") },
        Case { blind: 60..70, bar_m: 0.05, ..usual("blind for half a second") },
        Case { imu: saturated, bar_m: 0.1, ..usual("gyroscope saturated") },
        Case { rate_hz: 10.0, ..usual("10 Hz") },
        Case { rate_hz: 120.0, ..usual("120 Hz") },
        Case { start_ns: 1_400_000_000_000_000_000, ..usual("times of 1.4e18 ns") },
        Case { room: Vec::new(), bar_m: f64::INFINITY, ..usual("nothing to see") },
    ]
}

fn drive(case: &Case) -> Run {
    let motion = Wander::new(5, &case.motion).unwrap();
    let cameras = euroc();
    let mut tracks = Tracks::new(case.room.clone(), cameras.clone(), 100, 0.5, 7);
    tracks.blind = case.blind.clone();
    tracks.dropped = case.dropped.clone();
    let unit = Inertial {
        gyr_range_rad_s: case.imu.gyr.saturation.min(Inertial::EUROC.gyr_range_rad_s),
        ..Inertial::EUROC
    };
    let params = Params { inertial: Some(unit), ..Params::default() };
    let mut odometry = Odometry::new(params, cameras.iter().map(|c| c.body_from_camera).collect());
    tracks.epoch_ns = case.start_ns;
    let start = Timestamp::from_nanos(20_000_000);
    run(&mut odometry, &motion, &case.imu, &mut tracks, start, 6.0, case.rate_hz)
}

#[test]
fn at_the_ends_of_the_domain_states_are_honest() {
    println!(
        "| case | ATE, m | worst error / sigma while tracked | tracked | coasting | lost | last sigma, m |"
    );
    println!("|---|---|---|---|---|---|---|");
    let mut wrong = Vec::new();
    for case in cases() {
        let run = drive(&case);
        let share = |state: State| {
            run.estimates.iter().filter(|e| e.state == state).count() as f64 / run.estimates.len() as f64
        };
        let errors = run.errors_m();
        let worst = run
            .estimates
            .iter()
            .zip(&errors)
            .filter(|(e, _)| e.state == State::Tracked)
            .map(|(e, error)| error / e.position_sigma_m)
            .fold(0.0, f64::max);
        let last = run.estimates.last().unwrap();
        let ate_m = run.ate_m();
        println!(
            "| {} | {ate_m:.4} | {worst:.2} | {:.0} % | {:.0} % | {:.0} % | {:.4} |",
            case.name,
            share(State::Tracked) * 100.0,
            share(State::Coasting) * 100.0,
            share(State::Lost) * 100.0,
            last.position_sigma_m
        );
        let finite = run.estimates.iter().all(|e| {
            let pose = e.world_from_body.to_homogeneous();
            pose.iter().chain(e.velocity_m_s.iter()).all(|x| x.is_finite()) && !e.position_sigma_m.is_nan()
        });
        if !finite {
            wrong.push(format!("{}: a number that is none", case.name));
        }
        if worst.is_nan() || worst >= 3.0 {
            wrong.push(format!("{}: tracked, but {worst:.2} sigmas off", case.name));
        }
        if ate_m.is_nan() || ate_m > case.bar_m {
            wrong.push(format!("{}: {ate_m} m", case.name));
        }
        if case.room.is_empty() && share(State::Tracked) > 0.0 {
            wrong.push(format!("{}: tracked", case.name));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn the_same_input_gives_the_same_bits_on_any_number_of_threads() {
    let bits = |run: &Run| -> Vec<u64> {
        run.estimates
            .iter()
            .flat_map(|e| vergence_geom::components(&e.world_from_body).map(f64::to_bits))
            .collect()
    };
    let alone = bits(&drive(&usual("alone")));
    for threads in [2, 4] {
        std::thread::scope(|scope| {
            let runs: Vec<_> =
                (0..threads).map(|_| scope.spawn(|| bits(&drive(&usual("beside others"))))).collect();
            for run in runs {
                assert!(run.join().unwrap() == alone, "{threads} threads");
            }
        });
    }
}

#[test]
fn frames_and_readings_out_of_order_are_left_out() {
    let mut odometry = Odometry::new(Params::default(), vec![nalgebra::Isometry3::identity()]);
    let at = Timestamp::from_nanos;
    let imu = |acc: f64| vergence_sense::Imu {
        gyr_rad_s: Vector3::zeros(),
        acc_m_s2: Vector3::new(0.0, acc, 0.0),
        mag_ut: None,
    };
    assert!(odometry.imu(at(10), &imu(9.8)));
    assert!(!odometry.imu(at(10), &imu(9.8)) && !odometry.imu(at(5), &imu(9.8)));
    assert!(!odometry.imu(at(20), &imu(f64::NAN)));
    let first = odometry.frame(at(1000), &[]);
    assert_eq!(odometry.frame(at(1000), &[]), first);
    assert_eq!(odometry.frame(at(500), &[]), first);
    assert_eq!(odometry.frame(at(i64::MAX), &[]).time, at(i64::MAX));
}
