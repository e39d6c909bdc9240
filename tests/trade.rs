//! `vergence trade render` as its users call it: what it writes is what it prints, and what `run` takes.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use vergence_tests::pictures::Bench;

fn trade(scene: &Path, folder: &Path, more: &[&str]) -> Output {
    let mut command = Command::new(vergence_tests::vergence());
    command.args(["trade", "render"]).arg(scene).arg("-o").arg(folder);
    command.args(["--quick", "--size", "64x64", "--json"]).args(more);
    command.output().expect("the binary runs")
}

fn told(output: &Output) -> String {
    let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    format!("{}\n{out}\n{err}", output.status)
}

/// The errors of all measurements, in order: they must not depend on the machine's load.
fn errors(report: &serde_json::Value) -> Vec<String> {
    let measurements = report["all"]["trade"]["measurements"].as_array().expect("a list of measurements");
    measurements.iter().map(|m| m["errors"].to_string()).collect()
}

fn scene(name: &str) -> Option<PathBuf> {
    let scene = vergence_tests::data()?.join("scenes/gltf").join(name);
    // Says that there is no Vulkan device where there is none.
    Bench::open().map(|_| scene)
}

#[test]
fn a_choice_is_written_and_taken() {
    let Some(scene) = scene("NormalTangentTest.glb") else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let output = trade(&scene, folder.path(), &["--error", "1"]);
    assert!(output.status.success(), "{}", told(&output));
    let report = vergence_tests::last_object(&String::from_utf8_lossy(&output.stdout)).expect("one object");
    for name in
        ["trade.html", "trade.json", "NormalTangentTest.svg", "NormalTangentTest-truth.png", "quality.toml"]
    {
        assert!(folder.path().join(name).metadata().is_ok_and(|file| file.len() > 50), "{name}");
    }
    // The scene has textures and normal maps, so all four knobs are turned.
    for knob in report["all"]["trade"]["knobs"].as_array().expect("a list of knobs") {
        let values = knob["values"].as_array().expect("a list of values").len();
        assert!(values >= 2 || knob["name"] == "msaa", "{knob}");
    }
    let file = std::fs::read_to_string(folder.path().join("quality.toml")).expect("a file");
    let file: toml::Table = file.parse().expect("TOML");
    let chosen = &report["chosen"]["setting"];
    assert_eq!(file["quality"]["msaa"].as_integer(), chosen["msaa"].as_i64());
    assert_eq!(file["quality"]["normal_maps"].as_bool(), chosen["normal_maps"].as_bool());
    // Any error is allowed: the cheapest setting was taken.
    let front = report["all"]["front"].as_array().expect("a list");
    let cheapest = &report["all"]["trade"]["measurements"][front[0].as_u64().expect("an index") as usize];
    assert_eq!(&report["chosen"], cheapest);

    let run = Command::new(vergence_tests::vergence())
        .arg("run")
        .arg(&scene)
        .args(["--headset", "simulated", "--frames", "2", "--json", "--quality"])
        .arg(folder.path().join("quality.toml"))
        .output()
        .expect("the binary runs");
    assert!(run.status.success(), "{}", told(&run));

    let again = trade(&scene, folder.path(), &[]);
    let again = vergence_tests::last_object(&String::from_utf8_lossy(&again.stdout)).expect("one object");
    assert_eq!(errors(&report), errors(&again));
}

#[test]
fn what_cannot_be_chosen_is_said() {
    let Some(scene) = scene("Box.glb") else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let output = trade(&scene, folder.path(), &["--budget", "1ns"]);
    assert_eq!(output.status.code(), Some(1), "{}", told(&output));
    assert!(String::from_utf8_lossy(&output.stderr).contains("at most 0.000001"), "{}", told(&output));
    assert!(!folder.path().join("quality.toml").exists());
    let output = trade(&scene, folder.path(), &["--budget", "40"]);
    assert_eq!(output.status.code(), Some(2), "{}", told(&output));
}
