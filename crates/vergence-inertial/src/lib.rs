#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod error;
pub mod filter;
mod reader;
mod score;

pub use error::Error;
pub use reader::{RATES_HZ, Recording, Truth, read_orientations, write_orientations};
pub use score::{Pair, Score, score};
