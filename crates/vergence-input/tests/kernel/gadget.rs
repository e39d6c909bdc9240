//! A USB device made with the gadget drivers on a virtual controller: a HID function and a serial one, with ids and names.

use std::fs::{self, OpenOptions};
use std::io::Write;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use vergence_input::Config;
use vergence_input::serial::frame::Frame;
use vergence_sense::{Reading, Scalar};

use crate::hid::{found_unit, with_mapping};
use crate::{Clocked, PATIENCE, Samples, found, has_event, of, open, read};

const GADGET: &str = "/sys/kernel/config/usb_gadget/unit";
/// Vendor page, one input report without a number: four bytes.
const DESCRIPTOR: [u8; 21] = [
    0x06, 0x00, 0xFF, 0x09, 0x01, 0xA1, 0x01, 0x15, 0x00, 0x26, 0xFF, 0x00, 0x75, 0x08, 0x95, 4, 0x09, 0x02,
    0x81, 0x02, 0xC0,
];
const MAPPING: &str = r#"
name = "composite unit"
sequence = "@-:0:u32"
[[match]]
vendor = 0x1d6b
[[stream]]
name = "number"
kind = "scalar"
from = ["@-:0:u32"]
"#;

fn make() {
    let gadget = Path::new(GADGET);
    let put = |name: &str, value: &[u8]| {
        let path = gadget.join(name);
        if let Some(folder) = path.parent() {
            // In this file system folders are made by making them.
            fs::create_dir_all(folder).expect("a folder of the gadget");
        }
        fs::write(&path, value).unwrap_or_else(|error| panic!("{name}: {error}"));
    };
    fs::create_dir(gadget).expect("a gadget");
    put("idVendor", b"0x1d6b");
    put("idProduct", b"0x0104");
    put("strings/0x409/manufacturer", b"Vergence");
    put("strings/0x409/product", b"Composite Unit");
    put("strings/0x409/serialnumber", b"C-7");
    put("functions/hid.usb0/protocol", b"0");
    put("functions/hid.usb0/subclass", b"0");
    put("functions/hid.usb0/report_length", b"4");
    put("functions/hid.usb0/report_desc", &DESCRIPTOR);
    fs::create_dir(gadget.join("functions/acm.usb0")).expect("the serial function");
    put("configs/c.1/strings/0x409/configuration", b"both");
    for function in ["hid.usb0", "acm.usb0"] {
        symlink(gadget.join("functions").join(function), gadget.join("configs/c.1").join(function))
            .expect("joined");
    }
}

fn plug(is_in: bool) {
    fs::write(Path::new(GADGET).join("UDC"), if is_in { "dummy_udc.0" } else { "\n" })
        .expect("the controller");
}

fn opened(path: &str) -> fs::File {
    let start = Instant::now();
    loop {
        if let Ok(file) = OpenOptions::new().write(true).open(path) {
            return file;
        }
        assert!(start.elapsed() < PATIENCE, "{path} does not appear");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// A description, and frames of a millisecond each with their numbers.
pub(crate) fn numbered_frames(count: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let description = b"\x01number scalar u32";
    Frame { stream: 0, sequence: 0, time_us: 0, payload: description }.encode(&mut bytes);
    for number in 0..count {
        let (sequence, payload) = ((number + 1) as u16, number.to_le_bytes());
        Frame { stream: 1, sequence, time_us: number * 1000, payload: &payload }.encode(&mut bytes);
    }
    bytes
}

/// Whether the last but few of these is the reading with the last number.
pub(crate) fn is_last(samples: &Samples, count: u32) -> bool {
    samples.iter().rev().take(3).any(|(_, s)| s.value == Reading::Scalar(Scalar(f64::from(count - 1))))
}

pub(crate) fn numbers(source: &Clocked, samples: &Samples, name: &str) -> Vec<u32> {
    let values = of(source, samples, name).into_iter();
    values
        .filter_map(
            |reading| if let Reading::Scalar(Scalar(value)) = reading { Some(*value as u32) } else { None },
        )
        .collect()
}

pub(crate) fn composite() {
    const COUNT: u32 = 3000;
    make();
    plug(true);
    let config = with_mapping(MAPPING);
    let port = found("serial", 1).remove(0);
    let ids = (port.vendor_id, port.product_id, port.serial_number.as_deref());
    assert_eq!(ids, (Some(0x1d6b), Some(0x0104), Some("C-7")));
    assert!(port.name.contains("Composite Unit"), "{port:?}");
    let unit = found_unit(&config);
    assert_eq!((unit.vendor_id, unit.product_id, unit.serial_number.as_deref()), ids);

    // The serial function: frames of our protocol, through the driver of real USB serial devices.
    let mut serial = open(&port, &Config::default());
    read(&mut serial, |samples| has_event(samples, "connected"));
    let raw = std::process::Command::new("/bin/stty").args(["-F", "/dev/ttyGS0", "raw", "-echo"]).status();
    assert!(raw.is_ok_and(|status| status.success()), "stty");
    let writer = std::thread::spawn(|| {
        let mut port = opened("/dev/ttyGS0");
        port.write_all(&numbered_frames(COUNT)).expect("written");
        port
    });
    let samples = read(&mut serial, |samples| is_last(samples, COUNT));
    assert_eq!(numbers(&serial, &samples, "number"), (0..COUNT).collect::<Vec<_>>());
    assert!(!has_event(&samples, "gap"));
    let device_end = writer.join().expect("no panic");

    // The HID function, whose end waits until each report was fetched.
    let mut hid = open(&unit, &config);
    read(&mut hid, |samples| has_event(samples, "connected"));
    // The kernel keeps 64 reports for a reader, and leaves out what comes then: on a loaded host the reader is waited for.
    let taken = Arc::new(AtomicU32::new(0));
    let taken_by_now = taken.clone();
    let writer = std::thread::spawn(move || {
        let mut reports = opened("/dev/hidg0");
        for number in 0..COUNT {
            while number > taken_by_now.load(Ordering::Relaxed) + 32 {
                std::thread::sleep(Duration::from_millis(1));
            }
            reports.write_all(&number.to_le_bytes()).expect("sent");
        }
    });
    let samples = read(&mut hid, |samples| {
        taken.store(samples.len() as u32, Ordering::Relaxed);
        is_last(samples, COUNT)
    });
    writer.join().expect("no panic");
    assert_eq!(numbers(&hid, &samples, "number"), (0..COUNT).collect::<Vec<_>>());
    assert!(!has_event(&samples, "gap"));

    // Unplugged while both are read, and plugged in again.
    drop(device_end);
    let thread = std::thread::spawn(|| {
        std::thread::sleep(Duration::from_millis(100));
        plug(false);
    });
    read(&mut serial, |samples| has_event(samples, "disconnected"));
    read(&mut hid, |samples| has_event(samples, "disconnected"));
    thread.join().expect("no panic");
    found("serial", 0);
    plug(true);
    read(&mut serial, |samples| has_event(samples, "connected"));
    read(&mut hid, |samples| has_event(samples, "connected"));
    plug(false);
}
