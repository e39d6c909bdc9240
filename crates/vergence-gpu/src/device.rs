//! The device: made by us, by an OpenXR runtime on our behalf, or adopted; its queue, its limits and what lives on it.

use std::ffi::{CStr, CString, c_char};
use std::mem::ManuallyDrop;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use ash::vk;
use gpu_allocator::vulkan::{Allocator, AllocatorCreateDesc};

use crate::census::{Census, Counters};
use crate::driver_clock::blocking;
use crate::error::{At, Error};
use crate::instance::{Instance, VulkanCreator};
use crate::limits::{Limits, read_limits};
use crate::select;

/// How long [`Device::wait`] and the destructors wait before they give up, in nanoseconds (one minute: software devices are slow).
pub(crate) const PATIENCE_NS: u64 = 60_000_000_000;

/// What a device shall be able to do beyond what every device must.
#[derive(Debug, Clone, Copy, Default)]
pub struct DeviceDesc {
    /// Presentation to a window (the instance must have been made with a display; default: off).
    pub present: bool,
    /// Shader accesses outside of a buffer give zero instead of undefined behaviour (default: off, since every index in our
    /// shaders is a constant or checked before upload; for other shaders; costs a few percent on some GPUs).
    pub robust: bool,
}

/// Handles that somebody else owns, for [`Device::adopt`].
#[derive(Clone, Copy)]
pub struct RawDevice {
    /// The loader's entry point.
    pub get_instance_proc_addr: vk::PFN_vkGetInstanceProcAddr,
    /// The instance that the device is of.
    pub instance: vk::Instance,
    /// The physical device that the device is of.
    pub physical_device: vk::PhysicalDevice,
    /// The device.
    pub device: vk::Device,
    /// Family of the queue to use; must do graphics and compute.
    pub queue_family: u32,
    /// Index of the queue in its family.
    pub queue_index: u32,
}

/// One lock per Vulkan queue of the process: a device and those that adopt it share the queue, and so its lock.
fn queue_lock(queue: vk::Queue) -> Arc<Mutex<()>> {
    static LOCKS: Mutex<Vec<(vk::Queue, Weak<Mutex<()>>)>> = Mutex::new(Vec::new());
    let mut locks = LOCKS.lock().unwrap_or_else(PoisonError::into_inner);
    locks.retain(|(_, lock)| lock.strong_count() > 0);
    if let Some(lock) = locks.iter().find(|(q, _)| *q == queue).and_then(|(_, lock)| lock.upgrade()) {
        return lock;
    }
    let lock = Arc::new(Mutex::new(()));
    locks.push((queue, Arc::downgrade(&lock)));
    lock
}

/// A Vulkan device with one queue for graphics, compute and copies.
///
/// Everything made from it holds an `Arc` of it, so it is destroyed last. Its methods may be called from any thread.
pub struct Device {
    pub(crate) raw: ash::Device,
    pub(crate) physical: vk::PhysicalDevice,
    pub(crate) queue: vk::Queue,
    pub(crate) queue_family: u32,
    queue_index: u32,
    lock: Arc<Mutex<()>>,
    /// Signalled by every submission with its number.
    pub(crate) timeline: vk::Semaphore,
    /// Number of the last submission; changed only under `lock`.
    pub(crate) submitted: AtomicU64,
    /// Largest number known to be completed, so that most questions need no call.
    completed: AtomicU64,
    pub(crate) memory: Mutex<ManuallyDrop<Allocator>>,
    pub(crate) pipeline_cache: vk::PipelineCache,
    pub(crate) counters: Counters,
    pub(crate) swapchain: Option<ash::khr::swapchain::Device>,
    pub(crate) anisotropy: bool,
    names: Option<ash::ext::debug_utils::Device>,
    limits: Limits,
    owned: bool,
    pub(crate) instance: Arc<Instance>,
}

impl Device {
    /// Makes a device: the one that `creator` names, else the one that `VERGENCE_GPU` names, else the best one.
    ///
    /// # Errors
    ///
    /// No device, none that is suitable (with what each lacks), or a refusal by driver or creator.
    pub fn new(
        instance: &Arc<Instance>,
        desc: &DeviceDesc,
        creator: Option<&mut dyn VulkanCreator>,
    ) -> Result<Arc<Self>, Error> {
        let mut creator = creator;
        let candidate = match &mut creator {
            Some(creator) => select::check(instance, creator.physical_device(instance.raw.handle())?)?,
            None => select::choose(instance)?,
        };
        let physical = candidate.physical;

        // SAFETY: the physical device is of this instance.
        let has = unsafe { instance.raw.get_physical_device_features(physical) };
        // What a pipeline, a sampler or a shader of ours uses, and nothing else: a feature is added with its first user.
        let features = vk::PhysicalDeviceFeatures::default()
            .robust_buffer_access(desc.robust && has.robust_buffer_access == vk::TRUE)
            .sampler_anisotropy(has.sampler_anisotropy == vk::TRUE);
        let mut f11 = vk::PhysicalDeviceVulkan11Features::default().multiview(true);
        let mut f12 =
            vk::PhysicalDeviceVulkan12Features::default().timeline_semaphore(true).host_query_reset(true);
        let mut f13 = vk::PhysicalDeviceVulkan13Features::default()
            .dynamic_rendering(true)
            .synchronization2(true)
            .maintenance4(true);

        let mut extensions: Vec<*const c_char> = Vec::new();
        if desc.present {
            if instance.surface.is_none() {
                return Err(Error::Surface { detail: "the instance was made without a display".into() });
            }
            require_extension(instance, physical, ash::khr::swapchain::NAME)?;
            extensions.push(ash::khr::swapchain::NAME.as_ptr());
        }
        let priorities = [1.0];
        let queues = [vk::DeviceQueueCreateInfo::default()
            .queue_family_index(candidate.queue_family)
            .queue_priorities(&priorities)];
        let info = vk::DeviceCreateInfo::default()
            .queue_create_infos(&queues)
            .enabled_extension_names(&extensions)
            .enabled_features(&features)
            .push_next(&mut f11)
            .push_next(&mut f12)
            .push_next(&mut f13);
        let handle = match creator {
            // SAFETY: `info` borrows only locals; the physical device is the creator's own answer for this instance.
            Some(creator) => unsafe {
                creator.create_device(instance.get_instance_proc_addr(), physical, &info)?
            },
            None => {
                // SAFETY: as above; every feature and extension in it was asked for first.
                let device = unsafe { instance.raw.create_device(physical, &info, None) };
                device.at("vkCreateDevice")?.handle()
            }
        };
        // SAFETY: the handle was just made on this instance.
        let raw = unsafe { ash::Device::load(instance.raw.fp_v1_0(), handle) };
        let enabled = Enabled {
            anisotropy: features.sampler_anisotropy == vk::TRUE,
            swapchain: desc.present,
            owned: true,
        };
        Self::finish(Arc::clone(instance), raw, &candidate, 0, &enabled)
    }

    /// Wraps a device that somebody else owns, in a runtime that works on its application's device. Nothing of it is destroyed
    /// here, and optional features are taken as absent (anisotropy is 1).
    ///
    /// Submissions of the owner, if it uses this crate too, and of this wrapper are serialised by one lock, which both share.
    ///
    /// # Safety
    ///
    /// The handles must belong together and outlive everything made from the result, and the device must have been made with
    /// multiview, dynamic rendering, synchronization2, maintenance4, timeline semaphores and host query reset. Where the owner
    /// does not use this crate, the caller keeps it from using the queue during calls of this wrapper.
    ///
    /// # Errors
    ///
    /// When the device cannot do what is required, or has no memory for the wrapper's own objects.
    pub unsafe fn adopt(raw: &RawDevice) -> Result<Arc<Self>, Error> {
        // SAFETY: the caller guarantees the handles.
        let instance = unsafe { Instance::adopt(raw.get_instance_proc_addr, raw.instance) };
        let mut candidate = select::check(&instance, raw.physical_device)?;
        candidate.queue_family = raw.queue_family;
        // SAFETY: the caller guarantees the handles.
        let device = unsafe { ash::Device::load(instance.raw.fp_v1_0(), raw.device) };
        let enabled = Enabled { anisotropy: false, swapchain: false, owned: false };
        Self::finish(instance, device, &candidate, raw.queue_index, &enabled)
    }

    fn finish(
        instance: Arc<Instance>,
        raw: ash::Device,
        candidate: &select::Candidate,
        queue_index: u32,
        enabled: &Enabled,
    ) -> Result<Arc<Self>, Error> {
        // Destroys the device again if a later step fails.
        let mut guard =
            DeviceGuard { raw: Some(raw.clone()), owned: enabled.owned, timeline: vk::Semaphore::null() };
        // SAFETY: the queue was requested when the device was made, here or by the owner.
        let queue = unsafe { raw.get_device_queue(candidate.queue_family, queue_index) };
        let mut kind = vk::SemaphoreTypeCreateInfo::default()
            .semaphore_type(vk::SemaphoreType::TIMELINE)
            .initial_value(0);
        // SAFETY: timeline semaphores are enabled.
        let timeline =
            unsafe { raw.create_semaphore(&vk::SemaphoreCreateInfo::default().push_next(&mut kind), None) }
                .at("vkCreateSemaphore")?;
        guard.timeline = timeline;
        let mut debug_settings = gpu_allocator::AllocatorDebugSettings::default();
        debug_settings.log_leaks_on_shutdown = false;
        let allocator = Allocator::new(&AllocatorCreateDesc {
            instance: instance.raw.clone(),
            device: raw.clone(),
            physical_device: candidate.physical,
            debug_settings,
            buffer_device_address: false,
            allocation_sizes: gpu_allocator::AllocationSizes::new(32 << 20, 16 << 20),
        })
        .map_err(|e| Error::Memory {
            name: "the allocator".into(),
            bytes: 0,
            detail: e.to_string(),
        })?;
        // SAFETY: the device is valid.
        let pipeline_cache =
            unsafe { raw.create_pipeline_cache(&vk::PipelineCacheCreateInfo::default(), None) }
                .at("vkCreatePipelineCache")?;
        guard.raw = None;
        let limits = read_limits(&instance, candidate, enabled.anisotropy);
        let names = instance.debug_utils.then(|| ash::ext::debug_utils::Device::new(&instance.raw, &raw));
        let swapchain = enabled.swapchain.then(|| ash::khr::swapchain::Device::new(&instance.raw, &raw));
        Ok(Arc::new(Self {
            raw,
            physical: candidate.physical,
            queue,
            queue_family: candidate.queue_family,
            queue_index,
            lock: queue_lock(queue),
            timeline,
            submitted: AtomicU64::new(0),
            completed: AtomicU64::new(0),
            memory: Mutex::new(ManuallyDrop::new(allocator)),
            pipeline_cache,
            counters: Counters::default(),
            swapchain,
            anisotropy: enabled.anisotropy,
            names,
            limits,
            owned: enabled.owned,
            instance,
        }))
    }

    /// What the device can do.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// The instance that the device is of.
    pub fn instance(&self) -> &Arc<Instance> {
        &self.instance
    }

    /// The handles, for an OpenXR session binding or for somebody who adopts the device.
    pub fn raw(&self) -> RawDevice {
        RawDevice {
            get_instance_proc_addr: self.instance.get_instance_proc_addr(),
            instance: self.instance.raw.handle(),
            physical_device: self.physical,
            device: self.raw.handle(),
            queue_family: self.queue_family,
            queue_index: self.queue_index,
        }
    }

    /// What the validation layer said since the last call; see [`Instance::validation_messages`].
    pub fn validation_messages(&self) -> Vec<String> {
        self.instance.validation_messages()
    }

    /// How many objects of each kind exist, and their bytes.
    pub fn census(&self) -> Census {
        self.counters.read()
    }

    /// Bytes of device memory in use by buffers and images.
    pub fn allocated_bytes(&self) -> u64 {
        let census = self.census();
        census.buffer_bytes + census.image_bytes
    }

    /// Locks the queue, for work that is not a submission of this crate (a foreign library that submits by itself).
    ///
    /// An OpenXR runtime is one: while it is in xrBeginFrame, xrEndFrame, xrAcquireSwapchainImage or xrReleaseSwapchainImage
    /// (and where sessions and swapchains are made and destroyed) nobody else may use the queue (XR_KHR_vulkan_enable2).
    /// Whoever submits from the thread of the frame loop only, as `vergence-session` does, keeps that rule without a lock;
    /// another thread that submits must take turns with these calls. The lock is not held over them, since the runtime that
    /// is linked in adopts the device and takes the same lock for its own submissions.
    pub fn lock_queue(&self) -> QueueGuard<'_> {
        QueueGuard { _guard: self.lock.lock().unwrap_or_else(PoisonError::into_inner) }
    }

    /// Number of the newest submission; 0 before the first.
    pub fn last_submission(&self) -> u64 {
        self.submitted.load(Ordering::Acquire)
    }

    /// Number of the newest submission that is complete, together with all before it.
    ///
    /// # Errors
    ///
    /// When the device is lost.
    pub fn completed(&self) -> Result<u64, Error> {
        // SAFETY: the semaphore is the device's own timeline.
        let value = blocking(|| unsafe { self.raw.get_semaphore_counter_value(self.timeline) })
            .at("vkGetSemaphoreCounterValue")?;
        self.completed.fetch_max(value, Ordering::AcqRel);
        Ok(value)
    }

    /// Waits until the submission with this number is complete, at most one minute.
    ///
    /// # Errors
    ///
    /// When the device is lost or does not finish; a number that was never submitted is refused.
    pub fn wait(&self, submission: u64) -> Result<(), Error> {
        if submission <= self.completed.load(Ordering::Acquire) {
            return Ok(());
        }
        let newest = self.last_submission();
        if submission > newest {
            return Err(Error::range("number of a submission", format_args!("at most {newest}"), submission));
        }
        self.wait_semaphore(self.timeline, submission, PATIENCE_NS, "a submission")?;
        self.completed.fetch_max(submission, Ordering::AcqRel);
        Ok(())
    }

    pub(crate) fn wait_semaphore(
        &self,
        semaphore: vk::Semaphore,
        value: u64,
        timeout_ns: u64,
        what: &'static str,
    ) -> Result<(), Error> {
        let (semaphores, values) = ([semaphore], [value]);
        let info = vk::SemaphoreWaitInfo::default().semaphores(&semaphores).values(&values);
        // SAFETY: the semaphore is a timeline of this device.
        match blocking(|| unsafe { self.raw.wait_semaphores(&info, timeout_ns) }) {
            Err(vk::Result::TIMEOUT) => Err(Error::Timeout { what, timeout_ms: timeout_ns / 1_000_000 }),
            other => other.at("vkWaitSemaphores"),
        }
    }

    /// Waits until everything that was submitted to the queue, by anybody, is complete.
    ///
    /// # Errors
    ///
    /// When the device is lost.
    pub fn wait_idle(&self) -> Result<(), Error> {
        let _lock = self.lock_queue();
        // SAFETY: the queue is locked.
        blocking(|| unsafe { self.raw.queue_wait_idle(self.queue) }).at("vkQueueWaitIdle")
    }

    /// What pipelines compiled so far, for [`Device::load_pipeline_cache`] in a later process on the same driver.
    ///
    /// # Errors
    ///
    /// When the driver cannot give it.
    pub fn pipeline_cache_data(&self) -> Result<Vec<u8>, Error> {
        // SAFETY: the cache is of this device.
        unsafe { self.raw.get_pipeline_cache_data(self.pipeline_cache) }.at("vkGetPipelineCacheData")
    }

    /// Adds what another process compiled; data of another driver is ignored by the driver.
    ///
    /// # Errors
    ///
    /// When there is no memory for it.
    pub fn load_pipeline_cache(&self, data: &[u8]) -> Result<(), Error> {
        // A header that is not of this device is skipped here already: some drivers trust what follows it.
        // SAFETY: the physical device is of this instance.
        let properties = unsafe { self.instance.raw.get_physical_device_properties(self.physical) };
        let word = |at: usize| data.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        let same = word(0) == Some(32)
            && word(4) == Some(1)
            && word(8) == Some(properties.vendor_id)
            && word(12) == Some(properties.device_id)
            && data.get(16..32) == Some(&properties.pipeline_cache_uuid[..]);
        if !same {
            log::debug!("a pipeline cache of another driver is ignored");
            return Ok(());
        }
        let info = vk::PipelineCacheCreateInfo::default().initial_data(data);
        // SAFETY: the data has a valid header for this device.
        let other = unsafe { self.raw.create_pipeline_cache(&info, None) }.at("vkCreatePipelineCache")?;
        let merged = {
            let _lock = self.lock_queue();
            // SAFETY: both caches are of this device; the target is synchronised against another call of this method by the
            // queue's lock, and against pipeline creation by the driver.
            unsafe { self.raw.merge_pipeline_caches(self.pipeline_cache, &[other]) }
        };
        // SAFETY: made above, not used any more.
        unsafe { self.raw.destroy_pipeline_cache(other, None) };
        merged.at("vkMergePipelineCaches")
    }

    pub(crate) fn name<T: vk::Handle>(&self, handle: T, name: &str) {
        if let Some(names) = &self.names {
            let name = CString::new(name.replace('\0', "")).unwrap_or_default();
            let info = vk::DebugUtilsObjectNameInfoEXT::default().object_handle(handle).object_name(&name);
            // SAFETY: the handle is of this device; a failure to name has no consequence.
            let _ = unsafe { names.set_debug_utils_object_name(&info) };
        }
    }
}

/// Holds the queue for its owner until it is dropped.
pub struct QueueGuard<'a> {
    _guard: MutexGuard<'a, ()>,
}

struct Enabled {
    anisotropy: bool,
    swapchain: bool,
    owned: bool,
}

/// Undoes [`Device::finish`] when it fails halfway.
struct DeviceGuard {
    raw: Option<ash::Device>,
    owned: bool,
    timeline: vk::Semaphore,
}

impl Drop for DeviceGuard {
    fn drop(&mut self) {
        if let Some(raw) = &self.raw {
            // SAFETY: the semaphore is null or was just made; nothing uses it.
            unsafe { raw.destroy_semaphore(self.timeline, None) };
            if self.owned {
                // SAFETY: nothing else was made from the device yet.
                unsafe { raw.destroy_device(None) };
            }
        }
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        if self.owned {
            // SAFETY: the last owner drops, so no other thread uses the device or its queue through this wrapper.
            let _ = unsafe { self.raw.device_wait_idle() };
        } else {
            let _ = self.wait(self.last_submission());
        }
        let memory = self.memory.get_mut().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: dropped once, before the device; all allocations are freed, since their owners hold the device.
        unsafe { ManuallyDrop::drop(memory) };
        // SAFETY: nothing is in use any more, as was waited for above.
        unsafe {
            self.raw.destroy_pipeline_cache(self.pipeline_cache, None);
            self.raw.destroy_semaphore(self.timeline, None);
            if self.owned {
                self.raw.destroy_device(None);
            }
        }
    }
}

fn require_extension(instance: &Instance, physical: vk::PhysicalDevice, name: &CStr) -> Result<(), Error> {
    // SAFETY: the physical device is of this instance.
    let offered = unsafe { instance.raw.enumerate_device_extension_properties(physical) }
        .at("vkEnumerateDeviceExtensionProperties")?;
    if offered.iter().any(|e| e.extension_name_as_c_str() == Ok(name)) {
        return Ok(());
    }
    Err(Error::MissingExtension { name: name.to_string_lossy().into_owned(), by: "the Vulkan device".into() })
}
