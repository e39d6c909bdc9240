//! `vergence trade imu`: what each orientation filter costs and how far it errs, over recordings with a truth.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressStyle};
use serde::de::{Deserialize as _, IntoDeserializer as _};
use vergence_inertial::filter::{
    self, Axes, Complementary, ComplementaryParams, Filter, Kind, Limits, Madgwick, MadgwickParams, Mahony,
    MahonyParams, Stream, Vergence, VergenceParams, Vqf, VqfParams,
};
use vergence_inertial::{Recording, Unit, score};
use vergence_report::Page;
use vergence_time::Span;
use vergence_trade::{Knob, Limit, Measurement, Scale, Setting, Trade, Value};

use crate::failure::Failure;
use crate::imu::{Corrections, corrected};
use crate::timing::thread_cpu_ns;

/// Every orientation filter, each at several positions of its main knob: time per sample against degrees
#[derive(clap::Args)]
pub struct ImuTrade {
    /// Folder of recordings with truth (BROAD-style .csv or .csv.gz); default: broad in the folder VERGENCE_DATA
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    #[command(flatten)]
    corrections: Corrections,
    /// Folder for the results; made where it is missing
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Choose the smallest error that takes at most this time per sample, such as 100ns; writes imu.toml for `imu run --config`
    #[arg(long, value_name = "TIME", value_parser = nanoseconds)]
    budget: Option<f64>,
    /// Choose the least time that errs at most this much, such as 3deg; with --budget too, only within that
    #[arg(long, value_name = "ANGLE", value_parser = degrees)]
    error: Option<f64>,
    /// Sensors that the choice is about: 6 is gyroscope and accelerometer, 9 also the magnetometer
    #[arg(long, default_value = "9", value_parser = ["6", "9"])]
    axes: String,
    /// The error that plots, fronts and choice are about
    #[arg(long, value_enum, default_value_t = Metric::Total)]
    metric: Metric,
    /// The first recording only, each filter at its default
    #[arg(long)]
    quick: bool,
    /// Print one JSON object at the end instead of tables
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Metric {
    /// Of the whole rotation; with 6 axes after aligning the heading at the start
    Total,
    /// About the vertical; with 6 axes after aligning the heading at the start
    Heading,
    /// Of the vertical
    Inclination,
}

/// As text in a configuration file.
fn text(text: &str) -> serde::de::value::StrDeserializer<'_, serde::de::value::Error> {
    text.into_deserializer()
}

fn nanoseconds(argument: &str) -> Result<f64, String> {
    let duration =
        vergence_config::Duration::deserialize(text(argument)).map_err(|error| error.to_string())?;
    Ok(duration.seconds() * 1e9)
}

fn degrees(argument: &str) -> Result<f64, String> {
    let angle = vergence_config::Angle::deserialize(text(argument)).map_err(|error| error.to_string())?;
    Ok(angle.radians().to_degrees())
}

/// What a file for `imu run --config` sets.
type Set = Vec<(&'static str, f64)>;

/// Makes a filter for a unit, some of its sensors and a period between samples.
type Make = Box<dyn Fn(Unit, Axes, Span) -> Box<dyn Filter>>;

/// A filter at one position of its main knob.
struct Candidate {
    kind: Kind,
    /// Such as "beta 0.12"; "default" where nothing is turned.
    position: String,
    /// The knobs that are turned.
    set: Set,
    make: Make,
}

impl Candidate {
    /// Whether each knob is where it is by default.
    fn is_default(&self) -> bool {
        let usual = self.kind.knobs(Unit::Unknown);
        self.set
            .iter()
            .all(|(name, value)| usual.iter().any(|(knob, usual)| knob.name == *name && usual == value))
    }

    /// A file for `imu run --config`.
    fn config_text(&self) -> String {
        let mut text =
            format!("# vergence imu run RECORDING --filter {} --config imu.toml\n", self.kind.name());
        for (name, value) in &self.set {
            let _ = writeln!(text, "{name} = {value:?}");
        }
        text
    }
}

/// Positions of each filter's main knob; the defaults are among them.
fn candidates(quick: bool) -> Vec<Candidate> {
    let mut all = Vec::new();
    for kind in Kind::ALL {
        let mut turned: Vec<(String, Set, Make)> = Vec::new();
        let mut add = |position: String, set: Set, make: Make| turned.push((position, set, make));
        match kind {
            _ if quick => {}
            Kind::Complementary => {
                for tau_acc_s in [0.3, 1.0, 3.0, 10.0] {
                    let params = ComplementaryParams { tau_acc_s, tau_mag_s: 3.0 * tau_acc_s };
                    let set = vec![("tau_acc_s", tau_acc_s), ("tau_mag_s", params.tau_mag_s)];
                    add(format!("tau_acc {tau_acc_s} s"), set, stream(move |_| Complementary::new(params)));
                }
            }
            Kind::Madgwick => {
                for beta in [0.03, 0.06, 0.12, 0.24, 0.5] {
                    let params = MadgwickParams { beta };
                    add(format!("beta {beta}"), vec![("beta", beta)], stream(move |_| Madgwick::new(params)));
                }
            }
            Kind::Mahony => {
                for kp in [0.2, 0.4, 0.74, 1.5, 3.0] {
                    let params = MahonyParams { kp, ..MahonyParams::default() };
                    add(format!("kp {kp}"), vec![("kp", kp)], stream(move |_| Mahony::new(params)));
                }
            }
            Kind::VqfBasic | Kind::Vqf => {
                let base = if kind == Kind::Vqf { VqfParams::FULL } else { VqfParams::BASIC };
                for tau_acc_s in [1.0, 2.0, 3.0, 5.0] {
                    let params = VqfParams { tau_acc_s, ..base };
                    let make = move |period: Span| Vqf::new(params, period.as_secs_f64());
                    add(format!("tau_acc {tau_acc_s} s"), vec![("tau_acc_s", tau_acc_s)], stream(make));
                }
            }
            Kind::Vergence => {
                for window_s in [0.05, 0.1, 0.2, 0.4] {
                    let make: Make = Box::new(move |unit, axes, period| {
                        let params = VergenceParams { window_s, ..unit.params() };
                        let core = Vergence::new(params, period.as_secs_f64());
                        Box::new(Stream::new(core, axes, period, Limits::default()))
                    });
                    add(format!("window {window_s} s"), vec![("window_s", window_s)], make);
                }
            }
            Kind::Integration => {}
        }
        if turned.is_empty() {
            turned.push((
                "default".to_owned(),
                Set::new(),
                Box::new(move |unit, axes, period| kind.of(unit, axes, period)),
            ));
        }
        all.extend(turned.into_iter().map(|(position, set, make)| Candidate { kind, position, set, make }));
    }
    all
}

fn stream<C: filter::Core + 'static>(core: impl Fn(Span) -> C + 'static) -> Make {
    Box::new(move |_, axes, period| Box::new(Stream::new(core(period), axes, period, Limits::default())))
}

/// What is measured of each candidate with each set of sensors: time, then the errors in the order of [`Metric`].
fn measure(
    candidate: &Candidate,
    axes: Axes,
    recordings: &[(PathBuf, Recording)],
) -> Result<(f64, [f64; 3]), Failure> {
    /// Runs over each recording; the fastest counts: what is slower is what else the machine did.
    const REPEATS: usize = 3;
    let (mut least_ns, mut errors) = (f64::INFINITY, [0.0; 3]);
    for (path, recording) in recordings {
        let period =
            recording.period().ok_or_else(|| Failure::Work(format!("{}: too short", path.display())))?;
        for _ in 0..REPEATS {
            let mut filter = (candidate.make)(recording.unit, axes, period);
            let started = thread_cpu_ns();
            for (at, imu) in &recording.samples {
                filter.update(*at, imu);
                std::hint::black_box(filter.earth_from_sensor());
            }
            least_ns = least_ns.min((thread_cpu_ns() - started) / recording.samples.len() as f64);
        }
        let estimates =
            filter::run((candidate.make)(recording.unit, axes, period).as_mut(), &recording.samples);
        let estimate: Vec<_> = recording.samples.iter().map(|(at, _)| *at).zip(estimates).collect();
        let pairs = recording.scored(&estimate, path).map_err(|error| Failure::work(&error))?;
        let score = score(&pairs).ok_or_else(|| {
            Failure::Work(format!("{}: expected a truth in movement, found none", path.display()))
        })?;
        let found = match axes {
            Axes::Nine => [score.total_rad, score.heading_rad, score.inclination_rad],
            Axes::Six => [score.start_total_rad, score.start_heading_rad, score.inclination_rad],
        };
        for (sum, angle) in errors.iter_mut().zip(found) {
            *sum += angle.to_degrees() / recordings.len() as f64;
        }
    }
    Ok((least_ns, errors))
}

impl ImuTrade {
    pub fn run(self) -> Result<(), Failure> {
        Failure::unless_folder(&self.output)?;
        let recordings = self.read()?;
        let limit = Limit::of(self.budget, self.error);
        let metric = self.metric as usize;
        let candidates = candidates(self.quick);
        let bar = ProgressBar::new(2 * candidates.len() as u64);
        if let Ok(style) = ProgressStyle::with_template("{bar:30} {pos}/{len} {msg}") {
            bar.set_style(style);
        }
        let trades = [(Axes::Nine, "9"), (Axes::Six, "6")];
        let trades = trades.into_iter().filter(|(axes, name)| {
            (*axes == Axes::Six || recordings.iter().all(|(_, r)| r.has_mag()))
                && (!self.quick || *name == self.axes)
        });
        let mut done = Vec::new();
        for (axes, name) in trades {
            done.push((name, trade(axes, &candidates, &recordings, &bar)?));
        }
        bar.finish_and_clear();
        let Some((_, chosen_from)) = done.iter().find(|(name, _)| *name == self.axes) else {
            return Err(Failure::Call("the recordings have no magnetometer: expected --axes 6".to_owned()));
        };
        let choice = limit.map(|limit| chosen_from.choose(0, metric, limit)).transpose();
        let chosen = choice.as_ref().ok().copied().flatten();
        self.write(&done, chosen, recordings.len(), &candidates)?;
        self.print(&done, chosen);
        choice.map(|_| ()).map_err(|error| Failure::work(&error))
    }

    fn read(&self) -> Result<Vec<(PathBuf, Recording)>, Failure> {
        let variable = std::env::var_os("VERGENCE_DATA").filter(|value| !value.is_empty());
        let folder = self.data.clone().or_else(|| variable.map(|data| Path::new(&data).join("broad")));
        let folder = folder.ok_or_else(|| {
            Failure::Call("expected --data DIR or the variable VERGENCE_DATA, found neither".to_owned())
        })?;
        let entries =
            std::fs::read_dir(&folder).map_err(|e| Failure::Call(format!("{}: {e}", folder.display())))?;
        let mut paths: Vec<PathBuf> =
            entries.filter_map(|entry| entry.ok().map(|entry| entry.path())).collect();
        paths.retain(|path| {
            let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
            name.ends_with(".csv") || name.ends_with(".csv.gz")
        });
        paths.sort();
        paths.truncate(if self.quick { 1 } else { usize::MAX });
        if paths.is_empty() {
            return Err(Failure::Call(format!(
                "{}: expected files .csv or .csv.gz, found none",
                folder.display()
            )));
        }
        let corrections = self.corrections.read()?;
        let read = |path: PathBuf| {
            let mut recording = Recording::read(&path).map_err(|error| Failure::work(&error))?;
            corrected(&corrections, &mut recording);
            Ok((path, recording))
        };
        paths.into_iter().map(read).collect()
    }

    fn write(
        &self,
        trades: &[(&str, Trade)],
        chosen: Option<usize>,
        recordings: usize,
        candidates: &[Candidate],
    ) -> Result<(), Failure> {
        let save = |name: &str, text: &str| {
            let path = self.output.join(name);
            std::fs::write(&path, text).map_err(|e| Failure::unwritable(&path, &e))
        };
        let metric = self.metric as usize;
        let mut page = Page::new("What orientation costs").paragraph(&format!(
            "{}; CPU time of one sample and one reading of the orientation, one thread, the fastest of all runs. Of each filter the default is named. Without a magnetometer the heading is aligned over the first second of movement.",
            if recordings == 1 { "One recording".to_owned() } else { format!("Mean of {recordings} recordings") }
        ));
        for (name, trade) in trades {
            let chosen = chosen.filter(|_| *name == self.axes);
            // Candidates were measured in this order.
            let defaults = candidates.iter().enumerate().filter(|(_, candidate)| candidate.is_default());
            let names: Vec<(usize, String)> =
                defaults.map(|(index, candidate)| (index, candidate.kind.name().to_owned())).collect();
            let plot = trade.plot_with_names(0, metric, chosen, &names);
            save(&format!("imu-{name}d.svg"), &plot.to_svg().map_err(|e| Failure::work(&e))?)?;
            page = page.heading(trade.title()).plot(&plot).map_err(|e| Failure::work(&e))?;
            page = page.table(&trade.table(0, metric));
        }
        save("trade.html", &page.to_html())?;
        if let Some(candidate) = chosen.and_then(|index| candidates.get(index)) {
            save("imu.toml", &candidate.config_text())?;
        }
        let json = serde_json::to_string_pretty(&self.json(trades, chosen)).map_err(|e| Failure::work(&e))?;
        save("trade.json", &json)
    }

    fn json(&self, trades: &[(&str, Trade)], chosen: Option<usize>) -> serde_json::Value {
        let metric = self.metric as usize;
        let all = trades.iter().map(|(name, trade)| {
            (format!("{name}d"), serde_json::json!({ "trade": trade, "front": trade.pareto(0, metric) }))
        });
        let all: serde_json::Map<_, _> = all.collect();
        let of = trades.iter().find(|(name, _)| *name == self.axes).map(|(_, trade)| trade);
        let chosen = of.zip(chosen).map(|(trade, index)| &trade.measurements()[index]);
        serde_json::json!({
            "axes": self.axes,
            "error": of.map(|trade| &trade.errors()[metric]),
            "all": all,
            "chosen": chosen,
        })
    }

    fn print(&self, trades: &[(&str, Trade)], chosen: Option<usize>) {
        if self.json {
            println!("{}", self.json(trades, chosen));
            return;
        }
        let metric = self.metric as usize;
        let mut text = String::new();
        for (name, trade) in trades {
            let _ = writeln!(
                text,
                "{}; * is on the Pareto front of time and {}\n{}",
                trade.title(),
                trade.errors()[metric].title(),
                trade.table(0, metric).to_text()
            );
            if let Some(index) = chosen.filter(|_| *name == self.axes) {
                let m = &trade.measurements()[index];
                let _ = writeln!(
                    text,
                    "chosen: {} ({:.0} ns, {:.3} deg)\n",
                    m.setting, m.costs[0], m.errors[metric]
                );
                if let Some((_, Value::Kind(filter))) = m.setting.0.first() {
                    let config = self.output.join("imu.toml");
                    let config = if filter == Kind::Integration.name() {
                        String::new()
                    } else {
                        format!(" --config {}", config.display())
                    };
                    let _ = writeln!(text, "use it: vergence imu run RECORDING --filter {filter}{config}\n");
                }
            }
        }
        let _ = writeln!(text, "look at it: {}", self.output.join("trade.html").display());
        print!("{text}");
    }
}

fn trade(
    axes: Axes,
    candidates: &[Candidate],
    recordings: &[(PathBuf, Recording)],
    bar: &ProgressBar,
) -> Result<Trade, Failure> {
    let (title, names) = match axes {
        Axes::Nine => ("gyroscope, accelerometer, magnetometer", ["total", "heading", "inclination"]),
        Axes::Six => {
            ("gyroscope, accelerometer", ["total from the start", "heading from the start", "inclination"])
        }
    };
    let kinds = Kind::ALL.iter().map(|kind| Value::from(kind.name())).collect();
    let mut positions: Vec<Value> = Vec::new();
    for candidate in candidates {
        let value = Value::from(candidate.position.as_str());
        if !positions.contains(&value) {
            positions.push(value);
        }
    }
    let mut trade = Trade::new(
        title,
        vec![Knob::new("filter", "", kinds), Knob::new("knob", "", positions)],
        vec![Scale::new("time per sample", "ns")],
        names.map(|name| Scale::new(name, "deg")).to_vec(),
    )
    .map_err(|error| Failure::work(&error))?;
    for candidate in candidates {
        bar.set_message(format!("{} {}", candidate.kind.name(), candidate.position));
        let (ns, errors) = measure(candidate, axes, recordings)?;
        log::info!(
            "{}, {} {}: {ns:.0} ns, {:.3} deg",
            title,
            candidate.kind.name(),
            candidate.position,
            errors[0]
        );
        let setting = Setting(vec![
            ("filter".to_owned(), Value::from(candidate.kind.name())),
            ("knob".to_owned(), Value::from(candidate.position.as_str())),
        ]);
        trade
            .push(Measurement { setting, costs: vec![ns], errors: errors.to_vec() })
            .map_err(|error| Failure::work(&error))?;
        bar.inc(1);
    }
    Ok(trade)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_say_their_units() {
        assert!((nanoseconds("100ns").unwrap() - 100.0).abs() < 1e-9);
        assert!((degrees("3deg").unwrap() - 3.0).abs() < 1e-12);
        assert!(degrees("3").unwrap_err().contains("expected an angle"));
    }

    #[test]
    fn each_filter_is_there_with_its_default() {
        let all = candidates(false);
        for kind in Kind::ALL {
            assert!(all.iter().any(|candidate| candidate.kind == kind), "{}", kind.name());
        }
        assert!(all.iter().any(|c| c.kind == Kind::Madgwick && c.position == "beta 0.12"));
        for kind in Kind::ALL {
            assert_eq!(all.iter().filter(|c| c.kind == kind && c.is_default()).count(), 1, "{}", kind.name());
        }
        assert_eq!(candidates(true).len(), Kind::ALL.len());
    }
}
