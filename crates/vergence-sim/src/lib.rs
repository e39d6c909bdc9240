#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod camera;
pub mod gamepad;
pub mod gaze;
pub mod hid;
pub mod mouse;
pub mod person;
mod smooth;
pub mod uart;

/// What a simulation cannot do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// A parameter out of its range.
    #[error("{what}: expected {expected}, found {found}")]
    Parameter {
        /// Which.
        what: &'static str,
        /// Its range.
        expected: &'static str,
        /// What was given.
        found: f64,
    },
    /// A line of a recording is wrong.
    #[error("line {line}: expected {expected}, found {found:?}")]
    Line {
        /// Counted from 1.
        line: usize,
        /// What.
        expected: &'static str,
        /// The beginning of it.
        found: String,
    },
    /// A stimulus before the one before it.
    #[error("expected a stimulus at {latest_ns} ns or later, found one at {found_ns} ns")]
    Order {
        /// The last one's time.
        latest_ns: i64,
        /// What was given.
        found_ns: i64,
    },
}

/// Refuses the first value that is not in its range: name, value, lowest, highest, the range in words.
fn in_ranges(ranges: &[(&'static str, f64, f64, f64, &'static str)]) -> Result<(), Error> {
    let outside = ranges.iter().find(|(_, found, low, high, _)| !(*low..=*high).contains(found));
    match outside {
        Some(&(what, found, _, _, expected)) => Err(Error::Parameter { what, expected, found }),
        None => Ok(()),
    }
}
