use std::path::{Path, PathBuf};

/// Why a headset profile or a motion cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The TOML file cannot be read or says something wrong.
    #[error(transparent)]
    Config(#[from] vergence_config::Error),
    /// A name that is neither a file nor built in.
    #[error("{kind} \"{name}\": expected a file or one of {known}, found neither")]
    Unknown {
        /// "headset profile" or "motion".
        kind: &'static str,
        /// What was asked for.
        name: String,
        /// The built-in names.
        known: String,
    },
    /// The trajectory cannot be read.
    #[error("{path}: {source}{hint}")]
    Trajectory {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
        /// What to do about it, or nothing.
        hint: String,
    },
    /// A line of the trajectory is wrong.
    #[error("{path}:{line}: expected {expected}, found {found}")]
    Tum {
        /// Which file.
        path: PathBuf,
        /// Counted from 1.
        line: usize,
        /// What would be right.
        expected: &'static str,
        /// What is there.
        found: String,
    },
    /// A fault that the runtime cannot show.
    #[error("fault \"{text}\": expected {expected}, found {found}")]
    Fault {
        /// What was asked for.
        text: String,
        /// What there is.
        expected: String,
        /// What is there instead.
        found: String,
    },
}

impl Error {
    /// A file says something that no headset and no motion can be, at the value of `key`.
    pub(crate) fn value(path: &Path, text: &str, key: &str, message: &str) -> Self {
        vergence_config::invalid_key(path, text, key, message).into()
    }
}
