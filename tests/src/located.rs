//! What `vergence run --log-poses FILE` wrote.

use std::path::Path;

use serde_json::Value;

/// One line of `--log-poses`: what the client located for a frame, in LOCAL space.
#[derive(Clone, Debug, PartialEq)]
pub struct Located {
    /// When the frame is to be seen, in the runtime's time.
    pub predicted_display_ns: i64,
    /// Position (m), then quaternion x, y, z, w; infinite where the head was not located.
    pub head: [f64; 7],
    /// Left, right; as the head.
    pub eyes: [[f64; 7]; 2],
    /// Left, right, up, down, radians.
    pub fovs: [[f64; 4]; 2],
}

fn numbers<const N: usize>(value: &Value) -> [f64; N] {
    let list: Vec<f64> =
        value.as_array().expect("a list of numbers").iter().map(|n| n.as_f64().expect("a number")).collect();
    list.try_into().unwrap_or_else(|list: Vec<f64>| panic!("expected {N} numbers, found {}", list.len()))
}

/// The complete lines so far: the last one may still be being written.
///
/// # Panics
/// When a line is not what `--log-poses` promises.
#[must_use]
pub fn located(file: &Path) -> Vec<Located> {
    let text = std::fs::read_to_string(file).unwrap_or_default();
    let complete = text.rfind('\n').map_or("", |end| &text[..end]);
    let line = |line: &str| {
        let value: Value = serde_json::from_str(line).unwrap_or_else(|error| panic!("{error} in {line}"));
        Located {
            predicted_display_ns: value["predicted_display_ns"]
                .as_i64()
                .expect("predicted_display_ns is a whole number"),
            head: if value["head"].is_null() { [f64::INFINITY; 7] } else { numbers(&value["head"]) },
            eyes: [0, 1].map(|eye: usize| numbers(&value["eyes"][eye]["pose"])),
            fovs: [0, 1].map(|eye: usize| numbers(&value["eyes"][eye]["fov"])),
        }
    };
    complete.lines().map(line).collect()
}
