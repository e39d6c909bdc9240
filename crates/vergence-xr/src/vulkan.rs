//! Vulkan instance and device made by the OpenXR runtime (XR_KHR_vulkan_enable2).

use std::ffi::c_void;

use openxr::sys::platform::{VkGetInstanceProcAddr, VkInstance, VkPhysicalDevice};
use vergence_gpu::{
    Error as GpuError, VulkanCreator,
    vk::{self, Handle},
};

use crate::Connection;

/// Has the runtime of a connection make Vulkan's instance and device.
pub struct Creator<'a> {
    connection: &'a Connection,
}

impl Connection {
    /// Who makes the Vulkan instance and device for this headset.
    pub const fn vulkan_creator(&self) -> Creator<'_> {
        Creator { connection: self }
    }
}

fn refused(call: &'static str) -> impl Fn(openxr::sys::Result) -> GpuError {
    move |result| GpuError::creator(call, result.to_string())
}

fn failed(call: &'static str) -> impl Fn(i32) -> GpuError {
    move |result| GpuError::Vulkan { call, result: vk::Result::from_raw(result) }
}

/// The same function pointer by OpenXR's name for its type.
fn loader(get_instance_proc_addr: vk::PFN_vkGetInstanceProcAddr) -> VkGetInstanceProcAddr {
    // SAFETY: both types are `vkGetInstanceProcAddr`: an instance handle of pointer size, a C string, a function pointer.
    unsafe {
        std::mem::transmute::<vk::PFN_vkGetInstanceProcAddr, VkGetInstanceProcAddr>(get_instance_proc_addr)
    }
}

fn pointer(handle: u64) -> *const c_void {
    handle as usize as *const c_void
}

fn handle(pointer: *const c_void) -> u64 {
    pointer as usize as u64
}

// SAFETY: the handles come from a conforming runtime, which makes them from the given create infos and by
// XR_KHR_vulkan_enable2 may only add to them; nobody but the caller destroys them.
unsafe impl VulkanCreator for Creator<'_> {
    unsafe fn create_instance(
        &mut self,
        get_instance_proc_addr: vk::PFN_vkGetInstanceProcAddr,
        info: &vk::InstanceCreateInfo<'_>,
    ) -> Result<vk::Instance, GpuError> {
        let Connection { instance, system, .. } = self.connection;
        // The specification wants the requirements asked for first.
        let requirements = instance
            .graphics_requirements::<openxr::Vulkan>(*system)
            .map_err(refused("xrGetVulkanGraphicsRequirements2KHR"))?;
        if requirements.min_api_version_supported > openxr::Version::new(1, 3, u32::MAX) {
            let found = format!("expected a runtime that takes Vulkan 1.3, found {requirements:?}");
            return Err(GpuError::creator("xrGetVulkanGraphicsRequirements2KHR", found));
        }
        let info = std::ptr::from_ref(info).cast::<c_void>();
        // SAFETY: the caller guarantees the create info; the requirements have been asked for.
        let made = unsafe { instance.create_vulkan_instance(*system, loader(get_instance_proc_addr), info) };
        let made: VkInstance = made
            .map_err(refused("xrCreateVulkanInstanceKHR"))?
            .map_err(failed("vkCreateInstance, called by the OpenXR runtime"))?;
        Ok(vk::Instance::from_raw(handle(made)))
    }

    fn physical_device(&mut self, instance: vk::Instance) -> Result<vk::PhysicalDevice, GpuError> {
        let Connection { instance: xr, system, .. } = self.connection;
        // SAFETY: `instance` was made by `create_instance` above.
        let found: VkPhysicalDevice =
            unsafe { xr.vulkan_graphics_device(*system, pointer(instance.as_raw())) }
                .map_err(refused("xrGetVulkanGraphicsDevice2KHR"))?;
        Ok(vk::PhysicalDevice::from_raw(handle(found)))
    }

    unsafe fn create_device(
        &mut self,
        get_instance_proc_addr: vk::PFN_vkGetInstanceProcAddr,
        physical_device: vk::PhysicalDevice,
        info: &vk::DeviceCreateInfo<'_>,
    ) -> Result<vk::Device, GpuError> {
        let Connection { instance, system, .. } = self.connection;
        let info = std::ptr::from_ref(info).cast::<c_void>();
        // SAFETY: the caller guarantees the create info and that the physical device is of the instance made above.
        let made = unsafe {
            instance.create_vulkan_device(
                *system,
                loader(get_instance_proc_addr),
                pointer(physical_device.as_raw()),
                info,
            )
        };
        let made = made
            .map_err(refused("xrCreateVulkanDeviceKHR"))?
            .map_err(failed("vkCreateDevice, called by the OpenXR runtime"))?;
        Ok(vk::Device::from_raw(handle(made)))
    }
}
