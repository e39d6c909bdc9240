//! Scenes: meshes, materials, lights, skeletons, animation, text; importers; picking.
//!
//! Whatever the file format (glTF, OBJ, PLY, or a scene file that places them), the result is one [`Scene`]; what a
//! picture of it requires is [`Needs`]. This crate draws nothing and knows no graphics API. Files are not trusted:
//! damage is an error that names file and place, memory stays in proportion to the bytes on disk ([`Limits`]), and
//! nothing outside of the scene's folder is read.
//!
//! ```
//! use vergence_scene::{Limits, Needs, load, model::WorldTransforms, pick::Picker};
//! # let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("samples/room.toml");
//! let scene = load(&path, &Limits::default())?;
//! assert!(Needs::of(&scene, true).text);
//! // What does the user point at, looking down at the table?
//! let (picker, world) = (Picker::new(&scene), WorldTransforms::at_rest(&scene));
//! let origin = nalgebra::Point3::new(0.0, 1.6, 0.0);
//! let direction = nalgebra::UnitVector3::new_normalize(nalgebra::Point3::new(0.42, 0.78, -0.62) - origin);
//! let ray = vergence_geom::Ray { origin, direction };
//! let hit = picker.pick(&scene, &world, &ray, 10.0).ok_or("nothing there")?;
//! let touchable = scene.touchable_of(hit.node).ok_or("not to be touched")?;
//! assert_eq!(scene.touchables[touchable].name, "mug");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
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
mod shapes;
mod surface;
pub mod text;

pub use error::Error;
pub use import::{Limits, Progress};
pub use lines::linear_from_srgb;
pub use load::{ENDINGS, load, load_with};
pub use model::Scene;
pub use needs::{Coverage, Law, Needs, Surface};
