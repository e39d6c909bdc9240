//! What a recording was made of, so that a replay can tell whether it has the same before it.

use std::path::{Path, PathBuf};

use vergence_scene::Scene;

use crate::error::Error;

/// The name of each of a scene's files as seen from the folder of the first one, and where it is.
pub(crate) fn named_files(scene: &Scene) -> Vec<(String, PathBuf)> {
    let folder = scene.files.first().and_then(|first| first.parent()).unwrap_or(Path::new(""));
    scene
        .files
        .iter()
        .map(|file| {
            let name = file.strip_prefix(folder).unwrap_or(file);
            (name.to_string_lossy().into_owned(), file.clone())
        })
        .collect()
}

/// Identifies a scene's content, wherever its files are: the names of all its files and what is in them. Empty for a scene
/// that was made from no file.
///
/// # Errors
/// Where a file cannot be read any more.
pub fn scene_hash(scene: &Scene) -> Result<String, Error> {
    if scene.files.is_empty() {
        return Ok(String::new());
    }
    let mut hasher = blake3::Hasher::new();
    let mut files = named_files(scene);
    // The first one by its ending only: renamed, it is the same scene.
    let first = files.remove(0);
    files.sort();
    for (name, path) in std::iter::once((String::new(), first.1)).chain(files) {
        let bytes = std::fs::read(&path).map_err(Error::read(&path))?;
        hasher.update(&(name.len() as u64).to_le_bytes());
        hasher.update(name.as_bytes());
        hasher.update(&(bytes.len() as u64).to_le_bytes());
        hasher.update(&bytes);
    }
    Ok(format!("blake3:{}", hasher.finalize().to_hex()))
}

/// Where the scene is, absolutely; empty for one that was made from no file.
pub(crate) fn scene_path(scene: &Scene) -> String {
    let Some(first) = scene.files.first() else { return String::new() };
    let absolute = std::path::absolute(first).unwrap_or_else(|_| first.clone());
    absolute.to_string_lossy().into_owned()
}

/// Identifies this very program: pictures are compared between equal ones only. Read once.
pub(crate) fn build() -> String {
    static BUILD: std::sync::OnceLock<String> = std::sync::OnceLock::new();
    BUILD
        .get_or_init(|| {
            let hash = std::env::current_exe().and_then(|path| {
                let mut hasher = blake3::Hasher::new();
                std::io::copy(&mut std::fs::File::open(path)?, &mut hasher)?;
                Ok(hasher.finalize().to_hex()[..16].to_owned())
            });
            format!("{} {}", env!("CARGO_PKG_VERSION"), hash.unwrap_or_else(|_| "unknown".to_owned()))
        })
        .clone()
}
