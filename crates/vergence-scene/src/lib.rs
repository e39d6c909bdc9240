#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod animation;
mod bounds;
mod default_light;
mod error;
pub mod gltf;
mod import;
mod lines;
mod load;
pub mod model;
mod mtl;
mod needs;
mod obj;
pub mod pick;
mod picture;
mod ply;
mod polygon;
pub mod scene_file;
pub mod shapes;
mod surface;
pub mod text;

pub use error::Error;
pub use import::{Limits, Progress};
pub use lines::linear_from_srgb;
pub use load::{ENDINGS, load, load_with};
pub use model::Scene;
pub use needs::{Coverage, Law, Needs, Surface};
