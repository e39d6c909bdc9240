#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod person;

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
    /// A stimulus before the one before it.
    #[error("expected a stimulus at {latest_ns} ns or later, found one at {found_ns} ns")]
    Order {
        /// The last one's time.
        latest_ns: i64,
        /// What was given.
        found_ns: i64,
    },
}
