//! The lights of a scene as the shader reads them: one formula for all kinds.

use nalgebra::{Isometry3, Point3, Vector3};
use vergence_geom::Affine;
use vergence_scene::model::{Light, LightKind};

/// `Light` of surface.wgsl, head coordinates.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub(crate) struct PackedLight {
    position: [f32; 4],
    color: [f32; 4],
    axis: [f32; 4],
    cone: [f32; 4],
}

/// Packs a light that stands at `world_from_node`, as seen by a head at `world_from_head`. The subtraction happens
/// in double precision.
pub(crate) fn pack(light: &Light, world_from_node: &Affine, head_from_world: &Isometry3<f64>) -> PackedLight {
    // A light shines along −z of its node, whatever the node's scale.
    let shines = world_from_node.linear * -Vector3::z();
    let shines = head_from_world.rotation * shines.try_normalize(0.0).unwrap_or(-Vector3::z());
    let place = head_from_world * Point3::from(world_from_node.translation);
    let (position, window, cone_scale, cone_offset) = match light.kind {
        LightKind::Directional => ((-shines).push(0.0), 0.0, 0.0, 1.0),
        LightKind::Point { range_m } => (place.coords.push(1.0), inverse_square(range_m), 0.0, 1.0),
        LightKind::Spot { range_m, inner_rad, outer_rad } => {
            // KHR_lights_punctual: (cos θ − cos outer) / (cos inner − cos outer), held in 0…1, squared.
            let (inner, outer) = (f64::from(inner_rad).cos(), f64::from(outer_rad).cos());
            let scale = 1.0 / (inner - outer).max(1e-3);
            (place.coords.push(1.0), inverse_square(range_m), scale, -outer * scale)
        }
    };
    let [r, g, b] = light.color.map(|c| c * light.intensity);
    PackedLight {
        position: position.cast::<f32>().into(),
        color: [r, g, b, window],
        axis: shines.push(cone_scale).cast::<f32>().into(),
        cone: [cone_offset as f32, 0.0, 0.0, 0.0],
    }
}

fn inverse_square(range_m: Option<f32>) -> f32 {
    range_m.filter(|r| *r > 0.0).map_or(0.0, |r| (1.0 / (f64::from(r) * f64::from(r))) as f32)
}
