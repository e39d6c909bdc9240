//! Other formats: recordings before they become a log, and what a log becomes for others.

mod dejitter;
mod flat;
mod table;
mod xdf;

pub use flat::{Cell, ORDER, flat, schema_of};
pub use table::{Table, TableColumn, TableError, TimeUnit};
pub use xdf::{Cells, Xdf, XdfStream, read_xdf};
