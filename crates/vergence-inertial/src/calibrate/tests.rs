use vergence_time::Span;

use super::*;
use crate::model::{ImuModel, Triad};
use crate::motion::{Earth, Wander, WanderParams};

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
    // What was not seen stays as it was.
    assert!((found.accelerometer.matrix[0][1]).abs() < 1e-2);
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
