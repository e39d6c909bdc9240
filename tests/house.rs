//! The rules of the house that a compiler does not see: who may import whom, where `unsafe` is allowed, what licences come in,
//! how long a file may be.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;
use vergence_tests::checkout;

/// What stands at the top of the checkout.
const TOP: [&str; 16] = [
    ".ci",
    ".gitignore",
    "CHANGELOG.md",
    "Cargo.lock",
    "Cargo.toml",
    "LICENSE-APACHE",
    "LICENSE-MIT",
    "README.md",
    "clippy.toml",
    "crates",
    "deny.toml",
    "rustfmt.toml",
    "shaders",
    "tests",
    "tools",
    ".gitattributes",
];

/// The rooms that lift the workspace's `unsafe_code = "deny"`, each for the C interface that it stands on.
const UNSAFE_ROOMS: [&str; 4] = ["gpu", "xr", "xr-sim", "xr-runtime"];

/// Files elsewhere that lift it for one line each: session vouches for the entry point of the runtime that it links in, vision for the
/// instruction set that the processor says it has, input for the one request to the kernel that no crate wraps.
const UNSAFE_FILES: [&str; 3] = [
    "crates/vergence-session/src/headset.rs",
    "crates/vergence-vision/src/simd.rs",
    "crates/vergence-input/src/gamepad/clock_id.rs",
];

/// Third-party crates that only one room may name in its manifest, and that room.
const OWNED: [(&str, &str); 5] =
    [("ash", "gpu"), ("ash-window", "gpu"), ("gpu-allocator", "gpu"), ("openxr", "xr"), ("winit", "window")];

/// Licences that dependencies may have; as in deny.toml.
const LICENCES: [&str; 12] = [
    "MIT",
    "MIT-0",
    "Apache-2.0",
    "Apache-2.0 WITH LLVM-exception",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "BSL-1.0",
    "CC0-1.0",
    "ISC",
    "Unicode-3.0",
    "Unlicense",
    "Zlib",
];

/// Crates that may have one licence more.
const LICENCE_EXCEPTIONS: [(&str, &str); 1] = [("serialport", "MPL-2.0")];

/// A longer file says in its first lines why it is one file: `Length: …`.
const LINES: usize = 800;

/// Drawers: names that say nothing of what is inside.
const DRAWERS: [&str; 5] = ["util", "utils", "common", "misc", "helpers"];

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The rooms that exist: folders `crates/vergence-*`.
fn rooms() -> BTreeMap<String, PathBuf> {
    let folders = std::fs::read_dir(checkout().join("crates")).expect("the workspace has crates");
    let mut rooms = BTreeMap::new();
    for folder in folders {
        let path = folder.expect("a readable folder").path();
        // A folder that holds no manifest is what a change of branch leaves behind.
        if path.join("Cargo.toml").is_file() {
            let name = path.file_name().and_then(|name| name.to_str()).expect("a name in UTF-8");
            let room = name
                .strip_prefix("vergence-")
                .unwrap_or_else(|| panic!("crates/{name} is not called vergence-*"));
            rooms.insert(room.to_owned(), path);
        }
    }
    rooms
}

/// README.md's table of rooms: each room and what it may import.
fn table() -> BTreeMap<String, BTreeSet<String>> {
    let readme = read(&checkout().join("README.md"));
    let section = readme.split("\n## Rooms\n").nth(1).expect("README.md has a section '## Rooms'");
    let mut table: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    let rows = section
        .lines()
        .skip_while(|line| !line.starts_with("| crate |"))
        .skip(2)
        .take_while(|line| line.starts_with('|'));
    for row in rows {
        let cells: Vec<&str> = row.trim_matches('|').split('|').map(str::trim).collect();
        let [names, imports] = cells[..] else { panic!("a row with two cells is expected, found: {row}") };
        let imports: BTreeSet<String> = match imports {
            "nothing of ours" => BTreeSet::new(),
            "every room above" => table.keys().cloned().collect(),
            // Binaries and tests, which nobody imports.
            "all" => continue,
            list => list.split(',').map(|room| room.trim().to_owned()).collect(),
        };
        for name in names.split(',') {
            assert!(table.insert(name.trim().to_owned(), imports.clone()).is_none(), "{name} has two rows");
        }
    }
    assert!(table.len() > 5, "the table of rooms has {} rows only", table.len());
    table
}

/// Names in the sections of a manifest that end with `kind`, also those for one platform only.
fn dependencies(manifest: &toml::Table, kind: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    let mut add = |table: &toml::Table| {
        if let Some(list) = table.get(kind).and_then(toml::Value::as_table) {
            for (key, value) in list {
                let renamed = value.get("package").and_then(toml::Value::as_str);
                found.insert(renamed.unwrap_or(key).to_owned());
            }
        }
    };
    add(manifest);
    if let Some(targets) = manifest.get("target").and_then(toml::Value::as_table) {
        targets.values().filter_map(toml::Value::as_table).for_each(add);
    }
    found
}

fn manifest(folder: &Path) -> toml::Table {
    let path = folder.join("Cargo.toml");
    read(&path).parse().unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

#[test]
fn rooms_import_only_what_the_table_allows() {
    let (rooms, table) = (rooms(), table());
    let mut wrong = Vec::new();
    for room in table.keys().filter(|room| !rooms.contains_key(*room)) {
        wrong.push(format!("the table names {room}, which is no crate"));
    }
    for (room, folder) in &rooms {
        let Some(allowed) = table.get(room) else {
            wrong.push(format!("{room} is not in the table"));
            continue;
        };
        let manifest = manifest(folder);
        for kind in ["dependencies", "build-dependencies", "dev-dependencies"] {
            for import in dependencies(&manifest, kind) {
                let Some(import) = import.strip_prefix("vergence-") else { continue };
                // A test may also measure with a room of the ground floor, which imports nothing that could form a circle.
                let ground_floor =
                    kind == "dev-dependencies" && table.get(import).is_some_and(BTreeSet::is_empty);
                if !allowed.contains(import) && !ground_floor {
                    wrong.push(format!("{room} imports {import} ({kind})"));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn a_rooms_readme_is_its_documentation() {
    let mut wrong = Vec::new();
    for (room, folder) in &rooms() {
        let readme = std::fs::read_to_string(folder.join("README.md")).unwrap_or_default();
        if !readme.contains("```") {
            wrong.push(format!("{room}: a README.md with an example is expected"));
        }
        if !read(&folder.join("src/lib.rs")).contains("#![doc = include_str!(\"../README.md\")]") {
            wrong.push(format!("{room}: src/lib.rs is expected to take its documentation from README.md"));
        }
        if manifest(folder)["package"].get("readme").is_none() {
            wrong.push(format!("{room}: a manifest that names README.md is expected"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn no_circle_in_the_table() {
    let table = table();
    let mut placed: BTreeSet<&String> = BTreeSet::new();
    while placed.len() < table.len() {
        let next: Vec<&String> = table
            .iter()
            .filter(|(room, imports)| {
                !placed.contains(room) && imports.iter().all(|import| placed.contains(import))
            })
            .map(|(room, _)| room)
            .collect();
        assert!(
            !next.is_empty(),
            "a circle, or an unknown import, among {:?}",
            table.keys().filter(|r| !placed.contains(r))
        );
        placed.extend(next);
    }
}

#[test]
fn what_the_workspace_lists_is_used() {
    let workspace = manifest(checkout());
    let listed = workspace["workspace"]["dependencies"].as_table().expect("a table of dependencies");
    let mut members: Vec<PathBuf> = rooms().into_values().collect();
    members.extend(["tools/vergence", "tests"].map(|member| checkout().join(member)));
    let mut used = BTreeSet::new();
    for member in &members {
        let manifest = manifest(member);
        for kind in ["dependencies", "build-dependencies", "dev-dependencies"] {
            used.append(&mut dependencies(&manifest, kind));
        }
    }
    // A room may be at the top, where nobody imports it; what others wrote is here for somebody.
    let idle: Vec<&String> = listed
        .iter()
        .filter(|(name, value)| value.get("path").is_none() && !used.contains(*name))
        .map(|(name, _)| name)
        .collect();
    assert!(idle.is_empty(), "listed in Cargo.toml, used by no member: {idle:?}");
}

#[test]
fn a_foreign_interface_has_one_room() {
    for (room, folder) in &rooms() {
        let manifest = manifest(folder);
        for kind in ["dependencies", "build-dependencies", "dev-dependencies"] {
            let names = dependencies(&manifest, kind);
            for (name, owner) in OWNED {
                // The client is what the simulated runtime is tested with.
                let tested = (name, room.as_str(), kind) == ("openxr", "xr-sim", "dev-dependencies");
                assert!(
                    room == owner || tested || !names.contains(name),
                    "{room} depends on {name}, which is {owner}'s"
                );
            }
        }
    }
}

/// Every file under `folder` with one of these endings, without build outputs.
fn files(folder: &Path, endings: &[&str], found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display())) {
        let path = entry.expect("a readable entry").path();
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        if path.is_dir() && name != "target" && !name.starts_with('.') {
            files(&path, endings, found);
        } else if endings.iter().any(|ending| name.ends_with(ending)) {
            found.push(path);
        }
    }
}

fn sources() -> Vec<PathBuf> {
    let mut found = Vec::new();
    for folder in ["crates", "shaders", "tools", "tests"]
        .map(|name| checkout().join(name))
        .iter()
        .filter(|f| f.is_dir())
    {
        files(folder, &[".rs", ".wgsl"], &mut found);
    }
    assert!(found.len() > 10, "only {} source files were found", found.len());
    found
}

/// Whether this file counts what an importer allocates, which takes an allocator, an unsafe trait.
fn counts_allocations(text: &str) -> bool {
    text.contains("unsafe impl GlobalAlloc") || text.contains("unsafe impl std::alloc::GlobalAlloc")
}

#[test]
fn unsafe_stays_in_its_rooms() {
    for (room, folder) in &rooms() {
        let inherits = manifest(folder)
            .get("lints")
            .and_then(|lints| lints.get("workspace"))
            .and_then(toml::Value::as_bool);
        assert_eq!(inherits, Some(true), "{room}'s manifest does not take the workspace's lints");
    }
    for path in sources().iter().filter(|path| !path.ends_with("tests/house.rs")) {
        let text = read(path);
        let allowed = UNSAFE_ROOMS
            .iter()
            .any(|room| path.starts_with(checkout().join(format!("crates/vergence-{room}"))));
        let test = path.strip_prefix(checkout()).is_ok_and(|path| path.iter().any(|part| part == "tests"));
        let vouches = UNSAFE_FILES.iter().any(|file| *path == checkout().join(file))
            && text.matches("unsafe {").count() == 1;
        if allowed || vouches || (test && counts_allocations(&text)) {
            continue;
        }
        let lifted = text
            .lines()
            .find(|line| line.contains("allow(unsafe_code") || line.contains("expect(unsafe_code"));
        assert_eq!(lifted, None, "{} lifts the lint", path.display());
    }
}

#[test]
fn files_have_a_length_and_a_name_with_a_reason() {
    let mut wrong = Vec::new();
    for path in sources() {
        let text = read(&path);
        let lines = text.lines().count();
        if lines > LINES && !text.lines().take(30).any(|line| line.contains("Length:")) {
            wrong.push(format!(
                "{}: {lines} lines, and its header gives no reason ('Length: …')",
                path.display()
            ));
        }
        let stem = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
        if DRAWERS.contains(&stem) || stem == "types" {
            wrong.push(format!("{}: a name that says nothing of its content", path.display()));
        }
        if text.lines().any(|line| line.trim_start().starts_with("use crate::*;")) {
            wrong.push(format!("{}: imports everything of its crate", path.display()));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn the_top_of_the_checkout_is_tidy() {
    let Ok(listing) = Command::new("git").args(["ls-files", "--cached"]).current_dir(checkout()).output()
    else {
        return vergence_tests::skip("git", "the command is missing");
    };
    if !listing.status.success() {
        return vergence_tests::skip("git", "this is no clone");
    }
    let listing = String::from_utf8(listing.stdout).expect("names in UTF-8");
    let top: BTreeSet<&str> = listing.lines().filter_map(|path| path.split('/').next()).collect();
    let strangers: Vec<&&str> = top.iter().filter(|name| !TOP.contains(name)).collect();
    assert!(strangers.is_empty(), "at the top, unexpected: {strangers:?}");
}

/// Whether an SPDX expression is satisfied when exactly `allowed` is acceptable. `A/B`, the old way to write it, is `A OR B`.
fn acceptable(expression: &str, allowed: &dyn Fn(&str) -> bool) -> bool {
    let spaced = expression.replace('/', " OR ").replace('(', " ( ").replace(')', " ) ");
    let mut words: Vec<&str> = spaced.split_whitespace().rev().collect();
    let result = alternatives(&mut words, allowed);
    assert!(words.is_empty(), "no SPDX expression: {expression}");
    result
}

fn alternatives(words: &mut Vec<&str>, allowed: &dyn Fn(&str) -> bool) -> bool {
    let mut result = conjunction(words, allowed);
    while words.last() == Some(&"OR") {
        words.pop();
        result |= conjunction(words, allowed);
    }
    result
}

fn conjunction(words: &mut Vec<&str>, allowed: &dyn Fn(&str) -> bool) -> bool {
    let mut result = licence(words, allowed);
    while words.last() == Some(&"AND") {
        words.pop();
        result &= licence(words, allowed);
    }
    result
}

fn licence(words: &mut Vec<&str>, allowed: &dyn Fn(&str) -> bool) -> bool {
    let word = words.pop().expect("an SPDX expression does not end here");
    if word == "(" {
        let result = alternatives(words, allowed);
        assert_eq!(words.pop(), Some(")"), "a parenthesis is not closed");
        return result;
    }
    if words.last() == Some(&"WITH") {
        words.pop();
        let exception = words.pop().expect("WITH is followed by an exception");
        return allowed(&format!("{word} WITH {exception}"));
    }
    allowed(word)
}

#[test]
fn spdx_expressions_are_read_by_their_precedence() {
    let mit = |name: &str| name == "MIT";
    assert!(acceptable("MIT OR GPL-3.0", &mit) && acceptable("GPL-3.0/MIT", &mit));
    assert!(!acceptable("MIT AND GPL-3.0", &mit) && !acceptable("(MIT OR ISC) AND GPL-3.0", &mit));
    // AND binds closer than OR.
    assert!(
        acceptable("MIT OR ISC AND GPL-3.0", &mit) && !acceptable("(MIT OR ISC) AND (ISC OR GPL-3.0)", &mit)
    );
    assert!(!acceptable("Apache-2.0 WITH LLVM-exception", &mit));
}

#[test]
fn licences_of_dependencies_are_allowed() {
    let mut metadata = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    metadata.current_dir(checkout()).args(["metadata", "--format-version", "1", "--locked"]);
    // What is not built here is not fetched here.
    metadata.args(["--filter-platform", "x86_64-unknown-linux-gnu"]);
    let output = metadata.output().expect("cargo is there, since it runs this test");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: Value = serde_json::from_slice(&output.stdout).expect("cargo metadata writes JSON");
    let used: BTreeSet<&str> = metadata["resolve"]["nodes"]
        .as_array()
        .expect("nodes")
        .iter()
        .filter_map(|node| node["id"].as_str())
        .collect();
    let mut wrong = Vec::new();
    for package in metadata["packages"].as_array().expect("packages") {
        let name = package["name"].as_str().unwrap_or_default();
        if !package["id"].as_str().is_some_and(|id| used.contains(id)) {
            continue;
        }
        let allowed =
            |licence: &str| LICENCES.contains(&licence) || LICENCE_EXCEPTIONS.contains(&(name, licence));
        match package["license"].as_str() {
            Some(expression) if acceptable(expression, &allowed) => {}
            found => wrong.push(format!("{name}: {}", found.unwrap_or("no licence stated"))),
        }
    }
    assert!(wrong.is_empty(), "licences that are not in the list:\n{}", wrong.join("\n"));
}

#[test]
fn deny_toml_says_the_same() {
    let deny: toml::Table = read(&checkout().join("deny.toml")).parse().expect("deny.toml is TOML");
    let allow = deny["licenses"]["allow"].as_array().expect("a list of licences");
    let allow: BTreeSet<&str> = allow.iter().filter_map(toml::Value::as_str).collect();
    assert_eq!(allow, LICENCES.into_iter().collect());
}
