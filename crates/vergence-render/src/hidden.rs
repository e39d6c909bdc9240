//! The visibility mask: what the lens hides of a view is never drawn.

use std::sync::Arc;

use vergence_gpu::vk;
use vergence_gpu::{
    Attribute, Blend, Buffer, DepthState, DescriptorSet, Device, Encoder, GraphicsPipeline,
    GraphicsPipelineDesc, PipelineLayout, SetLayout, ShaderModule, Stage, Upload, VertexBuffer,
};

use crate::Error;
use crate::target::Target;

/// The hidden areas of all views on the device.
pub(crate) struct Hidden {
    vertices: Arc<Buffer>,
    indices: Arc<Buffer>,
    count: u32,
    pipeline: Arc<GraphicsPipeline>,
}

impl Hidden {
    /// `areas`: for each view the corners (x, y in the plane z = −1 of the eye) and triangles of what is hidden;
    /// `None` where nothing is.
    pub fn new(
        device: &Arc<Device>,
        upload: &mut Upload,
        areas: &[(Vec<[f32; 2]>, Vec<u32>)],
        frame_sets: &Arc<SetLayout>,
        target: &Target,
        samples: u32,
    ) -> Result<Option<Self>, Error> {
        let (mut vertices, mut indices): (Vec<[f32; 3]>, Vec<u32>) = (Vec::new(), Vec::new());
        for (view, (corners, triangles)) in areas.iter().enumerate() {
            let base = vertices.len() as u32;
            if let Some(&found) = triangles.iter().find(|&&index| index as usize >= corners.len()) {
                return Err(Error::Index {
                    what: "mask vertices",
                    len: corners.len(),
                    found: found as usize,
                });
            }
            vertices.extend(corners.iter().map(|&[x, y]| [x, y, view as f32]));
            indices.extend(triangles.iter().map(|index| base + index));
        }
        if indices.is_empty() {
            return Ok(None);
        }
        let layout = PipelineLayout::new(device, &[frame_sets], vk::ShaderStageFlags::VERTEX, 4)?;
        let vertex = vergence_shaders::VISIBILITY_VERTEX.module(target.views_per_pass(device), 0);
        let module = ShaderModule::new(device, vertex.words())?;
        let pipeline = GraphicsPipeline::new(
            device,
            &GraphicsPipelineDesc {
                name: "visibility mask",
                layout: &layout,
                vertex: Stage { module: &module, entry: vertex.entry() },
                fragment: None,
                vertex_buffers: &[VertexBuffer {
                    stride: 12,
                    per_instance: false,
                    attributes: &[Attribute { location: 0, format: vk::Format::R32G32B32_SFLOAT, offset: 0 }],
                }],
                topology: vk::PrimitiveTopology::TRIANGLE_LIST,
                cull: vk::CullModeFlags::NONE,
                front: vk::FrontFace::COUNTER_CLOCKWISE,
                depth: Some(DepthState {
                    format: target.depth_format,
                    compare: vk::CompareOp::ALWAYS,
                    write: true,
                    bias: None,
                }),
                colors: &[(target.color_format, Blend::Nothing)],
                samples,
                alpha_to_coverage: false,
                view_mask: target.view_mask(device),
            },
        )?;
        Ok(Some(Self {
            vertices: upload.buffer("mask", &vertices, vk::BufferUsageFlags::VERTEX_BUFFER)?,
            indices: upload.buffer("mask indices", &indices, vk::BufferUsageFlags::INDEX_BUFFER)?,
            count: indices.len() as u32,
            pipeline,
        }))
    }

    /// Draws it in a pass from `first_view` on, whose frame begins at byte `frame`; before everything else.
    pub fn draw(
        &self,
        encoder: &mut Encoder<'_>,
        frame_set: &Arc<DescriptorSet>,
        frame: u32,
        first_view: u32,
    ) {
        encoder.bind(&self.pipeline);
        encoder.bind_set(0, frame_set, &[frame, 0, 0]);
        encoder.push(0, &first_view);
        encoder.vertex_buffer(0, &self.vertices, 0);
        encoder.index_buffer(&self.indices, 0, vk::IndexType::UINT32);
        encoder.draw_indexed(self.count, 0, 0, 1, 0);
    }
}
