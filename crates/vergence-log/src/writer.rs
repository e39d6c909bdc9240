//! The thread that writes: takes messages out of the queues in the order of their arrival, puts them into chunks, and
//! ends a chunk in time.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
#[cfg(unix)]
use std::os::unix::fs::FileTypeExt as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use mcap::records::{AttachmentHeader, MessageHeader, Metadata};
use vergence_sense::Event;
use vergence_time::Timestamp;

use crate::error::Error;
use crate::file::{claim, close_at};
use crate::header::{Header, PROFILE, SESSION};
use crate::lane::{LaneEnd, Next, Prefix, Shared, next};
use crate::message::{Message, StreamDesc, Times};
use crate::recorder::{Compression, Options};
use crate::records::{HEAD, put_channel, put_schema};
use crate::sink::Sink;
use crate::wire::Encoder;

/// How often empty queues are looked at.
const POLL: Duration = Duration::from_millis(5);
/// Bytes that MCAP puts in front of a message.
const MESSAGE_HEAD: u64 = 31;
/// How long another thread takes to hand over a message, where it was interrupted meanwhile.
const HANDING_OVER: Duration = Duration::from_micros(50);
/// Messages between two looks at the clock.
const BATCH: usize = 256;
/// Chunks after which all streams are announced again: half a minute of them, where they end by time.
const ANNOUNCE_EVERY: u32 = 60;

/// What the recorder asks of its thread.
#[derive(Debug)]
pub(crate) enum Command {
    Stream(StreamRecord),
    Lane(LaneEnd),
    Metadata(String, BTreeMap<String, String>),
    Attach {
        name: String,
        media_type: String,
        file: PathBuf,
        /// Hears when it is done.
        done: Sender<()>,
    },
    /// To be answered once all that was written before is on the disk.
    Sync(Sender<()>),
}

/// A stream, ready to be written.
#[derive(Debug)]
pub(crate) struct StreamRecord {
    id: u16,
    name: String,
    schema: String,
    descriptor: Vec<u8>,
    metadata: BTreeMap<String, String>,
}

impl StreamRecord {
    /// What the recorder itself has to say.
    pub(crate) const OWN: &'static str = "/recorder/events";

    pub(crate) fn of<T: Message>(id: u16, desc: &StreamDesc) -> Self {
        let mut metadata: BTreeMap<String, String> = desc.notes.iter().cloned().collect();
        for (key, value) in [
            ("type", T::NAME.to_owned()),
            ("version", T::VERSION.to_string()),
            ("unit", desc.unit.clone().unwrap_or_else(|| T::UNIT.to_owned())),
            ("frame", desc.frame.clone()),
            ("clock", desc.clock.name().to_owned()),
        ] {
            metadata.insert(key.to_owned(), value);
        }
        Self {
            id,
            name: desc.name.clone(),
            schema: T::SCHEMA.name.to_owned(),
            descriptor: T::SCHEMA.descriptor_set(),
            metadata,
        }
    }
}

/// What became of a look at the queues.
enum Drained {
    /// Nothing is left.
    Empty,
    /// There may be more.
    Part,
    /// There is more, and a message that may come before it is being handed over.
    Waits,
}

/// What is known of a stream while it is written.
#[derive(Debug, Default)]
struct Known {
    name: String,
    next: u32,
}

/// What announces a stream, as records.
#[derive(Debug)]
struct Announcement {
    schema_id: u16,
    schema: Vec<u8>,
    channel: Vec<u8>,
}

#[derive(Debug)]
enum Failed {
    Mcap(mcap::McapError),
    Io(std::io::Error),
}

impl From<mcap::McapError> for Failed {
    fn from(error: mcap::McapError) -> Self {
        Self::Mcap(error)
    }
}

impl From<std::io::Error> for Failed {
    fn from(error: std::io::Error) -> Self {
        Self::Io(error)
    }
}

impl Failed {
    fn into_io(self) -> std::io::Error {
        match self {
            Self::Io(error) | Self::Mcap(mcap::McapError::Io(error)) => error,
            Self::Mcap(error) => std::io::Error::other(error),
        }
    }
}

pub(crate) struct Writer {
    path: PathBuf,
    options: Options,
    mcap: mcap::Writer<Sink>,
    /// Checksum of all bytes so far.
    checksum: Arc<Mutex<crc32fast::Hasher>>,
    /// A second handle of the same file, to sync it and to cut it off.
    file: File,
    quiet: Arc<AtomicBool>,
    shared: Arc<Shared>,
    failure: Arc<Mutex<Option<Error>>>,
    inbox: Receiver<Command>,
    lanes: Vec<LaneEnd>,
    /// Who waits for the disk.
    waiters: Vec<Sender<()>>,
    streams: Vec<Option<Known>>,
    /// In the order in which they were added, and how many of them were announced outside of their chunk.
    announcements: Vec<Announcement>,
    announced: usize,
    /// Chunks since all were.
    chunks: u32,
    /// Where messages lie on their way from a queue to the file.
    room: Vec<u8>,
    /// Since when something waits to be flushed, and how much.
    waiting_since: Option<Instant>,
    waiting_bytes: u64,
    /// Since when a message is being handed over that may come before the others.
    waits_since: Option<Instant>,
    /// Up to here the file is complete.
    good: u64,
    last_arrived: Timestamp,
    own_sequence: u32,
    /// Dropped messages that the log has told of.
    told: u64,
}

/// MCAP counts time in unsigned nanoseconds; earlier instants are written as 0 there and exactly in the payload. Order
/// in the file is that of arrival, so that ties keep it.
pub(crate) fn log_time(instant: Timestamp) -> u64 {
    u64::try_from(instant.as_nanos()).unwrap_or(0)
}

impl Writer {
    pub(crate) fn create(
        path: &Path,
        header: &Header,
        options: &Options,
        shared: Arc<Shared>,
        failure: Arc<Mutex<Option<Error>>>,
        inbox: Receiver<Command>,
    ) -> Result<Self, Error> {
        let refused = |error: std::io::Error| Error::create(path, error);
        // To open a pipe waits for somebody to read it.
        #[cfg(unix)]
        if std::fs::metadata(path).is_ok_and(|found| found.file_type().is_fifo()) {
            let found = "expected a file to write to, found a pipe, which cannot be read from its end";
            return Err(refused(std::io::Error::new(std::io::ErrorKind::InvalidInput, found)));
        }
        let file = claim(path, options.durable).map_err(refused)?;
        let sink = Sink::new(file.try_clone().map_err(refused)?);
        let (quiet, checksum) = (sink.quiet(), sink.checksum());
        // Not over what goes past that writer: ours is put in at the end.
        let mcap = write_options(options.compression, None).calculate_data_section_crc(false).create(sink);
        let mut writer = Self {
            path: path.to_owned(),
            options: *options,
            mcap: mcap.map_err(|error| refused(Failed::from(error).into_io()))?,
            checksum,
            file,
            quiet,
            shared,
            failure,
            inbox,
            lanes: Vec::new(),
            waiters: Vec::new(),
            streams: Vec::new(),
            announcements: Vec::new(),
            announced: 0,
            chunks: 0,
            room: Vec::with_capacity(64 << 10),
            waiting_since: None,
            waiting_bytes: 0,
            waits_since: None,
            good: 0,
            last_arrived: Timestamp::default(),
            own_sequence: 0,
            told: 0,
        };
        if let Err(failed) = writer.begin(header) {
            writer.quiet.store(true, Ordering::Release);
            return Err(refused(failed.into_io()));
        }
        Ok(writer)
    }

    fn begin(&mut self, header: &Header) -> Result<(), Failed> {
        self.mcap.write_metadata(&Metadata { name: SESSION.to_owned(), metadata: header.to_map() })?;
        self.add_stream(StreamRecord::of::<Event>(0, &StreamDesc::new(StreamRecord::OWN)))?;
        self.flush()
    }

    pub(crate) fn add(&mut self, lane: LaneEnd) {
        self.lanes.push(lane);
    }

    /// Until it is told to stop and has written everything, or the file fails.
    pub(crate) fn run(mut self) {
        let result = self.write_all();
        if let Err(failed) = result {
            self.fail(failed);
        }
        // Whoever writes on is not held up: its queue runs full and counts.
    }

    fn write_all(&mut self) -> Result<(), Failed> {
        loop {
            // Looked at before the queues: what was written before the stop is in them.
            let stopping = self.shared.stop.load(Ordering::Acquire);
            self.shared.look();
            self.obey()?;
            let drained = self.drain()?;
            let age = self.waiting_since.map_or(Duration::ZERO, |since| since.elapsed());
            if age >= self.options.chunk_every {
                self.flush()?;
            }
            match drained {
                Drained::Empty => {}
                Drained::Part => continue,
                Drained::Waits => {
                    std::thread::sleep(HANDING_OVER);
                    continue;
                }
            }
            if !self.waiters.is_empty() {
                // What they had written when they asked was in the queues, which are empty now.
                self.flush()?;
                self.file.sync_data()?;
                self.waiters.drain(..).for_each(|waiter| waiter.send(()).unwrap_or_default());
            }
            if stopping {
                break;
            }
            self.lanes.retain(|lane| !lane.is_over());
            std::thread::park_timeout(POLL);
        }
        let dropped = self.shared.dropped.load(Ordering::Acquire);
        if dropped > self.told {
            self.say("dropped", "", f64::NAN, (dropped - self.told) as f64)?;
        }
        // The last chunk is good before the summary is begun: a disk that is full then loses the summary only.
        self.flush()?;
        let checksum = self.checksum.lock().unwrap_or_else(PoisonError::into_inner).clone().finalize();
        self.mcap.finish()?;
        // Into the record that ends the data, which stands where the last chunk ended: opcode, length, checksum.
        self.file.seek(SeekFrom::Start(self.good + HEAD as u64))?;
        self.file.write_all(&checksum.to_le_bytes())?;
        if self.options.durable {
            self.file.sync_all()?;
        }
        Ok(())
    }

    /// Does what the recorder asked for.
    fn obey(&mut self) -> Result<(), Failed> {
        while let Ok(command) = self.inbox.try_recv() {
            match command {
                Command::Stream(record) => self.add_stream(record)?,
                Command::Lane(lane) => self.lanes.push(lane),
                Command::Metadata(name, metadata) => {
                    self.mcap.write_metadata(&Metadata { name, metadata })?;
                    self.waiting_since.get_or_insert_with(Instant::now);
                }
                Command::Attach { name, media_type, file, done } => {
                    self.attach(name, media_type, &file)?;
                    // Whoever does not wait need not hear of it.
                    let _ = done.send(());
                }
                Command::Sync(waiter) => self.waiters.push(waiter),
            }
        }
        Ok(())
    }

    fn add_stream(&mut self, record: StreamRecord) -> Result<(), Failed> {
        let schema = self.mcap.add_schema(&record.schema, "protobuf", &record.descriptor)?;
        self.mcap.add_channel_with_id(record.id, schema, &record.name, "protobuf", &record.metadata)?;
        let mut announcement = Announcement { schema_id: schema, schema: Vec::new(), channel: Vec::new() };
        put_schema(schema, &record.schema, "protobuf", &record.descriptor, &mut announcement.schema);
        let ids = (record.id, schema);
        put_channel(ids, &record.name, "protobuf", &record.metadata, &mut announcement.channel);
        self.announcements.push(announcement);
        let index = usize::from(record.id);
        if self.streams.len() <= index {
            self.streams.resize_with(index + 1, || None);
        }
        self.streams[index] = Some(Known { name: record.name, next: 0 });
        self.waiting_since.get_or_insert_with(Instant::now);
        Ok(())
    }

    /// A file that cannot be read is said in the log and is no failure of the recording.
    fn attach(&mut self, name: String, media_type: String, path: &Path) -> Result<(), Failed> {
        let opened = File::open(path).and_then(|file| Ok((file.metadata()?.len(), file)));
        let (length, mut file) = match opened {
            Ok(opened) => opened,
            Err(error) => {
                log::warn!("{}: cannot be attached: {error}", path.display());
                return self.say("not_attached", &name, f64::NAN, f64::NAN);
            }
        };
        self.flush()?;
        let (log_time, name_again) = (log_time(self.last_arrived), name.clone());
        let header = AttachmentHeader { log_time, create_time: 0, name, media_type };
        self.mcap.start_attachment(length, header)?;
        let (mut left, mut piece, mut zeros) = (length, vec![0; 256 << 10], 0);
        while left > 0 {
            let most = usize::try_from(left).unwrap_or(usize::MAX).min(piece.len());
            let read = match file.read(&mut piece[..most]) {
                Ok(read) if read > 0 => read,
                // Shorter than it was, or unreadable: the promised length must be kept.
                _ => {
                    if zeros == 0 {
                        zeros = left;
                        let path = path.display();
                        log::warn!("{path}: {left} bytes could not be attached; zeros stand for them");
                    }
                    piece.fill(0);
                    most
                }
            };
            self.mcap.put_attachment_bytes(&piece[..read])?;
            left -= read as u64;
        }
        self.mcap.finish_attachment()?;
        if zeros > 0 {
            self.say("attached_short", &name_again, length as f64, (length - zeros) as f64)?;
        }
        self.flush()
    }

    /// Writes what is in the queues, at most a batch.
    fn drain(&mut self) -> Result<Drained, Failed> {
        for _ in 0..BATCH {
            let (index, prefix) = match next(&mut self.lanes, true) {
                Next::None => return Ok(Drained::Empty),
                Next::Soon => {
                    let since = *self.waits_since.get_or_insert_with(Instant::now);
                    // As long as a chunk may take: a thread that is held up for longer does not hold up the others.
                    match next(&mut self.lanes, false) {
                        Next::Of(index, prefix) if since.elapsed() >= self.options.chunk_every => {
                            (index, prefix)
                        }
                        _ => return Ok(Drained::Waits),
                    }
                }
                Next::Of(index, prefix) => {
                    self.waits_since = None;
                    (index, prefix)
                }
            };
            let lanes = self.lanes.len();
            self.obey()?;
            if self.lanes.len() > lanes {
                // A new one, which may have something that comes before.
                continue;
            }
            let mut room = std::mem::take(&mut self.room);
            let payload = self.lanes[index].take(&mut room);
            let written = self.message(prefix, payload);
            self.room = room;
            written?;
        }
        Ok(Drained::Part)
    }

    fn message(&mut self, prefix: Prefix, payload: &[u8]) -> Result<(), Failed> {
        let index = usize::from(prefix.stream);
        if !self.streams.get(index).is_some_and(Option::is_some) {
            // It was asked for after this thread last looked, and before the message.
            self.obey()?;
        }
        self.last_arrived = prefix.times.arrived;
        let mut missing = None;
        if let Some(Some(known)) = self.streams.get_mut(index) {
            let gap = prefix.sequence.wrapping_sub(known.next);
            if gap > 0 {
                missing = Some((known.name.clone(), known.next, gap));
            }
            known.next = prefix.sequence.wrapping_add(1);
        }
        if let Some((name, from, count)) = missing {
            self.told += u64::from(count);
            self.say("dropped", &name, f64::from(from), f64::from(count))?;
        }
        let header = MessageHeader {
            channel_id: prefix.stream,
            sequence: prefix.sequence,
            log_time: log_time(prefix.times.arrived),
            publish_time: log_time(prefix.times.captured),
        };
        self.mcap.write_to_known_channel(&header, payload)?;
        self.waiting_since.get_or_insert_with(Instant::now);
        self.waiting_bytes += payload.len() as u64 + MESSAGE_HEAD;
        // Ended here and not by the MCAP writer, so that it is known up to where the file is good.
        if self.waiting_bytes >= self.options.chunk_bytes { self.flush() } else { Ok(()) }
    }

    /// An event of the recorder's own.
    fn say(&mut self, name: &'static str, text: &str, before: f64, after: f64) -> Result<(), Failed> {
        let times = Times::at(self.last_arrived);
        let event = Event { name: name.into(), text: text.to_owned().into(), at: None, before, after };
        let mut payload = Vec::new();
        event.encode(times, "", &mut Encoder::new(&mut payload));
        let header = MessageHeader {
            channel_id: 0,
            sequence: self.own_sequence,
            log_time: log_time(times.arrived),
            publish_time: log_time(times.captured),
        };
        self.own_sequence = self.own_sequence.wrapping_add(1);
        self.mcap.write_to_known_channel(&header, &payload)?;
        self.waiting_since.get_or_insert_with(Instant::now);
        Ok(())
    }

    /// Ends the chunk and hands it to the system; with `durable`, to the disk.
    fn flush(&mut self) -> Result<(), Failed> {
        self.mcap.flush()?;
        self.announce_again()?;
        if self.options.durable {
            self.file.sync_data()?;
        }
        self.good = self.file.stream_position()?;
        self.waiting_since = None;
        self.waiting_bytes = 0;
        Ok(())
    }

    /// What a chunk announced is announced behind it, too, and now and then all is: nothing that is damaged is the only one to say
    /// what the messages of a stream are. Past the MCAP writer, which announces once and asks the file where it is.
    fn announce_again(&mut self) -> Result<(), Failed> {
        if self.announcements.len() == 1 {
            // Its own, of a file that just begins: with the first others.
            return Ok(());
        }
        self.chunks += 1;
        let first = if self.chunks >= ANNOUNCE_EVERY { 0 } else { self.announced };
        let mut schemas = BTreeSet::new();
        let mut records = Vec::new();
        for announcement in &self.announcements[first..] {
            if schemas.insert(announcement.schema_id) {
                records.extend_from_slice(&announcement.schema);
            }
            records.extend_from_slice(&announcement.channel);
        }
        self.file.write_all(&records)?;
        self.checksum.lock().unwrap_or_else(PoisonError::into_inner).update(&records);
        self.announced = self.announcements.len();
        if first == 0 {
            self.chunks = 0;
        }
        Ok(())
    }

    /// The file ends where it was last complete, with an ending if there is room for one.
    fn fail(&mut self, failed: Failed) {
        self.shared.failed.store(true, Ordering::Release);
        self.quiet.store(true, Ordering::Release);
        let source = Arc::new(failed.into_io());
        if let Err(error) = close_at(&mut self.file, self.good, &source.to_string()) {
            log::warn!("{}: the file has no ending, which a repair gives it: {error}", self.path.display());
        }
        let error = Error::Write { path: self.path.clone(), good_bytes: self.good, source };
        *self.failure.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
    }
}

/// Zstd's level 1: of a load of noisy pictures and inertial units it makes files 11 % larger than its default level 3, in six tenths
/// of a recording's whole processor time (`cargo bench -p vergence-log --bench load`). 0 is the compressor's default.
fn compression_level(compression: Option<mcap::Compression>) -> u32 {
    match compression {
        Some(mcap::Compression::Zstd) => 1,
        _ => 0,
    }
}

/// The writer of files of this format; without `chunk_bytes`, chunks end when they are told to.
pub(crate) fn write_options(compression: Compression, chunk_bytes: Option<u64>) -> mcap::WriteOptions {
    let compression = match compression {
        Compression::None => None,
        Compression::Lz4 => Some(mcap::Compression::Lz4),
        Compression::Zstd => Some(mcap::Compression::Zstd),
    };
    mcap::WriteOptions::new()
        .profile(PROFILE)
        .library(concat!("vergence-log ", env!("CARGO_PKG_VERSION")))
        .compression(compression)
        .compression_level(compression_level(compression))
        .compression_threads(0)
        .chunk_size(chunk_bytes)
        // Chunks are put together in memory and written whole: a kill never leaves a header that was not patched.
        .disable_seeking(true)
}
