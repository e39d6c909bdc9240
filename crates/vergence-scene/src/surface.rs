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
    let corners = corners.tangents.into_iter().map(sound).collect::<Vec<_>>();
    primitive.tangents = split(primitive, &corners, [1.0, 0.0, 0.0, 1.0]);
}

/// Gives vertices their corners' values: a vertex whose corners disagree is split. `corners` holds one value per
/// index, the answer one per vertex; a vertex of no triangle gets `unused`.
fn split<const N: usize>(primitive: &mut Primitive, corners: &[[f32; N]], unused: [f32; N]) -> Vec<[f32; N]> {
    // A first value stays at its vertex; others get copies of it.
    let mut first: Vec<Option<[f32; N]>> = vec![None; primitive.positions.len()];
    let mut copies: HashMap<(u32, [u32; N]), u32> = HashMap::new();
    let mut originals = Vec::new();
    for (index, &value) in primitive.indices.iter_mut().zip(corners) {
        let slot = &mut first[*index as usize];
        match slot {
            None => *slot = Some(value),
            Some(kept) if *kept == value => {}
            Some(_) => {
                let next = (primitive.positions.len() + originals.len()) as u32;
                let original = *index;
                *index = *copies.entry((original, value.map(f32::to_bits))).or_insert_with(|| {
                    originals.push((original as usize, value));
                    next
                });
            }
        }
    }
    fn copy<T: Copy, V>(values: &mut Vec<T>, originals: &[(usize, V)]) {
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
    let values = first.into_iter().map(|value| value.unwrap_or(unused));
    values.chain(originals.iter().map(|&(_, value)| value)).collect()
}

/// Which triangles around a point share its normal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Smoothing {
    /// Those that meet at less than [`CREASE_DEG`]: the file does not say.
    ByAngle,
    /// None: each triangle is flat.
    Flat,
    /// Those of the same group.
    Group(u32),
}

/// Triangles that meet at a larger angle than this have an edge between them, where the file does not say.
const CREASE_DEG: f64 = 50.0;

/// Around a point with more triangles than this all share one normal: the comparison of each with each would take
/// too long.
const MOST_COMPARED: usize = 64;

/// Computes normals, weighted by area, and splits vertices along edges. `point` says for each vertex which point of
/// the file it stands on (vertices that differ in texture coordinates only share one); `smoothing` for each triangle
/// which others it goes with.
pub(crate) fn creased_normals(
    primitive: &mut Primitive,
    point: &[u32],
    smoothing: impl Fn(usize) -> Smoothing,
) {
    let triangles: Vec<Vector3<f64>> =
        primitive.indices.chunks_exact(3).map(|triangle| area_normal(primitive, triangle)).collect();
    let units: Vec<Vector3<f32>> = triangles.iter().map(|n| Vector3::from(unit_or_up(n))).collect();
    // Triangles of each point, one after the other.
    let points = point.iter().max().map_or(0, |&max| max as usize + 1);
    let mut starts = vec![0u32; points + 1];
    for &vertex in &primitive.indices {
        starts[point[vertex as usize] as usize + 1] += 1;
    }
    for i in 0..points {
        starts[i + 1] += starts[i];
    }
    let mut filled = starts.clone();
    let mut around = vec![0u32; primitive.indices.len()];
    for (corner, &vertex) in primitive.indices.iter().enumerate() {
        let slot = &mut filled[point[vertex as usize] as usize];
        around[*slot as usize] = (corner / 3) as u32;
        *slot += 1;
    }
    drop(filled);
    let crease = CREASE_DEG.to_radians().cos() as f32;
    let mut sums: HashMap<u32, Vector3<f64>> = HashMap::new();
    let corners: Vec<[f32; 3]> = primitive
        .indices
        .iter()
        .enumerate()
        .map(|(corner, &vertex)| {
            let (own, point) = (corner / 3, point[vertex as usize]);
            let neighbours = &around[starts[point as usize] as usize..starts[point as usize + 1] as usize];
            let own_smoothing = smoothing(own);
            if own_smoothing == Smoothing::Flat {
                return units[own].into();
            }
            if neighbours.len() > MOST_COMPARED {
                let all = || neighbours.iter().map(|&t| triangles[t as usize]).sum();
                return unit_or_up(sums.entry(point).or_insert_with(all));
            }
            let goes_along = |&&other: &&u32| {
                smoothing(other as usize) == own_smoothing
                    && (own_smoothing != Smoothing::ByAngle
                        || units[own].dot(&units[other as usize]) >= crease)
            };
            let sum: Vector3<f64> =
                neighbours.iter().filter(goes_along).map(|&t| triangles[t as usize]).sum();
            if sum == Vector3::zeros() { units[own].into() } else { unit_or_up(&sum) }
        })
        .collect();
    primitive.normals = split(primitive, &corners, [0.0, 1.0, 0.0]);
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
