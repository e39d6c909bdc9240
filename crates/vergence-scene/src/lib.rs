//! Scenes: meshes, materials, lights, skeletons, animation, text; importers; picking.
//!
//! Whatever the file format, the result is one [`Scene`]; what a picture of it requires is [`Needs`]. This
//! crate draws nothing and knows no graphics API.
#![forbid(unsafe_code)]

pub mod model;
mod needs;

pub use model::Scene;
pub use needs::{Coverage, Law, Needs, Surface};
