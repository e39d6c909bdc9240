//! What formats are made of.

use ash::vk;

/// Depth, stencil or colour.
pub(crate) fn aspect_of(format: vk::Format) -> vk::ImageAspectFlags {
    match format {
        vk::Format::D16_UNORM | vk::Format::D32_SFLOAT | vk::Format::X8_D24_UNORM_PACK32 => {
            vk::ImageAspectFlags::DEPTH
        }
        vk::Format::D16_UNORM_S8_UINT | vk::Format::D24_UNORM_S8_UINT | vk::Format::D32_SFLOAT_S8_UINT => {
            vk::ImageAspectFlags::DEPTH | vk::ImageAspectFlags::STENCIL
        }
        vk::Format::S8_UINT => vk::ImageAspectFlags::STENCIL,
        _ => vk::ImageAspectFlags::COLOR,
    }
}

/// Bytes of one texel as copied to or from a buffer (the depth aspect of depth formats); `None` for block-compressed formats.
pub fn texel_bytes(format: vk::Format) -> Option<u64> {
    use vk::Format as F;
    Some(match format {
        F::R8_UNORM | F::R8_SNORM | F::R8_UINT | F::R8_SRGB | F::S8_UINT => 1,
        F::R8G8_UNORM | F::R8G8_SNORM | F::R16_SFLOAT | F::R16_UNORM | F::R16_UINT => 2,
        F::D16_UNORM | F::D16_UNORM_S8_UINT => 2,
        F::R8G8B8A8_UNORM | F::R8G8B8A8_SRGB | F::R8G8B8A8_SNORM | F::R8G8B8A8_UINT => 4,
        F::B8G8R8A8_UNORM | F::B8G8R8A8_SRGB | F::A2B10G10R10_UNORM_PACK32 => 4,
        F::B10G11R11_UFLOAT_PACK32 | F::R32_SFLOAT | F::R32_UINT | F::R32_SINT => 4,
        F::R16G16_SFLOAT | F::R16G16_UNORM => 4,
        F::D32_SFLOAT | F::D32_SFLOAT_S8_UINT | F::X8_D24_UNORM_PACK32 | F::D24_UNORM_S8_UINT => 4,
        F::R16G16B16A16_SFLOAT | F::R16G16B16A16_UNORM | F::R32G32_SFLOAT | F::R32G32_UINT => 8,
        F::R32G32B32A32_SFLOAT | F::R32G32B32A32_UINT => 16,
        _ => return None,
    })
}
