use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::wire::WireError;

/// What can go wrong with a log.
#[derive(Clone, Debug, thiserror::Error)]
pub enum Error {
    /// The file cannot be made.
    #[error("{}: cannot be created", path.display())]
    Create {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: Arc<std::io::Error>,
    },
    /// The file cannot be written any further; what was complete before stays readable.
    #[error("{}: recording ended after {good_bytes} bytes, which stay readable", path.display())]
    Write {
        /// Which file.
        path: PathBuf,
        /// Up to here the file is good.
        good_bytes: u64,
        /// Why.
        source: Arc<std::io::Error>,
    },
    /// The file cannot be opened or read.
    #[error("{}: cannot be read", path.display())]
    Read {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: Arc<std::io::Error>,
    },
    /// The file is something else.
    #[error("{}: expected {expected}, found {found}", path.display())]
    NotALog {
        /// Which file.
        path: PathBuf,
        /// What it should be.
        expected: &'static str,
        /// What it is.
        found: String,
    },
    /// A newer Vergence wrote the file.
    #[error("{}: expected a session log of format {expected} or earlier, found format {found}: a newer vergence wrote it", path.display())]
    Newer {
        /// Which file.
        path: PathBuf,
        /// The newest that is understood.
        expected: u32,
        /// What the file says.
        found: String,
    },
    /// The file is damaged.
    #[error("{}, byte {at}: expected {expected}, found {found}", path.display())]
    Damaged {
        /// Which file.
        path: PathBuf,
        /// Offset in the file of the record that is damaged, or of the chunk that it is in.
        at: u64,
        /// What should be there.
        expected: &'static str,
        /// What is there.
        found: String,
    },
    /// A message is not what its stream says.
    #[error("{}, byte {at}: a message of stream '{stream}' is no {expected}", path.display())]
    Decode {
        /// Which file.
        path: PathBuf,
        /// Offset in the file of the message, or of the chunk that it is in.
        at: u64,
        /// Which stream.
        stream: String,
        /// The type that was asked for.
        expected: &'static str,
        /// Why.
        source: Box<WireError>,
    },
    /// A stream carries another type.
    #[error("{}: stream '{stream}': expected type {expected}, found {found}", path.display())]
    Type {
        /// Which file.
        path: PathBuf,
        /// Which stream.
        stream: String,
        /// The type that was asked for.
        expected: String,
        /// The type that it has.
        found: String,
    },
    /// There is no such stream.
    #[error("{}: expected a stream '{stream}', found {found}", path.display())]
    NoStream {
        /// Which file.
        path: PathBuf,
        /// Which stream.
        stream: String,
        /// Which there are.
        found: String,
    },
    /// A stream cannot be added.
    #[error("stream '{stream}': {why}")]
    Stream {
        /// Which stream.
        stream: String,
        /// Why not.
        why: &'static str,
    },
    /// What was asked of these logs makes no sense.
    #[error("{0}")]
    Request(String),
}

impl Error {
    pub(crate) fn read(path: &Path, error: std::io::Error) -> Self {
        Self::Read { path: path.to_owned(), source: Arc::new(error) }
    }

    pub(crate) fn create(path: &Path, error: std::io::Error) -> Self {
        Self::Create { path: path.to_owned(), source: Arc::new(error) }
    }
}
