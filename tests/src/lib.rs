//! What tests across crates share: how a test says that something it needs is missing, where data and the built tool are,
//! and Monado, a real OpenXR runtime, with a script that poses its headset.

pub mod disc;
pub mod located;
pub mod monado;
pub mod pictures;
pub mod remote;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

/// Says `skipped: no WHAT (WHY)`, for a test that then returns.
///
/// # Panics
/// When `VERGENCE_REQUIRE` (a list as in `vulkan,openxr,data`) names `what`: there, nothing may be missing.
pub fn skip(what: &str, why: &str) {
    assert!(!required(what), "VERGENCE_REQUIRE names {what}, but there is none: {why}");
    println!("skipped: no {what} ({why})");
}

/// Whether `VERGENCE_REQUIRE` names `what`.
#[must_use]
pub fn required(what: &str) -> bool {
    let list = std::env::var("VERGENCE_REQUIRE").unwrap_or_default();
    list.split(',').any(|entry| entry.trim().eq_ignore_ascii_case(what))
}

/// The folder of large test data, `VERGENCE_DATA`. `None`, and the test says that it is skipped, where there is none.
///
/// # Panics
/// When `VERGENCE_REQUIRE` names `data` and there is none.
#[must_use]
pub fn data() -> Option<PathBuf> {
    match std::env::var_os("VERGENCE_DATA").map(PathBuf::from) {
        None => skip("data", "VERGENCE_DATA is not set"),
        Some(folder) if folder.is_dir() => return Some(folder),
        Some(folder) => skip("data", &format!("VERGENCE_DATA is {}, which is no folder", folder.display())),
    }
    None
}

/// The checkout.
#[must_use]
pub fn checkout() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the package is a folder of the checkout")
}

/// The `vergence` binary of the profile that the test was built in, built once where that was not done yet.
///
/// # Panics
/// When it does not build.
#[must_use]
pub fn vergence() -> PathBuf {
    static BUILT: OnceLock<PathBuf> = OnceLock::new();
    BUILT
        .get_or_init(|| {
            let test = std::env::current_exe().expect("a running test has a path");
            // …/target/PROFILE/deps/TEST
            let profile = test.ancestors().nth(2).expect("tests lie two folders below the target folder");
            let mut build = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
            build.current_dir(checkout()).args(["build", "--quiet", "--locked", "--package", "vergence"]);
            if profile.file_name().is_some_and(|name| name == "release") {
                build.arg("--release");
            }
            let status = build.status().expect("cargo is there, since it runs this test");
            assert!(status.success(), "the vergence binary does not build");
            profile.join("vergence")
        })
        .clone()
}

/// The one object that `--json` promises as the last thing on stdout; `None` where there is none. What a C library printed is
/// flushed at the end of the process, and may follow.
#[must_use]
pub fn last_object(stdout: &str) -> Option<serde_json::Value> {
    let start = if stdout.starts_with('{') { 0 } else { stdout.find("\n{")? + 1 };
    serde_json::Deserializer::from_str(&stdout[start..]).into_iter().next()?.ok()
}
