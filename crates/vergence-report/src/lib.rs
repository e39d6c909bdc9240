#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod axis;
mod labels;
mod page;
mod plot;
mod table;
mod text;

pub use axis::{Axis, Scale};
pub use page::Page;
pub use plot::{OKABE_ITO, Plot, Point, Series, Style};
pub use table::{Cell, Column, Table};

/// Why nothing can be drawn.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// The range of an axis is not a range.
    #[error("axis {axis:?}: expected a finite range, ascending{positive}, found {found:?}")]
    Range {
        /// The axis's label.
        axis: String,
        /// More about what was expected.
        positive: &'static str,
        /// What was given.
        found: (f64, f64),
    },
    /// The page's frame leaves no room for the plot.
    #[error("expected a plot of at least {expected:?} pixels, found {found:?}")]
    Size {
        /// Least width and height.
        expected: (u32, u32),
        /// What was given.
        found: (u32, u32),
    },
}
