//! `vergence imu compare`: every filter over one recording, against its truth.

use std::path::{Path, PathBuf};

use serde_json::json;
use vergence_geom::slerp;
use vergence_inertial::filter::{self, Axes, Kind};
use vergence_inertial::{Pair, Score, read_tum_orientations, score};
use vergence_report::{Cell, Column, Table};

use super::input;
use crate::failure::Failure;

/// Runs every filter over a recording and scores each against the truth, in degrees
///
/// The truth is that of the recording, or a trajectory in the TUM format (lines `t x y z qx qy qz qw`, world with z up)
/// with --truth: then every pose of it counts, and the heading only after aligning the start.
#[derive(clap::Args)]
pub struct Args {
    /// The recording: as for `imu run`
    input: PathBuf,
    /// The stream of a session's log; by default its only inertial unit
    #[arg(long)]
    stream: Option<String>,
    /// A trajectory in the TUM format
    #[arg(long, value_name = "TUM")]
    truth: Option<PathBuf>,
    /// Sensors to read: 6 is gyroscope and accelerometer, 9 also the magnetometer
    #[arg(long, default_value = "6", value_parser = ["6", "9"])]
    axes: String,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

impl Args {
    /// Reads, filters, scores.
    pub fn run(self) -> Result<(), Failure> {
        let failed = |error: vergence_inertial::Error| Failure::work(&error);
        let recording = input::read(&self.input, self.stream.as_deref())?;
        let period = recording.period().ok_or_else(|| Failure::Work("fewer than two samples".to_owned()))?;
        let axes = if self.axes == "6" { Axes::Six } else { Axes::Nine };
        if axes == Axes::Nine && !recording.has_mag() {
            return Err(Failure::Call(format!(
                "{} has no magnetometer: expected --axes 6",
                self.input.display()
            )));
        }
        let truth = self.truth.as_deref().map(read_tum_orientations).transpose().map_err(failed)?;
        let mut scores = Vec::new();
        for kind in Kind::ALL {
            let estimates = filter::run(kind.of(recording.unit, axes, period).as_mut(), &recording.samples);
            let times = recording.samples.iter().map(|(at, _)| *at);
            let estimate: Vec<_> = times.zip(estimates).collect();
            let pairs = match &truth {
                Some(truth) => between(&estimate, truth),
                None => recording.scored(&estimate, &self.input).map_err(failed)?,
            };
            let score = score(&pairs).ok_or_else(|| self.nothing())?;
            scores.push((kind, score));
        }
        self.print(&scores, axes);
        Ok(())
    }

    fn nothing(&self) -> Failure {
        let truth: &Path = self.truth.as_deref().unwrap_or(&self.input);
        Failure::Work(format!(
            "{}: expected a truth at the times of the recording, found none",
            truth.display()
        ))
    }

    fn print(&self, scores: &[(Kind, Score)], axes: Axes) {
        let row = |s: &Score| {
            let absolute = [s.total_rad, s.heading_rad];
            let relative = [s.inclination_rad, s.start_heading_rad, s.start_total_rad, s.mean_total_rad];
            absolute.into_iter().chain(relative).map(f64::to_degrees).collect::<Vec<f64>>()
        };
        let names = [
            "total_deg",
            "heading_deg",
            "inclination_deg",
            "start_heading_deg",
            "start_total_deg",
            "mean_total_deg",
        ];
        // Without a magnetometer, or in a world that knows no north, the heading says nothing.
        let first = if axes == Axes::Six || self.truth.is_some() { 2 } else { 0 };
        if self.json {
            let filters = scores.iter().map(|(kind, score)| {
                let mut object: serde_json::Map<_, _> = names
                    .iter()
                    .zip(row(score))
                    .skip(first)
                    .map(|(name, v)| ((*name).to_owned(), json!(v)))
                    .collect();
                object.insert("samples".to_owned(), json!(score.samples));
                (kind.name().to_owned(), serde_json::Value::Object(object))
            });
            println!("{}", serde_json::Value::Object(filters.collect()));
            return;
        }
        let titles = std::iter::once("filter").chain(names.into_iter().skip(first));
        let mut table = Table::new(titles.map(|title| Column::new(title, 3)).collect());
        for (kind, score) in scores {
            let numbers = row(score).into_iter().skip(first).map(Cell::Number);
            table.push(std::iter::once(Cell::Text(kind.name().to_owned())).chain(numbers).collect(), false);
        }
        println!("{}", table.to_text());
        println!("{} poses compared", scores.first().map_or(0, |(_, score)| score.samples));
    }
}

type Stamped = (vergence_time::Timestamp, nalgebra::UnitQuaternion<f64>);

/// Each pose of the truth with the estimate of its time, interpolated between samples.
fn between(estimate: &[Stamped], truth: &[Stamped]) -> Vec<Pair> {
    let pair = |(time, truth): &Stamped| {
        let after = estimate.partition_point(|(at, _)| at < time);
        let (to, from) = (estimate.get(after)?, estimate.get(after.checked_sub(1)?)?);
        let part = time.since(from.0)?.as_secs_f64() / to.0.since(from.0)?.as_secs_f64();
        Some((*time, slerp(&from.1, &to.1, part), *truth))
    };
    truth.iter().filter_map(pair).collect()
}
