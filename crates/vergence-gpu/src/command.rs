//! Command buffers: recorded through an encoder, submitted to the device's queue, kept until complete.
//!
//! A command buffer holds an `Arc` of everything that was recorded into it until it is recorded anew or dropped, both of which
//! wait for its last submission. So nothing that the device may still use is ever destroyed. In steady state neither recording
//! nor submission allocates.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use ash::vk;

use crate::buffer::Buffer;
use crate::census::Counters;
use crate::descriptor::DescriptorSet;
use crate::device::Device;
use crate::driver_clock::{blocking, quick};
use crate::encoder::Encoder;
use crate::error::{At, Error};
use crate::image::{Image, ImageView};
use crate::pipeline::{ComputePipeline, GraphicsPipeline};
use crate::sync::Timeline;

/// Most semaphores of each kind in one submission.
const MAX_SEMAPHORES: usize = 8;

/// Anything that a command buffer keeps alive.
pub(crate) trait Kept: Send + Sync {
    /// The device that it lives on.
    fn home(&self) -> &Device;
}

impl Kept for Buffer {
    fn home(&self) -> &Device {
        self.device()
    }
}

impl Kept for Image {
    fn home(&self) -> &Device {
        self.device()
    }
}

impl Kept for ImageView {
    fn home(&self) -> &Device {
        self.image().device()
    }
}

impl Kept for DescriptorSet {
    fn home(&self) -> &Device {
        self.layout().device()
    }
}

impl Kept for GraphicsPipeline {
    fn home(&self) -> &Device {
        self.layout().device()
    }
}

impl Kept for ComputePipeline {
    fn home(&self) -> &Device {
        self.layout().device()
    }
}

impl Kept for Timeline {
    fn home(&self) -> &Device {
        self.device()
    }
}

/// How long a pass took on the device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PassTime {
    /// Name given to [`Encoder::begin_pass`].
    pub name: &'static str,
    /// Time on the device, in nanoseconds.
    pub ns: f64,
}

/// The queries behind [`Encoder::begin_pass`].
pub(crate) struct Timer {
    pub pool: vk::QueryPool,
    pub capacity: u32,
    pub names: Vec<&'static str>,
    raw: Vec<u64>,
    results: Vec<PassTime>,
    unread: bool,
    pub overflow: bool,
}

/// A command buffer with its own pool; one per frame in flight.
pub struct CommandBuffer {
    pub(crate) device: Arc<Device>,
    pub(crate) raw: vk::CommandBuffer,
    pub(crate) kept: Vec<Arc<dyn Kept>>,
    /// Timelines of the last submission.
    timelines: Vec<Arc<Timeline>>,
    pub(crate) timer: Option<Timer>,
    pub(crate) executable: bool,
    pool: vk::CommandPool,
    name: String,
    pending: u64,
}

/// A timeline that a submission waits for.
#[derive(Clone, Copy)]
pub struct Wait<'a> {
    /// The timeline.
    pub timeline: &'a Arc<Timeline>,
    /// The value that it must reach.
    pub value: u64,
    /// The first stages that wait.
    pub stages: vk::PipelineStageFlags2,
}

/// A timeline that a submission signals when it is complete.
#[derive(Clone, Copy)]
pub struct Signal<'a> {
    /// The timeline.
    pub timeline: &'a Arc<Timeline>,
    /// The value that it gets.
    pub value: u64,
}

impl CommandBuffer {
    /// Makes an empty command buffer that can time `timed_passes` passes (0 for none).
    ///
    /// # Errors
    ///
    /// No memory.
    pub fn new(device: &Arc<Device>, name: &str, timed_passes: u32) -> Result<Self, Error> {
        let info = vk::CommandPoolCreateInfo::default().queue_family_index(device.queue_family);
        // SAFETY: the queue family is the device's own.
        let pool = unsafe { device.raw.create_command_pool(&info, None) }.at("vkCreateCommandPool")?;
        Counters::add(&device.counters.command_buffers, 1);
        let mut this = Self {
            device: Arc::clone(device),
            raw: vk::CommandBuffer::null(),
            kept: Vec::new(),
            timelines: Vec::new(),
            timer: None,
            executable: false,
            pool,
            name: name.into(),
            pending: 0,
        };
        let info = vk::CommandBufferAllocateInfo::default().command_pool(pool).command_buffer_count(1);
        // SAFETY: the pool was just made.
        this.raw = unsafe { device.raw.allocate_command_buffers(&info) }.at("vkAllocateCommandBuffers")?[0];
        device.name(this.raw, name);
        if timed_passes > 0 && device.limits().timestamp_period_ns > 0.0 {
            let info = vk::QueryPoolCreateInfo::default()
                .query_type(vk::QueryType::TIMESTAMP)
                .query_count(2 * timed_passes);
            // SAFETY: the create info is complete.
            let pool = unsafe { device.raw.create_query_pool(&info, None) }.at("vkCreateQueryPool")?;
            this.timer = Some(Timer {
                pool,
                capacity: timed_passes,
                names: Vec::with_capacity(timed_passes as usize),
                raw: vec![0; 2 * timed_passes as usize],
                results: Vec::with_capacity(timed_passes as usize),
                unread: false,
                overflow: false,
            });
        }
        Ok(this)
    }

    /// Waits for the last submission of this command buffer, forgets its content and starts to record anew.
    ///
    /// # Errors
    ///
    /// A lost device.
    pub fn record(&mut self) -> Result<Encoder<'_>, Error> {
        self.wait()?;
        self.fetch_times()?;
        self.kept.clear();
        self.executable = false;
        // SAFETY: the last submission is complete, so the pool's one buffer is not pending.
        blocking(|| unsafe {
            self.device.raw.reset_command_pool(self.pool, vk::CommandPoolResetFlags::empty())
        })
        .at("vkResetCommandPool")?;
        // SAFETY: the buffer was just reset.
        blocking(|| unsafe {
            self.device.raw.begin_command_buffer(self.raw, &vk::CommandBufferBeginInfo::default())
        })
        .at("vkBeginCommandBuffer")?;
        if let Some(timer) = &mut self.timer {
            timer.names.clear();
            timer.unread = false;
            timer.overflow = false;
            // SAFETY: the buffer is recording, outside of rendering.
            quick(|| unsafe {
                self.device.raw.cmd_reset_query_pool(self.raw, timer.pool, 0, 2 * timer.capacity)
            });
        }
        Ok(Encoder::new(self))
    }

    /// Name given when it was made.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Number of the last submission, 0 before the first.
    pub fn submission(&self) -> u64 {
        self.pending
    }

    /// Waits until the last submission is complete.
    ///
    /// # Errors
    ///
    /// A lost device, or one that does not finish within a minute.
    pub fn wait(&mut self) -> Result<(), Error> {
        self.device.wait(self.pending)
    }

    /// Times of the passes of the last submission, in the order in which they were begun; waits for it. Empty where the device has
    /// no timestamps or nothing was timed.
    ///
    /// # Errors
    ///
    /// A lost device.
    pub fn pass_times(&mut self) -> Result<&[PassTime], Error> {
        self.wait()?;
        self.fetch_times()?;
        Ok(self.timer.as_ref().map_or(&[], |timer| &timer.results))
    }

    fn fetch_times(&mut self) -> Result<(), Error> {
        let limits = self.device.limits();
        let (period, bits) = (f64::from(limits.timestamp_period_ns), limits.timestamp_bits);
        let Some(timer) = self.timer.as_mut().filter(|timer| timer.unread) else { return Ok(()) };
        timer.unread = false;
        timer.results.clear();
        if timer.names.is_empty() {
            return Ok(());
        }
        let raw = &mut timer.raw[..2 * timer.names.len()];
        // SAFETY: the pool has these queries, and the submission that wrote them is complete.
        blocking(|| unsafe {
            self.device.raw.get_query_pool_results(timer.pool, 0, raw, vk::QueryResultFlags::TYPE_64)
        })
        .at("vkGetQueryPoolResults")?;
        let mask = if bits >= 64 { u64::MAX } else { (1 << bits) - 1 };
        for (name, ticks) in timer.names.iter().zip(raw.chunks_exact(2)) {
            timer
                .results
                .push(PassTime { name, ns: (ticks[1].wrapping_sub(ticks[0]) & mask) as f64 * period });
        }
        Ok(())
    }
}

impl Drop for CommandBuffer {
    fn drop(&mut self) {
        match self.wait() {
            Ok(()) | Err(Error::DeviceLost { .. }) => {}
            // The device may still be at it: what it uses is left to it for good rather than destroyed under its hands.
            Err(error) => {
                log::error!("{}: {error}; its memory is not given back", self.name);
                std::mem::forget(std::mem::take(&mut self.kept));
                std::mem::forget(std::mem::take(&mut self.timelines));
                std::mem::forget(Arc::clone(&self.device));
                return;
            }
        }
        if let Some(timer) = &self.timer {
            // SAFETY: the last submission is complete (or the device is lost, which allows destruction).
            unsafe { self.device.raw.destroy_query_pool(timer.pool, None) };
        }
        // SAFETY: as above; the buffer goes with its pool.
        unsafe { self.device.raw.destroy_command_pool(self.pool, None) };
        Counters::sub(&self.device.counters.command_buffers, 1);
    }
}

impl Device {
    /// Submits recorded commands; returns the number of the submission, for [`Device::wait`].
    ///
    /// A command buffer may be submitted again without being recorded again; its earlier submission is waited for.
    ///
    /// # Errors
    ///
    /// Commands that were not finished, more than eight waits or signals, or a lost device.
    pub fn submit(
        &self,
        commands: &mut CommandBuffer,
        waits: &[Wait<'_>],
        signals: &[Signal<'_>],
    ) -> Result<u64, Error> {
        let mut wait_infos = [vk::SemaphoreSubmitInfo::default(); MAX_SEMAPHORES];
        let mut signal_infos = [vk::SemaphoreSubmitInfo::default(); MAX_SEMAPHORES];
        if waits.len() > MAX_SEMAPHORES || signals.len() >= MAX_SEMAPHORES {
            return Err(Error::range(
                "semaphores of a submission",
                format_args!("at most {MAX_SEMAPHORES} waits and {} signals", MAX_SEMAPHORES - 1),
                format_args!("{} and {}", waits.len(), signals.len()),
            ));
        }
        // Timelines of the last submission may be let go only when it is complete.
        commands.wait()?;
        commands.timelines.clear();
        for (info, wait) in wait_infos.iter_mut().zip(waits) {
            self.check_home(wait.timeline.home())?;
            commands.timelines.push(Arc::clone(wait.timeline));
            *info = info.semaphore(wait.timeline.raw).value(wait.value).stage_mask(wait.stages);
        }
        for (info, signal) in signal_infos.iter_mut().zip(signals) {
            self.check_home(signal.timeline.home())?;
            commands.timelines.push(Arc::clone(signal.timeline));
            *info = info
                .semaphore(signal.timeline.raw)
                .value(signal.value)
                .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS);
        }
        self.submit_raw(commands, &wait_infos[..waits.len()], &mut signal_infos[..=signals.len()])
    }

    /// Refuses what lives on another device.
    pub(crate) fn check_home(&self, home: &Device) -> Result<(), Error> {
        if std::ptr::eq(self, home) {
            return Ok(());
        }
        Err(Error::range(
            "device of an object",
            &self.limits().name,
            format_args!("another one ({})", home.limits().name),
        ))
    }

    /// Submits with raw semaphores; the last place of `signals` is filled with the device's own timeline.
    pub(crate) fn submit_raw(
        &self,
        commands: &mut CommandBuffer,
        waits: &[vk::SemaphoreSubmitInfo<'_>],
        signals: &mut [vk::SemaphoreSubmitInfo<'_>],
    ) -> Result<u64, Error> {
        if !commands.executable {
            return Err(Error::Recording {
                name: commands.name.clone(),
                detail: "submitted without being finished",
            });
        }
        self.check_home(&commands.device)?;
        commands.wait()?;
        let buffers = [vk::CommandBufferSubmitInfo::default().command_buffer(commands.raw)];
        let lock = self.lock_queue();
        let number = self.submitted.load(Ordering::Acquire) + 1;
        if let Some(last) = signals.last_mut() {
            *last = vk::SemaphoreSubmitInfo::default()
                .semaphore(self.timeline)
                .value(number)
                .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS);
        }
        let submit = [vk::SubmitInfo2::default()
            .wait_semaphore_infos(waits)
            .signal_semaphore_infos(signals)
            .command_buffer_infos(&buffers)];
        // SAFETY: the queue is locked; the commands are complete and not pending; they keep what they use alive.
        blocking(|| unsafe { self.raw.queue_submit2(self.queue, &submit, vk::Fence::null()) })
            .at("vkQueueSubmit2")?;
        self.submitted.store(number, Ordering::Release);
        drop(lock);
        commands.pending = number;
        if let Some(timer) = &mut commands.timer {
            timer.unread = true;
        }
        Ok(number)
    }
}
