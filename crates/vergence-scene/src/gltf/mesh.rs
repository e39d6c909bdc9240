//! Meshes: attributes read, strips and fans turned into triangles, what is missing computed.

use super::accessor::Accessors;
use super::raw;
use crate::Error;
use crate::import::Import;
use crate::model::{Material, Mesh, Primitive};
use crate::surface;

pub(super) fn mesh(
    import: &mut Import<'_>,
    accessors: &Accessors<'_>,
    materials: &[Material],
    index: usize,
) -> Result<Mesh, Error> {
    let raw = &accessors.root.meshes[index];
    let mut primitives = Vec::with_capacity(raw.primitives.len());
    for (at, primitive) in raw.primitives.iter().enumerate() {
        let place = format!("meshes[{index}].primitives[{at}]");
        primitives.extend(self::primitive(import, accessors, materials, &place, primitive)?);
    }
    Ok(Mesh { name: raw.name.clone(), primitives })
}

fn primitive(
    import: &mut Import<'_>,
    accessors: &Accessors<'_>,
    materials: &[Material],
    place: &str,
    raw: &raw::Primitive,
) -> Result<Option<Primitive>, Error> {
    let path = accessors.path;
    if !raw.targets.is_empty() {
        import.warn("morph targets are not drawn yet: their meshes keep their base shape");
    }
    let mode = raw.mode.unwrap_or(4);
    match mode {
        0 => {
            import.warn("points are not drawn");
            return Ok(None);
        }
        1..=3 => {
            import.warn("lines are not drawn");
            return Ok(None);
        }
        4..=6 => {}
        _ => {
            return Err(Error::invalid(
                path,
                format!("{place}.mode"),
                format!("expected 0 to 6, found {mode}"),
            ));
        }
    }
    let attribute = |name: &str| raw.attributes.get(name).map(|&a| (a, format!("{place}.attributes.{name}")));
    let Some((positions, positions_place)) = attribute("POSITION") else {
        import.warn("primitives without positions are not drawn");
        return Ok(None);
    };
    let positions = accessors.floats::<3>(import, positions, &positions_place)?;
    let count = positions.len();
    if u32::try_from(count).is_err() {
        return Err(Error::invalid(
            path,
            positions_place,
            format!("expected fewer than 2^32 vertices, found {count}"),
        ));
    }
    let same_length = |name: &str, found: usize| {
        if found == count {
            return Ok(());
        }
        Err(Error::invalid(
            path,
            format!("{place}.attributes.{name}"),
            format!("expected {count} elements, as many as positions, found {found}"),
        ))
    };
    let mut primitive = Primitive { positions, ..Primitive::default() };
    if let Some((index, place)) = attribute("NORMAL") {
        primitive.normals = accessors.floats::<3>(import, index, &place)?;
        same_length("NORMAL", primitive.normals.len())?;
    }
    for (name, uv) in [("TEXCOORD_0", &mut primitive.uv0), ("TEXCOORD_1", &mut primitive.uv1)] {
        if let Some((index, place)) = attribute(name) {
            *uv = accessors.floats::<2>(import, index, &place)?;
            same_length(name, uv.len())?;
        }
    }
    if let Some((index, place)) = attribute("COLOR_0") {
        primitive.colors = if accessors.get(index, &place)?.kind == "VEC3" {
            let colors = accessors.floats::<3>(import, index, &place)?;
            import.charge(path, &place, colors.len(), size_of::<[f32; 4]>())?;
            colors.iter().map(|&[r, g, b]| [r, g, b, 1.0]).collect()
        } else {
            accessors.floats::<4>(import, index, &place)?
        };
        same_length("COLOR_0", primitive.colors.len())?;
    }
    influences(import, accessors, place, raw, &mut primitive)?;
    indices(import, accessors, place, raw, mode, &mut primitive)?;

    primitive.material = raw.material.unwrap_or(materials.len() - 1);
    // The last material is the default one, which no index of the file may name.
    if raw.material.is_some_and(|material| material + 1 >= materials.len()) {
        return Err(Error::invalid(
            path,
            format!("{place}.material"),
            format!("expected a material below {}, found {}", materials.len() - 1, primitive.material),
        ));
    }
    if primitive.indices.is_empty() {
        import.warn("primitives without a whole triangle are not drawn");
        return Ok(None);
    }
    shade(import, accessors, place, raw, &materials[primitive.material], &mut primitive)?;
    Ok(Some(primitive))
}

/// Joints and weights of all vertices.
type Influences = (Vec<[u16; 4]>, Vec<[f32; 4]>);

/// Up to four joints per vertex, the heaviest where a file gives eight, weights summing to one.
fn influences(
    import: &mut Import<'_>,
    accessors: &Accessors<'_>,
    place: &str,
    raw: &raw::Primitive,
    primitive: &mut Primitive,
) -> Result<(), Error> {
    let count = primitive.positions.len();
    let mut sets: Vec<Influences> = Vec::new();
    for set in 0..2 {
        let names = [format!("JOINTS_{set}"), format!("WEIGHTS_{set}")];
        let [joints, weights] = &names;
        let (Some(&j), Some(&w)) = (raw.attributes.get(joints), raw.attributes.get(weights)) else {
            break;
        };
        let joints = accessors.joints(import, j, &format!("{place}.attributes.{joints}"))?;
        let weights = accessors.floats::<4>(import, w, &format!("{place}.attributes.{weights}"))?;
        for (name, found) in names.iter().zip([joints.len(), weights.len()]) {
            if found != count {
                return Err(Error::invalid(
                    accessors.path,
                    format!("{place}.attributes.{name}"),
                    format!("expected {count} elements, as many as positions, found {found}"),
                ));
            }
        }
        sets.push((joints, weights));
    }
    if raw.attributes.contains_key("JOINTS_2") || sets.len() == 2 {
        import.warn("of more than four joints per vertex the four heaviest move it");
    }
    let mut sets = sets.into_iter();
    let Some((mut joints, mut weights)) = sets.next() else {
        return Ok(());
    };
    if let Some((more_joints, more_weights)) = sets.next() {
        for vertex in 0..count {
            let mut all: Vec<(f32, u16)> = Vec::with_capacity(8);
            all.extend(weights[vertex].into_iter().zip(joints[vertex]));
            all.extend(more_weights[vertex].into_iter().zip(more_joints[vertex]));
            all.sort_by(|a, b| b.0.total_cmp(&a.0));
            for slot in 0..4 {
                (weights[vertex][slot], joints[vertex][slot]) = all[slot];
            }
        }
    }
    let mut without = 0usize;
    for (weights, joints) in weights.iter_mut().zip(&mut joints) {
        without += usize::from(!normalise(weights, joints));
    }
    if without > 0 {
        import.warn(format!(
            "{place}: {without} vertices have no weight: they follow the first joint of their skin"
        ));
    }
    (primitive.joints, primitive.weights) = (joints, weights);
    Ok(())
}

/// Weights that sum to one; negative ones count as none. Without any weight the vertex follows the first joint
/// (in the bind pose it stays where it is), and the answer is `false`.
fn normalise(weights: &mut [f32; 4], joints: &mut [u16; 4]) -> bool {
    for (weight, joint) in weights.iter_mut().zip(joints.iter_mut()) {
        if *weight <= 0.0 {
            // A joint without weight may be any index, even one that the skin does not have.
            (*weight, *joint) = (0.0, 0);
        }
    }
    let sum: f64 = weights.iter().map(|&w| f64::from(w)).sum();
    if sum <= 0.0 {
        (*weights, *joints) = ([1.0, 0.0, 0.0, 0.0], [0; 4]);
        return false;
    }
    for weight in weights.iter_mut() {
        *weight = (f64::from(*weight) / sum) as f32;
    }
    true
}

fn indices(
    import: &mut Import<'_>,
    accessors: &Accessors<'_>,
    place: &str,
    raw: &raw::Primitive,
    mode: u32,
    primitive: &mut Primitive,
) -> Result<(), Error> {
    let count = primitive.positions.len();
    let mut indices = match raw.indices {
        Some(index) => accessors.indices(import, index, &format!("{place}.indices"), count)?,
        None => {
            import.charge(accessors.path, place, count, size_of::<u32>())?;
            (0..count as u32).collect()
        }
    };
    match mode {
        4 => {
            if indices.len() % 3 != 0 {
                import.warn("a last triangle without three corners is not drawn");
                indices.truncate(indices.len() / 3 * 3);
            }
            primitive.indices = indices;
        }
        _ => {
            import.charge(accessors.path, place, indices.len(), 3 * size_of::<u32>())?;
            let triangles = indices.len().saturating_sub(2);
            primitive.indices.reserve_exact(3 * triangles);
            for i in 0..triangles {
                let triangle = match (mode, i % 2) {
                    (5, 0) => [i, i + 1, i + 2],
                    (5, _) => [i + 1, i, i + 2],
                    _ => [i + 1, i + 2, 0],
                };
                primitive.indices.extend(triangle.map(|corner| indices[corner]));
            }
        }
    }
    Ok(())
}

/// Normals and tangents as the material needs them.
fn shade(
    import: &mut Import<'_>,
    accessors: &Accessors<'_>,
    place: &str,
    raw: &raw::Primitive,
    material: &Material,
    primitive: &mut Primitive,
) -> Result<(), Error> {
    let path = accessors.path;
    let has_normals = !primitive.normals.is_empty();
    if has_normals {
        surface::unit_normals(primitive);
    } else {
        let per_corner = 2 * size_of::<[f32; 3]>()
            + size_of::<u32>()
            + size_of::<[f32; 2]>()
                * (usize::from(!primitive.uv0.is_empty()) + usize::from(!primitive.uv1.is_empty()))
            + size_of::<[f32; 4]>() * usize::from(!primitive.colors.is_empty())
            + 24 * usize::from(!primitive.joints.is_empty());
        import.charge(path, place, primitive.indices.len(), per_corner)?;
        surface::flat_normals(primitive);
    }
    let Some(normal_map) = material.normal_texture else {
        return Ok(());
    };
    let given = raw.attributes.get("TANGENT").filter(|_| has_normals && normal_map.uv_set == 0);
    if let Some(&index) = given {
        let place = format!("{place}.attributes.TANGENT");
        let tangents = accessors.floats::<4>(import, index, &place)?;
        if tangents.len() != primitive.positions.len() {
            return Err(Error::invalid(
                path,
                place,
                format!(
                    "expected {} elements, as many as positions, found {}",
                    primitive.positions.len(),
                    tangents.len()
                ),
            ));
        }
        primitive.tangents = tangents.into_iter().map(surface::sound).collect();
        return Ok(());
    }
    let triangles = primitive.indices.len() / 3;
    match import.charge(path, place, triangles, surface::TANGENT_BYTES_PER_TRIANGLE) {
        Ok(()) => surface::tangents(primitive, normal_map.uv_set),
        Err(_) => import.warn(format!(
            "{place}: its normal map is not drawn: computing tangents for {triangles} triangles would take more \
             memory than the limits allow"
        )),
    }
    Ok(())
}
