//! `vergence log import`: other people's recordings as a session log.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressStyle};
use vergence_log::foreign::TimeUnit;
use vergence_log::{Compressed, Header, Options, Recorder};
use vergence_sense::Image;
use vergence_time::Span;

use super::gather::{Carries, Gathered, Item, Open, World, broad, csv, euroc, tum, xdf};
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
    /// The unit of a table's first column (csv) [default: as its name says]
    #[arg(long, value_enum, value_name = "UNIT")]
    time_unit: Option<Unit>,
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
    /// A table with a header (commas, semicolons or tabs); the first column is time, in the unit of its name (t_s, `Time [ms]`,
    /// timestamp_us, captured_ns). Every column is numbers, whole numbers or text
    Csv,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Unit {
    S,
    Ms,
    Us,
    Ns,
}

impl From<Unit> for TimeUnit {
    fn from(unit: Unit) -> Self {
        match unit {
            Unit::S => Self::S,
            Unit::Ms => Self::Ms,
            Unit::Us => Self::Us,
            Unit::Ns => Self::Ns,
        }
    }
}

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
        if self.time_unit.is_some() && self.kind != Kind::Csv {
            return Err(Failure::Call("--time-unit: expected the kind csv; others say their own".into()));
        }
        let mut gathered = Gathered::default();
        let bar = ProgressBar::new_spinner();
        if let Ok(style) = ProgressStyle::with_template("{spinner} {elapsed} reading") {
            bar.set_style(style);
        }
        bar.enable_steady_tick(std::time::Duration::from_millis(200));
        match self.kind {
            Kind::Euroc => euroc(&self.path, self.world, &mut gathered)?,
            Kind::Tum => tum(&self.path, self.world, &mut gathered)?,
            Kind::Broad => broad(&self.path, self.world, &mut gathered)?,
            Kind::Xdf => xdf(&self.path, &mut gathered)?,
            Kind::Csv => csv(&self.path, self.time_unit.map(Into::into), &mut gathered)?,
        }
        bar.finish_and_clear();
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
            // A fault that begins with its line follows the file's name at once.
            let space = if fault.starts_with(|c: char| c.is_ascii_digit()) { "" } else { " " };
            ::log::warn!("{}:{space}{fault}", self.path.display());
        }
        let first = gathered.items.first().map(|(times, _)| times.captured);
        let seconds = first
            .and_then(|first| gathered.items.last()?.0.captured.since(first))
            .map_or(0.0, Span::as_secs_f64);
        if self.json {
            let bytes = std::fs::metadata(&self.output).map_or(0, |file| file.len());
            let names: Vec<&str> = gathered.descs.iter().map(|(desc, _)| &desc.name[..]).collect();
            println!(
                "{}",
                serde_json::json!({
                    "kind": kind, "streams": names.len(), "names": names, "samples": status.taken, "dropped": status.dropped,
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
    let bar = ProgressBar::new(gathered.items.len() as u64);
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos}/{len} samples {eta}") {
        bar.set_style(style);
    }
    let mut since_sync = 0;
    for (times, item) in &gathered.items {
        let times = *times;
        bar.inc(1);
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
    bar.finish_and_clear();
    let status = recorder.finish().map_err(failed)?;
    if status.dropped > 0 {
        let message =
            format!("{}: {} samples were dropped; nothing should be", output.display(), status.dropped);
        return Err(Failure::Work(message));
    }
    Ok(status)
}
