//! `vergence imu compare`: every filter over one recording, against its truth.

use std::path::{Path, PathBuf};

use serde_json::json;
use vergence_inertial::filter::{self, Axes, Kind};
use vergence_inertial::{Score, score};
use vergence_report::{Cell, Column, Table};

use super::input;
use super::truth::Truth;
use crate::failure::Failure;

/// Runs every filter over a recording and scores each against the truth, in degrees
///
/// The truth is that of the recording, or with --truth another one. Of a trajectory (lines `t x y z qx qy qz qw`, world with z up) every pose
/// counts, and the heading only after aligning the start.
#[derive(clap::Args)]
pub struct Args {
    /// The recording: as for `imu run`
    input: PathBuf,
    /// The stream of a session's log; by default its only inertial unit
    #[arg(long)]
    stream: Option<String>,
    /// A truth as for `imu eval`: a trajectory in the TUM format, EuRoC's, orientations
    #[arg(long, value_name = "TRUTH")]
    truth: Option<PathBuf>,
    #[command(flatten)]
    corrections: input::Corrections,
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
        let mut recording = input::read(&self.input, self.stream.as_deref())?;
        let truth = match &self.truth {
            Some(path) => Truth::read(path)?,
            // Before anything is corrected; of a log also what is not beside the samples.
            None if input::is_log(&self.input) && recording.truth.is_empty() => Truth::read(&self.input)?,
            None if recording.truth.is_empty() => {
                return Err(Failure::Work(format!(
                    "{}: expected a truth (columns gt_qw,gt_qx,gt_qy,gt_qz), found none: give one by --truth",
                    self.input.display()
                )));
            }
            None => Truth::Rows(Box::new(recording.clone())),
        };
        self.corrections.apply(&mut recording)?;
        let period = recording.period().ok_or_else(|| Failure::Work("fewer than two samples".to_owned()))?;
        let axes = if self.axes == "6" { Axes::Six } else { Axes::Nine };
        if axes == Axes::Nine && !recording.has_mag() {
            return Err(Failure::Call(format!(
                "{} has no magnetometer: expected --axes 6",
                self.input.display()
            )));
        }
        let (warnings, _) = input::checked_frames(&recording, &self.input);
        let path: &Path = self.truth.as_deref().unwrap_or(&self.input);
        let mut scores = Vec::new();
        for kind in Kind::ALL {
            let estimates = filter::run(kind.of(recording.unit, axes, period).as_mut(), &recording.samples);
            let times = recording.samples.iter().map(|(at, _)| *at);
            let estimate: Vec<_> = times.zip(estimates).collect();
            let (pairs, _) = truth.pairs(&estimate, &self.input, path)?;
            let score = score(&pairs).ok_or_else(|| self.nothing())?;
            scores.push((kind, score));
        }
        // Without a magnetometer, or in a world that knows no north, the heading says nothing.
        let first = if axes == Axes::Six || !truth.knows_north() { 2 } else { 0 };
        self.print(&scores, first, &warnings);
        Ok(())
    }

    fn nothing(&self) -> Failure {
        let truth: &Path = self.truth.as_deref().unwrap_or(&self.input);
        Failure::Work(format!(
            "{}: expected a truth at the times of the recording, found none",
            truth.display()
        ))
    }

    fn print(&self, scores: &[(Kind, Score)], first: usize, warnings: &[String]) {
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
            let mut object: serde_json::Map<_, _> = filters.collect();
            object.insert("warnings".to_owned(), json!(warnings));
            println!("{}", serde_json::Value::Object(object));
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
