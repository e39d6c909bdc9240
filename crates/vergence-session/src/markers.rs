//! What shows the user that something can be touched: a ray from each hand that means something, a dot where it meets what
//! can be touched, and a frame around that, of another colour once it is taken.
//!
//! They are nodes of the scene that is drawn, never of the one that is pointed at. They follow from what the hands said and
//! from the time of the scene, so a replay draws them again. Where nothing can be touched there are none.

use std::sync::Arc;

use nalgebra::{Matrix3, Point3, Vector3};
use vergence_geom::{Affine, Rigid};
use vergence_render::Renderer;
use vergence_scene::Scene;
use vergence_scene::model::{
    Bounds, Local, Material, Mesh, Node, Primitive, Shading, Touchable, WorldTransforms,
};
use vergence_sense::Hand;

use crate::touch::Touching;

/// Thickness of a ray, metres.
const RAY_M: f64 = 0.003;
/// It begins so far ahead of the hand, metres: one that is aimed with the eyes does not begin in them.
const RAY_FROM_M: f64 = 0.1;
/// It ends here where it meets nothing that can be touched, metres.
const STUB_TO_M: f64 = 0.35;
/// Radius of a dot, seen from the hand, radians.
const DOT_RAD: f64 = 0.006;
/// Thickness of a frame's bars, as a part of the longest side of what it is around, within these metres.
const BAR: f64 = 0.015;
const BAR_M: (f64, f64) = (0.003, 0.02);
/// Length of a frame's corners, as a part of each side.
const CORNER: f64 = 0.25;
/// Colours, linear light: rays and dots, a frame, a frame around what is taken.
const RAY_COLOR: [f32; 4] = [0.4, 0.7, 1.0, 1.0];
const FRAME_COLOR: [f32; 4] = [1.0, 0.4, 0.0, 1.0];
const TAKEN_COLOR: [f32; 4] = [0.1, 0.9, 0.15, 1.0];

/// Rays and dots of both hands stand before the frames.
const OF_HANDS: usize = 4;

/// Where the markers are among the nodes of a scene that [`with_markers`] gave.
pub(crate) struct Markers {
    /// The first node: two rays, two dots, then two frames for each touchable.
    first: usize,
    touchables: usize,
}

/// The scene with the markers that a run shows, and with their materials; the very same scene where nothing can be touched.
/// The nodes that it had keep their places. Vertices are copied, once per run; images are shared.
pub fn with_markers(scene: &Arc<Scene>) -> Arc<Scene> {
    if scene.touchables.is_empty() {
        return Arc::clone(scene);
    }
    let mut marked = Scene::clone(scene);
    let first_material = marked.materials.len();
    for (name, base_color) in [("ray", RAY_COLOR), ("frame", FRAME_COLOR), ("taken", TAKEN_COLOR)] {
        let shading = Shading::Unlit;
        marked.materials.push(Material { name: name.into(), shading, base_color, ..Material::default() });
    }
    let mut add = |name: &str, parent, primitive| {
        marked.meshes.push(Mesh { name: name.into(), primitives: vec![primitive] });
        let mesh = Some(marked.meshes.len() - 1);
        marked.nodes.push(Node { parent, mesh, ..Node::at(name, Local::Matrix(Affine::identity())) });
    };
    let of = |material: usize| Primitive { material: first_material + material, ..Primitive::default() };
    for hand in Hand::BOTH {
        let mut ray = of(0);
        // One metre along −z.
        cuboid(&mut ray, &Point3::new(0.0, 0.0, -0.5), &Vector3::new(RAY_M, RAY_M, 1.0));
        add(&format!("{hand} ray"), None, ray);
    }
    for hand in Hand::BOTH {
        let mut dot = of(0);
        octahedron(&mut dot);
        add(&format!("{hand} dot"), None, dot);
    }
    let world = WorldTransforms::at_rest(scene);
    for Touchable { name, node } in &scene.touchables {
        let bounds = bounds_below(scene, &world, *node);
        let metres = world.world_from_node[*node].linear.determinant().abs().cbrt();
        for material in [1, 2] {
            let mut frame = of(material);
            corners(&mut frame, &bounds, metres);
            add(name, Some(*node), frame);
        }
    }
    Arc::new(marked)
}

impl Markers {
    /// Of what [`with_markers`] makes of `scene`, on its renderer, none shown. `None` where nothing can be touched.
    pub(crate) fn new(scene: &Scene, renderer: &mut Renderer) -> Option<Self> {
        let markers = Self { first: scene.nodes.len(), touchables: scene.touchables.len() };
        let nodes = markers.first..markers.first + OF_HANDS + 2 * markers.touchables;
        if markers.touchables == 0 {
            return None;
        }
        nodes.for_each(|node| renderer.show(node, false));
        Some(markers)
    }

    /// Shows what the hands do, from the next frame on.
    pub(crate) fn follow(&self, renderer: &mut Renderer, touching: &Touching) {
        for hand in Hand::BOTH {
            self.point(renderer, hand, touching.aim(hand), touching.distance_m(hand));
        }
        let around = |of: &dyn Fn(Hand) -> Option<usize>| Hand::BOTH.map(of);
        let (pointed, held) = (around(&|hand| touching.pointed(hand)), around(&|hand| touching.held(hand)));
        for touchable in 0..self.touchables {
            let node = self.first + OF_HANDS + 2 * touchable;
            let is_held = held.contains(&Some(touchable));
            renderer.show(node, !is_held && pointed.contains(&Some(touchable)));
            renderer.show(node + 1, is_held);
        }
    }

    /// Shows where a hand points: nothing where it does not.
    fn point(&self, renderer: &mut Renderer, hand: Hand, aim: Option<&Rigid>, distance_m: Option<f64>) {
        let (ray, dot) = (self.first + hand.index(), self.first + 2 + hand.index());
        let length = distance_m.unwrap_or(STUB_TO_M) - RAY_FROM_M;
        renderer.show(ray, aim.is_some() && length > 0.0);
        renderer.show(dot, aim.is_some() && distance_m.is_some());
        let Some(world_from_aim) = aim else { return };
        let along = |at_m: f64, size: Vector3<f64>| {
            let mut place = Affine::from(world_from_aim * Rigid::translation(0.0, 0.0, -at_m));
            place.linear *= Matrix3::from_diagonal(&size);
            place
        };
        if length > 0.0 {
            renderer.place(ray, &along(RAY_FROM_M, Vector3::new(1.0, 1.0, length)));
        }
        if let Some(distance_m) = distance_m.filter(|distance_m| *distance_m > 0.0) {
            renderer.place(dot, &along(distance_m, Vector3::repeat(DOT_RAD * distance_m)));
        }
    }
}

/// The box around what stands at `top` and below it (skinned meshes in bind pose by their node), in its own coordinates.
fn bounds_below(scene: &Scene, world: &WorldTransforms, top: usize) -> Bounds {
    let mut bounds = Bounds::EMPTY;
    let Some(top_from_world) = world.world_from_node[top].try_inverse() else { return bounds };
    let mut is_below = vec![false; scene.nodes.len()];
    for (index, node) in scene.nodes.iter().enumerate() {
        // Parents stand before their children.
        is_below[index] = index == top || node.parent.is_some_and(|parent| is_below[parent]);
        let Some(mesh) = node.mesh.filter(|_| is_below[index]) else { continue };
        let top_from_node = top_from_world * world.world_from_node[index];
        for position in scene.meshes[mesh].primitives.iter().flat_map(|primitive| &primitive.positions) {
            bounds.add(&top_from_node.transform_point(&Vector3::from(*position).cast::<f64>().into()));
        }
    }
    bounds
}

/// The corners of a box, three bars each; `metres` is the length of its unit.
fn corners(primitive: &mut Primitive, bounds: &Bounds, metres: f64) {
    if bounds.is_empty() || !metres.is_normal() {
        return;
    }
    let longest = (bounds.max - bounds.min).max();
    let bar = (BAR * longest * metres).clamp(BAR_M.0, BAR_M.1) / metres;
    let grown = Vector3::repeat(1.5 * bar);
    let (min, max) = (bounds.min - grown, bounds.max + grown);
    let length = (max - min) * CORNER;
    for corner in 0..8 {
        let is_far = |axis: usize| corner >> axis & 1 == 1;
        let at = Point3::from(Vector3::from_fn(|axis, _| if is_far(axis) { max[axis] } else { min[axis] }));
        for axis in 0..3 {
            let mut size = Vector3::repeat(bar);
            size[axis] = length[axis];
            let mut middle = at;
            middle[axis] += 0.5 * length[axis] * if is_far(axis) { -1.0 } else { 1.0 };
            cuboid(primitive, &middle, &size);
        }
    }
}

/// Appends a box.
fn cuboid(primitive: &mut Primitive, middle: &Point3<f64>, size: &Vector3<f64>) {
    const SIDES: [[u32; 4]; 6] =
        [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let first = primitive.positions.len() as u32;
    for corner in 0..8 {
        let out = Vector3::from_fn(|axis, _| if corner >> axis & 1 == 1 { 0.5 } else { -0.5 });
        vertex(primitive, &(middle.coords + size.component_mul(&out)), &out);
    }
    for [a, b, c, d] in SIDES {
        primitive.indices.extend([a, b, c, a, c, d].map(|corner| first + corner));
    }
}

/// Appends the octahedron of radius 1.
fn octahedron(primitive: &mut Primitive) {
    let first = primitive.positions.len() as u32;
    for axis in 0..3 {
        for sign in [1.0, -1.0] {
            let out = Vector3::from_fn(|k, _| if k == axis { sign } else { 0.0 });
            vertex(primitive, &out, &out);
        }
    }
    for octant in 0..8u32 {
        let [x, y, z] = [0, 1, 2].map(|axis| first + 2 * axis + (octant >> axis & 1));
        let is_mirrored = octant.count_ones() % 2 == 1;
        primitive.indices.extend(if is_mirrored { [x, z, y] } else { [x, y, z] });
    }
}

fn vertex(primitive: &mut Primitive, at: &Vector3<f64>, out: &Vector3<f64>) {
    primitive.positions.push(at.cast::<f32>().into());
    primitive.normals.push(out.normalize().cast::<f32>().into());
}

#[cfg(test)]
mod tests {
    use vergence_scene::model::Image;

    use super::*;

    fn boxed(middle: Point3<f64>, size: Vector3<f64>) -> Scene {
        let mut primitive = Primitive::default();
        cuboid(&mut primitive, &middle, &size);
        let mut scene = Scene {
            meshes: vec![Mesh { name: String::new(), primitives: vec![primitive] }],
            materials: vec![Material::default()],
            ..Scene::default()
        };
        scene.nodes.push(Node::at("top", Local::Matrix(Affine::identity())));
        let below = Node::at("it", Local::Matrix(Affine::identity()));
        scene.nodes.push(Node { parent: Some(0), mesh: Some(0), ..below });
        scene
    }

    #[test]
    fn a_scene_where_nothing_can_be_touched_is_the_same_scene() {
        let scene = Arc::new(boxed(Point3::origin(), Vector3::repeat(1.0)));
        assert!(Arc::ptr_eq(&with_markers(&scene), &scene));
    }

    #[test]
    fn frames_are_around_what_can_be_touched_and_move_with_it() {
        let size = [0.2, 0.4, 0.6];
        let mut scene = boxed(Point3::new(1.0, 2.0, 3.0), Vector3::from(size));
        scene.touchables.push(Touchable { name: "it".into(), node: 0 });
        let rgba = vec![255; 4];
        scene.images.push(Arc::new(Image { name: "white".into(), width: 1, height: 1, rgba }));
        let scene = Arc::new(scene);
        let marked = with_markers(&scene);
        assert!(Arc::ptr_eq(&marked.images[0], &scene.images[0]), "a picture was copied");
        assert_eq!(marked.nodes.len(), scene.nodes.len() + OF_HANDS + 2);
        for frame in &marked.nodes[scene.nodes.len() + OF_HANDS..] {
            assert_eq!(frame.parent, Some(0));
            let mut around = Bounds::EMPTY;
            for position in &marked.meshes[frame.mesh.unwrap()].primitives[0].positions {
                around.add(&Vector3::from(*position).cast::<f64>().into());
            }
            let found = around.max - around.min;
            assert!((around.centre() - Point3::new(1.0, 2.0, 3.0)).norm() < 1e-6, "{around:?}");
            assert!((0..3).all(|axis| (1.0..1.3).contains(&(found[axis] / size[axis]))), "{found}");
        }
    }

    /// Backs are not drawn: every side must face outwards.
    #[test]
    fn solids_are_seen_from_outside() {
        let (mut solid, mut dot) = (Primitive::default(), Primitive::default());
        cuboid(&mut solid, &Point3::origin(), &Vector3::new(1.0, 2.0, 3.0));
        octahedron(&mut dot);
        for (primitive, triangles) in [(&solid, 12), (&dot, 8)] {
            assert_eq!(primitive.indices.len(), 3 * triangles);
            for triangle in primitive.indices.chunks_exact(3) {
                let [a, b, c] = [0, 1, 2].map(|k| Vector3::from(primitive.positions[triangle[k] as usize]));
                assert!((b - a).cross(&(c - a)).dot(&(a + b + c)) > 0.0, "{triangle:?}");
            }
        }
    }
}
