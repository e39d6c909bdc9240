//! What is in a log and whether it is well: one pass over the file, memory in proportion to its streams.

use std::collections::BTreeMap;

use serde::Serialize;
use vergence_sense::Event;

use crate::breaks::Breaks;
use crate::error::Error;
use crate::header::{FAILED, REPAIRED};
use crate::message::{ClockKind, Message, Times};
use crate::messages::times_of;
use crate::reader::{Ending, Entry, Place, Reader};

/// Findings kept; what is beyond is counted.
const FINDINGS: usize = 100;

/// A log, summed up.
#[derive(Clone, Debug, Serialize)]
pub struct Survey {
    /// Bytes of the file.
    pub bytes: u64,
    /// The file ends as it should.
    pub complete: bool,
    /// Where it was cut off, or ended because the recording failed, otherwise.
    pub cut_off_at: Option<u64>,
    /// Why the recording failed, where it did (a full disk): the file ends early, or was made of one that does.
    pub failed: Option<String>,
    /// What a repair found missing, where the file was made by one: `key value` after `key value`.
    pub repaired: Option<String>,
    /// Messages that were read.
    pub messages: u64,
    /// From the first arrival to the last, seconds.
    pub duration_s: f64,
    /// Earliest and latest arrival, session time, nanoseconds.
    pub arrived_ns: Option<(i64, i64)>,
    /// What it says about its session; empty where a stranger wrote it.
    pub session: BTreeMap<String, String>,
    /// Facts under names, and what is attached.
    pub metadata: Vec<String>,
    /// Names of what is attached.
    pub attachments: Vec<String>,
    /// By name.
    pub streams: Vec<StreamSurvey>,
    /// What is not as it should be, in the order of the file; the first hundred.
    pub findings: Vec<Finding>,
    /// How many there are in all.
    pub findings_count: u64,
}

/// A stream, summed up.
#[derive(Clone, Debug, Serialize)]
pub struct StreamSurvey {
    /// `/head`.
    pub name: String,
    /// Of its messages.
    #[serde(rename = "type")]
    pub type_name: String,
    /// Schema of its messages.
    pub schema: String,
    /// Of its values.
    pub unit: String,
    /// Of its coordinates.
    pub frame: String,
    /// `session` or `host`.
    pub clock: &'static str,
    /// Messages.
    pub count: u64,
    /// Of payload.
    pub bytes: u64,
    /// One over the median time between captures, Hz (to 5 % where times are uneven); `None` for fewer than two messages or no time between them.
    pub rate_hz: Option<f64>,
    /// Of a stream of events: the gaps that they tell of their device ([`Breaks`](crate::Breaks)), as a recording counts them. Of another:
    /// times between captures of more than twice the median.
    pub gaps: u64,
    /// Of a stream of events: the readings that are missing at these gaps by the device's own numbers.
    pub device_missing: u64,
    /// The longest time between captures, seconds.
    pub longest_gap_s: f64,
    /// Messages whose number is missing: dropped while recording, or lost with a damaged chunk.
    pub missing: u64,
    /// From capture to arrival.
    pub delay: Option<Delay>,
    /// What else the file says of it: a foreign recording's columns and axes, a device's range.
    pub notes: BTreeMap<String, String>,
}

/// How arrival follows capture: `arrived − captured = mean + drift · captured + residual`.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Delay {
    /// Mean, milliseconds; negative for what is predicted ahead.
    pub mean_ms: f64,
    /// Smallest, milliseconds.
    pub min_ms: f64,
    /// Largest, milliseconds.
    pub max_ms: f64,
    /// Slope of the least-squares line, parts per million: how much faster the clock of arrival runs.
    pub drift_ppm: f64,
    /// Root mean square of what the line leaves, milliseconds.
    pub residual_ms: f64,
}

/// Something that is not as it should be.
#[derive(Clone, Debug, Serialize)]
pub struct Finding {
    /// `damage`, `arrival`, `capture`, `sequence`, `dropped`, `attachment`, `times`.
    pub kind: &'static str,
    /// Which stream; empty for the file.
    pub stream: String,
    /// Offset in the file of the record or of its chunk.
    pub offset: u64,
    /// In words.
    pub sentence: String,
}

/// Times between captures, counted and summed up in classes of 1/16 octave: the median is the mean of its class, exact
/// where times are even and to 5 % elsewhere. As many classes as there were: a file may have 65,536 streams.
#[derive(Clone, Debug, Default)]
struct Intervals(BTreeMap<u32, (u64, u64)>);

impl Intervals {
    const PER_OCTAVE: u32 = 16;

    fn add(&mut self, nanos: i64) {
        let class = match u64::try_from(nanos) {
            Ok(nanos @ 1..) => ((nanos as f64).log2() * f64::from(Self::PER_OCTAVE)) as u32 + 1,
            _ => 0,
        };
        let (count, sum) = self.0.entry(class).or_default();
        *count += 1;
        *sum = sum.saturating_add(u64::try_from(nanos).unwrap_or(0));
    }

    /// The median, nanoseconds, and how many are more than twice as long.
    fn median_and_gaps(&self) -> Option<(f64, u64)> {
        let total: u64 = self.0.values().map(|(count, _)| count).sum();
        let mut below = 0;
        let (&class, &(count, sum)) = self.0.iter().find(|(_, (count, _))| {
            below += count;
            below * 2 >= total
        })?;
        if class == 0 {
            return None;
        }
        let median = sum as f64 / count as f64;
        // One class more than an octave, so that twice the median itself is no gap.
        let gaps = self.0.range(class + Self::PER_OCTAVE + 1..).map(|(_, (count, _))| count).sum();
        Some((median, gaps))
    }
}

/// Least squares of delay over capture, in one pass (Welford's recurrences, which do not cancel).
#[derive(Clone, Debug, Default)]
struct Line {
    count: f64,
    mean_x: f64,
    mean_y: f64,
    xx: f64,
    xy: f64,
    yy: f64,
    min: f64,
    max: f64,
}

impl Line {
    fn add(&mut self, x: f64, y: f64) {
        (self.min, self.max) = if self.count == 0.0 { (y, y) } else { (self.min.min(y), self.max.max(y)) };
        self.count += 1.0;
        let (dx, dy) = (x - self.mean_x, y - self.mean_y);
        self.mean_x += dx / self.count;
        self.mean_y += dy / self.count;
        self.xx += dx * (x - self.mean_x);
        self.xy += dx * (y - self.mean_y);
        self.yy += dy * (y - self.mean_y);
    }

    fn delay(&self) -> Option<Delay> {
        if self.count == 0.0 {
            return None;
        }
        let slope = if self.xx > 0.0 { self.xy / self.xx } else { 0.0 };
        let rest = (self.yy - slope * self.xy).max(0.0);
        Some(Delay {
            mean_ms: self.mean_y * 1e3,
            min_ms: self.min * 1e3,
            max_ms: self.max * 1e3,
            drift_ppm: slope * 1e6,
            residual_ms: (rest / self.count).sqrt() * 1e3,
        })
    }
}

#[derive(Debug)]
struct Watched {
    count: u64,
    bytes: u64,
    missing: u64,
    next: Option<u32>,
    last: Option<Times>,
    first: Option<Times>,
    longest: i64,
    intervals: Intervals,
    line: Line,
    breaks: Breaks,
}

impl Watched {
    fn new() -> Self {
        Self {
            count: 0,
            bytes: 0,
            missing: 0,
            next: None,
            last: None,
            first: None,
            longest: 0,
            intervals: Intervals::default(),
            line: Line::default(),
            breaks: Breaks::default(),
        }
    }
}

/// What a stream's metadata say beyond what has a place of its own in [`StreamSurvey`].
fn notes(metadata: &BTreeMap<String, String>) -> BTreeMap<String, String> {
    let is_said = |key: &str| ["type", "unit", "frame", "clock", "version"].contains(&key);
    metadata.iter().filter(|(key, _)| !is_said(key)).map(|(k, v)| (k.clone(), v.clone())).collect()
}

#[derive(Debug, Default)]
struct Findings {
    kept: Vec<Finding>,
    count: u64,
}

impl Findings {
    fn add(&mut self, kind: &'static str, stream: &str, place: Place, sentence: impl FnOnce() -> String) {
        self.count += 1;
        if self.kept.len() < FINDINGS {
            let (stream, offset) = (stream.to_owned(), place.offset);
            self.kept.push(Finding { kind, stream, offset, sentence: sentence() });
        }
    }
}

impl Survey {
    /// Reads the log to its end, and on behind damage; `progress` hears of bytes read and bytes in all.
    ///
    /// # Errors
    /// Where the file cannot be read at all.
    pub fn of(reader: &mut Reader, progress: &mut dyn FnMut(u64, u64)) -> Result<Self, Error> {
        let mut watched: BTreeMap<u16, Watched> = BTreeMap::new();
        let mut findings = Findings::default();
        let (mut messages, mut extent, mut last): (u64, Option<(i64, i64)>, Option<i64>) = (0, None, None);
        loop {
            if messages.is_multiple_of(1024) {
                let (read, all) = reader.progress();
                progress(read, all);
            }
            let entry = match reader.next() {
                Ok(Some(entry)) => entry,
                Ok(None) => break,
                Err(Error::Damaged { at, expected, found, .. }) => {
                    let place = Place { offset: at, in_chunk: 0 };
                    findings.add("damage", "", place, || format!("expected {expected}, found {found}"));
                    continue;
                }
                Err(error) => return Err(error),
            };
            messages += 1;
            let stream = watched.entry(entry.stream.id).or_insert_with(Watched::new);
            if let Some(arrived) = watch(stream, &entry, &mut findings) {
                let (low, high) = extent.unwrap_or((arrived, arrived));
                extent = Some((low.min(arrived), high.max(arrived)));
                if let Some(last) = last.filter(|last| *last > arrived) {
                    findings.add("arrival", &entry.stream.name, entry.place, || {
                        format!("arrived at {arrived} ns, after a message that arrived at {last} ns")
                    });
                }
                last = Some(arrived);
            }
        }
        for attached in reader.attachments() {
            if !attached.is_whole(reader.path())? {
                let place = Place { offset: attached.offset, in_chunk: 0 };
                findings
                    .add("attachment", "", place, || format!("the attached {} is damaged", attached.name));
            }
        }
        Ok(Self::sum_up(reader, &watched, findings, messages, extent))
    }

    fn sum_up(
        reader: &Reader,
        watched: &BTreeMap<u16, Watched>,
        findings: Findings,
        messages: u64,
        extent: Option<(i64, i64)>,
    ) -> Self {
        let nothing = Watched::new();
        let mut streams: Vec<StreamSurvey> = reader
            .streams()
            .map(|info| {
                let seen = watched.get(&info.id).unwrap_or(&nothing);
                let median = seen.intervals.median_and_gaps();
                let is_of_events = info.type_name() == Event::NAME;
                let pauses = median.map_or(0, |(_, gaps)| gaps);
                StreamSurvey {
                    name: info.name.clone(),
                    type_name: info.type_name().to_owned(),
                    schema: info.schema.clone(),
                    unit: info.unit().to_owned(),
                    frame: info.frame().to_owned(),
                    clock: info.clock().name(),
                    count: seen.count,
                    bytes: seen.bytes,
                    rate_hz: median.map(|(median, _)| 1e9 / median),
                    gaps: if is_of_events { seen.breaks.count() } else { pauses },
                    device_missing: seen.breaks.missing(),
                    longest_gap_s: seen.longest as f64 * 1e-9,
                    missing: seen.missing,
                    delay: seen.line.delay(),
                    notes: notes(&info.metadata),
                }
            })
            .collect();
        streams.sort_by(|a, b| a.name.cmp(&b.name));
        let (cut_off_at, has_failed) = match reader.ending() {
            Some(Ending::CutOff { at }) => (Some(at), false),
            Some(Ending::Failed { at }) => (Some(at), true),
            _ => (None, false),
        };
        let note = |wanted: &str| {
            let found = reader.metadata().iter().rfind(|(name, _)| name == wanted);
            found.map(|(_, note)| note)
        };
        let why = note(FAILED).and_then(|note| note.get("reason")).cloned();
        let unsaid = || has_failed.then(|| "there was no room to say why".to_owned());
        let repaired = note(REPAIRED).map(|note| {
            let pairs: Vec<String> = note.iter().map(|(key, value)| format!("{key} {value}")).collect();
            pairs.join(", ")
        });
        Self {
            bytes: reader.progress().1,
            complete: reader.ending() == Some(Ending::Complete),
            cut_off_at,
            failed: why.or_else(unsaid),
            repaired,
            messages,
            duration_s: extent.map_or(0.0, |(low, high)| (high as f64 - low as f64) * 1e-9),
            arrived_ns: extent,
            session: reader.header().map(crate::Header::to_map).unwrap_or_default(),
            metadata: reader.metadata().iter().map(|(name, _)| name.clone()).collect(),
            attachments: reader.attachments().iter().map(|attached| attached.name.clone()).collect(),
            streams,
            findings_count: findings.count,
            findings: findings.kept,
        }
    }

    /// The gaps that devices told of themselves, as a recording counts them, and the readings that are missing there by their numbers.
    pub fn device_gaps(&self) -> (u64, u64) {
        let of_events = self.streams.iter().filter(|stream| stream.type_name == Event::NAME);
        of_events.fold((0, 0), |sum, stream| (sum.0 + stream.gaps, sum.1 + stream.device_missing))
    }

    /// Everything is there and in order.
    pub fn is_well(&self) -> bool {
        self.complete && self.findings_count == 0
    }
}

/// What the recorder said of itself.
fn own_event(event: &Event, place: Place, findings: &mut Findings) {
    let Event { name, text, before, after, .. } = event;
    match &**name {
        "dropped" => {
            findings.add("dropped", text, place, || format!("{after} messages were dropped while recording"))
        }
        "not_attached" => {
            findings.add("attachment", "", place, || format!("{text} could not be attached"));
        }
        "attached_short" => findings.add("attachment", "", place, || {
            format!("{text}: expected {before} bytes, found {after}; zeros stand for the rest")
        }),
        _ => {}
    }
}

/// Takes a message into account; when it arrived.
fn watch(stream: &mut Watched, entry: &Entry<'_>, findings: &mut Findings) -> Option<i64> {
    let (name, place) = (&entry.stream.name, entry.place);
    stream.count += 1;
    stream.bytes += entry.payload.len() as u64;
    // Strangers do not count their messages.
    if let Some(next) = stream.next.filter(|_| entry.stream.metadata.contains_key("type")) {
        let ahead = entry.sequence.wrapping_sub(next);
        if ahead > u32::MAX / 2 {
            findings.add("sequence", name, place, || {
                format!("number {} after {}", entry.sequence, next.wrapping_sub(1))
            });
        } else if ahead > 0 {
            stream.missing += u64::from(ahead);
            findings.add("sequence", name, place, || {
                format!("{ahead} messages are missing from number {next} on")
            });
        }
    }
    stream.next = Some(entry.sequence.wrapping_add(1));
    if entry.stream.type_name() == Event::NAME
        && let Ok(event) = entry.decode::<Event>()
    {
        if name == crate::writer::StreamRecord::OWN {
            own_event(&event.value, place, findings);
        } else {
            stream.breaks.follow(&event.value);
        }
    }
    let times = match times_of(entry) {
        Ok(Some(times)) => times,
        Ok(None) => {
            let at =
                |nanos: u64| vergence_time::Timestamp::from_nanos(i64::try_from(nanos).unwrap_or(i64::MAX));
            Times::new(at(entry.publish_time), at(entry.log_time))
        }
        Err(error) => {
            findings.add("times", name, place, || format!("no times can be read: {error}"));
            return None;
        }
    };
    let (captured, arrived) = (times.captured.as_nanos(), times.arrived.as_nanos());
    if crate::writer::log_time(times.arrived) != entry.log_time {
        findings
            .add("times", name, place, || format!("arrived at {arrived} ns, log time {} ns", entry.log_time));
    }
    let first = *stream.first.get_or_insert(times);
    if let Some(last) = stream.last {
        let between = captured.saturating_sub(last.captured.as_nanos());
        if between < 0 && entry.stream.clock() == ClockKind::Session {
            findings.add("capture", name, place, || {
                format!("captured at {captured} ns, after one captured {} ns later", between.unsigned_abs())
            });
        }
        stream.intervals.add(between);
        stream.longest = stream.longest.max(between);
    }
    stream.last = Some(times);
    // Relative to the first, so that the precision of f64 is that of the session's length.
    let x = captured.saturating_sub(first.captured.as_nanos()) as f64 * 1e-9;
    stream.line.add(x, arrived.saturating_sub(captured) as f64 * 1e-9);
    Some(arrived)
}
