//! Rows that a query finds, in builds with the feature `sql`; elsewhere, what to do about it.

use std::io::Read;
use std::path::PathBuf;

use vergence_study::ColumnMap;

use crate::failure::Failure;

/// The rows that `query` finds in `files`, as the text of a table with commas.
#[cfg(feature = "sql")]
pub fn rows(files: &[PathBuf], map: &ColumnMap, query: &str) -> Result<impl Read + Send + use<>, Failure> {
    vergence_study::sql_text(files, map, query).map_err(|error| Failure::Work(error.to_string()))
}

/// Says what build has it.
#[cfg(not(feature = "sql"))]
pub fn rows(_: &[PathBuf], _: &ColumnMap, _: &str) -> Result<impl Read + Send + use<>, Failure> {
    Err::<std::io::Empty, _>(Failure::Call(
        "this build has no SQL: cargo build --release -p vergence --features sql makes one that has"
            .to_owned(),
    ))
}
