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
    let mut q = UnitQuaternion::identity();
    (0..5000)
        .map(|i| {
            let t = i as f64 * PERIOD_NS as f64 * 1e-9;
            let rate = Vector3::new((2.0 * t).sin(), 0.5, (0.7 * t).cos()) * if t < 4.0 { 0.0 } else { 0.5 };
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
    let mut text =
        "t_s,gyr_x,gyr_y,gyr_z,acc_x,acc_y,acc_z,mag_x,mag_y,mag_z,gt_qw,gt_qx,gt_qy,gt_qz,movement\n"
            .to_owned();
    for (at, imu, q) in samples() {
        let mag = imu.mag_ut.expect("made with one");
        let _ = write!(text, "{}", at as f64 * 1e-9);
        for value in imu.gyr_rad_s.iter().chain(&imu.acc_m_s2).chain(&mag).chain(&[q.w, q.i, q.j, q.k]) {
            let _ = write!(text, ",{value:?}");
        }
        let _ = writeln!(text, ",{}", u8::from(at > 4_000_000_000));
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
