//! `vergence devices`, `record` and `replay` as users call them, on a serial device behind a pseudo terminal.

use std::fs::File;
use std::io::Write;
use std::process::{Command, Stdio};
use std::time::Duration;

use serialport::{SerialPort, TTYPort};
use vergence_input::serial::frame::Frame;
use vergence_tests::{last_object, vergence};

const FRAMES: u16 = 2000;
/// From here on, three sequence numbers are missing.
const GAP_AT: u16 = 700;

fn frames() -> Vec<u8> {
    let mut bytes = Vec::new();
    Frame { stream: 0, sequence: 0, time_us: 0, payload: b"\x01number scalar u16 bpm" }.encode(&mut bytes);
    for number in 0..FRAMES {
        let sequence = number + 1 + if number >= GAP_AT { 3 } else { 0 };
        let payload = number.to_le_bytes();
        Frame { stream: 1, sequence, time_us: u32::from(number) * 1000, payload: &payload }
            .encode(&mut bytes);
    }
    bytes
}

#[test]
fn a_device_is_recorded_until_interrupted_and_played_again() {
    let folder = tempfile::tempdir().expect("a folder");
    let log = folder.path().join("device.mcap");
    let (mut device, mut terminal) = TTYPort::pair().expect("a pseudo terminal");
    terminal.set_exclusive(false).expect("others may open it");
    let path = terminal.name().expect("a terminal has a path");
    // Keeps the terminal as it is, without the lock of a port that is in use.
    let held = File::open(&path).expect("a terminal");
    drop(terminal);
    let mut record = Command::new(vergence())
        .args(["record", "--json", "--device", &format!("serial:{path}")])
        .arg(&log)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the tool starts");
    // Waits for the recorder, which alone reads.
    let writer = std::thread::spawn(move || {
        device.write_all(&frames()).expect("written");
        device
    });
    while !writer.is_finished() || rustix::io::ioctl_fionread(&held).expect("a count") > 0 {
        if record.try_wait().expect("a process").is_some() {
            let output = record.wait_with_output().expect("it ended");
            panic!("it ended early: {}", String::from_utf8_lossy(&output.stderr));
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    let id = rustix::process::Pid::from_raw(record.id().cast_signed()).expect("a running process");
    rustix::process::kill_process(id, rustix::process::Signal::INT).expect("interrupted");
    let record = record.wait_with_output().expect("it ends");
    assert!(record.status.success(), "{}", String::from_utf8_lossy(&record.stderr));
    drop(writer.join());
    let report = last_object(&String::from_utf8_lossy(&record.stdout)).expect("a report");
    // Besides the numbers there are two events, connected and the gap, and the clock's residual, once a second at most.
    let samples = report["samples"].as_u64().expect("a count");
    assert!(samples >= u64::from(FRAMES) + 3, "{report}");
    assert_eq!(
        (report["streams"].as_u64(), report["dropped"].as_u64(), report["gaps"].as_u64()),
        (Some(3), Some(0), Some(1))
    );
    assert_eq!(report["bytes"].as_u64(), std::fs::metadata(&log).ok().map(|file| file.len()));

    let replay = |rest: &[&str]| {
        let output =
            Command::new(vergence()).arg("replay").arg(&log).args(rest).output().expect("the tool starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).expect("text")
    };
    let again = last_object(&replay(&["--speed", "max", "--json"])).expect("a report");
    for key in ["streams", "samples", "dropped", "gaps", "bytes"] {
        assert_eq!(again[key], report[key], "{key}");
    }
    let printed = replay(&["--print", "number"]);
    let numbers = printed
        .lines()
        .map(|line| line.rsplit(' ').next().expect("a value").parse::<u16>().expect("a number"));
    assert!(numbers.eq(0..FRAMES), "{printed}");
    for line in printed.lines() {
        let times: Vec<i64> =
            line.split(' ').take(2).map(|time| time.parse().expect("nanoseconds")).collect();
        assert!(times[0] <= times[1], "captured before it arrived: {line}");
    }
}

#[test]
fn what_cannot_be_read_is_said() {
    let run = |arguments: &[&str]| {
        let output = Command::new(vergence()).args(arguments).output().expect("the tool starts");
        (
            output.status.code(),
            String::from_utf8_lossy(&output.stdout).into_owned(),
            String::from_utf8_lossy(&output.stderr).into_owned(),
        )
    };
    let (status, out, _) = run(&["devices", "list", "--json"]);
    let list: serde_json::Value = serde_json::from_str(&out).expect("JSON");
    assert_eq!(status, Some(0));
    for device in list.as_array().expect("an array") {
        for key in ["name", "adapter", "path", "vendor_id", "product_id", "streams", "problem", "remedy"] {
            assert!(device.get(key).is_some(), "{key} of {device}");
        }
    }
    let (status, out, _) = run(&["devices", "list"]);
    assert!(status == Some(0) && !out.trim().is_empty(), "an empty list is a sentence: {out}");
    let (status, _, err) = run(&["record", "--device", "no such thing", "/dev/null/x.mcap"]);
    assert!(status == Some(2) && err.contains("found 'no such thing'"), "{status:?} {err}");
    let (status, _, err) = run(&["record", "--device", "serial:/dev/no-such-port", "/dev/null/x.mcap"]);
    assert!(status == Some(1) && err.contains("/dev/no-such-port: cannot be opened"), "{status:?} {err}");
}
