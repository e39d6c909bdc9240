//! Starts and surroundings that the recordings do not have by themselves: in motion, in flight, with a strong magnet.

use nalgebra::Vector3;
use vergence_geom::slerp;
use vergence_inertial::filter::{self, Axes, Kind};
use vergence_inertial::{Recording, Score, read_tum_orientations, score};

use super::{data, mean, nine, run, six, trials};

/// What a start in motion may cost more than VQF's does, as a factor.
const LIKE_VQF: f64 = 1.1;

#[test]
fn a_start_in_motion_is_no_worse_than_that_of_vqf() {
    let Some(trials) = trials() else { return };
    for from_s in [55.0, 75.0] {
        let cut = trials.iter().map(|(_, trial)| {
            let mut cut = trial.clone();
            let first = cut.samples.partition_point(|(at, _)| at.as_nanos() < (from_s * 1e9) as i64);
            cut.samples.drain(..first);
            cut.truth.drain(..first);
            cut
        });
        let cut: Vec<Recording> = cut.collect();
        let [vqf, ours] = [Kind::Vqf, Kind::Vergence]
            .map(|kind| mean(cut.iter().map(|cut| six(&run(kind, Axes::Six, cut)))));
        println!("from {from_s} s on, in motion: vqf {vqf:.3?} vergence {ours:.3?}");
        let [vqf_nine, ours_nine] = [Kind::Vqf, Kind::Vergence]
            .map(|kind| mean(cut.iter().map(|cut| nine(&run(kind, Axes::Nine, cut)))));
        println!("the same with magnetometer: vqf {vqf_nine:.3?} vergence {ours_nine:.3?}");
        assert!(ours[0] <= LIKE_VQF * vqf[0] && ours[2] <= LIKE_VQF * vqf[2], "{ours:?} {vqf:?}");
        // The heading is found more slowly than by VQF: an uneven field and a wrong tilt look alike.
        assert!(ours_nine[0] <= 1.25 * vqf_nine[0] + 0.5, "{ours_nine:?} {vqf_nine:?}");
    }
}

/// Of a filter over a flight from `from_s` seconds on, without `bias`, against its trajectory.
fn flown(kind: Kind, flight: &Recording, truth: &[Stamped], from_s: usize, bias: &Vector3<f64>) -> Score {
    let mut flight = flight.clone();
    flight.samples.drain(..from_s * 200);
    for (_, imu) in &mut flight.samples {
        imu.gyr_rad_s -= bias;
    }
    let found =
        filter::run(kind.of(flight.unit, Axes::Six, flight.period().unwrap()).as_mut(), &flight.samples);
    let pair = |(time, truth): &Stamped| {
        let after = flight.samples.partition_point(|(at, _)| at < time);
        let before = after.checked_sub(1)?;
        let (from, to) = (flight.samples[before].0, flight.samples.get(after)?.0);
        let part = time.since(from)?.as_secs_f64() / to.since(from)?.as_secs_f64();
        Some((*time, slerp(&found[before], &found[after], part), *truth))
    };
    score(&truth.iter().filter_map(pair).collect::<Vec<_>>()).unwrap()
}

type Stamped = (vergence_time::Timestamp, nalgebra::UnitQuaternion<f64>);

#[test]
fn a_drone_is_followed_from_rest_with_any_bias_and_from_the_air() {
    let Some(folder) = data("slam/euroc_v101_start") else { return };
    let flight = Recording::read(&folder.join("mav0/imu0")).unwrap();
    let truth = read_tum_orientations(&folder.join("gt_vicon2gt_20hz_tum.txt")).unwrap();
    // The unit's own is 4.5 deg/s about the vertical.
    let rest = six(&flown(Kind::Vergence, &flight, &truth, 0, &Vector3::zeros()));
    println!("from rest, with its bias: {rest:.3?}");
    assert!(rest[0] <= 1.4 && rest[2] <= 3.2, "{rest:?}");
    let bias = Vector3::new(-0.0022, 0.02051, 0.07788);
    let mut inclinations = Vec::new();
    for from_s in [0, 20, 30, 40, 55, 70] {
        let [vqf, ours] =
            [Kind::Vqf, Kind::Vergence].map(|kind| six(&flown(kind, &flight, &truth, from_s, &bias)));
        println!("from {from_s} s on, in the air: vqf {vqf:.3?} vergence {ours:.3?}");
        assert!(ours[0] <= 1.25 * vqf[0] && ours[2] <= 1.25 * vqf[2], "{from_s}: {ours:?} {vqf:?}");
        inclinations.push([vqf[0], ours[0]]);
    }
    let [vqf, ours] = mean(inclinations.into_iter());
    println!("mean inclination: vqf {vqf:.3} vergence {ours:.3}");
    assert!(ours <= 1.1 * vqf, "{ours} {vqf}");
    // With its bias, which is not known in the air.
    for from_s in [20, 40, 70] {
        let of = |kind| six(&flown(kind, &flight, &truth, from_s, &Vector3::zeros()))[0];
        let [vqf, madgwick, ours] = [Kind::Vqf, Kind::Madgwick, Kind::Vergence].map(of);
        println!("from {from_s} s on, with its bias: vqf {vqf:.3} madgwick {madgwick:.3} vergence {ours:.3}");
        assert!(ours <= madgwick.min(vqf), "{from_s}: {ours} {madgwick} {vqf}");
    }
}

#[test]
fn half_a_minute_from_the_middle_of_motion_is_better_than_that_of_vqf() {
    let Some(trials) = trials() else { return };
    for from_s in [62, 84, 106] {
        let cut = |kind, axes| {
            mean(trials.iter().map(|(_, trial)| {
                let mut cut = trial.clone();
                let at = |s: i64| trial.samples.partition_point(|(at, _)| at.as_nanos() < s * 1_000_000_000);
                let (first, last) = (at(from_s), at(from_s + 30));
                cut.samples = trial.samples[first..last].to_vec();
                cut.truth = trial.truth[first..last].to_vec();
                let score = run(kind, axes, &cut);
                [score.inclination_rad, score.start_total_rad, score.total_rad].map(f64::to_degrees)
            }))
        };
        let [vqf, madgwick, ours] = [Kind::Vqf, Kind::Madgwick, Kind::Vergence]
            .map(|kind| (cut(kind, Axes::Six), cut(kind, Axes::Nine)));
        println!("{from_s} s: 6D vqf {:.3?} madgwick {:.3?} vergence {:.3?}", vqf.0, madgwick.0, ours.0);
        println!("      9D vqf {:.3?} madgwick {:.3?} vergence {:.3?}", vqf.1, madgwick.1, ours.1);
        for other in [vqf, madgwick] {
            assert!(ours.0[0] <= other.0[0] && ours.1[2] <= other.1[2], "{from_s}");
        }
    }
}

#[test]
fn a_strong_magnet_that_is_attached_is_learned_and_unlearned() {
    let Some(trials) = trials() else { return };
    // Attached two seconds before the movement, taken off a minute into it, as in the recordings that have one; ours errs by 2 to 5
    // degrees with any, VQF by 21 to 59.
    for (strength_ut, most) in [(15.0, 3.0), (45.0, 3.6), (150.0, 5.5)] {
        let found = mean(trials.iter().map(|(_, trial)| {
            let mut trial = trial.clone();
            let first = trial.truth.iter().position(|truth| truth.movement).unwrap() as f64;
            for (i, (_, imu)) in trial.samples.iter_mut().enumerate() {
                let (on, off) = ((i as f64 - (first - 600.0)) / 150.0, (first + 16_000.0 - i as f64) / 150.0);
                let near = on.clamp(0.0, 1.0) * off.clamp(0.0, 1.0);
                imu.mag_ut =
                    imu.mag_ut.map(|mag| mag + Vector3::new(0.6, -0.64, 0.48) * (strength_ut * near));
            }
            nine(&run(Kind::Vergence, Axes::Nine, &trial))
        }));
        println!("magnet of {strength_ut} uT: {found:.3?}");
        assert!(found[0] <= most, "{strength_ut} uT: {found:?}");
    }
}
