//! Recording, replaying and session logs as users call them: what is printed, what is written, how each call ends.

use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use serde_json::Value;

fn vergence(words: &[&str]) -> Output {
    Command::new(vergence_tests::vergence()).args(words).output().expect("the binary runs")
}

/// What a call printed, where it ended with `status`.
fn ended(words: &[&str], status: i32) -> (String, String) {
    let output = vergence(words);
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let (out, err) = (text(&output.stdout), text(&output.stderr));
    assert_eq!(output.status.code(), Some(status), "vergence {}\n{out}\n{err}", words.join(" "));
    (out, err)
}

fn object(words: &[&str], status: i32) -> Value {
    let (out, _) = ended(words, status);
    vergence_tests::last_object(&out).unwrap_or_else(|| panic!("no JSON object at the end of {out}"))
}

/// Whether the tool finds a Vulkan device; where not, the test says that it is skipped.
fn vulkan() -> bool {
    let report = object(&["doctor", "--json"], vergence(&["doctor", "--json"]).status.code().unwrap_or(0));
    let found =
        report["findings"].as_array().and_then(|all| all.iter().find(|f| f["topic"] == "Vulkan device"));
    let device = found.expect("a finding on Vulkan");
    if device["usable"] != true {
        vergence_tests::skip("vulkan", &device["missing"].to_string());
    }
    device["usable"] == true
}

/// A folder with a headset that is small enough to be drawn without a GPU, and what its user does.
struct Bench(tempfile::TempDir);

impl Bench {
    fn new() -> Self {
        let bench = Self(tempfile::tempdir().expect("a folder"));
        let headset = "name = \"small\"\nresolution = [32, 30]\nrates = [\"90 Hz\"]\nipd = \"64 mm\"\n[left]\n\
                       fov = { left = \"-48 deg\", right = \"42 deg\", up = \"44 deg\", down = \"-46 deg\" }\n";
        bench.write("headset.toml", headset);
        let user = |duration: &str, render: bool| {
            format!(
                "at-end = \"stop\"\nduration = \"{duration}\"\n[[headset]]\ntime = \"0 s\"\nrender = {render}\n[[head]]\n\
                 time = \"0 s\"\nposition = [\"0 m\", \"1.6 m\", \"0 m\"]\nturned = {{ yaw = \"-20 deg\" }}\n[[head]]\n\
                 time = \"3 s\"\nposition = [\"0.5 m\", \"1.5 m\", \"-0.2 m\"]\nturned = {{ yaw = \"25 deg\" }}\n[[right]]\n\
                 time = \"0 s\"\nposition = [\"0.2 m\", \"1.4 m\", \"-0.3 m\"]\ntrigger = 0.0\n[[right]]\n\
                 time = \"1 s\"\ntrigger = 0.9\n"
            )
        };
        bench.write("user.toml", &user("4 s", true));
        bench.write("idle.toml", &user("60 s", false));
        bench
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join(name).to_str().expect("a path in UTF-8").to_owned()
    }

    fn write(&self, name: &str, text: &str) {
        std::fs::write(self.0.path().join(name), text).expect("a file in the folder");
    }

    fn record(&self, scene: &Path, motion: &str, log: &str, more: &[&str]) -> Value {
        let (scene, headset, motion, log) =
            (scene.to_str().expect("UTF-8"), self.path("headset.toml"), self.path(motion), self.path(log));
        let mut words =
            vec!["run", scene, "--headset", "simulated", "--profile", &headset, "--motion", &motion];
        words.extend(["--msaa", "1", "--json", "--record", &log]);
        words.extend(more);
        object(&words, 0)
    }
}

fn room() -> PathBuf {
    vergence_tests::checkout().join("crates/vergence-scene/samples/room.toml")
}

fn assert_equal(report: &Value, frames: u64) {
    for (all, equal) in [("frames", "frames_equal"), ("events", "events_equal"), ("images", "images_equal")] {
        assert_eq!(report[all], report[equal], "{report}");
    }
    assert_eq!(
        (&report["first_difference"], &report["complete"]),
        (&Value::Null, &Value::Bool(true)),
        "{report}"
    );
    assert!(report["frames"].as_u64().is_some_and(|found| found >= frames), "{report}");
    assert!(report["events"].as_u64().is_some_and(|found| found >= 7), "{report}");
}

#[test]
fn three_hundred_frames_of_the_colonnade_replay_equal() {
    let Some(data) = vergence_tests::data() else { return };
    if !vulkan() {
        return;
    }
    let bench = Bench::new();
    let run =
        bench.record(&data.join("scenes/gltf/colonnade.glb"), "user.toml", "walk.mcap", &["--frames", "300"]);
    assert_eq!((&run["frames"], &run["recording"]["dropped"]), (&300.into(), &0.into()), "{run}");
    let log = bench.path("walk.mcap");
    let verify = |speed: &str| {
        let report = object(&["replay", &log, "--verify", "--json", "--speed", speed], 0);
        assert_equal(&report, 300);
        assert_eq!(report["images"], 600, "{report}");
    };
    verify("max");
    // As it was recorded, and as fast as it goes, while both cores have more to do than they can.
    std::thread::scope(|scope| {
        for speed in ["1", "max", "max"] {
            let verify = &verify;
            scope.spawn(move || verify(speed));
        }
    });

    // The recording is not of another scene, and a real headset keeps to the wall clock.
    let scene = room();
    let (_, said) = ended(&["replay", &log, "--scene", scene.to_str().expect("UTF-8")], 2);
    assert!(said.contains("found other content"), "{said}");
    let (_, said) = ended(&["replay", &log, "--headset", "openxr"], 2);
    assert!(said.contains("wall clock"), "{said}");
}

/// Where nothing is drawn a replay is a matter of calls; how fast it is, the line says (20 times real time is the bar).
#[test]
fn what_was_recorded_is_told_checked_mended_cut_merged_and_compared() {
    if !vulkan() {
        return;
    }
    let bench = Bench::new();
    let run = bench.record(&room(), "idle.toml", "a.mcap", &["--attach-scene"]);
    assert!(run["frames"] == 0 && run["paced"].as_u64().is_some_and(|paced| paced > 5300), "{run}");
    bench.record(&room(), "idle.toml", "b.mcap", &["--fault", "xrLocateViews=NAN_POSE@50"]);
    let (a, b) = (bench.path("a.mcap"), bench.path("b.mcap"));

    // Attached, the scene need not be where it was.
    let report = object(&["replay", &a, "--verify", "--json"], 0);
    assert_equal(&report, 5300);
    let (session, host) = (report["frames"].as_f64().unwrap_or(0.0) / 90.0, report["host_seconds"].as_f64());
    println!("{session:.2} s of session replayed in {host:?} s where nothing is drawn");

    let info = object(&["log", "info", &a, "--json"], 0);
    let stream = |name: &str| {
        let all = info["streams"].as_array().expect("streams");
        all.iter().find(|stream| stream["name"] == name).unwrap_or_else(|| panic!("no {name} in {info}"))
    };
    let head = stream("/head");
    for (field, value) in [("type", "RawLocation"), ("frame", "local"), ("clock", "session")] {
        assert_eq!(head[field], value, "{head}");
    }
    assert!(head["unit"].as_str().is_some_and(|unit| unit.starts_with('m')), "{head}");
    assert!(head["rate_hz"].as_f64().is_some_and(|rate| (rate - 90.0).abs() < 0.1), "{head}");
    for field in ["gaps", "count", "bytes"] {
        assert!(head[field].is_u64(), "{field} in {head}");
    }
    assert_eq!(stream("/diagnostics/recording")["clock"], "host");
    assert!(
        info["attachments"].as_array().is_some_and(|all| all.iter().any(|name| name == "room.toml")),
        "{info}"
    );
    let (out, _) = ended(&["log", "info", &a], 0);
    assert!(out.contains("complete") && out.contains("/session/events"), "{out}");

    let check = object(&["log", "check", &a, "--json"], 0);
    assert_eq!((&check["well"], &check["complete"]), (&true.into(), &true.into()), "{check}");
    assert!(check["streams"][0]["delay"]["residual_ms"].is_number(), "{check}");

    // Cut off in its last chunk: told, mended, replayed as far as it goes.
    let cut_off = bench.path("cut-off.mcap");
    let bytes = std::fs::read(&a).expect("the log");
    std::fs::write(&cut_off, &bytes[..bytes.len() * 9 / 10]).expect("a file");
    let check = object(&["log", "check", &cut_off, "--json"], 1);
    assert!(check["well"] == false && check["cut_off_at"].is_u64(), "{check}");
    let mended = object(&["log", "repair", &cut_off, "--json"], 0);
    let output = mended["output"].as_str().expect("a path").to_owned();
    assert!(
        mended["was_complete"] == false && mended["messages"].as_u64().is_some_and(|n| n > 100),
        "{mended}"
    );
    assert_eq!(object(&["log", "check", &output, "--json"], 0)["well"], true);
    let report = object(&["replay", &output, "--verify", "--json"], 0);
    assert_eq!(
        (&report["frames"], &report["first_difference"]),
        (&report["frames_equal"], &Value::Null),
        "{report}"
    );

    // A damaged chunk: what is before it is equal, and it is said.
    let damaged = bench.path("damaged.mcap");
    std::fs::copy(&a, &damaged).expect("a copy");
    let mut file = std::fs::File::options().read(true).write(true).open(&damaged).expect("the copy");
    let offset = info_chunk(&bytes);
    file.seek(SeekFrom::Start(offset)).expect("inside of the file");
    file.write_all(&[bytes[offset as usize] ^ 0x10]).expect("a byte");
    let (_, said) = ended(&["replay", &damaged, "--verify"], 1);
    assert!(said.contains("damaged"), "{said}");
    ended(&["log", "check", &damaged], 1);

    let part = bench.path("part.mcap");
    let kept = object(
        &[
            "log",
            "cut",
            &a,
            "--from",
            "500ms",
            "--until",
            "1.5s",
            "--streams",
            "/head,/views",
            "-o",
            &part,
            "--json",
        ],
        0,
    );
    assert!(kept["messages"].as_u64().is_some_and(|n| (180..=360).contains(&n)), "{kept}");
    let (_, said) = ended(&["replay", &part], 2);
    assert!(said.contains("from the beginning of a session"), "{said}");
    let (_, said) = ended(&["log", "cut", &a, "--streams", "/nose", "-o", &part], 2);
    assert!(said.contains("/nose") && said.contains("/head"), "{said}");
    // It moves another headset all the same.
    bench.write("unused", "");
    let moved = vergence(&[
        "run",
        room().to_str().expect("UTF-8"),
        "--headset",
        "simulated",
        "--profile",
        &bench.path("headset.toml"),
        "--motion",
        &a,
        "--frames",
        "3",
        "--msaa",
        "1",
    ]);
    assert!(moved.status.success(), "{moved:?}");

    let both = bench.path("both.mcap");
    let merged = object(&["log", "merge", &a, &b, "-o", &both, "--json"], 0);
    assert!(
        merged["renamed"].as_array().is_some_and(|all| all.iter().any(|pair| pair[1] == "/b/head")),
        "{merged}"
    );
    ended(&["log", "check", &both], 0);

    // The same but for one answer: named with its fields.
    assert_eq!(object(&["log", "diff", &a, &a, "--json"], 0)["equal"], true);
    let diff = object(&["log", "diff", &a, &b, "--json"], 1);
    let streams = diff["streams"].as_array().expect("streams");
    let views = streams.iter().find(|stream| stream["name"] == "/views/located").expect("located views");
    let difference = &views["first_difference"];
    assert_eq!(
        (&difference["index"], &difference["fields"][0]["name"]),
        (&49.into(), &"poses[0].position.x".into()),
        "{difference}"
    );
    let (out, _) = ended(&["log", "diff", &a, &b], 1);
    assert!(out.contains("poses[0].position.x") && out.contains("NaN"), "{out}");
    // And the one with the fault replays as it was.
    assert_equal(&object(&["replay", &b, "--verify", "--json"], 0), 5300);

    for verb in ["info", "check", "repair"] {
        ended(&["log", verb, &bench.path("missing.mcap")], 2);
    }
    ended(&["replay", &bench.path("missing.mcap")], 2);
    ended(&["replay", &a, "--speed", "0"], 2);
}

/// A byte in the middle of the chunk that lies in the middle of the file: MCAP's magic, then records of an opcode, a length
/// and a body.
fn info_chunk(bytes: &[u8]) -> u64 {
    let (mut at, mut chunks) = (8usize, Vec::new());
    while let Some(length) = bytes.get(at + 1..at + 9) {
        let length = u64::from_le_bytes(length.try_into().expect("eight bytes")) as usize;
        if bytes[at] == 6 {
            chunks.push(at + 9 + length / 2);
        }
        at += 9 + length;
    }
    chunks[chunks.len() / 2] as u64
}

/// Killed in the middle, a recording is mended to all but its last second; meanwhile nobody else writes it.
#[test]
fn a_killed_recording_is_mended_and_replays() {
    if !vulkan() {
        return;
    }
    let bench = Bench::new();
    let (scene, log) = (room(), bench.path("killed.mcap"));
    let words = |seconds: &'static str| {
        let texts =
            ["run", scene.to_str().expect("UTF-8"), "--headset", "simulated", "--msaa", "1", "--real-time"];
        let mut words: Vec<String> = texts.map(str::to_owned).to_vec();
        words.extend(["--profile".into(), bench.path("headset.toml"), "--record".into(), log.clone()]);
        // The second one is to meet the first one's writer, not its file.
        words.extend(["--overwrite".into(), "--seconds".into(), seconds.into()]);
        words
    };
    let mut child = Command::new(vergence_tests::vergence())
        .args(words("60"))
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("the binary runs");
    // Until there is something to mend.
    let began = std::time::Instant::now();
    let mut size = 0;
    while size < 20_000 && began.elapsed().as_secs() < 60 {
        std::thread::sleep(std::time::Duration::from_millis(100));
        size = std::fs::metadata(&log).map_or(0, |file| file.len());
    }
    let second = Command::new(vergence_tests::vergence()).args(words("1")).output().expect("the binary runs");
    child.kill().expect("it runs");
    child.wait().expect("it was killed");
    let said = String::from_utf8_lossy(&second.stderr);
    // The session went on; that it is not recorded is a failure of the work, for scripts as well.
    assert!(second.status.code() == Some(1) && said.contains("another recording"), "{said}");

    let mended = object(&["log", "repair", &log, "--json"], 0);
    assert_eq!((&mended["missing"], &mended["damaged"]), (&0.into(), &Value::Array(Vec::new())), "{mended}");
    let output = mended["output"].as_str().expect("a path").to_owned();
    let report = object(&["replay", &output, "--verify", "--json"], 0);
    assert_eq!(
        (&report["frames"], &report["first_difference"]),
        (&report["frames_equal"], &Value::Null),
        "{report}"
    );
    assert!(report["frames"].as_u64().is_some_and(|frames| frames > 0), "{report}");
    let mut magic = [0; 8];
    std::fs::File::open(&output).and_then(|mut file| file.read_exact(&mut magic)).expect("a log");
    assert_eq!(&magic, b"\x89MCAP0\r\n");
}
