//! XR_KHR_vulkan_enable2: the application's Vulkan instance and device are made through the runtime, which adds what
//! its composition needs.

use std::ffi::CStr;

use openxr_sys as sys;
use sys::platform::{VkDevice, VkInstance, VkPhysicalDevice, VkResult};
use vergence_gpu::vk::{self, Handle as _};

use crate::features::Features;
use crate::ffi::{In, Out, XrResult};
use crate::instance::Instance;
use crate::system::check_system;

/// The Vulkan instance of an application, and how its functions are found.
#[derive(Clone, Copy)]
pub(crate) struct VulkanEntry {
    pub gipa: vk::PFN_vkGetInstanceProcAddr,
    pub instance: vk::Instance,
}

/// Vulkan 1.3: what composition needs.
const VULKAN: u32 = vk::API_VERSION_1_3;

/// Finds a function of Vulkan.
///
/// # Safety
/// `F` is the function pointer type of `name`, and `instance` is null or an instance that `gipa` knows.
unsafe fn function<F: Copy>(
    gipa: vk::PFN_vkGetInstanceProcAddr,
    instance: vk::Instance,
    name: &CStr,
) -> XrResult<F> {
    const { assert!(size_of::<F>() == size_of::<vk::PFN_vkVoidFunction>()) };
    // SAFETY: demanded of the caller; the name is zero-terminated.
    let found = unsafe { gipa(instance, name.as_ptr()) }.ok_or(sys::Result::ERROR_GRAPHICS_DEVICE_INVALID)?;
    // SAFETY: function pointers are of one size (checked above); the type is demanded of the caller.
    Ok(unsafe { std::mem::transmute_copy(&found) })
}

fn entry_point(pfn: Option<sys::platform::VkGetInstanceProcAddr>) -> XrResult<vk::PFN_vkGetInstanceProcAddr> {
    let pfn = pfn.ok_or(sys::Result::ERROR_VALIDATION_FAILURE)?;
    // SAFETY: both are the type of vkGetInstanceProcAddr: openxr-sys spells the instance as a pointer, ash as a
    // transparent wrapper of an integer of the same size.
    Ok(unsafe {
        std::mem::transmute::<sys::platform::VkGetInstanceProcAddr, vk::PFN_vkGetInstanceProcAddr>(pfn)
    })
}

pub(crate) fn get_vulkan_graphics_requirements2(
    instance: &Instance,
    system: sys::SystemId,
    mut out: Out<sys::GraphicsRequirementsVulkanKHR>,
) -> XrResult {
    check_system(system)?;
    let requirements = out.fill()?;
    requirements.min_api_version_supported = sys::Version::new(1, 0, 0);
    requirements.max_api_version_supported = sys::Version::new(1, 1023, 4095);
    instance.lock().graphics_requirements_asked = true;
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn create_vulkan_instance(
    instance: &Instance,
    info: In<sys::VulkanInstanceCreateInfoKHR>,
    mut out: Out<VkInstance>,
    mut result: Out<VkResult>,
) -> XrResult {
    let info = info.get()?;
    check_system(info.system_id)?;
    out.check()?;
    result.check()?;
    let gipa = entry_point(info.pfn_get_instance_proc_addr)?;
    if info.vulkan_create_info.is_null() || info.create_flags != sys::VulkanInstanceCreateFlagsKHR::EMPTY {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    // SAFETY: the application hands over a VkInstanceCreateInfo.
    let mut create = unsafe { *info.vulkan_create_info.cast::<vk::InstanceCreateInfo>() };
    let mut application = vk::ApplicationInfo::default();
    if !create.p_application_info.is_null() {
        // SAFETY: not null, so it is a VkApplicationInfo by the rules of Vulkan.
        application = unsafe { *create.p_application_info };
    }
    application.api_version = application.api_version.max(VULKAN);
    create.p_application_info = &application;
    // SAFETY: the type is that of the function, which belongs to no instance.
    let make: vk::PFN_vkCreateInstance =
        unsafe { function(gipa, vk::Instance::null(), c"vkCreateInstance") }?;
    let mut made = vk::Instance::null();
    // SAFETY: the create info is the application's with a version raised; it lives during the call.
    let code = unsafe { make(&create, info.vulkan_allocator.cast(), &mut made) };
    result.set(code.as_raw())?;
    if code == vk::Result::SUCCESS {
        instance.lock().vulkan = Some(VulkanEntry { gipa, instance: made });
    }
    out.set(made.as_raw() as VkInstance)?;
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn get_vulkan_graphics_device2(
    instance: &Instance,
    info: In<sys::VulkanGraphicsDeviceGetInfoKHR>,
    mut out: Out<VkPhysicalDevice>,
) -> XrResult {
    let info = info.get()?;
    check_system(info.system_id)?;
    let entry = instance.lock().vulkan.ok_or(sys::Result::ERROR_HANDLE_INVALID)?;
    if info.vulkan_instance.is_null() || info.vulkan_instance as u64 != entry.instance.as_raw() {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    let physical = first_device(&entry)?;
    out.set(physical.as_raw() as VkPhysicalDevice)?;
    Ok(sys::Result::SUCCESS)
}

/// The device that the headset is "connected to": the one that the environment names, else the fastest kind that there is.
fn first_device(entry: &VulkanEntry) -> XrResult<vk::PhysicalDevice> {
    // SAFETY: the instance is alive (the application uses it in this call) and of Vulkan 1.3 (see `create_vulkan_instance`).
    unsafe { vergence_gpu::choose_device(entry.gipa, entry.instance) }.map_err(|error| {
        log::error!("simulated runtime: {error}");
        sys::Result::ERROR_RUNTIME_FAILURE
    })
}

pub(crate) fn create_vulkan_device(
    instance: &Instance,
    info: In<sys::VulkanDeviceCreateInfoKHR>,
    mut out: Out<VkDevice>,
    mut result: Out<VkResult>,
) -> XrResult {
    let info = info.get()?;
    check_system(info.system_id)?;
    out.check()?;
    result.check()?;
    let gipa = entry_point(info.pfn_get_instance_proc_addr)?;
    if info.vulkan_create_info.is_null()
        || info.vulkan_physical_device.is_null()
        || info.create_flags != sys::VulkanDeviceCreateFlagsKHR::EMPTY
    {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    let entry = instance.lock().vulkan.ok_or(sys::Result::ERROR_HANDLE_INVALID)?;
    // SAFETY: the application hands over a VkDeviceCreateInfo.
    let mut create = unsafe { *info.vulkan_create_info.cast::<vk::DeviceCreateInfo>() };
    // SAFETY: the application hands its chain over for this call.
    let mut features = unsafe { Features::turn_on(create.p_next) };
    create.p_next = features.chain(create.p_next);
    // SAFETY: the type is that of the function.
    let make: vk::PFN_vkCreateDevice = unsafe { function(gipa, entry.instance, c"vkCreateDevice") }?;
    let physical = vk::PhysicalDevice::from_raw(info.vulkan_physical_device as u64);
    let mut made = vk::Device::null();
    // SAFETY: the create info is the application's with features turned on; all of it lives during the call.
    let code = unsafe { make(physical, &create, info.vulkan_allocator.cast(), &mut made) };
    result.set(code.as_raw())?;
    out.set(made.as_raw() as VkDevice)?;
    Ok(sys::Result::SUCCESS)
}
