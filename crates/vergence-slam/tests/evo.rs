//! Errors of trajectories are those of the Python package `evo`: always against what it said of the committed examples, and against
//! the package itself where it is installed.

use std::path::{Path, PathBuf};
use std::process::Command;

use vergence_slam::evaluate::{Align, Evaluation, evaluate};
use vergence_slam::trajectory::Trajectory;

/// The bar of the comparison, metres and radians.
const EQUAL: f64 = 1e-9;

struct Example {
    estimate: &'static str,
    truth: &'static str,
    align: Align,
    /// Frames in one and in five seconds.
    frames: [usize; 2],
    /// What evo 1.38 said: ate_rmse_m, ate_max_m, scale, rpe_1s_m, rpe_1s_rad, rpe_5s_m, rpe_5s_rad.
    said: [f64; 7],
    matched: usize,
}

const EXAMPLES: [Example; 4] = [
    Example {
        estimate: "drift",
        truth: "truth",
        align: Align::Se3,
        frames: [20, 100],
        said: [
            0.036041875011,
            0.061669556530,
            1.011687272674,
            0.020193624545,
            0.006955196488,
            0.047124132947,
            0.013873450399,
        ],
        matched: 280,
    },
    Example {
        estimate: "drift",
        truth: "truth_50hz",
        align: Align::Se3,
        frames: [20, 100],
        said: [
            0.037144704801,
            0.071134608987,
            1.011959602716,
            0.023438129783,
            0.008977047738,
            0.049609195066,
            0.015195355016,
        ],
        matched: 280,
    },
    Example {
        estimate: "scaled",
        truth: "truth",
        align: Align::Sim3,
        frames: [10, 50],
        said: [
            0.017725577511,
            0.029314098584,
            2.720441904138,
            0.013372263842,
            0.007226615725,
            0.030980828063,
            0.016055748444,
        ],
        matched: 116,
    },
    Example {
        estimate: "drift",
        truth: "truth",
        align: Align::None,
        frames: [20, 100],
        said: [
            5.996248467793,
            6.434491287043,
            1.011687272674,
            0.020193624545,
            0.006955196488,
            0.047124132947,
            0.013873450399,
        ],
        matched: 280,
    },
];

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests")
}

fn file(name: &str) -> PathBuf {
    folder().join("trajectories").join(format!("{name}.tum"))
}

fn found(example: &Example) -> Evaluation {
    let read = |name| Trajectory::read(&file(name)).expect("a committed example");
    evaluate(&read(example.estimate), &read(example.truth), example.align).expect("examples that match")
}

fn numbers(found: &Evaluation) -> [f64; 7] {
    let (one, five) = (found.rpe_1s.expect("longer than 1 s"), found.rpe_5s.expect("longer than 5 s"));
    [found.ate_rmse_m, found.ate_max_m, found.scale, one.rmse_m, one.rmse_rad, five.rmse_m, five.rmse_rad]
}

#[test]
fn errors_are_those_that_evo_gave() {
    for example in EXAMPLES {
        let found = found(&example);
        assert_eq!(found.matched, example.matched);
        let frames = [found.rpe_1s, found.rpe_5s].map(|relative| relative.map(|relative| relative.frames));
        assert_eq!(frames, example.frames.map(Some), "{} {}", example.estimate, example.truth);
        for (ours, theirs) in numbers(&found).iter().zip(example.said) {
            assert!((ours - theirs).abs() < EQUAL, "{} {}: {ours} {theirs}", example.estimate, example.truth);
        }
    }
}

#[test]
fn errors_are_those_that_evo_gives() {
    let named = std::env::var_os("VERGENCE_PYTHON").map(PathBuf::from);
    let python = named.unwrap_or_else(|| folder().join("../../../target/python/bin/python"));
    let probe = Command::new(&python).args(["-c", "import evo"]).output();
    if !probe.is_ok_and(|output| output.status.success()) {
        let required = std::env::var("VERGENCE_REQUIRE").unwrap_or_default();
        assert!(!required.split(',').any(|name| name == "python"), "no Python with evo: run tools/setup");
        println!("skipped: no Python with the package evo");
        return;
    }
    for example in EXAMPLES {
        let align = match example.align {
            Align::Se3 => "se3",
            Align::Sim3 => "sim3",
            Align::None => "none",
        };
        let output = Command::new(&python)
            .arg(folder().join("by_evo.py"))
            .args([file(example.estimate), file(example.truth)])
            .arg(align)
            .args(example.frames.map(|frames| frames.to_string()))
            .output()
            .expect("Python runs, since it was probed");
        let said = String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let theirs = |key: &str| -> f64 {
            let after =
                said.split(&format!("\"{key}\": ")).nth(1).unwrap_or_else(|| panic!("no {key} in {said}"));
            let end = after.find([',', '}']).expect("the end of a number");
            after[..end].parse().unwrap_or_else(|error| panic!("{key} in {said}: {error}"))
        };
        let keys = ["ate_rmse_m", "ate_max_m", "scale", "rpe_1s_m", "rpe_1s_rad", "rpe_5s_m", "rpe_5s_rad"];
        let found = found(&example);
        for (key, ours) in keys.iter().zip(numbers(&found)) {
            assert!((ours - theirs(key)).abs() < EQUAL, "{} {key}: {ours} {}", example.estimate, theirs(key));
        }
        assert_eq!(found.matched as f64, theirs("matched"));
        println!("{} and {} ({align}): equal to evo", example.estimate, example.truth);
    }
}
