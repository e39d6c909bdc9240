//! A unit that is calibrated from a recording is not worse over that recording than it was.

use vergence_inertial::calibrate::{CalibrateParams, calibrate};
use vergence_inertial::filter::{Axes, Kind};

use super::{nine, run, six, trials};

/// What a calibration may add to an error, degrees: the bias alone moves them by so much.
const HARM_DEG: f64 = 0.1;

#[test]
fn calibrating_a_recording_by_itself_does_no_harm() {
    let Some(trials) = trials() else { return };
    for (name, trial) in &trials {
        let found = calibrate(&trial.samples, &CalibrateParams::default()).unwrap();
        println!("{name}: {} rests\n  {}", found.rests, found.not_observed.join("\n  "));
        if let Some(mag) = found.magnetometer {
            println!("  {mag:.4?}");
        }
        // No trial is laid on all sides.
        assert_eq!(
            (found.accelerometer.offset, found.accelerometer.matrix().is_identity(0.0)),
            ([0.0; 3], true)
        );
        let mut corrected = trial.clone();
        corrected.samples.iter_mut().for_each(|(_, imu)| *imu = found.correct(imu));
        for kind in [Kind::Vergence, Kind::Vqf] {
            let scores = [trial, &corrected].map(|trial| {
                let without = six(&run(kind, Axes::Six, trial));
                let with = nine(&run(kind, Axes::Nine, trial));
                [with[0], with[1], with[2], without[0], without[2]]
            });
            println!("  {kind:?}: {:.2?} -> {:.2?}", scores[0], scores[1]);
            for (before, after) in scores[0].iter().zip(scores[1]) {
                assert!(after <= before + HARM_DEG, "{name}, {kind:?}: {before} -> {after}");
            }
        }
    }
}
