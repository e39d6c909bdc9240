//! Devices made with uhid.

use std::collections::BTreeMap;
use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use vergence_input::Config;
use vergence_input::gamepad::Rumble;
use vergence_sense::{Axis, Button, Imu, Reading, Scalar, Vector2};
use vergence_time::Span;

use crate::uhid::{Identity, Uhid};
use crate::{PATIENCE, found, has_event, of, open, read};

/// Feature reports 5, 9 and 0x20, input 1, output 2: what the driver asks of a DualSense, and no more.
const DUALSENSE: [u8; 49] = [
    0x05, 0x01, 0x09, 0x05, 0xA1, 0x01, 0x06, 0x00, 0xFF, 0x15, 0x00, 0x26, 0xFF, 0x00, 0x75,
    0x08, // vendor page, bytes
    0x85, 0x01, 0x09, 0x20, 0x95, 63, 0x81, 0x02, 0x85, 0x02, 0x09, 0x21, 0x95, 47, 0x91,
    0x02, // input 1, output 2
    0x85, 0x05, 0x09, 0x22, 0x95, 40, 0xB1, 0x02, 0x85, 0x09, 0x09, 0x23, 0x95, 19, 0xB1,
    0x02, // features 5 and 9
    0xC0,
];

fn wait_until_open(device: &Uhid) {
    let start = Instant::now();
    while !device.is_open() {
        assert!(start.elapsed() < PATIENCE, "nobody opened the device");
        std::thread::sleep(Duration::from_millis(5));
    }
}

pub(crate) fn dualsense() {
    let mut descriptor = DUALSENSE[..48].to_vec();
    // Feature 0x20.
    descriptor.extend([0x85, 0x20, 0x09, 0x26, 0x95, 63, 0xB1, 0x02, 0xC0]);
    let mut calibration = vec![0; 41];
    calibration[0] = 5;
    let mut put = |at: usize, value: i16| calibration[at..at + 2].copy_from_slice(&value.to_le_bytes());
    for at in [7, 11, 15] {
        put(at, 8192);
        put(at + 2, -8192);
    }
    put(19, 500);
    put(21, 500);
    for at in [23, 27, 31] {
        put(at, 8192);
        put(at + 2, -8192);
    }
    let mut pairing = vec![0; 20];
    pairing[..7].copy_from_slice(&[9, 1, 2, 3, 4, 5, 6]);
    let mut firmware = vec![0; 64];
    firmware[0] = 0x20;
    let features = BTreeMap::from([(5, calibration), (9, pairing), (0x20, firmware)]);
    let identity =
        Identity { name: "DualSense", vendor: 0x054c, product: 0x0ce6, version: 0x0111, serial: "" };
    let device = Uhid::new(&identity, &descriptor, features);
    let (pad, motion) = (found("gamepad", 1).remove(0), found("motion", 1).remove(0));
    let mut pad_source = open(&pad, &Config::default());
    let mut motion_source = open(&motion, &Config::default());
    read(&mut pad_source, |samples| has_event(samples, "connected") && samples.len() > 10);
    read(&mut motion_source, |samples| has_event(samples, "connected"));
    let mut report = [0; 64];
    report[0] = 1;
    report[1..5].fill(128);
    report[8] = 8;
    report[33] = 0x80;
    report[37] = 0x80;
    let mut ticks = 0u32;
    let mut send = |report: &mut [u8; 64]| {
        // A third of a microsecond each: 4 ms.
        ticks += 12_000;
        report[28..32].copy_from_slice(&ticks.to_le_bytes());
        device.send(report);
    };
    send(&mut report);
    for (byte, bit, name) in [
        (8, 0x20, "south"),
        (8, 0x40, "east"),
        (8, 0x10, "west"),
        (8, 0x80, "north"),
        (9, 0x01, "left_shoulder"),
        (9, 0x02, "right_shoulder"),
        (9, 0x10, "select"),
        (9, 0x20, "start"),
        (9, 0x40, "left_stick/click"),
        (9, 0x80, "right_stick/click"),
        (10, 0x01, "guide"),
    ] {
        for down in [true, false] {
            report[byte] ^= bit;
            send(&mut report);
            let wanted = Reading::Button(Button(Some(down)));
            let samples = read(&mut pad_source, |samples| !samples.is_empty());
            let others: Vec<_> =
                samples.iter().filter(|(_, s)| s.value == Reading::Button(Button(Some(true)))).collect();
            assert_eq!(of(&pad_source, &samples, name).last(), Some(&&wanted), "{name}: {samples:?}");
            assert_eq!(others.len(), usize::from(down), "only {name}: {samples:?}");
        }
    }
    for (hat, name) in [(0, "dpad/up"), (2, "dpad/right"), (4, "dpad/down"), (6, "dpad/left")] {
        for (value, down) in [(hat, true), (8, false)] {
            report[8] = value;
            send(&mut report);
            let samples = read(&mut pad_source, |samples| !samples.is_empty());
            assert_eq!(
                of(&pad_source, &samples, name).last(),
                Some(&&Reading::Button(Button(Some(down)))),
                "{name}"
            );
        }
    }
    for (byte, name) in [(5, "left_trigger"), (6, "right_trigger")] {
        report[byte] = 255;
        send(&mut report);
        let samples = read(&mut pad_source, |samples| !samples.is_empty());
        assert_eq!(of(&pad_source, &samples, name).last(), Some(&&Reading::Axis(Axis(Some(1.0)))));
    }
    report[1] = 255;
    report[4] = 0;
    send(&mut report);
    let samples = read(&mut pad_source, |samples| samples.len() >= 2);
    assert_eq!(
        of(&pad_source, &samples, "left_stick").last(),
        Some(&&Reading::Vector2(Vector2(Some([1.0, 0.0]))))
    );
    let up = of(&pad_source, &samples, "right_stick").last().map(|reading| (*reading).clone());
    assert!(matches!(up, Some(Reading::Vector2(Vector2(Some([_, y])))) if y == 1.0), "{up:?}");

    // The sensors: half a g along y, then 1000 of the unit about x; what does not change stays.
    report[24..26].copy_from_slice(&4096i16.to_le_bytes());
    send(&mut report);
    report[16..18].copy_from_slice(&1000i16.to_le_bytes());
    send(&mut report);
    let near = |a: f64, b: f64| (a - b).abs() < 0.01 * b.abs().max(0.01);
    let samples = read(&mut motion_source, |samples| {
        samples.iter().any(|(_, s)| matches!(&s.value, Reading::Imu(imu) if imu.gyr_rad_s.x > 0.5))
    });
    let Some(Reading::Imu(Imu { gyr_rad_s, acc_m_s2, .. })) =
        of(&motion_source, &samples, "imu").last().copied()
    else {
        panic!("{samples:?}")
    };
    assert!(near(gyr_rad_s.x, 61.035f64.to_radians()) && near(acc_m_s2.y, 0.5 * 9.80665), "{samples:?}");
    assert!(samples.iter().all(|(_, sample)| sample.captured <= sample.arrived), "{samples:?}");

    // Motors: the driver's output report 2, right (weak) motor, then left (strong) one.
    let mut motors = Rumble::open(&pad).expect("motors");
    motors.play(1.0, 0.5, Span::from_millis(500)).expect("played");
    // Before it come those with which gilrs keeps them still.
    loop {
        let output = device.outputs.recv_timeout(PATIENCE).expect("a report to the pad");
        if (output[0], output[3], output[4]) == (2, 128, 255) {
            break;
        }
    }
    drop(device);
    assert!(motors.play(1.0, 1.0, Span::from_millis(500)).is_err());
    found("gamepad", 0);
}

/// Vendor page, one input report without a number: a counter of 16 bits, microseconds of 32, six numbers of 16 bits.
const UNIT: [u8; 21] = [
    0x06, 0x00, 0xFF, 0x09, 0x01, 0xA1, 0x01, 0x15, 0x00, 0x26, 0xFF, 0x00, 0x75, 0x08, 0x95, 18, 0x09, 0x02,
    0x81, 0x02, 0xC0,
];
const UNIT_IS: Identity =
    Identity { name: "Vendor Unit", vendor: 0xf055, product: 0x0001, version: 1, serial: "SN-1" };
const MAPPING: &str = r#"
name = "vendor unit"
sequence = "@-:0:u16"
[[match]]
vendor = 0xf055
[time]
from = "@-:2:u32"
tick_ns = 1000
[[stream]]
name = "imu"
kind = "imu"
from = ["@-:6:i16", "@-:8:i16", "@-:10:i16", "@-:12:i16", "@-:14:i16", "@-:16:i16"]
scale = [0.001]
[[stream]]
name = "number"
kind = "scalar"
from = ["@-:2:u32"]
"#;

fn unit_report(number: u32) -> [u8; 18] {
    let mut report = [0; 18];
    report[..2].copy_from_slice(&(number as u16).to_le_bytes());
    report[2..6].copy_from_slice(&(number * 1000).to_le_bytes());
    report[6..8].copy_from_slice(&((number % 1000) as i16).to_le_bytes());
    report
}

/// The configuration with a mapping file for it.
pub(crate) fn with_mapping(text: &str) -> Config {
    let folder = std::env::temp_dir();
    let (mapping, config) = (folder.join("mapping.toml"), folder.join("config.toml"));
    std::fs::File::create(&mapping).and_then(|mut file| file.write_all(text.as_bytes())).expect("written");
    std::fs::write(&config, "[hid]\nmappings = [\"mapping.toml\"]\n").expect("written");
    Config::read(&config).expect("a configuration")
}

pub(crate) fn found_unit(config: &Config) -> vergence_input::Found {
    let start = Instant::now();
    loop {
        if let Some(found) = vergence_input::found(config).into_iter().find(|found| found.adapter == "hid") {
            return found;
        }
        assert!(start.elapsed() < PATIENCE, "no HID device");
        std::thread::sleep(Duration::from_millis(20));
    }
}

pub(crate) fn inertial_unit() {
    const COUNT: u32 = 3000;
    let config = with_mapping(MAPPING);
    let device = Uhid::new(&UNIT_IS, &UNIT, BTreeMap::new());
    let found = found_unit(&config);
    assert_eq!((found.vendor_id, found.serial_number.as_deref()), (Some(0xf055), Some("SN-1")));
    let mut source = open(&found, &config);
    read(&mut source, |samples| has_event(samples, "connected"));
    wait_until_open(&device);
    let taken = Arc::new(AtomicU32::new(0));
    let seen = taken.clone();
    // 1 kHz; the kernel keeps 64 reports, and a host that stops the machine's reader for longer is waited for.
    let writer = std::thread::spawn(move || {
        for number in 0..COUNT {
            while number > seen.load(Ordering::Relaxed) + 40 {
                std::thread::sleep(Duration::from_millis(1));
            }
            device.send(&unit_report(number));
            std::thread::sleep(Duration::from_millis(1));
        }
        device
    });
    let place =
        source.source.streams().iter().position(|stream| stream.name == "number").expect("the number");
    let samples = read(&mut source, |samples| {
        let mut last = samples.iter().rev().take(4).filter(|(stream, _)| *stream == place);
        let Some((_, sample)) = last.next() else { return false };
        let Reading::Scalar(Scalar(micros)) = sample.value else { return false };
        taken.store(micros as u32 / 1000, Ordering::Relaxed);
        micros as u32 / 1000 == COUNT - 1
    });
    let numbers: Vec<f64> = of(&source, &samples, "number")
        .into_iter()
        .map(|reading| if let Reading::Scalar(Scalar(value)) = reading { *value } else { f64::NAN })
        .collect();
    let wanted: Vec<f64> = (0..COUNT).map(|number| f64::from(number) * 1000.0).collect();
    assert_eq!(numbers.len(), wanted.len(), "3,000 of 3,000");
    assert_eq!(numbers, wanted);
    assert_eq!(of(&source, &samples, "imu").len(), COUNT as usize);
    assert!(!has_event(&samples, "gap"));
    drop(writer.join().expect("no panic"));
}

pub(crate) fn goes_and_comes_back() {
    let config = with_mapping(MAPPING);
    let mut device = Uhid::new(&UNIT_IS, &UNIT, BTreeMap::new());
    let mut source = open(&found_unit(&config), &config);
    read(&mut source, |samples| has_event(samples, "connected"));
    for _ in 0..3 {
        wait_until_open(&device);
        device.send(&unit_report(7));
        read(&mut source, |samples| samples.iter().any(|(_, s)| matches!(s.value, Reading::Imu(_))));
        let thread = std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(100));
            drop(device);
        });
        read(&mut source, |samples| has_event(samples, "disconnected"));
        thread.join().expect("no panic");
        device = Uhid::new(&UNIT_IS, &UNIT, BTreeMap::new());
        read(&mut source, |samples| has_event(samples, "connected"));
    }
}
