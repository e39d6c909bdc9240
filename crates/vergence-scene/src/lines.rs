//! Text formats line by line: words and numbers with their places.

use std::path::Path;

use crate::Error;
use crate::import::Import;

/// The lines of a text; a backslash at the end of a line joins it with the next one.
pub(crate) struct Lines<'a> {
    path: &'a Path,
    bytes: &'a [u8],
    at: usize,
    number: usize,
}

/// One line (or several joined ones) and how far it has been read.
pub(crate) struct Line<'a> {
    path: &'a Path,
    bytes: &'a [u8],
    at: usize,
    /// Of the physical line at `at`, and where it starts.
    number: usize,
    start: usize,
}

impl<'a> Lines<'a> {
    pub(crate) fn new(path: &'a Path, bytes: &'a [u8]) -> Self {
        // Some editors put a mark before the first character.
        let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
        Self { path, bytes, at: 0, number: 0 }
    }

    /// The next line that is neither empty nor a comment.
    pub(crate) fn next_line(&mut self) -> Option<Line<'a>> {
        while self.at < self.bytes.len() {
            let start = self.at;
            let first = self.number + 1;
            let mut end = start;
            loop {
                let rest = &self.bytes[end..];
                end += rest.iter().position(|&b| b == b'\n').map_or(rest.len(), |at| at + 1);
                self.number += 1;
                let joined = self.bytes[start..end].trim_ascii_end().ends_with(b"\\");
                if !joined || end == self.bytes.len() {
                    break;
                }
            }
            self.at = end;
            let bytes = &self.bytes[start..end];
            if !matches!(bytes.trim_ascii_start().first(), None | Some(b'#')) {
                return Some(Line { path: self.path, bytes, at: 0, number: first, start: 0 });
            }
        }
        None
    }
}

fn is_space(byte: u8) -> bool {
    byte.is_ascii_whitespace() || byte == 0x0B
}

impl<'a> Line<'a> {
    pub(crate) fn path(&self) -> &'a Path {
        self.path
    }

    /// Where the next word starts, as `line:column`, counted from 1.
    pub(crate) fn place(&self) -> String {
        let spaces = self.bytes[self.at..].iter().take_while(|&&b| b == b' ' || b == b'\t').count();
        format!("{}:{}", self.number, self.at + spaces - self.start + 1)
    }

    fn skip_spaces(&mut self) {
        while let Some(&byte) = self.bytes.get(self.at) {
            // The backslash of a joined line is followed by nothing but its end.
            let joins =
                byte == b'\\' && self.bytes[self.at + 1..].first().is_none_or(|&b| b == b'\r' || b == b'\n');
            if !is_space(byte) && !joins {
                break;
            }
            self.at += 1;
            if byte == b'\n' {
                self.number += 1;
                self.start = self.at;
            }
        }
    }

    /// The next word; `None` at the end of the line or where a comment starts.
    pub(crate) fn word(&mut self) -> Option<&'a [u8]> {
        self.word_and_place().map(|(word, _)| word)
    }

    /// The next word and where it starts.
    pub(crate) fn word_and_place(&mut self) -> Option<(&'a [u8], WordPlace)> {
        self.skip_spaces();
        let rest = &self.bytes[self.at..];
        let end = rest.iter().position(|&b| is_space(b)).unwrap_or(rest.len());
        let mut word = &rest[..end];
        if word.first().is_none_or(|&b| b == b'#') {
            return None;
        }
        if let [head @ .., b'\\'] = word
            && rest.get(end).is_none_or(|&b| b == b'\n' || b == b'\r')
            && !head.is_empty()
        {
            word = head;
        }
        let place = WordPlace { line: self.number, column: self.at - self.start + 1 };
        self.at += word.len();
        Some((word, place))
    }

    /// What is left of the line, without spaces at its ends.
    pub(crate) fn rest(&mut self) -> String {
        self.skip_spaces();
        let rest = self.bytes[self.at..].trim_ascii_end();
        self.at = self.bytes.len();
        String::from_utf8_lossy(rest).into_owned()
    }

    /// A finite number.
    pub(crate) fn number(&mut self, import: &mut Import<'_>) -> Result<f32, Error> {
        let place = self.place();
        match self.optional_number(import)? {
            Some(number) => Ok(number),
            None => Err(Error::invalid(self.path, place, "expected a number, found the end of the line")),
        }
    }

    /// A finite number, or `None` at the end of the line.
    pub(crate) fn optional_number(&mut self, import: &mut Import<'_>) -> Result<Option<f32>, Error> {
        let Some((word, place)) = self.word_and_place() else { return Ok(None) };
        number(import, word).map(Some).ok_or_else(|| {
            let shown = String::from_utf8_lossy(&word[..word.len().min(40)]);
            Error::invalid(self.path, place, format!("expected a number up to 3.4e38, found {shown:?}"))
        })
    }
}

/// Line and column of a word, counted from 1.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WordPlace {
    line: usize,
    column: usize,
}

impl std::fmt::Display for WordPlace {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}:{}", self.line, self.column)
    }
}

/// A number as people write it: with a sign, with or without digits behind the point. Two spellings that are seen
/// though wrong are read with a warning: a decimal comma, and the exponent's sign before its letter.
pub(crate) fn number(import: &mut Import<'_>, word: &[u8]) -> Option<f32> {
    let text = std::str::from_utf8(word).ok()?;
    // Rust also reads "inf" and "nan", which are no places.
    let parse = |text: &str| text.parse::<f32>().ok().filter(|number| number.is_finite());
    if let Some(number) = parse(text) {
        return Some(number);
    }
    let is_digit_before = |at: usize| at > 0 && text.as_bytes()[at - 1].is_ascii_digit();
    if let Some(at) = text.find(',').filter(|&at| is_digit_before(at))
        && let Some(number) = parse(&format!("{}.{}", &text[..at], &text[at + 1..]))
    {
        import.warn("numbers with a decimal comma are read as if it were a point");
        return Some(number);
    }
    let at = text.find("+e").or_else(|| text.find("-e")).filter(|&at| is_digit_before(at))?;
    let number = parse(&format!("{}e{}{}", &text[..at], &text[at..at + 1], &text[at + 2..]))?;
    import.warn("numbers such as 3.1+e2 are read as 3.1e+2");
    Some(number)
}

/// The sRGB transfer function: a colour value as stored (0…1) to linear light.
pub fn linear_from_srgb(value: f32) -> f32 {
    let value = value.clamp(0.0, 1.0);
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}
