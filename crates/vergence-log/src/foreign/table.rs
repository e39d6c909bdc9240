//! Tables in text: a header, then rows whose first column is time.

use std::collections::HashSet;

use vergence_time::Timestamp;

use super::Cells;

/// Columns are at most this many.
const MOST_COLUMNS: usize = 4096;
/// Text that is read, at most, bytes.
const MOST_BYTES: u64 = 4 << 30;

/// A column of a [`Table`].
#[derive(Clone, Debug, PartialEq)]
pub struct TableColumn {
    /// As the header has it; a second column of one name has `_2` behind it.
    pub name: String,
    /// One for each row: whole numbers where all are, else floating point where all are (an empty cell is NaN), else text.
    pub cells: Cells,
}

/// What a table holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// When each row was captured.
    pub captured: Vec<Timestamp>,
    /// When each row arrived, where a second column `arrived_ns` follows `captured_ns`, as exporters of this crate write them.
    pub arrived: Option<Vec<Timestamp>>,
    /// The columns behind the times.
    pub columns: Vec<TableColumn>,
    /// Names that the header has twice, in sentences.
    pub renamed: Vec<String>,
}

/// What is wrong with a table, and where.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{line}:{column}: expected {expected}, found {found}")]
pub struct TableError {
    /// Line, from 1.
    pub line: u64,
    /// Column, from 1.
    pub column: usize,
    /// What would have been right.
    pub expected: String,
    /// What was there.
    pub found: String,
}

/// What a text was, shortened.
fn shown(text: &str) -> String {
    format!("{:?}", text.chars().take(40).collect::<String>())
}

/// How many digits of a unit of the name's ending are a nanosecond's: `t_ms` is in milliseconds; without such an ending it is seconds.
fn digits(name: &str) -> u32 {
    match name.rsplit_once('_') {
        Some((_, "ns")) => 0,
        Some((_, "us")) => 3,
        Some((_, "ms")) => 6,
        _ => 9,
    }
}

/// One column while it is read.
struct Gathered {
    name: String,
    cells: Cells,
}

impl Gathered {
    /// Takes one more cell, as the narrowest kind that holds all so far. Text keeps its own words; numbers that turn out to be text
    /// are read again from `words`.
    fn push(&mut self, word: &str) -> Result<(), ()> {
        match &mut self.cells {
            Cells::Integers(all) => {
                // Words such as 007 and +1 would not come back as they were.
                match word.parse::<i64>() {
                    Ok(whole) if whole.to_string() == word => all.push(whole),
                    _ => {
                        let wide: Option<Vec<f64>> = all.iter().map(|x| exact(*x)).collect();
                        self.cells = Cells::Numbers(wide.ok_or(())?);
                        return self.push(word);
                    }
                }
            }
            Cells::Numbers(all) => {
                let number = if word.is_empty() { Some(f64::NAN) } else { word.parse().ok() };
                all.push(number.ok_or(())?);
            }
            Cells::Texts(all) => all.push(word.to_owned()),
        }
        Ok(())
    }
}

/// The same number as floating point, where it is one.
fn exact(whole: i64) -> Option<f64> {
    (whole.unsigned_abs() <= 1 << 53).then_some(whole as f64)
}

impl Table {
    /// Reads a table: names in the first line; commas, semicolons or tabs between cells, whichever the first line has most of; quotes as in
    /// RFC 4180. The first column is time: seconds, or as its name ends in `_ns`, `_us`, `_ms`.
    ///
    /// # Errors
    /// Line and column of the first fault: text that is not UTF-8, no header, more than 4096 columns, a row that is longer or shorter
    /// than the header, a time that is none.
    pub fn parse(text: &[u8]) -> Result<Self, TableError> {
        let fault = |line: u64, column: usize, expected: &str, found: String| TableError {
            line,
            column,
            expected: expected.to_owned(),
            found,
        };
        if text.len() as u64 > MOST_BYTES {
            return Err(fault(1, 1, "at most 4 GiB", format!("{} bytes", text.len())));
        }
        let text = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(text);
        let first = text.split(|byte| *byte == b'\n').next().unwrap_or_default();
        let count = |separator: &u8| first.iter().filter(|byte| *byte == separator).count();
        let separator = [b',', b';', b'\t'].into_iter().rev().max_by_key(count).unwrap_or(b',');
        // Twice: a column's kind is known at its end only, and what was read as a number may turn out to be text.
        let mut is_text = HashSet::new();
        loop {
            match Self::read(text, separator, &is_text)? {
                Ok(table) => return Ok(table),
                Err(more) => is_text.extend(more),
            }
        }
    }

    /// The table, or which columns are text besides those of `is_text`.
    fn read(
        text: &[u8],
        separator: u8,
        is_text: &HashSet<usize>,
    ) -> Result<Result<Self, HashSet<usize>>, TableError> {
        let mut reader =
            csv::ReaderBuilder::new().trim(csv::Trim::All).delimiter(separator).from_reader(text);
        let wrong = |error: csv::Error| {
            let line = error.position().map_or(1, csv::Position::line);
            let (expected, found) = match error.kind() {
                csv::ErrorKind::UnequalLengths { expected_len, len, .. } => {
                    (format!("{expected_len} columns"), len.to_string())
                }
                csv::ErrorKind::Utf8 { .. } => ("text in UTF-8".to_owned(), "other bytes".to_owned()),
                _ => ("a table".to_owned(), error.to_string()),
            };
            TableError { line, column: 1, expected, found }
        };
        let header = reader.headers().map_err(wrong)?.clone();
        let width = header.len();
        if !(2..=MOST_COLUMNS).contains(&width) {
            let expected = "a header of 2 to 4096 columns".to_owned();
            return Err(TableError { line: 1, column: 1, expected, found: width.to_string() });
        }
        let has_arrived = width > 2 && &header[0] == "captured_ns" && &header[1] == "arrived_ns";
        let times = if has_arrived { 2 } else { 1 };
        let mut table = Self { arrived: has_arrived.then(Vec::new), ..Self::default() };
        let mut names = HashSet::new();
        let mut gathered = Vec::with_capacity(width);
        for (place, given) in header.iter().enumerate().skip(times) {
            let mut name = given.to_owned();
            let mut number = 2;
            while !names.insert(name.clone()) {
                name = format!("{given}_{number}");
                number += 1;
            }
            if name != given {
                table.renamed.push(format!(
                    "1:{}: the second column {} is called {}",
                    place + 1,
                    shown(given),
                    shown(&name)
                ));
            }
            let cells =
                if is_text.contains(&place) { Cells::Texts(Vec::new()) } else { Cells::Integers(Vec::new()) };
            gathered.push(Gathered { name, cells });
        }
        let digits = digits(&header[0]);
        let mut more = HashSet::new();
        let mut row = csv::StringRecord::new();
        while reader.read_record(&mut row).map_err(wrong)? {
            let line = row.position().map_or(0, csv::Position::line);
            for place in 0..times {
                let word = row.get(place).unwrap_or_default();
                let digits = if place == 0 { digits } else { 0 };
                let at = Timestamp::from_decimal(word, digits).ok_or_else(|| TableError {
                    line,
                    column: place + 1,
                    expected: "a time".to_owned(),
                    found: shown(word),
                })?;
                match &mut table.arrived {
                    Some(arrived) if place == 1 => arrived.push(at),
                    _ => table.captured.push(at),
                }
            }
            for (place, column) in gathered.iter_mut().enumerate() {
                let word = row.get(place + times).unwrap_or_default();
                if !more.contains(&(place + times)) && column.push(word).is_err() {
                    more.insert(place + times);
                }
            }
        }
        if !more.is_empty() {
            return Ok(Err(more));
        }
        table.columns =
            gathered.into_iter().map(|Gathered { name, cells }| TableColumn { name, cells }).collect();
        Ok(Ok(table))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_as_wide_as_they_must_be() {
        let text = "\u{feff}t_ms,whole,real,word,\"a, b\",real\n1.5,1,,7,-0.0,1e300\r\n2,-3,0.1,P01,3,\"9007199254740993\"\n";
        let table = Table::parse(text.as_bytes()).unwrap();
        assert_eq!(table.captured.iter().map(|at| at.as_nanos()).collect::<Vec<_>>(), [1_500_000, 2_000_000]);
        let names: Vec<&str> = table.columns.iter().map(|column| &column.name[..]).collect();
        assert_eq!(names, ["whole", "real", "word", "a, b", "real_2"]);
        assert_eq!(table.columns[0].cells, Cells::Integers(vec![1, -3]));
        assert!(matches!(&table.columns[1].cells, Cells::Numbers(x) if x[0].is_nan() && x[1] == 0.1));
        assert_eq!(table.columns[2].cells, Cells::Texts(vec!["7".into(), "P01".into()]));
        assert_eq!(table.renamed, ["1:6: the second column \"real\" is called \"real_2\""]);
        let ours = Table::parse(b"captured_ns;arrived_ns;x\n-5;7;1\n").unwrap();
        assert_eq!((ours.captured[0].as_nanos(), ours.arrived.unwrap()[0].as_nanos()), (-5, 7));
    }

    #[test]
    fn what_is_wrong_has_a_place() {
        for (text, expected) in [
            (&b""[..], "1:1: expected a header of 2 to 4096 columns, found 0"),
            (b"t\n1\n", "1:1: expected a header of 2 to 4096 columns, found 1"),
            (b"t,x\n1,2\nsoon,3\n", "3:1: expected a time, found \"soon\""),
            (b"t,x\n1,2,3\n", "2:1: expected 2 columns, found 3"),
            (b"t,x\n1,\xff\n", "2:1: expected text in UTF-8, found other bytes"),
            (b"t_ns,x\n99999999999999999999,1\n", "2:1: expected a time, found \"99999999999999999999\""),
        ] {
            assert_eq!(Table::parse(text).unwrap_err().to_string(), expected);
        }
    }
}
