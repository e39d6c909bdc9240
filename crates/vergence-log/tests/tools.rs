//! What is made out of logs: surveys, parts, merged logs, comparisons.
#![allow(clippy::unwrap_used, reason = "a test stops where something is not as expected")]

use std::path::{Path, PathBuf};

use tempfile::TempDir;
use vergence_log::{
    Compression, Error, Header, Limits, Options, Part, Reader, Recorder, Row, StreamDesc, Survey, Times, cut,
    diff, merge, repair,
};
use vergence_sense::{RawPose, RawView, RawViews, Scalar, Touch, TouchPhase, Validity, Vector2};
use vergence_time::Timestamp;

fn at(nanos: i64) -> Timestamp {
    Timestamp::from_nanos(nanos)
}

/// 1,000 readings of a device at 1 kHz whose clock runs 100 ppm fast and that arrive 3 ms later, with a gap of 50 ms;
/// and what a host measured.
fn log(dir: &Path, name: &str, change: impl Fn(i64, f64) -> f64) -> PathBuf {
    let path = dir.join(name);
    let header = Header { application: name.into(), ..Header::default() };
    let mut recorder = Recorder::create(&path, &header, &Options::default()).unwrap();
    let device = recorder.stream::<Scalar>(&StreamDesc::new("/device/x").unit("m").frame("stage")).unwrap();
    let stick = recorder.stream::<Vector2>(&StreamDesc::new("/stick")).unwrap();
    let host = recorder.stream::<Scalar>(&StreamDesc::new("/host/cpu").unit("ms").host_time()).unwrap();
    for step in 0..1000 {
        let captured = step * 1_000_000 + if step >= 500 { 50_000_000 } else { 0 };
        let arrived = captured + captured / 10_000 + 3_000_000;
        recorder.write(&device, Times::new(at(captured), at(arrived)), &Scalar(change(step, step as f64)));
        if step % 10 == 0 {
            recorder.write(&stick, Times::at(at(arrived)), &Vector2(Some([0.5, -0.0])));
            let noise = std::time::Instant::now().elapsed().as_nanos() as f64 + change(step, 0.0);
            recorder.write(&host, Times::at(at(arrived)), &Scalar(noise));
        }
    }
    recorder.annotate("late", &[("driver".to_owned(), "x 1.2".to_owned())].into());
    recorder.finish().unwrap();
    path
}

fn same(_: i64, value: f64) -> f64 {
    value
}

#[test]
fn a_survey_says_rate_gaps_and_clocks() {
    let dir = TempDir::new().unwrap();
    let path = log(dir.path(), "a.mcap", same);
    let survey = Survey::of(&mut Reader::open(&path).unwrap(), &mut |_, _| {}).unwrap();
    assert!(survey.is_well(), "{:?}", survey.findings);
    assert_eq!((survey.messages, survey.arrived_ns.unwrap().0), (1200, 3_000_000));
    assert_eq!(survey.metadata, ["late"]);
    let device = survey.streams.iter().find(|stream| stream.name == "/device/x").unwrap();
    assert_eq!(
        (device.unit.as_str(), device.frame.as_str(), device.type_name.as_str()),
        ("m", "stage", "Scalar")
    );
    assert_eq!((device.count, device.gaps, device.missing), (1000, 1, 0));
    assert!((device.rate_hz.unwrap() / 1000.0 - 1.0).abs() < 1e-9, "{:?}", device.rate_hz);
    assert!((device.longest_gap_s - 0.051).abs() < 1e-9);
    let delay = device.delay.unwrap();
    assert!((delay.drift_ppm - 100.0).abs() < 0.1 && delay.residual_ms < 1e-3, "{delay:?}");
    assert!((delay.min_ms - 3.0).abs() < 1e-6 && (delay.max_ms - 3.104_9).abs() < 1e-4, "{delay:?}");
    assert_eq!(survey.streams.iter().find(|stream| stream.name == "/host/cpu").unwrap().clock, "host");
}

#[test]
fn a_survey_finds_what_runs_backwards() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("back.mcap");
    let mut recorder = Recorder::create(&path, &Header::default(), &Options::default()).unwrap();
    let stream = recorder.stream::<Scalar>(&StreamDesc::new("/x")).unwrap();
    for (captured, arrived) in [(1, 1), (3, 3), (2, 4), (5, 2)] {
        recorder.write(&stream, Times::new(at(captured), at(arrived)), &Scalar(0.0));
    }
    recorder.finish().unwrap();
    let survey = Survey::of(&mut Reader::open(&path).unwrap(), &mut |_, _| {}).unwrap();
    let kinds: Vec<&str> = survey.findings.iter().map(|finding| finding.kind).collect();
    assert_eq!((kinds, survey.is_well(), survey.complete), (vec!["capture", "arrival"], false, true));
}

#[test]
fn a_part_keeps_bits_times_and_facts() {
    let dir = TempDir::new().unwrap();
    let path = log(dir.path(), "a.mcap", same);
    let to = dir.path().join("part.mcap");
    let part =
        Part { from: Some(at(103_010_000)), until: Some(at(203_020_000)), streams: vec!["/device".into()] };
    let kept = cut(&path, &to, &part, &mut |_, _| {}).unwrap();
    let samples = Reader::read_all::<Scalar>(&to, "/device/x").unwrap();
    assert_eq!((kept.messages, kept.messages + kept.left_out, samples.len()), (100, 1200, 100));
    assert_eq!((samples[0].captured, samples[99].value), (at(100_000_000), Scalar(199.0)));
    let mut reader = Reader::open(&to).unwrap();
    assert_eq!(reader.header().unwrap().application, "a.mcap");
    while reader.next().unwrap().is_some() {}
    let names: Vec<&str> = reader.metadata().iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!((names, reader.streams().count()), (vec!["late", "vergence.cut"], 1));
    // A part in time has every stream of the whole, also those that say nothing in it.
    let nothing = Part { from: Some(at(i64::MAX)), ..Part::default() };
    let empty = dir.path().join("empty.mcap");
    assert_eq!(cut(&path, &empty, &nothing, &mut |_, _| {}).unwrap().messages, 0);
    let mut reader = Reader::open(&empty).unwrap();
    while reader.next().unwrap().is_some() {}
    assert_eq!(reader.streams().count(), 4);
    let nothing = Part { streams: vec!["/dev".into()], ..Part::default() };
    assert!(matches!(cut(&path, &to, &nothing, &mut |_, _| {}), Err(Error::NoStream { .. })));
    assert!(matches!(cut(&path, &path, &part, &mut |_, _| {}), Err(Error::Request(_))));
    assert_eq!(Reader::read_all::<Scalar>(&to, "/device/x").unwrap().len(), 100, "an earlier file stays");
}

#[test]
fn merged_logs_are_in_the_order_of_arrival() {
    let dir = TempDir::new().unwrap();
    let (a, b) = (log(dir.path(), "a.mcap", same), log(dir.path(), "b.mcap", |_, value| -value));
    let to = dir.path().join("both.mcap");
    let merged = merge(&[&a, &b], &to, &mut |_, _| {}).unwrap();
    assert_eq!(merged.messages, 2400);
    assert!(merged.renamed.contains(&("/device/x".into(), "/b/device/x".into())), "{:?}", merged.renamed);
    let survey = Survey::of(&mut Reader::open(&to).unwrap(), &mut |_, _| {}).unwrap();
    assert!(survey.is_well(), "{:?}", survey.findings);
    assert_eq!(survey.session["application"], "a.mcap");
    assert!(survey.metadata.contains(&"vergence.session.2".to_owned()), "{:?}", survey.metadata);
    let theirs = Reader::read_all::<Scalar>(&to, "/b/device/x").unwrap();
    assert_eq!((theirs.len(), theirs[999].value), (1000, Scalar(-999.0)));
}

#[test]
fn a_difference_is_found_in_its_stream_and_host_time_is_none() {
    let dir = TempDir::new().unwrap();
    let a = log(dir.path(), "a.mcap", same);
    let compare = |other: &Path| diff(&a, other, &mut |_, _| {}).unwrap();
    assert!(compare(&log(dir.path(), "b.mcap", same)).equal);
    // The sign of zero is a difference; what the host measured is none.
    let other = compare(&log(dir.path(), "c.mcap", |step, value| if step == 0 { -0.0 } else { value }));
    let stream = |name: &str| other.streams.iter().find(|stream| stream.name == name).unwrap();
    assert!(!other.equal && stream("/stick").first_difference.is_none());
    assert_eq!(stream("/device/x").first_difference.as_ref().unwrap().index, 0);
    assert_eq!(stream("/host/cpu").not_compared, Some("host time"));
    let late =
        compare(&log(dir.path(), "d.mcap", |step, value| if step == 700 { value + 1e-9 } else { value }));
    let device = late.streams.iter().find(|stream| stream.name == "/device/x").unwrap();
    let difference = device.first_difference.as_ref().unwrap();
    assert_eq!((device.equal_until, difference.index), (700, 700));
    assert_eq!(difference.arrived_a_ns, Some(750_000_000 + 75_000 + 3_000_000));
    let field = &difference.fields[0];
    let values = (field.a.as_deref(), field.b.as_deref());
    assert_eq!((field.name.as_str(), values), ("value", (Some("700.0"), Some("700.000000001"))));
    assert_eq!((difference.fields_count, &*difference.sentence), (1, "value: 700.0 | 700.000000001"));
    // One that ends earlier.
    let part = Part { until: Some(at(300_000_000)), ..Part::default() };
    let short = dir.path().join("short.mcap");
    cut(&a, &short, &part, &mut |_, _| {}).unwrap();
    let short = compare(&short);
    let device = short.streams.iter().find(|stream| stream.name == "/device/x").unwrap();
    let own = short.streams.iter().find(|stream| stream.name == "/recorder/events").unwrap();
    assert_eq!((own.not_compared, own.first_difference.is_none()), (Some("the recorder's own"), true));
    assert!(!short.equal && device.first_difference.as_ref().unwrap().sentence.contains("only the first"));
}

/// Of nested messages and lists the very number is named that differs, and a sign of zero is one.
#[test]
fn a_difference_names_its_fields() {
    let dir = TempDir::new().unwrap();
    let write = |name: &str, z: f32, turned: f32, right: f32| {
        let path = dir.path().join(name);
        let mut recorder = Recorder::create(&path, &Header::default(), &Options::default()).unwrap();
        let views = recorder.stream::<RawViews>(&StreamDesc::new("/views").frame("local")).unwrap();
        let mut two = [RawView { pose: RawPose::IDENTITY, fov_rad: [-0.8, right, 0.8, -0.8] }; 2];
        two[1].pose.position_m[2] = z;
        two[1].pose.orientation_xyzw[1] = turned;
        recorder.write(&views, Times::at(at(1)), &RawViews::new(Validity::ALL, &two).unwrap());
        recorder.finish().unwrap();
        path
    };
    let (a, b) = (write("a.mcap", 0.0, 0.0, 0.5), write("b.mcap", -0.0, 0.25, 0.75));
    let found = diff(&a, &b, &mut |_, _| {}).unwrap();
    let views = found.streams.iter().find(|stream| stream.name == "/views").unwrap();
    let difference = views.first_difference.as_ref().unwrap();
    let names: Vec<&str> = difference.fields.iter().map(|field| field.name.as_str()).collect();
    assert_eq!(names, ["poses[1].position.z", "poses[1].orientation.y", "fovs_rad[1]", "fovs_rad[5]"]);
    assert_eq!(
        (difference.fields[0].a.as_deref(), difference.fields[0].b.as_deref()),
        (Some("0.0"), Some("-0.0"))
    );
}

/// What an earlier call left half done is a source like any other: the result's name does not touch it.
#[test]
fn a_repair_leaves_its_source_alone_whatever_it_is_called() {
    let dir = TempDir::new().unwrap();
    let source = log(dir.path(), "a.mcap.part", same);
    let before = std::fs::read(&source).unwrap();
    let to = dir.path().join("a.mcap");
    repair(&source, &to, Limits::default(), &mut |_, _| {}).unwrap();
    assert_eq!(std::fs::read(&source).unwrap(), before);
    assert!(to.exists());
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 2, "nothing else is left");
}

/// What is attached has a checksum of its own: a survey looks at it, and a repair leaves it out and says so.
/// One bit of the length of the file's first record: the chunks behind it are whole.
#[test]
fn a_damaged_beginning_costs_no_chunk() {
    let dir = TempDir::new().unwrap();
    let path = log(dir.path(), "a.mcap", same);
    let mut bytes = std::fs::read(&path).unwrap();
    bytes[16] ^= 0x40;
    std::fs::write(&path, &bytes).unwrap();
    let mut reader = Reader::open(&path).unwrap();
    assert!(matches!(reader.next(), Err(Error::Damaged { at: 8, .. })));
    let mended = dir.path().join("mended.mcap");
    let found = repair(&path, &mended, Limits::default(), &mut |_, _| {}).unwrap();
    assert_eq!((found.messages, found.damaged_count), (1200, 1), "{found:?}");
    assert_eq!(Survey::of(&mut Reader::open(&mended).unwrap(), &mut |_, _| {}).unwrap().messages, 1200);
}

#[test]
fn a_damaged_attachment_is_found_and_left_out() {
    let dir = TempDir::new().unwrap();
    let (path, scene) = (dir.path().join("a.mcap"), dir.path().join("scene.txt"));
    std::fs::write(&scene, "a scene that nobody changed").unwrap();
    let mut recorder = Recorder::create(&path, &Header::default(), &Options::default()).unwrap();
    let stream = recorder.stream::<Scalar>(&StreamDesc::new("/x")).unwrap();
    recorder.attach("scene.txt", "text/plain", &scene);
    recorder.write(&stream, Times::at(at(1)), &Scalar(1.0));
    recorder.finish().unwrap();
    let surveyed = |path: &Path| Survey::of(&mut Reader::open(path).unwrap(), &mut |_, _| {}).unwrap();
    assert!(surveyed(&path).is_well());

    let mut bytes = std::fs::read(&path).unwrap();
    let place = bytes.windows(6).position(|part| part == b"nobody").unwrap();
    bytes[place] ^= 1;
    std::fs::write(&path, bytes).unwrap();
    let survey = surveyed(&path);
    assert_eq!((survey.is_well(), survey.complete, survey.findings_count), (false, true, 1));
    assert_eq!(survey.findings[0].sentence, "the attached scene.txt is damaged");
    let mended = dir.path().join("mended.mcap");
    let found = repair(&path, &mended, Limits::default(), &mut |_, _| {}).unwrap();
    assert_eq!((found.was_complete, found.messages), (false, 1));
    assert_eq!(found.lost_attachments, ["scene.txt"]);
    assert!(surveyed(&mended).is_well());
}

/// A part that ends before it begins is a mistake, and leaves no file.
#[test]
fn a_part_ends_after_it_begins() {
    let dir = TempDir::new().unwrap();
    let path = log(dir.path(), "a.mcap", same);
    let part = Part { from: Some(at(500)), until: Some(at(500)), streams: Vec::new() };
    let out = dir.path().join("part.mcap");
    let refused = cut(&path, &out, &part, &mut |_, _| {}).unwrap_err();
    assert!(matches!(refused, Error::Request(_)) && refused.to_string().contains("after it begins"));
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    // The file that was named is the one that cannot be made.
    let nowhere = Path::new("/no/such/folder/part.mcap");
    let refused = cut(&path, nowhere, &Part::default(), &mut |_, _| {}).unwrap_err().to_string();
    assert_eq!(refused, "/no/such/folder/part.mcap: cannot be created");
}

/// What announces a stream outside of chunks is made unreadable: its name is text no more.
fn silence(bytes: &mut [u8], stream: &str) -> usize {
    let places: Vec<usize> =
        (0..bytes.len() - stream.len()).filter(|&at| bytes[at..].starts_with(stream.as_bytes())).collect();
    places.iter().for_each(|&at| bytes[at] = 0xff);
    places.len()
}

/// The first chunk announces a stream and is damaged, and so is all that would announce it again.
fn without_announcement(dir: &Path) -> (PathBuf, u64) {
    let path = dir.join("a.mcap");
    let mut recorder = Recorder::create(&path, &Header::default(), &Options::default()).unwrap();
    let early = recorder.stream::<Scalar>(&StreamDesc::new("/early")).unwrap();
    for step in 0..300 {
        recorder.write(&early, Times::at(at(step)), &Scalar((step as f64).sin()));
        if step % 100 == 99 {
            recorder.sync().unwrap();
        }
    }
    // Announced in the chunk that it begins in, with a schema that nobody else has.
    let late = recorder.stream::<Vector2>(&StreamDesc::new("/late")).unwrap();
    for step in 300..350 {
        recorder.write(&late, Times::at(at(step)), &Vector2(Some([step as f32, 0.0])));
    }
    recorder.finish().unwrap();
    let mut reader = Reader::open(&path).unwrap();
    let first = reader.next().unwrap().unwrap().place.offset;
    let mut lost = 0;
    while let Some(entry) = reader.next().unwrap() {
        lost += u64::from(entry.stream.name == "/early" && entry.place.offset > first);
    }
    let mut bytes = std::fs::read(&path).unwrap();
    bytes[first as usize + 100] ^= 1;
    assert!(silence(&mut bytes, "/early") >= 2, "behind the chunk and in the summary");
    // The footer: opcode and length, where the summary begins, where its offsets begin, its checksum; then the magic.
    let footer = bytes.len() - 8 - 20 - 9;
    let summary = u64::from_le_bytes(bytes[footer + 9..footer + 17].try_into().unwrap()) as usize;
    // The length of its first record: behind the end of the file.
    bytes[summary + 7] ^= 0x40;
    std::fs::write(&path, bytes).unwrap();
    (path, lost)
}

/// Messages of a stream that nothing announces are one place of damage, however many they are, and are counted.
#[test]
fn a_stream_whose_announcement_is_lost_is_one_place_of_damage() {
    let dir = TempDir::new().unwrap();
    let (path, lost) = without_announcement(dir.path());
    let found = repair(&path, &dir.path().join("mended.mcap"), Limits::default(), &mut |_, _| {}).unwrap();
    assert!(lost >= 200, "{lost}");
    assert_eq!(found.unannounced, [(1, lost)].into());
    let of_stream = found.damaged.iter().filter(|place| place.contains("found number 1")).count();
    assert_eq!((of_stream, found.damaged_count), (1, found.damaged.len() as u64), "{:?}", found.damaged);
    assert!(!found.was_complete);
}

/// Where the summary is damaged, too, what comes behind the chunks that nobody announced is read all the same.
#[test]
fn a_damaged_summary_costs_no_chunk() {
    let dir = TempDir::new().unwrap();
    let (path, _) = without_announcement(dir.path());
    let mended = dir.path().join("mended.mcap");
    let found = repair(&path, &mended, Limits::default(), &mut |_, _| {}).unwrap();
    assert_eq!(found.messages, 50, "{found:?}");
    let late = Reader::read_all::<Vector2>(&mended, "/late").unwrap();
    assert!(late.iter().map(|sample| sample.value.0).eq((300..350).map(|step| Some([step as f32, 0.0]))));
}

/// A bit of the chunk that announces all streams, in a recording that was killed: the rest is there.
#[test]
fn streams_are_announced_more_than_once() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("a.mcap");
    let options = Options { compression: Compression::None, ..Options::default() };
    let mut recorder = Recorder::create(&path, &Header::default(), &options).unwrap();
    let x = recorder.stream::<Scalar>(&StreamDesc::new("/x").unit("m")).unwrap();
    let y = recorder.stream::<Scalar>(&StreamDesc::new("/y")).unwrap();
    for step in 0..200 {
        recorder.write(&x, Times::at(at(step)), &Scalar(step as f64));
        recorder.write(&y, Times::at(at(step)), &Scalar(-step as f64));
        recorder.sync().unwrap();
    }
    // As a kill leaves it.
    let killed = std::fs::read(&path).unwrap();
    drop(recorder);
    let whole = std::fs::read(&path).unwrap();
    let first = Reader::open(&path).unwrap().next().unwrap().unwrap().place.offset as usize;
    let (broken, mended) = (dir.path().join("broken.mcap"), dir.path().join("mended.mcap"));
    let values = |bytes: &[u8]| {
        std::fs::write(&broken, bytes).unwrap();
        let found = repair(&broken, &mended, Limits::default(), &mut |_, _| {}).unwrap();
        (Reader::read_all::<Scalar>(&mended, "/x").unwrap(), found)
    };
    let mut one_bit = killed.clone();
    one_bit[first + 100] ^= 1;
    let (x, found) = values(&one_bit);
    assert!(x.iter().map(|sample| sample.value.0).eq((1..200).map(f64::from)), "{found:?}");
    assert_eq!((found.damaged_count, found.unannounced.len()), (1, 0), "{found:?}");
    assert_eq!(found.messages, 398);

    // All that announced them at first: they are announced again.
    let mut start = killed;
    let length = start.iter().rposition(|_| true).unwrap().min(first + 4096);
    assert!(silence(&mut start[..length], "/x") >= 2);
    start[first + 100] ^= 1;
    let (x, found) = values(&start);
    let behind = 200 - x.len();
    assert!((1..=61).contains(&behind) && found.damaged_count > 1, "{behind}: {found:?}");
    assert!(x.iter().map(|sample| sample.value.0).eq((behind as i32..200).map(f64::from)));

    // The checksum of the data counts what is announced again.
    let footer = whole.len() - 8 - 20 - 9;
    let summary = u64::from_le_bytes(whole[footer + 9..footer + 17].try_into().unwrap()) as usize;
    let end = summary - 9 - 4;
    assert_eq!(whole[end], 0x0f, "the record that ends the data");
    assert_eq!(whole[end + 9..summary], crc32fast::hash(&whole[..end]).to_le_bytes());
}

/// The fields of every type of this room are named.
#[test]
fn a_difference_of_a_touch_or_a_row_is_named() {
    let dir = TempDir::new().unwrap();
    let write = |name: &str, x: f64| {
        let path = dir.path().join(name);
        let mut recorder = Recorder::create(&path, &Header::default(), &Options::default()).unwrap();
        let touch = recorder.stream::<Touch>(&StreamDesc::new("/touch")).unwrap();
        let row = recorder.stream::<Row<'_>>(&StreamDesc::new("/row")).unwrap();
        let finger = Touch { contact: 1, position: [x, 0.0], phase: TouchPhase::Moves };
        recorder.write(&touch, Times::at(at(1)), &finger);
        recorder.write(&row, Times::at(at(1)), &Row { numbers: vec![1.0, x].into(), ..Row::default() });
        recorder.finish().unwrap();
        path
    };
    let found = diff(&write("a.mcap", 1.0), &write("b.mcap", 2.0), &mut |_, _| {}).unwrap();
    let of = |name: &str| {
        let stream = found.streams.iter().find(|stream| stream.name == name).unwrap();
        stream.first_difference.as_ref().unwrap().fields[0].name.clone()
    };
    assert_eq!((of("/touch").as_str(), of("/row").as_str()), ("x", "numbers[1]"));
}
