//! Row 1: reversed depth without a far plane tells near from far at any distance.

use nalgebra::{UnitQuaternion, Vector3};
use vergence_geom::{Rigid, View, eye_depth_from_clip_depth};
use vergence_scene::model::Scene;

use crate::stage::{NEAR_M, add, sized, square, square_fov, unlit};
use crate::table::Table;
use vergence_tests::pictures::Bench;

const SIZE: (u32, u32) = (256, 256);
const SIDE_PX: u32 = 200;
const FOV_DEG: f64 = 60.0;
/// Two roundings to 24 bits, and a little: depth → view z, without a rasteriser.
const ROUND_TRIP_BOUND: f64 = 2e-7;
/// The same through vertex stage, division and depth buffer of the device: five roundings.
const DEVICE_ROUND_TRIP_BOUND: f64 = 5e-7;
/// Of the slanted pairs.
const SLANT_RAD: f64 = std::f64::consts::FRAC_PI_4;
/// Yaws of the pair about the vertical axis.
const YAWS: u32 = 360;

const RED: [f32; 4] = [1.0, 0.0, 0.0, 1.0];
const GREEN: [f32; 4] = [0.0, 1.0, 0.0, 1.0];

/// Pixels, over all yaws, inside of two squares `gap_m` apart at `distance_m`, where the farther one is seen.
/// `slant_rad` turns both about their vertical axis.
fn wrong_pixels(bench: &mut Bench, distance_m: f64, gap_m: f64, slant_rad: f64, yaws: u32) -> (u64, u64) {
    let (mut wrong, mut looked_at) = (0, 0);
    let width_m =
        2.0 * (FOV_DEG.to_radians() / 2.0).tan() * distance_m * f64::from(SIDE_PX) / f64::from(SIZE.0);
    for yaw in 0..yaws {
        let yaw_rad = std::f64::consts::TAU * f64::from(yaw) / f64::from(yaws);
        let turned = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw_rad);
        let world_from_eye = Rigid::from_parts(Vector3::new(0.3, 1.6, -0.2).into(), turned);
        let slant = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), slant_rad);
        let pair = world_from_eye * Rigid::from_parts(Vector3::new(0.0, 0.0, -distance_m).into(), slant);
        // Slanted squares are so long that they cover the same pixels and more, and still end before the eye.
        let size = if slant_rad == 0.0 { (width_m, width_m) } else { (2.4 * distance_m, 2.4 * distance_m) };
        let mut scene = Scene::default();
        let mut squares = [(0.0, GREEN), (-gap_m, RED)];
        if yaw % 2 == 1 {
            squares.reverse();
        }
        for (offset, color) in squares {
            let place = pair * Rigid::translation(0.0, 0.0, offset);
            let mut primitive = square();
            primitive.colors.clear();
            add(&mut scene, sized(&place, size.0, size.1), primitive, unlit(color));
        }
        let view = View { world_from_eye, fov: square_fov(FOV_DEG) };
        let shot = bench.shoot(&scene, NEAR_M, SIZE, &[view]);
        // One pixel less on each side: edges belong to nobody.
        let margin = (SIZE.0 - SIDE_PX) / 2 + 1;
        for y in margin..SIZE.1 - margin {
            for x in margin..SIZE.0 - margin {
                let color = shot.color(0, x, y);
                let seen = &color[..3];
                assert!(*seen == GREEN[..3] || *seen == RED[..3], "no square covers ({x}, {y})");
                wrong += u64::from(*seen == RED[..3]);
                looked_at += 1;
            }
        }
    }
    (wrong, looked_at)
}

/// What a depth in f32 says about the distance: over eleven decades, without a rasteriser.
fn analytic_round_trip() -> f64 {
    let near = NEAR_M as f32;
    (0..=110_000)
        .map(|i| {
            let distance = (NEAR_M * 10f64.powf(f64::from(i) * 1e-4)) as f32;
            let depth = near / distance;
            let back = eye_depth_from_clip_depth(f64::from(depth), f64::from(near)) as f32;
            (f64::from(back) / f64::from(distance) - 1.0).abs()
        })
        .fold(0.0, f64::max)
}

/// The same, read back from the device's depth buffer: one square at a time, 0.06 m to 100 km.
fn device_round_trip(bench: &mut Bench) -> f64 {
    let near = f64::from(NEAR_M as f32);
    let mut worst = 0.0f64;
    for i in 0..=24 {
        let distance_m = 0.06 * 10f64.powf(f64::from(i) * 0.26);
        let world_from_eye = Rigid::new(Vector3::new(0.3, 1.6, -0.2), Vector3::new(0.2, f64::from(i), 0.1));
        let mut scene = Scene::default();
        let place = world_from_eye * Rigid::translation(0.0, 0.0, -distance_m);
        add(&mut scene, sized(&place, 0.5 * distance_m, 0.5 * distance_m), square(), unlit(GREEN));
        let view = View { world_from_eye, fov: square_fov(FOV_DEG) };
        let shot = bench.shoot(&scene, NEAR_M, SIZE, &[view]);
        for (x, y) in [(128, 128), (100, 100), (150, 110), (90, 160)] {
            let back = eye_depth_from_clip_depth(f64::from(shot.depth(0, x, y)), near);
            let error = (back / distance_m - 1.0).abs();
            // Once not a number, never a number again.
            worst = if error.is_nan() || worst.is_nan() { f64::NAN } else { worst.max(error) };
        }
    }
    worst
}

pub fn run(bench: &mut Bench, table: &mut Table) {
    for (distance_m, gap_m, name) in [(1e3, 1e-3, "1 mm apart at 1 km"), (5e3, 1e-2, "1 cm apart at 5 km")] {
        let (wrong, of) = wrong_pixels(bench, distance_m, gap_m, 0.0, YAWS);
        assert!(of > 10_000_000, "too few pixels were looked at");
        table.check(format!("squares {name}, fronto-parallel, wrong of {of}"), wrong as f64, 0.0, "px");
        let (wrong, of) = wrong_pixels(bench, distance_m, gap_m, SLANT_RAD, YAWS / 10);
        table.tell(format!("squares {name}, slanted 45 deg, wrong of {of}"), wrong as f64, "px");
    }
    table.check("depth to view z and back, f32", analytic_round_trip(), ROUND_TRIP_BOUND, "relative");
    let device = device_round_trip(bench);
    table.check("depth buffer of the device to view z", device, DEVICE_ROUND_TRIP_BOUND, "relative");
}
