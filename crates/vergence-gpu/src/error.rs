//! What can go wrong, each as one sentence that a user can act on.

use ash::vk;

/// Why a graphics operation could not be done.
#[derive(Debug, Clone, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The Vulkan loader library is not on this machine.
    #[error(
        "no Vulkan loader found ({detail}); install it with `apt-get install libvulkan1 mesa-vulkan-drivers`"
    )]
    NoLoader {
        /// What the dynamic linker said.
        detail: String,
    },
    /// The loader itself is too old.
    #[error("expected a Vulkan loader of version 1.3 or newer, found {found}; update libvulkan1")]
    OldLoader {
        /// Version of the loader.
        found: String,
    },
    /// The loader found no driver with a device.
    #[error(
        "no Vulkan device found ({detail}); install a driver, for example `apt-get install mesa-vulkan-drivers` (it includes a software device)"
    )]
    NoDevice {
        /// What was found instead.
        detail: String,
    },
    /// There are devices, but none can do what is required.
    #[error("expected a Vulkan 1.3 device with {required}, found only: {found}; update the graphics driver")]
    Unsuitable {
        /// What is required.
        required: &'static str,
        /// Each device and what it lacks.
        found: String,
    },
    /// The environment variable `VERGENCE_GPU` names no device.
    #[error(
        "expected VERGENCE_GPU to be an index or a part of the name of a Vulkan device, found {wanted:?}; there are: {found}"
    )]
    NoSuchDevice {
        /// Content of the variable.
        wanted: String,
        /// The devices by index and name.
        found: String,
    },
    /// A Vulkan extension is required and not there.
    #[error("expected the Vulkan extension {name}, which {by} does not offer")]
    MissingExtension {
        /// Name of the extension.
        name: String,
        /// Who was asked.
        by: String,
    },
    /// The device can not give what was asked for.
    #[error("{device} cannot give {asked}; it can give {offered}")]
    Unsupported {
        /// Name of the device.
        device: String,
        /// What was asked for.
        asked: String,
        /// What is possible.
        offered: String,
    },
    /// A creator (an OpenXR runtime) refused to make an instance or device.
    #[error("{call} failed: {detail}")]
    Creator {
        /// The call that failed.
        call: &'static str,
        /// What it said.
        detail: String,
    },
    /// A Vulkan call failed.
    #[error("{call} failed: {result}")]
    Vulkan {
        /// The call that failed.
        call: &'static str,
        /// What it returned.
        result: vk::Result,
    },
    /// The device stopped working; everything made from it must be made anew.
    #[error("the graphics device was lost in {call}; make the device and everything on it anew")]
    DeviceLost {
        /// The call that noticed.
        call: &'static str,
    },
    /// There is no memory for an object.
    #[error("no graphics memory for {name} ({bytes} bytes): {detail}")]
    Memory {
        /// Name of the object.
        name: String,
        /// Size of the request in bytes.
        bytes: u64,
        /// What the allocator said.
        detail: String,
    },
    /// An argument is outside of the object it refers to.
    #[error("{what}: expected {expected}, found {found}")]
    Range {
        /// What was checked.
        what: &'static str,
        /// What is allowed.
        expected: String,
        /// What was given.
        found: String,
    },
    /// Commands were recorded in an order or state that is not allowed.
    #[error("recording of {name}: {detail}")]
    Recording {
        /// Name of the command buffer.
        name: String,
        /// The first thing that was wrong.
        detail: &'static str,
    },
    /// The device did not finish in time.
    #[error("the graphics device did not finish {what} within {timeout_ms} ms")]
    Timeout {
        /// What was waited for.
        what: &'static str,
        /// How long, in milliseconds.
        timeout_ms: u64,
    },
    /// A window cannot be presented to.
    #[error("the window cannot be presented to: {detail}")]
    Surface {
        /// Why.
        detail: String,
    },
}

impl Error {
    /// For implementors of [`VulkanCreator`](crate::VulkanCreator): `call` failed with `detail`.
    pub fn creator(call: &'static str, detail: impl Into<String>) -> Self {
        Self::Creator { call, detail: detail.into() }
    }

    pub(crate) fn range(
        what: &'static str,
        expected: impl std::fmt::Display,
        found: impl std::fmt::Display,
    ) -> Self {
        Self::Range { what, expected: expected.to_string(), found: found.to_string() }
    }
}

/// Names the call that failed.
pub(crate) trait At<T> {
    /// The value, or an error that names `call`.
    fn at(self, call: &'static str) -> Result<T, Error>;
}

impl<T> At<T> for Result<T, vk::Result> {
    fn at(self, call: &'static str) -> Result<T, Error> {
        self.map_err(|result| match result {
            vk::Result::ERROR_DEVICE_LOST => Error::DeviceLost { call },
            result => Error::Vulkan { call, result },
        })
    }
}
