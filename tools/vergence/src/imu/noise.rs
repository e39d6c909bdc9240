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
/// there is something else than these noises, such as vibration: the numbers of that axis mean little. Written to the folder: gyroscope.svg, accelerometer.svg, noise.html, noise.json.
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
    let fitted = axes[0].curve.iter().map(|point| Point::new(point.tau_s, axes[0].fitted(point.tau_s)));
    plot.with(Series::new("x, as fitted", Style::FaintPoints, fitted.collect()))
}

fn table(noise: &ImuNoise) -> Table {
    let titles = [
        ("sensor", 8),
        ("mean", 8),
        ("density (/√Hz)", 8),
        ("±", 8),
        ("instability", 8),
        ("±", 8),
        ("walk (/√s)", 8),
        ("±", 8),
        ("least deviation", 8),
        ("at (s)", 3),
        ("fitted from (s)", 3),
        ("misfit", 1),
    ];
    let mut table = Table::new(titles.iter().map(|(title, places)| Column::new(*title, *places)).collect());
    let known = |value: Option<f64>, deviation: f64| value.map_or(Cell::Empty, |_| Cell::Number(deviation));
    let optional = |value: Option<f64>| value.map_or(Cell::Text("not seen".to_owned()), Cell::Number);
    let rows = [("gyroscope", "rad/s", &noise.gyr), ("accelerometer", "m/s²", &noise.acc)];
    for (sensor, unit, axes) in rows {
        for (axis, name) in axes.iter().zip(AXES) {
            table.push(
                vec![
                    Cell::Text(format!("{sensor} {name} ({unit})")),
                    Cell::Number(axis.mean),
                    Cell::Number(axis.density),
                    Cell::Number(axis.deviations[0]),
                    optional(axis.instability),
                    known(axis.instability, axis.deviations[1]),
                    optional(axis.walk),
                    known(axis.walk, axis.deviations[2]),
                    Cell::Number(axis.floor.deviation),
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

impl Args {
    /// Reads, analyses, draws.
    pub fn run(self) -> Result<(), Failure> {
        let recording = input::read(&self.input, self.stream.as_deref())?;
        let noise = imu_noise(&recording.samples)
            .map_err(|error| Failure::Work(format!("{}: {error}", self.input.display())))?;
        std::fs::create_dir_all(&self.out)
            .map_err(|e| Failure::Work(format!("{}: {e}", self.out.display())))?;
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
        if self.json {
            println!("{json}");
        } else {
            println!("{what}\n{}", table.to_text());
            println!("look at it: {}", self.out.join("noise.html").display());
        }
        Ok(())
    }
}
