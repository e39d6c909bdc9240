//! Orientation from gyroscope, accelerometer and magnetometer: filters under one contract.
//!
//! A filter is mathematics only ([`Core`]: clean samples, positive steps of time). [`Stream`] puts the [guard](Limits) in
//! front of it, which decides what of a sample may be used and says what it rejected ([`Rejected`]), and is what everybody
//! holds, as a [`Filter`]. Batch and streaming are the same calls, hence equal bit for bit.
//!
//! Earth frame: ENU, x east (magnetic), y north, z up. Without a magnetometer the heading starts at zero and drifts.

mod complementary;
mod guard;
mod integration;
mod kalman;
mod kind;
mod knobs;
mod low_pass;
mod madgwick;
mod mahony;
mod offline;
mod saved;
mod settings;
pub mod turn;
mod vergence;
mod vqf;

pub use complementary::{Complementary, ComplementaryParams};
pub use guard::{Limits, Rejected, Rejections, Stream};
pub use integration::Integration;
pub use kind::{Axes, Kind};
pub use knobs::{Knob, Params};
pub use low_pass::{LowPass, LowPassCoefficients};
pub use madgwick::{Madgwick, MadgwickParams};
pub use mahony::{Mahony, MahonyParams};
pub use offline::offline;
pub use saved::Saved;
pub use settings::{read_params, read_unit_params};
pub use vergence::{Vergence, VergenceCoefficients, VergenceParams, VergenceState};
pub use vqf::{Vqf, VqfCoefficients, VqfParams, VqfState};

use nalgebra::{UnitQuaternion, Vector3};
use vergence_sense::Imu;
use vergence_time::Timestamp;

use crate::Error;

/// What a filter may use of one sample. Everything is finite and within the sensor's limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clean {
    /// Time since the sample before, seconds; the nominal period for the first one. Positive.
    pub step_s: f64,
    /// Angular rate, radians per second: what the sensor says at the end of the step, be that of the instant or a mean
    /// ([`VergenceParams::gyr_averaged`]); over a bridged gap the mean.
    pub gyr_rad_s: Vector3<f64>,
    /// Specific force, metres per second squared, longer than zero.
    pub acc_m_s2: Option<Vector3<f64>>,
    /// Magnetic field, microteslas, longer than zero.
    pub mag_ut: Option<Vector3<f64>>,
}

/// The mathematics of one filter.
pub trait Core: Send {
    /// All that changes from sample to sample.
    type State: Saved + Clone + PartialEq + std::fmt::Debug;

    /// Takes one sample.
    fn step(&mut self, sample: &Clean);

    /// Is told that nothing is known about the motion of the last `gap_s` seconds: the orientation may be any.
    fn lost(&mut self, gap_s: f64);

    /// The rotation that takes sensor-frame vectors to the earth frame, ENU.
    fn earth_from_sensor(&self) -> UnitQuaternion<f64>;

    /// The bias of the gyroscope as far as it is known, radians per second; subtracted from readings before they are used.
    fn gyro_bias_rad_s(&self) -> Vector3<f64> {
        Vector3::zeros()
    }

    /// All that changes from sample to sample.
    fn state(&self) -> &Self::State;

    /// Continues from `state`.
    fn set_state(&mut self, state: Self::State);
}

/// An orientation filter at work on one stream.
pub trait Filter: Send {
    /// Takes the sample captured at `at` and says what of it was not used.
    fn update(&mut self, at: Timestamp, imu: &Imu) -> Rejected;

    /// The rotation that takes sensor-frame vectors to the earth frame, ENU: finite and of unit length, always.
    fn earth_from_sensor(&self) -> UnitQuaternion<f64>;

    /// The bias of the gyroscope as far as it is known, radians per second, sensor frame.
    fn gyro_bias_rad_s(&self) -> Vector3<f64>;

    /// What was rejected since the start, by reason.
    fn rejections(&self) -> Rejections;

    /// The state as bytes.
    fn save(&self) -> Vec<u8>;

    /// Continues from saved bytes of a filter with the same parameters, bit for bit.
    ///
    /// # Errors
    /// [`Error::State`] where the bytes are not those of this filter; the filter is then unchanged.
    fn restore(&mut self, bytes: &[u8]) -> Result<(), Error>;
}

/// Feeds all samples and gives the orientation after each.
pub fn run(filter: &mut dyn Filter, samples: &[(Timestamp, Imu)]) -> Vec<UnitQuaternion<f64>> {
    samples
        .iter()
        .map(|(at, imu)| {
            filter.update(*at, imu);
            filter.earth_from_sensor()
        })
        .collect()
}
