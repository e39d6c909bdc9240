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
    /// What was taken otherwise than it may have been meant, in sentences with line and column: a time without a unit, a name that the
    /// header has twice, a column that is numbers but for a few words.
    pub notes: Vec<String>,
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

/// In which unit a column of time is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeUnit {
    /// Seconds.
    S,
    /// Milliseconds.
    Ms,
    /// Microseconds.
    Us,
    /// Nanoseconds.
    Ns,
}

impl TimeUnit {
    /// How many digits of the unit are a nanosecond's.
    const fn digits(self) -> u32 {
        match self {
            Self::S => 9,
            Self::Ms => 6,
            Self::Us => 3,
            Self::Ns => 0,
        }
    }

    fn named(word: &str) -> Option<Self> {
        match word {
            "s" | "sec" | "secs" | "second" | "seconds" => Some(Self::S),
            "ms" | "msec" | "msecs" | "millis" | "millisecond" | "milliseconds" => Some(Self::Ms),
            // Micro sign and Greek mu look alike.
            "us" | "\u{b5}s" | "\u{3bc}s" | "usec" | "usecs" | "micros" | "microsecond" | "microseconds" => {
                Some(Self::Us)
            }
            "ns" | "nsec" | "nsecs" | "nanos" | "nanosecond" | "nanoseconds" => Some(Self::Ns),
            _ => None,
        }
    }
}

/// What the name of the first column says of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Said {
    /// Time, in this unit.
    Time(TimeUnit),
    /// Time, and not in which unit.
    Unitless,
    /// Time in a unit that is none of ours, or no time at all.
    Other,
}

/// Reads a name as `t_ms`, `Time [ms]`, `Timestamp (us)`, `timeMs`, `ms`: words and, last, a unit.
fn said(name: &str) -> Said {
    let mut words: Vec<String> = Vec::new();
    let (mut is_within, mut was_lower) = (false, false);
    for letter in name.chars() {
        if !letter.is_alphanumeric() {
            is_within = false;
            continue;
        }
        let starts = !is_within || (was_lower && letter.is_uppercase());
        (is_within, was_lower) = (true, letter.is_lowercase());
        let lower = letter.to_lowercase();
        match words.last_mut().filter(|_| !starts) {
            Some(word) => word.extend(lower),
            None => words.push(lower.collect()),
        }
    }
    let is_time = |word: &String| {
        ["t", "captured", "elapsed", "onset", "clock", "unix", "epoch", "since"].contains(&&word[..])
            || ["time", "stamp", "zeit"].iter().any(|part| word.contains(part))
    };
    let unit = words.last().and_then(|last| TimeUnit::named(last));
    match unit {
        Some(unit) if words.len() == 1 || words.iter().any(is_time) => Said::Time(unit),
        // `Time [min]` has a unit, and `m_s` is one of speed.
        None if words.last().is_some_and(is_time) => Said::Unitless,
        _ => Said::Other,
    }
}

/// A number, or nothing; `1e400` is none.
fn number(word: &str) -> Option<f64> {
    let number: f64 = word.parse().ok()?;
    // Infinity is a word with letters.
    (number.is_finite() || number.is_nan() || word.contains(['n', 'N'])).then_some(number)
}

/// Whether a word is digits with one `mark` between or before them, and nothing else but a sign and an exponent.
fn has_mark(word: &str, mark: char) -> bool {
    word.split_once(mark).is_some_and(|(whole, rest)| {
        let whole = whole.strip_prefix(['+', '-']).unwrap_or(whole);
        let rest = rest.find(['e', 'E']).map_or(rest, |at| match rest[at + 1..].parse::<i32>() {
            Ok(_) => &rest[..at],
            Err(_) => "",
        });
        !rest.is_empty() && whole.bytes().chain(rest.bytes()).all(|byte| byte.is_ascii_digit())
    })
}

/// One column while it is read.
struct Gathered {
    name: String,
    cells: Cells,
    /// How many of its cells are numbers, how many no numbers (and not empty), and the first of these with its line.
    numbers: u64,
    others: u64,
    first_other: Option<(u64, String)>,
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
                let number = if word.is_empty() { Some(f64::NAN) } else { number(word) };
                all.push(number.ok_or(())?);
            }
            Cells::Texts(all) => all.push(word.to_owned()),
        }
        Ok(())
    }

    /// Counts a cell of a column that turned out to be text.
    fn judge(&mut self, line: u64, word: &str) {
        if word.is_empty() {
        } else if number(word).is_some() {
            self.numbers += 1;
        } else {
            self.others += 1;
            self.first_other.get_or_insert_with(|| (line, shown(word)));
        }
    }
}

/// Lines by the bytes in front of them: the reader's own count is one short where lines end in CR LF, and behind empty lines.
struct Lines<'a> {
    text: &'a [u8],
    at: usize,
    line: u64,
}

impl Lines<'_> {
    /// The line of the record that is found from this byte on, no earlier than the one before.
    fn of(&mut self, byte: u64) -> u64 {
        let mut end = usize::try_from(byte).unwrap_or(usize::MAX).clamp(self.at, self.text.len());
        while self.text.get(end).is_some_and(|byte| matches!(byte, b'\r' | b'\n')) {
            end += 1;
        }
        let passed = &self.text[self.at..end];
        let ends = passed.iter().filter(|byte| **byte == b'\n').count();
        // A lone CR ends a line, too.
        let lone = passed.iter().zip(passed[1.min(passed.len())..].iter().chain(&[0]));
        let lone = lone.filter(|(byte, next)| **byte == b'\r' && **next != b'\n').count();
        (self.at, self.line) = (end, self.line + (ends + lone) as u64);
        self.line
    }
}

/// The same number as floating point, where it is one.
fn exact(whole: i64) -> Option<f64> {
    (whole.unsigned_abs() <= 1 << 53).then_some(whole as f64)
}

/// How a table is written.
#[derive(Clone, Copy)]
struct Form {
    separator: u8,
    unit: Option<TimeUnit>,
    has_decimal_commas: bool,
}

/// Whether the table's numbers have decimal commas: some have a comma in them, and none a point.
fn decimal_commas(text: &[u8], separator: u8) -> bool {
    if separator == b',' || !text.contains(&b',') {
        return false;
    }
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .delimiter(separator)
        .flexible(true)
        .has_headers(false)
        .from_reader(text);
    let mut row = csv::StringRecord::new();
    let mut found = false;
    // What cannot be read is said when it is read for good.
    while reader.read_record(&mut row).unwrap_or(false) {
        for word in &row {
            if has_mark(word, '.') {
                return false;
            }
            found |= has_mark(word, ',');
        }
    }
    found
}

impl Table {
    /// Reads a table: names in the first line; commas, semicolons or tabs between cells, whichever the first line has most of; quotes as in
    /// RFC 4180. Where cells are not separated by commas, numbers may have decimal commas. The first column is time, in `unit` or, where
    /// there is none, in what its name says (`t_ms`, `Time [ms]`); a time without a unit is seconds.
    ///
    /// # Errors
    /// Line and column of the first fault: text that is not UTF-8, no header, more than 4096 columns, a first column whose name says
    /// nothing of time, a row that is longer or shorter than the header, a time that is none.
    pub fn parse(text: &[u8], unit: Option<TimeUnit>) -> Result<Self, TableError> {
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
        let first = text.split(|byte| matches!(byte, b'\n' | b'\r')).next().unwrap_or_default();
        let count = |separator: &u8| first.iter().filter(|byte| *byte == separator).count();
        let separator = [b',', b';', b'\t'].into_iter().rev().max_by_key(count).unwrap_or(b',');
        let form = Form { separator, unit, has_decimal_commas: decimal_commas(text, separator) };
        // Twice: a column's kind is known at its end only, and what was read as a number may turn out to be text.
        let mut is_text = HashSet::new();
        loop {
            match Self::read(text, form, &is_text)? {
                Ok(table) => return Ok(table),
                Err(more) => is_text.extend(more),
            }
        }
    }

    /// The table, or which columns are text besides those of `is_text`.
    fn read(
        text: &[u8],
        form: Form,
        is_text: &HashSet<usize>,
    ) -> Result<Result<Self, HashSet<usize>>, TableError> {
        let mut reader =
            csv::ReaderBuilder::new().trim(csv::Trim::All).delimiter(form.separator).from_reader(text);
        let wrong = |error: csv::Error| {
            let mut lines = Lines { text, at: 0, line: 1 };
            let line = error.position().map_or(1, |place| lines.of(place.byte()));
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
                table.notes.push(format!(
                    "1:{}: the second column {} is called {}",
                    place + 1,
                    shown(given),
                    shown(&name)
                ));
            }
            let cells =
                if is_text.contains(&place) { Cells::Texts(Vec::new()) } else { Cells::Integers(Vec::new()) };
            gathered.push(Gathered { name, cells, numbers: 0, others: 0, first_other: None });
        }
        let unit = match (form.unit, said(&header[0])) {
            (Some(unit), _) | (None, Said::Time(unit)) => unit,
            (None, Said::Unitless) => {
                table.notes.push(format!("1:1: {} is taken for seconds", shown(&header[0])));
                TimeUnit::S
            }
            (None, Said::Other) => {
                let expected = "a first column of time, such as t_s, Time [ms], timestamp_us or captured_ns";
                let found = shown(&header[0]);
                return Err(TableError { line: 1, column: 1, expected: expected.to_owned(), found });
            }
        };
        let digits = unit.digits();
        let point = |word: &str| -> Option<String> {
            (form.has_decimal_commas && has_mark(word, ',')).then(|| word.replace(',', "."))
        };
        let mut lines = Lines { text, at: 0, line: 1 };
        let mut more = HashSet::new();
        let mut row = csv::StringRecord::new();
        while reader.read_record(&mut row).map_err(wrong)? {
            let line = lines.of(row.position().map_or(0, csv::Position::byte));
            for place in 0..times {
                let written = row.get(place).unwrap_or_default();
                let pointed = point(written);
                let word = pointed.as_deref().unwrap_or(written);
                let digits = if place == 0 { digits } else { 0 };
                let at = Timestamp::from_decimal(word, digits).ok_or_else(|| TableError {
                    line,
                    column: place + 1,
                    expected: "a time".to_owned(),
                    found: shown(written),
                })?;
                match &mut table.arrived {
                    Some(arrived) if place == 1 => arrived.push(at),
                    _ => table.captured.push(at),
                }
            }
            for (place, column) in gathered.iter_mut().enumerate() {
                let written = row.get(place + times).unwrap_or_default();
                let pointed = point(written);
                let is_text = matches!(column.cells, Cells::Texts(_));
                if is_text {
                    column.judge(line, pointed.as_deref().unwrap_or(written));
                }
                // Text keeps its own words.
                let word = pointed.as_deref().filter(|_| !is_text).unwrap_or(written);
                if !more.contains(&(place + times)) && column.push(word).is_err() {
                    more.insert(place + times);
                }
            }
        }
        if !more.is_empty() {
            return Ok(Err(more));
        }
        for (place, column) in gathered.iter().enumerate() {
            if let (Some((line, word)), true) = (&column.first_other, column.numbers > column.others) {
                let (name, others) = (shown(&column.name), column.others);
                let many = if others == 1 { "cell is" } else { "cells are" };
                table.notes.push(format!(
                    "{line}:{}: {name} is kept as text: {others} {many} no number, the first {word}",
                    place + times + 1
                ));
            }
        }
        table.columns =
            gathered.into_iter().map(|Gathered { name, cells, .. }| TableColumn { name, cells }).collect();
        Ok(Ok(table))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_as_wide_as_they_must_be() {
        let text = "\u{feff}t_ms,whole,real,word,\"a, b\",real\n1.5,1,,7,-0.0,1e300\r\n2,-3,0.1,P01,3,\"9007199254740993\"\n";
        let table = Table::parse(text.as_bytes(), None).unwrap();
        assert_eq!(table.captured.iter().map(|at| at.as_nanos()).collect::<Vec<_>>(), [1_500_000, 2_000_000]);
        let names: Vec<&str> = table.columns.iter().map(|column| &column.name[..]).collect();
        assert_eq!(names, ["whole", "real", "word", "a, b", "real_2"]);
        assert_eq!(table.columns[0].cells, Cells::Integers(vec![1, -3]));
        assert!(matches!(&table.columns[1].cells, Cells::Numbers(x) if x[0].is_nan() && x[1] == 0.1));
        assert_eq!(table.columns[2].cells, Cells::Texts(vec!["7".into(), "P01".into()]));
        assert_eq!(table.notes, ["1:6: the second column \"real\" is called \"real_2\""]);
        let ours = Table::parse(b"captured_ns;arrived_ns;x\n-5;7;1\n", None).unwrap();
        assert_eq!((ours.captured[0].as_nanos(), ours.arrived.unwrap()[0].as_nanos()), (-5, 7));
    }

    #[test]
    fn what_is_wrong_has_a_place() {
        for (text, expected) in [
            (&b""[..], "1:1: expected a header of 2 to 4096 columns, found 0"),
            (b"t\n1\n", "1:1: expected a header of 2 to 4096 columns, found 1"),
            (
                b"v,x\n1,2\n",
                "1:1: expected a first column of time, such as t_s, Time [ms], timestamp_us or captured_ns, found \"v\"",
            ),
            (b"t,x\r\n\r\n1,2\r\nsoon,3\r\n", "4:1: expected a time, found \"soon\""),
            (b"t,x\r\n1,2\r\n1,2,3\r\n", "3:1: expected 2 columns, found 3"),
            (b"t,x\r1,2\rsoon,3\r", "3:1: expected a time, found \"soon\""),
            (b"t,x\n1,2\nsoon,3\n", "3:1: expected a time, found \"soon\""),
            (b"t,x\n1,2,3\n", "2:1: expected 2 columns, found 3"),
            (b"t,x\n1,\xff\n", "2:1: expected text in UTF-8, found other bytes"),
            (b"t_ns,x\n99999999999999999999,1\n", "2:1: expected a time, found \"99999999999999999999\""),
        ] {
            assert_eq!(Table::parse(text, None).unwrap_err().to_string(), expected);
        }
    }

    #[test]
    fn the_name_of_the_first_column_says_its_unit() {
        use TimeUnit::{Ms, Ns, S, Us};
        for (name, expected) in [
            ("t_s", Said::Time(S)),
            ("Time [ms]", Said::Time(Ms)),
            ("time (ms)", Said::Time(Ms)),
            ("time(ms)", Said::Time(Ms)),
            ("Timestamp_MS", Said::Time(Ms)),
            ("timeMs", Said::Time(Ms)),
            ("ms", Said::Time(Ms)),
            ("Zeit [\u{b5}s]", Said::Time(Us)),
            ("TIME_US", Said::Time(Us)),
            ("captured_ns", Said::Time(Ns)),
            ("seconds", Said::Time(S)),
            ("t", Said::Unitless),
            ("time", Said::Unitless),
            ("LSL Timestamp", Said::Unitless),
            ("Time [min]", Said::Other),
            ("v_m_s", Said::Other),
            ("gyr_rad_s", Said::Other),
            ("v", Said::Other),
            ("a", Said::Other),
            ("", Said::Other),
        ] {
            assert_eq!(said(name), expected, "{name}");
        }
        let asked = Table::parse(b"v,x\n1000,1\n", Some(Ms)).unwrap();
        assert_eq!((asked.captured[0].as_nanos(), asked.notes.len()), (1_000_000_000, 0));
        let unsaid = Table::parse(b"time,x\n1000,1\n", None).unwrap();
        assert_eq!(unsaid.notes, ["1:1: \"time\" is taken for seconds"]);
    }

    #[test]
    fn numbers_may_have_decimal_commas() {
        let table = Table::parse(b"t_s;v;w;n\n1,5;2,5;1;-1,5e3\n2,25;-,5;2;0,1\n", None).unwrap();
        assert_eq!(
            table.captured.iter().map(|at| at.as_nanos()).collect::<Vec<_>>(),
            [1_500_000_000, 2_250_000_000]
        );
        assert_eq!(table.columns[0].cells, Cells::Numbers(vec![2.5, -0.5]));
        assert_eq!(table.columns[1].cells, Cells::Integers(vec![1, 2]));
        assert_eq!(table.columns[2].cells, Cells::Numbers(vec![-1500.0, 0.1]));
        // With points elsewhere, commas are no decimal ones.
        let table = Table::parse(b"t_s;v;w\n1;1,234;0.5\n", None).unwrap();
        assert_eq!(table.columns[0].cells, Cells::Texts(vec!["1,234".to_owned()]));
    }

    #[test]
    fn a_word_among_numbers_is_said() {
        let table =
            Table::parse(b"t_s,x,word\n1,2.5,a\n2,oops,b\n3,1,4\n4,1e400,5\n5,inf,c\n6,7,8\n", None).unwrap();
        assert_eq!(table.notes, ["3:2: \"x\" is kept as text: 2 cells are no number, the first \"oops\""]);
        assert!(
            matches!(&table.columns[0].cells, Cells::Texts(all) if all[1] == "oops" && all[3] == "1e400")
        );
    }
}
