//! `vergence sim camera` as its users call it: what it records is followed by `vergence slam run`, through the product's own
//! renderer, lenses and formats.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;
use vergence_tests::{checkout, data, last_object, skip, vergence};

fn tool(arguments: &[&str]) -> Output {
    Command::new(vergence()).args(arguments).output().expect("the binary runs")
}

fn told(output: &Output) -> String {
    let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    format!("{}\n{out}\n{err}", output.status)
}

fn done(arguments: &[&str]) -> Value {
    let output = tool(arguments);
    assert!(output.status.success(), "{}", told(&output));
    last_object(&String::from_utf8_lossy(&output.stdout)).expect("one object")
}

fn vulkan() -> bool {
    let report =
        last_object(&String::from_utf8_lossy(&tool(&["doctor", "--json"]).stdout)).expect("one object");
    let found =
        report["findings"].as_array().and_then(|all| all.iter().find(|f| f["topic"] == "Vulkan device"));
    let device = found.expect("a finding on Vulkan");
    if device["usable"] != true {
        skip("vulkan", &device["missing"].to_string());
    }
    device["usable"] == true
}

fn text(path: &Path) -> &str {
    path.to_str().expect("a path in UTF-8")
}

#[test]
fn what_is_recorded_in_the_sample_room_is_followed() {
    let Some(data) = data() else { return };
    if !vulkan() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let scene = checkout().join("crates/vergence-scene/samples/room.toml");
    let flight = data.join("trajectories/V1_01_easy.tum.txt");
    let rig = data.join("slam/euroc_v101_start");
    let camera = |rig: &Path, out: &Path, knobs: &[&str]| {
        let call = ["sim", "camera", text(&scene), "--trajectory", text(&flight), "--rig", text(rig)];
        tool(&[&call[..], &["-o", text(out)], knobs].concat())
    };
    let record = |name: &str, length: &str, seed: &str| {
        let out = folder.path().join(name);
        let knobs = ["--from", "10", "--length", length, "--oversampling", "1", "--seed", seed, "--json"];
        let output = camera(&rig, &out, &knobs);
        assert!(output.status.success(), "{}", told(&output));
        let said = last_object(&String::from_utf8_lossy(&output.stdout)).expect("one object");
        assert_eq!(said["cameras"], 2, "{said}");
        out
    };
    let first = |folder: &Path| {
        let pictures = folder.join("mav0/cam1/data");
        let mut names: Vec<_> = std::fs::read_dir(pictures)
            .expect("pictures")
            .map(|entry| entry.expect("an entry").path())
            .collect();
        names.sort();
        (names.len(), std::fs::read(&names[0]).expect("a picture"))
    };

    let long = record("long", "1.5", "7");
    let (frames, picture) = first(&long);
    assert_eq!(frames, 31);
    // The same seed gives the same bits, however long the flight; another one gives other noise.
    assert_eq!(first(&record("short", "0.1", "7")), (3, picture.clone()));
    assert_ne!(first(&record("other", "0.1", "8")).1, picture);

    let poses = folder.path().join("poses.tum");
    let run = done(&["slam", "run", text(&long), "-o", text(&poses), "--json"]);
    let eval = done(&["slam", "eval", text(&poses), text(&long.join("truth.tum")), "--json"]);
    println!("{run}\n{eval}");
    let ate = eval["ate_rmse_m"].as_f64().expect("an error");
    // A second and a half along a bare wall: seen, 2 mm over two seconds.
    assert!(ate < 0.02, "{eval}");

    let again = camera(&rig, &long, &[]);
    assert_eq!(again.status.code(), Some(2), "{}", told(&again));
    let nowhere = folder.path().join("nowhere");
    let lost = camera(&nowhere, Path::new("x"), &[]);
    assert_eq!(lost.status.code(), Some(1), "{}", told(&lost));
    assert!(told(&lost).contains("nowhere"), "{}", told(&lost));
}
