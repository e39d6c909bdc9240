//! Filters over recorded motion with optical truth: what others published is what ours give, and `vergence` beats it.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod calibrated;
mod hard;
mod twin;

use std::path::PathBuf;

use nalgebra::{UnitQuaternion, Vector3};
use vergence_inertial::filter::{self, Axes, Kind, VqfParams};
use vergence_inertial::{Recording, Score, score};
use vergence_sense::Imu;
use vergence_time::Timestamp;

use twin::Twin;

/// A folder of the data; `None`, said aloud, where it is not there.
fn data(name: &str) -> Option<PathBuf> {
    let required =
        std::env::var("VERGENCE_REQUIRE").unwrap_or_default().split(',').any(|entry| entry.trim() == "data");
    let folder = std::env::var_os("VERGENCE_DATA").map(|data| PathBuf::from(data).join(name));
    let found = folder.filter(|folder| folder.is_dir());
    if found.is_none() {
        assert!(!required, "VERGENCE_REQUIRE names data, but there is no {name}");
        println!("skipped: no data (VERGENCE_DATA has no folder {name})");
    }
    found
}

/// The recordings; `None`, said aloud, where there are none.
fn trials() -> Option<Vec<(String, Recording)>> {
    let folder = data("broad")?;
    let mut paths: Vec<PathBuf> = std::fs::read_dir(&folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.to_string_lossy().ends_with(".csv.gz"))
        .collect();
    paths.sort();
    assert_eq!(paths.len(), 8, "the open trials");
    let read = |path: PathBuf| {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        (name, Recording::read(&path).unwrap())
    };
    Some(paths.into_iter().map(read).collect())
}

fn scored(recording: &Recording, orientations: Vec<UnitQuaternion<f64>>) -> Score {
    let times = recording.samples.iter().map(|(at, _)| *at);
    let estimate: Vec<_> = times.zip(orientations).collect();
    score(&recording.scored(&estimate, "estimate".as_ref()).unwrap()).unwrap()
}

fn run(kind: Kind, axes: Axes, recording: &Recording) -> Score {
    let mut filter = kind.of(recording.unit, axes, recording.period().unwrap());
    scored(recording, filter::run(filter.as_mut(), &recording.samples))
}

/// Total, heading and inclination, degrees.
fn nine(score: &Score) -> [f64; 3] {
    [score.total_rad, score.heading_rad, score.inclination_rad].map(f64::to_degrees)
}

/// Inclination, and heading and total after the start's alignment, and total after the mean's, degrees.
fn six(score: &Score) -> [f64; 4] {
    [score.inclination_rad, score.start_heading_rad, score.start_total_rad, score.mean_total_rad]
        .map(f64::to_degrees)
}

fn mean<const N: usize>(of: impl Iterator<Item = [f64; N]>) -> [f64; N] {
    let all: Vec<[f64; N]> = of.collect();
    std::array::from_fn(|i| all.iter().map(|row| row[i]).sum::<f64>() / all.len() as f64)
}

/// What the data set's own tools give may differ from ours by rounding and the start of the filter.
const PUBLISHED_DEG: f64 = 0.05;

#[test]
fn published_filters_give_the_published_figures() {
    let Some(trials) = trials() else { return };
    let all = |kind| mean(trials.iter().map(|(_, trial)| nine(&run(kind, Axes::Nine, trial))));
    for (kind, published) in [
        (Kind::Madgwick, [4.501, 3.274, 2.600]),
        (Kind::Mahony, [8.710, 7.398, 4.331]),
        (Kind::VqfBasic, [3.744, 3.525, 1.123]),
        (Kind::Vqf, [2.348, 2.191, 0.651]),
    ] {
        let found = all(kind);
        println!("9D {:12} {found:.3?}, published {published:?}", kind.name());
        for (found, published) in found.into_iter().zip(published) {
            assert!((found - published).abs() <= PUBLISHED_DEG, "{}: {found} {published}", kind.name());
        }
    }
    for (kind, published) in
        [(Kind::VqfBasic, [1.123, 11.083, 11.188, 5.846]), (Kind::Vqf, [0.651, 3.233, 3.360, 1.824])]
    {
        let found = mean(trials.iter().map(|(_, trial)| six(&run(kind, Axes::Six, trial))));
        println!("6D {:12} {found:.3?}, published {published:?}", kind.name());
        for (found, published) in found.into_iter().zip(published) {
            assert!((found - published).abs() <= PUBLISHED_DEG, "{}: {found} {published}", kind.name());
        }
    }
}

#[test]
fn vergence_beats_vqf_on_average_and_loses_on_no_trial() {
    let Some(trials) = trials() else { return };
    let mut rows = Vec::new();
    println!(
        "trial 9D total vqf | total heading inclination; 6D start vqf | inclination start-heading start mean"
    );
    for (name, trial) in &trials {
        let [vqf, ours] = [Kind::Vqf, Kind::Vergence]
            .map(|kind| (nine(&run(kind, Axes::Nine, trial)), six(&run(kind, Axes::Six, trial))));
        println!("{name:44} {:.2} | {:.2?}  {:.2} | {:.2?}", vqf.0[0], ours.0, vqf.1[2], ours.1);
        for (ours, vqf) in [(ours.0[0], vqf.0[0]), (ours.0[2], vqf.0[2]), (ours.1[2], vqf.1[2])] {
            assert!(ours <= 1.25 * vqf + 0.5, "{name}: {ours}, VQF {vqf}");
        }
        rows.push(ours);
    }
    let (nine, six) = (mean(rows.iter().map(|row| row.0)), mean(rows.iter().map(|row| row.1)));
    println!("mean 9D {nine:.3?} 6D {six:.3?}");
    assert!(nine[0] <= 2.25 && nine[2] <= 0.64, "{nine:?}");
    assert!(six[0] <= 0.64 && six[2] <= 3.2, "{six:?}");
}

#[test]
fn the_offline_variant_beats_the_causal_one_of_vqf_and_the_bar() {
    let Some(trials) = trials() else { return };
    let found = mean(trials.iter().map(|(name, trial)| {
        let all = filter::offline(trial.unit.params(), Axes::Nine, trial.period().unwrap(), &trial.samples);
        let found = nine(&scored(trial, all));
        println!("{name:44} offline {found:.2?}");
        found
    }));
    println!("mean {found:.3?}");
    assert!(found[0] <= 2.1, "{found:?}");
}

#[test]
fn the_fast_vqf_equals_its_readable_twin() {
    let Some(trials) = trials() else { return };
    // One minute with the start of movement in it; rounding differs, and no decision may fall otherwise.
    const TWINS_RAD: f64 = 1e-7;
    for (name, trial) in trials.iter().step_by(3) {
        for (kind, params) in [(Kind::Vqf, VqfParams::FULL), (Kind::VqfBasic, VqfParams::BASIC)] {
            for axes in [Axes::Six, Axes::Nine] {
                let period = trial.period().unwrap();
                let mut fast = kind.filter(axes, period);
                let mut twin = Twin::new(params, period.as_secs_f64());
                let mut worst = 0f64;
                for (at, imu) in trial.samples.iter().take(25_000) {
                    fast.update(*at, imu);
                    twin.step(
                        &imu.gyr_rad_s,
                        &imu.acc_m_s2,
                        imu.mag_ut.as_ref().filter(|_| axes == Axes::Nine),
                    );
                    worst = worst.max(fast.earth_from_sensor().angle_to(&twin.orientation()));
                }
                println!("{name} {} {axes:?}: {worst:.1e} rad", kind.name());
                assert!(worst < TWINS_RAD, "{name} {}: {worst}", kind.name());
            }
        }
    }
}

#[test]
fn a_restored_filter_continues_bit_for_bit() {
    let Some(trials) = trials() else { return };
    let (_, trial) = &trials[7];
    let period = trial.period().unwrap();
    for kind in Kind::ALL {
        let mut whole = kind.filter(Axes::Nine, period);
        let bits = |q: UnitQuaternion<f64>| q.coords.map(f64::to_bits);
        let mut seed = 9u64;
        let mut moments: Vec<usize> = (0..100)
            .map(|_| {
                seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (seed >> 33) as usize % (trial.samples.len() - 600)
            })
            .collect();
        moments.sort_unstable();
        let mut saved = Vec::new();
        let mut orientations = Vec::new();
        for (i, (at, imu)) in trial.samples.iter().enumerate() {
            for _ in moments.iter().filter(|moment| **moment == i) {
                saved.push((i, whole.save()));
            }
            whole.update(*at, imu);
            orientations.push(bits(whole.earth_from_sensor()));
        }
        assert_eq!(saved.len(), 100);
        let mut other = kind.filter(Axes::Nine, period);
        for (i, bytes) in saved {
            other.restore(&bytes).unwrap();
            assert_eq!(other.save(), bytes);
            for (j, (at, imu)) in trial.samples.iter().enumerate().skip(i).take(600) {
                other.update(*at, imu);
                assert_eq!(bits(other.earth_from_sensor()), orientations[j], "{} {i} {j}", kind.name());
            }
            assert!(other.restore(&bytes[1..]).is_err() && other.restore(&[]).is_err());
        }
    }
}

/// What the change of the score may be, at least: the resolution of the anchors. Beyond it, what VQF changes by, recording by
/// recording: where samples do not hold what happened between them, any filter's score changes. A harmonic of the phone at 99 Hz
/// becomes, in samples taken by interpolation at 100 Hz, an acceleration of 0.4 m/s² that hardly changes: 0.4° of inclination in
/// that recording, here and with VQF (which hides it in the mean by a lag that fits 100 Hz better). Samples at 120 Hz, and the
/// inclination at 100 Hz where samples are means over the period, are held to the bar in the mean: no constant depends on the rate.
const INVARIANCE_DEG: f64 = 0.05;

/// Makes a copy that should score alike.
type Copying<'a> = &'a dyn Fn(&Recording) -> Recording;

/// Linear interpolation of samples and truth at another rate.
fn resampled(recording: &Recording, rate_hz: f64) -> Recording {
    let period_ns = (1e9 / rate_hz).round() as i64;
    let last = recording.samples.last().unwrap().0.as_nanos();
    let mut other = Recording { unit: recording.unit, ..Recording::default() };
    let mut right = 1;
    for at in (0..).map(|i| i * period_ns).take_while(|at| *at <= last) {
        while recording.samples[right].0.as_nanos() < at {
            right += 1;
        }
        let ((t0, a), (t1, b)) = (recording.samples[right - 1], recording.samples[right]);
        let share = (at - t0.as_nanos()) as f64 / (t1.as_nanos() - t0.as_nanos()) as f64;
        let imu = Imu {
            gyr_rad_s: a.gyr_rad_s.lerp(&b.gyr_rad_s, share),
            acc_m_s2: a.acc_m_s2.lerp(&b.acc_m_s2, share),
            mag_ut: a.mag_ut.zip(b.mag_ut).map(|(a, b)| a.lerp(&b, share)),
        };
        other.samples.push((Timestamp::from_nanos(at), imu));
        let (before, after) = (&recording.truth[right - 1], &recording.truth[right]);
        let mut truth = if share < 0.5 { *before } else { *after };
        truth.earth_from_sensor =
            before.earth_from_sensor.zip(after.earth_from_sensor).map(|(a, b)| a.slerp(&b, share));
        other.truth.push(truth);
    }
    other
}

#[test]
fn turned_resampled_and_biased_copies_score_alike() {
    let Some(trials) = trials() else { return };
    let turn = UnitQuaternion::from_euler_angles(0.7, -1.9, 2.4);
    let turned = |recording: &Recording| {
        let mut other = recording.clone();
        for (_, imu) in &mut other.samples {
            *imu = Imu {
                gyr_rad_s: turn * imu.gyr_rad_s,
                acc_m_s2: turn * imu.acc_m_s2,
                mag_ut: imu.mag_ut.map(|mag| turn * mag),
            };
        }
        for truth in &mut other.truth {
            truth.earth_from_sensor = truth.earth_from_sensor.map(|q| q * turn.inverse());
        }
        other
    };
    let biased = |recording: &Recording, size: f64| {
        let mut other = recording.clone();
        for (_, imu) in &mut other.samples {
            imu.gyr_rad_s += Vector3::new(size, -size, size).map(f64::to_radians);
        }
        other
    };
    let mut wrong = Vec::new();
    let kinds = [Kind::Vqf, Kind::Vergence];
    type Figures = Vec<[f64; 3]>;
    let scores = |copy: &dyn Fn(&Recording) -> Recording| -> [Figures; 2] {
        let copies: Vec<Recording> = trials.iter().map(|(_, trial)| copy(trial)).collect();
        kinds.map(|kind| {
            let figures = |copy| {
                let (n, s) = (run(kind, Axes::Nine, copy), run(kind, Axes::Six, copy));
                [nine(&n)[0], six(&s)[0], six(&s)[2]]
            };
            copies.iter().map(figures).collect()
        })
    };
    let plain = scores(&Recording::clone);
    let average = |figures: &Figures| mean(figures.iter().copied());
    println!(
        "plain: vqf {:.3?} vergence {:.3?} (9D total, inclination, 6D start)",
        average(&plain[0]),
        average(&plain[1])
    );
    // The mean over each period, as of a unit that samples no faster than its readings are smooth.
    let averaged = |recording: &Recording| {
        const PARTS: usize = 16;
        let fine = resampled(recording, 100.0 * PARTS as f64);
        let mut other = Recording { unit: recording.unit, ..Recording::default() };
        for middle in (PARTS..fine.samples.len() - PARTS).step_by(PARTS) {
            let around = &fine.samples[middle - PARTS / 2..middle + PARTS / 2];
            let sum = |of: &dyn Fn(&Imu) -> Vector3<f64>| {
                around.iter().map(|(_, imu)| of(imu)).sum::<Vector3<f64>>() / PARTS as f64
            };
            let imu = Imu {
                gyr_rad_s: sum(&|imu| imu.gyr_rad_s),
                acc_m_s2: sum(&|imu| imu.acc_m_s2),
                mag_ut: Some(sum(&|imu| imu.mag_ut.unwrap())),
            };
            other.samples.push((fine.samples[middle].0, imu));
            other.truth.push(fine.truth[middle]);
        }
        other
    };
    let copies: [(&str, Copying); 8] = [
        ("turned", &turned),
        ("100 Hz, averaged", &averaged),
        ("120 Hz", &|recording| resampled(recording, 120.0)),
        ("100 Hz", &|recording| resampled(recording, 100.0)),
        ("500 Hz", &|recording| resampled(recording, 500.0)),
        ("1000 Hz", &|recording| resampled(recording, 1000.0)),
        ("biased by 1 deg/s", &|recording| biased(recording, 1.0)),
        ("biased by -1 deg/s", &|recording| biased(recording, -1.0)),
    ];
    for (name, copy) in copies {
        let found = scores(copy);
        // Of the averages, and the average of how much each recording changes.
        let changes = [0, 1].map(|kind| {
            let changed = found[kind].iter().zip(&plain[kind]);
            let each: [f64; 3] =
                mean(changed.map(|(now, before)| std::array::from_fn(|i| (now[i] - before[i]).abs())));
            let (now, before) = (average(&found[kind]), average(&plain[kind]));
            (std::array::from_fn::<f64, 3, _>(|i| now[i] - before[i]), each)
        });
        let [(vqf, vqf_each), (ours, ours_each)] = changes;
        println!(
            "{name}: changes of the average, vqf {vqf:.3?} vergence {ours:.3?}; of each, {vqf_each:.3?} {ours_each:.3?}"
        );
        for (trial, ((name_of, _), now)) in trials.iter().zip(&found[1]).enumerate() {
            let change = |kind: usize, i: usize| found[kind][trial][i] - plain[kind][trial][i];
            for (i, figure) in ["9D total", "inclination", "6D start"].iter().enumerate() {
                let (vqf, ours) = (change(0, i), change(1, i));
                if ours > INVARIANCE_DEG.max(vqf.abs()) {
                    println!("    {name_of} {figure}: {ours:+.3} to {:.3}, vqf {vqf:+.3}", now[i]);
                }
            }
        }
        for i in 0..3 {
            let most = INVARIANCE_DEG.max(vqf[i].abs());
            let aliased = name == "100 Hz" && ours_each[i] <= INVARIANCE_DEG.max(vqf_each[i]);
            // What averaging takes from the amplitude of a turn is a scale factor, and drift: only what aliases is asked about.
            let of_another_motion = name == "100 Hz, averaged" && i != 1;
            if ours[i] > most && !aliased && !of_another_motion {
                wrong.push(format!("{name}, figure {i}: changes by {:.3}, VQF by {:.3}", ours[i], vqf[i]));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
