//! Picking: where a ray first meets the scene.
//!
//! Each mesh has one tree of boxes in its own coordinates, whatever places it. Rays are brought to the mesh, and
//! triangles are met, in `f64` by the watertight test of Woop, Benthin and Wald (JCGT 2013): a ray never slips between
//! two triangles that share an edge, however far from the origin the world is. Both sides of a surface are met.
//! Skinned meshes are met where their node stands, in the bind pose.
//!
//! The tree is our own because it must be of the same accuracy: the crates that were measured lose rays at edges.

mod tree;

use nalgebra::Vector3;
use vergence_geom::{Affine, Ray};

use crate::model::{Mesh, Scene, WorldTransforms};

/// Where a ray meets a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Index into [`Scene::nodes`].
    pub node: usize,
    /// Index into [`Mesh::primitives`] of the node's mesh.
    pub primitive: usize,
    /// Which triangle of the primitive: its indices are `3 · triangle …`.
    pub triangle: usize,
    /// Weights of the triangle's three corners; not negative, their sum is 1.
    pub barycentric: [f64; 3],
    /// From the ray's origin, metres.
    pub distance_m: f64,
}

/// What is needed to find hits quickly; made once for a scene's meshes. Moving nodes do not change it.
pub struct Picker {
    /// One per [`Scene::meshes`]; `None` where there is nothing to hit.
    meshes: Vec<Option<MeshTree>>,
}

struct MeshTree {
    tree: tree::Tree,
    /// By the tree's order: primitive and triangle.
    triangles: Vec<(u32, u32)>,
    /// Of a ball around the mesh, mesh coordinates.
    centre: Vector3<f64>,
    radius: f64,
}

impl Picker {
    /// Builds the trees: O(triangles · log triangles).
    pub fn new(scene: &Scene) -> Self {
        let mut is_shown = vec![false; scene.meshes.len()];
        scene.nodes.iter().filter_map(|node| node.mesh).for_each(|mesh| is_shown[mesh] = true);
        let tree = |(mesh, is_shown)| if is_shown { MeshTree::new(mesh) } else { None };
        Self { meshes: scene.meshes.iter().zip(is_shown).map(tree).collect() }
    }

    /// The first surface of `scene` (the one that this was made for) that `ray` meets within `within_m` metres, with
    /// the nodes where `world` says. A node whose transform is singular is not met.
    pub fn pick(&self, scene: &Scene, world: &WorldTransforms, ray: &Ray, within_m: f64) -> Option<Hit> {
        let mut nearest: Option<Hit> = None;
        for (index, (node, world_from_node)) in scene.nodes.iter().zip(&world.world_from_node).enumerate() {
            let Some(mesh) = node.mesh else { continue };
            let Some(Some(tree)) = self.meshes.get(mesh) else { continue };
            let within = nearest.map_or(within_m, |hit| hit.distance_m);
            if let Some(hit) = tree.pick(&scene.meshes[mesh], world_from_node, ray, within) {
                nearest = Some(Hit { node: index, ..hit });
            }
        }
        nearest
    }
}

impl MeshTree {
    fn new(mesh: &Mesh) -> Option<Self> {
        let mut triangles: Vec<(u32, u32)> = Vec::new();
        let mut boxes = Vec::new();
        for (index, primitive) in mesh.primitives.iter().enumerate() {
            for (triangle, corners) in primitive.indices.chunks_exact(3).enumerate() {
                let corner = |i: usize| primitive.positions[corners[i] as usize];
                triangles.push((index as u32, triangle as u32));
                boxes.push(tree::Box3::around(&[corner(0), corner(1), corner(2)]));
            }
        }
        if triangles.is_empty() {
            return None;
        }
        let tree = tree::Tree::new(&boxes);
        let triangles = tree.order.iter().map(|&i| triangles[i as usize]).collect();
        let (centre, radius) = tree.ball();
        Some(Self { tree, triangles, centre, radius })
    }

    fn pick(&self, mesh: &Mesh, world_from_node: &Affine, ray: &Ray, within_m: f64) -> Option<Hit> {
        let node_from_world = world_from_node.try_inverse()?;
        let direction = node_from_world.linear * ray.direction.into_inner();
        // World metres along the ray for each unit of the mesh.
        let metres = 1.0 / direction.norm();
        let direction = direction.try_normalize(0.0)?;
        // Subtracting first keeps what matters where the world is far from its origin.
        let from_node = ray.origin.coords - world_from_node.translation;
        let origin = node_from_world.linear * from_node;
        // Bring the ray to the ball around the mesh.
        let along = (self.centre - origin).dot(&direction);
        let nearest_point = origin + direction * along;
        let is_past = along < -1.01 * self.radius;
        let misses = (nearest_point - self.centre).norm() > 1.01 * self.radius;
        if is_past || misses || !metres.is_finite() || !along.is_finite() {
            return None;
        }
        let start = (along - 1.01 * self.radius).max(0.0);
        let near = origin + direction * start;
        let woop = Woop::new(near, direction);
        let mut nearest: Option<Hit> = None;
        self.tree.traverse(&near, &direction, within_m / metres - start, |id, within| {
            let (primitive_index, triangle) = self.triangles[id];
            let primitive = &mesh.primitives[primitive_index as usize];
            let corners = std::array::from_fn(|corner| {
                let vertex = primitive.indices[3 * triangle as usize + corner] as usize;
                Vector3::from(primitive.positions[vertex]).cast::<f64>()
            });
            match woop.hit(&corners) {
                Some((t, barycentric)) if t >= 0.0 && t <= within => {
                    nearest = Some(Hit {
                        node: 0,
                        primitive: primitive_index as usize,
                        triangle: triangle as usize,
                        barycentric,
                        distance_m: (t + start) * metres,
                    });
                    t
                }
                _ => within,
            }
        });
        nearest
    }
}

/// A ray, sheared so that it runs along the third axis.
struct Woop {
    origin: Vector3<f64>,
    axes: [usize; 3],
    shear: [f64; 3],
}

impl Woop {
    fn new(origin: Vector3<f64>, direction: Vector3<f64>) -> Self {
        let z = direction.iamax();
        let (x, y) = ((z + 1) % 3, (z + 2) % 3);
        let axes = if direction[z] < 0.0 { [y, x, z] } else { [x, y, z] };
        let shear =
            [direction[axes[0]] / direction[z], direction[axes[1]] / direction[z], 1.0 / direction[z]];
        Self { origin, axes, shear }
    }

    /// Distance along the ray (negative behind its origin), in lengths of its direction, and barycentric weights.
    fn hit(&self, corners: &[Vector3<f64>; 3]) -> Option<(f64, [f64; 3])> {
        let [x, y, z] = self.axes;
        let [a, b, c] = corners.each_ref().map(|corner| {
            let p = corner - self.origin;
            [p[x] - self.shear[0] * p[z], p[y] - self.shear[1] * p[z], self.shear[2] * p[z]]
        });
        // Two triangles compute the same number, with opposite signs, for the edge that they share.
        let u = c[0] * b[1] - c[1] * b[0];
        let v = a[0] * c[1] - a[1] * c[0];
        let w = b[0] * a[1] - b[1] * a[0];
        if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
            return None;
        }
        let det = u + v + w;
        if det == 0.0 {
            return None;
        }
        let t = (u * a[2] + v * b[2] + w * c[2]) / det;
        t.is_finite().then_some((t, [u / det, v / det, w / det]))
    }
}

impl Scene {
    /// What can be touched that `node` belongs to: the nearest one on the way to the root; an index into
    /// [`Scene::touchables`].
    pub fn touchable_of(&self, node: usize) -> Option<usize> {
        let mut at = Some(node);
        while let Some(node) = at {
            if let Some(found) = self.touchables.iter().position(|touchable| touchable.node == node) {
                return Some(found);
            }
            at = self.nodes.get(node)?.parent;
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, UnitQuaternion, UnitVector3};
    use vergence_geom::Trs;

    use super::*;
    use crate::model::{Local, Node, Primitive, Touchable};
    use crate::shapes;

    fn node(trs: Trs, parent: Option<usize>, mesh: Option<usize>) -> Node {
        Node {
            name: String::new(),
            parent,
            parent_from_node: Local::Trs(trs),
            mesh,
            skin: None,
            light: None,
            camera: None,
            label: None,
        }
    }

    fn scene(primitive: Primitive, trs: Trs) -> Scene {
        Scene {
            nodes: vec![node(trs, None, None), node(Trs::identity(), Some(0), Some(0))],
            meshes: vec![Mesh { name: String::new(), primitives: vec![primitive] }],
            touchables: vec![Touchable { name: "ball".into(), node: 0 }],
            ..Scene::default()
        }
    }

    /// A deterministic stream of numbers, −1…1.
    fn numbers(seed: u64) -> impl FnMut() -> f64 {
        let mut state = seed;
        move || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            ((state >> 11) as f64 / (1u64 << 52) as f64) - 1.0
        }
    }

    fn toward(origin: Point3<f64>, target: Point3<f64>) -> Ray {
        Ray { origin, direction: UnitVector3::new_normalize(target - origin) }
    }

    /// Rays from inside of a closed surface, aimed at every vertex and at the middle of every edge: none gets out, at
    /// any size, any distance from the origin.
    #[test]
    fn a_closed_surface_has_no_leaks() {
        let mut leaks = 0;
        let mut rays = 0;
        for (scale, shift) in [(1.0, 0.0), (1e-6, 0.0), (1e6, 0.0), (1.0, 1e7), (0.01, 1e4)] {
            let trs = Trs {
                translation: Vector3::new(shift, -0.3 * shift, 0.7 * shift),
                rotation: UnitQuaternion::from_euler_angles(0.3, 0.2, 0.1),
                scale: Vector3::repeat(scale),
            };
            let scene = scene(shapes::sphere(1.0, 64), trs);
            let (picker, world) = (Picker::new(&scene), WorldTransforms::at_rest(&scene));
            let primitive = &scene.meshes[0].primitives[0];
            let place = |p: Vector3<f64>| world.world_from_node[1].transform_point(&p.into());
            let at = |i: u32| Vector3::from(primitive.positions[i as usize]).cast::<f64>();
            for origin in [Vector3::new(0.1, 0.2, 0.05), Vector3::new(-0.4, 0.01, 0.3)] {
                for t in primitive.indices.chunks_exact(3) {
                    for target in [at(t[0]), (at(t[0]) + at(t[1])) * 0.5, (at(t[1]) + at(t[2])) * 0.5] {
                        let ray = toward(place(origin), place(target));
                        leaks += usize::from(picker.pick(&scene, &world, &ray, f64::INFINITY).is_none());
                        rays += 1;
                    }
                }
            }
        }
        assert!(rays > 50_000);
        assert_eq!(leaks, 0, "of {rays}");
    }

    #[test]
    fn the_nearest_of_all_triangles_is_found() {
        let trs = Trs {
            translation: Vector3::new(0.5, -1.0, 2.0),
            rotation: UnitQuaternion::from_euler_angles(1.0, 0.2, -0.4),
            scale: Vector3::new(2.0, -0.5, 1.0),
        };
        let scene = scene(shapes::lathe(&[[0.0, 0.0], [1.0, 0.1], [0.3, 0.5], [0.8, 1.0]], 24), trs);
        let (picker, world) = (Picker::new(&scene), WorldTransforms::at_rest(&scene));
        let primitive = &scene.meshes[0].primitives[0];
        let mut random = numbers(1);
        let mut point = |size: f64| Point3::new(random() * size, random() * size, random() * size);
        let mut hits = 0;
        for _ in 0..2000 {
            let ray = toward(point(5.0), world.world_from_node[1].transform_point(&point(0.8)));
            let woop = Woop::new(ray.origin.coords, ray.direction.into_inner());
            let truth = primitive
                .indices
                .chunks_exact(3)
                .filter_map(|t| {
                    let at = |i: u32| Point3::from(primitive.positions[i as usize]).cast::<f64>();
                    let corner = |i: u32| world.world_from_node[1].transform_point(&at(i)).coords;
                    woop.hit(&[corner(t[0]), corner(t[1]), corner(t[2])])
                })
                .map(|(t, _)| t)
                .filter(|t| *t >= 0.0)
                .fold(f64::INFINITY, f64::min);
            let found = picker.pick(&scene, &world, &ray, f64::INFINITY);
            match found {
                None => assert!(truth.is_infinite(), "missed a hit at {truth}"),
                Some(hit) => {
                    hits += 1;
                    assert!((hit.distance_m - truth).abs() < 1e-9, "{} {truth}", hit.distance_m);
                    // The weights lead to the same point.
                    let triangle = &primitive.indices[3 * hit.triangle..3 * hit.triangle + 3];
                    let at = |i: u32| Vector3::from(primitive.positions[i as usize]).cast::<f64>();
                    let point: Vector3<f64> =
                        triangle.iter().zip(hit.barycentric).map(|(&i, w)| at(i) * w).sum();
                    let point = world.world_from_node[1].transform_point(&point.into());
                    assert!((point - ray.at(hit.distance_m)).norm() < 1e-9);
                    assert_eq!(scene.touchable_of(hit.node), Some(0));
                    assert_eq!(picker.pick(&scene, &world, &ray, 0.999 * truth), None);
                }
            }
        }
        assert!(hits > 500, "{hits}");
    }

    /// Row 6 of the extremes: rays that lie in the faces of boxes.
    #[test]
    fn rays_along_axes_and_in_faces_are_not_lost() {
        let scene = scene(shapes::rectangle(2.0, 2.0), Trs::identity());
        let (picker, world) = (Picker::new(&scene), WorldTransforms::at_rest(&scene));
        for x in [-1.0f64, -0.5, 0.0, 0.5, 1.0] {
            for y in [-1.0f64, 0.0, 1.0] {
                for tiny in [0.0, -0.0, 1e-310] {
                    if tiny > 0.0 && (x.abs() == 1.0 || y.abs() == 1.0) {
                        // Such a ray really passes by, if only by 3e-310 m.
                        continue;
                    }
                    let ray = Ray {
                        origin: Point3::new(x, y, 3.0),
                        direction: UnitVector3::new_unchecked(Vector3::new(tiny, -tiny, -1.0)),
                    };
                    let hit = picker.pick(&scene, &world, &ray, f64::INFINITY);
                    assert!(
                        hit.is_some_and(|hit| (hit.distance_m - 3.0).abs() < 1e-12),
                        "{x} {y} {tiny:e}: {hit:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn what_cannot_be_hit_is_not() {
        let flat = Trs { scale: Vector3::new(1.0, 0.0, 1.0), ..Trs::identity() };
        for scene in [Scene::default(), scene(shapes::sphere(1.0, 8), flat)] {
            let (picker, world) = (Picker::new(&scene), WorldTransforms::at_rest(&scene));
            let ray = toward(Point3::new(0.0, 5.0, 0.0), Point3::origin());
            assert_eq!(picker.pick(&scene, &world, &ray, f64::INFINITY), None);
        }
    }
}
