//! The box around a scene as it is seen at rest.

use nalgebra::{Point3, Vector3};

use crate::model::{Bounds, Scene, WorldTransforms};

impl Scene {
    /// The box around all vertices at rest, skinned ones where their joints put them, metres. O(vertices).
    pub fn posed_bounds(&self) -> Bounds {
        let world = WorldTransforms::at_rest(self);
        let mut bounds = Bounds::EMPTY;
        for (node, world_from_node) in self.nodes.iter().zip(&world.world_from_node) {
            let Some(mesh) = node.mesh else { continue };
            for primitive in &self.meshes[mesh].primitives {
                let skin = node.skin.filter(|_| !primitive.joints.is_empty()).map(|skin| &self.skins[skin]);
                for (index, position) in primitive.positions.iter().enumerate() {
                    let position = Point3::from(Vector3::from(*position).cast::<f64>());
                    let Some(skin) = skin else {
                        bounds.add(&world_from_node.transform_point(&position));
                        continue;
                    };
                    let mut placed = Vector3::zeros();
                    for (&joint, weight) in primitive.joints[index].iter().zip(primitive.weights[index]) {
                        let joint = usize::from(joint);
                        let world_from_mesh =
                            world.world_from_node[skin.joints[joint]] * skin.joint_from_mesh[joint];
                        placed += world_from_mesh.transform_point(&position).coords * f64::from(weight);
                    }
                    bounds.add(&Point3::from(placed));
                }
            }
        }
        bounds
    }
}
