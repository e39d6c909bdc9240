//! An Xbox 360 pad on a virtual controller, made of what is on the wire, and read by the driver of real ones.

use std::fs::{self, File};
use std::io::{Read, Write};
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::Command;
use std::sync::mpsc;
use std::time::{Duration, Instant};

use vergence_input::Config;
use vergence_input::gamepad::Rumble;
use vergence_sense::{Axis, Button, Reading, Vector2};
use vergence_time::Span;

use crate::{Clocked, PATIENCE, found, has_event, of, open, read};

const GADGET: &str = "/sys/kernel/config/usb_gadget/pad";
const ENDS: &str = "/tmp/pad";

/// Of one speed: a vendor's interface with an interrupt endpoint each way.
fn descriptors() -> Vec<u8> {
    let one: [u8; 9 + 7 + 7] = [
        9, 4, 0, 0, 2, 0xFF, 0x5D, 0x01, 0, // interface
        7, 5, 0x81, 3, 32, 0, 4, // to the host
        7, 5, 0x02, 3, 32, 0, 8, // from it
    ];
    let mut all = Vec::new();
    // Version 2 of the descriptors; length; full and high speed; three descriptors each.
    for word in [3, 4 * 5 + 2 * one.len() as u32, 3, 3, 3] {
        all.extend(word.to_le_bytes());
    }
    all.extend(one);
    all.extend(one);
    all
}

/// No text in any language.
fn texts() -> Vec<u8> {
    [2u32, 16, 0, 0].iter().flat_map(|word| word.to_le_bytes()).collect()
}

/// The pad's end of the wire.
struct Pad {
    _control: File,
    to_host: File,
    motors: mpsc::Receiver<[u8; 2]>,
}

fn plug(is_in: bool) {
    fs::write(Path::new(GADGET).join("UDC"), if is_in { "dummy_udc.0" } else { "\n" })
        .expect("the controller");
}

impl Pad {
    fn make() -> Self {
        let gadget = Path::new(GADGET);
        fs::create_dir(gadget).expect("a gadget");
        for (name, value) in [
            ("idVendor", "0x045e"),
            ("idProduct", "0x028e"),
            ("bcdDevice", "0x0114"),
            ("bDeviceClass", "0xff"),
        ] {
            fs::write(gadget.join(name), value).expect(name);
        }
        for folder in ["functions/ffs.pad", "configs/c.1"] {
            fs::create_dir(gadget.join(folder)).expect(folder);
        }
        symlink(gadget.join("functions/ffs.pad"), gadget.join("configs/c.1/ffs.pad")).expect("joined");
        fs::create_dir_all(ENDS).expect("a folder");
        let mount = Command::new("/bin/mount").args(["-t", "functionfs", "pad", ENDS]).status();
        assert!(mount.is_ok_and(|status| status.success()), "functionfs");
        let end = |name: &str, writes: bool| {
            let mut options = File::options();
            let opened =
                options.read(!writes || name == "ep0").write(writes).open(Path::new(ENDS).join(name));
            opened.unwrap_or_else(|error| panic!("{name}: {error}"))
        };
        let mut control = end("ep0", true);
        control.write_all(&descriptors()).expect("descriptors");
        control.write_all(&texts()).expect("texts");
        let (to_host, mut from_host) = (end("ep1", true), end("ep2", false));
        let (said, motors) = mpsc::channel();
        std::thread::spawn(move || {
            let mut packet = [0; 32];
            loop {
                match from_host.read(&mut packet) {
                    // Rumble; the others are lights.
                    Ok(8) if packet[0] == 0 && said.send([packet[3], packet[4]]).is_err() => return,
                    Ok(_) => {}
                    // Unplugged: until it is plugged in again.
                    Err(_) => std::thread::sleep(Duration::from_millis(20)),
                }
            }
        });
        plug(true);
        Self { _control: control, to_host, motors }
    }

    /// Waits until the host fetches it.
    fn send(&mut self, report: &[u8; 20]) {
        let start = Instant::now();
        while let Err(error) = self.to_host.write(report) {
            assert!(start.elapsed() < PATIENCE, "the report is not fetched: {error}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

/// What comes of `name` after a report.
fn after(source: &mut Clocked, pad: &mut Pad, report: &[u8; 20], name: &str) -> Reading<'static> {
    pad.send(report);
    let samples = read(source, |samples| !samples.is_empty());
    assert_eq!(samples.len(), 1, "one change, one sample: {samples:?}");
    let said = of(source, &samples, name);
    said.first().map(|reading| (*reading).clone()).unwrap_or_else(|| panic!("{name}: {samples:?}"))
}

pub(crate) fn every_control_through_its_driver() {
    let mut pad = Pad::make();
    let device = found("gamepad", 1).remove(0);
    assert_eq!((device.vendor_id, device.product_id), (Some(0x045e), Some(0x028e)), "{device:?}");
    let mut source = open(&device, &Config::default());
    read(&mut source, |samples| has_event(samples, "connected") && samples.len() > 10);
    let mut report = [0; 20];
    report[1] = 20;
    for (byte, bit, name) in [
        (2, 0, "dpad/up"),
        (2, 1, "dpad/down"),
        (2, 2, "dpad/left"),
        (2, 3, "dpad/right"),
        (2, 4, "start"),
        (2, 5, "select"),
        (2, 6, "left_stick/click"),
        (2, 7, "right_stick/click"),
        (3, 0, "left_shoulder"),
        (3, 1, "right_shoulder"),
        (3, 2, "guide"),
        (3, 4, "south"),
        (3, 5, "east"),
        (3, 6, "west"),
        (3, 7, "north"),
    ] {
        for down in [true, false] {
            report[byte] ^= 1 << bit;
            let said = after(&mut source, &mut pad, &report, name);
            assert_eq!(said, Reading::Button(Button(Some(down))), "{name}");
        }
    }
    for (byte, name) in [(4, "left_trigger"), (5, "right_trigger")] {
        for (pulled, value) in [(255, 1.0), (0, 0.0)] {
            report[byte] = pulled;
            assert_eq!(
                after(&mut source, &mut pad, &report, name),
                Reading::Axis(Axis(Some(value))),
                "{name}"
            );
        }
    }
    // On the wire, away from the user is up.
    for (byte, name, value, wanted) in [
        (6, "left_stick", i16::MAX, [1.0, 0.0]),
        (8, "left_stick", i16::MAX, [1.0, 1.0]),
        (10, "right_stick", i16::MIN, [-1.0, 0.0]),
        (12, "right_stick", i16::MIN, [-1.0, -1.0]),
    ] {
        report[byte..byte + 2].copy_from_slice(&value.to_le_bytes());
        let said = after(&mut source, &mut pad, &report, name);
        assert_eq!(said, Reading::Vector2(Vector2(Some(wanted))), "{name}");
    }

    let mut motors = Rumble::open(&device).expect("a pad with motors");
    motors.play(1.0, 0.5, Span::from_millis(30_000)).expect("played");
    // Before it come those with which they are kept still.
    while pad.motors.recv_timeout(PATIENCE).expect("a packet to the pad") != [255, 128] {}

    plug(false);
    let samples = read(&mut source, |samples| has_event(samples, "disconnected"));
    assert_eq!(
        of(&source, &samples, "south").last(),
        Some(&&Reading::Button(Button(None))),
        "offers nothing"
    );
    assert!(motors.play(1.0, 1.0, Span::from_millis(10)).is_err(), "it vanished");
    drop(motors);
    found("gamepad", 0);
    plug(true);
    read(&mut source, |samples| has_event(samples, "connected"));
    report = [0; 20];
    report[1] = 20;
    report[3] = 1 << 4;
    pad.send(&report);
    read(&mut source, is_pressed);
    plug(false);
}

fn is_pressed(samples: &crate::Samples) -> bool {
    samples.iter().any(|(_, sample)| sample.value == Reading::Button(Button(Some(true))))
}
