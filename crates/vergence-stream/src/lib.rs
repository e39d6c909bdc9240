#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod history;
mod timeline;

pub use history::{Answer, How, PoseHistory, Reach};
pub use timeline::Timeline;
