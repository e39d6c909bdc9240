#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod allan;
pub mod calibrate;
mod dice;
mod error;
pub mod filter;
pub mod frames;
pub mod model;
pub mod motion;
pub mod predict;
pub mod preintegrate;
mod reader;
mod score;
pub mod spline;
mod still;
mod unit;

pub use dice::Dice;
pub use error::Error;
pub use reader::{RATES_HZ, Recording, Truth, read_orientations, read_tum_orientations, write_orientations};
pub use score::{Pair, Score, paired, score};
pub use unit::Unit;
