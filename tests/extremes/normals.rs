//! Row 21: normals under uneven and negative scale.
//!
//! Measured in the picture: three lights of pure red, green and blue from three known directions make each pixel's
//! colour three cosines, from which the normal that was shaded with follows.

use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};
use vergence_geom::{Affine, Trs};
use vergence_scene::model::Scene;

use crate::stage::{NEAR_M, add, add_sun, angle, looking, matt, square, square_fov};
use crate::table::Table;
use vergence_tests::pictures::Bench;

const BOUND_RAD: f64 = 1e-6;
const SIZE: (u32, u32) = (64, 64);

/// Angle between the normal that the middle pixel was shaded with and the true one.
fn error_rad(bench: &mut Bench, scale: Vector3<f64>, tilt: UnitQuaternion<f64>) -> f64 {
    let place = Trs {
        translation: Vector3::new(0.4, -0.3, 0.2),
        rotation: UnitQuaternion::from_euler_angles(0.4, -0.9, 1.7),
        scale,
    };
    // The square stands askew in its mesh, so that the scale shears it.
    let mesh_from_square =
        Affine { linear: tilt.to_rotation_matrix().into_inner(), translation: Vector3::zeros() };
    let mut primitive = square();
    for (position, normal) in primitive.positions.iter_mut().zip(&mut primitive.normals) {
        let moved = mesh_from_square.transform_point(&Point3::from(Vector3::from(*position).cast::<f64>()));
        *position = moved.coords.cast::<f32>().into();
        *normal = (mesh_from_square.linear * Vector3::z()).cast::<f32>().into();
    }
    primitive.colors.clear();
    let world_from_mesh = place.to_affine();
    // The truth in f64, of the normal that is stored; its length is not exactly one, which must not matter.
    let stored = Vector3::from(primitive.normals[0]).cast::<f64>();
    let inverse_transpose = world_from_mesh.linear.try_inverse().expect("no zero scale").transpose();
    let truth = (inverse_transpose * stored).normalize();

    let mut scene = Scene::default();
    let side = if truth.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
    let along = truth.cross(&side).normalize();
    let across = truth.cross(&along);
    let directions =
        [0.0f64, 2.1, 4.2].map(|turn| (truth + 0.7 * (turn.cos() * along + turn.sin() * across)).normalize());
    for (index, direction) in directions.iter().enumerate() {
        let mut color = [0.0; 3];
        color[index] = 1.0;
        add_sun(&mut scene, direction, color, std::f32::consts::PI);
    }
    add(&mut scene, world_from_mesh, primitive, matt([1.0; 4]));
    let centre = Point3::from(world_from_mesh.translation);
    // The visible size of the flattened square may be a millimetre: come close, slightly off the normal.
    let extent = world_from_mesh.linear * mesh_from_square.linear;
    let size_m = extent.column(0).norm().min(extent.column(1).norm());
    let eye = centre + (truth + 0.1 * along).normalize() * size_m;
    let shot =
        bench.shoot(&scene, NEAR_M.min(0.1 * size_m), SIZE, &[looking(&eye, &centre, square_fov(20.0))]);
    let color = shot.color(0, SIZE.0 / 2, SIZE.1 / 2);
    let cosines = Vector3::new(f64::from(color[0]), f64::from(color[1]), f64::from(color[2]));
    let rows = Matrix3::from_rows(&directions.map(|direction| direction.transpose()));
    let normal = rows.try_inverse().expect("three directions that span space") * cosines;
    if (normal.norm() - 1.0).abs() > 1e-3 { f64::NAN } else { angle(&normal, &truth) }
}

pub fn run(bench: &mut Bench, table: &mut Table) {
    let scales = [
        ("(1, 1, 1)", Vector3::new(1.0, 1.0, 1.0)),
        ("(1, 1e-3, 1)", Vector3::new(1.0, 1e-3, 1.0)),
        ("(1e-3, 1, 1e3)", Vector3::new(1e-3, 1.0, 1e3)),
        ("(-1, 1, 1)", Vector3::new(-1.0, 1.0, 1.0)),
        ("(-1, -1, -1)", Vector3::new(-1.0, -1.0, -1.0)),
        ("(1, -1e-3, 1)", Vector3::new(1.0, -1e-3, 1.0)),
    ];
    let tilts = [(0.3, 0.8, -0.4), (-1.2, 0.1, 0.9), (0.0, 0.0, 0.0), (0.9, -0.7, 2.0)];
    for (name, scale) in scales {
        let worst = tilts
            .map(|(roll, pitch, yaw)| {
                error_rad(bench, scale, UnitQuaternion::from_euler_angles(roll, pitch, yaw))
            })
            .into_iter()
            .fold(0.0f64, |worst, error| if error.is_nan() { error } else { worst.max(error) });
        table.check(format!("normals, scale {name}"), worst, BOUND_RAD, "rad");
    }
}
