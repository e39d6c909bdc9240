use openxr::sys;

use crate::State;

/// Why a headset cannot be used, or no longer.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The loader's library is not installed.
    #[error(
        "no OpenXR loader: expected libopenxr_loader.so.1, found none ({detail}); install libopenxr-loader1"
    )]
    NoLoader {
        /// What the dynamic linker said.
        detail: String,
    },
    /// No runtime is installed, or none answers.
    #[error(
        "no OpenXR runtime answers ({call}: {result}); start the headset's software, or name its manifest in \
         XR_RUNTIME_JSON"
    )]
    NoRuntime {
        /// The call that failed.
        call: &'static str,
        /// How.
        result: sys::Result,
    },
    /// The runtime has no headset now.
    #[error("the OpenXR runtime {runtime} has no headset: expected one connected, found none ({result})")]
    NoHeadset {
        /// Its name.
        runtime: String,
        /// What it said.
        result: sys::Result,
    },
    /// The runtime lacks an extension without which nothing works.
    #[error(
        "the OpenXR runtime {runtime} lacks {name}: expected it among the extensions, found {found} others"
    )]
    MissingExtension {
        /// The runtime's name, where it is known.
        runtime: String,
        /// The extension.
        name: String,
        /// How many it has.
        found: usize,
    },
    /// The headset wants something that is not built here.
    #[error("{what}: expected {expected}, found {found}")]
    Unsupported {
        /// What does not fit.
        what: &'static str,
        /// What is supported.
        expected: String,
        /// What the runtime offers.
        found: String,
    },
    /// The session is lost; a new one may be asked for.
    #[error("the session was lost ({call}); it can be asked for anew")]
    SessionLost {
        /// The call that noticed.
        call: &'static str,
    },
    /// The runtime is gone; everything must be made anew.
    #[error("the OpenXR runtime was lost ({call}); it can be connected to anew")]
    InstanceLost {
        /// The call that noticed.
        call: &'static str,
    },
    /// A call failed.
    #[error("{call}: {result}")]
    Call {
        /// The call.
        call: &'static str,
        /// How.
        result: sys::Result,
    },
    /// Vulkan failed.
    #[error(transparent)]
    Gpu(#[from] vergence_gpu::Error),
}

impl Error {
    /// The state in which this leaves the user.
    pub const fn state(&self) -> State {
        match self {
            Self::NoRuntime { .. } | Self::NoHeadset { .. } => State::WaitingForRuntime,
            Self::SessionLost { .. } | Self::InstanceLost { .. } => State::Lost { retry: true },
            Self::Call { .. } => State::Lost { retry: false },
            Self::NoLoader { .. }
            | Self::MissingExtension { .. }
            | Self::Unsupported { .. }
            | Self::Gpu(_) => State::Flat,
        }
    }

    pub(crate) fn of(call: &'static str, result: sys::Result) -> Self {
        match result {
            sys::Result::ERROR_SESSION_LOST => Self::SessionLost { call },
            sys::Result::ERROR_INSTANCE_LOST | sys::Result::ERROR_RUNTIME_UNAVAILABLE => {
                Self::InstanceLost { call }
            }
            result => Self::Call { call, result },
        }
    }
}

/// Names the call in the error.
pub(crate) trait In<T> {
    fn during(self, call: &'static str) -> Result<T, Error>;
}

impl<T> In<T> for Result<T, sys::Result> {
    fn during(self, call: &'static str) -> Result<T, Error> {
        self.map_err(|result| Error::of(call, result))
    }
}

/// The answer of a raw call: success (also a qualified one) or the error.
pub(crate) fn check(call: &'static str, result: sys::Result) -> Result<sys::Result, Error> {
    if result.into_raw() >= 0 { Ok(result) } else { Err(Error::of(call, result)) }
}
