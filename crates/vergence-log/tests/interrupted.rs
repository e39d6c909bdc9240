//! Recordings that do not end well: killed at any moment, on a full disk, under `--durable`.
//!
//! The recordings run in processes of their own: this test's executable, told by its environment what to do.
#![allow(clippy::unwrap_used, reason = "a test stops where something is not as expected")]

mod python;

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use tempfile::TempDir;
use vergence_log::{
    Ending, Error, Header, Limits, Options, Reader, Recorder, StreamDesc, Survey, Times, repair,
};
use vergence_sense::{Button, RawLocation, RawPose, Scalar, Validity};
use vergence_time::Timestamp;

const TASK: &str = "VERGENCE_LOG_TEST_TASK";
const FILE: &str = "VERGENCE_LOG_TEST_FILE";
/// Moments at which recordings are killed.
const KILLS: u32 = 50;
/// Recordings at a time.
const AT_A_TIME: usize = 10;
/// What may be lost: the last second.
const LOST_AT_MOST: Duration = Duration::from_secs(1);

/// A location that is made from its number alone, with bits that arithmetic would not keep.
fn location(step: i64) -> RawLocation {
    let pose = RawPose {
        position_m: [step as f32 * 0.1, -0.0, f32::from_bits(0x7fa0_0000 | step as u32 & 0xffff)],
        orientation_xyzw: [0.0, (step as f32).sin(), 0.0, (step as f32).cos()],
    };
    RawLocation { pose, validity: Validity::ALL, velocity: None }
}

fn recorder(path: &Path, durable: bool) -> Recorder {
    let header = Header { application: "interrupted".into(), ..Header::default() };
    Recorder::create(path, &header, &Options { durable, ..Options::default() }).unwrap()
}

/// Records as a session does: a frame every 4 ms with a pose, a button and a number; says of each frame its number, when it was
/// recorded, and how long the writer was away from the queues at most so far, nanoseconds of one clock.
fn record_until_killed(path: &Path, durable: bool) {
    let mut recorder = recorder(path, durable);
    let head = recorder.stream::<RawLocation>(&StreamDesc::new("/head").frame("local")).unwrap();
    let select = recorder.stream::<Button>(&StreamDesc::new("/select")).unwrap();
    let load = recorder.stream::<Scalar>(&StreamDesc::new("/load").host_time()).unwrap();
    let began = Instant::now();
    for step in 0.. {
        let times = Times::at(Timestamp::from_nanos(step * 4_000_000 - 1_000_000_000));
        recorder.write(&head, times, &location(step));
        recorder.write(&select, times, &Button(Some(step % 2 == 0)));
        recorder.write(&load, times, &Scalar(step as f64));
        // The later is looked at later: it covers the earlier.
        let recorded = began.elapsed().as_nanos();
        println!("frame {step} {recorded} {}", recorder.longest_away().as_nanos());
        std::thread::sleep(Duration::from_millis(4));
    }
}

/// Records until the disk is full, goes on as a session would, and judges what is left.
fn record_on_a_full_disk(path: &Path) {
    let mut recorder = recorder(path, false);
    let head = recorder.stream::<RawLocation>(&StreamDesc::new("/head").frame("local")).unwrap();
    let noise = recorder.stream::<Scalar>(&StreamDesc::new("/noise")).unwrap();
    let mut failure = None;
    let mut after = 0;
    let began = Instant::now();
    for step in 0..i64::MAX {
        let times = Times::at(Timestamp::from_nanos(step * 1_000_000));
        recorder.write(&head, times, &location(step));
        for part in 0..20 {
            // Not to be compressed.
            let bits = (step as u64 * 20 + part).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0x1234_5678;
            recorder.write(&noise, times, &Scalar(f64::from_bits(bits.wrapping_mul(0xbf58_476d_1ce4_e5b9))));
        }
        if step % 20 == 0 {
            std::thread::sleep(Duration::from_millis(1));
        }
        failure = failure.or_else(|| recorder.failure());
        after += u32::from(failure.is_some());
        if after > 5000 {
            break;
        }
        assert!(began.elapsed() < Duration::from_secs(60), "the disk does not fill");
    }
    let failure: Error = failure.unwrap();
    let sentence = format!("{failure}: {}", std::error::Error::source(&failure).unwrap());
    println!("error: {sentence}");
    assert!(
        matches!(failure, Error::Write { .. }) && sentence.contains(path.to_str().unwrap()),
        "{sentence}"
    );
    assert!(recorder.failure().is_none(), "it is said once");
    assert!(recorder.status().failed);
    assert!(recorder.finish().is_ok(), "it was said before");
    let length = std::fs::metadata(path).unwrap().len();
    let mut reader = Reader::open(path).unwrap();
    let mut steps = 0;
    while let Some(entry) = reader.next().unwrap() {
        if entry.stream.name == "/head" {
            assert_eq!(entry.decode::<RawLocation>().unwrap().value, location(steps));
            steps += 1;
        }
    }
    println!("good: {steps} frames, {length} bytes, {:?}", reader.ending());
    assert!(steps > 500 && length > 500_000 && length <= 1 << 20, "{steps} {length}");
    // It says of itself that it is not all.
    assert!(matches!(reader.ending(), Some(Ending::Failed { .. })), "{:?}", reader.ending());
    let survey = Survey::of(&mut Reader::open(path).unwrap(), &mut |_, _| {}).unwrap();
    assert!(!survey.complete && !survey.is_well() && survey.failed.is_some(), "{survey:?}");
    let system = std::error::Error::source(&failure).unwrap().to_string();
    println!("why: {}", survey.failed.as_ref().unwrap());
    if survey.metadata.iter().any(|name| name == "vergence.failed") {
        assert_eq!(survey.failed, Some(system));
    }
}

/// What the other tests start as a process of its own; on its own it does nothing.
#[test]
fn child() {
    let (Ok(task), Ok(file)) = (std::env::var(TASK), std::env::var(FILE)) else { return };
    match task.as_str() {
        "record" => record_until_killed(Path::new(&file), false),
        "durable" => record_until_killed(Path::new(&file), true),
        "full" => record_on_a_full_disk(Path::new(&file)),
        other => panic!("task '{other}'"),
    }
}

fn executable() -> String {
    std::env::current_exe().unwrap().to_str().unwrap().to_owned()
}

const ARGUMENTS: [&str; 4] = ["child", "--exact", "--nocapture", "--test-threads=1"];

/// What became of one recording.
struct Killed {
    /// From the first frame that is not in the file to the last that was recorded, by the recording's clock.
    lost: Duration,
    /// The longest that the writer was away from the queues: what the disk and the other processes made of it.
    away: Duration,
    frames: i64,
}

/// A frame as the recording says it.
#[derive(Clone, Copy)]
struct Heard {
    recorded: Duration,
    away: Duration,
}

impl Heard {
    fn of(line: &str) -> Option<Self> {
        let mut words = line.split("frame ").nth(1)?.split(' ').skip(1).map(str::parse);
        let mut next = || Some(Duration::from_nanos(words.next()?.ok()?));
        Some(Self { recorded: next()?, away: next()? })
    }
}

/// Starts a recording, kills it `after` its first frame, repairs the file and compares.
fn kill_one(dir: &Path, number: u32, after: Duration, durable: bool) -> Killed {
    let path = dir.join(format!("killed-{number}.mcap"));
    let mended = dir.join(format!("mended-{number}.mcap"));
    let mut child = Command::new(executable())
        .args(ARGUMENTS)
        .env(TASK, if durable { "durable" } else { "record" })
        .env(FILE, &path)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let mut heard = Vec::new();
    let mut first = None;
    while first.is_none_or(|first: Instant| first.elapsed() < after) {
        let line = lines.next().unwrap().unwrap();
        if let Some(frame) = Heard::of(&line) {
            first.get_or_insert_with(Instant::now);
            heard.push(frame);
        }
    }
    child.kill().unwrap();
    child.wait().unwrap();
    // What it had said and nobody had heard; the last line may be half a line.
    let rest: Vec<String> = lines.map_while(Result::ok).collect();
    heard.extend(rest[..rest.len().saturating_sub(1)].iter().filter_map(|line| Heard::of(line)));

    let found = repair(&path, &mended, Limits::default(), &mut |_, _| {}).unwrap();
    assert!(!found.was_complete && found.damaged.is_empty() && found.missing == 0, "{found:?}");
    // What the broken file holds and what the mended one holds is the same, byte for byte.
    let (mut broken, mut whole) = (Reader::open(&path).unwrap(), Reader::open(&mended).unwrap());
    let mut frames = 0;
    loop {
        let (old, new) = (broken.next().unwrap(), whole.next().unwrap());
        let key = |entry: &vergence_log::Entry<'_>| {
            let name = entry.stream.name.clone();
            (name, entry.sequence, entry.log_time, entry.publish_time, entry.payload.to_vec())
        };
        assert_eq!(old.as_ref().map(key), new.as_ref().map(key));
        let Some(entry) = new else { break };
        if entry.stream.name == "/head" {
            let sample = entry.decode::<RawLocation>().unwrap();
            assert_eq!(sample.value, location(frames));
            assert_eq!(sample.arrived.as_nanos(), frames * 4_000_000 - 1_000_000_000);
            frames += 1;
        }
    }
    assert!(matches!(broken.ending(), Some(Ending::CutOff { .. })), "{:?}", broken.ending());
    assert_eq!(whole.ending(), Some(Ending::Complete));
    let survey = Survey::of(&mut Reader::open(&mended).unwrap(), &mut |_, _| {}).unwrap();
    assert!(survey.is_well(), "{:?}", survey.findings);
    assert!(survey.failed.is_none() && survey.repaired.unwrap().contains("cut_off_at"));
    let last = heard[heard.len() - 1];
    let lost = heard.get(frames as usize).map_or(Duration::ZERO, |first| last.recorded - first.recorded);
    Killed { lost, away: last.away, frames }
}

#[test]
fn a_killed_recording_loses_at_most_its_last_second() {
    let dir = TempDir::new().unwrap();
    // Where somebody wants to look at the files with other readers.
    let kept = std::env::var_os("VERGENCE_LOG_KEEP").map(std::path::PathBuf::from);
    let dir = kept.as_deref().unwrap_or(dir.path());
    std::fs::create_dir_all(dir).unwrap();
    let began = Instant::now();
    let numbers: Vec<u32> = (0..KILLS).collect();
    let mut all = Vec::new();
    for batch in numbers.chunks(AT_A_TIME) {
        std::thread::scope(|scope| {
            let one = |&number: &u32| {
                // 0 to 2.5 s, spread evenly by the golden ratio, with the remainder of a clock on top.
                let part = f64::from(number) * 0.618_033_988_75 % 1.0;
                let clock = Duration::from_nanos(u64::from(began.elapsed().subsec_nanos()) % 5_000_000);
                let after = Duration::from_secs_f64(2.5 * part) + clock;
                scope.spawn(move || kill_one(dir, number, after, number % 5 == 0))
            };
            let running: Vec<_> = batch.iter().map(one).collect();
            all.extend(running.into_iter().map(|thread| thread.join().unwrap()));
        });
    }
    let longest = all.iter().map(|killed| killed.lost).max().unwrap();
    let frames: i64 = all.iter().map(|killed| killed.frames).sum();
    let away = all.iter().map(|killed| killed.away).max().unwrap();
    println!("{KILLS} kills: at most {longest:?} lost (the bar: {LOST_AT_MOST:?}); {frames} frames kept");
    println!("the writer waited for the disk and for processors for at most {away:?} at a time");
    // A chunk ends in time by the writer's own clock, whatever else the machine does: what keeps the writer away comes on top, at
    // each of four steps (`Recorder::longest_away`). Where nothing does, that is half a second: the bar, with as much to spare.
    for Killed { lost, away, .. } in all {
        assert!(lost <= Options::default().chunk_every + 4 * away, "{lost:?}, away {away:?}");
    }
    assert!(Options::default().chunk_every * 2 <= LOST_AT_MOST);
    assert!(frames > 0);
    // What was mended is read by others, too.
    if let Some(python) = python::find() {
        let mended: Vec<_> = (0..KILLS).map(|number| dir.join(format!("mended-{number}.mcap"))).collect();
        python::decode(&python, &mended);
    }
}

fn run(shell: &str, file: &Path) -> (bool, String) {
    let output = Command::new("bash")
        .args(["-c", shell, &executable()])
        .env(TASK, "full")
        .env(FILE, file)
        .output()
        .unwrap();
    let said =
        String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    (output.status.success(), said)
}

#[test]
fn a_file_that_may_not_grow_beyond_a_mebibyte_is_good_so_far() {
    let dir = TempDir::new().unwrap();
    let arguments = ARGUMENTS.join(" ");
    // A limit of the process (RLIMIT_FSIZE); its signal is ignored, so that writing fails instead.
    let (done, said) = run(
        &format!("trap '' XFSZ; ulimit -f 1024; exec \"$0\" {arguments}"),
        &dir.path().join("limited.mcap"),
    );
    assert!(done && said.contains("good: "), "{said}");
    print!(
        "{}",
        said.lines().filter(|line| line.contains(": ")).map(|l| format!("{l}\n")).collect::<String>()
    );
    // What others make of it, and what a repair does.
    let limited = dir.path().join("limited.mcap");
    if let Some(python) = python::find() {
        python::decode(&python, std::slice::from_ref(&limited));
    }
    let mended = dir.path().join("mended.mcap");
    let found = repair(&limited, &mended, Limits::default(), &mut |_, _| {}).unwrap();
    assert!(found.recording_failed && !found.was_complete && found.cut_off_at.is_some(), "{found:?}");
    assert_eq!((found.damaged_count, found.lost_bytes_at_end, found.missing), (0, 0, 0));
    let survey = Survey::of(&mut Reader::open(&mended).unwrap(), &mut |_, _| {}).unwrap();
    assert!(survey.complete && survey.messages == found.messages);
    assert!(survey.repaired.unwrap().contains("recording_failed 1"));
}

#[test]
fn a_disk_of_a_mebibyte_is_good_so_far() {
    let dir = TempDir::new().unwrap();
    let there = dir.path().to_str().unwrap();
    let arguments = ARGUMENTS.join(" ");
    let mount = format!("mount -t tmpfs -o size=1m tmpfs '{there}'");
    // In a mount namespace of its own, which nobody else sees.
    let probe = Command::new("unshare").args(["-m", "-r", "sh", "-c", &mount]).output();
    if !probe.is_ok_and(|output| output.status.success()) {
        let required = std::env::var("VERGENCE_REQUIRE").unwrap_or_default();
        assert!(!required.split(',').any(|name| name.trim() == "tmpfs"), "VERGENCE_REQUIRE names tmpfs");
        println!("skipped: no tmpfs (one of a mebibyte cannot be mounted here)");
        return;
    }
    let shell = format!(
        "export PROGRAM=\"$0\"; exec unshare -m -r sh -c \"{mount} && exec \\\"\\$PROGRAM\\\" {arguments}\""
    );
    let (done, said) = run(&shell, &dir.path().join("full.mcap"));
    assert!(done && said.contains("good: "), "{said}");
    print!(
        "{}",
        said.lines().filter(|line| line.contains(": ")).map(|l| format!("{l}\n")).collect::<String>()
    );
}

#[test]
fn a_durable_recording_is_whole() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("durable.mcap");
    let mut recorder = recorder(&path, true);
    let head = recorder.stream::<RawLocation>(&StreamDesc::new("/head")).unwrap();
    for step in 0..100 {
        recorder.write(&head, Times::at(Timestamp::from_nanos(step)), &location(step));
    }
    recorder.finish().unwrap();
    assert_eq!(Reader::read_all::<RawLocation>(&path, "/head").unwrap().len(), 100);
}
