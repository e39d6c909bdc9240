//! `vergence trade slam`: what odometry costs per frame and how far it errs, knob by knob, over a recording with a truth.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use indicatif::{ProgressBar, ProgressStyle};
use vergence_report::Page;
use vergence_session::RigLog;
use vergence_slam::State;
use vergence_slam::dataset::Dataset;
use vergence_slam::evaluate::{Align, evaluate};
use vergence_trade::{Knob, Limit, Measurement, Scale, Setting, Trade, Value};

use crate::devices::interrupted;
use crate::failure::Failure;
use crate::slam::knobs::Config;
use crate::slam::run::{Sensors, play};

/// Odometry: CPU time per frame against error
#[derive(clap::Args)]
pub struct SlamTrade {
    /// A recording with a truth (EuRoC or 7-Scenes folder); default: slam/half_real_v101_14s in the folder VERGENCE_DATA
    dataset: Option<PathBuf>,
    /// Folder for the results; made where it is missing
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Which sensors take part
    #[arg(long, value_enum, default_value_t = Sensors::StereoInertial)]
    mode: Sensors,
    /// Choose the smallest error that takes at most this CPU time per frame, such as 8ms; writes slam.toml for `slam run --config`
    #[arg(long, value_name = "TIME", value_parser = super::milliseconds)]
    budget: Option<f64>,
    /// Choose the least time that errs at most so many metres; with --budget too, only within that
    #[arg(long, value_name = "METRES")]
    error: Option<f64>,
    /// Frames that are followed at most
    #[arg(long, default_value_t = 100_000)]
    frames: usize,
    /// The default and the two outermost positions of each knob only
    #[arg(long)]
    quick: bool,
    /// Print one JSON object at the end instead of tables
    #[arg(long)]
    json: bool,
}

/// ATE that differs by less than this share is the same: corners found a pixel aside change it by as much.
const NOISE: f64 = 0.1;
/// Fewer frames than this say little.
const FEW: usize = 200;

/// What is turned: name, unit, positions (the default among them), where it stands in a file of knobs.
struct Turned {
    name: &'static str,
    unit: &'static str,
    positions: &'static [usize],
    default: usize,
    of: fn(&mut Config) -> &mut Option<usize>,
}

const KNOBS: [Turned; 6] = [
    Turned { name: "reduce", unit: "", positions: &[1, 2], default: 1, of: |c| &mut c.reduce },
    Turned { name: "cell_px", unit: "px", positions: &[40, 50, 65, 90], default: 50, of: |c| &mut c.cell_px },
    Turned { name: "levels", unit: "", positions: &[2, 3, 4], default: 4, of: |c| &mut c.levels },
    Turned { name: "keyframes", unit: "", positions: &[3, 5, 7, 10], default: 7, of: |c| &mut c.keyframes },
    Turned { name: "states", unit: "", positions: &[2, 3, 5], default: 3, of: |c| &mut c.states },
    Turned { name: "iterations", unit: "", positions: &[1, 2, 4, 8], default: 4, of: |c| &mut c.iterations },
];

/// The defaults; each knob alone at each other position; and several of them turned towards speed together.
fn plan(quick: bool) -> Vec<[usize; KNOBS.len()]> {
    let usual = KNOBS.each_ref().map(|k| k.default);
    let mut all = vec![usual];
    for (index, knob) in KNOBS.iter().enumerate() {
        let ends = [knob.positions[0], knob.positions[knob.positions.len() - 1]];
        let taken = if quick { &ends[..] } else { knob.positions };
        for position in taken.iter().filter(|p| **p != knob.default) {
            let mut setting = usual;
            setting[index] = *position;
            all.push(setting);
        }
    }
    all.extend([[1, 65, 3, 5, 3, 2], [1, 90, 3, 5, 2, 2], [1, 90, 2, 3, 2, 1], [2, 40, 2, 5, 3, 2]]);
    all
}

fn config(setting: &[usize; KNOBS.len()]) -> Config {
    let mut config = Config::default();
    for (knob, position) in KNOBS.iter().zip(setting) {
        *(knob.of)(&mut config) = Some(*position);
    }
    config
}

impl SlamTrade {
    pub fn run(self) -> Result<(), Failure> {
        let variable = std::env::var_os("VERGENCE_DATA").filter(|value| !value.is_empty());
        let usual = variable.map(|data| Path::new(&data).join("slam/half_real_v101_14s"));
        let folder = self.dataset.clone().or(usual).ok_or_else(|| {
            Failure::Call("expected a recording or the variable VERGENCE_DATA, found neither".to_owned())
        })?;
        if RigLog::is_log(&folder) {
            let name = folder.display();
            return Err(Failure::Call(format!(
                "{name}: expected a recording's folder with a truth, found a log; `log export euroc` makes one of it"
            )));
        }
        let mut dataset = Dataset::open(&folder).map_err(|error| Failure::work(&error))?;
        dataset.frames.truncate(self.frames);
        let Some(truth) = dataset.truth.take() else {
            return Err(Failure::Work(format!("{}: expected a truth, found none", folder.display())));
        };
        std::fs::create_dir_all(&self.output).map_err(|e| Failure::unwritable(&self.output, &e))?;
        let mode = self.mode.mode();
        // Without an inertial unit and with one camera, nothing says how large anything is.
        let align = if mode == vergence_slam::playback::Mode::Mono { Align::Sim3 } else { Align::Se3 };
        let knobs = KNOBS.iter().map(|k| {
            let positions = k.positions.iter().map(|p| Value::Count(*p as u32)).collect();
            Knob::new(k.name, k.unit, positions)
        });
        let mut trade = Trade::new(
            "odometry",
            knobs.collect(),
            vec![Scale::new("median CPU time per frame", "ms"), Scale::new("p95", "ms")],
            vec![Scale::new("ATE", "m"), Scale::new("RPE over 1 s", "m")],
        )
        .map_err(|error| Failure::work(&error))?
        .with_error_noise(NOISE);
        let mut warnings = Vec::new();
        if dataset.frames.len() < FEW {
            warnings.push(format!(
                "{} frames: errors of so few say little of other flights; {FEW} or more are better",
                dataset.frames.len()
            ));
        }
        let plan = plan(self.quick);
        let stop = interrupted()?;
        let bar = ProgressBar::new((plan.len() * dataset.frames.len()) as u64);
        if let Ok(style) = ProgressStyle::with_template("{bar:30} {pos}/{len} frames, {eta}") {
            bar.set_style(style);
        }
        let mut untracked = 0;
        for setting in &plan {
            let outcome = play(&dataset, mode, &config(setting), 2, &bar, &stop)?;
            if stop.load(Ordering::Relaxed) {
                break;
            }
            let found = evaluate(&outcome.trajectory(), &truth, align).map_err(|e| Failure::work(&e))?;
            let tracked = outcome.count(|state| state == State::Tracked);
            let is_tracked = tracked * 2 >= outcome.estimates.len();
            if !is_tracked {
                untracked += 1;
            }
            let names = KNOBS.iter().map(|k| k.name.to_owned());
            let values = setting.iter().map(|p| Value::Count(*p as u32));
            trade
                .push(Measurement {
                    setting: Setting(names.zip(values).collect()),
                    costs: vec![outcome.quantile_ms(0.5), outcome.quantile_ms(0.95)],
                    // Of poses that say themselves that they are not to be trusted, the error means nothing.
                    errors: vec![
                        if is_tracked { found.ate_rmse_m } else { f64::NAN },
                        found.rpe_1s.filter(|_| is_tracked).map_or(f64::NAN, |r| r.rmse_m),
                    ],
                })
                .map_err(|error| Failure::work(&error))?;
        }
        bar.finish_and_clear();
        if trade.measurements().len() < plan.len() {
            let (done, all) = (trade.measurements().len(), plan.len());
            eprintln!("vergence: ended after {done} of {all} settings, as asked");
            if done == 0 {
                return Ok(());
            }
        }
        if untracked > 0 {
            let done = trade.measurements().len();
            let said = format!("in {untracked} of {done} settings less than half of the frames are tracked");
            if untracked == done {
                return Err(Failure::Work(format!("{}: {said}; see `slam run`", folder.display())));
            }
            warnings.push(format!("{said}: they have no error, and are not chosen"));
        }
        for warning in &warnings {
            eprintln!("vergence: {warning}");
        }
        let limit = Limit::of(self.budget, self.error);
        let choice = limit.map(|limit| trade.choose(0, 0, limit)).transpose();
        let chosen = choice.as_ref().ok().copied().flatten();
        let frames = dataset.frames.len();
        self.write(&trade, chosen.map(|index| (index, config(&plan[index]))), frames, &warnings)?;
        self.print(&trade, chosen, &warnings);
        choice.map(|_| ()).map_err(|error| Failure::work(&error))
    }

    fn json(trade: &Trade, chosen: Option<usize>, warnings: &[String]) -> serde_json::Value {
        let chosen = chosen.map(|index| &trade.measurements()[index]);
        serde_json::json!({ "trade": trade, "front": trade.pareto(0, 0), "chosen": chosen, "warnings": warnings })
    }

    fn write(
        &self,
        trade: &Trade,
        chosen: Option<(usize, Config)>,
        frames: usize,
        warnings: &[String],
    ) -> Result<(), Failure> {
        let save = |name: &str, text: &str| {
            let path = self.output.join(name);
            std::fs::write(&path, text).map_err(|e| Failure::unwritable(&path, &e))
        };
        let index = chosen.as_ref().map(|c| c.0);
        let plot = trade.plot(0, 0, index);
        save("slam.svg", &plot.to_svg().map_err(|e| Failure::work(&e))?)?;
        let page = Page::new("What odometry costs")
            .paragraph(&format!(
                "{frames} frames; CPU time of one thread per frame without decoding; position error after alignment. Each knob is \
                 turned alone, then all of them towards speed. Errors that differ by less than a tenth are taken as equal. {}",
                warnings.join(". ")
            ))
            .plot(&plot)
            .map_err(|e| Failure::work(&e))?
            .table(&trade.table(0, 0));
        save("trade.html", &page.to_html())?;
        let json = serde_json::to_string_pretty(&Self::json(trade, index, warnings))
            .map_err(|e| Failure::work(&e))?;
        save("trade.json", &json)?;
        if let Some((_, config)) = chosen {
            save("slam.toml", &toml::to_string(&config).map_err(|e| Failure::work(&e))?)?;
        }
        Ok(())
    }

    fn print(&self, trade: &Trade, chosen: Option<usize>, warnings: &[String]) {
        if self.json {
            println!("{}", Self::json(trade, chosen, warnings));
            return;
        }
        println!(
            "* is on the Pareto front of time and ATE (steps of a tenth or more)\n{}",
            trade.table(0, 0).to_text()
        );
        if let Some(index) = chosen {
            let m = &trade.measurements()[index];
            println!("chosen: {} ({:.1} ms, {:.4} m)", m.setting, m.costs[0], m.errors[0]);
        }
        println!("look at it: {}", self.output.join("trade.html").display());
    }
}

#[cfg(test)]
mod tests {
    use vergence_slam::Params;
    use vergence_vision::TrackerKnobs;

    use super::*;

    #[test]
    fn the_plan_begins_with_the_defaults_and_stays_on_the_knobs() {
        let (knobs, params) = config(&plan(false)[0]).resolve().unwrap();
        assert!(knobs == TrackerKnobs::default() && params == Params::default());
        for quick in [false, true] {
            for setting in plan(quick) {
                assert!(KNOBS.iter().zip(&setting).all(|(k, p)| k.positions.contains(p)), "{setting:?}");
                config(&setting).resolve().unwrap();
            }
        }
    }
}
