//! XDF, the format of the lab streaming layer: chunks of samples of many streams, with the clocks' offsets.
//!
//! Format: "XDF specification 1.0", github.com/sccn/xdf. Own parser: the crates that read it trust the counts in the file; here memory
//! stays in proportion to the file's size.

use std::path::Path;
use std::sync::Arc;

use super::dejitter::{even_out, synchronise};
use crate::error::Error;

/// Larger files are refused, bytes.
const LARGEST_FILE: u64 = 4 << 30;
/// A header is XML of at most so many bytes.
const LARGEST_HEADER: usize = 16 << 20;
/// Streams and channels, at most.
const MOST: usize = 1 << 16;

/// The values of a stream, sample after sample, channel after channel.
#[derive(Clone, Debug, PartialEq)]
pub enum Cells {
    /// Floating point of any width.
    Numbers(Vec<f64>),
    /// Whole numbers of any width.
    Integers(Vec<i64>),
    /// Text.
    Texts(Vec<String>),
}

/// A stream of an XDF file.
#[derive(Clone, Debug, PartialEq)]
pub struct XdfStream {
    /// Its number in the file.
    pub id: u32,
    /// As its sender called it.
    pub name: String,
    /// What it carries: EEG, Markers, Gaze, …
    pub content: String,
    /// Samples per second; 0 where they come as they come.
    pub nominal_hz: f64,
    /// How many values a sample has.
    pub channels: usize,
    /// The channels' labels, where the sender gave one for each.
    pub labels: Vec<String>,
    /// As the file calls the type of the values.
    pub format: String,
    /// When each sample was taken, seconds of the recorder's clock.
    pub stamps_s: Vec<f64>,
    /// The values.
    pub cells: Cells,
    /// Offsets of the sender's clock: when, and how much, seconds.
    pub offsets: Vec<(f64, f64)>,
    /// Samples may be missing: times are not evened out.
    can_drop: bool,
    last_s: f64,
}

/// What an XDF file holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Xdf {
    /// In the order of their headers; times are on one clock and evened out.
    pub streams: Vec<XdfStream>,
    /// What was wrong with the file, in sentences with offsets: what is read is what came before, and after.
    pub faults: Vec<String>,
}

/// Bytes to be taken from the front.
struct Bytes<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Bytes<'a> {
    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let end = self.at.checked_add(count)?;
        let taken = self.bytes.get(self.at..end)?;
        self.at = end;
        Some(taken)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.take(N)?.try_into().ok()
    }

    fn double(&mut self) -> Option<f64> {
        self.array().map(f64::from_le_bytes)
    }

    /// A count, preceded by the number of its bytes.
    fn count(&mut self) -> Option<usize> {
        let [width] = self.array::<1>()?;
        match width {
            1 => self.array::<1>().map(|[count]| usize::from(count)),
            4 => usize::try_from(u32::from_le_bytes(self.array()?)).ok(),
            8 => usize::try_from(u64::from_le_bytes(self.array()?)).ok(),
            _ => None,
        }
    }
}

/// Behind these bytes a chunk begins, whatever was before.
const BOUNDARY: [u8; 16] =
    [0x43, 0xa5, 0x46, 0xdc, 0xcb, 0xf5, 0x41, 0x0f, 0xb3, 0x0e, 0xd5, 0x46, 0x73, 0x83, 0xcb, 0xe4];

/// Reads a file. A damaged one is read as far as it is whole, from each boundary on again.
///
/// # Errors
/// Where it cannot be read, is larger than 4 GiB, or is no XDF.
pub fn read_xdf(path: &Path) -> Result<Xdf, Error> {
    let failed = |source| Error::Read { path: path.to_owned(), source: Arc::new(source) };
    let length = std::fs::metadata(path).map_err(failed)?.len();
    if length > LARGEST_FILE {
        let message = format!("expected at most {LARGEST_FILE} bytes, found {length}");
        return Err(failed(std::io::Error::new(std::io::ErrorKind::FileTooLarge, message)));
    }
    let bytes = std::fs::read(path).map_err(failed)?;
    Xdf::parse(&bytes).ok_or_else(|| Error::NotALog {
        path: path.to_owned(),
        expected: "an XDF file",
        found: format!("a file that begins with {:02x?}", &bytes[..bytes.len().min(4)]),
    })
}

impl Xdf {
    /// Reads the bytes of a file; `None` where they do not begin as XDF does.
    pub fn parse(bytes: &[u8]) -> Option<Self> {
        let mut file = Bytes { bytes, at: 0 };
        if file.take(4)? != b"XDF:" {
            return None;
        }
        let mut xdf = Self::default();
        while file.at < bytes.len() {
            let begins = file.at;
            if let Err(fault) = xdf.chunk(&mut file) {
                // Faults may be as many as chunks; the first ones tell.
                if xdf.faults.len() < 100 {
                    xdf.faults.push(format!("byte {begins}: {fault}"));
                }
                let rest = bytes.get(begins + 1..).unwrap_or_default();
                match rest.windows(BOUNDARY.len()).position(|window| window == BOUNDARY) {
                    Some(place) => file.at = begins + 1 + place + BOUNDARY.len(),
                    None => break,
                }
            }
        }
        for stream in &mut xdf.streams {
            synchronise(&mut stream.stamps_s, &stream.offsets);
            if !stream.can_drop {
                even_out(&mut stream.stamps_s, stream.nominal_hz);
            }
        }
        Some(xdf)
    }

    fn stream(&mut self, id: u32) -> Result<&mut XdfStream, String> {
        let found = self.streams.iter_mut().find(|stream| stream.id == id);
        found.ok_or_else(|| format!("expected a stream with a header, found number {id}"))
    }

    fn chunk(&mut self, file: &mut Bytes<'_>) -> Result<(), String> {
        const SHORT: &str = "expected a whole chunk, found the end of the file";
        let length = file.count().ok_or("expected the length of a chunk, found none")?;
        let content = file.take(length).ok_or(SHORT)?;
        let mut chunk = Bytes { bytes: content, at: 0 };
        let tag = u16::from_le_bytes(chunk.array().ok_or("expected a tag, found an empty chunk")?);
        if ![2, 3, 4, 6].contains(&tag) {
            return Ok(());
        }
        let id = u32::from_le_bytes(chunk.array().ok_or("expected a stream's number, found a short chunk")?);
        match tag {
            2 => {
                if self.streams.len() >= MOST || self.streams.iter().any(|stream| stream.id == id) {
                    return Err(format!("expected a new stream, found number {id} again or too many"));
                }
                self.streams.push(header(id, &content[6..])?);
                Ok(())
            }
            3 => samples(self.stream(id)?, &mut chunk),
            4 => {
                let offset = chunk.double().zip(chunk.double());
                let offset = offset.filter(|(t, o)| t.is_finite() && o.is_finite());
                let offset = offset.ok_or("expected a time and an offset, found something else")?;
                self.stream(id)?.offsets.push(offset);
                Ok(())
            }
            // The footer repeats what was said.
            _ => Ok(()),
        }
    }
}

/// A stream's header.
fn header(id: u32, xml: &[u8]) -> Result<XdfStream, String> {
    if xml.len() > LARGEST_HEADER {
        return Err(format!("expected a header of at most {LARGEST_HEADER} bytes, found {}", xml.len()));
    }
    let text = String::from_utf8_lossy(xml);
    // Elements within elements, which parsers recurse into.
    let depth = text.bytes().scan(0i64, |depth, byte| {
        *depth += i64::from(byte == b'<');
        Some(*depth)
    });
    if depth.last().unwrap_or(0) > 100_000 {
        return Err("expected a header of at most 100,000 elements, found more".to_owned());
    }
    let document = roxmltree::Document::parse(&text)
        .map_err(|error| format!("expected a header in XML, found {error}"))?;
    let root = document.root_element();
    let child = |name: &str| {
        let node = root.children().find(|node| node.has_tag_name(name));
        node.and_then(|node| node.text()).unwrap_or_default().trim().to_owned()
    };
    let number = |name: &str| -> Result<f64, String> {
        let text = child(name);
        let number = text.parse::<f64>().ok().filter(|x| x.is_finite() && *x >= 0.0);
        number.ok_or_else(|| format!("{name}: expected a number, found {text:?}"))
    };
    let channels = child("channel_count").parse::<usize>().ok().filter(|count| *count <= MOST);
    let channels = channels.ok_or_else(|| {
        format!("channel_count: expected at most {MOST}, found {:?}", child("channel_count"))
    })?;
    let format = child("channel_format");
    let cells = match &format[..] {
        "float32" | "double64" => Cells::Numbers(Vec::new()),
        "int8" | "int16" | "int32" | "int64" => Cells::Integers(Vec::new()),
        "string" => Cells::Texts(Vec::new()),
        other => {
            return Err(format!(
                "channel_format: expected int8 to int64, float32, double64 or string, found {other:?}"
            ));
        }
    };
    let labels: Vec<String> = root
        .descendants()
        .filter(|node| node.has_tag_name("channel"))
        .filter_map(|node| {
            node.children().find(|child| child.has_tag_name("label")).and_then(|label| label.text())
        })
        .map(|label| label.trim().to_owned())
        .take(MOST + 1)
        .collect();
    let can_drop = root.descendants().any(|node| {
        node.has_tag_name("can_drop_samples")
            && node.text().is_some_and(|text| text.trim().eq_ignore_ascii_case("true"))
    });
    Ok(XdfStream {
        id,
        name: child("name"),
        content: child("type"),
        nominal_hz: number("nominal_srate")?,
        channels,
        labels: if labels.len() == channels { labels } else { Vec::new() },
        format,
        stamps_s: Vec::new(),
        cells,
        offsets: Vec::new(),
        can_drop,
        last_s: 0.0,
    })
}

/// A chunk of samples: those before a fault are kept.
fn samples(stream: &mut XdfStream, chunk: &mut Bytes<'_>) -> Result<(), String> {
    let count = chunk.count().ok_or("expected a count of samples, found none")?;
    let step_s = if stream.nominal_hz > 0.0 { 1.0 / stream.nominal_hz } else { 0.0 };
    let short = |k: usize| format!("expected {count} samples, found {k}");
    for k in 0..count {
        let [width] = chunk.array().ok_or_else(|| short(k))?;
        let stamp_s = match width {
            0 => stream.last_s + step_s,
            8 => chunk.double().filter(|x| x.is_finite()).ok_or_else(|| short(k))?,
            other => return Err(format!("expected a time of 0 or 8 bytes, found {other}")),
        };
        let channels = stream.channels;
        match &mut stream.cells {
            Cells::Texts(texts) => {
                let before = texts.len();
                for _ in 0..channels {
                    let Some(text) = chunk.count().and_then(|length| chunk.take(length)) else {
                        texts.truncate(before);
                        return Err(short(k));
                    };
                    texts.push(String::from_utf8_lossy(text).into_owned());
                }
            }
            Cells::Numbers(numbers) => match &stream.format[..] {
                "float32" => {
                    let raw = chunk.take(4 * channels).ok_or_else(|| short(k))?;
                    let values = raw.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
                    numbers.extend(values.map(f64::from));
                }
                _ => {
                    let raw = chunk.take(8 * channels).ok_or_else(|| short(k))?;
                    let eight =
                        |b: &[u8]| f64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]);
                    numbers.extend(raw.chunks_exact(8).map(eight));
                }
            },
            Cells::Integers(integers) => {
                let width = match &stream.format[..] {
                    "int8" => 1,
                    "int16" => 2,
                    "int32" => 4,
                    _ => 8,
                };
                let raw = chunk.take(width * channels).ok_or_else(|| short(k))?;
                // Sign-extended from the highest byte.
                let whole = |b: &[u8]| {
                    let mut all = [if b[width - 1] & 0x80 == 0 { 0 } else { 0xff }; 8];
                    all[..width].copy_from_slice(b);
                    i64::from_le_bytes(all)
                };
                integers.extend(raw.chunks_exact(width).map(whole));
            }
        }
        stream.last_s = stamp_s;
        stream.stamps_s.push(stamp_s);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chunk(tag: u16, content: &[u8]) -> Vec<u8> {
        let mut bytes = vec![4];
        bytes.extend((content.len() as u32 + 2).to_le_bytes());
        bytes.extend(tag.to_le_bytes());
        bytes.extend(content);
        bytes
    }

    fn example() -> Vec<u8> {
        let xml = |name: &str, format: &str, rate: &str| {
            format!(
                "<?xml version=\"1.0\"?><info><name>{name}</name><type>T</type><channel_count>2</channel_count>\
                 <nominal_srate>{rate}</nominal_srate><channel_format>{format}</channel_format></info>"
            )
        };
        let with_id = |id: u32, rest: &[u8]| [&id.to_le_bytes()[..], rest].concat();
        let mut bytes = b"XDF:".to_vec();
        bytes.extend(chunk(1, b"<info/>"));
        bytes.extend(chunk(2, &with_id(1, xml("a", "int16", "10").as_bytes())));
        bytes.extend(chunk(2, &with_id(2, xml("b", "string", "0").as_bytes())));
        let mut two = vec![1, 2, 8];
        two.extend(5.0f64.to_le_bytes());
        two.extend([1, 0, 0xff, 0xff, 0, 3, 0, 4, 0]);
        bytes.extend(chunk(3, &with_id(1, &two)));
        let mut text = vec![1, 1, 8];
        text.extend(5.05f64.to_le_bytes());
        text.extend([1, 2, b'h', b'i', 1, 0]);
        bytes.extend(chunk(3, &with_id(2, &text)));
        bytes.extend(chunk(4, &with_id(1, &[6.0f64.to_le_bytes(), 0.5f64.to_le_bytes()].concat())));
        bytes.extend(chunk(5, &BOUNDARY));
        bytes.extend(chunk(6, &with_id(1, b"<info/>")));
        bytes
    }

    #[test]
    fn streams_are_read() {
        let xdf = Xdf::parse(&example()).unwrap();
        assert_eq!(xdf.faults, Vec::<String>::new());
        let [a, b] = &xdf.streams[..] else { panic!("{xdf:?}") };
        assert_eq!(a.cells, Cells::Integers(vec![1, -1, 3, 4]));
        assert!((a.stamps_s[0] - 5.5).abs() < 1e-12 && (a.stamps_s[1] - 5.6).abs() < 1e-12);
        assert_eq!((&b.cells, b.stamps_s[0]), (&Cells::Texts(vec!["hi".to_owned(), String::new()]), 5.05));
    }

    #[test]
    fn behind_a_damaged_chunk_reading_goes_on_at_the_boundary() {
        let mut bytes = example();
        let boundary = bytes.windows(16).position(|window| window == BOUNDARY).unwrap();
        // A sample chunk of a stream that has no header, then the boundary and more.
        bytes.splice(boundary - 7..boundary - 7, chunk(3, &[9, 0, 0, 0, 1, 1, 0]));
        let xdf = Xdf::parse(&bytes).unwrap();
        assert_eq!((xdf.faults.len(), xdf.streams.len()), (1, 2), "{:?}", xdf.faults);
        assert!(xdf.faults[0].contains("expected a stream with a header, found number 9"));
        assert_eq!(Xdf::parse(b"XD"), None);
        assert_eq!(Xdf::parse(b"MCAP..."), None);
    }

    /// A count in the file is no reason to take memory.
    #[test]
    fn counts_are_not_believed() {
        let mut bytes = example();
        let mut huge = vec![1, 0, 0, 0, 8];
        huge.extend(u64::MAX.to_le_bytes());
        bytes.extend(chunk(3, &huge));
        bytes.extend([8, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x7f]);
        let xdf = Xdf::parse(&bytes).unwrap();
        assert!(xdf.faults[0].contains("samples, found 0"), "{:?}", xdf.faults);
        assert_eq!(xdf.streams[0].stamps_s.len(), 2);
    }
}
