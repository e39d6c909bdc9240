use std::path::Path;

use crate::import::{Import, Limits, Progress};
use crate::{Error, Scene};

/// How the names of files that [`load`] reads end, in lower case.
pub const ENDINGS: [&str; 5] = ["glb", "gltf", "obj", "ply", "toml"];

/// Loads the scene at `path`: `.glb`, `.gltf`, `.obj`, `.ply`, or a scene file (`.toml`).
///
/// Files that it names must lie in (or below) its folder. What the format can say but Vergence does not draw is in
/// [`Scene::warnings`], one sentence each.
///
/// # Errors
/// Where a file cannot be read, is not what its format asks for, or asks for more than `limits` allow; the error
/// names file and place.
pub fn load(path: &Path, limits: &Limits) -> Result<Scene, Error> {
    load_with(path, limits, &mut |_| {})
}

/// As [`load`]; calls `progress` now and then.
///
/// # Errors
/// As [`load`].
pub fn load_with(path: &Path, limits: &Limits, progress: &mut dyn FnMut(Progress)) -> Result<Scene, Error> {
    let mut import = Import::new(path, limits, progress)?;
    let bytes = import.read_named(path)?;
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    let mut scene = match extension.as_deref() {
        Some("glb" | "gltf") => crate::gltf::load(&mut import, path, bytes)?,
        Some("obj") => crate::obj::load(&mut import, path, bytes)?,
        Some("ply") => crate::ply::load(&mut import, path, bytes)?,
        Some("toml") => crate::scene_file::load(&mut import, path, bytes)?,
        _ => {
            return Err(Error::invalid(
                path,
                "file name",
                format!(
                    "expected .glb, .gltf, .obj, .ply or .toml, found {}",
                    extension.as_deref().unwrap_or("none")
                ),
            ));
        }
    };
    crate::picture::keep_stand_ins_for_colours(&mut scene);
    if !scene.shows_something() {
        import.warn("there is nothing to see: expected a surface or a label, found none");
    }
    scene.warnings = import.take_warnings();
    scene.files = import.take_read();
    Ok(scene)
}
