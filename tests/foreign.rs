//! `vergence log import` and `export` as their users call them: what was in the files is in the log, and in the files again.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;
use vergence_tests::{data, last_object, skip, vergence};

fn log(arguments: &[&str]) -> Output {
    Command::new(vergence()).arg("log").args(arguments).output().expect("the binary runs")
}

fn told(output: &Output) -> String {
    let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    format!("{}\n{out}\n{err}", output.status)
}

fn done(arguments: &[&str]) -> Value {
    let output = log(arguments);
    assert!(output.status.success(), "{}", told(&output));
    last_object(&String::from_utf8_lossy(&output.stdout)).expect("one object")
}

fn text(path: &Path) -> &str {
    path.to_str().expect("a path in UTF-8")
}

/// Times as nanoseconds and numbers of a table, without comments and header.
fn numbers(path: &Path, separator: char) -> Vec<Vec<f64>> {
    let content = std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let is_row = |line: &&str| line.starts_with(|c: char| c.is_ascii_digit() || c == '-');
    let row = |line: &str| line.split(separator).map(|word| word.trim().parse().expect("a number")).collect();
    content.lines().filter(is_row).map(row).collect()
}

#[test]
fn a_tum_file_comes_back_as_it_was() {
    let Some(file) = data().map(|data| data.join("trajectories/V1_01_easy.tum.txt")) else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let (mcap, out) = (folder.path().join("a.mcap"), folder.path().join("out"));
    let said = done(&["import", "tum", text(&file), "-o", text(&mcap), "--json"]);
    assert_eq!((said["samples"].as_u64(), said["dropped"].as_u64()), (Some(2895), Some(0)), "{said}");
    done(&["export", "tum", text(&mcap), "-o", text(&out), "--json"]);
    let (before, after) = (numbers(&file, ' '), numbers(&out.join("body.tum.txt"), ' '));
    assert_eq!(before.len(), after.len());
    for (a, b) in before.iter().zip(&after) {
        // Quaternions, too, have the digits of the file, although their length is 1 only to six of them.
        assert_eq!(a, b);
    }
}

#[test]
fn an_euroc_folder_comes_back_as_it_was() {
    let Some(rig) = data().map(|data| data.join("slam/euroc_v101_start")) else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let (mcap, out) = (folder.path().join("a.mcap"), folder.path().join("out"));
    let said = done(&["import", "euroc", text(&rig), "-o", text(&mcap), "--json"]);
    assert_eq!(said["dropped"], 0);
    // The truth lies beside mav0, in TUM's format.
    assert!(said["names"].as_array().expect("names").contains(&"/truth".into()), "{said}");
    done(&["export", "euroc", text(&mcap), "-o", text(&out), "--json"]);
    let inertial = |root: &Path| numbers(&root.join("mav0/imu0/data.csv"), ',');
    let (before, after) = (inertial(&rig), inertial(&out));
    assert!(before.len() > 100 && before == after);
    for sensor in ["cam0", "cam1", "imu0"] {
        let sheet = |root: &Path| std::fs::read(root.join("mav0").join(sensor).join("sensor.yaml"));
        assert_eq!(sheet(&rig).expect("a calibration"), sheet(&out).expect("a calibration"), "{sensor}");
    }
    let ours = vergence_slam::dataset::Dataset::open(&out).expect("a folder that odometry takes");
    let theirs = vergence_slam::dataset::Dataset::open(&rig).expect("a folder that odometry takes");
    assert_eq!(ours.cameras, theirs.cameras);
    let truth = |dataset: &vergence_slam::dataset::Dataset| dataset.truth.clone().expect("a truth").poses;
    let near = |(a, b): (&(vergence_time::Timestamp, _), &(vergence_time::Timestamp, _))| {
        let off: vergence_geom::Rigid = std::ops::Mul::mul(vergence_geom::Rigid::inverse(&a.1), &b.1);
        a.0 == b.0 && off.translation.vector.norm() < 1e-12
    };
    assert!(truth(&ours).len() > 10 && truth(&ours).len() == truth(&theirs).len());
    assert!(truth(&ours).iter().zip(&truth(&theirs)).all(near));
    let times = |dataset: &vergence_slam::dataset::Dataset| -> Vec<_> {
        dataset.frames.iter().map(|frame| frame.at).collect()
    };
    assert_eq!(times(&ours), times(&theirs));
    for camera in ["cam0", "cam1"] {
        let pictures = |root: &Path| -> Vec<PathBuf> {
            let entries = std::fs::read_dir(root.join("mav0").join(camera).join("data")).expect("pictures");
            let mut all: Vec<PathBuf> = entries.map(|entry| entry.expect("an entry").path()).collect();
            all.sort();
            all
        };
        let (before, after) = (pictures(&rig), pictures(&out));
        assert_eq!(before.len(), after.len(), "{camera}");
        for (a, b) in before.iter().zip(&after) {
            assert_eq!(a.file_name(), b.file_name());
            assert!(
                std::fs::read(a).expect("a picture") == std::fs::read(b).expect("a picture"),
                "{}",
                a.display()
            );
        }
    }
}

#[test]
fn a_world_with_z_up_is_turned_where_that_is_asked_for() {
    let folder = tempfile::tempdir().expect("a folder");
    let (file, mcap, out) =
        (folder.path().join("a.txt"), folder.path().join("a.mcap"), folder.path().join("out"));
    // A quarter turn about the vertical, 3 m up.
    let half = std::f64::consts::FRAC_1_SQRT_2;
    std::fs::write(&file, format!("1.0 1 2 3 0 0 0 1\n2.0 1 2 3 0 0 {half} {half}\n")).expect("a file");
    done(&["import", "tum", text(&file), "-o", text(&mcap), "--world", "y-up", "--json"]);
    done(&["export", "tum", text(&mcap), "-o", text(&out), "--json"]);
    let rows = numbers(&out.join("body.tum.txt"), ' ');
    for (row, (x, y, z, w)) in rows.iter().zip([(-half, 0.0, 0.0, half), (-0.5, 0.5, 0.5, 0.5)]) {
        let wanted = [1.0, 3.0, -2.0, x, y, z, w];
        assert!(
            row[1..].iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-6),
            "{row:?}, expected {wanted:?}"
        );
    }
    let refused = log(&["import", "csv", text(&file), "-o", text(&mcap), "--world", "y-up"]);
    assert_eq!(refused.status.code(), Some(2), "{}", told(&refused));
}

/// Seventeen columns, of which the pose is kept: nanoseconds, position and quaternion (w first).
#[test]
fn eurocs_truth_comes_back_as_it_was() {
    let folder = tempfile::tempdir().expect("a folder");
    let truth = folder.path().join("mav0/state_groundtruth_estimate0");
    std::fs::create_dir_all(&truth).expect("a folder");
    let lines = [
        "#timestamp, p_RS_R_x [m], …",
        "1403636580838555648,4.688319,-1.786938,0.783338,0.534108,-0.153029,-0.827383,-0.082152,0,0,0,0,0,0,0,0,0",
        "1403636580843555648,4.688177,-1.786770,0.787350,0.6,-0.8,0,0,0,0,0,0,0,0,0,0,0",
    ];
    std::fs::write(truth.join("data.csv"), lines.join("\r\n")).expect("a file");
    let (mcap, out) = (folder.path().join("a.mcap"), folder.path().join("out"));
    done(&["import", "euroc", text(folder.path()), "-o", text(&mcap), "--json"]);
    done(&["export", "euroc", text(&mcap), "-o", text(&out), "--json"]);
    let table = "mav0/state_groundtruth_estimate0/data.csv";
    let (before, after) = (numbers(&folder.path().join(table), ','), numbers(&out.join(table), ','));
    assert_eq!((before.len(), after.len()), (2, 2));
    for (a, b) in before.iter().zip(&after) {
        assert_eq!(a[..8], b[..8]);
    }
}

/// Each part of BROAD's truth is there for itself, with the file's digits; what is not there is an empty cell.
#[test]
fn broads_truth_comes_back_as_it_was() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let (gyr, pose, seen) =
        ("0,0,0,0,0,9.81", "-0.13315,-0.26749,1.22517", "0.2954542,0.3118895,-0.4187885,0.80003");
    let rows = [
        format!("0.000000,{gyr},nan,nan,nan,nan,{pose},0"),
        format!("0.003500,{gyr},{seen},{pose},1"),
        format!("0.007000,{gyr},nan,nan,nan,nan,nan,nan,nan,0"),
        format!("0.010500,{gyr},{seen},nan,nan,nan,1"),
    ];
    let head = "t_s,gyr_x,gyr_y,gyr_z,acc_x,acc_y,acc_z,gt_qw,gt_qx,gt_qy,gt_qz,gt_px,gt_py,gt_pz,movement";
    std::fs::write(at("a.csv"), format!("{head}\n{}\n", rows.join("\n"))).expect("a file");
    done(&["import", "broad", text(&at("a.csv")), "-o", text(&at("a.mcap")), "--json"]);
    done(&["export", "csv", text(&at("a.mcap")), "-o", text(&at("out")), "--streams", "truth", "--json"]);
    let turned = "0.3118895,-0.4187885,0.80003,0.2954542";
    let expected = [
        "captured_ns,arrived_ns,frame_id,pose.position.x,pose.position.y,pose.position.z,pose.orientation.x,\
         pose.orientation.y,pose.orientation.z,pose.orientation.w,validity"
            .to_owned(),
        format!("0,0,enu,{pose},,,,,10"),
        format!("3500000,3500000,enu,{pose},{turned},15"),
        "7000000,7000000,enu,,,,,,,,0".to_owned(),
        format!("10500000,10500000,enu,,,,{turned},5"),
    ];
    let table = std::fs::read_to_string(at("out/truth.csv")).expect("a table");
    assert_eq!(table.lines().collect::<Vec<_>>(), expected);
    // Turned, positions turn along: what was up is y.
    done(&["import", "broad", text(&at("a.csv")), "-o", text(&at("y.mcap")), "--world", "y-up", "--json"]);
    done(&["export", "tum", text(&at("y.mcap")), "-o", text(&at("y")), "--json"]);
    let row = &numbers(&at("y/truth.tum.txt"), ' ')[0];
    assert!(
        row[1..4].iter().zip([-0.13315, 1.22517, 0.26749]).all(|(a, b)| (a - b).abs() < 1e-12),
        "{row:?}"
    );
    let turn = [0.3118895, -0.4187885, 0.80003, 0.2954542];
    let half = std::f64::consts::FRAC_1_SQRT_2;
    // (−s, 0, 0, c)·q by hand.
    let [x, y, z, w] = turn;
    let wanted = [half * (x - w), half * (y + z), half * (z - y), half * (w + x)];
    assert!(row[4..].iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-6), "{row:?}, expected {wanted:?}");
}

/// A table of a spreadsheet's, with what people do to them.
#[test]
fn a_spreadsheets_table_comes_back_as_it_was() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let table =
        "Time [ms];word;real;typo;whole\r\n1000,5;a;1,25;1;3\r\n\r\n2000;b;-2,5;oops;4\r\n3000;c;;3;5\r\n";
    std::fs::write(at("a.csv"), table).expect("a file");
    let said = done(&["import", "csv", text(&at("a.csv")), "-o", text(&at("a.mcap")), "--json"]);
    let fault = "4:4: \"typo\" is kept as text: 1 cell is no number, the first \"oops\"";
    assert_eq!((said["seconds"].as_f64(), said["faults"][0].as_str()), (Some(1.9995), Some(fault)), "{said}");
    done(&["export", "csv", text(&at("a.mcap")), "-o", text(&at("out")), "--json"]);
    let expected = "captured_ns,arrived_ns,word,real,typo,whole\n1000500000,1000500000,a,1.25,1,3\n\
                    2000000000,2000000000,b,-2.5,oops,4\n3000000000,3000000000,c,,3,5\n";
    assert_eq!(std::fs::read_to_string(at("out/a.csv")).expect("a table"), expected);
    // What was exported is imported as it is.
    done(&["import", "csv", text(&at("out/a.csv")), "-o", text(&at("b.mcap")), "--json"]);
    done(&["export", "csv", text(&at("b.mcap")), "-o", text(&at("again")), "--json"]);
    assert_eq!(std::fs::read_to_string(at("again/a.csv")).expect("a table"), expected);
    std::fs::write(at("v.csv"), "v,x\n1000,2\n2000,3\n").expect("a file");
    let unit = ["--time-unit", "us", "--json"];
    let said = done(&[&["import", "csv", text(&at("v.csv")), "-o", text(&at("v.mcap"))][..], &unit].concat());
    assert_eq!((said["seconds"].as_f64(), said["faults"].as_array().map(Vec::len)), (Some(0.001), Some(0)));
}

/// Behind a file that cannot be written to its end there is nothing that would pass for one.
#[test]
fn a_full_disk_leaves_no_half_table() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let rows: String = (0..2000).map(|k| format!("{k},{}\n", f64::from(k) * 0.1)).collect();
    std::fs::write(at("a.csv"), format!("t_s,x\n{rows}")).expect("a file");
    done(&["import", "csv", text(&at("a.csv")), "-o", text(&at("a.mcap")), "--json"]);
    let full = |kind: &str, bytes: u32| {
        // A file may grow so far; what is beyond is an error, not a signal.
        let script = format!("ulimit -f {}; trap '' XFSZ; exec \"$@\"", bytes / 512);
        let out = at(&format!("out_{kind}"));
        let output = Command::new("sh")
            .args(["-c", &script, "sh"])
            .arg(vergence())
            .args(["log", "export", kind])
            .arg(at("a.mcap"))
            .arg("-o")
            .arg(&out)
            .output()
            .expect("a shell");
        assert_eq!(output.status.code(), Some(1), "{}", told(&output));
        let left: Vec<_> = std::fs::read_dir(&out).expect("a folder").collect();
        assert!(left.is_empty(), "{left:?}");
    };
    full("csv", 4096);
    full("parquet", 1024);
}

/// What a foreign file says of its columns can be seen.
#[test]
fn notes_are_shown() {
    let Some(data) = data() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let mcap = folder.path().join("a.mcap");
    let said =
        done(&["import", "xdf", text(&data.join("xdf/clock_resets.xdf")), "-o", text(&mcap), "--json"]);
    assert_eq!((said["streams"].as_u64(), said["names"][1].as_str()), (Some(2), Some("/BioSemi")), "{said}");
    let info = done(&["info", text(&mcap), "--json"]);
    let streams = info["streams"].as_array().expect("streams");
    let notes = &streams.iter().find(|stream| stream["name"] == "/BioSemi").expect("a stream")["notes"];
    assert_eq!((notes["xdf.type"].as_str(), notes["xdf.nominal_srate"].as_str()), (Some("EEG"), Some("100")));
    assert!(told(&log(&["info", text(&mcap)])).contains("/BioSemi          xdf.type = EEG"));
}

/// What pandas, pyarrow and the MCAP reader read of a table, an XDF file and a BROAD trial.
#[test]
fn others_read_equal_numbers() {
    let Some(data) = data() else { return };
    let checkout = vergence_tests::checkout();
    let named = std::env::var_os("VERGENCE_PYTHON").map(PathBuf::from);
    let python = named.unwrap_or_else(|| checkout.join("target/python/bin/python"));
    let probe = Command::new(&python).args(["-c", "import pandas, pyarrow, mcap_protobuf"]).output();
    if !probe.is_ok_and(|output| output.status.success()) {
        return skip("python", "pandas, pyarrow and mcap-protobuf-support are missing: run tools/setup");
    }
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let table = "t_ns,x,y z\n-5,1.5,0.1\n7,,1e300\n9,-0.0,3\n";
    std::fs::write(at("table.csv"), table).expect("a file");
    for (kind, file, mcap) in [
        ("csv", at("table.csv"), at("csv.mcap")),
        ("xdf", data.join("xdf/clock_resets.xdf"), at("xdf.mcap")),
        ("broad", data.join("broad/24_disturbed_tapping_A.csv.gz"), at("broad.mcap")),
    ] {
        assert_eq!(done(&["import", kind, text(&file), "-o", text(&mcap), "--json"])["dropped"], 0, "{kind}");
        for kind in KINDS {
            let out = mcap.with_extension(kind);
            done(&["export", kind, text(&mcap), "-o", text(&out), "--json"]);
        }
    }
    let script = checkout.join("tests/foreign.py");
    let broad = data.join("broad/24_disturbed_tapping_A.csv.gz");
    let output = Command::new(&python).arg(script).arg(folder.path()).arg(broad).output().expect("it runs");
    assert!(output.status.success(), "{}", told(&output));
    print!("{}", String::from_utf8_lossy(&output.stdout));
}

const KINDS: [&str; 2] = ["csv", "parquet"];

#[test]
fn what_is_wrong_is_said_with_its_place() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    for (kind, content, expected) in [
        ("csv", "t,x\n1,2\nzwei,2\n", "a.csv:3:1: expected a time, found \"zwei\""),
        ("csv", "t\n", "a.csv:1:1: expected a header of 2 to 4096 columns"),
        ("csv", "v,x\n1,2\n", "a.csv:1:1: expected a first column of time, such as t_s"),
        ("tum", "1 2 3\n", "a.tum:1:3: expected eight numbers, found 3"),
        ("xdf", "MCAP", "expected an XDF file"),
    ] {
        let file = at(&format!("a.{kind}"));
        std::fs::write(&file, content).expect("a file");
        let output = log(&["import", kind, text(&file), "-o", text(&at("a.mcap"))]);
        assert_eq!(output.status.code(), Some(1), "{}", told(&output));
        assert!(String::from_utf8_lossy(&output.stderr).contains(expected), "{}", told(&output));
    }
    std::fs::write(at("t.csv"), "t,x\n1,2\n").expect("a file");
    let output = log(&["import", "csv", text(&at("t.csv")), "-o", text(&at("t.csv"))]);
    assert_eq!(output.status.code(), Some(2), "{}", told(&output));
    assert_eq!(
        std::fs::read(at("t.csv")).expect("a file"),
        b"t,x\n1,2\n",
        "what was to be read is still there"
    );
    done(&["import", "csv", text(&at("t.csv")), "-o", text(&at("t.mcap")), "--json"]);
    let output = log(&["export", "tum", text(&at("t.mcap")), "-o", text(&at("out"))]);
    assert!(
        String::from_utf8_lossy(&output.stderr)
            .contains("tracked poses, found /recorder/events (Event), /t (Row)"),
        "{}",
        told(&output)
    );
    done(&["export", "csv", text(&at("t.mcap")), "-o", text(&at("out")), "--streams", "t", "--json"]);
    let output = log(&["import", "csv", text(&at("nothing.csv")), "-o", text(&at("a.mcap"))]);
    assert_eq!(output.status.code(), Some(2), "{}", told(&output));
}
