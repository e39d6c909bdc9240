//! Recording: what the session's threads call, and the thread that writes.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use crate::error::Error;
use crate::header::Header;
use crate::lane::{Lane, Shared};
use crate::message::{Message, Stream, StreamDesc, Times};
use crate::writer::{Command, StreamRecord, Writer};

/// How chunks are compressed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Compression {
    /// Not at all: for streams that are compressed already.
    None,
    /// Fast.
    Lz4,
    /// Small, at its fastest level; the default.
    #[default]
    Zstd,
}

/// Knobs of a recording.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Of chunks. Cost and gain: see the benchmark in `benches/`.
    pub compression: Compression,
    /// A chunk ends when it is this old, host time, also when nothing more comes; a killed process loses what came
    /// after the last end. 10 ms to 900 ms; smaller loses less and compresses worse.
    pub chunk_every: Duration,
    /// A chunk also ends when it holds this many bytes before compression. 4 KiB to 64 MiB.
    pub chunk_bytes: u64,
    /// Size of the queue of each lane, bytes. What comes while it is full is dropped and counted; the writer empties it
    /// at least every 10 ms. 64 KiB and more.
    pub queue_bytes: usize,
    /// Asks the disk to have each chunk before the next begins (`fdatasync`), so that a power cut loses no more than a
    /// kill does. Costs a disk round trip per chunk, on the writer's thread only.
    pub durable: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            compression: Compression::Zstd,
            chunk_every: Duration::from_millis(500),
            chunk_bytes: 1 << 20,
            queue_bytes: 4 << 20,
            durable: false,
        }
    }
}

/// How a recording stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Status {
    /// Messages that came while the file could be written.
    pub taken: u64,
    /// Messages that are not in the file: of those that were taken, what found its queue full; and all that came after a
    /// failure or belong to a stream that was refused, which are not counted as taken. What was in a queue when the file failed is in neither.
    pub dropped: u64,
    /// The file cannot be written any more.
    pub failed: bool,
}

/// A recording in progress: owned by the thread that writes most, which uses its own [`Lane`] through
/// [`Recorder::write`]. Other threads are given lanes of theirs.
#[derive(Debug)]
pub struct Recorder {
    path: PathBuf,
    shared: Arc<Shared>,
    lane: Lane,
    options: Options,
    names: BTreeMap<String, u16>,
    commands: Sender<Command>,
    failure: Arc<Mutex<Option<Error>>>,
    thread: Option<JoinHandle<()>>,
}

impl Recorder {
    /// Makes the file at `path` (an existing one is replaced), writes its header and starts the writer's thread. Until the
    /// recording ends nobody else records to it.
    ///
    /// # Errors
    /// Where the file cannot be made or its first bytes not written, and where another recording is writing it.
    pub fn create(path: impl AsRef<Path>, header: &Header, options: &Options) -> Result<Self, Error> {
        let path = path.as_ref().to_owned();
        let options = Options {
            chunk_every: options.chunk_every.clamp(Duration::from_millis(10), Duration::from_millis(900)),
            chunk_bytes: options.chunk_bytes.clamp(4 << 10, 64 << 20),
            queue_bytes: options.queue_bytes.max(64 << 10),
            ..*options
        };
        let shared = Arc::<Shared>::default();
        let failure = Arc::new(Mutex::new(None));
        let (commands, inbox) = channel();
        let (lane, end) = Lane::new(shared.clone(), options.queue_bytes);
        let mut writer = Writer::create(&path, header, &options, shared.clone(), failure.clone(), inbox)?;
        writer.add(end);
        let thread = std::thread::Builder::new()
            .name("vergence-log".to_owned())
            .spawn(move || writer.run())
            .map_err(|error| Error::create(&path, error))?;
        Ok(Self {
            path,
            shared,
            lane,
            options,
            names: BTreeMap::new(),
            commands,
            failure,
            thread: Some(thread),
        })
    }

    /// Adds a stream of messages of type `T`. Not for the frame loop: allocates.
    ///
    /// # Errors
    /// Where the name is taken, is empty, or does not begin with a slash.
    pub fn stream<T: Message>(&mut self, desc: &StreamDesc) -> Result<Stream<T>, Error> {
        let refuse = |why| Err(Error::Stream { stream: desc.name.clone(), why });
        if !desc.name.starts_with('/') || desc.name.len() < 2 || desc.name.len() > 1024 {
            return refuse("expected a name that begins with a slash, of 2 to 1024 bytes");
        }
        // The writer's own stream is number 0.
        let Ok(id) = u16::try_from(self.names.len() + 1) else { return refuse("there are too many streams") };
        if desc.name == StreamRecord::OWN || self.names.contains_key(&desc.name) {
            return refuse("there is one of this name already");
        }
        self.names.insert(desc.name.clone(), id);
        self.command(Command::Stream(StreamRecord::of::<T>(id, desc)));
        Ok(Stream { id, frame: desc.frame.as_str().into(), of: std::marker::PhantomData })
    }

    /// Takes a message; see [`Lane::write`].
    pub fn write<T: Message>(&mut self, stream: &Stream<T>, times: Times, value: &T) {
        self.lane.write(stream, times, value);
    }

    /// A way into the recording for one more thread, with a queue of its own.
    pub fn lane(&self) -> Lane {
        let (lane, end) = Lane::new(self.shared.clone(), self.options.queue_bytes);
        self.command(Command::Lane(end));
        lane
    }

    /// Adds facts about the session under a name (`device`, `scene`, …), as a metadata record. Not for the frame loop:
    /// allocates, and ends a chunk.
    pub fn annotate(&self, name: &str, facts: &BTreeMap<String, String>) {
        self.command(Command::Metadata(name.to_owned(), facts.clone()));
    }

    /// Attaches a file's content (a scene), which the writer's thread reads in pieces; returns when it is in the log. An
    /// attachment is one piece of the file: what other lanes say meanwhile waits in their queues, and a kill loses that.
    /// So a session attaches before its first frame. Not for the frame loop.
    ///
    /// A file that cannot be read is said in the log (`not_attached`), and so is one that ends early (`attached_short`).
    pub fn attach(&self, name: &str, media_type: &str, file: &Path) {
        let (done, attached) = channel();
        self.command(Command::Attach {
            name: name.to_owned(),
            media_type: media_type.to_owned(),
            file: file.to_owned(),
            done,
        });
        if let Some(thread) = &self.thread {
            thread.thread().unpark();
        }
        // A writer that is gone answers no more.
        let _ = attached.recv();
    }

    /// Waits until everything that this thread has written so far is on the disk: for what must be safe before something
    /// else begins. Not for the frame loop: takes a disk round trip.
    ///
    /// # Errors
    /// Where the file cannot be written, which [`Recorder::failure`] then no longer says.
    pub fn sync(&self) -> Result<(), Error> {
        let (sender, answer) = channel();
        self.command(Command::Sync(sender));
        if let Some(thread) = &self.thread {
            thread.thread().unpark();
        }
        if answer.recv().is_ok() {
            return Ok(());
        }
        let said = self.failure.lock().unwrap_or_else(PoisonError::into_inner).take();
        let gone = || Error::Write {
            path: self.path.clone(),
            good_bytes: 0,
            source: Arc::new(std::io::Error::other(
                "expected a recording in progress, found one that has failed",
            )),
        };
        Err(said.unwrap_or_else(gone))
    }

    /// A writer that is gone takes no commands; why it is gone is said by [`Recorder::failure`].
    fn command(&self, command: Command) {
        drop(self.commands.send(command));
    }

    /// Where it records to.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How it stands; costs three loads.
    pub fn status(&self) -> Status {
        Status {
            taken: self.shared.order.load(Ordering::Relaxed),
            dropped: self.shared.dropped.load(Ordering::Relaxed),
            failed: self.shared.failed.load(Ordering::Relaxed),
        }
    }

    /// The longest that the writer's thread did not look at the queues, so far: because the disk or a processor made it wait, or an
    /// attachment is large. A message is in the file at most four times as long after [`Options::chunk_every`] has passed: until it
    /// is seen, until it is in its chunk, until the chunk is found to be old enough, until that is written.
    pub fn longest_away(&self) -> Duration {
        self.shared.longest_away()
    }

    /// Why the file cannot be written any more, once: the session says it and goes on.
    pub fn failure(&mut self) -> Option<Error> {
        if !self.shared.failed.load(Ordering::Relaxed) {
            return None;
        }
        self.failure.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    /// Writes what is left, ends the file and says how it went.
    ///
    /// # Errors
    /// Where the file could not be written to its end and [`Recorder::failure`] has not said so before.
    pub fn finish(self) -> Result<Status, Error> {
        match self.close() {
            (_, Some(error)) => Err(error),
            (status, None) => Ok(status),
        }
    }

    /// As [`Recorder::finish`], with how the recording stands also where it failed.
    pub fn close(mut self) -> (Status, Option<Error>) {
        self.end();
        (self.status(), self.failure.lock().unwrap_or_else(PoisonError::into_inner).take())
    }

    fn end(&mut self) {
        self.shared.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            if thread.join().is_err() {
                self.shared.failed.store(true, Ordering::Relaxed);
            }
        }
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        self.end();
    }
}
