//! Serial ports: frames of a protocol of our own, or lines of numbers.

mod backlog;
mod describe;
pub mod frame;
mod knobs;
pub mod lines;
mod port;
mod source;
mod table;

pub use describe::{Description, DescriptionError};
pub use knobs::{Format, SerialConfig, Totals};
pub use port::{Port, found, open};
pub use source::SerialSource;
