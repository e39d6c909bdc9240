//! Where everything is at one time: animated nodes, and the balls that culling tests.

use nalgebra::Point3;
use vergence_geom::Affine;
use vergence_scene::model::{Local, Scene, WorldTransforms};
use vergence_time::Span;

use crate::meshes::Meshes;

/// The present pose of a scene; kept from frame to frame so that it allocates nothing.
pub(crate) struct Pose {
    locals: Vec<Local>,
    pub world: WorldTransforms,
    /// One per drawable: a ball around it, world coordinates.
    pub balls: Vec<(Point3<f64>, f64)>,
    /// One per skin at a node: anchor_from_mesh of each joint, rows of six (three for normals).
    pub joint_rows: Vec<[f32; 4]>,
    /// One per skin at a node: where its results are relative to, world coordinates.
    pub anchors: Vec<Point3<f64>>,
    /// Nodes that the caller has placed, relative to their parents.
    placed: Vec<(usize, Affine)>,
    /// Per node: whether it is not drawn.
    pub hidden: Vec<bool>,
    fresh: bool,
}

impl Pose {
    pub fn new(scene: &Scene, meshes: &Meshes) -> Self {
        Self {
            locals: Vec::with_capacity(scene.nodes.len()),
            world: WorldTransforms::default(),
            balls: vec![(Point3::origin(), 0.0); meshes.drawables.len()],
            joint_rows: vec![[0.0; 4]; 6 * meshes.joints],
            anchors: vec![Point3::origin(); meshes.skins.len()],
            placed: Vec::new(),
            hidden: vec![false; scene.nodes.len()],
            fresh: false,
        }
    }

    /// Places a node relative to its parent from now on, whatever animates it.
    pub fn place(&mut self, node: usize, parent_from_node: &Affine) {
        match self.placed.iter_mut().find(|(placed, _)| *placed == node) {
            Some((_, place)) if place == parent_from_node => return,
            Some((_, place)) => *place = *parent_from_node,
            None => self.placed.push((node, *parent_from_node)),
        }
        self.fresh = false;
    }

    /// Moves to `time` after the start of the clips in [`Scene::playing`]. O(nodes + drawables), nothing where nothing moves.
    pub fn update(&mut self, scene: &Scene, meshes: &Meshes, time: Span) {
        if self.fresh && scene.playing.is_empty() {
            return;
        }
        scene.animate(time, &mut self.locals);
        for (node, parent_from_node) in &self.placed {
            if let Some(local) = self.locals.get_mut(*node) {
                *local = Local::Matrix(*parent_from_node);
            }
        }
        let locals = &self.locals;
        self.world.update(scene, |node| locals[node].to_affine());
        self.skin(scene, meshes);
        self.find_balls(scene, meshes);
        self.fresh = true;
    }

    fn skin(&mut self, scene: &Scene, meshes: &Meshes) {
        for (at, skin_at) in meshes.skins.iter().enumerate() {
            let skin = &scene.skins[skin_at.skin];
            let Some(&first) = skin.joints.first() else { continue };
            // Relative to the first joint: single precision is then exact to a millionth of the figure's size.
            let anchor = Point3::from(self.world.world_from_node[first].translation);
            self.anchors[at] = anchor;
            for (joint, (&node, joint_from_mesh)) in skin.joints.iter().zip(&skin.joint_from_mesh).enumerate()
            {
                let world_from_mesh = self.world.world_from_node[node] * *joint_from_mesh;
                let anchor_from_mesh =
                    Affine { translation: world_from_mesh.translation - anchor.coords, ..world_from_mesh };
                let rows = &mut self.joint_rows[6 * (skin_at.first_joint + joint)..][..6];
                rows[..3].copy_from_slice(&rows_of(&anchor_from_mesh.linear, &anchor_from_mesh.translation));
                let normals = outward_normal_matrix(&anchor_from_mesh.linear);
                rows[3..].copy_from_slice(&rows_of(&normals, &nalgebra::Vector3::zeros()));
            }
        }
    }

    fn find_balls(&mut self, scene: &Scene, meshes: &Meshes) {
        for (ball, drawable) in self.balls.iter_mut().zip(&meshes.drawables) {
            *ball = match drawable.skin {
                None => {
                    let world_from_node = &self.world.world_from_node[drawable.node];
                    let scale = largest_scale(world_from_node);
                    (world_from_node.transform_point(&drawable.centre), scale * drawable.radius_m)
                }
                Some(at) => {
                    // Every vertex is a weighted mean of places inside the joints' balls.
                    let skin_at = &meshes.skins[at];
                    let skin = &scene.skins[skin_at.skin];
                    let balls = skin_at.reach.iter().zip(&skin.joints).zip(&skin.joint_from_mesh).filter_map(
                        |((reach, &node), joint_from_mesh)| {
                            let (centre, radius_m) = (*reach)?;
                            let world_from_mesh = self.world.world_from_node[node] * *joint_from_mesh;
                            let scale = largest_scale(&world_from_mesh);
                            Some((world_from_mesh.transform_point(&centre), scale * radius_m))
                        },
                    );
                    let anchor = self.anchors[at];
                    let reach = balls.map(|(centre, radius)| (centre - anchor).norm() + radius);
                    (anchor, reach.fold(0.0, f64::max))
                }
            };
        }
    }
}

/// The largest factor by which a length grows: exact for axes that stay perpendicular, else a little more
/// (Gershgorin's bound on the largest eigenvalue of AᵀA).
pub(crate) fn largest_scale(transform: &Affine) -> f64 {
    let square = transform.linear.transpose() * transform.linear;
    square.row_iter().map(|row| row.iter().map(|x| x.abs()).sum::<f64>()).fold(0.0, f64::max).sqrt()
}

/// Takes outward normals to outward normals, also through a mirror; scaled so that it fits into single precision.
pub(crate) fn outward_normal_matrix(linear: &nalgebra::Matrix3<f64>) -> nalgebra::Matrix3<f64> {
    let affine = Affine { linear: *linear, translation: nalgebra::Vector3::zeros() };
    let normals = affine.normal_matrix();
    let largest = normals.amax();
    let sign = if linear.determinant() < 0.0 { -1.0 } else { 1.0 };
    if largest > 0.0 && largest.is_finite() {
        normals * (sign / largest)
    } else {
        nalgebra::Matrix3::identity()
    }
}

/// Three rows of a shader's matrix; the one cast to single precision.
pub(crate) fn rows_of(linear: &nalgebra::Matrix3<f64>, offset: &nalgebra::Vector3<f64>) -> [[f32; 4]; 3] {
    [0, 1, 2].map(|r| [linear[(r, 0)] as f32, linear[(r, 1)] as f32, linear[(r, 2)] as f32, offset[r] as f32])
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};
    use vergence_geom::Trs;

    /// Normals under flattening and mirrors, as the shader gets them (single precision), within 1e-6 rad.
    #[test]
    fn normals_stay_within_a_microradian() {
        let rotation = UnitQuaternion::from_euler_angles(0.4, 1.3, -0.8);
        for scale in
            [Vector3::new(1.0, 1e-3, 1.0), Vector3::new(-1.0, 1.0, 1.0), Vector3::new(-2.0, -3.0, -1e-3)]
        {
            let linear = Trs { rotation, scale, ..Trs::identity() }.to_affine().linear;
            let rows = rows_of(&outward_normal_matrix(&linear), &Vector3::zeros());
            let inverse_transpose = linear.try_inverse().unwrap().transpose();
            for normal in
                [Vector3::new(1.0, 2.0, -0.5), Vector3::new(0.01, 1.0, 0.0), Vector3::new(0.0, 0.0, -1.0)]
            {
                let normal = normal.normalize();
                let n = normal.cast::<f32>();
                let found = Vector3::from(rows.map(|r| r[0] * n.x + r[1] * n.y + r[2] * n.z));
                let found = found.cast::<f64>().normalize();
                let truth = (inverse_transpose * normal).normalize();
                assert!(found.cross(&truth).norm() < 1e-6 && found.dot(&truth) > 0.0, "{scale} {normal}");
            }
        }
    }

    #[test]
    fn a_turn_and_a_scale_grow_lengths_by_the_scale() {
        let rotation = UnitQuaternion::from_euler_angles(0.4, 1.3, -0.8);
        let affine = Trs { rotation, scale: Vector3::new(2.0, 0.5, -3.0), ..Trs::identity() }.to_affine();
        assert!((largest_scale(&affine) - 3.0).abs() < 1e-12);
    }
}
