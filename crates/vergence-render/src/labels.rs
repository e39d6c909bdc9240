//! Texts: one quad per glyph, from an atlas of signed distances.

use std::sync::Arc;

use nalgebra::{Matrix3, Point3, Vector3};
use vergence_gpu::vk;
use vergence_gpu::{
    Attribute, BindingDesc, Blend, Bound, Buffer, DepthState, DescriptorSet, Device, Encoder,
    GraphicsPipeline, GraphicsPipelineDesc, ImageDesc, PipelineLayout, Sampler, SamplerDesc, SetLayout,
    ShaderModule, Stage, Upload, Use, VertexBuffer,
};
use vergence_scene::model::{Label, Scene, WorldTransforms};
use vergence_scene::text::{Atlas, Layout, Text};

use crate::Error;
use crate::meshes::at;
use crate::pipelines::DEPTH_COMPARE;
use crate::pose::largest_scale;
use crate::target::Target;

/// `Draw` of text.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
struct Push {
    color: [f32; 4],
    atlas: [f32; 2],
    texels_per_value: f32,
    rest: u32,
}

/// A text at a node.
struct LabelAt {
    node: usize,
    label: Label,
    radius_m: f64,
    first_index: u32,
    index_count: u32,
}

/// All texts of a scene on the device.
pub(crate) struct Labels {
    all: Vec<LabelAt>,
    vertices: Arc<Buffer>,
    indices: Arc<Buffer>,
    set: Arc<DescriptorSet>,
    pipeline: Arc<GraphicsPipeline>,
    atlas_size: [f32; 2],
    texels_per_value: f32,
}

/// Corners and triangles of the glyphs of the labels that nodes show.
#[derive(Default)]
struct Glyphs {
    all: Vec<LabelAt>,
    vertices: Vec<[f32; 4]>,
    indices: Vec<u32>,
}

impl Glyphs {
    fn add(&mut self, node: usize, label: &Label, layout: &Layout) {
        let first_index = self.indices.len() as u32;
        let mut radius_m = 0.0f64;
        for quad in &layout.quads {
            let base = self.vertices.len() as u32;
            let ([x0, y0], [x1, y1]) = (quad.min_m, quad.max_m);
            let ([u0, v0], [u1, v1]) = (quad.uv_min, quad.uv_max);
            self.vertices.extend([[x0, y0, u0, v0], [x1, y0, u1, v0], [x1, y1, u1, v1], [x0, y1, u0, v1]]);
            self.indices.extend([0, 1, 2, 0, 2, 3].map(|corner| base + corner));
            for (x, y) in [(x0, y0), (x1, y1), (x0, y1), (x1, y0)] {
                radius_m = radius_m.max(f64::from(x).hypot(f64::from(y)));
            }
        }
        let index_count = self.indices.len() as u32 - first_index;
        if index_count > 0 {
            self.all.push(LabelAt { node, label: label.clone(), radius_m, first_index, index_count });
        }
    }
}

impl Labels {
    /// Uploads atlas and glyphs; `None` where there is nothing to see.
    pub fn new(
        device: &Arc<Device>,
        upload: &mut Upload,
        scene: &Scene,
        frame_sets: &Arc<SetLayout>,
        target: &Target,
        samples: u32,
    ) -> Result<Option<Self>, Error> {
        let text = Text::new(&scene.labels);
        let mut glyphs = Glyphs::default();
        for (node_index, node) in scene.nodes.iter().enumerate() {
            let Some(label) = node.label else { continue };
            let layout = at("label layouts", &text.layouts, label)?;
            glyphs.add(node_index, at("labels", &scene.labels, label)?, layout);
        }
        if glyphs.all.is_empty() {
            return Ok(None);
        }
        let (set_layout, set) = atlas_set(device, upload, &text.atlas)?;
        let stages = vk::ShaderStageFlags::VERTEX | vk::ShaderStageFlags::FRAGMENT;
        let layout =
            PipelineLayout::new(device, &[frame_sets, &set_layout], stages, size_of::<Push>() as u32)?;
        Ok(Some(Self {
            vertices: upload.buffer("glyphs", &glyphs.vertices, vk::BufferUsageFlags::VERTEX_BUFFER)?,
            indices: upload.buffer("glyph indices", &glyphs.indices, vk::BufferUsageFlags::INDEX_BUFFER)?,
            all: glyphs.all,
            set,
            pipeline: pipeline(device, &layout, target, samples)?,
            atlas_size: [text.atlas.width as f32, text.atlas.height as f32],
            texels_per_value: 2.0 * text.atlas.range_texels,
        }))
    }

    /// A ball around each label, world coordinates; of a negative radius where its node is hidden.
    pub fn find_balls(&self, world: &WorldTransforms, hidden: &[bool], balls: &mut Vec<(Point3<f64>, f64)>) {
        balls.clear();
        balls.extend(self.all.iter().map(|label| {
            let world_from_node = &world.world_from_node[label.node];
            let scale = largest_scale(world_from_node);
            let radius_m = if hidden[label.node] { f64::NEG_INFINITY } else { scale * label.radius_m };
            (Point3::from(world_from_node.translation), radius_m)
        }));
    }

    /// How a label stands in the world: its linear part and its origin. A billboard turns about the vertical axis to
    /// `viewer`, the middle of all eyes: the same for every eye, so that both see one object.
    pub fn stand(
        &self,
        index: usize,
        world: &WorldTransforms,
        viewer: &Point3<f64>,
    ) -> (Matrix3<f64>, Point3<f64>) {
        let label = &self.all[index];
        let world_from_node = &world.world_from_node[label.node];
        let origin = Point3::from(world_from_node.translation);
        if !label.label.billboard {
            return (world_from_node.linear, origin);
        }
        let towards = viewer - origin;
        let z = Vector3::new(towards.x, 0.0, towards.z).try_normalize(1e-9).unwrap_or(Vector3::z());
        let y = Vector3::y();
        let scale = world_from_node.linear.column(0).norm();
        (Matrix3::from_columns(&[y.cross(&z), y, z]) * scale, origin)
    }

    /// Draws one label, whose frame and place begin at `windows` (bytes).
    pub fn draw(
        &self,
        encoder: &mut Encoder<'_>,
        frame_set: &Arc<DescriptorSet>,
        index: usize,
        windows: [u32; 3],
    ) {
        let label = &self.all[index];
        encoder.bind(&self.pipeline);
        encoder.bind_set(0, frame_set, &windows);
        encoder.bind_set(1, &self.set, &[]);
        encoder.vertex_buffer(0, &self.vertices, 0);
        encoder.index_buffer(&self.indices, 0, vk::IndexType::UINT32);
        let push = Push {
            color: label.label.color,
            atlas: self.atlas_size,
            texels_per_value: self.texels_per_value,
            rest: 0,
        };
        encoder.push(0, &push);
        encoder.draw_indexed(label.index_count, label.first_index, 0, 1, 0);
    }

    /// Number of labels.
    pub fn len(&self) -> usize {
        self.all.len()
    }
}

fn atlas_set(
    device: &Arc<Device>,
    upload: &mut Upload,
    atlas: &Atlas,
) -> Result<(Arc<SetLayout>, Arc<DescriptorSet>), Error> {
    let desc = ImageDesc {
        name: "glyph atlas",
        format: vk::Format::R8_UNORM,
        width: atlas.width,
        height: atlas.height,
        usage: vk::ImageUsageFlags::SAMPLED,
        ..ImageDesc::default()
    };
    let view = upload.image(&desc, &[&atlas.texels], false, Use::SampledAny)?.view()?;
    let clamp = vk::SamplerAddressMode::CLAMP_TO_EDGE;
    let sampler =
        Sampler::new(device, &SamplerDesc { address: [clamp; 2], max_lod: 0.0, ..Default::default() })?;
    let fragment = vk::ShaderStageFlags::FRAGMENT;
    let layout = SetLayout::new(
        device,
        &[
            BindingDesc::new(0, vk::DescriptorType::SAMPLED_IMAGE, fragment),
            BindingDesc::new(1, vk::DescriptorType::SAMPLER, fragment),
        ],
    )?;
    let set =
        DescriptorSet::new(&layout, &[(0, 0, Bound::Sampled(&view)), (1, 0, Bound::Sampler(&sampler))])?;
    Ok((layout, set))
}

fn pipeline(
    device: &Arc<Device>,
    layout: &Arc<PipelineLayout>,
    target: &Target,
    samples: u32,
) -> Result<Arc<GraphicsPipeline>, Error> {
    let vertex = vergence_shaders::TEXT_VERTEX.module(target.views_per_pass(device), 0);
    let fragment = vergence_shaders::TEXT_FRAGMENT.module(target.views_per_pass(device), 0);
    let vertex_module = ShaderModule::new(device, vertex.words())?;
    let fragment_module = ShaderModule::new(device, fragment.words())?;
    Ok(GraphicsPipeline::new(
        device,
        &GraphicsPipelineDesc {
            name: "text",
            layout,
            vertex: Stage { module: &vertex_module, entry: vertex.entry() },
            fragment: Some(Stage { module: &fragment_module, entry: fragment.entry() }),
            vertex_buffers: &[VertexBuffer {
                stride: 16,
                per_instance: false,
                attributes: &[
                    Attribute { location: 0, format: vk::Format::R32G32_SFLOAT, offset: 0 },
                    Attribute { location: 1, format: vk::Format::R32G32_SFLOAT, offset: 8 },
                ],
            }],
            topology: vk::PrimitiveTopology::TRIANGLE_LIST,
            // Readable from +z; from behind it is mirrored, as on a pane of glass.
            cull: vk::CullModeFlags::NONE,
            front: vk::FrontFace::COUNTER_CLOCKWISE,
            depth: Some(DepthState {
                format: target.depth_format,
                compare: DEPTH_COMPARE,
                // Ink writes depth (the shader discards the rest of a glyph's quad): a runtime that moves pixels by the
                // depth layer would move letters like the wall behind them otherwise. They are drawn from far to near.
                write: true,
                bias: None,
            }),
            colors: &[(target.color_format, Blend::Alpha)],
            samples,
            alpha_to_coverage: false,
            view_mask: target.view_mask(device),
        },
    )?)
}
