//! Where samples come from: a text recording, or a stream of a session's log; and what is set right in them before anything else.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use nalgebra::{UnitQuaternion, Vector3};
use vergence_geom::y_up_from_z_up;
use vergence_inertial::calibrate::Calibration;
use vergence_inertial::frames::{SensorAxes, SignedAxes, check_frames};
use vergence_inertial::{Recording, Truth, Unit};
use vergence_log::{Entry, Reader};
use vergence_sense::{Button, Imu, Pose, Tracking};
use vergence_time::Timestamp;

use crate::failure::Failure;
use crate::log::{INERTIAL_UNIT, TRUTHS};

/// Refuses an output that is one of the inputs, or the table of an input that is EuRoC's folder.
pub fn check_out(out: &Path, inputs: &[Option<&PathBuf>]) -> Result<(), Failure> {
    if super::output::is_stdout(out) {
        return Ok(());
    }
    let inside = ["data.csv", "imu0/data.csv", "mav0/imu0/data.csv"];
    let tables = |input: &PathBuf| inside.map(|inner| input.join(inner));
    let read: Vec<PathBuf> = inputs
        .iter()
        .copied()
        .flatten()
        .flat_map(|input| [vec![input.clone()], tables(input).to_vec()].concat())
        .collect();
    Failure::unless_own("--out", out, &read)
}

/// A sensor's axes on the command line, such as `mag=y,x,-z`.
#[derive(Clone, Copy, Debug)]
pub struct Turn {
    sensor: usize,
    axes: SignedAxes,
}

const SENSORS: [&str; 3] = ["gyr", "acc", "mag"];

fn turn(text: &str) -> Result<Turn, String> {
    let (name, axes) = text
        .split_once('=')
        .ok_or_else(|| format!("expected a sensor and its axes, such as mag=y,x,-z, found {text}"))?;
    let sensor = SENSORS.iter().position(|sensor| *sensor == name);
    let sensor = sensor.ok_or_else(|| format!("expected gyr, acc or mag before '=', found '{name}'"))?;
    Ok(Turn { sensor, axes: axes.parse()? })
}

/// Axes that are set right.
#[derive(clap::Args)]
pub struct Turns {
    /// Takes a sensor's readings in other axes, before anything else: its x, y and z from which of its readings, such as mag=y,x,-z for
    /// a magnetometer with x and y swapped and z negated. For gyr, acc and mag, each once
    #[arg(long, value_name = "SENSOR=AXES", value_parser = turn)]
    turn: Vec<Turn>,
}

impl Turns {
    /// Of the three sensors.
    pub fn axes(&self) -> Result<SensorAxes, Failure> {
        let mut axes = SensorAxes::default();
        for (index, turn) in self.turn.iter().enumerate() {
            if self.turn[..index].iter().any(|other| other.sensor == turn.sensor) {
                return Err(Failure::Call(format!(
                    "--turn: expected {} once, found it twice",
                    SENSORS[turn.sensor]
                )));
            }
            *[&mut axes.gyr, &mut axes.acc, &mut axes.mag][turn.sensor] = turn.axes;
        }
        Ok(axes)
    }
}

/// What is set right in every reading.
#[derive(clap::Args)]
pub struct Corrections {
    /// What `imu calibrate` found of this unit: taken out of each reading before the filter sees it. One that is written by hand needs only
    /// what it changes, such as gyr_bias_rad_s = [0.01, 0, 0]
    #[arg(long, value_name = "FILE.toml")]
    pub calibration: Option<PathBuf>,
    #[command(flatten)]
    turns: Turns,
}

impl Corrections {
    /// Reads the calibration.
    pub fn read(&self) -> Result<Calibration, Failure> {
        let axes = self.turns.axes()?;
        let mut found = match &self.calibration {
            Some(path) => Calibration::read(path).map_err(|error| Failure::call(&error))?,
            None => Calibration::default(),
        };
        if !axes.is_same() {
            if !found.axes.is_same() {
                return Err(Failure::Call(
                    "--turn: expected a calibration without [axes], found one that turns them already"
                        .to_owned(),
                ));
            }
            found.axes = axes;
        }
        Ok(found)
    }

    /// Reads the calibration and applies it.
    pub fn apply(&self, recording: &mut Recording) -> Result<(), Failure> {
        corrected(&self.read()?, recording);
        Ok(())
    }
}

/// Takes what was found of the unit out of each reading.
pub fn corrected(found: &Calibration, recording: &mut Recording) {
    // Without corrections readings stay to the last bit.
    if *found != Calibration::default() {
        recording.samples.iter_mut().for_each(|(_, imu)| *imu = found.correct(imu));
    }
}

/// What the turns of a recording say of its sensors' frames, on stderr and as sentences; and the dip of the field, degrees.
pub fn checked_frames(recording: &Recording, path: &Path) -> (Vec<String>, Option<f64>) {
    let check = check_frames(&recording.samples);
    let warnings: Vec<String> =
        check.warnings().iter().map(|sentence| format!("{}: {sentence}", path.display())).collect();
    warnings.iter().for_each(|warning| log::warn!("{warning}"));
    (warnings, check.dip_rad.map(f64::to_degrees))
}

/// `-` is what comes in by a pipe.
pub fn place(path: &Path) -> &Path {
    if path.as_os_str() == "-" { Path::new("/dev/stdin") } else { path }
}

/// Whether it is a session's log.
pub fn is_log(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "mcap")
}

/// Reads the recording at `path`: a session's log where it ends with `.mcap`, from the stream `stream` or the only one of an
/// inertial unit; else text, that of stdin for `-`.
pub fn read(path: &Path, stream: Option<&str>) -> Result<Recording, Failure> {
    if is_log(path) {
        return read_log(path, stream);
    }
    if let Some(stream) = stream {
        return Err(Failure::Call(format!(
            "{}: expected a session's log (.mcap) to take the stream {stream} from",
            path.display()
        )));
    }
    let recording = Recording::read(place(path)).map_err(|error| Failure::work(&error))?;
    if !recording.ignored.is_empty() {
        log::warn!("{}: nothing is made of the columns {}", path.display(), recording.ignored.join(", "));
    }
    warn_of_times(path, &recording);
    Ok(recording)
}

/// Says which samples were left out because of their times.
fn warn_of_times(path: &Path, recording: &Recording) {
    for (count, what) in
        [(recording.repeated, "the same time as"), (recording.reversed, "an earlier time than")]
    {
        if count > 0 {
            log::warn!("{}: {count} samples have {what} the one before: left out", path.display());
        }
    }
}

/// Whether a stream of a log holds the truth, as imports call it.
pub fn is_truth(entry: &Entry<'_>) -> bool {
    let name = entry.stream.name.trim_start_matches('/');
    entry.is::<Pose>() && (name == "truth" || TRUTHS.contains(&name))
}

/// A pose of such a stream in a world with z up, as recordings have it: orientation as it was written and position.
pub fn said(entry: &Entry<'_>, pose: &Pose) -> Truth {
    let (position, [x, y, z, w]) = pose.to_exact();
    let is_turned = entry.stream.metadata.get("axes").is_some_and(|axes| axes.starts_with("y up"));
    let back = is_turned.then(|| y_up_from_z_up().rotation.inverse());
    let written = nalgebra::Quaternion::new(w, x, y, z);
    let written = back.map_or(written, |back| back.into_inner() * written);
    let seen = pose.orientation_tracking != Tracking::Lost;
    let unit =
        UnitQuaternion::try_new(written, 1e-6).filter(|q| seen && q.coords.iter().all(|v| v.is_finite()));
    let position_m = (pose.position_tracking != Tracking::Lost).then(|| Vector3::from(position));
    Truth {
        earth_from_sensor: unit,
        as_written: unit.map(|_| written),
        position_m: position_m.map(|p| back.map_or(p, |back| back * p)),
        movement: true,
    }
}

fn read_log(path: &Path, stream: Option<&str>) -> Result<Recording, Failure> {
    let failed = |error: vergence_log::Error| Failure::work(&error);
    let mut reader = Reader::open(path).map_err(failed)?;
    let mut recording = Recording::default();
    let mut chosen = stream.map(str::to_owned);
    let mut truth: BTreeMap<Timestamp, Truth> = BTreeMap::new();
    let mut movement: BTreeMap<Timestamp, bool> = BTreeMap::new();
    while let Some(entry) = reader.next().map_err(failed)? {
        let name = &entry.stream.name;
        if is_truth(&entry) {
            let sample = entry.decode::<Pose>().map_err(failed)?;
            truth.insert(sample.captured, said(&entry, &sample.value));
            continue;
        }
        if name == "/movement" && entry.is::<Button>() {
            let sample = entry.decode::<Button>().map_err(failed)?;
            movement.insert(sample.captured, sample.value.0 == Some(true));
            continue;
        }
        match &chosen {
            Some(chosen) if chosen != name => {
                if stream.is_none() && entry.is::<Imu>() {
                    return Err(Failure::Call(format!(
                        "{}: expected one stream of an inertial unit, found {chosen} and {name}: choose with --stream",
                        path.display()
                    )));
                }
                continue;
            }
            None if !entry.is::<Imu>() => continue,
            None => chosen = Some(name.clone()),
            Some(_) => {}
        }
        if let Some(unit) = entry.stream.metadata.get(INERTIAL_UNIT).and_then(|unit| Unit::from_name(unit)) {
            recording.unit = unit;
        }
        let sample = entry.decode::<Imu>().map_err(failed)?;
        match recording.samples.last().map(|(last, _)| sample.captured.cmp(last)) {
            Some(Ordering::Equal) => recording.repeated += 1,
            Some(Ordering::Less) => recording.reversed += 1,
            _ => recording.samples.push((sample.captured, sample.value)),
        }
    }
    if recording.samples.len() < 2 {
        let names: Vec<&str> = reader.streams().map(|info| info.name.as_str()).collect();
        return Err(Failure::Work(format!(
            "{}: expected two samples or more of {}, found {} in the streams {}",
            path.display(),
            chosen.as_deref().unwrap_or("an inertial unit"),
            recording.samples.len(),
            names.join(", ")
        )));
    }
    warn_of_times(path, &recording);
    // Truth that was recorded beside each sample is the recording's own, as in its table.
    let beside = |(at, _): &(Timestamp, Imu)| {
        let movement = movement.get(at).copied().unwrap_or(movement.is_empty());
        truth.get(at).map(|said| Truth { movement, ..*said })
    };
    recording.truth = recording.samples.iter().map(beside).collect::<Option<Vec<_>>>().unwrap_or_default();
    Ok(recording)
}
