//! Odometry over a rig that is live, replayed from a log, and read from a data set's folder: the same poses, to the last bit.

use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::sync::{Arc, Mutex};

use vergence_log::{Header, Options, Recorder, SourceLane};
use vergence_sense::{Progress, Reading, Sample, Sink, Source, SourceStream};
use vergence_session::{RigLog, annotate_rig};
use vergence_slam::dataset::{Dataset, DatasetSource, Writer};
use vergence_slam::follower::{Feed, Follower};
use vergence_slam::playback::{Mode, Playback};
use vergence_slam::trajectory::Trajectory;
use vergence_slam::{Error, Estimate, Params};
use vergence_tests::{data, vergence};
use vergence_time::{Span, Timestamp};
use vergence_vision::TrackerKnobs;

/// The first `frames` frames of the half-real flight.
fn beginning(frames: usize) -> Option<Dataset> {
    let mut dataset = Dataset::open(&data()?.join("slam/half_real_v101_14s")).expect("the flight");
    dataset.frames.truncate(frames);
    let last = dataset.frames[frames - 1].at.saturating_add(Span::from_millis(30));
    dataset.inertial.as_mut().expect("a unit").samples.retain(|sample| sample.0 <= last);
    dataset.truth.as_mut().expect("a truth").poses.truncate(frames);
    Some(dataset)
}

fn follower(dataset: &Dataset, mode: Mode) -> Follower {
    let (knobs, params) = (TrackerKnobs::default(), Params::default());
    Follower::new(&dataset.root, &dataset.rig(), mode, knobs, params, 1).expect("a follower")
}

/// Takes every frame that is ready.
fn gather(into: &mut Vec<Estimate>) -> impl FnMut(&mut Follower) -> Result<bool, Error> {
    |follower| {
        while let Some(estimate) = follower.follow()? {
            into.push(estimate);
        }
        Ok(true)
    }
}

/// What a live session has: the estimator and the recorder listen to the same source.
struct Both<'a>(Feed<'a>, SourceLane);

impl Sink for Both<'_> {
    fn appears(&mut self, place: usize, stream: &SourceStream) {
        self.0.appears(place, stream);
        self.1.appears(place, stream);
    }

    fn take(&mut self, stream: usize, sample: Sample<Reading<'_>>) {
        self.1.take(stream, sample.clone());
        self.0.take(stream, sample);
    }
}

/// The rig's source, whose second camera is late and whose readings come in packets, as over a slow bus.
struct Late(DatasetSource);

impl Late {
    fn give(&mut self, until: Timestamp, sink: &mut dyn Sink) -> Progress {
        let mut held = Vec::new();
        let progress = self.0.advance(until, &mut held);
        // Of what came in this step, pictures first and the readings last.
        held.sort_by_key(|(stream, _)| std::cmp::Reverse(*stream));
        for (stream, sample) in held {
            sink.take(stream, sample);
        }
        progress
    }
}

#[test]
fn live_replay_and_data_set_give_the_same_poses() {
    let Some(dataset) = beginning(36) else { return };
    let mode = Mode::StereoInertial;
    let mut played = Vec::new();
    let mut playback =
        Playback::new(&dataset, mode, TrackerKnobs::default(), Params::default()).expect("a playback");
    for frame in 0..dataset.frames.len() {
        let loaded = Playback::load(&dataset, mode, frame).expect("pictures");
        played.push(playback.follow(frame, &loaded).expect("an estimate"));
    }

    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("live.mcap");
    let header = Header { application: "test".into(), clock: "of the recording".into(), ..Header::default() };
    let options = Options { queue_bytes: 256 << 20, ..Options::default() };
    let recorder = Recorder::create(&path, &header, &options).expect("a recorder");
    annotate_rig(&recorder, &dataset.rig(), 20.0);
    let recorder = Arc::new(Mutex::new(recorder));
    let mut live = Vec::new();
    let mut late = Late(DatasetSource::new(dataset.clone()));
    let lane = SourceLane::new(&recorder, "rig", late.0.streams()).expect("a lane");
    {
        let feed = Feed::new(follower(&dataset, mode), late.0.streams(), gather(&mut live));
        let mut both = Both(feed, lane);
        let mut until = dataset.inertial.as_ref().expect("a unit").samples[0].0;
        while late.give(until, &mut both) != Progress::Ended {
            until = until.saturating_add(Span::from_millis(37));
        }
        assert_eq!(both.0.finish().expect("all is well").incomplete(), 0);
    }
    let recorder = Arc::into_inner(recorder).expect("one owner").into_inner().expect("no panic");
    assert_eq!(recorder.finish().expect("a log").dropped, 0);

    let log = RigLog::open(&path).expect("a log of a rig");
    let mut replayed = Vec::new();
    log.follow(follower(&dataset, mode), gather(&mut replayed)).expect("a replay");
    assert_eq!(played.len(), 36);
    assert!(live == played, "live: {} poses", live.len());
    assert!(replayed == played, "replayed: {} poses", replayed.len());
    let moved = played[35].world_from_body.translation.vector.norm();
    assert!(moved > 0.05, "it does not move: {moved} m");
}

fn tool(arguments: &[&str]) -> Output {
    Command::new(vergence()).args(arguments).output().expect("the binary runs")
}

fn text(path: &Path) -> &str {
    path.to_str().expect("a path in UTF-8")
}

fn told(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn an_imported_log_is_followed_as_its_folder_is() {
    let Some(dataset) = beginning(24) else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let rig = folder.path().join("flight");
    let mut writer = Writer::create(&rig, &dataset.rig(), 20.0).expect("a folder");
    for frame in 0..dataset.frames.len() {
        for (camera, picture) in dataset.pictures(frame).expect("pictures").iter().enumerate() {
            writer.picture(camera, dataset.frames[frame].at, &picture.pixels).expect("written");
        }
    }
    let readings = &dataset.inertial.as_ref().expect("a unit").samples;
    writer.finish(readings, dataset.truth.as_ref().expect("a truth")).expect("written");

    let log = folder.path().join("flight.mcap");
    let imported = tool(&["log", "import", "euroc", text(&rig), "-o", text(&log)]);
    assert!(imported.status.success(), "{}", told(&imported));
    let (by_folder, by_log) = (folder.path().join("folder.tum"), folder.path().join("log.tum"));
    for (recording, poses) in [(&rig, &by_folder), (&log, &by_log)] {
        let ran = tool(&["slam", "run", text(recording), "-o", text(poses), "--json"]);
        assert!(ran.status.success(), "{}", told(&ran));
        let said = String::from_utf8_lossy(&ran.stdout).into_owned();
        assert!(said.contains("\"frames\":24") && said.contains("\"state\":\"tracked\""), "{said}");
    }
    let read = |path: &Path| std::fs::read(path).expect("poses");
    assert!(read(&by_folder) == read(&by_log), "other poses");
    assert_eq!(Trajectory::read(&by_log).expect("poses").poses.len(), 24);
    let compared = tool(&["slam", "eval", text(&by_log), text(&rig)]);
    assert!(compared.status.success(), "{}", told(&compared));

    // What is read is not written over, nor is one output by the other.
    let truth = rig.join("truth.tum");
    let states = folder.path().join("states.csv");
    for (poses, states) in [(&truth, &states), (&by_log, &by_log), (&by_log, &truth)] {
        let arguments = ["slam", "run", text(&rig), "-o", text(poses), "--states", text(states)];
        let refused = tool(&arguments);
        assert_eq!(refused.status.code(), Some(2), "{}", told(&refused));
    }
    assert_eq!(Trajectory::read(&truth).expect("the truth").poses.len(), 24);
    assert_eq!(Trajectory::read(&by_log).expect("poses").poses.len(), 24);

    // The truth comes along into the log.
    let compared = tool(&["slam", "eval", text(&by_log), text(&log)]);
    assert!(compared.status.success(), "{}", told(&compared));
    // Every second picture of a camera is missing; and half an exposure apart.
    let table = rig.join("mav0/cam1/data.csv");
    let whole = std::fs::read_to_string(&table).expect("a table");
    let keep = |(line, _): &(usize, &str)| *line == 0 || line % 2 == 1;
    let half: Vec<&str> = whole.lines().enumerate().filter(keep).map(|line| line.1).collect();
    std::fs::write(&table, half.join("\n")).expect("written");
    let ran = tool(&["slam", "run", text(&rig), "-o", text(&by_folder), "--json"]);
    let report = vergence_tests::last_object(&String::from_utf8_lossy(&ran.stdout)).expect("one object");
    assert_eq!((report["frames"].as_u64(), report["poses"].as_u64()), (Some(24), Some(12)), "{report}");
    assert!(
        told(&ran).contains("12 of 24 pictures of cam0 have no partner within 1.000 ms"),
        "{}",
        told(&ran)
    );
    let late: Vec<String> = whole
        .lines()
        .map(|line| match line.split_once(',').map(|(at, name)| (at.parse::<i64>(), name)) {
            Some((Ok(at), name)) => format!("{},{name}", at + 3_000_000),
            _ => line.to_owned(),
        })
        .collect();
    std::fs::write(&table, late.join("\n")).expect("written");
    let refused = tool(&["slam", "run", text(&rig), "-o", text(&by_folder)]);
    assert!(
        told(&refused).contains("is 3.000 ms later in the middle, and a longer pair_within_ms"),
        "{}",
        told(&refused)
    );
    let config = folder.path().join("pair.toml");
    std::fs::write(&config, "pair_within_ms = 5.0\n").expect("written");
    let ran = tool(&["slam", "run", text(&rig), "-o", text(&by_folder), "--config", text(&config), "--json"]);
    assert!(String::from_utf8_lossy(&ran.stdout).contains("\"poses\":24"), "{}", told(&ran));
    std::fs::write(&table, whole).expect("written");

    // A log without a rig, and one whose calibration is not there.
    let poses = folder.path().join("poses.mcap");
    assert!(tool(&["log", "import", "tum", text(&by_log), "-o", text(&poses)]).status.success());
    let refused = tool(&["slam", "run", text(&poses), "-o", text(&folder.path().join("no.tum"))]);
    assert_eq!(refused.status.code(), Some(1), "{}", told(&refused));
    assert!(told(&refused).contains("poses.mcap: expected a log of a rig"), "{}", told(&refused));
}

/// A path that bends about all axes, every 50 ms for 10 s.
fn spiral(scale: f64, wobble_m: f64) -> Trajectory {
    let pose = |k: i64| {
        let t = k as f64 * 0.05;
        let place = nalgebra::Vector3::new(t.sin(), (1.3 * t).cos(), 0.2 * t) * scale;
        let wobble = nalgebra::Vector3::new((31.0 * t).sin(), (47.0 * t).cos(), 0.0) * wobble_m;
        let turn = nalgebra::UnitQuaternion::from_euler_angles(0.3 * t, t.sin(), 0.8 * t);
        let at = Timestamp::from_nanos(1_403_715_281_262_140_000 + 50_000_000 * k);
        (at, vergence_geom::Rigid::from_parts((place + wobble).into(), turn))
    };
    Trajectory { poses: (0..200).map(pose).collect() }
}

fn write_tum(trajectory: &Trajectory, path: &Path) {
    trajectory.write_tum(std::fs::File::create(path).expect("a file")).expect("written");
}

/// `slam eval --json`: the object, and what was said beside it.
fn evaluated(arguments: &[&str]) -> (serde_json::Value, String) {
    let output = tool(&[&["slam", "eval", "--json"], arguments].concat());
    assert!(output.status.success(), "{}", told(&output));
    let object = vergence_tests::last_object(&String::from_utf8_lossy(&output.stdout)).expect("one object");
    // All warnings are in both.
    for warning in object["warnings"].as_array().expect("warnings") {
        assert!(told(&output).contains(warning.as_str().expect("a sentence")), "{object}");
    }
    (object, told(&output))
}

#[test]
fn an_evaluation_says_what_is_wrong_with_its_files() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = |name: &str| folder.path().join(name);
    let (truth, estimate) = (file("truth.tum"), file("estimate.tum"));
    write_tum(&spiral(1.0, 0.0), &truth);
    write_tum(&spiral(1.0, 2e-3), &estimate);
    let (found, said) = evaluated(&[text(&estimate), text(&truth)]);
    assert_eq!((found["warnings"].as_array().map(Vec::len), &*said), (Some(0), ""));
    let ate_m = found["ate_rmse_m"].as_f64().expect("a number");
    assert!((1e-3..3e-3).contains(&ate_m) && (found["scale"].as_f64().expect("a scale") - 1.0).abs() < 0.01);

    // w before x y z, in a file that has it last.
    let turned = std::fs::read_to_string(&estimate).expect("poses");
    let turned = turned.lines().filter(|line| !line.starts_with('#')).map(|line| {
        let words: Vec<&str> = line.split(' ').collect();
        [&words[..4], &words[7..], &words[4..7]].concat().join(" ")
    });
    std::fs::write(file("w-first.tum"), turned.collect::<Vec<_>>().join("\n")).expect("written");
    let (_, said) = evaluated(&[text(&file("w-first.tum")), text(&truth)]);
    assert!(said.contains("w-first.tum: is w the first number of its quaternions?"), "{said}");
    let (_, said) = evaluated(&[text(&truth), text(&file("w-first.tum"))]);
    assert!(said.contains("w-first.tum: is w the first number of its quaternions?"), "{said}");

    // Twice as large: a matter of one camera, where it is not scaled.
    write_tum(&spiral(2.0, 2e-3), &file("large.tum"));
    let (_, said) = evaluated(&[text(&file("large.tum")), text(&truth)]);
    assert!(said.contains("2.00 times as large as the truth") && said.contains("--align sim3"), "{said}");
    assert_eq!(evaluated(&[text(&file("large.tum")), text(&truth), "--align", "sim3"]).1, "");

    // Positions alone have an ATE; what stands has no scale.
    let straight = spiral(1.0, 0.0);
    let places = straight.poses.iter().map(|(at, pose)| {
        let p = pose.translation.vector;
        format!("{},{},{},{}", at.as_nanos(), p.x, p.y, p.z)
    });
    std::fs::write(file("leica.csv"), places.collect::<Vec<_>>().join("\n")).expect("written");
    let (found, said) = evaluated(&[text(&estimate), text(&file("leica.csv"))]);
    assert!(
        (found["ate_rmse_m"].as_f64().expect("a number") - ate_m).abs() < 1e-12
            && found["rpe_1s_m"].is_null()
    );
    assert!(said.contains("leica.csv: positions alone"), "{said}");
    write_tum(&spiral(1e-4, 0.0), &file("still.tum"));
    assert!(evaluated(&[text(&file("still.tum")), text(&file("still.tum"))]).0["scale"].is_null());

    // Times that begin at 0.
    let begins = spiral(1.0, 0.0).poses[0].0.as_nanos();
    let relative = |(at, pose): &(Timestamp, _)| (Timestamp::from_nanos(at.as_nanos() - begins), *pose);
    write_tum(
        &Trajectory { poses: spiral(1.0, 0.0).poses.iter().map(relative).collect() },
        &file("zero.tum"),
    );
    let refused = tool(&["slam", "eval", text(&file("zero.tum")), text(&truth)]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(told(&refused).contains("do the estimate's times begin at 0?"), "{}", told(&refused));

    // Logs: one stream of poses is it, none is named.
    let log = file("truth.mcap");
    assert!(tool(&["log", "import", "tum", text(&truth), "-o", text(&log)]).status.success());
    let (found, said) = evaluated(&[text(&estimate), text(&log)]);
    assert!(
        (found["ate_rmse_m"].as_f64().expect("a number") - ate_m).abs() < 1e-9 && said.is_empty(),
        "{said}"
    );
    std::fs::write(file("t.csv"), "t_s,x\n0,1\n1,2\n").expect("written");
    assert!(
        tool(&["log", "import", "csv", text(&file("t.csv")), "-o", text(&file("t.mcap"))]).status.success()
    );
    let refused = tool(&["slam", "eval", text(&estimate), text(&file("t.mcap"))]);
    let sentence = "t.mcap: expected a stream of poses called /truth, found none";
    assert!(refused.status.code() == Some(1) && told(&refused).contains(sentence), "{}", told(&refused));
    let refused = tool(&["trade", "slam", text(&log), "-o", text(&file("trade"))]);
    let sentence = "truth.mcap: expected a recording's folder with a truth, found a log";
    assert!(refused.status.code() == Some(2) && told(&refused).contains(sentence), "{}", told(&refused));
}

#[test]
fn states_say_which_poses_are_held_to_their_word() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = |name: &str| folder.path().join(name);
    let (truth, estimate) = (file("truth.tum"), file("estimate.tum"));
    write_tum(&spiral(1.0, 0.0), &truth);
    let mut ours = spiral(1.0, 1e-3);
    let mut states = "#time_ns,state,position_sigma_m,rotation_sigma_rad\n".to_owned();
    for (k, (at, pose)) in ours.poses.iter_mut().enumerate() {
        // A second that does not know where it is, and a jump of ten standard deviations.
        pose.translation.z += if k < 20 { 0.5 } else { 0.0 } + if k == 100 { 0.1 } else { 0.0 };
        states +=
            &format!("{},{},0.01,0.01\n", at.as_nanos(), if k < 20 { "finding-depth" } else { "tracked" });
    }
    write_tum(&ours, &estimate);
    std::fs::write(file("states.csv"), &states).expect("written");
    let (with, plot) = (file("states.csv"), file("plot.svg"));
    let (found, _) = evaluated(&[text(&estimate), text(&truth), "--states", text(&with), "-o", text(&plot)]);
    let tracked = &found["states"];
    assert_eq!((tracked["frames"].as_u64(), tracked["tracked"].as_u64()), (Some(200), Some(180)), "{found}");
    let number = |value: &serde_json::Value| value.as_f64().expect("a number");
    assert!(number(&found["ate_rmse_m"]) > 0.1 && number(&tracked["ate_rmse_m"]) < 0.01, "{found}");
    assert!((number(&tracked["worst_sigmas"]) - 10.0).abs() < 0.5, "{found}");
    assert!((number(&tracked["within_3_sigmas"]) - 179.0 / 180.0).abs() < 1e-9, "{found}");
    // The map above, the error over time with its bounds below.
    let drawn = std::fs::read_to_string(&plot).expect("a plot");
    for part in ["ATE 0.", "Distance from the truth", "three standard deviations", "not tracked"] {
        assert!(drawn.contains(part), "{part}");
    }
    let other = states.replace("140371", "140372");
    std::fs::write(file("other.csv"), other).expect("written");
    let refused =
        tool(&["slam", "eval", text(&estimate), text(&truth), "--states", text(&file("other.csv"))]);
    assert!(
        refused.status.code() == Some(1) && told(&refused).contains("none of 200 at the times of 200 poses")
    );
    let refused =
        tool(&["slam", "eval", text(&estimate), text(&truth), "--states", text(&with), "-o", text(&with)]);
    assert_eq!(refused.status.code(), Some(2), "{}", told(&refused));
}

#[test]
fn a_trade_of_what_was_never_tracked_is_refused() {
    let Some(dataset) = beginning(20) else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let rig = folder.path().join("black");
    let mut writer = Writer::create(&rig, &dataset.rig(), 20.0).expect("a folder");
    for frame in &dataset.frames {
        for camera in 0..2 {
            writer.picture(camera, frame.at, &[0; 752 * 480]).expect("written");
        }
    }
    let readings = &dataset.inertial.as_ref().expect("a unit").samples;
    writer.finish(readings, dataset.truth.as_ref().expect("a truth")).expect("written");
    let out = folder.path().join("trade");
    let refused = tool(&["trade", "slam", text(&rig), "-o", text(&out), "--quick", "--json"]);
    let sentence = "settings less than half of the frames are tracked";
    assert!(refused.status.code() == Some(1) && told(&refused).contains(sentence), "{}", told(&refused));
    assert!(!out.join("slam.toml").exists());
}

#[test]
fn an_end_keeps_what_was_done() {
    let Some(dataset) = beginning(1) else { return };
    let whole = dataset.root.clone();
    let folder = tempfile::tempdir().expect("a folder");
    let poses = folder.path().join("poses.tum");
    // It listens before it opens what it writes.
    let arguments = ["slam", "run", text(&whole), "-o", text(&poses), "--json"];
    let running =
        Command::new(vergence()).args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
    let mut running = running.expect("the binary runs");
    let begun = std::time::Instant::now();
    while !poses.exists() {
        assert!(begun.elapsed().as_secs() < 120 && running.try_wait().expect("a child").is_none());
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    let interrupt = Command::new("kill").args(["-INT", &running.id().to_string()]).status();
    assert!(interrupt.expect("kill runs").success());
    let ended = running.wait_with_output().expect("it ends");
    assert!(ended.status.success(), "{}", told(&ended));
    assert!(told(&ended).contains("of 280 frames, as asked"), "{}", told(&ended));
    assert!(String::from_utf8_lossy(&ended.stdout).contains("\"frames\":280"));
    assert!(std::fs::read_to_string(&poses).expect("poses").lines().count() < 280);
}
