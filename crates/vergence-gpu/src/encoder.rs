//! Recording: barriers, rendering, draws, dispatches, copies and timed passes.
//!
//! Recording methods do not fail one by one: the first misuse is remembered, what follows is not recorded, and
//! [`Encoder::finish`] returns it.

mod barrier;
mod rendering;
mod transfer;

pub use barrier::{BufferBarrier, ImageBarrier};
pub use rendering::{ColorAttachment, DepthAttachment, Load, Rendering};
pub use transfer::Area;

use std::sync::Arc;

use ash::vk;
use bytemuck::Pod;

use crate::buffer::Buffer;
use crate::command::{CommandBuffer, Kept};
use crate::descriptor::DescriptorSet;
use crate::driver_clock::{blocking, quick};
use crate::error::{At, Error};
use crate::pipeline::{ComputePipeline, GraphicsPipeline, PipelineLayout};

/// Most descriptor sets of a pipeline whose binding is remembered, so that a repeated one costs nothing.
const MAX_SETS: usize = 4;
/// Most vertex buffers whose binding is remembered.
const MAX_VERTEX_BUFFERS: usize = 4;

/// The pipeline that is bound, by its bind point.
#[derive(Clone, Copy, PartialEq, Eq)]
struct BoundPipeline {
    raw: vk::Pipeline,
    layout: vk::PipelineLayout,
    point: vk::PipelineBindPoint,
    push_stages: vk::ShaderStageFlags,
    push_bytes: u32,
}

/// Records commands into a [`CommandBuffer`]; dropped without [`Encoder::finish`], the recording is lost.
pub struct Encoder<'a> {
    commands: &'a mut CommandBuffer,
    wrong: Option<&'static str>,
    rendering: bool,
    in_pass: bool,
    pipeline: Option<BoundPipeline>,
    sets: [vk::DescriptorSet; MAX_SETS],
    set_owner: (vk::PipelineLayout, vk::PipelineBindPoint),
    vertices: [(vk::Buffer, u64); MAX_VERTEX_BUFFERS],
    index: (vk::Buffer, u64, vk::IndexType),
    indexed: bool,
}

impl<'a> Encoder<'a> {
    pub(crate) fn new(commands: &'a mut CommandBuffer) -> Self {
        Self {
            commands,
            wrong: None,
            rendering: false,
            in_pass: false,
            pipeline: None,
            sets: [vk::DescriptorSet::null(); MAX_SETS],
            set_owner: (vk::PipelineLayout::null(), vk::PipelineBindPoint::GRAPHICS),
            vertices: [(vk::Buffer::null(), 0); MAX_VERTEX_BUFFERS],
            index: (vk::Buffer::null(), 0, vk::IndexType::UINT16),
            indexed: false,
        }
    }

    /// Keeps what is recorded alive; `false` after a misuse, which it is to record what lives on another device.
    fn keep<T: Kept + 'static>(&mut self, what: &Arc<T>) -> bool {
        let here = std::ptr::eq(what.home(), &*self.commands.device);
        let keeps = self.ensure(here, "something of another device was recorded");
        if keeps {
            self.commands.kept.push(Arc::clone(what) as Arc<dyn Kept>);
        }
        keeps
    }

    /// Remembers the first misuse; says whether to go on.
    fn ensure(&mut self, right: bool, otherwise: &'static str) -> bool {
        if !right && self.wrong.is_none() {
            self.wrong = Some(otherwise);
        }
        self.wrong.is_none()
    }

    /// Ends recording.
    ///
    /// # Errors
    ///
    /// The first misuse of this encoder, or a refusal by the driver.
    pub fn finish(mut self) -> Result<(), Error> {
        let open = self.rendering || self.in_pass;
        self.ensure(!open, "finished while rendering or a timed pass was open");
        if let Some(detail) = self.wrong {
            return Err(Error::Recording { name: self.commands.name().into(), detail });
        }
        // SAFETY: the buffer is recording, outside of rendering.
        blocking(|| unsafe { self.commands.device.raw.end_command_buffer(self.commands.raw) })
            .at("vkEndCommandBuffer")?;
        self.commands.executable = true;
        Ok(())
    }

    /// Begins a timed pass; not inside of rendering. Passes do not nest. More than the command buffer can time are not timed.
    pub fn begin_pass(&mut self, name: &'static str) {
        let free = !self.rendering && !self.in_pass;
        if !self.ensure(free, "a timed pass was begun inside of another or of rendering") {
            return;
        }
        self.in_pass = true;
        let raw = self.commands.raw;
        if let Some(timer) = &mut self.commands.timer {
            if (timer.names.len() as u32) < timer.capacity {
                let query = 2 * timer.names.len() as u32;
                timer.names.push(name);
                // SAFETY: the query is in the pool and was reset at the beginning of this recording.
                quick(|| unsafe {
                    self.commands.device.raw.cmd_write_timestamp2(
                        raw,
                        vk::PipelineStageFlags2::ALL_COMMANDS,
                        timer.pool,
                        query,
                    );
                });
            } else {
                timer.overflow = true;
            }
        }
    }

    /// Ends the timed pass.
    pub fn end_pass(&mut self) {
        let ends = self.in_pass && !self.rendering;
        if !self.ensure(ends, "a timed pass was ended that was not begun, or inside of rendering") {
            return;
        }
        self.in_pass = false;
        if let Some(timer) = &mut self.commands.timer {
            if timer.overflow {
                return;
            }
            let query = 2 * timer.names.len() as u32 - 1;
            // SAFETY: as in `begin_pass`.
            quick(|| unsafe {
                self.commands.device.raw.cmd_write_timestamp2(
                    self.commands.raw,
                    vk::PipelineStageFlags2::ALL_COMMANDS,
                    timer.pool,
                    query,
                );
            });
        }
    }

    /// Sets the viewport, in pixels; depth goes from 0 to 1.
    pub fn viewport(&mut self, corner: (f32, f32), size: (f32, f32)) {
        let viewport = [vk::Viewport {
            x: corner.0,
            y: corner.1,
            width: size.0,
            height: size.1,
            min_depth: 0.0,
            max_depth: 1.0,
        }];
        let valid = size.0 > 0.0 && size.1 > 0.0;
        if self.ensure(valid, "an empty viewport") {
            // SAFETY: recording.
            quick(|| unsafe { self.commands.device.raw.cmd_set_viewport(self.commands.raw, 0, &viewport) });
        }
    }

    /// Sets the scissor, in pixels.
    pub fn scissor(&mut self, corner: (u32, u32), size: (u32, u32)) {
        let valid = [corner.0, corner.1, size.0, size.1].iter().all(|&v| v < 1 << 30);
        if !self.ensure(valid, "a scissor far outside of any image") {
            return;
        }
        let scissor = [vk::Rect2D {
            offset: vk::Offset2D { x: corner.0 as i32, y: corner.1 as i32 },
            extent: vk::Extent2D { width: size.0, height: size.1 },
        }];
        // SAFETY: recording.
        quick(|| unsafe { self.commands.device.raw.cmd_set_scissor(self.commands.raw, 0, &scissor) });
    }

    /// Binds a graphics pipeline; binding the bound one again costs nothing.
    pub fn bind(&mut self, pipeline: &Arc<GraphicsPipeline>) {
        if self.pipeline.is_none_or(|bound| bound.raw != pipeline.raw) && self.keep(pipeline) {
            self.bind_pipeline(pipeline.raw, &pipeline.layout, vk::PipelineBindPoint::GRAPHICS);
        }
    }

    /// Binds a compute pipeline; binding the bound one again costs nothing.
    pub fn bind_compute(&mut self, pipeline: &Arc<ComputePipeline>) {
        if self.pipeline.is_none_or(|bound| bound.raw != pipeline.raw) && self.keep(pipeline) {
            self.bind_pipeline(pipeline.raw, &pipeline.layout, vk::PipelineBindPoint::COMPUTE);
        }
    }

    fn bind_pipeline(&mut self, raw: vk::Pipeline, layout: &PipelineLayout, point: vk::PipelineBindPoint) {
        if self.wrong.is_some() {
            return;
        }
        if self.set_owner != (layout.raw, point) {
            self.set_owner = (layout.raw, point);
            self.sets = [vk::DescriptorSet::null(); MAX_SETS];
        }
        self.pipeline = Some(BoundPipeline {
            raw,
            layout: layout.raw,
            point,
            push_stages: layout.push_stages,
            push_bytes: layout.push_bytes,
        });
        // SAFETY: recording; the caller keeps the pipeline.
        quick(|| unsafe { self.commands.device.raw.cmd_bind_pipeline(self.commands.raw, point, raw) });
    }

    /// Binds set `number` of the bound pipeline, with one offset (bytes) per dynamic binding; binding a bound set without dynamic
    /// bindings again costs nothing.
    pub fn bind_set(&mut self, number: u32, set: &Arc<DescriptorSet>, dynamic_offsets: &[u32]) {
        let matches = set.layout().dynamic() as usize == dynamic_offsets.len();
        if !self.ensure(self.pipeline.is_some(), "a descriptor set was bound before a pipeline")
            || !self.ensure(matches, "a descriptor set was bound with the wrong number of dynamic offsets")
        {
            return;
        }
        let Some(pipeline) = self.pipeline else { return };
        let known = self.sets.get(number as usize).is_some_and(|bound| *bound == set.raw);
        if known && dynamic_offsets.is_empty() {
            return;
        }
        if !known && !self.keep(set) {
            return;
        }
        if let Some(slot) = self.sets.get_mut(number as usize) {
            *slot = set.raw;
        }
        // SAFETY: recording; the set is kept; its layout is checked by the validation layer.
        quick(|| unsafe {
            self.commands.device.raw.cmd_bind_descriptor_sets(
                self.commands.raw,
                pipeline.point,
                pipeline.layout,
                number,
                &[set.raw],
                dynamic_offsets,
            );
        });
    }

    /// Sets push constants of the bound pipeline at `offset` (bytes).
    pub fn push<T: Pod>(&mut self, offset: u32, data: &T) {
        let bytes = bytemuck::bytes_of(data);
        let fits = self.pipeline.is_some_and(|p| {
            offset.is_multiple_of(4)
                && bytes.len().is_multiple_of(4)
                && u64::from(offset) + bytes.len() as u64 <= u64::from(p.push_bytes)
                && !bytes.is_empty()
        });
        if !self.ensure(fits, "push constants without a pipeline, or more than its layout has") {
            return;
        }
        let Some(pipeline) = self.pipeline else { return };
        // SAFETY: recording; the range is within the layout's.
        quick(|| unsafe {
            self.commands.device.raw.cmd_push_constants(
                self.commands.raw,
                pipeline.layout,
                pipeline.push_stages,
                offset,
                bytes,
            );
        });
    }

    /// Binds a vertex buffer from `offset` (bytes); binding the bound one again costs nothing.
    pub fn vertex_buffer(&mut self, binding: u32, buffer: &Arc<Buffer>, offset: u64) {
        let fits = offset < buffer.size() && buffer.usage().contains(vk::BufferUsageFlags::VERTEX_BUFFER);
        if !self.ensure(fits, "a vertex buffer of another usage, or an offset outside of it") {
            return;
        }
        let bound = (buffer.raw, offset);
        if self.vertices.get(binding as usize) == Some(&bound) {
            return;
        }
        if !self.keep(buffer) {
            return;
        }
        if let Some(slot) = self.vertices.get_mut(binding as usize) {
            *slot = bound;
        }
        // SAFETY: recording; the buffer is kept, the offset within it.
        quick(|| unsafe {
            self.commands.device.raw.cmd_bind_vertex_buffers(
                self.commands.raw,
                binding,
                &[buffer.raw],
                &[offset],
            );
        });
    }

    /// Binds the index buffer from `offset` (bytes); binding the bound one again costs nothing.
    pub fn index_buffer(&mut self, buffer: &Arc<Buffer>, offset: u64, kind: vk::IndexType) {
        let fits = offset < buffer.size() && buffer.usage().contains(vk::BufferUsageFlags::INDEX_BUFFER);
        if !self.ensure(fits, "an index buffer of another usage, or an offset outside of it") {
            return;
        }
        if self.index == (buffer.raw, offset, kind) {
            return;
        }
        if !self.keep(buffer) {
            return;
        }
        self.index = (buffer.raw, offset, kind);
        self.indexed = true;
        // SAFETY: recording; the buffer is kept, the offset within it.
        quick(|| unsafe {
            self.commands.device.raw.cmd_bind_index_buffer(self.commands.raw, buffer.raw, offset, kind);
        });
    }

    fn can_draw(&mut self) -> bool {
        let bound = self.pipeline.is_some_and(|p| p.point == vk::PipelineBindPoint::GRAPHICS);
        let rendering = self.rendering;
        self.ensure(bound && rendering, "a draw outside of rendering, or without a graphics pipeline")
    }

    /// Draws vertices.
    pub fn draw(&mut self, vertices: u32, first: u32, instances: u32, first_instance: u32) {
        if self.can_draw() {
            // SAFETY: inside of rendering with a pipeline.
            quick(|| unsafe {
                self.commands.device.raw.cmd_draw(
                    self.commands.raw,
                    vertices,
                    instances,
                    first,
                    first_instance,
                );
            });
        }
    }

    /// Draws indexed vertices.
    pub fn draw_indexed(
        &mut self,
        indices: u32,
        first: u32,
        base_vertex: i32,
        instances: u32,
        first_instance: u32,
    ) {
        let indexed = self.indexed;
        if self.can_draw() && self.ensure(indexed, "an indexed draw without an index buffer") {
            // SAFETY: inside of rendering with a pipeline and an index buffer.
            quick(|| unsafe {
                self.commands.device.raw.cmd_draw_indexed(
                    self.commands.raw,
                    indices,
                    instances,
                    first,
                    base_vertex,
                    first_instance,
                );
            });
        }
    }

    /// Runs work groups of the bound compute pipeline.
    pub fn dispatch(&mut self, x: u32, y: u32, z: u32) {
        let bound =
            self.pipeline.is_some_and(|p| p.point == vk::PipelineBindPoint::COMPUTE) && !self.rendering;
        if self.ensure(bound, "a dispatch inside of rendering, or without a compute pipeline") {
            // SAFETY: outside of rendering with a pipeline.
            quick(|| unsafe { self.commands.device.raw.cmd_dispatch(self.commands.raw, x, y, z) });
        }
    }
}
