//! Scenes: meshes, materials, lights, skeletons, animation, text; importers; picking.
//!
//! Whatever the file format, the result is one [`Scene`]; what a picture of it requires is [`Needs`]. This
//! crate draws nothing and knows no graphics API.
#![forbid(unsafe_code)]

pub mod animation;
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
mod shapes;
mod surface;
pub mod text;

pub use error::Error;
pub use import::{Limits, Progress};
pub use load::{load, load_with};
pub use model::Scene;
pub use needs::{Coverage, Law, Needs, Surface};
