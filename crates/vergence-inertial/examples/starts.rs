//! Starts in motion: `vergence` beside VQF and Madgwick where a recording begins while the unit moves.
//! `cargo run --release -p vergence-inertial --example starts -- [--each] [CONFIG…]`: CONFIG files of parameters as for `imu run --config`,
//! each a column of its own; `--each` prints every start. Recordings are taken from `broad` and `slam` in the folder VERGENCE_DATA.
//!
//! Each BROAD-style recording is cut at ten moments of its movement, a flight with running rotors at ten moments in the air, and hands
//! and heads are simulated; the thirty seconds from the cut on are scored, from the first sample. Every other start is for development,
//! those between for validation. Prints mean inclination / 6D total after aligning the first second / 9D total in degrees, in how many
//! starts ours is worse than 1.25 times the better of the other two and half a degree (inclination and 9D total), and the worst.

use std::error::Error;
use std::path::{Path, PathBuf};

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use vergence_inertial::filter::{self, Axes, Filter, Kind};
use vergence_inertial::model::{ImuModel, Triad};
use vergence_inertial::motion::{Earth, Motion, Wander, WanderParams};
use vergence_inertial::{Dice, Recording, Unit, paired, read_tum_orientations, score};
use vergence_sense::Imu;
use vergence_time::{Span, Timestamp};

/// Inclination, 6D total after aligning the start, 9D total; degrees. The last is missing where there is no magnetometer.
type Figures = [Option<f64>; 3];
type Truth = Vec<(Timestamp, UnitQuaternion<f64>)>;

const FACTOR: f64 = 1.25;
const MORE_DEG: f64 = 0.5;
/// What is scored of a start, seconds.
const SCORED_S: f64 = 30.0;
const CUTS: usize = 10;

/// For development, for validation, and, of some cuts, all that comes after them.
const SECTIONS: [&str; 3] = ["development", "validation", "to the end"];

struct Start {
    family: String,
    name: String,
    unit: Unit,
    samples: Vec<(Timestamp, Imu)>,
    truth: Truth,
    section: &'static str,
}

impl Start {
    fn figures(&self, made: &dyn Fn(Axes, Span) -> Box<dyn Filter>) -> Result<Figures, Box<dyn Error>> {
        let recording = Recording { samples: self.samples.clone(), ..Recording::default() };
        let period = recording.period().ok_or("expected two samples or more")?;
        let scored = |axes| {
            let found = filter::run(made(axes, period).as_mut(), &self.samples);
            let estimate: Vec<_> = self.samples.iter().map(|(at, _)| *at).zip(found).collect();
            let (pairs, _) = paired(&estimate, self.truth.iter().copied());
            score(&pairs).ok_or_else(|| format!("{} {}: expected a truth", self.family, self.name))
        };
        let six = scored(Axes::Six)?;
        let magnetic = self.samples.iter().any(|(_, imu)| imu.mag_ut.is_some());
        let nine = magnetic.then(|| scored(Axes::Nine)).transpose()?;
        let all = [Some(six.inclination_rad), Some(six.start_total_rad), nine.map(|nine| nine.total_rad)];
        Ok(all.map(|figure| figure.map(f64::to_degrees)))
    }
}

fn from_to(samples: &[(Timestamp, Imu)], from: Timestamp, length_s: f64) -> &[(Timestamp, Imu)] {
    let end = from.as_nanos().saturating_add((length_s * 1e9) as i64);
    let first = samples.partition_point(|(at, _)| *at < from);
    let last = samples.partition_point(|(at, _)| at.as_nanos() < end);
    &samples[first..last]
}

/// Ten cuts of each BROAD-style recording, evenly over what moves and is followed by enough.
fn recorded(folder: &Path) -> Result<Vec<Start>, Box<dyn Error>> {
    let mut files: Vec<PathBuf> =
        std::fs::read_dir(folder)?.filter_map(|entry| Some(entry.ok()?.path())).collect();
    files.retain(|path| path.to_string_lossy().ends_with(".csv.gz"));
    files.sort();
    let mut starts = Vec::new();
    for (index, file) in files.iter().enumerate() {
        let recording = Recording::read(file)?;
        let rows: Vec<_> = recording.samples.iter().map(|(at, _)| *at).zip(&recording.truth).collect();
        let Some(last) = rows.iter().rposition(|(_, truth)| truth.movement) else { continue };
        let end = rows[last].0.as_nanos() - (SCORED_S * 1e9) as i64;
        let moments: Vec<Timestamp> = rows
            .iter()
            .filter(|(at, truth)| truth.movement && at.as_nanos() < end)
            .map(|(at, _)| *at)
            .collect();
        let truth: Truth = rows
            .iter()
            .filter(|(_, truth)| truth.movement)
            .filter_map(|(at, truth)| Some((*at, truth.earth_from_sensor?)))
            .collect();
        let name = file.file_name().map(|name| name.to_string_lossy()[..2].to_owned()).unwrap_or_default();
        for cut in 0..CUTS {
            // Not the very first: that moment is a start from rest in all but name.
            let from = moments[((cut as f64 + 0.7) / CUTS as f64 * (moments.len() - 1) as f64) as usize];
            let seconds = from.as_nanos() as f64 * 1e-9;
            starts.push(Start {
                family: format!("recorded {name}"),
                name: format!("{name} from {seconds:.0} s"),
                unit: recording.unit,
                samples: from_to(&recording.samples, from, SCORED_S).to_vec(),
                truth: truth.clone(),
                section: SECTIONS[(index + cut) % 2],
            });
        }
        for from_s in [55.0, 75.0, 95.0] {
            let from = Timestamp::from_nanos((from_s * 1e9) as i64);
            starts.push(Start {
                family: format!("recorded from {from_s} s"),
                name: format!("{name} from {from_s} s to the end"),
                unit: recording.unit,
                samples: from_to(&recording.samples, from, f64::INFINITY).to_vec(),
                truth: truth.clone(),
                section: SECTIONS[2],
            });
        }
    }
    Ok(starts)
}

/// Cuts of a flight, with and without the unit's bias, and the shorter one that was cut before.
fn flown(folder: &Path) -> Result<Vec<Start>, Box<dyn Error>> {
    let bias = Vector3::new(-0.0022, 0.02051, 0.07788);
    let mut starts = Vec::new();
    let of = |path: &str, truth: &str| -> Result<_, Box<dyn Error>> {
        let recording = Recording::read(&folder.join(path))?;
        Ok((recording, read_tum_orientations(&folder.join(truth))?))
    };
    let (flight, truth) = of("euroc_v101_start/mav0/imu0", "euroc_v101_start/gt_vicon2gt_20hz_tum.txt")?;
    for (family, taken) in [("flight as recorded", 0.0), ("flight without bias", 1.0)] {
        let to_the_end = [20.0, 30.0, 40.0, 55.0, 70.0].map(|from_s| (from_s, f64::INFINITY, SECTIONS[2]));
        let cuts = (0..CUTS).map(|cut| (20.0 + 9.0 * cut as f64, SCORED_S, SECTIONS[cut % 2]));
        for (from_s, length_s, section) in cuts.chain(to_the_end) {
            let from = flight.samples[0].0.saturating_add(Span::from_nanos((from_s * 1e9) as i64));
            let mut samples = from_to(&flight.samples, from, length_s).to_vec();
            samples.iter_mut().for_each(|(_, imu)| imu.gyr_rad_s -= bias * taken);
            starts.push(Start {
                family: family.to_owned(),
                name: format!("flight from {from_s} s, bias {}", 1.0 - taken),
                unit: flight.unit,
                samples,
                truth: truth.clone(),
                section,
            });
        }
    }
    let (half, truth) = of("half_real_v101_14s/mav0/imu0", "half_real_v101_14s/gt_tum.txt")?;
    starts.push(Start {
        family: "flight of 14 s".to_owned(),
        name: "half_real".to_owned(),
        unit: half.unit,
        samples: half.samples,
        truth,
        section: SECTIONS[0],
    });
    Ok(starts)
}

/// What is simulated: tilt (rad), turn (rad), way (m), frequency (Hz), bias of the gyroscope (°/s).
const SIMULATED: [(&str, [f64; 5]); 10] = [
    ("head, slow", [0.2, 0.6, 0.06, 0.3, 0.3]),
    ("head, lively", [0.3, 1.0, 0.1, 0.7, 0.3]),
    ("head, bias of 2°/s", [0.3, 1.0, 0.1, 0.7, 1.2]),
    ("head, bias of 5°/s", [0.3, 1.0, 0.1, 0.7, 3.0]),
    ("hand, slow", [0.6, 0.8, 0.2, 0.3, 0.3]),
    ("hand, fast", [0.8, 0.8, 0.2, 0.9, 0.3]),
    ("hand, fast, 2°/s", [0.8, 0.8, 0.2, 0.9, 1.2]),
    ("pushed, not turned", [0.03, 0.05, 0.25, 0.9, 0.3]),
    ("turned fast, in place", [0.9, 0.9, 0.04, 1.0, 0.3]),
    ("slow sway", [0.1, 0.1, 0.3, 0.12, 0.3]),
];
const DRAWS: u64 = 6;

fn simulated(index: usize, seed: u64) -> Result<Start, Box<dyn Error>> {
    let (name, [tilt_rad, turn_rad, way_m, frequency_hz, bias_deg_s]) = SIMULATED[index];
    let dice = Dice::new(seed, 4000 + index as u64);
    let rests_s = Vec::new();
    let params = WanderParams { tilt_rad, turn_rad, way_m, frequency_hz, rests_s, ramp_s: 1.0 };
    let motion = Wander::new(1000 * index as u64 + seed, &params).ok_or("expected a motion")?;
    let triad = |base: Triad, k: u64, scale: f64, bias: f64| Triad {
        scale: Matrix3::identity()
            + Matrix3::from_fn(|i, j| dice.normal(100 * k + (3 * i + j) as u64) * scale),
        bias: Vector3::from_fn(|i, _| dice.normal(100 * k + 20 + i as u64) * bias),
        ..base
    };
    let mut model = ImuModel::consumer(200.0, seed);
    model.gyr = triad(model.gyr, 1, 0.003, bias_deg_s.to_radians());
    model.acc = triad(model.acc, 2, 0.003, 0.03);
    model.mag = model.mag.map(|mag| triad(mag, 3, 0.005, 0.7));
    let length = Span::from_secs_f64(SCORED_S).ok_or("expected a length")?;
    let (mut samples, mut truth) = (Vec::new(), Vec::new());
    for sample in model.record(&motion, &Earth::MID_LATITUDE, length) {
        samples.push((sample.arrived, sample.value));
        truth.push((sample.arrived, motion.at(sample.arrived).world_from_body.rotation));
    }
    Ok(Start {
        family: name.to_owned(),
        name: format!("{name} {seed}"),
        unit: Unit::Unknown,
        samples,
        truth,
        section: SECTIONS[seed as usize % 2],
    })
}

/// Figures of one start: VQF, Madgwick, then ours.
struct Row<'a> {
    start: &'a Start,
    found: Vec<Figures>,
}

impl Row<'_> {
    /// How much column `ours` is beyond what it may be.
    fn over(&self, ours: usize, figure: usize) -> Option<f64> {
        let better = self.found[0][figure]?.min(self.found[1][figure]?);
        Some(self.found[ours][figure]? - (FACTOR * better + MORE_DEG))
    }
}

fn print(title: &str, rows: &[&Row<'_>]) {
    let Some(first) = rows.first() else { return };
    print!("{title:24}");
    for column in 0..first.found.len() {
        let mean = |figure: usize| {
            let of: Vec<f64> = rows.iter().filter_map(|row| row.found[column][figure]).collect();
            if of.is_empty() { f64::NAN } else { of.iter().sum::<f64>() / of.len() as f64 }
        };
        print!(" | {:5.2} {:5.2} {:5.2}", mean(0), mean(1), mean(2));
        if column >= 2 {
            let bad = |figure: usize| {
                rows.iter().filter(|row| row.over(column, figure).is_some_and(|over| over > 0.0)).count()
            };
            print!(" ({:2} {:2})", bad(0), bad(2));
        }
    }
    println!("  of {}", rows.len());
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut configs: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let each = configs.iter().any(|arg| arg.as_os_str() == "--each");
    configs.retain(|arg| arg.as_os_str() != "--each");
    let mut starts = Vec::new();
    if let Some(data) = std::env::var_os("VERGENCE_DATA").map(PathBuf::from) {
        starts.extend(recorded(&data.join("broad"))?);
        starts.extend(flown(&data.join("slam"))?);
    }
    for index in 0..SIMULATED.len() {
        for seed in 0..DRAWS {
            starts.push(simulated(index, seed)?);
        }
    }
    let of = |start| -> Result<Row<'_>, Box<dyn Error>> {
        let start: &Start = start;
        let mut found = Vec::new();
        for kind in [Kind::Vqf, Kind::Madgwick, Kind::Vergence] {
            found.push(start.figures(&|axes, period| kind.of(start.unit, axes, period))?);
        }
        for config in &configs {
            found.push(start.figures(&|axes, period| {
                Kind::Vergence.configured(start.unit, axes, period, config).unwrap_or_else(|error| {
                    eprintln!("{error}");
                    std::process::exit(1)
                })
            })?);
        }
        Ok(Row { start, found })
    };
    let rows: Vec<Row<'_>> = starts.iter().map(of).collect::<Result<_, _>>()?;
    println!(
        "{:24} | {:17} | {:17} | vergence, worse than it may be…",
        "inclination, 6D, 9D", "vqf", "madgwick"
    );
    if each {
        rows.iter().for_each(|row| print(&row.start.name, &[row]));
    }
    for section in SECTIONS {
        println!("{section}:");
        let rows: Vec<&Row<'_>> = rows.iter().filter(|row| row.start.section == section).collect();
        let mut families: Vec<&str> = rows.iter().map(|row| row.start.family.as_str()).collect();
        families.sort_unstable();
        families.dedup();
        for family in families {
            let of: Vec<&Row<'_>> = rows.iter().filter(|row| row.start.family == family).copied().collect();
            print(family, &of);
        }
        print("all", &rows);
        for (figure, title) in [(0, "inclination"), (2, "9D total")] {
            for column in 2..2 + 1 + configs.len() {
                let worst = rows
                    .iter()
                    .filter_map(|row| Some((row.over(column, figure)?, row)))
                    .max_by(|a, b| a.0.total_cmp(&b.0));
                if let Some((over, row)) = worst.filter(|(over, _)| *over > 0.0) {
                    let found: Vec<_> = row.found.iter().filter_map(|of| of[figure]).collect();
                    println!("  worst {title}: {}, {over:.2} too much of {found:.2?}", row.start.name);
                }
            }
        }
    }
    Ok(())
}
