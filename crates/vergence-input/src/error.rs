use crate::found::Found;

/// Why a device cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// It is there, and cannot be opened.
    #[error("{path}: cannot be opened: {reason}{}", remedy.as_ref().map_or_else(String::new, |r| format!("; this mends it: {r}")))]
    Open {
        /// Of the node.
        path: String,
        /// What the system said.
        reason: String,
        /// The command that mends it.
        remedy: Option<String>,
    },
    /// There is no such device.
    #[error("expected a device named by its path or name, found '{found}'; there is {there}")]
    NoDevice {
        /// As it was asked for.
        found: String,
        /// What there is.
        there: String,
    },
    /// A mapping or a description is wrong.
    #[error("{0}")]
    Config(#[from] vergence_config::Error),
    /// A line of a gamepads' mapping is wrong.
    #[error("{path}: {wrong}", path = path.display())]
    Mapping {
        /// Of the file.
        path: std::path::PathBuf,
        /// Which line, what was expected and found.
        wrong: String,
    },
    /// What the device says of itself cannot be understood.
    #[error("{device}: report descriptor: expected {expected}, found {found}")]
    Descriptor {
        /// Which.
        device: String,
        /// What was expected.
        expected: &'static str,
        /// What was found.
        found: String,
    },
    /// The device is gone.
    #[error("{device} is gone")]
    Gone {
        /// Which.
        device: String,
    },
}

impl Error {
    #[cfg_attr(
        not(any(feature = "serial", feature = "hid", feature = "gamepad", feature = "desktop")),
        allow(dead_code)
    )]
    pub(crate) fn open(found: &Found, reason: impl ToString) -> Self {
        let reason = found.problem.clone().unwrap_or_else(|| reason.to_string());
        Self::Open { path: found.path.clone(), reason, remedy: found.remedy.clone() }
    }
}
