#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod anova;
mod decimal;
mod distribution;
mod exact;
mod moments;
mod regression;
mod repeated;
mod summary;
mod table;

pub use anova::{OneWay, one_way};
pub use decimal::{Decimal, MAX_PLACES};
pub use distribution::{normal_cdf, normal_quantile, p_of_f, p_of_t, t_quantile};
pub use moments::{Moments, Spread};
pub use regression::{Regression, linear, regress};
pub use repeated::{Effect, Observation, Repeated, repeated};
pub use summary::{interval_of_mean, kurtosis, mad, median, quantile, skewness};
pub use table::{MAX_COLUMNS, Table};

/// Why there is no answer.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// Not a decimal number.
    #[error("expected a decimal number, found {found:?}")]
    NotANumber {
        /// The text.
        found: String,
    },
    /// More digits or a larger exponent than is handled exactly.
    #[error("expected at most {MAX_PLACES} decimal places and digits, found {found:?}")]
    TooLong {
        /// The beginning of the text.
        found: String,
    },
    /// Too few numbers.
    #[error("expected at least {expected} {what}, found {found}")]
    TooFew {
        /// What is counted.
        what: &'static str,
        /// The least count.
        expected: usize,
        /// The count.
        found: usize,
    },
    /// Columns of different lengths.
    #[error("expected {expected} values in column {column}, found {found}")]
    Length {
        /// Counted from 0.
        column: usize,
        /// As many as there are responses.
        expected: usize,
        /// The count.
        found: usize,
    },
    /// A predictor is a linear combination of those before it.
    #[error("expected independent predictors, found that number {column} follows from those before it")]
    Dependent {
        /// Counted from 0; the intercept, where there is one, is number 0.
        column: usize,
    },
    /// All values are the same, or all residuals are zero, so that a ratio has no value.
    #[error("expected {what} that vary, found none that does")]
    Constant {
        /// What does not vary.
        what: &'static str,
    },
    /// A subject lacks a cell of the design.
    #[error("expected every subject in every condition, found none of subject {subject:?} in {cell}")]
    MissingCell {
        /// Whose data are incomplete.
        subject: String,
        /// The levels.
        cell: String,
    },
    /// A subject belongs to two groups.
    #[error("expected each subject in one group, found subject {subject:?} in {first:?} and {second:?}")]
    TwoGroups {
        /// Who.
        subject: String,
        /// One group.
        first: String,
        /// The other.
        second: String,
    },
    /// Observations that name different numbers of factors.
    #[error("expected {expected} within-subject levels in each observation, found {found}")]
    Levels {
        /// As many as in the first observation.
        expected: usize,
        /// The count.
        found: usize,
    },
    /// A file of numbers is damaged.
    #[error("line {line}: {message}")]
    Table {
        /// Counted from 1.
        line: u64,
        /// What was expected and what was found.
        message: String,
    },
    /// A column that is not there.
    #[error("expected one of the columns {expected}, found {found:?}")]
    Column {
        /// Those that are there.
        expected: String,
        /// What was asked for.
        found: String,
    },
}
