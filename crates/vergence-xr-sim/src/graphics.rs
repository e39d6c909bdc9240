//! The application's Vulkan device, as the runtime uses it.

use std::ffi::c_void;
use std::sync::{Arc, Mutex, PoisonError};

use openxr_sys as sys;
use vergence_gpu::vk::{self, Handle as _};
use vergence_gpu::{CommandBuffer, Device, Image, RawDevice, Use};
use vergence_time::Timestamp;

use crate::compose::Composer;
use crate::config::{ComposedEye, ComposedFrame};
use crate::extension::Extension;
use crate::ffi::{XrResult, chained};
use crate::instance::Instance;
use crate::layer::Layer;
use crate::session::Session;
use vergence_geom::View;

pub(crate) struct Graphics {
    pub device: Arc<Device>,
    /// For the first transition of swapchain images.
    commands: Mutex<CommandBuffer>,
    /// Made when the first frame is composed.
    composer: Mutex<Option<Composer>>,
}

/// What a failure of the device is to the application.
pub(crate) fn failed(error: vergence_gpu::Error) -> sys::Result {
    match error {
        vergence_gpu::Error::Memory { .. } => sys::Result::ERROR_OUT_OF_MEMORY,
        vergence_gpu::Error::Unsupported { .. } => sys::Result::ERROR_FEATURE_UNSUPPORTED,
        error => {
            log::error!("simulated runtime: {error}");
            sys::Result::ERROR_RUNTIME_FAILURE
        }
    }
}

impl Graphics {
    /// The graphics of a session that is being created; `None` for a headless one.
    ///
    /// # Errors
    /// `XR_ERROR_GRAPHICS_DEVICE_INVALID` and `XR_ERROR_GRAPHICS_REQUIREMENTS_CALL_MISSING`.
    pub(crate) fn from_chain(instance: &Instance, next: *const c_void) -> XrResult<Option<Self>> {
        let Some(binding) = chained::<sys::GraphicsBindingVulkanKHR>(next) else {
            let headless = instance.has(Extension::Headless);
            return if headless { Ok(None) } else { Err(sys::Result::ERROR_GRAPHICS_DEVICE_INVALID) };
        };
        let invalid = sys::Result::ERROR_GRAPHICS_DEVICE_INVALID;
        if !instance.has(Extension::VulkanEnable2) {
            return Err(invalid);
        }
        let shared = instance.lock();
        if !shared.graphics_requirements_asked {
            return Err(sys::Result::ERROR_GRAPHICS_REQUIREMENTS_CALL_MISSING);
        }
        let entry = shared.vulkan.ok_or(invalid)?;
        drop(shared);
        let handles = [binding.instance, binding.physical_device, binding.device];
        if handles.iter().any(|handle| handle.is_null()) || binding.instance as u64 != entry.instance.as_raw()
        {
            return Err(invalid);
        }
        let raw = RawDevice {
            get_instance_proc_addr: entry.gipa,
            instance: entry.instance,
            physical_device: vk::PhysicalDevice::from_raw(binding.physical_device as u64),
            device: vk::Device::from_raw(binding.device as u64),
            queue_family: binding.queue_family_index,
            queue_index: binding.queue_index,
        };
        // SAFETY: the application binds handles that belong together and outlive the session (specification of
        // XR_KHR_vulkan_enable2), and keeps away from the queue during the calls in which the runtime uses it. The
        // device was made by `create_vulkan_device`, which sees to its features.
        let device = unsafe { Device::adopt(&raw) }.map_err(|error| {
            log::error!("simulated runtime: {error}");
            invalid
        })?;
        let commands = CommandBuffer::new(&device, "xr-sim transitions", 0).map_err(failed)?;
        Ok(Some(Self { device, commands: Mutex::new(commands), composer: Mutex::new(None) }))
    }

    /// Brings a new image to the layout in which applications get it.
    pub(crate) fn make_ready(&self, image: &Arc<Image>) -> XrResult<()> {
        let depth = image.aspect().contains(vk::ImageAspectFlags::DEPTH);
        let ready = if depth { Use::DepthAttachment } else { Use::ColorAttachment };
        let mut commands = self.commands.lock().unwrap_or_else(PoisonError::into_inner);
        let mut encoder = commands.record().map_err(failed)?;
        encoder.transition(image, Use::Undefined, ready);
        encoder.finish().map_err(failed)?;
        self.device.submit(&mut commands, &[], &[]).map_err(failed)?;
        Ok(())
    }

    /// Waits for whatever the runtime has submitted.
    pub(crate) fn finish(&self) {
        if let Err(error) = self.device.wait(self.device.last_submission()) {
            log::error!("simulated runtime: {error}");
        }
    }

    /// The picture that the user sees at `display`, read back.
    pub(crate) fn compose(
        &self,
        session: &Session,
        number: u64,
        display: Timestamp,
        layers: &[Layer],
    ) -> XrResult<ComposedFrame> {
        let profile = &session.instance.config.profile;
        let head = session.head(display).pose();
        let stage_from_head = head.unwrap_or_else(|| session.lock().stage_from_local_at(display));
        let mut composer = self.composer.lock().unwrap_or_else(PoisonError::into_inner);
        let composer = match &mut *composer {
            Some(composer) => composer,
            none => none.insert(Composer::new(&self.device, profile.resolution).map_err(failed)?),
        };
        let views = [0, 1].map(|eye| View {
            world_from_eye: stage_from_head * profile.eyes[eye].head_from_eye,
            fov: profile.eyes[eye].fov,
        });
        let pictures = composer.compose(&views, layers, display).map_err(failed)?;
        let local_from_stage = session.lock().stage_from_local_at(display).inverse();
        let mut eye = 0;
        let eyes = pictures.map(|rgba| {
            let view = views[eye];
            eye += 1;
            let world_from_eye = local_from_stage * view.world_from_eye;
            ComposedEye { view_in_local: View { world_from_eye, fov: view.fov }, rgba }
        });
        Ok(ComposedFrame {
            number,
            display_time: display,
            size: profile.resolution,
            stage_from_head,
            local_from_head: local_from_stage * stage_from_head,
            eyes,
        })
    }
}
