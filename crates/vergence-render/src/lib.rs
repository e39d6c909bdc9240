#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod between;
pub mod camera;
mod cull;
mod draws;
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
mod slots;
mod surfaces;
mod target;
mod textures;
mod views;

pub use error::Error;
pub use mips::mip_chain;
pub use offscreen::Offscreen;
pub use quality::Quality;
pub use renderer::{PassMs, Renderer, Statistics};
pub use target::{Attachments, Target};
pub use vergence_shaders::{MAX_LIGHTS, MAX_VIEWS};
