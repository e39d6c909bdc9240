//! Which device is used, and why another is not.

use ash::vk;

use crate::error::{At, Error};
use crate::instance::{DeviceSummary, Instance, version_text};

/// The environment variable that names a device: its index in the loader's list, or a part of its name (any case).
pub const DEVICE_VARIABLE: &str = "VERGENCE_GPU";

/// What every device must be able to do; named in errors.
pub(crate) const REQUIRED: &str =
    "dynamic rendering, synchronization2, maintenance4, timeline semaphores, host query reset and multiview";

/// A device that can be used, and what of the optional things it offers.
pub(crate) struct Candidate {
    pub physical: vk::PhysicalDevice,
    pub queue_family: u32,
    pub properties: vk::PhysicalDeviceProperties,
}

fn missing(
    instance: &Instance,
    physical: vk::PhysicalDevice,
    properties: &vk::PhysicalDeviceProperties,
) -> Vec<String> {
    let mut lacks = Vec::new();
    if properties.api_version < vk::API_VERSION_1_3 {
        lacks.push(format!("Vulkan 1.3 (it has {})", version_text(properties.api_version)));
        return lacks;
    }
    let mut f11 = vk::PhysicalDeviceVulkan11Features::default();
    let mut f12 = vk::PhysicalDeviceVulkan12Features::default();
    let mut f13 = vk::PhysicalDeviceVulkan13Features::default();
    let mut features =
        vk::PhysicalDeviceFeatures2::default().push_next(&mut f11).push_next(&mut f12).push_next(&mut f13);
    // SAFETY: the physical device is of this instance and has Vulkan 1.3, which knows these structures.
    unsafe { instance.raw.get_physical_device_features2(physical, &mut features) };
    for (has, name) in [
        (f11.multiview, "multiview"),
        (f12.timeline_semaphore, "timeline semaphores"),
        (f12.host_query_reset, "host query reset"),
        (f13.dynamic_rendering, "dynamic rendering"),
        (f13.synchronization2, "synchronization2"),
        (f13.maintenance4, "maintenance4"),
    ] {
        if has == vk::FALSE {
            lacks.push(name.into());
        }
    }
    if queue_family(instance, physical).is_none() {
        lacks.push("a queue for graphics and compute".into());
    }
    lacks
}

fn queue_family(instance: &Instance, physical: vk::PhysicalDevice) -> Option<u32> {
    let wanted = vk::QueueFlags::GRAPHICS | vk::QueueFlags::COMPUTE;
    // SAFETY: the physical device is of this instance.
    let families = unsafe { instance.raw.get_physical_device_queue_family_properties(physical) };
    families.iter().position(|f| f.queue_flags.contains(wanted)).map(|i| i as u32)
}

fn name_of(properties: &vk::PhysicalDeviceProperties) -> String {
    properties.device_name_as_c_str().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}

fn kind_of(properties: &vk::PhysicalDeviceProperties) -> &'static str {
    match properties.device_type {
        vk::PhysicalDeviceType::DISCRETE_GPU => "discrete",
        vk::PhysicalDeviceType::INTEGRATED_GPU => "integrated",
        vk::PhysicalDeviceType::CPU => "software",
        vk::PhysicalDeviceType::VIRTUAL_GPU => "virtual",
        _ => "other",
    }
}

/// Smaller is preferred.
fn rank(properties: &vk::PhysicalDeviceProperties) -> u32 {
    match properties.device_type {
        vk::PhysicalDeviceType::DISCRETE_GPU => 0,
        vk::PhysicalDeviceType::INTEGRATED_GPU => 1,
        vk::PhysicalDeviceType::VIRTUAL_GPU => 2,
        vk::PhysicalDeviceType::CPU => 3,
        _ => 4,
    }
}

fn list(instance: &Instance) -> Result<Vec<(vk::PhysicalDevice, vk::PhysicalDeviceProperties)>, Error> {
    // SAFETY: the instance is valid.
    let devices = match unsafe { instance.raw.enumerate_physical_devices() } {
        Err(vk::Result::ERROR_INITIALIZATION_FAILED) => Vec::new(),
        other => other.at("vkEnumeratePhysicalDevices")?,
    };
    Ok(devices
        .into_iter()
        // SAFETY: the physical devices are of this instance.
        .map(|p| (p, unsafe { instance.raw.get_physical_device_properties(p) }))
        .collect())
}

/// Name and version of the driver of a device with Vulkan 1.2 or newer.
pub(crate) fn driver_of(
    instance: &Instance,
    physical: vk::PhysicalDevice,
    properties: &vk::PhysicalDeviceProperties,
) -> String {
    if properties.api_version < vk::API_VERSION_1_2 {
        return format!("version {}", properties.driver_version);
    }
    let mut driver = vk::PhysicalDeviceDriverProperties::default();
    let mut all = vk::PhysicalDeviceProperties2::default().push_next(&mut driver);
    // SAFETY: the physical device is of this instance, and 1.2 knows the structure.
    unsafe { instance.raw.get_physical_device_properties2(physical, &mut all) };
    let text =
        |t: Result<&std::ffi::CStr, _>| t.map(|t| t.to_string_lossy().into_owned()).unwrap_or_default();
    let (name, info) = (text(driver.driver_name_as_c_str()), text(driver.driver_info_as_c_str()));
    format!("{name} {info}").trim().to_string()
}

pub(crate) fn summaries(instance: &Instance) -> Result<Vec<DeviceSummary>, Error> {
    Ok(list(instance)?
        .into_iter()
        .map(|(physical, properties)| DeviceSummary {
            name: name_of(&properties),
            driver: driver_of(instance, physical, &properties),
            vulkan: version_text(properties.api_version),
            kind: kind_of(&properties),
            missing: missing(instance, physical, &properties),
        })
        .collect())
}

/// Index of the device that `wanted` names: a number, or a part of a name in any case.
fn find_wanted(wanted: &str, names: &[String]) -> Option<usize> {
    match wanted.parse::<usize>() {
        Ok(index) if index < names.len() => Some(index),
        _ => {
            let wanted = wanted.to_lowercase();
            names.iter().position(|n| n.to_lowercase().contains(&wanted))
        }
    }
}

/// The one that `VERGENCE_GPU` names, else the best of those that are suitable: discrete, integrated, virtual, software.
pub(crate) fn choose(instance: &Instance) -> Result<Candidate, Error> {
    let devices = list(instance)?;
    if devices.is_empty() {
        return Err(Error::NoDevice { detail: "the loader is there, but no driver answered".into() });
    }
    let names: Vec<String> = devices.iter().map(|(_, p)| name_of(p)).collect();
    if let Some(wanted) = std::env::var(DEVICE_VARIABLE).ok().filter(|w| !w.trim().is_empty()) {
        let Some(index) = find_wanted(wanted.trim(), &names) else {
            let found =
                names.iter().enumerate().map(|(i, n)| format!("{i}: {n}")).collect::<Vec<_>>().join(", ");
            return Err(Error::NoSuchDevice { wanted, found });
        };
        return check(instance, devices[index].0);
    }
    let mut order: Vec<usize> = (0..devices.len()).collect();
    order.sort_by_key(|&i| rank(&devices[i].1));
    let mut found = Vec::new();
    for i in order {
        let lacks = missing(instance, devices[i].0, &devices[i].1);
        if lacks.is_empty() {
            return check(instance, devices[i].0);
        }
        found.push(format!("{} without {}", names[i], lacks.join(", ")));
    }
    Err(Error::Unsuitable { required: REQUIRED, found: found.join("; ") })
}

/// The physical device that [`Device::new`](crate::Device::new) would choose on an instance that somebody else owns: for a runtime that
/// says which device its headset is connected to.
///
/// # Safety
///
/// The instance must be valid, of Vulkan 1.3 or newer, and not be destroyed during the call.
///
/// # Errors
///
/// As for [`Device::new`](crate::Device::new).
pub unsafe fn choose_device(
    get_instance_proc_addr: vk::PFN_vkGetInstanceProcAddr,
    instance: vk::Instance,
) -> Result<vk::PhysicalDevice, Error> {
    // SAFETY: the caller guarantees both.
    let instance = unsafe { Instance::adopt(get_instance_proc_addr, instance) };
    choose(&instance).map(|candidate| candidate.physical)
}

/// The device, if it can do what is required.
pub(crate) fn check(instance: &Instance, physical: vk::PhysicalDevice) -> Result<Candidate, Error> {
    // SAFETY: the physical device is of this instance.
    let properties = unsafe { instance.raw.get_physical_device_properties(physical) };
    let lacks = missing(instance, physical, &properties);
    match queue_family(instance, physical) {
        Some(queue_family) if lacks.is_empty() => Ok(Candidate { physical, queue_family, properties }),
        _ => Err(Error::Unsuitable {
            required: REQUIRED,
            found: format!("{} without {}", name_of(&properties), lacks.join(", ")),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_is_named_by_index_or_by_a_part_of_its_name() {
        let names = ["NVIDIA H200".to_string(), "llvmpipe (LLVM 15)".to_string()];
        assert_eq!(find_wanted("1", &names), Some(1));
        assert_eq!(find_wanted("LLVMpipe", &names), Some(1));
        // A number that is no index may still be a part of a name.
        assert_eq!(find_wanted("200", &names), Some(0));
        assert_eq!(find_wanted("radeon", &names), None);
    }
}
