//! Sources and logs: a source's way into a recording, and a recording as a source.

use std::sync::{Arc, Mutex, PoisonError};

use vergence_sense::{
    Axis, Button, Event, Gaze, Image, Imu, Pose, Progress, Reading, ReadingKind, Sample, Scalar, Sink,
    Source, SourceStream, Touch, Vector2,
};
use vergence_time::Timestamp;

use crate::error::Error;
use crate::lane::Lane;
use crate::message::{Message, Stream, StreamDesc, Times};
use crate::messages::Compressed;
use crate::reader::{Entry, Reader, StreamInfo};
use crate::recorder::Recorder;
use crate::writer::StreamRecord;

/// A recorded stream of any kind.
enum Any {
    Button(Stream<Button>),
    Axis(Stream<Axis>),
    Vector2(Stream<Vector2>),
    Touch(Stream<Touch>),
    Scalar(Stream<Scalar>),
    Imu(Stream<Imu>),
    Pose(Stream<Pose>),
    Gaze(Stream<Option<Gaze>>),
    Image(Stream<Image<'static>>),
    Event(Stream<Event>),
}

/// Streams of one source that are recorded: a device that announces streams without end leaves room for the others.
const MOST_STREAMS: usize = 1024;

/// One source's way into a recording: a sink with a queue of its own, so that each source may have a thread. Taking a
/// sample neither locks nor allocates; a stream that appears does both, once. Samples of a stream that the recording
/// refuses, as it does beyond the 1024th of a source, count as dropped.
pub struct SourceLane {
    recorder: Arc<Mutex<Recorder>>,
    lane: Lane,
    prefix: String,
    streams: Vec<Option<Any>>,
    taken: u64,
}

impl SourceLane {
    /// For a source with these streams, which are recorded as `/NAME/…`; `name` has no slash in front.
    ///
    /// # Errors
    /// Where the recording refuses a stream: it has one of that name.
    pub fn new(recorder: &Arc<Mutex<Recorder>>, name: &str, streams: &[SourceStream]) -> Result<Self, Error> {
        let lane = recorder.lock().unwrap_or_else(PoisonError::into_inner).lane();
        let (recorder, streams_of) = (recorder.clone(), streams);
        let prefix = format!("/{name}");
        let mut lane = Self { recorder, lane, prefix, streams: Vec::with_capacity(64), taken: 0 };
        for stream in streams_of {
            let added = lane.add(stream)?;
            lane.streams.push(Some(added));
        }
        Ok(lane)
    }

    fn add(&self, stream: &SourceStream) -> Result<Any, Error> {
        let mut desc = StreamDesc::new(format!("{}/{}", self.prefix, stream.name)).frame(&*stream.frame);
        if !stream.unit.is_empty() {
            desc = desc.unit(&*stream.unit);
        }
        if let Some(rate_hz) = stream.rate_hz {
            desc = desc.note("declared_rate_hz", rate_hz.to_string());
        }
        let mut recorder = self.recorder.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(match stream.kind {
            ReadingKind::Button => Any::Button(recorder.stream(&desc)?),
            ReadingKind::Axis => Any::Axis(recorder.stream(&desc)?),
            ReadingKind::Vector2 => Any::Vector2(recorder.stream(&desc)?),
            ReadingKind::Touch => Any::Touch(recorder.stream(&desc)?),
            ReadingKind::Scalar => Any::Scalar(recorder.stream(&desc)?),
            ReadingKind::Imu => Any::Imu(recorder.stream(&desc)?),
            ReadingKind::Pose => Any::Pose(recorder.stream(&desc)?),
            ReadingKind::Gaze => Any::Gaze(recorder.stream(&desc)?),
            ReadingKind::Image => Any::Image(recorder.stream(&desc)?),
            ReadingKind::Event => Any::Event(recorder.stream(&desc)?),
        })
    }

    /// Samples that were taken; which of them found the queue full, and which were not taken, the recorder counts.
    pub fn taken(&self) -> u64 {
        self.taken
    }
}

impl Sink for SourceLane {
    fn appears(&mut self, place: usize, stream: &SourceStream) {
        if place >= MOST_STREAMS {
            if place == MOST_STREAMS {
                log::warn!("not recorded: {}: its streams beyond {MOST_STREAMS}", self.prefix);
            }
            return;
        }
        if self.streams.len() <= place {
            self.streams.resize_with(place + 1, || None);
        }
        match self.add(stream) {
            Ok(stream) => self.streams[place] = Some(stream),
            Err(error) => log::warn!("not recorded: {error}"),
        }
    }

    fn take(&mut self, stream: usize, sample: Sample<Reading<'_>>) {
        let Some(Some(stream)) = self.streams.get(stream) else { return self.lane.refuse() };
        let (lane, times) = (&mut self.lane, Times::new(sample.captured, sample.arrived));
        match (stream, &sample.value) {
            (Any::Button(stream), Reading::Button(value)) => lane.write(stream, times, value),
            (Any::Axis(stream), Reading::Axis(value)) => lane.write(stream, times, value),
            (Any::Vector2(stream), Reading::Vector2(value)) => lane.write(stream, times, value),
            (Any::Touch(stream), Reading::Touch(value)) => lane.write(stream, times, value),
            (Any::Scalar(stream), Reading::Scalar(value)) => lane.write(stream, times, value),
            (Any::Imu(stream), Reading::Imu(value)) => lane.write(stream, times, value),
            (Any::Pose(stream), Reading::Pose(value)) => lane.write(stream, times, value),
            (Any::Gaze(stream), Reading::Gaze(value)) => lane.write(stream, times, value),
            (Any::Image(stream), Reading::Image(value)) => lane.write(stream, times, value),
            (Any::Event(stream), Reading::Event(value)) => lane.write(stream, times, value),
            // Another kind than the stream's: the source's mistake, which a recording must survive.
            _ => return self.lane.refuse(),
        }
        self.taken += 1;
    }
}

/// A recording as a source: every stream of a kind that sources have, in the order of arrival.
pub struct LogSource {
    reader: Reader,
    streams: Vec<SourceStream>,
    /// Of the stream with each number of the file: what it carries. Unknown until it is met.
    known: Vec<Option<Known>>,
    /// Read ahead of time.
    next: Option<(usize, Sample<Reading<'static>>)>,
    failure: Option<Error>,
    ended: bool,
}

/// What is known of a stream of the file.
#[derive(Clone, Copy)]
enum Known {
    /// Its place and kind; a message was decoded as that.
    Sample(usize, ReadingKind),
    /// Nothing that sources have.
    Other,
}

/// Which kind a recorded type is.
fn kind_of(stream: &StreamInfo) -> Option<ReadingKind> {
    Some(match stream.type_name() {
        Button::NAME => ReadingKind::Button,
        Axis::NAME => ReadingKind::Axis,
        Vector2::NAME => ReadingKind::Vector2,
        Touch::NAME => ReadingKind::Touch,
        Scalar::NAME => ReadingKind::Scalar,
        Imu::NAME => ReadingKind::Imu,
        Pose::NAME => ReadingKind::Pose,
        <Option<Gaze> as Message>::NAME => ReadingKind::Gaze,
        <Image<'_> as Message>::NAME | <Compressed<'_> as Message>::NAME => ReadingKind::Image,
        Event::NAME => ReadingKind::Event,
        _ => return None,
    })
}

/// The first message of a stream is looked at more closely.
fn decode(kind: ReadingKind, entry: &Entry<'_>, is_first: bool) -> Result<Sample<Reading<'static>>, Error> {
    fn as_reading<T: Message>(
        entry: &Entry<'_>,
        is_first: bool,
        wrap: impl FnOnce(T) -> Reading<'static>,
    ) -> Result<Sample<Reading<'static>>, Error> {
        let sample = if is_first { entry.decode::<T>() } else { entry.decode_again::<T>() };
        let Sample { captured, arrived, value } = sample?;
        Ok(Sample { captured, arrived, value: wrap(value) })
    }
    match kind {
        ReadingKind::Button => as_reading(entry, is_first, Reading::Button),
        ReadingKind::Axis => as_reading(entry, is_first, Reading::Axis),
        ReadingKind::Vector2 => as_reading(entry, is_first, Reading::Vector2),
        ReadingKind::Touch => as_reading(entry, is_first, Reading::Touch),
        ReadingKind::Scalar => as_reading(entry, is_first, Reading::Scalar),
        ReadingKind::Imu => as_reading(entry, is_first, Reading::Imu),
        ReadingKind::Pose => as_reading(entry, is_first, Reading::Pose),
        ReadingKind::Gaze => as_reading(entry, is_first, Reading::Gaze),
        ReadingKind::Image if entry.stream.type_name() == <Compressed<'_> as Message>::NAME => {
            as_reading::<Compressed<'static>>(entry, is_first, |compressed| Reading::Image(compressed.0))
        }
        ReadingKind::Image => as_reading::<Image<'static>>(entry, is_first, Reading::Image),
        ReadingKind::Event => as_reading(entry, is_first, Reading::Event),
    }
}

impl LogSource {
    /// Of this log; streams become known as they are met.
    pub fn new(reader: Reader) -> Self {
        Self { reader, streams: Vec::new(), known: Vec::new(), next: None, failure: None, ended: false }
    }

    /// Why the log could not be read to its end, once.
    pub fn failure(&mut self) -> Option<Error> {
        self.failure.take()
    }

    /// Whether this is a stream of a kind that sources have.
    pub fn reads(stream: &StreamInfo) -> bool {
        kind_of(stream).is_some()
    }

    /// How many streams of a kind that sources have were recorded, as far as the log was read: with those that never said anything,
    /// which are not among [`Source::streams`], and without what the recorder says itself.
    pub fn announced(&self) -> usize {
        let of_a_source =
            |stream: &&Arc<StreamInfo>| stream.name != StreamRecord::OWN && kind_of(stream).is_some();
        self.reader.streams().filter(of_a_source).count()
    }

    /// The log's reader.
    pub fn reader(&self) -> &Reader {
        &self.reader
    }

    /// When the next sample arrived that was read already but not given.
    pub fn next_arrival(&self) -> Option<Timestamp> {
        self.next.as_ref().map(|(_, sample)| sample.arrived)
    }

    fn read(&mut self, sink: &mut dyn Sink) -> Option<(usize, Sample<Reading<'static>>)> {
        loop {
            let read = self.reader.next();
            let entry = match read {
                Ok(Some(entry)) => entry,
                Ok(None) => break,
                Err(error) => {
                    self.failure = Some(error);
                    break;
                }
            };
            let id = usize::from(entry.stream.id);
            if self.known.len() <= id {
                self.known.resize(id + 1, None);
            }
            let (place, kind, is_first) = match self.known[id] {
                Some(Known::Sample(place, kind)) => (place, kind, false),
                Some(Known::Other) => continue,
                None => {
                    let Some(kind) = kind_of(entry.stream) else {
                        self.known[id] = Some(Known::Other);
                        continue;
                    };
                    let stream = SourceStream::new(entry.stream.name.trim_start_matches('/'), kind)
                        .unit(entry.stream.unit().to_owned())
                        .frame(entry.stream.frame().to_owned());
                    let place = self.streams.len();
                    sink.appears(place, &stream);
                    self.streams.push(stream);
                    self.known[id] = Some(Known::Sample(place, kind));
                    (place, kind, true)
                }
            };
            match decode(kind, &entry, is_first) {
                Ok(sample) => return Some((place, sample)),
                Err(error) => {
                    self.failure = Some(error);
                    break;
                }
            }
        }
        self.ended = true;
        None
    }
}

impl Source for LogSource {
    fn streams(&self) -> &[SourceStream] {
        &self.streams
    }

    fn advance(&mut self, until: Timestamp, sink: &mut dyn Sink) -> Progress {
        let mut gave = false;
        loop {
            let next = match self.next.take() {
                Some(next) => Some(next),
                None if self.ended => None,
                None => self.read(sink),
            };
            match next {
                None if gave => return Progress::Gave,
                None => return Progress::Ended,
                Some((place, sample)) if sample.arrived >= until && until != LAST => {
                    self.next = Some((place, sample));
                    return if gave { Progress::Gave } else { Progress::Idle };
                }
                Some((place, sample)) => {
                    sink.take(place, sample);
                    gave = true;
                }
            }
        }
    }
}

/// The end of time: everything arrives before it, also what arrives at it.
const LAST: Timestamp = Timestamp::from_nanos(i64::MAX);
