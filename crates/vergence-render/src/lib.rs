//! Vulkan stereo passes: a scene, drawn for all eyes at once.
//!
//! [`Renderer::new`] makes exactly what [`Needs`](vergence_scene::Needs) asks for. A frame is then
//! [`begin`](Renderer::begin) (animate, cull, record), [`latch`](Renderer::latch) (write the views, as late as
//! possible) and [`submit`](Renderer::submit). [`Offscreen`] is a target that can be read back.
//!
//! Precision: meshes are cut into parts whose vertices are single precision relative to the part's own centre;
//! for each part and eye the matrix is composed in double precision and cast last, so that a scene far from the
//! origin looks the same. Depth is reversed and has no far plane. It depends on no window and no headset.
#![forbid(unsafe_code)]

mod between;
pub mod camera;
mod cull;
mod error;
mod hidden;
mod labels;
mod lights;
mod meshes;
mod mips;
mod offscreen;
mod parts;
mod pipelines;
mod pose;
mod quality;
mod renderer;
mod skinning;
mod surfaces;
mod textures;
mod views;

pub use error::Error;
pub use mips::mip_chain;
pub use offscreen::Offscreen;
pub use quality::Quality;
pub use renderer::{Attachments, PassMs, Renderer, Statistics, Target};
pub use vergence_shaders::{MAX_LIGHTS, MAX_VIEWS};
