//! What an inertial unit makes of the truth: noise, wandering bias, saturation, quantisation, scale and cross-axis
//! errors, jitter of the time stamps, dropped samples. Pure in (seed, index of the sample).

use nalgebra::{Matrix3, Vector3};
use vergence_sense::{Imu, Sample};
use vergence_time::{Span, Timestamp};

use crate::dice::Dice;
use crate::motion::{Earth, Motion};

/// Errors of one sensor of three axes. The unit u is that of what it measures: rad/s, m/s² or µT.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triad {
    /// `measured = scale · true + bias`: scale factors on the diagonal, cross-axis errors beside it; 1.
    pub scale: Matrix3<f64>,
    /// Bias at the start, u.
    pub bias: Vector3<f64>,
    /// Density of the white noise of each axis, u/√Hz; a sample at rate f has the standard deviation density · √f.
    pub noise_density: f64,
    /// Density of the random walk of each axis' bias, u/√s (also written u/s/√Hz): after t seconds the bias has
    /// wandered by density · √t.
    pub bias_walk: f64,
    /// Readings are held within ± this, u.
    pub saturation: f64,
    /// Readings are rounded to multiples of this, u; 0: not rounded.
    pub quantum: f64,
}

impl Triad {
    /// Reads the truth.
    pub const PERFECT: Self = Self {
        scale: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        bias: Vector3::new(0.0, 0.0, 0.0),
        noise_density: 0.0,
        bias_walk: 0.0,
        saturation: f64::INFINITY,
        quantum: 0.0,
    };
}

/// An inertial unit with all its errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuModel {
    /// Samples per second.
    pub rate_hz: f64,
    /// Of the gyroscope, rad/s.
    pub gyr: Triad,
    /// Of the accelerometer, m/s².
    pub acc: Triad,
    /// Of the magnetometer, µT; `None`: there is none.
    pub mag: Option<Triad>,
    /// Standard deviation of the time stamps about the truth, s; held within ±0.45 of a period, so that stamps ascend.
    pub jitter_s: f64,
    /// Probability that a sample is missing, 0..=1.
    pub drop_probability: f64,
    /// Chooses the noise; different seeds give independent noise.
    pub seed: u64,
}

impl ImuModel {
    /// A unit at `rate_hz` that reads the truth.
    pub fn perfect(rate_hz: f64) -> Self {
        Self {
            rate_hz,
            gyr: Triad::PERFECT,
            acc: Triad::PERFECT,
            mag: Some(Triad::PERFECT),
            jitter_s: 0.0,
            drop_probability: 0.0,
            seed: 0,
        }
    }

    /// A unit as today's headsets and controllers have them (BMI270 and AK09918 class, from their data sheets): gyro
    /// 0.007 °/s/√Hz, ±2000 °/s in 16 bits; accelerometer 160 µg/√Hz, ±16 g in 16 bits; magnetometer 0.06 µT/√Hz.
    pub fn consumer(rate_hz: f64, seed: u64) -> Self {
        const G: f64 = 9.80665;
        let gyr_range = 2000f64.to_radians();
        Self {
            gyr: Triad {
                noise_density: 0.007f64.to_radians(),
                bias_walk: 2e-5,
                saturation: gyr_range,
                quantum: gyr_range / 32768.0,
                ..Triad::PERFECT
            },
            acc: Triad {
                noise_density: 160e-6 * G,
                bias_walk: 1e-4,
                saturation: 16.0 * G,
                quantum: 16.0 * G / 32768.0,
                ..Triad::PERFECT
            },
            mag: Some(Triad { noise_density: 0.06, saturation: 4912.0, quantum: 0.15, ..Triad::PERFECT }),
            jitter_s: 20e-6,
            seed,
            ..Self::perfect(rate_hz)
        }
    }

    /// When sample `index` is taken.
    pub fn time(&self, index: u64) -> Timestamp {
        Timestamp::from_nanos((index as f64 * 1e9 / self.rate_hz).round() as i64)
    }

    /// The first sample taken at or after `time`; 0 for negative times.
    pub fn index_at(&self, time: Timestamp) -> u64 {
        let near = (time.as_nanos() as f64 * 1e-9 * self.rate_hz).floor().max(0.0) as u64;
        // The rounding of `time` may put the neighbour on the other side.
        (near.saturating_sub(1)..=near + 2).find(|&k| self.time(k) >= time).unwrap_or(near + 2)
    }

    /// Biases of gyroscope (rad/s) and accelerometer (m/s²) at sample `index`.
    pub fn biases(&self, index: u64) -> (Vector3<f64>, Vector3<f64>) {
        (self.bias(&self.gyr, 0, index), self.bias(&self.acc, 1, index))
    }

    fn bias(&self, triad: &Triad, sensor: u64, index: u64) -> Vector3<f64> {
        if triad.bias_walk == 0.0 {
            return triad.bias;
        }
        let per_tick = triad.bias_walk / self.rate_hz.sqrt();
        let walked = |axis: usize| Dice::new(self.seed, 16 + 8 * sensor + axis as u64).walk(index) * per_tick;
        triad.bias + Vector3::from_fn(|axis, _| walked(axis))
    }

    fn reading(&self, triad: &Triad, sensor: u64, index: u64, truth: &Vector3<f64>) -> Vector3<f64> {
        let deviation = triad.noise_density * self.rate_hz.sqrt();
        let noise = |axis: usize| match deviation {
            0.0 => 0.0,
            _ => Dice::new(self.seed, 64 + 8 * sensor + axis as u64).normal(index) * deviation,
        };
        let exact = triad.scale * truth + self.bias(triad, sensor, index);
        Vector3::from_fn(|axis, _| {
            let held = (exact[axis] + noise(axis)).clamp(-triad.saturation, triad.saturation);
            if triad.quantum > 0.0 { (held / triad.quantum).round() * triad.quantum } else { held }
        })
    }

    /// What the unit says about `motion` on `earth` at sample `index`; `None` where the sample is dropped. It arrives
    /// when it is taken.
    pub fn read(&self, index: u64, motion: &dyn Motion, earth: &Earth) -> Option<Sample<Imu>> {
        if Dice::new(self.seed, 1).uniform(index) < self.drop_probability {
            return None;
        }
        let time = self.time(index);
        let truth = motion.at(time);
        let world_from_body = truth.world_from_body.rotation;
        let field = world_from_body.inverse_transform_vector(&earth.field_ut);
        let value = Imu {
            gyr_rad_s: self.reading(&self.gyr, 0, index, &truth.rate_in_body_rad_s),
            acc_m_s2: self.reading(&self.acc, 1, index, &truth.specific_force_m_s2(earth)),
            mag_ut: self.mag.map(|mag| self.reading(&mag, 2, index, &field)),
        };
        let most = 0.45 / self.rate_hz;
        let jitter = match self.jitter_s {
            0.0 => 0.0,
            deviation => (Dice::new(self.seed, 2).normal(index) * deviation).clamp(-most, most),
        };
        let stamp = time.saturating_add(Span::from_secs_f64(jitter).unwrap_or(Span::ZERO));
        Some(Sample { captured: stamp, arrived: time, value })
    }

    /// All samples of the first `length`.
    pub fn record<'a>(
        &'a self,
        motion: &'a dyn Motion,
        earth: &'a Earth,
        length: Span,
    ) -> impl Iterator<Item = Sample<Imu>> + 'a {
        let end = self.index_at(Timestamp::from_nanos(length.as_nanos()));
        (0..end).filter_map(move |index| self.read(index, motion, earth))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{Still, Wander, WanderParams};

    const EARTH: Earth = Earth::MID_LATITUDE;

    #[test]
    fn the_same_seed_gives_the_same_bytes_in_any_order() {
        let motion = Wander::new(3, &WanderParams::default()).unwrap();
        let model = ImuModel { drop_probability: 0.1, ..ImuModel::consumer(200.0, 5) };
        let forward: Vec<_> = (0..500).map(|k| model.read(k, &motion, &EARTH)).collect();
        let mut backward: Vec<_> = (0..500).rev().map(|k| model.read(k, &motion, &EARTH)).collect();
        backward.reverse();
        assert_eq!(forward, backward);
        let other = ImuModel { seed: 6, ..model };
        assert_ne!(forward, (0..500).map(|k| other.read(k, &motion, &EARTH)).collect::<Vec<_>>());
    }

    #[test]
    fn a_perfect_unit_reads_the_truth() {
        let motion = Wander::new(3, &WanderParams::default()).unwrap();
        let model = ImuModel::perfect(1000.0);
        for k in [0, 17, 999] {
            let read = model.read(k, &motion, &EARTH).unwrap();
            let truth = motion.at(model.time(k));
            assert_eq!(read.value.gyr_rad_s, truth.rate_in_body_rad_s);
            assert_eq!(read.value.acc_m_s2, truth.specific_force_m_s2(&EARTH));
            assert_eq!(read.captured, model.time(k));
        }
    }

    #[test]
    fn each_error_is_the_one_that_was_asked_for() {
        let still = Still::default();
        let truth = still.at(Timestamp::default()).specific_force_m_s2(&EARTH);
        // Noise: standard deviation density · √rate.
        let mut model = ImuModel::perfect(400.0);
        model.acc.noise_density = 0.01;
        let read: Vec<f64> =
            model.record(&still, &EARTH, Span::from_millis(25_000)).map(|s| s.value.acc_m_s2.x).collect();
        assert_eq!(read.len(), 10_000);
        let deviation = (read.iter().map(|x| (x - truth.x).powi(2)).sum::<f64>() / 1e4).sqrt();
        assert!((deviation / 0.2 - 1.0).abs() < 5.0 * (0.5f64 / 1e4).sqrt(), "{deviation}");
        // Walk: over many seeds, after 4 s.
        let wandered = |seed| {
            let mut model = ImuModel { seed, ..ImuModel::perfect(100.0) };
            model.gyr.bias_walk = 0.5;
            model.biases(400).0.norm_squared() / 3.0
        };
        let variance = (0..3000).map(wandered).sum::<f64>() / 3000.0;
        assert!((variance / (0.25 * 4.0) - 1.0).abs() < 5.0 * (2f64 / 9000.0).sqrt(), "{variance}");
        // Saturation, quantisation, scale and bias.
        let mut model = ImuModel::perfect(100.0);
        model.acc = Triad {
            scale: Matrix3::new(1.0, 0.1, 0.0, 0.0, 1.0, 0.02, 0.0, 0.0, 1.1),
            bias: Vector3::new(0.5, 0.0, -0.1),
            saturation: 10.0,
            quantum: 0.25,
            ..Triad::PERFECT
        };
        let read = model.read(0, &still, &EARTH).unwrap().value.acc_m_s2;
        assert_eq!(read, Vector3::new(0.5, 0.25, 10.0));
        // Dropped samples and jitter.
        let model = ImuModel { drop_probability: 0.2, jitter_s: 1e-4, ..ImuModel::perfect(1000.0) };
        let all: Vec<_> = model.record(&still, &EARTH, Span::from_millis(20_000)).collect();
        assert!((all.len() as f64 - 16_000.0).abs() < 5.0 * (20_000.0f64 * 0.16).sqrt(), "{}", all.len());
        assert!(all.windows(2).all(|w| w[1].captured > w[0].captured));
        let off = |s: &Sample<Imu>| s.captured.since(s.arrived).unwrap().as_secs_f64();
        let jitter = (all.iter().map(|s| off(s).powi(2)).sum::<f64>() / all.len() as f64).sqrt();
        assert!((jitter / 1e-4 - 1.0).abs() < 0.05, "{jitter}");
    }

    #[test]
    fn indices_and_times_agree() {
        for rate in [10.0, 285.714_285_7, 1000.0, 9999.9] {
            let model = ImuModel::perfect(rate);
            for k in [0u64, 1, 2, 999, 123_456] {
                assert_eq!(model.index_at(model.time(k)), k, "{rate}");
            }
            assert_eq!(model.index_at(Timestamp::from_nanos(-5)), 0);
        }
    }
}
