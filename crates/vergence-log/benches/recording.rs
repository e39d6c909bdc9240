//! What recording costs: the frame thread per frame, and the whole against the bare `mcap` crate.
//!
//! `cargo bench -p vergence-log` prints two tables; figures depend on the machine and what else it does.
#![allow(clippy::unwrap_used, reason = "a benchmark stops where something is not as expected")]

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::time::{Duration, Instant};

use vergence_log::wire::Encoder;
use vergence_log::{Compression, Header, Message, Options, Reader, Recorder, StreamDesc, Times};
use vergence_sense::{
    Axis, Button, FrameTiming, Imu, JOINTS_PER_HAND, RawJoint, RawJoints, RawLocation, RawPose, RawView,
    RawViews, Scalar, Validity, Vector2,
};
use vergence_time::{Span, Timestamp};

fn header() -> Header {
    Header::default()
}

/// A frame of a session: 20 messages (head, views twice, 4 hand poses, 2 hands' joints, 8 actions, times, 2 numbers).
fn frames(path: &std::path::Path, count: i64) {
    let mut recorder = Recorder::create(path, &header(), &Options::default()).unwrap();
    let local = |name: String| StreamDesc::new(name).frame("local");
    let poses: Vec<_> =
        (0..5).map(|i| recorder.stream::<RawLocation>(&local(format!("/pose/{i}"))).unwrap()).collect();
    let views: Vec<_> =
        (0..2).map(|i| recorder.stream::<RawViews>(&local(format!("/views/{i}"))).unwrap()).collect();
    let hands: Vec<_> =
        (0..2).map(|i| recorder.stream::<RawJoints>(&local(format!("/hand/{i}"))).unwrap()).collect();
    let buttons: Vec<_> =
        (0..4).map(|i| recorder.stream::<Button>(&local(format!("/button/{i}"))).unwrap()).collect();
    let axes: Vec<_> =
        (0..2).map(|i| recorder.stream::<Axis>(&local(format!("/axis/{i}"))).unwrap()).collect();
    let sticks: Vec<_> =
        (0..2).map(|i| recorder.stream::<Vector2>(&local(format!("/stick/{i}"))).unwrap()).collect();
    let numbers: Vec<_> =
        (0..2).map(|i| recorder.stream::<Scalar>(&local(format!("/cpu/{i}"))).unwrap()).collect();
    let timing = recorder.stream::<FrameTiming>(&local("/frame".to_owned())).unwrap();
    let mut took = Vec::new();
    for step in 0..count {
        let now = Timestamp::from_nanos(step * 11_111_111);
        let times = Times::at(now);
        let pose =
            RawPose { position_m: [step as f32 * 1e-3, 1.6, -0.1], orientation_xyzw: [0.1, 0.2, 0.3, 0.927] };
        let location = RawLocation { pose, validity: Validity::ALL, velocity: None };
        let view = RawView { pose, fov_rad: [-0.8, 0.7, 0.75, -0.8] };
        let two = RawViews::new(Validity::ALL, &[view; 2]).unwrap();
        let joint = RawJoint { pose, validity: Validity::ALL, radius_m: 0.01 };
        let joints = RawJoints { is_active: true, joints: [joint; JOINTS_PER_HAND] };
        let start = Instant::now();
        poses.iter().for_each(|stream| recorder.write(stream, times, &location));
        views.iter().for_each(|stream| recorder.write(stream, times, &two));
        hands.iter().for_each(|stream| recorder.write(stream, times, &joints));
        buttons.iter().for_each(|stream| recorder.write(stream, times, &Button(Some(step % 2 == 0))));
        axes.iter().for_each(|stream| recorder.write(stream, times, &Axis(Some(0.25))));
        sticks.iter().for_each(|stream| recorder.write(stream, times, &Vector2(Some([0.5, -0.5]))));
        numbers.iter().for_each(|stream| recorder.write(stream, times, &Scalar(1.5)));
        recorder.write(
            &timing,
            times,
            &FrameTiming {
                frame: step as u64,
                wait_returned: now,
                begun: now,
                submitted: Some(now),
                predicted_display: now,
                predicted_period: Span::from_millis(11),
                should_render: true,
                presented: None,
                raw_display: now,
                raw_period: Span::from_millis(11),
                ended: true,
            },
        );
        took.push(start.elapsed());
        std::thread::sleep(Duration::from_millis(2));
    }
    let dropped = recorder.finish().unwrap().dropped;
    took.sort();
    let at = |part: f64| took[((took.len() - 1) as f64 * part) as usize].as_secs_f64() * 1e6;
    println!(
        "frame thread, 20 messages: median {:.1} µs, p95 {:.1} µs, p99 {:.1} µs, worst {:.1} µs over {count} frames; \
         {dropped} dropped",
        at(0.5),
        at(0.95),
        at(0.99),
        at(1.0)
    );
}

fn reading(step: u64) -> Imu {
    // Quantised as a device does it: 16 bits.
    let q = |phase: f64| ((step as f64 * 0.01 + phase).sin() * 3000.0).round() / 1024.0;
    let v = nalgebra::Vector3::new(q(0.0), q(1.0), q(2.0));
    Imu { gyr_rad_s: v, acc_m_s2: v * 3.0, mag_ut: None }
}

const MESSAGES: u64 = 300_000;

fn bare(path: &std::path::Path, compression: Compression) -> (f64, u64) {
    let compression = match compression {
        Compression::None => None,
        Compression::Lz4 => Some(mcap::Compression::Lz4),
        Compression::Zstd => Some(mcap::Compression::Zstd),
    };
    let start = Instant::now();
    let sink = BufWriter::new(File::create(path).unwrap());
    let options = mcap::WriteOptions::new().compression(compression).compression_threads(0);
    let mut writer = options.create(sink).unwrap();
    let schema = writer.add_schema("vergence.Imu", "protobuf", &Imu::SCHEMA.descriptor_set()).unwrap();
    let channels: Vec<u16> = (0..20)
        .map(|i| writer.add_channel(schema, &format!("/imu/{i}"), "protobuf", &BTreeMap::new()).unwrap())
        .collect();
    let mut payload = Vec::new();
    for step in 0..MESSAGES {
        payload.clear();
        let times = Times::at(Timestamp::from_nanos(step as i64 * 33_333));
        reading(step).encode(times, "", &mut Encoder::new(&mut payload));
        let header = mcap::records::MessageHeader {
            channel_id: channels[step as usize % 20],
            sequence: (step / 20) as u32,
            log_time: step * 33_333,
            publish_time: step * 33_333,
        };
        writer.write_to_known_channel(&header, &payload).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    (start.elapsed().as_secs_f64(), std::fs::metadata(path).unwrap().len())
}

fn ours(path: &std::path::Path, compression: Compression) -> (f64, f64, u64, u64) {
    let start = Instant::now();
    let options = Options { compression, queue_bytes: 64 << 20, ..Options::default() };
    let mut recorder = Recorder::create(path, &header(), &options).unwrap();
    let streams: Vec<_> =
        (0..20).map(|i| recorder.stream::<Imu>(&StreamDesc::new(format!("/imu/{i}"))).unwrap()).collect();
    for step in 0..MESSAGES {
        let times = Times::at(Timestamp::from_nanos(step as i64 * 33_333));
        recorder.write(&streams[step as usize % 20], times, &reading(step));
    }
    let thread = start.elapsed().as_secs_f64();
    let dropped = recorder.finish().unwrap().dropped;
    (start.elapsed().as_secs_f64(), thread, std::fs::metadata(path).unwrap().len(), dropped)
}

fn main() {
    let dir = tempfile::TempDir::new().unwrap();
    frames(&dir.path().join("frames.mcap"), 3000);
    println!("\n{MESSAGES} inertial readings on 20 streams (20 × 1.5 kHz is 30 thousand a second):");
    println!(
        "| compression | bare mcap, k/s | recorder, k/s | of it on the caller's thread, ns each | MB | MB | dropped | read, k/s |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for compression in [Compression::Zstd, Compression::Lz4, Compression::None] {
        let path = dir.path().join("a.mcap");
        let (bare_s, bare_bytes) = bare(&path, compression);
        let path = dir.path().join("b.mcap");
        let (all_s, thread_s, bytes, dropped) = ours(&path, compression);
        let start = Instant::now();
        let mut reader = Reader::open(&path).unwrap();
        let mut count = 0u64;
        while let Some(entry) = reader.next().unwrap() {
            count += u64::from(entry.decode::<Imu>().is_ok());
        }
        let read_s = start.elapsed().as_secs_f64();
        let rate = |n: u64, s: f64| n as f64 / s * 1e-3;
        println!(
            "| {compression:?} | {:.0} | {:.0} | {:.0} | {:.1} | {:.1} | {dropped} | {:.0} |",
            rate(MESSAGES, bare_s),
            rate(MESSAGES, all_s),
            thread_s / MESSAGES as f64 * 1e9,
            bare_bytes as f64 * 1e-6,
            bytes as f64 * 1e-6,
            rate(count, read_s)
        );
    }
    // Cameras: 4 × 640×480 at 30 Hz, beside them.
    let path = dir.path().join("c.mcap");
    let options = Options { compression: Compression::Lz4, queue_bytes: 64 << 20, ..Options::default() };
    let mut recorder = Recorder::create(&path, &header(), &options).unwrap();
    let camera = recorder.stream::<vergence_sense::Image<'_>>(&StreamDesc::new("/camera")).unwrap();
    let pixels: Vec<u8> =
        (0..640 * 480).map(|i: usize| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
    let start = Instant::now();
    for step in 0..480 {
        let data = pixels.as_slice().into();
        let image =
            vergence_sense::Image { width: 640, height: 480, step: 640, encoding: "mono8".into(), data };
        recorder.write(&camera, Times::at(Timestamp::from_nanos(step * 8_333_333)), &image);
        std::thread::sleep(Duration::from_millis(4));
    }
    let dropped = recorder.finish().unwrap().dropped;
    let secs = start.elapsed().as_secs_f64();
    println!(
        "\n480 pictures of 640×480 (4 s of four cameras at 30 Hz): {:.0} MB/s; {dropped} dropped",
        480.0 * 0.3072 / secs
    );
}
