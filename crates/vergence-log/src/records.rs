//! Records of an MCAP file, one after the other, each with its place.
//!
//! Own code beside the `mcap` crate, which writes: a log that was cut off or damaged must say where, be read on behind
//! the damage, and never take more memory than was agreed, and the crate's reader tells no places, stops at the first
//! damage and (0.26) slices out of range in an attachment of less than four bytes. Source: MCAP specification, "Records".

use std::collections::BTreeMap;

pub(crate) mod op {
    pub(crate) const HEADER: u8 = 0x01;
    pub(crate) const FOOTER: u8 = 0x02;
    pub(crate) const SCHEMA: u8 = 0x03;
    pub(crate) const CHANNEL: u8 = 0x04;
    pub(crate) const MESSAGE: u8 = 0x05;
    pub(crate) const CHUNK: u8 = 0x06;
    pub(crate) const MESSAGE_INDEX: u8 = 0x07;
    pub(crate) const ATTACHMENT: u8 = 0x09;
    pub(crate) const METADATA: u8 = 0x0c;
    pub(crate) const DATA_END: u8 = 0x0f;
}

/// Bytes of a record's opcode and length.
pub(crate) const HEAD: usize = 9;
/// The first and the last bytes of a file.
pub(crate) const MAGIC: &[u8; 8] = b"\x89MCAP0\r\n";

/// Memory that a note takes: its bytes, each text's place in the map, and what the allocator adds.
pub(crate) fn note_bytes(key: &str, value: &str) -> u64 {
    (key.len() + value.len()) as u64 + 160
}

/// A record as it stands in a file.
pub(crate) fn put_record(opcode: u8, body: &[u8], out: &mut Vec<u8>) {
    out.push(opcode);
    out.extend_from_slice(&(body.len() as u64).to_le_bytes());
    out.extend_from_slice(body);
}

fn put_bytes(bytes: &[u8], out: &mut Vec<u8>) {
    out.extend_from_slice(&(bytes.len() as u32).to_le_bytes());
    out.extend_from_slice(bytes);
}

fn put_map(map: &BTreeMap<String, String>, out: &mut Vec<u8>) {
    let mut fields = Vec::new();
    for (key, value) in map {
        put_bytes(key.as_bytes(), &mut fields);
        put_bytes(value.as_bytes(), &mut fields);
    }
    put_bytes(&fields, out);
}

/// The record that announces a schema.
pub(crate) fn put_schema(id: u16, name: &str, encoding: &str, data: &[u8], out: &mut Vec<u8>) {
    let mut body = id.to_le_bytes().to_vec();
    put_bytes(name.as_bytes(), &mut body);
    put_bytes(encoding.as_bytes(), &mut body);
    put_bytes(data, &mut body);
    put_record(op::SCHEMA, &body, out);
}

/// The record that announces a stream.
pub(crate) fn put_channel(
    (id, schema): (u16, u16),
    topic: &str,
    encoding: &str,
    metadata: &BTreeMap<String, String>,
    out: &mut Vec<u8>,
) {
    let mut body = [id.to_le_bytes(), schema.to_le_bytes()].concat();
    put_bytes(topic.as_bytes(), &mut body);
    put_bytes(encoding.as_bytes(), &mut body);
    put_map(metadata, &mut body);
    put_record(op::CHANNEL, &body, out);
}

/// The record that holds notes under a name.
pub(crate) fn put_metadata(name: &str, metadata: &BTreeMap<String, String>, out: &mut Vec<u8>) {
    let mut body = Vec::new();
    put_bytes(name.as_bytes(), &mut body);
    put_map(metadata, &mut body);
    put_record(op::METADATA, &body, out);
}

/// What a record should have held.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Malformed {
    pub(crate) expected: &'static str,
    pub(crate) found: String,
}

impl Malformed {
    pub(crate) fn new(expected: &'static str, found: impl Into<String>) -> Self {
        Self { expected, found: found.into() }
    }
}

/// Reads the fields of a record's body.
pub(crate) struct Fields<'a>(pub(crate) &'a [u8]);

impl<'a> Fields<'a> {
    pub(crate) fn bytes(&mut self, count: u64, expected: &'static str) -> Result<&'a [u8], Malformed> {
        match usize::try_from(count).ok().and_then(|count| self.0.split_at_checked(count)) {
            Some((bytes, rest)) => {
                self.0 = rest;
                Ok(bytes)
            }
            None => Err(Malformed::new(expected, format!("{count} bytes announced, {} there", self.0.len()))),
        }
    }

    fn array<const N: usize>(&mut self, expected: &'static str) -> Result<[u8; N], Malformed> {
        let mut array = [0; N];
        array.copy_from_slice(self.bytes(N as u64, expected)?);
        Ok(array)
    }

    pub(crate) fn u16(&mut self, expected: &'static str) -> Result<u16, Malformed> {
        self.array(expected).map(u16::from_le_bytes)
    }

    pub(crate) fn u32(&mut self, expected: &'static str) -> Result<u32, Malformed> {
        self.array(expected).map(u32::from_le_bytes)
    }

    pub(crate) fn u64(&mut self, expected: &'static str) -> Result<u64, Malformed> {
        self.array(expected).map(u64::from_le_bytes)
    }

    pub(crate) fn text(&mut self, expected: &'static str) -> Result<&'a str, Malformed> {
        let length = self.u32(expected)?;
        let bytes = self.bytes(length.into(), expected)?;
        std::str::from_utf8(bytes).map_err(|_| Malformed::new(expected, "bytes that are no UTF-8"))
    }

    /// Notes under names. Counted while they are read: some bytes in the file are many times as many in memory.
    pub(crate) fn map(
        &mut self,
        expected: &'static str,
        room: u64,
    ) -> Result<BTreeMap<String, String>, Malformed> {
        let length = self.u32(expected)?;
        let mut fields = Fields(self.bytes(length.into(), expected)?);
        let mut map = BTreeMap::new();
        let mut taken = 0;
        while !fields.0.is_empty() {
            let (key, value) = (fields.text(expected)?, fields.text(expected)?);
            taken += note_bytes(key, value);
            if taken > room {
                let found = format!("{taken} bytes of them, and more");
                return Err(Malformed::new("notes that fit into the memory that is allowed", found));
            }
            map.insert(key.to_owned(), value.to_owned());
        }
        Ok(map)
    }
}

/// A record of the data section that holds something of the session.
#[derive(Debug)]
pub(crate) enum Record<'a> {
    Header {
        library: &'a str,
    },
    Schema {
        id: u16,
        name: &'a str,
        encoding: &'a str,
        data: &'a [u8],
    },
    Channel {
        id: u16,
        schema: u16,
        topic: &'a str,
        encoding: &'a str,
        metadata: BTreeMap<String, String>,
    },
    Message(MessageRecord<'a>),
    Chunk(ChunkRecord<'a>),
    Attachment,
    Metadata {
        name: &'a str,
        metadata: BTreeMap<String, String>,
    },
    DataEnd,
    Footer {
        /// 0 where there is none.
        summary_start: u64,
    },
    /// An index, or something that a later MCAP has.
    Other,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct MessageRecord<'a> {
    pub(crate) channel: u16,
    pub(crate) sequence: u32,
    pub(crate) log_time: u64,
    pub(crate) publish_time: u64,
    pub(crate) data: &'a [u8],
}

/// Bytes of a message in front of its data, with the record's head.
const MESSAGE_HEAD: usize = HEAD + 22;

impl<'a> MessageRecord<'a> {
    /// The message that begins `bytes`, whole: what nearly every record of a chunk is. `None` where something else begins there, or
    /// damage: [`Inner::next`] says what.
    #[inline]
    pub(crate) fn first(bytes: &'a [u8]) -> Option<Self> {
        let (head, rest) = bytes.split_first_chunk::<MESSAGE_HEAD>()?;
        let number = |from: usize| {
            let mut eight = [0; 8];
            eight.copy_from_slice(&head[from..from + 8]);
            u64::from_le_bytes(eight)
        };
        if head[0] != op::MESSAGE {
            return None;
        }
        let length = usize::try_from(number(1)).ok()?;
        Some(Self {
            channel: u16::from_le_bytes([head[9], head[10]]),
            sequence: u32::from_le_bytes([head[11], head[12], head[13], head[14]]),
            log_time: number(15),
            publish_time: number(23),
            data: rest.get(..length.checked_sub(MESSAGE_HEAD - HEAD)?)?,
        })
    }

    /// Bytes of the record.
    #[inline]
    pub(crate) fn length(&self) -> usize {
        MESSAGE_HEAD + self.data.len()
    }
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct ChunkRecord<'a> {
    pub(crate) uncompressed_size: u64,
    pub(crate) crc: u32,
    pub(crate) compression: &'a str,
    pub(crate) data: &'a [u8],
}

impl<'a> Record<'a> {
    /// `room` is how many bytes notes may take in memory.
    pub(crate) fn parse(opcode: u8, body: &'a [u8], room: u64) -> Result<Self, Malformed> {
        let mut fields = Fields(body);
        Ok(match opcode {
            op::HEADER => {
                let _profile = fields.text("a header")?;
                Self::Header { library: fields.text("a header")? }
            }
            op::FOOTER => Self::Footer { summary_start: fields.u64("a footer")? },
            op::SCHEMA => {
                let what = "a schema";
                let (id, name, encoding) = (fields.u16(what)?, fields.text(what)?, fields.text(what)?);
                let length = fields.u32(what)?;
                Self::Schema { id, name, encoding, data: fields.bytes(length.into(), what)? }
            }
            op::CHANNEL => {
                let what = "a channel";
                Self::Channel {
                    id: fields.u16(what)?,
                    schema: fields.u16(what)?,
                    topic: fields.text(what)?,
                    encoding: fields.text(what)?,
                    metadata: fields.map(what, room)?,
                }
            }
            op::MESSAGE => {
                let what = "a message";
                Self::Message(MessageRecord {
                    channel: fields.u16(what)?,
                    sequence: fields.u32(what)?,
                    log_time: fields.u64(what)?,
                    publish_time: fields.u64(what)?,
                    data: fields.0,
                })
            }
            op::CHUNK => {
                let what = "a chunk";
                let (_start, _end) = (fields.u64(what)?, fields.u64(what)?);
                let (uncompressed_size, crc) = (fields.u64(what)?, fields.u32(what)?);
                let compression = fields.text(what)?;
                let length = fields.u64(what)?;
                Self::Chunk(ChunkRecord {
                    uncompressed_size,
                    crc,
                    compression,
                    data: fields.bytes(length, what)?,
                })
            }
            op::ATTACHMENT => Self::Attachment,
            op::METADATA => {
                Self::Metadata { name: fields.text("metadata")?, metadata: fields.map("metadata", room)? }
            }
            op::DATA_END => Self::DataEnd,
            _ => Self::Other,
        })
    }
}

/// The records inside of a chunk, decompressed.
#[derive(Clone, Debug)]
pub(crate) struct Inner<'a> {
    bytes: &'a [u8],
    at: usize,
    room: u64,
}

impl<'a> Inner<'a> {
    /// From the record at `at` on; `room` as for [`Record::parse`].
    pub(crate) fn new(bytes: &'a [u8], at: usize, room: u64) -> Self {
        Self { bytes, at, room }
    }

    /// Where the next record begins.
    pub(crate) fn at(&self) -> usize {
        self.at
    }

    /// The next record; `None` at the end.
    pub(crate) fn next(&mut self) -> Result<Option<Record<'a>>, Malformed> {
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        if rest.is_empty() {
            return Ok(None);
        }
        let mut fields = Fields(rest);
        let opcode = fields.array::<1>("a record in a chunk")?[0];
        let length = fields.u64("a record in a chunk")?;
        let body = fields.bytes(length, "a record in a chunk")?;
        self.at += HEAD + body.len();
        Record::parse(opcode, body, self.room).map(Some)
    }
}
