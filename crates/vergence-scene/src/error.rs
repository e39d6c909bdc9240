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
    #[error("{}: {message}", Named(path, place))]
    Invalid {
        /// Which file.
        path: PathBuf,
        /// Where in it: `line:column`, counted from 1; a JSON path, `accessors[3]`; a byte.
        place: String,
        /// What was expected and what was found.
        message: String,
    },
    /// A file that another one names is not there.
    #[error("{}: expected a file, found {wanted:?}: {source}", Named(path, place))]
    Missing {
        /// Which file names it.
        path: PathBuf,
        /// Where in that.
        place: String,
        /// The name.
        wanted: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// Loading would take more than [`crate::Limits`] allow.
    #[error("{}: expected at most {allowed} {what}, found {found}", Named(path, place))]
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

/// A file and a place in it: `file:line:column`, or `file: accessors[3]`.
struct Named<'a>(&'a Path, &'a str);

impl Display for Named<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self(path, place) = self;
        let between = if place.starts_with(|first: char| first.is_ascii_digit()) { ":" } else { ": " };
        write!(f, "{}{between}{place}", path.display())
    }
}
