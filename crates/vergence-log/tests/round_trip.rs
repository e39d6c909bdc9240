//! What is recorded comes back bit for bit, in the order in which it arrived.
#![allow(clippy::unwrap_used, reason = "a test stops where something is not as expected")]

use std::path::Path;

use proptest::prelude::*;
use tempfile::TempDir;
use vergence_log::wire::Encoder;
use vergence_log::{
    Compressed, Ending, Error, Header, Limits, Message, Options, Reader, Recorder, StreamDesc, Survey, Times,
    repair,
};
use vergence_sense::{
    Axis, Button, CallResult, Event, FrameHash, FrameTiming, Gaze, HandJoints, Haptic, Image, Imu,
    JOINTS_PER_HAND, JointPose, Pose, RawJoint, RawJoints, RawLocation, RawPose, RawVelocity, RawView,
    RawViews, Scalar, Tracking, Validity, Vector2,
};
use vergence_time::{Span, Timestamp};

fn at(nanos: i64) -> Timestamp {
    Timestamp::from_nanos(nanos)
}

fn encode<T: Message>(times: Times, value: &T) -> Vec<u8> {
    let mut bytes = Vec::new();
    value.encode(times, "local", &mut Encoder::new(&mut bytes));
    bytes
}

/// The same bytes come out of what was read: stronger than equality, which does not see −0 and NaN.
fn survives<T: Message>(times: Times, value: &T) {
    let bytes = encode(times, value);
    let sample = T::decode(&bytes).expect("what was encoded decodes");
    assert_eq!(Times::new(sample.captured, sample.arrived), times);
    assert_eq!(encode(times, &sample.value), bytes, "{}", T::NAME);
    // Cut anywhere, it is an error or a shorter message, never a panic.
    for end in 0..bytes.len() {
        let _ = T::decode(&bytes[..end]);
    }
}

fn single() -> impl Strategy<Value = f32> {
    any::<u32>().prop_map(f32::from_bits)
}

fn double() -> impl Strategy<Value = f64> {
    any::<u64>().prop_map(f64::from_bits)
}

fn tracking() -> impl Strategy<Value = Tracking> {
    prop_oneof![Just(Tracking::Lost), Just(Tracking::Inferred), Just(Tracking::Measured)]
}

prop_compose! {
    fn raw_pose()(position_m in [single(), single(), single()],
                  orientation_xyzw in [single(), single(), single(), single()]) -> RawPose {
        RawPose { position_m, orientation_xyzw }
    }
}

prop_compose! {
    fn pose()(p in [double(), double(), double()], q in [double(), double(), double(), double()],
              pt in tracking(), qt in tracking()) -> Pose {
        Pose::from_exact(p, pt, q, qt)
    }
}

prop_compose! {
    fn times()(captured in any::<i64>(), arrived in any::<i64>()) -> Times {
        Times::new(at(captured), at(arrived))
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn every_bit_of_a_location_survives(times in times(), raw in raw_pose(), flags in any::<u8>(),
                                        v in [single(), single(), single()], with in any::<[bool; 3]>()) {
        let velocity = with[0].then_some(RawVelocity {
            linear_m_s: v, angular_rad_s: v, linear_valid: with[1], angular_valid: with[2],
        });
        let location = RawLocation { pose: raw, validity: Validity(flags), velocity };
        survives(times, &location);
        prop_assert_eq!(RawLocation::decode(&encode(times, &location)).unwrap().value, location);
    }

    #[test]
    fn every_bit_of_views_and_joints_survives(times in times(), poses in proptest::collection::vec(raw_pose(), 26),
                                              fov in [single(), single(), single(), single()], count in 0usize..=4) {
        let views: Vec<RawView> = poses.iter().take(count).map(|&pose| RawView { pose, fov_rad: fov }).collect();
        let views = RawViews::new(Validity(7), &views).unwrap();
        survives(times, &views);
        prop_assert_eq!(RawViews::decode(&encode(times, &views)).unwrap().value, views);
        let joint = |index: usize| RawJoint { pose: poses[index], validity: Validity(index as u8), radius_m: fov[0] };
        let joints = RawJoints { is_active: count % 2 == 0, joints: std::array::from_fn(joint) };
        survives(times, &joints);
        prop_assert_eq!(RawJoints::decode(&encode(times, &joints)).unwrap().value, joints);
    }

    #[test]
    fn every_bit_of_poses_survives(times in times(), poses in proptest::collection::vec(pose(), 26), r in single()) {
        survives(times, &poses[0]);
        let joints: [JointPose; JOINTS_PER_HAND] =
            std::array::from_fn(|index| JointPose { pose: poses[index], radius_m: r });
        survives(times, &HandJoints(joints));
    }

    #[test]
    fn every_bit_of_numbers_survives(times in times(), s in single(), d in double(), some in any::<bool>(),
                                     ns in any::<i64>(), frame in any::<u64>(), hash in any::<[u8; 32]>()) {
        survives(times, &Button(some.then_some(s > 0.0)));
        survives(times, &Axis(some.then_some(s)));
        survives(times, &Vector2(some.then_some([s, -s])));
        survives(times, &Scalar(d));
        let v = nalgebra::Vector3::new(d, -0.0, f64::from(s));
        survives(times, &Imu { gyr_rad_s: v, acc_m_s2: -v, mag_ut: some.then_some(v) });
        let image = Image { width: 3, height: 2, step: 4, encoding: "mono8".into(), data: hash[..8].into() };
        survives(times, &image);
        survives(times, &Compressed(Image { encoding: "jpeg".into(), ..image }));
        survives(times, &Haptic {
            duration: some.then_some(Span::from_nanos(ns)), frequency_hz: some.then_some(s), amplitude: s,
        });
        survives(times, &FrameHash { frame, view: frame as u32, hash });
        survives(times, &FrameTiming {
            frame, wait_returned: at(ns), begun: at(!ns), submitted: some.then_some(at(ns / 2)),
            predicted_display: at(ns / 3), predicted_period: Span::from_nanos(ns / 5), should_render: some,
            presented: (!some).then_some(at(ns / 7)), raw_display: at(!ns / 3),
            raw_period: Span::from_nanos(!ns), ended: some,
        });
        survives(times, &CallResult {
            call: "xrWaitFrame".into(), nth: frame as u32, in_frame: some, code: ns as i32, result: "é".into(),
        });
        let event = Event { name: "état".into(), text: "x".repeat(frame as usize % 300).into(),
                            at: some.then_some(at(ns)), before: d, after: -d };
        survives(times, &event);
        let direction = nalgebra::Unit::new_unchecked(nalgebra::Vector3::new(d, -0.0, 1.0));
        survives(times, &some.then_some(Gaze { origin: [d, f64::NAN, -0.0].into(), direction }));
    }
}

#[test]
fn order_of_arrival_holds_over_streams_lanes_ties_and_negative_times() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("order.mcap");
    let header =
        Header { application: "test".into(), configuration: "[a]\nb = 1\n".into(), ..Header::default() };
    let mut recorder = Recorder::create(&path, &header, &Options::default()).unwrap();
    let one = recorder.stream::<Scalar>(&StreamDesc::new("/one").unit("m")).unwrap();
    let two = recorder.stream::<Scalar>(&StreamDesc::new("/two").host_time().note("why", "a test")).unwrap();
    let mut lane = recorder.lane();
    for step in 0..10_000 {
        // Ten messages share each instant; the first half of the time is before the epoch.
        let now = Times::at(at(step / 10 - 500));
        recorder.write(&one, now, &Scalar(2.0 * step as f64));
        lane.write(&two, now, &Scalar(2.0 * step as f64 + 1.0));
    }
    let status = recorder.finish().unwrap();
    assert_eq!((status.taken, status.dropped, status.failed), (20_000, 0, false));

    let mut reader = Reader::open(&path).unwrap();
    assert_eq!(reader.header(), Some(&header));
    let (mut next, mut last_place) = (0, None);
    while let Some(entry) = reader.next().unwrap() {
        let sample = entry.decode::<Scalar>().unwrap();
        assert_eq!(sample.value, Scalar(f64::from(next)));
        assert_eq!(sample.arrived, at(i64::from(next) / 20 - 500));
        assert_eq!(entry.log_time, u64::try_from(sample.arrived.as_nanos()).unwrap_or(0));
        assert!(last_place < Some(entry.place), "places go forward");
        last_place = Some(entry.place);
        next += 1;
    }
    assert_eq!((next, reader.ending()), (20_000, Some(Ending::Complete)));
    let two = reader.streams().find(|stream| stream.name == "/two").unwrap();
    assert_eq!(
        (two.clock().name(), two.type_name(), two.metadata["why"].as_str()),
        ("host", "Scalar", "a test")
    );
    assert_eq!(Reader::read_all::<Scalar>(&path, "/one").unwrap().len(), 10_000);
}

#[test]
fn another_type_or_stream_is_refused_by_name() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("types.mcap");
    let mut recorder = Recorder::create(&path, &Header::default(), &Options::default()).unwrap();
    let head = recorder.stream::<Pose>(&StreamDesc::new("/head").frame("local")).unwrap();
    assert!(matches!(recorder.stream::<Pose>(&StreamDesc::new("/head")), Err(Error::Stream { .. })));
    assert!(matches!(recorder.stream::<Pose>(&StreamDesc::new("head")), Err(Error::Stream { .. })));
    recorder.write(&head, Times::at(at(1)), &Pose::LOST);
    recorder.finish().unwrap();
    // The schema is the same, the type is not.
    let error = Reader::read_all::<RawLocation>(&path, "/head").unwrap_err();
    assert!(
        error.to_string().contains("expected type RawLocation version 1, found Pose version 1"),
        "{error}"
    );
    let error = Reader::read_all::<Pose>(&path, "/hat").unwrap_err();
    assert!(error.to_string().contains("'/hat'") && error.to_string().contains("/head"), "{error}");
}

#[test]
fn a_queue_that_runs_full_is_counted_and_said_in_the_log() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("full.mcap");
    let options = Options { queue_bytes: 64 << 10, ..Options::default() };
    let mut recorder = Recorder::create(&path, &Header::default(), &options).unwrap();
    let stream = recorder.stream::<Scalar>(&StreamDesc::new("/flood")).unwrap();
    for step in 0..200_000 {
        recorder.write(&stream, Times::at(at(step)), &Scalar(step as f64));
    }
    let status = recorder.finish().unwrap();
    assert!(status.dropped > 0, "this machine writes faster than it thinks");

    let (mut missing, mut told, mut next) = (0, 0.0, 0);
    let mut reader = Reader::open(&path).unwrap();
    while let Some(entry) = reader.next().unwrap() {
        if entry.is::<Event>() {
            let event = entry.decode::<Event>().unwrap().value;
            assert_eq!(event.name, "dropped");
            told += event.after;
        } else {
            assert_eq!(entry.decode::<Scalar>().unwrap().value.0, f64::from(entry.sequence));
            missing += u64::from(entry.sequence - next);
            next = entry.sequence + 1;
        }
    }
    missing += u64::from(200_000 - next);
    assert_eq!((missing, told), (status.dropped, status.dropped as f64));
}

#[test]
fn a_path_that_cannot_be_written_is_one_clear_error() {
    let error =
        Recorder::create("/nowhere/at/all.mcap", &Header::default(), &Options::default()).unwrap_err();
    let source = std::error::Error::source(&error).unwrap().to_string();
    assert_eq!(error.to_string(), "/nowhere/at/all.mcap: cannot be created");
    assert!(source.contains("No such file"), "{source}");
}

/// The second of two recordings to one path is refused, takes nothing from the first, and may go on once that has ended.
#[test]
fn two_recordings_do_not_share_a_file() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("one.mcap");
    let create = || Recorder::create(&path, &Header::default(), &Options::default());
    let mut first = create().unwrap();
    let stream = first.stream::<Scalar>(&StreamDesc::new("/x")).unwrap();
    first.write(&stream, Times::at(Timestamp::from_nanos(1)), &Scalar(1.0));
    let refused = create().unwrap_err();
    let why = std::error::Error::source(&refused).unwrap().to_string();
    assert!(matches!(refused, Error::Create { .. }) && why.contains("another recording"), "{why}");
    // Nor is it replaced by what is made out of other logs.
    let other = dir.path().join("other.mcap");
    Recorder::create(&other, &Header::default(), &Options::default()).unwrap().finish().unwrap();
    let repaired = repair(&other, &path, Limits::default(), &mut |_, _| {});
    assert!(matches!(repaired, Err(Error::Request(_))), "{repaired:?}");
    first.finish().unwrap();
    assert_eq!(Reader::read_all::<Scalar>(&path, "/x").unwrap()[0].value, Scalar(1.0));
    create().unwrap().finish().unwrap();
    assert!(Reader::read_all::<Scalar>(&path, "/x").is_err(), "it was replaced");
}

/// What could not be attached whole is said in the log, and a check finds it.
#[test]
fn what_is_not_attached_is_said() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("attached.mcap");
    let recorder = Recorder::create(&path, &Header::default(), &Options::default()).unwrap();
    recorder.attach("missing.glb", "model/gltf-binary", &dir.path().join("missing.glb"));
    // A file whose length is said to be larger than what can be read of it.
    if std::fs::metadata("/sys/kernel/mm/transparent_hugepage/enabled").is_ok_and(|file| file.len() > 1000) {
        recorder.attach("short", "text/plain", Path::new("/sys/kernel/mm/transparent_hugepage/enabled"));
    }
    recorder.finish().unwrap();
    let survey = Survey::of(&mut Reader::open(&path).unwrap(), &mut |_, _| {}).unwrap();
    let sentences: Vec<&str> = survey.findings.iter().map(|finding| finding.sentence.as_str()).collect();
    assert_eq!(sentences[0], "missing.glb could not be attached");
    if let Some(short) = sentences.get(1) {
        assert!(short.starts_with("short: expected 4096 bytes, found"), "{short}");
    }
    assert!(!survey.is_well());
}

/// What a source sends on streams that the recording refuses is not recorded, and is counted.
#[test]
fn samples_of_a_refused_stream_are_dropped() {
    use vergence_sense::{Reading, Sample, Sink, SourceStream};
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("refused.mcap");
    let recorder = Recorder::create(&path, &Header::default(), &Options::default()).unwrap();
    let recorder = std::sync::Arc::new(std::sync::Mutex::new(recorder));
    let mut lane = vergence_log::SourceLane::new(&recorder, "device", &[]).unwrap();
    let scalar = |name: &str| SourceStream::new(name.to_owned(), vergence_sense::ReadingKind::Scalar);
    let at = Timestamp::from_nanos(1);
    let sample = || Sample { captured: at, arrived: at, value: Reading::Scalar(Scalar(1.0)) };
    lane.appears(0, &scalar("x"));
    lane.appears(1, &scalar("x"));
    // Another device has room for its streams, however many this one announces.
    (2..70_000).for_each(|place| lane.appears(place, &scalar(&format!("x{place}"))));
    let mut other = vergence_log::SourceLane::new(&recorder, "other", &[scalar("x")]).unwrap();
    for place in [0, 0, 0, 1, 1, 1023, 1024, 69_999, 70_000] {
        lane.take(place, sample());
    }
    other.take(0, sample());
    assert_eq!((lane.taken(), other.taken()), (4, 1));
    drop((lane, other));
    let recorder = std::sync::Arc::into_inner(recorder).unwrap().into_inner().unwrap();
    let status = recorder.finish().unwrap();
    assert_eq!((status.taken, status.dropped), (5, 5));
    let said = Reader::read_all::<vergence_sense::Event>(&path, "/recorder/events").unwrap();
    assert_eq!(
        said.iter().map(|event| (&*event.value.name, event.value.after)).collect::<Vec<_>>(),
        [("dropped", 5.0)]
    );
}
