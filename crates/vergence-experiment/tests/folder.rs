//! The folder of a study: what is finished stays, whatever happens; what is wrong with it is found; who is deleted is gone.
//!
//! Sittings that end badly run in processes of their own: this test's executable, told by its environment what to do.
#![allow(clippy::unwrap_used, reason = "a test stops where something is not as expected")]

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use tempfile::TempDir;
use vergence_experiment::{
    About, Conduct, Ended, Error, Folder, Kind, Reading, State, Status, Step, imported, read, write_log,
};
use vergence_study::{CursorSample, TEMPLATE, analyse};
use vergence_time::Timestamp;

const TASK: &str = "VERGENCE_EXPERIMENT_TEST_TASK";
const FOLDER: &str = "VERGENCE_EXPERIMENT_TEST_FOLDER";

/// A study of 2 × 2 sequences of 5 trials for each of two instructions: 40 trials.
fn study_file(dir: &Path) -> PathBuf {
    let text = TEMPLATE
        .replace("targets = 15", "targets = 5")
        .replace("per_condition = 15", "per_condition = 5")
        .replace("[\"0.15 m\", \"0.25 m\", \"0.35 m\"]", "[\"0.15 m\", \"0.35 m\"]")
        .replace("[\"0.01 m\", \"0.02 m\", \"0.03 m\", \"0.04 m\"]", "[\"0.01 m\", \"0.04 m\"]")
        .replace(
            "[[instructions]]\nname = \"balanced\"\ntext = \"Be as fast and as accurate as you can.\"\n",
            "",
        );
    let path = dir.join("study.toml");
    std::fs::write(&path, text).unwrap();
    path
}

fn about(participant: &str) -> About {
    About {
        application: "test".into(),
        participant: participant.into(),
        headset: "none".into(),
        input: "scripted".into(),
        clock: "virtual".into(),
        ..About::default()
    }
}

fn begin(dir: &Path, participant: &str, resume: bool) -> Result<Conduct, Error> {
    let folder = Folder::create(&dir.join("data"), &study_file(dir))?;
    Conduct::begin(folder, about(participant), resume, false)
}

/// Somebody whose every movement is another one: the offsets follow from the name and the number of the trial.
fn act(
    conduct: &mut Conduct,
    participant: &str,
    most: usize,
    mut ended: impl FnMut(usize),
) -> Result<(), Error> {
    let (mut trials, mut now) = (0, 0i64);
    let own = participant.bytes().fold(0, |sum, byte| 31 * sum + i64::from(byte)) % 50_000;
    while trials < most && !conduct.course().is_done() {
        let goal = conduct.course().goal();
        for step in 0..6 {
            now += 90_000_000 + own + 1_000_000 * ((trials as i64 * 7) % 5);
            let cursor = goal.map(|goal| {
                let off = if goal.is_start { 0.0 } else { 0.3 * goal.width.unwrap_or(0.0) };
                let (sin, cos) = (now as f64 * 1e-8).sin_cos();
                [goal.centre[0] + off * sin, goal.centre[1] + off * cos, goal.centre[2]]
            });
            let reading = Reading { at: Timestamp::from_nanos(now), cursor, pressed: step == 5 };
            if let Step::Trial(_) = conduct.follow(&reading)? {
                trials += 1;
                ended(trials);
            }
        }
    }
    Ok(())
}

fn sit(dir: &Path, participant: &str, resume: bool, most: usize) -> Result<Ended, Error> {
    let mut conduct = begin(dir, participant, resume)?;
    act(&mut conduct, participant, most, |_| ())?;
    conduct.finish(Some("asked to stop"))
}

fn status(dir: &Path) -> Status {
    Status::of(&Folder::open(&dir.join("data")).unwrap()).unwrap()
}

fn kinds(status: &Status) -> Vec<Kind> {
    status.findings.iter().map(|finding| finding.kind).collect()
}

#[test]
fn a_sitting_ends_goes_on_and_is_analysed() {
    let dir = TempDir::new().unwrap();
    let first = sit(dir.path(), "P01", false, 13).unwrap();
    assert_eq!((first.trials, first.progress, first.finished), (13, (13, 40), false));
    assert_eq!(kinds(&status(dir.path())), [Kind::Incomplete, Kind::Incomplete]);
    let again = sit(dir.path(), "P01", false, 40).unwrap_err();
    assert!(again.is_wrong_call() && again.to_string().contains("--resume"), "{again}");
    let other = About { input: "mouse".to_owned(), ..about("P01") };
    let folder = Folder::open(&dir.path().join("data")).unwrap();
    let other = Conduct::begin(folder, other, true, false).unwrap_err();
    assert!(other.is_wrong_call() && other.to_string().contains("--input mouse"), "{other}");
    let second = sit(dir.path(), "P01", true, 40).unwrap();
    assert_eq!((second.trials, second.progress, second.finished), (27, (40, 40), true));
    let done = sit(dir.path(), "P01", true, 40).unwrap_err();
    assert!(done.to_string().contains("has done everything"), "{done}");
    let nobody = sit(dir.path(), "P02", true, 40).unwrap_err();
    assert!(nobody.to_string().contains("has begun"), "{nobody}");

    let folder = Folder::open(&dir.path().join("data")).unwrap();
    let logs: Vec<_> = folder.sittings().iter().map(|sitting| folder.log(sitting).unwrap()).collect();
    let all = imported(&logs).unwrap();
    let analysis = analyse(&all.data, &all.conventions);
    assert_eq!((analysis.counts.trials, analysis.rows.len(), analysis.counts.participants), (40, 8, 1));
    assert!(analysis.rows.iter().all(|row| row.n == 5), "a sequence in two parts is one row");
    assert!(analysis.tp_mean_of_means().unwrap() > 1.0);

    // As a log of its own, the same numbers.
    let copy = dir.path().join("copy.mcap");
    write_log(&copy, &all, "test").unwrap();
    let back = imported(&[read(&copy).unwrap()]).unwrap();
    assert_eq!((&back.data, &back.conventions), (&all.data, &all.conventions));
}

#[test]
fn names_that_are_no_file_names_are_refused() {
    let dir = TempDir::new().unwrap();
    for name in ["", "../P01", "P 1", "-x", "a/b", "ü"] {
        let error = begin(dir.path(), name, false).unwrap_err();
        assert!(error.is_wrong_call() && error.to_string().contains("pseudonym"), "{name}: {error}");
    }
}

#[test]
fn a_study_that_was_changed_is_refused() {
    let dir = TempDir::new().unwrap();
    sit(dir.path(), "P01", false, 3).unwrap();
    let file = dir.path().join("study.toml");
    let changed = std::fs::read_to_string(&file).unwrap().replace("0.35 m", "0.36 m");
    std::fs::write(&file, changed).unwrap();
    let error = Folder::create(&dir.path().join("data"), &file).unwrap_err();
    assert!(error.to_string().contains("before it was changed"), "{error}");
}

#[test]
fn two_do_not_write_at_once() {
    let dir = TempDir::new().unwrap();
    let held = begin(dir.path(), "P01", false).unwrap();
    let error = begin(dir.path(), "P02", false).unwrap_err();
    assert!(error.to_string().contains("in use"), "{error}");
    assert!(status(dir.path()).in_use);
    held.finish(None).unwrap();
    begin(dir.path(), "P02", false).unwrap().finish(None).unwrap();
}

#[test]
fn who_is_deleted_leaves_no_trace_but_the_fact() {
    let dir = TempDir::new().unwrap();
    for name in ["P01", "P011", "P02"] {
        sit(dir.path(), name, false, 40).unwrap();
    }
    std::fs::write(dir.path().join("data/report.html"), "<td>P01</td>").unwrap();
    let mut folder = Folder::open(&dir.path().join("data")).unwrap();
    let naming = folder.delete("P01").unwrap();
    assert_eq!(naming, [dir.path().join("data/report.html")]);
    std::fs::remove_file(&naming[0]).unwrap();
    for entry in std::fs::read_dir(dir.path().join("data")).unwrap() {
        let path = entry.unwrap().path();
        let bytes = std::fs::read(&path).unwrap();
        let text = String::from_utf8_lossy(&bytes).replace("P011", "");
        assert!(!text.contains("P01"), "{}", path.display());
        assert!(!path.display().to_string().replace("P011", "").contains("P01"));
    }
    let status = status(dir.path());
    assert_eq!((status.deleted, status.participants.len(), status.is_sound()), (1, 2, true));
    assert!(folder.delete("P01").unwrap_err().is_wrong_call());
    // The name is free again.
    sit(dir.path(), "P01", false, 2).unwrap();
}

#[test]
fn what_is_wrong_is_found() {
    let whole = TempDir::new().unwrap();
    for name in ["P01", "P02"] {
        sit(whole.path(), name, false, 40).unwrap();
    }
    assert!(status(whole.path()).findings.is_empty(), "{:?}", status(whole.path()).findings);
    let data = whole.path().join("data");
    let log = data.join("P02.1.mcap");
    let bytes = std::fs::read(&log).unwrap();

    let found = |what: &str, kind: Kind, word: &str| {
        let status = status(whole.path());
        let fits = status.findings.iter().any(|f| f.kind == kind && f.text.contains(word));
        assert!(fits && !status.is_sound(), "{what}: {:?}", status.findings);
    };
    // A bit in the middle.
    let mut damaged = bytes.clone();
    damaged[bytes.len() / 2] ^= 4;
    std::fs::write(&log, &damaged).unwrap();
    found("a flipped bit", Kind::Damaged, "checksum");
    // Half of it.
    std::fs::write(&log, &bytes[..bytes.len() / 2]).unwrap();
    found("half a log", Kind::Gap, "expected 40 trials");
    std::fs::remove_file(&log).unwrap();
    found("no log", Kind::Damaged, "found none");
    // Somebody else's under this name.
    std::fs::copy(data.join("P01.1.mcap"), &log).unwrap();
    found("a copy in place of a log", Kind::Copied, "expected trials of P02, found those of P01");
    found("a copy in place of a log", Kind::Copied, "it is a copy");
    std::fs::write(&log, &bytes).unwrap();
    std::fs::copy(&log, data.join("P03.1.mcap")).unwrap();
    found("a log that nobody announced", Kind::Copied, "was it copied here");
    std::fs::remove_file(data.join("P03.1.mcap")).unwrap();
    assert!(status(whole.path()).is_sound());

    // The manifest is trusted no more than any file.
    let manifest = data.join("manifest.json");
    let text = std::fs::read_to_string(&manifest).unwrap();
    std::fs::write(&manifest, text.replace("P02.1.mcap", "../P02.1.mcap")).unwrap();
    assert!(Folder::open(&data).unwrap_err().to_string().contains("names of files in this folder"));
    std::fs::write(&manifest, &text[..text.len() / 2]).unwrap();
    assert!(Folder::open(&data).unwrap_err().to_string().contains("expected a study's manifest"));
    std::fs::write(&manifest, &text).unwrap();
    sit(whole.path(), "P2", false, 40).unwrap();
    found("one person under two names", Kind::Duplicate, "may be the same person");
}

/// Rewrites the log of P01 with changed records, and the manifest so that checksums agree: what slipped before they were made.
fn rewritten(change: impl Fn(usize, &mut vergence_experiment::Record)) -> Status {
    let dir = TempDir::new().unwrap();
    sit(dir.path(), "P01", false, 40).unwrap();
    let data = dir.path().join("data");
    let path = data.join("P01.1.mcap");
    let log = read(&path).unwrap();
    std::fs::remove_file(&path).unwrap();
    let about = About { clock: "monotonic".into(), ..log.about.clone() };
    let mut journal = vergence_experiment::Journal::create(&path, &about).unwrap();
    let mut count = 0;
    for (number, record) in log.records.iter().enumerate() {
        let mut record = record.clone();
        change(number, &mut record);
        if record.trial.mt_s > 0.0 {
            journal.trial(&mut record).unwrap();
            count += 1;
        }
    }
    journal.finish(Timestamp::default(), None).unwrap();
    let manifest = data.join("manifest.json");
    let mut json: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(&manifest).unwrap()).unwrap();
    json["sittings"][0]["hash"] = "".into();
    json["sittings"][0]["trials"] = count.into();
    std::fs::write(&manifest, json.to_string()).unwrap();
    let mut status = status(dir.path());
    // All were written at once, so the computer's clock stands still against the session's.
    status.findings.retain(|finding| !finding.text.contains("against the session's"));
    status
}

/// The cursor of a movement at one speed, as a headset sees it.
fn glide() -> Vec<CursorSample> {
    let sample =
        |i: u32| CursorSample { t_s: f64::from(i) / 90.0, position: [f64::from(i) * 1e-3, 0.0, 0.0] };
    (0..50).map(sample).collect()
}

#[test]
fn slips_gaps_and_doubles_are_found() {
    assert!(rewritten(|_, _| ()).findings.is_empty());
    let finds = |what: &str, kind: Kind, word: &str, status: Status| {
        assert!(
            status.findings.iter().any(|f| f.kind == kind && f.text.contains(word)),
            "{what}: {:?}",
            status.findings
        );
    };
    finds("ms", Kind::UnitSlip, "ms for s", rewritten(|_, record| record.trial.mt_s *= 1e3));
    finds(
        "mm",
        Kind::UnitSlip,
        "mm for m",
        rewritten(|_, record| record.trial.width = record.trial.width.map(|w| w * 1e3)),
    );
    finds(
        "degrees",
        Kind::UnitSlip,
        "degrees for radians",
        rewritten(|_, record| {
            record.trial.amplitude = record.trial.amplitude.map(f64::to_degrees);
        }),
    );
    finds(
        "pixels",
        Kind::UnitSlip,
        "pixels for millimetres",
        rewritten(|_, record| {
            let to_px = 96.0 / 25.4;
            record.trial.end = record.trial.end.map(|x| x * to_px);
            record.trial.start = record.trial.start.map(|p| p.map(|x| x * to_px));
        }),
    );
    finds(
        "a hole",
        Kind::Gap,
        "expected trial 8 of block 1",
        rewritten(|number, record| {
            if number == 7 {
                record.trial.mt_s = 0.0;
            }
        }),
    );
    finds(
        "a double",
        Kind::Duplicate,
        "there twice",
        rewritten(|number, record| {
            if number == 25 {
                record.place.trial -= 1;
            }
        }),
    );
    finds(
        "samples",
        Kind::Gap,
        "gaps between the cursor's samples",
        rewritten(|_, record| {
            record.trial.samples = glide();
            record.trial.samples.drain(10..25);
        }),
    );
    // A hand that rests before it moves says nothing meanwhile.
    let rested = rewritten(|_, record| {
        record.trial.samples = glide();
        record.trial.samples.iter_mut().skip(1).for_each(|sample| sample.t_s += 2.0);
    });
    assert!(!rested.findings.iter().any(|f| f.kind == Kind::Gap), "{:?}", rested.findings);
    finds(
        "back in time",
        Kind::ClockJump,
        "ascending times",
        rewritten(|number, record| {
            if number > 20 {
                record.began = Timestamp::from_nanos(record.began.as_nanos() - 3_600_000_000_000);
            }
        }),
    );
}

#[test]
fn a_clock_that_jumps_is_noticed() {
    let dir = TempDir::new().unwrap();
    let folder = Folder::create(&dir.path().join("data"), &study_file(dir.path())).unwrap();
    let about = About { clock: "monotonic".into(), ..about("P01") };
    let mut conduct = Conduct::begin(folder, about, false, false).unwrap();
    // The session's clock goes on by minutes, the computer's stands still.
    act(&mut conduct, "P01", 40, |_| ()).unwrap();
    conduct.finish(None).unwrap();
    let found = status(dir.path());
    assert!(kinds(&found).contains(&Kind::ClockJump) && !found.is_sound(), "{:?}", found.findings);
}

/// What the other tests start as a process of its own; on its own it does nothing.
#[test]
fn child() {
    let (Ok(task), Ok(dir)) = (std::env::var(TASK), std::env::var(FOLDER)) else { return };
    let mut conduct = begin(Path::new(&dir), "P01", task == "resume").unwrap();
    let ended = act(&mut conduct, "P01", 40, |trials| {
        println!("trial {trials}");
        if task == "killed" && trials == 17 {
            println!("kill me");
            std::thread::sleep(std::time::Duration::from_secs(60));
        }
    });
    match ended {
        Ok(()) => println!("done"),
        Err(error) => {
            println!("stopped: {error}: {:?}", std::error::Error::source(&error).map(ToString::to_string))
        }
    }
    println!("finish: {:?}", conduct.finish(Some("the disk is full")).map(|ended| ended.trials));
}

const ARGUMENTS: [&str; 4] = ["child", "--exact", "--nocapture", "--test-threads=1"];

#[test]
fn who_is_killed_goes_on_with_the_next_trial() {
    let dir = TempDir::new().unwrap();
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(ARGUMENTS)
        .env(TASK, "killed")
        .env(FOLDER, dir.path())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let said: Vec<String> = lines.map(|line| line.unwrap()).take_while(|line| line != "kill me").collect();
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(said.iter().any(|line| line.ends_with("trial 17")), "{said:?}");
    let found = status(dir.path());
    assert_eq!((found.participants[0].trials, found.participants[0].state), (17, State::Open));
    assert!(found.findings.iter().any(|f| f.text.contains("ended without a word")), "{:?}", found.findings);
    assert!(found.is_sound(), "{:?}", found.findings);
    let ended = sit(dir.path(), "P01", true, 40).unwrap();
    assert_eq!((ended.trials, ended.finished), (23, true));
    let found = status(dir.path());
    assert_eq!((found.participants[0].trials, found.participants[0].finished), (40, true));
    assert!(found.findings.iter().all(|f| f.kind == Kind::Note), "{:?}", found.findings);
}

/// A limit of the process (RLIMIT_FSIZE) whose signal is ignored stands for a disk without room: writing fails alike.
#[test]
fn a_full_disk_costs_the_trial_under_way() {
    let dir = TempDir::new().unwrap();
    let shell = format!("trap '' XFSZ; ulimit -f 12; exec \"$0\" {}", ARGUMENTS.join(" "));
    let output = Command::new("bash")
        .args(["-c", &shell, std::env::current_exe().unwrap().to_str().unwrap()])
        .env(TASK, "full")
        .env(FOLDER, dir.path())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let trials = said.lines().filter(|line| line.contains("trial ")).count();
    assert!(said.contains("stopped: ") && (1..40).contains(&trials), "{said}");
    let found = status(dir.path());
    assert_eq!(found.participants[0].trials, trials, "{said}\n{:?}", found.findings);
    assert!(found.findings.iter().any(|f| f.kind == Kind::Incomplete), "{:?}", found.findings);
    let ended = sit(dir.path(), "P01", true, 40).unwrap();
    assert_eq!((ended.trials as usize, ended.finished), (40 - trials, true));
    assert!(status(dir.path()).is_sound(), "{:?}", status(dir.path()).findings);
}
