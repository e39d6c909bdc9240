//! What can be a message of a log.

use std::sync::Arc;

use vergence_sense::Sample;
use vergence_time::Timestamp;

use crate::schema::Schema;
use crate::wire::{Encoder, WireError};

/// When something held and when it reached us, session time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Times {
    /// The instant for which the value holds.
    pub captured: Timestamp,
    /// The instant at which it reached us; becomes the log time.
    pub arrived: Timestamp,
}

impl Times {
    /// It held when it arrived.
    pub const fn at(instant: Timestamp) -> Self {
        Self { captured: instant, arrived: instant }
    }

    /// Captured first, arrived second.
    pub const fn new(captured: Timestamp, arrived: Timestamp) -> Self {
        Self { captured, arrived }
    }
}

/// A type that a stream of a log can carry. `vergence-log` implements it for what `vergence-sense` says; a room above
/// implements it for what only it knows, with a schema of its own.
pub trait Message: Sized {
    /// Names the type in the file (metadata `type`): two types may share a schema.
    const NAME: &'static str;
    /// Counted up when the meaning of a field changes or a field goes; new fields alone do not count.
    const VERSION: u32 = 1;
    /// The shape in the file.
    const SCHEMA: &'static Schema;
    /// Unit of the values, as people write it; what the fields' comments say in full.
    const UNIT: &'static str;

    /// Writes the message, both times included. Must not allocate beyond what `out` grows to.
    fn encode(&self, times: Times, frame: &str, out: &mut Encoder<'_>);

    /// Reads it back, bit for bit. Fields of numbers that are not known are passed over.
    ///
    /// # Errors
    /// Where the bytes are no such message.
    fn decode(bytes: &[u8]) -> Result<Sample<Self>, WireError>;
}

/// Which clock the *values* of a stream come from. Times of messages are session time always.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ClockKind {
    /// Session time: replayed exactly, compared.
    #[default]
    Session,
    /// Host time (CPU time, latency): kept, never compared.
    Host,
}

impl ClockKind {
    /// As in the file.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Session => "session",
            Self::Host => "host",
        }
    }
}

/// What a stream is, to be asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StreamDesc {
    /// Begins with a slash: `/head`, `/hand/left/aim`, `/action/select/right`.
    pub name: String,
    /// The reference frame of its coordinates (`local`, `stage`, `view`); empty where it has none.
    pub frame: String,
    /// In place of the type's own, where the type has none.
    pub unit: Option<String>,
    /// Which clock its values come from.
    pub clock: ClockKind,
    /// Anything more that a reader should know, as metadata of the channel.
    pub notes: Vec<(String, String)>,
}

impl StreamDesc {
    /// A stream without a frame, of session time.
    pub fn new(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            frame: String::new(),
            unit: None,
            clock: ClockKind::Session,
            notes: Vec::new(),
        }
    }

    /// Coordinates are in this frame.
    #[must_use]
    pub fn frame(self, frame: impl Into<String>) -> Self {
        Self { frame: frame.into(), ..self }
    }

    /// Values have this unit.
    #[must_use]
    pub fn unit(self, unit: impl Into<String>) -> Self {
        Self { unit: Some(unit.into()), ..self }
    }

    /// Values are of host time: kept, never compared.
    #[must_use]
    pub fn host_time(self) -> Self {
        Self { clock: ClockKind::Host, ..self }
    }

    /// One more note.
    #[must_use]
    pub fn note(mut self, key: impl Into<String>, value: impl Into<String>) -> Self {
        self.notes.push((key.into(), value.into()));
        self
    }
}

/// A stream of a recording that takes messages of one type; cheap to clone.
#[derive(Debug)]
pub struct Stream<T> {
    pub(crate) id: u16,
    pub(crate) frame: Arc<str>,
    pub(crate) of: std::marker::PhantomData<fn() -> T>,
}

impl<T> Clone for Stream<T> {
    fn clone(&self) -> Self {
        Self { id: self.id, frame: self.frame.clone(), of: std::marker::PhantomData }
    }
}
