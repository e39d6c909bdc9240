//! A study from its template to its report, with simulated people: in the simulated headset and in a window; and what becomes
//! of it when the power goes, the session is lost, or the headset is taken off.

use std::io::{BufRead as _, BufReader, Read as _};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use vergence_study::{Plan, PlannedTrial, Study, TEMPLATE};
use vergence_tests::{checkout, last_object, skip, vergence};

/// Processor time that the whole study should take, seconds: said, not asserted, since it is another one on another machine.
const WANTED_CPU_S: f64 = 300.0;
/// The report's throughput against a computation in another language.
const SAME: f64 = 1e-9;
/// For what happens sooner or later, however busy the machine is.
const PATIENCE: Duration = Duration::from_secs(400);

fn tool(folder: &Path, arguments: &[&str]) -> Output {
    let output = Command::new(vergence()).current_dir(folder).args(arguments).output();
    output.expect("the tool runs")
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

fn done(folder: &Path, arguments: &[&str]) -> Value {
    let output = tool(folder, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", said(&output));
    last_object(&String::from_utf8_lossy(&output.stdout)).unwrap_or(Value::Null)
}

fn has_vulkan(folder: &Path) -> bool {
    let output = tool(folder, &["doctor", "--json"]);
    let found = last_object(&String::from_utf8_lossy(&output.stdout));
    let devices = found.as_ref().and_then(|object| object["vulkan"]["devices"].as_array().map(Vec::len));
    // What doctor does not say is found out by trying.
    devices != Some(0)
}

/// The simulated headset with few pixels: lavapipe draws them on the processor.
fn small_headset(folder: &Path) {
    let full = std::fs::read_to_string(checkout().join("crates/vergence-xr-sim/headsets/default.toml"))
        .expect("the default headset is a file");
    let line = full.lines().find(|line| line.starts_with("resolution")).expect("it has a resolution");
    std::fs::write(folder.join("small.toml"), full.replace(line, "resolution = [64, 64]"))
        .expect("a folder to write to");
}

/// A study of 20 trials.
fn small_study(folder: &Path) -> PathBuf {
    let text = TEMPLATE
        .replace("targets = 15", "targets = 5")
        .replace("per_condition = 15", "per_condition = 5")
        .replace("[\"0.15 m\", \"0.25 m\", \"0.35 m\"]", "[\"0.1 m\", \"0.2 m\"]")
        .replace("[\"0.01 m\", \"0.02 m\", \"0.03 m\", \"0.04 m\"]", "[\"0.02 m\", \"0.03 m\"]")
        .replace("repeat_above_error = 0.4\n", "");
    // One instruction.
    let (first, rest) = text.split_once("[[instructions]]").expect("the template has instructions");
    let after = rest.split_once("[prediction]").expect("and a prediction").1;
    let path = folder.join("study.toml");
    std::fs::write(&path, format!("{first}[prediction]{after}")).expect("a folder to write to");
    path
}

/// Processor time of all processes that this one has waited for, seconds: from /proc/self/stat.
fn children_cpu_s() -> f64 {
    let Ok(text) = std::fs::read_to_string("/proc/self/stat") else { return 0.0 };
    // Behind the name, which may hold anything: state is field 3, cutime and cstime are 16 and 17, in hundredths.
    let fields: Vec<&str> = text.rsplit(')').next().unwrap_or("").split_whitespace().collect();
    let ticks = |field: usize| fields.get(field - 3).and_then(|text| text.parse::<f64>().ok()).unwrap_or(0.0);
    (ticks(16) + ticks(17)) / 100.0
}

#[test]
fn a_study_of_twelve_from_template_to_report() {
    let dir = tempfile::tempdir().expect("a folder");
    let here = dir.path();
    if !has_vulkan(here) {
        return skip("vulkan", "no device draws");
    }
    small_headset(here);
    let _ = vergence();
    let before = children_cpu_s();
    done(here, &["study", "new", "s.toml"]);
    for number in 1..=12 {
        let name = format!("P{number:02}");
        let mut arguments = vec!["study", "run", "s.toml", "--participant", &name, "--headset", "simulated"];
        arguments.extend(["--input", "simulated:7", "--profile", "small.toml", "--msaa", "1", "--json"]);
        if number > 1 {
            arguments.push("--no-pictures");
        }
        let ran = done(here, &arguments);
        assert_eq!((&ran["finished"], &ran["done"]), (&true.into(), &540.into()), "{ran}");
        assert!(ran["trials"].as_u64() >= Some(540), "{ran}");
        let (frames, paced) = (ran["session"]["frames"].as_u64(), ran["session"]["paced"].as_u64());
        assert!(paced > Some(20_000) && (number == 1) == (frames > Some(20_000)), "{ran}");
    }
    let status = done(here, &["study", "status", "s.data", "--json"]);
    let people = status["participants"].as_array().expect("participants");
    assert!(people.len() == 12 && people.iter().all(|one| one["finished"] == true), "{status}");

    let found = done(here, &["study", "analyze", "s.data", "--json", "--csv", "tables"]);
    let summary = &found["summary"];
    assert_eq!((&summary["participants"], &summary["sequences"]), (&12.into(), &432.into()), "{summary}");
    assert_eq!(summary["trials"], 12 * 540);
    let tp = summary["tp_mean_of_means"].as_f64().expect("a throughput");
    // People of 4.4 bits/s whom Fitts' law holds for, and who trade speed for accuracy.
    assert!((3.5..5.5).contains(&tp) && summary["r"].as_f64() > Some(0.8), "{summary}");
    let levels = summary["instructions"]["levels"].as_array().expect("instructions");
    let of = |name: &str, what: &str| {
        levels
            .iter()
            .find(|level| level["instruction"] == name)
            .and_then(|level| level[what].as_f64())
            .expect("a level")
    };
    assert!(
        of("fast", "mt_s") < of("balanced", "mt_s") && of("balanced", "mt_s") < of("accurate", "mt_s"),
        "{levels:?}"
    );
    assert!(of("fast", "error_rate") > of("accurate", "error_rate"), "{levels:?}");

    done(here, &["study", "report", "s.data", "-o", "report.html"]);
    let cpu_s = children_cpu_s() - before;
    println!(
        "the whole study took {cpu_s:.0} s of processor time (wanted: {WANTED_CPU_S}) and {:.1} MB of disk; throughput {tp:.4} \
         bits/s",
        megabytes(here)
    );

    let html = std::fs::read_to_string(here.join("report.html")).expect("the report is there");
    throughput_is_pythons(here, &html, tp);
    chromium_opens(here, &html);
}

/// What a folder takes of the disk.
fn megabytes(folder: &Path) -> f64 {
    let entries = std::fs::read_dir(folder).expect("a folder").flatten();
    let size = |entry: std::fs::DirEntry| match entry.metadata() {
        Ok(data) if data.is_dir() => megabytes(&entry.path()),
        Ok(data) => data.len() as f64 * 1e-6,
        Err(_) => 0.0,
    };
    entries.map(size).sum()
}

/// The exact value behind the cell of all sequences in the first table.
fn reported_throughput(html: &str) -> f64 {
    let row = html.split("<tr class=\"marked\">").nth(1).expect("a row for all");
    let cell = row.split("data-value=\"").nth(2).expect("sequences, then throughput");
    cell.split('"').next().expect("a value").parse().expect("a number")
}

fn throughput_is_pythons(here: &Path, html: &str, tp: f64) {
    let script = checkout().join("tests/study_throughput.py");
    let Ok(output) = Command::new("python3").arg(script).arg(here.join("tables/trials.csv")).output() else {
        return skip("python", "no python3");
    };
    assert!(output.status.success(), "{}", said(&output));
    let theirs: Value = serde_json::from_slice(&output.stdout).expect("an object");
    let (theirs_tp, reported) = (theirs["tp"].as_f64().expect("a number"), reported_throughput(html));
    println!("throughput: report {reported}, analysis {tp}, Python {theirs_tp}");
    assert_eq!(theirs["sequences"], 432);
    assert!((reported - theirs_tp).abs() < SAME && (tp - theirs_tp).abs() < SAME);
}

/// Opens the page as a reader does, presses the heads of columns, and tells what happened.
fn chromium_opens(here: &Path, html: &str) {
    const PROBE: &str = "<script>
        const trouble = []; addEventListener('error', e => trouble.push(e.message));
        addEventListener('securitypolicyviolation', e => trouble.push(e.blockedURI));
        addEventListener('load', () => {
          const values = table => [...table.tBodies[0].rows].map(row => Number(row.cells[2].dataset.value));
          const table = document.querySelector('table'), head = table.tHead.rows[0].cells[2].querySelector('button');
          head.click(); const up = values(table); head.click(); const down = values(table);
          const ascends = list => list.every((v, i) => i === 0 || list[i - 1] <= v);
          const sorted = ascends(up) && ascends([...down].reverse()) && up.length > 2 && table.tFoot.rows.length === 1;
          const wide = document.documentElement.scrollWidth <= innerWidth;
          const shown = [...document.querySelectorAll('figure svg')].map(svg => svg.getBoundingClientRect())
            .filter(rect => rect.width > 0);
          const whole = shown.every(rect => rect.left >= 0 && rect.right <= innerWidth);
          const told = {plots: shown.length, whole, sorted, wide, trouble,
            loads: performance.getEntriesByType('resource').length};
          const place = document.createElement('pre'); place.id = 'probe'; place.textContent = JSON.stringify(told);
          document.body.append(place);
        });</script>";
    let page = here.join("probe.html");
    std::fs::write(&page, html.replacen("</head>", &format!("{PROBE}</head>"), 1))
        .expect("a folder to write to");
    for (what, size) in [("desktop", "1280,1600"), ("phone", "390,844")] {
        let run = Command::new("chromium")
            .args(["--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--no-first-run"])
            .args(["--disable-background-networking", "--disable-component-update", "--disable-sync"])
            .args(["--enable-logging=stderr", "--virtual-time-budget=3000", "--dump-dom"])
            .arg(format!("--window-size={size}"))
            .arg(format!("--user-data-dir={}", here.join(what).display()))
            .arg(format!("file://{}", page.display()))
            .output();
        let Ok(output) = run else { return skip("chromium", "it is not installed") };
        // A profile is larger than the whole study.
        let _ = std::fs::remove_dir_all(here.join(what));
        let (dom, log) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
        let told = dom.split("<pre id=\"probe\">").nth(1).and_then(|rest| rest.split("</pre>").next());
        let told: Value =
            told.and_then(|text| serde_json::from_str(text).ok()).unwrap_or_else(|| panic!("{what}: {log}"));
        println!("report at {size} px: {told}");
        assert!(told["plots"].as_u64() >= Some(2) && told["sorted"] == true, "{told}");
        assert_eq!(told["whole"], true, "a plot is cut off: {told}");
        assert!(told["trouble"].as_array().is_some_and(Vec::is_empty) && told["loads"] == 0, "{told}");
        assert!(!log.contains("CONSOLE"), "{log}");
        assert_eq!(told["wide"], true, "the page is wider than the screen: {told}");
    }
}

fn status_of(here: &Path) -> Value {
    let output = tool(here, &["study", "status", "study.data", "--json"]);
    last_object(&String::from_utf8_lossy(&output.stdout)).unwrap_or_else(|| panic!("{}", said(&output)))
}

/// Trials that are on the disk, and movements that had to be made again, while the first participant's first sitting goes on.
fn written(here: &Path) -> (usize, usize) {
    vergence_experiment::read(&here.join("study.data/P01.1.mcap")).map_or((0, 0), |log| {
        let again = log.events.iter().filter(|(_, event)| event.name == "interrupted").count();
        (log.records.len(), again)
    })
}

fn run_of(more: &[&'static str]) -> Vec<&'static str> {
    let mut all =
        vec!["study", "run", "study.toml", "--participant", "P01", "--headset", "simulated", "--json"];
    all.extend(["--profile", "small.toml", "--msaa", "1"]);
    all.extend(more);
    all
}

fn prepared() -> Option<tempfile::TempDir> {
    let dir = tempfile::tempdir().expect("a folder");
    if !has_vulkan(dir.path()) {
        skip("vulkan", "no device draws");
        return None;
    }
    small_headset(dir.path());
    small_study(dir.path());
    Some(dir)
}

#[test]
fn who_is_killed_in_the_middle_of_a_trial_goes_on_with_it() {
    let Some(dir) = prepared() else { return };
    let here = dir.path();
    let mut child = Command::new(vergence())
        .current_dir(here)
        .args(run_of(&["--no-pictures", "--real-time"]))
        .stderr(Stdio::null())
        .stdout(Stdio::null())
        .spawn()
        .expect("the tool runs");
    // In real time the first movements take some seconds.
    let began = Instant::now();
    while written(here).0 < 3 {
        assert!(began.elapsed() < PATIENCE, "no trial ends");
        std::thread::sleep(Duration::from_millis(50));
    }
    child.kill().expect("it is killed");
    child.wait().expect("it ends");
    let status = status_of(here);
    let before = status["participants"][0]["trials"].as_u64().expect("trials");
    assert!((3..20).contains(&before), "{status}");
    assert!(status["findings"].to_string().contains("ended without a word"), "{status}");
    let refused = tool(here, &run_of(&["--no-pictures"]));
    assert_eq!(refused.status.code(), Some(2));
    assert!(said(&refused).contains("--resume"), "{}", said(&refused));
    let ran = done(here, &run_of(&["--no-pictures", "--resume"]));
    assert_eq!((&ran["finished"], ran["trials"].as_u64()), (&true.into(), Some(20 - before)), "{ran}");
    let found = done(here, &["study", "analyze", "study.data", "--json"]);
    assert_eq!((&found["summary"]["trials"], &found["summary"]["sequences"]), (&20.into(), &4.into()));
}

#[test]
fn a_session_that_is_lost_costs_no_trial() {
    let Some(dir) = prepared() else { return };
    let here = dir.path();
    // Once: it is asked for anew, and goes on.
    let ran = done(here, &run_of(&["--no-pictures", "--fault", "xrEndFrame=ERROR_SESSION_LOST@300"]));
    assert_eq!((&ran["finished"], &ran["done"]), (&true.into(), &20.into()), "{ran}");
    let status = status_of(here);
    assert!(status["findings"].to_string().contains("lost"), "{status}");
    // For good: the run fails, and somebody goes on later.
    done(here, &["study", "delete", "study.data", "--participant", "P01"]);
    let lost = tool(here, &run_of(&["--no-pictures", "--fault", "xrEndFrame=ERROR_SESSION_LOST@300+"]));
    assert_eq!(lost.status.code(), Some(1), "{}", said(&lost));
    let status = status_of(here);
    let before = status["participants"][0]["trials"].as_u64().expect("trials");
    assert!((1..20).contains(&before) && status["findings"].to_string().contains("lost"), "{status}");
    let ran = done(here, &run_of(&["--no-pictures", "--resume"]));
    assert_eq!((&ran["finished"], ran["trials"].as_u64()), (&true.into(), Some(20 - before)), "{ran}");
}

/// While it is off nobody points; the movement that was under way is made again, and nothing that was finished is.
#[test]
fn a_headset_that_is_taken_off_costs_no_trial() {
    let Some(dir) = prepared() else { return };
    let here = dir.path();
    let ran = done(here, &run_of(&["--no-pictures", "--away", "7-11"]));
    assert_eq!((&ran["finished"], &ran["done"]), (&true.into(), &20.into()), "{ran}");
    assert!(ran["interrupted"].as_u64() == Some(1), "{ran}");
    let status = status_of(here);
    assert_eq!(status["participants"][0]["trials"].as_u64(), Some(20), "{status}");
    assert!(status["findings"].to_string().contains("made again"), "{status}");
    // Nobody's time goes on while the headset lies on the table.
    let (trials, again) = written(here);
    assert_eq!((trials, again), (20, 1));
    // Until the end of a session that somebody else ends: what was done is kept.
    done(here, &["study", "delete", "study.data", "--participant", "P01"]);
    let part = done(here, &run_of(&["--no-pictures", "--away", "7-11", "--most-trials", "12"]));
    let ran = done(here, &run_of(&["--no-pictures", "--resume"]));
    let trials = |ran: &Value| ran["trials"].as_u64().expect("trials");
    assert_eq!((trials(&part), trials(&ran), &ran["finished"]), (12, 8, &true.into()), "{ran}");
}

/// The study goes on without the recording of its session, and a script that asked for one learns that there is none.
#[test]
fn a_recording_that_is_not_whole_is_exit_status_1() {
    let Some(dir) = prepared() else { return };
    let here = dir.path();
    let output = tool(here, &run_of(&["--no-pictures", "--record", "/dev/full"]));
    assert_eq!(output.status.code(), Some(1), "{}", said(&output));
    assert!(said(&output).contains("/dev/full"), "{}", said(&output));
    let ran =
        last_object(&String::from_utf8_lossy(&output.stdout)).expect("the report is there all the same");
    assert_eq!((&ran["finished"], &ran["done"]), (&true.into(), &20.into()), "{ran}");
    assert!(ran["session"]["recording"]["error"].is_string(), "{ran}");
    // One that is whole is no failure.
    done(here, &["study", "delete", "study.data", "--participant", "P01"]);
    let ran = done(here, &run_of(&["--no-pictures", "--record", "session.mcap"]));
    assert!(ran["session"]["recording"]["messages"].as_u64() > Some(100), "{ran}");
}

#[test]
fn there_is_no_falling_back() {
    let dir = tempfile::tempdir().expect("a folder");
    let here = dir.path();
    small_study(here);
    let run = |more: &[&str]| {
        let mut all = vec!["study", "run", "study.toml", "--participant", "P01"];
        all.extend(more);
        tool(here, &all)
    };
    for (more, word) in [
        (vec![], "--headset"),
        (vec!["--headset", "simulated", "--input", "controller"], "simulated:SEED"),
        (vec!["--headset", "openxr", "--input", "simulated:1"], "controller, hand or gaze"),
        (vec!["--headset", "openxr", "--input", "gaze"], "kind = \"ray\""),
        (vec!["--headset", "desktop", "--input", "hand"], "mouse"),
        (vec!["--headset", "simulated", "--input", "simulated"], "simulated:SEED"),
    ] {
        let output = run(&more);
        assert_eq!(output.status.code(), Some(2), "{more:?}: {}", said(&output));
        assert!(said(&output).contains(word), "{more:?}: {}", said(&output));
        assert!(!here.join("study.data").exists(), "{more:?} made a folder");
    }
}

/// A screen without hardware.
struct Screen {
    server: Child,
    display: String,
}

impl Screen {
    fn start(size: &str) -> Option<Self> {
        let mut server = Command::new("Xvfb")
            .args(["-displayfd", "1", "-screen", "0", &format!("{size}x24"), "-nolisten", "tcp"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .ok()?;
        let mut line = String::new();
        BufReader::new(server.stdout.take()?).read_line(&mut line).ok()?;
        Some(Self { server, display: format!(":{}", line.trim()) })
    }

    fn does(&self, arguments: &[String]) -> Option<String> {
        let output = Command::new("xdotool").env("DISPLAY", &self.display).args(arguments).output().ok()?;
        output.status.success().then(|| String::from_utf8_lossy(&output.stdout).into_owned())
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

#[test]
fn where_no_window_can_be_no_log_is_begun() {
    let folder = tempfile::tempdir().expect("a folder");
    let here = folder.path();
    done(here, &["study", "new", "study.toml"]);
    let run_on = |display: &str| {
        Command::new(vergence())
            .current_dir(here)
            .env("DISPLAY", display)
            .env_remove("WAYLAND_DISPLAY")
            .env_remove("WAYLAND_SOCKET")
            .args([
                "study",
                "run",
                "study.toml",
                "--participant",
                "P01",
                "--headset",
                "desktop",
                "--dpi",
                "72",
            ])
            .output()
            .expect("the tool runs")
    };
    let output = run_on("");
    assert!(!output.status.success(), "{}", said(&output));
    assert!(!here.join("study.data").exists(), "{}", said(&output));
    let Some(small) = Screen::start("640x300") else {
        skip("xvfb", "it is not installed");
        return;
    };
    let output = run_on(&small.display);
    assert_eq!(output.status.code(), Some(2), "{}", said(&output));
    assert!(said(&output).contains("found 640×300"), "{}", said(&output));
    assert!(!here.join("study.data").exists(), "{}", said(&output));
}

/// A study in a window, and the mouse in its participant's hand.
struct Desk {
    screen: Screen,
    child: Child,
    /// Where the middle of the window is on the screen, pixels.
    middle: [f64; 2],
    clock: Instant,
}

/// The screen has 72 pixels per inch.
const PIXELS_PER_M: f64 = 72.0 / 0.0254;

impl Desk {
    /// Opens the study of `here` for its first participant; `None`, and the test says that it is skipped, where something is
    /// not installed.
    fn open(here: &Path) -> Option<Self> {
        let Some(screen) = Screen::start("1600x1400") else {
            skip("xvfb", "it is not installed");
            return None;
        };
        let words = [
            "study",
            "run",
            "study.toml",
            "--participant",
            "P01",
            "--headset",
            "desktop",
            "--dpi",
            "72",
            "--json",
        ];
        let child = Command::new(vergence())
            .current_dir(here)
            .env("DISPLAY", &screen.display)
            .args(words)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn();
        let mut desk =
            Self { screen, child: child.expect("the tool runs"), middle: [0.0; 2], clock: Instant::now() };
        let window = loop {
            let found = desk.does(&["search", "--onlyvisible", "--name", "Pointing in a headset"]);
            if let Some(id) = found.and_then(|found| found.lines().next().map(str::to_owned)) {
                break id;
            }
            if Command::new("xdotool").arg("version").output().is_err() {
                skip("xdotool", "it is not installed");
                return None;
            }
            desk.is_patient("no window");
            std::thread::sleep(Duration::from_millis(200));
        };
        let shape = desk.does(&["getwindowgeometry", "--shell", &window]).expect("the window has a shape");
        let number = |name: &str| -> f64 {
            let line = shape.lines().find_map(|line| line.strip_prefix(name)).expect("a number");
            line.trim_start_matches('=').parse().expect("a number")
        };
        desk.middle = [number("X") + 0.5 * number("WIDTH"), number("Y") + 0.5 * number("HEIGHT")];
        Some(desk)
    }

    fn does(&self, arguments: &[&str]) -> Option<String> {
        self.screen.does(&arguments.iter().map(|&word| word.to_owned()).collect::<Vec<_>>())
    }

    fn is_patient(&mut self, what: &str) {
        if let Ok(Some(status)) = self.child.try_wait() {
            panic!("{what}: the study has ended ({status})");
        }
        assert!(self.clock.elapsed() < PATIENCE, "{what}");
    }

    /// Moves to a place of the task, metres, and clicks there.
    fn click(&self, [x, y]: [f64; 2]) {
        let at = |middle: f64, off: f64| format!("{:.0}", (middle + off * PIXELS_PER_M).max(0.0));
        let (right, down) = (at(self.middle[0], x), at(self.middle[1], -y));
        self.does(&["mousemove", &right, &down, "sleep", "0.05", "click", "1"]).expect("the mouse is moved");
    }

    /// Does a plan: goes on when a trial is on the disk, and back where a busy machine took the movement for one that was
    /// interrupted. `aim` says where to click for trial number n.
    fn does_all(&mut self, here: &Path, plan: &Plan, aim: impl Fn(&PlannedTrial, usize) -> [f64; 2]) {
        let mut again = 0;
        for (number, trial) in plan.blocks.iter().flat_map(|block| &block.trials).enumerate() {
            let [x, y, _] = trial.from.centre;
            // Where there is no width, a little beyond is inside.
            let beyond = if trial.from.width.is_none() { 0.004 } else { 0.0 };
            let from = [x + beyond * x.signum(), y + beyond * y.signum()];
            if trial.index == 0 {
                self.click(from);
            }
            self.click(aim(trial, number));
            loop {
                let (trials, interrupted) = written(here);
                if trials > number {
                    break;
                }
                if interrupted > again {
                    again = interrupted;
                    self.click(from);
                    self.click(aim(trial, number));
                }
                assert!(self.clock.elapsed() < PATIENCE, "trial {number} does not end");
                std::thread::sleep(Duration::from_millis(20));
            }
        }
    }

    /// Waits for the end.
    fn end(mut self) -> Output {
        while self.child.try_wait().expect("a child").is_none() {
            if self.clock.elapsed() > PATIENCE {
                let _ = self.child.kill();
            }
            std::thread::sleep(Duration::from_millis(50));
        }
        let (mut stdout, mut stderr) = (Vec::new(), Vec::new());
        let status = self.child.wait().expect("it has ended");
        self.child.stdout.take().expect("a pipe").read_to_end(&mut stdout).expect("it can be read");
        self.child.stderr.take().expect("a pipe").read_to_end(&mut stderr).expect("it can be read");
        Output { status, stdout, stderr }
    }
}

impl Drop for Desk {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn the_same_study_in_a_window() {
    let dir = tempfile::tempdir().expect("a folder");
    let here = dir.path();
    if !has_vulkan(here) {
        return skip("vulkan", "no device draws");
    }
    let file = small_study(here);
    let study = Study::parse(&file, &std::fs::read_to_string(&file).expect("it is there")).expect("a study");
    let plan = study.plan("P01");
    let Some(mut desk) = Desk::open(here) else { return };
    desk.does_all(here, &plan, |trial, number| {
        // Beside the middle, and every seventh time beside the target.
        let width = trial.to.width.unwrap_or(0.0);
        let off = if number % 7 == 6 { 0.8 * width } else { 0.1 * width * (number % 4) as f64 };
        [trial.to.centre[0] + off, trial.to.centre[1]]
    });
    let output = desk.end();
    let status = status_of(here);
    assert!(output.status.success(), "{}\n{status}", said(&output));
    assert!(status["participants"][0]["finished"] == true, "{status}");
    let found = done(here, &["study", "analyze", "study.data", "--json", "--csv", "tables"]);
    let summary = &found["summary"];
    assert_eq!((&summary["trials"], &summary["dimensions"]), (&20.into(), &2.into()), "{summary}");
    assert_eq!(summary["length_unit"], "m");
    // Two of twenty were beside the target; a pixel is 0.35 mm.
    assert!((summary["error_rate"].as_f64().expect("a rate") - 0.1).abs() < 1e-9, "{summary}");
    let trials = std::fs::read_to_string(here.join("tables/trials.csv")).expect("a table");
    let header: Vec<&str> = trials.lines().next().expect("a header").split(',').collect();
    let column = |name: &str| header.iter().position(|own| *own == name).expect("a column");
    for (line, planned) in trials.lines().skip(1).zip(plan.blocks.iter().flat_map(|block| &block.trials)) {
        let cell = |name: &str| -> f64 {
            line.split(',').nth(column(name)).expect("a cell").parse().expect("a number")
        };
        assert!((cell("to_x") - planned.to.centre[0]).abs() < 1e-12);
        assert!((cell("end_y") - planned.to.centre[1]).abs() < 0.001, "{line}");
        assert!(cell("mt_s") >= 0.0, "{line}");
    }
    done(here, &["study", "report", "study.data", "-o", "report.html"]);
}

/// Corners of the screen: the cursor goes as far as the window, wherever the mouse goes; effective measures only.
#[test]
fn nobody_goes_beyond_a_corner() {
    let dir = tempfile::tempdir().expect("a folder");
    let here = dir.path();
    if !has_vulkan(here) {
        return skip("vulkan", "no device draws");
    }
    let text = TEMPLATE.replace("kind = \"ring\"", "kind = \"corner\"");
    let text = text.replace("[\"0.15 m\", \"0.25 m\", \"0.35 m\"]", "[\"0.15 m\"]");
    let text = text.replace("widths = [\"0.01 m\", \"0.02 m\", \"0.03 m\", \"0.04 m\"]", "");
    let (first, rest) = text.split_once("[[instructions]]").expect("the template has instructions");
    let after = rest.split_once("[prediction]").expect("and a prediction").1;
    let text = format!("{first}[prediction]{after}").replace("per_condition = 15", "per_condition = 6");
    std::fs::write(here.join("study.toml"), &text).expect("a folder to write to");
    let study = Study::parse("study.toml".as_ref(), &text).expect("a study");
    let Some(mut desk) = Desk::open(here) else { return };
    // From the first picture on, the mouse cannot leave the window.
    let x_of_the_mouse = |desk: &Desk| -> f64 {
        let said =
            desk.does(&["mousemove", "1020", "890", "sleep", "0.05", "getmouselocation"]).expect("a place");
        let x = said.split_whitespace().find_map(|word| word.strip_prefix("x:")).expect("a place");
        x.parse().expect("a number")
    };
    while x_of_the_mouse(&desk) > 1000.0 {
        desk.is_patient("the mouse leaves the window");
        std::thread::sleep(Duration::from_millis(100));
    }
    // Far beyond the corner: 15 cm, where the window ends after one.
    desk.does_all(here, &study.plan("P01"), |trial, _| {
        let [x, y, _] = trial.to.centre;
        [x + 0.15 * x.signum(), y + 0.15 * y.signum()]
    });
    let output = desk.end();
    assert!(output.status.success(), "{}", said(&output));
    let found = done(here, &["study", "analyze", "study.data", "--json", "--csv", "tables"]);
    let row = &found["conditions"][0];
    assert_eq!(
        (&row["error_rate"], &row["width"], &row["id"]),
        (&0.0.into(), &Value::Null, &Value::Null),
        "{row}"
    );
    let (beyond, spread) = (row["bias"].as_f64().expect("a bias"), row["sd_x"].as_f64().expect("a spread"));
    println!("corners: ends are {beyond:.4} m beyond them along the diagonal, with a spread of {spread}");
    // A window has 1 cm to each side of the targets, and 5 cm above and below them, where words are.
    assert!((beyond - 0.06 * std::f64::consts::FRAC_1_SQRT_2).abs() < 0.001 && spread < 1e-9, "{row}");
}
