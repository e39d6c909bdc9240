//! What can be touched, found by rays.

use std::sync::Arc;

use vergence_geom::Ray;
use vergence_scene::Scene;
use vergence_scene::model::WorldTransforms;
use vergence_scene::pick::Picker;

/// How far away something can be pointed at, metres.
const REACH_M: f64 = 20.0;

/// Finds what a ray points at, with everything where it is at rest.
pub(crate) struct Targets {
    scene: Arc<Scene>,
    picker: Picker,
    world: WorldTransforms,
}

impl Targets {
    /// `None` where nothing can be touched.
    pub(crate) fn new(scene: &Arc<Scene>) -> Option<Self> {
        (!scene.touchables.is_empty()).then(|| Self {
            scene: Arc::clone(scene),
            picker: Picker::new(scene),
            world: WorldTransforms::at_rest(scene),
        })
    }

    /// What logs call it.
    pub(crate) fn name(&self, target: usize) -> &str {
        &self.scene.touchables[target].name
    }

    /// What the first surface along the ray belongs to, where that can be touched; its place among the scene's touchables.
    pub(crate) fn hit(&self, ray: &Ray) -> Option<usize> {
        let hit = self.picker.pick(&self.scene, &self.world, ray, REACH_M)?;
        self.scene.touchable_of(hit.node)
    }
}
