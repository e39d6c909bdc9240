//! The adapters against a real kernel's devices, in the virtual machine of `tools/vm`: pads made with uinput, a DualSense and an
//! inertial unit made with uhid, an Xbox pad and a USB device with a HID and a serial function made with the gadget drivers, and a USB
//! serial adapter of QEMU's.
//!
//! Outside, each test starts a machine with this very program; inside, it runs the scenes below, one after the other.
//! What is asserted are order and counts: the machine's clock is at the mercy of the host's load.
#![cfg(all(feature = "serial", feature = "hid", feature = "gamepad"))]

mod adapter;
mod gadget;
mod hid;
mod pads;
mod uhid;
mod xpad;

use std::os::unix::net::UnixListener;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::process::Command;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use vergence_input::{Config, Found};
use vergence_sense::{Reading, Sample, Source};
use vergence_time::{Clock, HostClock, Span};

type Samples = Vec<(usize, Sample<Reading<'static>>)>;

/// Nothing in a scene takes longer than this where it works, whatever the load.
const PATIENCE: Duration = Duration::from_secs(120);

const SCENES: [(&str, fn()); 11] = [
    ("nothing is plugged in", nothing),
    ("every button and axis of an Xbox pad", pads::every_button_and_axis),
    ("tablets, touchpads, mice and keyboards are no gamepads", pads::others_are_no_gamepads),
    ("two pads between two looks", pads::two_between_two_looks),
    ("a pad that goes and comes back while it is read", pads::goes_and_comes_back),
    ("rumble reaches the pad, and a vanished pad is an error", pads::rumble),
    ("a DualSense with its motion sensors", hid::dualsense),
    ("a vendor's inertial unit, 3,000 frames", hid::inertial_unit),
    ("a HID device that goes and comes back while it is read", hid::goes_and_comes_back),
    ("a USB device with a HID and a serial function", gadget::composite),
    ("an Xbox pad on USB, through its driver", xpad::every_control_through_its_driver),
];

#[test]
fn devices_of_a_real_kernel() {
    if is_inside() {
        return inside();
    }
    if let Some(out) = machine("devices_of_a_real_kernel", "") {
        for (name, _) in SCENES {
            assert!(out.contains(&format!("scene ok: {name}")), "in the machine: {name}");
        }
    }
}

#[test]
fn a_serial_adapter_of_a_real_kernel() {
    if is_inside() {
        return adapter::every_frame_through_its_driver();
    }
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("line");
    let listener = UnixListener::bind(&path).expect("a socket");
    // Not waited for: where there is no machine, nobody comes.
    std::thread::spawn(move || adapter::device(&listener));
    let qemu = format!(
        "-device qemu-xhci -chardev socket,id=line,path={} -device usb-serial,chardev=line,always-plugged=on",
        path.display()
    );
    if let Some(out) = machine("a_serial_adapter_of_a_real_kernel", &qemu) {
        assert!(out.contains(&format!("scene ok: {}", adapter::NAME)), "in the machine");
    }
}

fn is_inside() -> bool {
    std::env::var_os("VERGENCE_IN_VM").is_some()
}

/// Runs a test of this program in a machine that has what `qemu` says besides, and gives what it printed; `None` where there is no
/// machine.
fn machine(test: &str, qemu: &str) -> Option<String> {
    let vm = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tools/vm");
    let whereabouts = Command::new(&vm).arg("where").output().expect("tools/vm is a script of the checkout");
    if !whereabouts.status.success() {
        let why = String::from_utf8_lossy(&whereabouts.stderr).trim().to_owned();
        let list = std::env::var("VERGENCE_REQUIRE").unwrap_or_default();
        assert!(!list.split(',').any(|entry| entry.trim() == "vm"), "VERGENCE_REQUIRE names vm, but: {why}");
        println!("skipped: no vm ({why})");
        return None;
    }
    // One machine at a time: each has two processors.
    static RUNNING: Mutex<()> = Mutex::new(());
    let _alone = RUNNING.lock().unwrap_or_else(PoisonError::into_inner);
    let this = std::env::current_exe().expect("a running test has a path");
    let mut run = Command::new(&vm);
    let run = run
        .env("VERGENCE_VM_TIMEOUT", "600")
        .env("VERGENCE_VM_QEMU", qemu)
        .arg("run")
        .arg(this)
        .args(["--nocapture", "--exact", test])
        .output()
        .expect("tools/vm runs");
    let (out, err) = (String::from_utf8_lossy(&run.stdout), String::from_utf8_lossy(&run.stderr));
    println!("{out}\n{err}");
    assert!(run.status.success(), "the machine ended with {:?}", run.status.code());
    Some(out.into_owned())
}

fn inside() {
    // The machine has no udev: gilrs is to look itself, as in a container.
    if std::env::var_os("GILRS_DISABLE_UDEV").is_none() {
        let this = std::env::current_exe().expect("a running test has a path");
        let run = Command::new(this)
            .args(["--nocapture", "--exact", "devices_of_a_real_kernel"])
            .env("GILRS_DISABLE_UDEV", "1")
            .status();
        assert!(run.is_ok_and(|status| status.success()), "with gilrs looking itself");
        return;
    }
    let mut failed = Vec::new();
    for (name, scene) in SCENES {
        let start = Instant::now();
        match catch_unwind(AssertUnwindSafe(scene)) {
            Ok(()) => println!("scene ok: {name} ({:.1} s)", start.elapsed().as_secs_f64()),
            Err(_) => failed.push(name),
        }
    }
    assert!(failed.is_empty(), "failed: {failed:?}");
}

fn nothing() {
    assert_eq!(vergence_input::found(&Config::default()), []);
}

/// Waits until there are `count` devices of an adapter.
fn found(adapter: &str, count: usize) -> Vec<Found> {
    let start = Instant::now();
    loop {
        let mut all = vergence_input::found(&Config::default());
        all.retain(|found| found.adapter == adapter);
        if all.len() == count {
            return all;
        }
        assert!(start.elapsed() < PATIENCE, "expected {count} of {adapter}, found {all:#?}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// A source and the clock that it stamps with.
struct Clocked {
    source: Box<dyn Source>,
    clock: Arc<dyn Clock>,
}

fn open(device: &Found, config: &Config) -> Clocked {
    let clock: Arc<dyn Clock> = Arc::new(HostClock::start());
    let source = vergence_input::open(device, config, clock.clone()).expect("it can be opened");
    Clocked { source, clock }
}

/// Advances until `enough` of what came.
fn read(source: &mut Clocked, mut enough: impl FnMut(&Samples) -> bool) -> Samples {
    let (start, mut samples) = (Instant::now(), Samples::new());
    while !enough(&samples) {
        let last = &samples[samples.len().saturating_sub(6)..];
        assert!(start.elapsed() < PATIENCE, "so far came {} samples, at last {last:?}", samples.len());
        let until = source.clock.now().saturating_add(Span::from_millis(50));
        source.source.advance(until, &mut samples);
    }
    samples
}

/// Readings of the stream with this name.
fn of<'a>(source: &Clocked, samples: &'a Samples, name: &str) -> Vec<&'a Reading<'static>> {
    let place = source.source.streams().iter().position(|stream| stream.name == name);
    let place = place.unwrap_or_else(|| panic!("a stream {name}"));
    samples.iter().filter(|(stream, _)| *stream == place).map(|(_, sample)| &sample.value).collect()
}

fn has_event(samples: &Samples, name: &str) -> bool {
    samples.iter().any(|(_, sample)| matches!(&sample.value, Reading::Event(event) if event.name == name))
}
