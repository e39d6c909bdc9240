//! Simulated tracks: true motions, points on the walls of a box, noise; and the error after alignment.

#![allow(dead_code, reason = "each test takes what it needs")]
#![allow(clippy::unwrap_used, reason = "in a test, what is missing fails it")]

use std::collections::HashMap;

use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector2, Vector3};
use vergence_geom::{Camera, Distortion, Lens, Rigid};
use vergence_inertial::model::{ImuModel, Triad};
use vergence_inertial::motion::{Earth, Motion};
use vergence_slam::{Estimate, Odometry, Sighting, State};
use vergence_time::{Span, Timestamp};

/// What is missing is said; where it is required, it fails.
pub fn skip(what: &str) {
    let required = std::env::var("VERGENCE_REQUIRE").is_ok_and(|list| list.split(',').any(|w| w == "data"));
    assert!(!required, "required: {what}");
    println!("skipped: {what}");
}

/// A folder of recordings.
pub fn recording(name: &str) -> Option<std::path::PathBuf> {
    let folder = std::path::PathBuf::from(std::env::var_os("VERGENCE_DATA")?).join("slam").join(name);
    folder.is_dir().then_some(folder)
}

/// EuRoC's two cameras.
pub fn euroc() -> Vec<Camera> {
    let radtan =
        |radial: [f64; 2], tangential| Distortion::Radtan { radial: [radial[0], radial[1], 0.0], tangential };
    let pose = |rows: [f64; 9], t: [f64; 3]| {
        let rotation = nalgebra::Rotation3::from_matrix(&Matrix3::from_row_slice(&rows));
        Rigid::from_parts(Vector3::from(t).into(), UnitQuaternion::from_rotation_matrix(&rotation))
    };
    vec![
        Camera {
            lens: Lens::new(
                [458.654, 457.296],
                [367.215, 248.375],
                radtan([-0.28340811, 0.07395907], [0.00019359, 1.76187114e-05]),
            )
            .unwrap(),
            size_px: [752, 480],
            body_from_camera: pose(
                [
                    0.0148655429818,
                    -0.999880929698,
                    0.00414029679422,
                    0.999557249008,
                    0.0149672133247,
                    0.025715529948,
                    -0.0257744366974,
                    0.00375618835797,
                    0.999660727178,
                ],
                [-0.0216401454975, -0.064676986768, 0.00981073058949],
            ),
        },
        Camera {
            lens: Lens::new(
                [457.587, 456.134],
                [379.999, 255.238],
                radtan([-0.28368365, 0.07451284], [-0.00010473, -3.55590700e-05]),
            )
            .unwrap(),
            size_px: [752, 480],
            body_from_camera: pose(
                [
                    0.0125552670891,
                    -0.999755099723,
                    0.0182237714554,
                    0.999598781151,
                    0.0130119051815,
                    0.0251588363115,
                    -0.0253898008918,
                    0.0179005838253,
                    0.999517347078,
                ],
                [-0.0198435579556, 0.0453689425024, 0.00786212447038],
            ),
        },
    ]
}

/// EuRoC's unit at 200 Hz.
pub fn euroc_imu(seed: u64) -> ImuModel {
    let mut model = ImuModel::perfect(200.0);
    model.gyr = Triad {
        noise_density: 1.6968e-4,
        bias_walk: 1.9393e-5,
        bias: Vector3::new(-0.002, 0.021, 0.077),
        ..Triad::PERFECT
    };
    model.acc = Triad {
        noise_density: 2e-3,
        bias_walk: 3e-3,
        bias: Vector3::new(-0.02, 0.12, 0.06),
        ..Triad::PERFECT
    };
    model.mag = None;
    model.seed = seed;
    model
}

/// SplitMix64, for the tests' own noise.
pub struct Noise(pub u64);

impl Noise {
    pub fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn normal(&mut self) -> f64 {
        let r = (-2.0 * self.uniform().max(1e-300).ln()).sqrt();
        r * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// Points on the walls of a box that encloses the motion.
pub fn box_room(low: Vector3<f64>, high: Vector3<f64>, count: usize, seed: u64) -> Vec<Vector3<f64>> {
    let mut dice = Noise(seed);
    (0..count)
        .map(|_| {
            let mut p = Vector3::from_fn(|i, _| low[i] + (high[i] - low[i]) * dice.uniform());
            let wall = (dice.uniform() * 6.0) as usize;
            p[wall / 2] = if wall.is_multiple_of(2) { low[wall / 2] } else { high[wall / 2] };
            p
        })
        .collect()
}

/// Follows points as a tracker does: keeps those that it sees, takes new ones where there is room.
pub struct Tracks {
    pub points: Vec<Vector3<f64>>,
    pub cameras: Vec<Camera>,
    pub most: usize,
    pub noise_px: f64,
    pub dice: Noise,
    pub depth: bool,
    pub blind: std::ops::Range<usize>,
    pub dropped: std::ops::Range<usize>,
    /// Added to every time that is told.
    pub epoch_ns: i64,
    tracks: HashMap<usize, u64>,
    next: u64,
}

impl Tracks {
    pub fn new(
        points: Vec<Vector3<f64>>,
        cameras: Vec<Camera>,
        most: usize,
        noise_px: f64,
        seed: u64,
    ) -> Self {
        Self {
            points,
            cameras,
            most,
            noise_px,
            dice: Noise(seed),
            depth: false,
            blind: 0..0,
            dropped: 0..0,
            epoch_ns: 0,
            tracks: HashMap::new(),
            next: 0,
        }
    }

    pub fn see(&mut self, world_from_body: &Rigid) -> Vec<Sighting> {
        let mut visible: Vec<Vec<(u8, Vector2<f64>, f64)>> = vec![Vec::new(); self.points.len()];
        for (index, camera) in self.cameras.iter().enumerate() {
            let camera_from_world = (world_from_body * camera.body_from_camera).inverse();
            for (point, list) in self.points.iter().zip(&mut visible) {
                let inside = (camera_from_world * Point3::from(*point)).coords;
                if inside.z < 0.1 {
                    continue;
                }
                let Some(pixel) = camera.lens.project(&inside) else { continue };
                let size = Vector2::new(f64::from(camera.size_px[0]), f64::from(camera.size_px[1]));
                if pixel.x > 3.0 && pixel.y > 3.0 && pixel.x < size.x - 3.0 && pixel.y < size.y - 3.0 {
                    list.push((index as u8, pixel, inside.z));
                }
            }
        }
        self.tracks.retain(|point, _| visible[*point].iter().any(|v| v.0 == 0));
        let start = (self.dice.uniform() * self.points.len() as f64) as usize;
        for k in 0..self.points.len() {
            let point = (start + k) % self.points.len();
            if self.tracks.len() >= self.most {
                break;
            }
            if visible[point].iter().any(|v| v.0 == 0) && !self.tracks.contains_key(&point) {
                self.tracks.insert(point, self.next);
                self.next += 1;
            }
        }
        let mut seen: Vec<(u64, usize)> = self.tracks.iter().map(|(p, t)| (*t, *p)).collect();
        seen.sort_unstable();
        let mut out = Vec::new();
        for (track, point) in seen {
            for (camera, pixel, depth) in &visible[point] {
                let noisy = pixel + Vector2::new(self.dice.normal(), self.dice.normal()) * self.noise_px;
                let lens = &self.cameras[usize::from(*camera)].lens;
                if let Some(mut sighting) = Sighting::new(track, *camera, &noisy, lens) {
                    if self.depth {
                        sighting.depth_m = Some(depth * (1.0 + 0.002 * depth * self.dice.normal()));
                    }
                    out.push(sighting);
                }
            }
        }
        out
    }
}

/// Poses of a TUM file.
pub fn tum(path: &std::path::Path) -> Vec<(Timestamp, Rigid)> {
    let text = std::fs::read_to_string(path).unwrap();
    text.lines()
        .filter(|l| !l.starts_with('#') && !l.trim().is_empty())
        .map(|line| {
            let mut words = line.split_whitespace();
            let (secs, frac) = words.next().unwrap().split_once('.').unwrap();
            let nanos: i64 = format!("{frac:0<9}")[..9].parse().unwrap();
            let v: Vec<f64> = words.map(|w| w.parse().unwrap()).collect();
            let q = nalgebra::Quaternion::new(v[6], v[3], v[4], v[5]);
            let pose =
                Rigid::from_parts(Vector3::new(v[0], v[1], v[2]).into(), UnitQuaternion::from_quaternion(q));
            (Timestamp::from_nanos(secs.parse::<i64>().unwrap() * 1_000_000_000 + nanos), pose)
        })
        .collect()
}

/// CPU time of this thread.
pub fn cpu_ms() -> f64 {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    t.tv_sec as f64 * 1e3 + t.tv_nsec as f64 * 1e-6
}

#[derive(Default)]
pub struct Run {
    pub estimates: Vec<Estimate>,
    pub truth: Vec<Rigid>,
    pub frame_ms: Vec<f64>,
}

/// Runs odometry along a motion (z up).
pub fn run(
    odometry: &mut Odometry,
    motion: &dyn Motion,
    imu: &ImuModel,
    tracks: &mut Tracks,
    from: Timestamp,
    seconds: f64,
    rate_hz: f64,
) -> Run {
    let earth = Earth { gravity_m_s2: Vector3::new(0.0, 0.0, -9.80665), field_ut: Vector3::zeros() };
    let mut out = Run { estimates: Vec::new(), truth: Vec::new(), frame_ms: Vec::new() };
    let epoch = Span::from_nanos(tracks.epoch_ns);
    let mut next = imu.index_at(from).saturating_sub(4);
    for k in 0..(seconds * rate_hz) as i64 {
        let time = from.saturating_add(Span::from_nanos((k as f64 * 1e9 / rate_hz) as i64));
        while imu.time(next) < time.saturating_add(Span::from_millis(6)) {
            if let Some(sample) = imu.read(next, motion, &earth) {
                odometry.imu(sample.captured.saturating_add(epoch), &sample.value);
            }
            next += 1;
        }
        let pose = motion.at(time).world_from_body;
        if tracks.dropped.contains(&(k as usize)) {
            continue;
        }
        let mut seen = tracks.see(&pose);
        if tracks.blind.contains(&(k as usize)) {
            seen.clear();
        }
        let start = cpu_ms();
        out.estimates.push(odometry.frame(time.saturating_add(epoch), &seen));
        out.frame_ms.push(cpu_ms() - start);
        out.truth.push(pose);
    }
    out
}

impl Run {
    /// Errors of the positions after alignment (Umeyama without scale), m.
    pub fn errors_m(&self) -> Vec<f64> {
        let n = self.truth.len() as f64;
        let a: Vec<Vector3<f64>> =
            self.estimates.iter().map(|e| e.world_from_body.translation.vector).collect();
        let b: Vec<Vector3<f64>> = self.truth.iter().map(|t| t.translation.vector).collect();
        let (ma, mb) = (a.iter().sum::<Vector3<f64>>() / n, b.iter().sum::<Vector3<f64>>() / n);
        let cross: Matrix3<f64> = a.iter().zip(&b).map(|(a, b)| (b - mb) * (a - ma).transpose()).sum();
        let svd = cross.svd(true, true);
        let (u, vt) = (svd.u.unwrap(), svd.v_t.unwrap());
        let sign = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * vt).determinant().signum()));
        let r = u * sign * vt;
        a.iter().zip(&b).map(|(a, b)| (r * (a - ma) - (b - mb)).norm()).collect()
    }

    /// Root mean square of these, m.
    pub fn ate_m(&self) -> f64 {
        let errors = self.errors_m();
        (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt()
    }

    pub fn print(&self, name: &str) {
        let last = self.estimates.last().unwrap();
        let keyframes = self.estimates.iter().filter(|e| e.keyframe).count();
        let tracked = self.estimates.iter().position(|e| e.state == State::Tracked);
        println!(
            "{name}: ATE {:.4} m, {:.2} ms/frame, sigma {:.4} m, {keyframes} keyframes, tracked from frame {tracked:?}",
            self.ate_m(),
            self.mean_ms(),
            last.position_sigma_m
        );
    }

    pub fn mean_ms(&self) -> f64 {
        self.frame_ms.iter().sum::<f64>() / self.frame_ms.len() as f64
    }
}
