//! Composed pictures as files.

use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use vergence_geom::components;
use vergence_xr_sim::{Capture, ComposedFrame};

use crate::Error;

/// Writes every `every`th frame into `folder`, which is made where it is missing. A failure is said once, and ends the
/// writing, not the application.
pub(crate) fn to_folder(folder: PathBuf, every: u64) -> Result<Capture, Error> {
    let failed = |path: &Path| {
        let path = path.to_owned();
        move |source| Error::Write { path, source }
    };
    std::fs::create_dir_all(&folder).map_err(failed(&folder))?;
    let path = folder.join("poses.jsonl");
    let poses = File::create(&path).map_err(failed(&path))?;
    let state = Mutex::new(Some(poses));
    Ok(Capture::new(move |frame| {
        let mut state = state.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(poses) = state.as_mut().filter(|_| frame.number % every == 0) else { return };
        if let Err(error) = write(&folder, poses, &frame) {
            eprintln!("vergence OpenXR runtime: {}: {error}; no more pictures are written", folder.display());
            *state = None;
        }
    }))
}

fn write(folder: &Path, poses: &mut File, frame: &ComposedFrame) -> std::io::Result<()> {
    let (width, height) = frame.size;
    let file = format!("frame-{:06}.png", frame.number);
    let mut encoder = png::Encoder::new(BufWriter::new(File::create(folder.join(&file))?), 2 * width, height);
    encoder.set_color(png::ColorType::Rgba);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    encoder.set_compression(png::Compression::Fast);
    let row = 4 * width as usize;
    let mut pixels = Vec::with_capacity(2 * row * height as usize);
    for (left, right) in frame.eyes[0].rgba.chunks_exact(row).zip(frame.eyes[1].rgba.chunks_exact(row)) {
        pixels.extend_from_slice(left);
        pixels.extend_from_slice(right);
    }
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&pixels)?;
    writer.finish()?;
    let eyes: Vec<serde_json::Value> = frame
        .eyes
        .iter()
        .map(|eye| {
            let fov = eye.view_in_local.fov;
            serde_json::json!({
                "pose": components(&eye.view_in_local.world_from_eye),
                "fov": [fov.left_rad, fov.right_rad, fov.up_rad, fov.down_rad],
            })
        })
        .collect();
    let line = serde_json::json!({
        "frame": frame.number,
        "display_ns": frame.display_time.as_nanos(),
        "file": file,
        "size": [width, height],
        "head": components(&frame.local_from_head),
        "eyes": eyes,
    });
    // In one piece: the process may be killed between two of them.
    poses.write_all(format!("{line}\n").as_bytes())
}
