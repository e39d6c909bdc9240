//! Pipelines for surfaces: one per kind, and one more where a mirrored node turns its triangles over.

use std::sync::Arc;

use vergence_gpu::vk;
use vergence_gpu::{
    Attribute, Blend, DepthState, Device, GraphicsPipeline, GraphicsPipelineDesc, PipelineLayout, SetLayout,
    ShaderModule, Stage, VertexBuffer,
};
use vergence_scene::Coverage;

use crate::Error;
use crate::meshes::Kind;
use crate::surfaces::Layout;
use crate::target::Target;

/// Reversed depth: nearer is greater.
pub(crate) const DEPTH_COMPARE: vk::CompareOp = vk::CompareOp::GREATER;

/// A kind of surface on the device.
pub(crate) struct KindPipelines {
    kind: Kind,
    layout: Arc<PipelineLayout>,
    /// Whether its textures are filtered so.
    anisotropic: bool,
    /// Upright and mirrored; each made when it is first needed.
    made: [Option<Arc<GraphicsPipeline>>; 2],
}

impl KindPipelines {
    pub fn new(
        device: &Arc<Device>,
        kind: Kind,
        frame_sets: &Arc<SetLayout>,
        textures: &Arc<SetLayout>,
        anisotropic: bool,
    ) -> Result<Self, Error> {
        let layout = PipelineLayout::new(device, &[frame_sets, textures], vk::ShaderStageFlags::empty(), 0)?;
        Ok(Self { kind, layout, anisotropic, made: [None, None] })
    }

    /// The pipeline, made where it is missing.
    pub fn get(
        &mut self,
        device: &Arc<Device>,
        target: &Target,
        samples: u32,
        lights: vergence_shaders::Lights,
        mirrored: bool,
    ) -> Result<&Arc<GraphicsPipeline>, Error> {
        let place = &mut self.made[usize::from(mirrored)];
        if place.is_none() {
            let drawn = Drawn { kind: self.kind, samples, lights, mirrored, anisotropic: self.anisotropic };
            *place = Some(make(device, &drawn, &self.layout, target)?);
        }
        Ok(place.as_ref().expect("filled above"))
    }
}

/// What a pipeline draws, and how.
struct Drawn {
    kind: Kind,
    samples: u32,
    lights: vergence_shaders::Lights,
    mirrored: bool,
    anisotropic: bool,
}

fn make(
    device: &Arc<Device>,
    drawn: &Drawn,
    layout: &Arc<PipelineLayout>,
    target: &Target,
) -> Result<Arc<GraphicsPipeline>, Error> {
    let &Drawn { kind: Kind { surface, variant }, samples, lights, mirrored, anisotropic } = drawn;
    let handed_on = variant.lit() && device.limits().software && target.views_per_pass(device) == 1;
    let bounded_footprint =
        anisotropic && variant.uses_uv() && device.limits().software && (handed_on || !variant.lit());
    let variant = vergence_shaders::Variant { handed_on, bounded_footprint, ..variant };
    let missing = || Error::range("surface", "a variant that makes sense", format!("{variant:?}"));
    let vertex =
        vergence_shaders::surface_vertex(&variant, target.views_per_pass(device)).ok_or_else(missing)?;
    let fragment = vergence_shaders::surface_fragment(&variant, target.views_per_pass(device), lights)
        .ok_or_else(missing)?;
    let vertex_module = ShaderModule::new(device, vertex.words())?;
    let fragment_module = ShaderModule::new(device, fragment.words())?;
    let (moving, sticking) = attributes(Layout::of(&variant));
    let stride = |attributes: &[Attribute]| attributes.iter().map(|a| floats(a.format) * 4).sum::<u32>();
    let buffers = [
        VertexBuffer { stride: stride(&moving), per_instance: false, attributes: &moving },
        VertexBuffer { stride: stride(&sticking), per_instance: false, attributes: &sticking },
    ];
    let blended = surface.coverage == Coverage::Blend;
    Ok(GraphicsPipeline::new(
        device,
        &GraphicsPipelineDesc {
            name: "surface",
            layout,
            vertex: Stage { module: &vertex_module, entry: vertex.entry() },
            fragment: Some(Stage { module: &fragment_module, entry: fragment.entry() }),
            vertex_buffers: &buffers[..if sticking.is_empty() { 1 } else { 2 }],
            topology: vk::PrimitiveTopology::TRIANGLE_LIST,
            cull: if surface.double_sided { vk::CullModeFlags::NONE } else { vk::CullModeFlags::BACK },
            front: if mirrored { vk::FrontFace::CLOCKWISE } else { vk::FrontFace::COUNTER_CLOCKWISE },
            depth: Some(DepthState {
                format: target.depth_format,
                compare: DEPTH_COMPARE,
                write: !blended,
                bias: None,
            }),
            colors: &[(target.color_format, if blended { Blend::Alpha } else { Blend::Opaque })],
            samples,
            alpha_to_coverage: false,
            view_mask: target.view_mask(device),
        },
    )?)
}

/// Attributes of the stream that moves and of the stream that sticks.
fn attributes(layout: Layout) -> (Vec<Attribute>, Vec<Attribute>) {
    const VEC2: vk::Format = vk::Format::R32G32_SFLOAT;
    const VEC3: vk::Format = vk::Format::R32G32B32_SFLOAT;
    const VEC4: vk::Format = vk::Format::R32G32B32A32_SFLOAT;
    let pack = |wanted: &[(bool, u32, vk::Format)]| {
        let mut offset = 0;
        let used = wanted.iter().filter(|(used, ..)| *used);
        used.map(|&(_, location, format)| {
            let attribute = Attribute { location, format, offset };
            offset += 4 * floats(format);
            attribute
        })
        .collect()
    };
    (
        pack(&[(true, 0, VEC3), (layout.normal, 1, VEC3), (layout.tangent, 2, VEC4)]),
        pack(&[(layout.uvs > 0, 3, VEC2), (layout.uvs > 1, 4, VEC2), (layout.color, 5, VEC4)]),
    )
}

const fn floats(format: vk::Format) -> u32 {
    match format {
        vk::Format::R32G32_SFLOAT => 2,
        vk::Format::R32G32B32_SFLOAT => 3,
        _ => 4,
    }
}
