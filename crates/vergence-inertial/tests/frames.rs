//! Sensors that do not speak of one frame, and rests that are none, in recorded motion.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::path::PathBuf;

use nalgebra::Vector3;
use vergence_inertial::Recording;
use vergence_inertial::calibrate::{CalibrateParams, calibrate};
use vergence_inertial::frames::check_frames;
use vergence_sense::Imu;

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

#[test]
fn recordings_whose_sensors_agree_are_not_warned_of() {
    let (Some(broad), Some(slam)) = (data("broad"), data("slam")) else { return };
    let mut paths: Vec<PathBuf> = std::fs::read_dir(&broad)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.to_string_lossy().ends_with(".csv.gz"))
        .collect();
    assert_eq!(paths.len(), 8);
    paths.extend(["euroc_v101_start", "half_real_v101_14s"].map(|name| slam.join(name)));
    for path in paths {
        let check = check_frames(&Recording::read(&path).unwrap().samples);
        println!("{}: {check:.2?}", path.display());
        assert_eq!(check.warnings(), Vec::<String>::new(), "{}", path.display());
    }
}

#[test]
fn wrong_axes_and_units_are_warned_of() {
    let Some(broad) = data("broad") else { return };
    let trial = Recording::read(&broad.join("02_undisturbed_slow_rotation_B.csv.gz")).unwrap();
    let mirrored = |v: Vector3<f64>| Vector3::new(v.x, v.y, -v.z);
    type Change<'a> = &'a dyn Fn(&Imu) -> Imu;
    let changes: [(&str, Change<'_>, &str); 6] = [
        (
            "gyroscope's sign",
            &|imu| Imu { gyr_rad_s: -imu.gyr_rad_s, ..*imu },
            "accelerometer and magnetometer turn as (-x, -y, -z) of the gyroscope: --turn gyr=-x,-y,-z",
        ),
        (
            "left-handed",
            &|imu| Imu {
                gyr_rad_s: mirrored(imu.gyr_rad_s),
                acc_m_s2: mirrored(imu.acc_m_s2),
                mag_ut: imu.mag_ut.map(mirrored),
            },
            "where all three sensors are left-handed, turn one and the same axis of all of them",
        ),
        (
            "magnetometer as an MPU-9250 has it",
            &|imu| Imu { mag_ut: imu.mag_ut.map(|m| Vector3::new(m.y, m.x, -m.z)), ..*imu },
            "the magnetometer turns as (y, x, -z) of the gyroscope: --turn mag=y,x,-z (or -y,-x,z:",
        ),
        (
            "accelerometer with another order",
            &|imu| Imu { acc_m_s2: Vector3::new(imu.acc_m_s2.z, imu.acc_m_s2.x, imu.acc_m_s2.y), ..*imu },
            "the accelerometer turns as (z, x, y) of the gyroscope: --turn acc=y,z,x",
        ),
        (
            "degrees",
            &|imu| Imu { gyr_rad_s: imu.gyr_rad_s.map(f64::to_degrees), ..*imu },
            "expected rates in rad/s, found deg/s",
        ),
        (
            "degrees and the gyroscope's x and y swapped",
            &|imu| Imu {
                gyr_rad_s: Vector3::new(imu.gyr_rad_s.y, imu.gyr_rad_s.x, imu.gyr_rad_s.z)
                    .map(f64::to_degrees),
                ..*imu
            },
            "and as (y, x, z) of it: expected rates in rad/s, found deg/s",
        ),
    ];
    for (name, change, sentence) in changes {
        let samples: Vec<_> = trial.samples.iter().map(|(at, imu)| (*at, change(imu))).collect();
        let check = check_frames(&samples);
        println!("{name}: {check:.3?}");
        let warnings = check.warnings();
        assert!(warnings.len() == 1 && warnings[0].contains(sentence), "{name}: {warnings:?}");
    }
    // What turning does not tell, the dip does, for who knows where she is.
    for change in [(&|imu: &Imu| Imu { acc_m_s2: -imu.acc_m_s2, ..*imu }) as Change<'_>, &|imu| Imu {
        mag_ut: imu.mag_ut.map(|mag| -mag),
        ..*imu
    }] {
        let samples: Vec<_> = trial.samples.iter().map(|(at, imu)| (*at, change(imu))).collect();
        let check = check_frames(&samples);
        assert!(check.warnings().is_empty() && check.dip_rad.unwrap() < -0.5, "{check:?}");
    }
}

#[test]
fn a_flight_has_no_rests() {
    let Some(slam) = data("slam") else { return };
    for name in ["euroc_v101_start", "half_real_v101_14s"] {
        let recording = Recording::read(&slam.join(name)).unwrap();
        let found = calibrate(&recording.samples, &CalibrateParams::default());
        println!("{name}: {found:?}");
        let Ok(found) = found else { continue };
        for axis in 0..3 {
            let (bias, sd) =
                (found.gyr_bias_rad_s[axis].to_degrees(), found.gyr_bias_sd_rad_s[axis].to_degrees());
            assert!(bias == 0.0 || sd < 0.2, "{name}: {bias} ± {sd}");
        }
        assert_eq!(found.accelerometer.offset, [0.0; 3], "{name}");
        assert!(found.accelerometer.matrix().is_identity(0.0), "{name}");
    }
}
