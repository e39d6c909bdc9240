//! What can be touched, found by rays.
//!
//! Things are met where animated nodes bring them now. Skinned meshes are met in their bind pose, where their node stands: the
//! joints that move their vertices are followed on the GPU only.

use std::sync::Arc;

use vergence_geom::Ray;
use vergence_scene::Scene;
use vergence_scene::model::{Local, WorldTransforms};
use vergence_scene::pick::Picker;
use vergence_time::Span;

/// How far away something can be pointed at, metres.
const REACH_M: f64 = 20.0;

/// Finds what a ray points at.
pub(crate) struct Targets {
    scene: Arc<Scene>,
    picker: Picker,
    world: WorldTransforms,
    locals: Vec<Local>,
}

impl Targets {
    /// `None` where nothing can be touched.
    pub(crate) fn new(scene: &Arc<Scene>) -> Option<Self> {
        (!scene.touchables.is_empty()).then(|| Self {
            scene: Arc::clone(scene),
            picker: Picker::new(scene),
            world: WorldTransforms::at_rest(scene),
            locals: Vec::with_capacity(scene.nodes.len()),
        })
    }

    /// What logs call it.
    pub(crate) fn name(&self, target: usize) -> &str {
        &self.scene.touchables[target].name
    }

    /// Moves everything to where it is `time` after the start of the scene's clips; nothing where none plays.
    pub(crate) fn move_to(&mut self, time: Span) {
        let Self { scene, world, locals, .. } = self;
        if !scene.playing.is_empty() {
            scene.animate(time, locals);
            world.update(scene, |node| locals[node].to_affine());
        }
    }

    /// What the first surface along the ray belongs to, where that can be touched: its place among the scene's
    /// touchables, and its distance in metres.
    pub(crate) fn hit(&self, ray: &Ray) -> Option<(usize, f64)> {
        let hit = self.picker.pick(&self.scene, &self.world, ray, REACH_M)?;
        Some((self.scene.touchable_of(hit.node)?, hit.distance_m))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Vector3};
    use vergence_geom::Trs;
    use vergence_scene::model::{Animation, Interpolation, Mesh, Node, Primitive, Touchable, Track, Values};

    /// A triangle that goes three metres to the right in a second.
    #[test]
    fn things_are_met_where_animation_has_brought_them() {
        let primitive = Primitive {
            positions: vec![[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]],
            indices: vec![0, 1, 2],
            ..Primitive::default()
        };
        let track = Track {
            node: 0,
            times_secs: vec![0.0, 2.0],
            interpolation: Interpolation::Linear,
            values: Values::Translation(vec![[0.0, 0.0, -2.0], [6.0, 0.0, -2.0]]),
        };
        let scene = Arc::new(Scene {
            nodes: vec![Node { mesh: Some(0), ..Node::at("it", Local::Trs(Trs::identity())) }],
            meshes: vec![Mesh { name: String::new(), primitives: vec![primitive] }],
            animations: vec![Animation { name: String::new(), tracks: vec![track] }],
            playing: vec![0],
            touchables: vec![Touchable { name: "it".into(), node: 0 }],
            ..Scene::default()
        });
        let mut targets = Targets::new(&scene).unwrap();
        let from = |x: f64| Ray { origin: Point3::new(x, 0.0, 0.0), direction: -Vector3::z_axis() };
        targets.move_to(Span::ZERO);
        assert_eq!((targets.hit(&from(0.0)), targets.hit(&from(3.0))), (Some((0, 2.0)), None));
        targets.move_to(Span::from_nanos(1_000_000_000));
        assert_eq!((targets.hit(&from(0.0)), targets.hit(&from(3.0))), (None, Some((0, 2.0))));
    }
}
