//! Loading a scene with a progress bar on stderr and its warnings in the log.

use std::path::Path;

use indicatif::{ProgressBar, ProgressStyle};
use vergence_scene::{Limits, Scene};

use crate::failure::Failure;

/// That the caller names a file, of a kind that is known; what is in it is another matter (exit status 1).
fn name_is_right(path: &Path) -> Result<(), Failure> {
    let found = match path.metadata() {
        Ok(metadata) if metadata.is_file() => {
            let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
            if ending.as_deref().is_some_and(|ending| vergence_scene::ENDINGS.contains(&ending)) {
                return Ok(());
            }
            ending.map_or("no ending".to_owned(), |ending| format!(".{ending}"))
        }
        Ok(metadata) if metadata.is_dir() => "a folder".to_owned(),
        Ok(_) => "a device".to_owned(),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            let data = std::env::var_os("VERGENCE_DATA").map(|folder| Path::new(&folder).join(path));
            match data.filter(|there| there.is_file()) {
                Some(there) => format!("no such file; did you mean {}?", there.display()),
                None => "no such file".to_owned(),
            }
        }
        // It may well be right.
        Err(error) => return Err(Failure::Work(format!("{}: {error}", path.display()))),
    };
    let endings = vergence_scene::ENDINGS.map(|ending| format!(".{ending}")).join(", ");
    Err(Failure::Call(format!("{}: expected a scene file ({endings}), found {found}", path.display())))
}

/// Loads a scene. A bar is drawn only where stderr is a terminal.
pub fn scene(path: &Path) -> Result<Scene, Failure> {
    name_is_right(path)?;
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
