#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod quantity;

use std::path::{Path, PathBuf};

pub use quantity::{Angle, Duration, Frequency, Length};

/// Largest configuration file that is read, in bytes.
pub const MAX_FILE_BYTES: u64 = 16 << 20;

/// Why a configuration cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file cannot be read.
    #[error("{path}: {source}")]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is larger than [`MAX_FILE_BYTES`].
    #[error("{path}: expected at most {MAX_FILE_BYTES} bytes, found {found}")]
    TooLarge {
        /// Which file.
        path: PathBuf,
        /// Its size in bytes.
        found: u64,
    },
    /// A place in the file is wrong.
    #[error("{path}:{line}:{column}: {message}")]
    Invalid {
        /// Which file.
        path: PathBuf,
        /// Counted from 1.
        line: usize,
        /// Counted from 1, in characters.
        column: usize,
        /// What was expected and what was found.
        message: String,
    },
}

/// Reads and parses the file at `path`.
///
/// # Errors
/// Where it cannot be read, is larger than [`MAX_FILE_BYTES`], or does not parse (see [`parse`]).
pub fn read<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, Error> {
    let io = |source| Error::Io { path: path.to_owned(), source };
    let found = std::fs::metadata(path).map_err(io)?.len();
    if found > MAX_FILE_BYTES {
        return Err(Error::TooLarge { path: path.to_owned(), found });
    }
    parse(path, &std::fs::read_to_string(path).map_err(io)?)
}

/// Parses `text`, naming `path` in errors.
///
/// # Errors
/// Where the text is not TOML, a key is unknown or missing, or a value is not what was expected.
pub fn parse<T: serde::de::DeserializeOwned>(path: impl AsRef<Path>, text: &str) -> Result<T, Error> {
    toml::from_str(text).map_err(|error| {
        let offset = error.span().map_or(0, |span| span.start);
        invalid_at(path.as_ref(), text, offset, error.message().trim_end())
    })
}

/// An [`Error::Invalid`] for the byte `offset` in `text`: for checks that an owner makes after parsing.
pub fn invalid_at(path: &Path, text: &str, offset: usize, message: &str) -> Error {
    let before = text.get(..offset).unwrap_or(text);
    let line = before.matches('\n').count() + 1;
    let column = before.chars().rev().take_while(|&c| c != '\n').count() + 1;
    Error::Invalid { path: path.to_owned(), line, column, message: message.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    #[allow(dead_code)]
    struct Raw {
        rate: Frequency,
        fov: Angle,
    }

    #[test]
    fn errors_name_file_line_and_column() {
        let unknown = parse::<Raw>("a.toml", "rate = \"90 Hz\"\nfov = \"1 rad\"\n\nfvo = 3\n").unwrap_err();
        assert!(unknown.to_string().starts_with("a.toml:4:1: unknown field `fvo`"), "{unknown}");
        let missing = parse::<Raw>("a.toml", "rate = \"90 Hz\"").unwrap_err();
        assert!(missing.to_string().contains("missing field `fov`"), "{missing}");
        let syntax = parse::<Raw>("a.toml", "rate = ").unwrap_err();
        assert!(syntax.to_string().starts_with("a.toml:1:8"), "{syntax}");
    }

    #[test]
    fn a_missing_file_is_named() {
        let error = read::<Raw>(Path::new("no/such/file.toml")).unwrap_err();
        assert!(error.to_string().starts_with("no/such/file.toml: "), "{error}");
    }
}
