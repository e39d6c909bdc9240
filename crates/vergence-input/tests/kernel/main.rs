//! The adapters against a real kernel's devices, in the virtual machine of `tools/vm`: pads made with uinput, a DualSense and an
//! inertial unit made with uhid, a USB device with a HID and a serial function made with the gadget drivers.
//!
//! Outside, the one test starts the machine with this very program; inside, it runs the scenes below, one after the other.
//! What is asserted are order and counts: the machine's clock is at the mercy of the host's load.
#![cfg(all(feature = "serial", feature = "hid", feature = "gamepad"))]

mod gadget;
mod hid;
mod pads;
mod uhid;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};

use vergence_input::{Config, Found};
use vergence_sense::{Reading, Sample, Source};
use vergence_time::{Clock, HostClock, Span};

type Samples = Vec<(usize, Sample<Reading<'static>>)>;

/// Nothing in a scene takes longer than this where it works, whatever the load.
const PATIENCE: Duration = Duration::from_secs(120);

const SCENES: [(&str, fn()); 10] = [
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
];

#[test]
fn devices_of_a_real_kernel() {
    if std::env::var_os("VERGENCE_IN_VM").is_some() {
        return inside();
    }
    let vm = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tools/vm");
    let whereabouts = Command::new(&vm).arg("where").output().expect("tools/vm is a script of the checkout");
    if !whereabouts.status.success() {
        let why = String::from_utf8_lossy(&whereabouts.stderr).trim().to_owned();
        let list = std::env::var("VERGENCE_REQUIRE").unwrap_or_default();
        assert!(!list.split(',').any(|entry| entry.trim() == "vm"), "VERGENCE_REQUIRE names vm, but: {why}");
        println!("skipped: no vm ({why})");
        return;
    }
    let this = std::env::current_exe().expect("a running test has a path");
    let mut run = Command::new(&vm);
    let run = run
        .env("VERGENCE_VM_TIMEOUT", "600")
        .arg("run")
        .arg(this)
        .arg("--nocapture")
        .output()
        .expect("tools/vm runs");
    let (out, err) = (String::from_utf8_lossy(&run.stdout), String::from_utf8_lossy(&run.stderr));
    println!("{out}\n{err}");
    for (name, _) in SCENES {
        assert!(out.contains(&format!("scene ok: {name}")), "in the machine: {name}");
    }
    assert!(run.status.success(), "the machine ended with {:?}", run.status.code());
}

fn inside() {
    // The machine has no udev: gilrs is to look itself, as in a container.
    if std::env::var_os("GILRS_DISABLE_UDEV").is_none() {
        let this = std::env::current_exe().expect("a running test has a path");
        let run = Command::new(this).arg("--nocapture").env("GILRS_DISABLE_UDEV", "1").status();
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
