//! `vergence render`: a picture of a scene, or how long pictures take.

use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use serde_json::json;
use vergence_geom::View;
use vergence_gpu::{Device, DeviceDesc, Instance, InstanceDesc};
use vergence_render::{Offscreen, Quality, Renderer, Target};
use vergence_scene::{Needs, Scene};
use vergence_time::Span;

use crate::failure::Failure;
use crate::framing::{self, Framing};
use crate::loading;
use crate::timing::{least, median, process_cpu_ms};

/// Frames that are drawn before any is measured.
const WARM_UP_FRAMES: u32 = 3;

/// Draws a scene to a picture, or measures how long that takes
#[derive(clap::Args)]
pub struct Args {
    /// A .glb, .gltf, .obj, .ply or scene .toml
    scene: PathBuf,
    /// Which eyes: both side by side, one of them, or the middle between them
    #[arg(long, value_enum, default_value_t = Eye::Stereo)]
    eye: Eye,
    /// Where the head is, metres; default: the scene's start, its first camera, or where all of it is seen
    #[arg(long, value_name = "X,Y,Z", value_parser = framing::point, allow_hyphen_values = true)]
    eye_position: Option<nalgebra::Point3<f64>>,
    /// What it looks at, metres; default: the middle of the scene
    #[arg(long, value_name = "X,Y,Z", value_parser = framing::point, allow_hyphen_values = true)]
    target: Option<nalgebra::Point3<f64>>,
    /// Vertical field of view, degrees, between 0 and 180; default: the camera's, else 60
    #[arg(long, value_name = "DEG", value_parser = framing::fov_y_deg, allow_negative_numbers = true)]
    fov_y: Option<f64>,
    /// Distance between the eyes, millimetres; default: 63, with --view three 64
    #[arg(long, value_name = "MM", value_parser = framing::ipd_mm, allow_negative_numbers = true)]
    ipd: Option<f64>,
    /// `three`: the cameras of the peer's benchmark (eyes ±32 mm, 60°), nothing animated
    #[arg(long, value_enum, conflicts_with_all = ["eye_position", "target", "fov_y", "ipd"])]
    view: Option<Preset>,
    /// `scene`: the scene's (where it has none, one from the upper right and ambient light); `three`: those of the
    /// peer's benchmark beside the scene's; `none`
    #[arg(long, value_enum, default_value_t = Lights::Scene)]
    lights: Lights,
    /// Pixels of each eye's picture
    #[arg(long, value_name = "WxH", value_parser = framing::size, default_value = "1024x1024")]
    size: (u32, u32),
    /// Samples per pixel for edges
    #[arg(long, value_name = "N", default_value_t = Quality::default().msaa)]
    msaa: u32,
    /// Texture samples along the line of sight [default: 4, or what the device has]
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    anisotropy: Option<f32>,
    /// Leaves normal maps out
    #[arg(long)]
    no_normal_maps: bool,
    /// Time in the scene's animations, seconds
    #[arg(long, value_name = "S", default_value = "0", value_parser = seconds, allow_hyphen_values = true)]
    time: Span,
    /// The picture, a PNG; `-`: to stdout
    #[arg(short, long, value_name = "FILE.png", value_parser = png_file, required_unless_present = "json")]
    output: Option<Output>,
    /// Frames to draw; with more than one, or --json, they are measured, after three that are not
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    frames: u32,
    /// Brings the pixels of every frame back to the host
    #[arg(long)]
    read_back: bool,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
    /// Turns Vulkan's validation layer on; any message is a failure
    #[arg(long)]
    validate: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Eye {
    Stereo,
    Left,
    Right,
    Mono,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Preset {
    Three,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Lights {
    Scene,
    Three,
    None,
}

/// Where the picture goes.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Output {
    Stdout,
    File(PathBuf),
}

/// Parses the name of a picture.
fn png_file(text: &str) -> Result<Output, String> {
    if text == "-" {
        return Ok(Output::Stdout);
    }
    let path = PathBuf::from(text);
    match path.extension() {
        Some(extension) if extension.eq_ignore_ascii_case("png") => Ok(Output::File(path)),
        _ => Err(format!("expected a name that ends in .png, or - for stdout, found {text:?}")),
    }
}

/// Parses a time in a scene.
fn seconds(text: &str) -> Result<Span, String> {
    let seconds: Option<f64> = text.parse().ok();
    let span = seconds.filter(|s| s.is_finite()).and_then(Span::from_secs_f64);
    span.ok_or_else(|| format!("expected a number of seconds (up to 292 years), found {text:?}"))
}

/// Milliseconds per frame.
struct Times {
    wall_ms: Vec<f64>,
    cpu_ms: Vec<f64>,
    thread_ms: Vec<f64>,
}

impl Args {
    /// Draws, measures, writes, prints.
    pub fn run(self) -> Result<(), Failure> {
        if self.json && self.output == Some(Output::Stdout) {
            return Err(Failure::Call("--json and -o -: expected one of them on stdout, found both".into()));
        }
        let scene = self.prepare()?;
        if let Some(Output::File(output)) = &self.output {
            Failure::unless_own("--output", output, &scene.files)?;
        }
        let framing = self.frame(&scene)?;
        let all =
            framing.views(f64::from(self.size.0) / f64::from(self.size.1)).map_err(|e| Failure::call(&e))?;
        let views: Vec<View> = match self.eye {
            Eye::Stereo => all.to_vec(),
            Eye::Left => vec![all[0]],
            Eye::Right => vec![all[1]],
            Eye::Mono => vec![framing.mono(&all)],
        };
        let quality = Quality {
            msaa: self.msaa,
            anisotropy: self.anisotropy,
            normal_maps: !self.no_normal_maps,
            near_m: framing.near_m,
            // Pictures are drawn from exactly the views that they are culled for.
            cull_margin_m: 0.0,
            cull_margin_rad: 0.0,
            ..Quality::default()
        };
        let desc = InstanceDesc { app_name: "vergence", validation: self.validate, surface: None };
        let instance = Instance::new(&desc, None).map_err(|e| Failure::work(&e))?;
        let device = Device::new(&instance, &DeviceDesc::default(), None).map_err(|e| Failure::gpu(&e))?;
        quality.check(device.limits()).map_err(|e| Failure::call(&e))?;
        let most = device.limits().max_image_size;
        if self.size.0.max(self.size.1) > most {
            let (width, height) = self.size;
            return Err(Failure::Call(format!(
                "--size: expected at most {most}x{most} ({}), found {width}x{height}",
                device.limits().name
            )));
        }
        let anisotropy = quality.anisotropy_on(device.limits());
        let target = Target::new(self.size, views.len() as u32);
        let needs = Needs::of(&scene, quality.normal_maps);
        let renderer = Renderer::new(&device, &scene, &needs, &quality, &target, 1);
        let mut renderer = renderer.map_err(|e| Failure::work(&e))?;
        let mut offscreen = Offscreen::new(&device, &target, false).map_err(|e| Failure::work(&e))?;
        let times =
            self.draw(&device, &mut renderer, &mut offscreen, &views).map_err(|e| Failure::work(&e))?;
        if let Some(output) = &self.output {
            let pictures = offscreen.pictures().map_err(|e| Failure::work(&e))?;
            write_png(output, self.size, &pictures)?;
        }
        let passes = renderer.timings(0).map_err(|e| Failure::work(&e))?;
        let statistics = renderer.statistics();
        let messages = device.validation_messages();
        if !messages.is_empty() {
            return Err(Failure::Work(format!("Vulkan validation: {}", messages.join("\n"))));
        }
        if self.json {
            let summary = |times: &[f64]| json!({ "min": least(times), "median": median(times) });
            // The stamps of a processor are not those of a GPU.
            let passes = passes.iter().filter(|_| !device.limits().software);
            let gpu: serde_json::Map<_, _> = passes.map(|p| (p.name.into(), json!(p.ms))).collect();
            println!(
                "{}",
                json!({
                    "device": device.limits().name,
                    "size": [self.size.0, self.size.1],
                    "views": views.len(),
                    "msaa": self.msaa,
                    "anisotropy": anisotropy,
                    "camera": framing.describe(),
                    "triangles": statistics.triangles,
                    "triangles_drawn": statistics.triangles_drawn,
                    "draws": statistics.draws,
                    "read_back": self.read_back,
                    "frames": times.wall_ms.len(),
                    "wall_ms": summary(&times.wall_ms),
                    "cpu_ms": summary(&times.cpu_ms),
                    "frame_thread_ms": summary(&times.thread_ms),
                    "gpu_ms": gpu,
                    "validated": self.validate,
                })
            );
        } else {
            let mut sentence = format!(
                "{}: {} × {}×{}, MSAA {}, anisotropy {}: {} triangles ({} drawn)",
                device.limits().name,
                views.len(),
                self.size.0,
                self.size.1,
                self.msaa,
                anisotropy,
                statistics.triangles,
                statistics.triangles_drawn,
            );
            if self.is_measured() {
                let (wall, cpu) = (median(&times.wall_ms), median(&times.cpu_ms));
                sentence += &format!(", {wall:.1} ms wall, {cpu:.1} ms CPU per frame");
            }
            match self.output {
                Some(Output::Stdout) => eprintln!("{sentence}"),
                _ => println!("{sentence}"),
            }
        }
        Ok(())
    }

    /// A single frame for a picture is not measured: its time would be that of the driver's compiler.
    fn is_measured(&self) -> bool {
        self.frames > 1 || self.json
    }

    /// The scene with the lights that were asked for.
    fn prepare(&self) -> Result<Arc<Scene>, Failure> {
        let mut scene = loading::scene(&self.scene)?;
        match self.lights {
            Lights::Scene => {
                scene.light_if_dark();
            }
            Lights::Three => framing::add_bench_lights(&mut scene),
            Lights::None => {
                scene.ambient = [0.0; 3];
                scene.nodes.iter_mut().for_each(|node| node.light = None);
            }
        }
        if self.view.is_some() {
            scene.animations.clear();
            scene.playing.clear();
        }
        Ok(Arc::new(scene))
    }

    fn frame(&self, scene: &Scene) -> Result<Framing, Failure> {
        let mut framing = match self.view {
            Some(Preset::Three) => Framing::bench(scene, &self.scene),
            None => Framing::of(scene),
        };
        if self.eye_position.is_some() || self.target.is_some() {
            framing.look(self.eye_position, self.target, scene).map_err(Failure::Call)?;
        }
        if let Some(fov_y) = self.fov_y {
            framing.fov_y_rad = fov_y.to_radians();
        }
        if let Some(ipd_mm) = self.ipd {
            framing.ipd_m = ipd_mm * 1e-3;
        }
        Ok(framing)
    }

    fn draw(
        &self,
        device: &Arc<Device>,
        renderer: &mut Renderer,
        offscreen: &mut Offscreen,
        views: &[View],
    ) -> Result<Times, vergence_render::Error> {
        let (time, measured) = (self.time, self.is_measured());
        let warm_up = if measured { WARM_UP_FRAMES } else { 0 };
        let mut times = Times { wall_ms: Vec::new(), cpu_ms: Vec::new(), thread_ms: Vec::new() };
        vergence_gpu::set_driver_clock(measured);
        for frame in 0..warm_up + self.frames {
            let (wall, cpu) = (Instant::now(), process_cpu_ms());
            let (thread, driver) = (vergence_gpu::thread_cpu_ns(), vergence_gpu::driver_time());
            renderer.begin(0, time, views, &offscreen.attachments())?;
            renderer.latch(0, views)?;
            let submission = renderer.submit(0)?;
            let thread_ns = vergence_gpu::thread_cpu_ns() - thread;
            let driver_ns = vergence_gpu::driver_time().ns - driver.ns;
            if self.read_back {
                offscreen.read(|pixels| std::hint::black_box(pixels.first().copied()))?;
            } else {
                device.wait(submission)?;
            }
            if frame >= warm_up {
                times.wall_ms.push(wall.elapsed().as_secs_f64() * 1e3);
                times.cpu_ms.push(process_cpu_ms() - cpu);
                times.thread_ms.push(thread_ns.saturating_sub(driver_ns) as f64 * 1e-6);
            }
        }
        Ok(times)
    }
}

/// Writes pictures of one size side by side.
fn write_png(output: &Output, size: (u32, u32), pictures: &[Vec<u8>]) -> Result<(), Failure> {
    let name = match output {
        Output::Stdout => "stdout".into(),
        Output::File(path) => path.display().to_string(),
    };
    let fail = |error: &dyn std::fmt::Display| Failure::Work(format!("{name}: {error}"));
    let row = 4 * size.0 as usize;
    let mut pixels = Vec::with_capacity(pictures.len() * row * size.1 as usize);
    for y in 0..size.1 as usize {
        for picture in pictures {
            pixels.extend_from_slice(&picture[y * row..(y + 1) * row]);
        }
    }
    let sink: Box<dyn Write> = match output {
        Output::Stdout => Box::new(std::io::stdout().lock()),
        Output::File(path) => Box::new(std::fs::File::create(path).map_err(|e| fail(&e))?),
    };
    let mut encoder =
        png::Encoder::new(std::io::BufWriter::new(sink), size.0 * pictures.len() as u32, size.1);
    encoder.set_color(png::ColorType::Rgba);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    let mut writer = encoder.write_header().map_err(|e| fail(&e))?;
    writer.write_image_data(&pixels).map_err(|e| fail(&e))?;
    writer.finish().map_err(|e| fail(&e))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_pngs_are_written() {
        assert_eq!(png_file("a.PNG"), Ok(Output::File("a.PNG".into())));
        assert_eq!(png_file("-"), Ok(Output::Stdout));
        for wrong in ["a.jpg", "png", "", "a.png.txt"] {
            assert!(png_file(wrong).unwrap_err().contains(".png"), "{wrong}");
        }
    }

    #[test]
    fn times_are_finite() {
        assert_eq!(seconds("1.5"), Ok(Span::from_nanos(1_500_000_000)));
        assert_eq!(seconds("-2"), Ok(Span::from_nanos(-2_000_000_000)));
        for wrong in ["nan", "inf", "1e300", "", "soon"] {
            assert!(seconds(wrong).unwrap_err().contains("number of seconds"), "{wrong}");
        }
    }
}
