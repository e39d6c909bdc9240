//! `vergence devices`, `record` and `replay` as users call them: on a serial device behind a pseudo terminal, on the eyes of who wears a
//! headset, and on nothing at all.

use std::fs::File;
use std::io::{BufRead as _, BufReader, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU16, Ordering};
use std::time::Duration;

use nalgebra::{Point3, Vector3};
use serialport::{SerialPort, TTYPort};
use vergence_input::hid::{HidSource, Mapping, Reports};
use vergence_input::serial::frame::Frame;
use vergence_log::{LogSource, Reader};
use vergence_sense::{Gaze, Progress, Reading, ReadingKind, Sample, Source, SourceStream};
use vergence_sim::gamepad::{Gamepad, Held, Params, button};
use vergence_tests::{last_object, skip, vergence};
use vergence_time::{Clock, HandClock, Span, Timestamp};

type Samples = Vec<(usize, Sample<Reading<'static>>)>;

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
    // The same gap, whoever counts.
    let check = Command::new(vergence())
        .args(["log", "check", "--json"])
        .arg(&log)
        .output()
        .expect("the tool starts");
    let survey = last_object(&String::from_utf8_lossy(&check.stdout)).expect("a survey");
    let of_events: Vec<_> = survey["streams"]
        .as_array()
        .expect("streams")
        .iter()
        .filter(|stream| stream["type"] == "Event" && stream["count"] != 0)
        .map(|stream| (stream["gaps"].as_u64(), stream["device_missing"].as_u64()))
        .collect();
    assert_eq!(of_events, [(Some(1), Some(3))], "{survey}");
    assert_eq!(
        (report["missing"].as_u64(), report["broken"].as_u64(), report["unread"].as_u64()),
        (Some(3), Some(0), Some(0))
    );
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

/// What a container has: neither input nor serial devices, nor the folders that would list them.
#[test]
fn without_any_folder_of_devices_the_list_is_empty_and_a_sentence() {
    // In a mount namespace of its own; an empty folder takes the place of all classes of devices.
    let script = "mkdir -p \"$1/empty\" && mount --bind \"$1/empty\" /sys/class && mount -t tmpfs none /dev && \
                  test ! -e /dev/input && test ! -e /sys/class/tty && test ! -e /sys/class/hidraw && \
                  \"$2\" devices list && exec \"$2\" devices list --json";
    let folder = tempfile::tempdir().expect("a folder");
    let probe = Command::new("unshare").args(["-m", "-r", "sh", "-c", "mount -t tmpfs none /dev"]).output();
    match probe {
        Ok(output) if output.status.success() => {}
        Ok(output) => return skip("tmpfs", String::from_utf8_lossy(&output.stderr).trim()),
        Err(error) => return skip("tmpfs", &error.to_string()),
    }
    let output = Command::new("unshare")
        .args(["-m", "-r", "sh", "-c", script, "sh"])
        .arg(folder.path())
        .arg(vergence())
        .output()
        .expect("unshare is there, as was just seen");
    let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert_eq!((output.status.code(), &*err), (Some(0), ""), "{out}");
    assert!(
        out.starts_with("No gamepad, HID device with a mapping, or USB serial device is plugged in.\n"),
        "{out}"
    );
    assert_eq!(out.lines().last(), Some("[]"), "{out}");
}

/// Everything that a source gives until it has no more.
fn all(source: &mut dyn Source, until: Timestamp) -> (Vec<SourceStream>, Samples) {
    let mut samples = Samples::new();
    while source.advance(until, &mut samples) == Progress::Gave {}
    (source.streams().to_vec(), samples)
}

/// The stream of gazes, and what came of it.
fn gazes((streams, samples): (Vec<SourceStream>, Samples)) -> (SourceStream, Vec<Sample<Gaze>>) {
    let place =
        streams.iter().position(|stream| stream.kind == ReadingKind::Gaze).expect("a stream of gazes");
    let gaze = |(stream, sample): (usize, Sample<Reading<'static>>)| match sample.value {
        Reading::Gaze(Some(value)) if stream == place => {
            Some(Sample { captured: sample.captured, arrived: sample.arrived, value })
        }
        _ => None,
    };
    (streams[place].clone(), samples.into_iter().filter_map(gaze).collect())
}

/// An eye tracker on a desk, as the eye and head tracker page has it: time in µs, the point that is looked at, both eyes in µm.
struct Tracker {
    reports: Vec<Vec<u8>>,
    clock: Arc<HandClock>,
}

const TRACKER: [u8; 72] = [
    0x05, 0x12, 0x09, 0x01, 0xA1, 0x01, 0x85, 0x10, 0x09, 0x20, 0x75, 0x40, 0x95, 0x01, 0x81, 0x02, 0x17,
    0x00, 0x00, 0x00, 0x80, 0x27, 0xFF, 0xFF, 0xFF, 0x7F, 0x09, 0x24, 0xA1, 0x00, 0x09, 0x21, 0x09, 0x22,
    0x75, 0x20, 0x95, 0x02, 0x81, 0x02, 0xC0, 0x09, 0x25, 0xA1, 0x00, 0x09, 0x21, 0x09, 0x22, 0x09, 0x23,
    0x95, 0x03, 0x81, 0x02, 0xC0, 0x09, 0x26, 0xA1, 0x00, 0x09, 0x21, 0x09, 0x22, 0x09, 0x23, 0x95, 0x03,
    0x81, 0x02, 0xC0, 0xC0,
];

impl Reports for Tracker {
    fn read(&mut self, report: &mut [u8], _: Duration) -> std::io::Result<usize> {
        self.clock.advance_to(self.clock.now().saturating_add(Span::from_millis(10)));
        let said = self.reports.pop().ok_or(std::io::ErrorKind::BrokenPipe)?;
        report[..said.len()].copy_from_slice(&said);
        Ok(said.len())
    }

    fn descriptor(&self) -> std::io::Result<Vec<u8>> {
        Ok(TRACKER.to_vec())
    }
}

/// Of 20 reports; the user looks at a point 0.3 m to the right of the display's corner and 0.2 m below it.
fn of_a_tracker() -> (SourceStream, Vec<Sample<Gaze>>) {
    let clock = Arc::new(HandClock::default());
    let report = |number: u64| {
        let mut bytes = vec![0x10];
        bytes.extend((number * 10_000).to_le_bytes());
        // Micrometres: the point; the left eye; the right eye.
        for place in [300_000i32, 200_000, 270_000, 100_000, 600_000, 330_000, 100_000, 600_000] {
            bytes.extend(place.to_le_bytes());
        }
        bytes
    };
    let reports = (0..20).rev().map(report).collect();
    let mut tracker = Some(Tracker { reports, clock: clock.clone() });
    let opener = Box::new(move || {
        let tracker = tracker.take().ok_or(std::io::ErrorKind::NotFound)?;
        Ok(Box::new(tracker) as Box<dyn Reports>)
    });
    let mapping =
        Mapping::shipped().into_iter().find(|mapping| mapping.name == "eye tracker").expect("it is shipped");
    let mut source = HidSource::new("tracker".into(), opener, mapping, clock).expect("it can be read");
    gazes(all(&mut source, Timestamp::from_nanos(1_000_000_000)))
}

/// The eyes turn to the left at 1°/s from straight ahead, the head rests.
const EYES: &str = r#"
at-end = "stop"
duration = "60 s"

[[head]]
time = "0 s"
position = ["0 m", "1.6 m", "0 m"]
turned = { yaw = "0 deg", pitch = "0 deg" }

[[gaze]]
time = "0 s"
turned = { yaw = "0 deg", pitch = "0 deg" }

[[gaze]]
time = "60 s"
turned = { yaw = "60 deg", pitch = "0 deg" }
"#;

#[test]
fn the_gaze_of_a_headset_and_of_an_eye_tracker_are_one_kind_of_stream() {
    if vergence_gpu::Instance::new(&vergence_gpu::InstanceDesc::default(), None).is_err() {
        return skip("vulkan", "no device draws");
    }
    let folder = tempfile::tempdir().expect("a folder");
    let (eyes, log) = (folder.path().join("eyes.toml"), folder.path().join("eyes.mcap"));
    std::fs::write(&eyes, EYES).expect("written");
    let record = |device: &str, log: &Path| {
        let seconds = ["--seconds", "3", "--json"];
        let output =
            Command::new(vergence()).args(["record", "--device", device]).arg(log).args(seconds).output();
        output.expect("the tool starts")
    };
    let output = record(&format!("gaze:{}", eyes.display()), &log);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report = last_object(&String::from_utf8_lossy(&output.stdout)).expect("a report");
    assert_eq!((report["streams"].as_u64(), report["dropped"].as_u64()), (Some(2), Some(0)), "{report}");

    let mut source = LogSource::new(Reader::open(&log).expect("a log"));
    let (worn, of_worn) = gazes(all(&mut source, Timestamp::from_nanos(i64::MAX)));
    let (desk, of_desk) = of_a_tracker();
    assert_eq!((worn.name.as_str(), desk.name.as_str()), ("gaze/gaze", "gaze"));
    // One type, which differs in what the coordinates are of.
    assert_eq!((&*worn.frame, &*desk.frame), ("local", "display"));
    assert_eq!(worn.kind, desk.kind);

    // Between the eyes, and from there to the point: y is up.
    assert_eq!(of_desk.len(), 20);
    for sample in &of_desk {
        assert!((sample.value.origin - Point3::new(0.3, -0.1, 0.6)).norm() < 1e-9, "{sample:?}");
        let towards = Vector3::new(0.0, -0.1, -0.6).normalize();
        assert!((sample.value.direction.into_inner() - towards).norm() < 1e-9, "{sample:?}");
    }
    // To the left of straight ahead and level, by as many degrees as seconds have passed.
    assert!(of_worn.len() > 5, "{} gazes in 3 s", of_worn.len());
    let left_deg = |gaze: &Gaze| (-gaze.direction.x).atan2(-gaze.direction.z).to_degrees();
    let first = &of_worn[0];
    for sample in &of_worn {
        assert!(
            sample.value.direction.y.abs() < 1e-4 && sample.value.origin.coords.norm() < 0.1,
            "{sample:?}"
        );
        let turned = left_deg(&sample.value) - left_deg(&first.value);
        let passed = sample.captured.since(first.captured).expect("it is later").as_secs_f64();
        // A machine that is busy between two looks at the clock is off by that.
        assert!((turned - passed).abs() < 0.5, "{turned} degrees in {passed} s");
    }

    let output = record("gaze:no such motion", &folder.path().join("none.mcap"));
    let err = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && err.contains("no such motion"), "{err}");
}

/// A simulated pad on a serial line, and whose buttons are down there.
struct Pad {
    buttons: Arc<AtomicU16>,
    is_over: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Pad {
    fn on(mut line: TTYPort) -> Self {
        let (buttons, is_over) = (Arc::new(AtomicU16::new(0)), Arc::new(AtomicBool::new(false)));
        let (pressed, ends) = (buttons.clone(), is_over.clone());
        let thread = std::thread::spawn(move || {
            let pad = Gamepad::new(1, &Params::default()).expect("a pad");
            let start = std::time::Instant::now();
            let mut sequence = 0u16;
            while !ends.load(Ordering::Relaxed) {
                let time = start.elapsed();
                let held = Held { buttons: pressed.load(Ordering::Relaxed), ..Held::default() };
                let report = pad.report(Timestamp::from_nanos(time.as_nanos() as i64), &held);
                let down = u16::from_le_bytes([report[2], report[3]]);
                let is_down = |button: u16| [u8::from(down & button != 0)];
                let (south, east) = (is_down(button::SOUTH), is_down(button::EAST));
                let frames: [(u8, &[u8]); 6] = [
                    (0, b"\x01south button u8"),
                    (0, b"\x02east button u8"),
                    (0, b"\x03left_stick vector2 i16 0.0000305"),
                    (1, &south),
                    (2, &east),
                    (3, &report[6..10]),
                ];
                let mut bytes = Vec::new();
                for (stream, payload) in frames {
                    let time_us = time.as_micros() as u32;
                    Frame { stream, sequence, time_us, payload }.encode(&mut bytes);
                    sequence = sequence.wrapping_add(1);
                }
                // Where nobody reads it yet, what does not fit is lost, as on a wire.
                drop(line.write_all(&bytes));
                std::thread::sleep(Duration::from_millis(20));
            }
        });
        Self { buttons, is_over, thread: Some(thread) }
    }
}

impl Drop for Pad {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        drop(self.thread.take().map(std::thread::JoinHandle::join));
    }
}

/// Ends it, however the test ends.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        drop(self.0.kill());
        drop(self.0.wait());
    }
}

#[test]
fn bindings_are_at_work_on_a_simulated_pad_and_change_with_their_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("bindings.toml");
    let (line, mut terminal) = TTYPort::pair().expect("a pseudo terminal");
    terminal.set_exclusive(false).expect("others may open it");
    let port = terminal.name().expect("a terminal has a path");
    let held = File::open(&port).expect("a terminal");
    drop(terminal);
    let device = port.trim_matches('/').replace('/', "_");
    let bind = |jump: &str, fire: &str| {
        let action = |name: &str, input: &str| {
            format!(
                "[actions.{name}]\nkind = \"button\"\nbind = [{{ input = \"device.{device}.{input}\" }}]\n"
            )
        };
        let text = action("jump", jump) + &action("fire", fire);
        std::fs::write(&path, &text).expect("written");
        text
    };
    bind("south", "east");
    let tool = vergence();
    let pad = Pad::on(line);
    let mut child = Command::new(&tool)
        .args(["devices", "monitor", &format!("serial:{port}"), "--bindings"])
        .arg(&path)
        .stdout(Stdio::piped())
        .spawn()
        .expect("the tool starts");
    let mut lines = BufReader::new(child.stdout.take().expect("a pipe")).lines();
    let mut running = Running(child);
    let mut seen = Vec::new();
    // Waits for a line that has all of these words: the monitor draws once a second, for as long as it runs.
    let mut until = |words: &[&str]| {
        for _ in 0..2_000 {
            let line = lines.next().unwrap_or_else(|| panic!("it ended: {seen:#?}")).expect("text");
            let is_it = words.iter().all(|word| line.contains(word));
            seen.push(line);
            if is_it {
                return;
            }
        }
        panic!("expected {words:?}, found {:#?}", &seen[seen.len() - 30..]);
    };
    until(&["jump", "released"]);
    pad.buttons.store(button::SOUTH, Ordering::Relaxed);
    until(&["jump", "pressed"]);
    until(&["fire", "released"]);
    // What is held does nothing new until it is pressed again; then it does the other action.
    let swapped = bind("east", "south");
    until(&["bindings.toml, read 2 times"]);
    pad.buttons.store(0, Ordering::Relaxed);
    until(&["  south ", "Hz", "released"]);
    until(&["fire", "button", " 0  released"]);
    pad.buttons.store(button::SOUTH, Ordering::Relaxed);
    until(&["fire", "pressed"]);
    until(&["jump", "released"]);
    // Both on one button: a conflict, in a sentence.
    bind("south", "south");
    until(&["conflict:", ".south does both \"fire\" and \"jump\""]);
    std::fs::write(&path, swapped.replace("button", "lever")).expect("written");
    until(&["not read:", "bindings.toml:"]);
    bind("north", "south");
    until(&["no device here has", ".north"]);
    assert!(running.0.try_wait().expect("a process").is_none(), "it still runs");
    drop(running);
    drop((pad, held));

    let check = |text: &str| {
        std::fs::write(&path, text).expect("written");
        let output = Command::new(vergence()).args(["devices", "bindings"]).arg(&path).output();
        let output = output.expect("the tool starts");
        (output.status.code(), String::from_utf8_lossy(&output.stdout).into_owned())
    };
    let (status, out) = check(&swapped);
    assert!(status == Some(0) && out.lines().count() == 2 && out.contains("jump"), "{status:?} {out}");
    let (status, out) = check(&bind("south", "south"));
    assert!(status == Some(1) && out.contains("does both"), "{status:?} {out}");
}
