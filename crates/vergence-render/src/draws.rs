//! Draws of surfaces: what is bound for each, and nothing twice.

use std::sync::Arc;

use vergence_gpu::vk;
use vergence_gpu::{Buffer, DescriptorSet, Device, Encoder, Upload};

use crate::meshes::Meshes;
use crate::pipelines::KindPipelines;
use crate::pose::Pose;
use crate::slots::Windows;
use crate::textures::TextureSet;
use crate::{Error, Target};

/// Where the scene's vertices are.
pub(crate) struct Geometry {
    pub(crate) moving: Option<Arc<Buffer>>,
    pub(crate) sticking: Option<Arc<Buffer>>,
    pub(crate) indices: Arc<Buffer>,
}

pub(crate) fn upload_geometry(upload: &mut Upload, meshes: &Meshes) -> Result<Option<Geometry>, Error> {
    if meshes.indices.is_empty() {
        return Ok(None);
    }
    let mut stream = |name, data: &[f32]| -> Result<Option<Arc<Buffer>>, Error> {
        if data.is_empty() {
            return Ok(None);
        }
        Ok(Some(upload.buffer(name, data, vk::BufferUsageFlags::VERTEX_BUFFER)?))
    };
    let moving = stream("vertices", &meshes.moving)?;
    let sticking = stream("vertex attributes", &meshes.sticking)?;
    let indices = upload.buffer("indices", &meshes.indices, vk::BufferUsageFlags::INDEX_BUFFER)?;
    Ok(Some(Geometry { moving, sticking, indices }))
}

/// Whether a node turns its triangles over (joints decide for themselves: they rarely do).
pub(crate) fn is_mirrored(pose: &Pose, node: usize, skin: Option<usize>) -> bool {
    skin.is_none() && pose.world.world_from_node[node].linear.determinant() < 0.0
}

/// What is bound, by index, so that nothing is bound twice.
#[derive(Default, PartialEq, Clone, Copy)]
pub(crate) struct Bindings {
    pub(crate) pipeline: Option<(usize, bool)>,
    pub(crate) texture_set: Option<usize>,
    pub(crate) group: Option<usize>,
    pub(crate) indices: bool,
}

/// Records the draws of one frame.
pub(crate) struct Draws<'a> {
    pub(crate) meshes: &'a Meshes,
    pub(crate) pose: &'a Pose,
    pub(crate) geometry: Option<&'a Geometry>,
    pub(crate) skinned: Option<&'a Arc<Buffer>>,
    pub(crate) textures: &'a [TextureSet],
    pub(crate) kinds: &'a mut [KindPipelines],
    pub(crate) device: &'a Arc<Device>,
    pub(crate) target: &'a Target,
    pub(crate) samples: u32,
    pub(crate) lights: vergence_shaders::Lights,
    pub(crate) set: &'a Arc<DescriptorSet>,
    pub(crate) windows: Windows,
    pub(crate) pass: u32,
    pub(crate) bound: Bindings,
    pub(crate) triangles: u64,
}

impl Draws<'_> {
    pub(crate) fn part(&mut self, encoder: &mut Encoder<'_>, index: usize, place: u32) -> Result<(), Error> {
        let Some(geometry) = self.geometry else { return Ok(()) };
        let drawable = &self.meshes.drawables[index];
        let mirrored = is_mirrored(self.pose, drawable.node, drawable.skin);
        let pipeline = Some((drawable.kind, mirrored));
        if self.bound.pipeline != pipeline {
            let kind = &mut self.kinds[drawable.kind];
            let made = kind.get(self.device, self.target, self.samples, self.lights, mirrored)?;
            encoder.bind(made);
            self.bound.pipeline = pipeline;
            self.bound.texture_set = None;
        }
        if self.bound.texture_set != Some(drawable.texture_set) {
            if let Some(set) = &self.textures[drawable.texture_set].set {
                encoder.bind_set(1, set, &[]);
            }
            self.bound.texture_set = Some(drawable.texture_set);
        }
        if self.bound.group != Some(drawable.group) {
            let group = &self.meshes.groups[drawable.group];
            let moving = if group.skinned { self.skinned } else { geometry.moving.as_ref() };
            if let Some(moving) = moving {
                encoder.vertex_buffer(0, moving, group.moving_offset);
            }
            if let Some(sticking) = geometry.sticking.as_ref().filter(|_| group.layout.sticking() > 0) {
                encoder.vertex_buffer(1, sticking, group.sticking_offset);
            }
            self.bound.group = Some(drawable.group);
        }
        if !self.bound.indices {
            encoder.index_buffer(&geometry.indices, 0, vk::IndexType::UINT16);
            self.bound.indices = true;
        }
        let material = drawable.material * self.windows.material_stride;
        encoder.bind_set(0, self.set, &[self.pass * self.windows.frame_stride, place, material]);
        encoder.draw_indexed(drawable.index_count, drawable.first_index, drawable.base_vertex, 1, 0);
        self.triangles += u64::from(drawable.index_count / 3);
        Ok(())
    }
}
