//! `vergence trade filters` as its users call it.

use std::process::Command;

use vergence_tests::{data, last_object, vergence};

/// The one euro filter is on the front; with as little jitter left, no other errs as little.
#[test]
fn one_euro_is_on_the_front() {
    if data().is_none() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let output = Command::new(vergence())
        .args(["trade", "filters", "--quick", "--json", "-o"])
        .arg(folder.path())
        .output()
        .expect("the binary runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report = last_object(&String::from_utf8_lossy(&output.stdout)).expect("one object");
    for name in ["filters.html", "filters.json", "filters-error.svg", "filters-lag.svg"] {
        assert!(folder.path().join(name).metadata().is_ok_and(|file| file.len() > 500), "{name}");
    }
    let measurements = report["trade"]["measurements"].as_array().expect("a list");
    let front = report["front"].as_array().expect("a list");
    let is_one_euro = |index: &serde_json::Value| {
        measurements[index.as_u64().expect("an index") as usize]["setting"]["filter"] == "one-euro"
    };
    assert!(front.iter().filter(|index| is_one_euro(index)).count() >= 3, "{front:?}");
    for row in report["compared"].as_array().expect("a list") {
        let error = |filter: &str| row["best"][filter]["errors"][0].as_f64();
        let one_euro = error("one-euro").expect("one euro leaves as little jitter as is asked for");
        let others = ["low-pass", "double-exponential"];
        assert!(others.iter().all(|other| error(other).is_none_or(|error| error > one_euro)), "{row}");
    }
}
