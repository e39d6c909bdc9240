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
use vergence_time::{Clock, HandClock, HostClock, Span, Timestamp};

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

/// A minute, nearly all of it asleep.
#[test]
fn a_thousand_readings_a_second_all_arrive() {
    const COUNT: u32 = 60_000;
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
    let samples = run(&mut source, 300.0, |source, _| source.totals().frames.frames == u64::from(COUNT));
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
    let (wire, intact) = damaged(200_000, &mut dice);
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

/// What a device sends, and when, on a clock that nobody waits for.
struct Script {
    pieces: std::vec::IntoIter<(i64, Vec<u8>)>,
    next: Option<(i64, Vec<u8>)>,
    clock: Arc<HandClock>,
}

impl Port for Script {
    fn read(&mut self, buffer: &mut [u8], longest: Duration) -> std::io::Result<usize> {
        let latest = self.clock.now().saturating_add(Span::from_nanos(longest.as_nanos() as i64));
        let Some((at, _)) = self.next else { return Err(std::io::ErrorKind::BrokenPipe.into()) };
        let at = Timestamp::from_nanos(at * 1_000_000);
        self.clock.advance_to(latest.min(at.max(self.clock.now())));
        if at > latest {
            return Ok(0);
        }
        let Some((_, bytes)) = self.next.take() else { return Ok(0) };
        buffer[..bytes.len()].copy_from_slice(&bytes);
        self.next = self.pieces.next();
        Ok(bytes.len())
    }
}

/// What a source makes of such pieces: each connection's, with the milliseconds at which they arrive.
fn scripted(connections: Vec<Vec<(i64, Vec<u8>)>>, config: SerialConfig) -> (SerialSource, Samples) {
    let clock = Arc::new(HandClock::default());
    let end = connections.iter().flatten().map(|piece| piece.0).max().unwrap_or(0) + 1000;
    let (mut connections, of_ports) = (connections.into_iter(), clock.clone());
    let opener = move || {
        let mut pieces = connections.next().ok_or(std::io::ErrorKind::NotFound)?.into_iter();
        let next = pieces.next();
        Ok(Box::new(Script { pieces, next, clock: of_ports.clone() }) as Box<dyn Port>)
    };
    let mut source = SerialSource::new(Box::new(opener), config, clock.clone());
    let mut samples = Samples::new();
    let end = Timestamp::from_nanos(end * 1_000_000);
    while clock.now() < end {
        let until = end.min(clock.now().saturating_add(Span::from_millis(20)));
        source.advance(until, &mut samples);
    }
    (source, samples)
}

/// Lines at 50 Hz from a millisecond on.
fn lines_at(from_ms: i64, lines: &[&str]) -> Vec<(i64, Vec<u8>)> {
    lines.iter().enumerate().map(|(i, line)| (from_ms + 20 * i as i64, line.as_bytes().to_vec())).collect()
}

fn of_columns(names: &str) -> SerialConfig {
    SerialConfig { columns: Columns::parse(names).ok(), ..SerialConfig::default() }
}

/// Names and values of all scalars but the clock's residual.
fn scalars(source: &SerialSource, samples: &Samples) -> Vec<(String, f64)> {
    let each = samples.iter().filter_map(|(stream, sample)| match sample.value {
        Reading::Scalar(Scalar(value)) if *stream >= 2 => {
            Some((source.streams()[*stream].name.clone(), value))
        }
        _ => None,
    });
    each.collect()
}

fn texts<'a>(samples: &'a Samples, name: &str) -> Vec<&'a str> {
    let each = samples.iter().filter_map(|(_, sample)| match &sample.value {
        Reading::Event(event) if event.name == name => Some(event.text.as_ref()),
        _ => None,
    });
    each.collect()
}

#[test]
fn one_stray_line_costs_itself() {
    let mut lines = vec!["boot\n", "time_us,bpm\n"];
    let numbers: Vec<String> = (0..100).map(|n| format!("{},{}\n", n * 20_000, 60 + n)).collect();
    lines.extend(numbers[..50].iter().map(String::as_str));
    lines.push("OK\n");
    lines.extend(numbers[50..].iter().map(String::as_str));
    let (source, samples) = scripted(vec![lines_at(5, &lines)], SerialConfig::default());
    let found = scalars(&source, &samples);
    assert_eq!((found.len(), source.streams().len()), (100, 3));
    assert!(found.iter().enumerate().all(|(n, (name, bpm))| name == "bpm" && *bpm == 60.0 + n as f64));
    assert_eq!(events(&samples), ["connected", "disconnected"]);
}

#[test]
fn what_is_cut_is_no_reading_and_no_name() {
    // The piece of a line at the opening, a newline lost, a cable pulled in the middle of a line.
    let first = lines_at(5, &["2.5\n", "72.5\n", "73.5\n", "74.5", "75.5\n", "76.5\n", "7"]);
    let second = lines_at(1000, &["8.5\n", "79.5\n"]);
    let (source, samples) = scripted(vec![first, second], of_columns("bpm"));
    let values: Vec<f64> = scalars(&source, &samples).into_iter().map(|(_, bpm)| bpm).collect();
    assert_eq!((values, source.streams().len()), (vec![72.5, 73.5, 76.5, 79.5], 3));
    assert_eq!(source.totals().broken_lines, 1);
    let said = texts(&samples, "line");
    assert!(said.len() == 1 && said[0].contains("`74.575.5`"), "{said:?}");
    // Frames: half of one, and the connection after it begins with the other half.
    let (mut one, mut two) = (Vec::new(), Vec::new());
    encode(1, &mut one);
    encode(2, &mut two);
    let pieces =
        vec![vec![(5, one.clone()), (6, two[..9].to_vec())], vec![(1000, two[9..].to_vec()), (1001, one)]];
    let (source, samples) = scripted(pieces, described("n scalar u32"));
    assert_eq!((values_of(&samples), source.totals().frames.frames), (vec![1, 1], 2));
}

fn values_of(samples: &Samples) -> Vec<u32> {
    values(samples.clone())
}

/// A tenth of a second of readings that wait in the port, then one each millisecond.
#[test]
fn what_waited_in_the_port_is_as_far_apart_as_it_was_measured() {
    let frame = |number: u32| {
        let mut bytes = Vec::new();
        encode(number, &mut bytes);
        bytes
    };
    let mut pieces: Vec<(i64, Vec<u8>)> = vec![(0, (0..100).flat_map(frame).collect())];
    pieces.extend((100..1000).map(|number| (i64::from(number) - 99 + i64::from(number % 3), frame(number))));
    let (source, samples) = scripted(vec![pieces], described("n scalar u32"));
    assert_eq!(source.totals().lost, 0);
    let captured = |samples: &Samples| -> Vec<i64> {
        let readings = samples.iter().filter(|(stream, _)| *stream == 2);
        readings.map(|(_, sample)| sample.captured.as_nanos()).collect()
    };
    let times = captured(&samples);
    assert_eq!(times.len(), 1000);
    for (number, pair) in times.windows(2).enumerate() {
        let step = pair[1] - pair[0];
        assert!((500_000..=1_500_000).contains(&step), "{step} ns after reading {number}");
    }
    assert!(samples.iter().all(|(_, sample)| sample.captured <= sample.arrived));
    // The same of lines.
    let line = |n: i64| format!("{},1\n", n * 1000);
    let mut pieces = vec![(0, format!("time_us,a\n{}", (0..100).map(line).collect::<String>()).into_bytes())];
    pieces.extend((100..300).map(|n| (n - 99, line(n).into_bytes())));
    let (_, samples) = scripted(vec![pieces], SerialConfig::default());
    let times = captured(&samples);
    assert_eq!(times.len(), 300);
    for pair in times.windows(2) {
        assert!((900_000..=1_100_000).contains(&(pair[1] - pair[0])), "{pair:?}");
    }
}

#[test]
fn frames_that_nothing_describes_are_said_once() {
    let pieces = |stream: u8, length: usize| {
        let frame = |number: u16| {
            let mut bytes = Vec::new();
            let (payload, time_us) = (vec![1; length], u32::from(number) * 10_000);
            Frame { stream, sequence: number, time_us, payload: &payload }.encode(&mut bytes);
            (i64::from(number) * 10, bytes)
        };
        vec![(0..500).map(frame).collect::<Vec<_>>()]
    };
    let (source, samples) = scripted(pieces(7, 4), described("n scalar u32"));
    let said = texts(&samples, "unread");
    assert!(
        said.len() == 1 && said[0].contains("stream 7") && said[0].contains("[serial.streams] 7 ="),
        "{said:?}"
    );
    assert_eq!((source.totals().unread, values_of(&samples).len()), (500, 0));
    // Also where they end soon.
    let mut few = pieces(7, 4);
    few[0].truncate(50);
    few[0].push((2000, vec![0]));
    let (_, samples) = scripted(few, described("n scalar u32"));
    assert_eq!(texts(&samples, "unread").len(), 1);
    let (source, samples) = scripted(pieces(1, 3), described("n scalar u32"));
    let said = texts(&samples, "unread");
    assert!(said.len() == 1 && said[0].contains("have 3 bytes") && said[0].ends_with("with 4"), "{said:?}");
    assert_eq!(source.totals().unread, 500);
    assert!(source.losses().contains(&("unread", 500)), "{:?}", source.losses());
}

#[test]
fn a_description_that_is_not_understood_is_said_once_with_its_reason() {
    let frame = |number: u16| {
        let mut bytes = Vec::new();
        Frame { stream: 0, sequence: number, time_us: 0, payload: b"\x04hr scalar u7" }.encode(&mut bytes);
        (i64::from(number) * 10, bytes)
    };
    let (_, samples) = scripted(vec![(0..20).map(frame).collect()], SerialConfig::default());
    let said = texts(&samples, "description");
    assert!(
        said.len() == 1 && said[0].starts_with("stream 4: ") && said[0].contains("found 'u7'"),
        "{said:?}"
    );
}

#[test]
fn lines_that_are_not_understood_are_said_to_be_that() {
    for (line, name, wanted) in [
        ("1000;72,5\n", "line", "found semicolons"),
        ("1000,72\n", "line", "columns = \"name1,name2\""),
        ("hello world 3\n", "no_lines", "found 'hello world 3'"),
    ] {
        let text = [&*vec!["boot\n"], &vec![line; 300]].concat();
        let (_, samples) = scripted(vec![lines_at(5, &text)], SerialConfig::default());
        let said = texts(&samples, name);
        assert!(said.len() == 1 && said[0].contains(wanted), "{line}: {:?}", events(&samples));
        assert!(texts(&samples, "no_frames").is_empty(), "{line}: {:?}", events(&samples));
    }
    let (source, samples) =
        scripted(vec![lines_at(5, &["x\n", "bpm,bpm\n", "1,2\n"])], SerialConfig::default());
    assert_eq!(scalars(&source, &samples), [("bpm".to_owned(), 1.0), ("bpm~2".to_owned(), 2.0)]);
    assert!(texts(&samples, "description")[0].contains("two columns 'bpm'"));
}

#[test]
fn counters_of_lines_wrap() {
    let line = |n: u64| {
        // One is lost behind the wraps.
        let n = n + u64::from(n > 310);
        let (time, sequence) = (((1u64 << 32) - 900_000 + 3000 * n) % (1 << 32), (65_300 + n) % 65_536);
        (3 * n as i64, format!("{time},{sequence},72\n").into_bytes())
    };
    let mut pieces = vec![(0, b"time_us,seq,bpm\n".to_vec())];
    pieces.extend((0..600).map(line));
    let (source, samples) = scripted(vec![pieces], SerialConfig::default());
    assert_eq!(events(&samples), ["connected", "gap", "disconnected"]);
    assert_eq!((source.totals().lost, source.clock_state().jumps), (1, 0));
}

#[test]
fn numbers_that_are_none_are_no_readings() {
    let lines = lines_at(5, &["x\n", "a,b\n", "1,2\n", "nan,3\n", "4,1e400\n", "5,inf\n", "6,7\n"]);
    let (source, samples) = scripted(vec![lines], SerialConfig::default());
    let values: Vec<f64> = scalars(&source, &samples).into_iter().map(|(_, value)| value).collect();
    assert_eq!((values, source.totals().broken_lines), (vec![1.0, 2.0, 3.0, 6.0, 7.0], 2));
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
        lines.push(text.as_bytes(), |line| if let Some(columns) = line.and_then(|line| Columns::parse(line).ok()) {
            let count = columns.streams().count();
            assert!(count > 0);
            if let Some(line) = columns.read("1,2,3") {
                assert_eq!(columns.values(&line).count(), count);
            }
        });
        let _ = text.parse::<Description>();
    }
}
