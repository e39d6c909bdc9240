//! `vergence log import`: other people's recordings as a session log.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::ValueEnum;
use vergence_geom::{Rigid, y_up_from_z_up};
use vergence_inertial::Recording;
use vergence_log::foreign::{Cells, Table, read_xdf};
use vergence_log::{Compressed, Header, Options, Recorder, Row, Stream, StreamDesc, Times};
use vergence_sense::{Button, Image, Imu, Pose, Tracking};
use vergence_slam::trajectory::Trajectory;
use vergence_time::{Span, Timestamp};

use crate::failure::Failure;

#[derive(clap::Args)]
pub struct ImportArgs {
    /// What kind of recording it is
    #[arg(value_enum)]
    kind: Kind,
    /// The recording: a file, for euroc the folder that has mav0 in it (or mav0)
    path: PathBuf,
    /// The log; one that is there is refused
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Replaces the log where there is one already
    #[arg(long)]
    overwrite: bool,
    /// Which way the poses' world is turned (euroc, tum, broad)
    #[arg(long, value_enum, default_value_t = World::AsRecorded)]
    world: World,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Kind {
    /// Cameras, inertial unit and truth of EuRoC's and TUM-VI's data sets
    Euroc,
    /// Poses: lines of `seconds x y z qx qy qz qw`
    Tum,
    /// Inertial unit with truth: a table t_s,gyr_x,…,mag_z,gt_qw,…,movement
    Broad,
    /// The lab streaming layer's recordings, on one clock
    Xdf,
    /// A table with a header (commas, semicolons or tabs); the first column is time: seconds, or with a name that ends in _ns, _us or
    /// _ms. Every column is numbers, whole numbers or text
    Csv,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum World {
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
enum Item {
    Imu(usize, Imu),
    Pose(usize, Pose),
    Button(usize, Button),
    Row(usize, Row<'static>),
    Picture(usize, PathBuf),
}

/// Everything of a recording, before it is put in order.
#[derive(Default)]
struct Gathered {
    descs: Vec<(StreamDesc, Carries)>,
    items: Vec<(Times, Item)>,
    faults: Vec<String>,
    /// EuRoC's calibrations, by the name that they have in the folder.
    rig: BTreeMap<String, String>,
}

#[derive(Clone, Copy)]
enum Carries {
    Imu,
    Pose,
    Button,
    Row,
    Picture,
}

/// A stream at work.
enum Open {
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

impl ImportArgs {
    pub fn run(self) -> Result<(), Failure> {
        if !self.path.exists() {
            return Err(Failure::Call(format!(
                "{}: expected a recording, found nothing",
                self.path.display()
            )));
        }
        // What is read would be gone before it is written.
        if self
            .output
            .canonicalize()
            .is_ok_and(|output| self.path.canonicalize().is_ok_and(|path| path == output))
        {
            let message =
                format!("{}: expected another file than the recording itself", self.output.display());
            return Err(Failure::Call(message));
        }
        Failure::unless_kept(&self.output, self.overwrite)?;
        if self.world != World::AsRecorded && matches!(self.kind, Kind::Xdf | Kind::Csv) {
            return Err(Failure::Call("--world: expected a kind with poses: euroc, tum, broad".into()));
        }
        let mut gathered = Gathered::default();
        match self.kind {
            Kind::Euroc => euroc(&self.path, self.world, &mut gathered)?,
            Kind::Tum => tum(&self.path, self.world, &mut gathered)?,
            Kind::Broad => broad(&self.path, self.world, &mut gathered)?,
            Kind::Xdf => xdf(&self.path, &mut gathered)?,
            Kind::Csv => csv(&self.path, &mut gathered)?,
        }
        // Stable: at one instant in the order of the streams.
        gathered.items.sort_by_key(|(times, _)| times.arrived);
        let kind =
            self.kind.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned());
        let mut header = Header {
            application: format!("vergence {}", env!("CARGO_PKG_VERSION")),
            clock: "of the recording".to_owned(),
            ..Header::default()
        };
        header.notes.insert("imported_from".to_owned(), kind.clone());
        let status = write(&self.output, &header, &gathered)?;
        for fault in &gathered.faults {
            ::log::warn!("{}: {fault}", self.path.display());
        }
        let first = gathered.items.first().map(|(times, _)| times.captured);
        let seconds = first
            .and_then(|first| gathered.items.last()?.0.captured.since(first))
            .map_or(0.0, Span::as_secs_f64);
        if self.json {
            let bytes = std::fs::metadata(&self.output).map_or(0, |file| file.len());
            let streams: Vec<&str> = gathered.descs.iter().map(|(desc, _)| &desc.name[..]).collect();
            println!(
                "{}",
                serde_json::json!({
                    "kind": kind, "streams": streams, "samples": status.taken, "dropped": status.dropped,
                    "seconds": seconds, "bytes": bytes, "faults": gathered.faults,
                })
            );
        } else {
            let (count, samples) = (gathered.descs.len(), status.taken);
            println!(
                "{}: {samples} sample{} of {count} stream{}, {seconds:.3} s",
                self.output.display(),
                if samples == 1 { "" } else { "s" },
                if count == 1 { "" } else { "s" },
            );
        }
        Ok(())
    }
}

fn write(output: &Path, header: &Header, gathered: &Gathered) -> Result<vergence_log::Status, Failure> {
    /// The queue is emptied before it can be full: nothing of a recording is dropped.
    const BEFORE_SYNC: usize = 1 << 20;
    let options = Options { queue_bytes: 64 << 20, ..Options::default() };
    let failed = |error: vergence_log::Error| super::failed(&error);
    let mut recorder = Recorder::create(output, header, &options).map_err(failed)?;
    if !gathered.rig.is_empty() {
        recorder.annotate(vergence_session::RIG, &gathered.rig);
    }
    let mut open = Vec::with_capacity(gathered.descs.len());
    for (desc, carries) in &gathered.descs {
        open.push(match carries {
            Carries::Imu => Open::Imu(recorder.stream(desc).map_err(failed)?),
            Carries::Pose => Open::Pose(recorder.stream(desc).map_err(failed)?),
            Carries::Button => Open::Button(recorder.stream(desc).map_err(failed)?),
            Carries::Row => Open::Row(recorder.stream(desc).map_err(failed)?),
            Carries::Picture => Open::Picture(recorder.stream(desc).map_err(failed)?),
        });
    }
    let mut since_sync = 0;
    for (times, item) in &gathered.items {
        let times = *times;
        since_sync += 256;
        match item {
            Item::Imu(stream, imu) => {
                if let Open::Imu(stream) = &open[*stream] {
                    recorder.write(stream, times, imu);
                }
            }
            Item::Pose(stream, pose) => {
                if let Open::Pose(stream) = &open[*stream] {
                    recorder.write(stream, times, pose);
                }
            }
            Item::Button(stream, button) => {
                if let Open::Button(stream) = &open[*stream] {
                    recorder.write(stream, times, button);
                }
            }
            Item::Row(stream, row) => {
                since_sync += 16 * (row.numbers.len() + row.integers.len());
                since_sync += row.texts.iter().map(String::len).sum::<usize>();
                if let Open::Row(stream) = &open[*stream] {
                    recorder.write(stream, times, row);
                }
            }
            Item::Picture(stream, path) => {
                let data =
                    std::fs::read(path).map_err(|e| Failure::Work(format!("{}: {e}", path.display())))?;
                // By what it is, not by its name.
                let encoding = if data.starts_with(&[0xff, 0xd8]) { "jpeg" } else { "png" };
                since_sync += data.len();
                let image = Image {
                    width: 0,
                    height: 0,
                    step: 0,
                    encoding: Cow::Borrowed(encoding),
                    data: Cow::Owned(data),
                };
                if let Open::Picture(stream) = &open[*stream] {
                    recorder.write(stream, times, &Compressed(image));
                }
            }
        }
        if since_sync > BEFORE_SYNC {
            recorder.sync().map_err(failed)?;
            since_sync = 0;
        }
    }
    let status = recorder.finish().map_err(failed)?;
    if status.dropped > 0 {
        let message =
            format!("{}: {} samples were dropped; nothing should be", output.display(), status.dropped);
        return Err(Failure::Work(message));
    }
    Ok(status)
}

fn poses(trajectory: &Trajectory, name: &str, world: World, gathered: &mut Gathered) {
    let (ours_from_theirs, axes) = world.turn();
    let desc = StreamDesc::new(name).frame(WORLD).note("axes", axes);
    let stream = gathered.stream(desc, Carries::Pose);
    let item = |(at, theirs_from_body): &(Timestamp, Rigid)| {
        // What stays as it was stays to the last bit.
        let pose = match world {
            World::AsRecorded => *theirs_from_body,
            World::YUp => ours_from_theirs * theirs_from_body,
        };
        (Times::at(*at), Item::Pose(stream, Pose::tracked(pose)))
    };
    gathered.items.extend(trajectory.poses.iter().map(item));
}

fn tum(path: &Path, world: World, gathered: &mut Gathered) -> Result<(), Failure> {
    poses(&Trajectory::read(path).map_err(|error| Failure::work(&error))?, "/body", world, gathered);
    Ok(())
}

/// What of EuRoC's folder is there: any of imu0, cam0…, state_groundtruth_estimate0.
fn euroc(path: &Path, world: World, gathered: &mut Gathered) -> Result<(), Failure> {
    let inner = path.join("mav0");
    let rig = if inner.is_dir() { inner } else { path.to_owned() };
    for name in (0..8).map(|index| format!("cam{index}")).chain(["imu0".to_owned()]) {
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
    for truth in ["state_groundtruth_estimate0", "mocap0", "vicon0", "leica0"] {
        let table = rig.join(truth).join("data.csv");
        // Leica has positions only, which are no poses.
        if table.is_file() && truth != "leica0" {
            let trajectory = Trajectory::read(&table).map_err(|error| Failure::work(&error))?;
            poses(&trajectory, &format!("/{truth}"), world, gathered);
        }
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

fn broad(path: &Path, world: World, gathered: &mut Gathered) -> Result<(), Failure> {
    let recording = Recording::read(path).map_err(|error| Failure::work(&error))?;
    let imu = gathered.stream(StreamDesc::new("/imu").frame("imu"), Carries::Imu);
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
    let desc = StreamDesc::new("/truth").frame(frame).note("axes", axes);
    let truth = gathered.stream(desc, Carries::Pose);
    let movement = gathered.stream(StreamDesc::new("/movement"), Carries::Button);
    for ((at, _), said) in recording.samples.iter().zip(&recording.truth) {
        let pose = said.earth_from_sensor.map_or(Pose::LOST, |q| {
            let c = match world {
                World::AsRecorded => q.coords,
                World::YUp => (world.turn().0.rotation * q).coords,
            };
            Pose::from_exact([0.0; 3], Tracking::Lost, [c.x, c.y, c.z, c.w], Tracking::Measured)
        });
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

fn xdf(path: &Path, gathered: &mut Gathered) -> Result<(), Failure> {
    let xdf = read_xdf(path).map_err(|error| super::failed(&error))?;
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
fn csv(path: &Path, gathered: &mut Gathered) -> Result<(), Failure> {
    let text = std::fs::read(path).map_err(|error| Failure::Work(format!("{}: {error}", path.display())))?;
    let table = Table::parse(&text).map_err(|error| Failure::Work(format!("{}:{error}", path.display())))?;
    gathered.faults = table.renamed;
    let stem = path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
    let mut desc = StreamDesc::new(stream_name(&stem, &gathered.descs));
    let (mut numbers, mut integers, mut texts) = (Vec::new(), Vec::new(), Vec::new());
    for column in table.columns {
        let (field, place) = match column.cells {
            Cells::Numbers(all) => (numbers.push(all), ("numbers", numbers.len())).1,
            Cells::Integers(all) => (integers.push(all), ("integers", integers.len())).1,
            Cells::Texts(all) => (texts.push(all), ("texts", texts.len())).1,
        };
        desc = desc.note(format!("column.{field}[{}]", place - 1), column.name);
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
