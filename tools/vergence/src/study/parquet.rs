//! Tables as Parquet, in builds with the feature `parquet`; elsewhere, what to do about it.

#[cfg(feature = "parquet")]
pub use with::{available, text, write};
#[cfg(not(feature = "parquet"))]
pub use without::{available, text, write};

#[cfg(feature = "parquet")]
mod with {
    use std::fs::File;
    use std::path::Path;

    use vergence_study::{ParquetText, parquet_text, write_parquet};

    use crate::failure::Failure;

    /// Whether this build has it.
    #[expect(clippy::unnecessary_wraps, reason = "other builds have not")]
    pub fn available() -> Result<(), Failure> {
        Ok(())
    }

    /// The rows of a file as text.
    pub fn text(file: &Path) -> Result<ParquetText, Failure> {
        let input =
            File::open(file).map_err(|error| Failure::Call(format!("{}: {error}", file.display())))?;
        parquet_text(input).map_err(|error| Failure::Work(format!("{}: {error}", file.display())))
    }

    /// Writes a table.
    pub fn write(file: &Path, table: &str) -> Result<(), Failure> {
        let failed = |error: &dyn std::fmt::Display| Failure::Work(format!("{}: {error}", file.display()));
        let output = File::create(file).map_err(|error| failed(&error))?;
        write_parquet(table, output).map_err(|error| failed(&error))
    }
}

#[cfg(not(feature = "parquet"))]
mod without {
    use std::path::Path;

    use crate::failure::Failure;

    /// Whether this build has it.
    pub fn available() -> Result<(), Failure> {
        Err(Failure::Call(
            "this build has no Parquet: cargo build --release -p vergence --features parquet makes one that has".to_owned(),
        ))
    }

    /// The rows of a file as text.
    pub fn text(_: &Path) -> Result<std::io::Empty, Failure> {
        available().map(|()| std::io::empty())
    }

    /// Writes a table.
    pub fn write(_: &Path, _: &str) -> Result<(), Failure> {
        available()
    }
}
