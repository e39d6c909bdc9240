//! `vergence record`: devices into a session log, without a scene. And such a log, played again.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use vergence_log::{Breaks, Ending, Header, LogSource, Options, Reader, Recorder, SourceLane};
use vergence_sense::{Event, Progress, Reading, Sample, Sink, Source, SourceStream};
use vergence_time::{Clock, HostClock, Span, Timestamp};

use crate::devices::{Opened, interrupted, open, words};
use crate::failure::Failure;

/// Names us in the header of a log; what is replayed as a log of devices.
const APPLICATION: &str = "vergence record";
/// Of each device's queue: more than a second of two cameras, for a writer that the machine does not let run.
const QUEUE_BYTES: usize = 32 << 20;
/// How long a device may keep a thread that is asked to end.
const ROUND: Span = Span::from_millis(100);

/// Records devices into a session log, without a scene, until Ctrl-C
#[derive(clap::Args)]
pub struct Args {
    /// The log (.mcap); one that is there is refused
    output: PathBuf,
    /// A device: its path; a part of its name; serial:PATH; desktop for keyboard, mouse and touches of a window that opens; gaze for where
    /// the wearer of an OpenXR headset looks, or gaze:MOTION for that of the simulated one, moved so (gaze:tour) [default: every one
    /// that is listed and can be read]
    #[arg(long = "device", value_name = "DEVICE")]
    devices: Vec<String>,
    /// How devices are read: baud rate, streams of devices that do not describe themselves, HID mappings, extra mouse buttons; all keys
    /// are in crates/vergence-input/MAPPING.md
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Ends after so many seconds [default: with Ctrl-C]
    #[arg(long, value_name = "SECONDS", value_parser = crate::devices::seconds, allow_negative_numbers = true)]
    seconds: Option<f64>,
    /// Replaces the log where there is one already
    #[arg(long)]
    overwrite: bool,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

/// How a recording, or its replay, went.
#[derive(Debug, Default, Serialize)]
struct Report {
    streams: usize,
    samples: u64,
    dropped: u64,
    gaps: u64,
    seconds: f64,
    bytes: u64,
    /// What devices sent and is in no sample: of a recording only.
    #[serde(flatten)]
    losses: BTreeMap<&'static str, u64>,
}

impl Report {
    fn print(&self, json: bool, what: &str) -> Result<(), Failure> {
        if json {
            println!("{}", serde_json::to_string(self).map_err(|error| Failure::work(&error))?);
        } else {
            let losses = self.losses.iter().filter(|(_, count)| **count > 0);
            let losses: String = losses.map(|(way, count)| format!(", {count} {way}")).collect();
            println!(
                "{what}: {} samples of {} streams in {:.3} s, {} bytes; {} dropped, {} gaps{losses}",
                self.samples, self.streams, self.seconds, self.bytes, self.dropped, self.gaps
            );
        }
        Ok(())
    }
}

/// Counts on the way into the log, and says what the user can mend while it can be mended.
struct Counted<'a> {
    lane: SourceLane,
    name: String,
    bar: ProgressBar,
    samples: &'a AtomicU64,
    gaps: &'a AtomicU64,
    /// Whether the device has said anything else than events and how its clock stands.
    has_readings: bool,
    lost: Breaks,
}

impl Counted<'_> {
    fn hear(&mut self, event: &Event) {
        let was_there = self.lost.was_there();
        if self.lost.follow(event) {
            self.gaps.fetch_add(1, Ordering::Relaxed);
        }
        let is_said = match &*event.name {
            "gap" => self.lost.count() == 1,
            "connected" => was_there,
            "disconnected" | "no_frames" | "no_lines" | "line" | "clock_ignored" | "description"
            | "unread" | "restarted" => true,
            _ => false,
        };
        if is_said {
            let again = if event.name == "connected" { " again" } else { "" };
            let text = if event.text.is_empty() { String::new() } else { format!(": {}", event.text) };
            self.bar.suspend(|| eprintln!("{}: {}{again}{text}", self.name, event.name));
        }
    }
}

impl Sink for Counted<'_> {
    fn appears(&mut self, place: usize, stream: &SourceStream) {
        self.lane.appears(place, stream);
    }

    fn take(&mut self, stream: usize, sample: Sample<Reading<'_>>) {
        match &sample.value {
            Reading::Event(event) => self.hear(event),
            // The clock's residual is ours.
            Reading::Scalar(_) if stream == vergence_input::CLOCK_RESIDUAL => {}
            _ => self.has_readings = true,
        }
        let before = self.lane.taken();
        self.lane.take(stream, sample);
        self.samples.fetch_add(self.lane.taken() - before, Ordering::Relaxed);
    }
}

impl Args {
    /// Records, and says how that went.
    pub fn run(self) -> Result<(), Failure> {
        let log_failed = |error: &vergence_log::Error| Failure::work(error);
        if let Some(config) = &self.config {
            Failure::unless_own("OUTPUT", &self.output, std::slice::from_ref(config))?;
        }
        Failure::unless_kept(&self.output, self.overwrite)?;
        let clock: Arc<dyn Clock> = Arc::new(HostClock::start());
        let stop = interrupted()?;
        let mut opened = open(&self.devices, self.config.as_ref(), &clock)?;
        let mut header = Header {
            application: APPLICATION.to_owned(),
            clock: "monotonic".to_owned(),
            ..Header::default()
        };
        header.device = opened
            .iter()
            .map(|d| format!("{} ({})", d.device.name, d.device.path))
            .collect::<Vec<_>>()
            .join(", ");
        let options = Options { queue_bytes: QUEUE_BYTES, ..Options::default() };
        let recorder = Recorder::create(&self.output, &header, &options).map_err(|e| log_failed(&e))?;
        let recorder = Arc::new(Mutex::new(recorder));
        let (samples, gaps) = (AtomicU64::new(0), AtomicU64::new(0));
        let bar = ProgressBar::new_spinner();
        if let Ok(style) = ProgressStyle::with_template("{spinner} {elapsed} {pos} samples {msg}") {
            bar.set_style(style);
        }
        let mut lanes = Vec::new();
        for device in &opened {
            let lane = SourceLane::new(&recorder, &device.name, device.source.streams());
            lanes.push(Counted {
                lane: lane.map_err(|e| log_failed(&e))?,
                name: device.name.clone(),
                bar: bar.clone(),
                samples: &samples,
                gaps: &gaps,
                has_readings: false,
                lost: Breaks::default(),
            });
        }
        let start = Instant::now();
        let left = AtomicUsize::new(opened.len());
        let is_over = || {
            stop.load(Ordering::Relaxed)
                || left.load(Ordering::Relaxed) == 0
                || self.seconds.is_some_and(|secs| start.elapsed().as_secs_f64() >= secs)
        };
        let mut failure = None;
        std::thread::scope(|scope| {
            for (device, mut lane) in opened.iter_mut().zip(lanes) {
                let (clock, is_over, left) = (&clock, &is_over, &left);
                scope.spawn(move || {
                    pump(device, &mut lane, &**clock, is_over);
                    left.fetch_sub(1, Ordering::Relaxed);
                    if !lane.has_readings {
                        lane.bar.suspend(|| eprintln!("{}: nothing but events came of it", lane.name));
                    }
                });
            }
            while !is_over() {
                std::thread::sleep(std::time::Duration::from_millis(50));
                bar.set_position(samples.load(Ordering::Relaxed));
                failure = failure
                    .take()
                    .or_else(|| recorder.lock().unwrap_or_else(PoisonError::into_inner).failure());
                if failure.is_some() {
                    stop.store(true, Ordering::Relaxed);
                }
            }
        });
        bar.finish_and_clear();
        let streams = opened.iter().map(|device| device.source.streams().len()).sum();
        let mut losses = BTreeMap::from([("missing", 0), ("broken", 0), ("unread", 0)]);
        for (way, count) in opened.iter().flat_map(|device| device.source.losses()) {
            *losses.entry(way).or_default() += count;
        }
        drop(opened);
        // Lanes went with their threads: nobody else has it.
        let (status, error) =
            match Arc::into_inner(recorder).map(|r| r.into_inner().unwrap_or_else(PoisonError::into_inner)) {
                Some(recorder) => recorder.close(),
                None => return Err(Failure::Work("the recording is still in use".into())),
            };
        let failure = failure.or(error);
        let (mut samples, mut dropped) = (samples.into_inner(), status.dropped);
        if failure.is_some() {
            // What was on its way is in neither count: the file says what it has.
            let held = held(&self.output);
            dropped = dropped.max(samples.saturating_sub(held));
            samples = held;
        }
        let report = Report {
            streams,
            samples,
            dropped,
            gaps: gaps.into_inner(),
            seconds: start.elapsed().as_secs_f64(),
            bytes: std::fs::metadata(&self.output).map_or(0, |file| file.len()),
            losses,
        };
        report.print(self.json, &self.output.display().to_string())?;
        match (failure, report.dropped) {
            (Some(error), _) => Err(log_failed(&error)),
            (None, 1..) => Err(Failure::Work(format!(
                "expected every sample to be recorded, found {} dropped",
                report.dropped
            ))),
            (None, _) => Ok(()),
        }
    }
}

/// Samples that a file has, as far as it can be read.
fn held(path: &Path) -> u64 {
    let Ok(reader) = Reader::open(path) else { return 0 };
    let (mut source, mut sink) = (LogSource::new(reader), Printed::default());
    while source.advance(Timestamp::from_nanos(i64::MAX), &mut sink) != Progress::Ended {}
    sink.samples
}

fn pump(device: &mut Opened, lane: &mut dyn Sink, clock: &dyn Clock, is_over: &dyn Fn() -> bool) {
    while !is_over() {
        let until = clock.now().saturating_add(ROUND);
        if device.source.advance(until, lane) == Progress::Ended {
            return;
        }
    }
}

/// Whether a log is one of devices or was imported: without a headset and a scene.
pub fn is_of_devices(path: &Path) -> bool {
    let without = |header: &Header| {
        header.application == APPLICATION || (header.headset.is_empty() && header.scene_path.is_empty())
    };
    Reader::open(path).is_ok_and(|reader| reader.header().is_some_and(without))
}

/// Says on stderr where a log that was read to its end is not whole.
pub fn warn_of_end(reader: &Reader) {
    let path = reader.path().display();
    match reader.ending() {
        Some(Ending::CutOff { at }) => eprintln!("{path}: cut off at byte {at}: what came later is missing"),
        Some(Ending::Failed { .. }) => eprintln!("{path}: the recording failed: what came later is missing"),
        Some(Ending::Complete) | None => {}
    }
}

#[derive(Default)]
struct Printed<'a> {
    only: Option<&'a str>,
    /// Of each stream: its name, and whether it is printed.
    streams: Vec<(String, bool)>,
    samples: u64,
    /// By the place of the stream of events.
    gaps: BTreeMap<usize, Breaks>,
    dropped: u64,
    first: Option<Timestamp>,
    last: Option<Timestamp>,
    /// Samples wait for this.
    pace: Option<(HostClock, f64)>,
}

impl Sink for Printed<'_> {
    fn appears(&mut self, place: usize, stream: &SourceStream) {
        self.streams.resize(self.streams.len().max(place + 1), (String::new(), false));
        let name = format!("/{}", stream.name);
        let is_printed = self.only.is_some_and(|only| is_named(only, &name));
        self.streams[place] = (name, is_printed);
    }

    fn take(&mut self, stream: usize, sample: Sample<Reading<'_>>) {
        self.samples += 1;
        let first = *self.first.get_or_insert(sample.arrived);
        self.last = Some(sample.arrived);
        match &sample.value {
            Reading::Event(event) if event.name == "dropped" => self.dropped += event.after as u64,
            Reading::Event(event) => drop(self.gaps.entry(stream).or_default().follow(event)),
            _ => {}
        }
        if let Some((clock, speed)) = &self.pace
            && let Some(since) = sample.arrived.since(first)
        {
            let due = Span::from_secs_f64(since.as_secs_f64() / speed).unwrap_or(Span::ZERO);
            clock.sleep_until(Timestamp::default().saturating_add(due));
        }
        if self.streams.get(stream).is_some_and(|(_, is_printed)| *is_printed) {
            println!("{} {} {}", sample.captured.as_nanos(), sample.arrived.as_nanos(), words(&sample.value));
        }
    }
}

/// Whether `only` names this stream: in whole, without the slash in front, or by its last levels.
fn is_named(only: &str, name: &str) -> bool {
    name.strip_suffix(only).is_some_and(|before| before.is_empty() || before.ends_with('/'))
}

/// Prints a stream whose messages are none that devices give: capture and arrival in nanoseconds, then its columns. Whether it is
/// one.
fn print_columns(path: &Path, only: &str) -> Result<bool, Failure> {
    let failed = |error: &vergence_log::Error| Failure::work(error);
    let mut reader = Reader::open(path).map_err(|error| failed(&error))?;
    let mut is_one = false;
    while let Some(entry) = reader.next().map_err(|error| failed(&error))? {
        if !is_named(only, &entry.stream.name) {
            continue;
        }
        if vergence_log::LogSource::reads(entry.stream) {
            return Ok(false);
        }
        is_one = true;
        let cells = match vergence_log::foreign::flat(&entry) {
            Ok(Some(cells)) => cells,
            _ => {
                return Err(Failure::Work(format!("{}: its messages are not understood", entry.stream.name)));
            }
        };
        let words: Vec<String> = cells.iter().map(|(column, cell)| word(column, cell)).collect();
        println!("{}", words.join(" "));
    }
    if is_one {
        warn_of_end(&reader);
    }
    Ok(is_one)
}

/// A value, with its column's name where it is none of the two times.
fn word(column: &str, cell: &vergence_log::foreign::Cell) -> String {
    use vergence_log::foreign::Cell;
    let value = match cell {
        Cell::Number(number) => number.to_string(),
        Cell::Integer(number) => number.to_string(),
        Cell::Truth(truth) => truth.to_string(),
        Cell::Text(text) => text.clone(),
    };
    if matches!(column, "captured_ns" | "arrived_ns") { value } else { format!("{column}={value}") }
}

/// Plays a log of devices again, at `speed` times its own or as fast as it goes, printing one of its streams: capture and
/// arrival in nanoseconds, then the values.
pub fn replay(path: &Path, speed: Option<f64>, print: Option<&str>, json: bool) -> Result<(), Failure> {
    let reader = Reader::open(path).map_err(|error| match &error {
        vergence_log::Error::Read { source, .. } if source.kind() == std::io::ErrorKind::NotFound => {
            Failure::call(&error)
        }
        _ => Failure::work(&error),
    })?;
    let mut source = LogSource::new(reader);
    // What sources do not have, as rows of tables and what a runtime said, is printed as columns.
    if let Some(only) = print
        && print_columns(path, only)?
    {
        return Ok(());
    }
    let pace = speed.map(|speed| (HostClock::start(), speed));
    let mut sink = Printed { only: print, pace, ..Printed::default() };
    while source.advance(Timestamp::from_nanos(i64::MAX), &mut sink) != Progress::Ended {}
    if let Some(error) = source.failure() {
        return Err(Failure::work(&error));
    }
    warn_of_end(source.reader());
    if let Some(only) = print
        && !sink.streams.iter().any(|(_, is_printed)| *is_printed)
    {
        let there: Vec<&str> = source.reader().streams().map(|stream| stream.name.as_str()).collect();
        let there = if there.is_empty() { "none".to_owned() } else { there.join(", ") };
        return Err(Failure::Call(format!("expected a stream of the log, found '{only}'; there is {there}")));
    }
    let seconds = sink.first.zip(sink.last).and_then(|(first, last)| last.since(first)).unwrap_or(Span::ZERO);
    let report = Report {
        streams: source.announced(),
        samples: sink.samples,
        dropped: sink.dropped,
        gaps: sink.gaps.values().map(|gaps| gaps.count()).sum(),
        seconds: seconds.as_secs_f64(),
        bytes: std::fs::metadata(path).map_or(0, |file| file.len()),
        losses: BTreeMap::new(),
    };
    if json || print.is_none() {
        report.print(json, &path.display().to_string())?;
    }
    Ok(())
}
