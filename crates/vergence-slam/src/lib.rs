#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod dataset;
mod error;
pub mod evaluate;
mod link;
mod odometry;
mod params;
mod shrink;
mod sighting;
pub mod trajectory;
mod window;

pub use error::Error;
pub use link::Motion;
pub use odometry::{Estimate, Odometry, State};
pub use params::{Inertial, Params};
pub use sighting::Sighting;
