//! HID devices out of a recording: their report descriptor, and what they reported when. The text is that of `hid-recorder`
//! (hid-tools), which many people have recorded their devices with.

use std::fmt::Write as _;

use vergence_time::{Span, Timestamp};

use crate::Error;

/// A recorded device.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Recording {
    /// As the device calls itself.
    pub name: String,
    /// Bus (3 is USB, 5 Bluetooth), vendor, product.
    pub ids: [u16; 3],
    /// What its reports mean.
    pub descriptor: Vec<u8>,
    /// Time since the first report, and the report with its number where it has one, ascending.
    pub reports: Vec<(Timestamp, Vec<u8>)>,
}

/// The largest descriptor and report that the Linux kernel takes, bytes.
const LARGEST: usize = 4096;
/// As large, at most, is a recording's text that is read: a minute of a fast device.
const LONGEST_TEXT: usize = 64 << 20;

impl Recording {
    /// Reads the text of a recording: lines `N: name`, `I: bus vendor product` (hexadecimal), `R: count bytes…`,
    /// `E: seconds.microseconds count bytes…`. Comments (`#`), other devices' (`D: 1`) and other lines are passed over.
    ///
    /// # Errors
    /// With the line's number: where a count is not that of the bytes, a number is none, times do not ascend, or there is no
    /// descriptor.
    pub fn parse(text: &str) -> Result<Self, Error> {
        let wrong = |line: usize, expected: &'static str, found: &str| Error::Line {
            line,
            expected,
            found: found.chars().take(40).collect(),
        };
        if text.len() > LONGEST_TEXT {
            return Err(wrong(1, "at most 64 MiB of text", "more"));
        }
        let mut recording = Self::default();
        let mut is_other = false;
        for (index, line) in text.lines().enumerate() {
            let number = index + 1;
            let Some((key, rest)) = line.split_once(':') else { continue };
            let rest = rest.trim();
            let bytes = |text: &str| -> Result<Vec<u8>, Error> {
                let (count, text) = text.split_once(' ').unwrap_or((text, ""));
                let count: usize = count
                    .parse()
                    .ok()
                    .filter(|count| *count <= LARGEST)
                    .ok_or_else(|| wrong(number, "a count of bytes up to 4096", count))?;
                let bytes: Result<Vec<u8>, Error> = text
                    .split_whitespace()
                    .take(LARGEST + 1)
                    .map(|byte| {
                        u8::from_str_radix(byte, 16).map_err(|_| wrong(number, "a byte, hexadecimal", byte))
                    })
                    .collect();
                bytes.and_then(|bytes| {
                    if bytes.len() == count {
                        Ok(bytes)
                    } else {
                        Err(wrong(number, "as many bytes as counted", text))
                    }
                })
            };
            match key {
                "D" => is_other = rest != "0",
                _ if is_other => {}
                "N" => recording.name = rest.chars().take(256).collect(),
                "I" => {
                    let ids: Vec<u16> =
                        rest.split_whitespace().filter_map(|id| u16::from_str_radix(id, 16).ok()).collect();
                    recording.ids =
                        ids.try_into().map_err(|_| wrong(number, "bus, vendor, product", rest))?;
                }
                "R" => recording.descriptor = bytes(rest)?,
                "E" => {
                    let (time, rest) = rest.split_once(' ').unwrap_or((rest, ""));
                    let time = seconds(time).ok_or_else(|| wrong(number, "a time in seconds", time))?;
                    if recording.reports.last().is_some_and(|(last, _)| time < *last) {
                        return Err(wrong(number, "a time not before the one above", line));
                    }
                    recording.reports.push((time, bytes(rest)?));
                }
                _ => {}
            }
        }
        if recording.descriptor.is_empty() {
            return Err(wrong(text.lines().count().max(1), "a report descriptor (R: …)", "none"));
        }
        if let Some(first) = recording.reports.first().map(|(time, _)| *time) {
            for (time, _) in &mut recording.reports {
                *time = Timestamp::default().saturating_add(time.since(first).unwrap_or_default());
            }
        }
        Ok(recording)
    }

    /// The text that [`Recording::parse`] reads.
    pub fn to_text(&self) -> String {
        let hex = |bytes: &[u8]| {
            bytes.iter().fold(bytes.len().to_string(), |mut text, byte| {
                let _ = write!(text, " {byte:02x}");
                text
            })
        };
        let [bus, vendor, product] = self.ids;
        let mut text = format!("D: 0\nR: {}\nN: {}\n", hex(&self.descriptor), self.name);
        let _ = writeln!(text, "I: {bus:x} {vendor:04x} {product:04x}");
        for (time, report) in &self.reports {
            let micros = time.as_nanos() / 1000;
            let _ = writeln!(text, "E: {:06}.{:06} {}", micros / 1_000_000, micros % 1_000_000, hex(report));
        }
        text
    }

    /// What the device reports after `from` and up to `to`, both counted from the first report; the recording is repeated
    /// every `period` where one is given that is not shorter than it, else told once.
    pub fn between(
        &self,
        from: Timestamp,
        to: Timestamp,
        period: Option<Span>,
    ) -> impl Iterator<Item = (Timestamp, &[u8])> {
        let length = self.reports.last().map_or(0, |(time, _)| time.as_nanos());
        let period_ns = period.map(Span::as_nanos).filter(|ns| *ns > 0 && *ns >= length);
        let (first, last) = match period_ns {
            Some(ns) => (from.as_nanos().div_euclid(ns).max(0), to.as_nanos().div_euclid(ns)),
            None => (0, 0),
        };
        (first..=last).flat_map(move |turn| {
            let shift = turn.saturating_mul(period_ns.unwrap_or(0));
            let shifted =
                move |time: &Timestamp| Timestamp::from_nanos(time.as_nanos().saturating_add(shift));
            let begin = self.reports.partition_point(|(time, _)| shifted(time) <= from);
            let reports =
                self.reports[begin..].iter().map(move |(time, report)| (shifted(time), &report[..]));
            reports.take_while(move |(time, _)| *time <= to)
        })
    }
}

/// `12.000345`, with up to six digits behind the point.
fn seconds(text: &str) -> Option<Timestamp> {
    let (whole, part) = text.split_once('.').unwrap_or((text, "0"));
    if part.is_empty() || part.len() > 6 || !part.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    let micros: i64 = part.parse::<i64>().ok()? * 10i64.pow(6 - part.len() as u32);
    let whole: u32 = whole.parse().ok()?;
    i64::from(whole).checked_mul(1_000_000_000)?.checked_add(micros * 1000).map(Timestamp::from_nanos)
}

/// A device with six degrees of freedom (a knob that is pushed and twisted) and two buttons: reports 1 (way), 2 (turn), 3
/// (buttons), little-endian, −350 to 350, as such devices have them.
pub struct SixDof;

impl SixDof {
    /// Its report descriptor.
    pub const DESCRIPTOR: [u8; 90] = [
        0x05, 0x01, 0x09, 0x08, 0xa1, 0x01, // generic desktop, multi-axis controller, application
        0xa1, 0x00, 0x85, 0x01, 0x16, 0xa2, 0xfe, 0x26, 0x5e, 0x01, // physical, report 1, -350 to 350
        0x36, 0x88, 0xfa, 0x46, 0x78, 0x05, 0x55, 0x0c, 0x65, 0x11, // -1400 to 1400, of centimetres
        0x09, 0x30, 0x09, 0x31, 0x09, 0x32, 0x75, 0x10, 0x95, 0x03, 0x81, 0x06,
        0xc0, // x y z, 3 of 16 bits, relative
        0xa1, 0x00, 0x85, 0x02, 0x16, 0xa2, 0xfe, 0x26, 0x5e, 0x01, // report 2
        0x09, 0x33, 0x09, 0x34, 0x09, 0x35, 0x75, 0x10, 0x95, 0x03, 0x81, 0x06, 0xc0, // rx ry rz
        0xa1, 0x02, 0x85, 0x03, 0x05, 0x09, 0x19, 0x01, 0x29, 0x02, 0x15, 0x00, 0x25,
        0x01, // logical, report 3
        0x75, 0x01, 0x95, 0x02, 0x81, 0x02, 0x75, 0x06, 0x95, 0x01, 0x81, 0x03, 0xc0,
        0xc0, // 2 buttons, 6 bits
    ];

    /// The three reports for a way and a turn (shares of what the knob can do, −1 to 1) and buttons.
    pub fn reports(way: [f64; 3], turn: [f64; 3], buttons: u8) -> [Vec<u8>; 3] {
        let three = |number: u8, axes: [f64; 3]| {
            let numbers = axes.map(|axis| ((axis.clamp(-1.0, 1.0) * 350.0).round() as i16).to_le_bytes());
            std::iter::once(number).chain(numbers.into_iter().flatten()).collect()
        };
        [three(1, way), three(2, turn), vec![3, buttons & 3]]
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn recorded() -> Recording {
        let report = |k: i64| {
            let [way, _, _] = SixDof::reports([k as f64 / 10.0, 0.0, -1.0], [0.0; 3], 0);
            (Timestamp::from_nanos(k * 8_000_000), way)
        };
        Recording {
            name: "six degrees".to_owned(),
            ids: [3, 0x046d, 0xc626],
            descriptor: SixDof::DESCRIPTOR.to_vec(),
            reports: (0..10).map(report).collect(),
        }
    }

    #[test]
    fn text_is_read_as_it_was_written() {
        let recording = recorded();
        assert_eq!(Recording::parse(&recording.to_text()).unwrap(), recording);
        let text = "# a comment\nD:0\nR: 2 05 01\nN: Me\nP: usb-1\nI: 3 046d c626\nD: 1\nE: 1.5 1 00\nD: 0\nE: 3.5 2 01 02\n";
        let parsed = Recording::parse(text).unwrap();
        assert_eq!((parsed.reports, parsed.ids[1]), (vec![(Timestamp::default(), vec![1, 2])], 0x046d));
    }

    #[test]
    fn faults_have_their_line() {
        for (text, line) in [
            ("R: 2 05", 1),
            ("R: 1 05\nE: x 1 00", 2),
            ("R: 1 05\nE: 2.0 1 00\nE: 1.0 1 00", 3),
            ("R: 1 zz", 1),
            ("R: 99999999999999999999 00", 1),
            ("R: 5000 00", 1),
            ("I: 3 4", 1),
            ("N: nobody\n", 1),
        ] {
            match Recording::parse(text) {
                Err(Error::Line { line: found, .. }) => assert_eq!(found, line, "{text}"),
                other => panic!("{text}: {other:?}"),
            }
        }
    }

    #[test]
    fn reports_come_once_each_also_when_repeated() {
        let recording = recorded();
        let at = |ms: i64| Timestamp::from_nanos(ms * 1_000_000);
        let all = |period| {
            let steps = (0..50).map(|k| (at(7 * k - 7), at(7 * k)));
            steps
                .flat_map(|(from, to)| {
                    recording.between(from, to, period).map(|(t, r)| (t, r.to_vec())).collect::<Vec<_>>()
                })
                .collect::<Vec<_>>()
        };
        assert_eq!(all(None), recording.reports);
        let repeated = all(Some(Span::from_millis(80)));
        assert_eq!(repeated.len(), 43);
        assert!(repeated.windows(2).all(|pair| pair[1].0.since(pair[0].0) == Some(Span::from_millis(8))));
        // A period shorter than the recording would mix its reports up.
        assert_eq!(all(Some(Span::from_millis(10))), recording.reports);
    }

    proptest! {
        #[test]
        fn damaged_text_is_refused_or_read(cut in 0usize..2000, place in 0usize..2000, byte in any::<u8>(), any_text in ".{0,200}") {
            let mut text = recorded().to_text().into_bytes();
            let place = place % text.len();
            text[place] = byte;
            text.truncate(cut.max(1));
            let _ = Recording::parse(&String::from_utf8_lossy(&text));
            let _ = Recording::parse(&any_text);
        }
    }
}
