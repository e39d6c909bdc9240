//! Broken recordings: one error that names file, line and column; never a panic.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::io::Write;
use std::path::PathBuf;

use proptest::prelude::*;
use vergence_inertial::{Recording, read_orientations};

const HEADER: &str = "t_s,gyr_x,gyr_y,gyr_z,acc_x,acc_y,acc_z\n";

fn file(name: &str, bytes: &[u8]) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    (folder, path)
}

fn error(text: &str) -> String {
    let (_folder, path) = file("in.csv", text.as_bytes());
    Recording::read(&path).unwrap_err().to_string()
}

fn rows(count: usize, period_s: f64) -> String {
    (0..count).map(|i| format!("{},0,0,0,0,0,9.81\n", i as f64 * period_s)).collect()
}

#[test]
fn each_fault_is_named_with_its_place() {
    for (text, place) in [
        (String::new(), "in.csv:1:1: expected a header line, found an empty file"),
        ("a,b\n1,2\n".to_owned(), "in.csv:1:1: expected columns t_s (or t_ms, t_us, t_ns), gyr_x to gyr_z"),
        (format!("{}1,0,0,0,0,9.81\n", HEADER.replace(",gyr_z", "")), "expected a column 'gyr_z'"),
        (
            HEADER.replace("acc_z", "acc_z,t_s"),
            "in.csv:1:8: expected each column once, found 't_s' a second time",
        ),
        (HEADER.replace("acc_z", "acc_z,mag_x"), "expected a column 'mag_y'"),
        (format!("{HEADER}0,0,0,x,0,0,9.81\n"), "in.csv:2:4: expected a number, found 'x'"),
        (format!("{HEADER}0,0,0,0,0,0\n"), "in.csv:2:6: expected 7 columns as in the header, found 6"),
        (format!("{HEADER}0,0,0,0,0,0,9.8,1\n"), "in.csv:2:8: expected 7 columns as in the header, found 8"),
        (
            format!("{HEADER}0,0,0,0,0,0,9.8\n-1,0,0,0,0,0,9.8\n"),
            "in.csv:3:1: expected a time after 0 s, found -1 s",
        ),
        (format!("{HEADER}nan,0,0,0,0,0,9.8\n"), "in.csv:2:1: expected a time in seconds, found NaN"),
        (format!("{HEADER}0,0,0,0,0,0,9.8\n"), "in.csv:2:1: expected two samples or more, found 1"),
        (
            format!("{HEADER}{}", rows(9, 3.5)),
            "in.csv:10:1: expected a median rate of 5 to 50000 Hz, found 0.286 Hz",
        ),
        (format!("{HEADER}{}", rows(9, 1e-6)), "found 1000000.000 Hz"),
        (
            // Eight stamps each 28 ms, as a radio delivers them.
            (0..80)
                .map(|i| format!("{},0,0,0,0,0,9.81\n", f64::from(i / 8) * 0.028 + f64::from(i % 8) * 1e-5))
                .fold(HEADER.to_owned(), |text, row| text + &row),
            "found batches: most samples are 0.0100 ms after the one before, 313.4 come in a second",
        ),
        (format!("{HEADER}{}", "1".repeat(9000)), "in.csv:2:1: expected a line of at most 4096 bytes"),
        ("#timestamp [ns],w_RS_S_x,w\n".to_owned(), "in.csv:1:3: expected 'w_RS_S_y', found 'w'"),
    ] {
        let found = error(&text);
        assert!(found.contains(place), "{found}\nexpected {place}");
    }
}

#[test]
fn tables_of_other_makers_are_read() {
    let read = |text: &str| {
        let (_folder, path) = file("in.csv", text.as_bytes());
        Recording::read(&path).unwrap()
    };
    let plain = read(&format!("{HEADER}0,0.5,0,0,0,0,9.81\n0.01,0,0,0,0,0,9.81\n"));
    // Semicolons with decimal commas, milliseconds, other columns among them, one row twice.
    let found = read(
        "\"t_ms\";label;acc_x;acc_y;acc_z;gyr_x;gyr_y;gyr_z\n0;7;0;0;9,81;0,5;0;0\n0;7;0;0;9,81;0,5;0;0\n10;;0;0;9,81;0;0;0\n",
    );
    assert_eq!(found.samples, plain.samples);
    assert_eq!((&found.ignored[..], found.repeated), (&["label".to_owned()][..], 1));
    // Whole nanoseconds keep all their digits; an empty cell is a reading that is missing.
    let header = HEADER.replace("t_s", "t_ns").replace("acc_z", "acc_z,mag_x,mag_y,mag_z");
    let found = read(&format!(
        "{header}1403715281262142976,0,0,0,0,0,9.81,20,0,-40\n1403715281272142977,0,0,0,0,0,9.81,,,\n"
    ));
    assert_eq!(found.samples[1].0.as_nanos(), 1_403_715_281_272_142_977);
    assert!(found.samples[1].1.mag_ut.unwrap().iter().all(|x| x.is_nan()) && found.ignored.is_empty());
}

#[test]
fn a_swapped_pair_of_rows_costs_one_row() {
    let mut lines: Vec<String> = rows(500, 0.01).lines().map(str::to_owned).collect();
    lines.swap(200, 201);
    let (_folder, path) = file("in.csv", format!("{HEADER}{}\n", lines.join("\n")).as_bytes());
    let found = Recording::read(&path).unwrap();
    assert_eq!((found.samples.len(), found.reversed), (499, 1));
    assert!(found.samples.is_sorted_by(|a, b| a.0 < b.0));
    // More than one in a hundred are another clock.
    (0..6).for_each(|k| lines.swap(40 * k, 40 * k + 1));
    let text = format!("{HEADER}{}\n", lines.join("\n"));
    assert!(error(&text).contains("in.csv:3:1: expected a time after 0.01 s, found 0 s"), "{}", error(&text));
}

fn compressed() -> Vec<u8> {
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    gzip.write_all(format!("{HEADER}{}", rows(5000, 0.01)).as_bytes()).unwrap();
    gzip.finish().unwrap()
}

#[test]
fn truncated_compression_is_said_with_its_line() {
    let whole = compressed();
    let (_folder, path) = file("in.csv.gz", &whole);
    assert_eq!(Recording::read(&path).unwrap().samples.len(), 5000);
    let (_folder, path) = file("in.csv.gz", &whole[..whole.len() / 2]);
    let found = Recording::read(&path).unwrap_err().to_string();
    assert!(found.contains("in.csv.gz:") && found.contains(":1: expected more compressed data"), "{found}");
    let line: u64 = found.split("in.csv.gz:").nth(1).unwrap().split(':').next().unwrap().parse().unwrap();
    assert!((1000..4000).contains(&line), "{line}");
}

#[test]
fn a_missing_file_is_named() {
    let found = Recording::read("nowhere.csv".as_ref()).unwrap_err().to_string();
    assert!(found.starts_with("nowhere.csv: "), "{found}");
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn damaged_bytes_never_panic(at in 0usize..20_000, byte in any::<u8>(), cut in any::<bool>()) {
        let mut bytes = compressed();
        let at = at % bytes.len();
        bytes[at] = byte;
        if cut { bytes.truncate(at); }
        let (_folder, path) = file("in.csv.gz", &bytes);
        let _ = Recording::read(&path);
        let _ = read_orientations(&path);
    }

    #[test]
    fn damaged_text_never_panics(text in "[0-9a-z_,.#\\n\\[\\] -]{0,200}", header in any::<bool>()) {
        let text = if header { format!("{HEADER}{text}") } else { text };
        let (_folder, path) = file("in.csv", text.as_bytes());
        let _ = Recording::read(&path);
    }
}
