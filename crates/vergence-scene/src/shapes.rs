//! Simple solids: what a scene file says without a model. Texture coordinates are in metres, so that a material's
//! pattern has a size.

use std::f32::consts::TAU;

use crate::model::Primitive;
use crate::surface::{self, Smoothing};

/// A box with its middle at the origin; `size` in metres.
pub fn cuboid(size: [f32; 3]) -> Primitive {
    let half = size.map(|s| 0.5 * s);
    let mut primitive = Primitive::default();
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for sign in [1.0, -1.0] {
            let corner = |a: f32, b: f32| {
                let mut position = [0.0; 3];
                position[axis] = sign * half[axis];
                position[u] = sign * a * half[u];
                position[v] = b * half[v];
                position
            };
            let mut normal = [0.0; 3];
            normal[axis] = sign;
            // Upright on the sides: u runs to the right, v down, as seen from outside.
            let (right, up) = match axis {
                0 => (2, 1),
                1 => (0, 2),
                _ => (0, 1),
            };
            let corners = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
            add_quad(&mut primitive, corners, normal, |p| [p[right], -p[up]]);
        }
    }
    primitive
}

/// A rectangle in the x-y plane, seen from +z; metres.
pub fn rectangle(width: f32, height: f32) -> Primitive {
    let (x, y) = (0.5 * width, 0.5 * height);
    let mut primitive = Primitive::default();
    add_quad(
        &mut primitive,
        [[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]],
        [0.0, 0.0, 1.0],
        |p| [p[0] + x, y - p[1]],
    );
    primitive
}

fn add_quad(
    primitive: &mut Primitive,
    corners: [[f32; 3]; 4],
    normal: [f32; 3],
    uv: impl Fn([f32; 3]) -> [f32; 2],
) {
    let base = primitive.positions.len() as u32;
    primitive.positions.extend(corners);
    primitive.normals.extend([normal; 4]);
    primitive.uv0.extend(corners.map(uv));
    primitive.indices.extend([0, 1, 2, 0, 2, 3].map(|i| base + i));
}

/// What `profile` (distance from the axis and height, metres; from bottom to top on the outside) sweeps about the y
/// axis. Edges sharper than the angle at which shading is smoothed stay edges.
pub fn lathe(profile: &[[f32; 2]], segments: u32) -> Primitive {
    let mut primitive = Primitive::default();
    // The point that a vertex stands on: the seam's two ends are one, as is each end on the axis.
    let mut point = Vec::new();
    let (mut along, mut before) = (0.0f32, None::<[f32; 2]>);
    let widest = profile.iter().fold(0.0f32, |a, p| a.max(p[0]));
    for (ring, &[radius, height]) in profile.iter().enumerate() {
        along += before.map_or(0.0, |[r, h]| (radius - r).hypot(height - h));
        before = Some([radius, height]);
        for step in 0..=segments {
            let angle = step as f32 / segments as f32;
            let (sin, cos) = (angle * TAU).sin_cos();
            primitive.positions.push([radius * sin, height, radius * cos]);
            primitive.uv0.push([angle * TAU * widest, -along]);
            let on_axis = radius == 0.0;
            point.push(ring as u32 * segments + if on_axis { 0 } else { step % segments });
        }
    }
    let stride = segments + 1;
    for ring in 0..profile.len().saturating_sub(1) as u32 {
        for step in 0..segments {
            let low = ring * stride + step;
            let (a, b, c, d) = (low, low + 1, low + 1 + stride, low + stride);
            if profile[ring as usize][0] != 0.0 {
                primitive.indices.extend([a, b, c]);
            }
            if profile[ring as usize + 1][0] != 0.0 {
                primitive.indices.extend([a, c, d]);
            }
        }
    }
    surface::creased_normals(&mut primitive, &point, |_| Smoothing::ByAngle);
    primitive
}

/// The profile of a ball; metres.
pub fn sphere(radius: f32, segments: u32) -> Primitive {
    let rings = (segments / 2).max(3);
    let profile: Vec<[f32; 2]> = (0..=rings)
        .map(|i| {
            let (sin, cos) = (i as f32 / rings as f32 * 0.5 * TAU).sin_cos();
            // Exactly on the axis at the poles.
            [if i == 0 || i == rings { 0.0 } else { radius * sin }, -radius * cos]
        })
        .collect();
    let mut primitive = lathe(&profile, segments);
    for (normal, position) in primitive.normals.iter_mut().zip(&primitive.positions) {
        *normal = position.map(|p| p / radius);
    }
    primitive
}

/// The profile of a cylinder that stands on y = 0; metres.
pub fn cylinder(radius: f32, height: f32, segments: u32) -> Primitive {
    lathe(&[[0.0, 0.0], [radius, 0.0], [radius, height], [0.0, height]], segments)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    /// The volume that the triangles enclose, by the divergence theorem: positive where they face outwards.
    fn volume(primitive: &Primitive) -> f64 {
        let at = |i: u32| Vector3::from(primitive.positions[i as usize]).cast::<f64>();
        primitive.indices.chunks_exact(3).map(|t| at(t[0]).dot(&at(t[1]).cross(&at(t[2]))) / 6.0).sum()
    }

    #[test]
    fn solids_are_closed_and_face_outwards() {
        assert!((volume(&cuboid([1.0, 2.0, 3.0])) - 6.0).abs() < 1e-6);
        let ball = 4.0 / 3.0 * std::f64::consts::PI * 8.0;
        assert!((volume(&sphere(2.0, 128)) / ball - 1.0).abs() < 2e-3);
        assert!((volume(&cylinder(1.0, 2.0, 256)) / std::f64::consts::TAU - 1.0).abs() < 1e-3);
        for primitive in
            [cuboid([1.0, 2.0, 3.0]), sphere(2.0, 32), cylinder(1.0, 2.0, 32), rectangle(1.0, 2.0)]
        {
            for triangle in primitive.indices.chunks_exact(3) {
                let at = |i: u32| Vector3::from(primitive.positions[i as usize]);
                let face = (at(triangle[1]) - at(triangle[0])).cross(&(at(triangle[2]) - at(triangle[0])));
                for &corner in triangle {
                    let normal = Vector3::from(primitive.normals[corner as usize]);
                    assert!(normal.dot(&face) > 0.0 && (normal.norm() - 1.0).abs() < 1e-5);
                }
            }
        }
    }

    #[test]
    fn a_cylinder_keeps_its_edges_and_is_round() {
        let primitive = cylinder(1.0, 2.0, 64);
        for (position, normal) in primitive.positions.iter().zip(&primitive.normals) {
            let radial = Vector3::new(position[0], 0.0, position[2]);
            let normal = Vector3::from(*normal);
            let is_cap = normal.y.abs() > 0.999;
            let is_side = normal.y.abs() < 1e-3 && (radial.norm() < 1e-6 || normal.dot(&radial) > 0.99);
            assert!(is_cap || is_side, "{position:?} {normal:?}");
        }
    }
}
