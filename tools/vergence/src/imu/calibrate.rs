//! `vergence imu calibrate`: the errors of a unit, from a recording with rests and turns.

use std::path::PathBuf;

use vergence_inertial::calibrate::{CalibrateParams, Calibration, TriadCalibration, calibrate};

use super::{input, output};
use crate::failure::Failure;

/// Finds bias, scale, cross-axis terms and offsets from a recording with rests and turns between them
///
/// Lay the unit down or hold it still for two seconds in each of nine or more directions, and turn it about all axes in
/// between. One rest alone gives the bias of the gyroscope. What could not be observed is said, and stays as it was: of a recording in
/// which the unit never rests (a flight), the bias too.
/// A triad measures `matrix * true + offset`; deviations (`_sd`) are standard deviations.
#[derive(clap::Args)]
pub struct Args {
    /// The recording: as for `imu run`
    input: PathBuf,
    /// The stream of a session's log; by default its only inertial unit
    #[arg(long)]
    stream: Option<String>,
    #[command(flatten)]
    turns: input::Turns,
    /// Where to write the calibration
    #[arg(short, long, value_name = "TOML")]
    out: PathBuf,
    /// Length of gravity where it was recorded, m/s²
    #[arg(long, value_name = "M_S2", default_value_t = CalibrateParams::default().gravity_m_s2)]
    gravity: f64,
    /// Strength of the magnetic field where it was recorded, µT; without it the mean scale is taken as 1
    #[arg(long, value_name = "UT")]
    field: Option<f64>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

fn row(name: &str, values: &[f64], deviations: &[f64], unit: &str) {
    let numbers: Vec<String> =
        values.iter().zip(deviations).map(|(v, sd)| format!("{v:11.6} ± {sd:8.1e}")).collect();
    println!("  {name:9} {} {unit}", numbers.join("  "));
}

fn show(name: &str, unit: &str, triad: &TriadCalibration) {
    println!(
        "{name}: measured = matrix · true + offset; length {:.4} {unit}, residual {:.4} {unit}",
        triad.length, triad.residual
    );
    row("offset", &triad.offset, &triad.offset_sd, unit);
    for (values, deviations) in triad.matrix.iter().zip(&triad.matrix_sd) {
        row("matrix", values, deviations, "");
    }
}

fn show_all(found: &Calibration) {
    println!("{} rests", found.rests);
    println!("gyroscope:");
    row("bias", &found.gyr_bias_rad_s, &found.gyr_bias_sd_rad_s, "rad/s");
    show("accelerometer", "m/s²", &found.accelerometer);
    if let Some(mag) = &found.magnetometer {
        show("magnetometer", "µT", mag);
    }
    for missing in &found.not_observed {
        println!("not observed: {missing}");
    }
}

impl Args {
    /// Reads, calibrates, writes.
    pub fn run(self) -> Result<(), Failure> {
        let positive = |name: &str, value: f64| {
            let fits = value.is_finite() && value > 0.0;
            fits.then_some(())
                .ok_or_else(|| Failure::Call(format!("--{name}: expected a positive number, found {value}")))
        };
        positive("gravity", self.gravity)?;
        self.field.map_or(Ok(()), |field| positive("field", field))?;
        input::check_out(&self.out, &[Some(&self.input)])?;
        if self.json && output::is_stdout(&self.out) {
            return Err(Failure::Call("--json: expected a file for --out, found - (stdout)".to_owned()));
        }
        let axes = self.turns.axes()?;
        let mut recording = input::read(&self.input, self.stream.as_deref())?;
        recording.samples.iter_mut().for_each(|(_, imu)| *imu = axes.of(imu));
        let (warnings, _) = input::checked_frames(&recording, &self.input);
        let params = CalibrateParams { gravity_m_s2: self.gravity, field_ut: self.field };
        let mut found = calibrate(&recording.samples, &params)
            .map_err(|error| Failure::Work(format!("{}: {error}", self.input.display())))?;
        found.axes = axes;
        let text = toml::to_string(&found).map_err(|error| Failure::work(&error))?;
        if output::is_stdout(&self.out) {
            print!("{text}");
            return Ok(());
        }
        std::fs::write(&self.out, text)
            .map_err(|e| Failure::Work(format!("{}: cannot be written: {e}", self.out.display())))?;
        if self.json {
            let mut object = serde_json::to_value(&found).map_err(|error| Failure::work(&error))?;
            object["warnings"] = serde_json::json!(warnings);
            println!("{object}");
        } else {
            show_all(&found);
            println!("written: {}", self.out.display());
        }
        Ok(())
    }
}
