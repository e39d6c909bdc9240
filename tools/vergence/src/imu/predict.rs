//! `vergence imu predict`: how well the orientation some milliseconds ahead is foretold.

use std::path::PathBuf;

use serde::de::{Deserialize as _, IntoDeserializer as _};
use serde_json::json;
use vergence_inertial::filter::Axes;
use vergence_inertial::predict::{AtHorizon, Method, Track, judge};
use vergence_report::{Cell, Column, Table};
use vergence_time::Span;

use super::input;
use super::run::Name;
use crate::failure::Failure;
use crate::timing::thread_cpu_ns;

/// Predicts orientation over a recording and compares it with what came true, in degrees
///
/// Judged by what the filter says later, and by the truth of the recording where it has one (the way since the prediction
/// was made). Where the recording says when there is movement, only predictions made then count. Positions are not predicted here.
/// `*` is the least mean at its horizon, by the truth where there is one.
#[derive(clap::Args)]
pub struct Args {
    /// The recording: as for `imu run`
    input: PathBuf,
    /// The stream of a session's log; by default its only inertial unit
    #[arg(long)]
    stream: Option<String>,
    #[command(flatten)]
    corrections: input::Corrections,
    /// How far ahead, such as 21ms; several are separated by commas. At most 250ms
    #[arg(long, value_name = "TIME", value_parser = horizon, value_delimiter = ',', default_value = "21ms")]
    horizon: Vec<Span>,
    /// The method; default: all
    #[arg(long, value_parser = ["hold", "constant", "damped", "desp", "adaptive"])]
    method: Option<String>,
    /// The filter whose orientation is predicted, without magnetometer
    #[arg(long, default_value = "vergence")]
    filter: Name,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

fn horizon(text: &str) -> Result<Span, String> {
    if text.trim().parse::<f64>().is_ok() {
        return Err(format!("expected a time with its unit, found {text}: {}ms?", text.trim()));
    }
    let parsed: serde::de::value::StrDeserializer<'_, serde::de::value::Error> = text.into_deserializer();
    let seconds =
        vergence_config::Duration::deserialize(parsed).map_err(|error| error.to_string())?.seconds();
    let most = vergence_inertial::predict::MOST_AHEAD;
    Span::from_secs_f64(seconds)
        .filter(|span| *span > Span::ZERO && *span <= most)
        .ok_or_else(|| format!("expected more than 0 and at most {} ms, found {text}", most.as_millis_f64()))
}

impl Args {
    /// Reads, filters, predicts, judges.
    pub fn run(self) -> Result<(), Failure> {
        let mut recording = input::read(&self.input, self.stream.as_deref())?;
        self.corrections.apply(&mut recording)?;
        let period = recording.period().ok_or_else(|| Failure::Work("fewer than two samples".to_owned()))?;
        let mut filter = self.filter.0.of(recording.unit, Axes::Six, period);
        let track = Track::of(&recording, filter.as_mut());
        let chosen = self.method.as_deref().and_then(Method::named);
        let methods = Method::ALL.into_iter().filter(|method| chosen.is_none_or(|chosen| chosen == *method));
        let judged: Vec<(Method, Vec<AtHorizon>, f64)> = methods
            .map(|method| {
                let at = judge(method, &track, &self.horizon);
                (method, at, ns_per_observation(method, &track))
            })
            .collect();
        if judged.iter().any(|(_, at, _)| at.iter().any(|at| at.by_estimate.is_none())) {
            return Err(Failure::Work(format!(
                "{}: expected samples in movement at least {} ms before the end, found none",
                self.input.display(),
                self.horizon.iter().max().map_or(0.0, |span| span.as_millis_f64())
            )));
        }
        if self.json {
            let methods = judged.iter().map(|(method, at, ns)| {
                let horizons = self.horizon.iter().zip(at).map(|(span, at)| {
                    json!({ "horizon_ms": span.as_millis_f64(), "by_estimate": at.by_estimate, "by_truth": at.by_truth })
                });
                let value = json!({ "horizons": horizons.collect::<Vec<_>>(), "ns_per_sample": ns });
                (method.name().to_owned(), value)
            });
            let methods: serde_json::Map<_, _> = methods.collect();
            println!("{}", json!({ "filter": self.filter.0.name(), "methods": methods }));
        } else {
            println!("{}", self.table(&judged).to_text());
            let by_truth = judged.iter().any(|(_, at, _)| at.iter().any(|at| at.by_truth.is_some()));
            let by = if by_truth { "by the truth" } else { "by the filter's later orientation" };
            println!("degrees, of orientations from {}; *: least mean {by}", self.filter.0.name());
        }
        Ok(())
    }

    fn table(&self, judged: &[(Method, Vec<AtHorizon>, f64)]) -> Table {
        let titles = ["method", "ms", "mean", "95 %", "worst", "truth: mean", "95 %", "worst", "ns / sample"];
        let decimals = [0, 1, 3, 3, 2, 3, 3, 2, 0];
        let mut table = Table::new(
            titles.iter().zip(decimals).map(|(title, places)| Column::new(*title, places)).collect(),
        );
        for (place, span) in self.horizon.iter().enumerate() {
            let mean = |at: &AtHorizon| at.by_truth.or(at.by_estimate).map_or(f64::INFINITY, |j| j.mean_deg);
            let best = judged.iter().map(|(_, at, _)| mean(&at[place])).fold(f64::INFINITY, f64::min);
            for (method, at, ns) in judged {
                let at = &at[place];
                let mut cells =
                    vec![Cell::Text(method.name().to_owned()), Cell::Number(span.as_millis_f64())];
                for by in [at.by_estimate, at.by_truth] {
                    match by {
                        Some(by) => cells.extend([by.mean_deg, by.p95_deg, by.worst_deg].map(Cell::Number)),
                        None => cells.extend([Cell::Empty, Cell::Empty, Cell::Empty]),
                    }
                }
                cells.push(Cell::Number(*ns));
                table.push(cells, judged.len() > 1 && mean(at) <= best);
            }
        }
        table
    }
}

/// Processor time of one observation with one prediction 21 ms ahead.
fn ns_per_observation(method: Method, track: &Track) -> f64 {
    let mut predictor = method.rotation();
    let started = thread_cpu_ns();
    for ((time, estimate), rate) in track.times.iter().zip(&track.estimates).zip(&track.rates_rad_s) {
        predictor.observe(*time, estimate, rate);
        std::hint::black_box(predictor.predict(time.saturating_add(Span::from_millis(21))));
    }
    (thread_cpu_ns() - started) / track.times.len().max(1) as f64
}
