//! What the shaders know of a frame: written as late as possible.

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};
use vergence_geom::View;
use vergence_shaders::{MAX_LIGHTS, MAX_VIEWS};

use crate::lights::PackedLight;
use crate::pose::{outward_normal_matrix, rows_of};

/// `View` of surface.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub(crate) struct PackedView {
    clip: [f32; 4],
    eye_in_head: [f32; 4],
    ray: [f32; 4],
    ray_per_x: [f32; 4],
    ray_per_y: [f32; 4],
}

/// `Frame` of surface.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub(crate) struct PackedFrame {
    pub views: [PackedView; MAX_VIEWS as usize],
    pub ambient: [f32; 4],
    pub lights: [PackedLight; MAX_LIGHTS as usize],
}

/// Rows of `Place` in the shader: three for normals, three for each view.
pub(crate) const PLACE_ROWS: usize = 3 + 3 * MAX_VIEWS as usize;

/// The late views of a frame. Head coordinates are those of the first view.
#[derive(Clone, Debug)]
pub(crate) struct Eyes {
    pub head_from_world: Isometry3<f64>,
    /// Per view: world axes to eye axes, and where the eye is in the world.
    eyes: [(Matrix3<f64>, Point3<f64>); MAX_VIEWS as usize],
    count: usize,
}

impl Eyes {
    /// From one to [`MAX_VIEWS`] views.
    pub fn new(views: &[View]) -> Self {
        let mut eyes = [(Matrix3::identity(), Point3::origin()); MAX_VIEWS as usize];
        for (eye, view) in eyes.iter_mut().zip(views) {
            let rotation = view.world_from_eye.rotation.to_rotation_matrix().into_inner().transpose();
            *eye = (rotation, Point3::from(view.world_from_eye.translation.vector));
        }
        let head_from_world =
            views.first().map_or(Isometry3::identity(), |view| view.world_from_eye.inverse());
        Self { head_from_world, eyes, count: views.len().min(MAX_VIEWS as usize) }
    }

    /// Turns the linear part of world_from_part into the axes of head and eyes: what parts of one node share.
    pub fn axes(&self, linear: &Matrix3<f64>) -> Axes {
        let mut axes = Axes { normals: [[0.0; 4]; 3], linear: [Matrix3::zeros(); MAX_VIEWS as usize] };
        for (turned, (eye_from_world, _)) in axes.linear.iter_mut().zip(&self.eyes[..self.count]) {
            *turned = eye_from_world * linear;
        }
        axes.normals = rows_of(&outward_normal_matrix(&axes.linear[0]), &Vector3::zeros());
        axes.normals[0][3] = if linear.determinant() < 0.0 { -1.0 } else { 1.0 };
        axes
    }

    /// Writes the rows of a part whose origin stands at `place` in the world.
    pub fn write_rows(&self, axes: &Axes, place: &Point3<f64>, rows: &mut [[f32; 4]]) {
        rows[..3].copy_from_slice(&axes.normals);
        for (view, (eye_from_world, eye)) in self.eyes[..self.count].iter().enumerate() {
            // The subtraction that makes everything relative to the eye, in double precision.
            let offset = eye_from_world * (place - eye);
            rows[3 + 3 * view..6 + 3 * view].copy_from_slice(&rows_of(&axes.linear[view], &offset));
        }
    }
}

/// What parts of one node share in a frame.
#[derive(Clone, Copy)]
pub(crate) struct Axes {
    normals: [[f32; 4]; 3],
    linear: [Matrix3<f64>; MAX_VIEWS as usize],
}

/// Packs a view that is drawn to `size` pixels.
pub(crate) fn pack(
    view: &View,
    head_from_world: &Isometry3<f64>,
    size: (u32, u32),
    near_m: f64,
) -> PackedView {
    let [l, r, u, d] = view.fov.tangents();
    let (width, height) = (r - l, u - d);
    let head_from_eye = head_from_world * view.world_from_eye;
    let axes = head_from_eye.rotation.to_rotation_matrix().into_inner();
    let vec4 = |v: Vector3<f64>, w: f64| v.push(w).cast::<f32>().into();
    PackedView {
        clip: [2.0 / width, (r + l) / width, -2.0 / height, -(u + d) / height].map(|v| v as f32),
        eye_in_head: vec4(head_from_eye.translation.vector, near_m),
        ray: vec4(axes * Vector3::new(l, u, -1.0), 0.0),
        ray_per_x: vec4(axes.column(0) * (width / f64::from(size.0)), 0.0),
        ray_per_y: vec4(axes.column(1) * (-height / f64::from(size.1)), 0.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vergence_geom::{Fov, Rigid};

    fn stereo(ipd_m: f64) -> [View; 2] {
        let fov = Fov { left_rad: -0.9, right_rad: 0.7, up_rad: 0.75, down_rad: -0.8 };
        let head = Rigid::from_parts(
            nalgebra::Translation3::new(1e7, 1.7, -2e6),
            nalgebra::UnitQuaternion::from_euler_angles(0.2, 2.0, 0.1),
        );
        [-0.5, 0.5]
            .map(|side| View { world_from_eye: head * Rigid::translation(side * ipd_m, 0.0, 0.0), fov })
    }

    /// The two eyes' matrices differ by exactly the eye offset, 10,000 km from the origin too (the step of f64 there is 2 nm).
    #[test]
    fn matrices_of_two_eyes_differ_by_the_eye_offset() {
        let views = stereo(0.063);
        let eyes = Eyes::new(&views);
        let linear =
            nalgebra::UnitQuaternion::from_euler_angles(1.0, 0.3, 0.2).to_rotation_matrix().into_inner();
        let place = Point3::from(views[0].world_from_eye.translation.vector) + Vector3::new(0.2, -0.4, 1.0);
        let mut rows = vec![[0.0; 4]; PLACE_ROWS];
        eyes.write_rows(&eyes.axes(&linear), &place, &mut rows);
        let (left, right) = (&rows[3..6], &rows[6..9]);
        for r in 0..3 {
            assert_eq!(left[r][..3], right[r][..3]);
            let offset = f64::from(left[r][3]) - f64::from(right[r][3]);
            assert!((offset - [0.063, 0.0, 0.0][r]).abs() < 1e-6, "{r}: {offset}");
        }
    }

    /// The ray through a pixel meets what projects there.
    #[test]
    fn rays_and_projection_agree() {
        let views = stereo(0.063);
        let head_from_world = views[0].world_from_eye.inverse();
        let size = (1000, 800);
        for view in &views {
            let packed = pack(view, &head_from_world, size, 0.05);
            let in_eye = Point3::new(0.3, -0.2, -2.0);
            let ndc = vergence_geom::project(&view.fov, &in_eye).unwrap();
            let (x, y) = ((0.5 * ndc.x + 0.5) * 1000.0, (0.5 * ndc.y + 0.5) * 800.0);
            let v = |a: [f32; 4]| Vector3::new(a[0], a[1], a[2]).cast::<f64>();
            let along = v(packed.ray) + v(packed.ray_per_x) * x + v(packed.ray_per_y) * y;
            let found = v(packed.eye_in_head) + along * 2.0;
            let truth = head_from_world * (view.world_from_eye * in_eye);
            assert!((found - truth.coords).norm() < 2e-6, "{found} {truth}");
        }
    }
}
