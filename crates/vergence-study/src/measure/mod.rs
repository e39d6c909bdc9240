//! Measures: of ends (Fitts' law), of paths, of errors.

pub mod ends;
pub mod fitts;
pub mod outlier;
pub mod path;
