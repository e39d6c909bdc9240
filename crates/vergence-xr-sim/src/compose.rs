//! Composition: from the layers that were submitted to the pictures that the eyes see.

use std::sync::Arc;

use vergence_geom::{Rigid, View};
use vergence_gpu::vk;
use vergence_gpu::{
    Area, BindingDesc, Blend, Bound, Buffer, BufferBarrier, ColorAttachment, CommandBuffer, DescriptorSet,
    Device, Error, GraphicsPipeline, GraphicsPipelineDesc, Image, ImageBarrier, ImageDesc, ImageView, Load,
    Memory, PipelineLayout, Rendering, Sampler, SamplerDesc, SetLayout, ShaderModule, Stage, Use, ViewDesc,
};
use vergence_shaders::{COMPOSE_FRAGMENT, COMPOSE_VERTEX};
use vergence_time::Timestamp;

use crate::layer::{Content, Layer, SubImage};

/// Up to this angle (radians) between the pose that a layer was drawn for and the true one, and between the sides of the
/// two fields of view, a picture of the right size is copied: 1/1000 pixel on the finest headset. Poses go through `f32`.
const SAME_RAD: f64 = 1e-6;

/// The formats that the pictures are composed in: that of the first layer, so that it can be copied bit by bit.
const FORMATS: [vk::Format; 2] = [vk::Format::R8G8B8A8_SRGB, vk::Format::B8G8R8A8_SRGB];

/// Makes composed pictures of one size on one device.
pub(crate) struct Composer {
    device: Arc<Device>,
    size: (u32, u32),
    commands: CommandBuffer,
    sets: Arc<SetLayout>,
    layout: Arc<PipelineLayout>,
    modules: [Arc<ShaderModule>; 2],
    sampler: Arc<Sampler>,
    targets: [Option<Target>; 2],
    read_back: Arc<Buffer>,
}

/// A picture for each eye, and the pipelines that draw to it: without and with blending.
struct Target {
    image: Arc<Image>,
    views: [Arc<ImageView>; 2],
    pipelines: [Arc<GraphicsPipeline>; 2],
}

/// As in `shaders/compose.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Constants {
    axes: [[f32; 4]; 3],
    eye: [f32; 4],
    source: [f32; 4],
    rect: [f32; 4],
    half_texel: [f32; 2],
    array_layer: u32,
    flags: u32,
}

const QUAD: u32 = 1;
const IGNORE_ALPHA: u32 = 2;
const STRAIGHT_ALPHA: u32 = 4;

/// One layer as one eye gets it.
struct Source<'a> {
    image: &'a SubImage,
    shown: Arc<Image>,
    /// Eye coordinates to those of the projection's eye, or of the quad.
    source_from_eye: Rigid,
    /// Left, right, up, down of the source, as in the shader.
    sides: [f64; 4],
    layer: &'a Layer,
}

impl Composer {
    pub(crate) fn new(device: &Arc<Device>, size: (u32, u32)) -> Result<Self, Error> {
        let stages = vk::ShaderStageFlags::FRAGMENT;
        let bindings = [
            BindingDesc::new(0, vk::DescriptorType::SAMPLED_IMAGE, stages),
            BindingDesc::new(1, vk::DescriptorType::SAMPLER, stages),
        ];
        let sets = SetLayout::new(device, &bindings)?;
        let layout = PipelineLayout::new(device, &[&sets], stages, size_of::<Constants>() as u32)?;
        let (vertex, fragment) = (COMPOSE_VERTEX.module(1, 0), COMPOSE_FRAGMENT.module(1, 0));
        let modules =
            [ShaderModule::new(device, vertex.words())?, ShaderModule::new(device, fragment.words())?];
        let sampler = Sampler::new(
            device,
            &SamplerDesc { address: [vk::SamplerAddressMode::CLAMP_TO_EDGE; 2], ..SamplerDesc::default() },
        )?;
        let bytes = 2 * picture_bytes(size) as u64;
        let read_back = Buffer::new(
            device,
            "xr-sim read back",
            bytes,
            vk::BufferUsageFlags::TRANSFER_DST,
            Memory::ReadBack,
        )?;
        Ok(Self {
            device: device.clone(),
            size,
            commands: CommandBuffer::new(device, "xr-sim composition", 0)?,
            sets,
            layout,
            modules,
            sampler,
            targets: [None, None],
            read_back,
        })
    }

    /// Composes and reads back: RGBA8, sRGB, one picture for each eye. `views` are where the eyes are in the stage at
    /// the instant `display`, and what they see.
    pub(crate) fn compose(
        &mut self,
        views: &[View; 2],
        layers: &[Layer],
        display: Timestamp,
    ) -> Result<[Vec<u8>; 2], Error> {
        let sources = [0, 1].map(|eye| sources(&views[eye], eye, layers, display));
        let first = sources[0].first().or(sources[1].first());
        let format = first.map_or(FORMATS[0], |source| source.shown.format());
        let which = usize::from(format == FORMATS[1]);
        self.ready_target(which)?;
        let Self { device, commands, targets, read_back, size, .. } = self;
        let Some(target) = &targets[which] else { return Ok([Vec::new(), Vec::new()]) };
        // Made before recording: sets are kept by the command buffer until the frame is read back.
        let mut drawn: Vec<(usize, &Source, Option<Arc<DescriptorSet>>)> = Vec::new();
        let mut seen: Vec<Arc<Image>> = Vec::new();
        for (eye, sources) in sources.iter().enumerate() {
            for (index, source) in sources.iter().enumerate() {
                let copied = index == 0 && source.is_copy(&views[eye], target, *size);
                let set = if copied {
                    None
                } else {
                    let desc = ViewDesc {
                        kind: Some(vk::ImageViewType::TYPE_2D_ARRAY),
                        mips: Some(1),
                        ..ViewDesc::default()
                    };
                    let view = ImageView::new(&source.shown, &desc)?;
                    let bound = [(0, 0, Bound::Sampled(&view)), (1, 0, Bound::Sampler(&self.sampler))];
                    Some(DescriptorSet::new(&self.sets, &bound)?)
                };
                if !seen.iter().any(|image| Arc::ptr_eq(image, &source.shown)) {
                    seen.push(source.shown.clone());
                }
                drawn.push((eye, source, set));
            }
        }

        let mut encoder = commands.record()?;
        let target_is = |from, to| ImageBarrier::new(&target.image, from, to);
        // Copies first, all from images in the one layout and to the other; then what is drawn.
        let to_copy: Vec<_> =
            seen.iter().map(|i| ImageBarrier::new(i, Use::ColorAttachment, Use::TransferSource)).collect();
        encoder.barrier(&to_copy, &[]);
        encoder.barrier(&[target_is(Use::Undefined, Use::TransferDestination)], &[]);
        for (eye, source, set) in &drawn {
            if set.is_none() {
                let to = Area::whole(&target.image, *eye as u32, 0);
                encoder.copy_image(&source.shown, source.area(), &target.image, to);
            }
        }
        encoder.barrier(&[target_is(Use::TransferDestination, Use::ColorAttachment)], &[]);
        let to_sample: Vec<_> =
            seen.iter().map(|i| ImageBarrier::new(i, Use::TransferSource, Use::Sampled)).collect();
        encoder.barrier(&to_sample, &[]);
        for (eye, view) in views.iter().enumerate() {
            let of_eye = || drawn.iter().filter(|(of, ..)| *of == eye);
            let copied = of_eye().any(|(_, _, set)| set.is_none());
            let load = if copied { Load::Keep } else { Load::Clear([0.0, 0.0, 0.0, 1.0]) };
            let color = ColorAttachment { view: &target.views[eye], resolve: None, load, store: true };
            encoder.begin_rendering(&Rendering {
                size: *size,
                view_mask: 0,
                layers: 1,
                colors: &[color],
                depth: None,
            });
            encoder.viewport((0.0, 0.0), (size.0 as f32, size.1 as f32));
            encoder.scissor((0, 0), *size);
            for (_, source, set) in of_eye() {
                let Some(set) = set else { continue };
                encoder.bind(&target.pipelines[usize::from(source.layer.blend)]);
                encoder.bind_set(0, set, &[]);
                encoder.push(0, &source.constants(view));
                encoder.draw(3, 0, 1, 0);
            }
            encoder.end_rendering();
        }
        // Applications get their images back in the layout in which they released them.
        let back: Vec<_> =
            seen.iter().map(|i| ImageBarrier::new(i, Use::Sampled, Use::ColorAttachment)).collect();
        encoder.barrier(&back, &[]);
        encoder.barrier(&[target_is(Use::ColorAttachment, Use::TransferSource)], &[]);
        let bytes = picture_bytes(*size);
        for eye in 0..2u32 {
            let offset = u64::from(eye) * bytes as u64;
            encoder.copy_image_to_buffer(
                &target.image,
                Area::whole(&target.image, eye, 0),
                read_back,
                offset,
            );
        }
        let host = BufferBarrier { buffer: read_back, from: Use::TransferDestination, to: Use::HostRead };
        encoder.barrier(&[], &[host]);
        encoder.finish()?;
        let submission = device.submit(commands, &[], &[])?;
        device.wait(submission)?;

        let mut pictures = [vec![0; bytes], vec![0; bytes]];
        for (eye, picture) in pictures.iter_mut().enumerate() {
            read_back.read(eye as u64 * bytes as u64, picture)?;
            if which == 1 {
                picture.chunks_exact_mut(4).for_each(|texel| texel.swap(0, 2));
            }
        }
        Ok(pictures)
    }

    fn ready_target(&mut self, which: usize) -> Result<(), Error> {
        if self.targets[which].is_some() {
            return Ok(());
        }
        let format = FORMATS[which];
        let desc = ImageDesc {
            name: "xr-sim composed picture",
            format,
            width: self.size.0,
            height: self.size.1,
            layers: 2,
            usage: vk::ImageUsageFlags::COLOR_ATTACHMENT
                | vk::ImageUsageFlags::TRANSFER_SRC
                | vk::ImageUsageFlags::TRANSFER_DST,
            ..ImageDesc::default()
        };
        let image = Image::new(&self.device, &desc)?;
        let view = |eye| {
            let kind = Some(vk::ImageViewType::TYPE_2D);
            ImageView::new(
                &image,
                &ViewDesc { kind, base_layer: eye, layers: Some(1), ..ViewDesc::default() },
            )
        };
        let pipeline = |blend| {
            let [vertex, fragment] = &self.modules;
            let desc = GraphicsPipelineDesc {
                name: "xr-sim composition",
                layout: &self.layout,
                vertex: Stage { module: vertex, entry: COMPOSE_VERTEX.module(1, 0).entry() },
                fragment: Some(Stage { module: fragment, entry: COMPOSE_FRAGMENT.module(1, 0).entry() }),
                vertex_buffers: &[],
                topology: vk::PrimitiveTopology::TRIANGLE_LIST,
                cull: vk::CullModeFlags::NONE,
                front: vk::FrontFace::COUNTER_CLOCKWISE,
                depth: None,
                colors: &[(format, blend)],
                samples: 1,
                alpha_to_coverage: false,
                view_mask: 0,
            };
            GraphicsPipeline::new(&self.device, &desc)
        };
        let views = [view(0)?, view(1)?];
        let pipelines = [pipeline(Blend::Opaque)?, pipeline(Blend::Premultiplied)?];
        self.targets[which] = Some(Target { image, views, pipelines });
        Ok(())
    }
}

fn picture_bytes((width, height): (u32, u32)) -> usize {
    4 * width as usize * height as usize
}

/// What an eye gets from each layer, the farthest first. A layer whose space is lost is not seen.
fn sources<'a>(view: &View, eye: usize, layers: &'a [Layer], display: Timestamp) -> Vec<Source<'a>> {
    let one = |layer: &'a Layer| {
        let stage_from_space = layer.space.stage_from_space(display).pose()?;
        let (image, pose, sides) = match &layer.content {
            Content::Projection(views) => (&views[eye].image, views[eye].pose, views[eye].fov.tangents()),
            Content::Quad { pose, size_m: (width, height), image, eyes } if eyes[eye] => {
                (image, *pose, [-0.5 * width, 0.5 * width, 0.5 * height, -0.5 * height])
            }
            Content::Quad { .. } => return None,
        };
        let source_from_eye = (stage_from_space * pose).inverse() * view.world_from_eye;
        let shown = image.swapchain.shown()?;
        Some(Source { image, shown, source_from_eye, sides, layer })
    };
    layers.iter().filter_map(one).collect()
}

impl Source<'_> {
    /// Whether the picture can be copied as it is: drawn for this very eye, in the size and format of the composed one.
    fn is_copy(&self, view: &View, target: &Target, size: (u32, u32)) -> bool {
        let Content::Projection(_) = &self.layer.content else { return false };
        let sides = view.fov.tangents();
        let same_fov = self.sides.iter().zip(sides).all(|(a, b)| (a.atan() - b.atan()).abs() <= SAME_RAD);
        let same_pose = self.source_from_eye.rotation.angle() <= SAME_RAD;
        same_fov
            && same_pose
            && self.image.size == size
            && self.shown.format() == target.image.format()
            && !self.layer.blend
    }

    fn area(&self) -> Area {
        let (min, size) = (self.image.offset, self.image.size);
        Area { layer: self.image.array_index, mip: 0, min, max: (min.0 + size.0, min.1 + size.1) }
    }

    fn constants(&self, view: &View) -> Constants {
        let rotation = self.source_from_eye.rotation.to_rotation_matrix().into_inner();
        let place = self.source_from_eye.translation.vector;
        let axis = |column: usize, place: f64| {
            let column = rotation.column(column);
            [column.x as f32, column.y as f32, column.z as f32, place as f32]
        };
        let (width, height) = self.shown.size(0);
        let (u, v) = (1.0 / width as f32, 1.0 / height as f32);
        let (offset, size) = (self.image.offset, self.image.size);
        let quad = if matches!(self.layer.content, Content::Quad { .. }) { QUAD } else { 0 };
        let alpha = match (self.layer.blend, self.layer.straight_alpha) {
            (false, _) => IGNORE_ALPHA,
            (true, true) => STRAIGHT_ALPHA,
            (true, false) => 0,
        };
        Constants {
            axes: [axis(0, place.x), axis(1, place.y), axis(2, place.z)],
            eye: view.fov.tangents().map(|tangent| tangent as f32),
            source: self.sides.map(|side| side as f32),
            rect: [offset.0 as f32 * u, offset.1 as f32 * v, size.0 as f32 * u, size.1 as f32 * v],
            half_texel: [0.5 * u, 0.5 * v],
            array_layer: self.image.array_index,
            flags: quad | alpha,
        }
    }
}
