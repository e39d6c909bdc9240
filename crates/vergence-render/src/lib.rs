//! Vulkan stereo passes: a scene, drawn for all eyes at once.
//!
//! [`Renderer::new`] makes exactly what [`Needs`](vergence_scene::Needs) asks for. A frame is then
//! [`begin`](Renderer::begin) (animate, cull, record), [`latch`](Renderer::latch) (write the views, as late as
//! possible) and [`submit`](Renderer::submit). [`Offscreen`] is a target that can be read back.
//!
//! Precision: meshes are cut into parts whose vertices are single precision relative to the part's own centre;
//! for each part and eye the matrix is composed in double precision and cast last, so that a scene far from the
//! origin looks the same. Depth is reversed and has no far plane. It depends on no window and no headset.
//!
//! ```no_run
//! # use std::sync::Arc;
//! use vergence_gpu::{Device, DeviceDesc, Instance, InstanceDesc};
//! use vergence_render::{Offscreen, Quality, Renderer, Target, camera};
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let mut scene = vergence_scene::load("box.glb".as_ref(), &vergence_scene::Limits::default())?;
//! scene.light_if_dark();
//! let scene = Arc::new(scene);
//! let device = Device::new(&Instance::new(&InstanceDesc::default(), None)?, &DeviceDesc::default(), None)?;
//! let (quality, target) = (Quality::default(), Target::new((1024, 1024), 2));
//! let needs = vergence_scene::Needs::of(&scene, quality.normal_maps);
//! let mut renderer = Renderer::new(&device, &scene, &needs, &quality, &target, 1)?;
//! let mut offscreen = Offscreen::new(&device, &target, false)?;
//! let head = camera::look_at(&[1.0, 1.0, 2.0].into(), &[0.0, 0.0, 0.0].into());
//! let views = camera::stereo(&head, 0.063, vergence_geom::Fov::symmetric(1.0, 1.0)?);
//! renderer.begin(0, vergence_time::Span::ZERO, &views, &offscreen.attachments())?;
//! renderer.latch(0, &views)?;
//! renderer.submit(0)?;
//! let [_left, _right] = &offscreen.pictures()?[..] else { unreachable!("one per view") };
//! # Ok(())
//! # }
//! ```
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
