//! Row 3: a scene far from the origin looks the same.

use std::path::Path;

use nalgebra::{Point3, Vector3};
use vergence_fidelity::{DEFAULT_PIXELS_PER_DEGREE, Picture, flip};
use vergence_geom::{Rigid, View};
use vergence_scene::model::{Local, Scene};

use crate::stage::{NEAR_M, looking, square_fov};
use crate::table::Table;
use vergence_tests::pictures::{Bench, Shot};

const FLIP_BOUND: f64 = 1e-3;
const DISPARITY_BOUND_PX: f64 = 0.01;
const SIZE: (u32, u32) = (512, 512);
const IPD_M: f64 = 0.064;
/// Side of the squares in which displacement is measured, pixels.
const TILE_PX: u32 = 32;
/// Sum of squared horizontal gradients below which a tile shows too little to be located.
const LEAST_TEXTURE: f64 = 0.05;

/// The scene, moved as a whole.
fn moved(scene: &Scene, by: &Vector3<f64>) -> Scene {
    let mut scene = scene.clone();
    for node in scene.nodes.iter_mut().filter(|node| node.parent.is_none()) {
        match &mut node.parent_from_node {
            Local::Trs(trs) => trs.translation += by,
            Local::Matrix(affine) => affine.translation += by,
        }
    }
    scene
}

fn views(by: &Vector3<f64>) -> [View; 2] {
    let eye = Point3::new(-10.5, 1.7, 0.0);
    let centre = looking(&eye, &(eye + Vector3::x()), square_fov(60.0));
    [-0.5, 0.5].map(|side| {
        let at_origin = centre.world_from_eye * Rigid::translation(side * IPD_M, 0.0, 0.0);
        let world_from_eye =
            Rigid::from_parts((at_origin.translation.vector + by).into(), at_origin.rotation);
        View { world_from_eye, fov: centre.fov }
    })
}

fn picture(shot: &Shot, view: usize) -> Picture {
    let pixel = |i: u32| shot.color(view, i % SIZE.0, i / SIZE.0);
    let linear: Vec<f32> = (0..SIZE.0 * SIZE.1)
        .flat_map(|i| {
            let c = pixel(i);
            [c[0], c[1], c[2]]
        })
        .collect();
    Picture::from_linear(SIZE.0 as usize, SIZE.1 as usize, &linear).expect("a finite picture")
}

/// Horizontal displacement of each textured tile of `b` against `a`, pixels (Lucas & Kanade, one step: enough for
/// hundredths of a pixel).
fn displacements(a: &Picture, b: &Picture) -> Vec<Option<f64>> {
    let green = |p: &Picture, x: u32, y: u32| f64::from(p.rgb()[3 * (y * SIZE.0 + x) as usize + 1]);
    let mut tiles = Vec::new();
    for tile_y in 0..SIZE.1 / TILE_PX {
        for tile_x in 0..SIZE.0 / TILE_PX {
            let (mut gradient2, mut product) = (0.0, 0.0);
            for y in tile_y * TILE_PX..(tile_y + 1) * TILE_PX {
                for x in (tile_x * TILE_PX).max(1)..((tile_x + 1) * TILE_PX).min(SIZE.0 - 1) {
                    let gradient = 0.5 * (green(a, x + 1, y) - green(a, x - 1, y));
                    gradient2 += gradient * gradient;
                    product += gradient * (green(a, x, y) - green(b, x, y));
                }
            }
            tiles.push((gradient2 > LEAST_TEXTURE).then(|| product / gradient2));
        }
    }
    tiles
}

pub fn run(bench: &mut Bench, table: &mut Table, data: &Path) {
    let file = data.join("scenes/gltf/colonnade.glb");
    let scene = vergence_scene::load(&file, &vergence_scene::Limits::default()).expect("the colonnade loads");
    let home = bench.shoot(&scene, NEAR_M, SIZE, &views(&Vector3::zeros()));
    let home = [picture(&home, 0), picture(&home, 1)];
    // The measure is not blind: the right picture differs from the left one.
    let apart = flip(&home[0], &home[1], DEFAULT_PIXELS_PER_DEGREE).expect("equal sizes").mean;
    assert!(apart > 20.0 * FLIP_BOUND, "left and right are too alike to measure anything: {apart}");
    for distance_m in [1e3, 1e5, 1e7] {
        // In no direction that suits binary numbers; the length is that of the longest component.
        let by = Vector3::new(1.0, -0.317_31, 0.731_77) * distance_m;
        let away = bench.shoot(&moved(&scene, &by), NEAR_M, SIZE, &views(&by));
        let away = [picture(&away, 0), picture(&away, 1)];
        let worst_flip = [0, 1]
            .map(|i| flip(&home[i], &away[i], DEFAULT_PIXELS_PER_DEGREE).expect("equal sizes").mean)
            .into_iter()
            .fold(0.0, f64::max);
        table.check(format!("colonnade moved {distance_m:e} m, FLIP"), worst_flip, FLIP_BOUND, "");
        let (left, right) = (displacements(&home[0], &away[0]), displacements(&home[1], &away[1]));
        let errors: Vec<f64> =
            left.iter().zip(&right).filter_map(|(l, r)| Some((l.as_ref()? - r.as_ref()?).abs())).collect();
        assert!(errors.len() > 30, "only {} tiles have texture", errors.len());
        let worst = errors.iter().copied().fold(0.0, f64::max);
        table.check(format!("colonnade moved {distance_m:e} m, disparity"), worst, DISPARITY_BOUND_PX, "px");
    }
}
