//! Serial ports: frames of a protocol of our own, or lines of numbers.

mod describe;
pub mod frame;
pub mod lines;
mod port;
mod source;

pub use describe::{Description, DescriptionError};
pub use port::{Port, found, open};
pub use source::{Format, SerialConfig, SerialSource, Totals};
