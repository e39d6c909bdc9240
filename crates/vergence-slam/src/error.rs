use std::path::{Path, PathBuf};

/// What can go wrong with recordings and trajectories.
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
    /// A file or folder is not what was expected.
    #[error("{}: expected {expected}, found {found}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What it should be.
        expected: String,
        /// What it is.
        found: String,
    },
    /// A line of a file says something else than was expected.
    #[error("{}:{line}:{column}: expected {expected}, found {found}", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Column or word, from 1.
        column: usize,
        /// What should stand there.
        expected: String,
        /// What stands there.
        found: String,
    },
    /// A calibration that no lens has.
    #[error("{}: {source}", path.display())]
    Lens {
        /// The file.
        path: PathBuf,
        /// Why.
        source: vergence_geom::LensError,
    },
    /// The inertial unit's recording.
    #[error(transparent)]
    Inertial(#[from] vergence_inertial::Error),
    /// Pictures or knobs that the tracker cannot take.
    #[error(transparent)]
    Vision(#[from] vergence_vision::Error),
    /// A knob of the estimator outside of its range.
    #[error("{name}: expected {expected}, found {found}")]
    Knob {
        /// Its name.
        name: &'static str,
        /// Its range.
        expected: &'static str,
        /// What was asked for.
        found: f64,
    },
    /// A calibration whose cameras sit otherwise than pictures and readings show.
    #[error("{}: expected cameras that see what their calibration says, found {misfit}", name.display())]
    Mounting {
        /// Of the recording.
        name: PathBuf,
        /// Which camera.
        misfit: crate::Misfit,
    },
    /// Two trajectories that cannot be compared.
    #[error("expected {expected}, found {found}")]
    Unmatched {
        /// What comparing takes.
        expected: String,
        /// What is there.
        found: String,
    },
}

impl Error {
    pub(crate) fn file(path: &Path, expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self::File { path: path.to_owned(), expected: expected.into(), found: found.into() }
    }

    pub(crate) fn content(
        path: &Path,
        (line, column): (usize, usize),
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> Self {
        Self::Content { path: path.to_owned(), line, column, expected: expected.into(), found: found.into() }
    }

    pub(crate) fn read(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Read { path, source }
    }
}
