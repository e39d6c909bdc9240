//! The table of results is what the registry says.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use super::registry::RESULTS;
use crate::entry;

/// The registry lies in the sources of openxr-sys, which cargo knows.
fn xr_xml() -> String {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let said = Command::new(&cargo).arg("-vV").output().unwrap();
    let said = String::from_utf8(said.stdout).unwrap();
    let host = said.lines().find_map(|line| line.strip_prefix("host: ")).expect("cargo names its host");
    // What is not built here was not fetched here: other platforms' packages are not asked for.
    let output = Command::new(cargo)
        .args(["metadata", "--format-version", "1", "--locked", "--offline", "--filter-platform", host])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let package =
        metadata["packages"].as_array().unwrap().iter().find(|p| p["name"] == "openxr-sys").unwrap();
    let manifest = PathBuf::from(package["manifest_path"].as_str().unwrap());
    let path = manifest.parent().unwrap().join("OpenXR-SDK/specification/registry/xr.xml");
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Codes of `function` as the registry writes them; of an alias, those of what it stands for.
fn codes(commands: &[roxmltree::Node<'_, '_>], function: &str) -> Vec<String> {
    let named = |wanted: &str| {
        commands.iter().find(|command| {
            command.attribute("name") == Some(wanted)
                || command.descendants().any(|node| {
                    node.has_tag_name("name")
                        && node.parent().is_some_and(|parent| parent.has_tag_name("proto"))
                        && node.text() == Some(wanted)
                })
        })
    };
    let mut command = named(function).unwrap_or_else(|| panic!("{function} is not in the registry"));
    if let Some(alias) = command.attribute("alias") {
        command = named(alias).unwrap();
    }
    let list = |attribute| command.attribute(attribute).unwrap_or("").split(',').collect::<Vec<_>>();
    let codes = list("successcodes").into_iter().chain(list("errorcodes"));
    codes.filter(|code| !matches!(*code, "" | "XR_SUCCESS")).map(|code| code[3..].to_owned()).collect()
}

#[test]
fn the_table_is_the_registry() {
    let text = xr_xml();
    let options = roxmltree::ParsingOptions { allow_dtd: true, ..Default::default() };
    let document = roxmltree::Document::parse_with_options(&text, options).unwrap();
    let commands: Vec<_> = document.descendants().filter(|node| node.has_tag_name("command")).collect();
    let mut rows = String::new();
    for (name, _) in entry::NAMES {
        let codes = codes(&commands, name);
        assert!(!codes.is_empty(), "{name}");
        let _ = writeln!(rows, "    (\"{name}\", &[");
        for code in codes {
            let _ = writeln!(rows, "        R::{code},");
        }
        rows.push_str("    ]),\n");
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/fault/registry.rs");
    let written = include_str!("registry.rs");
    let (head, _) = written.split_once("pub(crate)").unwrap();
    let made = format!("{head}pub(crate) const RESULTS: &[(&str, &[R])] = &[\n{rows}];\n");
    if std::env::var_os("VERGENCE_BLESS").is_some() {
        std::fs::write(path, made).unwrap();
        return;
    }
    // Spaces are rustfmt's.
    let bare = |text: &str| text.chars().filter(|c| !c.is_whitespace() && *c != ',').collect::<String>();
    assert!(bare(written) == bare(&made), "the table differs from the registry: run with VERGENCE_BLESS=1");
    assert_eq!(RESULTS.len(), entry::NAMES.len());
}
