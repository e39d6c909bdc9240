#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod descent;
mod elimination;
mod factor;
mod kernel;
mod marginal;
mod normal;
pub mod numeric;
mod qr;

pub use descent::{Options, Problem, Report, minimise};
pub use elimination::{EliminatedPoint, Elimination};
pub use kernel::Kernel;
pub use marginal::{Prior, Stack};
pub use normal::Normal;
pub use qr::triangularise;
