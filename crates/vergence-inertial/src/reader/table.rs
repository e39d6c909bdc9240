use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use flate2::read::MultiGzDecoder;

use crate::Error;

/// A longer line is no table's.
const LINE_BYTES: usize = 4096;

/// A text table, read line by line: header, then rows of numbers.
pub struct Table {
    path: PathBuf,
    input: Box<dyn BufRead>,
    compressed: bool,
    /// Comma, semicolon or tab: whatever the header has most of.
    separator: char,
    header: Vec<String>,
    line: u64,
    text: Vec<u8>,
}

impl Table {
    /// Opens the file, compressed by gzip where its first bytes say so, and reads its header.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let failed = |source| Error::Read { path: path.to_owned(), source };
        let mut input = BufReader::new(File::open(path).map_err(failed)?);
        let compressed = input.fill_buf().map_err(failed)?.starts_with(&[0x1f, 0x8b]);
        let input: Box<dyn BufRead> =
            if compressed { Box::new(BufReader::new(MultiGzDecoder::new(input))) } else { Box::new(input) };
        let mut table = Self {
            path: path.to_owned(),
            input,
            compressed,
            separator: ',',
            header: Vec::new(),
            line: 0,
            text: Vec::new(),
        };
        if !table.next_line()? {
            return Err(table.content(1, 1, "a header line", "an empty file"));
        }
        let header = std::str::from_utf8(&table.text)
            .map_err(|_| table.content(1, 1, "a header in UTF-8", "other bytes"))?
            .trim_start_matches('\u{feff}');
        let most =
            [';', '\t'].into_iter().find(|by| header.matches(*by).count() > header.matches(',').count());
        let separator = most.unwrap_or(',');
        let name = |name: &str| name.trim().trim_matches('"').to_owned();
        table.header = header.trim().split(separator).map(name).collect();
        table.separator = separator;
        Ok(table)
    }

    /// Names of the columns.
    pub fn header(&self) -> &[String] {
        &self.header
    }

    /// The line that was read last, from 1.
    pub const fn line(&self) -> u64 {
        self.line
    }

    /// The error that says what stands in `line` and `column` (both from 1).
    pub fn content(&self, line: u64, column: usize, expected: &str, found: impl std::fmt::Display) -> Error {
        Error::Content {
            path: self.path.clone(),
            line,
            column,
            expected: expected.to_owned(),
            found: found.to_string(),
        }
    }

    /// Reads the next line that is not empty; `false` at the end.
    fn next_line(&mut self) -> Result<bool, Error> {
        loop {
            self.text.clear();
            self.line += 1;
            let line = self.line;
            let limit = LINE_BYTES as u64 + 1;
            let mut limited = (&mut self.input).take(limit);
            match limited.read_until(b'\n', &mut self.text) {
                Ok(0) => {
                    self.line -= 1;
                    return Ok(false);
                }
                Ok(_) if self.text.len() > LINE_BYTES => {
                    let expected = format!("a line of at most {LINE_BYTES} bytes");
                    return Err(self.content(line, 1, &expected, "a longer one"));
                }
                Ok(_) => {}
                Err(source) if self.compressed => {
                    return Err(Error::Compressed { path: self.path.clone(), line, source });
                }
                Err(source) => return Err(Error::Read { path: self.path.clone(), source }),
            }
            while self.text.last().is_some_and(u8::is_ascii_whitespace) {
                self.text.pop();
            }
            if !self.text.is_empty() {
                return Ok(true);
            }
        }
    }

    /// Reads the next row into `values`, one number for each column (`nan` and `inf` are numbers; an empty cell is NaN, between semicolons a
    /// comma is a point); `false` at the end. The text of the first column is given to `first` before it is read as a number.
    pub fn row(&mut self, values: &mut Vec<f64>, mut first: impl FnMut(&str)) -> Result<bool, Error> {
        if !self.next_line()? {
            return Ok(false);
        }
        values.clear();
        let line = self.line;
        let Ok(text) = std::str::from_utf8(&self.text) else {
            return Err(self.content(line, 1, "numbers", "bytes that are no text"));
        };
        for (index, cell) in text.split(self.separator).enumerate() {
            let cell = cell.trim();
            if index == 0 {
                first(cell);
            }
            let value = if cell.is_empty() && index > 0 {
                Ok(f64::NAN)
            } else if self.separator == ';' && cell.contains(',') {
                cell.replace(',', ".").parse()
            } else {
                cell.parse::<f64>()
            };
            let Ok(value) = value else {
                let shown: String = cell.chars().take(40).collect();
                return Err(self.content(line, index + 1, "a number", format!("'{shown}'")));
            };
            values.push(value);
        }
        if values.len() != self.header.len() {
            let expected = format!("{} columns as in the header", self.header.len());
            let found = values.len();
            return Err(self.content(
                line,
                found.min(self.header.len()) + usize::from(found > self.header.len()),
                &expected,
                found,
            ));
        }
        Ok(true)
    }
}
