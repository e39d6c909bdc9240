//! Lines of numbers: `SERIAL.md` says it for those who write firmware.

use vergence_sense::ReadingKind;

/// Longer lines are passed over.
pub const MOST_LINE: usize = 512;
/// Further columns are passed over.
pub const MOST_COLUMNS: usize = 32;

/// An inertial unit's; the first six, or all nine.
const IMU: [&str; 9] = ["gx", "gy", "gz", "ax", "ay", "az", "mx", "my", "mz"];

fn is_time(name: &str) -> bool {
    matches!(name, "time_ns" | "time_us" | "time_ms" | "time_s")
}

/// Whether a column may be called so.
pub(super) fn is_name(name: &str) -> bool {
    let allowed = |c: char| c.is_ascii_alphanumeric() || "_-/[]%°.".contains(c);
    name.starts_with(|c: char| c.is_ascii_alphabetic())
        && name.len() <= 64
        && name.chars().all(allowed)
        && name.parse::<f64>().is_err()
}

/// As much of a text as a sentence holds.
pub(super) fn shown(text: &str) -> String {
    let mut shown: String = text.chars().take(40).collect();
    if shown.len() < text.len() {
        shown.push('…');
    }
    shown
}

/// Why a line is none of names.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NamesError {
    /// Something in it cannot be a name.
    #[error(
        "expected names separated by commas, each of letters, digits and '_-/[]%°.', a letter first, found '{found}'"
    )]
    NoName {
        /// What.
        found: String,
    },
    /// It is longer than lines may be.
    #[error("expected at most 32 columns, found {found}")]
    TooMany {
        /// How many.
        found: usize,
    },
    /// What may be there once is there twice.
    #[error("expected each column once, found '{found}' twice")]
    Twice {
        /// Which.
        found: String,
    },
    /// Only time and number.
    #[error("expected a column with values, found '{found}'")]
    NoValues {
        /// The line.
        found: String,
    },
}

/// What a column is.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Column {
    /// Nanoseconds that one of it lasts.
    Time(f64),
    Sequence,
    /// Place of the value among the inertial unit's.
    Imu(usize),
    /// Place among the scalars.
    Scalar(usize),
}

/// What a line of names says.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Columns {
    columns: Vec<Column>,
    /// Values of the inertial unit: none, 6, or 9 with its magnetometer.
    imu: usize,
    /// Name and unit of each scalar.
    scalars: Vec<(String, String)>,
}

/// One line of numbers.
#[derive(Clone, Copy, Debug)]
pub struct Line {
    /// The device's clock as it is written, where it has one: it may be a counter that wraps ([`LineClock`]).
    pub time_ns: Option<u64>,
    /// The device's count of lines, where it has one.
    pub sequence: Option<u64>,
    /// The time as a whole number, and the nanoseconds that one of it lasts.
    ticks: Option<(u64, u64)>,
    imu: [f64; 9],
    scalars: [f64; MOST_COLUMNS],
}

impl Columns {
    /// From a line of names, each of which begins with a letter.
    ///
    /// # Errors
    /// Where it is none, with what was expected.
    pub fn parse(text: &str) -> Result<Self, NamesError> {
        let names: Vec<&str> = text.split(',').map(str::trim).collect();
        if let Some(wrong) = names.iter().find(|name| !is_name(name)) {
            return Err(NamesError::NoName { found: shown(wrong) });
        }
        if names.len() > MOST_COLUMNS {
            return Err(NamesError::TooMany { found: names.len() });
        }
        // Of scalars, two may have one name: the second stream gets another.
        let is_known = |name: &str| IMU.contains(&name) || name == "seq" || is_time(name);
        let is_again = |&place: &usize| {
            let name = names[place];
            is_known(name) && names[..place].iter().any(|&b| b == name || is_time(name) && is_time(b))
        };
        if let Some(place) = (1..names.len()).find(is_again) {
            return Err(NamesError::Twice { found: shown(names[place]) });
        }
        let has = |values: &usize| IMU[..*values].iter().all(|name| names.contains(name));
        let imu = [9, 6].into_iter().find(has).unwrap_or(0);
        let mut scalars: Vec<(String, String)> = Vec::new();
        let column = |&name: &&str| match name {
            "time_ns" => Column::Time(1.0),
            "time_us" => Column::Time(1e3),
            "time_ms" => Column::Time(1e6),
            "time_s" => Column::Time(1e9),
            "seq" => Column::Sequence,
            _ => match IMU[..imu].iter().position(|imu| *imu == name) {
                Some(place) => Column::Imu(place),
                None => {
                    let (name, unit) = name.split_once('[').unwrap_or((name, ""));
                    let name = name.replace(|c: char| !c.is_ascii_alphanumeric() && !"_-/".contains(c), "_");
                    scalars.push((name.trim_matches('/').to_owned(), unit.trim_end_matches(']').to_owned()));
                    Column::Scalar(scalars.len() - 1)
                }
            },
        };
        let columns: Vec<Column> = names.iter().map(column).collect();
        let unnamed = scalars.iter().any(|(name, _)| name.is_empty());
        let has_values = imu > 0 || !scalars.is_empty();
        if !has_values || unnamed {
            return Err(NamesError::NoValues { found: shown(text) });
        }
        Ok(Self { columns, imu, scalars })
    }

    /// How many numbers a line of them has.
    pub fn count(&self) -> usize {
        self.columns.len()
    }

    /// The numbers of a line; `None` where it is another number of columns, or not numbers. `nan` is a value that is not there.
    pub fn read(&self, text: &str) -> Option<Line> {
        let mut line =
            Line { time_ns: None, sequence: None, ticks: None, imu: [0.0; 9], scalars: [0.0; MOST_COLUMNS] };
        let mut columns = self.columns.iter();
        for field in text.split(',') {
            let column = columns.next()?;
            let field = field.trim();
            let value: f64 = field.parse().ok()?;
            // More than a number can be.
            if value.is_infinite() {
                return None;
            }
            match *column {
                Column::Time(nanos) => {
                    if !(0.0..1e19).contains(&(value * nanos)) {
                        return None;
                    }
                    // Whole numbers lose nothing.
                    line.time_ns = Some(match field.parse::<u64>() {
                        Ok(whole) => {
                            line.ticks = Some((whole, nanos as u64));
                            whole.checked_mul(nanos as u64)?
                        }
                        Err(_) => (value * nanos) as u64,
                    });
                }
                Column::Sequence => line.sequence = Some(field.parse().ok()?),
                Column::Imu(place) => line.imu[place] = value,
                Column::Scalar(place) => line.scalars[place] = value,
            }
        }
        columns.next().is_none().then_some(line)
    }

    /// Each stream: its name, what it carries, its unit.
    pub fn streams(&self) -> impl Iterator<Item = (&str, ReadingKind, &str)> {
        let imu = (self.imu > 0).then_some(("imu", ReadingKind::Imu, ""));
        let scalars =
            self.scalars.iter().map(|(name, unit)| (name.as_str(), ReadingKind::Scalar, unit.as_str()));
        imu.into_iter().chain(scalars)
    }

    /// Each stream's numbers of a line, in the order of [`Columns::streams`].
    pub fn values<'a>(&'a self, line: &'a Line) -> impl Iterator<Item = (ReadingKind, &'a [f64])> {
        let imu = (self.imu > 0).then_some((ReadingKind::Imu, &line.imu[..self.imu]));
        let scalars =
            (0..self.scalars.len()).map(|place| (ReadingKind::Scalar, &line.scalars[place..=place]));
        imu.into_iter().chain(scalars)
    }
}

/// Times out of the counters of 32 bits that lines have: milliseconds and microseconds since the start of the program.
#[derive(Clone, Copy, Debug, Default)]
pub struct LineClock {
    last: u64,
    turns: u64,
}

impl LineClock {
    /// A fall by nearly all that 32 bits count, so that no more than this passed, is a wrap.
    const MOST_PAUSE_NS: u64 = 60_000_000_000;

    /// The line's time, where it has one, with the counter's wraps so far.
    pub fn nanos(&mut self, line: &Line) -> Option<u64> {
        const RANGE: u64 = 1 << 32;
        let Some((ticks, tick_ns)) = line.ticks else { return line.time_ns };
        if ticks >= RANGE {
            // It has more bits.
            self.turns = 0;
        } else if ticks < self.last && self.last < RANGE {
            let passed = ticks + RANGE - self.last;
            self.turns += u64::from(passed.saturating_mul(tick_ns) < Self::MOST_PAUSE_NS);
        }
        self.last = ticks;
        Some(self.turns.wrapping_mul(RANGE).wrapping_add(ticks).wrapping_mul(tick_ns))
    }
}

/// The bits of a counter of lines that fell from `next` to `sequence`, where that is a wrap; 64 where it is none.
pub fn sequence_bits(next: u64, sequence: u64) -> u32 {
    let wraps = |bits: &u32| {
        let (range, near) = (1u64 << bits, 1u64 << (bits - 4));
        next <= range && next > range - near && sequence < near
    };
    if sequence >= next { 64 } else { [8, 16, 32].into_iter().find(wraps).unwrap_or(64) }
}

/// Finds lines in bytes that arrive in pieces; memory is bounded.
#[derive(Debug)]
pub struct Lines {
    line: [u8; MOST_LINE],
    length: usize,
    /// The line is too long: the rest of it is passed over.
    overlong: bool,
}

impl Default for Lines {
    fn default() -> Self {
        Self { line: [0; MOST_LINE], length: 0, overlong: false }
    }
}

impl Lines {
    /// Forgets the beginning of a line.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// Takes bytes and hands over each line that they complete, without its end: `None` for one that is too long or not
    /// text.
    pub fn push(&mut self, bytes: &[u8], mut tell: impl FnMut(Option<&str>)) {
        for &byte in bytes {
            if byte != b'\n' {
                match self.line.get_mut(self.length) {
                    Some(slot) if !self.overlong => {
                        *slot = byte;
                        self.length += 1;
                    }
                    _ => self.overlong = true,
                }
                continue;
            }
            let text = std::str::from_utf8(&self.line[..self.length]).ok().map(str::trim);
            let is_text = |text: &&str| !text.contains(|c: char| c.is_control() && c != '\t');
            match text.filter(|_| !self.overlong).filter(is_text) {
                Some("") => {}
                text => tell(text),
            }
            (self.length, self.overlong) = (0, false);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_say_what_numbers_are() {
        let columns = Columns::parse("time_ms,gx,gy,gz,ax,ay,az,skin[C],seq").unwrap();
        let streams: Vec<_> = columns.streams().collect();
        assert_eq!(streams, [("imu", ReadingKind::Imu, ""), ("skin", ReadingKind::Scalar, "C")]);
        let line = columns.read("1500, 1,2,3,4,5,6,36.5,7").unwrap();
        assert_eq!((line.time_ns, line.sequence), (Some(1_500_000_000), Some(7)));
        let values: Vec<f64> = columns.values(&line).flat_map(|(_, values)| values.to_vec()).collect();
        assert_eq!(values, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 36.5]);
        for wrong in ["1,2", "1500,1,2,3,4,5,6,x,7", "-1,1,2,3,4,5,6,7,8", "1500,1,2,3,4,5,6,36.5,7,8"] {
            assert!(columns.read(wrong).is_none(), "{wrong}");
        }
        assert!(columns.read("1500,1,2,3,4,5,6,nan,7").is_some());
        assert!(columns.read("1500,1,2,3,4,5,6,1e400,7").is_none());
        // With a magnetometer, all nine are the unit's; two of its axes are none.
        let nine = Columns::parse("gx,gy,gz,mx,my,mz,ax,ay,az").unwrap();
        assert_eq!(nine.streams().count(), 1);
        let line = nine.read("1,2,3,7,8,9,4,5,6").unwrap();
        let values: Vec<Vec<f64>> = nine.values(&line).map(|(_, values)| values.to_vec()).collect();
        assert_eq!(values, [[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]]);
        assert_eq!(Columns::parse("gx,gy,gz,ax,ay,az,mx,my").unwrap().streams().count(), 3);
        for (no_names, what) in [
            ("1,2", "'1'"),
            ("", "''"),
            ("a,,b", "''"),
            ("2a,b", "'2a'"),
            ("time_us,seq", "values"),
            ("hello world", "'hello world'"),
            ("nan,a", "'nan'"),
            ("time_us,a,time_ms", "'time_ms' twice"),
            ("gx,a,gx", "'gx' twice"),
        ] {
            let error = Columns::parse(no_names).unwrap_err().to_string();
            assert!(error.contains(what), "{no_names}: {error}");
        }
        assert!(Columns::parse(&vec!["a"; 33].join(",")).unwrap_err().to_string().contains("33"));
        assert_eq!(Columns::parse("a,a").unwrap().count(), 2);
    }

    #[test]
    fn counters_of_32_bits_go_on_where_they_wrap() {
        let columns = Columns::parse("time_us,a").unwrap();
        let mut clock = LineClock::default();
        let mut nanos = |ticks: u64| clock.nanos(&columns.read(&format!("{ticks},1")).unwrap());
        const RANGE: u64 = 1 << 32;
        assert_eq!(nanos(RANGE - 1000), Some((RANGE - 1000) * 1000));
        assert_eq!(nanos(500), Some((RANGE + 500) * 1000));
        // It began anew, as no minute passed.
        assert_eq!(nanos(200_000_000), Some((RANGE + 200_000_000) * 1000));
        assert_eq!(nanos(100), Some((RANGE + 100) * 1000));
        // It has more bits.
        assert_eq!(nanos(RANGE + 7), Some((RANGE + 7) * 1000));
        assert_eq!(nanos(7), Some(7000));
        for (next, sequence, bits) in [
            (65_530, 3, 16),
            (1 << 16, 0, 16),
            (250, 2, 8),
            (1 << 32, 5, 32),
            (65_530, 65_531, 64),
            (5, 3, 64),
            (40_000, 1, 64),
        ] {
            assert_eq!(sequence_bits(next, sequence), bits, "{next} {sequence}");
        }
    }

    #[test]
    fn lines_are_found_in_any_pieces_and_long_ones_passed_over() {
        let mut text = b"a,b\r\n1,2\n\n".to_vec();
        text.extend(vec![b'9'; 2000]);
        text.extend(b"\n3,4\n\xFF\n\x01a\n5,6");
        for piece in [1, 5, 4096] {
            let (mut lines, mut found) = (Lines::default(), Vec::new());
            for piece in text.chunks(piece) {
                lines.push(piece, |line| found.push(line.map(str::to_owned)));
            }
            let wanted =
                [Some("a,b"), Some("1,2"), None, Some("3,4"), None, None].map(|l| l.map(str::to_owned));
            assert_eq!(found, wanted, "pieces of {piece}");
        }
    }
}
