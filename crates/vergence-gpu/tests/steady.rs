//! What a frame costs the frame's thread: no allocation of ours, and little time outside of the driver.

// The counting allocator.
#![allow(unsafe_code)]
#![allow(clippy::unwrap_used)]

mod shared;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::Arc;

use shared::{assert_valid, device, spirv};
use vergence_gpu::{
    BindingDesc, Blend, Bound, Buffer, ColorAttachment, CommandBuffer, DescriptorSet, Device,
    GraphicsPipeline, GraphicsPipelineDesc, Image, ImageBarrier, ImageDesc, ImageView, Load, Memory,
    PipelineLayout, Rendering, SetLayout, ShaderModule, Signal, Stage, Timeline, Upload, Use, driver_time,
    set_driver_clock, thread_cpu_ns, vk,
};

/// Draws of one frame: a scene of some size.
const DRAWS: u32 = 300;

struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

// SAFETY: every call goes to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let _ = ALLOCATIONS.try_with(|n| n.set(n.get() + 1));
        // SAFETY: as the caller's.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as the caller's.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

struct Frames {
    device: Arc<Device>,
    pipelines: [Arc<GraphicsPipeline>; 2],
    sets: Vec<Arc<DescriptorSet>>,
    indices: Arc<Buffer>,
    target: Arc<ImageView>,
    timeline: Arc<Timeline>,
    slots: Vec<(CommandBuffer, Arc<Buffer>)>,
    number: u64,
}

impl Frames {
    fn new(device: &Arc<Device>) -> Self {
        let code = spirv(
            "@group(0) @binding(0) var<uniform> shift: vec4<f32>;
             var<immediate> color: vec4<f32>;
             @vertex fn vertex(@builtin(vertex_index) i: u32) -> @builtin(position) vec4<f32> {
                 return vec4(f32(i & 1u), f32(i >> 1u), 0.5, 1.0) + shift;
             }
             @fragment fn fragment() -> @location(0) vec4<f32> { return color; }",
        );
        let module = ShaderModule::new(device, &code).unwrap();
        let binding = BindingDesc::new(0, vk::DescriptorType::UNIFORM_BUFFER, vk::ShaderStageFlags::VERTEX);
        let set_layout = SetLayout::new(device, &[binding]).unwrap();
        let layout = PipelineLayout::new(device, &[&set_layout], vk::ShaderStageFlags::FRAGMENT, 16).unwrap();
        let format = vk::Format::R8G8B8A8_SRGB;
        let pipelines = [vk::CullModeFlags::NONE, vk::CullModeFlags::BACK].map(|cull| {
            let desc = GraphicsPipelineDesc {
                name: "many",
                layout: &layout,
                vertex: Stage { module: &module, entry: "vertex" },
                fragment: Some(Stage { module: &module, entry: "fragment" }),
                vertex_buffers: &[],
                topology: vk::PrimitiveTopology::TRIANGLE_LIST,
                cull,
                front: vk::FrontFace::COUNTER_CLOCKWISE,
                depth: None,
                colors: &[(format, Blend::Opaque)],
                samples: 1,
                alpha_to_coverage: false,
                view_mask: 0,
            };
            GraphicsPipeline::new(device, &desc).unwrap()
        });
        let mut upload = Upload::new(device).unwrap();
        let indices = upload.buffer("indices", &[0u32, 1, 2], vk::BufferUsageFlags::INDEX_BUFFER).unwrap();
        let uniform = || {
            Buffer::new(device, "shift", 16, vk::BufferUsageFlags::UNIFORM_BUFFER, Memory::Upload).unwrap()
        };
        let buffers: Vec<_> = (0..3).map(|_| uniform()).collect();
        let sets = buffers
            .iter()
            .map(|b| DescriptorSet::new(&set_layout, &[(0, 0, Bound::Buffer(b))]).unwrap())
            .collect();
        let usage = vk::ImageUsageFlags::COLOR_ATTACHMENT;
        let desc = ImageDesc { name: "target", format, width: 4, height: 4, usage, ..Default::default() };
        let target = Image::new(device, &desc).unwrap().view().unwrap();
        let slots = (0..2).map(|_| (CommandBuffer::new(device, "frame", 2).unwrap(), uniform())).collect();
        let timeline = Timeline::new(device, 0).unwrap();
        Self { device: Arc::clone(device), pipelines, sets, indices, target, timeline, slots, number: 0 }
    }

    fn frame(&mut self) {
        let slot = (self.number % 2) as usize;
        self.number += 1;
        let (commands, late) = &mut self.slots[slot];
        let mut encoder = commands.record().unwrap();
        encoder.begin_pass("draw");
        let barrier = ImageBarrier::new(self.target.image(), Use::ColorAttachment, Use::ColorAttachment);
        encoder.barrier(&[barrier.discard()], &[]);
        encoder.begin_rendering(&Rendering {
            size: (4, 4),
            view_mask: 0,
            layers: 1,
            colors: &[ColorAttachment {
                view: &self.target,
                resolve: None,
                load: Load::Clear([0.0; 4]),
                store: true,
            }],
            depth: None,
        });
        for i in 0..DRAWS {
            encoder.bind(&self.pipelines[(i / 100) as usize % 2]);
            encoder.bind_set(0, &self.sets[(i / 10) as usize % 3], &[]);
            encoder.index_buffer(&self.indices, 0, vk::IndexType::UINT32);
            encoder.push(0, &[i as f32 / DRAWS as f32; 4]);
            encoder.draw_indexed(3, 0, 0, 1, 0);
        }
        encoder.end_rendering();
        encoder.end_pass();
        encoder.finish().unwrap();
        late.write(0, &[0.0f32; 4]).unwrap();
        let signal = Signal { timeline: &self.timeline, value: self.number };
        self.device.submit(commands, &[], &[signal]).unwrap();
    }
}

#[test]
fn recording_and_submitting_allocate_nothing_in_steady_state() {
    let Some(device) = device() else { return };
    let mut frames = Frames::new(&device);
    for _ in 0..4 {
        frames.frame();
    }
    let before = ALLOCATIONS.get();
    for _ in 0..20 {
        frames.frame();
    }
    let after = ALLOCATIONS.get();
    // The counter counts.
    drop(Box::new(std::hint::black_box(1)));
    assert!(ALLOCATIONS.get() > after);
    assert_eq!(after - before, 0, "allocations in 20 frames");
    assert_valid(&device);
}

/// Prints what a frame costs: `cargo test -p vergence-gpu --test steady -- --ignored --nocapture`.
#[test]
#[ignore = "a measurement"]
fn cost_of_a_frame() {
    let instance = vergence_gpu::Instance::new(&vergence_gpu::InstanceDesc::default(), None).unwrap();
    let device = Device::new(&instance, &vergence_gpu::DeviceDesc::default(), None).unwrap();
    let mut frames = Frames::new(&device);
    for on in [false, true] {
        set_driver_clock(on);
        let mut rows = Vec::new();
        for _ in 0..200 {
            let (cpu, driver) = (thread_cpu_ns(), driver_time());
            frames.frame();
            let (cpu, driver) =
                (thread_cpu_ns() - cpu, (driver_time().ns - driver.ns, driver_time().calls - driver.calls));
            rows.push((cpu.saturating_sub(driver.0), cpu, driver.1));
        }
        rows.sort_unstable();
        let (own, cpu, calls) = rows[rows.len() * 95 / 100];
        println!(
            "{DRAWS} draws, driver clock {on}: own p50 {} us, p95 {} us; with driver {} us; {calls} calls",
            rows[rows.len() / 2].0 / 1000,
            own / 1000,
            cpu / 1000
        );
    }
    set_driver_clock(false);
}
