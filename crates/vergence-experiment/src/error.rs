use std::path::{Path, PathBuf};

/// Why a study cannot go on, or its data cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// What was asked makes no sense here.
    #[error("{0}")]
    Call(String),
    /// A file of the study's folder cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file of the study's folder is not what it should be.
    #[error("{}: expected {expected}, found {found}", path.display())]
    Damaged {
        /// Which.
        path: PathBuf,
        /// What it should be.
        expected: String,
        /// What it is.
        found: String,
    },
    /// The study file is wrong, or measures cannot be had.
    #[error(transparent)]
    Study(#[from] vergence_study::Error),
    /// The log cannot be written or read.
    #[error(transparent)]
    Log(#[from] vergence_log::Error),
}

impl Error {
    pub(crate) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        move |source| Self::Io { path: path.to_owned(), source }
    }

    /// Whether the call was wrong, rather than the work.
    pub fn is_wrong_call(&self) -> bool {
        matches!(self, Self::Call(_))
    }
}
