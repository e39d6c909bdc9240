#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod history;

pub use history::{Ahead, Answer, How, PoseHistory, Reach};
