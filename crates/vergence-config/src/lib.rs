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
    parse(path, &read_text(path)?)
}

/// Reads the text of the file at `path`: for owners who check values after parsing ([`invalid_key`]).
///
/// # Errors
/// Where it cannot be read or is larger than [`MAX_FILE_BYTES`].
pub fn read_text(path: &Path) -> Result<String, Error> {
    let io = |source| Error::Io { path: path.to_owned(), source };
    let found = std::fs::metadata(path).map_err(io)?.len();
    if found > MAX_FILE_BYTES {
        return Err(Error::TooLarge { path: path.to_owned(), found });
    }
    std::fs::read_to_string(path).map_err(io)
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

/// An [`Error::Invalid`] for the value of `key` in `text`: names with points between them, and numbers, from 0, for
/// places in arrays (`left.fov`, `head.2.time`). Where there is no such value, the nearest around it is the place.
pub fn invalid_key(path: &Path, text: &str, key: &str, message: &str) -> Error {
    let root = toml::de::DeTable::parse(text).ok();
    let mut place = 0;
    let mut value: Option<&toml::de::DeValue<'_>> = None;
    for name in key.split('.') {
        let inner = match (value, &root) {
            (None, Some(root)) => root.get_ref().get(name),
            (Some(toml::de::DeValue::Table(table)), _) => table.get(name),
            (Some(toml::de::DeValue::Array(array)), _) => {
                name.parse::<usize>().ok().and_then(|index| array.get(index))
            }
            _ => None,
        };
        let Some(inner) = inner else { break };
        place = inner.span().start;
        value = Some(inner.get_ref());
    }
    invalid_at(path, text, place, message)
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
    fn values_are_found_by_their_keys() {
        let text = "a = 1\n[[list]]\nx = 1\n[[list]]\nx = 2\n[t]\nfov = { left = [0, 7] }\n";
        for (key, place) in [
            ("a", "1:5"),
            ("list.1.x", "5:5"),
            ("t.fov", "7:7"),
            ("t.fov.left.1", "7:20"),
            // What is not there is around.
            ("t.fov.right", "7:7"),
            ("list.2.x", "2:1"),
            ("none.x", "1:1"),
        ] {
            let error = invalid_key(Path::new("a.toml"), text, key, "no").to_string();
            assert_eq!(error, format!("a.toml:{place}: no"), "{key}");
        }
    }

    #[test]
    fn a_missing_file_is_named() {
        let error = read::<Raw>(Path::new("no/such/file.toml")).unwrap_err();
        assert!(error.to_string().starts_with("no/such/file.toml: "), "{error}");
    }
}
