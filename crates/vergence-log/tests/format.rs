//! FORMAT.md says what the code does; public readers in another language read it.
#![allow(clippy::unwrap_used, reason = "a test stops where something is not as expected")]

mod python;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use tempfile::TempDir;
use vergence_log::schema::{Kind, Schema};
use vergence_log::{
    Compressed, Compression, Header, Message, Options, Reader, Recorder, Row, StreamDesc, Times,
};
use vergence_sense::{
    Axis, Button, CallResult, Event, FrameHash, FrameTiming, Gaze, HandJoints, Haptic, Image, Imu,
    JOINTS_PER_HAND, Pose, RawJoint, RawJoints, RawLocation, RawPose, RawVelocity, RawView, RawViews, Scalar,
    Touch, Validity, Vector2,
};
use vergence_time::{Span, Timestamp};

fn collect(schema: &'static Schema, found: &mut BTreeMap<&'static str, &'static Schema>) {
    if found.insert(schema.name, schema).is_none() {
        for field in schema.fields {
            if let Kind::Message(inner) = field.kind {
                collect(inner, found);
            }
        }
    }
}

#[test]
fn the_page_has_every_type_and_field() {
    let mut types = Vec::new();
    let mut schemas = BTreeMap::new();
    macro_rules! all {
        ($($t:ty),*) => { $(
            types.push(format!("| `{}` | {} | `{}` | {} |", <$t>::NAME, <$t>::VERSION, <$t>::SCHEMA.name, <$t>::UNIT));
            collect(<$t>::SCHEMA, &mut schemas);
        )* };
    }
    all!(
        Pose,
        RawLocation,
        RawViews,
        RawJoints,
        HandJoints,
        Option<Gaze>,
        Button,
        Axis,
        Vector2,
        Haptic,
        Event
    );
    all!(FrameTiming, CallResult, FrameHash, Scalar, Imu, Touch, Image<'_>, Compressed<'_>, Row<'_>);
    let mut page = "| type | version | schema | unit |\n|---|---|---|---|\n".to_owned();
    page += &(types.join("\n") + "\n\n```proto\n");
    page += &schemas.values().map(|schema| schema.to_proto()).collect::<Vec<_>>().join("\n");
    page += "```\n";
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("FORMAT.md");
    let text = std::fs::read_to_string(&path).unwrap();
    let (start, end) = ("<!-- types -->\n", "<!-- end of types -->");
    let (before, rest) = text.split_once(start).unwrap();
    let (written, after) = rest.split_once(end).unwrap();
    if std::env::var_os("VERGENCE_WRITE_FORMAT").is_some() {
        std::fs::write(&path, format!("{before}{start}{page}{end}{after}")).unwrap();
    } else {
        assert!(
            written == page,
            "FORMAT.md is out of date: set VERGENCE_WRITE_FORMAT=1 and run this test\n{page}"
        );
    }
}

/// One message and more of every type, at negative and positive times.
fn everything(path: &Path, compression: Compression) {
    let options = Options { compression, ..Options::default() };
    let mut recorder = Recorder::create(path, &Header::default(), &options).unwrap();
    let local = |name: &str| StreamDesc::new(name).frame("local");
    let head = recorder.stream::<RawLocation>(&local("/head")).unwrap();
    let estimate = recorder.stream::<Pose>(&local("/estimate")).unwrap();
    let views = recorder.stream::<RawViews>(&local("/views")).unwrap();
    let raw_hand = recorder.stream::<RawJoints>(&local("/hand/left/joints")).unwrap();
    let hand = recorder.stream::<HandJoints>(&local("/hand/right/joints")).unwrap();
    let gaze = recorder.stream::<Option<Gaze>>(&local("/gaze")).unwrap();
    let button = recorder.stream::<Button>(&StreamDesc::new("/action/select")).unwrap();
    let axis = recorder.stream::<Axis>(&StreamDesc::new("/action/trigger")).unwrap();
    let stick = recorder.stream::<Vector2>(&StreamDesc::new("/action/move")).unwrap();
    let haptic = recorder.stream::<Haptic>(&StreamDesc::new("/haptic")).unwrap();
    let event = recorder.stream::<Event>(&StreamDesc::new("/event")).unwrap();
    let frame = recorder.stream::<FrameTiming>(&StreamDesc::new("/frame")).unwrap();
    let result = recorder.stream::<CallResult>(&StreamDesc::new("/result")).unwrap();
    let hash = recorder.stream::<FrameHash>(&StreamDesc::new("/hash")).unwrap();
    let cpu = recorder.stream::<Scalar>(&StreamDesc::new("/cpu").unit("ms").host_time()).unwrap();
    let imu = recorder.stream::<Imu>(&StreamDesc::new("/imu").frame("imu")).unwrap();
    let camera = recorder.stream::<Image<'_>>(&StreamDesc::new("/camera").frame("camera")).unwrap();
    let jpeg = recorder.stream::<Compressed<'_>>(&StreamDesc::new("/jpeg").frame("camera")).unwrap();
    for step in 0..50 {
        let now = Timestamp::from_nanos(step * 10_000_000 - 250_000_000);
        let times = Times::new(now.saturating_add(Span::from_millis(5)), now);
        let pose = RawPose { position_m: [-0.0, 1.6, step as f32 * 0.1], ..RawPose::IDENTITY };
        let velocity = RawVelocity {
            linear_m_s: [0.1; 3],
            angular_rad_s: [-0.2; 3],
            linear_valid: true,
            angular_valid: true,
        };
        let located = RawLocation { pose, validity: Validity::ALL, velocity: Some(velocity) };
        recorder.write(&head, times, &located);
        recorder.write(&estimate, times, &located.read());
        let view = RawView { pose, fov_rad: [-0.8, 0.7, 0.75, -0.8] };
        recorder.write(&views, times, &RawViews::new(Validity::ALL, &[view; 2]).unwrap());
        let joint = RawJoint { pose, validity: Validity::ALL, radius_m: 0.01 };
        recorder.write(&raw_hand, times, &RawJoints { is_active: true, joints: [joint; JOINTS_PER_HAND] });
        recorder.write(&hand, times, &HandJoints::LOST);
        recorder.write(&gaze, times, &Gaze::of(&located.read()).filter(|_| step % 7 != 3));
        recorder.write(&button, times, &Button(Some(step % 2 == 0)));
        recorder.write(&axis, times, &Axis(None));
        recorder.write(&stick, times, &Vector2(Some([0.5, -0.5])));
        recorder.write(&haptic, times, &Haptic::TICK);
        recorder.write(&event, times, &Event::new("state", "focused"));
        let timing = FrameTiming {
            frame: step as u64,
            wait_returned: now,
            begun: now,
            submitted: None,
            predicted_display: times.captured,
            predicted_period: Span::from_millis(10),
            should_render: true,
            presented: None,
            raw_display: times.captured,
            raw_period: Span::from_millis(10),
            ended: true,
        };
        recorder.write(&frame, times, &timing);
        let failed = CallResult {
            call: "xrLocateViews".into(),
            nth: 2,
            in_frame: true,
            code: -17,
            result: "ERROR_SESSION_LOST".into(),
        };
        recorder.write(&result, times, &failed);
        recorder.write(&hash, times, &FrameHash { frame: step as u64, view: 0, hash: [7; 32] });
        recorder.write(&cpu, times, &Scalar(1.5));
        let up = nalgebra::Vector3::new(0.0, 9.81, 0.0);
        recorder.write(&imu, times, &Imu { gyr_rad_s: up * 0.0, acc_m_s2: up, mag_ut: None });
        let pixels = vec![step as u8; 64 * 48];
        let image = Image {
            width: 64,
            height: 48,
            step: 64,
            encoding: "mono8".into(),
            data: pixels.as_slice().into(),
        };
        recorder.write(&camera, times, &image);
        recorder.write(&jpeg, times, &Compressed(Image { encoding: "jpeg".into(), ..image }));
    }
    assert_eq!(recorder.finish().unwrap().dropped, 0);
}

#[test]
fn public_readers_read_it() {
    let Some(python) = python::find() else { return };
    let dir = TempDir::new().unwrap();
    let names = ["zstd", "lz4", "none"].map(|name| dir.path().join(format!("{name}.mcap")));
    for (path, compression) in names.iter().zip([Compression::Zstd, Compression::Lz4, Compression::None]) {
        everything(path, compression);
    }
    // Cut off in the last chunk, and repaired.
    let whole = std::fs::read(&names[0]).unwrap();
    let (cut, mended) = (dir.path().join("cut.mcap"), dir.path().join("mended.mcap"));
    std::fs::write(&cut, &whole[..whole.len() - 10_000]).unwrap();
    vergence_log::repair(&cut, &mended, vergence_log::Limits::default(), &mut |_, _| {}).unwrap();
    let all: Vec<PathBuf> = names.iter().cloned().chain([mended]).collect();
    python::decode(&python, &all);
    let mut reader = Reader::open(&names[0]).unwrap();
    let mut count = 0;
    while reader.next().unwrap().is_some() {
        count += 1;
    }
    assert_eq!(count, 18 * 50);
    // The script that people copy from.
    let plot = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tools/plot-head-motion");
    let picture = dir.path().join("head.png");
    let output = Command::new(&python).arg(plot).arg(&names[0]).arg(&picture).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(std::fs::read(picture).unwrap().starts_with(b"\x89PNG"));
}
