//! What a reader keeps for the whole file: schemas, streams, notes, attachments.

use std::collections::BTreeMap;
use std::io::Read;
use std::sync::Arc;

use super::behind::Behind;
use super::{Attachment, Ending, Found, Head, Place, Reader, StreamInfo};
use crate::error::Error;
use crate::header::{FORMAT_VERSION, Header, LIBRARY, SESSION};
use crate::records::{Fields, MAGIC, Malformed, Record, note_bytes, op};

impl Reader {
    /// Takes in the record that was read last; a message is found.
    pub(super) fn take_record(&mut self, head: Head) -> Result<Option<Found>, Error> {
        let body = std::mem::take(&mut self.body);
        let taken = self.take_body(head, &body);
        self.body = body;
        if taken.is_err() {
            self.behind = Some(Behind::new(head.offset, head.offset + head.length));
        }
        taken
    }

    pub(super) fn take_body(&mut self, head: Head, body: &[u8]) -> Result<Option<Found>, Error> {
        let offset = head.offset;
        if head.opcode == op::ATTACHMENT {
            let taken = self.add_attachment(head, body);
            return taken.map(|()| None).map_err(|malformed| self.damaged(offset, malformed));
        }
        let record = Record::parse(head.opcode, body, self.room())
            .map_err(|malformed| self.damaged(offset, malformed))?;
        let taken = match record {
            // Ours are in chunks, which have checksums: outside, where two pieces changed places, there is nothing to believe.
            Record::Message(_) if self.library.starts_with(LIBRARY) => {
                Err(Malformed::new("messages in chunks, as this library writes them", "one outside"))
            }
            Record::Message(message) => {
                let place = Place { offset, in_chunk: 0 };
                return Ok(Some(Found::new(&message, place, false, body.len())));
            }
            Record::Header { library } => {
                library.clone_into(&mut self.library);
                Ok(())
            }
            Record::Chunk(chunk) => {
                self.chunk_at = offset;
                self.chunk_read = 0;
                let done = self.decompressor.decompress(&chunk, self.limits.record_bytes, &mut self.chunk);
                self.effort.decompressed(self.chunk.len() as u64);
                done.inspect_err(|_| self.chunk.clear())
            }
            Record::Schema { id, name, encoding, data } => self.add_schema(id, name, encoding, data),
            Record::Channel { id, schema, topic, encoding, metadata } => {
                self.add_stream(id, schema, topic, encoding, metadata)
            }
            Record::Metadata { name, metadata } => {
                return self.add_metadata(offset, name, metadata).map(|()| None);
            }
            Record::Footer { summary_start } => {
                let mut magic = [0; MAGIC.len()];
                let whole = self.file.read_exact(&mut magic).is_ok() && magic == *MAGIC;
                // Ours have a summary, unless they could not be written on.
                let failed = summary_start == 0 && self.library.starts_with(LIBRARY);
                self.ending = Some(match (whole, failed) {
                    (false, _) => Ending::CutOff { at: self.at },
                    (true, true) => Ending::Failed { at: offset },
                    (true, false) => Ending::Complete,
                });
                Ok(())
            }
            Record::Attachment | Record::DataEnd | Record::Other => Ok(()),
        };
        taken.map(|()| None).map_err(|malformed| self.damaged(offset, malformed))
    }

    /// Bytes that what is kept for the whole file may still take.
    pub(super) fn room(&self) -> u64 {
        self.limits.index_bytes.saturating_sub(self.index_bytes)
    }

    /// Counts what is kept for the whole file.
    fn charge(&mut self, bytes: u64) -> Result<(), Malformed> {
        // What a map needs beside the bytes themselves.
        self.index_bytes += bytes + 128;
        if self.index_bytes > self.limits.index_bytes {
            let found = format!("{} bytes of them", self.index_bytes);
            return Err(Malformed::new(
                "schemas, streams and notes that fit into the memory that is allowed",
                found,
            ));
        }
        Ok(())
    }

    pub(super) fn add_schema(
        &mut self,
        id: u16,
        name: &str,
        encoding: &str,
        data: &[u8],
    ) -> Result<(), Malformed> {
        if let Some(known) = self.schemas.get(&id) {
            let same = (known.0.as_str(), known.1.as_str(), known.2.as_slice()) == (name, encoding, data);
            let found = || format!("two, '{}' and '{name}'", known.0);
            return if same { Ok(()) } else { Err(Malformed::new("one schema per number", found())) };
        }
        self.charge((name.len() + encoding.len() + data.len()) as u64)?;
        self.schemas.insert(id, (name.to_owned(), encoding.to_owned(), data.to_owned()));
        Ok(())
    }

    pub(super) fn add_stream(
        &mut self,
        id: u16,
        schema: u16,
        topic: &str,
        encoding: &str,
        metadata: BTreeMap<String, String>,
    ) -> Result<(), Malformed> {
        let number = schema;
        let schema = match self.schemas.get(&schema) {
            Some((name, ..)) => name.clone(),
            // MCAP: messages without a schema.
            None if schema == 0 => String::new(),
            None => {
                return Err(Malformed::new(
                    "a schema before the stream that has it",
                    format!("number {schema}"),
                ));
            }
        };
        let info = StreamInfo { id, name: topic.to_owned(), schema, encoding: encoding.to_owned(), metadata };
        if let Some(known) = self.stream(id) {
            let found = || format!("two, '{}' and '{topic}'", known.name);
            return if **known == info {
                Ok(())
            } else {
                Err(Malformed::new("one stream per number", found()))
            };
        }
        self.charge((topic.len() + encoding.len() + info.schema.len()) as u64 + notes_bytes(&info.metadata))?;
        let place = usize::from(id);
        if self.streams.len() <= place {
            self.streams.resize(place + 1, None);
            self.schema_of.resize(place + 1, 0);
        }
        self.schema_of[place] = number;
        self.streams[place] = Some(Arc::new(info));
        Ok(())
    }

    fn add_metadata(
        &mut self,
        offset: u64,
        name: &str,
        metadata: BTreeMap<String, String>,
    ) -> Result<(), Error> {
        if name == SESSION && self.header.is_none() {
            let version = metadata.get("format_version").map_or("", String::as_str);
            if !version.parse::<u32>().is_ok_and(|version| version <= FORMAT_VERSION) {
                return Err(Error::Newer {
                    path: self.path.clone(),
                    expected: FORMAT_VERSION,
                    found: format!("'{version}'"),
                });
            }
            let charged = self.charge(notes_bytes(&metadata));
            charged.map_err(|malformed| self.damaged(offset, malformed))?;
            self.header = Some(Header::from_map(&metadata));
            return Ok(());
        }
        let charged = self.charge(name.len() as u64 + notes_bytes(&metadata));
        charged.map_err(|malformed| self.damaged(offset, malformed))?;
        self.metadata.push((name.to_owned(), metadata));
        Ok(())
    }

    fn add_attachment(&mut self, head: Head, start: &[u8]) -> Result<(), Malformed> {
        let mut fields = Fields(start);
        let what = "an attachment";
        let (_log_time, _create_time) = (fields.u64(what)?, fields.u64(what)?);
        let (name, media_type) = (fields.text(what)?, fields.text(what)?);
        self.charge((name.len() + media_type.len()) as u64)?;
        self.attachments.push(Attachment {
            name: name.to_owned(),
            media_type: media_type.to_owned(),
            offset: head.offset,
            length: head.length,
        });
        Ok(())
    }
}

fn notes_bytes(notes: &BTreeMap<String, String>) -> u64 {
    notes.iter().map(|(key, value)| note_bytes(key, value)).sum()
}
