//! `vergence sim camera`: what a rig of cameras and an inertial unit records along a trajectory through a scene.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;

use indicatif::{ProgressBar, ProgressStyle};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use serde_json::json;
use vergence_geom::{Rigid, interpolate};
use vergence_gpu::{Device, DeviceDesc, Instance, InstanceDesc};
use vergence_inertial::model::{ImuModel, Triad};
use vergence_inertial::motion::{Earth, Motion};
use vergence_inertial::spline::SplineMotion;
use vergence_inertial::{Dice, Recording};
use vergence_render::{Offscreen, Quality, Renderer, Target};
use vergence_scene::{Needs, Scene};
use vergence_sense::Imu;
use vergence_sim::camera::{Film, Optics};
use vergence_slam::Inertial;
use vergence_slam::dataset::{Rig, Writer, rig};
use vergence_slam::trajectory::Trajectory;
use vergence_time::{Span, Timestamp};

use crate::devices::interrupted;
use crate::failure::Failure;
use crate::{framing, loading};

/// Records a flight through a scene: pictures behind the rig's lenses, inertial readings, and the truth, as a EuRoC (ASL) folder
///
/// Poses are those of the inertial unit, in a world with z up (TUM format). With synthetic readings, the truth is a smooth curve through the
/// poses, and rates and accelerations are its exact derivatives; with real ones, poses are taken as they are.
#[derive(clap::Args)]
pub struct Args {
    /// A .glb, .gltf, .obj, .ply or scene .toml
    scene: PathBuf,
    /// Where the rig is over time, TUM format
    #[arg(long, value_name = "T.tum")]
    trajectory: PathBuf,
    /// A EuRoC (ASL) folder whose cam*/sensor.yaml and imu0/sensor.yaml are taken
    #[arg(long, value_name = "FOLDER")]
    rig: PathBuf,
    /// `synth`, with the noise that the rig's imu0 says; `real:FILE`: the readings of a EuRoC table at the trajectory's times
    #[arg(long, default_value = "synth", value_parser = readings)]
    imu: Readings,
    /// The folder to be written; must not exist
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Frames per second
    #[arg(long, default_value_t = 20.0, value_parser = within::<1, 1000>)]
    rate: f64,
    /// Synthetic readings per second
    #[arg(long, default_value_t = 200.0, value_parser = within::<10, 10000>)]
    imu_rate: f64,
    /// Seconds of the trajectory that are left out at its start
    #[arg(long, default_value_t = 0.0, value_parser = within::<0, 100000>)]
    from: f64,
    /// Seconds that are recorded at most
    #[arg(long, value_parser = within::<0, 100000>)]
    length: Option<f64>,
    /// Knots of the smooth curve are this far apart, ms
    #[arg(long, default_value_t = 50.0, value_parser = within::<5, 1000>)]
    knot: f64,
    /// Where in the scene the middle of the trajectory is, metres; default: the middle of the scene
    #[arg(long, value_name = "X,Y,Z", value_parser = framing::point, allow_hyphen_values = true)]
    at: Option<Point3<f64>>,
    /// Turns the trajectory about the vertical, degrees
    #[arg(long, default_value_t = 0.0, value_parser = within::<-360, 360>, allow_hyphen_values = true)]
    turn: f64,
    /// For how long light is collected around each frame's time, ms; 0: an instant
    #[arg(long, default_value_t = 0.0, value_parser = within::<0, 100>)]
    exposure: f64,
    /// Instants in an exposure
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(2..=64))]
    instants: u32,
    /// Factor on the light
    #[arg(long, default_value_t = Film::default().gain)]
    gain: f64,
    /// Standard deviation of each pixel's noise, grey levels
    #[arg(long, default_value_t = Film::default().noise)]
    noise: f64,
    /// Chooses all noise
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Pixels that are drawn for one of the camera's, along each side
    #[arg(long, default_value_t = 2.0, value_parser = within::<1, 4>)]
    oversampling: f64,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

/// Where readings come from.
#[derive(Clone, Debug)]
enum Readings {
    Synthetic,
    Real(PathBuf),
}

fn readings(text: &str) -> Result<Readings, String> {
    match text.strip_prefix("real:") {
        Some(path) if !path.is_empty() => Ok(Readings::Real(path.into())),
        None if text == "synth" => Ok(Readings::Synthetic),
        _ => Err(format!("expected synth or real:FILE, found {text:?}")),
    }
}

/// Parses a number from `LOW` to `HIGH`.
fn within<const LOW: i32, const HIGH: i32>(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|x| (f64::from(LOW)..=f64::from(HIGH)).contains(x));
    number.ok_or_else(|| format!("expected {LOW} to {HIGH}, found {text:?}"))
}

/// The rig's way: smooth, or as recorded. Times are since `base`.
enum Way {
    Smooth(SplineMotion),
    Recorded(Vec<(Timestamp, Rigid)>),
}

impl Way {
    fn span(&self) -> (Timestamp, Timestamp) {
        match self {
            Self::Smooth(spline) => (spline.start(), spline.end()),
            Self::Recorded(poses) => (poses[0].0, poses[poses.len() - 1].0),
        }
    }

    fn at(&self, time: Timestamp) -> Rigid {
        match self {
            Self::Smooth(spline) => spline.at(time).world_from_body,
            Self::Recorded(poses) => {
                let after = poses.partition_point(|pose| pose.0 < time).clamp(1, poses.len() - 1);
                let (a, b) = (&poses[after - 1], &poses[after]);
                let nanos = |from: Timestamp, to: Timestamp| (to.as_nanos() - from.as_nanos()) as f64;
                interpolate(&a.1, &b.1, (nanos(a.0, time) / nanos(a.0, b.0)).clamp(0.0, 1.0))
            }
        }
    }
}

const SECOND: f64 = 1e9;

fn later(time: Timestamp, seconds: f64) -> Timestamp {
    Timestamp::from_nanos(time.as_nanos() + (seconds * SECOND).round() as i64)
}

impl Args {
    /// Draws, reads, writes.
    pub fn run(self) -> Result<(), Failure> {
        let film = Film { gain: self.gain, noise: self.noise, seed: self.seed };
        let film = film.checked().map_err(|error| Failure::call(&error))?;
        if self.output.exists() {
            return Err(Failure::Call(format!(
                "{}: expected a folder that does not exist yet",
                self.output.display()
            )));
        }
        let Rig { cameras, inertial } = rig(&self.rig).map_err(|error| Failure::work(&error))?;
        let (unit, _) = inertial.unwrap_or((Inertial::EUROC, self.imu_rate));
        let recorded = Trajectory::read(&self.trajectory).map_err(|error| Failure::work(&error))?;
        let base = recorded.poses[0].0;
        let way = self.way(&recorded, base)?;
        let mut frames = self.frames(&way)?;
        let optics = cameras.iter().map(|camera| Optics::new(camera, self.oversampling));
        let optics: Vec<Optics> = optics.collect::<Result<_, _>>().map_err(|error| Failure::work(&error))?;
        let scene = Arc::new(loading::scene(&self.scene)?);
        let scene_from_world = self.placed(&scene, &recorded);
        let readings_hz = match &self.imu {
            Readings::Synthetic => self.imu_rate,
            Readings::Real(_) => inertial.map_or(self.imu_rate, |(_, rate_hz)| rate_hz),
        };
        let absolute = |time: Timestamp| Timestamp::from_nanos(base.as_nanos() + time.as_nanos());
        let imu = self.readings(&way, &unit, &frames, base)?;
        let written = Rig { cameras: cameras.clone(), inertial: Some((unit, readings_hz)) };
        let failed = |error: vergence_slam::Error| Failure::work(&error);
        let mut folder = Writer::create(&self.output, &written, self.rate).map_err(failed)?;

        let bar = ProgressBar::new(frames.len() as u64);
        if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos}/{len} frames, {eta}") {
            bar.set_style(style);
        }
        let start = Instant::now();
        let mut drawers =
            optics.iter().map(|optics| Drawer::new(&scene, optics)).collect::<Result<Vec<_>, _>>()?;
        let exposure: Vec<f64> = if self.exposure > 0.0 {
            let share = |k: u32| f64::from(k) / f64::from(self.instants - 1) - 0.5;
            (0..self.instants).map(|k| share(k) * self.exposure * 1e-3).collect()
        } else {
            vec![0.0]
        };
        let (stop, mut drawn) = (interrupted()?, 0);
        for (n, &time) in frames.iter().enumerate().take_while(|_| !stop.load(Ordering::Relaxed)) {
            for (camera, (optics, drawer)) in optics.iter().zip(&mut drawers).enumerate() {
                let mut shot = optics.shot();
                for offset in &exposure {
                    let body = scene_from_world * way.at(later(time, *offset));
                    for (k, view) in optics.views(&body).enumerate() {
                        drawer.draw(&view, |pixels| optics.expose(k, pixels, &mut shot))?;
                    }
                }
                let pixels = film.develop(&shot, camera as u64, n as u64);
                folder.picture(camera, absolute(time), &pixels).map_err(failed)?;
            }
            drawn = n + 1;
            bar.inc(1);
        }
        bar.finish_and_clear();
        if drawn < frames.len() {
            eprintln!("vergence: ended after {drawn} of {} frames, as asked", frames.len());
            frames.truncate(drawn);
        }
        let truth = Trajectory { poses: frames.iter().map(|t| (absolute(*t), way.at(*t))).collect() };
        folder.finish(&imu, &truth).map_err(failed)?;
        let (seconds, metres) = (start.elapsed().as_secs_f64(), truth.length_m());
        let per_frame = seconds * 1e3 / frames.len().max(1) as f64;
        if self.json {
            println!(
                "{}",
                json!({
                    "frames": frames.len(),
                    "cameras": cameras.len(),
                    "readings": imu.len(),
                    "length_m": metres,
                    "views": optics.iter().map(|o| o.views(&Rigid::identity()).count()).collect::<Vec<_>>(),
                    "drawn_px": optics.iter().map(Optics::size_px).collect::<Vec<_>>(),
                    "wall_ms_per_frame": per_frame,
                })
            );
        } else {
            println!(
                "{}: {} frames of {} cameras, {} readings, {metres:.1} m; {per_frame:.0} ms a frame",
                self.output.display(),
                frames.len(),
                cameras.len(),
                imu.len(),
            );
        }
        Ok(())
    }

    fn way(&self, recorded: &Trajectory, base: Timestamp) -> Result<Way, Failure> {
        let since = |at: &Timestamp| Timestamp::from_nanos(at.as_nanos() - base.as_nanos());
        let poses: Vec<_> = recorded.poses.iter().map(|(at, pose)| (since(at), *pose)).collect();
        let short = || Failure::Work(format!("{}: expected four poses or more", self.trajectory.display()));
        match self.imu {
            Readings::Real(_) if poses.len() < 4 => Err(short()),
            Readings::Real(_) => Ok(Way::Recorded(poses)),
            Readings::Synthetic => {
                let knot = Span::from_nanos((self.knot * 1e6) as i64);
                SplineMotion::new(&poses, knot).map(Way::Smooth).ok_or_else(short)
            }
        }
    }

    /// When pictures are taken, since the trajectory's beginning.
    fn frames(&self, way: &Way) -> Result<Vec<Timestamp>, Failure> {
        let (start, end) = way.span();
        let last = end.as_nanos() as f64 / SECOND;
        let from = self.from.max(start.as_nanos() as f64 / SECOND);
        let until = self.length.map_or(last, |length| last.min(from + length));
        let count = ((until - from) * self.rate + 1e-6).floor();
        if count < 1.0 {
            return Err(Failure::Call(format!(
                "--from, --length: expected a part of the trajectory's {last:.3} s, found {from} to {until} s"
            )));
        }
        let first = Timestamp::from_nanos((from * SECOND).round() as i64);
        Ok((0..=count as u64).map(|k| later(first, k as f64 / self.rate)).filter(|t| *t <= end).collect())
    }

    /// Takes the trajectory's world (z up) to the scene's (y up).
    fn placed(&self, scene: &Scene, recorded: &Trajectory) -> Rigid {
        let upright = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), self.turn.to_radians());
        let rotation = turn * upright;
        let places = || recorded.poses.iter().map(|pose| pose.1.translation.vector);
        let low = places().fold(Vector3::repeat(f64::INFINITY), |a, b| a.inf(&b));
        let high = places().fold(Vector3::repeat(f64::NEG_INFINITY), |a, b| a.sup(&b));
        let middle = self.at.unwrap_or_else(|| scene.bounds().centre()).coords;
        Rigid::from_parts((middle - rotation * ((low + high) * 0.5)).into(), rotation)
    }

    /// Readings from a little before the first frame to a little after the last one.
    fn readings(
        &self,
        way: &Way,
        unit: &Inertial,
        frames: &[Timestamp],
        base: Timestamp,
    ) -> Result<Vec<(Timestamp, Imu)>, Failure> {
        const AROUND_S: f64 = 0.1;
        let (first, last) = (frames[0], frames[frames.len() - 1]);
        let (from, to) = (later(first, -AROUND_S), later(last, AROUND_S));
        let absolute = |time: Timestamp| Timestamp::from_nanos(base.as_nanos() + time.as_nanos());
        let spline = match (way, &self.imu) {
            (Way::Smooth(spline), _) => spline,
            (Way::Recorded(_), Readings::Synthetic) => return Ok(Vec::new()),
            (Way::Recorded(_), Readings::Real(path)) => return real(path, absolute(from), absolute(to)),
        };
        let dice = |stream| Dice::new(self.seed, stream);
        let bias = |stream, size: f64| Vector3::from_fn(|k, _| size * dice(stream).normal(k as u64));
        let model = ImuModel {
            gyr: Triad {
                noise_density: unit.noise.gyr_rad_s_rthz,
                bias_walk: unit.gyr_walk,
                bias: bias(100, 0.02),
                ..Triad::PERFECT
            },
            acc: Triad {
                noise_density: unit.noise.acc_m_s2_rthz,
                bias_walk: unit.acc_walk,
                bias: bias(101, 0.05),
                ..Triad::PERFECT
            },
            mag: None,
            seed: self.seed,
            ..ImuModel::perfect(self.imu_rate)
        };
        let earth = Earth { gravity_m_s2: Vector3::new(0.0, 0.0, -9.80665), ..Earth::MID_LATITUDE };
        // Before its start and after its end the curve rests, which the rig does not.
        let (start, end) = way.span();
        let indices = model.index_at(from.max(start))..model.index_at(to.min(end));
        let read = indices.filter_map(|index| model.read(index, spline, &earth));
        Ok(read.map(|sample| (absolute(sample.captured), sample.value)).collect())
    }
}

/// The readings of a table in a span.
fn real(path: &Path, from: Timestamp, to: Timestamp) -> Result<Vec<(Timestamp, Imu)>, Failure> {
    let mut samples = Recording::read(path).map_err(|error| Failure::work(&error))?.samples;
    samples.retain(|(at, _)| (from..=to).contains(at));
    if samples.len() < 2 {
        return Err(Failure::Work(format!(
            "{}: expected readings at the frames' times, found none",
            path.display()
        )));
    }
    Ok(samples)
}

/// Draws single views of one size.
struct Drawer {
    renderer: Renderer,
    offscreen: Offscreen,
}

impl Drawer {
    fn new(scene: &Arc<Scene>, optics: &Optics) -> Result<Self, Failure> {
        let desc = InstanceDesc { app_name: "vergence", validation: false, surface: None };
        let instance = Instance::new(&desc, None).map_err(|error| Failure::work(&error))?;
        let device =
            Device::new(&instance, &DeviceDesc::default(), None).map_err(|error| Failure::gpu(&error))?;
        let quality =
            Quality { msaa: 1, near_m: 0.02, cull_margin_m: 0.0, cull_margin_rad: 0.0, ..Quality::default() };
        quality.check(device.limits()).map_err(|error| Failure::call(&error))?;
        let [width, height] = optics.size_px();
        let most = device.limits().max_image_size;
        if width.max(height) > most {
            return Err(Failure::Call(format!(
                "--oversampling: expected pictures of at most {most}x{most}, found {width}x{height}"
            )));
        }
        let target = Target::new((width, height), 1);
        let needs = Needs::of(scene, quality.normal_maps);
        let renderer = Renderer::new(&device, scene, &needs, &quality, &target, 1);
        Ok(Self {
            renderer: renderer.map_err(|error| Failure::work(&error))?,
            offscreen: Offscreen::new(&device, &target, false).map_err(|error| Failure::work(&error))?,
        })
    }

    fn draw(&mut self, view: &vergence_geom::View, look: impl FnOnce(&[u8])) -> Result<(), Failure> {
        let views = [*view];
        let drawn = || {
            self.renderer.begin(0, Span::ZERO, &views, &self.offscreen.attachments())?;
            self.renderer.latch(0, &views)?;
            self.renderer.submit(0)?;
            self.offscreen.read(look)
        };
        drawn().map_err(|error: vergence_render::Error| Failure::work(&error))
    }
}
