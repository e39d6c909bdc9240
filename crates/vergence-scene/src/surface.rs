//! What files leave out: normals and tangents.

use std::collections::HashMap;

use nalgebra::Vector3;

use crate::model::Primitive;

/// Bytes that MikkTSpace takes for each triangle while it runs (measured: see the memory test).
pub(crate) const TANGENT_BYTES_PER_TRIANGLE: usize = 1000;

fn position(primitive: &Primitive, vertex: u32) -> Vector3<f64> {
    Vector3::from(primitive.positions[vertex as usize]).cast()
}

/// Twice the area times the normal of a triangle.
fn area_normal(primitive: &Primitive, triangle: &[u32]) -> Vector3<f64> {
    let a = position(primitive, triangle[0]);
    (position(primitive, triangle[1]) - a).cross(&(position(primitive, triangle[2]) - a))
}

/// A unit vector, or up where there is no direction (a triangle without area).
pub(crate) fn unit_or_up(vector: &Vector3<f64>) -> [f32; 3] {
    // Scaled first, so that neither tiny nor huge vectors leave the range of f64 when squared.
    let largest = vector.amax();
    if largest > 0.0 && largest.is_finite() {
        (vector / largest).normalize().cast().into()
    } else {
        [0.0, 1.0, 0.0]
    }
}

/// Gives each triangle its own three vertices and its geometric normal, as glTF asks for where normals are missing.
pub(crate) fn flat_normals(primitive: &mut Primitive) {
    fn spread<T: Copy>(values: &mut Vec<T>, indices: &[u32]) {
        if !values.is_empty() {
            *values = indices.iter().map(|&i| values[i as usize]).collect();
        }
    }
    let mut normals = Vec::with_capacity(primitive.indices.len());
    for triangle in primitive.indices.chunks_exact(3) {
        let normal = unit_or_up(&area_normal(primitive, triangle));
        normals.extend([normal; 3]);
    }
    let indices = std::mem::take(&mut primitive.indices);
    spread(&mut primitive.positions, &indices);
    spread(&mut primitive.uv0, &indices);
    spread(&mut primitive.uv1, &indices);
    spread(&mut primitive.colors, &indices);
    spread(&mut primitive.joints, &indices);
    spread(&mut primitive.weights, &indices);
    primitive.normals = normals;
    primitive.indices = (0..primitive.positions.len() as u32).collect();
}

/// Gives each vertex the mean normal of its triangles, weighted by their areas.
pub(crate) fn smooth_normals(primitive: &mut Primitive) {
    let mut sums = vec![Vector3::zeros(); primitive.positions.len()];
    for triangle in primitive.indices.chunks_exact(3) {
        let normal = area_normal(primitive, triangle);
        for &vertex in triangle {
            sums[vertex as usize] += normal;
        }
    }
    primitive.normals = sums.iter().map(unit_or_up).collect();
}

/// Makes given normals unit length; those without a direction get the mean normal of their triangles.
pub(crate) fn unit_normals(primitive: &mut Primitive) {
    let is_direction = |n: &[f32; 3]| n.iter().any(|c| *c != 0.0);
    if !primitive.normals.iter().all(is_direction) {
        let given = std::mem::take(&mut primitive.normals);
        smooth_normals(primitive);
        for (normal, given) in primitive.normals.iter_mut().zip(&given) {
            if is_direction(given) {
                *normal = *given;
            }
        }
    }
    for normal in &mut primitive.normals {
        *normal = unit_or_up(&Vector3::from(*normal).cast());
    }
}

struct Corners<'a> {
    primitive: &'a Primitive,
    uv: &'a [[f32; 2]],
    /// One per index.
    tangents: Vec<[f32; 4]>,
}

impl Corners<'_> {
    fn vertex(&self, face: usize, corner: usize) -> usize {
        self.primitive.indices[3 * face + corner] as usize
    }
}

impl bevy_mikktspace::Geometry for Corners<'_> {
    fn num_faces(&self) -> usize {
        self.primitive.indices.len() / 3
    }
    fn num_vertices_of_face(&self, _face: usize) -> usize {
        3
    }
    fn position(&self, face: usize, corner: usize) -> [f32; 3] {
        self.primitive.positions[self.vertex(face, corner)]
    }
    fn normal(&self, face: usize, corner: usize) -> [f32; 3] {
        self.primitive.normals[self.vertex(face, corner)]
    }
    fn tex_coord(&self, face: usize, corner: usize) -> [f32; 2] {
        // Its texture coordinates run upwards, glTF's downwards.
        let [u, v] = self.uv[self.vertex(face, corner)];
        [u, 1.0 - v]
    }
    fn set_tangent(&mut self, space: Option<bevy_mikktspace::TangentSpace>, face: usize, corner: usize) {
        if let Some(space) = space {
            self.tangents[3 * face + corner] = space.tangent_encoded();
        }
    }
}

/// Computes tangents by MikkTSpace for the texture coordinates of set `uv_set`; vertices whose triangles disagree
/// are split. Leaves none where there are no such coordinates.
pub(crate) fn tangents(primitive: &mut Primitive, uv_set: u8) {
    let uv = if uv_set == 0 { &primitive.uv0 } else { &primitive.uv1 };
    primitive.tangents.clear();
    if uv.is_empty() {
        return;
    }
    let mut corners =
        Corners { tangents: vec![[1.0, 0.0, 0.0, 1.0]; primitive.indices.len()], uv, primitive };
    if bevy_mikktspace::generate_tangents(&mut corners).is_err() {
        return;
    }
    let corners = corners.tangents;
    // A first tangent stays at its vertex; others get copies of it.
    let mut first: Vec<Option<[f32; 4]>> = vec![None; primitive.positions.len()];
    let mut copies: HashMap<(u32, [u32; 4]), u32> = HashMap::new();
    let mut originals = Vec::new();
    for (index, tangent) in primitive.indices.iter_mut().zip(corners) {
        let tangent = sound(tangent);
        let slot = &mut first[*index as usize];
        match slot {
            None => *slot = Some(tangent),
            Some(kept) if *kept == tangent => {}
            Some(_) => {
                let next = (primitive.positions.len() + originals.len()) as u32;
                let original = *index;
                *index = *copies.entry((original, tangent.map(f32::to_bits))).or_insert_with(|| {
                    originals.push((original as usize, tangent));
                    next
                });
            }
        }
    }
    primitive.tangents = first.into_iter().map(|t| t.unwrap_or([1.0, 0.0, 0.0, 1.0])).collect();
    fn copy<T: Copy>(values: &mut Vec<T>, originals: &[(usize, [f32; 4])]) {
        if !values.is_empty() {
            values.reserve_exact(originals.len());
            for &(original, _) in originals {
                values.push(values[original]);
            }
        }
    }
    copy(&mut primitive.positions, &originals);
    copy(&mut primitive.normals, &originals);
    copy(&mut primitive.uv0, &originals);
    copy(&mut primitive.uv1, &originals);
    copy(&mut primitive.colors, &originals);
    copy(&mut primitive.joints, &originals);
    copy(&mut primitive.weights, &originals);
    primitive.tangents.extend(originals.iter().map(|&(_, tangent)| tangent));
}

/// A tangent with finite numbers and unit length, whatever came.
pub(crate) fn sound([x, y, z, w]: [f32; 4]) -> [f32; 4] {
    let direction = Vector3::new(x, y, z).cast::<f64>();
    let [x, y, z] = if direction.iter().any(|c| *c != 0.0) && direction.iter().all(|c| c.is_finite()) {
        unit_or_up(&direction)
    } else {
        [1.0, 0.0, 0.0]
    };
    [x, y, z, if w < 0.0 { -1.0 } else { 1.0 }]
}
