#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod bootstrap;
pub mod dataset;
mod error;
pub mod evaluate;
mod flight;
pub mod follower;
mod link;
mod mounting;
mod odometry;
mod one_camera;
mod params;
pub mod playback;
mod shrink;
mod sighting;
mod state;
pub mod states;
mod stillness;
mod tracking;
pub mod trajectory;
mod window;

pub use error::Error;
pub use link::Motion;
pub use mounting::Misfit;
pub use odometry::{Estimate, Odometry};
pub use params::{Inertial, Params};
pub use sighting::Sighting;
pub use state::State;
pub use tracking::Tracking;
