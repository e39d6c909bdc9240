//! What each frame in flight owns, and where in its uniform buffers what stands.

use std::sync::Arc;

use vergence_gpu::vk;
use vergence_gpu::{
    BindingDesc, Bound, Buffer, CommandBuffer, DescriptorSet, Device, Memory, SetLayout, Upload,
};

use crate::cull::Item;
use crate::meshes::Meshes;
use crate::surfaces::PackedMaterial;
use crate::views::{PLACE_ROWS, PackedFrame};
use crate::{Error, Target};

/// What a frame in flight owns.
pub(crate) struct Slot {
    pub(crate) commands: CommandBuffer,
    pub(crate) frame: Arc<Buffer>,
    /// `None` where nothing is drawn.
    pub(crate) transforms: Option<Arc<Buffer>>,
    pub(crate) set: Option<Arc<DescriptorSet>>,
    /// In the order of transforms.
    pub(crate) items: Vec<Item>,
    pub(crate) state: State,
}

#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum State {
    Free,
    Begun,
    Latched,
}

impl Slot {
    pub(crate) fn new(
        device: &Arc<Device>,
        layout: &Arc<SetLayout>,
        windows: &Windows,
        materials: Option<&Arc<Buffer>>,
        timestamps: bool,
    ) -> Result<Self, Error> {
        const PASSES: u32 = 2;
        let bytes = u64::from(windows.frame_stride) * windows.passes as u64;
        let frame =
            Buffer::new(device, "frame", bytes, vk::BufferUsageFlags::UNIFORM_BUFFER, Memory::Upload)?;
        let uniform = vk::BufferUsageFlags::UNIFORM_BUFFER;
        let rows = windows.rows();
        let (mut transforms, mut set) = (None, None);
        if rows > 0 {
            let buffer = Buffer::new(device, "transforms", 16 * rows as u64, uniform, Memory::Upload)?;
            let bound = [
                (0, 0, Bound::BufferRange(&frame, 0, size_of::<PackedFrame>() as u64)),
                (1, 0, Bound::BufferRange(&buffer, 0, 16 * PLACE_ROWS as u64)),
                match materials {
                    Some(materials) => {
                        (2, 0, Bound::BufferRange(materials, 0, size_of::<PackedMaterial>() as u64))
                    }
                    // A scene of labels only has no materials; their shader does not look.
                    None => (2, 0, Bound::BufferRange(&buffer, 0, 16 * PLACE_ROWS as u64)),
                },
            ];
            set = Some(DescriptorSet::new(layout, &bound)?);
            transforms = Some(buffer);
        }
        let commands = CommandBuffer::new(device, "frame", if timestamps { PASSES } else { 0 })?;
        Ok(Self { commands, frame, transforms, set, items: Vec::new(), state: State::Free })
    }
}

/// The set that every draw of a frame is given.
pub(crate) fn frame_set_layout(device: &Arc<Device>) -> Result<Arc<SetLayout>, Error> {
    let stages = vk::ShaderStageFlags::VERTEX | vk::ShaderStageFlags::FRAGMENT;
    Ok(SetLayout::new(
        device,
        &[
            BindingDesc::new(0, vk::DescriptorType::UNIFORM_BUFFER_DYNAMIC, stages),
            BindingDesc::new(1, vk::DescriptorType::UNIFORM_BUFFER_DYNAMIC, vk::ShaderStageFlags::VERTEX),
            BindingDesc::new(2, vk::DescriptorType::UNIFORM_BUFFER_DYNAMIC, stages),
        ],
    )?)
}

/// Windows of the uniform buffers: a frame for each pass, a place for each pass and item, a material for each
/// material.
#[derive(Clone, Copy)]
pub(crate) struct Windows {
    /// One, or one for each view.
    pub(crate) passes: usize,
    pub(crate) items: usize,
    /// From one to the next: bytes.
    pub(crate) frame_stride: u32,
    /// From one to the next: rows of 16 bytes.
    pub(crate) place_stride: usize,
    /// From one to the next: bytes.
    pub(crate) material_stride: u32,
}

impl Windows {
    pub(crate) fn new(device: &Device, target: &Target, items: usize) -> Self {
        let alignment = (device.limits().uniform_alignment as usize).max(16);
        let views_per_pass = target.views_per_pass(device);
        Self {
            passes: (target.views / views_per_pass) as usize,
            items,
            frame_stride: size_of::<PackedFrame>().next_multiple_of(alignment) as u32,
            place_stride: (16 * (3 + 3 * views_per_pass as usize)).next_multiple_of(alignment) / 16,
            material_stride: size_of::<PackedMaterial>().next_multiple_of(alignment) as u32,
        }
    }

    /// First row of a place.
    pub(crate) fn place_row(&self, pass: usize, item: usize) -> usize {
        (pass * self.items + item) * self.place_stride
    }

    /// First byte of a place.
    pub(crate) fn place(&self, pass: usize, item: usize) -> u32 {
        16 * self.place_row(pass, item) as u32
    }

    /// Rows of all places; the last window is as long as all others.
    pub(crate) fn rows(&self) -> usize {
        if self.items == 0 { 0 } else { self.place_row(self.passes, 0) + PLACE_ROWS }
    }
}

pub(crate) fn upload_materials(
    upload: &mut Upload,
    meshes: &Meshes,
    windows: &Windows,
) -> Result<Option<Arc<Buffer>>, Error> {
    if meshes.materials.is_empty() {
        return Ok(None);
    }
    let mut bytes = Vec::with_capacity(meshes.materials.len() * windows.material_stride as usize);
    for material in &meshes.materials {
        bytes.extend_from_slice(bytemuck::bytes_of(material));
        bytes.resize(bytes.len().next_multiple_of(windows.material_stride as usize), 0);
    }
    Ok(Some(upload.buffer("materials", &bytes, vk::BufferUsageFlags::UNIFORM_BUFFER)?))
}
