//! Serial devices behind a pseudo terminal: the kernel's line discipline and buffers, the port's library, our protocol.
#![cfg(feature = "serial")]

use std::io::Write;
use std::sync::Arc;
use std::time::{Duration, Instant};

use proptest::prelude::*;
use serialport::{SerialPort, TTYPort};
use vergence_input::EVENTS;
use vergence_input::serial::frame::{Decoder, Frame};
use vergence_input::serial::lines::{Columns, Lines};
use vergence_input::serial::{Description, Port, SerialConfig, SerialSource};
use vergence_sense::{Reading, Sample, Scalar, Source};
use vergence_time::{Clock, HostClock, Span};

type Samples = Vec<(usize, Sample<Reading<'static>>)>;

fn pair() -> (TTYPort, Box<dyn Port>) {
    let (device, host) = TTYPort::pair().expect("a pseudo terminal");
    (device, Box::new(Box::new(host) as Box<dyn SerialPort>))
}

/// A source of the ports of these hosts, one after the other.
fn source(hosts: Vec<Box<dyn Port>>, config: SerialConfig) -> SerialSource {
    let mut hosts = hosts.into_iter();
    let opener = move || hosts.next().ok_or_else(|| std::io::ErrorKind::NotFound.into());
    SerialSource::new(Box::new(opener), config, Arc::new(HostClock::start()))
}

/// Advances until `enough`, or for `secs` seconds.
fn run(
    source: &mut SerialSource,
    secs: f64,
    mut enough: impl FnMut(&SerialSource, &Samples) -> bool,
) -> Samples {
    let (clock, mut samples) = (HostClock::start(), Samples::new());
    let start = Instant::now();
    let mut until = clock.now();
    while start.elapsed().as_secs_f64() < secs && !enough(source, &samples) {
        until = until.saturating_add(Span::from_millis(20));
        source.advance(until, &mut samples);
    }
    samples
}

fn events(samples: &Samples) -> Vec<&str> {
    let each = samples.iter().filter_map(|(_, sample)| match &sample.value {
        Reading::Event(event) => Some(event.name.as_ref()),
        _ => None,
    });
    each.collect()
}

fn described(text: &str) -> SerialConfig {
    SerialConfig { streams: vec![(1, text.parse().expect("a description"))], ..SerialConfig::default() }
}

/// Frame `number`: a counter that 32 bits hold exactly.
fn encode(number: u32, out: &mut Vec<u8>) {
    let payload = number.to_le_bytes();
    Frame { stream: 1, sequence: number as u16, time_us: number.wrapping_mul(1000), payload: &payload }
        .encode(out);
}

/// Of the described stream, which stands behind the source's own two.
fn values(samples: Samples) -> Vec<u32> {
    let each = samples.into_iter().filter_map(|(stream, sample)| match sample.value {
        Reading::Scalar(Scalar(value)) if stream == 2 => Some(value as u32),
        _ => None,
    });
    each.collect()
}

#[test]
fn a_thousand_readings_a_second_all_arrive() {
    const COUNT: u32 = 3000;
    let (mut device, host) = pair();
    let mut source = source(vec![host], described("n scalar u32"));
    let writer = std::thread::spawn(move || {
        let start = Instant::now();
        for number in 0..COUNT {
            let mut bytes = Vec::new();
            encode(number, &mut bytes);
            device.write_all(&bytes).expect("written");
            let due = start + Duration::from_millis(u64::from(number));
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
        }
        device
    });
    let samples = run(&mut source, 30.0, |source, _| source.totals().frames.frames == u64::from(COUNT));
    let totals = source.totals();
    assert_eq!((totals.lost, totals.frames.broken, totals.frames.skipped), (0, 0, 0), "{totals:?}");
    assert_eq!(values(samples), (0..COUNT).collect::<Vec<_>>());
    drop(writer.join());
}

#[test]
fn two_hundred_thousand_frames_as_fast_as_they_go() {
    const COUNT: u32 = 200_000;
    let (mut device, host) = pair();
    let mut source = source(vec![host], described("n scalar u32"));
    let writer = std::thread::spawn(move || {
        let mut bytes = Vec::new();
        (0..COUNT).for_each(|number| encode(number, &mut bytes));
        device.write_all(&bytes).expect("written");
        device
    });
    let samples = run(&mut source, 60.0, |source, _| source.totals().frames.frames == u64::from(COUNT));
    let totals = source.totals();
    assert_eq!((totals.lost, totals.frames.broken, totals.frames.skipped), (0, 0, 0), "{totals:?}");
    assert!(values(samples).into_iter().eq(0..COUNT));
    drop(writer.join());
}

/// A byte dropped in every 97th, a bit flipped in every 131st, a byte added in every 211th frame.
fn damaged(count: u32, dice: &mut impl FnMut() -> usize) -> (Vec<u8>, Vec<u32>) {
    let (mut wire, mut intact) = (Vec::new(), Vec::new());
    for number in 1..=count {
        let mut bytes = Vec::new();
        encode(number, &mut bytes);
        let place = dice() % bytes.len();
        let mut is_intact = true;
        if number % 97 == 0 {
            bytes.remove(place);
            is_intact = false;
        }
        if number % 131 == 0 {
            let place = place.min(bytes.len() - 1);
            bytes[place] ^= 1 << (dice() % 8);
            is_intact = false;
        }
        if number % 211 == 0 {
            // Not between two frames, where it would do no harm.
            bytes.insert(place.max(1), dice() as u8);
            is_intact = false;
        }
        if is_intact {
            intact.push(number);
        }
        wire.extend(bytes);
    }
    (wire, intact)
}

#[test]
fn damage_costs_what_it_hits_and_nothing_else() {
    let mut state = 1u64;
    let mut dice = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize
    };
    let (wire, intact) = damaged(20_000, &mut dice);
    let (mut device, host) = pair();
    let mut source = source(vec![host], described("n scalar u32"));
    let length = wire.len() as u64;
    let writer = std::thread::spawn(move || {
        device.write_all(&wire).expect("written");
        device
    });
    let samples = run(&mut source, 60.0, |source, _| source.totals().frames.bytes == length);
    let totals = source.totals();
    let found = values(samples);
    let kept = found.iter().filter(|number| intact.binary_search(number).is_ok()).count();
    let false_frames = found.len() - kept;
    println!("{kept} of {} intact frames, {false_frames} false ones, {totals:?}", intact.len());
    assert_eq!(false_frames, 0);
    assert!(kept * 100 >= intact.len() * 98);
    // Nothing waits behind damage but the very last frame.
    assert!(kept + 1 >= intact.len());
    assert!(totals.lost > 0);
    drop(writer.join());
}

#[test]
fn a_device_that_goes_is_told_and_one_that_comes_back_is_read() {
    let (mut first, host_1) = pair();
    let (mut second, host_2) = pair();
    let mut source = source(vec![host_1, host_2], described("n scalar u32"));
    let mut bytes = Vec::new();
    encode(1, &mut bytes);
    first.write_all(&bytes).expect("written");
    second.write_all(&bytes).expect("written");
    let mut samples = run(&mut source, 5.0, |_, samples| samples.len() >= 3);
    drop(first);
    samples.extend(run(&mut source, 5.0, |source, _| source.totals().frames.frames == 2));
    assert_eq!(events(&samples), ["connected", "disconnected", "connected"]);
    assert!(samples.iter().filter(|(stream, _)| *stream == EVENTS).count() == 3);
    assert_eq!(values(samples), [1, 1]);
}

#[test]
fn noise_is_said_to_be_a_wrong_baud_rate() {
    let (mut device, host) = pair();
    let mut source = source(vec![host], SerialConfig::default());
    let noise: Vec<u8> = (0..4096u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8 | 0x80).collect();
    device.write_all(&noise).expect("written");
    let samples = run(&mut source, 5.0, |_, samples| events(samples).contains(&"no_frames"));
    let said = samples.iter().find_map(|(_, sample)| match &sample.value {
        Reading::Event(event) if event.name == "no_frames" => Some(event.clone()),
        _ => None,
    });
    let said = said.expect("an event");
    assert!(said.text.contains("wrong baud rate?") && said.after == 115_200.0, "{said:?}");
}

#[test]
fn streams_that_describe_themselves_need_no_configuration() {
    let (mut device, host) = pair();
    let mut source = source(vec![host], SerialConfig::default());
    let mut bytes = Vec::new();
    let frame = |stream, sequence, payload: &[u8], bytes: &mut Vec<u8>| {
        Frame { stream, sequence, time_us: u32::from(sequence) * 1000, payload }.encode(bytes);
    };
    frame(1, 0, &[1], &mut bytes);
    for round in 0..3u16 {
        frame(0, 3 * round + 1, b"\x01heart scalar u8 bpm", &mut bytes);
        frame(0, 3 * round + 2, b"\x02imu imu i16 0.001", &mut bytes);
        frame(1, 3 * round + 3, &[72], &mut bytes);
    }
    frame(2, 10, &[100, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0], &mut bytes);
    device.write_all(&bytes).expect("written");
    let samples = run(&mut source, 5.0, |source, _| source.totals().frames.frames == 11);
    let names: Vec<&str> = source.streams().iter().map(|stream| stream.name.as_str()).collect();
    assert_eq!(names, ["events", "clock/residual", "heart", "imu"]);
    assert_eq!((source.totals().unread, source.totals().lost), (1, 0));
    assert_eq!(source.streams()[2].unit, "bpm");
    let imu = samples.iter().find_map(|(stream, sample)| match sample.value {
        Reading::Imu(imu) if *stream == 3 => Some(imu),
        _ => None,
    });
    let imu = imu.expect("an inertial reading");
    assert_eq!((imu.gyr_rad_s.x, imu.acc_m_s2.z), (0.1, 0.001));
}

/// A device that goes back and forth between descriptions has as many streams as descriptions; one that describes new ones
/// without end has as many as are allowed.
#[test]
fn descriptions_without_end_make_no_streams_without_end() {
    const CHANGES: usize = 3000;
    let (mut device, host) = pair();
    let mut source = source(vec![host], SerialConfig::default());
    let (go_on, half) = std::sync::mpsc::channel();
    let writer = std::thread::spawn(move || {
        let mut write = |sequence: usize, text: String| {
            let (mut bytes, payload) = (Vec::new(), [&[1], text.as_bytes()].concat());
            Frame { stream: 0, sequence: sequence as u16, time_us: 0, payload: &payload }.encode(&mut bytes);
            device.write_all(&bytes).expect("written");
        };
        (0..CHANGES).for_each(|turn| write(turn, format!("x scalar {}", ["u8", "u16"][turn % 2])));
        half.recv().expect("the first half is read");
        (0..CHANGES).for_each(|turn| write(CHANGES + turn, format!("x{turn} scalar u8")));
        device
    });
    let (clock, mut samples) = (HostClock::start(), Samples::new());
    let mut advance = |source: &mut SerialSource, frames: usize| {
        while source.totals().frames.frames < frames as u64 {
            source.advance(clock.now().saturating_add(Span::from_millis(20)), &mut samples);
        }
    };
    advance(&mut source, CHANGES);
    assert_eq!(source.streams().len(), 4);
    go_on.send(()).expect("the writer waits");
    advance(&mut source, 2 * CHANGES);
    assert_eq!(source.streams().len(), 1024);
    let told = events(&samples).into_iter().filter(|name| *name == "description").count();
    assert_eq!(told, 1);
    drop(writer.join());
}

/// The same of lines of names.
#[test]
fn names_without_end_make_no_streams_without_end() {
    let (mut device, host) = pair();
    let mut source = source(vec![host], SerialConfig::default());
    let writer = std::thread::spawn(move || {
        let turns = (0..200).map(|turn| format!("{}\n1,2\n", ["a,b", "c,d"][turn % 2]));
        let new = (0..2000).map(|turn| format!("e{turn},f{turn}\n1,2\n"));
        turns.chain(new).for_each(|text| device.write_all(text.as_bytes()).expect("written"));
        device
    });
    // Two new streams at a time: 2 of its own, 4 that come back, 1018 that are new.
    let samples = run(&mut source, 60.0, |source, _| source.totals().broken_lines == 2000 - 509);
    assert_eq!((source.totals().lines, source.totals().broken_lines), (200 + 509, 2000 - 509));
    assert_eq!(source.streams().len(), 1024);
    assert_eq!(events(&samples).into_iter().filter(|name| *name == "description").count(), 1);
    drop(writer.join());
}

#[test]
fn lines_of_numbers_are_read_with_their_times() {
    let (mut device, host) = pair();
    let mut source = source(vec![host], SerialConfig::default());
    device
        .write_all(b"hello\r\ntime_ms,bpm,seq\r\n1000,60,1\r\n2000,61.5,2\r\n3000,x,3\r\n4000,62,4\r\n")
        .expect("written");
    let samples = run(&mut source, 5.0, |source, _| source.totals().lines == 3);
    let bpm: Vec<_> = samples.iter().filter(|(stream, _)| *stream >= 2).collect();
    let read: Vec<_> = bpm.iter().map(|(_, sample)| &sample.value).collect();
    assert_eq!(read, [60.0, 61.5, 62.0].map(|bpm| Reading::Scalar(Scalar(bpm))).iter().collect::<Vec<_>>());
    assert_eq!((source.totals().lost, source.totals().broken_lines), (1, 1));
    assert!(events(&samples).contains(&"gap"));
}

proptest! {
    /// Whatever arrives: no panic, bounded memory, and nothing but frames whose checksum is right.
    #[test]
    fn anything_may_arrive(bytes in prop::collection::vec(prop_oneof![Just(0xAA), Just(0x55), any::<u8>()], 0..3000)) {
        let mut decoder = Decoder::new();
        for piece in bytes.chunks(97) {
            prop_assert_eq!(decoder.push(piece), 0);
            while decoder.next().is_some() {}
        }
        let tally = decoder.tally();
        prop_assert!(tally.skipped <= tally.bytes);
        let (mut lines, columns) = (Lines::default(), Columns::parse("time_us,a,gx").expect("names"));
        lines.push(&bytes, |line| if let Some(line) = line {
            let _ = columns.read(line);
            let _ = Columns::parse(line);
            let _ = line.parse::<Description>();
        });
    }

    #[test]
    fn any_text_may_come_as_lines(text in "[0-9a-z,.eE_+\\-\\[\\]\n ]{0,400}") {
        let mut lines = Lines::default();
        lines.push(text.as_bytes(), |line| if let Some(columns) = line.and_then(Columns::parse) {
            let count = columns.streams().count();
            assert!(count > 0);
            if let Some(line) = columns.read("1,2,3") {
                assert_eq!(columns.values(&line).count(), count);
            }
        });
        let _ = text.parse::<Description>();
    }
}
