//! Reading a log from its beginning to its end.

mod behind;
mod index;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, ErrorKind, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use vergence_sense::Sample;

use crate::chunk::Decompressor;
use crate::error::Error;
use crate::header::Header;
use crate::message::{ClockKind, Message};
use crate::records::{HEAD, Inner, MAGIC, Malformed, MessageRecord, Record, op};
use behind::{Behind, Effort};

/// How much memory reading may take.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// The largest record, and the largest chunk before compression, that is read; bytes. A reader holds one of each.
    pub record_bytes: u64,
    /// Schemas, streams, notes and names of attachments together, bytes.
    pub index_bytes: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self { record_bytes: 256 << 20, index_bytes: 64 << 20 }
    }
}

/// What a stream is, as its file says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StreamInfo {
    /// MCAP's number of the channel.
    pub id: u16,
    /// `/head`.
    pub name: String,
    /// Name of the schema.
    pub schema: String,
    /// How messages are encoded.
    pub encoding: String,
    /// Everything else that the file says: `type`, `version`, `unit`, `frame`, `clock`, notes.
    pub metadata: BTreeMap<String, String>,
}

impl StreamInfo {
    fn get(&self, key: &str) -> &str {
        self.metadata.get(key).map_or("", String::as_str)
    }

    /// Name of the type; the schema's where a stranger wrote the stream.
    pub fn type_name(&self) -> &str {
        self.metadata.get("type").unwrap_or(&self.schema)
    }

    /// Of the values; empty where there is none.
    pub fn unit(&self) -> &str {
        self.get("unit")
    }

    /// Reference frame of the values; empty where there is none.
    pub fn frame(&self) -> &str {
        self.get("frame")
    }

    /// Which clock the values come from.
    pub fn clock(&self) -> ClockKind {
        if self.get("clock") == ClockKind::Host.name() { ClockKind::Host } else { ClockKind::Session }
    }
}

/// Where in a file something is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Place {
    /// Offset in the file of the record, or of the chunk that it is in.
    pub offset: u64,
    /// Offset in the decompressed chunk; 0 outside of chunks.
    pub in_chunk: u64,
}

/// How a file ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// As it should.
    Complete,
    /// The recording was cut off: nothing whole is behind this offset.
    CutOff {
        /// Offset in the file.
        at: u64,
    },
    /// The recording failed (a full disk) and ended here, early: what came afterwards is not in the file. The note
    /// `vergence.failed` says why, where there was room for it ([`Reader::metadata`]).
    Failed {
        /// Offset in the file of its last record.
        at: u64,
    },
}

/// A message, still encoded.
#[derive(Clone, Copy, Debug)]
pub struct Entry<'a> {
    /// Of which stream.
    pub stream: &'a Arc<StreamInfo>,
    /// Its number in its stream; gaps are messages that were dropped.
    pub sequence: u32,
    /// MCAP's log time: arrival, 0 for instants before the epoch. The exact instant is in the payload.
    pub log_time: u64,
    /// MCAP's publish time: capture, 0 for instants before the epoch.
    pub publish_time: u64,
    /// Where in the file.
    pub place: Place,
    /// As encoded.
    pub payload: &'a [u8],
    path: &'a Path,
}

impl Entry<'_> {
    /// Whether the stream carries messages of type `T`.
    pub fn is<T: Message>(&self) -> bool {
        self.stream.type_name() == T::NAME
    }

    /// The message, bit for bit as it was written.
    ///
    /// # Errors
    /// Where the stream carries another type, or the bytes are no such message.
    pub fn decode<T: Message>(&self) -> Result<Sample<T>, Error> {
        let version = self.stream.get("version");
        let newer = version.parse::<u32>().is_ok_and(|version| version > T::VERSION);
        if !self.is::<T>() || newer {
            return Err(Error::Type {
                path: self.path.to_owned(),
                stream: self.stream.name.clone(),
                expected: format!("{} version {}", T::NAME, T::VERSION),
                found: format!("{} version {version}", self.stream.type_name()),
            });
        }
        self.decode_again()
    }

    /// As [`Entry::decode`], where another message of the stream was decoded as this type: what a stream carries does not change.
    pub(crate) fn decode_again<T: Message>(&self) -> Result<Sample<T>, Error> {
        T::decode(self.payload).map_err(|source| Error::Decode {
            path: self.path.to_owned(),
            at: self.place.offset,
            stream: self.stream.name.clone(),
            expected: T::NAME,
            source: Box::new(source),
        })
    }
}

/// What is attached to a log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Attachment {
    /// As it was given.
    pub name: String,
    /// As it was given.
    pub media_type: String,
    /// Offset in the file of its record.
    pub offset: u64,
    /// Of the record, bytes.
    pub length: u64,
}

impl Attachment {
    /// Bytes from the beginning of its record to its content: opcode and length, two instants, two names with their lengths,
    /// the length of the content. `None` where the record is too short for that.
    pub fn content_offset(&self) -> Option<u64> {
        let texts = self.name.len() as u64 + self.media_type.len() as u64;
        let head = HEAD as u64 + 16 + 4 + 4 + 8 + texts;
        (head + CHECKSUM <= self.length).then_some(head)
    }

    /// Whether what is attached to the log at `path` is as it was written, by its checksum.
    ///
    /// # Errors
    /// Where the file cannot be read.
    pub fn is_whole(&self, path: &Path) -> Result<bool, Error> {
        if self.content_offset().is_none() {
            return Ok(false);
        }
        let read_error = |error: std::io::Error| Error::read(path, error);
        let mut file = File::open(path).map_err(read_error)?;
        file.seek(SeekFrom::Start(self.offset + HEAD as u64)).map_err(read_error)?;
        let mut checksum = crc32fast::Hasher::new();
        let mut piece = vec![0; 256 << 10];
        let mut left = self.length - HEAD as u64 - CHECKSUM;
        while left > 0 {
            let most = left.min(piece.len() as u64) as usize;
            file.read_exact(&mut piece[..most]).map_err(read_error)?;
            checksum.update(&piece[..most]);
            left -= most as u64;
        }
        let mut saved = [0; CHECKSUM as usize];
        file.read_exact(&mut saved).map_err(read_error)?;
        let saved = u32::from_le_bytes(saved);
        Ok(saved == 0 || saved == checksum.finalize())
    }
}

/// Bytes of the checksum behind what is attached.
const CHECKSUM: u64 = 4;

/// What stands in front of a record, and where.
#[derive(Clone, Copy)]
struct Head {
    opcode: u8,
    offset: u64,
    /// With the head.
    length: u64,
}

/// Where a message is that was found.
struct Found {
    channel: u16,
    sequence: u32,
    log_time: u64,
    publish_time: u64,
    place: Place,
    in_chunk: bool,
    data: Range<usize>,
}

impl Found {
    fn new(message: &MessageRecord<'_>, place: Place, in_chunk: bool, end: usize) -> Self {
        Self {
            channel: message.channel,
            sequence: message.sequence,
            log_time: message.log_time,
            publish_time: message.publish_time,
            place,
            in_chunk,
            data: end - message.data.len()..end,
        }
    }
}

/// Streams the messages of a log in the order in which they arrived, holding one chunk at a time.
pub struct Reader {
    path: PathBuf,
    limits: Limits,
    file: BufReader<File>,
    length: u64,
    /// Offset of the next record.
    at: u64,
    /// The record that was read last.
    body: Vec<u8>,
    /// The chunk that is being read: its offset, its content, and how far it is read.
    chunk_at: u64,
    chunk: Vec<u8>,
    chunk_read: usize,
    decompressor: Decompressor,
    index_bytes: u64,
    schemas: BTreeMap<u16, (String, String, Vec<u8>)>,
    /// By their numbers.
    streams: Vec<Option<Arc<StreamInfo>>>,
    /// The number of each one's schema.
    schema_of: Vec<u16>,
    library: String,
    header: Option<Header>,
    metadata: Vec<(String, BTreeMap<String, String>)>,
    attachments: Vec<Attachment>,
    ending: Option<Ending>,
    /// Messages that were passed over, by the number of their stream.
    unannounced: BTreeMap<u16, u64>,
    /// A record that was damaged, until it is known where reading goes on behind it.
    behind: Option<Behind>,
    effort: Effort,
    /// Streams were looked for at the end of the file, too.
    summary_read: bool,
}

impl Reader {
    /// Opens a log and reads what it says about its session.
    ///
    /// # Errors
    /// Where it cannot be read, is no MCAP file, or is of a newer format.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, Error> {
        Self::open_with(path, Limits::default())
    }

    /// Opens a log with other limits; see [`Reader::open`].
    ///
    /// # Errors
    /// As [`Reader::open`].
    pub fn open_with(path: impl AsRef<Path>, limits: Limits) -> Result<Self, Error> {
        let path = path.as_ref().to_owned();
        let open = || -> std::io::Result<(File, u64)> {
            let file = File::open(&path)?;
            let length = file.metadata()?.len();
            Ok((file, length))
        };
        let (file, length) = open().map_err(|error| Error::read(&path, error))?;
        let mut reader = Self {
            path,
            limits,
            file: BufReader::with_capacity(64 << 10, file),
            length,
            at: 0,
            body: Vec::new(),
            chunk_at: 0,
            chunk: Vec::new(),
            chunk_read: 0,
            decompressor: Decompressor::default(),
            index_bytes: 0,
            schemas: BTreeMap::new(),
            streams: Vec::new(),
            schema_of: Vec::new(),
            library: String::new(),
            header: None,
            metadata: Vec::new(),
            attachments: Vec::new(),
            ending: None,
            unannounced: BTreeMap::new(),
            behind: None,
            effort: Effort::default(),
            summary_read: false,
        };
        reader.begin()?;
        Ok(reader)
    }

    fn begin(&mut self) -> Result<(), Error> {
        let mut magic = [0; MAGIC.len()];
        match self.file.read_exact(&mut magic) {
            Ok(()) if magic == *MAGIC => self.at = MAGIC.len() as u64,
            Ok(()) => {
                let found = format!("a file that begins with \"{}\"", magic.escape_ascii());
                return Err(self.not_a_log(found));
            }
            Err(error) if error.kind() == ErrorKind::UnexpectedEof && self.length == 0 => {
                return Err(self.not_a_log("an empty file".to_owned()));
            }
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => {
                return Err(self.not_a_log(format!("a file of {} bytes", self.length)));
            }
            Err(error) => return Err(Error::read(&self.path, error)),
        }
        // The session's record is the second; a stranger's file has none, and messages come at once.
        while self.header.is_none() && self.ending.is_none() {
            let before = self.at;
            let taken = match self.read_record() {
                Ok(Some(head))
                    if matches!(head.opcode, op::HEADER | op::METADATA | op::SCHEMA | op::CHANNEL) =>
                {
                    self.take_record(head).map(|_| ())
                }
                Ok(_) => return self.again(before),
                Err(error) => Err(error),
            };
            match taken {
                Err(Error::Damaged { .. }) => return self.again(before),
                taken => taken?,
            }
        }
        Ok(())
    }

    /// What was looked at is read again, and damage told, when messages are asked for.
    fn again(&mut self, at: u64) -> Result<(), Error> {
        self.ending = None;
        self.behind = None;
        self.effort.again_from(at);
        self.seek(at)
    }

    fn not_a_log(&self, found: String) -> Error {
        Error::NotALog { path: self.path.clone(), expected: "an MCAP file", found }
    }

    fn damaged(&self, at: u64, malformed: Malformed) -> Error {
        Error::Damaged { path: self.path.clone(), at, expected: malformed.expected, found: malformed.found }
    }

    fn seek(&mut self, at: u64) -> Result<(), Error> {
        // Inside of what is in memory already, nothing is read again; files are shorter than 2^63 bytes.
        let here = self.file.stream_position();
        let moved = here.and_then(|here| self.file.seek_relative(at.wrapping_sub(here) as i64));
        moved.map_err(|error| Error::read(&self.path, error))?;
        self.at = at;
        Ok(())
    }

    /// Where it records come from.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What the file says about its session; `None` where a stranger wrote it.
    pub fn header(&self) -> Option<&Header> {
        self.header.as_ref()
    }

    /// Which library wrote the file.
    pub fn library(&self) -> &str {
        &self.library
    }

    /// The streams that have been met so far: all, once the end is reached.
    pub fn streams(&self) -> impl Iterator<Item = &Arc<StreamInfo>> {
        self.streams.iter().flatten()
    }

    fn stream(&self, id: u16) -> Option<&Arc<StreamInfo>> {
        self.streams.get(usize::from(id))?.as_ref()
    }

    /// The schema of a stream: its encoding and its data.
    pub fn schema(&self, stream: &StreamInfo) -> Option<(&str, &[u8])> {
        let number = self.schema_of.get(usize::from(stream.id))?;
        let found = self.schemas.get(number).filter(|(name, ..)| *name == stream.schema)?;
        Some((&found.1, &found.2))
    }

    /// Facts that were added under names, as far as they have been met.
    pub fn metadata(&self) -> &[(String, BTreeMap<String, String>)] {
        &self.metadata
    }

    /// What is attached, as far as it has been met.
    pub fn attachments(&self) -> &[Attachment] {
        &self.attachments
    }

    /// How the file ends; `None` until the end is reached.
    pub fn ending(&self) -> Option<Ending> {
        self.ending
    }

    /// How many messages, so far, are of streams whose announcement is lost, by their numbers: nothing says what they carry.
    /// [`Reader::next`] says so as damage once per stream and passes over the others.
    pub fn unannounced(&self) -> &BTreeMap<u16, u64> {
        &self.unannounced
    }

    /// Bytes read so far and in all, for a progress bar.
    pub fn progress(&self) -> (u64, u64) {
        (self.at, self.length)
    }

    /// Bytes that were taken out of the file and out of its chunks so far: what reading has cost. Behind damage some are read again;
    /// how many is bounded by the length of the file, whatever it holds.
    pub fn effort_bytes(&self) -> u64 {
        self.effort.bytes()
    }

    /// The next message; `None` at the end, whose kind [`Reader::ending`] tells.
    ///
    /// # Errors
    /// Where the file cannot be read or is damaged. Asked again after damage, it goes on with what is whole behind it.
    #[expect(clippy::should_implement_trait, reason = "an entry borrows the reader")]
    pub fn next(&mut self) -> Result<Option<Entry<'_>>, Error> {
        let found = loop {
            let Some(found) = self.advance()? else { return Ok(None) };
            if self.stream(found.channel).is_some() {
                break found;
            }
            self.read_summary()?;
            if self.stream(found.channel).is_some() {
                break found;
            }
            let count = self.unannounced.entry(found.channel).or_default();
            *count += 1;
            if *count == 1 {
                let (place, found) = (found.place, format!("number {}", found.channel));
                let malformed = Malformed::new("a message of a stream that was announced", found);
                return Err(self.damaged(place.offset, malformed));
            }
        };
        // It was looked for just now.
        let Some(stream) = self.stream(found.channel) else { return Ok(None) };
        let buffer = if found.in_chunk { &self.chunk } else { &self.body };
        Ok(Some(Entry {
            stream,
            sequence: found.sequence,
            log_time: found.log_time,
            publish_time: found.publish_time,
            place: found.place,
            payload: &buffer[found.data],
            path: &self.path,
        }))
    }

    fn advance(&mut self) -> Result<Option<Found>, Error> {
        loop {
            if self.chunk_read < self.chunk.len() {
                if let Some(found) = self.advance_in_chunk()? {
                    return Ok(Some(found));
                }
                continue;
            }
            if self.ending.is_some() {
                return Ok(None);
            }
            if let Some(behind) = self.behind.take() {
                self.go_on(behind)?;
                continue;
            }
            let Some(head) = self.read_record()? else { return Ok(None) };
            if let Some(found) = self.take_record(head)? {
                return Ok(Some(found));
            }
        }
    }

    /// Reads on in the chunk; `None` where what was read is no message.
    fn advance_in_chunk(&mut self) -> Result<Option<Found>, Error> {
        let (offset, in_chunk) = (self.chunk_at, self.chunk_read as u64);
        if let Some(message) = self.chunk.get(self.chunk_read..).and_then(MessageRecord::first) {
            self.chunk_read += message.length();
            let place = Place { offset, in_chunk };
            return Ok(Some(Found::new(&message, place, true, self.chunk_read)));
        }
        let chunk = std::mem::take(&mut self.chunk);
        let mut inner = Inner::new(&chunk, self.chunk_read, self.room());
        let taken = match inner.next() {
            Ok(Some(Record::Message(message))) => {
                Ok(Some(Found::new(&message, Place { offset, in_chunk }, true, inner.at())))
            }
            Ok(Some(Record::Schema { id, name, encoding, data })) => {
                self.add_schema(id, name, encoding, data).map(|()| None)
            }
            Ok(Some(Record::Channel { id, schema, topic, encoding, metadata })) => {
                self.add_stream(id, schema, topic, encoding, metadata).map(|()| None)
            }
            Ok(_) => Ok(None),
            Err(malformed) => Err(malformed),
        };
        self.chunk_read = inner.at();
        self.chunk = chunk;
        taken.map_err(|malformed| {
            // Where one record ends is not known, no other in this chunk begins.
            self.chunk.clear();
            self.chunk_read = 0;
            self.damaged(offset, malformed)
        })
    }

    /// Reads a record of the file into `body`. `None` where the file ends, and how is noted.
    fn read_record(&mut self) -> Result<Option<Head>, Error> {
        let at = self.at;
        let left = self.length.saturating_sub(at);
        if left < HEAD as u64 {
            self.ending = Some(Ending::CutOff { at });
            return Ok(None);
        }
        let mut head = [0; HEAD];
        self.file.read_exact(&mut head).map_err(|error| Error::read(&self.path, error))?;
        let mut length = [0; 8];
        length.copy_from_slice(&head[1..]);
        let length = u64::from_le_bytes(length);
        let opcode = head[0];
        if length > left - HEAD as u64 {
            // Cut off here, unless there are whole chunks behind: then this length is wrong.
            if self.find_chunk(at + 1)?.is_none() {
                self.ending = Some(Ending::CutOff { at });
                return Ok(None);
            }
            self.behind = Some(Behind::new(at, u64::MAX));
            let found = format!("one of {length} bytes");
            return Err(self.damaged(at, Malformed::new("a record that ends inside of the file", found)));
        }
        let behind = Behind::new(at, at + HEAD as u64 + length);
        if opcode == 0 || (op::DATA_END + 1..0x80).contains(&opcode) {
            self.behind = Some(behind);
            let found = format!("number {opcode:#04x}");
            return Err(self.damaged(at, Malformed::new("a kind of record that there is", found)));
        }
        self.body.clear();
        let wanted = match opcode {
            // Asked for by name, where at all; and what is not known is passed over.
            op::MESSAGE_INDEX => 0,
            op::ATTACHMENT => length.min(64 << 10),
            op::HEADER..=op::DATA_END => length,
            _ => 0,
        };
        if wanted > self.limits.record_bytes {
            self.seek(at + HEAD as u64 + length)?;
            let found = format!("{length} bytes");
            return Err(
                self.damaged(at, Malformed::new("a record that fits into the memory that is allowed", found))
            );
        }
        if let Err(behind) = self.effort.take(at, wanted, self.length) {
            self.behind = Some(behind);
            let found = "one inside of others that are damaged, too";
            return Err(self.damaged(at, Malformed::new("a record that was not read before", found)));
        }
        // Within the file and within the limit.
        self.body.resize(wanted as usize, 0);
        self.file.read_exact(&mut self.body).map_err(|error| Error::read(&self.path, error))?;
        if wanted == length {
            self.at = at + HEAD as u64 + length;
        } else {
            self.seek(at + HEAD as u64 + length)?;
        }
        Ok(Some(Head { opcode, offset: at, length: HEAD as u64 + length }))
    }

    /// Every message of one stream, in order. For streams that fit into memory.
    ///
    /// # Errors
    /// Where the file is damaged, has no such stream, or the stream carries another type.
    pub fn read_all<T: Message>(path: impl AsRef<Path>, stream: &str) -> Result<Vec<Sample<T>>, Error> {
        let mut reader = Self::open(path)?;
        let mut samples = Vec::new();
        while let Some(entry) = reader.next()? {
            if entry.stream.name == stream {
                samples.push(entry.decode()?);
            }
        }
        if !reader.streams().any(|info| info.name == stream) {
            let names: Vec<&str> = reader.streams().map(|info| info.name.as_str()).collect();
            return Err(Error::NoStream {
                path: reader.path.clone(),
                stream: stream.to_owned(),
                found: names.join(", "),
            });
        }
        Ok(samples)
    }
}
