//! What the serial source costs beside a loop that only reads, over a pseudo terminal; and a minute of a device at 1 kHz.
//!
//! `cargo bench -p vergence-input --bench serial` prints both; `-- quick` leaves the minute out. Without a pause a device sends frame
//! after frame, each with a write of its own; in one write of them all, only the kernel's copying stands beside the source's work.
#![allow(clippy::unwrap_used, reason = "a benchmark stops where something is not as expected")]

use std::io::Write;
use std::sync::Arc;
use std::time::{Duration, Instant};

use serialport::{SerialPort, TTYPort};
use vergence_input::serial::frame::Frame;
use vergence_input::serial::{Port, SerialConfig, SerialSource};
use vergence_sense::{Reading, Sample, Sink, Source};
use vergence_time::{Clock, HostClock, Span};

const FRAMES: u32 = 200_000;

/// An inertial reading.
fn frame(number: u32, out: &mut Vec<u8>) {
    let payload: Vec<u8> = (0..6).flat_map(|axis| ((number + axis) as i16).to_le_bytes()).collect();
    let time_us = number.wrapping_mul(1000);
    Frame { stream: 1, sequence: number as u16, time_us, payload: &payload }.encode(out);
}

fn pair() -> (TTYPort, Box<dyn Port>) {
    let (device, host) = TTYPort::pair().unwrap();
    (device, Box::new(Box::new(host) as Box<dyn SerialPort>))
}

#[derive(Default)]
struct Count(u64, f64);

impl Sink for Count {
    fn take(&mut self, _: usize, sample: Sample<Reading<'_>>) {
        if let Reading::Imu(imu) = sample.value {
            self.0 += 1;
            self.1 += imu.gyr_rad_s.x;
        }
    }
}

/// Sends all in pieces of `piece` bytes.
fn written(mut device: TTYPort, bytes: Vec<u8>, piece: usize) -> std::thread::JoinHandle<TTYPort> {
    std::thread::spawn(move || {
        bytes.chunks(piece).for_each(|piece| device.write_all(piece).unwrap());
        device
    })
}

/// Seconds that a loop which only reads takes.
fn bare(bytes: &[u8], piece: usize) -> f64 {
    let (device, mut host) = pair();
    let (start, mut buffer, mut left) = (Instant::now(), vec![0; 16 << 10], bytes.len());
    let writer = written(device, bytes.to_vec(), piece);
    while left > 0 {
        left -= host.read(&mut buffer, Duration::from_millis(100)).unwrap();
    }
    drop(writer.join());
    start.elapsed().as_secs_f64()
}

fn source(host: Box<dyn Port>) -> SerialSource {
    let config =
        SerialConfig { streams: vec![(1, "imu imu i16 0.001".parse().unwrap())], ..SerialConfig::default() };
    let mut host = Some(host);
    let opener = move || host.take().ok_or_else(|| std::io::ErrorKind::NotFound.into());
    SerialSource::new(Box::new(opener), config, Arc::new(HostClock::start()))
}

/// Advances until `count` frames have come.
fn run(source: &mut SerialSource, count: u64) -> Count {
    let (clock, mut sink) = (HostClock::start(), Count::default());
    while source.totals().frames.frames < count {
        source.advance(clock.now().saturating_add(Span::from_millis(100)), &mut sink);
    }
    sink
}

fn ours(bytes: &[u8], piece: usize) -> f64 {
    let (device, host) = pair();
    let mut source = source(host);
    let start = Instant::now();
    let writer = written(device, bytes.to_vec(), piece);
    let count = run(&mut source, u64::from(FRAMES));
    let secs = start.elapsed().as_secs_f64();
    assert_eq!((count.0, source.totals().lost), (u64::from(FRAMES), 0), "{:?}", source.totals());
    drop(writer.join());
    secs
}

fn main() {
    let mut bytes = Vec::new();
    (0..FRAMES).for_each(|number| frame(number, &mut bytes));
    println!("{FRAMES} frames, {:.1} MB, median of 9 rounds, 0 lost:", bytes.len() as f64 * 1e-6);
    for (piece, how) in [(bytes.len() / FRAMES as usize, "frame by frame"), (bytes.len(), "in one write")] {
        let mut rounds: Vec<(f64, f64)> =
            (0..9).map(|_| (bare(&bytes, piece), ours(&bytes, piece))).collect();
        rounds.sort_by(|a, b| (a.1 / a.0).total_cmp(&(b.1 / b.0)));
        let (bare_s, ours_s) = rounds[rounds.len() / 2];
        let rate = |secs: f64| f64::from(FRAMES) / secs * 1e-3;
        println!(
            "sent {how}: reading only {:.0} k frames/s, source {:.0} k frames/s; {:.3} of it",
            rate(bare_s),
            rate(ours_s),
            bare_s / ours_s
        );
    }
    if std::env::args().any(|argument| argument == "quick") {
        return;
    }
    const MINUTE: u32 = 60_000;
    let (mut device, host) = pair();
    let writer = std::thread::spawn(move || {
        let start = Instant::now();
        for number in 0..MINUTE {
            let mut bytes = Vec::new();
            frame(number, &mut bytes);
            device.write_all(&bytes).unwrap();
            let due = start + Duration::from_millis(u64::from(number));
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
        }
        device
    });
    let mut source = source(host);
    let count = run(&mut source, u64::from(MINUTE));
    println!("1 kHz for 60 s: {} readings, {:?}, clock {:?}", count.0, source.totals(), source.clock_state());
    drop(writer.join());
}
