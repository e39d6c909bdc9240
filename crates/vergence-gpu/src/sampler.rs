//! Samplers.

use std::sync::Arc;

use ash::vk;

use crate::census::Counters;
use crate::device::Device;
use crate::error::{At, Error};

/// How an image is sampled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SamplerDesc {
    /// Filter when magnified.
    pub mag: vk::Filter,
    /// Filter when minified.
    pub min: vk::Filter,
    /// Filter between mip levels.
    pub mip: vk::SamplerMipmapMode,
    /// What lies outside, along u and v.
    pub address: [vk::SamplerAddressMode; 2],
    /// Largest anisotropy; 1 is none. Clamped to nothing: more than the device has is an error.
    pub anisotropy: f32,
    /// Largest level of detail (default: no bound).
    pub max_lod: f32,
    /// Compares depth instead of filtering colour.
    pub compare: Option<vk::CompareOp>,
}

impl Default for SamplerDesc {
    fn default() -> Self {
        Self {
            mag: vk::Filter::LINEAR,
            min: vk::Filter::LINEAR,
            mip: vk::SamplerMipmapMode::LINEAR,
            address: [vk::SamplerAddressMode::REPEAT; 2],
            anisotropy: 1.0,
            max_lod: vk::LOD_CLAMP_NONE,
            compare: None,
        }
    }
}

/// A sampler.
pub struct Sampler {
    pub(crate) raw: vk::Sampler,
    device: Arc<Device>,
}

impl Sampler {
    /// Makes a sampler.
    ///
    /// # Errors
    ///
    /// More anisotropy than the device has.
    pub fn new(device: &Arc<Device>, desc: &SamplerDesc) -> Result<Arc<Self>, Error> {
        let max = device.limits().max_anisotropy;
        if !(1.0..=max).contains(&desc.anisotropy) {
            return Err(Error::Unsupported {
                device: device.limits().name.clone(),
                asked: format!("anisotropy {}", desc.anisotropy),
                offered: format!("1 to {max}"),
            });
        }
        let info = vk::SamplerCreateInfo::default()
            .mag_filter(desc.mag)
            .min_filter(desc.min)
            .mipmap_mode(desc.mip)
            .address_mode_u(desc.address[0])
            .address_mode_v(desc.address[1])
            .address_mode_w(vk::SamplerAddressMode::CLAMP_TO_EDGE)
            .anisotropy_enable(device.anisotropy && desc.anisotropy > 1.0)
            .max_anisotropy(desc.anisotropy)
            .compare_enable(desc.compare.is_some())
            .compare_op(desc.compare.unwrap_or(vk::CompareOp::NEVER))
            .min_lod(0.0)
            .max_lod(desc.max_lod);
        // SAFETY: the create info is complete and within the device's limits.
        let raw = unsafe { device.raw.create_sampler(&info, None) }.at("vkCreateSampler")?;
        Counters::add(&device.counters.samplers, 1);
        Ok(Arc::new(Self { raw, device: Arc::clone(device) }))
    }
}

impl Sampler {
    /// The device that it lives on.
    pub fn device(&self) -> &Arc<Device> {
        &self.device
    }
}

impl Drop for Sampler {
    fn drop(&mut self) {
        // SAFETY: descriptor sets that use the sampler hold an Arc of it.
        unsafe { self.device.raw.destroy_sampler(self.raw, None) };
        Counters::sub(&self.device.counters.samplers, 1);
    }
}
