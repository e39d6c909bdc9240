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
        assert!(String::from_utf8_lossy(&ran.stdout).contains("\"frames\":24"));
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

    // A log without a rig, and one whose calibration is not there.
    let poses = folder.path().join("poses.mcap");
    assert!(tool(&["log", "import", "tum", text(&by_log), "-o", text(&poses)]).status.success());
    let refused = tool(&["slam", "run", text(&poses), "-o", text(&folder.path().join("no.tum"))]);
    assert_eq!(refused.status.code(), Some(1), "{}", told(&refused));
    assert!(told(&refused).contains("poses.mcap: expected a log of a rig"), "{}", told(&refused));
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
