//! `vergence imu run`: a filter over a recording.

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use nalgebra::Vector3;
use serde_json::json;
use vergence_inertial::filter::{self, Axes, Kind, Rejections};
use vergence_inertial::{Recording, Unit};
use vergence_sense::Imu;

use super::{input, output};
use crate::failure::Failure;
use crate::timing;

/// Runs an orientation filter over a recording and writes an orientation for each sample
///
/// The three sensors speak of one right-handed frame. At rest the accelerometer points up: +9.8 m/s² along whatever axis is up (specific force;
/// units that give −9.8 there need their sign turned). Turning anticlockwise about an axis, seen from its tip, is positive. The
/// magnetometer points north and, on the northern half of the earth, down; that of many units has other axes than its gyroscope and has to be
/// turned before: by --turn, or by `[axes]` in the file of --calibration.
///
/// How gravity and the field turn in the recording tells whether the three fit together: where they do not, and another order or other signs
/// of the axes (or degrees for radians) clearly explain it, that is warned of with what would mend it. Turning does not tell: the sign of all
/// three axes of the accelerometer or of the magnetometer together (it goes as the dip of the field that is printed: above the horizon is right
/// south of the magnetic equator, and wrong north of it), and whether the gyroscope has its signs turned or all three sensors are left-handed.
///
/// How late readings are is a property of the unit that they do not tell. A table of BROAD's style is taken for one of BROAD's unit,
/// whose readings are 4 ms late, anything else for one of a unit that is not late; what was taken is printed. For a table of a unit of
/// your own give --unit unknown, or its lag in a --config (latency_s, acc_lag_s, mag_lag_s, gyr_averaged).
#[derive(clap::Args)]
pub struct Args {
    /// A table `t_s,gyr_x,…,acc_z[,mag_x,…]` (rad/s, m/s², µT; .csv or .csv.gz; - for stdin), EuRoC's imu0 (data.csv, its folder or one around
    /// it), or a session's log (.mcap)
    #[arg(required_unless_present = "print_config")]
    input: Option<PathBuf>,
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
    /// Parameters of the filter: TOML, one key for each knob; --print-config shows them all
    #[arg(long, value_name = "FILE.toml")]
    config: Option<PathBuf>,
    /// Prints the filter's knobs as a file for --config, each with its meaning, range and default, and does nothing else
    #[arg(long, conflicts_with_all = ["input", "out", "config", "json"])]
    print_config: bool,
    /// The unit that recorded, for the filter vergence: broad (readings 4 ms late) or unknown (not late). Default: broad for a table
    /// of BROAD's style, else unknown
    #[arg(long, value_parser = Unit::ALL.map(Unit::name))]
    unit: Option<String>,
    #[command(flatten)]
    corrections: input::Corrections,
    /// Where to write `t_s,qw,qx,qy,qz`: rotations of sensor-frame vectors into the earth frame, ENU; compressed where the name ends
    /// with .gz; - for stdout
    #[arg(short, long, required_unless_present = "print_config")]
    out: Option<PathBuf>,
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

/// More than this share of a sensor's readings is not refused where the readings are in the right unit.
const MOST_REFUSED: f64 = 0.05;

/// Warns of sensors of which much is refused: where that is the rule, not the exception, the readings are in another unit. Readings that are
/// missing (of a sensor that is slower than the gyroscope) are not refused.
fn refused(recording: &Recording, rejections: Rejections, input: &Path) -> Vec<String> {
    let lengths = |of: &dyn Fn(&Imu) -> Option<Vector3<f64>>| -> (Vec<f64>, u64) {
        let read: Vec<f64> =
            recording.samples.iter().filter_map(|(_, imu)| of(imu)).map(|v| v.norm()).collect();
        let all = read.len();
        let finite: Vec<f64> = read.into_iter().filter(|length| length.is_finite()).collect();
        let missing = (all - finite.len()) as u64;
        (finite, missing)
    };
    let mut warnings = Vec::new();
    for (sensor, expected, of) in [
        (
            "gyr",
            "rates in rad/s",
            &(|imu: &Imu| Some(imu.gyr_rad_s)) as &dyn Fn(&Imu) -> Option<Vector3<f64>>,
        ),
        ("acc", "accelerations in m/s² (gravity is 9.8)", &|imu: &Imu| Some(imu.acc_m_s2)),
        ("mag", "a field in µT", &|imu: &Imu| imu.mag_ut),
    ] {
        let (finite, missing) = lengths(of);
        for (name, count) in rejections.occurred() {
            let is_of_unit = name.starts_with(sensor) && !name.ends_with("not_finite");
            // What is missing counts as wrong.
            let count = if name.ends_with("wrong") { count.saturating_sub(missing) } else { count };
            if !is_of_unit || count as f64 <= MOST_REFUSED * finite.len() as f64 {
                continue;
            }
            let warning = format!(
                "{}: expected {expected}, found {name} in {count} of {} readings, their median length is {:.4}",
                input.display(),
                finite.len(),
                timing::median(&finite)
            );
            log::warn!("{warning}");
            warnings.push(warning);
        }
    }
    warnings
}

impl Args {
    /// Reads, filters, writes.
    pub fn run(self) -> Result<(), Failure> {
        let named = self.unit.as_deref().and_then(Unit::from_name);
        let (Some(input), Some(out), false) = (&self.input, &self.out, self.print_config) else {
            // Without a recording only what was said is known of the unit.
            print!("{}", self.filter.0.config_text(named.unwrap_or_default()));
            return Ok(());
        };
        let read = [Some(input), self.config.as_ref(), self.corrections.calibration.as_ref()];
        input::check_out(out, &read)?;
        if self.json && output::is_stdout(out) {
            return Err(Failure::Call("--json: expected a file for --out, found - (stdout)".to_owned()));
        }
        let corrections = self.corrections.read()?;
        let mut recording = input::read(input, self.stream.as_deref())?;
        recording.unit = named.unwrap_or(recording.unit);
        let unit = recording.unit;
        input::corrected(&corrections, &mut recording);
        let axes = match self.axes.as_deref() {
            Some("9") => Axes::Nine,
            None if recording.has_mag() => Axes::Nine,
            _ => Axes::Six,
        };
        if axes == Axes::Nine && !recording.has_mag() {
            return Err(Failure::Call(format!("{} has no magnetometer: expected --axes 6", input.display())));
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
        let times = recording.samples.iter().map(|(at, _)| *at);
        output::write(out, times.zip(orientations))?;
        let (mut warnings, dip_deg) = input::checked_frames(&recording, input);
        warnings.extend(refused(&recording, filter.rejections(), input));
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
                    "dip_deg": dip_deg,
                    "warnings": warnings,
                })
            );
        } else {
            let mut text = format!(
                "{} samples, {ns_per_sample:.0} ns each, unit: {}\n",
                recording.samples.len(),
                unit.name()
            );
            if let Some(dip_deg) = dip_deg.filter(|_| axes == Axes::Nine) {
                text += &if dip_deg < 0.0 {
                    let up = -dip_deg;
                    format!(
                        "field: {up:.0}° above the horizon: right south of the magnetic equator; north of it accelerometer or magnetometer have their signs turned\n"
                    )
                } else {
                    format!("field: {dip_deg:.0}° below the horizon\n")
                };
            }
            for (reason, count) in &rejected {
                text += &format!("rejected: {reason} in {count} samples\n");
            }
            // Rows have stdout for themselves.
            if output::is_stdout(out) { eprint!("{text}") } else { print!("{text}") }
        }
        Ok(())
    }
}
