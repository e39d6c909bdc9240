//! Calibration from a recording with rests and turns between them: bias of the gyroscope, ellipsoids of accelerometer
//! and magnetometer with scale, cross-axis terms and offset, and what of it the recording could not tell.
//!
//! A triad reads `measured = matrix · true + offset`. The lengths of gravity and of the earth's field give the symmetric
//! part of the matrix and the offset (an ellipsoid); how the directions turn between rests, seen by the gyroscope, gives
//! the rest of it: the rotation between that sensor and the gyroscope, whose axes are the axes of the unit.
//!
//! What the recording does not tell is named, and stays as it is in a unit without errors: an offset or cross-axis term of
//! exactly 0, a scale of exactly 1, no rotation. Its standard deviation is what it may be all the same.

mod alignment;
mod ellipsoid;
mod gyroscope;
mod magnetometer;

use std::path::Path;

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use vergence_geom::log;
use vergence_sense::Imu;
use vergence_time::Timestamp;

use crate::Error;
use crate::frames::SensorAxes;
use crate::still::still_stretches;
use alignment::{Alignment, Turn};
use ellipsoid::{Ellipsoid, Prior, Reading};
use magnetometer::Told;

/// What is known without the recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrateParams {
    /// Length of gravity, m/s²; 9.80665. It is 9.780 at the equator and 9.832 at the poles.
    pub gravity_m_s2: f64,
    /// Length of the magnetic field, µT, where it is known (25 to 65 on earth); otherwise the mean scale is taken as 1.
    pub field_ut: Option<f64>,
}

impl Default for CalibrateParams {
    fn default() -> Self {
        Self { gravity_m_s2: 9.80665, field_ut: None }
    }
}

/// What a triad makes of the truth, with standard deviations. What a file does not name is as in a triad without errors.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TriadCalibration {
    /// In the unit of the sensor.
    pub offset: [f64; 3],
    /// Standard deviations of the offset.
    pub offset_sd: [f64; 3],
    /// Rows: `measured = matrix · true + offset`. Scale factors on the diagonal.
    pub matrix: [[f64; 3]; 3],
    /// Standard deviations of the matrix.
    pub matrix_sd: [[f64; 3]; 3],
    /// Length of the true vector, in the unit of the sensor: as given, or as found with a mean scale of 1.
    pub length: f64,
    /// Root of the mean square of what is left of the length after calibration, in the unit of the sensor.
    pub residual: f64,
}

impl Default for TriadCalibration {
    fn default() -> Self {
        unknown(0.0)
    }
}

impl TriadCalibration {
    /// The true vector of a measured one; `None` where the matrix is singular.
    pub fn correct(&self, measured: &Vector3<f64>) -> Option<Vector3<f64>> {
        Some(self.matrix().try_inverse()? * (measured - Vector3::from(self.offset)))
    }

    /// As a matrix.
    pub fn matrix(&self) -> Matrix3<f64> {
        Matrix3::from_fn(|row, column| self.matrix[row][column])
    }
}

/// Calibration of an inertial unit. What a file does not name is as in a unit without errors: one that is written by hand needs only what it
/// changes.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Calibration {
    /// Bias of the gyroscope, rad/s.
    pub gyr_bias_rad_s: [f64; 3],
    /// Its standard deviation, rad/s.
    pub gyr_bias_sd_rad_s: [f64; 3],
    /// Rests that were found.
    pub rests: usize,
    /// What the recording could not tell, and what would.
    pub not_observed: Vec<String>,
    /// Of the accelerometer, m/s².
    pub accelerometer: TriadCalibration,
    /// Of the magnetometer, µT; `None` where there is none, or nothing could be told.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub magnetometer: Option<TriadCalibration>,
    /// The axes in which the readings were taken before they were calibrated, where they are not those of the sensors: `[axes]` with `gyr`, `acc`
    /// and `mag`, such as `mag = "y,x,-z"`.
    #[serde(skip_serializing_if = "SensorAxes::is_same")]
    pub axes: SensorAxes,
}

impl Default for Calibration {
    fn default() -> Self {
        Self {
            gyr_bias_rad_s: [0.0; 3],
            gyr_bias_sd_rad_s: [f64::INFINITY; 3],
            rests: 0,
            not_observed: Vec::new(),
            accelerometer: TriadCalibration::default(),
            magnetometer: None,
            axes: SensorAxes::default(),
        }
    }
}

/// The smallest determinant of a triad's matrix that can be undone: axes that read half as much as they should have 0.125.
const LEAST_DETERMINANT: f64 = 0.01;

impl Calibration {
    /// Reads what `vergence imu calibrate` wrote.
    ///
    /// # Errors
    /// File, line and column of what is no calibration; the name of a triad whose numbers are not finite or whose matrix cannot
    /// be undone.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let read: Self = vergence_config::read(path)?;
        let wrong =
            |expected: String, found: String| Error::Mismatch { path: path.to_owned(), expected, found };
        if !read.gyr_bias_rad_s.iter().all(|bias| bias.is_finite()) {
            let found = format!("{:?}", read.gyr_bias_rad_s);
            return Err(wrong("a finite gyr_bias_rad_s".to_owned(), found));
        }
        let triads =
            [("accelerometer", Some(&read.accelerometer)), ("magnetometer", read.magnetometer.as_ref())];
        for (name, triad) in triads {
            let Some(triad) = triad else { continue };
            let (determinant, offset) = (triad.matrix().determinant(), Vector3::from(triad.offset));
            // NaN fails the comparison.
            if !(determinant.abs() > LEAST_DETERMINANT && determinant.is_finite() && offset.sum().is_finite())
            {
                return Err(wrong(
                    format!(
                        "a finite {name}.offset and a {name}.matrix with a determinant of {LEAST_DETERMINANT} or more"
                    ),
                    format!("{:?} and a determinant of {determinant}", triad.offset),
                ));
            }
        }
        Ok(read)
    }

    /// The reading of a unit without these errors.
    pub fn correct(&self, imu: &Imu) -> Imu {
        let imu = self.axes.of(imu);
        let magnetic =
            |mag: Vector3<f64>| self.magnetometer.map_or(Some(mag), |m| m.correct(&mag)).unwrap_or(mag);
        Imu {
            gyr_rad_s: imu.gyr_rad_s - Vector3::from(self.gyr_bias_rad_s),
            acc_m_s2: self.accelerometer.correct(&imu.acc_m_s2).unwrap_or(imu.acc_m_s2),
            mag_ut: imu.mag_ut.map(magnetic),
        }
    }
}

/// One rest: means, with the variance of the mean of each axis.
struct Rest {
    /// Index of its middle sample.
    middle: usize,
    gyr: Vector3<f64>,
    acc: Vector3<f64>,
    mag: Option<Vector3<f64>>,
    samples: usize,
}

/// Blocks that a rest is cut into, to see what its mean is worth: also noise that is not white counts.
const BLOCKS: usize = 5;

/// Means of the blocks of one rest.
fn block_means(
    samples: &[(Timestamp, Imu)],
    read: impl Fn(&Imu) -> Option<Vector3<f64>>,
) -> Vec<Vector3<f64>> {
    let length = samples.len() / BLOCKS;
    let mean = |block: &[(Timestamp, Imu)]| {
        let (mut sum, mut count) = (Vector3::zeros(), 0.0);
        for vector in
            block.iter().filter_map(|(_, imu)| read(imu)).filter(|v| v.iter().all(|x| x.is_finite()))
        {
            sum += vector;
            count += 1.0;
        }
        (count > 0.0).then(|| sum / count)
    };
    samples.chunks_exact(length.max(1)).take(BLOCKS).filter_map(mean).collect()
}

/// Variance of one axis of the mean of a rest, times its samples: pooled over all rests.
fn variance_per_sample(
    samples: &[(Timestamp, Imu)],
    stretches: &[std::ops::Range<usize>],
    read: impl Fn(&Imu) -> Option<Vector3<f64>>,
) -> f64 {
    let (mut squares, mut freedom) = (0.0, 0.0);
    for stretch in stretches {
        let blocks = block_means(&samples[stretch.clone()], &read);
        if blocks.len() < 2 {
            continue;
        }
        let mean = blocks.iter().sum::<Vector3<f64>>() / blocks.len() as f64;
        let length = (stretch.len() / BLOCKS) as f64;
        squares += blocks.iter().map(|b| (b - mean).norm_squared()).sum::<f64>() * length;
        freedom += 3.0 * (blocks.len() - 1) as f64;
    }
    if freedom > 0.0 { squares / freedom } else { 0.0 }
}

/// Calibrates from `samples`. Stretches that look still but turn at different rates are no rests.
///
/// # Errors
/// [`Error::Unusable`] where the recording has no rest of a second.
pub fn calibrate(samples: &[(Timestamp, Imu)], params: &CalibrateParams) -> Result<Calibration, Error> {
    let stretches = still_stretches(samples);
    if stretches.is_empty() {
        return Err(Error::Unusable {
            expected: "a recording with rests of at least one second".into(),
            found: format!("none in {} samples", samples.len()),
        });
    }
    let mut not_observed = Vec::new();
    let rests: Vec<Rest> = stretches
        .iter()
        .map(|stretch| {
            let still = &samples[stretch.clone()];
            let mean = |read: &dyn Fn(&Imu) -> Option<Vector3<f64>>| {
                let all: Vec<_> = still.iter().filter_map(|(_, imu)| read(imu)).collect();
                (!all.is_empty()).then(|| all.iter().sum::<Vector3<f64>>() / all.len() as f64)
            };
            Rest {
                middle: stretch.start + stretch.len() / 2,
                gyr: mean(&|imu| Some(imu.gyr_rad_s)).unwrap_or_default(),
                acc: mean(&|imu| Some(imu.acc_m_s2)).unwrap_or_default(),
                mag: mean(&|imu| imu.mag_ut.filter(|mag| mag.sum().is_finite())),
                samples: stretch.len(),
            }
        })
        .collect();

    let gyr_variance = variance_per_sample(samples, &stretches, |imu| Some(imu.gyr_rad_s));
    let gyroscope::Told { bias, deviations: bias_sd, at_rest, not_observed: unseen } =
        gyroscope::told(&rests, gyr_variance);
    not_observed.extend(unseen);
    let kept = |index: usize| at_rest.get(index) == Some(&true);
    let stretches: Vec<_> =
        stretches.into_iter().enumerate().filter(|(i, _)| kept(*i)).map(|(_, stretch)| stretch).collect();
    let rests: Vec<Rest> =
        rests.into_iter().enumerate().filter(|(i, _)| kept(*i)).map(|(_, rest)| rest).collect();
    let acc_variance = variance_per_sample(samples, &stretches, |imu| Some(imu.acc_m_s2));
    let point = |rest: &Rest| {
        let noise = (acc_variance / rest.samples as f64).sqrt().max(1e-9 * params.gravity_m_s2);
        Reading { vector: rest.acc, noise, weight: 1.0 / (noise * noise) }
    };
    let points: Vec<Reading> = rests.iter().map(point).collect();
    let acc = Ellipsoid::fit(&points, Some(params.gravity_m_s2), &Prior::ACCELEROMETER, None)
        .and_then(|fit| fit.clone().put_back(&fit.unseen(), &points, Some(params.gravity_m_s2)));
    let accelerometer = match &acc {
        Some(fit) => {
            let aligned = alignment::align(
                &turns(samples, &rests, &bias, &|rest| fit.direction(&rest.acc)),
                !fit.unseen().contains(&true),
            );
            whole(
                "accelerometer",
                "rests in other directions (each axis up and down, and between)",
                fit,
                aligned,
                &mut not_observed,
            )
        }
        None => {
            let why =
                if rests.is_empty() { "there are no rests" } else { "its rests do not measure a vector" };
            not_observed.push(format!("accelerometer: nothing; {why}"));
            unknown(params.gravity_m_s2)
        }
    };

    let magnetometer = magnetometer(samples, params, &rests, &bias, &mut not_observed);
    Ok(Calibration {
        gyr_bias_rad_s: bias.into(),
        gyr_bias_sd_rad_s: bias_sd.into(),
        rests: rests.len(),
        not_observed,
        accelerometer,
        magnetometer,
        axes: SensorAxes::default(),
    })
}

/// How the unit turned between two rests, and the directions that a sensor saw in them; `None` where the gyroscope has a
/// gap in between, it took longer than half a minute, or a direction is missing.
fn turn(
    samples: &[(Timestamp, Imu)],
    from: &Rest,
    to: &Rest,
    bias: &Vector3<f64>,
    direction: &dyn Fn(&Rest) -> Option<Vector3<f64>>,
) -> Option<Turn> {
    let mut from_to = UnitQuaternion::identity();
    for pair in samples[from.middle..=to.middle].windows(2) {
        let seconds = pair[1].0.since(pair[0].0)?.as_secs_f64();
        let rate = (pair[0].1.gyr_rad_s + pair[1].1.gyr_rad_s) * 0.5 - bias;
        if !(seconds > 0.0 && seconds < 0.1 && rate.iter().all(|x| x.is_finite())) {
            return None;
        }
        from_to = vergence_geom::advance(&from_to, &(rate * seconds));
    }
    let seconds = samples[to.middle].0.since(samples[from.middle].0)?.as_secs_f64();
    // Less than this says nothing of an axis.
    let enough = log(&from_to).norm() > 0.1 && seconds < 30.0;
    Some(Turn { from: direction(from)?, to: direction(to)?, from_to }).filter(|_| enough)
}

/// The turns between neighbouring rests.
fn turns(
    samples: &[(Timestamp, Imu)],
    rests: &[Rest],
    bias: &Vector3<f64>,
    direction: &dyn Fn(&Rest) -> Option<Vector3<f64>>,
) -> Vec<Turn> {
    rests.windows(2).filter_map(|pair| turn(samples, &pair[0], &pair[1], bias, direction)).collect()
}

fn magnetometer(
    samples: &[(Timestamp, Imu)],
    params: &CalibrateParams,
    rests: &[Rest],
    bias: &Vector3<f64>,
    not_observed: &mut Vec<String>,
) -> Option<TriadCalibration> {
    let seen: Vec<Vector3<f64>> = samples
        .iter()
        .filter_map(|(_, imu)| imu.mag_ut)
        .filter(|m| m.iter().all(|x| x.is_finite()))
        .collect();
    if seen.is_empty() {
        return None;
    }
    let fit = match magnetometer::fit(&seen, params.field_ut) {
        Told::Fit(fit) => *fit,
        Told::Nothing => {
            not_observed.push("magnetometer: nothing; turning it about every axis would tell".to_owned());
            return None;
        }
        Told::Uneven(left_ut) => {
            not_observed.push(format!(
                "magnetometer: nothing; its errors are smaller than the field differs from place to place ({left_ut:.2} µT), \
                 turning it where the field is even (outdoors) would tell"
            ));
            return None;
        }
    };
    if params.field_ut.is_none() {
        not_observed
            .push("magnetometer: strength of the field (its mean scale is taken as 1); say it".to_owned());
    }
    let aligned = alignment::align(
        &turns(samples, rests, bias, &|rest| fit.direction(&rest.mag?)),
        !fit.unseen().contains(&true),
    );
    Some(whole("magnetometer", "turning it about every axis", &fit, aligned, not_observed))
}

fn unknown(length: f64) -> TriadCalibration {
    TriadCalibration {
        offset: [0.0; 3],
        offset_sd: [f64::INFINITY; 3],
        matrix: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        matrix_sd: [[f64::INFINITY; 3]; 3],
        length,
        residual: 0.0,
    }
}

/// Ellipsoid and rotation together, and what of them was not observed.
fn whole(
    sensor: &str,
    remedy: &str,
    fit: &Ellipsoid,
    alignment: Alignment,
    not_observed: &mut Vec<String>,
) -> TriadCalibration {
    let Alignment { sensor_from_unit, deviations: rotation_sd, seen: turned } = alignment;
    let matrix = fit.matrix * sensor_from_unit.to_rotation_matrix().into_inner();
    let mut matrix_sd = fit.matrix_sd;
    for row in 0..3 {
        for column in (0..3).filter(|column| *column != row) {
            let about = 3 - row - column;
            matrix_sd[(row, column)] = fit.matrix_sd[(row, column)].hypot(rotation_sd[about]);
        }
    }
    let axes = ["x", "y", "z"];
    let list = |seen: &[bool]| -> String {
        let missing = seen.iter().zip(axes).filter(|(seen, _)| !**seen).map(|(_, axis)| axis);
        missing.collect::<Vec<_>>().join(" ")
    };
    let mut miss = |what: &str, missing: String, remedy: &str| {
        if !missing.is_empty() {
            not_observed.push(format!("{sensor}: {what} {missing}; {remedy} would tell"));
        }
    };
    miss("offset along", list(&fit.offset_seen), remedy);
    miss("scale along", list(&fit.scale_seen), remedy);
    let pairs = ["x y", "x z", "y z"];
    let crossed: Vec<&str> =
        fit.cross_seen.iter().zip(pairs).filter(|(seen, _)| !**seen).map(|(_, pair)| pair).collect();
    miss("cross-axis terms", crossed.join(", "), remedy);
    miss("rotation to the gyroscope about", list(&turned), "turns about other axes between rests");
    TriadCalibration {
        offset: fit.offset.into(),
        offset_sd: fit.offset_sd.into(),
        matrix: std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)])),
        matrix_sd: std::array::from_fn(|row| std::array::from_fn(|column| matrix_sd[(row, column)])),
        length: fit.length,
        residual: fit.residual,
    }
}

#[cfg(test)]
mod tests;
