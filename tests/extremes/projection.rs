//! Row 2: where points land, at every field of view, eye distance and world scale.
//!
//! A world scale multiplies the scene, the eyes' distance and the near plane: a user who has become that much larger.
//!
//! Every vertex colour is a place in its square, so each covered pixel of a floating-point picture says which point of
//! the square its middle shows. The f64 truth is the intersection of that pixel's ray with the square.

use nalgebra::{Point3, Vector3};
use vergence_geom::{Fov, Rigid, View};
use vergence_scene::model::Scene;

use crate::stage::{self, NEAR_M, add, ray_of_pixel, sized, square_fov, unlit};
use crate::table::Table;
use vergence_tests::pictures::{Bench, Shot};

/// The bar: a thousandth of a pixel.
const BOUND_PX: f64 = 1e-3;
const SIZE: (u32, u32) = (512, 512);
/// Side of a square in the picture, pixels.
const SIDE_PX: f64 = 90.0;
/// Identities are this fraction of blue.
const ID_STEP: f64 = 1.0 / 16.0;

struct Square {
    centre: Point3<f64>,
    width_m: f64,
    height_m: f64,
}

/// Squares parallel to the picture, from just behind the near plane to 100 km and all over it, as seen from between the eyes.
fn squares(fov: &Fov, scale: f64) -> Vec<Square> {
    let [l, r, u, d] = fov.tangents();
    let mut squares = Vec::new();
    for (distance, places) in [
        (0.06, [(0.15, 0.2), (0.85, 0.15)]),
        (3.0, [(0.5, 0.5), (0.15, 0.85)]),
        (0.2, [(0.33, 0.35), (0.67, 0.3)]),
        (400.0, [(0.3, 0.67), (0.68, 0.68)]),
        (1e5, [(0.85, 0.85), (0.5, 0.12)]),
    ] {
        let depth = distance * scale;
        for (s, t) in places {
            squares.push(Square {
                centre: Point3::new((l + (r - l) * s) * depth, (u + (d - u) * t) * depth, -depth),
                width_m: depth * (r - l) * SIDE_PX / f64::from(SIZE.0),
                height_m: depth * (u - d) * SIDE_PX / f64::from(SIZE.1),
            });
        }
    }
    squares
}

/// Largest distance, in pixels, between where a pixel's colour says that it looks and where it does; and how many
/// pixels were looked at.
fn worst_px(shot: &Shot, views: &[View], world_from_head: &Rigid, squares: &[Square]) -> (f64, usize) {
    let (mut worst, mut pixels) = (0.0f64, 0);
    for (index, view) in views.iter().enumerate() {
        let head_from_eye = world_from_head.inverse() * view.world_from_eye;
        for y in 0..SIZE.1 {
            for x in 0..SIZE.0 {
                let color = shot.color(index, x, y);
                if !color.iter().all(|c| c.is_finite()) {
                    return (f64::NAN, pixels);
                }
                let id = (f64::from(color[2]) / ID_STEP).round() as usize;
                if id == 0 || id > squares.len() {
                    continue;
                }
                let square = &squares[id - 1];
                let eye = head_from_eye.translation.vector;
                let ray = ray_of_pixel(&view.fov, SIZE, x, y) * (eye.z - square.centre.z);
                let hit = eye + ray - square.centre.coords;
                let (u, v) = (hit.x / square.width_m + 0.5, hit.y / square.height_m + 0.5);
                let (du, dv) = (f64::from(color[0]) - u, f64::from(color[1]) - v);
                worst = worst.max(du.hypot(dv) * SIDE_PX);
                pixels += 1;
            }
        }
    }
    (worst, pixels)
}

fn case(bench: &mut Bench, table: &mut Table, name: String, fov: Fov, ipd_m: f64, scale: f64) {
    // Not at the origin, and not straight ahead: nothing is round by chance.
    let world_from_head = Rigid::new(Vector3::new(1.3, -0.7, 2.9) * scale, Vector3::new(0.3, -1.1, 0.2));
    let squares = squares(&fov, scale);
    let mut scene = Scene::default();
    for (index, square) in squares.iter().enumerate() {
        let place = world_from_head * Rigid::translation(square.centre.x, square.centre.y, square.centre.z);
        let blue = ((index + 1) as f64 * ID_STEP) as f32;
        let place = sized(&place, square.width_m, square.height_m);
        add(&mut scene, place, stage::square(), unlit([1.0, 1.0, blue, 1.0]));
    }
    let views = [-0.5, 0.5].map(|side| View {
        world_from_eye: world_from_head * Rigid::translation(side * ipd_m * scale, 0.0, 0.0),
        fov,
    });
    let shot = bench.shoot(&scene, NEAR_M * scale, SIZE, &views);
    let (worst, pixels) = worst_px(&shot, &views, &world_from_head, &squares);
    assert!(pixels > 10_000, "{name}: only {pixels} pixels were seen");
    table.check(name, worst, BOUND_PX, "px");
}

pub fn run(bench: &mut Bench, table: &mut Table) {
    for degrees in [1.0, 10.0, 60.0, 90.0, 120.0, 150.0, 170.0, 179.0] {
        let name = format!("projection, FOV {degrees} deg, IPD 63 mm");
        case(bench, table, name, square_fov(degrees), 0.063, 1.0);
    }
    let asymmetric = Fov { left_rad: -0.93, right_rad: 0.71, up_rad: 0.77, down_rad: -0.91 };
    for ipd_m in [0.0, 0.063, 0.3, 1.0] {
        let name = format!("projection, asymmetric FOV, IPD {ipd_m} m");
        case(bench, table, name, asymmetric, ipd_m, 1.0);
    }
    for scale in [1e-3, 1e-1, 1e1, 1e3] {
        let name = format!("projection, asymmetric FOV, world scale {scale:e}");
        case(bench, table, name, asymmetric, 0.063, scale);
    }
    // Both ends of all three at once.
    for degrees in [1.0, 179.0] {
        for ipd_m in [0.0, 1.0] {
            for scale in [1e-3, 1e3] {
                let name = format!("projection, FOV {degrees} deg, IPD {ipd_m} m, world scale {scale:e}");
                case(bench, table, name, square_fov(degrees), ipd_m, scale);
            }
        }
    }
}
