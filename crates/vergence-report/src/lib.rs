//! Plots as SVG, tables as text, and both as one self-contained HTML page.
//!
//! What a person reads after a measurement: a [`Plot`] (points and lines, linear or logarithmic axes, legend, labels
//! that do not overlap, the colour-blind-safe palette of Okabe and Ito with a shape per series, a tooltip per point),
//! a [`Table`] (aligned text for a terminal; sortable in HTML) and a [`Page`] that loads nothing from anywhere and
//! reads well on a phone. The same input gives the same bytes. It depends on nothing else of Vergence.
//!
//! Why not `plotters`: its back ends know pixels, lines and text only, so an SVG from it cannot carry a tooltip, a
//! title for screen readers or a label that gives way to another; what is left of it, axes and ticks, is the
//! smaller part of this crate.
//!
//! ```
//! use vergence_report::{Axis, Page, Plot, Point, Series, Style};
//! let points = vec![Point::new(1.0, 0.1), Point::new(10.0, 0.01).labelled("knee")];
//! let plot = Plot::new("Cost and error", Axis::log("cost (ms)"), Axis::linear("error"))
//!     .with(Series::new("measured", Style::Line, points));
//! let page = Page::new("Report").plot(&plot)?.to_html();
//! assert!(page.contains("<svg") && page.contains("knee"));
//! # Ok::<(), vergence_report::Error>(())
//! ```
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
