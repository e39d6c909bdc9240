//! A log made out of logs: what repair, cut and merge write with.

use std::collections::BTreeMap;
use std::fs::{File, TryLockError};
use std::io::{BufWriter, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use mcap::records::{AttachmentHeader, MessageHeader, Metadata};

use crate::error::Error;
use crate::file::sync_folder_of;
use crate::header::SESSION;
use crate::reader::{Attachment, Entry, Limits, Reader, StreamInfo};
use crate::recorder::Compression;
use crate::records::{Fields, HEAD};
use crate::writer::write_options;

/// Writes beside the goal and takes its place at the end, so that a goal is whole or as it was.
pub(crate) struct Rewriter {
    goal: PathBuf,
    beside: PathBuf,
    mcap: mcap::Writer<BufWriter<File>>,
    /// Channel of the new file for a channel of the nth source.
    channels: BTreeMap<(usize, u16), u16>,
    done: bool,
}

impl Rewriter {
    pub(crate) fn create(goal: &Path, sources: &[&Path]) -> Result<Self, Error> {
        let same = |a: &Path, b: &Path| match (a.canonicalize(), b.canonicalize()) {
            (Ok(a), Ok(b)) => a == b,
            _ => false,
        };
        if sources.iter().any(|source| same(source, goal)) {
            return Err(Error::Request(format!("{}: expected another file to write to", goal.display())));
        }
        let busy = |goal: &Path| {
            // A file that cannot be opened or locked is not being recorded to by anybody whom we could ask.
            File::open(goal).is_ok_and(|file| matches!(file.try_lock(), Err(TryLockError::WouldBlock)))
        };
        if busy(goal) {
            let goal = goal.display();
            let found = "expected a file that nobody writes, found one that a recording is writing";
            return Err(Error::Request(format!("{goal}: {found}")));
        }
        // A name that nobody has, so that nothing of anybody's is written over: a source may be what an earlier call left.
        let mut name = goal.as_os_str().to_owned();
        name.push(format!(".{}.part", std::process::id()));
        let beside = PathBuf::from(name);
        let file = File::create_new(&beside).map_err(|error| Error::create(goal, error))?;
        let sink = BufWriter::with_capacity(256 << 10, file);
        let mcap = write_options(Compression::Zstd, Some(1 << 20)).create(sink);
        let mcap = mcap.map_err(|error| write_error(goal, error))?;
        Ok(Self { goal: goal.to_owned(), beside, mcap, channels: BTreeMap::new(), done: false })
    }

    fn check<T>(&self, result: Result<T, mcap::McapError>) -> Result<T, Error> {
        result.map_err(|error| write_error(&self.goal, error))
    }

    pub(crate) fn session(&mut self, metadata: BTreeMap<String, String>) -> Result<(), Error> {
        self.metadata(SESSION, metadata)
    }

    pub(crate) fn metadata(&mut self, name: &str, metadata: BTreeMap<String, String>) -> Result<(), Error> {
        let written = self.mcap.write_metadata(&Metadata { name: name.to_owned(), metadata });
        self.check(written)
    }

    /// Announces a stream of the `source`th log, under a name of the caller's.
    pub(crate) fn stream(
        &mut self,
        source: usize,
        info: &StreamInfo,
        name: &str,
        schema: Option<(&str, &[u8])>,
    ) -> Result<(), Error> {
        if self.channels.contains_key(&(source, info.id)) {
            return Ok(());
        }
        let schema = match schema {
            Some((encoding, data)) => {
                let added = self.mcap.add_schema(&info.schema, encoding, data);
                self.check(added)?
            }
            None => 0,
        };
        let added = self.mcap.add_channel(schema, name, &info.encoding, &info.metadata);
        let id = self.check(added)?;
        self.channels.insert((source, info.id), id);
        Ok(())
    }

    pub(crate) fn message(
        &mut self,
        source: usize,
        channel: u16,
        sequence: u32,
        times: (u64, u64),
        payload: &[u8],
    ) -> Result<(), Error> {
        let Some(&channel_id) = self.channels.get(&(source, channel)) else {
            return Err(Error::Request("a message of a stream that was not announced".to_owned()));
        };
        let header = MessageHeader { channel_id, sequence, log_time: times.0, publish_time: times.1 };
        let written = self.mcap.write_to_known_channel(&header, payload);
        self.check(written)
    }

    pub(crate) fn entry(&mut self, source: usize, entry: &Entry<'_>) -> Result<(), Error> {
        let times = (entry.log_time, entry.publish_time);
        self.message(source, entry.stream.id, entry.sequence, times, entry.payload)
    }

    /// Copies what is attached to a log, in pieces; whether its checksum was right, without which it is not copied.
    pub(crate) fn attachment(&mut self, reader: &Reader, attached: &Attachment) -> Result<bool, Error> {
        let path = reader.path();
        let read_error = |error: std::io::Error| Error::read(path, error);
        let mut piece = vec![0; 256 << 10];
        let Some(content) = attached.content_offset().filter(|head| *head <= piece.len() as u64) else {
            return Ok(false);
        };
        if !attached.is_whole(path)? {
            return Ok(false);
        }
        let mut file = File::open(path).map_err(read_error)?;
        let start = attached.offset + HEAD as u64;
        file.seek(SeekFrom::Start(start)).map_err(read_error)?;
        let head = &mut piece[..(content - HEAD as u64) as usize];
        file.read_exact(head).map_err(read_error)?;
        let mut fields = Fields(head);
        let what = "an attachment";
        let (Ok(log_time), Ok(create_time)) = (fields.u64(what), fields.u64(what)) else { return Ok(false) };
        let mut left = attached.length - content - 4;
        let (name, media_type) = (attached.name.clone(), attached.media_type.clone());
        let started =
            self.mcap.start_attachment(left, AttachmentHeader { log_time, create_time, name, media_type });
        self.check(started)?;
        while left > 0 {
            let most = left.min(piece.len() as u64) as usize;
            file.read_exact(&mut piece[..most]).map_err(read_error)?;
            let put = self.mcap.put_attachment_bytes(&piece[..most]);
            self.check(put)?;
            left -= most as u64;
        }
        let finished = self.mcap.finish_attachment();
        self.check(finished).map(|()| true)
    }

    /// Ends the file and puts it into its place.
    pub(crate) fn finish(mut self) -> Result<(), Error> {
        let finished = self.mcap.finish();
        self.check(finished)?;
        // The new name must not reach the disk before what it names.
        let synced = File::open(&self.beside).and_then(|file| file.sync_all());
        synced.map_err(|error| Error::create(&self.goal, error))?;
        std::fs::rename(&self.beside, &self.goal).map_err(|error| Error::create(&self.goal, error))?;
        self.done = true;
        sync_folder_of(&self.goal);
        Ok(())
    }
}

impl Drop for Rewriter {
    fn drop(&mut self) {
        if !self.done {
            // What was begun is of no use.
            drop(std::fs::remove_file(&self.beside));
        }
    }
}

fn write_error(path: &Path, error: mcap::McapError) -> Error {
    let source = match error {
        mcap::McapError::Io(error) => error,
        error => std::io::Error::other(error),
    };
    Error::Write { path: path.to_owned(), good_bytes: 0, source: std::sync::Arc::new(source) }
}

/// Copies a log's session, notes and attachments as they are met, and its messages as `keep` says.
pub(crate) struct Copier<'a> {
    pub(crate) source: usize,
    pub(crate) reader: Reader,
    metadata: usize,
    attachments: usize,
    pub(crate) name: Box<dyn Fn(&str) -> String + 'a>,
}

impl<'a> Copier<'a> {
    pub(crate) fn open(source: usize, path: &Path, limits: Limits) -> Result<Self, Error> {
        let reader = Reader::open_with(path, limits)?;
        Ok(Self { source, reader, metadata: 0, attachments: 0, name: Box::new(str::to_owned) })
    }

    /// What was met since the last call; attachments that are damaged are told by name.
    pub(crate) fn copy_facts(&mut self, to: &mut Rewriter) -> Result<Vec<String>, Error> {
        let mut damaged = Vec::new();
        while let Some((name, metadata)) = self.reader.metadata().get(self.metadata) {
            to.metadata(name, metadata.clone())?;
            self.metadata += 1;
        }
        while let Some(attached) = self.reader.attachments().get(self.attachments) {
            if !to.attachment(&self.reader, attached)? {
                damaged.push(attached.name.clone());
            }
            self.attachments += 1;
        }
        Ok(damaged)
    }

    /// Announces all streams that are known, also those without messages.
    pub(crate) fn copy_streams(&self, to: &mut Rewriter) -> Result<(), Error> {
        for info in self.reader.streams() {
            to.stream(self.source, info, &(self.name)(&info.name), self.reader.schema(info))?;
        }
        Ok(())
    }
}
