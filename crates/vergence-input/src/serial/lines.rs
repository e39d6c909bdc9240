//! Lines of numbers: `SERIAL.md` says it for those who write firmware.

use vergence_sense::ReadingKind;

/// Longer lines are passed over.
pub const MOST_LINE: usize = 512;
/// Further columns are passed over.
pub const MOST_COLUMNS: usize = 32;

const IMU: [&str; 6] = ["gx", "gy", "gz", "ax", "ay", "az"];

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
    has_imu: bool,
    /// Name and unit of each scalar.
    scalars: Vec<(String, String)>,
}

/// One line of numbers.
#[derive(Clone, Copy, Debug)]
pub struct Line {
    /// The device's clock, where it has one.
    pub time_ns: Option<u64>,
    /// The device's count of lines, where it has one.
    pub sequence: Option<u64>,
    imu: [f64; 6],
    scalars: [f64; MOST_COLUMNS],
}

impl Columns {
    /// From a line of names; `None` where it is none.
    pub fn parse(text: &str) -> Option<Self> {
        let names: Vec<&str> = text.split(',').map(str::trim).collect();
        let allowed = |c: char| c.is_ascii_alphanumeric() || "_-/[]%°.".contains(c);
        let is_name = |name: &&str| {
            !name.is_empty() && name.len() <= 64 && name.chars().all(allowed) && name.parse::<f64>().is_err()
        };
        if names.len() > MOST_COLUMNS || !names.iter().all(is_name) {
            return None;
        }
        let has_imu = IMU.iter().all(|name| names.contains(name));
        let mut scalars: Vec<(String, String)> = Vec::new();
        let column = |&name: &&str| match name {
            "time_ns" => Column::Time(1.0),
            "time_us" => Column::Time(1e3),
            "time_ms" => Column::Time(1e6),
            "time_s" => Column::Time(1e9),
            "seq" => Column::Sequence,
            _ => match IMU.iter().position(|imu| *imu == name) {
                Some(place) if has_imu => Column::Imu(place),
                _ => {
                    let (name, unit) = name.split_once('[').unwrap_or((name, ""));
                    let name = name.replace(|c: char| !c.is_ascii_alphanumeric() && !"_-/".contains(c), "_");
                    scalars.push((name.trim_matches('/').to_owned(), unit.trim_end_matches(']').to_owned()));
                    Column::Scalar(scalars.len() - 1)
                }
            },
        };
        let columns: Vec<Column> = names.iter().map(column).collect();
        let unnamed = scalars.iter().any(|(name, _)| name.is_empty());
        let has_values = has_imu || !scalars.is_empty();
        (has_values && !unnamed).then_some(Self { columns, has_imu, scalars })
    }

    /// The numbers of a line; `None` where it is another number of columns, or not numbers.
    pub fn read(&self, text: &str) -> Option<Line> {
        let mut line = Line { time_ns: None, sequence: None, imu: [0.0; 6], scalars: [0.0; MOST_COLUMNS] };
        let mut columns = self.columns.iter();
        for field in text.split(',') {
            let column = columns.next()?;
            let field = field.trim();
            let value: f64 = field.parse().ok()?;
            match *column {
                Column::Time(nanos) => {
                    if !(0.0..1e19).contains(&(value * nanos)) {
                        return None;
                    }
                    // Whole numbers lose nothing.
                    line.time_ns = Some(match field.parse::<u64>() {
                        Ok(whole) => whole.checked_mul(nanos as u64)?,
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
        let imu = self.has_imu.then_some(("imu", ReadingKind::Imu, ""));
        let scalars =
            self.scalars.iter().map(|(name, unit)| (name.as_str(), ReadingKind::Scalar, unit.as_str()));
        imu.into_iter().chain(scalars)
    }

    /// Each stream's numbers of a line, in the order of [`Columns::streams`].
    pub fn values<'a>(&'a self, line: &'a Line) -> impl Iterator<Item = (ReadingKind, &'a [f64])> {
        let imu = self.has_imu.then_some((ReadingKind::Imu, &line.imu[..]));
        let scalars =
            (0..self.scalars.len()).map(|place| (ReadingKind::Scalar, &line.scalars[place..=place]));
        imu.into_iter().chain(scalars)
    }
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
            match text.filter(|_| !self.overlong) {
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
        for no_names in ["1,2", "", "a,,b", "time_us,seq", "hello world"] {
            assert_eq!(Columns::parse(no_names), None, "{no_names}");
        }
    }

    #[test]
    fn lines_are_found_in_any_pieces_and_long_ones_passed_over() {
        let mut text = b"a,b\r\n1,2\n\n".to_vec();
        text.extend(vec![b'9'; 2000]);
        text.extend(b"\n3,4\n\xFF\n5,6");
        for piece in [1, 5, 4096] {
            let (mut lines, mut found) = (Lines::default(), Vec::new());
            for piece in text.chunks(piece) {
                lines.push(piece, |line| found.push(line.map(str::to_owned)));
            }
            let wanted = [Some("a,b"), Some("1,2"), None, Some("3,4"), None].map(|l| l.map(str::to_owned));
            assert_eq!(found, wanted, "pieces of {piece}");
        }
    }
}
