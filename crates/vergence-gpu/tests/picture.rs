//! A multiview picture with MSAA, resolved colour and depth, drawn and read back under validation; and what a missing barrier does.

#![allow(clippy::unwrap_used)]

mod shared;

use std::sync::Arc;

use shared::{assert_valid, device, spirv};
use vergence_gpu::{
    Attribute, BindingDesc, Blend, Bound, Buffer, BufferBarrier, ColorAttachment, CommandBuffer,
    ComputePipeline, DepthAttachment, DepthState, DescriptorSet, Device, Encoder, GraphicsPipeline,
    GraphicsPipelineDesc, Image, ImageBarrier, ImageDesc, ImageView, Load, Memory, PipelineLayout, ReadBack,
    Rendering, SetLayout, ShaderModule, Stage, Upload, Use, VertexBuffer, vk,
};

const SIDE: u32 = 64;
const VIEWS: u32 = 2;
const CLEAR: [f32; 4] = [0.0, 0.0, 0.0, 1.0];

/// Each view moves the triangle by its own shift; the depth is pushed.
const WGSL: &str = "
    struct Views { shift: array<vec4<f32>, 2> }
    @group(0) @binding(0) var<uniform> views: Views;
    struct Push { color: vec4<f32>, depth: f32, a: f32, b: f32, c: f32 }
    var<immediate> push: Push;
    @vertex fn vertex(@location(0) at: vec2<f32>, @builtin(view_index) view: u32) -> @builtin(position) vec4<f32> {
        return vec4(at + views.shift[view].xy, push.depth, 1.0);
    }
    @fragment fn fragment() -> @location(0) vec4<f32> { return push.color; }
";

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Push {
    color: [f32; 4],
    depth: [f32; 4],
}

struct Scene {
    device: Arc<Device>,
    pipeline: Arc<GraphicsPipeline>,
    set: Arc<DescriptorSet>,
    vertices: Arc<Buffer>,
    indices: Arc<Buffer>,
    msaa_color: Option<Arc<ImageView>>,
    msaa_depth: Option<Arc<ImageView>>,
    color: Arc<ImageView>,
    depth: Arc<ImageView>,
}

impl Scene {
    fn new(device: &Arc<Device>, samples: u32) -> Self {
        let layout = SetLayout::new(
            device,
            &[BindingDesc::new(0, vk::DescriptorType::UNIFORM_BUFFER, vk::ShaderStageFlags::VERTEX)],
        )
        .unwrap();
        let stages = vk::ShaderStageFlags::VERTEX | vk::ShaderStageFlags::FRAGMENT;
        let pipeline_layout = PipelineLayout::new(device, &[&layout], stages, 32).unwrap();
        let module = ShaderModule::new(device, &spirv(WGSL)).unwrap();
        let pipeline = GraphicsPipeline::new(
            device,
            &GraphicsPipelineDesc {
                name: "triangle",
                layout: &pipeline_layout,
                vertex: Stage { module: &module, entry: "vertex" },
                fragment: Some(Stage { module: &module, entry: "fragment" }),
                vertex_buffers: &[VertexBuffer {
                    stride: 8,
                    per_instance: false,
                    attributes: &[Attribute { location: 0, format: vk::Format::R32G32_SFLOAT, offset: 0 }],
                }],
                topology: vk::PrimitiveTopology::TRIANGLE_LIST,
                cull: vk::CullModeFlags::NONE,
                front: vk::FrontFace::COUNTER_CLOCKWISE,
                depth: Some(DepthState {
                    format: vk::Format::D32_SFLOAT,
                    compare: vk::CompareOp::GREATER,
                    write: true,
                    bias: None,
                }),
                colors: &[(vk::Format::R8G8B8A8_SRGB, Blend::Opaque)],
                samples,
                alpha_to_coverage: false,
                view_mask: 0b11,
            },
        )
        .unwrap();
        let mut upload = Upload::new(device).unwrap();
        // The left lower half of a view: its diagonal edge crosses pixels.
        let vertices = upload
            .buffer(
                "vertices",
                &[[-1.0f32, -1.0], [-1.0, 1.0], [1.0, 1.0]],
                vk::BufferUsageFlags::VERTEX_BUFFER,
            )
            .unwrap();
        let indices = upload.buffer("indices", &[0u32, 1, 2], vk::BufferUsageFlags::INDEX_BUFFER).unwrap();
        let views =
            Buffer::new(device, "views", 32, vk::BufferUsageFlags::UNIFORM_BUFFER, Memory::Upload).unwrap();
        // The right view sees the triangle half a picture further right.
        views.write(0, &[[0.0f32; 4], [1.0, 0.0, 0.0, 0.0]]).unwrap();
        let set = DescriptorSet::new(&layout, &[(0, 0, Bound::Buffer(&views))]).unwrap();
        let image = |name, format, samples, usage| {
            let desc = ImageDesc {
                name,
                format,
                width: SIDE,
                height: SIDE,
                layers: VIEWS,
                samples,
                usage,
                ..Default::default()
            };
            Image::new(device, &desc).unwrap().view().unwrap()
        };
        let color_usage = vk::ImageUsageFlags::COLOR_ATTACHMENT;
        let depth_usage = vk::ImageUsageFlags::DEPTH_STENCIL_ATTACHMENT;
        let read = vk::ImageUsageFlags::TRANSFER_SRC;
        let many = samples > 1;
        Self {
            device: Arc::clone(device),
            pipeline,
            set,
            vertices,
            indices,
            msaa_color: many.then(|| image("msaa color", vk::Format::R8G8B8A8_SRGB, samples, color_usage)),
            msaa_depth: many.then(|| image("msaa depth", vk::Format::D32_SFLOAT, samples, depth_usage)),
            color: image("color", vk::Format::R8G8B8A8_SRGB, 1, color_usage | read),
            depth: image("depth", vk::Format::D32_SFLOAT, 1, depth_usage | read),
        }
    }

    /// Draws a near red triangle and a far green one over it, which must lose (reversed depth).
    fn draw(&self, encoder: &mut Encoder<'_>) {
        encoder.begin_pass("draw");
        let mut barriers = vec![
            ImageBarrier::new(self.color.image(), Use::TransferSource, Use::ColorAttachment).discard(),
            ImageBarrier::new(self.depth.image(), Use::TransferSource, Use::DepthAttachment).discard(),
        ];
        if let (Some(color), Some(depth)) = (&self.msaa_color, &self.msaa_depth) {
            barriers
                .push(ImageBarrier::new(color.image(), Use::ColorAttachment, Use::ColorAttachment).discard());
            barriers
                .push(ImageBarrier::new(depth.image(), Use::DepthAttachment, Use::DepthAttachment).discard());
        }
        encoder.barrier(&barriers, &[]);
        let many = self.msaa_color.is_some();
        encoder.begin_rendering(&Rendering {
            size: (SIDE, SIDE),
            view_mask: 0b11,
            layers: 1,
            colors: &[ColorAttachment {
                view: self.msaa_color.as_ref().unwrap_or(&self.color),
                resolve: many.then_some(&self.color),
                load: Load::Clear(CLEAR),
                store: !many,
            }],
            depth: Some(DepthAttachment {
                view: self.msaa_depth.as_ref().unwrap_or(&self.depth),
                resolve: many.then_some(&self.depth),
                load: Load::Clear(0.0),
                store: !many,
                read_only: false,
            }),
        });
        encoder.bind(&self.pipeline);
        encoder.bind_set(0, &self.set, &[]);
        encoder.vertex_buffer(0, &self.vertices, 0);
        encoder.index_buffer(&self.indices, 0, vk::IndexType::UINT32);
        encoder.push(0, &Push { color: [1.0, 0.0, 0.0, 1.0], depth: [0.5; 4] });
        encoder.draw_indexed(3, 0, 0, 1, 0);
        encoder.push(0, &Push { color: [0.0, 1.0, 0.0, 1.0], depth: [0.25; 4] });
        encoder.draw_indexed(3, 0, 0, 1, 0);
        encoder.end_rendering();
        encoder.end_pass();
    }

    /// Draws once and reads colour and depth of one view.
    fn picture(&self, view: u32) -> (Vec<u8>, Vec<f32>) {
        let mut commands = CommandBuffer::new(&self.device, "frame", 4).unwrap();
        let mut encoder = commands.record().unwrap();
        self.draw(&mut encoder);
        encoder.finish().unwrap();
        self.device.submit(&mut commands, &[], &[]).unwrap();
        let mut read_back = ReadBack::new(&self.device).unwrap();
        let (mut color, mut depth) = (Vec::new(), Vec::new());
        read_back.layer(self.color.image(), view, Use::ColorAttachment, &mut color).unwrap();
        read_back.layer(self.depth.image(), view, Use::DepthAttachment, &mut depth).unwrap();
        let depth = depth.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        (color, depth)
    }
}

fn texel(color: &[u8], x: u32, y: u32) -> [u8; 4] {
    let at = 4 * (y * SIDE + x) as usize;
    [color[at], color[at + 1], color[at + 2], color[at + 3]]
}

/// How much of pixel (x, y) of view 0 the triangle covers, of 255 in sRGB.
fn expected(x: u32, y: u32) -> &'static str {
    match x.cmp(&y) {
        std::cmp::Ordering::Less => "inside",
        std::cmp::Ordering::Equal => "edge",
        std::cmp::Ordering::Greater => "outside",
    }
}

fn check_picture(device: &Arc<Device>, samples: u32) {
    let scene = Scene::new(device, samples);
    for view in 0..VIEWS {
        let (color, depth) = scene.picture(view);
        let shift = view * SIDE / 2;
        for (y, x) in (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (y, x))) {
            let [red, green, blue, alpha] = texel(&color, x, y);
            let z = depth[(y * SIDE + x) as usize];
            assert_eq!((green, blue, alpha), (0, 0, 255), "view {view} ({x}, {y})");
            let place = if x < shift { "outside" } else { expected(x - shift, y) };
            match place {
                "inside" => assert_eq!((red, z), (255, 0.5), "view {view} ({x}, {y})"),
                "outside" => assert_eq!((red, z), (0, 0.0), "view {view} ({x}, {y})"),
                // One sample decides everything or nothing; of four, two or three are inside, averaged in linear light:
                // 0.5 is 188 in sRGB, 0.25 is 137, 0.75 is 225.
                _ if samples == 1 => assert!(red == 0 || red == 255),
                _ => {
                    assert!(
                        [137, 188, 225].iter().any(|&v: &u8| red.abs_diff(v) <= 1),
                        "averaged in linear light: {red}"
                    );
                    // Sample zero is either of the two depths, never a mean.
                    assert!(z == 0.5 || z == 0.0, "{z}");
                }
            }
        }
    }
    assert_valid(device);
}

#[test]
fn two_views_are_drawn_in_one_pass() {
    let Some(device) = device() else { return };
    check_picture(&device, 1);
}

#[test]
fn samples_are_averaged_and_depth_is_sample_zero() {
    let Some(device) = device() else { return };
    let Some(&samples) = device.limits().msaa.iter().find(|&&n| n == 4) else { return };
    check_picture(&device, samples);
}

#[test]
fn samples_that_the_device_lacks_are_refused_with_what_there_is() {
    let Some(device) = device() else { return };
    let Some(lacking) = [2, 8, 16, 32, 64].into_iter().find(|n| !device.limits().msaa.contains(n)) else {
        return;
    };
    let error = device.limits().check_msaa(lacking).unwrap_err().to_string();
    assert!(error.contains(&format!("MSAA {lacking}")) && error.contains("MSAA 1"), "{error}");
    assert!(device.limits().check_msaa(3).is_err());
}

/// The negative control of every other test: synchronization validation sees it when a barrier is missing.
#[test]
fn a_removed_barrier_is_reported() {
    let Some(device) = device() else { return };
    if !device.instance().validation() {
        eprintln!("skipped: no validation layer");
        return;
    }
    // Only copies: older layers (1.3.239) do not follow what dynamic rendering does to its attachments.
    let usage = vk::ImageUsageFlags::TRANSFER_SRC | vk::ImageUsageFlags::TRANSFER_DST;
    let desc = ImageDesc { name: "image", width: SIDE, height: SIDE, usage, ..Default::default() };
    let image = Image::new(&device, &desc).unwrap();
    let buffer =
        |name| Buffer::new(&device, name, 64, vk::BufferUsageFlags::empty(), Memory::Device).unwrap();
    let (a, b, c) = (buffer("a"), buffer("b"), buffer("c"));
    let mut commands = CommandBuffer::new(&device, "frame", 0).unwrap();
    for waits in [true, false] {
        let mut encoder = commands.record().unwrap();
        encoder.transition(&image, Use::Undefined, Use::TransferDestination);
        encoder.clear(&image, CLEAR);
        let used = if waits { Use::TransferDestination } else { Use::Undefined };
        encoder.transition(&image, used, Use::TransferSource);
        encoder.copy_buffer(&a, 0, &b, 0, 64);
        if waits {
            let barrier =
                BufferBarrier { buffer: &b, from: Use::TransferDestination, to: Use::TransferSource };
            encoder.barrier(&[], &[barrier]);
        }
        encoder.copy_buffer(&b, 0, &c, 0, 64);
        encoder.finish().unwrap();
        let messages = device.validation_messages();
        if waits {
            assert!(messages.is_empty(), "{messages:?}");
        } else {
            for hazard in ["SYNC-HAZARD-WRITE-AFTER-WRITE", "SYNC-HAZARD-READ-AFTER-WRITE"] {
                assert!(messages.iter().any(|m| m.contains(hazard)), "{hazard}: {messages:?}");
            }
        }
    }
}

#[test]
fn passes_are_timed_by_name() {
    let Some(device) = device() else { return };
    let scene = Scene::new(&device, 1);
    let mut commands = CommandBuffer::new(&device, "frame", 2).unwrap();
    for _ in 0..2 {
        let mut encoder = commands.record().unwrap();
        // One pass more than there is room for: not timed, and not an error.
        for _ in 0..3 {
            scene.draw(&mut encoder);
        }
        encoder.finish().unwrap();
        device.submit(&mut commands, &[], &[]).unwrap();
    }
    let times = commands.pass_times().unwrap();
    if device.limits().timestamp_period_ns > 0.0 {
        assert_eq!(times.len(), 2);
        assert!(times.iter().all(|t| t.name == "draw" && t.ns > 0.0 && t.ns < 1e9), "{times:?}");
    }
    assert_valid(&device);
}

/// A compute pass writes a storage buffer that the host reads.
#[test]
fn compute_writes_what_the_host_reads() {
    let Some(device) = device() else { return };
    let module = ShaderModule::new(
        &device,
        &spirv(
            "@group(0) @binding(0) var<storage, read_write> out: array<u32>;
             @compute @workgroup_size(64) fn square(@builtin(global_invocation_id) id: vec3<u32>) {
                 out[id.x] = id.x * id.x;
             }",
        ),
    )
    .unwrap();
    let layout = SetLayout::new(
        &device,
        &[BindingDesc::new(0, vk::DescriptorType::STORAGE_BUFFER, vk::ShaderStageFlags::COMPUTE)],
    )
    .unwrap();
    let pipeline_layout = PipelineLayout::new(&device, &[&layout], vk::ShaderStageFlags::empty(), 0).unwrap();
    let stage = Stage { module: &module, entry: "square" };
    let pipeline = ComputePipeline::new(&device, "square", &pipeline_layout, stage).unwrap();
    let out =
        Buffer::new(&device, "out", 256 * 4, vk::BufferUsageFlags::STORAGE_BUFFER, Memory::ReadBack).unwrap();
    let set = DescriptorSet::new(&layout, &[(0, 0, Bound::Buffer(&out))]).unwrap();
    let mut commands = CommandBuffer::new(&device, "compute", 0).unwrap();
    let mut encoder = commands.record().unwrap();
    encoder.bind_compute(&pipeline);
    encoder.bind_set(0, &set, &[]);
    encoder.dispatch(4, 1, 1);
    let barrier = BufferBarrier { buffer: &out, from: Use::Storage, to: Use::HostRead };
    encoder.barrier(&[], &[barrier]);
    encoder.finish().unwrap();
    let submission = device.submit(&mut commands, &[], &[]).unwrap();
    device.wait(submission).unwrap();
    let mut values = [0u32; 256];
    out.read(0, &mut values).unwrap();
    assert!(values.iter().enumerate().all(|(i, &v)| v == (i * i) as u32));
    assert!(out.write(1020, &[0u32, 0]).is_err(), "a write over the end is refused");
    assert_valid(&device);
}

/// An uploaded image keeps its texels; its mips are made by halving.
#[test]
fn images_are_uploaded_with_mips() {
    let Some(device) = device() else { return };
    let texels: Vec<u8> =
        (0..4 * 4).flat_map(|i| if i % 2 == 0 { [200, 0, 40, 255] } else { [100, 0, 40, 255] }).collect();
    let desc = ImageDesc {
        name: "texture",
        format: vk::Format::R8G8B8A8_UNORM,
        width: 4,
        height: 4,
        mips: 3,
        usage: vk::ImageUsageFlags::SAMPLED,
        ..Default::default()
    };
    let mut upload = Upload::new(&device).unwrap();
    let image = upload.image(&desc, &[&texels], true, Use::SampledAny).unwrap();
    let mut back = Vec::new();
    let mut read_back = ReadBack::new(&device).unwrap();
    read_back.layer(&image, 0, Use::SampledAny, &mut back).unwrap();
    assert_eq!(back, texels);
    // The smallest mip is the mean.
    let buffer = Buffer::new(&device, "mip", 4, vk::BufferUsageFlags::empty(), Memory::ReadBack).unwrap();
    let mut commands = CommandBuffer::new(&device, "mip", 0).unwrap();
    let mut encoder = commands.record().unwrap();
    encoder.transition(&image, Use::SampledAny, Use::TransferSource);
    encoder.copy_image_to_buffer(&image, vergence_gpu::Area::whole(&image, 0, 2), &buffer, 0);
    encoder.finish().unwrap();
    let submission = device.submit(&mut commands, &[], &[]).unwrap();
    device.wait(submission).unwrap();
    let mut mean = [0u8; 4];
    buffer.read(0, &mut mean).unwrap();
    assert!(mean[0].abs_diff(150) <= 1 && mean[1] == 0 && mean[2].abs_diff(40) <= 1, "{mean:?}");
    let wrong = upload.image(&desc, &[&texels[..60]], true, Use::SampledAny);
    assert!(wrong.is_err_and(|e| e.to_string().contains("expected 64, found 60")));
    assert_valid(&device);
}
