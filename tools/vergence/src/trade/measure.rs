//! Draws every scene at every setting and compares it with its truth.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use indicatif::{ProgressBar, ProgressStyle};
use vergence_fidelity::{Picture, flip, rmse, ssim};
use vergence_render::Quality;
use vergence_scene::{Needs, Scene};
use vergence_trade::{Knob, Measurement, Scale, Setting, Trade, Value};

use super::studio::{Costs, Drawn, Studio};
use crate::failure::Failure;
use crate::framing::Framing;

/// Index of the cost scale: CPU time of all threads.
pub const CPU: usize = 0;
/// Index of the cost scale: time on the device.
pub const GPU: usize = 1;
/// Index of the cost scale: elapsed time.
pub const WALL: usize = 2;

/// Shading samples per pixel and axis of the truth: 4 × 4 = 16 per pixel.
const TRUTH_FACTOR: u32 = 4;
/// Frames before the measured ones.
const WARM_UP: u32 = 2;

/// What is to be measured.
pub struct Plan {
    /// At least one.
    pub scenes: Vec<PathBuf>,
    /// Pixels per eye at render scale 1.
    pub size: (u32, u32),
    /// The cameras of the peer's benchmark instead of the scenes' own.
    pub bench_view: bool,
    /// Fewer settings and frames.
    pub quick: bool,
}

/// What came out.
pub struct Measured {
    /// Device and driver.
    pub device: String,
    /// Pixels per eye at render scale 1.
    pub size: (u32, u32),
    /// Frames of which a cost is the median.
    pub frames: u32,
    /// One paragraph.
    pub method: String,
    /// Whether the device's timestamps are not those of the CPU.
    pub gpu_times_mean_something: bool,
    /// Each setting's worst scene.
    pub all: Trade,
    /// One per scene.
    pub scenes: Vec<MeasuredScene>,
}

/// One scene's measurements.
pub struct MeasuredScene {
    /// Fit for a file name.
    pub name: String,
    /// All settings.
    pub trade: Trade,
    /// Left eye.
    pub truth_png: Vec<u8>,
    /// Left eye, at the cheapest setting (CPU).
    pub cheapest_png: Vec<u8>,
}

/// Loads, draws and compares.
pub fn measure(plan: &Plan) -> Result<Measured, Failure> {
    let mut studio = Studio::open()?;
    let scenes = load(plan)?;
    let knobs = knobs(&studio, &scenes, plan.quick);
    let frames = if plan.quick { 3 } else { 9 };
    let new_trade = |title: String| {
        let costs = [("CPU", "ms"), ("GPU", "ms"), ("wall", "ms")].map(|(n, u)| Scale::new(n, u)).to_vec();
        let errors = ["FLIP", "RMSE", "1 - SSIM"].map(|n| Scale::new(n, "")).to_vec();
        Trade::new(title, knobs.clone(), costs, errors).map_err(|e| Failure::work(&e))
    };
    let mut all = new_trade(format!("worst of {} scenes", scenes.len()))?;
    let settings = all.grid();
    let bar = ProgressBar::new((scenes.len() * (settings.len() + 1)) as u64);
    bar.set_style(
        ProgressStyle::with_template("{bar:30} {pos}/{len} {elapsed} of {duration} {msg}")
            .unwrap_or_else(|_| ProgressStyle::default_bar()),
    );
    let mut measured_scenes: Vec<MeasuredScene> = Vec::new();
    for Loaded { name, scene, framing } in &scenes {
        bar.set_message(format!("{name}: truth"));
        let aspect = f64::from(plan.size.0) / f64::from(plan.size.1);
        let views = framing.views(aspect).map_err(|e| Failure::call(&e))?;
        let pixels_per_degree =
            0.5 * f64::from(plan.size.1) / (0.5 * framing.fov_y_rad).tan() * 1f64.to_radians();
        let truth = truth(&mut studio, scene, framing.near_m, &views, plan.size)?;
        bar.inc(1);
        let mut trade = new_trade(name.clone())?;
        let mut cheapest: Option<(f64, Picture)> = None;
        for setting in &settings {
            bar.set_message(format!("{name}: {setting}"));
            let quality = Quality { near_m: framing.near_m, ..quality(setting) };
            let scaled = |side: u32| ((f64::from(side) * quality.render_scale).round() as u32).max(1);
            let size = (scaled(plan.size.0), scaled(plan.size.1));
            let drawn = studio.draw(scene, &quality, size, &views, WARM_UP, frames)?;
            let pictures = pictures(&drawn, plan.size)?;
            let errors = errors(&truth, &pictures, pixels_per_degree)?;
            let Costs { cpu_ms, gpu_ms, wall_ms } = drawn.costs;
            if let Some(left) =
                pictures.first().filter(|_| cheapest.as_ref().is_none_or(|(c, _)| cpu_ms < *c))
            {
                cheapest = Some((cpu_ms, left.clone()));
            }
            let costs = vec![cpu_ms, gpu_ms, wall_ms];
            let measurement = Measurement { setting: setting.clone(), costs, errors };
            trade.push(measurement).map_err(|e| Failure::work(&e))?;
            bar.inc(1);
        }
        measured_scenes.push(MeasuredScene {
            name: name.clone(),
            trade,
            truth_png: truth.first().map(png).transpose()?.unwrap_or_default(),
            cheapest_png: cheapest.as_ref().map(|(_, left)| png(left)).transpose()?.unwrap_or_default(),
        });
    }
    bar.finish_and_clear();
    for (index, setting) in settings.into_iter().enumerate() {
        let of = |f: &dyn Fn(&Measurement) -> &Vec<f64>| {
            let each: Vec<&Vec<f64>> =
                measured_scenes.iter().map(|s| f(&s.trade.measurements()[index])).collect();
            worst(&each)
        };
        let measurement = Measurement { setting, costs: of(&|m| &m.costs), errors: of(&|m| &m.errors) };
        all.push(measurement).map_err(|e| Failure::work(&e))?;
    }
    Ok(Measured {
        device: studio.device_name(),
        size: plan.size,
        frames,
        method: format!(
            "Time per stereo frame, without read-back: the median of {frames} frames after {WARM_UP}. Error against {} \
             shading samples per pixel ({TRUTH_FACTOR} x {TRUTH_FACTOR}, each with MSAA {} and anisotropy {}), averaged in \
             linear light; mean of both eyes; other render scales stretched bilinearly in linear light. FLIP at the \
             view's own pixels per degree.",
            TRUTH_FACTOR * TRUTH_FACTOR,
            studio.most_msaa(),
            studio.most_anisotropy()
        ),
        gpu_times_mean_something: studio.gpu_times_mean_something(),
        all,
        scenes: measured_scenes,
    })
}

/// The largest of each column; NaN where one of them is.
fn worst(rows: &[&Vec<f64>]) -> Vec<f64> {
    let columns = rows.first().map_or(0, |row| row.len());
    let larger = |a: f64, b: f64| if a.is_nan() || b.is_nan() { f64::NAN } else { a.max(b) };
    (0..columns).map(|c| rows.iter().map(|row| row[c]).fold(f64::NEG_INFINITY, larger)).collect()
}

/// A scene and where it is seen from.
struct Loaded {
    name: String,
    scene: Arc<Scene>,
    framing: Framing,
}

fn load(plan: &Plan) -> Result<Vec<Loaded>, Failure> {
    let mut scenes: Vec<Loaded> = Vec::new();
    for path in &plan.scenes {
        let mut scene = crate::loading::scene(path)?;
        scene.light_if_dark();
        let framing = if plan.bench_view { Framing::bench(&scene, path) } else { Framing::of(&scene) };
        let scene = Arc::new(scene);
        let stem = file_name(path);
        let taken =
            scenes.iter().filter(|s| s.name == stem || s.name.starts_with(&format!("{stem}-"))).count();
        let name = if taken == 0 { stem } else { format!("{stem}-{}", taken + 1) };
        scenes.push(Loaded { name, scene, framing });
    }
    Ok(scenes)
}

fn file_name(path: &Path) -> String {
    let stem = path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let name: String =
        stem.chars().map(|c| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' }).collect();
    if name.is_empty() { "scene".to_owned() } else { name }
}

/// What can be turned on this device and makes a difference in one of the scenes at least.
fn knobs(studio: &Studio, scenes: &[Loaded], quick: bool) -> Vec<Knob> {
    let needs: Vec<Needs> = scenes.iter().map(|s| Needs::of(&s.scene, true)).collect();
    let textures = needs.iter().any(|n| !n.images.is_empty());
    let relief = needs.iter().any(|n| n.surfaces.iter().any(|s| s.normal_texture));
    let default = Quality::default();
    let anisotropy: &[f64] = match (textures, quick) {
        (false, _) => &[1.0],
        (true, true) => &[1.0, 16.0],
        (true, false) => &[1.0, 4.0, 16.0],
    };
    let most = f64::from(studio.most_anisotropy());
    let mut anisotropy: Vec<f64> = anisotropy.iter().map(|a| a.min(most)).collect();
    anisotropy.dedup();
    let scales: &[f64] = if quick { &[0.7, 1.0] } else { &[0.5, 0.7, 1.0, 1.4] };
    let normal_maps: &[bool] = if relief { &[false, true] } else { &[default.normal_maps] };
    vec![
        Knob::new("msaa", "", studio.msaa().iter().map(|&samples| Value::from(samples)).collect()),
        Knob::new("anisotropy", "", anisotropy.into_iter().map(Value::from).collect()),
        Knob::new("render_scale", "", scales.iter().map(|&scale| Value::from(scale)).collect()),
        Knob::new("normal_maps", "", normal_maps.iter().map(|&on| Value::from(on)).collect()),
    ]
}

/// The renderer's knobs as a setting has them.
fn quality(setting: &Setting) -> Quality {
    let file = super::quality_of(setting).quality;
    let default = Quality::default();
    Quality {
        msaa: file.msaa.unwrap_or(default.msaa),
        anisotropy: file.anisotropy.or(default.anisotropy),
        render_scale: file.render_scale.unwrap_or(default.render_scale),
        normal_maps: file.normal_maps.unwrap_or(default.normal_maps),
        ..default
    }
}

fn truth(
    studio: &mut Studio,
    scene: &Arc<Scene>,
    near_m: f64,
    views: &[vergence_geom::View],
    size: (u32, u32),
) -> Result<Vec<Picture>, Failure> {
    let quality = Quality {
        msaa: studio.most_msaa(),
        anisotropy: Some(studio.most_anisotropy()),
        normal_maps: true,
        render_scale: 1.0,
        near_m,
        ..Quality::default()
    };
    let large = (TRUTH_FACTOR * size.0, TRUTH_FACTOR * size.1);
    let drawn = studio.draw(scene, &quality, large, views, 0, 1)?;
    let average = |rgba: &Vec<u8>| {
        let picture = Picture::from_rgba8(large.0 as usize, large.1 as usize, rgba)?;
        picture.averaged(TRUTH_FACTOR as usize)
    };
    drawn.rgba.iter().map(average).collect::<Result<_, _>>().map_err(|e| Failure::work(&e))
}

fn pictures(drawn: &Drawn, size: (u32, u32)) -> Result<Vec<Picture>, Failure> {
    let (width, height) = (drawn.size.0 as usize, drawn.size.1 as usize);
    let fit = |rgba: &Vec<u8>| {
        let picture = Picture::from_rgba8(width, height, rgba)?;
        if drawn.size == size { Ok(picture) } else { picture.stretched(size.0 as usize, size.1 as usize) }
    };
    drawn.rgba.iter().map(fit).collect::<Result<_, _>>().map_err(|e| Failure::work(&e))
}

/// FLIP, RMSE, 1 − SSIM: in the order of the trade's scales, means over the views.
fn errors(truth: &[Picture], pictures: &[Picture], pixels_per_degree: f64) -> Result<Vec<f64>, Failure> {
    let mut sums = [0.0; 3];
    for (truth, picture) in truth.iter().zip(pictures) {
        let three = || {
            let flip = flip(truth, picture, pixels_per_degree.clamp(1.0, 1000.0))?.mean;
            Ok([flip, rmse(truth, picture)?, 1.0 - ssim(truth, picture)?])
        };
        let three = three().map_err(|e: vergence_fidelity::Error| Failure::work(&e))?;
        sums.iter_mut().zip(three).for_each(|(sum, error)| *sum += error);
    }
    Ok(sums.map(|sum| sum / truth.len().max(1) as f64).to_vec())
}

fn png(picture: &Picture) -> Result<Vec<u8>, Failure> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, picture.width() as u32, picture.height() as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    let mut writer = encoder.write_header().map_err(|e| Failure::work(&e))?;
    writer.write_image_data(&picture.to_rgb8()).map_err(|e| Failure::work(&e))?;
    writer.finish().map_err(|e| Failure::work(&e))?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_scene_counts_and_nan_stays() {
        let (a, b) = (vec![1.0, f64::NAN, 3.0], vec![2.0, 1.0, -1.0]);
        let worst = worst(&[&a, &b]);
        assert_eq!((worst[0], worst[2]), (2.0, 3.0));
        assert!(worst[1].is_nan());
    }

    #[test]
    fn names_fit_for_files() {
        assert_eq!(file_name(Path::new("/a/b c/Suzanne é?.gltf")), "Suzanne_é_");
        assert_eq!(file_name(Path::new("/")), "scene");
    }
}
