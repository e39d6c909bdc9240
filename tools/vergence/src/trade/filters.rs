//! `vergence trade filters`: what each smoothing filter leaves of the jitter, and what it costs in lag and error.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;

use indicatif::{ProgressBar, ProgressStyle};
use vergence_action::filter::judge::{Stretch, judge};
use vergence_action::filter::{DoubleExponentialParams, LowPassParams, OneEuroParams, Smoothing};
use vergence_config::Length;
use vergence_inertial::Dice;
use vergence_report::{Axis, Page, Plot, Point, Series, Style};
use vergence_slam::trajectory::Trajectory;
use vergence_time::Span;
use vergence_trade::{Knob, Measurement, Scale, Setting, Trade, Value};

use crate::failure::Failure;

#[derive(clap::Args)]
pub struct FilterTrade {
    /// Folder of recorded motion (TUM or EuRoC text); default: trajectories in the folder VERGENCE_DATA
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Folder for the results; made where it is missing
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Noise that is added to each axis (standard deviation, white)
    #[arg(long, value_name = "LENGTH", default_value = "1mm")]
    noise: Length,
    /// Of the noise
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// The first ten seconds of each recording, fewer positions of the knobs
    #[arg(long)]
    quick: bool,
    /// Print one JSON object at the end instead of tables
    #[arg(long)]
    json: bool,
}

/// Slower recordings say nothing of smoothing between frames.
const SLOWEST_HZ: f64 = 60.0;

/// Shares of jitter at which the filters are compared.
const COMPARED: [f64; 3] = [0.5, 0.25, 0.1];

const ERROR: usize = 0;
const LAG: usize = 1;

/// Every filter at several positions of its knobs, with the words for them.
fn candidates(quick: bool) -> Vec<(Smoothing, String)> {
    let mut all = vec![(Smoothing::None, "–".to_owned())];
    let thin =
        |values: &[f64]| -> Vec<f64> { values.iter().copied().step_by(if quick { 3 } else { 1 }).collect() };
    let cutoffs = [0.3, 0.6, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 9.0, 13.0, 20.0, 30.0];
    for cutoff_hz in thin(&cutoffs) {
        all.push((Smoothing::LowPass(LowPassParams { cutoff_hz }), format!("cutoff {cutoff_hz} Hz")));
    }
    for ms in thin(&[2.0, 4.0, 7.0, 10.0, 15.0, 22.0, 33.0, 50.0, 75.0, 110.0, 170.0, 250.0]) {
        let params = DoubleExponentialParams { time_s: ms * 1e-3, ahead_s: 0.0 };
        all.push((Smoothing::DoubleExponential(params), format!("time {ms} ms")));
    }
    for least_cutoff_hz in thin(&[0.1, 0.2, 0.4, 0.8, 1.5, 3.0, 6.0, 10.0, 16.0]) {
        for beta in [1.0, 3.0, 10.0, 20.0, 40.0, 80.0, 160.0, 320.0] {
            let params = OneEuroParams { least_cutoff_hz, beta, speed_cutoff_hz: 1.0 };
            all.push((Smoothing::OneEuro(params), format!("least cutoff {least_cutoff_hz} Hz, beta {beta}")));
        }
    }
    all
}

/// What one recording is called, and how much of it there is.
struct Source {
    name: String,
    seconds: f64,
    hertz: f64,
    metres_per_s: f64,
}

/// What was read: the recordings that are fast enough, the names of the others, and the former cut at their gaps.
struct Motion {
    sources: Vec<Source>,
    skipped: Vec<String>,
    stretches: Vec<Stretch>,
}

impl FilterTrade {
    pub fn run(self) -> Result<(), Failure> {
        let noise_m = self.noise.metres();
        if !(0.0..=1.0).contains(&noise_m) {
            return Err(Failure::Call(format!("--noise: expected 0 to 1 m, found {noise_m} m")));
        }
        let Motion { sources, skipped, stretches } = self.read(noise_m)?;
        std::fs::create_dir_all(&self.output).map_err(|e| Failure::unwritable(&self.output, &e))?;
        let candidates = candidates(self.quick);
        let bar = ProgressBar::new(candidates.len() as u64);
        if let Ok(style) = ProgressStyle::with_template("{bar:30} {pos}/{len} {msg}") {
            bar.set_style(style);
        }
        let trade = trade(&candidates, &stretches, &bar)?;
        bar.finish_and_clear();
        let said = method(&sources, &skipped, noise_m);
        self.write(&trade, &said)?;
        if self.json {
            println!("{}", json(&trade, &said));
            return Ok(());
        }
        let mut text = format!("{said}\n\n");
        let _ = writeln!(
            text,
            "{}; * is on the Pareto front of jitter left and error\n{}",
            trade.title(),
            trade.table(0, ERROR).to_text()
        );
        for share in COMPARED {
            let _ = writeln!(
                text,
                "at most {:.0} % of the jitter left, least error of each filter:",
                100.0 * share
            );
            for (name, index) in best_of_each(&trade, share) {
                let m = &trade.measurements()[index];
                let _ = writeln!(
                    text,
                    "  {name:<20} lag {:>6.1} ms, error {:>6.2} mm, jitter {:.2}  ({})",
                    m.errors[LAG],
                    m.errors[ERROR],
                    m.costs[0],
                    m.setting.get("knobs").map_or_else(String::new, ToString::to_string)
                );
            }
        }
        let _ = writeln!(text, "look at it: {}", self.output.join("filters.html").display());
        print!("{text}");
        Ok(())
    }

    /// With noise.
    fn read(&self, noise_m: f64) -> Result<Motion, Failure> {
        let variable = std::env::var_os("VERGENCE_DATA").filter(|value| !value.is_empty());
        let folder = self.data.clone().or_else(|| variable.map(|data| Path::new(&data).join("trajectories")));
        let folder = folder.ok_or_else(|| {
            Failure::Call("expected --data DIR or the variable VERGENCE_DATA, found neither".to_owned())
        })?;
        let entries =
            std::fs::read_dir(&folder).map_err(|e| Failure::Call(format!("{}: {e}", folder.display())))?;
        let mut paths: Vec<PathBuf> =
            entries.filter_map(|entry| entry.ok().map(|entry| entry.path())).collect();
        paths.retain(|path| path.extension().is_some_and(|end| end == "txt" || end == "csv" || end == "tum"));
        paths.sort();
        let (mut sources, mut skipped, mut stretches) = (Vec::new(), Vec::new(), Vec::new());
        for path in paths {
            let mut motion = Trajectory::read(&path).map_err(|error| Failure::work(&error))?;
            let name = path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
            let period_s = motion.period().map_or(f64::INFINITY, Span::as_secs_f64);
            if 1.0 / period_s < SLOWEST_HZ {
                skipped.push(name);
                continue;
            }
            if self.quick {
                motion.poses.truncate((10.0 / period_s) as usize);
            }
            let first = motion.poses[0].0;
            let seconds =
                motion.poses.last().and_then(|last| last.0.since(first)).map_or(0.0, Span::as_secs_f64);
            let dice = Dice::new(self.seed, sources.len() as u64);
            sources.push(Source {
                name,
                seconds,
                hertz: 1.0 / period_s,
                metres_per_s: motion.length_m() / seconds.max(period_s),
            });
            let mut open = Stretch::default();
            for (index, (at, pose)) in motion.poses.iter().enumerate() {
                let gap_s =
                    open.truth.last().and_then(|(last, _)| at.since(*last)).map_or(0.0, Span::as_secs_f64);
                if gap_s > 3.0 * period_s {
                    stretches.push(std::mem::take(&mut open));
                }
                open.truth.push((*at, pose.translation.vector.into()));
                open.noise.push(std::array::from_fn(|i| noise_m * dice.normal(3 * index as u64 + i as u64)));
            }
            stretches.push(open);
        }
        if sources.is_empty() {
            let message = format!(
                "{}: expected motion recorded at {SLOWEST_HZ} Hz or more, found none",
                folder.display()
            );
            return Err(Failure::Call(message));
        }
        Ok(Motion { sources, skipped, stretches })
    }

    fn write(&self, trade: &Trade, said: &str) -> Result<(), Failure> {
        let save = |name: &str, text: &str| {
            let path = self.output.join(name);
            std::fs::write(&path, text).map_err(|e| Failure::unwritable(&path, &e))
        };
        let mut page = Page::new("What smoothing costs").paragraph(said);
        for (scale, name) in [(ERROR, "error"), (LAG, "lag")] {
            let plot = plot(trade, scale);
            save(&format!("filters-{name}.svg"), &plot.to_svg().map_err(|e| Failure::work(&e))?)?;
            page = page.heading(&trade.errors()[scale].title()).plot(&plot).map_err(|e| Failure::work(&e))?;
        }
        page = page.heading(trade.title()).table(&trade.table(0, ERROR));
        save("filters.html", &page.to_html())?;
        let text = serde_json::to_string_pretty(&json(trade, said)).map_err(|e| Failure::work(&e))?;
        save("filters.json", &text)
    }
}

/// What was done, in sentences.
fn method(sources: &[Source], skipped: &[String], noise_m: f64) -> String {
    let mut text = format!("White noise of {} mm on each axis was added to", 1e3 * noise_m);
    for (index, source) in sources.iter().enumerate() {
        let _ = write!(
            text,
            "{} {} ({:.0} s, {:.0} Hz, {:.2} m/s)",
            if index == 0 { "" } else { "," },
            source.name,
            source.seconds,
            source.hertz,
            source.metres_per_s
        );
    }
    text.push_str(
        ". Jitter left: root of the mean square of what a filter makes of the noise alone, over that of the noise. Lag: the delay of \
         the truth to which the filtered motion is nearest in the mean square. Error: root of the mean square distance from the truth \
         at the same time.",
    );
    if !skipped.is_empty() {
        let _ = write!(text, " Left out, slower than {SLOWEST_HZ} Hz: {}.", skipped.join(", "));
    }
    text
}

fn trade(
    candidates: &[(Smoothing, String)],
    stretches: &[Stretch],
    bar: &ProgressBar,
) -> Result<Trade, Failure> {
    let mut names: Vec<Value> = Vec::new();
    for (smoothing, _) in candidates {
        let name = Value::from(smoothing.name());
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let knobs = candidates.iter().map(|(_, words)| Value::from(words.as_str())).collect();
    let mut trade = Trade::new(
        "smoothing of positions",
        vec![Knob::new("filter", "", names), Knob::new("knobs", "", knobs)],
        vec![Scale::new("jitter left", ""), Scale::new("time per sample", "ns")],
        vec![Scale::new("error", "mm"), Scale::new("lag", "ms")],
    )
    .map_err(|error| Failure::work(&error))?;
    for (smoothing, words) in candidates {
        bar.set_message(format!("{} {words}", smoothing.name()));
        let judged = judge(smoothing, stretches).map_err(|error| Failure::work(&error))?;
        let judged = judged
            .ok_or_else(|| Failure::Work("expected motion of more than a second, found less".to_owned()))?;
        let setting = Setting(vec![
            ("filter".to_owned(), Value::from(smoothing.name())),
            ("knobs".to_owned(), Value::from(words.as_str())),
        ]);
        let measurement = Measurement {
            setting,
            costs: vec![judged.jitter_left, time_ns(smoothing, stretches)?],
            errors: vec![1e3 * judged.error_m, 1e3 * judged.lag_s],
        };
        trade.push(measurement).map_err(|error| Failure::work(&error))?;
        bar.inc(1);
    }
    Ok(trade)
}

/// Of one update with three numbers, the fastest of three runs over the first stretch.
fn time_ns(smoothing: &Smoothing, stretches: &[Stretch]) -> Result<f64, Failure> {
    let mut least = f64::INFINITY;
    let samples = &stretches[0].truth[..stretches[0].truth.len().min(5000)];
    for _ in 0..3 {
        let mut smoother = smoothing.smoother::<3>().map_err(|error| Failure::work(&error))?;
        let started = Instant::now();
        for (at, place) in samples {
            std::hint::black_box(smoother.update(*at, *place));
        }
        least = least.min(started.elapsed().as_nanos() as f64 / samples.len() as f64);
    }
    Ok(least)
}

/// Every filter's own front over the jitter that it leaves, what lies behind it pale. Both axes are logarithmic, as errors span three
/// decades; what lags less than can be told (0.1 ms) is drawn there.
fn plot(trade: &Trade, scale: usize) -> Plot {
    let measurements = trade.measurements();
    let title = trade.errors()[scale].title();
    let (title, least) = if scale == LAG { (format!("{title}, at least 0.1"), 0.1) } else { (title, 0.0) };
    let point = |m: &Measurement| {
        let words = m.setting.get("knobs").map_or_else(String::new, ToString::to_string);
        let tooltip = format!(
            "{}: jitter {:.2}, error {:.2} mm, lag {:.1} ms",
            m.setting, m.costs[0], m.errors[ERROR], m.errors[LAG]
        );
        (Point::new(m.costs[0], m.errors[scale].max(least)).with_tooltip(tooltip), words)
    };
    let named =
        |m: &Measurement, name: &str| m.setting.get("filter").is_some_and(|own| own.to_string() == name);
    let (mut behind, mut fronts) = (Vec::new(), Vec::new());
    for filter in ["none", "low-pass", "double-exponential", "one-euro"] {
        let mut own: Vec<&Measurement> = measurements.iter().filter(|m| named(m, filter)).collect();
        own.sort_by(|a, b| {
            a.costs[0].total_cmp(&b.costs[0]).then(a.errors[scale].total_cmp(&b.errors[scale]))
        });
        let (mut lowest, mut front) = (f64::INFINITY, Vec::new());
        for m in own {
            let (point, words) = point(m);
            if m.errors[scale] < lowest {
                lowest = m.errors[scale];
                front.push(point.labelled(words));
            } else {
                behind.push(point);
            }
        }
        fronts.push(Series::new(filter, Style::Steps, front));
    }
    let title_of_jitter = trade.costs()[0].title();
    let plot = Plot::new(trade.title(), Axis::log(title_of_jitter), Axis::log(title)).with(Series::new(
        "other positions of the same knobs",
        Style::FaintPoints,
        behind,
    ));
    fronts.into_iter().fold(plot, Plot::with)
}

/// Of each filter that leaves at most this share of the jitter, the position with the least error.
fn best_of_each(trade: &Trade, share: f64) -> Vec<(String, usize)> {
    let mut best: Vec<(String, usize)> = Vec::new();
    for (index, m) in trade.measurements().iter().enumerate().filter(|(_, m)| m.costs[0] <= share) {
        let name = m.setting.get("filter").map_or_else(String::new, ToString::to_string);
        match best.iter_mut().find(|(own, _)| *own == name) {
            Some((_, before)) if trade.measurements()[*before].errors[ERROR] <= m.errors[ERROR] => {}
            Some((_, before)) => *before = index,
            None => best.push((name, index)),
        }
    }
    best
}

fn json(trade: &Trade, said: &str) -> serde_json::Value {
    let compared = COMPARED.iter().map(|share| {
        let best: serde_json::Map<_, _> = best_of_each(trade, *share)
            .into_iter()
            .map(|(name, index)| (name, serde_json::json!(trade.measurements()[index])))
            .collect();
        serde_json::json!({ "jitter_left": share, "best": best })
    });
    serde_json::json!({
        "method": said,
        "trade": trade,
        "front": trade.pareto(0, ERROR),
        "front_of_lag": trade.pareto(0, LAG),
        "compared": compared.collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_position_can_be_used_and_is_named_once() {
        for quick in [false, true] {
            let all = candidates(quick);
            assert!(all.iter().all(|(smoothing, _)| smoothing.fault().is_none()));
            for name in ["none", "low-pass", "double-exponential", "one-euro"] {
                assert!(all.iter().any(|(smoothing, _)| smoothing.name() == name), "{name}");
            }
            let mut words: Vec<&str> = all.iter().map(|(_, words)| words.as_str()).collect();
            words.sort_unstable();
            words.dedup();
            assert_eq!(words.len(), all.len());
        }
    }
}
