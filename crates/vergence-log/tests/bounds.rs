//! What reading may cost, whatever a file holds: bytes taken out of it, and memory.
#![allow(clippy::unwrap_used, reason = "a test stops where something is not as expected")]

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use peak_alloc::PeakAlloc;
use tempfile::TempDir;
use vergence_log::{
    Compression, Error, Header, Options, Reader, Recorder, Row, StreamDesc, Survey, Times, diff, repair,
};
use vergence_sense::Scalar;
use vergence_time::Timestamp;

#[global_allocator]
static PEAK: PeakAlloc = PeakAlloc;
/// Memory is counted of one test at a time.
static ALONE: Mutex<()> = Mutex::new(());

/// A head of a chunk without compression that announces `size` bytes of it.
fn chunk_head(size: u64) -> Vec<u8> {
    let mut head = vec![6];
    head.extend_from_slice(&(40 + size).to_le_bytes());
    head.extend_from_slice(&[0; 16]);
    head.extend_from_slice(&size.to_le_bytes());
    // A checksum that is wrong, and the name of no compression.
    head.extend_from_slice(&[1, 2, 3, 4, 0, 0, 0, 0]);
    head.extend_from_slice(&size.to_le_bytes());
    head
}

/// A file of `length` bytes full of heads of chunks that hold the rest of the file, or the next 64 kB; between them `between`.
fn nested(length: usize, holds: u64, between: &dyn Fn(u64) -> Vec<u8>) -> Vec<u8> {
    let mut bytes = b"\x89MCAP0\r\n".to_vec();
    while bytes.len() < length {
        let left = (length - bytes.len()) as u64;
        bytes.extend(chunk_head(left.saturating_sub(49).min(holds)));
        bytes.extend(between(left.saturating_sub(49 + 9)));
    }
    bytes
}

/// Reading to the end takes this many bytes out of the file and its chunks.
fn effort(path: &Path) -> (u64, u64) {
    let mut reader = Reader::open(path).unwrap();
    let mut damaged = 0;
    loop {
        match reader.next() {
            Ok(Some(_)) => {}
            Ok(None) => return (reader.effort_bytes(), damaged),
            Err(Error::Damaged { .. }) => damaged += 1,
            Err(error) => panic!("{error}"),
        }
    }
}

#[test]
fn a_file_that_was_made_to_mislead_is_read_in_time() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("nested.mcap");
    let notes = |left: u64| [&[0x0c][..], &left.to_le_bytes(), &[0xff; 16]].concat();
    let beyond = |_: u64| [&[0x0c][..], &u64::MAX.to_le_bytes(), &[0xff; 16]].concat();
    for megabytes in [1, 4] {
        let length = megabytes << 20;
        for (case, bytes) in [
            nested(length, u64::MAX, &|_| Vec::new()),
            nested(length, 64 << 10, &|_| Vec::new()),
            nested(length, u64::MAX, &notes),
            nested(length, 0, &beyond),
            nested(length, 64 << 10, &|_| vec![0xff; 7]),
        ]
        .into_iter()
        .enumerate()
        {
            std::fs::write(&path, bytes).unwrap();
            let (effort, damaged) = effort(&path);
            println!("{megabytes} MiB, case {case}: {damaged} places, {} MiB read", effort >> 20);
            // What may be read again, once more for the last one, and a constant for each place that is looked at.
            let most = 16 * length as u64 + (40 << 20) + damaged * 4096;
            assert!(effort < most, "{megabytes} MiB, case {case}: {effort} bytes of at most {most}");
        }
    }
    // As the tools do.
    Survey::of(&mut Reader::open(&path).unwrap(), &mut |_, _| {}).unwrap();
    repair(&path, &dir.path().join("mended.mcap"), vergence_log::Limits::default(), &mut |_, _| {}).unwrap();
}

fn at(nanos: i64) -> Timestamp {
    Timestamp::from_nanos(nanos)
}

/// A log with a stream of 48 MB, or with that stream announced and empty, and one that both have.
fn log(dir: &Path, name: &str, is_full: bool) -> PathBuf {
    let path = dir.join(name);
    let options = Options { compression: Compression::None, ..Options::default() };
    let mut recorder = Recorder::create(&path, &Header::default(), &options).unwrap();
    let large = recorder.stream::<Row<'_>>(&StreamDesc::new("/large")).unwrap();
    let both = recorder.stream::<Scalar>(&StreamDesc::new("/both")).unwrap();
    let numbers = vec![1.5; 2000];
    for step in 0..3000 {
        if is_full {
            recorder.write(
                &large,
                Times::at(at(step)),
                &Row { numbers: (&numbers[..]).into(), ..Row::default() },
            );
        }
        recorder.write(&both, Times::at(at(step)), &Scalar(step as f64));
        if step % 64 == 0 {
            recorder.sync().unwrap();
        }
    }
    assert_eq!(recorder.finish().unwrap().dropped, 0);
    path
}

/// A stream that only one log has says so with its first message, and the others need not be kept.
#[test]
fn a_comparison_keeps_what_it_compares() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let dir = TempDir::new().unwrap();
    let (full, empty) = (log(dir.path(), "full.mcap", true), log(dir.path(), "empty.mcap", false));
    for (a, b, side) in [(&full, &empty, "first"), (&empty, &full, "second")] {
        PEAK.reset_peak_usage();
        let before = PEAK.current_usage_as_mb();
        let found = diff(a, b, &mut |_, _| {}).unwrap();
        let took = PEAK.peak_usage_as_mb() - before;
        println!("{took:.1} MiB for a stream of 48 MB that only the {side} log has");
        assert!(took < 24.0, "{took} MiB");
        let of = |name: &str| found.streams.iter().find(|stream| stream.name == name).unwrap();
        assert_eq!((of("/both").equal_until, of("/both").first_difference.is_none()), (3000, true));
        let difference = of("/large").first_difference.as_ref().unwrap();
        assert_eq!(
            (difference.index, difference.sentence.as_str()),
            (0, &*format!("only the {side} log has it"))
        );
        assert_eq!(of("/large").count_a + of("/large").count_b, 3000);
    }
}
