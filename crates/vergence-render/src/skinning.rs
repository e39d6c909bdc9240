//! Linear-blend skinning: a compute pass that moves vertices once per frame, for all views.

use std::sync::Arc;

use vergence_gpu::vk;
use vergence_gpu::{
    BindingDesc, Bound, Buffer, BufferBarrier, ComputePipeline, DescriptorSet, Device, Encoder, Memory,
    PipelineLayout, SetLayout, ShaderModule, Stage, Upload, Use,
};

use crate::Error;
use crate::meshes::Meshes;

/// `Job` of skin.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
struct Job {
    count: u32,
    stride: u32,
    source: u32,
    result: u32,
    influence: u32,
    joint: u32,
}

/// The pass, its pipeline and its buffers.
pub(crate) struct Skinning {
    pipeline: Arc<ComputePipeline>,
    jobs: Vec<Job>,
    /// Where the moved vertices are; in the places of the source.
    pub result: Arc<Buffer>,
    /// Per frame in flight.
    frames: Vec<(Arc<Buffer>, Arc<DescriptorSet>)>,
}

impl Skinning {
    /// Uploads what joints move; `None` where there is nothing.
    pub fn new(
        device: &Arc<Device>,
        upload: &mut Upload,
        meshes: &Meshes,
        frames: usize,
    ) -> Result<Option<Self>, Error> {
        if meshes.skin_jobs.is_empty() {
            return Ok(None);
        }
        let storage = vk::BufferUsageFlags::STORAGE_BUFFER;
        let source = upload.buffer("skin source", &meshes.skin_source, storage)?;
        let influences = upload.buffer("skin influences", &meshes.influences, storage)?;
        let usage = storage | vk::BufferUsageFlags::VERTEX_BUFFER;
        let result = Buffer::new(device, "skin result", source.size(), usage, Memory::Device)?;
        let binding = |number| {
            BindingDesc::new(number, vk::DescriptorType::STORAGE_BUFFER, vk::ShaderStageFlags::COMPUTE)
        };
        let set_layout = SetLayout::new(device, &[0, 1, 2, 3].map(binding))?;
        let layout = PipelineLayout::new(
            device,
            &[&set_layout],
            vk::ShaderStageFlags::COMPUTE,
            size_of::<Job>() as u32,
        )?;
        let shader = vergence_shaders::SKIN_SKIN.module(1, 0);
        let module = ShaderModule::new(device, shader.words())?;
        let stage = Stage { module: &module, entry: shader.entry() };
        let pipeline = ComputePipeline::new(device, "skinning", &layout, stage)?;
        let bytes = 16 * 6 * meshes.joints.max(1) as u64;
        let frames = (0..frames)
            .map(|_| {
                let joints = Buffer::new(device, "joints", bytes, storage, Memory::Upload)?;
                let set = DescriptorSet::new(
                    &set_layout,
                    &[
                        (0, 0, Bound::Buffer(&joints)),
                        (1, 0, Bound::Buffer(&influences)),
                        (2, 0, Bound::Buffer(&source)),
                        (3, 0, Bound::Buffer(&result)),
                    ],
                )?;
                Ok((joints, set))
            })
            .collect::<Result<_, Error>>()?;
        let jobs = meshes
            .skin_jobs
            .iter()
            .map(|job| {
                let group = &meshes.groups[job.group];
                let stride = group.layout.moving() as u32;
                let first = (group.moving_offset / 4) as u32 + job.first_vertex * stride;
                Job {
                    count: job.count,
                    stride,
                    source: first,
                    result: first,
                    influence: job.first_influence,
                    joint: 6 * meshes.skins[job.skin].first_joint as u32,
                }
            })
            .collect();
        Ok(Some(Self { pipeline, jobs, result, frames }))
    }

    /// Writes the joints of a frame.
    pub fn write(&self, slot: usize, joint_rows: &[[f32; 4]]) -> Result<(), Error> {
        Ok(self.frames[slot].0.write(0, joint_rows)?)
    }

    /// Moves all vertices; before any rendering.
    pub fn record(&self, encoder: &mut Encoder<'_>, slot: usize) {
        let barrier = |from, to| BufferBarrier { buffer: &self.result, from, to };
        encoder.barrier(&[], &[barrier(Use::Vertex, Use::Storage)]);
        encoder.bind_compute(&self.pipeline);
        encoder.bind_set(0, &self.frames[slot].1, &[]);
        for job in &self.jobs {
            encoder.push(0, job);
            encoder.dispatch(job.count.div_ceil(vergence_shaders::SKIN_GROUP), 1, 1);
        }
        encoder.barrier(&[], &[barrier(Use::Storage, Use::Vertex)]);
    }
}
