//! Where the user stands in the scene.

use nalgebra::{Point3, UnitQuaternion, Vector3};
use vergence_geom::{Ray, Rigid};
use vergence_scene::Scene;
use vergence_scene::model::WorldTransforms;
use vergence_scene::pick::Picker;

/// Height of the eyes over the floor for whom a scene without a start is arranged, and where the floor is not known,
/// metres.
const EYE_HEIGHT_M: f64 = 1.6;
/// Heights of what can be a room to stand in, metres.
const ROOM_HEIGHT_M: std::ops::RangeInclusive<f64> = 2.2..=30.0;
/// Heights of what stands on the user's floor; lower things are put before the eyes, higher ones are seen from afar.
const STANDING_HEIGHT_M: std::ops::RangeInclusive<f64> = 1.2..=30.0;
/// How far inside of a room, as a part of its depth.
const INSIDE: f64 = 0.15;
/// From the middle of a thing to the eyes, in radii of the ball around it: it then fills 54° of the view.
const DISTANCE_RADII: f64 = 2.2;
/// Nearest distance from a thing, metres: that of distinct vision, at which two eyes still see one picture in comfort.
const NEAREST_M: f64 = 0.25;
/// How far the eyes are over the middle of a thing, as a part of the distance: it is looked at a little from above.
const ABOVE: f64 = 0.2;

/// Where the user starts.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Start {
    /// The user's floor origin in world coordinates (y up, −z ahead).
    pub(crate) world_from_start: Rigid,
    /// Whether that floor is the one the user stands on; else the eyes shall be [`EYE_HEIGHT_M`] over it, however tall
    /// the user is.
    pub(crate) is_floor: bool,
    /// What was chosen where the scene does not say it, for people.
    pub(crate) chosen: Option<String>,
}

/// The user's floor origin in world coordinates (y up, −z ahead): the scene's own start; else where its first camera puts
/// the eyes, upright; else inside of it, near its front (+z), where it is a room; else in front of it, at a distance at
/// which it fills a good part of the view and two eyes see it in comfort. Nothing is scaled: what is tiny stays tiny.
pub fn start_of(scene: &Scene) -> Rigid {
    start(scene).world_from_start
}

/// As [`start_of`], with how it was chosen. O(vertices).
pub(crate) fn start(scene: &Scene) -> Start {
    if let Some(world_from_start) = scene.world_from_start {
        return Start { world_from_start, is_floor: true, chosen: None };
    }
    if let Some(world_from_start) = below_camera(scene) {
        return Start {
            world_from_start,
            is_floor: false,
            chosen: Some("starts at the file's camera".into()),
        };
    }
    let bounds = scene.posed_bounds();
    if bounds.is_empty() {
        return Start { world_from_start: Rigid::identity(), is_floor: true, chosen: None };
    }
    let (centre, size) = (bounds.centre(), bounds.max - bounds.min);
    let at = |x, y, z| Rigid::from_parts(nalgebra::Translation3::new(x, y, z), UnitQuaternion::identity());
    let inside = at(centre.x, bounds.min.y, bounds.max.z - INSIDE * size.z);
    let shown = format!("{} × {} × {}", metres(size.x), metres(size.y), metres(size.z));
    if ROOM_HEIGHT_M.contains(&size.y) && is_room(scene, &inside) {
        let chosen = Some(format!("starts inside of the scene ({shown}): the file names no start"));
        return Start { world_from_start: inside, is_floor: true, chosen };
    }
    let radius_m = 0.5 * size.norm();
    let from_front_m = (DISTANCE_RADII * radius_m - 0.5 * size.z).max(NEAREST_M);
    let distance_m = from_front_m + 0.5 * size.z;
    let stands = STANDING_HEIGHT_M.contains(&size.y);
    let floor_m = if stands { bounds.min.y } else { centre.y + ABOVE * distance_m - EYE_HEIGHT_M };
    let angle = 2.0 * (radius_m / distance_m).min(1.0).asin().to_degrees();
    let tiny = if angle < 10.0 { "; `scale` in a scene file makes it larger" } else { "" };
    let chosen = Some(format!(
        "starts {} in front of the scene ({shown}), which fills {angle:.0}° of the view: the file names no start{tiny}",
        metres(from_front_m)
    ));
    Start { world_from_start: at(centre.x, floor_m, bounds.max.z + from_front_m), is_floor: stands, chosen }
}

/// Whether there is a floor to stand on and walls on most sides, none of them in the face.
fn is_room(scene: &Scene, world_from_start: &Rigid) -> bool {
    const SIDES: usize = 12;
    const NEAREST_WALL_M: f64 = 0.3;
    let (picker, world) = (Picker::new(scene), WorldTransforms::at_rest(scene));
    let origin = world_from_start * Point3::new(0.0, EYE_HEIGHT_M, 0.0);
    let reach_m = scene.bounds().diagonal_m();
    let distance_m = |direction: Vector3<f64>| {
        let ray = Ray { origin, direction: nalgebra::Unit::new_normalize(direction) };
        picker.pick(scene, &world, &ray, reach_m).map(|hit| hit.distance_m)
    };
    let has_floor = distance_m(-Vector3::y()).is_some_and(|down_m| down_m > 0.5 * EYE_HEIGHT_M);
    let walls = (0..SIDES).filter_map(|side| {
        let angle = side as f64 / SIDES as f64 * std::f64::consts::TAU;
        distance_m(Vector3::new(angle.sin(), 0.0, angle.cos()))
    });
    let walls: Vec<f64> = walls.collect();
    has_floor && 2 * walls.len() > SIDES && walls.iter().all(|wall_m| *wall_m > NEAREST_WALL_M)
}

/// A length as people say it.
fn metres(length_m: f64) -> String {
    match length_m {
        l if l < 0.01 => format!("{:.1} mm", l * 1e3),
        l if l < 1.0 => format!("{:.0} cm", l * 1e2),
        l if l < 1e4 => format!("{l:.1} m"),
        l => format!("{:.0} km", l * 1e-3),
    }
}

/// The floor in LOCAL while the runtime knows none: LOCAL's origin is where the eyes were at first.
pub(crate) fn assumed_floor() -> Rigid {
    Rigid::translation(0.0, -EYE_HEIGHT_M, 0.0)
}

/// The floor below the first camera, turned to where it looks; `None` without a camera, or where it looks straight up or
/// down.
fn below_camera(scene: &Scene) -> Option<Rigid> {
    let node = scene.nodes.iter().position(|node| node.camera.is_some())?;
    let world_from_camera = WorldTransforms::at_rest(scene).world_from_node[node];
    let ahead = world_from_camera.linear * -Vector3::z();
    let is_level = ahead.xz().norm() > 1e-3 * ahead.norm();
    is_level.then(|| {
        let yaw_rad = (-ahead.x).atan2(-ahead.z);
        let floor = world_from_camera.translation - EYE_HEIGHT_M * Vector3::y();
        Rigid::from_parts(floor.into(), UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw_rad))
    })
}

/// Where LOCAL's origin is in the world, when its floor is at `local_from_floor`.
pub(crate) fn world_from_local(world_from_start: &Rigid, local_from_floor: &Rigid) -> Rigid {
    // At the start, the user's floor origin is the scene's start.
    world_from_start * local_from_floor.inverse()
}

#[cfg(test)]
mod tests {
    use super::*;
    use vergence_geom::Affine;
    use vergence_scene::model::{Local, Mesh, Node, Primitive};

    fn boxed(min: [f32; 3], max: [f32; 3]) -> Scene {
        let node = Node {
            name: String::new(),
            parent: None,
            parent_from_node: Local::Matrix(Affine::identity()),
            mesh: Some(0),
            skin: None,
            light: None,
            camera: None,
            label: None,
        };
        let primitive = Primitive { positions: vec![min, max], ..Primitive::default() };
        Scene {
            nodes: vec![node],
            meshes: vec![Mesh { name: String::new(), primitives: vec![primitive] }],
            ..Scene::default()
        }
    }

    /// Angle that the ball around the scene fills, and the nearest distance from it.
    fn seen(scene: &Scene) -> (f64, f64) {
        let eyes = start_of(scene) * Point3::new(0.0, EYE_HEIGHT_M, 0.0);
        let bounds = scene.posed_bounds();
        let angle = 2.0 * (0.5 * bounds.diagonal_m() / (eyes - bounds.centre()).norm()).asin();
        (angle.to_degrees(), eyes.z - bounds.max.z)
    }

    #[test]
    fn a_scene_without_a_start_is_before_the_user_whatever_its_size() {
        for size in [0.05f32, 0.3, 1.0, 3.0, 80.0, 550.0, 1e6] {
            let half = 0.5 * size;
            let scene = boxed([10.0 - half, -half, -half], [10.0 + half, half, half]);
            let (angle_deg, from_front_m) = seen(&scene);
            assert!((if size < 0.1 { 15.0 } else { 40.0 }..60.0).contains(&angle_deg), "{size}: {angle_deg}");
            assert!(from_front_m >= NEAREST_M - 1e-9, "{size}: {from_front_m}");
            assert!((start_of(&scene).translation.x - 10.0).abs() < 1e-6);
        }
        // Tiny things stay tiny, and that is said.
        let tiny = start(&boxed([0.0; 3], [0.007; 3]));
        assert!(tiny.chosen.as_ref().is_some_and(|chosen| chosen.contains("7.0 mm")), "{tiny:?}");
        assert_eq!(start_of(&Scene::default()), Rigid::identity());
    }

    #[test]
    fn what_stands_is_put_on_the_floor() {
        let person = start(&boxed([-0.3, 0.1, -0.2], [0.3, 1.9, 0.2]));
        assert!((person.world_from_start.translation.y - 0.1).abs() < 1e-6 && person.is_floor);
        // A solid thing as high as a room is none.
        let house = start(&boxed([-4.0, 0.0, -4.0], [4.0, 8.0, 4.0]));
        assert!(house.world_from_start.translation.z > 4.0, "{house:?}");
    }

    #[test]
    fn a_file_with_a_camera_starts_there() {
        let mut scene = boxed([-20.0, -1.0, -20.0], [20.0, 9.0, 20.0]);
        let place = Rigid::from_parts(
            nalgebra::Translation3::new(-10.5, 1.7, 0.5),
            UnitQuaternion::from_euler_angles(0.0, -std::f64::consts::FRAC_PI_2, 0.0),
        );
        let camera = Node { camera: Some(0), ..Node::at("camera", Local::Matrix(place.into())) };
        scene.nodes.push(camera);
        let start = start_of(&scene);
        let eyes = start * nalgebra::Point3::new(0.0, EYE_HEIGHT_M, 0.0);
        assert!((eyes.coords - place.translation.vector).norm() < 1e-12, "{eyes}");
        assert!((start.rotation * -Vector3::z() - Vector3::x()).norm() < 1e-12);
    }

    #[test]
    fn the_users_floor_is_the_scenes_start() {
        let start = Rigid::from_parts(
            nalgebra::Translation3::new(1.0, 2.0, 3.0),
            UnitQuaternion::from_euler_angles(0.0, 1.0, 0.0),
        );
        let local_from_floor = Rigid::translation(0.0, -1.7, 0.0);
        let world_from_floor = world_from_local(&start, &local_from_floor) * local_from_floor;
        assert!((world_from_floor.translation.vector - start.translation.vector).norm() < 1e-12);
    }
}
