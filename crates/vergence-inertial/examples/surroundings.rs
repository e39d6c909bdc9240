//! `vergence` beside VQF where the recordings do not go: magnets at random places in the room or on the device, furniture of iron,
//! starts inside a disturbance, other units, other motions.
//! `cargo run --release -p vergence-inertial --example surroundings -- [SEEDS [CONFIG]]`, where SEEDS is the number of draws of
//! each kind (default 4) and CONFIG a file of parameters as for `imu run --config`. BROAD-style recordings with truth and positions are
//! taken from `broad` in the folder VERGENCE_DATA.
//!
//! Two families. Recorded motion: the field that a simulated magnet or cupboard has along the true path is added to what the
//! magnetometer said. Simulated motion: smooth random ways and turns as of hands, by a unit with errors drawn at random. Prints for
//! each kind the means (9D total, inclination, 6D total after aligning the start; degrees), how many of the trials are worse than
//! 1.25 times VQF's error and half a degree, and the worst.

use std::error::Error;
use std::io::Read;
use std::path::{Path, PathBuf};

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use vergence_inertial::filter::{self, Axes, Filter, Kind};
use vergence_inertial::model::{ImuModel, Triad};
use vergence_inertial::motion::{Earth, Kinematics, Motion, Wander, WanderParams};
use vergence_inertial::{Dice, Recording, Truth, Unit, score};
use vergence_sense::Imu;
use vergence_time::{Span, Timestamp};

type Figures = [f64; 3];

/// What a trial may be worse by than VQF.
const FACTOR: f64 = 1.25;
const MORE_DEG: f64 = 0.5;

/// Of both filters: VQF, ours.
fn figures(recording: &Recording, config: Option<&Path>) -> Result<[Figures; 2], Box<dyn Error>> {
    let period = recording.period().ok_or("expected two samples or more")?;
    let of = |kind: Kind| -> Result<Figures, Box<dyn Error>> {
        let scored = |axes| {
            let mut filter: Box<dyn Filter> = match config {
                Some(file) if kind == Kind::Vergence => {
                    kind.configured(recording.unit, axes, period, file)?
                }
                _ => kind.of(recording.unit, axes, period),
            };
            let orientations = filter::run(filter.as_mut(), &recording.samples);
            let times = recording.samples.iter().map(|(at, _)| *at);
            let estimate: Vec<_> = times.zip(orientations).collect();
            let pairs = recording.scored(&estimate, Path::new("estimate"))?;
            score(&pairs).ok_or_else(|| Box::<dyn Error>::from("expected a truth in movement, found none"))
        };
        let (nine, six) = (scored(Axes::Nine)?, scored(Axes::Six)?);
        Ok([nine.total_rad, six.inclination_rad, six.start_total_rad].map(f64::to_degrees))
    };
    Ok([of(Kind::Vqf)?, of(Kind::Vergence)?])
}

/// A magnet, or iron that the earth's field makes one.
#[derive(Clone, Copy)]
struct Dipole {
    at_m: Vector3<f64>,
    /// A·m².
    moment: Vector3<f64>,
}

impl Dipole {
    /// Its field at `point_m`, µT; within 5 cm as at 5 cm.
    fn field_ut(&self, point_m: &Vector3<f64>) -> Vector3<f64> {
        let way = point_m - self.at_m;
        let length = way.norm().max(0.05);
        let along = way / length;
        // µ₀/4π = 0.1 µT·m³/(A·m²).
        (along * (3.0 * along.dot(&self.moment)) - self.moment) * (0.1 / length.powi(3))
    }
}

/// A direction, all alike.
fn direction(dice: Dice, index: u64) -> Vector3<f64> {
    Vector3::from_fn(|i, _| dice.normal(8 * index + i as u64)).normalize()
}

fn between(dice: Dice, index: u64, from: f64, to: f64) -> f64 {
    from + (to - from) * dice.uniform(1_000_000 + index)
}

/// A recording with the true path.
struct Trial {
    name: String,
    recording: Recording,
    /// Position and orientation at each sample, carried on where the cameras lost them.
    path: Vec<(Vector3<f64>, UnitQuaternion<f64>)>,
}

impl Trial {
    fn read(file: &Path) -> Result<Self, Box<dyn Error>> {
        let recording = Recording::read(file)?;
        let mut text = String::new();
        flate2::read::GzDecoder::new(std::fs::File::open(file)?).read_to_string(&mut text)?;
        let mut lines = text.lines();
        let header: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
        let place = |name| {
            header.iter().position(|column| *column == name).ok_or(format!("{}: no {name}", file.display()))
        };
        let places = [place("gt_px")?, place("gt_py")?, place("gt_pz")?];
        let mut last = (Vector3::zeros(), UnitQuaternion::identity());
        let mut path: Vec<_> = lines
            .zip(&recording.truth)
            .map(|(line, truth)| {
                let row: Vec<&str> = line.split(',').collect();
                let point = Vector3::from(places.map(|i| row[i].parse::<f64>().unwrap_or(f64::NAN)));
                if let (true, Some(q)) = (point.iter().all(|x| x.is_finite()), truth.earth_from_sensor) {
                    last = (point, q);
                }
                last
            })
            .collect();
        if let Some(first) = path.iter().find(|(point, _)| *point != Vector3::zeros()).copied() {
            path.iter_mut().filter(|(point, _)| *point == Vector3::zeros()).for_each(|at| *at = first);
        }
        let name = file.file_name().map(|n| n.to_string_lossy()[..2].to_owned()).unwrap_or_default();
        Ok(Self { name, recording, path })
    }

    /// First and last sample of the movement.
    fn movement(&self) -> (usize, usize) {
        let moves = |truth: &Truth| truth.movement;
        let truth = &self.recording.truth;
        (truth.iter().position(moves).unwrap_or(0), truth.iter().rposition(moves).unwrap_or(truth.len()))
    }

    /// A copy to whose readings `added(sample, position, orientation)` is added, which is told in the earth frame and in the
    /// sensor's.
    fn with(&self, added: impl Fn(usize, &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>)) -> Recording {
        let mut copy = self.recording.clone();
        for (i, ((_, imu), (point, q))) in copy.samples.iter_mut().zip(&self.path).enumerate() {
            let (in_earth, in_sensor) = added(i, point);
            imu.mag_ut = imu.mag_ut.map(|mag| mag + q.inverse_transform_vector(&in_earth) + in_sensor);
        }
        copy
    }

    /// A place at a distance of `near..far` from some place of the movement, and never nearer to any.
    fn place(&self, dice: Dice, near: f64, far: f64) -> Vector3<f64> {
        let (from, to) = self.movement();
        (0..10_000)
            .map(|k| {
                let sample = between(dice, 2 * k, from as f64, to as f64) as usize;
                self.path[sample].0 + direction(dice, 1000 + k) * between(dice, 2 * k + 1, near, far)
            })
            .find(|place| self.path[from..to].iter().step_by(50).all(|(at, _)| (at - place).norm() >= near))
            .unwrap_or_else(|| Vector3::repeat(100.0))
    }
}

/// Disturbances of the magnetometer over a recorded motion.
const RECORDED: [&str; 14] = [
    "as recorded",
    "small magnet in the room",
    "magnet in the room",
    "strong magnet in the room",
    "furniture of iron",
    "much iron",
    "starts beside a magnet",
    "magnet taken from the start",
    "magnet 5 cm, attached",
    "magnet 3 cm, attached",
    "magnet 2 cm, attached",
    "magnet 1 cm, attached",
    "magnet there from the start",
    "attached in movement",
];

fn disturbed(trial: &Trial, kind: &str, dice: Dice) -> Recording {
    let zero = Vector3::zeros();
    let (from, to) = trial.movement();
    let room = |moment: f64, near: f64| {
        let magnet =
            Dipole { at_m: trial.place(dice, near, near + 0.15), moment: direction(dice, 1) * moment };
        trial.with(|_, point| (magnet.field_ut(point), zero))
    };
    let iron = |count: u64, size: f64| {
        let dipoles: Vec<Dipole> = (0..count)
            .map(|k| {
                let at_m = trial.place(Dice::new(dice.bits(k), 5), 0.35, 1.0);
                Dipole { at_m, moment: direction(dice, 50 + k) * between(dice, 70 + k, 0.3, 1.0) * size }
            })
            .collect();
        trial.with(|_, point| (dipoles.iter().map(|dipole| dipole.field_ut(point)).sum(), zero))
    };
    // As in the recordings that have one: attached some seconds before the movement, taken off half way through it.
    let attached = |size: f64, on: f64, off: f64| {
        let field = direction(dice, 2) * size;
        trial.with(|i, _| {
            let (on, off) = ((i as f64 - on) / 300.0, (off - i as f64) / 300.0);
            (zero, field * on.clamp(0.0, 1.0).min(off.clamp(0.0, 1.0)))
        })
    };
    let (first, length) = (from as f64, (to - from) as f64);
    let on = first - 286.0 * between(dice, 3, 1.0, 10.0);
    let off = first + length * between(dice, 4, 0.3, 0.7);
    let size = between(dice, 5, 0.7, 1.4);
    match kind {
        "small magnet in the room" => room(0.15 * size, 0.1),
        "magnet in the room" => room(0.5 * size, 0.15),
        "strong magnet in the room" => room(2.0 * size, 0.25),
        "furniture of iron" => iron(5, 3.0),
        "much iron" => iron(8, 8.0),
        "starts beside a magnet" => {
            let way = direction(dice, 6) * 0.25;
            let magnet = Dipole { at_m: trial.path[0].0 + way, moment: direction(dice, 7) * 1.5 * size };
            trial.with(|_, point| (magnet.field_ut(point), zero))
        }
        "magnet taken from the start" => {
            let field = direction(dice, 8) * 15.0 * size;
            trial.with(|i, _| {
                (
                    field
                        * (1.0 + (first + 286.0 * between(dice, 9, -5.0, 20.0) - i as f64) / 300.0)
                            .clamp(0.0, 1.0),
                    zero,
                )
            })
        }
        "magnet 5 cm, attached" => attached(2.2 * size, on, off),
        "magnet 3 cm, attached" => attached(10.0 * size, on, off),
        "magnet 2 cm, attached" => attached(34.0 * size, on, off),
        "magnet 1 cm, attached" => attached(200.0 * size, on, off),
        "magnet there from the start" => attached(6.0 * size, -1e6, off),
        "attached in movement" => attached(15.0 * size, first + 0.2 * length, off.max(first + 0.4 * length)),
        _ => trial.recording.clone(),
    }
}

/// Reads the truth of a while ago, as sensors with a low-pass do.
struct Lagging<'a>(&'a Wander, i64);

impl Motion for Lagging<'_> {
    fn at(&self, time: Timestamp) -> Kinematics {
        self.0.at(Timestamp::from_nanos(time.as_nanos() - self.1))
    }
}

/// Motions that are simulated: tilt (rad), turn (rad), way (m), frequency (Hz), breaks.
const SIMULATED: [(&str, [f64; 4], bool); 10] = [
    ("fast rotation, perfect unit", [0.8, 0.8, 0.04, 1.0], false),
    ("fast combined, perfect unit", [0.7, 0.8, 0.2, 0.8], false),
    ("slow rotation", [0.6, 0.8, 0.02, 0.3], false),
    ("slow rotation, breaks", [0.6, 0.8, 0.02, 0.3], true),
    ("fast rotation", [0.8, 0.8, 0.04, 1.0], false),
    ("fast rotation, breaks", [0.8, 0.8, 0.04, 1.0], true),
    ("slow translation", [0.03, 0.03, 0.2, 0.4], false),
    ("fast translation", [0.06, 0.06, 0.2, 0.9], true),
    ("slow combined, 5 min", [0.6, 0.8, 0.2, 0.3], false),
    ("fast combined, 5 min", [0.7, 0.8, 0.2, 0.8], true),
];

fn simulated(index: usize, seed: u64) -> Result<Recording, Box<dyn Error>> {
    let (name, [tilt_rad, turn_rad, way_m, frequency_hz], breaks) = SIMULATED[index];
    let dice = Dice::new(seed, 900 + index as u64);
    let moving_s = if name.contains("5 min") { 300.0 } else { 120.0 };
    let mut rests_s = vec![(-10.0, 30.0)];
    if breaks {
        rests_s.extend(
            (1..4).map(|k| (30.0 + moving_s * 0.25 * f64::from(k), 40.0 + moving_s * 0.25 * f64::from(k))),
        );
    }
    rests_s.push((30.0 + moving_s, 1e3));
    let params =
        WanderParams { tilt_rad, turn_rad, way_m, frequency_hz, rests_s: rests_s.clone(), ramp_s: 1.0 };
    let motion = Wander::new(seed, &params).ok_or("expected a motion")?;
    let triad = |base: Triad, k: u64, scale: f64, bias: f64| Triad {
        scale: Matrix3::identity()
            + Matrix3::from_fn(|i, j| dice.normal(100 * k + (3 * i + j) as u64) * scale),
        bias: Vector3::from_fn(|i, _| dice.normal(100 * k + 20 + i as u64) * bias),
        ..base
    };
    let mut model = ImuModel::consumer(2000.0 / 7.0, seed);
    model.gyr = triad(model.gyr, 1, 0.004, 0.3f64.to_radians());
    model.acc = triad(model.acc, 2, 0.003, 0.03);
    model.mag = model.mag.map(|mag| triad(mag, 3, 0.005, 0.7));
    if name.contains("perfect") {
        model = ImuModel { gyr: Triad { noise_density: model.gyr.noise_density, ..Triad::PERFECT }, ..model };
    }
    let field = Earth::MID_LATITUDE;
    let lagging = Lagging(&motion, 4_000_000);
    let iron = Dipole { at_m: direction(dice, 800) * 1.2, moment: direction(dice, 801) * 8.0 };
    // The simulated lag is that of the recorded unit.
    let mut recording = Recording { unit: Unit::Broad, ..Recording::default() };
    for sample in model.record(&lagging, &field, Span::from_secs_f64(moving_s + 50.0).ok_or("too long")?) {
        let at = sample.arrived;
        let t = at.as_nanos() as f64 * 1e-9;
        let true_pose = motion.at(at).world_from_body;
        let mut imu: Imu = sample.value;
        let uneven =
            true_pose.rotation.inverse_transform_vector(&iron.field_ut(&true_pose.translation.vector));
        imu.mag_ut = imu.mag_ut.map(|mag| mag + uneven);
        recording.samples.push((at, imu));
        let movement = rests_s.iter().all(|(from, to)| !(from - 1.0..to + 1.0).contains(&t));
        let earth_from_sensor = Some(true_pose.rotation);
        recording.truth.push(Truth { earth_from_sensor, movement, ..Truth::default() });
    }
    Ok(recording)
}

/// Means of both, trials that are too bad, and the worst: by how much, which.
#[derive(Default)]
struct Row {
    all: Vec<([Figures; 2], String)>,
}

impl Row {
    fn print(&self, name: &str) {
        let n = self.all.len().max(1) as f64;
        let mean = |k: usize, i: usize| self.all.iter().map(|(of, _)| of[k][i]).sum::<f64>() / n;
        let over = |of: &[Figures; 2], i: usize| of[1][i] - (FACTOR * of[0][i] + MORE_DEG);
        let bad = |i: usize| self.all.iter().filter(|(of, _)| over(of, i) > 0.0).count();
        let worst = self.all.iter().max_by(|a, b| over(&a.0, 0).total_cmp(&over(&b.0, 0)));
        let triple = |k| format!("{:6.2} {:5.2} {:6.2}", mean(k, 0), mean(k, 1), mean(k, 2));
        print!(
            "{name:28} {} | {} | {:3} {:3} {:3} of {:3}",
            triple(0),
            triple(1),
            bad(0),
            bad(1),
            bad(2),
            self.all.len()
        );
        if let Some((of, which)) = worst.filter(|(of, _)| over(of, 0) > 0.0) {
            print!("   {which}: {:.2}, vqf {:.2}", of[1][0], of[0][0]);
        }
        println!();
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let seeds: u64 = std::env::args().nth(1).map_or(Ok(4), |text| text.parse())?;
    let data = std::env::var_os("VERGENCE_DATA").map(|data| PathBuf::from(data).join("broad"));
    let folder = data.filter(|folder| folder.is_dir());
    let config = std::env::args_os().nth(2).map(PathBuf::from);
    let config = config.as_deref();
    println!(
        "{:28} {:19} | {:19} | worse than {FACTOR} x + {MORE_DEG}",
        "9D total, inclination, 6D start", "vqf", "vergence"
    );
    if let Some(folder) = folder {
        let mut files: Vec<PathBuf> = std::fs::read_dir(&folder)
            .map_err(|error| format!("{}: {error}", folder.display()))?
            .filter_map(|entry| Some(entry.ok()?.path()))
            .filter(|path| path.to_string_lossy().ends_with(".csv.gz"))
            .collect();
        files.sort();
        // Those without a magnet of their own.
        files.retain(|file| {
            !file.to_string_lossy().contains("magnet") && !file.to_string_lossy().contains("phone")
        });
        let trials: Vec<Trial> = files.iter().map(|file| Trial::read(file)).collect::<Result<_, _>>()?;
        for (k, kind) in RECORDED.iter().enumerate() {
            let mut row = Row::default();
            for trial in &trials {
                for seed in 0..if k == 0 { 1 } else { seeds } {
                    let copy =
                        disturbed(trial, kind, Dice::new(1000 * k as u64 + seed, trial.name.len() as u64));
                    row.all.push((figures(&copy, config)?, format!("{} seed {seed}", trial.name)));
                }
            }
            row.print(kind);
        }
    }
    for (index, (name, ..)) in SIMULATED.iter().enumerate() {
        let mut row = Row::default();
        for seed in 0..seeds {
            row.all.push((figures(&simulated(index, seed)?, config)?, format!("seed {seed}")));
        }
        row.print(name);
    }
    Ok(())
}
