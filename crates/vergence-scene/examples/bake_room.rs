//! Computes the soft light in the sample room, and paints what it falls on:
//! `cargo run --release -p vergence-scene --example bake_room -- crates/vergence-scene/samples`
//!
//! Each flat surface of `room.toml` that is listed in [`SURFACES`] gets a picture: its paint (made here) times the
//! light that arrives there from the window, the lamps and, once reflected, from everything else. Rays are traced
//! with the library's own picker. The pictures that exist need not be right: only shapes and colours are read.

use std::path::{Path, PathBuf};

use image::{Rgb, RgbImage};
use nalgebra::{Point3, UnitVector3, Vector3};
use vergence_geom::{Affine, Ray};
use vergence_scene::model::{Scene, Shading, WorldTransforms};
use vergence_scene::pick::Picker;
use vergence_scene::{Limits, load};

type Color = Vector3<f64>;

/// Name, metres across and down, pixels per metre of the picture, light samples per metre, paint.
type Surface = (&'static str, f64, f64, f64, f64, fn(f64, f64) -> Color);

const SURFACES: &[Surface] = &[
    ("floor", 5.0, 5.0, 256.0, 30.0, planks),
    ("rug", 2.2, 1.6, 400.0, 44.0, rug),
    ("ceiling", 5.0, 5.0, 60.0, 14.0, ceiling),
    ("wall_back", 5.0, 2.7, 160.0, 32.0, teal),
    ("wall_front", 5.0, 2.7, 60.0, 14.0, plaster),
    ("wall_left", 5.0, 2.7, 120.0, 28.0, plaster),
    ("wall_right", 5.0, 2.7, 120.0, 26.0, plaster),
    ("table_top", 1.4, 0.7, 1200.0, 140.0, table),
    ("board", 0.95, 0.9, 300.0, 40.0, paper),
];

/// Radiance of the window.
const SKY: [f64; 3] = [5.2, 5.7, 6.0];
/// Window: middle, half sizes along y and z.
const WINDOW: ([f64; 3], f64, f64) = ([-2.485, 1.55, -1.5], 0.75, 0.85);
/// Middle, radius, and intensity per steradian of the lamp and of a soft fill from above.
const LAMPS: [([f64; 3], f64, [f64; 3]); 2] =
    [([2.05, 1.56, -2.6], 0.1, [1.7, 1.22, 0.72]), ([0.4, 2.55, 0.6], 0.3, [2.2, 2.1, 2.0])];
/// Rays for each light and for what is reflected.
const WINDOW_RAYS: usize = 36;
const LAMP_RAYS: usize = 6;
const BOUNCE_RAYS: usize = 64;
/// Irradiance of one bounce, at most.
const BRIGHTEST_BOUNCE: f64 = 3.0;
/// Light that has been reflected more than once, everywhere alike.
const REST: f64 = 0.6;

/// A deterministic stream of numbers, 0…1.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        let x = self.0 ^ (self.0 >> 29);
        (x.wrapping_mul(0xBF58476D1CE4E5B9) >> 11) as f64 / (1u64 << 53) as f64
    }
}

struct World {
    scene: Scene,
    world: WorldTransforms,
    picker: Picker,
}

/// A smooth random field, 0…1, with detail down to `1 / 2^octaves` of a unit.
fn noise(x: f64, y: f64, octaves: u32) -> f64 {
    let hash = |i: i64, j: i64| {
        let mut h = (i.wrapping_mul(374761393) ^ j.wrapping_mul(668265263)) as u64;
        h = (h ^ (h >> 13)).wrapping_mul(1274126177);
        ((h ^ (h >> 16)) & 0xFFFF) as f64 / 65535.0
    };
    let (mut sum, mut weight, mut scale) = (0.0, 0.0, 1.0);
    for octave in 0..octaves {
        let (u, v) = (x * scale + 17.0 * f64::from(octave), y * scale);
        let (i, j) = (u.floor(), v.floor());
        let (s, t) = (u - i, v - j);
        let (s, t) = (s * s * (3.0 - 2.0 * s), t * t * (3.0 - 2.0 * t));
        let (i, j) = (i as i64, j as i64);
        let a = hash(i, j) * (1.0 - s) + hash(i + 1, j) * s;
        let b = hash(i, j + 1) * (1.0 - s) + hash(i + 1, j + 1) * s;
        sum += (a * (1.0 - t) + b * t) / scale;
        weight += 1.0 / scale;
        scale *= 2.0;
    }
    sum / weight
}

fn srgb(hex: u32) -> Color {
    Color::new(f64::from(hex >> 16), f64::from(hex >> 8 & 255), f64::from(hex & 255))
        .map(|v| (v / 255.0).powf(2.2))
}

fn mix(a: Color, b: Color, t: f64) -> Color {
    a * (1.0 - t) + b * t
}

fn wood(along: f64, across: f64, seed: f64) -> Color {
    let warp = noise(along * 1.5 + seed, across * 6.0 + seed, 3);
    let rings = (across * 90.0 + 14.0 * warp + seed * 7.0).sin() * 0.5 + 0.5;
    let fibre = noise(along * 12.0 + seed * 3.0, across * 420.0, 3);
    let t = 0.45 * rings.powf(1.5) + 0.55 * fibre;
    mix(srgb(0xb98a58), srgb(0x946539), t)
}

fn planks(x: f64, y: f64) -> Color {
    let row = (x / 0.14).floor();
    let shift = (row * 0.618).fract() * 1.7;
    let plank = ((y + shift) / 1.7).floor();
    let id = (row * 12.9898 + plank * 78.233).sin().abs() * 43.7;
    let (u, v) = (x / 0.14 - row, (y + shift) / 1.7 - plank);
    let gap = if !(0.012..=0.988).contains(&u) || !(0.0012..=0.9988).contains(&v) { 0.35 } else { 1.0 };
    let tone = 0.82 + 0.3 * id.fract();
    wood(y, x, id) * (tone * gap * 0.85)
}

fn table(x: f64, y: f64) -> Color {
    let board = (y / 0.1167).floor();
    let edge = (y / 0.1167 - board - 0.5).abs();
    let tone = 0.92 + 0.16 * ((board * 3.7).sin() * 0.5 + 0.5);
    let seam = if edge > 0.494 { 0.72 } else { 1.0 };
    mix(wood(x * 0.8, y, board * 2.3 + 0.7), srgb(0xd0a26a), 0.35) * (tone * seam)
}

fn plaster(x: f64, y: f64) -> Color {
    srgb(0xe6dccb) * (0.97 + 0.06 * noise(x * 30.0, y * 30.0, 4))
}

fn teal(x: f64, y: f64) -> Color {
    srgb(0x5d8583) * (0.95 + 0.1 * noise(x * 26.0, y * 26.0, 4))
}

fn ceiling(_: f64, _: f64) -> Color {
    srgb(0xf0ece4)
}

fn paper(x: f64, y: f64) -> Color {
    srgb(0xf3efe4) * (0.98 + 0.04 * noise(x * 200.0, y * 200.0, 3))
}

fn rug(x: f64, y: f64) -> Color {
    let (u, v) = (x / 2.2 * 2.0 - 1.0, y / 1.6 * 2.0 - 1.0);
    let border = (1.1 * (1.0 - u.abs())).min(0.8 * (1.0 - v.abs()));
    let weave = 0.86 + 0.28 * noise(x * 260.0, y * 90.0, 2);
    let diamond = ((x * 4.5).fract() - 0.5).abs() + ((y * 4.5).fract() - 0.5).abs();
    let color = if border < 0.035 {
        srgb(0xe4d3b0)
    } else if border < 0.075 {
        srgb(0x2d3f4f)
    } else if border < 0.1 {
        srgb(0xd9a441)
    } else if diamond < 0.16 {
        srgb(0xe4d3b0)
    } else if (0.3..0.36).contains(&diamond) {
        srgb(0xd9a441)
    } else {
        srgb(0x9c3b28)
    };
    color * weave
}

fn main() {
    let folder =
        PathBuf::from(std::env::args().nth(1).unwrap_or_else(|| "crates/vergence-scene/samples".into()));
    let room = folder.join("room");
    // Pictures that are not there yet would be errors.
    for name in SURFACES.iter().map(|surface| surface.0).chain(["sky"]) {
        let path = room.join(format!("{name}.jpg"));
        if !path.exists() {
            save(&RgbImage::new(8, 8), &path);
        }
    }
    save(&sky(), &room.join("sky.jpg"));
    let scene = load(&folder.join("room.toml"), &Limits::default()).unwrap_or_else(|error| panic!("{error}"));
    let world = WorldTransforms::at_rest(&scene);
    let picker = Picker::new(&scene);
    let world = World { scene, world, picker };
    for surface in SURFACES {
        let start = std::time::Instant::now();
        let picture = world.bake(surface);
        save(&picture, &room.join(format!("{}.jpg", surface.0)));
        println!("{}: {} x {}, {:.1?}", surface.0, picture.width(), picture.height(), start.elapsed());
    }
}

fn save(picture: &RgbImage, path: &Path) {
    let mut bytes = Vec::new();
    let encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 88);
    picture.write_with_encoder(encoder).unwrap_or_else(|error| panic!("{error}"));
    std::fs::write(path, bytes).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
}

/// What is seen through the window: a bright sky over hills.
fn sky() -> RgbImage {
    RgbImage::from_fn(425, 375, |x, y| {
        let (u, v) = (f64::from(x) / 425.0, f64::from(y) / 375.0);
        let hill = 0.72 + 0.05 * (u * 5.0).sin() + 0.03 * noise(u * 6.0, 0.0, 4);
        let far = 0.66 + 0.07 * (u * 3.0 + 2.0).sin() + 0.02 * noise(u * 9.0, 5.0, 4);
        let cloud = ((noise(u * 3.0, v * 7.0, 5) - 0.45) * 3.0).clamp(0.0, 1.0);
        let color = if v > hill {
            mix(srgb(0x9db37a), srgb(0x7d9a5e), noise(u * 40.0, v * 40.0, 3))
        } else if v > far {
            srgb(0xb4c9bd)
        } else {
            mix(mix(srgb(0xa9cdf0), srgb(0xeaf4fb), v / far), srgb(0xffffff), 0.8 * cloud)
        };
        pixel(color)
    })
}

fn pixel(linear: Color) -> Rgb<u8> {
    // A soft shoulder keeps what is close to the window from turning into a white spot.
    let shown = linear.map(|v| if v < 0.6 { v } else { 0.6 + 0.4 * (1.0 - (-(v - 0.6) / 0.4).exp()) });
    Rgb(shown
        .map(|v| {
            let v = v.clamp(0.0, 1.0);
            let encoded = if v <= 0.0031308 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
            (encoded * 255.0).round() as u8
        })
        .into())
}

impl World {
    fn bake(&self, &(name, width, height, pixels, samples, paint): &Surface) -> RgbImage {
        let node = self.scene.nodes.iter().position(|node| node.name == name);
        let world_from_node = self.world.world_from_node[node.unwrap_or_else(|| panic!("no {name}"))];
        let (columns, rows) = ((width * samples) as usize, (height * samples) as usize);
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        let light: Vec<Color> = std::thread::scope(|scope| {
            let part = |range: std::ops::Range<usize>| {
                range
                    .flat_map(|row| (0..columns).map(move |column| (row, column)))
                    .map(|(row, column)| {
                        let x = (column as f64 + 0.5) / columns as f64 * width;
                        let y = (row as f64 + 0.5) / rows as f64 * height;
                        let seed = (row * columns + column) as u64;
                        self.arriving(&world_from_node, x - 0.5 * width, 0.5 * height - y, seed)
                    })
                    .collect::<Vec<Color>>()
            };
            let bound = |thread: usize| rows * thread / threads;
            let workers: Vec<_> =
                (0..threads).map(|t| scope.spawn(move || part(bound(t)..bound(t + 1)))).collect();
            workers
                .into_iter()
                .flat_map(|w| w.join().unwrap_or_else(|_| panic!("a thread has panicked")))
                .collect()
        });
        let light = smooth(&light, columns, rows);
        let at = |x: f64, y: f64| {
            let (u, v) = (
                (x * samples - 0.5).clamp(0.0, columns as f64 - 1.001),
                (y * samples - 0.5).clamp(0.0, rows as f64 - 1.001),
            );
            let (i, j) = (u as usize, v as usize);
            let row = |j: usize| mix(light[j * columns + i], light[j * columns + i + 1], u - i as f64);
            mix(row(j), row(j + 1), v - j as f64)
        };
        RgbImage::from_fn((width * pixels) as u32, (height * pixels) as u32, |column, row| {
            let (x, y) = ((f64::from(column) + 0.5) / pixels, (f64::from(row) + 0.5) / pixels);
            pixel(paint(x, y).component_mul(&at(x, y)) / std::f64::consts::PI)
        })
    }

    /// Irradiance at a point of a rectangle.
    fn arriving(&self, world_from_node: &Affine, x: f64, y: f64, seed: u64) -> Color {
        let point = world_from_node.transform_point(&Point3::new(x, y, 0.0));
        let normal = (world_from_node.linear * Vector3::z()).normalize();
        let mut random = Random(seed.wrapping_mul(0x9E3779B97F4A7C15) ^ 0x1234_5678);
        let direct = self.direct(&point, &normal, WINDOW_RAYS, LAMP_RAYS, &mut random);
        let mut reflected = Color::zeros();
        let side = (BOUNCE_RAYS as f64).sqrt() as usize;
        for i in 0..side {
            for j in 0..side {
                let u = (i as f64 + random.next()) / side as f64;
                let angle = (j as f64 + random.next()) / side as f64 * std::f64::consts::TAU;
                let direction = around(&normal, u.sqrt(), angle, (1.0 - u).sqrt());
                let Some((hit, normal, color, emitted)) = self.hit(&point, &normal, &direction) else {
                    continue;
                };
                // A bounce next to a lamp would be one bright speck: its light is held back.
                let light = self.direct(&hit, &normal, 1, 1, &mut random).map(|v| v.min(BRIGHTEST_BOUNCE))
                    + Color::repeat(REST);
                reflected += color.component_mul(&light) + emitted * std::f64::consts::PI;
            }
        }
        direct + reflected / (side * side) as f64
    }

    /// Irradiance straight from window and lamps.
    fn direct(
        &self,
        point: &Point3<f64>,
        normal: &Vector3<f64>,
        window_rays: usize,
        lamp_rays: usize,
        random: &mut Random,
    ) -> Color {
        let mut sum = Color::zeros();
        let (middle, half_y, half_z) = WINDOW;
        let side = (window_rays as f64).sqrt() as usize;
        for i in 0..side {
            for j in 0..side {
                let v = ((i as f64 + random.next()) / side as f64) * 2.0 - 1.0;
                let w = ((j as f64 + random.next()) / side as f64) * 2.0 - 1.0;
                let target = Point3::from(middle) + Vector3::new(0.0, v * half_y, w * half_z);
                let way = target - point;
                let distance = way.norm();
                let cosines = (normal.dot(&way) / distance).max(0.0) * (-way.x / distance).max(0.0);
                if cosines > 0.0 && self.is_free(point, normal, &way, 0.999) {
                    let area = 4.0 * half_y * half_z / (side * side) as f64;
                    sum += Color::from(SKY) * (cosines * area / (distance * distance));
                }
            }
        }
        for (middle, radius, intensity) in LAMPS {
            for _ in 0..lamp_rays {
                let z = 2.0 * random.next() - 1.0;
                let angle = random.next() * std::f64::consts::TAU;
                let r = (1.0 - z * z).sqrt();
                let offset = Vector3::new(r * angle.cos(), r * angle.sin(), z) * radius;
                let way = Point3::from(middle) + offset - point;
                let distance = way.norm();
                let cosine = (normal.dot(&way) / distance).max(0.0);
                if cosine > 0.0 && self.is_free(point, normal, &way, 0.9) {
                    sum += Color::from(intensity) * (cosine / (distance * distance) / lamp_rays as f64);
                }
            }
        }
        sum
    }

    fn is_free(&self, point: &Point3<f64>, normal: &Vector3<f64>, way: &Vector3<f64>, share: f64) -> bool {
        let origin = point + normal * 1e-4;
        let ray = Ray { origin, direction: UnitVector3::new_normalize(*way) };
        match self.picker.pick(&self.scene, &self.world, &ray, way.norm() * share) {
            None => true,
            // The lamp's shade lets light through.
            Some(hit) => self.scene.nodes[hit.node].name == "lamp shade",
        }
    }

    /// Where a ray ends: point, normal towards the ray, colour, what it emits.
    fn hit(
        &self,
        point: &Point3<f64>,
        normal: &Vector3<f64>,
        direction: &Vector3<f64>,
    ) -> Option<(Point3<f64>, Vector3<f64>, Color, Color)> {
        let ray = Ray { origin: point + normal * 1e-4, direction: UnitVector3::new_normalize(*direction) };
        let hit = self.picker.pick(&self.scene, &self.world, &ray, f64::INFINITY)?;
        let node = &self.scene.nodes[hit.node];
        let primitive = &self.scene.meshes[node.mesh?].primitives[hit.primitive];
        let material = &self.scene.materials[primitive.material];
        let corners: Vec<Vector3<f64>> = primitive.indices[3 * hit.triangle..3 * hit.triangle + 3]
            .iter()
            .map(|&i| Vector3::from(primitive.normals[i as usize]).cast())
            .collect();
        let local: Vector3<f64> = corners.iter().zip(hit.barycentric).map(|(n, w)| n * w).sum();
        let shading = (self.world.world_from_node[hit.node].normal_matrix() * local).normalize();
        let facing = if shading.dot(direction) > 0.0 { -shading } else { shading };
        let base =
            Vector3::new(material.base_color[0], material.base_color[1], material.base_color[2]).cast();
        // Painted surfaces have their colour in the picture that is being made.
        let color = match SURFACES.iter().find(|surface| surface.0 == node.name) {
            Some(&(_, width, height, _, _, paint)) => paint(0.37 * width, 0.41 * height),
            None if material.base_color_texture.is_some() => base * 0.45,
            None => base,
        };
        // The window's own light is counted where it is sampled.
        let is_sky = material.shading == Shading::Unlit;
        let emitted = if is_sky || material.emissive_texture.is_some() {
            Color::zeros()
        } else {
            Vector3::from(material.emissive).cast()
        };
        let color = if is_sky { Color::zeros() } else { color };
        Some((ray.at(hit.distance_m), facing, color, emitted))
    }
}

/// The direction with the given parts across and along `normal`.
fn around(normal: &Vector3<f64>, across: f64, angle: f64, along: f64) -> Vector3<f64> {
    let helper = if normal.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
    let tangent = normal.cross(&helper).normalize();
    let bitangent = normal.cross(&tangent);
    tangent * (across * angle.cos()) + bitangent * (across * angle.sin()) + normal * along
}

/// Takes the grain out of the light: a small Gaussian.
fn smooth(light: &[Color], columns: usize, rows: usize) -> Vec<Color> {
    let weights = [0.25, 0.5, 0.25];
    let clamp = |i: usize, by: usize, end: usize| (i + by).saturating_sub(1).min(end - 1);
    let pass = |source: &[Color], horizontal: bool| -> Vec<Color> {
        (0..rows * columns)
            .map(|at| {
                let (row, column) = (at / columns, at % columns);
                (0..3)
                    .map(|k| {
                        let from = if horizontal {
                            row * columns + clamp(column, k, columns)
                        } else {
                            clamp(row, k, rows) * columns + column
                        };
                        source[from] * weights[k]
                    })
                    .sum()
            })
            .collect()
    };
    pass(&pass(&pass(&pass(light, true), false), true), false)
}
