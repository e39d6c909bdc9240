//! HID devices: what a mapping makes of their reports.

pub mod descriptor;
pub mod mapping;
mod node;
mod source;

pub use mapping::{Identity, Mapping};
pub use node::{Reports, found, unmapped};
pub use source::HidSource;
