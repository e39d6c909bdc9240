#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod alternatives;
mod analysis;
mod convention;
mod design;
mod export;
mod import;
pub mod measure;
mod plan;
mod report;
mod study_file;
mod task;
mod tradeoff;
mod trial;

pub use alternatives::{Alternative, alternatives};
pub use analysis::{Analysed, Analysis, Counts, Fit, Key, Row, analyse, analyse_trials, key_of};
pub use convention::{
    Axis, Conventions, Difficulty, Frame, Front, MeanTime, Outliers, PathRule, Reach, SQRT_2_PI_E,
};
pub use design::{Order, permutations, shuffled, williams};
pub use export::{conditions_csv, factor_column, summary_json, trials_csv};
pub use import::{Column, ColumnMap, Imported, Maps, Scaled, Streamed, Tool, import, stream, together};
#[cfg(feature = "parquet")]
pub use import::{ParquetText, parquet_text, write_parquet};
#[cfg(feature = "sql")]
pub use import::{SqlText, TABLE, sql_text};
pub use plan::{Plan, PlannedBlock, PlannedTrial};
pub use report::page;
pub use study_file::{Instruction, Size, Study, TEMPLATE, Trigger};
pub use task::{Geometry, Plane, Target, layout, real_amplitude};
pub use tradeoff::{
    CafBin, ErrorModel, Level, Stability, Who, conditional_accuracy, error_model, front_of,
    speeds_and_spreads, stability, who, who_of,
};
pub use trial::{CursorSample, DataSet, PathMeasures, Point, Trial};

/// Why there is no answer.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// A study file or a map is wrong: file, line, column.
    #[error("{0}")]
    Config(String),
    /// A knob has no such value.
    #[error("{what}: expected {expected}, found {found:?}")]
    Knob {
        /// Which knob.
        what: &'static str,
        /// Its values.
        expected: String,
        /// What was given.
        found: String,
    },
    /// A recording does not begin as its tool writes it.
    #[error("line 1: expected {expected}, found something else")]
    Header {
        /// What.
        expected: &'static str,
    },
    /// A column or attribute is missing.
    #[error(
        "line {line}: expected a column {column:?}, found none of that name (a column map says which is which)"
    )]
    Missing {
        /// Counted from 1.
        line: u64,
        /// Its name.
        column: String,
    },
    /// A table lacks a column that is needed.
    #[error(
        "line 1: expected a column {column:?}, found {header} (a column map says which is which, and what stands between cells)"
    )]
    NoColumn {
        /// Its name.
        column: String,
        /// The names that are there.
        header: String,
    },
    /// A row has more or fewer cells than the header.
    #[error("line {line}: expected {expected} cells, found {found}")]
    Row {
        /// Counted from 1.
        line: u64,
        /// As many as there are columns.
        expected: usize,
        /// The count.
        found: usize,
    },
    /// A cell is not what its column holds.
    #[error("line {line}, column {column:?}: expected {expected}, found {found:?}")]
    Cell {
        /// Counted from 1.
        line: u64,
        /// Its column.
        column: String,
        /// What.
        expected: &'static str,
        /// The beginning of it.
        found: String,
    },
    /// Markup or quoting is damaged.
    #[error("line {line}: expected {expected}, found damage")]
    Xml {
        /// Counted from 1.
        line: u64,
        /// What.
        expected: &'static str,
    },
    /// JSON that is not a recording of its tool.
    #[error("line {line}: {message}")]
    Json {
        /// Counted from 1.
        line: u64,
        /// What was expected and what was found.
        message: String,
    },
    /// Nothing to analyse.
    #[error("expected {what}, found none")]
    Empty {
        /// What.
        what: &'static str,
    },
    /// More than is handled.
    #[error("expected at most {most} {what}, found more")]
    TooMany {
        /// What.
        what: &'static str,
        /// The limit.
        most: usize,
    },
    /// Recordings that cannot be put together.
    #[error("expected recordings of one kind ({expected}), found {found}")]
    Mixed {
        /// The first one's.
        expected: String,
        /// The other one's.
        found: String,
    },
    /// A convention that needs a whole sequence at once.
    #[error(
        "expected conventions that one pass can follow, found an outlier policy or an axis that needs whole sequences"
    )]
    NotStreamed,
    /// The input ended badly.
    #[error("{0}")]
    Read(String),
    /// A picture of the report cannot be drawn.
    #[error(transparent)]
    Report(#[from] vergence_report::Error),
}

impl From<vergence_config::Error> for Error {
    fn from(error: vergence_config::Error) -> Self {
        Self::Config(error.to_string())
    }
}
