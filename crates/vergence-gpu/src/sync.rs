//! What a resource is used for between barriers, and timelines that order work across queues, devices and the host.

use std::sync::Arc;

use ash::vk;

use crate::census::Counters;
use crate::device::Device;
use crate::driver_clock::quick;
use crate::error::{At, Error};

/// What a resource is used for, before or after a barrier: stages, accesses and (for images) the layout in one word.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Use {
    /// Nothing before: the content is lost, and nothing is waited for.
    Undefined,
    /// Colour attachment (also the target of a resolve).
    ColorAttachment,
    /// Depth attachment that is tested and written (also the target of a depth resolve).
    DepthAttachment,
    /// Depth attachment that is only tested, and may be sampled in the fragment stage at the same time.
    DepthReadOnly,
    /// Sampled by fragment shaders.
    Sampled,
    /// Sampled by compute shaders.
    SampledCompute,
    /// Sampled by vertex, fragment and compute shaders.
    SampledAny,
    /// Storage image or storage buffer that compute shaders read and write.
    Storage,
    /// Storage buffer that vertex or fragment shaders read.
    StorageRead,
    /// Uniform buffer of any stage.
    Uniform,
    /// Vertex buffer.
    Vertex,
    /// Index buffer.
    Index,
    /// Arguments of indirect draws or dispatches.
    Indirect,
    /// Source of a copy or blit.
    TransferSource,
    /// Destination of a copy, blit or clear.
    TransferDestination,
    /// Read by the host after the submission is complete.
    HostRead,
    /// Written by the host before the submission (only needed inside one command buffer: submission itself orders host writes).
    HostWrite,
    /// Presented to a window.
    Present,
    /// Anything, for whoever does not know; waits for everything (layout `GENERAL`).
    General,
}

impl Use {
    /// Stages and accesses.
    pub(crate) fn scope(self) -> (vk::PipelineStageFlags2, vk::AccessFlags2) {
        use vk::{AccessFlags2 as A, PipelineStageFlags2 as S};
        match self {
            Self::Undefined => (S::NONE, A::NONE),
            Self::ColorAttachment => {
                (S::COLOR_ATTACHMENT_OUTPUT, A::COLOR_ATTACHMENT_READ | A::COLOR_ATTACHMENT_WRITE)
            }
            // A depth resolve runs in the colour output stage with colour accesses, by the specification.
            Self::DepthAttachment => (
                S::EARLY_FRAGMENT_TESTS | S::LATE_FRAGMENT_TESTS | S::COLOR_ATTACHMENT_OUTPUT,
                A::DEPTH_STENCIL_ATTACHMENT_READ
                    | A::DEPTH_STENCIL_ATTACHMENT_WRITE
                    | A::COLOR_ATTACHMENT_READ
                    | A::COLOR_ATTACHMENT_WRITE,
            ),
            Self::DepthReadOnly => (
                S::EARLY_FRAGMENT_TESTS | S::LATE_FRAGMENT_TESTS | S::FRAGMENT_SHADER,
                A::DEPTH_STENCIL_ATTACHMENT_READ | A::SHADER_SAMPLED_READ,
            ),
            Self::Sampled => (S::FRAGMENT_SHADER, A::SHADER_SAMPLED_READ),
            Self::SampledCompute => (S::COMPUTE_SHADER, A::SHADER_SAMPLED_READ),
            Self::SampledAny => {
                (S::VERTEX_SHADER | S::FRAGMENT_SHADER | S::COMPUTE_SHADER, A::SHADER_SAMPLED_READ)
            }
            Self::Storage => (S::COMPUTE_SHADER, A::SHADER_STORAGE_READ | A::SHADER_STORAGE_WRITE),
            Self::StorageRead => (S::VERTEX_SHADER | S::FRAGMENT_SHADER, A::SHADER_STORAGE_READ),
            Self::Uniform => (S::VERTEX_SHADER | S::FRAGMENT_SHADER | S::COMPUTE_SHADER, A::UNIFORM_READ),
            Self::Vertex => (S::VERTEX_ATTRIBUTE_INPUT, A::VERTEX_ATTRIBUTE_READ),
            Self::Index => (S::INDEX_INPUT, A::INDEX_READ),
            Self::Indirect => (S::DRAW_INDIRECT, A::INDIRECT_COMMAND_READ),
            Self::TransferSource => (S::ALL_TRANSFER, A::TRANSFER_READ),
            Self::TransferDestination => (S::ALL_TRANSFER, A::TRANSFER_WRITE),
            Self::HostRead => (S::HOST, A::HOST_READ),
            Self::HostWrite => (S::HOST, A::HOST_WRITE),
            // The semaphore of the presentation makes the writes visible.
            Self::Present => (S::NONE, A::NONE),
            Self::General => (S::ALL_COMMANDS, A::MEMORY_READ | A::MEMORY_WRITE),
        }
    }

    /// Layout of an image in this use.
    pub fn layout(self) -> vk::ImageLayout {
        use vk::ImageLayout as L;
        match self {
            Self::Undefined => L::UNDEFINED,
            Self::ColorAttachment => L::COLOR_ATTACHMENT_OPTIMAL,
            // The layouts in which OpenXR hands out depth images; right for formats without stencil too.
            Self::DepthAttachment => L::DEPTH_STENCIL_ATTACHMENT_OPTIMAL,
            Self::DepthReadOnly => L::DEPTH_STENCIL_READ_ONLY_OPTIMAL,
            Self::Sampled | Self::SampledCompute | Self::SampledAny => L::SHADER_READ_ONLY_OPTIMAL,
            Self::TransferSource => L::TRANSFER_SRC_OPTIMAL,
            Self::TransferDestination => L::TRANSFER_DST_OPTIMAL,
            Self::Present => L::PRESENT_SRC_KHR,
            _ => L::GENERAL,
        }
    }

    fn writes(self) -> bool {
        matches!(
            self,
            Self::ColorAttachment
                | Self::DepthAttachment
                | Self::Storage
                | Self::TransferDestination
                | Self::HostWrite
                | Self::General
        )
    }

    /// The source half of a barrier: only writes need to be made available.
    pub(crate) fn source(self) -> (vk::PipelineStageFlags2, vk::AccessFlags2) {
        let (stages, access) = self.scope();
        (stages, if self.writes() { access } else { vk::AccessFlags2::NONE })
    }
}

/// A timeline semaphore: a number that only grows, signalled and waited for by submissions and by the host.
pub struct Timeline {
    pub(crate) raw: vk::Semaphore,
    device: Arc<Device>,
}

impl Timeline {
    /// Makes a timeline that starts at `value`.
    ///
    /// # Errors
    ///
    /// When the driver refuses.
    pub fn new(device: &Arc<Device>, value: u64) -> Result<Arc<Self>, Error> {
        let mut kind = vk::SemaphoreTypeCreateInfo::default()
            .semaphore_type(vk::SemaphoreType::TIMELINE)
            .initial_value(value);
        let info = vk::SemaphoreCreateInfo::default().push_next(&mut kind);
        // SAFETY: timeline semaphores are enabled on every device.
        let raw = unsafe { device.raw.create_semaphore(&info, None) }.at("vkCreateSemaphore")?;
        Counters::add(&device.counters.timelines, 1);
        Ok(Arc::new(Self { raw, device: Arc::clone(device) }))
    }

    /// The device that it lives on.
    pub fn device(&self) -> &Arc<Device> {
        &self.device
    }

    /// Its value now.
    ///
    /// # Errors
    ///
    /// When the device is lost.
    pub fn value(&self) -> Result<u64, Error> {
        // SAFETY: the semaphore is a timeline.
        quick(|| unsafe { self.device.raw.get_semaphore_counter_value(self.raw) })
            .at("vkGetSemaphoreCounterValue")
    }

    /// Waits on the host until the value is reached, at most `timeout_ns`.
    ///
    /// # Errors
    ///
    /// [`Error::Timeout`], or a lost device.
    pub fn wait(&self, value: u64, timeout_ns: u64) -> Result<(), Error> {
        self.device.wait_semaphore(self.raw, value, timeout_ns, "a timeline")
    }

    /// Sets the value from the host; it must grow, also in the order of signals that are still pending.
    ///
    /// # Errors
    ///
    /// A value that is not larger than the present one.
    pub fn signal(&self, value: u64) -> Result<(), Error> {
        let now = self.value()?;
        if value <= now {
            return Err(Error::range("value of a timeline", format_args!("more than {now}"), value));
        }
        let info = vk::SemaphoreSignalInfo::default().semaphore(self.raw).value(value);
        // SAFETY: the semaphore is a timeline, and the value is larger than its present one.
        quick(|| unsafe { self.device.raw.signal_semaphore(&info) }).at("vkSignalSemaphore")
    }
}

impl Drop for Timeline {
    fn drop(&mut self) {
        // SAFETY: command buffers whose submission uses it hold an Arc of it until they are complete.
        unsafe { self.device.raw.destroy_semaphore(self.raw, None) };
        Counters::sub(&self.device.counters.timelines, 1);
    }
}
