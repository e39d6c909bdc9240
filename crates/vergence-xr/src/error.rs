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
    /// The display has no such rate.
    #[error("the display cannot run at {wanted_hz} Hz: expected one of {offered}")]
    RefreshRate {
        /// What was asked for.
        wanted_hz: f32,
        /// What there is.
        offered: String,
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
    /// The runtime contradicts itself; a new session may do better.
    #[error("{call}: expected {expected}, found {found}")]
    Contradiction {
        /// The call.
        call: &'static str,
        /// What it said before.
        expected: String,
        /// What it says now.
        found: String,
    },
    /// A call does not return. Nothing of the session can be taken down: whoever holds it leaves it as it is
    /// ([`Client::abandon`](crate::Client::abandon)).
    #[error(
        "the OpenXR runtime does not return from {call}: expected an answer within {waited_s} s, found none; restart the \
         headset's software"
    )]
    Hung {
        /// The call.
        call: &'static str,
        /// How long it was waited for, seconds.
        waited_s: f64,
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
            Self::SessionLost { .. } | Self::InstanceLost { .. } | Self::Contradiction { .. } => {
                State::Lost { retry: true }
            }
            Self::Hung { .. } => State::Lost { retry: false },
            Self::Call { result, .. } if is_refusal(*result) => State::Flat,
            // What a runtime failed to do once, a new session may be able to do.
            Self::Call { .. } => State::Lost { retry: true },
            Self::NoLoader { .. }
            | Self::MissingExtension { .. }
            | Self::Unsupported { .. }
            | Self::RefreshRate { .. }
            | Self::Gpu(_) => State::Flat,
        }
    }

    /// What is missing, in a few words, where something is; else the whole sentence.
    pub fn brief(&self) -> String {
        match self {
            Self::NoLoader { .. } => "no OpenXR loader is installed".to_owned(),
            Self::NoRuntime { .. } => "no OpenXR runtime answers".to_owned(),
            Self::NoHeadset { runtime, .. } => format!("the OpenXR runtime {runtime} has no headset"),
            other => other.to_string(),
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

/// Whether the runtime says that it never does such a thing, so that asking again is of no use.
const fn is_refusal(result: sys::Result) -> bool {
    matches!(
        result,
        sys::Result::ERROR_FUNCTION_UNSUPPORTED
            | sys::Result::ERROR_FEATURE_UNSUPPORTED
            | sys::Result::ERROR_EXTENSION_NOT_PRESENT
            | sys::Result::ERROR_EXTENSION_DEPENDENCY_NOT_ENABLED
            | sys::Result::ERROR_API_VERSION_UNSUPPORTED
            | sys::Result::ERROR_API_LAYER_NOT_PRESENT
            | sys::Result::ERROR_FORM_FACTOR_UNSUPPORTED
            | sys::Result::ERROR_VIEW_CONFIGURATION_TYPE_UNSUPPORTED
            | sys::Result::ERROR_ENVIRONMENT_BLEND_MODE_UNSUPPORTED
            | sys::Result::ERROR_REFERENCE_SPACE_UNSUPPORTED
            | sys::Result::ERROR_PATH_UNSUPPORTED
            | sys::Result::ERROR_SWAPCHAIN_FORMAT_UNSUPPORTED
            | sys::Result::ERROR_DISPLAY_REFRESH_RATE_UNSUPPORTED_FB
    )
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
