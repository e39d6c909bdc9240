use vergence_geom::exp;
use vergence_time::Span;

use super::*;
use crate::model::{ImuModel, Triad};
use crate::motion::{Earth, Motion, Wander, WanderParams};

/// A unit with known errors, turned by hand between rests for two minutes.
fn unit(seed: u64) -> ImuModel {
    let mut model = ImuModel::consumer(200.0, seed);
    model.gyr.bias = Vector3::new(0.02, -0.05, 0.011);
    model.gyr.bias_walk = 0.0;
    model.acc = Triad {
        scale: Matrix3::new(1.02, 0.004, -0.012, -0.003, 0.985, 0.006, 0.008, 0.002, 1.007),
        bias: Vector3::new(0.3, -0.2, 0.1),
        bias_walk: 0.0,
        ..model.acc
    };
    model.mag = model.mag.map(|mag| Triad {
        scale: Matrix3::new(1.1, 0.03, -0.02, 0.05, 0.95, 0.01, -0.01, 0.04, 0.99),
        bias: Vector3::new(20.0, -35.0, 8.0),
        ..mag
    });
    model
}

fn recorded(model: &ImuModel, tilt_rad: f64, seconds: i64) -> Vec<(Timestamp, Imu)> {
    let rests = (0..seconds / 4).map(|k| (4.0 * k as f64, 4.0 * k as f64 + 1.9)).collect();
    let params = WanderParams {
        tilt_rad,
        turn_rad: 1.5,
        way_m: 0.05,
        frequency_hz: 0.35,
        rests_s: rests,
        ramp_s: 0.4,
    };
    let motion = Wander::new(model.seed + 100, &params).unwrap();
    model
        .record(&motion, &Earth::MID_LATITUDE, Span::from_millis(seconds * 1000))
        .map(|s| (s.captured, s.value))
        .collect()
}

/// Errors in standard deviations: of the gyroscope, the accelerometer, the magnetometer.
fn deviations(seed: u64) -> (Vec<f64>, Calibration) {
    let model = unit(seed);
    let earth = Earth::MID_LATITUDE;
    let params =
        CalibrateParams { gravity_m_s2: earth.gravity_m_s2.norm(), field_ut: Some(earth.field_ut.norm()) };
    let found = calibrate(&recorded(&model, 1.6, 160), &params).unwrap();
    let mut all: Vec<f64> =
        (0..3).map(|i| (found.gyr_bias_rad_s[i] - model.gyr.bias[i]) / found.gyr_bias_sd_rad_s[i]).collect();
    let mag = (found.magnetometer.unwrap(), model.mag.unwrap());
    for (found, truth) in [(found.accelerometer, model.acc), mag] {
        for i in 0..3 {
            all.push((found.offset[i] - truth.bias[i]) / found.offset_sd[i]);
            for j in 0..3 {
                all.push((found.matrix[i][j] - truth.scale[(i, j)]) / found.matrix_sd[i][j]);
            }
        }
    }
    (all, found)
}

#[test]
fn known_errors_are_found_within_three_standard_deviations() {
    let mut all = Vec::new();
    for seed in 1..=8 {
        let (found, calibration) = deviations(seed);
        println!("{seed}: {found:.1?}");
        assert!(calibration.not_observed.is_empty(), "{:?}", calibration.not_observed);
        let acc = calibration.accelerometer;
        assert!(acc.offset_sd.iter().all(|sd| *sd < 0.01) && acc.matrix_sd[0][0] < 2e-3, "{acc:?}");
        assert!(calibration.magnetometer.unwrap().offset_sd.iter().all(|sd| *sd < 0.2));
        all.extend(found);
    }
    let within = all.iter().filter(|d| d.abs() <= 3.0).count() as f64 / all.len() as f64;
    // Of normal errors, 99.7 in 100 are.
    assert!(within >= 0.99, "{within} of {}", all.len());
    // And the standard deviations are not simply too large.
    let mean_square = all.iter().map(|d| d * d).sum::<f64>() / all.len() as f64;
    assert!((0.4..1.6).contains(&mean_square), "{mean_square}");
}

#[test]
fn a_recording_that_only_lies_there_says_what_it_could_not_see() {
    let model = unit(3);
    let found = calibrate(&recorded(&model, 0.0, 40)[..380], &CalibrateParams::default()).unwrap();
    let said = found.not_observed.join("\n");
    for what in [
        "accelerometer: offset along x",
        "accelerometer: scale along",
        "accelerometer: rotation",
        "magnetometer: nothing",
    ] {
        assert!(said.contains(what), "{what}: {said}");
    }
    assert!((found.gyr_bias_rad_s[1] + 0.05).abs() < 1e-3);
    is_usual(&found.accelerometer);
    assert_eq!(found.magnetometer, None);
}

/// What was not seen is exactly as it was.
fn is_usual(triad: &TriadCalibration) {
    assert_eq!((triad.offset, triad.matrix()), ([0.0; 3], Matrix3::identity()));
}

#[test]
fn rests_about_one_axis_only_change_nothing() {
    // Upright all the time, turned about the vertical: only the sum of offset and scale along it is told, and that of offset
    // and rotation across it.
    let found = calibrate(&recorded(&unit(4), 0.0, 160), &CalibrateParams::default()).unwrap();
    assert!(found.rests > 10, "{found:?}");
    is_usual(&found.accelerometer);
    // Turned about one axis of the sensor, x, only: what belongs to x stays, and so does what may come of it.
    let model = unit(5);
    let mut samples = Vec::new();
    for step in 0..24 * 800u64 {
        let (rest, at) = (step / 800, step % 800);
        let turned = rest as f64 + (at as f64 - 600.0).max(0.0) / 200.0;
        let rate = if at > 600 { 0.4 } else { 0.0 };
        let truth = exp(&(Vector3::x() * (0.4 * turned))).inverse() * Vector3::z() * 9.80665;
        let noise = |axis: u64| crate::dice::Dice::new(7, axis).normal(step) * 0.01;
        let imu = Imu {
            gyr_rad_s: Vector3::x() * rate,
            acc_m_s2: model.acc.scale * truth + model.acc.bias + Vector3::new(noise(0), noise(1), noise(2)),
            mag_ut: None,
        };
        samples.push((Timestamp::from_nanos(step as i64 * 5_000_000), imu));
    }
    let found = calibrate(&samples, &CalibrateParams::default()).unwrap();
    let said = found.not_observed.join("\n");
    assert!(said.contains("offset along x") && said.contains("scale along x"), "{said}");
    is_usual(&found.accelerometer);
}

/// A recording in a room whose field differs by `share` of its strength from place to place.
fn in_a_room(model: &ImuModel, seed: u64, share: f64) -> Vec<(Timestamp, Imu)> {
    let rests = (0..30).map(|k| (6.0 * f64::from(k), 6.0 * f64::from(k) + 3.9)).collect();
    let params = WanderParams {
        tilt_rad: 1.6,
        turn_rad: 1.5,
        way_m: 0.15,
        frequency_hz: 0.35,
        rests_s: rests,
        ramp_s: 0.4,
    };
    let motion = Wander::new(seed, &params).unwrap();
    let dice = crate::dice::Dice::new(seed, 9);
    let earth = Earth::MID_LATITUDE;
    model
        .record(&motion, &earth, Span::from_millis(180_000))
        .map(|s| {
            let place = motion.at(s.captured).world_from_body.translation.vector;
            let wave = |k: u64| {
                let along = Vector3::new(dice.normal(4 * k), dice.normal(4 * k + 1), dice.normal(4 * k + 2));
                (8.0 * along.dot(&place) + 6.0 * dice.uniform(4 * k + 3)).sin()
            };
            let uneven = 1.0 + share * (0..3).map(wave).sum::<f64>() * (2.0f64 / 3.0).sqrt();
            let mag = s.value.mag_ut.unwrap();
            let bias = model.mag.unwrap().bias;
            (s.captured, Imu { mag_ut: Some((mag - bias) * uneven + bias), ..s.value })
        })
        .collect()
}

#[test]
fn the_deviations_hold_in_an_uneven_field_too() {
    let params =
        CalibrateParams { field_ut: Some(Earth::MID_LATITUDE.field_ut.norm()), ..Default::default() };
    let mut all = Vec::new();
    for seed in 1..=10 {
        let mut model = ImuModel { rate_hz: 50.0, ..unit(seed) };
        let mut truth = model.mag.unwrap();
        // Symmetric, so that the rests do not matter.
        truth.scale = Matrix3::new(1.1, 0.03, -0.02, 0.03, 0.95, 0.01, -0.02, 0.01, 0.99);
        model.mag = Some(truth);
        let Told::Fit(found) = magnetometer::fit(
            &in_a_room(&model, 40 + seed, 0.02).iter().filter_map(|(_, imu)| imu.mag_ut).collect::<Vec<_>>(),
            params.field_ut,
        ) else {
            panic!("{seed}: nothing was told")
        };
        for i in 0..3 {
            all.push((found.offset[i] - truth.bias[i]) / found.offset_sd[i]);
            for j in i..3 {
                all.push((found.matrix[(i, j)] - truth.scale[(i, j)]) / found.matrix_sd[(i, j)]);
            }
        }
        println!("{seed}: {:.1?} ± {:.2?}", &all[all.len() - 9..], found.offset_sd.as_slice());
        assert!(found.offset_sd.iter().all(|sd| *sd < 1.0), "{found:?}");
    }
    let mean_square = all.iter().map(|d| d * d).sum::<f64>() / all.len() as f64;
    let within = all.iter().filter(|d| d.abs() <= 3.0).count() as f64 / all.len() as f64;
    println!("mean square {mean_square:.2}, {within:.3} within three");
    assert!((0.2..2.0).contains(&mean_square) && within >= 0.95, "{mean_square} {within}");
}

#[test]
fn an_uneven_field_is_not_taken_for_errors_of_the_magnetometer() {
    for seed in 1..=6 {
        let mut model = ImuModel { rate_hz: 50.0, ..unit(seed) };
        model.mag = model.mag.map(|mag| Triad { scale: Matrix3::identity(), bias: Vector3::zeros(), ..mag });
        let found = calibrate(&in_a_room(&model, 60 + seed, 0.02), &CalibrateParams::default()).unwrap();
        let said = found.not_observed.join("\n");
        assert!(
            found.magnetometer.is_none() && said.contains("the field differs from place to place"),
            "{seed}: {said}"
        );
    }
}

#[test]
fn correcting_undoes_the_errors() {
    let (_, found) = deviations(2);
    let model = unit(2);
    let truth = Imu {
        gyr_rad_s: Vector3::new(0.1, 0.2, 0.3),
        acc_m_s2: Vector3::new(3.0, -4.0, 8.0),
        mag_ut: Some(Vector3::new(20.0, 10.0, -40.0)),
    };
    let read = Imu {
        gyr_rad_s: truth.gyr_rad_s + model.gyr.bias,
        acc_m_s2: model.acc.scale * truth.acc_m_s2 + model.acc.bias,
        mag_ut: truth.mag_ut.map(|m| model.mag.unwrap().scale * m + model.mag.unwrap().bias),
    };
    let corrected = found.correct(&read);
    assert!((corrected.gyr_rad_s - truth.gyr_rad_s).norm() < 1e-3);
    assert!((corrected.acc_m_s2 - truth.acc_m_s2).norm() < 0.02, "{corrected:?}");
    assert!((corrected.mag_ut.unwrap() - truth.mag_ut.unwrap()).norm() < 0.5);
}

#[test]
fn damaged_recordings_do_not_panic() {
    let model = unit(1);
    let whole = recorded(&model, 1.0, 24);
    assert!(calibrate(&[], &CalibrateParams::default()).is_err());
    for every in [3usize, 50, 400] {
        for bad in [f64::NAN, f64::INFINITY, 0.0, 1e300] {
            let mut samples = whole.clone();
            for (index, (_, imu)) in samples.iter_mut().enumerate() {
                if index % every == 0 {
                    imu.acc_m_s2.y = bad;
                    imu.mag_ut = Some(Vector3::repeat(bad));
                    imu.gyr_rad_s.x = bad;
                }
            }
            let _ = calibrate(&samples, &CalibrateParams::default());
        }
    }
    let zero: Vec<_> = whole
        .iter()
        .map(|(t, _)| {
            (
                *t,
                Imu {
                    gyr_rad_s: Vector3::zeros(),
                    acc_m_s2: Vector3::zeros(),
                    mag_ut: Some(Vector3::zeros()),
                },
            )
        })
        .collect();
    let found = calibrate(&zero, &CalibrateParams::default()).unwrap();
    assert!(!found.not_observed.is_empty());
}

#[test]
fn two_recordings_of_one_magnetometer_agree_within_three_standard_deviations() {
    // Slow and fast rotation of one unit in one room.
    let names = ["02_undisturbed_slow_rotation_B", "09_undisturbed_fast_rotation_with_breaks_B"];
    let Some(data) = std::env::var_os("VERGENCE_DATA").map(std::path::PathBuf::from) else {
        let required = std::env::var("VERGENCE_REQUIRE").unwrap_or_default();
        assert!(!required.split(',').any(|entry| entry.trim() == "data"), "VERGENCE_REQUIRE names data");
        println!("skipped: no data (VERGENCE_DATA)");
        return;
    };
    let found = names.map(|name| {
        let trial = crate::Recording::read(&data.join(format!("broad/{name}.csv.gz"))).unwrap();
        let mag: Vec<_> = trial.samples.iter().filter_map(|(_, imu)| imu.mag_ut).collect();
        let fit = magnetometer::read(&mag, None).unwrap().fit;
        let numbers = |offset: Vector3<f64>, m: Matrix3<f64>| {
            [offset.as_slice(), &[m.m11, m.m22, m.m33, m.m12, m.m13, m.m23]].concat()
        };
        (numbers(fit.offset, fit.matrix), numbers(fit.offset_sd, fit.matrix_sd))
    });
    let [(a, a_sd), (b, b_sd)] = &found;
    let apart: Vec<f64> = (0..9).map(|i| (a[i] - b[i]) / a_sd[i].hypot(b_sd[i])).collect();
    println!("{a:.4?} ± {a_sd:.4?}\n{b:.4?} ± {b_sd:.4?}\n{apart:.2?}");
    assert!(apart.iter().all(|d| d.abs() < 3.0), "{apart:?}");
    // Not by being vague.
    assert!(
        a_sd[..3].iter().all(|sd| *sd < 0.2) && b_sd[..3].iter().all(|sd| *sd < 0.7),
        "{a_sd:?} {b_sd:?}"
    );
}
