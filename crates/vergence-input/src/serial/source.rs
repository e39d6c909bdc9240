//! A serial device as a source.

use std::sync::Arc;
use std::time::Duration;

use vergence_sense::{Event, Progress, Sample, Sink, Source, SourceStream};
use vergence_time::{Clock, ClockKnobs, ClockMap, ClockState, Counter, Span, Timestamp};

use super::describe::{Description, unique};
use super::frame::{DESCRIPTIONS, Decoder, Tally};
use super::lines::{Columns, Lines};
use super::port::{Port, found, open};
use crate::connection::{ClockReport, TRY_AGAIN, own_streams, tell};
use crate::error::Error;
use crate::found::Found;
use crate::values::reading;

/// So many bytes without a frame or a line are not the protocol's; at 9600 baud two seconds.
const FOREIGN_BYTES: u64 = 2048;
/// Bytes that are read at once.
const CHUNK: usize = 16 << 10;
/// A source that is asked to end does so after this.
const LONGEST_WAIT: Duration = Duration::from_millis(100);
/// A gap of more is a device that began anew.
const MOST_GAP: u64 = 1 << 15;

/// Streams that a device may have, also where it describes them anew: a broken one does so without end.
const MOST_STREAMS: usize = 1024;

/// What a device sends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Format {
    /// Whichever comes first.
    #[default]
    Either,
    /// Frames.
    Frames,
    /// Lines of numbers.
    Lines,
}

/// Knobs of a [`SerialSource`].
#[derive(Clone, Debug)]
pub struct SerialConfig {
    /// Bits per second on the wire; USB devices pass over it.
    pub baud: u32,
    /// What comes.
    pub format: Format,
    /// Of devices that do not describe their streams: the number of the stream and what it is.
    pub streams: Vec<(u8, Description)>,
    /// The line of names of devices that send none.
    pub columns: Option<Columns>,
    /// What the fastest reading takes from measurement to arrival, where it is declared. It is subtracted.
    pub least_latency: Span,
}

impl Default for SerialConfig {
    fn default() -> Self {
        Self {
            baud: 115_200,
            format: Format::Either,
            streams: Vec::new(),
            columns: None,
            least_latency: Span::ZERO,
        }
    }
}

/// Who is asked before anybody listens.
struct Nobody;

impl Sink for Nobody {
    fn take(&mut self, _: usize, _: vergence_sense::Sample<vergence_sense::Reading<'_>>) {}
}

/// What became of what a device sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Totals {
    /// Of frames.
    pub frames: Tally,
    /// Lines of numbers.
    pub lines: u64,
    /// Lines that were none.
    pub broken_lines: u64,
    /// What the sequence numbers say is missing.
    pub lost: u64,
    /// Frames of streams that nothing describes, of another length than described, or beyond the most streams that a
    /// device may have.
    pub unread: u64,
}

/// One described stream of the device.
struct Known {
    /// Place among the source's streams.
    place: usize,
    text: Vec<u8>,
    description: Description,
}

type Opener = Box<dyn FnMut() -> std::io::Result<Box<dyn Port>> + Send>;

/// A serial device as a source: its streams as it describes them, times of capture from its own clock, gaps in its numbers
/// as events. A device that is unplugged is waited for, under any name that it comes back with.
pub struct SerialSource {
    port: Option<Box<dyn Port>>,
    opener: Opener,
    try_at: Timestamp,
    clock: Arc<dyn Clock>,
    config: SerialConfig,
    streams: Vec<SourceStream>,
    frames: Decoder,
    known: Vec<Option<Known>>,
    text: Lines,
    columns: Option<Columns>,
    /// The text that `columns` was made of, and the place of the first of its streams.
    columns_text: String,
    columns_place: usize,
    /// What was described so far, and where its streams are: a device may go back to it.
    described: Vec<(u8, Description, usize)>,
    named: Vec<(Columns, usize)>,
    /// It was said that there are too many streams.
    is_full: bool,
    map: ClockMap,
    /// The same for lines, whose times are nanoseconds.
    lines_map: ClockMap,
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
        let mut first = Some(open(&device.path, baud).map_err(|error| Error::open(device, error))?);
        let opener = move || {
            if let Some(port) = first.take() {
                return Ok(Box::new(port) as Box<dyn Port>);
            }
            let again = found().into_iter().find(|found| found.is_same_device(&wanted));
            let path = again.map_or_else(|| wanted.path.clone(), |found| found.path);
            Ok(Box::new(open(&path, baud)?) as Box<dyn Port>)
        };
        Ok(Self::new(Box::new(opener), config, clock))
    }

    /// Reads what `opener` opens, and asks it again after a loss.
    pub fn new(opener: Opener, config: SerialConfig, clock: Arc<dyn Clock>) -> Self {
        let least_latency = config.least_latency;
        let map = |counter| ClockMap::new(ClockKnobs { least_latency, ..ClockKnobs::new(counter) });
        let mut source = Self {
            port: None,
            opener,
            try_at: clock.now(),
            clock,
            streams: own_streams(),
            frames: Decoder::new(),
            known: (0..256).map(|_| None).collect(),
            text: Lines::default(),
            columns: None,
            columns_text: String::new(),
            columns_place: 0,
            described: Vec::new(),
            named: Vec::new(),
            is_full: false,
            map: map(Counter::MICROS_32),
            lines_map: map(Counter::NANOS_64),
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
        if let Some(columns) = source.config.columns.clone() {
            source.take_columns(columns, &mut Nobody);
        }
        source
    }

    /// What became of what the device sent.
    pub fn totals(&self) -> Totals {
        Totals { frames: self.frames.tally(), ..self.totals }
    }

    /// How the device's clock stands to ours.
    pub fn clock_state(&self) -> ClockState {
        if self.config.format == Format::Lines { self.lines_map.state() } else { self.map.state() }
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

    fn take_columns(&mut self, columns: Columns, sink: &mut dyn Sink) {
        if self.columns.as_ref() == Some(&columns) {
            return;
        }
        if let Some((_, place)) = self.named.iter().find(|(known, _)| *known == columns) {
            self.columns_place = *place;
            self.columns = Some(columns);
            return;
        }
        if self.streams.len() + columns.streams().count() > MOST_STREAMS {
            self.columns = None;
            return self.too_many(sink);
        }
        self.columns_place = self.streams.len();
        self.named.push((columns.clone(), self.columns_place));
        for (name, kind, unit) in columns.streams() {
            let name = unique(name, &self.streams);
            let stream = SourceStream::new(name, kind).unit(unit.to_owned());
            sink.appears(self.streams.len(), &stream);
            self.streams.push(stream);
        }
        self.columns = Some(columns);
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
                match &self.known[number] {
                    Some(known) => match known.description.read(frame.payload) {
                        Some(value) => sink.take(known.place, Sample { captured, arrived, value }),
                        None => self.totals.unread += 1,
                    },
                    None => self.totals.unread += 1,
                }
            }
            gave = true;
            self.missing(u64::from(sequence), 16, arrived, sink);
            if let Some((number, text)) = described {
                match String::from_utf8_lossy(&text).parse::<Description>() {
                    Ok(description) => self.describe(number, &text, description, sink),
                    Err(error) => {
                        log::warn!("stream {number}: {error}");
                        tell(
                            sink,
                            arrived,
                            Event::new("description", "a stream's description is not understood"),
                        );
                    }
                }
            }
        }
        gave
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
        let Some(line) = self.columns.as_ref().and_then(|columns| columns.read(text)) else {
            if text != self.columns_text {
                match Columns::parse(text) {
                    Some(columns) => {
                        text.clone_into(&mut self.columns_text);
                        self.take_columns(columns, sink);
                    }
                    None => self.totals.broken_lines += 1,
                }
            }
            return false;
        };
        self.foreign = 0;
        self.totals.lines += 1;
        let captured = line.time_ns.map_or_else(
            || arrived.saturating_add(Span::from_nanos(-self.config.least_latency.as_nanos())),
            |nanos| self.lines_map.map(nanos, arrived),
        );
        if let Some(columns) = &self.columns {
            for (offset, (kind, values)) in columns.values(&line).enumerate() {
                if let Some(value) = reading(kind, values) {
                    sink.take(self.columns_place + offset, Sample { captured, arrived, value });
                }
            }
        }
        if let Some(sequence) = line.sequence {
            self.missing(sequence, 64, arrived, sink);
        }
        true
    }

    /// Takes bytes that have arrived; whether anything was given. Frames are in the decoder already.
    fn take(&mut self, bytes: &[u8], count: usize, arrived: Timestamp, sink: &mut dyn Sink) -> bool {
        let before = self.foreign;
        self.foreign += count as u64;
        let mut gave = false;
        if self.config.format != Format::Lines {
            self.frames.push(bytes);
            if self.take_frames(arrived, sink) {
                gave = true;
                self.config.format = Format::Frames;
            }
        }
        if self.config.format != Format::Frames && self.take_lines(bytes, arrived, sink) {
            gave = true;
            self.config.format = Format::Lines;
        }
        if before < FOREIGN_BYTES && self.foreign >= FOREIGN_BYTES {
            let text = "bytes come, but no frame and no line: wrong baud rate?";
            tell(
                sink,
                arrived,
                Event { after: f64::from(self.config.baud), ..Event::new("no_frames", text) },
            );
            gave = true;
        }
        if gave {
            self.report.say(self.clock_state(), arrived, sink);
        }
        gave
    }

    fn connect(&mut self, now: Timestamp, sink: &mut dyn Sink) -> bool {
        match (self.opener)() {
            Ok(port) => {
                self.port = Some(port);
                self.next_sequence = None;
                self.foreign = 0;
                tell(sink, now, Event::new("connected", ""));
                true
            }
            Err(error) => {
                log::debug!("serial: not yet: {error}");
                self.try_at = now.saturating_add(TRY_AGAIN);
                false
            }
        }
    }
}

impl Source for SerialSource {
    fn streams(&self) -> &[SourceStream] {
        &self.streams
    }

    fn advance(&mut self, until: Timestamp, sink: &mut dyn Sink) -> Progress {
        let mut buffer = std::mem::take(&mut self.buffer);
        let progress = loop {
            let now = self.clock.now();
            let left = until.since(now).map_or(i64::MAX, Span::as_nanos);
            if left <= 0 {
                break Progress::Idle;
            }
            let Some(port) = &mut self.port else {
                if now < self.try_at {
                    self.clock.sleep_until(until.min(self.try_at));
                } else if self.connect(now, sink) {
                    break Progress::Gave;
                }
                continue;
            };
            let longest = Duration::from_nanos(left.unsigned_abs()).min(LONGEST_WAIT);
            // Where only frames come, they are read to where they are looked for.
            let is_framed = self.config.format == Format::Frames;
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
