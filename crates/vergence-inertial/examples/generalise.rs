//! Whether the defaults of `vergence` hold beyond the recordings that they were chosen on:
//! `cargo run --release -p vergence-inertial --example generalise -- [DIR]`, where DIR holds BROAD-style recordings with truth
//! (default: `broad` in the folder VERGENCE_DATA). Minutes; prints two tables.
//!
//! 1. Leave one out. For each recording the knobs are chosen on the others only, by a search that starts from values of which
//!    half are half and half are twice the defaults, and halves or doubles them; then scored on the one that was left out.
//! 2. Flatness. Each knob at 0.7 and 1.4 times its default: what the averages change by.

use std::collections::HashMap;
use std::error::Error;
use std::path::{Path, PathBuf};

use vergence_inertial::filter::{self, Axes, Filter, Kind, Limits, Stream, Vergence, VergenceParams};
use vergence_inertial::{Recording, Unit, score};

/// A knob that is turned.
type Knob = (&'static str, fn(&mut VergenceParams) -> &mut f64);

/// All but the limits and what is no matter of tuning: how late the unit reads ([`Unit`], measured against cameras), what says how long a
/// rest is, how a start goes on without one, and how fast one must turn for readings of the field to be independent (about a radian in a
/// second, which takes a hand from one place of a room's field to another).
const KNOBS: [Knob; 17] = [
    ("tau_acc_s", |p| &mut p.tau_acc_s),
    ("window_s", |p| &mut p.window_s),
    ("bias_sigma_deg_s", |p| &mut p.bias_sigma_deg_s),
    ("bias_wander_deg_s", |p| &mut p.bias_wander_deg_s),
    ("factor_sigma", |p| &mut p.factor_sigma),
    ("factor_doubt", |p| &mut p.factor_doubt),
    ("tilt_noise_deg_s", |p| &mut p.tilt_noise_deg_s),
    ("tilt_noise_before_rest_deg_s", |p| &mut p.tilt_noise_before_rest_deg_s),
    ("tilt_outlier_deg_s", |p| &mut p.tilt_outlier_deg_s),
    ("tilt_noise_per_acc", |p| &mut p.tilt_noise_per_acc),
    ("rest_noise_deg_s", |p| &mut p.rest_noise_deg_s),
    ("offset_sigma_ut", |p| &mut p.offset_sigma_ut),
    ("field_noise_ut", |p| &mut p.field_noise_ut),
    ("field_outlier_ut", |p| &mut p.field_outlier_ut),
    ("jump_ut", |p| &mut p.jump_ut),
    ("jump_offset", |p| &mut p.jump_offset),
    ("jump_field", |p| &mut p.jump_field),
];

/// Half powers of two about the defaults.
type Position = [i8; KNOBS.len()];

/// The defaults.
const DEFAULT: Position = [0; KNOBS.len()];

/// How far a search goes: a quarter to four times the default.
const FURTHEST: i8 = 4;

fn params(position: &Position) -> VergenceParams {
    let mut params = Unit::Broad.params();
    for ((_, knob), step) in KNOBS.iter().zip(position) {
        *knob(&mut params) *= 2f64.powf(0.5 * f64::from(*step));
    }
    params
}

/// 9D total, inclination, 6D total after aligning the start; degrees.
type Figures = [f64; 3];

const TITLES: [&str; 3] = ["9D total", "inclination", "6D start"];

fn figures(make: &dyn Fn(Axes) -> Box<dyn Filter>, recording: &Recording) -> Result<Figures, Box<dyn Error>> {
    let scored = |axes| {
        let orientations = filter::run(make(axes).as_mut(), &recording.samples);
        let times = recording.samples.iter().map(|(at, _)| *at);
        let estimate: Vec<_> = times.zip(orientations).collect();
        let pairs = recording.scored(&estimate, Path::new("estimate"))?;
        score(&pairs).ok_or_else(|| Box::<dyn Error>::from("expected a truth in movement, found none"))
    };
    let (nine, six) = (scored(Axes::Nine)?, scored(Axes::Six)?);
    Ok([nine.total_rad, six.inclination_rad, six.start_total_rad].map(f64::to_degrees))
}

fn ours(position: &Position, recording: &Recording) -> Result<Figures, Box<dyn Error>> {
    let period = recording.period().ok_or("expected two samples or more")?;
    let core = Vergence::new(params(position), period.as_secs_f64());
    figures(&|axes| Box::new(Stream::new(core.clone(), axes, period, Limits::default())), recording)
}

fn mean(of: &[Figures]) -> Figures {
    std::array::from_fn(|i| of.iter().map(|figures| figures[i]).sum::<f64>() / of.len() as f64)
}

/// The recordings, what VQF makes of them, and what ours did at the positions tried so far.
struct Trials {
    names: Vec<String>,
    recordings: Vec<Recording>,
    vqf: Vec<Figures>,
    tried: HashMap<Position, Vec<Figures>>,
}

impl Trials {
    fn read(folder: &Path) -> Result<Self, Box<dyn Error>> {
        let entries = std::fs::read_dir(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
        let mut paths: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
        paths.retain(|path| path.to_string_lossy().ends_with(".csv.gz"));
        paths.sort();
        let name = |path: &PathBuf| {
            path.file_name().map(|name| name.to_string_lossy().replace(".csv.gz", "")).unwrap_or_default()
        };
        let recordings: Vec<Recording> =
            paths.iter().map(|path| Recording::read(path)).collect::<Result<_, _>>()?;
        if recordings.len() < 2 {
            return Err(format!("{}: expected two recordings (.csv.gz) or more", folder.display()).into());
        }
        let vqf = |recording: &Recording| {
            let period = recording.period().ok_or("expected two samples or more")?;
            figures(&|axes| Kind::Vqf.filter(axes, period), recording)
        };
        let vqf = recordings.iter().map(vqf).collect::<Result<_, _>>()?;
        Ok(Self { names: paths.iter().map(name).collect(), recordings, vqf, tried: HashMap::new() })
    }

    /// Figures of every recording at `position`.
    fn at(&mut self, position: &Position) -> Result<&[Figures], Box<dyn Error>> {
        if !self.tried.contains_key(position) {
            let next = std::sync::atomic::AtomicUsize::new(0);
            let work = || {
                let mut done = Vec::new();
                loop {
                    let index = next.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                    let Some(recording) = self.recordings.get(index) else { return done };
                    done.push((index, ours(position, recording).map_err(|error| error.to_string())));
                }
            };
            let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
            let mut done: Vec<_> = std::thread::scope(|scope| {
                let workers: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
                workers.into_iter().flat_map(|worker| worker.join().unwrap_or_default()).collect()
            });
            done.sort_by_key(|(index, _)| *index);
            let all = done.into_iter().map(|(_, figures)| figures).collect::<Result<_, _>>()?;
            self.tried.insert(*position, all);
        }
        Ok(&self.tried[position])
    }

    /// The mean of the figures relative to VQF's, over all recordings but `left_out`.
    fn cost(&mut self, position: &Position, left_out: usize) -> Result<f64, Box<dyn Error>> {
        let all = self.at(position)?.to_vec();
        let others = all.iter().zip(&self.vqf).enumerate().filter(|(i, _)| *i != left_out);
        let relative: Vec<f64> = others
            .flat_map(|(_, (ours, vqf))| (0..3).map(|i| ours[i] / vqf[i]).collect::<Vec<_>>())
            .collect();
        Ok(relative.iter().sum::<f64>() / relative.len() as f64)
    }

    /// One knob after the other halved or doubled while that helps, until none does.
    fn search(&mut self, mut position: Position, left_out: usize) -> Result<Position, Box<dyn Error>> {
        let mut least = self.cost(&position, left_out)?;
        loop {
            let before = least;
            for knob in 0..KNOBS.len() {
                for step in [-2, 2] {
                    loop {
                        let mut next = position;
                        next[knob] += step;
                        if next[knob].abs() > FURTHEST {
                            break;
                        }
                        let cost = self.cost(&next, left_out)?;
                        // Less than this is chance.
                        if cost >= least - 1e-3 {
                            break;
                        }
                        (position, least) = (next, cost);
                    }
                }
            }
            if least >= before {
                return Ok(position);
            }
            eprintln!("{}: {least:.4}, {} positions tried", self.names[left_out], self.tried.len());
        }
    }
}

fn degrees(figures: Figures) -> String {
    figures.map(|figure| format!("{figure:7.3}")).join(" ")
}

fn leave_one_out(trials: &mut Trials) -> Result<Vec<Position>, Box<dyn Error>> {
    println!("Knobs chosen on the other recordings, degrees: {}", TITLES.join(", "));
    println!("{:44} {:24} {:24} vqf", "left out", "chosen on the others", "defaults");
    let (mut out, mut chosen) = (Vec::new(), Vec::new());
    for left_out in 0..trials.names.len() {
        // Another start for each, half below and half above.
        let start: Position = std::array::from_fn(|knob| if (knob + left_out) % 2 == 0 { -2 } else { 2 });
        let found = trials.search(start, left_out)?;
        let figures = trials.at(&found)?[left_out];
        let (defaults, vqf) = (trials.at(&DEFAULT)?[left_out], trials.vqf[left_out]);
        let name = &trials.names[left_out];
        println!("{name:44} {}  {}  {}", degrees(figures), degrees(defaults), degrees(vqf));
        out.push(figures);
        chosen.push(found);
    }
    let defaults = mean(trials.at(&DEFAULT)?);
    println!("{:44} {}  {}  {}", "mean", degrees(mean(&out)), degrees(defaults), degrees(mean(&trials.vqf)));
    Ok(chosen)
}

fn flatness(trials: &mut Trials, chosen: &[Position]) -> Result<(), Box<dyn Error>> {
    let plain = mean(trials.at(&DEFAULT)?);
    println!("\nEach knob alone: what the means change by, degrees: {}", TITLES.join(", "));
    println!("{:28} {:24} {:24} chosen above, times the default", "knob", "x 0.7", "x 1.4");
    for (index, (name, _)) in KNOBS.iter().enumerate() {
        let mut changed = |step: i8| -> Result<String, Box<dyn Error>> {
            let mut position = DEFAULT;
            position[index] = step;
            let turned = mean(trials.at(&position)?);
            Ok(degrees(std::array::from_fn(|i| turned[i] - plain[i])))
        };
        let (below, above) = (changed(-1)?, changed(1)?);
        let times =
            chosen.iter().map(|position| format!("{:.1}", 2f64.powf(0.5 * f64::from(position[index]))));
        println!("{name:28} {below}  {above}  {}", times.collect::<Vec<_>>().join(" "));
    }
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let data = std::env::var_os("VERGENCE_DATA").map(|data| PathBuf::from(data).join("broad"));
    let folder = std::env::args_os().nth(1).map(PathBuf::from).or(data);
    let folder = folder.ok_or("expected a folder of recordings, or the variable VERGENCE_DATA")?;
    let mut trials = Trials::read(&folder)?;
    let chosen = leave_one_out(&mut trials)?;
    flatness(&mut trials, &chosen)
}
