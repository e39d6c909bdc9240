use std::fmt::Display;
use std::path::{Path, PathBuf};

/// Why a scene cannot be loaded.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file cannot be read.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A scene file (TOML) cannot be used; says file, line and column.
    #[error(transparent)]
    Config(#[from] vergence_config::Error),
    /// A place in a file is wrong.
    #[error("{}: {place}: {message}", path.display())]
    Invalid {
        /// Which file.
        path: PathBuf,
        /// Where in it: a JSON path, `accessors[3]`, a line and column, a byte.
        place: String,
        /// What was expected and what was found.
        message: String,
    },
    /// Loading would take more than [`crate::Limits`] allow.
    #[error("{}: {place}: expected at most {allowed} {what}, found {found}", path.display())]
    TooLarge {
        /// Which file.
        path: PathBuf,
        /// Where in it.
        place: String,
        /// What is counted.
        what: &'static str,
        /// The limit.
        allowed: u64,
        /// What the file asks for.
        found: u64,
    },
}

impl Error {
    /// An [`Error::Invalid`].
    pub(crate) fn invalid(path: &Path, place: impl Display, message: impl Display) -> Self {
        Self::Invalid { path: path.to_owned(), place: place.to_string(), message: message.to_string() }
    }
}
