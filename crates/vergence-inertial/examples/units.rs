//! `vergence` beside VQF with units that the recordings are not of: without a lag, with readings that are means over the period, slow
//! ones, ones with errors of scale, starts in motion and inside a magnetic disturbance; and copies of the recordings at low rates.
//! `cargo run --release -p vergence-inertial --example units -- [SEEDS [CONFIG…]]`: SEEDS draws of each kind (default 4), CONFIG files
//! of parameters as for `imu run --config`, each a column of its own beside the defaults. Recordings are taken from `broad` in the
//! folder VERGENCE_DATA.
//!
//! The motion tumbles: rates and accelerations are sums of sines of 0.15 to 1.5 (2.5 above 200 °/s) hertz, after 20 s of rest.
//! Prints 9D total / inclination / 6D start, degrees, means over the draws.

use std::error::Error;
use std::f64::consts::TAU;
use std::path::PathBuf;

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use vergence_geom::exp;
use vergence_inertial::filter::{self, Axes, Filter, Kind};
use vergence_inertial::{Dice, Recording, Truth, Unit, score};
use vergence_sense::Imu;
use vergence_time::Timestamp;

type Figures = [f64; 3];

const EARTH_FIELD: Vector3<f64> = Vector3::new(0.0, 20.0, -45.0);
/// The fine rate that motion is simulated at, hertz.
const FINE_HZ: usize = 4000;

/// What is drawn.
#[derive(Clone, Copy)]
struct Case {
    name: &'static str,
    rate_hz: usize,
    /// Root mean square rate and acceleration of the motion.
    deg_s: f64,
    acc_m_s2: f64,
    /// What readings lag by, seconds (4 ms: as BROAD's unit, and the filter is told that); whether they are means over the period.
    lag_s: f64,
    averaged: bool,
    /// Standard deviation of the nine factors of the gyroscope.
    factors: f64,
    rest_s: f64,
    /// A disturbance to the east until then, microteslas and seconds.
    disturbed: (f64, f64),
}

const PLAIN: Case = Case {
    name: "",
    rate_hz: 250,
    deg_s: 110.0,
    acc_m_s2: 2.0,
    lag_s: 0.0,
    averaged: false,
    factors: 0.0,
    rest_s: 20.0,
    disturbed: (0.0, 0.0),
};

const CASES: [Case; 22] = [
    Case { name: "perfect 30°/s", deg_s: 30.0, ..PLAIN },
    Case { name: "perfect 110°/s", ..PLAIN },
    Case { name: "perfect 350°/s", deg_s: 350.0, ..PLAIN },
    Case { name: "perfect 350°/s 1 kHz", deg_s: 350.0, rate_hz: 1000, ..PLAIN },
    Case { name: "means 350°/s 200 Hz", deg_s: 350.0, rate_hz: 200, averaged: true, ..PLAIN },
    Case { name: "means, 2 ms, 350°/s", deg_s: 350.0, averaged: true, lag_s: 0.002, ..PLAIN },
    Case { name: "4 ms, told, 110°/s", lag_s: 0.004, ..PLAIN },
    Case { name: "4 ms, told, 350°/s", deg_s: 350.0, lag_s: 0.004, ..PLAIN },
    Case { name: "factors 0.4 % 110°/s", factors: 0.004, lag_s: 0.004, ..PLAIN },
    Case { name: "factors 0.4 % 350°/s", deg_s: 350.0, factors: 0.004, lag_s: 0.004, ..PLAIN },
    Case { name: "factors 1 % 110°/s", factors: 0.01, lag_s: 0.004, ..PLAIN },
    Case { name: "shaken 6 m/s²", acc_m_s2: 6.0, lag_s: 0.004, ..PLAIN },
    Case { name: "means 100 Hz", rate_hz: 100, averaged: true, ..PLAIN },
    Case { name: "means 50 Hz", rate_hz: 50, averaged: true, ..PLAIN },
    Case { name: "means 25 Hz", rate_hz: 25, averaged: true, ..PLAIN },
    Case { name: "perfect 50 Hz", rate_hz: 50, ..PLAIN },
    Case { name: "perfect 25 Hz", rate_hz: 25, ..PLAIN },
    Case { name: "starts in motion", rest_s: 0.0, ..PLAIN },
    Case { name: "starts in slow motion", rest_s: 0.0, deg_s: 20.0, ..PLAIN },
    Case { name: "starts in motion, shaken", rest_s: 0.0, acc_m_s2: 5.0, ..PLAIN },
    Case { name: "20 µT for 10 s", disturbed: (20.0, 10.0), ..PLAIN },
    Case { name: "10 µT for 30 s", disturbed: (10.0, 30.0), ..PLAIN },
];

fn drawn(case: &Case, seed: u64) -> Recording {
    let dice = Dice::new(seed, 77);
    let length_s = case.rest_s + 80.0;
    let count = (length_s * FINE_HZ as f64) as usize;
    let most_hz = if case.deg_s > 200.0 { 2.5 } else { 1.5 };
    const WAVES: usize = 14;
    let waves = |which: u64| -> Vec<[(f64, f64); WAVES]> {
        (0..3u64)
            .map(|axis| {
                std::array::from_fn(|k| {
                    let index = 1000 * which + 100 * axis + 2 * k as u64;
                    (0.15 + (most_hz - 0.15) * dice.uniform(index), TAU * dice.uniform(index + 1))
                })
            })
            .collect()
    };
    let (turns, pushes) = (waves(1), waves(2));
    let sum = |waves: &[[(f64, f64); WAVES]], size: f64, t: f64| {
        let each = size / 3f64.sqrt() / (WAVES as f64 / 2.0).sqrt();
        Vector3::from_fn(|i, _| waves[i].iter().map(|(f, p)| (TAU * f * t + p).sin()).sum::<f64>() * each)
    };
    let envelope = |t: f64| {
        if case.rest_s == 0.0 {
            return 1.0;
        }
        let k = ((t - case.rest_s) / 0.4).clamp(0.0, 1.0);
        k * k * (3.0 - 2.0 * k)
    };
    let mut q = UnitQuaternion::new(Vector3::from_fn(|i, _| dice.normal(i as u64)));
    let (mut rates, mut pushed, mut orientations) = (Vec::new(), Vec::new(), Vec::new());
    for k in 0..count {
        let t = k as f64 / FINE_HZ as f64;
        let at = envelope(t);
        let rate = if at > 0.0 { sum(&turns, case.deg_s.to_radians(), t) * at } else { Vector3::zeros() };
        let push = if at > 0.0 { sum(&pushes, case.acc_m_s2, t) * at } else { Vector3::zeros() };
        let before = rates.last().copied().unwrap_or(rate);
        q *= exp(&((before + rate) * (0.5 / FINE_HZ as f64)));
        q.renormalize_fast();
        rates.push(rate);
        pushed.push(push);
        orientations.push(q);
    }
    let factors =
        Matrix3::identity() + Matrix3::from_fn(|i, j| dice.normal(5000 + (3 * i + j) as u64) * case.factors);
    let bias = Vector3::new(0.3, -0.2, 0.25).map(f64::to_radians);
    let every = FINE_HZ / case.rate_hz;
    let lag = (case.lag_s * FINE_HZ as f64).round() as usize;
    let root = (case.rate_hz as f64).sqrt();
    let unit = if case.lag_s == 0.004 { Unit::Broad } else { Unit::Unknown };
    let mut recording = Recording { unit, ..Recording::default() };
    let feels =
        |j: usize| orientations[j].inverse_transform_vector(&(pushed[j] + Vector3::new(0.0, 0.0, 9.81)));
    for (n, i) in (0..count).step_by(every).enumerate() {
        let noise = |which: u64, size: f64| {
            Vector3::from_fn(|axis, _| {
                dice.normal(1_000_000 + 16 * n as u64 + 3 * which + axis as u64) * size * root
            })
        };
        let j = i.saturating_sub(lag);
        let t = i as f64 / FINE_HZ as f64;
        let field = EARTH_FIELD
            + if t < case.disturbed.1 { Vector3::x() * case.disturbed.0 } else { Vector3::zeros() };
        let (rate, force, mag) = if case.averaged {
            let from = (j + 1).saturating_sub(every);
            let mean = |of: &dyn Fn(usize) -> Vector3<f64>| {
                (from..=j).map(of).sum::<Vector3<f64>>() / (j + 1 - from) as f64
            };
            (mean(&|k| rates[k]), mean(&feels), mean(&|k| orientations[k].inverse_transform_vector(&field)))
        } else {
            (rates[j], feels(j), orientations[j].inverse_transform_vector(&field))
        };
        let imu = Imu {
            gyr_rad_s: factors * rate + bias + noise(0, 0.007f64.to_radians()),
            acc_m_s2: force + noise(1, 0.0015),
            mag_ut: Some(mag + noise(2, 0.08)),
        };
        recording.samples.push((Timestamp::from_nanos((i as f64 / FINE_HZ as f64 * 1e9) as i64), imu));
        let movement = envelope(t) > 0.05;
        let earth_from_sensor = Some(orientations[i]);
        recording.truth.push(Truth { earth_from_sensor, movement, ..Truth::default() });
    }
    recording
}

/// The mean of each `every` samples, at the time of the last: a unit that averages.
fn averaged(recording: &Recording, every: usize) -> Recording {
    let mut other = Recording { unit: recording.unit, ..Recording::default() };
    for (samples, truth) in recording.samples.chunks_exact(every).zip(recording.truth.chunks_exact(every)) {
        let mean = |of: &dyn Fn(&Imu) -> Vector3<f64>| {
            samples.iter().map(|(_, imu)| of(imu)).sum::<Vector3<f64>>() / every as f64
        };
        let imu = Imu {
            gyr_rad_s: mean(&|imu| imu.gyr_rad_s),
            acc_m_s2: mean(&|imu| imu.acc_m_s2),
            mag_ut: Some(mean(&|imu| imu.mag_ut.unwrap_or_default())),
        };
        other.samples.push((samples[every - 1].0, imu));
        other.truth.push(truth[every - 1]);
    }
    other
}

/// Linear interpolation at another rate.
fn resampled(recording: &Recording, rate_hz: f64) -> Recording {
    let period_ns = (1e9 / rate_hz).round() as i64;
    let mut other = Recording { unit: recording.unit, ..Recording::default() };
    let mut at = 0;
    for (pair, truth) in recording.samples.windows(2).zip(recording.truth.windows(2)) {
        let ((t0, a), (t1, b)) = (&pair[0], &pair[1]);
        while at < t1.as_nanos() {
            let share = (at - t0.as_nanos()) as f64 / (t1.as_nanos() - t0.as_nanos()) as f64;
            let imu = Imu {
                gyr_rad_s: a.gyr_rad_s.lerp(&b.gyr_rad_s, share),
                acc_m_s2: a.acc_m_s2.lerp(&b.acc_m_s2, share),
                mag_ut: a.mag_ut.zip(b.mag_ut).map(|(a, b)| a.lerp(&b, share)),
            };
            other.samples.push((Timestamp::from_nanos(at), imu));
            let mut now = if share < 0.5 { truth[0] } else { truth[1] };
            now.earth_from_sensor =
                truth[0].earth_from_sensor.zip(truth[1].earth_from_sensor).map(|(a, b)| a.slerp(&b, share));
            other.truth.push(now);
            at += period_ns;
        }
    }
    other
}

/// From some second on: a start in motion.
fn from_second(recording: &Recording, second: f64) -> Recording {
    let from = recording.samples.partition_point(|(at, _)| (at.as_nanos() as f64) < second * 1e9);
    let (samples, truth) = (recording.samples[from..].to_vec(), recording.truth[from..].to_vec());
    Recording { samples, truth, unit: recording.unit, ..Recording::default() }
}

fn figures(recording: &Recording, made: &dyn Fn(Axes) -> Box<dyn Filter>) -> Result<Figures, Box<dyn Error>> {
    let scored = |axes| {
        let mut filter = made(axes);
        let orientations = filter::run(filter.as_mut(), &recording.samples);
        let estimate: Vec<_> = recording.samples.iter().map(|(at, _)| *at).zip(orientations).collect();
        let pairs = recording.scored(&estimate, "estimate".as_ref())?;
        score(&pairs).ok_or_else(|| Box::<dyn Error>::from("expected a truth in movement, found none"))
    };
    let (nine, six) = (scored(Axes::Nine)?, scored(Axes::Six)?);
    Ok([nine.total_rad, six.inclination_rad, six.start_total_rad].map(f64::to_degrees))
}

/// One line: VQF, the defaults, each of the files.
fn row(name: &str, recordings: &[Recording], configs: &[PathBuf], each: bool) -> Result<(), Box<dyn Error>> {
    print!("{name:26}");
    let mut all: Vec<Option<&PathBuf>> = vec![None, None];
    all.extend(configs.iter().map(Some));
    let mut lines = vec![String::new(); recordings.len()];
    for (column, config) in all.into_iter().enumerate() {
        let mut sum = [0.0; 3];
        for (recording, line) in recordings.iter().zip(&mut lines) {
            let period = recording.period().ok_or("expected two samples or more")?;
            let kind = if column == 0 { Kind::Vqf } else { Kind::Vergence };
            let found = figures(recording, &|axes| match config {
                Some(file) => kind.configured(recording.unit, axes, period, file).unwrap_or_else(|error| {
                    eprintln!("{error}");
                    std::process::exit(1)
                }),
                None => kind.of(recording.unit, axes, period),
            })?;
            *line += &format!(" | {:6.2} {:5.2} {:6.2}", found[0], found[1], found[2]);
            sum.iter_mut().zip(found).for_each(|(sum, found)| *sum += found / recordings.len() as f64);
        }
        print!(" | {:6.3} {:5.3} {:6.3}", sum[0], sum[1], sum[2]);
    }
    println!();
    if each {
        lines.iter().enumerate().for_each(|(i, line)| println!("   {i:<23}{line}"));
    }
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args_os().skip(1);
    let seeds: u64 = match args.next() {
        Some(text) => text.to_string_lossy().parse()?,
        None => 4,
    };
    let configs: Vec<PathBuf> = args.map(PathBuf::from).collect();
    let folder = std::env::var_os("VERGENCE_DATA").map(|data| PathBuf::from(data).join("broad"));
    if let Some(folder) = folder.filter(|folder| folder.is_dir()) {
        let mut files: Vec<PathBuf> = std::fs::read_dir(&folder)?
            .filter_map(|entry| Some(entry.ok()?.path()))
            .filter(|path| path.to_string_lossy().ends_with(".csv.gz"))
            .collect();
        files.sort();
        let recorded: Vec<Recording> =
            files.iter().map(|file| Recording::read(file)).collect::<Result<_, _>>()?;
        let copies = |copy: &dyn Fn(&Recording) -> Recording| -> Vec<Recording> {
            recorded.iter().map(copy).collect()
        };
        row("recorded", &recorded, &configs, true)?;
        row("recorded, 100 Hz", &copies(&|one| resampled(one, 100.0)), &configs, true)?;
        row("recorded, 120 Hz", &copies(&|one| resampled(one, 120.0)), &configs, false)?;
        row("recorded, 500 Hz", &copies(&|one| resampled(one, 500.0)), &configs, false)?;
        row("recorded, 1 kHz", &copies(&|one| resampled(one, 1000.0)), &configs, false)?;
        row("recorded, means 95 Hz", &copies(&|one| averaged(one, 3)), &configs, false)?;
        row("recorded, means 57 Hz", &copies(&|one| averaged(one, 5)), &configs, false)?;
        row("recorded, means 29 Hz", &copies(&|one| averaged(one, 10)), &configs, false)?;
        row("recorded from 55 s", &copies(&|one| from_second(one, 55.0)), &configs, false)?;
        row("recorded from 75 s", &copies(&|one| from_second(one, 75.0)), &configs, false)?;
    }
    for case in &CASES {
        let drawn: Vec<Recording> = (0..seeds).map(|seed| drawn(case, seed)).collect();
        row(case.name, &drawn, &configs, false)?;
    }
    Ok(())
}
