//! Images, and views of them.

use std::sync::Arc;

use ash::vk;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc, AllocationScheme};

use crate::buffer::lock_memory;
use crate::census::Counters;
use crate::device::Device;
use crate::error::{At, Error};
use crate::format::aspect_of;

/// What an image is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ImageDesc<'a> {
    /// Name, for tools and messages.
    pub name: &'a str,
    /// Format of a texel.
    pub format: vk::Format,
    /// Width in texels.
    pub width: u32,
    /// Height in texels.
    pub height: u32,
    /// Array layers (default 1).
    pub layers: u32,
    /// Mip levels (default 1).
    pub mips: u32,
    /// Samples per texel (default 1).
    pub samples: u32,
    /// What it is used for.
    pub usage: vk::ImageUsageFlags,
    /// Further flags, such as `MUTABLE_FORMAT` (default none).
    pub flags: vk::ImageCreateFlags,
}

impl Default for ImageDesc<'_> {
    fn default() -> Self {
        Self {
            name: "image",
            format: vk::Format::R8G8B8A8_SRGB,
            width: 1,
            height: 1,
            layers: 1,
            mips: 1,
            samples: 1,
            usage: vk::ImageUsageFlags::empty(),
            flags: vk::ImageCreateFlags::empty(),
        }
    }
}

/// A two-dimensional image with layers and mip levels.
pub struct Image {
    pub(crate) raw: vk::Image,
    format: vk::Format,
    width: u32,
    height: u32,
    layers: u32,
    mips: u32,
    samples: u32,
    usage: vk::ImageUsageFlags,
    allocation: Option<Allocation>,
    bytes: u64,
    owned: bool,
    device: Arc<Device>,
}

impl Image {
    /// Makes an image in device memory; its content is undefined.
    ///
    /// # Errors
    ///
    /// A size or format that the device cannot give, or no memory.
    pub fn new(device: &Arc<Device>, desc: &ImageDesc<'_>) -> Result<Arc<Self>, Error> {
        let samples = vk::SampleCountFlags::from_raw(desc.samples);
        // SAFETY: the physical device is of this instance.
        let possible = unsafe {
            device.instance.raw.get_physical_device_image_format_properties(
                device.physical,
                desc.format,
                vk::ImageType::TYPE_2D,
                vk::ImageTiling::OPTIMAL,
                desc.usage,
                desc.flags,
            )
        };
        let unsupported = |offered: String| Error::Unsupported {
            device: device.limits().name.clone(),
            asked: format!(
                "{}: {}×{}, {} layers, {} mips, {} samples, {:?}, {:?}",
                desc.name,
                desc.width,
                desc.height,
                desc.layers,
                desc.mips,
                desc.samples,
                desc.format,
                desc.usage
            ),
            offered,
        };
        let possible = match possible {
            Err(vk::Result::ERROR_FORMAT_NOT_SUPPORTED) => {
                return Err(unsupported("no image of this format and use".into()));
            }
            other => other.at("vkGetPhysicalDeviceImageFormatProperties")?,
        };
        let fits = (1..=possible.max_extent.width).contains(&desc.width)
            && (1..=possible.max_extent.height).contains(&desc.height)
            && (1..=possible.max_array_layers).contains(&desc.layers)
            && (1..=possible.max_mip_levels.min(full_mips(desc.width, desc.height))).contains(&desc.mips)
            && desc.samples.is_power_of_two()
            && possible.sample_counts.contains(samples);
        if !fits {
            return Err(unsupported(format!(
                "1×1 to {}×{}, {} layers, {} mips, samples {:?}",
                possible.max_extent.width,
                possible.max_extent.height,
                possible.max_array_layers,
                full_mips(desc.width.max(1), desc.height.max(1)),
                possible.sample_counts
            )));
        }
        let info = vk::ImageCreateInfo::default()
            .flags(desc.flags)
            .image_type(vk::ImageType::TYPE_2D)
            .format(desc.format)
            .extent(vk::Extent3D { width: desc.width, height: desc.height, depth: 1 })
            .mip_levels(desc.mips)
            .array_layers(desc.layers)
            .samples(samples)
            .tiling(vk::ImageTiling::OPTIMAL)
            .usage(desc.usage)
            .sharing_mode(vk::SharingMode::EXCLUSIVE)
            .initial_layout(vk::ImageLayout::UNDEFINED);
        // SAFETY: the device was asked for this combination above.
        let raw = unsafe { device.raw.create_image(&info, None) }.at("vkCreateImage")?;
        // SAFETY: the image was just made.
        let requirements = unsafe { device.raw.get_image_memory_requirements(raw) };
        let allocated = lock_memory(device).allocate(&AllocationCreateDesc {
            name: desc.name,
            requirements,
            location: MemoryLocation::GpuOnly,
            linear: false,
            allocation_scheme: AllocationScheme::GpuAllocatorManaged,
        });
        let allocation = match allocated {
            Ok(allocation) => allocation,
            Err(error) => {
                // SAFETY: made above, never used.
                unsafe { device.raw.destroy_image(raw, None) };
                return Err(Error::Memory {
                    name: desc.name.into(),
                    bytes: requirements.size,
                    detail: error.to_string(),
                });
            }
        };
        let bytes = allocation.size();
        Counters::add(&device.counters.images, 1);
        Counters::add(&device.counters.image_bytes, bytes);
        // From here on the destructor undoes everything.
        let mut image = Self::wrap(device, raw, desc, true);
        image.bytes = bytes;
        // SAFETY: memory and offset come from the allocator for exactly these requirements, and are bound once.
        let bound = unsafe { device.raw.bind_image_memory(raw, allocation.memory(), allocation.offset()) };
        image.allocation = Some(allocation);
        bound.at("vkBindImageMemory")?;
        device.name(raw, desc.name);
        Ok(Arc::new(image))
    }

    /// Wraps an image that somebody else owns, such as one of an OpenXR swapchain; it is never destroyed here.
    ///
    /// # Safety
    ///
    /// `raw` must be an image of this device (or of the one it adopted), be described by `desc`, and outlive the result and
    /// everything that uses it.
    pub unsafe fn borrowed(device: &Arc<Device>, raw: vk::Image, desc: &ImageDesc<'_>) -> Arc<Self> {
        Counters::add(&device.counters.borrowed_images, 1);
        Arc::new(Self::wrap(device, raw, desc, false))
    }

    fn wrap(device: &Arc<Device>, raw: vk::Image, desc: &ImageDesc<'_>, owned: bool) -> Self {
        Self {
            raw,
            format: desc.format,
            width: desc.width,
            height: desc.height,
            layers: desc.layers,
            mips: desc.mips,
            samples: desc.samples,
            usage: desc.usage,
            allocation: None,
            bytes: 0,
            owned,
            device: Arc::clone(device),
        }
    }

    /// Format of a texel.
    pub fn format(&self) -> vk::Format {
        self.format
    }

    /// Width and height of a mip level in texels.
    pub fn size(&self, mip: u32) -> (u32, u32) {
        (mip_size(self.width, mip), mip_size(self.height, mip))
    }

    /// Number of array layers.
    pub fn layers(&self) -> u32 {
        self.layers
    }

    /// Number of mip levels.
    pub fn mips(&self) -> u32 {
        self.mips
    }

    /// Samples per texel.
    pub fn samples(&self) -> u32 {
        self.samples
    }

    /// What it may be used for.
    pub fn usage(&self) -> vk::ImageUsageFlags {
        self.usage
    }

    /// Bytes of memory bound to it; 0 for a borrowed image.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The raw handle, for a runtime that hands the image out.
    pub fn handle(&self) -> vk::Image {
        self.raw
    }

    /// Depth, stencil or colour, by the format.
    pub fn aspect(&self) -> vk::ImageAspectFlags {
        aspect_of(self.format)
    }

    /// The device that it lives on.
    pub fn device(&self) -> &Arc<Device> {
        &self.device
    }

    /// A view of all mips and layers: an array view where there is more than one layer.
    ///
    /// # Errors
    ///
    /// When the driver refuses.
    pub fn view(self: &Arc<Self>) -> Result<Arc<ImageView>, Error> {
        ImageView::new(self, &ViewDesc::default())
    }
}

impl Drop for Image {
    fn drop(&mut self) {
        if !self.owned {
            Counters::sub(&self.device.counters.borrowed_images, 1);
            return;
        }
        // SAFETY: views hold an Arc of the image, and command buffers one of it or of its views, until they are complete.
        unsafe { self.device.raw.destroy_image(self.raw, None) };
        if let Some(allocation) = self.allocation.take() {
            let _ = lock_memory(&self.device).free(allocation);
        }
        Counters::sub(&self.device.counters.images, 1);
        Counters::sub(&self.device.counters.image_bytes, self.bytes);
    }
}

/// Which part of an image a view shows; the default is all of it.
#[derive(Debug, Clone, Copy, Default)]
pub struct ViewDesc {
    /// Array view or single-layer view; `None`: an array where there is more than one layer.
    pub kind: Option<vk::ImageViewType>,
    /// Another format of the same size class (the image needs `MUTABLE_FORMAT`); `None`: the image's.
    pub format: Option<vk::Format>,
    /// First layer.
    pub base_layer: u32,
    /// Number of layers; `None`: the rest.
    pub layers: Option<u32>,
    /// First mip level.
    pub base_mip: u32,
    /// Number of mip levels; `None`: the rest.
    pub mips: Option<u32>,
}

/// A view of an image; keeps the image alive.
pub struct ImageView {
    pub(crate) raw: vk::ImageView,
    format: vk::Format,
    layers: u32,
    base_mip: u32,
    image: Arc<Image>,
}

impl ImageView {
    /// Makes a view.
    ///
    /// # Errors
    ///
    /// Layers or mips outside of the image, or an image that is only for copies.
    pub fn new(image: &Arc<Image>, desc: &ViewDesc) -> Result<Arc<Self>, Error> {
        let viewable = vk::ImageUsageFlags::SAMPLED
            | vk::ImageUsageFlags::STORAGE
            | vk::ImageUsageFlags::COLOR_ATTACHMENT
            | vk::ImageUsageFlags::DEPTH_STENCIL_ATTACHMENT;
        if !image.usage.intersects(viewable) {
            return Err(Error::range(
                "usage of an image with views",
                format_args!("one of {viewable:?}"),
                format_args!("{:?}", image.usage),
            ));
        }
        let part = |what, base: u32, count: Option<u32>, all: u32| {
            let count = count.unwrap_or(all.saturating_sub(base));
            if count == 0 || base.checked_add(count).is_none_or(|end| end > all) {
                return Err(Error::range(
                    what,
                    format_args!("within {all}"),
                    format_args!("{count} from {base}"),
                ));
            }
            Ok(count)
        };
        let layers = part("layers of a view", desc.base_layer, desc.layers, image.layers)?;
        let mips = part("mips of a view", desc.base_mip, desc.mips, image.mips)?;
        let kind = desc.kind.unwrap_or(if layers > 1 {
            vk::ImageViewType::TYPE_2D_ARRAY
        } else {
            vk::ImageViewType::TYPE_2D
        });
        let format = desc.format.unwrap_or(image.format);
        // A sampled view of depth and stencil must choose one of them; depth is what is asked for.
        let aspect = match aspect_of(format) {
            both if both.contains(vk::ImageAspectFlags::DEPTH) => vk::ImageAspectFlags::DEPTH,
            other => other,
        };
        let info = vk::ImageViewCreateInfo::default()
            .image(image.raw)
            .view_type(kind)
            .format(format)
            .subresource_range(vk::ImageSubresourceRange {
                aspect_mask: aspect,
                base_mip_level: desc.base_mip,
                level_count: mips,
                base_array_layer: desc.base_layer,
                layer_count: layers,
            });
        // SAFETY: the range was checked against the image, which the view keeps alive.
        let raw = unsafe { image.device.raw.create_image_view(&info, None) }.at("vkCreateImageView")?;
        Counters::add(&image.device.counters.image_views, 1);
        Ok(Arc::new(Self { raw, format, layers, base_mip: desc.base_mip, image: Arc::clone(image) }))
    }

    /// The image that it shows.
    pub fn image(&self) -> &Arc<Image> {
        &self.image
    }

    /// Format that it shows the image in.
    pub fn format(&self) -> vk::Format {
        self.format
    }

    /// Number of layers it shows.
    pub fn layers(&self) -> u32 {
        self.layers
    }

    /// Width and height of its first mip level, in texels.
    pub fn size(&self) -> (u32, u32) {
        self.image.size(self.base_mip)
    }
}

impl Drop for ImageView {
    fn drop(&mut self) {
        // SAFETY: command buffers and descriptor sets that use the view hold an Arc of it until they are complete.
        unsafe { self.image.device.raw.destroy_image_view(self.raw, None) };
        Counters::sub(&self.image.device.counters.image_views, 1);
    }
}

/// Size of one side at a mip level, at least 1.
fn mip_size(side: u32, mip: u32) -> u32 {
    side.checked_shr(mip).unwrap_or(0).max(1)
}

/// Number of mip levels from `width`×`height` down to 1×1.
pub fn full_mips(width: u32, height: u32) -> u32 {
    32 - width.max(height).max(1).leading_zeros()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mip_chains_end_at_one() {
        assert_eq!(full_mips(1, 1), 1);
        assert_eq!(full_mips(1024, 3), 11);
        assert_eq!(full_mips(1023, 3), 10);
        assert_eq!((mip_size(1024, 10), mip_size(3, 10), mip_size(1, 40)), (1, 1, 1));
    }
}
