//! What other people's recordings hold, as samples of streams: EuRoC, TUM, BROAD, XDF, tables.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use clap::ValueEnum;
use flate2::read::MultiGzDecoder;
use nalgebra::UnitQuaternion;
use vergence_geom::{Rigid, y_up_from_z_up};
use vergence_inertial::Recording;
use vergence_log::foreign::{Cells, ORDER, Table, TimeUnit, Xdf};
use vergence_log::{Compressed, Row, Stream, StreamDesc, Times};
use vergence_sense::{Button, Imu, Pose, Tracking};
use vergence_slam::dataset::truth_file;
use vergence_slam::trajectory::Trajectory;
use vergence_time::{Span, Timestamp};

use crate::failure::Failure;

/// Text and XDF are read into memory; larger files are refused, bytes.
const LARGEST: u64 = 4 << 30;

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum World {
    /// As it is in the recording: the same numbers
    AsRecorded,
    /// From z up (EuRoC, TUM, BROAD) to y up and −z forward, as scenes have it
    YUp,
}

impl World {
    /// Ours from the recording's, and what is said of its axes.
    fn turn(self) -> (Rigid, &'static str) {
        match self {
            Self::AsRecorded => (Rigid::identity(), "as in the recording (EuRoC, TUM: z up)"),
            Self::YUp => (y_up_from_z_up(), "y up, -z forward (the recording: z up)"),
        }
    }
}

/// What is written, in order of time.
pub enum Item {
    Imu(usize, Imu),
    Pose(usize, Pose),
    Button(usize, Button),
    Row(usize, Row<'static>),
    Picture(usize, PathBuf),
}

/// Everything of a recording, before it is put in order.
#[derive(Default)]
pub struct Gathered {
    /// The streams.
    pub descs: Vec<(StreamDesc, Carries)>,
    /// Their samples.
    pub items: Vec<(Times, Item)>,
    /// What is wrong with the recording, or taken otherwise than it may have been meant, in sentences.
    pub faults: Vec<String>,
    /// EuRoC's calibrations, by the name that they have in the folder.
    pub rig: BTreeMap<String, String>,
}

#[derive(Clone, Copy)]
pub enum Carries {
    Imu,
    Pose,
    Button,
    Row,
    Picture,
}

/// A stream at work.
pub enum Open {
    Imu(Stream<Imu>),
    Pose(Stream<Pose>),
    Button(Stream<Button>),
    Row(Stream<Row<'static>>),
    Picture(Stream<Compressed<'static>>),
}

impl Gathered {
    fn stream(&mut self, desc: StreamDesc, carries: Carries) -> usize {
        self.descs.push((desc, carries));
        self.descs.len() - 1
    }
}

/// What the axes of a foreign world are is a note on the stream.
const WORLD: &str = "world";

/// Which inertial unit recorded is a note on its stream: how late it is, its readings do not tell.
pub const INERTIAL_UNIT: &str = "inertial_unit";

/// What a file holds, unpacked where its first bytes say that it is compressed by gzip.
fn bytes_of(path: &Path) -> Result<Vec<u8>, Failure> {
    let failed = |error: std::io::Error| Failure::Work(format!("{}: {error}", path.display()));
    let file = std::fs::read(path).map_err(failed)?;
    let larger =
        || Failure::Work(format!("{}: expected at most {LARGEST} bytes, found more", path.display()));
    let file = if file.starts_with(&[0x1f, 0x8b]) {
        let mut unpacked = Vec::new();
        MultiGzDecoder::new(&file[..]).take(LARGEST + 1).read_to_end(&mut unpacked).map_err(failed)?;
        unpacked
    } else {
        file
    };
    if file.len() as u64 > LARGEST { Err(larger()) } else { Ok(file) }
}

fn trajectory(path: &Path) -> Result<Trajectory, Failure> {
    let text = String::from_utf8(bytes_of(path)?).map_err(|_| {
        Failure::Work(format!("{}: expected text in UTF-8, found other bytes", path.display()))
    })?;
    Trajectory::parse_as_written(&text, path).map_err(|error| Failure::work(&error))
}

fn poses(trajectory: &Trajectory, name: &str, world: World, gathered: &mut Gathered) {
    let (ours_from_theirs, axes) = world.turn();
    let desc = StreamDesc::new(name).frame(WORLD).note("axes", axes);
    let stream = gathered.stream(desc, Carries::Pose);
    let item = |(at, theirs_from_body): &(Timestamp, Rigid)| {
        // What stays as it was stays to the last digit.
        let pose = match world {
            World::AsRecorded => *theirs_from_body,
            World::YUp => {
                let rotation = UnitQuaternion::new_normalize(theirs_from_body.rotation.into_inner());
                ours_from_theirs * Rigid::from_parts(theirs_from_body.translation, rotation)
            }
        };
        (Times::at(*at), Item::Pose(stream, Pose::tracked(pose)))
    };
    gathered.items.extend(trajectory.poses.iter().map(item));
}

pub fn tum(path: &Path, world: World, gathered: &mut Gathered) -> Result<(), Failure> {
    poses(&trajectory(path)?, "/body", world, gathered);
    Ok(())
}

/// Where EuRoC's data sets have their truth.
pub const TRUTHS: [&str; 3] = ["state_groundtruth_estimate0", "mocap0", "vicon0"];

/// What of EuRoC's folder is there: any of imu0, cam0…, state_groundtruth_estimate0.
pub fn euroc(path: &Path, world: World, gathered: &mut Gathered) -> Result<(), Failure> {
    let inner = path.join("mav0");
    let rig = if inner.is_dir() { inner } else { path.to_owned() };
    let cameras = (0..8).map(|index| format!("cam{index}"));
    for name in cameras.chain(TRUTHS.iter().chain(&["imu0"]).map(|name| (*name).to_owned())) {
        let name = format!("{name}/sensor.yaml");
        match std::fs::read_to_string(rig.join(&name)) {
            Ok(sheet) => drop(gathered.rig.insert(name, sheet)),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
            Err(error) => return Err(Failure::Work(format!("{}: {error}", rig.join(&name).display()))),
        }
    }
    let imu = rig.join("imu0");
    if imu.is_dir() {
        let recording = Recording::read(&imu).map_err(|error| Failure::work(&error))?;
        let stream = gathered.stream(StreamDesc::new("/imu0").frame("imu0"), Carries::Imu);
        let item = |(at, imu): &(Timestamp, Imu)| (Times::at(*at), Item::Imu(stream, *imu));
        gathered.items.extend(recording.samples.iter().map(item));
    }
    // Leica's leica0 has positions only, which are no poses.
    let tables = TRUTHS.map(|truth| (truth, rig.join(truth).join("data.csv")));
    let there: Vec<_> = tables.iter().filter(|(_, table)| table.is_file()).collect();
    for (truth, table) in &there {
        poses(&trajectory(table)?, &format!("/{truth}"), world, gathered);
    }
    // Recordings that are made with other tools have it beside, as `slam eval` takes it.
    if let Some(beside) = truth_file(path).filter(|_| there.is_empty()) {
        poses(&trajectory(&beside)?, "/truth", world, gathered);
    }
    for camera in (0..8).map(|index| format!("cam{index}")) {
        let table = rig.join(&camera).join("data.csv");
        if !table.is_file() {
            continue;
        }
        let text = std::fs::read_to_string(&table)
            .map_err(|e| Failure::Work(format!("{}: {e}", table.display())))?;
        let stream =
            gathered.stream(StreamDesc::new(format!("/{camera}")).frame(camera.clone()), Carries::Picture);
        for (index, line) in
            text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty() && !l.starts_with('#'))
        {
            let wrong = |expected: &str| {
                Failure::Work(format!(
                    "{}:{}:1: expected {expected}, found {line:?}",
                    table.display(),
                    index + 1
                ))
            };
            let (at, name) = line.split_once(',').ok_or_else(|| wrong("a time and a file"))?;
            let at =
                at.trim().parse().map(Timestamp::from_nanos).map_err(|_| wrong("a time in nanoseconds"))?;
            let name = name.trim();
            // Nothing outside of the recording's folder is read.
            if name.is_empty() || name.contains(['/', '\\']) || name.starts_with('.') {
                return Err(wrong("the name of a file in the folder data"));
            }
            let picture = rig.join(&camera).join("data").join(name);
            if picture.is_file() {
                gathered.items.push((Times::at(at), Item::Picture(stream, picture)));
            } else {
                gathered.faults.push(format!("{}: no such picture", picture.display()));
            }
        }
    }
    if gathered.items.is_empty() {
        let expected = "expected imu0, cam0 or state_groundtruth_estimate0, found none";
        return Err(Failure::Call(format!("{}: {expected}", rig.display())));
    }
    Ok(())
}

pub fn broad(path: &Path, world: World, gathered: &mut Gathered) -> Result<(), Failure> {
    let recording = Recording::read(path).map_err(|error| Failure::work(&error))?;
    let desc = StreamDesc::new("/imu").frame("imu").note(INERTIAL_UNIT, recording.unit.name());
    let imu = gathered.stream(desc, Carries::Imu);
    gathered
        .items
        .extend(recording.samples.iter().map(|(at, sample)| (Times::at(*at), Item::Imu(imu, *sample))));
    if recording.truth.is_empty() {
        return Ok(());
    }
    let (frame, axes) = match world {
        World::AsRecorded => ("enu", "earth (east, north, up) from sensor"),
        World::YUp => (WORLD, "y up (east, up, south) from sensor"),
    };
    let ours_from_earth = world.turn().0;
    let desc = StreamDesc::new("/truth").frame(frame).note("axes", axes);
    let truth = gathered.stream(desc, Carries::Pose);
    let movement = gathered.stream(StreamDesc::new("/movement"), Carries::Button);
    for ((at, _), said) in recording.samples.iter().zip(&recording.truth) {
        // Each part is there for itself: cameras see where a board is before they see how it is turned.
        let (position, orientation) = match world {
            World::AsRecorded => (said.position_m, said.as_written.map(|q| q.coords)),
            World::YUp => (
                said.position_m.map(|p| ours_from_earth.rotation * p),
                said.earth_from_sensor.map(|q| (ours_from_earth.rotation * q).coords),
            ),
        };
        let trust = |is_there: bool| if is_there { Tracking::Measured } else { Tracking::Lost };
        let q = orientation.map_or([0.0, 0.0, 0.0, 1.0], Into::into);
        let pose = Pose::from_exact(
            position.map_or([0.0; 3], Into::into),
            trust(position.is_some()),
            q,
            trust(orientation.is_some()),
        );
        gathered.items.push((Times::at(*at), Item::Pose(truth, pose)));
        gathered.items.push((Times::at(*at), Item::Button(movement, Button(Some(said.movement)))));
    }
    Ok(())
}

fn seconds(secs: f64) -> Option<Timestamp> {
    Span::from_secs_f64(secs).map(|span| Timestamp::from_nanos(span.as_nanos()))
}

/// A name that a stream may have, and that no other one has.
fn stream_name(name: &str, taken: &[(StreamDesc, Carries)]) -> String {
    let word: String = name
        .chars()
        .take(200)
        .map(|c| if c.is_alphanumeric() || "-_./".contains(c) { c } else { '_' })
        .collect();
    let base = format!("/{}", word.trim_matches('/'));
    let base = if base.len() < 2 { "/stream".to_owned() } else { base };
    let is_free = |name: &String| taken.iter().all(|(desc, _)| desc.name != *name);
    let numbered = (2..).map(|k| format!("{base}_{k}"));
    std::iter::once(base.clone()).chain(numbered).find(is_free).unwrap_or(base)
}

pub fn xdf(path: &Path, gathered: &mut Gathered) -> Result<(), Failure> {
    let bytes = bytes_of(path)?;
    let xdf = Xdf::parse(&bytes).ok_or_else(|| {
        let begins = &bytes[..bytes.len().min(4)];
        Failure::Work(format!(
            "{}: expected an XDF file, found a file that begins with {begins:02x?}",
            path.display()
        ))
    })?;
    drop(bytes);
    if xdf.streams.iter().all(|stream| stream.stamps_s.is_empty())
        && let Some(fault) = xdf.faults.first()
    {
        return Err(Failure::Work(format!("{}: no sample of it is whole: {fault}", path.display())));
    }
    gathered.faults = xdf.faults;
    for stream in xdf.streams {
        let mut desc = StreamDesc::new(stream_name(&stream.name, &gathered.descs))
            .note("xdf.name", &stream.name)
            .note("xdf.type", &stream.content)
            .note("xdf.format", &stream.format)
            .note("xdf.id", stream.id.to_string())
            .note("xdf.nominal_srate", stream.nominal_hz.to_string())
            .note("xdf.channels", stream.channels.to_string());
        let field = match &stream.cells {
            Cells::Numbers(_) => "numbers",
            Cells::Integers(_) => "integers",
            Cells::Texts(_) => "texts",
        };
        for (place, label) in stream.labels.iter().enumerate() {
            desc = desc.note(format!("column.{field}[{place}]"), label);
        }
        let place = gathered.stream(desc, Carries::Row);
        for (k, stamp_s) in stream.stamps_s.iter().enumerate() {
            let at = seconds(*stamp_s).ok_or_else(|| {
                Failure::Work(format!("{}: expected a time, found {stamp_s} s", path.display()))
            })?;
            let cells = k * stream.channels..(k + 1) * stream.channels;
            let row = match &stream.cells {
                Cells::Numbers(all) => Row { numbers: Cow::Owned(all[cells].to_vec()), ..Row::default() },
                Cells::Integers(all) => Row { integers: Cow::Owned(all[cells].to_vec()), ..Row::default() },
                Cells::Texts(all) => Row { texts: Cow::Owned(all[cells].to_vec()), ..Row::default() },
            };
            gathered.items.push((Times::at(at), Item::Row(place, row)));
        }
    }
    Ok(())
}

/// A table of anything.
pub fn csv(path: &Path, unit: Option<TimeUnit>, gathered: &mut Gathered) -> Result<(), Failure> {
    let text = bytes_of(path)?;
    let table =
        Table::parse(&text, unit).map_err(|error| Failure::Work(format!("{}:{error}", path.display())))?;
    gathered.faults = table.notes;
    let unpacked = path.with_extension("");
    let is_packed = path.extension().is_some_and(|end| end == "gz");
    let stem = if is_packed { &unpacked } else { path }
        .file_stem()
        .map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
    let mut desc = StreamDesc::new(stream_name(&stem, &gathered.descs));
    let (mut numbers, mut integers, mut texts) = (Vec::new(), Vec::new(), Vec::new());
    let mut order = Vec::new();
    for column in table.columns {
        let (field, place) = match column.cells {
            Cells::Numbers(all) => (numbers.push(all), ("numbers", numbers.len())).1,
            Cells::Integers(all) => (integers.push(all), ("integers", integers.len())).1,
            Cells::Texts(all) => (texts.push(all), ("texts", texts.len())).1,
        };
        let field = format!("{field}[{}]", place - 1);
        desc = desc.note(format!("column.{field}"), column.name);
        order.push(field);
    }
    // A row has its numbers first, then whole numbers, then texts.
    let rank =
        |field: &String| ["numbers", "integers", "texts"].iter().position(|own| field.starts_with(own));
    if !order.is_sorted_by_key(rank) {
        desc = desc.note(ORDER, order.join(","));
    }
    let stream = gathered.stream(desc, Carries::Row);
    for (k, captured) in table.captured.iter().enumerate() {
        let row = Row {
            numbers: numbers.iter().map(|all| all[k]).collect(),
            integers: integers.iter().map(|all| all[k]).collect(),
            texts: texts.iter_mut().map(|all| std::mem::take(&mut all[k])).collect(),
        };
        let arrived = table.arrived.as_ref().map_or(*captured, |all| all[k]);
        gathered.items.push((Times::new(*captured, arrived), Item::Row(stream, row)));
    }
    Ok(())
}
