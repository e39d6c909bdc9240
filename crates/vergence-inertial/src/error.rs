use std::path::PathBuf;

/// What can go wrong with recordings and states.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file cannot be opened or read.
    #[error("{}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file says something else than was expected.
    #[error("{}:{line}:{column}: expected {expected}, found {found}", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: u64,
        /// Column of the table, from 1; for a fault of the whole line, 1.
        column: usize,
        /// What should stand there.
        expected: String,
        /// What stands there.
        found: String,
    },
    /// A file's compressed data end too early or are damaged.
    #[error("{}:{line}:1: expected more compressed data, found {source}", path.display())]
    Compressed {
        /// The file.
        path: PathBuf,
        /// The line that could not be read to its end.
        line: u64,
        /// What the decompression says.
        source: std::io::Error,
    },
    /// Bytes that are no state of this filter.
    #[error("expected the {expected} bytes of this filter's state, found {found} bytes that are not")]
    State {
        /// Length of this filter's state.
        expected: usize,
        /// Length of what was given.
        found: usize,
    },
    /// An estimate and a truth that cannot be compared.
    #[error("{path}: expected {expected}, found {found}", path = path.display())]
    Mismatch {
        /// The file with the estimate.
        path: PathBuf,
        /// What the truth asks for.
        expected: String,
        /// What the estimate has.
        found: String,
    },
    /// A recording that does not hold what the work takes.
    #[error("expected {expected}, found {found}")]
    Unusable {
        /// What it takes.
        expected: String,
        /// What is there.
        found: String,
    },
    /// Parameters that cannot be used.
    #[error(transparent)]
    Config(#[from] vergence_config::Error),
}
