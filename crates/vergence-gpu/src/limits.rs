//! What a device can do.

use std::ffi::c_char;

use ash::vk;

use crate::error::Error;
use crate::instance::{Instance, version_text};
use crate::select;

/// What the device can do.
#[derive(Debug, Clone, PartialEq)]
pub struct Limits {
    /// Name given by the driver.
    pub name: String,
    /// Driver and its version.
    pub driver: String,
    /// Vulkan version, such as `1.3.230`.
    pub vulkan: String,
    /// Whether it computes on the CPU.
    pub software: bool,
    /// Samples per pixel that colour and depth attachments both support, ascending; always contains 1.
    pub msaa: Vec<u32>,
    /// Largest anisotropy of samplers; 1 where there is none.
    pub max_anisotropy: f32,
    /// Most views of one multiview pass.
    pub max_views: u32,
    /// Largest width and height of an image, in pixels.
    pub max_image_size: u32,
    /// Nanoseconds per timestamp tick; 0 where the queue has no timestamps.
    pub timestamp_period_ns: f32,
    /// Bits of a timestamp that count.
    pub timestamp_bits: u32,
    /// Alignment of uniform buffer offsets, in bytes.
    pub uniform_alignment: u64,
    /// Alignment of storage buffer offsets, in bytes.
    pub storage_alignment: u64,
    /// Largest uniform buffer binding, in bytes.
    pub max_uniform_bytes: u64,
    /// Largest storage buffer binding, in bytes.
    pub max_storage_bytes: u64,
    /// Bytes of push constants.
    pub max_push_bytes: u32,
    /// Whether depth can be resolved by sample zero (Vulkan requires it).
    pub depth_resolve_sample_zero: bool,
}

impl Limits {
    /// Refuses a number of samples that the device does not have.
    ///
    /// # Errors
    ///
    /// [`Error::Unsupported`] that lists what there is.
    pub fn check_msaa(&self, samples: u32) -> Result<vk::SampleCountFlags, Error> {
        if self.msaa.contains(&samples) {
            return Ok(vk::SampleCountFlags::from_raw(samples));
        }
        Err(Error::Unsupported {
            device: self.name.clone(),
            asked: format!("MSAA {samples}"),
            offered: format!(
                "MSAA {}",
                self.msaa.iter().map(u32::to_string).collect::<Vec<_>>().join(" or ")
            ),
        })
    }
}

pub(crate) fn read_limits(instance: &Instance, candidate: &select::Candidate, anisotropy: bool) -> Limits {
    let mut p11 = vk::PhysicalDeviceVulkan11Properties::default();
    let mut p12 = vk::PhysicalDeviceVulkan12Properties::default();
    let mut all = vk::PhysicalDeviceProperties2::default().push_next(&mut p11).push_next(&mut p12);
    // SAFETY: the physical device is of this instance and has Vulkan 1.3.
    unsafe { instance.raw.get_physical_device_properties2(candidate.physical, &mut all) };
    // SAFETY: as above.
    let families = unsafe { instance.raw.get_physical_device_queue_family_properties(candidate.physical) };
    let timestamp_bits =
        families.get(candidate.queue_family as usize).map_or(0, |family| family.timestamp_valid_bits);
    let p = &candidate.properties;
    let both = p.limits.framebuffer_color_sample_counts & p.limits.framebuffer_depth_sample_counts;
    let text = |t: &[c_char]| {
        let bytes: Vec<u8> = t.iter().take_while(|&&c| c != 0).map(|&c| c as u8).collect();
        String::from_utf8_lossy(&bytes).into_owned()
    };
    Limits {
        name: text(&p.device_name),
        driver: select::driver_of(instance, candidate.physical, p),
        vulkan: version_text(p.api_version),
        software: p.device_type == vk::PhysicalDeviceType::CPU,
        msaa: [1, 2, 4, 8, 16, 32, 64].into_iter().filter(|&n| n == 1 || both.as_raw() & n != 0).collect(),
        max_anisotropy: if anisotropy { p.limits.max_sampler_anisotropy } else { 1.0 },
        max_views: p11.max_multiview_view_count,
        max_image_size: p.limits.max_image_dimension2_d,
        timestamp_period_ns: if timestamp_bits == 0 { 0.0 } else { p.limits.timestamp_period },
        timestamp_bits,
        uniform_alignment: p.limits.min_uniform_buffer_offset_alignment,
        storage_alignment: p.limits.min_storage_buffer_offset_alignment,
        max_uniform_bytes: u64::from(p.limits.max_uniform_buffer_range),
        max_storage_bytes: u64::from(p.limits.max_storage_buffer_range),
        max_push_bytes: p.limits.max_push_constants_size,
        depth_resolve_sample_zero: p12
            .supported_depth_resolve_modes
            .contains(vk::ResolveModeFlags::SAMPLE_ZERO),
    }
}
