#![doc = include_str!("../README.md")]
// This is the room where Vulkan is called: raw handles become types that keep its rules.
#![allow(unsafe_code)]
#![warn(missing_docs)]

mod buffer;
mod census;
mod command;
mod descriptor;
mod device;
mod driver_clock;
mod encoder;
mod error;
mod format;
mod image;
mod instance;
mod limits;
mod pipeline;
mod sampler;
mod select;
mod surface;
mod sync;
mod upload;

/// Vulkan's plain enumerations, flags and handles. Functions are called only in this crate.
pub use ash::vk;

pub use buffer::{Buffer, Memory};
pub use census::Census;
pub use command::{CommandBuffer, PassTime, Signal, Wait};
pub use descriptor::{BindingDesc, Bound, DescriptorSet, SetLayout};
pub use device::{Device, DeviceDesc, QueueGuard, RawDevice};
pub use driver_clock::{DriverTime, driver_time, set_driver_clock, thread_cpu_ns};
pub use encoder::{
    Area, BufferBarrier, ColorAttachment, DepthAttachment, Encoder, ImageBarrier, Load, Rendering,
};
pub use error::Error;
pub use format::texel_bytes;
pub use image::{Image, ImageDesc, ImageView, ViewDesc, full_mips};
pub use instance::{DeviceSummary, Instance, InstanceDesc, VulkanCreator};
pub use limits::Limits;
pub use pipeline::{
    Attribute, Blend, ComputePipeline, DepthState, GraphicsPipeline, GraphicsPipelineDesc, MAX_COLORS,
    PipelineLayout, ShaderModule, Stage, VertexBuffer,
};
pub use sampler::{Sampler, SamplerDesc};
pub use select::{DEVICE_VARIABLE, choose_device};
pub use surface::{Mirror, Presentable, Shown};
pub use sync::{Timeline, Use};
pub use upload::{ReadBack, Upload};
