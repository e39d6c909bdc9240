//! Loading a scene with a progress bar on stderr and its warnings in the log.

use std::path::Path;

use indicatif::{ProgressBar, ProgressStyle};
use vergence_scene::{Limits, Scene};

use crate::failure::Failure;

/// Loads a scene. A bar is drawn only where stderr is a terminal.
pub fn scene(path: &Path) -> Result<Scene, Failure> {
    if !path.is_file() {
        return Err(Failure::Call(format!("{}: expected a scene file, found none", path.display())));
    }
    let bar = ProgressBar::new(0);
    if let Ok(style) = ProgressStyle::with_template("{msg:10} {bar:40} {pos}/{len}") {
        bar.set_style(style);
    }
    let loaded = vergence_scene::load_with(path, &Limits::default(), &mut |progress| {
        bar.set_message(progress.stage);
        bar.set_length(progress.of as u64);
        bar.set_position(progress.done as u64);
    });
    bar.finish_and_clear();
    let mut scene = loaded.map_err(|error| Failure::work(&error))?;
    if scene.light_if_dark() {
        log::info!("the scene has no light: lit from above");
    }
    for warning in &scene.warnings {
        log::warn!("{warning}");
    }
    Ok(scene)
}
