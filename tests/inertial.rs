//! `vergence imu run` and `imu eval` as their users call them: text and session logs in, orientations and scores out, and what is
//! wrong said with its place.

use std::fmt::Write;
use std::path::Path;
use std::process::{Command, Output};

use nalgebra::{UnitQuaternion, Vector3};
use vergence_log::{Header, Options, Recorder, StreamDesc, Times};
use vergence_sense::Imu;
use vergence_time::Timestamp;

const PERIOD_NS: i64 = 4_000_000;

/// A unit that rests for 4 s and then turns, with its true orientation.
fn samples() -> Vec<(i64, Imu, UnitQuaternion<f64>)> {
    turned(0.5)
}

fn turned(speed: f64) -> Vec<(i64, Imu, UnitQuaternion<f64>)> {
    let mut q = UnitQuaternion::identity();
    (0..5000)
        .map(|i| {
            let t = i as f64 * PERIOD_NS as f64 * 1e-9;
            let rate =
                Vector3::new((2.0 * t).sin(), 0.5, (0.7 * t).cos()) * if t < 4.0 { 0.0 } else { speed };
            q *= UnitQuaternion::new(rate * (PERIOD_NS as f64 * 1e-9));
            let imu = Imu {
                gyr_rad_s: rate,
                acc_m_s2: q.inverse() * Vector3::new(0.0, 0.0, 9.81),
                mag_ut: Some(q.inverse() * Vector3::new(0.0, 16.0, -42.0)),
            };
            (i * PERIOD_NS, imu, q)
        })
        .collect()
}

fn text() -> String {
    table(&samples())
}

fn table(samples: &[(i64, Imu, UnitQuaternion<f64>)]) -> String {
    let mut text =
        "t_s,gyr_x,gyr_y,gyr_z,acc_x,acc_y,acc_z,mag_x,mag_y,mag_z,gt_qw,gt_qx,gt_qy,gt_qz,movement\n"
            .to_owned();
    for (at, imu, q) in samples {
        let mag = imu.mag_ut.expect("made with one");
        let _ = write!(text, "{}", *at as f64 * 1e-9);
        for value in imu.gyr_rad_s.iter().chain(&imu.acc_m_s2).chain(&mag).chain(&[q.w, q.i, q.j, q.k]) {
            let _ = write!(text, ",{value:?}");
        }
        let _ = writeln!(text, ",{}", u8::from(*at > 4_000_000_000));
    }
    text
}

fn log(path: &Path, units: &[&str]) {
    // Written faster than any device would: all of it must fit into the queue.
    let options = Options { queue_bytes: 16 << 20, ..Options::default() };
    let mut recorder = Recorder::create(path, &Header::default(), &options).expect("a log");
    for unit in units {
        let stream = recorder.stream::<Imu>(&StreamDesc::new(*unit)).expect("a stream");
        for (at, imu, _) in samples() {
            recorder.write(&stream, Times::at(Timestamp::from_nanos(at)), &imu);
        }
    }
    assert_eq!(recorder.finish().expect("a whole log").dropped, 0);
}

fn imu(arguments: &[&str], folder: &Path) -> Output {
    Command::new(vergence_tests::vergence())
        .arg("imu")
        .args(arguments)
        .current_dir(folder)
        .output()
        .expect("the binary runs")
}

fn object(output: &Output) -> serde_json::Value {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    vergence_tests::last_object(&String::from_utf8_lossy(&output.stdout)).expect("one object")
}

#[test]
fn text_and_logs_give_the_same_orientations_and_a_score() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    std::fs::write(folder.join("in.csv"), text()).expect("a file");
    log(&folder.join("in.mcap"), &["/imu"]);
    std::fs::write(folder.join("p.toml"), "latency_s = 0.002\n").expect("a file");
    for (input, out) in [("in.csv", "text.csv"), ("in.mcap", "log.csv")] {
        let told = object(&imu(
            &["run", input, "--unit", "unknown", "--config", "p.toml", "--json", "-o", out],
            folder,
        ));
        assert_eq!(told["samples"], 5000);
        assert!(told["rejected"].as_object().is_some_and(serde_json::Map::is_empty), "{told}");
        assert!(told["ns_per_sample"].as_f64().is_some_and(|ns| ns > 0.0));
    }
    let read = |name: &str| std::fs::read_to_string(folder.join(name)).expect("what was written");
    let (text, log) = (read("text.csv"), read("log.csv"));
    assert_eq!(text, log, "a replayed stream gives what the recording gave");
    assert_eq!(text.lines().next(), Some("t_s,qw,qx,qy,qz"));
    assert_eq!(text.lines().count(), 5001);
    let score = object(&imu(&["eval", "text.csv", "in.csv", "--json"], folder));
    for name in [
        "total_deg",
        "heading_deg",
        "inclination_deg",
        "start_heading_deg",
        "start_total_deg",
        "mean_total_deg",
    ] {
        let degrees = score[name].as_f64().expect("a number");
        assert!((0.0..1.0).contains(&degrees), "{name}: {degrees}");
    }
    assert_eq!(score["samples"], 3999);
    // Every verb reads what `run` reads.
    for arguments in [vec!["predict"], vec!["noise"], vec!["calibrate", "-o", "found.toml"]] {
        let [by_text, by_log] = ["in.csv", "in.mcap"].map(|input| {
            let output = imu(&[&arguments[..], &[input, "--json"]].concat(), folder);
            (output.status.code(), String::from_utf8_lossy(&output.stderr).replace(input, "in"))
        });
        assert_eq!(by_text, by_log, "{arguments:?}");
    }
    let offline = object(&imu(&["run", "in.csv", "--offline", "--json", "-o", "off.csv"], folder));
    assert_eq!(offline["samples"], 5000);
    assert_ne!(read("off.csv"), text);
}

#[test]
fn what_is_wrong_is_said_with_its_place_and_status() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let text = text();
    std::fs::write(folder.join("in.csv"), &text).expect("a file");
    std::fs::write(folder.join("bad.csv"), text.replacen("\n0.012,", "\n0.012,x", 1)).expect("a file");
    std::fs::write(folder.join("p.toml"), "tau = 1.0\n").expect("a file");
    log(&folder.join("two.mcap"), &["/left", "/right"]);
    for (arguments, status, sentence) in [
        (vec!["run", "bad.csv", "-o", "o.csv"], 1, "bad.csv:5:2: expected a number"),
        (vec!["run", "none.csv", "-o", "o.csv"], 1, "none.csv: "),
        (vec!["run", "in.csv", "--config", "p.toml", "-o", "o.csv"], 2, "p.toml:1:1: "),
        (vec!["run", "in.csv", "--filter", "vqf", "--offline", "-o", "o.csv"], 2, "--offline"),
        (vec!["run", "two.mcap", "-o", "o.csv"], 2, "choose with --stream"),
        (vec!["run", "two.mcap", "--stream", "/middle", "-o", "o.csv"], 1, "/left, /right"),
        (vec!["eval", "in.csv", "in.csv"], 1, "in.csv:1:1: expected the header"),
    ] {
        let output = imu(&arguments, folder);
        let error = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(status), "{arguments:?}: {error}");
        assert!(error.contains(sentence), "{arguments:?}: {error}");
    }
    object(&imu(&["run", "two.mcap", "--stream", "/right", "--axes", "6", "--json", "-o", "o.csv"], folder));
}

#[test]
fn a_calibration_is_taken_out_of_each_reading() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    std::fs::write(folder.join("in.csv"), text()).expect("a file");
    let triad = |name: &str, offset: &str, scale: f64, length: f64| {
        format!(
            "[{name}]\noffset = {offset}\noffset_sd = [0.0, 0.0, 0.0]\n\
             matrix = [[{scale}, 0.0, 0.0], [0.0, {scale}, 0.0], [0.0, 0.0, {scale}]]\n\
             matrix_sd = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]\nlength = {length}\nresidual = 0.0\n"
        )
    };
    let whole = |bias: &str, mag_scale: f64| {
        format!(
            "gyr_bias_rad_s = {bias}\ngyr_bias_sd_rad_s = [0.0, 0.0, 0.0]\nrests = 1\nnot_observed = []\n{}{}",
            triad("accelerometer", "[0.3, -0.2, 0.1]", 1.02, 9.81),
            triad("magnetometer", "[5.0, -8.0, 3.0]", mag_scale, 45.0)
        )
    };
    std::fs::write(folder.join("c.toml"), whole("[0.1, -0.2, 0.15]", 0.97)).expect("a file");
    std::fs::write(folder.join("flat.toml"), whole("[0.1, -0.2, 0.15]", 0.0)).expect("a file");
    std::fs::write(folder.join("nan.toml"), whole("[nan, 0.0, 0.0]", 1.0)).expect("a file");
    // The unit of `text`, with these errors.
    let mut wrong = String::new();
    for (row, line) in text().lines().enumerate() {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        if row > 0 {
            let errors = [(1.0, [0.1, -0.2, 0.15]), (1.02, [0.3, -0.2, 0.1]), (0.97, [5.0, -8.0, 3.0])];
            for (sensor, (scale, offset)) in errors.iter().enumerate() {
                for axis in 0..3 {
                    let cell = &mut cells[1 + 3 * sensor + axis];
                    *cell = format!("{:?}", cell.parse::<f64>().expect("a number") * scale + offset[axis]);
                }
            }
        }
        wrong += &cells.join(",");
        wrong.push('\n');
    }
    std::fs::write(folder.join("wrong.csv"), wrong).expect("a file");
    let total = |arguments: &[&str]| {
        object(&imu(&[arguments, &["-o", "o.csv", "--filter", "madgwick", "--json"]].concat(), folder));
        object(&imu(&["eval", "o.csv", "in.csv", "--json"], folder))["total_deg"].as_f64().expect("a number")
    };
    let (right, wrong) = (total(&["run", "in.csv"]), total(&["run", "wrong.csv"]));
    let calibrated = total(&["run", "wrong.csv", "--calibration", "c.toml"]);
    assert!((calibrated - right).abs() < 1e-6 && wrong > right + 5.0, "{right} {wrong} {calibrated}");
    for (file, sentence) in [
        ("flat.toml", "flat.toml: expected a finite magnetometer.offset and a magnetometer.matrix"),
        ("nan.toml", "nan.toml: expected a finite gyr_bias_rad_s"),
        ("in.csv", "in.csv:1:"),
        ("none.toml", "none.toml: "),
    ] {
        let output = imu(&["run", "wrong.csv", "--calibration", file, "-o", "o.csv"], folder);
        let error = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{file}: {error}");
        assert!(error.contains(sentence), "{file}: {error}");
    }
}

#[test]
fn axes_that_are_wrong_are_warned_of_and_set_right() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let right = table(&turned(1.0));
    let swapped: String = right
        .lines()
        .enumerate()
        .map(|(row, line)| {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            if row > 0 {
                // As an MPU-9250 has them.
                cells.swap(7, 8);
                cells[9] = format!("{:?}", -cells[9].parse::<f64>().expect("a number"));
            }
            cells.join(",") + "\n"
        })
        .collect();
    std::fs::write(folder.join("in.csv"), right).expect("a file");
    std::fs::write(folder.join("swapped.csv"), swapped).expect("a file");
    let run = |arguments: &[&str]| {
        let told = object(&imu(&[&["run", "--json", "-o", "o.csv"], arguments].concat(), folder));
        let score = object(&imu(&["eval", "o.csv", "in.csv", "--json"], folder));
        let warnings = told["warnings"].as_array().expect("a list").clone();
        (
            warnings,
            score["total_deg"].as_f64().expect("a number"),
            told["dip_deg"].as_f64().expect("a number"),
        )
    };
    let right = run(&["in.csv"]);
    assert!(right.0.is_empty() && right.1 < 1.0 && (right.2 - 69.1).abs() < 0.2, "{right:?}");
    let wrong = run(&["swapped.csv"]);
    let sentence = "the magnetometer turns as (y, x, -z) of the gyroscope: --turn mag=y,x,-z";
    assert!(wrong.1 > 30.0 && wrong.0.len() == 1, "{wrong:?}");
    assert!(wrong.0[0].as_str().is_some_and(|warning| warning.contains(sentence)), "{wrong:?}");
    assert_eq!(run(&["swapped.csv", "--turn", "mag=y,x,-z"]), right);
    // A calibration that is written by hand needs no more than that, and one that was made of turned readings turns them.
    std::fs::write(folder.join("hand.toml"), "[axes]\nmag = \"y x -z\"\n").expect("a file");
    assert_eq!(run(&["swapped.csv", "--calibration", "hand.toml"]), right);
    let made =
        imu(&["calibrate", "swapped.csv", "--turn", "mag=y,x,-z", "-o", "made.toml", "--json"], folder);
    assert_eq!(object(&made)["warnings"], serde_json::json!([]));
    let made = std::fs::read_to_string(folder.join("made.toml")).expect("written");
    assert!(made.contains("[axes]") && made.contains("mag = \"y,x,-z\""), "{made}");
    for (arguments, sentence) in [
        (vec!["--turn", "mag=y,x"], "each of x, y and z once"),
        (vec!["--turn", "nose=x,y,z"], "expected gyr, acc or mag before '=', found 'nose'"),
        (vec!["--turn", "mag=y,x,z", "--turn", "mag=x,y,z"], "expected mag once"),
        (vec!["--turn", "mag=y,x,z", "--calibration", "hand.toml"], "without [axes]"),
    ] {
        let output = imu(&[vec!["run", "in.csv", "-o", "o.csv"], arguments].concat(), folder);
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && error.contains(sentence), "{error}");
    }
}

#[test]
fn a_calibration_counts_in_every_verb_that_filters() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let biased: String = text()
        .lines()
        .enumerate()
        .map(|(row, line)| {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            if row > 0 {
                cells[1] = format!("{:?}", cells[1].parse::<f64>().expect("a number") + 0.25);
            }
            cells.join(",") + "\n"
        })
        .collect();
    std::fs::create_dir(folder.join("data")).expect("a folder");
    std::fs::write(folder.join("in.csv"), text()).expect("a file");
    std::fs::write(folder.join("data/biased.csv"), biased).expect("a file");
    std::fs::write(folder.join("c.toml"), "gyr_bias_rad_s = [0.25, 0, 0]\n").expect("a file");
    let near = |a: &serde_json::Value, b: &serde_json::Value, most: f64| {
        let (a, b) = (a.as_f64().expect("a number"), b.as_f64().expect("a number"));
        (a - b).abs() <= most
    };
    let with = ["data/biased.csv", "--calibration", "c.toml", "--json"];
    let plain = object(&imu(&["compare", "in.csv", "--json"], folder));
    let found = object(&imu(&[&["compare"], &with[..]].concat(), folder));
    let without = object(&imu(&["compare", "data/biased.csv", "--json"], folder));
    let of = |value: &serde_json::Value| value["integration"]["inclination_deg"].clone();
    assert!(near(&of(&found), &of(&plain), 1e-6) && !near(&of(&without), &of(&plain), 5.0), "{found}");
    let plain = object(&imu(&["predict", "in.csv", "--json"], folder));
    let found = object(&imu(&[&["predict"], &with[..]].concat(), folder));
    let of = |value: &serde_json::Value| {
        value["methods"]["constant"]["horizons"][0]["by_truth"]["mean_deg"].clone()
    };
    assert!(near(&of(&found), &of(&plain), 1e-6), "{found} {plain}");
    assert_eq!(found["filter"], "vergence");
    // The trade, and the file of what it chose.
    let trade = |arguments: &[&str]| {
        let output = Command::new(vergence_tests::vergence())
            .args(["trade", "imu", "--data", "data", "-o", "trade", "--quick", "--json", "--error", "90deg"])
            .args(arguments)
            .current_dir(folder)
            .output()
            .expect("the binary runs");
        object(&output)
    };
    let (without, found) = (trade(&[]), trade(&["--calibration", "c.toml"]));
    let total =
        |value: &serde_json::Value| value["all"]["9d"]["trade"]["measurements"][0]["errors"][0].clone();
    assert!(
        !near(&total(&without), &total(&found), 5.0) && total(&found).as_f64() < Some(1.0),
        "{without} {found}"
    );
    let chosen = std::fs::read_to_string(folder.join("trade/imu.toml")).expect("written");
    let named = chosen.split("--filter ").nth(1).and_then(|rest| rest.split(' ').next()).expect("a filter");
    assert_eq!(found["chosen"]["setting"]["filter"], named, "{chosen} {found}");
}

#[test]
fn knobs_are_shown_and_kept_in_range() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    std::fs::write(folder.join("in.csv"), text()).expect("a file");
    for filter in ["vergence", "vqf", "vqf-basic", "madgwick", "mahony", "complementary"] {
        let shown = imu(&["run", "--filter", filter, "--print-config", "--unit", "broad"], folder);
        let shown = String::from_utf8_lossy(&shown.stdout).into_owned();
        assert!(shown.starts_with(&format!("# Knobs of {filter}")), "{shown}");
        std::fs::write(folder.join("c.toml"), &shown).expect("a file");
        let read = |name: &str| std::fs::read_to_string(folder.join(name)).expect("written");
        object(&imu(&["run", "in.csv", "--filter", filter, "--json", "-o", "a.csv"], folder));
        let with = ["run", "in.csv", "--filter", filter, "--config", "c.toml", "--json", "-o", "b.csv"];
        object(&imu(&with, folder));
        assert_eq!(read("a.csv"), read("b.csv"), "{filter}: what is shown are the defaults");
    }
    for (knob, sentence) in [
        ("latency_s = -5.0", "expected latency_s from -0.02 to 0.1 s, found -5"),
        ("tau_acc_s = 1e9", "expected tau_acc_s from 0.1 to 60 s, found 1000000000"),
    ] {
        std::fs::write(folder.join("c.toml"), knob).expect("a file");
        let output = imu(&["run", "in.csv", "--config", "c.toml", "-o", "o.csv"], folder);
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && error.contains(sentence), "{error}");
    }
}

#[test]
fn any_orientations_are_scored_against_any_truth() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    std::fs::write(folder.join("in.csv"), text()).expect("a file");
    object(&imu(&["run", "in.csv", "--unit", "unknown", "--json", "-o", "o.csv"], folder));
    let read = |name: &str| std::fs::read_to_string(folder.join(name)).expect("written");
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).expect("a file");
    let out = read("o.csv");
    // Half the rows, half a millisecond later.
    let mut half = "t_s,qw,qx,qy,qz\n".to_owned();
    // The truth in the other forms; also without the rest before the movement.
    let (mut tum, mut euroc, mut table) =
        (String::new(), "#timestamp,p,p,p,q_RS_w [],q,q,q\n".to_owned(), half.clone());
    for (row, line) in out.lines().skip(1).enumerate().filter(|(row, _)| row % 2 == 0) {
        let (time, rest) = line.split_once(',').expect("a time");
        let later = if row % 4 == 0 { time.to_owned() } else { time[..time.len() - 6].to_owned() + "000001" };
        let _ = writeln!(half, "{later},{rest}");
    }
    for (at, _, q) in samples().iter().filter(|(at, ..)| *at > 4_000_000_000) {
        let t = *at as f64 * 1e-9;
        let _ = writeln!(tum, "{t:.9} 0 0 0 {} {} {} {}", q.i, q.j, q.k, q.w);
        let _ = writeln!(euroc, "{at},0,0,0,{},{},{},{}", q.w, q.i, q.j, q.k);
        let _ = writeln!(table, "{t:.9},{},{},{},{}", q.w, q.i, q.j, q.k);
    }
    write("half.csv", &half);
    write("truth.txt", &format!("# timestamp(s) tx ty tz qx qy qz qw\n{tum}"));
    write("table.csv", &table);
    std::fs::create_dir_all(folder.join("set/mav0/state_groundtruth_estimate0")).expect("a folder");
    write("set/mav0/state_groundtruth_estimate0/data.csv", &euroc);
    let eval = |estimate: &str, truth: &str| object(&imu(&["eval", estimate, truth, "--json"], folder));
    let names = ["inclination_deg", "start_total_deg", "mean_total_deg"];
    let rows = eval("o.csv", "in.csv");
    for (estimate, truth, north) in [
        ("half.csv", "in.csv", true),
        ("o.csv", "table.csv", true),
        ("o.csv", "truth.txt", false),
        ("half.csv", "set", false),
        ("o.csv", "set/mav0", false),
    ] {
        let found = eval(estimate, truth);
        for name in names {
            let (a, b) = (found[name].as_f64().expect("a number"), rows[name].as_f64().expect("a number"));
            assert!((a - b).abs() < 1e-3, "{estimate} {truth} {name}: {a} {b}");
        }
        assert_eq!(found["total_deg"].is_number(), north, "{found}");
        let samples = found["samples"].as_u64().expect("a number");
        assert!((3997..=3999).contains(&samples), "{found}");
    }
    // Every verb with a truth takes the same ones.
    let by_folder = object(&imu(&["compare", "in.csv", "--truth", "set", "--json"], folder));
    let by_rows = object(&imu(&["compare", "in.csv", "--json"], folder));
    let of = |value: &serde_json::Value| value["vergence"]["inclination_deg"].as_f64().expect("a number");
    assert!((of(&by_folder) - of(&by_rows)).abs() < 1e-3, "{by_folder} {by_rows}");
    // What cannot be scored is said.
    write("nan.csv", &out.replacen("\n0.004", "\n0.004000000,nan,nan,nan,nan\n0.0041", 1));
    write("late.csv", "t_s,qw,qx,qy,qz\n1000,1,0,0,0\n1000.004,1,0,0,0\n");
    for (estimate, truth, sentence) in [
        (
            "nan.csv",
            "in.csv",
            "nan.csv:3:2: expected a quaternion of four finite numbers, not all zero, found NaN,NaN,NaN,NaN",
        ),
        (
            "late.csv",
            "in.csv",
            "late.csv: expected orientations at times of in.csv (0.000 to 19.996 s), found 1000.000 to 1000.004 s",
        ),
        ("o.csv", "nowhere.txt", "nowhere.txt: No such file"),
        ("o.csv", ".", ".: expected a truth, found none"),
    ] {
        let output = imu(&["eval", estimate, truth], folder);
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(1) && error.contains(sentence), "{error}");
    }
}

#[test]
fn pipes_folders_and_compressed_outputs() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    std::fs::write(folder.join("in.csv"), text()).expect("a file");
    object(&imu(&["run", "in.csv", "--unit", "unknown", "--axes", "6", "--json", "-o", "o.csv"], folder));
    let read = |name: &str| std::fs::read_to_string(folder.join(name)).expect("written");
    let piped = Command::new(vergence_tests::vergence())
        .args(["imu", "run", "-", "--unit", "unknown", "--axes", "6", "-o", "-"])
        .stdin(std::fs::File::open(folder.join("in.csv")).expect("a file"))
        .output()
        .expect("the binary runs");
    assert_eq!(String::from_utf8_lossy(&piped.stdout), read("o.csv"));
    assert!(String::from_utf8_lossy(&piped.stderr).contains("5000 samples"));
    object(&imu(&["run", "in.csv", "--unit", "unknown", "--axes", "6", "--json", "-o", "o.csv.gz"], folder));
    let packed = std::fs::read(folder.join("o.csv.gz")).expect("written");
    assert!(packed.starts_with(&[0x1f, 0x8b]));
    let [plain, gz] =
        ["o.csv", "o.csv.gz"].map(|name| object(&imu(&["eval", name, "in.csv", "--json"], folder)));
    assert_eq!(plain, gz);
    // EuRoC's folders, from outside to inside.
    let mut euroc = "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n".to_owned();
    for (at, imu, _) in samples() {
        let (g, a) = (imu.gyr_rad_s, imu.acc_m_s2);
        let _ = writeln!(euroc, "{at},{:?},{:?},{:?},{:?},{:?},{:?}", g.x, g.y, g.z, a.x, a.y, a.z);
    }
    std::fs::create_dir_all(folder.join("set/mav0/imu0")).expect("a folder");
    std::fs::write(folder.join("set/mav0/imu0/data.csv"), euroc).expect("a file");
    for input in ["set", "set/mav0", "set/mav0/imu0"] {
        object(&imu(&["run", input, "--json", "-o", "e.csv"], folder));
        assert_eq!(read("e.csv"), read("o.csv"), "{input}");
    }
    std::fs::create_dir(folder.join("empty")).expect("a folder");
    for (arguments, status, sentence) in [
        (
            vec!["run", "empty", "-o", "o.csv"],
            1,
            "empty: expected a folder with data.csv, or imu0/data.csv, or mav0/imu0/data.csv",
        ),
        (vec!["run", "in.csv", "-o", "none/o.csv"], 1, "none/o.csv: cannot be written: "),
        (vec!["run", "in.csv", "--json", "-o", "-"], 2, "--json: expected a file for --out"),
        (vec!["run", "set", "-o", "set/mav0/imu0/data.csv"], 2, "expected a file of its own"),
        (vec!["noise", "in.csv", "-o", "in.csv"], 2, "in.csv: expected a folder, found a file"),
        (
            vec!["predict", "in.csv", "--horizon", "10ms,21"],
            2,
            "expected a time with its unit, found 21: 21ms?",
        ),
    ] {
        let output = imu(&arguments, folder);
        let error = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(status), "{arguments:?}: {error}");
        assert!(error.contains(sentence), "{arguments:?}: {error}");
    }
}

#[test]
fn an_imported_recording_is_of_the_same_unit_and_has_its_truth() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    std::fs::write(folder.join("in.csv"), text()).expect("a file");
    for (log, world) in [("in.mcap", "as-recorded"), ("up.mcap", "y-up")] {
        let imported = Command::new(vergence_tests::vergence())
            .args(["log", "import", "broad", "in.csv", "-o", log, "--world", world])
            .current_dir(folder)
            .output()
            .expect("the binary runs");
        assert!(imported.status.success(), "{}", String::from_utf8_lossy(&imported.stderr));
    }
    let by_text = object(&imu(&["run", "in.csv", "--json", "-o", "text.csv"], folder));
    let by_log = object(&imu(&["run", "in.mcap", "--json", "-o", "log.csv"], folder));
    assert_eq!((&by_text["unit"], &by_log["unit"]), (&"broad".into(), &"broad".into()));
    let read = |name: &str| std::fs::read_to_string(folder.join(name)).expect("written");
    assert_eq!(read("text.csv"), read("log.csv"));
    let score = |truth: &str| object(&imu(&["eval", "text.csv", truth, "--json"], folder));
    assert_eq!(score("in.csv"), score("in.mcap"));
    let total = |value: &serde_json::Value| value["total_deg"].as_f64().expect("a number");
    assert!((total(&score("in.csv")) - total(&score("up.mcap"))).abs() < 1e-9);
    for verb in [vec!["compare", "--axes", "9"], vec!["predict", "--method", "constant"]] {
        let [by_text, by_log] = ["in.csv", "in.mcap"].map(|input| {
            let mut found = object(&imu(&[&verb[..], &[input, "--json"]].concat(), folder));
            // Time is another one each time.
            if verb[0] == "predict" {
                found = found["methods"]["constant"]["horizons"].take();
            }
            found
        });
        assert_eq!(by_text, by_log);
    }
}

#[test]
fn readings_in_another_unit_are_warned_of_and_slow_sensors_are_not() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let warned = |name: &str, change: &dyn Fn(usize, &mut Vec<String>)| -> String {
        let rows = text();
        let changed = rows.lines().enumerate().map(|(row, line)| {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            if row > 0 {
                change(row, &mut cells);
            }
            cells.join(",") + "\n"
        });
        std::fs::write(folder.join(name), changed.collect::<String>()).expect("a file");
        let told = object(&imu(&["run", name, "--json", "-o", "o.csv"], folder));
        told["warnings"].to_string()
    };
    let scaled = |cells: &mut Vec<String>, from: usize, by: f64| {
        for cell in &mut cells[from..from + 3] {
            *cell = format!("{:?}", cell.parse::<f64>().expect("a number") * by);
        }
    };
    // Raw counts of 16 bits, of which one in fifty happens to look well.
    let counts = warned("counts.csv", &|row, cells| {
        if row % 50 != 0 {
            scaled(cells, 4, 16384.0);
        }
    });
    assert!(
        counts.contains("found acc_wrong in 4900 of 5000 readings, their median length is 160727"),
        "{counts}"
    );
    let zeros = warned("zeros.csv", &|_, cells| scaled(cells, 4, 0.0));
    assert!(zeros.contains("found acc_zero in 5000 of 5000 readings"), "{zeros}");
    let slow = warned("slow.csv", &|row, cells| {
        if row % 4 != 0 {
            cells[4..10].iter_mut().for_each(String::clear);
        }
    });
    assert_eq!(slow, "[]");
}
