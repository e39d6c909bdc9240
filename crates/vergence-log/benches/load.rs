//! A full load: 20 streams with 30,000 samples a second in all, and two cameras of 640×480 at 30 Hz.
//!
//! `cargo bench -p vergence-log --bench load` prints how the writer stands beside the bare `mcap` crate, what a minute of that load
//! costs, and how fast it is read again; `-- quick` makes the minute five seconds; `-- load`, `-- replay` and `-- throughput` do one only.
#![allow(clippy::unwrap_used, reason = "a benchmark stops where something is not as expected")]

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Instant;

use vergence_log::wire::Encoder;
use vergence_log::{
    Compression, Header, LogSource, Message, Options, Reader, Recorder, SourceLane, StreamDesc, Times,
};
use vergence_sense::{Image, Imu, Progress, Reading, ReadingKind, Sample, Sink, Source, SourceStream};
use vergence_time::{Clock, HostClock, Span, Timestamp};

const STREAMS: usize = 20;
const DEVICES: usize = 4;
const RATE_HZ: u64 = 1500;
const CAMERAS: usize = 2;
const PICTURES_HZ: u64 = 30;
const WIDTH: u32 = 640;
const HEIGHT: u32 = 480;

fn reading(step: u64) -> Imu {
    // Quantised as a device does it: 16 bits.
    let q = |phase: f64| ((step as f64 * 0.01 + phase).sin() * 3000.0).round() / 1024.0;
    let v = nalgebra::Vector3::new(q(0.0), q(1.0), q(2.0));
    Imu { gyr_rad_s: v, acc_m_s2: v * 3.0, mag_ut: None }
}

/// A picture with noise of 3 bits, as sensors have it in a dark room; each step another.
fn pictures() -> Vec<Vec<u8>> {
    let mut dice = 0x9E37_79B9_7F4A_7C15u64;
    let mut picture = || {
        (0..WIDTH * HEIGHT)
            .map(|pixel| {
                dice ^= dice << 13;
                dice ^= dice >> 7;
                dice ^= dice << 17;
                ((pixel % WIDTH / 4 + pixel / WIDTH / 8) & 0xF8) as u8 | (dice >> 61) as u8
            })
            .collect()
    };
    (0..8).map(|_| picture()).collect()
}

fn image(pixels: &[u8]) -> Image<'_> {
    Image { width: WIDTH, height: HEIGHT, step: WIDTH, encoding: "mono8".into(), data: pixels.into() }
}

/// Ten seconds of the load, in their order: each step of a 30th of a second has two pictures and a thousand readings.
const STEPS: u64 = 300;
const PER_STEP: u64 = STREAMS as u64 * RATE_HZ / PICTURES_HZ;

fn bare(path: &Path, compression: Compression, pictures: &[Vec<u8>]) -> (f64, u64) {
    // The level that the recorder has.
    let level = u32::from(compression == Compression::Zstd);
    let compression = match compression {
        Compression::None => None,
        Compression::Lz4 => Some(mcap::Compression::Lz4),
        Compression::Zstd => Some(mcap::Compression::Zstd),
    };
    let start = Instant::now();
    let options =
        mcap::WriteOptions::new().compression(compression).compression_level(level).compression_threads(0);
    let mut writer = options.create(BufWriter::new(File::create(path).unwrap())).unwrap();
    let imu = writer.add_schema("vergence.Imu", "protobuf", &Imu::SCHEMA.descriptor_set()).unwrap();
    let raw = writer.add_schema("vergence.Image", "protobuf", &Image::SCHEMA.descriptor_set()).unwrap();
    let mut channel =
        |schema, name: String| writer.add_channel(schema, &name, "protobuf", &BTreeMap::new()).unwrap();
    let units: Vec<u16> = (0..STREAMS).map(|i| channel(imu, format!("/imu/{i}"))).collect();
    let cameras: Vec<u16> = (0..CAMERAS).map(|i| channel(raw, format!("/camera/{i}"))).collect();
    let (mut payload, mut bytes, mut sequence) = (Vec::new(), 0, 0);
    let mut write = |channel_id, nanos: u64, payload: &[u8]| {
        sequence += 1;
        bytes += payload.len() as u64;
        let header =
            mcap::records::MessageHeader { channel_id, sequence, log_time: nanos, publish_time: nanos };
        writer.write_to_known_channel(&header, payload).unwrap();
    };
    for step in 0..STEPS {
        let nanos = step * 33_333_333;
        let times = Times::at(Timestamp::from_nanos(nanos as i64));
        for &camera in &cameras {
            payload.clear();
            image(&pictures[step as usize % pictures.len()]).encode(
                times,
                "",
                &mut Encoder::new(&mut payload),
            );
            write(camera, nanos, &payload);
        }
        for number in 0..PER_STEP {
            payload.clear();
            reading(step * PER_STEP + number).encode(times, "", &mut Encoder::new(&mut payload));
            write(units[number as usize % STREAMS], nanos, &payload);
        }
    }
    writer.finish().unwrap();
    drop(writer);
    (start.elapsed().as_secs_f64(), bytes)
}

fn ours(path: &Path, compression: Compression, pictures: &[Vec<u8>]) -> f64 {
    let start = Instant::now();
    // Unthrottled, the queue holds what the writer has not taken yet.
    let options = Options { compression, queue_bytes: 512 << 20, ..Options::default() };
    let mut recorder = Recorder::create(path, &Header::default(), &options).unwrap();
    let units: Vec<_> = (0..STREAMS)
        .map(|i| recorder.stream::<Imu>(&StreamDesc::new(format!("/imu/{i}"))).unwrap())
        .collect();
    let cameras: Vec<_> = (0..CAMERAS)
        .map(|i| recorder.stream::<Image<'_>>(&StreamDesc::new(format!("/camera/{i}"))).unwrap())
        .collect();
    for step in 0..STEPS {
        let times = Times::at(Timestamp::from_nanos(step as i64 * 33_333_333));
        for camera in &cameras {
            recorder.write(camera, times, &image(&pictures[step as usize % pictures.len()]));
        }
        for number in 0..PER_STEP {
            recorder.write(&units[number as usize % STREAMS], times, &reading(step * PER_STEP + number));
        }
    }
    assert_eq!(recorder.finish().unwrap().dropped, 0);
    start.elapsed().as_secs_f64()
}

fn throughput(folder: &Path, pictures: &[Vec<u8>]) {
    println!("payload throughput of ten seconds of the load, unthrottled, median of 7 rounds:");
    println!("| compression | bare mcap, MB/s | recorder, MB/s | recorder / bare |");
    println!("|---|---|---|---|");
    for compression in [Compression::Zstd, Compression::Lz4, Compression::None] {
        let (a, b) = (folder.join("a.mcap"), folder.join("b.mcap"));
        let mut payload = 0;
        let mut rounds: Vec<(f64, f64)> = (0..7)
            .map(|_| {
                let (bare_s, bytes) = bare(&a, compression, pictures);
                payload = bytes;
                (bare_s, ours(&b, compression, pictures))
            })
            .collect();
        rounds.sort_by(|x, y| (x.1 / x.0).total_cmp(&(y.1 / y.0)));
        let (bare_s, ours_s) = rounds[rounds.len() / 2];
        let rate = |secs: f64| payload as f64 * 1e-6 / secs;
        println!("| {compression:?} | {:.0} | {:.0} | {:.2} |", rate(bare_s), rate(ours_s), bare_s / ours_s);
    }
}

/// One device: some of the streams, a wake-up each millisecond, as a USB device is polled.
fn device(number: usize, mut lane: SourceLane, seconds: u64) -> u64 {
    let (clock, per_device) = (HostClock::start(), STREAMS / DEVICES);
    let (mut step, total) = (0, seconds * RATE_HZ);
    while step < total {
        let now = clock.now();
        let due = (now.as_nanos() as u64 * RATE_HZ / 1_000_000_000).min(total);
        while step < due {
            for stream in 0..per_device {
                let value = Reading::Imu(reading(step + (number * per_device + stream) as u64));
                lane.take(stream, Sample { captured: now, arrived: now, value });
            }
            step += 1;
        }
        clock.sleep_until(now.saturating_add(Span::from_millis(1)));
    }
    lane.taken()
}

fn camera(mut lane: SourceLane, seconds: u64, pictures: &[Vec<u8>]) -> u64 {
    let clock = HostClock::start();
    for step in 0..seconds * PICTURES_HZ {
        let now = clock.now();
        for stream in 0..CAMERAS {
            let value = Reading::Image(image(&pictures[(step as usize + stream) % pictures.len()]));
            lane.take(stream, Sample { captured: now, arrived: now, value });
        }
        clock.sleep_until(Timestamp::from_nanos(((step + 1) * 1_000_000_000 / PICTURES_HZ) as i64));
    }
    lane.taken()
}

fn cpu_secs() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

fn minute(path: &Path, seconds: u64, pictures: &[Vec<u8>]) {
    // As `vergence record` has them.
    let options = Options { queue_bytes: 32 << 20, ..Options::default() };
    let recorder = Recorder::create(path, &Header::default(), &options).unwrap();
    let recorder = Arc::new(Mutex::new(recorder));
    let streams = |kind, name: &str, count: usize| {
        (0..count).map(|i| SourceStream::new(format!("{name}/{i}"), kind)).collect::<Vec<_>>()
    };
    let lane = |name: &str, streams: &[SourceStream]| SourceLane::new(&recorder, name, streams).unwrap();
    let units: Vec<SourceLane> = (0..DEVICES)
        .map(|i| lane(&format!("device_{i}"), &streams(ReadingKind::Imu, "imu", STREAMS / DEVICES)))
        .collect();
    let cameras = lane("cameras", &streams(ReadingKind::Image, "camera", CAMERAS));
    let (cpu, start) = (cpu_secs(), Instant::now());
    let taken: u64 = std::thread::scope(|scope| {
        let units: Vec<_> = units
            .into_iter()
            .enumerate()
            .map(|(number, lane)| scope.spawn(move || device(number, lane, seconds)))
            .collect();
        let cameras = scope.spawn(move || camera(cameras, seconds, pictures));
        units.into_iter().chain([cameras]).map(|thread| thread.join().unwrap()).sum()
    });
    let secs = start.elapsed().as_secs_f64();
    let recorder = Arc::into_inner(recorder).unwrap().into_inner().unwrap();
    let dropped = recorder.finish().unwrap().dropped;
    let cpu = cpu_secs() - cpu;
    println!(
        "\n{secs:.1} s of 20 streams, 30,000 samples/s, and two cameras: {taken} samples, {dropped} dropped, {:.1} MB; \
         processor time {cpu:.2} s, {:.1} % of one core, sources included",
        std::fs::metadata(path).unwrap().len() as f64 * 1e-6,
        100.0 * cpu / secs
    );
}

/// Compares each sample with what was written.
struct Compared<'a>(u64, &'a [Imu]);

impl Sink for Compared<'_> {
    fn take(&mut self, stream: usize, sample: Sample<Reading<'_>>) {
        let number = self.0;
        assert_eq!(stream, number as usize % STREAMS, "in order");
        assert!(matches!(&sample.value, Reading::Imu(imu) if *imu == self.1[number as usize]), "equal");
        assert_eq!(sample.captured.as_nanos(), number as i64 * 33_333);
        self.0 += 1;
    }
}

fn again(path: &Path) {
    const COUNT: u64 = 60 * STREAMS as u64 * RATE_HZ;
    let options = Options { queue_bytes: 512 << 20, ..Options::default() };
    let mut recorder = Recorder::create(path, &Header::default(), &options).unwrap();
    let units: Vec<_> = (0..STREAMS)
        .map(|i| recorder.stream::<Imu>(&StreamDesc::new(format!("/imu/{i}"))).unwrap())
        .collect();
    let written: Vec<Imu> = (0..COUNT).map(reading).collect();
    for (number, imu) in written.iter().enumerate() {
        let times = Times::at(Timestamp::from_nanos(number as i64 * 33_333));
        recorder.write(&units[number % STREAMS], times, imu);
    }
    assert_eq!(recorder.finish().unwrap().dropped, 0);
    let (cpu, start) = (cpu_secs(), Instant::now());
    let mut source = LogSource::new(Reader::open(path).unwrap());
    let mut sink = Compared(0, &written);
    while source.advance(Timestamp::from_nanos(i64::MAX), &mut sink) != Progress::Ended {}
    let (secs, cpu) = (start.elapsed().as_secs_f64(), cpu_secs() - cpu);
    assert_eq!(sink.0, COUNT);
    println!(
        "replay at max: {COUNT} samples of 60 s, each equal and in order, in {secs:.2} s, {cpu:.2} s of processor time: \
         {:.0} times real time, {:.0} with a processor to itself",
        60.0 / secs,
        60.0 / cpu
    );
}

fn main() {
    let has = |wanted: &str| std::env::args().any(|argument| argument == wanted);
    let seconds = if has("quick") { 5 } else { 60 };
    // Memory-backed, where there is such a folder: it is the writer that is measured, not the disk.
    let shared = Path::new("/dev/shm");
    let folder = if shared.is_dir() { tempfile::tempdir_in(shared) } else { tempfile::tempdir() }.unwrap();
    let pictures = pictures();
    if has("replay") {
        return again(&folder.path().join("again.mcap"));
    }
    // A minute of pictures is more than a memory-backed folder should be asked for.
    let disk = tempfile::tempdir().unwrap();
    let minute = || minute(&disk.path().join("minute.mcap"), seconds, &pictures);
    if has("load") {
        return minute();
    }
    throughput(folder.path(), &pictures);
    if has("throughput") {
        return;
    }
    minute();
    again(&folder.path().join("again.mcap"));
}
