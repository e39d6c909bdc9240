//! Vulkan instance and device made by the OpenXR runtime (XR_KHR_vulkan_enable2).
//!
//! The runtime is given an entry point of ours, which the specification allows: Monado puts a request for timeline
//! semaphores before a chain that has them in `VkPhysicalDeviceVulkan12Features` already, which Vulkan forbids. It is taken
//! out again before Vulkan sees it.

use std::ffi::{CStr, c_char, c_void};
use std::sync::atomic::{AtomicUsize, Ordering};

use openxr::sys::platform::{VkGetInstanceProcAddr, VkInstance, VkPhysicalDevice};
use vergence_gpu::{
    Error as GpuError, VulkanCreator,
    vk::{self, Handle},
};

use crate::{Connection, Error};

/// Has the runtime of a connection make Vulkan's instance and device.
pub struct Creator<'a> {
    connection: &'a Connection,
    /// The call that the runtime refused.
    refused: Option<(&'static str, openxr::sys::Result)>,
}

impl Creator<'_> {
    /// What an error of the graphics device means for the headset: where the runtime refused a call, the error of that
    /// call, which may be a loss.
    pub fn explain(&self, error: GpuError) -> Error {
        match (error, self.refused) {
            (GpuError::Creator { .. }, Some((call, result))) => Error::of(call, result),
            (error, _) => Error::Gpu(error),
        }
    }

    fn refused(&mut self, call: &'static str) -> impl FnOnce(openxr::sys::Result) -> GpuError {
        move |result| {
            self.refused = Some((call, result));
            GpuError::creator(call, result.to_string())
        }
    }
}

impl Connection {
    /// Who makes the Vulkan instance and device for this headset.
    pub const fn vulkan_creator(&self) -> Creator<'_> {
        Creator { connection: self, refused: None }
    }
}

fn failed(call: &'static str) -> impl Fn(i32) -> GpuError {
    move |result| GpuError::Vulkan { call, result: vk::Result::from_raw(result) }
}

/// Vulkan's `vkGetInstanceProcAddr` and `vkCreateDevice`, as addresses: the C functions below have no other way to know
/// them. A process has one Vulkan loader, so that everybody writes the same values.
static GET_INSTANCE_PROC_ADDR: AtomicUsize = AtomicUsize::new(0);
static CREATE_DEVICE: AtomicUsize = AtomicUsize::new(0);

/// What the runtime is given in place of `get_instance_proc_addr`.
fn loader(get_instance_proc_addr: vk::PFN_vkGetInstanceProcAddr) -> VkGetInstanceProcAddr {
    GET_INSTANCE_PROC_ADDR.store(get_instance_proc_addr as usize, Ordering::Release);
    compatible_get_instance_proc_addr
}

unsafe extern "system" fn compatible_get_instance_proc_addr(
    instance: VkInstance,
    name: *const c_char,
) -> Option<unsafe extern "system" fn()> {
    let address = GET_INSTANCE_PROC_ADDR.load(Ordering::Acquire);
    if address == 0 || name.is_null() {
        return None;
    }
    // SAFETY: the address was stored by `loader` from a pointer of this type.
    let real = unsafe { std::mem::transmute::<usize, vk::PFN_vkGetInstanceProcAddr>(address) };
    // SAFETY: the runtime calls with an instance of Vulkan's (or null) and a C string.
    let found = unsafe { real(vk::Instance::from_raw(handle(instance)), name) }?;
    // SAFETY: as above, and not null.
    if unsafe { CStr::from_ptr(name) } != c"vkCreateDevice" {
        return Some(found);
    }
    CREATE_DEVICE.store(found as usize, Ordering::Release);
    let ours: vk::PFN_vkCreateDevice = create_device_without_repetition;
    // SAFETY: function pointers of one calling convention; the caller casts it to vkCreateDevice's type again.
    Some(unsafe { std::mem::transmute::<vk::PFN_vkCreateDevice, unsafe extern "system" fn()>(ours) })
}

/// `vkCreateDevice` that leaves out requests for timeline semaphores at the head of a chain that asks for them later on.
unsafe extern "system" fn create_device_without_repetition(
    physical_device: vk::PhysicalDevice,
    info: *const vk::DeviceCreateInfo<'_>,
    allocator: *const vk::AllocationCallbacks<'_>,
    device: *mut vk::Device,
) -> vk::Result {
    let address = CREATE_DEVICE.load(Ordering::Acquire);
    if address == 0 || info.is_null() {
        return vk::Result::ERROR_INITIALIZATION_FAILED;
    }
    // SAFETY: the address was stored above from what Vulkan gave for the name `vkCreateDevice`.
    let real = unsafe { std::mem::transmute::<usize, vk::PFN_vkCreateDevice>(address) };
    // SAFETY: the caller gives a valid create info for the time of the call.
    let mut info = unsafe { *info };
    // SAFETY: as above; its chain is valid, too.
    info.p_next = unsafe { without_repetition(info.p_next) };
    // SAFETY: arguments as the caller gave them, but for the shortened chain.
    unsafe { real(physical_device, &info, allocator, device) }
}

/// The chain without requests for timeline semaphores at its head, where a later link asks for them, too.
///
/// # Safety
/// `chain` must be null or a valid chain of structures.
unsafe fn without_repetition(chain: *const c_void) -> *const c_void {
    let mut asked_later = false;
    let mut link = chain.cast::<vk::BaseInStructure<'_>>();
    while !link.is_null() {
        // SAFETY: not null, and a link of a valid chain.
        let (kind, next) = unsafe { ((*link).s_type, (*link).p_next) };
        if kind == vk::StructureType::PHYSICAL_DEVICE_VULKAN_1_2_FEATURES {
            // SAFETY: its type says what it is.
            asked_later |=
                unsafe { (*link.cast::<vk::PhysicalDeviceVulkan12Features<'_>>()).timeline_semaphore }
                    == vk::TRUE;
        }
        link = next;
    }
    let mut head = chain.cast::<vk::BaseInStructure<'_>>();
    while asked_later && !head.is_null() {
        // SAFETY: as above.
        let (kind, next) = unsafe { ((*head).s_type, (*head).p_next) };
        if kind != vk::StructureType::PHYSICAL_DEVICE_TIMELINE_SEMAPHORE_FEATURES {
            break;
        }
        head = next;
    }
    head.cast()
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
            .map_err(self.refused("xrGetVulkanGraphicsRequirements2KHR"))?;
        if requirements.min_api_version_supported > openxr::Version::new(1, 3, u32::MAX) {
            let found = format!("expected a runtime that takes Vulkan 1.3, found {requirements:?}");
            return Err(GpuError::creator("xrGetVulkanGraphicsRequirements2KHR", found));
        }
        let info = std::ptr::from_ref(info).cast::<c_void>();
        // SAFETY: the caller guarantees the create info; the requirements have been asked for.
        let made = unsafe { instance.create_vulkan_instance(*system, loader(get_instance_proc_addr), info) };
        let made: VkInstance = made
            .map_err(self.refused("xrCreateVulkanInstanceKHR"))?
            .map_err(failed("vkCreateInstance, called by the OpenXR runtime"))?;
        Ok(vk::Instance::from_raw(handle(made)))
    }

    fn physical_device(&mut self, instance: vk::Instance) -> Result<vk::PhysicalDevice, GpuError> {
        let Connection { instance: xr, system, .. } = self.connection;
        // SAFETY: `instance` was made by `create_instance` above.
        let found: VkPhysicalDevice =
            unsafe { xr.vulkan_graphics_device(*system, pointer(instance.as_raw())) }
                .map_err(self.refused("xrGetVulkanGraphicsDevice2KHR"))?;
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
            .map_err(self.refused("xrCreateVulkanDeviceKHR"))?
            .map_err(failed("vkCreateDevice, called by the OpenXR runtime"))?;
        Ok(vk::Device::from_raw(handle(made)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_repeated_request_at_the_head_is_left_out_and_nothing_else() {
        let mut asks = vk::PhysicalDeviceVulkan12Features::default().timeline_semaphore(true);
        let mut head = vk::PhysicalDeviceTimelineSemaphoreFeatures::default().timeline_semaphore(true);
        let plain: *const c_void = std::ptr::from_ref(&asks).cast();
        // SAFETY: a chain of one.
        assert_eq!(unsafe { without_repetition(plain) }, plain);
        head.p_next = std::ptr::from_mut(&mut asks).cast();
        let repeated: *const c_void = std::ptr::from_ref(&head).cast();
        // SAFETY: a chain of two.
        assert_eq!(unsafe { without_repetition(repeated) }, plain);
        let mut silent = vk::PhysicalDeviceVulkan12Features::default();
        head.p_next = std::ptr::from_mut(&mut silent).cast();
        let alone: *const c_void = std::ptr::from_ref(&head).cast();
        // SAFETY: a chain of two; the head is the only one to ask.
        assert_eq!(unsafe { without_repetition(alone) }, alone);
        // SAFETY: no chain.
        assert!(unsafe { without_repetition(std::ptr::null()) }.is_null());
    }
}
