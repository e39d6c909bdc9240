//! Paths: strings that the application exchanges for numbers.

use std::collections::HashMap;

use openxr_sys as sys;

use crate::ffi::{Buffer, Out, XrResult, text};
use crate::instance::Instance;

/// How many paths one instance may make.
const MOST_PATHS: usize = 1 << 16;

/// The paths of one instance.
#[derive(Default)]
pub(crate) struct Paths {
    texts: Vec<String>,
    numbers: HashMap<String, u64>,
}

impl Paths {
    /// The number of a well-formed path.
    pub(crate) fn intern(&mut self, path: &str) -> XrResult<sys::Path> {
        if let Some(&number) = self.numbers.get(path) {
            return Ok(sys::Path::from_raw(number));
        }
        if !well_formed(path) {
            return Err(sys::Result::ERROR_PATH_FORMAT_INVALID);
        }
        if self.texts.len() >= MOST_PATHS {
            return Err(sys::Result::ERROR_PATH_COUNT_EXCEEDED);
        }
        self.texts.push(path.to_owned());
        let number = self.texts.len() as u64;
        self.numbers.insert(path.to_owned(), number);
        Ok(sys::Path::from_raw(number))
    }

    /// The text of a path that this instance made.
    pub(crate) fn text(&self, path: sys::Path) -> XrResult<&str> {
        let index = path.into_raw().checked_sub(1).and_then(|index| usize::try_from(index).ok());
        index
            .and_then(|index| self.texts.get(index))
            .map(String::as_str)
            .ok_or(sys::Result::ERROR_PATH_INVALID)
    }
}

/// "Well-formed path strings" of the specification: `/` before each level, no empty or dotted-only level, lower-case
/// letters, digits, `-`, `_` and `.`.
fn well_formed(path: &str) -> bool {
    let allowed = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || matches!(c, '-' | '_' | '.');
    path.len() < sys::MAX_PATH_LENGTH
        && path.strip_prefix('/').is_some_and(|levels| {
            levels.split('/').all(|level| level.chars().all(allowed) && level.chars().any(|c| c != '.'))
        })
}

pub(crate) fn string_to_path(
    instance: &Instance,
    string: *const std::ffi::c_char,
    mut out: Out<sys::Path>,
) -> XrResult {
    out.check()?;
    // SAFETY: the application hands over a zero-terminated string or null.
    let string = unsafe { text(string, usize::MAX) }?;
    out.set(instance.lock().paths.intern(string)?)?;
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn path_to_string(
    instance: &Instance,
    path: sys::Path,
    mut buffer: Buffer<std::ffi::c_char>,
) -> XrResult {
    let text = instance.lock().paths.text(path)?.to_owned();
    buffer.give_text(&text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_round_trip_and_malformed_ones_are_refused() {
        let mut paths = Paths::default();
        let path = paths.intern("/user/hand/left").unwrap();
        assert_eq!(paths.intern("/user/hand/left"), Ok(path));
        assert_eq!(paths.text(path), Ok("/user/hand/left"));
        for wrong in ["", "user", "/", "/user/", "/User", "/user//hand", "/..", "/a/...", "/a b", "/ü"] {
            assert_eq!(paths.intern(wrong), Err(sys::Result::ERROR_PATH_FORMAT_INVALID), "{wrong}");
        }
        assert_eq!(paths.text(sys::Path::NULL), Err(sys::Result::ERROR_PATH_INVALID));
        assert_eq!(paths.text(sys::Path::from_raw(99)), Err(sys::Result::ERROR_PATH_INVALID));
        assert!(paths.intern(&format!("/{}", "a".repeat(300))).is_err());
    }
}
