//! Anything at all where a file of somebody else is read: XDF recordings and tables. No panic, and no more memory than a small file is
//! worth.
//!
//! Each target runs for `VERGENCE_FUZZ_S` seconds of processor time (default 2), from examples that are cut, repeated, mixed and
//! changed; the case of a failure is in its message.
#![allow(clippy::unwrap_used, reason = "a test stops where something is not as expected")]

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use peak_alloc::PeakAlloc;
use vergence_log::foreign::{Cells, Table, Xdf};

#[global_allocator]
static PEAK: PeakAlloc = PeakAlloc;
/// Memory is counted of one target at a time.
static ALONE: Mutex<()> = Mutex::new(());
/// Of a file of at most [`LONGEST`] bytes.
const MOST_BYTES: usize = 16 << 20;
const LONGEST: usize = 64 << 10;

/// xorshift64*: Vigna 2016.
struct Dice(u64);

impl Dice {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    fn below(&mut self, limit: usize) -> usize {
        if limit == 0 { 0 } else { (self.next() >> 33) as usize % limit }
    }

    /// One of the examples, damaged.
    fn changed(&mut self, examples: &[Vec<u8>], words: &[&[u8]]) -> Vec<u8> {
        let mut bytes = examples[self.below(examples.len())].clone();
        for _ in 0..1 + self.below(6) {
            let (at, length) = (self.below(bytes.len() + 1), self.below(60));
            let end = (at + length).min(bytes.len());
            match self.below(7) {
                0 if at < bytes.len() => bytes[at] ^= 1 << self.below(8),
                1 if at < bytes.len() => bytes[at] = self.next() as u8,
                2 => drop(bytes.drain(at..end)),
                3 => bytes.truncate(at),
                4 => {
                    let piece = bytes[at..end].to_vec();
                    let to = self.below(bytes.len() + 1);
                    bytes.splice(to..to, piece);
                }
                5 => {
                    let other = &examples[self.below(examples.len())];
                    let from = self.below(other.len() + 1);
                    bytes.splice(at.., other[from..].iter().copied());
                }
                _ => {
                    let word = words[self.below(words.len())];
                    let end = (at + self.below(word.len() + 1)).min(bytes.len());
                    bytes.splice(at..end, word.iter().copied());
                }
            }
            bytes.truncate(LONGEST);
        }
        bytes
    }
}

fn processor_secs() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// Runs a target until its time is over.
fn fuzz(name: &str, mut target: impl FnMut(&mut Dice)) {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let secs: f64 = std::env::var("VERGENCE_FUZZ_S").ok().and_then(|text| text.parse().ok()).unwrap_or(2.0);
    let (begin, before) = (processor_secs(), PEAK.current_usage());
    let (mut count, mut most) = (0u64, 0);
    while processor_secs() - begin < secs {
        PEAK.reset_peak_usage();
        let mut dice = Dice((count + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
        let run = catch_unwind(AssertUnwindSafe(|| target(&mut dice)));
        assert!(run.is_ok(), "{name}: case {count}");
        most = most.max(PEAK.peak_usage().saturating_sub(before));
        assert!(most < MOST_BYTES, "{name}: case {count}: {most} bytes held");
        count += 1;
    }
    println!("{name}: {count} cases in {secs} s of processor time, at most {} KiB held", most >> 10);
}

fn count(cells: &Cells) -> usize {
    match cells {
        Cells::Numbers(all) => all.len(),
        Cells::Integers(all) => all.len(),
        Cells::Texts(all) => all.len(),
    }
}

const BOUNDARY: [u8; 16] =
    [0x43, 0xA5, 0x46, 0xDC, 0xCB, 0xF5, 0x41, 0x0F, 0xB3, 0x0E, 0xD5, 0x46, 0x73, 0x83, 0xCB, 0xE4];

fn chunk(tag: u16, content: &[u8]) -> Vec<u8> {
    let mut bytes = vec![4];
    bytes.extend((content.len() as u32 + 2).to_le_bytes());
    bytes.extend(tag.to_le_bytes());
    bytes.extend(content);
    bytes
}

/// A stream of each format, samples with and without times, an offset of the clock, a boundary, the ends.
fn recording() -> Vec<u8> {
    let mut bytes = b"XDF:".to_vec();
    bytes.extend(chunk(1, b"<?xml version=\"1.0\"?><info><version>1.0</version></info>"));
    let formats = [
        ("float32", 4),
        ("double64", 8),
        ("int8", 1),
        ("int16", 2),
        ("int32", 4),
        ("int64", 8),
        ("string", 0),
    ];
    for (id, (format, size)) in (1u32..).zip(formats) {
        let info = format!(
            "<?xml version=\"1.0\"?><info><name>{format}</name><type>T</type><channel_count>2</channel_count>\
             <nominal_srate>10</nominal_srate><channel_format>{format}</channel_format><desc><channels><channel>\
             <label>x</label></channel></channels></desc></info>"
        );
        bytes.extend(chunk(2, &[&id.to_le_bytes()[..], info.as_bytes()].concat()));
        let mut samples = id.to_le_bytes().to_vec();
        samples.extend([1, 3]);
        for number in 0..3u8 {
            if number == 1 {
                samples.push(0);
            } else {
                samples.push(8);
                samples.extend((5.0 + f64::from(number)).to_le_bytes());
            }
            for _ in 0..2 {
                match size {
                    0 => samples.extend([1, 2, b'h', number]),
                    size => samples.extend((0..size).map(|k| number * k)),
                }
            }
        }
        bytes.extend(chunk(3, &samples));
        let offset = [id.to_le_bytes().to_vec(), 6.0f64.to_le_bytes().into(), 0.5f64.to_le_bytes().into()];
        bytes.extend(chunk(4, &offset.concat()));
        bytes.extend(chunk(5, &BOUNDARY));
        bytes.extend(chunk(
            6,
            &[&id.to_le_bytes()[..], b"<info><first_timestamp>5</first_timestamp></info>"].concat(),
        ));
    }
    bytes
}

#[test]
fn fuzz_xdf() {
    let mut examples = vec![recording()];
    assert_eq!(Xdf::parse(&examples[0]).unwrap().faults, Vec::<String>::new(), "the example is well");
    if let Some(data) = std::env::var_os("VERGENCE_DATA") {
        let file = |name| std::fs::read(Path::new(&data).join("xdf").join(name)).ok();
        examples.extend(["minimal.xdf", "empty_streams.xdf"].into_iter().filter_map(file));
    }
    let words: [&[u8]; 9] = [
        &BOUNDARY,
        &[8, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x7F],
        &[4, 0xFF, 0xFF, 0xFF, 0xFF],
        b"<channel_count>4294967295</channel_count>",
        b"<nominal_srate>-1e300</nominal_srate>",
        b"<channel_format>string</channel_format>",
        b"<!DOCTYPE a [<!ENTITY a \"&b;&b;\">]>",
        &[0, 0, 0, 0, 0, 0, 0xF8, 0x7F],
        &[0, 0, 0, 0, 0, 0, 0xF0, 0xFF],
    ];
    let mut good = 0;
    fuzz("XDF", |dice| {
        let Some(xdf) = Xdf::parse(&dice.changed(&examples, &words)) else { return };
        for stream in &xdf.streams {
            assert_eq!(count(&stream.cells), stream.stamps_s.len() * stream.channels);
            good += stream.stamps_s.len();
        }
    });
    assert!(good > 1000, "{good} samples: the rest tested nothing");
}

#[test]
fn fuzz_csv() {
    let examples = [
        b"t_ms,a,\"b \"\"c\"\n1.5,2,x\n-3e2,,9\n4,nan,\"y\n\"\n".to_vec(),
        b"captured_ns;arrived_ns;x;y\r\n1;2;0.5;-7\r\n3;4;1e9;inf\r\n".to_vec(),
        b"t_s\tevent\n0\tbegin\n1\tend\n".to_vec(),
    ];
    for example in &examples {
        assert!(Table::parse(example, None).is_ok(), "the examples are well");
    }
    let words: [&[u8]; 12] = [
        b",",
        b";",
        b"\t",
        b"\"",
        b"\r\n",
        b"\n",
        b"\xFF",
        b"1e999",
        b"-9223372036854775808",
        b"99999999999999999999",
        b"captured_ns,arrived_ns",
        b",,,,,,,,,,,,,,,,,,,,,,,,,,,,,,,,",
    ];
    let mut good = 0;
    fuzz("CSV", |dice| {
        let bytes = dice.changed(&examples, &words);
        let Ok(table) = Table::parse(&bytes, None) else { return };
        let rows = table.captured.len();
        assert!(rows <= bytes.len() && table.arrived.is_none_or(|all| all.len() == rows));
        for column in &table.columns {
            assert_eq!(count(&column.cells), rows);
        }
        good += rows;
    });
    assert!(good > 1000, "{good} rows: the rest tested nothing");
}
