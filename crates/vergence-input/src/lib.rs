#![doc = include_str!("../README.md")]
#![deny(unsafe_code)]

mod connection;
mod error;
mod found;
#[cfg(feature = "serial")]
pub mod serial;

pub use connection::{CLOCK_RESIDUAL, EVENTS};
pub use error::Error;
pub use found::Found;

/// Everything that is plugged in and that one of the adapters of this build reads, by adapter and path.
pub fn found() -> Vec<Found> {
    let mut all = Vec::new();
    #[cfg(feature = "serial")]
    all.extend(serial::found());
    all
}
