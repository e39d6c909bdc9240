//! `vergence imu noise`: the noise of a unit at rest, by its Allan deviation.

use std::path::PathBuf;

use vergence_inertial::allan::{AxisNoise, ImuNoise, imu_noise};
use vergence_report::{Axis, Cell, Column, Page, Plot, Point, Series, Style, Table};

use super::input;
use crate::failure::Failure;

/// Finds noise densities and bias instability from a recording at rest (Allan deviation), and draws the curves
///
/// The longest rest of the recording is used. A minute tells the densities, hours the instability and the walk. Where a low-pass in
/// the sensor bends the beginning of the curve, the noises are fitted to what comes after it. A misfit beyond 3 (1 is chance) says that
/// there is something else than these noises, such as vibration: the numbers of that axis mean little. Written to the folder: gyroscope.svg,
/// accelerometer.svg, noise.html, noise.json, and imu.yaml with the keys of Kalibr's and EuRoC's files of units.
#[derive(clap::Args)]
pub struct Args {
    /// The recording: as for `imu run`
    input: PathBuf,
    /// The stream of a session's log; by default its only inertial unit
    #[arg(long)]
    stream: Option<String>,
    /// Folder for the plots; made where it is missing
    #[arg(short, long, value_name = "DIR", default_value = "allan")]
    out: PathBuf,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

const AXES: [&str; 3] = ["x", "y", "z"];

fn plot(title: &str, unit: &str, axes: &[AxisNoise; 3]) -> Plot {
    let mut plot =
        Plot::new(title, Axis::log("averaging time (s)"), Axis::log(format!("Allan deviation ({unit})")));
    for (axis, name) in axes.iter().zip(AXES) {
        let points = axis.curve.iter().map(|point| {
            let tooltip = format!("{name}: {:.3e} {unit} at {:.4} s", point.deviation, point.tau_s);
            Point::new(point.tau_s, point.deviation).with_tooltip(tooltip)
        });
        plot = plot.with(Series::new(name, Style::Line, points.collect()));
    }
    for (axis, name) in axes.iter().zip(AXES) {
        let fitted = axis.curve.iter().filter(|point| point.tau_s >= axis.from_s);
        let fitted = fitted.map(|point| Point::new(point.tau_s, axis.fitted(point.tau_s)));
        plot = plot.with(Series::new(format!("{name}, as fitted"), Style::Curve, fitted.collect()));
    }
    plot
}

/// Three digits.
fn short(value: f64) -> String {
    if value == 0.0 { "0".to_owned() } else { format!("{value:.2e}") }
}

fn table(noise: &ImuNoise) -> Table {
    let titles = [
        ("sensor", 0),
        ("unit u", 0),
        ("mean (u)", 0),
        ("density (u/√Hz)", 0),
        ("instability (u)", 0),
        ("walk (u/√s)", 0),
        ("least deviation (u)", 0),
        ("at (s)", 3),
        ("fitted from (s)", 3),
        ("misfit", 1),
    ];
    let mut table = Table::new(titles.iter().map(|(title, places)| Column::new(*title, *places)).collect());
    let known = |value: Option<f64>, deviation: f64| {
        let text = value.map(|value| format!("{} ± {deviation:.0e}", short(value)));
        Cell::Text(text.unwrap_or_else(|| "not seen".to_owned()))
    };
    let rows = [("gyroscope", "rad/s", &noise.gyr), ("accelerometer", "m/s²", &noise.acc)];
    for (sensor, unit, axes) in rows {
        for (axis, name) in axes.iter().zip(AXES) {
            table.push(
                vec![
                    Cell::Text(format!("{sensor} {name}")),
                    Cell::Text(unit.to_owned()),
                    Cell::Text(short(axis.mean)),
                    known(Some(axis.density), axis.deviations[0]),
                    known(axis.instability, axis.deviations[1]),
                    known(axis.walk, axis.deviations[2]),
                    Cell::Text(short(axis.floor.deviation)),
                    Cell::Number(axis.floor.tau_s),
                    Cell::Number(axis.from_s),
                    Cell::Number(axis.misfit),
                ],
                false,
            );
        }
    }
    table
}

/// The noises with the keys of Kalibr's and EuRoC's files: one number for three axes, the root of the mean of their squares.
fn yaml(noise: &ImuNoise) -> String {
    let mut text =
        format!("# From {:.0} s at rest, the root of the mean square over three axes.\n", noise.seconds);
    let mean = |of: &[Option<f64>]| -> Option<f64> {
        let squares: Option<f64> = of.iter().map(|value| value.map(|v| v * v)).sum();
        squares.map(|squares| (squares / of.len() as f64).sqrt())
    };
    let mut line = |key: &str, value: Option<f64>, unit: &str| {
        text += &match value {
            Some(value) => format!("{key}: {} # {unit}\n", short(value)),
            None => format!("# {key}: not seen on every axis: a longer rest would tell # {unit}\n"),
        };
    };
    for (sensor, unit, axes) in [("accelerometer", "m/s²", &noise.acc), ("gyroscope", "rad/s", &noise.gyr)] {
        let density = axes.each_ref().map(|axis| Some(axis.density));
        line(&format!("{sensor}_noise_density"), mean(&density), &format!("{unit}/√Hz"));
        let walk = axes.each_ref().map(|axis| axis.walk);
        line(&format!("{sensor}_random_walk"), mean(&walk), &format!("{unit}/√s"));
    }
    text + &format!(
        "update_rate: {:.3} # Hz\nrate_hz: {:.3} # Hz, as EuRoC calls it\n",
        noise.rate_hz, noise.rate_hz
    )
}

impl Args {
    /// Reads, analyses, draws.
    pub fn run(self) -> Result<(), Failure> {
        Failure::unless_folder(&self.out)?;
        let recording = input::read(&self.input, self.stream.as_deref())?;
        let noise = imu_noise(&recording.samples)
            .map_err(|error| Failure::Work(format!("{}: {error}", self.input.display())))?;
        let save = |name: &str, text: &str| {
            let path = self.out.join(name);
            std::fs::write(&path, text).map_err(|e| Failure::Work(format!("{}: {e}", path.display())))
        };
        let what = format!(
            "{:.1} s at rest, {:.3} samples per second{}{}.",
            noise.seconds,
            noise.rate_hz,
            if noise.moved { "; the rest of the recording was left out" } else { "" },
            if noise.filled > 0 {
                format!("; {} missing samples put in", noise.filled)
            } else {
                String::new()
            },
        );
        let table = table(&noise);
        let mut page = Page::new("Noise of an inertial unit").paragraph(&what).table(&table);
        for (name, title, unit, axes) in [
            ("gyroscope", "Gyroscope", "rad/s", &noise.gyr),
            ("accelerometer", "Accelerometer", "m/s²", &noise.acc),
        ] {
            let plot = plot(title, unit, axes);
            save(&format!("{name}.svg"), &plot.to_svg().map_err(|e| Failure::work(&e))?)?;
            page = page.plot(&plot).map_err(|e| Failure::work(&e))?;
        }
        save("noise.html", &page.to_html())?;
        let json = serde_json::to_string(&noise).map_err(|error| Failure::work(&error))?;
        save("noise.json", &json)?;
        save("imu.yaml", &yaml(&noise))?;
        if self.json {
            println!("{json}");
        } else {
            println!("{what}\n{}", table.to_text());
            println!("look at it: {}", self.out.join("noise.html").display());
        }
        Ok(())
    }
}
