//! Broken logs: truncated, bits flipped, pieces moved, of a newer version. Always an error or a reading of what is whole,
//! never a panic, and never more memory than was agreed.
#![allow(clippy::unwrap_used, reason = "a test stops where something is not as expected")]

use std::path::{Path, PathBuf};

use peak_alloc::PeakAlloc;
use tempfile::TempDir;
use vergence_log::{
    Compression, Ending, Error, Header, Limits, Options, Reader, Recorder, StreamDesc, Survey, Times, repair,
};
use vergence_sense::{Event, Pose, Scalar};
use vergence_time::Timestamp;

#[global_allocator]
static PEAK: PeakAlloc = PeakAlloc;

/// Cases in all; as many of each kind.
const CASES: u64 = 2000;
/// What reading and repairing a file of 200 kB may take beside what the test holds: buffers of the reader and the
/// writer, compression contexts, and the limit on records.
const MEMORY_MIB: f32 = 24.0;
const LIMITS: Limits = Limits { record_bytes: 4 << 20, index_bytes: 4 << 20 };

/// A small generator (SplitMix64), so that a case can be run again by its number.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, end: usize) -> usize {
        (self.next() % end as u64) as usize
    }
}

/// A log of several chunks with everything in it; numbered messages, so that what is read can be judged.
fn whole(dir: &Path, compression: Compression) -> Vec<u8> {
    let path = dir.join("whole.mcap");
    let scene = dir.join("scene.txt");
    std::fs::write(&scene, "a scene ".repeat(500)).unwrap();
    let options = Options { compression, chunk_bytes: 8 << 10, ..Options::default() };
    let header = Header { application: "damage".into(), ..Header::default() };
    let mut recorder = Recorder::create(&path, &header, &options).unwrap();
    let number = recorder.stream::<Scalar>(&StreamDesc::new("/number")).unwrap();
    let head = recorder.stream::<Pose>(&StreamDesc::new("/head").frame("local")).unwrap();
    let event = recorder.stream::<Event>(&StreamDesc::new("/event")).unwrap();
    for step in 0..1000 {
        let times = Times::at(Timestamp::from_nanos(step * 1_000_000 - 5_000_000));
        recorder.write(&number, times, &Scalar(step as f64));
        if step % 4 == 0 {
            let there = vergence_geom::Rigid::translation(step as f64 * 1e-3, 1.6, -0.1);
            recorder.write(&head, times, &Pose::tracked(there));
        }
        if step % 100 == 0 {
            recorder.write(&event, times, &Event::new("state", "focused"));
        }
        if step == 500 {
            recorder.attach("scene.txt", "text/plain", &scene);
        }
    }
    recorder.finish().unwrap();
    std::fs::read(path).unwrap()
}

fn damage(kind: u64, whole: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = whole.to_vec();
    match kind {
        // Truncated.
        0 => bytes.truncate(random.below(whole.len())),
        // One to eight bits flipped, anywhere.
        1 => {
            for _ in 0..=random.below(8) {
                let at = random.below(bytes.len());
                bytes[at] ^= 1 << random.below(8);
            }
        }
        // Two pieces change places.
        2 => {
            let length = 1 + random.below(bytes.len() / 3);
            let first = random.below(bytes.len() - 2 * length);
            let second = first + length + random.below(bytes.len() - first - 2 * length + 1);
            let (left, right) = bytes.split_at_mut(second);
            left[first..first + length].swap_with_slice(&mut right[..length]);
        }
        // A length or a version that says something else: eight bytes of noise, small or huge.
        3 => {
            let at = random.below(bytes.len() - 8);
            let noise = random.next() >> random.below(64);
            bytes[at..at + 8].copy_from_slice(&noise.to_le_bytes());
        }
        // A piece is missing, or there twice.
        _ => {
            let at = random.below(bytes.len());
            let length = random.below((bytes.len() - at).min(5000) + 1);
            if random.below(2) == 0 {
                bytes.drain(at..at + length);
            } else {
                let piece = bytes[at..at + length].to_vec();
                bytes.splice(at..at, piece);
            }
        }
    }
    bytes
}

/// Reads to the end, on behind damage; what was read.
fn read(path: &Path) -> Result<(Vec<f64>, u64, Option<Ending>), Error> {
    let mut reader = Reader::open_with(path, LIMITS)?;
    let (mut numbers, mut damaged) = (Vec::new(), 0);
    loop {
        match reader.next() {
            Ok(Some(entry)) => {
                if entry.stream.name == "/number"
                    && let Ok(sample) = entry.decode::<Scalar>()
                {
                    numbers.push(sample.value.0);
                }
            }
            Ok(None) => return Ok((numbers, damaged, reader.ending())),
            Err(Error::Damaged { .. }) => damaged += 1,
            Err(error) => return Err(error),
        }
        assert!(damaged < 10_000, "damage without end");
    }
}

/// Notes of a few bytes each take many times as many in memory: they are counted while they are read, be they the
/// session's own, at the top of the file, or of a stream in a chunk.
fn many_notes(dir: &TempDir) {
    let mut notes = Vec::new();
    for number in 0u32..330_000 {
        notes.extend_from_slice(&3u32.to_le_bytes());
        notes.extend_from_slice(&number.to_le_bytes().map(|byte| byte & 0x7f)[..3]);
        notes.extend_from_slice(&0u32.to_le_bytes());
    }
    let text = |text: &str| [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat();
    let map = [&(notes.len() as u32).to_le_bytes()[..], &notes].concat();
    let record = |opcode: u8, body: &[u8]| [&[opcode][..], &(body.len() as u64).to_le_bytes(), body].concat();
    let channel = [&[1, 0, 0, 0][..], &text("/x"), &text("")].concat();
    let cases = [
        record(0x0c, &[text("vergence.session"), map.clone()].concat()),
        record(0x0c, &[text("notes"), map.clone()].concat()),
        record(0x04, &[channel, map].concat()),
    ];
    drop(notes);
    for (case, record) in cases.into_iter().enumerate() {
        let path = write(dir, &[b"\x89MCAP0\r\n".to_vec(), record].concat());
        PEAK.reset_peak_usage();
        let before = PEAK.current_usage_as_mb();
        let (numbers, damaged, _) = read(&path).unwrap();
        let took = PEAK.peak_usage_as_mb() - before;
        assert_eq!((numbers.len(), damaged), (0, 1), "case {case}");
        assert!(took < 10.0, "case {case}: {took} MiB");
    }
}

#[test]
fn broken_logs_are_read_as_far_as_they_are_whole() {
    let dir = TempDir::new().unwrap();
    many_notes(&dir);
    let path = dir.path().join("broken.mcap");
    let mended = dir.path().join("mended.mcap");
    let (mut refused, mut read_on, mut recovered) = (0, 0, 0u64);
    for compression in [Compression::Zstd, Compression::Lz4, Compression::None] {
        let good = whole(dir.path(), compression);
        let share = CASES / 3 + 1;
        for case in 0..share {
            let seed = case * 3 + compression as u64;
            let kind = case % 5;
            let broken = damage(kind, &good, &mut Random(seed));
            std::fs::write(&path, &broken).unwrap();
            drop(broken);
            PEAK.reset_peak_usage();
            let before = PEAK.current_usage_as_mb();
            let result = read(&path);
            let repaired = repair(&path, &mended, LIMITS, &mut |_, _| {});
            let surveyed =
                Reader::open_with(&path, LIMITS).and_then(|mut r| Survey::of(&mut r, &mut |_, _| {}));
            let took = PEAK.peak_usage_as_mb() - before;
            assert!(took < MEMORY_MIB, "case {seed}, kind {kind}: {took} MiB");
            assert_eq!(result.is_ok(), surveyed.is_ok(), "case {seed}");
            match (result, repaired) {
                (Ok((numbers, ..)), Ok(_)) => {
                    read_on += 1;
                    recovered += numbers.len() as u64;
                    let (again, damaged, ending) = read(&mended).unwrap();
                    assert_eq!((damaged, ending), (0, Some(Ending::Complete)), "case {seed}, kind {kind}");
                    assert_eq!(again, numbers, "case {seed}, kind {kind}");
                    // Chunks have checksums: what is read is what was written.
                    assert!(
                        numbers.iter().all(|n| (0.0..1000.0).contains(n) && n.fract() == 0.0),
                        "case {seed}"
                    );
                }
                (Err(error), Err(_)) => {
                    refused += 1;
                    assert!(error.to_string().contains("broken.mcap"), "{error}");
                }
                (read, repaired) => panic!("case {seed}, kind {kind}: read {read:?}, repaired {repaired:?}"),
            }
        }
    }
    println!("{read_on} read on, {refused} refused, {recovered} messages recovered of {}", 1000 * read_on);
    assert!(refused + read_on >= CASES && recovered > 500 * read_on, "{refused} {read_on} {recovered}");
}

fn write(dir: &TempDir, bytes: &[u8]) -> PathBuf {
    let path = dir.path().join("case.mcap");
    std::fs::write(&path, bytes).unwrap();
    path
}

#[test]
fn a_damaged_chunk_costs_that_chunk_and_no_more() {
    let dir = TempDir::new().unwrap();
    let mut bytes = whole(dir.path(), Compression::Zstd);
    let intact = write(&dir, &bytes);
    assert_eq!(read(&intact).unwrap().0.len(), 1000);
    let mut places = Vec::new();
    let mut reader = Reader::open(&intact).unwrap();
    while let Some(entry) = reader.next().unwrap() {
        places.push(entry.place.offset);
    }
    places.dedup();
    assert!(places.len() > 5, "several chunks");
    // Inside of the first chunk, where the streams are announced; and the length of another.
    bytes[places[0] as usize + 100] ^= 1;
    bytes[places[3] as usize + 1 + 6] ^= 0x40;
    let (numbers, damaged, ending) = read(&write(&dir, &bytes)).unwrap();
    assert_eq!((damaged, ending), (2, Some(Ending::Complete)));
    let chunks = places.len() as f64;
    assert!(numbers.len() as f64 > 1000.0 * (chunks - 3.0) / chunks, "{} of {chunks}", numbers.len());
}

#[test]
fn a_newer_log_is_refused_by_name() {
    let dir = TempDir::new().unwrap();
    let mut bytes = whole(dir.path(), Compression::Zstd);
    let at = bytes.windows(14).position(|w| w == b"format_version").unwrap();
    // Behind the name: the length of the value, then the value.
    assert_eq!(bytes[at + 18], b'1');
    bytes[at + 18] = b'2';
    let path = write(&dir, &bytes);
    let sentence = read(&path).unwrap_err().to_string();
    assert!(
        sentence.contains("case.mcap") && sentence.contains("format 1") && sentence.contains("'2'"),
        "{sentence}"
    );
    assert!(matches!(repair(&path, &dir.path().join("x"), LIMITS, &mut |_, _| {}), Err(Error::Newer { .. })));
}

#[test]
fn something_else_is_no_log() {
    let dir = TempDir::new().unwrap();
    for bytes in [&b""[..], b"\x89MCAP", b"\x89MCAP1\r\nabc", b"#!/bin/sh\nexit 0\n"] {
        let path = write(&dir, bytes);
        assert!(matches!(Reader::open(&path), Err(Error::NotALog { .. })), "{bytes:?}");
    }
    assert!(matches!(Reader::open(dir.path().join("none")), Err(Error::Read { .. })));
    let path = write(&dir, b"\x89MCAP0\r\n");
    let (numbers, _, ending) = read(&path).unwrap();
    assert_eq!((numbers.len(), ending), (0, Some(Ending::CutOff { at: 8 })));
}
