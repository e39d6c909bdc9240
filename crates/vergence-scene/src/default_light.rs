//! Light for scenes that bring none.

use nalgebra::{UnitQuaternion, Vector3};
use vergence_geom::Trs;

use crate::Scene;
use crate::model::{Light, LightKind, Local, Node, Shading};

/// Where light comes from in a scene without lights: from the upper right, behind the viewer.
const TOWARDS_LIGHT: [f64; 3] = [1.0, 2.0, 1.5];
/// Its illuminance, lux.
const DIRECTIONAL_LUX: f32 = 2.0;
/// Irradiance from everywhere in a scene without lights.
const AMBIENT: f32 = 0.5;

impl Scene {
    /// Adds a directional light from `towards_light` (any length but 0) of `lux`, white.
    pub fn add_directional(&mut self, towards_light: [f64; 3], lux: f32) {
        let rotation = UnitQuaternion::rotation_between(&Vector3::z(), &Vector3::from(towards_light))
            .unwrap_or_else(|| UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0));
        self.lights.push(Light { color: [1.0; 3], intensity: lux, kind: LightKind::Directional });
        self.nodes.push(Node {
            name: "light".into(),
            parent: None,
            parent_from_node: Local::Trs(Trs { rotation, ..Trs::identity() }),
            mesh: None,
            skin: None,
            light: Some(self.lights.len() - 1),
            camera: None,
            label: None,
        });
    }

    /// Makes a scene visible that has surfaces to be lit but no light at all: one white directional light (2 lux,
    /// from the upper right) and ambient light (0.5). Says whether it did.
    pub fn light_if_dark(&mut self) -> bool {
        let has_light = self.ambient != [0.0; 3] || self.nodes.iter().any(|node| node.light.is_some());
        let shown =
            self.nodes.iter().filter_map(|node| node.mesh).flat_map(|mesh| &self.meshes[mesh].primitives);
        let lit = |primitive: &crate::model::Primitive| {
            self.materials.get(primitive.material).is_some_and(|m| m.shading != Shading::Unlit)
        };
        if has_light || !shown.into_iter().any(lit) {
            return false;
        }
        self.ambient = [AMBIENT; 3];
        self.add_directional(TOWARDS_LIGHT, DIRECTIONAL_LUX);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::WorldTransforms;

    #[test]
    fn a_directional_light_comes_from_where_it_was_asked_to() {
        for towards in [[1.0, 2.0, 1.5], [0.0, 0.0, -1.0], [0.0, -3.0, 0.0]] {
            let mut scene = Scene::default();
            scene.add_directional(towards, 1.0);
            let world = WorldTransforms::at_rest(&scene);
            let shines = world.world_from_node[0].linear * -Vector3::z();
            assert!((shines + Vector3::from(towards).normalize()).norm() < 1e-12, "{towards:?}");
        }
    }

    #[test]
    fn nothing_to_light_needs_no_light() {
        assert!(!Scene::default().light_if_dark());
    }
}
