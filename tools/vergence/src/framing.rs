//! Where a picture is taken from when there is no headset, and the cameras and lights of the peer's benchmark.

use std::path::Path;

use nalgebra::{Isometry3, Point3, Translation3, Vector3};
use serde_json::json;
use vergence_geom::{Fov, FovError, View};
use vergence_render::camera::{look_along, look_at, stereo};
use vergence_scene::Scene;
use vergence_scene::model::{Bounds, WorldTransforms};

/// Height of the eyes above the user's floor, metres.
const EYE_HEIGHT_M: f64 = 1.6;
/// From the middle of a scene to where all of it is seen, in diagonals of its box.
const OVERVIEW: [f64; 3] = [0.4 * 0.9, 0.3 * 0.9, 0.9];
/// Nearest distance that is drawn, metres; less for small scenes.
const NEAR_M: f64 = 0.05;

/// A head, what its eyes see, and how far they are apart.
#[derive(Clone, Debug)]
pub struct Framing {
    /// Where the head is.
    pub world_from_head: Isometry3<f64>,
    /// Vertical angle, radians.
    pub fov_y_rad: f64,
    /// Between the eyes, metres.
    pub ipd_m: f64,
    /// Nearest distance that is drawn, metres.
    pub near_m: f64,
    /// Where the camera comes from.
    pub source: &'static str,
}

impl Framing {
    /// From the scene's start, else its first camera, else from where all of it is seen.
    pub fn of(scene: &Scene) -> Self {
        let bounds = scene.bounds();
        let near_m = near(&bounds);
        let (fov_y_rad, ipd_m) = (60f64.to_radians(), 0.063);
        if let Some(world_from_start) = scene.world_from_start {
            let world_from_head = world_from_start * Translation3::new(0.0, EYE_HEIGHT_M, 0.0);
            return Self { world_from_head, fov_y_rad, ipd_m, near_m, source: "start" };
        }
        let with_camera =
            scene.nodes.iter().enumerate().find_map(|(index, node)| Some((index, node.camera?)));
        if let Some((node, camera)) = with_camera {
            let world = WorldTransforms::at_rest(scene).world_from_node[node];
            let origin = Point3::from(world.translation);
            let world_from_head = look_along(&origin, &(world.linear * -Vector3::z()));
            let fov_y_rad = f64::from(scene.cameras[camera].fov_y_rad);
            return Self { world_from_head, fov_y_rad, ipd_m, near_m, source: "camera" };
        }
        let world_from_head = overview(&bounds);
        Self { world_from_head, fov_y_rad, ipd_m, near_m, source: "overview" }
    }

    /// The peer's benchmark (bench.html): for the colonnade from one end down its length, else from where all of
    /// the scene is seen; eyes ±32 mm, 60°.
    pub fn bench(scene: &Scene, path: &Path) -> Self {
        let bounds = scene.posed_bounds();
        let is_colonnade = path.to_string_lossy().contains("colonnade");
        let world_from_head = if is_colonnade {
            look_at(&Point3::new(-10.5, 1.7, 0.0), &Point3::new(0.0, 1.7, 0.0))
        } else {
            overview(&bounds)
        };
        let near_m = if is_colonnade { 0.05 } else { bounds.diagonal_m().max(1e-6) * 0.05 };
        Self { world_from_head, fov_y_rad: 60f64.to_radians(), ipd_m: 0.064, near_m, source: "three" }
    }

    /// Looks from `eye` at `target`; what is not given stays, or is the middle of the scene.
    ///
    /// # Errors
    /// A sentence, where both are the same point, or too far apart for numbers: nobody can say which way that looks.
    pub fn look(
        &mut self,
        eye: Option<Point3<f64>>,
        target: Option<Point3<f64>>,
        scene: &Scene,
    ) -> Result<(), String> {
        let target_is_given = target.is_some();
        let eye = eye.unwrap_or(Point3::from(self.world_from_head.translation.vector));
        let target = target.unwrap_or_else(|| scene.bounds().centre());
        let ahead = target - eye;
        if !ahead.amax().is_normal() {
            let point = |p: Point3<f64>| format!("{:?},{:?},{:?}", p.x, p.y, p.z);
            let hint = if target_is_given { "" } else { " (the middle of the scene); give --target" };
            return Err(format!(
                "expected an eye position and a target that say a direction, found {} and {}{hint}",
                point(eye),
                point(target)
            ));
        }
        self.world_from_head = look_along(&eye, &ahead);
        self.source = "given";
        Ok(())
    }

    /// Left and right.
    ///
    /// # Errors
    /// A field of view that cannot be drawn.
    pub fn views(&self, aspect: f64) -> Result<[View; 2], FovError> {
        Ok(stereo(&self.world_from_head, self.ipd_m, Fov::symmetric(self.fov_y_rad, aspect)?))
    }

    /// The view from between the eyes.
    pub fn mono(&self, views: &[View; 2]) -> View {
        View { world_from_eye: self.world_from_head, ..views[0] }
    }

    /// For the report.
    pub fn describe(&self) -> serde_json::Value {
        let place = self.world_from_head.translation.vector;
        let ahead = self.world_from_head * -Vector3::z();
        json!({
            "from": self.source,
            "eye_position_m": [place.x, place.y, place.z],
            "ahead": [ahead.x, ahead.y, ahead.z],
            "fov_y_deg": self.fov_y_rad.to_degrees(),
            "ipd_mm": self.ipd_m * 1e3,
            "near_m": self.near_m,
        })
    }
}

/// Adds the lights of the peer's benchmark: ambient 0.5, directional 2 from (1, 2, 1.5).
pub fn add_bench_lights(scene: &mut Scene) {
    for channel in &mut scene.ambient {
        *channel += 0.5;
    }
    scene.add_directional([1.0, 2.0, 1.5], 2.0);
}

fn near(bounds: &Bounds) -> f64 {
    NEAR_M.min(bounds.diagonal_m().max(1e-6) * NEAR_M)
}

fn overview(bounds: &Bounds) -> Isometry3<f64> {
    let centre = bounds.centre();
    look_at(&(centre + Vector3::from(OVERVIEW) * bounds.diagonal_m().max(1e-3)), &centre)
}

/// Parses "X,Y,Z".
pub fn point(text: &str) -> Result<Point3<f64>, String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse::<f64>()).collect();
    match numbers.as_deref() {
        Ok(&[x, y, z]) if x.is_finite() && y.is_finite() && z.is_finite() => Ok(Point3::new(x, y, z)),
        _ => Err(format!("expected three numbers such as 0,1.6,-2, found {text:?}")),
    }
}

/// Parses a vertical field of view, degrees.
pub fn fov_y_deg(text: &str) -> Result<f64, String> {
    let degrees: Option<f64> = text.parse().ok();
    degrees
        .filter(|degrees| *degrees > 0.0 && *degrees < 180.0)
        .ok_or_else(|| format!("expected degrees between 0 and 180, found {text:?}"))
}

/// Parses a distance between the eyes, millimetres.
pub fn ipd_mm(text: &str) -> Result<f64, String> {
    let millimetres: Option<f64> = text.parse().ok();
    millimetres
        .filter(|millimetres| (0.0..=1000.0).contains(millimetres))
        .ok_or_else(|| format!("expected 0 to 1000 mm, found {text:?}"))
}

/// Parses "WxH".
pub fn size(text: &str) -> Result<(u32, u32), String> {
    let expected = || format!("expected a size such as 1024x1024, found {text:?}");
    let (width, height) = text.split_once('x').ok_or_else(expected)?;
    match (width.parse(), height.parse()) {
        (Ok(width), Ok(height)) if width > 0 && height > 0 => Ok((width, height)),
        _ => Err(expected()),
    }
}
