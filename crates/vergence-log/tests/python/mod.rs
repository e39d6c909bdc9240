//! Public readers in another language.

use std::path::{Path, PathBuf};
use std::process::Command;

/// The Python of `tools/setup`, or the one that is named.
pub fn find() -> Option<PathBuf> {
    let named = std::env::var_os("VERGENCE_PYTHON").map(PathBuf::from);
    let checkout = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let python = named.unwrap_or_else(|| checkout.join("target/python/bin/python"));
    let probe =
        Command::new(&python).args(["-c", "import mcap, mcap_protobuf, foxglove_schemas_protobuf"]).output();
    if probe.is_ok_and(|output| output.status.success()) {
        return Some(python);
    }
    let required = std::env::var("VERGENCE_REQUIRE").unwrap_or_default();
    assert!(!required.split(',').any(|name| name.trim() == "python"), "no Python with mcap: run tools/setup");
    println!("skipped: no Python with the packages mcap, mcap-protobuf-support, foxglove-schemas-protobuf");
    None
}

/// Decodes every message of these logs by the schemas in them, and Foxglove's also by the published ones.
pub fn decode(python: &Path, logs: &[PathBuf]) {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/decode.py");
    let output = Command::new(python).arg(script).args(logs).output().unwrap();
    let said =
        String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && said.contains(&format!("{} files", logs.len())), "{said}");
    print!("{said}");
}
