#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod link;
mod odometry;
mod params;
mod shrink;
mod sighting;
mod window;

pub use link::Motion;
pub use odometry::{Estimate, Odometry, State};
pub use params::{Inertial, Params};
pub use sighting::Sighting;
