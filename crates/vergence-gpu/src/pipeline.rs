//! Shader modules, pipeline layouts, graphics and compute pipelines.

use std::ffi::CString;
use std::sync::Arc;

use ash::vk;

use crate::census::Counters;
use crate::descriptor::SetLayout;
use crate::device::Device;
use crate::error::{At, Error};

/// Most colour attachments of a pass.
pub const MAX_COLORS: usize = 4;

/// A shader module.
pub struct ShaderModule {
    raw: vk::ShaderModule,
    device: Arc<Device>,
}

impl ShaderModule {
    /// Makes a module of SPIR-V words.
    ///
    /// The words must be valid SPIR-V: they come from our own build, which validates them.
    ///
    /// # Errors
    ///
    /// Words that do not begin as SPIR-V does, or a refusal by the driver.
    pub fn new(device: &Arc<Device>, spirv: &[u32]) -> Result<Arc<Self>, Error> {
        if spirv.first() != Some(&0x0723_0203) {
            return Err(Error::range(
                "first word of a shader",
                "the SPIR-V number 0x07230203",
                format_args!("{:x?}", spirv.first()),
            ));
        }
        let info = vk::ShaderModuleCreateInfo::default().code(spirv);
        // SAFETY: the words are SPIR-V.
        let raw = unsafe { device.raw.create_shader_module(&info, None) }.at("vkCreateShaderModule")?;
        Counters::add(&device.counters.shader_modules, 1);
        Ok(Arc::new(Self { raw, device: Arc::clone(device) }))
    }
}

impl Drop for ShaderModule {
    fn drop(&mut self) {
        // SAFETY: a module is used only while a pipeline is made.
        unsafe { self.device.raw.destroy_shader_module(self.raw, None) };
        Counters::sub(&self.device.counters.shader_modules, 1);
    }
}

/// One stage of a pipeline.
#[derive(Clone, Copy)]
pub struct Stage<'a> {
    /// The module.
    pub module: &'a Arc<ShaderModule>,
    /// Name of the entry point in it.
    pub entry: &'a str,
}

/// Descriptor sets and push constants that pipelines take. Pipelines that share a layout keep each other's bindings.
pub struct PipelineLayout {
    pub(crate) raw: vk::PipelineLayout,
    pub(crate) push_stages: vk::ShaderStageFlags,
    pub(crate) push_bytes: u32,
    sets: Vec<Arc<SetLayout>>,
    device: Arc<Device>,
}

impl PipelineLayout {
    /// Makes a layout of sets 0, 1, … and `push_bytes` of push constants (0 for none) seen by `push_stages`.
    ///
    /// # Errors
    ///
    /// More push constants than the device has.
    pub fn new(
        device: &Arc<Device>,
        sets: &[&Arc<SetLayout>],
        push_stages: vk::ShaderStageFlags,
        push_bytes: u32,
    ) -> Result<Arc<Self>, Error> {
        for set in sets {
            device.check_home(set.device())?;
        }
        let max = device.limits().max_push_bytes;
        if push_bytes > max || !push_bytes.is_multiple_of(4) {
            return Err(Error::range(
                "bytes of push constants",
                format_args!("a multiple of 4 up to {max}"),
                push_bytes,
            ));
        }
        let raw_sets: Vec<_> = sets.iter().map(|s| s.raw).collect();
        let ranges = [vk::PushConstantRange::default().stage_flags(push_stages).offset(0).size(push_bytes)];
        let info = vk::PipelineLayoutCreateInfo::default()
            .set_layouts(&raw_sets)
            .push_constant_ranges(if push_bytes == 0 { &[] } else { &ranges });
        // SAFETY: the set layouts are of this device and kept below.
        let raw = unsafe { device.raw.create_pipeline_layout(&info, None) }.at("vkCreatePipelineLayout")?;
        Counters::add(&device.counters.pipeline_layouts, 1);
        Ok(Arc::new(Self {
            raw,
            push_stages,
            push_bytes,
            sets: sets.iter().map(|s| Arc::clone(s)).collect(),
            device: Arc::clone(device),
        }))
    }

    /// The device that it lives on.
    pub fn device(&self) -> &Arc<Device> {
        &self.device
    }

    /// The sets, by number.
    pub fn sets(&self) -> &[Arc<SetLayout>] {
        &self.sets
    }
}

impl Drop for PipelineLayout {
    fn drop(&mut self) {
        // SAFETY: pipelines hold an Arc of it.
        unsafe { self.device.raw.destroy_pipeline_layout(self.raw, None) };
        Counters::sub(&self.device.counters.pipeline_layouts, 1);
    }
}

/// One vertex attribute.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Attribute {
    /// Location in the shader.
    pub location: u32,
    /// Format.
    pub format: vk::Format,
    /// Offset in the vertex, in bytes.
    pub offset: u32,
}

/// One vertex buffer; its binding number is its place in the list.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct VertexBuffer<'a> {
    /// Bytes from one vertex to the next.
    pub stride: u32,
    /// Whether it advances per instance.
    pub per_instance: bool,
    /// Its attributes.
    pub attributes: &'a [Attribute],
}

/// Depth test and write.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthState {
    /// Format of the depth attachment.
    pub format: vk::Format,
    /// Passes where `new compare old`; reversed-Z uses `GREATER` or `GREATER_OR_EQUAL`.
    pub compare: vk::CompareOp,
    /// Whether depth is written.
    pub write: bool,
    /// Constant and slope-scaled bias.
    pub bias: Option<(f32, f32)>,
}

/// How a colour is blended into its attachment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Blend {
    /// Replaces.
    #[default]
    Opaque,
    /// Over, with straight alpha; the attachment's alpha accumulates coverage.
    Alpha,
    /// Over, with premultiplied alpha.
    Premultiplied,
    /// Adds.
    Additive,
    /// Writes nothing (depth only).
    Nothing,
}

/// A graphics pipeline for dynamic rendering. Viewport and scissor are dynamic.
#[derive(Clone, Copy)]
pub struct GraphicsPipelineDesc<'a> {
    /// Name, for tools and messages.
    pub name: &'a str,
    /// Sets and push constants.
    pub layout: &'a Arc<PipelineLayout>,
    /// Vertex stage.
    pub vertex: Stage<'a>,
    /// Fragment stage, if there is one.
    pub fragment: Option<Stage<'a>>,
    /// Vertex buffers.
    pub vertex_buffers: &'a [VertexBuffer<'a>],
    /// Primitives.
    pub topology: vk::PrimitiveTopology,
    /// Faces that are not drawn.
    pub cull: vk::CullModeFlags,
    /// Which winding is the front (in framebuffer coordinates, y down).
    pub front: vk::FrontFace,
    /// Depth, if there is an attachment.
    pub depth: Option<DepthState>,
    /// Format and blending of each colour attachment, at most [`MAX_COLORS`].
    pub colors: &'a [(vk::Format, Blend)],
    /// Samples per pixel.
    pub samples: u32,
    /// Alpha becomes coverage (needs more than one sample).
    pub alpha_to_coverage: bool,
    /// Bit per view of a multiview pass; 0 for none.
    pub view_mask: u32,
}

/// A graphics pipeline.
pub struct GraphicsPipeline {
    pub(crate) raw: vk::Pipeline,
    pub(crate) layout: Arc<PipelineLayout>,
}

impl GraphicsPipeline {
    /// Compiles a pipeline.
    ///
    /// # Errors
    ///
    /// A number of samples or views that the device does not have, an entry name with a nul, or a refusal by the driver.
    pub fn new(device: &Arc<Device>, desc: &GraphicsPipelineDesc<'_>) -> Result<Arc<Self>, Error> {
        device.check_home(desc.layout.device())?;
        device.check_home(&desc.vertex.module.device)?;
        if let Some(fragment) = desc.fragment {
            device.check_home(&fragment.module.device)?;
        }
        if desc.colors.len() > MAX_COLORS {
            return Err(Error::range(
                "colour attachments",
                format_args!("at most {MAX_COLORS}"),
                desc.colors.len(),
            ));
        }
        let views = 32 - desc.view_mask.leading_zeros();
        if views > device.limits().max_views {
            return Err(Error::Unsupported {
                device: device.limits().name.clone(),
                asked: format!("{views} views"),
                offered: format!("at most {}", device.limits().max_views),
            });
        }
        let samples = device.limits().check_msaa(desc.samples)?;
        let vertex_entry = entry_name(desc.vertex.entry)?;
        let fragment_entry = entry_name(desc.fragment.map_or("", |f| f.entry))?;
        let mut stages = [vk::PipelineShaderStageCreateInfo::default(); 2];
        stages[0] =
            stages[0].stage(vk::ShaderStageFlags::VERTEX).module(desc.vertex.module.raw).name(&vertex_entry);
        let mut stage_count = 1;
        if let Some(fragment) = desc.fragment {
            stages[1] = stages[1]
                .stage(vk::ShaderStageFlags::FRAGMENT)
                .module(fragment.module.raw)
                .name(&fragment_entry);
            stage_count = 2;
        }
        let bindings: Vec<_> = desc
            .vertex_buffers
            .iter()
            .enumerate()
            .map(|(i, b)| {
                vk::VertexInputBindingDescription::default().binding(i as u32).stride(b.stride).input_rate(
                    if b.per_instance { vk::VertexInputRate::INSTANCE } else { vk::VertexInputRate::VERTEX },
                )
            })
            .collect();
        let attributes: Vec<_> = desc
            .vertex_buffers
            .iter()
            .enumerate()
            .flat_map(|(i, b)| {
                b.attributes.iter().map(move |a| {
                    vk::VertexInputAttributeDescription::default()
                        .binding(i as u32)
                        .location(a.location)
                        .format(a.format)
                        .offset(a.offset)
                })
            })
            .collect();
        let vertex_input = vk::PipelineVertexInputStateCreateInfo::default()
            .vertex_binding_descriptions(&bindings)
            .vertex_attribute_descriptions(&attributes);
        let assembly = vk::PipelineInputAssemblyStateCreateInfo::default().topology(desc.topology);
        let viewport = vk::PipelineViewportStateCreateInfo::default().viewport_count(1).scissor_count(1);
        let bias = desc.depth.and_then(|d| d.bias);
        let raster = vk::PipelineRasterizationStateCreateInfo::default()
            .polygon_mode(vk::PolygonMode::FILL)
            .cull_mode(desc.cull)
            .front_face(desc.front)
            .depth_bias_enable(bias.is_some())
            .depth_bias_constant_factor(bias.map_or(0.0, |b| b.0))
            .depth_bias_slope_factor(bias.map_or(0.0, |b| b.1))
            .line_width(1.0);
        let multisample = vk::PipelineMultisampleStateCreateInfo::default()
            .rasterization_samples(samples)
            .alpha_to_coverage_enable(desc.alpha_to_coverage && desc.samples > 1);
        let depth = desc.depth.map_or(vk::PipelineDepthStencilStateCreateInfo::default(), |d| {
            vk::PipelineDepthStencilStateCreateInfo::default()
                .depth_test_enable(true)
                .depth_write_enable(d.write)
                .depth_compare_op(d.compare)
        });
        let blends: Vec<_> = desc.colors.iter().map(|(_, blend)| blend_state(*blend)).collect();
        let blend = vk::PipelineColorBlendStateCreateInfo::default().attachments(&blends);
        let dynamic = [vk::DynamicState::VIEWPORT, vk::DynamicState::SCISSOR];
        let dynamic = vk::PipelineDynamicStateCreateInfo::default().dynamic_states(&dynamic);
        let formats: Vec<_> = desc.colors.iter().map(|(format, _)| *format).collect();
        let mut rendering = vk::PipelineRenderingCreateInfo::default()
            .view_mask(desc.view_mask)
            .color_attachment_formats(&formats)
            .depth_attachment_format(desc.depth.map_or(vk::Format::UNDEFINED, |d| d.format));
        let info = vk::GraphicsPipelineCreateInfo::default()
            .stages(&stages[..stage_count])
            .vertex_input_state(&vertex_input)
            .input_assembly_state(&assembly)
            .viewport_state(&viewport)
            .rasterization_state(&raster)
            .multisample_state(&multisample)
            .depth_stencil_state(&depth)
            .color_blend_state(&blend)
            .dynamic_state(&dynamic)
            .layout(desc.layout.raw)
            .push_next(&mut rendering);
        // SAFETY: everything that the create info refers to is alive and of this device.
        let made = unsafe { device.raw.create_graphics_pipelines(device.pipeline_cache, &[info], None) };
        let raw = first_pipeline(made, "vkCreateGraphicsPipelines")?;
        device.name(raw, desc.name);
        Counters::add(&device.counters.graphics_pipelines, 1);
        Ok(Arc::new(Self { raw, layout: Arc::clone(desc.layout) }))
    }

    /// Its layout.
    pub fn layout(&self) -> &Arc<PipelineLayout> {
        &self.layout
    }
}

impl Drop for GraphicsPipeline {
    fn drop(&mut self) {
        // SAFETY: command buffers that use it hold an Arc of it until they are complete.
        unsafe { self.layout.device.raw.destroy_pipeline(self.raw, None) };
        Counters::sub(&self.layout.device.counters.graphics_pipelines, 1);
    }
}

/// A compute pipeline.
pub struct ComputePipeline {
    pub(crate) raw: vk::Pipeline,
    pub(crate) layout: Arc<PipelineLayout>,
}

impl ComputePipeline {
    /// Compiles a pipeline.
    ///
    /// # Errors
    ///
    /// An entry name with a nul, or a refusal by the driver.
    pub fn new(
        device: &Arc<Device>,
        name: &str,
        layout: &Arc<PipelineLayout>,
        stage: Stage<'_>,
    ) -> Result<Arc<Self>, Error> {
        device.check_home(layout.device())?;
        device.check_home(&stage.module.device)?;
        let entry = entry_name(stage.entry)?;
        let info = vk::ComputePipelineCreateInfo::default().layout(layout.raw).stage(
            vk::PipelineShaderStageCreateInfo::default()
                .stage(vk::ShaderStageFlags::COMPUTE)
                .module(stage.module.raw)
                .name(&entry),
        );
        // SAFETY: everything that the create info refers to is alive and of this device.
        let made = unsafe { device.raw.create_compute_pipelines(device.pipeline_cache, &[info], None) };
        let raw = first_pipeline(made, "vkCreateComputePipelines")?;
        device.name(raw, name);
        Counters::add(&device.counters.compute_pipelines, 1);
        Ok(Arc::new(Self { raw, layout: Arc::clone(layout) }))
    }

    /// Its layout.
    pub fn layout(&self) -> &Arc<PipelineLayout> {
        &self.layout
    }
}

impl Drop for ComputePipeline {
    fn drop(&mut self) {
        // SAFETY: command buffers that use it hold an Arc of it until they are complete.
        unsafe { self.layout.device.raw.destroy_pipeline(self.raw, None) };
        Counters::sub(&self.layout.device.counters.compute_pipelines, 1);
    }
}

fn entry_name(name: &str) -> Result<CString, Error> {
    CString::new(name)
        .map_err(|_| Error::range("entry point", "a name without nul", format_args!("{name:?}")))
}

fn first_pipeline(
    made: Result<Vec<vk::Pipeline>, (Vec<vk::Pipeline>, vk::Result)>,
    call: &'static str,
) -> Result<vk::Pipeline, Error> {
    // A failed creation of one pipeline gives a null handle: nothing to destroy.
    made.map_err(|(_, result)| result).at(call).map(|pipelines| pipelines[0])
}

fn blend_state(blend: Blend) -> vk::PipelineColorBlendAttachmentState {
    let state =
        vk::PipelineColorBlendAttachmentState::default().color_write_mask(vk::ColorComponentFlags::RGBA);
    let factors = |source, destination| {
        state
            .blend_enable(true)
            .src_color_blend_factor(source)
            .dst_color_blend_factor(destination)
            .color_blend_op(vk::BlendOp::ADD)
            .src_alpha_blend_factor(vk::BlendFactor::ONE)
            .dst_alpha_blend_factor(if blend == Blend::Additive {
                vk::BlendFactor::ONE
            } else {
                vk::BlendFactor::ONE_MINUS_SRC_ALPHA
            })
            .alpha_blend_op(vk::BlendOp::ADD)
    };
    match blend {
        Blend::Opaque => state,
        Blend::Alpha => factors(vk::BlendFactor::SRC_ALPHA, vk::BlendFactor::ONE_MINUS_SRC_ALPHA),
        Blend::Premultiplied => factors(vk::BlendFactor::ONE, vk::BlendFactor::ONE_MINUS_SRC_ALPHA),
        Blend::Additive => factors(vk::BlendFactor::ONE, vk::BlendFactor::ONE),
        Blend::Nothing => state.color_write_mask(vk::ColorComponentFlags::empty()),
    }
}
