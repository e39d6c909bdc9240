//! Anything at all, where devices and people say something: report descriptors and reports, what a serial port brings, mapping
//! files, configurations, lines of SDL's database. No panic, and no more memory than a device is worth.
//!
//! Each target runs for `VERGENCE_FUZZ_S` seconds of processor time (default 10), from examples that are cut, repeated, mixed and changed; the seed of a
//! failure is in its message.
#![cfg(all(feature = "serial", feature = "hid", feature = "gamepad"))]
#![allow(unsafe_code, reason = "an allocator that counts is an unsafe trait")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::path::Path;
use std::sync::{Arc, Once};
use std::time::Duration;

use vergence_input::gamepad::database;
use vergence_input::hid::descriptor;
use vergence_input::hid::{HidSource, Identity, Mapping, Reports};
use vergence_input::serial::frame::Frame;
use vergence_input::serial::{Description, Port, SerialConfig, SerialSource};
use vergence_sense::{Progress, Reading, Sample, Sink, Source};
use vergence_time::{Clock, HandClock, Span};

/// Of what one target holds.
const MOST_BYTES: isize = 64 << 20;

struct Counting;

thread_local! {
    // Of this thread: each target has one.
    static HELD: Cell<isize> = const { Cell::new(0) };
    static MOST: Cell<isize> = const { Cell::new(0) };
}

fn count(bytes: isize) {
    HELD.set(HELD.get() + bytes);
    MOST.set(MOST.get().max(HELD.get()));
}

// SAFETY: every call goes on to the system's allocator with what it was given; the counters touch no memory of callers.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size().cast_signed());
        // SAFETY: the caller's promise is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count(-layout.size().cast_signed());
        // SAFETY: the caller's promise is passed on.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

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
    fn changed(&mut self, examples: &[Vec<u8>], words: &[&[u8]], longest: usize) -> Vec<u8> {
        let mut bytes = examples[self.below(examples.len())].clone();
        for _ in 0..self.below(8) {
            let (at, length) = (self.below(bytes.len() + 1), self.below(24));
            let end = (at + length).min(bytes.len());
            match self.below(8) {
                0 if at < bytes.len() => bytes[at] = self.next() as u8,
                1 if at < bytes.len() => bytes[at] ^= 1 << self.below(8),
                2 => drop(bytes.drain(at..end)),
                3 => bytes.truncate(at),
                4 => {
                    let part = bytes[at..end].to_vec();
                    for _ in 0..self.below(40) {
                        bytes.splice(at..at, part.iter().copied());
                    }
                }
                5 => {
                    let word = words[self.below(words.len())];
                    bytes.splice(at..end, word.iter().copied());
                }
                6 => {
                    let other = &examples[self.below(examples.len())];
                    let from = self.below(other.len() + 1);
                    bytes.splice(at.., other[from..].iter().copied());
                }
                _ => {
                    let noise: Vec<u8> = (0..length).map(|_| self.next() as u8).collect();
                    bytes.splice(at..at, noise);
                }
            }
            bytes.truncate(longest);
        }
        bytes
    }
}

/// Of this thread: a machine that is busy with something else tests nothing.
fn processor_time() -> Duration {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    Duration::new(time.tv_sec.unsigned_abs(), time.tv_nsec as u32)
}

/// Runs a target until its time is over.
fn fuzz(name: &str, mut target: impl FnMut(&mut Dice)) {
    static QUIET: Once = Once::new();
    QUIET.call_once(|| {
        let hook = std::panic::take_hook();
        // The parser of descriptors panics, is caught, and need not say so a million times.
        std::panic::set_hook(Box::new(move |panic| {
            let file = panic.location().map_or("", |location| location.file());
            if !file.contains("/hidreport") && !file.contains("/hut") {
                hook(panic);
            }
        }));
    });
    let secs = std::env::var("VERGENCE_FUZZ_S").ok().and_then(|text| text.parse().ok()).unwrap_or(10.0);
    let (start, length) = (processor_time(), Duration::from_secs_f64(secs));
    let mut count = 0u64;
    // A longer run goes further along the same way; a fresh way where one is named.
    let first: u64 = std::env::var("VERGENCE_FUZZ_SEED").ok().and_then(|text| text.parse().ok()).unwrap_or(1);
    while processor_time() - start < length {
        let seed = first.wrapping_add(count).wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
        let run = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| target(&mut Dice(seed))));
        assert!(run.is_ok(), "{name}: run {count} (VERGENCE_FUZZ_SEED={})", first.wrapping_add(count));
        let held = MOST.get();
        assert!(held < MOST_BYTES, "{name}: run {count} (seed {first}): {held} bytes held");
        count += 1;
    }
    println!("{name}: {count} runs in {secs} s of processor time, at most {} KiB held", MOST.get() >> 10);
}

/// Counts what comes, and looks that no number is one that no reading may have.
#[derive(Default)]
struct Count(usize);

impl Sink for Count {
    fn take(&mut self, _: usize, sample: Sample<Reading<'_>>) {
        self.0 += 1;
        if let Reading::Axis(axis) = sample.value {
            assert!(axis.0.is_none_or(|value| (-1.0..=1.0).contains(&value)), "{axis:?}");
        }
    }
}

/// Accelerometer of the sensor page, a gamepad of the generic desktop page, a 6-DoF controller, an eye tracker.
fn descriptors() -> Vec<Vec<u8>> {
    let accelerometer = [
        0x05, 0x20, 0x09, 0x73, 0xA1, 0x01, 0x85, 0x01, 0x16, 0x01, 0x80, 0x26, 0xFF, 0x7F, 0x75, 0x10, 0x95,
        0x01, 0x55, 0x0E, 0x0A, 0x53, 0x04, 0x81, 0x02, 0x0A, 0x54, 0x04, 0x81, 0x02, 0x0A, 0x55, 0x04, 0x81,
        0x02, 0x0A, 0x29, 0x05, 0x15, 0x00, 0x75, 0x20, 0x55, 0x00, 0x81, 0x02, 0xC0,
    ];
    let pad = [
        0x05, 0x01, 0x09, 0x05, 0xA1, 0x01, 0xA1, 0x02, 0x09, 0x30, 0x09, 0x31, 0x09, 0x39, 0x15, 0x00, 0x26,
        0xFF, 0x00, 0x75, 0x08, 0x95, 0x03, 0x81, 0x42, 0x05, 0x09, 0x19, 0x01, 0x29, 0x0C, 0x25, 0x01, 0x75,
        0x01, 0x95, 0x0C, 0x81, 0x02, 0x95, 0x04, 0x81, 0x03, 0xC0, 0xA4, 0x06, 0x00, 0xFF, 0x09, 0x20, 0x95,
        0x07, 0x75, 0x08, 0xB1, 0x02, 0xB4, 0xC0,
    ];
    let six = [
        0x05, 0x01, 0x09, 0x08, 0xA1, 0x01, 0xA1, 0x00, 0x85, 0x01, 0x16, 0xA2, 0xFE, 0x26, 0x5E, 0x01, 0x09,
        0x30, 0x09, 0x31, 0x09, 0x32, 0x75, 0x10, 0x95, 0x03, 0x81, 0x06, 0xC0, 0xA1, 0x00, 0x85, 0x02, 0x09,
        0x33, 0x09, 0x34, 0x09, 0x35, 0x75, 0x10, 0x95, 0x03, 0x81, 0x06, 0xC0, 0xC0,
    ];
    let eyes = [
        0x05, 0x12, 0x09, 0x01, 0xA1, 0x01, 0x85, 0x10, 0x09, 0x20, 0x75, 0x40, 0x95, 0x01, 0x81, 0x02, 0x09,
        0x24, 0xA1, 0x00, 0x09, 0x21, 0x09, 0x22, 0x75, 0x20, 0x95, 0x02, 0x81, 0x02, 0xC0, 0x09, 0x25, 0xA1,
        0x00, 0x09, 0x21, 0x09, 0x22, 0x09, 0x23, 0x95, 0x03, 0x81, 0x02, 0xC0, 0x09, 0x26, 0xA1, 0x00, 0x09,
        0x21, 0x09, 0x22, 0x09, 0x23, 0x95, 0x03, 0x81, 0x02, 0xC0, 0xC0,
    ];
    vec![accelerometer.to_vec(), pad.to_vec(), six.to_vec(), eyes.to_vec()]
}

struct Said {
    descriptor: Vec<u8>,
    reports: Vec<Vec<u8>>,
    clock: Arc<HandClock>,
}

impl Reports for Said {
    fn read(&mut self, report: &mut [u8], _: Duration) -> std::io::Result<usize> {
        self.clock.advance_to(self.clock.now().saturating_add(Span::from_millis(1)));
        let Some(said) = self.reports.pop() else { return Err(std::io::ErrorKind::BrokenPipe.into()) };
        let length = said.len().min(report.len());
        report[..length].copy_from_slice(&said[..length]);
        Ok(length)
    }

    fn descriptor(&self) -> std::io::Result<Vec<u8>> {
        Ok(self.descriptor.clone())
    }
}

fn advance(source: &mut dyn Source, clock: &HandClock, sink: &mut Count) {
    for _ in 0..200 {
        let until = clock.now().saturating_add(Span::from_millis(100));
        if source.advance(until, sink) == Progress::Ended {
            return;
        }
    }
}

#[test]
fn hid_descriptors_and_reports() {
    let examples = descriptors();
    let words: [&[u8]; 10] = [
        &[0x97, 0xFF, 0xFF, 0xFF, 0xFF],
        &[0x77, 0xFF, 0xFF, 0xFF, 0x7F],
        &[0x2B, 0xFF, 0xFF, 0x00, 0x00],
        &[0xA4, 0xA4],
        &[0xB4],
        &[0x55, 0x08],
        &[0x95, 0x00],
        &[0x75, 0x00],
        &[0x85, 0x00],
        &[0xA1, 0x02],
    ];
    let mappings = Mapping::shipped();
    let mut given = 0;
    fuzz("HID descriptors and reports", |dice| {
        let bytes = dice.changed(&examples, &words, 5000);
        let lengths: Vec<usize> = match descriptor::Layout::parse(&bytes) {
            Ok(layout) => layout.reports.iter().map(|report| report.bytes).collect(),
            Err(_) => return,
        };
        let reports = (0..dice.below(20))
            .map(|_| {
                let length = match dice.below(3) {
                    0 => dice.below(70),
                    _ => lengths.get(dice.below(lengths.len())).copied().unwrap_or(0).min(20_000),
                };
                let mut report: Vec<u8> = (0..length).map(|_| dice.next() as u8).collect();
                if let Some(first) = report.first_mut() {
                    *first = [1, 2, 0x10, 0, 0xFF][dice.below(5)];
                }
                report
            })
            .collect();
        let clock = Arc::new(HandClock::default());
        let mut said = Some(Said { descriptor: bytes, reports, clock: clock.clone() });
        let opener = Box::new(move || {
            let said = said.take().ok_or(std::io::ErrorKind::NotFound)?;
            Ok(Box::new(said) as Box<dyn Reports>)
        });
        let mapping = mappings[dice.below(mappings.len())].clone();
        if let Ok(mut source) = HidSource::new("any".into(), opener, mapping, clock.clone()) {
            let mut sink = Count::default();
            advance(&mut source, &clock, &mut sink);
            given += sink.0;
        }
    });
    // Some of it must have come through, else the target tests nothing.
    assert!(given > 1000, "{given}");
}

struct Wire {
    bytes: Vec<u8>,
    at: usize,
    pieces: u64,
    clock: Arc<HandClock>,
}

impl Port for Wire {
    fn read(&mut self, buffer: &mut [u8], _: Duration) -> std::io::Result<usize> {
        self.clock.advance_to(self.clock.now().saturating_add(Span::from_millis(1)));
        if self.at == self.bytes.len() {
            return Err(std::io::ErrorKind::BrokenPipe.into());
        }
        self.pieces = self.pieces.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        let length =
            ((self.pieces >> 40) as usize % 700 + 1).min(self.bytes.len() - self.at).min(buffer.len());
        buffer[..length].copy_from_slice(&self.bytes[self.at..self.at + length]);
        self.at += length;
        Ok(length)
    }
}

#[test]
fn serial_frames_and_lines() {
    let mut frames = Vec::new();
    for (number, text) in [(1u8, "imu imu i16 0.001"), (2, "heart scalar u8 1 bpm"), (3, "head pose f32")] {
        let payload: Vec<u8> = std::iter::once(number).chain(text.bytes()).collect();
        Frame { stream: 0, sequence: u16::from(number), time_us: 0, payload: &payload }.encode(&mut frames);
    }
    for sequence in 3..20u16 {
        let payload = [sequence as u8; 12];
        Frame { stream: 1, sequence, time_us: u32::from(sequence) * 1000, payload: &payload }
            .encode(&mut frames);
        Frame { stream: 2, sequence: sequence + 1, time_us: u32::MAX, payload: &payload[..1] }
            .encode(&mut frames);
    }
    let lines = b"time_ms,seq,gx,gy,gz,ax,ay,az,heart_bpm\n1.5,1,0.1,-0.2,3e-4,0,0,9.81,60\n2.5,2,nan,inf,,1,2,3,4\r\n".to_vec();
    let numbers: Vec<u8> = (0..50).flat_map(|n| format!("{n},{},-1e308\n", n * n).into_bytes()).collect();
    let examples = [frames, lines, numbers, vec![0xAA; 3000]];
    let words: [&[u8]; 8] =
        [b",", b"\n", b"time_us", b"-1e400", &[0xFF; 4], &[0; 9], b"99999999999999999999", b"\xF0\x9F"];
    let mut given = 0;
    fuzz("serial frames and lines", |dice| {
        let bytes = dice.changed(&examples, &words, 60_000);
        let clock = Arc::new(HandClock::default());
        let pieces = dice.next();
        let mut wire = Some(Wire { bytes, at: 0, pieces, clock: clock.clone() });
        let opener = Box::new(move || {
            let wire = wire.take().ok_or(std::io::ErrorKind::NotFound)?;
            Ok(Box::new(wire) as Box<dyn Port>)
        });
        let mut source = SerialSource::new(opener, SerialConfig::default(), clock.clone());
        let mut sink = Count::default();
        advance(&mut source, &clock, &mut sink);
        given += sink.0;
        assert!(source.streams().len() < 4000, "{} streams", source.streams().len());
    });
    assert!(given > 1000, "{given}");
}

#[test]
fn texts_of_people() {
    let own = |name: &str| {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("mappings").join(name);
        std::fs::read(path).expect("a mapping that is shipped")
    };
    let config = b"[serial]\nbaud = 921600\nformat = \"frames\"\nleast_latency = \"2 ms\"\ncolumns = \"a,b\"\n[serial.streams]\n1 = \"imu imu i16 0.001\"\n".to_vec();
    let pads: Vec<u8> = database::SHIPPED.bytes().skip(300_000).take(1500).collect();
    let description = b"imu imu i16 0.001 0.002 rad/s".to_vec();
    let examples =
        [own("six-dof.toml"), own("sensor-imu.toml"), own("eye-tracker.toml"), config, pads, description];
    let words: [&[u8]; 10] = [
        b"\"",
        b"[[stream]]\n",
        b"99999999999",
        b"-1",
        b"1e999",
        b"@1:65535:f64",
        b"ffff:ffff",
        b"\0",
        "é".as_bytes(),
        b"a:b255,",
    ];
    let file = tempfile::NamedTempFile::new().expect("a file");
    let (mut good, mut written) = (0, 0u32);
    fuzz("texts of people", |dice| {
        let bytes = dice.changed(&examples, &words, 20_000);
        let text = String::from_utf8_lossy(&bytes);
        if let Ok(mapping) = Mapping::parse(Path::new("any.toml"), &text) {
            good += 1;
            mapping.fits(&Identity { vendor_id: 1, product_id: 1, usages: vec![(1, 8)] });
        }
        good += u32::from(text.parse::<Description>().is_ok());
        good += database::lines(&text).filter(Result::is_ok).count() as u32;
        written += 1;
        // Files are slow; a configuration is a text as the others are.
        if written % 16 == 0 {
            std::fs::write(file.path(), &bytes).expect("written");
            good += u32::from(vergence_input::Config::read(file.path()).is_ok());
        }
    });
    assert!(good > 100, "{good}");
}
