//! A serial device as a source.

use std::sync::Arc;
use std::time::Duration;

use vergence_sense::{Event, Progress, Sample, Sink, Source, SourceStream};
use vergence_time::{Clock, ClockKnobs, ClockMap, ClockState, Counter, Span, Timestamp};

use super::backlog::{Backlog, Ticks};
use super::describe::{Description, Payload, unique};
use super::frame::{DESCRIPTIONS, Decoder};
use super::knobs::{Format, SerialConfig, Totals};
use super::lines::{Columns, LineClock, Lines, sequence_bits};
use super::port::{Port, again, open_claimed};
use super::table::{Heard, Table};
use crate::connection::{ClockReport, TRY_AGAIN, event, own_streams, tell};
use crate::error::Error;
use crate::found::Found;
use crate::values::reading;

/// So many bytes without a frame or a line are not the protocol's; at 9600 baud two seconds.
const FOREIGN_BYTES: u64 = 2048;
/// Bytes that are read at once.
const CHUNK: usize = 16 << 10;
/// Of a backlog: as much as kernels buffer.
const MOST_BACKLOG: usize = 64 << 10;
/// A source that is asked to end does so after this.
const LONGEST_WAIT: Duration = Duration::from_millis(100);
/// A gap of more is a device that began anew.
const MOST_GAP: u64 = 1 << 15;

/// Streams that a device may have, also where it describes them anew: a broken one does so without end.
const MOST_STREAMS: usize = 1024;
/// Devices describe their streams once a second; what nothing describes for longer is said.
const DESCRIBED_WITHIN: Span = Span::from_millis(1500);
/// What a port held as it was opened, and what comes meanwhile, is read until nothing comes for so long, at most for so long.
const BACKLOG_PAUSE: Duration = Duration::from_millis(2);
const BACKLOG_LONGEST: Span = Span::from_millis(50);
/// So many lines that are text, and half of the bytes: no wrong baud rate.
const TEXT_LINES: u32 = 3;

/// Who is asked before anybody listens.
struct Nobody;

impl Sink for Nobody {
    fn take(&mut self, _: usize, _: vergence_sense::Sample<vergence_sense::Reading<'_>>) {}
}

/// One described stream of the device.
struct Known {
    /// Place among the source's streams.
    place: usize,
    text: Vec<u8>,
    description: Description,
}

/// What was said of a stream whose frames cannot be read.
#[derive(Clone, Debug, Default)]
struct Strange {
    since: Option<Timestamp>,
    is_told: bool,
    /// A description that is not understood.
    refused: Vec<u8>,
}

/// Lines since something was understood that are none.
#[derive(Debug, Default)]
struct Odd {
    /// What is wrong with the first.
    first: String,
    lines: u32,
    bytes: u64,
}

type Opener = Box<dyn FnMut() -> std::io::Result<Box<dyn Port>> + Send>;

/// A serial device as a source: its streams as it describes them, times of capture from its own clock, gaps in its numbers
/// as events. A device that is unplugged is waited for, under any name that it comes back with.
pub struct SerialSource {
    port: Option<Box<dyn Port>>,
    opener: Opener,
    try_at: Timestamp,
    /// What comes now was measured later: when the device was lost.
    lost_at: Timestamp,
    clock: Arc<dyn Clock>,
    config: SerialConfig,
    /// What comes, once that is seen.
    format: Format,
    streams: Vec<SourceStream>,
    frames: Decoder,
    known: Vec<Option<Known>>,
    strange: Vec<Strange>,
    /// The first stream that nothing described so far, and when that is to be said.
    undescribed: Option<(usize, Timestamp)>,
    text: Lines,
    table: Table,
    /// The place of the first stream of the table's columns.
    columns_place: usize,
    /// Kinds of lines that were said to be none, a bit each.
    refusals: u16,
    odd: Odd,
    /// What was described so far, and where its streams are: a device may go back to it.
    described: Vec<(u8, Description, usize)>,
    named: Vec<(Columns, usize)>,
    /// It was said that there are too many streams.
    is_full: bool,
    map: ClockMap,
    /// The same for lines, whose times are nanoseconds.
    lines_map: ClockMap,
    lines_clock: LineClock,
    /// The device's times of what the port held as it was opened, while that is read.
    backlog: Option<Vec<Option<Ticks>>>,
    report: ClockReport,
    buffer: Box<[u8]>,
    next_sequence: Option<u64>,
    /// Bytes since something was understood.
    foreign: u64,
    totals: Totals,
}

impl SerialSource {
    /// Opens the port of `device`.
    ///
    /// # Errors
    /// Where it cannot be opened.
    pub fn open(device: &Found, config: SerialConfig, clock: Arc<dyn Clock>) -> Result<Self, Error> {
        let (wanted, baud) = (device.clone(), config.baud);
        let refused = |error: std::io::Error| {
            let mut device = device.clone();
            if error.kind() == std::io::ErrorKind::PermissionDenied {
                device.check_access("dialout");
            }
            Error::open(&device, error)
        };
        let mut first = Some(open_claimed(&device.path, baud).map_err(refused)?);
        let opener = move || {
            if let Some(port) = first.take() {
                return Ok(port);
            }
            open_claimed(&again(&wanted).ok_or(std::io::ErrorKind::NotFound)?, baud)
        };
        Ok(Self::new(Box::new(opener), config, clock))
    }

    /// Reads what `opener` opens, and asks it again after a loss.
    pub fn new(opener: Opener, config: SerialConfig, clock: Arc<dyn Clock>) -> Self {
        let (least_latency, most_drift_ppm) = (config.least_latency, config.most_drift_ppm);
        let map =
            |counter| ClockMap::new(ClockKnobs { least_latency, most_drift_ppm, ..ClockKnobs::new(counter) });
        let mut source = Self {
            port: None,
            opener,
            try_at: clock.now(),
            lost_at: Timestamp::from_nanos(i64::MIN),
            clock,
            format: config.format,
            streams: own_streams(),
            frames: Decoder::new(),
            known: (0..256).map(|_| None).collect(),
            strange: vec![Strange::default(); 256],
            undescribed: None,
            text: Lines::default(),
            table: Table::new(config.columns.clone()),
            columns_place: 0,
            refusals: 0,
            odd: Odd::default(),
            described: Vec::new(),
            named: Vec::new(),
            is_full: false,
            map: map(Counter::MICROS_32),
            lines_map: map(Counter::NANOS_64),
            lines_clock: LineClock::default(),
            backlog: None,
            report: ClockReport::default(),
            buffer: vec![0; CHUNK].into_boxed_slice(),
            next_sequence: None,
            foreign: 0,
            totals: Totals::default(),
            config,
        };
        for (number, description) in source.config.streams.clone() {
            source.describe(number, &[], description, &mut Nobody);
        }
        source.take_columns(&mut Nobody);
        source
    }

    /// What became of what the device sent.
    pub fn totals(&self) -> Totals {
        Totals { frames: self.frames.tally(), ..self.totals }
    }

    /// How the device's clock stands to ours.
    pub fn clock_state(&self) -> ClockState {
        if self.format == Format::Lines { self.lines_map.state() } else { self.map.state() }
    }

    fn describe(&mut self, number: u8, text: &[u8], description: Description, sink: &mut dyn Sink) {
        let same = |known: &&(u8, Description, usize)| known.0 == number && known.1 == description;
        let place = match self.described.iter().find(same) {
            Some((.., place)) => *place,
            None if self.streams.len() >= MOST_STREAMS => {
                // What it sends is no longer what it was described as.
                self.known[usize::from(number)] = None;
                return self.too_many(sink);
            }
            None => {
                let name = unique(description.name(), &self.streams);
                let stream = description.stream(name.into_owned());
                let place = self.streams.len();
                sink.appears(place, &stream);
                self.streams.push(stream);
                self.described.push((number, description.clone(), place));
                place
            }
        };
        self.known[usize::from(number)] = Some(Known { place, text: text.to_owned(), description });
    }

    /// Says, once, that the device has described too many streams.
    fn too_many(&mut self, sink: &mut dyn Sink) {
        if !std::mem::replace(&mut self.is_full, true) {
            log::warn!("serial: the device describes more than {MOST_STREAMS} streams: the rest is not read");
            let event = Event::new("description", "there are too many streams: the rest is not read");
            tell(sink, self.clock.now(), event);
        }
    }

    /// Makes streams of the table's columns; whether there is room for them.
    fn take_columns(&mut self, sink: &mut dyn Sink) -> bool {
        let Some(columns) = self.table.columns() else { return false };
        if let Some((_, place)) = self.named.iter().find(|(known, _)| known == columns) {
            self.columns_place = *place;
            return true;
        }
        if self.streams.len() + columns.streams().count() > MOST_STREAMS {
            self.table.give_up();
            self.too_many(sink);
            return false;
        }
        self.columns_place = self.streams.len();
        self.named.push((columns.clone(), self.columns_place));
        let mut again = None;
        for (name, kind, unit) in columns.streams() {
            let is_again = self.streams[self.columns_place..].iter().any(|stream| stream.name == name);
            let own = unique(name, &self.streams);
            if is_again {
                again = Some(format!("there are two columns '{name}': the second is the stream '{own}'"));
            }
            let stream = SourceStream::new(own, kind).unit(unit.to_owned());
            sink.appears(self.streams.len(), &stream);
            self.streams.push(stream);
        }
        if let Some(text) = again {
            tell(sink, self.clock.now(), event("description", text));
        }
        true
    }

    /// Counts what is missing between two numbers of a counter of `bits` bits.
    fn missing(&mut self, sequence: u64, bits: u32, arrived: Timestamp, sink: &mut dyn Sink) {
        let mask = if bits == 64 { u64::MAX } else { (1 << bits) - 1 };
        if let Some(next) = self.next_sequence {
            let gap = sequence.wrapping_sub(next) & mask;
            if gap >= MOST_GAP {
                tell(sink, arrived, Event::new("restarted", "sequence numbers begin anew"));
            } else if gap > 0 {
                self.totals.lost += gap;
                let (before, after) = (next as f64, gap as f64);
                tell(
                    sink,
                    arrived,
                    Event { before, after, ..Event::new("gap", "sequence numbers are missing") },
                );
            }
        }
        self.next_sequence = Some(sequence.wrapping_add(1) & mask);
    }

    /// Takes the frames that have arrived; whether anything was given.
    fn take_frames(&mut self, arrived: Timestamp, sink: &mut dyn Sink) -> bool {
        let mut gave = false;
        while let Some(frame) = self.frames.next() {
            self.foreign = 0;
            let (number, sequence, time_us) = (usize::from(frame.stream), frame.sequence, frame.time_us);
            let mut described = None;
            if frame.stream == DESCRIPTIONS {
                if let Some((&number, text)) = frame.payload.split_first()
                    && self.known[usize::from(number)].as_ref().is_none_or(|known| known.text != text)
                {
                    described = Some((number, text.to_vec()));
                }
            } else {
                let captured = self.map.map(u64::from(time_us), arrived);
                let length = frame.payload.len();
                let mut is_strange = false;
                match self.known[number]
                    .as_ref()
                    .map(|known| (known.place, known.description.read(frame.payload)))
                {
                    Some((place, Payload::Value(value))) => {
                        if let Some(backlog) = &mut self.backlog {
                            backlog.push(Some(Ticks::Micros32(time_us)));
                        }
                        sink.take(place, Sample { captured, arrived, value });
                    }
                    Some((_, Payload::Nothing)) => {}
                    Some((_, Payload::Misfit)) | None => is_strange = true,
                }
                if is_strange {
                    self.strange(number, length, arrived, sink);
                }
            }
            gave = true;
            self.missing(u64::from(sequence), 16, arrived, sink);
            if let Some((number, text)) = described {
                match String::from_utf8_lossy(&text).parse::<Description>() {
                    Ok(description) => self.describe(number, &text, description, sink),
                    Err(error) => {
                        let strange = &mut self.strange[usize::from(number)];
                        if strange.refused != text {
                            let text = format!("stream {number}: {error}");
                            tell(sink, arrived, event("description", text));
                        }
                        strange.refused = text;
                    }
                }
            }
        }
        gave
    }

    /// Counts a frame that is not read, and says so once: where nothing describes it, when it could have been described.
    fn strange(&mut self, number: usize, length: usize, arrived: Timestamp, sink: &mut dyn Sink) {
        self.totals.unread += 1;
        if self.known[number].is_none() && self.strange[number].since.is_none() {
            self.undescribed.get_or_insert((number, arrived.saturating_add(DESCRIBED_WITHIN)));
        }
        self.say_strange(number, length, arrived, sink);
    }

    fn say_strange(&mut self, number: usize, length: usize, arrived: Timestamp, sink: &mut dyn Sink) {
        let strange = &mut self.strange[number];
        let since = *strange.since.get_or_insert(arrived);
        if strange.is_told {
            return;
        }
        let text = match &self.known[number] {
            Some(known) => format!(
                "frames of stream {number} have {length} bytes, and are described as '{}' with {}",
                known.description.name(),
                known.description.bytes()
            ),
            None if self.is_full || arrived.since(since).is_none_or(|passed| passed < DESCRIBED_WITHIN) => {
                return;
            }
            None => format!(
                "frames of stream {number} come, and nothing says what it is; the configuration can: [serial.streams] {number} = \"NAME KIND FORMAT\""
            ),
        };
        strange.is_told = true;
        tell(sink, arrived, Event { before: number as f64, ..event("unread", text) });
    }

    /// Takes the lines in bytes that have arrived; whether anything was given.
    fn take_lines(&mut self, bytes: &[u8], arrived: Timestamp, sink: &mut dyn Sink) -> bool {
        let mut gave = false;
        let mut text = std::mem::take(&mut self.text);
        text.push(bytes, |line| gave |= self.take_line(line, arrived, sink));
        self.text = text;
        gave
    }

    fn take_line(&mut self, line: Option<&str>, arrived: Timestamp, sink: &mut dyn Sink) -> bool {
        let Some(text) = line else {
            self.totals.broken_lines += 1;
            return false;
        };
        let line = match self.table.hear(text) {
            Heard::Numbers(line) => line,
            Heard::Passed => return false,
            Heard::Refused => return self.refuse(text, arrived, sink),
            Heard::Anew(line) => {
                if !self.take_columns(sink) {
                    self.totals.broken_lines += 1;
                    return true;
                }
                line
            }
        };
        self.foreign = 0;
        self.odd.lines = 0;
        self.totals.lines += 1;
        let nanos = self.lines_clock.nanos(&line);
        let captured = nanos.map_or_else(
            || arrived.saturating_add(Span::from_nanos(-self.config.least_latency.as_nanos())),
            |nanos| self.lines_map.map(nanos, arrived),
        );
        if let Some(columns) = self.table.columns() {
            for (offset, (kind, values)) in columns.values(&line).enumerate() {
                if let Some(value) = reading(kind, values) {
                    if let Some(backlog) = &mut self.backlog {
                        backlog.push(nanos.map(Ticks::Nanos));
                    }
                    sink.take(self.columns_place + offset, Sample { captured, arrived, value });
                }
            }
        }
        if let Some(sequence) = line.sequence {
            let bits = self.next_sequence.map_or(64, |next| sequence_bits(next, sequence));
            self.missing(sequence, bits, arrived, sink);
        }
        true
    }

    /// Counts a line that is none, and says why, once of each kind. Whether anything was given.
    fn refuse(&mut self, text: &str, arrived: Timestamp, sink: &mut dyn Sink) -> bool {
        self.totals.broken_lines += 1;
        let is_first = self.odd.lines == 0;
        if is_first {
            self.odd.bytes = 0;
        }
        self.odd.lines = self.odd.lines.saturating_add(1);
        self.odd.bytes += text.len() as u64 + 1;
        if !is_first && self.refusals == u16::MAX {
            return false;
        }
        let refusal = self.table.refuse(text);
        let kind = 1 << refusal.kind;
        if is_first {
            self.odd.first.clone_from(&refusal.text);
        }
        if !refusal.is_sure || self.refusals & kind != 0 {
            return false;
        }
        self.refusals |= kind;
        tell(sink, arrived, event("line", refusal.text));
        true
    }

    /// Takes bytes that have arrived; whether anything was given. Frames are in the decoder already.
    fn take(&mut self, bytes: &[u8], count: usize, arrived: Timestamp, sink: &mut dyn Sink) -> bool {
        let before = self.foreign;
        self.foreign += count as u64;
        let mut gave = false;
        if self.format != Format::Lines {
            self.frames.push(bytes);
            if self.take_frames(arrived, sink) {
                gave = true;
                self.format = Format::Frames;
            }
        }
        if self.format != Format::Frames {
            let lines = self.totals.lines;
            gave |= self.take_lines(bytes, arrived, sink);
            if self.totals.lines > lines {
                self.format = Format::Lines;
            }
        }
        if before < FOREIGN_BYTES && self.foreign >= FOREIGN_BYTES {
            let are_lines = self.format != Format::Frames
                && self.odd.lines >= TEXT_LINES
                && self.odd.bytes * 2 >= self.foreign;
            let what = if are_lines {
                event("no_lines", format!("lines come, but none that is understood: {}", self.odd.first))
            } else {
                let text = "bytes come, but no frame and no line: wrong baud rate?";
                Event { after: f64::from(self.config.baud), ..Event::new("no_frames", text) }
            };
            tell(sink, arrived, what);
            gave = true;
        }
        if gave && self.backlog.is_none() {
            self.report.say(self.clock_state(), arrived, sink);
        }
        gave
    }

    fn connect(&mut self, now: Timestamp, buffer: &mut [u8], sink: &mut dyn Sink) -> bool {
        match (self.opener)() {
            Ok(port) => {
                self.port = Some(port);
                self.next_sequence = None;
                self.foreign = 0;
                // Nothing of before belongs to what comes now.
                self.format = self.config.format;
                self.frames.clear();
                self.text.clear();
                self.table.begin();
                self.odd.lines = 0;
                tell(sink, now, Event::new("connected", ""));
                self.take_backlog(buffer, sink);
                true
            }
            Err(error) => {
                log::debug!("serial: not yet: {error}");
                self.try_at = now.saturating_add(TRY_AGAIN);
                false
            }
        }
    }

    /// Takes what the port holds: it arrived earlier than it is read, as far apart as the device says.
    fn take_backlog(&mut self, buffer: &mut [u8], sink: &mut dyn Sink) {
        let mut held = Backlog::new(sink);
        self.backlog = Some(Vec::new());
        let start = self.clock.now();
        let (mut left, mut gave) = (MOST_BACKLOG, false);
        // What goes wrong here goes wrong again at the next reading.
        while left > 0
            && let Some(port) = &mut self.port
            && let Ok(count @ 1..) = port.read(&mut buffer[..left.min(CHUNK)], BACKLOG_PAUSE)
        {
            let arrived = self.clock.now();
            let count = count.min(CHUNK);
            left = left.saturating_sub(count);
            gave |= self.take(&buffer[..count], count, arrived, &mut held);
            if arrived.since(start).is_none_or(|passed| passed > BACKLOG_LONGEST) {
                break;
            }
        }
        held.finish(&self.backlog.take().unwrap_or_default(), self.lost_at);
        if gave {
            self.report.say(self.clock_state(), self.clock.now(), sink);
        }
    }
}

impl Source for SerialSource {
    fn streams(&self) -> &[SourceStream] {
        &self.streams
    }

    fn losses(&self) -> Vec<(&'static str, u64)> {
        let totals = self.totals();
        vec![
            ("missing", totals.lost),
            ("broken", totals.frames.broken + totals.broken_lines),
            ("unread", totals.unread),
        ]
    }

    fn advance(&mut self, until: Timestamp, sink: &mut dyn Sink) -> Progress {
        let mut buffer = std::mem::take(&mut self.buffer);
        let progress = loop {
            let now = self.clock.now();
            let left = until.since(now).map_or(i64::MAX, Span::as_nanos);
            if left <= 0 {
                break Progress::Idle;
            }
            // Also where no more of it comes.
            if let Some((number, due)) = self.undescribed.filter(|(_, due)| now >= *due) {
                self.undescribed = None;
                if self.known[number].is_none() && !self.strange[number].is_told {
                    self.say_strange(number, 0, due, sink);
                    break Progress::Gave;
                }
            }
            let Some(port) = &mut self.port else {
                if now < self.try_at {
                    self.clock.sleep_until(until.min(self.try_at));
                } else if self.connect(now, &mut buffer, sink) {
                    break Progress::Gave;
                }
                continue;
            };
            let longest = Duration::from_nanos(left.unsigned_abs()).min(LONGEST_WAIT);
            // Where only frames come, they are read to where they are looked for.
            let is_framed = self.format == Format::Frames;
            let room = if is_framed { self.frames.room() } else { &mut buffer[..] };
            let most = room.len().min(CHUNK);
            match port.read(&mut room[..most], longest) {
                Ok(0) => {}
                Ok(count) => {
                    let arrived = self.clock.now();
                    let count = count.min(most);
                    let bytes = if is_framed {
                        self.frames.arrived(count);
                        &[]
                    } else {
                        &buffer[..count]
                    };
                    if self.take(bytes, count, arrived, sink) {
                        break Progress::Gave;
                    }
                }
                Err(error) => {
                    log::debug!("serial: {error}");
                    self.port = None;
                    self.lost_at = now;
                    self.try_at = now.saturating_add(TRY_AGAIN);
                    tell(
                        sink,
                        self.clock.now(),
                        Event::new("disconnected", "the device does not answer any more"),
                    );
                    break Progress::Gave;
                }
            }
        };
        self.buffer = buffer;
        progress
    }
}
