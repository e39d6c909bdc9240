//! `vergence imu run`: a filter over a recording.

use std::fs::File;
use std::io::BufWriter;
use std::path::PathBuf;

use clap::ValueEnum;
use serde_json::json;
use vergence_inertial::calibrate::Calibration;
use vergence_inertial::filter::{self, Axes, Kind};
use vergence_inertial::{Unit, write_orientations};

use super::input;
use crate::failure::Failure;
use crate::timing;

/// Runs an orientation filter over a recording and writes an orientation for each sample
///
/// The three sensors speak of one right-handed frame. At rest the accelerometer points up: +9.8 m/s² along whatever axis is up (specific force;
/// units that give −9.8 there need their sign turned). Turning anticlockwise about an axis, seen from its tip, is positive. The
/// magnetometer points north and, on the northern half of the earth, down; that of many units has other axes than its gyroscope and has to be
/// turned before.
///
/// How late readings are is a property of the unit that they do not tell. A table of BROAD's style is taken for one of BROAD's unit,
/// whose readings are 4 ms late, anything else for one of a unit that is not late; what was taken is printed. For a table of a unit of
/// your own give --unit unknown, or its lag in a --config (latency_s, acc_lag_s, mag_lag_s, gyr_averaged).
#[derive(clap::Args)]
pub struct Args {
    /// A table `t_s,gyr_x,…,acc_z[,mag_x,…]` (rad/s, m/s², µT; .csv or .csv.gz), EuRoC's imu0 (its folder or data.csv),
    /// or a session's log (.mcap)
    input: PathBuf,
    /// The stream of a session's log; by default its only inertial unit
    #[arg(long)]
    stream: Option<String>,
    /// The filter
    #[arg(long, default_value = "vergence")]
    filter: Name,
    /// Sensors to read: 6 is gyroscope and accelerometer, 9 also the magnetometer; default: 9 where there is one
    #[arg(long, value_parser = ["6", "9"])]
    axes: Option<String>,
    /// Looks ahead: each orientation from the whole recording (for the filter vergence)
    #[arg(long)]
    offline: bool,
    /// Parameters of the filter: TOML, one key for each knob as in the documentation of vergence-inertial
    #[arg(long, value_name = "FILE.toml")]
    config: Option<PathBuf>,
    /// The unit that recorded, for the filter vergence: broad (readings 4 ms late) or unknown (not late). Default: broad for a table
    /// of BROAD's style, else unknown
    #[arg(long, value_parser = Unit::ALL.map(Unit::name))]
    unit: Option<String>,
    /// What `imu calibrate` found of this unit: taken out of each reading before the filter sees it
    #[arg(long, value_name = "FILE.toml")]
    calibration: Option<PathBuf>,
    /// Where to write `t_s,qw,qx,qy,qz`: rotations of sensor-frame vectors into the earth frame, ENU
    #[arg(short, long)]
    out: PathBuf,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

/// A filter by its name.
#[derive(Clone, Copy, Debug)]
pub struct Name(pub Kind);

impl ValueEnum for Name {
    fn value_variants<'a>() -> &'a [Self] {
        const ALL: [Name; Kind::ALL.len()] = {
            let mut all = [Name(Kind::ALL[0]); Kind::ALL.len()];
            let mut i = 0;
            while i < all.len() {
                all[i] = Name(Kind::ALL[i]);
                i += 1;
            }
            all
        };
        &ALL
    }

    fn to_possible_value(&self) -> Option<clap::builder::PossibleValue> {
        Some(clap::builder::PossibleValue::new(self.0.name()))
    }
}

impl Args {
    /// Reads, filters, writes.
    pub fn run(self) -> Result<(), Failure> {
        let read = [Some(&self.input), self.config.as_ref(), self.calibration.as_ref()];
        input::check_out(&self.out, &read)?;
        let calibration = self.calibration.as_deref().map(Calibration::read).transpose();
        let calibration = calibration.map_err(|error| Failure::call(&error))?;
        let mut recording = input::read(&self.input, self.stream.as_deref())?;
        if let Some(unit) = self.unit.as_deref().and_then(Unit::from_name) {
            recording.unit = unit;
        }
        let unit = recording.unit;
        if let Some(calibration) = calibration {
            recording.samples.iter_mut().for_each(|(_, imu)| *imu = calibration.correct(imu));
        }
        let axes = match self.axes.as_deref() {
            Some("9") => Axes::Nine,
            None if recording.has_mag() => Axes::Nine,
            _ => Axes::Six,
        };
        if axes == Axes::Nine && !recording.has_mag() {
            return Err(Failure::Call(format!(
                "{} has no magnetometer: expected --axes 6",
                self.input.display()
            )));
        }
        let period = recording.period().ok_or_else(|| Failure::Work("fewer than two samples".to_owned()))?;
        let called = |error: vergence_inertial::Error| Failure::call(&error);
        let mut filter = match &self.config {
            Some(config) => self.filter.0.configured(unit, axes, period, config).map_err(called)?,
            None => self.filter.0.of(unit, axes, period),
        };
        if self.offline && self.filter.0 != Kind::Vergence {
            return Err(Failure::Call(format!(
                "expected --filter vergence with --offline, found {}",
                self.filter.0.name()
            )));
        }
        let started = timing::thread_cpu_ns();
        let orientations = if self.offline {
            let params = match &self.config {
                Some(config) => filter::read_unit_params(config, unit).map_err(called)?,
                None => unit.params(),
            };
            // What is rejected does not depend on the direction: the causal filter counts it.
            filter::run(filter.as_mut(), &recording.samples);
            filter::offline(params, axes, period, &recording.samples)
        } else {
            filter::run(filter.as_mut(), &recording.samples)
        };
        let ns_per_sample = (timing::thread_cpu_ns() - started) / recording.samples.len() as f64;
        let out = |error: std::io::Error| Failure::Work(format!("{}: {error}", self.out.display()));
        let times = recording.samples.iter().map(|(at, _)| *at);
        let file = BufWriter::new(File::create(&self.out).map_err(out)?);
        write_orientations(file, times.zip(orientations)).map_err(out)?;
        // Where it is the rule, not the exception, the readings are in another unit. Sensors that are slower than the gyroscope miss many
        // samples, but not all.
        let mut warnings = Vec::new();
        let samples = recording.samples.len() as u64;
        for (name, expected, most) in [
            ("gyr_saturated", "rates in rad/s", samples / 20),
            ("acc_wrong", "accelerations in m/s² (gravity is 9.8)", samples - 1),
            ("acc_zero", "accelerations in m/s² (gravity is 9.8)", samples - 1),
            ("mag_wrong", "a field in µT", samples - 1),
        ] {
            let found = filter.rejections().occurred().find(|(found, _)| *found == name);
            if let Some((_, count)) = found.filter(|(_, count)| *count > most) {
                let input = self.input.display();
                let warning =
                    format!("{input}: expected {expected}, found {name} in {count} of {samples} samples");
                log::warn!("{warning}");
                warnings.push(warning);
            }
        }
        let rejected: serde_json::Map<String, serde_json::Value> =
            filter.rejections().occurred().map(|(name, count)| (name.to_owned(), json!(count))).collect();
        if self.json {
            println!(
                "{}",
                json!({
                    "samples": recording.samples.len(),
                    "ns_per_sample": ns_per_sample,
                    "unit": unit.name(),
                    "rejected": rejected,
                    "warnings": warnings,
                })
            );
        } else {
            println!(
                "{} samples, {ns_per_sample:.0} ns each, unit: {}",
                recording.samples.len(),
                unit.name()
            );
            for (reason, count) in &rejected {
                println!("rejected: {reason} in {count} samples");
            }
        }
        Ok(())
    }
}
