//! XDF files are read as pyxdf, the reference reader, reads them: values equal, times to 20 nanoseconds, clock resets included.
#![allow(clippy::unwrap_used, reason = "a test stops where something is not as expected")]

use std::path::{Path, PathBuf};
use std::process::Command;

use vergence_log::foreign::{Cells, read_xdf};

/// pyxdf fits clocks that read 653,000 s without taking their mean off first, and is 9e-9 s from the same steps in extended precision.
const STAMPS_S: f64 = 2e-8;

fn is_required(what: &str) -> bool {
    std::env::var("VERGENCE_REQUIRE").unwrap_or_default().split(',').any(|entry| entry.trim() == what)
}

fn data() -> Option<PathBuf> {
    let folder = std::env::var_os("VERGENCE_DATA").map(|data| PathBuf::from(data).join("xdf"));
    let folder = folder.filter(|folder| folder.is_dir());
    if folder.is_none() {
        assert!(!is_required("data"), "VERGENCE_DATA has no folder xdf");
        println!("skipped: no data (VERGENCE_DATA)");
    }
    folder
}

/// The Python of `tools/setup`, or the one that is named.
fn python() -> Option<PathBuf> {
    let named = std::env::var_os("VERGENCE_PYTHON").map(PathBuf::from);
    let checkout = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let python = named.unwrap_or_else(|| checkout.join("target/python/bin/python"));
    let probe = Command::new(&python).args(["-c", "import pyxdf"]).output();
    if probe.is_ok_and(|output| output.status.success()) {
        return Some(python);
    }
    assert!(!is_required("python"), "no Python with pyxdf: run tools/setup");
    println!("skipped: no Python with the package pyxdf");
    None
}

/// A line for each stream (number, samples, channels), then one for each sample: its time, and its values or their texts in hexadecimal.
const REFERENCE: &str = r#"
import logging, sys
import pyxdf
logging.disable(logging.CRITICAL)
streams, _ = pyxdf.load_xdf(sys.argv[1])
for s in streams:
    i = s["info"]
    print("stream", i["stream_id"], len(s["time_stamps"]), i["channel_count"][0], i["channel_format"][0])
    for t, row in zip(s["time_stamps"], s["time_series"]):
        print(repr(float(t)), *[v.encode().hex() or "-" if isinstance(v, str) else repr(v.item()) for v in row])
"#;

#[test]
fn the_reference_reader_reads_the_same() {
    let (Some(folder), Some(python)) = (data(), python()) else { return };
    let mut samples = 0;
    for name in ["minimal.xdf", "clock_resets.xdf", "empty_streams.xdf"] {
        let path = folder.join(name);
        let output = Command::new(&python).args(["-c", REFERENCE]).arg(&path).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let text = String::from_utf8(output.stdout).unwrap();
        let ours = read_xdf(&path).unwrap();
        assert_eq!(ours.faults, Vec::<String>::new(), "{name}");
        let mut lines = text.lines();
        let (mut count, mut worst) = (0, 0f64);
        while let Some(head) = lines.next() {
            let words: Vec<&str> = head.split(' ').collect();
            let id: u32 = words[1].parse().unwrap();
            let stream = ours.streams.iter().find(|stream| stream.id == id).unwrap();
            let (rows, channels): (usize, usize) = (words[2].parse().unwrap(), words[3].parse().unwrap());
            assert_eq!(
                (stream.stamps_s.len(), stream.channels, &stream.format[..]),
                (rows, channels, words[4])
            );
            for row in 0..rows {
                let line = lines.next().unwrap();
                let mut words = line.split(' ');
                let stamp_s: f64 = words.next().unwrap().parse().unwrap();
                worst = worst.max((stream.stamps_s[row] - stamp_s).abs());
                for channel in 0..channels {
                    let (word, place) = (words.next().unwrap(), row * channels + channel);
                    match &stream.cells {
                        Cells::Numbers(all) => {
                            assert_eq!(all[place], word.parse::<f64>().unwrap(), "{name}: {line}")
                        }
                        Cells::Integers(all) => {
                            assert_eq!(all[place], word.parse::<i64>().unwrap(), "{name}: {line}")
                        }
                        Cells::Texts(all) => {
                            let hex: String = all[place].bytes().map(|byte| format!("{byte:02x}")).collect();
                            assert_eq!(if hex.is_empty() { "-" } else { &hex }, word, "{name}: {line}");
                        }
                    }
                }
            }
            samples += rows;
            count += 1;
        }
        assert_eq!(count, ours.streams.len(), "{name}");
        println!("{name}: {count} streams, times differ by at most {worst:.1e} s");
        assert!(worst <= STAMPS_S, "{name}: {worst}");
    }
    assert!(samples > 28_000, "{samples}");
}
