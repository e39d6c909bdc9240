//! Where the user stands in the scene.

use nalgebra::{UnitQuaternion, Vector3};
use vergence_geom::Rigid;
use vergence_scene::Scene;
use vergence_scene::model::WorldTransforms;

/// Height of the eyes over the floor for whom a scene without a start is arranged, and where the floor is not known,
/// metres.
const EYE_HEIGHT_M: f64 = 1.6;
/// A scene this high or higher is something to stand in; a lower one is put before the eyes.
const ROOM_HEIGHT_M: f64 = 2.2;
/// How far inside of a room, as a part of its depth.
const INSIDE: f64 = 0.15;
/// Nearest and farthest distance from the front of the scene, metres.
const DISTANCE_M: (f64, f64) = (0.6, 3.0);

/// The user's floor origin in world coordinates (y up, −z ahead): the scene's own start; else where its first camera puts
/// the eyes, upright; else, where the scene is as high as a room, inside of it, near its front (+z) and on its lowest
/// point; else in front of it, so that its middle is before the eyes.
pub fn start_of(scene: &Scene) -> Rigid {
    if let Some(world_from_start) = scene.world_from_start {
        return world_from_start;
    }
    if let Some(world_from_start) = below_camera(scene) {
        return world_from_start;
    }
    let bounds = scene.bounds();
    if bounds.is_empty() {
        return Rigid::identity();
    }
    let centre = bounds.centre();
    let size = bounds.max - bounds.min;
    let (floor_m, ahead_m) = if size.y >= ROOM_HEIGHT_M {
        (bounds.min.y, -INSIDE * size.z)
    } else {
        (centre.y - (EYE_HEIGHT_M - 0.2), size.x.max(size.y).clamp(DISTANCE_M.0, DISTANCE_M.1))
    };
    Rigid::from_parts(
        nalgebra::Translation3::new(centre.x, floor_m, bounds.max.z + ahead_m),
        UnitQuaternion::identity(),
    )
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

    #[test]
    fn a_scene_without_a_start_is_before_the_user() {
        let thing = start_of(&boxed([9.5, -0.5, -0.5], [10.5, 0.5, 0.5]));
        assert_eq!((thing.translation.x, thing.translation.z), (10.0, 1.5));
        let eyes_above_middle_m = thing.translation.y + EYE_HEIGHT_M;
        assert!((0.0..0.5).contains(&eyes_above_middle_m), "{eyes_above_middle_m}");
        let room = start_of(&boxed([-20.0, -1.0, -20.0], [20.0, 9.0, 20.0]));
        assert_eq!((room.translation.y, room.translation.z), (-1.0, 14.0));
        assert_eq!(start_of(&Scene::default()), Rigid::identity());
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
