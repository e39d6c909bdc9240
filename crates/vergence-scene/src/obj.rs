//! Wavefront OBJ to a [`Scene`]: polygons, normals, texture coordinates, vertex colours, smoothing groups.
//!
//! Written here rather than taken from a crate because errors must name line and column, concave faces must come
//! out right, and memory must stay in proportion to the file. One node per `o` statement.

use std::collections::HashMap;
use std::path::Path;

use crate::Error;
use crate::import::{Bytes, Import};
use crate::lines::{Line, Lines, linear_from_srgb};
use crate::model::{Local, Mesh, Node, Primitive, Scene};
use crate::surface::{self, Smoothing};
use crate::{mtl, polygon};

/// No texture coordinate or no normal.
const NONE: u32 = u32::MAX;

/// Indices (from 0) of a corner's position, texture coordinate and normal.
type Corner = [u32; 3];

/// The triangles of one object and one material.
#[derive(Default)]
struct Part {
    corners: Vec<Corner>,
    /// One per triangle; `None` where the file has not said yet.
    groups: Vec<Option<u32>>,
}

#[derive(Default)]
struct Tables {
    positions: Vec<[f32; 3]>,
    colors: Vec<[f32; 3]>,
    uvs: Vec<[f32; 2]>,
    normals: Vec<[f32; 3]>,
}

#[derive(Default)]
struct Counts {
    positions: usize,
    uvs: usize,
    normals: usize,
}

pub(crate) fn load(import: &mut Import<'_>, path: &Path, bytes: Bytes) -> Result<Scene, Error> {
    let counts = count(&bytes);
    import.charge(path, "vertices", counts.positions, 12)?;
    import.charge(path, "texture coordinates", counts.uvs, 8)?;
    import.charge(path, "normals", counts.normals, 12)?;
    let mut reader = Reader {
        tables: Tables {
            positions: Vec::with_capacity(counts.positions),
            uvs: Vec::with_capacity(counts.uvs),
            normals: Vec::with_capacity(counts.normals),
            colors: Vec::new(),
        },
        counts,
        objects: Vec::new(),
        object_places: HashMap::new(),
        object: String::new(),
        material: 0,
        material_names: HashMap::new(),
        group: None,
        unknown: None,
        parts: HashMap::new(),
        order: Vec::new(),
        libraries: Vec::new(),
        polygon: Vec::new(),
        triangles: Vec::new(),
    };
    let mut lines = Lines::new(path, &bytes);
    while let Some(mut line) = lines.next_line() {
        reader.statement(import, &mut line)?;
    }
    reader.finish(import, path)
}

/// How many vertices there will be: faces may name them only where they exist, and tables are made in one piece.
fn count(bytes: &[u8]) -> Counts {
    let mut counts = Counts::default();
    for line in bytes.split(|&b| b == b'\n') {
        match line.trim_ascii_start() {
            [b'v', b' ' | b'\t', ..] => counts.positions += 1,
            [b'v', b't', b' ' | b'\t', ..] => counts.uvs += 1,
            [b'v', b'n', b' ' | b'\t', ..] => counts.normals += 1,
            _ => {}
        }
    }
    counts
}

struct Reader {
    tables: Tables,
    counts: Counts,
    /// Names in the order in which they come, and where each is there.
    objects: Vec<String>,
    object_places: HashMap<String, usize>,
    object: String,
    /// 0 is the material of faces without one.
    material: usize,
    material_names: HashMap<String, usize>,
    group: Option<u32>,
    unknown: Option<String>,
    /// By object and material.
    parts: HashMap<(usize, usize), Part>,
    order: Vec<(usize, usize)>,
    libraries: Vec<(String, String)>,
    /// Of the face at hand; kept to save allocations.
    polygon: Vec<Corner>,
    triangles: Vec<[usize; 3]>,
}

impl Reader {
    fn statement(&mut self, import: &mut Import<'_>, line: &mut Line<'_>) -> Result<(), Error> {
        let keyword = line.word().unwrap_or_default();
        match keyword {
            b"" => {}
            b"v" => self.vertex(import, line)?,
            b"vt" => {
                let u = line.number(import)?;
                let v = line.optional_number(import)?.unwrap_or(0.0);
                // Texture coordinates run upwards here, downwards in the model.
                self.tables.uvs.push([u, 1.0 - v]);
            }
            b"vn" => {
                let normal = [line.number(import)?, line.number(import)?, line.number(import)?];
                self.tables.normals.push(normal);
            }
            b"f" | b"fo" => self.face(import, line)?,
            b"l" => import.warn("lines are not drawn"),
            b"p" => import.warn("points are not drawn"),
            b"o" => self.object = line.rest(),
            b"g" => {}
            b"s" => {
                self.group = Some(match line.word() {
                    Some(b"off" | b"0") | None => 0,
                    Some(word) => std::str::from_utf8(word).ok().and_then(|w| w.parse().ok()).unwrap_or(1),
                });
            }
            b"usemtl" => {
                let next = self.material_names.len() + 1;
                self.material = *self.material_names.entry(line.rest()).or_insert(next);
            }
            b"mtllib" => self.libraries.push((line.rest(), line.place())),
            b"vp" | b"cstype" | b"deg" | b"curv" | b"curv2" | b"surf" | b"parm" | b"trim" | b"hole"
            | b"end" => {
                import.warn("free-form curves and surfaces are not drawn");
            }
            other => {
                let place = line.place();
                self.unknown.get_or_insert_with(|| {
                    format!("{:?} ({place})", String::from_utf8_lossy(&other[..other.len().min(32)]))
                });
            }
        }
        Ok(())
    }

    fn vertex(&mut self, import: &mut Import<'_>, line: &mut Line<'_>) -> Result<(), Error> {
        let position = [line.number(import)?, line.number(import)?, line.number(import)?];
        let mut more = [0.0; 4];
        let mut count = 0;
        while count < 4 {
            let Some(value) = line.optional_number(import)? else { break };
            more[count] = value;
            count += 1;
        }
        // x y z r g b, or x y z w r g b; a lone w is a weight of free-form surfaces.
        let color = match count {
            3 => Some([more[0], more[1], more[2]]),
            4 => Some([more[1], more[2], more[3]]),
            _ => None,
        };
        if let Some(color) = color {
            let place = line.place();
            import.charge(
                line.path(),
                &place,
                self.tables.positions.len() + 1 - self.tables.colors.len(),
                24,
            )?;
            self.tables.colors.resize(self.tables.positions.len(), [1.0; 3]);
            self.tables.colors.push(color.map(linear_from_srgb));
        }
        self.tables.positions.push(position);
        Ok(())
    }

    fn face(&mut self, import: &mut Import<'_>, line: &mut Line<'_>) -> Result<(), Error> {
        self.polygon.clear();
        while let Some((word, place)) = line.word_and_place() {
            let mut parts = word.split(|&b| b == b'/');
            let mut index = |what: &str, so_far: usize, all: usize| -> Result<u32, Error> {
                let Some(text) = parts.next().filter(|text| !text.is_empty()) else { return Ok(NONE) };
                let number = std::str::from_utf8(text).ok().and_then(|text| text.parse::<i64>().ok());
                let resolved = number.and_then(|number| match number {
                    1.. => Some(number - 1),
                    0 => None,
                    _ => Some(so_far as i64 + number),
                });
                // A face may come before its vertices: what counts is that the file has them.
                resolved.filter(|&i| i >= 0 && i < all as i64 && i < i64::from(NONE)).map(|i| i as u32).ok_or_else(|| {
                    Error::invalid(
                        line.path(),
                        place,
                        format!(
                            "expected the index of one of {all} {what} (from 1, or negative from the last of {so_far}), \
                             found {:?}",
                            String::from_utf8_lossy(&text[..text.len().min(32)])
                        ),
                    )
                })
            };
            let position = index("vertices", self.tables.positions.len(), self.counts.positions)?;
            let uv = index("texture coordinates", self.tables.uvs.len(), self.counts.uvs)?;
            let normal = index("normals", self.tables.normals.len(), self.counts.normals)?;
            if position == NONE {
                return Err(Error::invalid(line.path(), place, "expected a vertex index, found none"));
            }
            self.polygon.push([position, uv, normal]);
        }
        if self.polygon.len() < 3 {
            import.warn("faces with fewer than three corners are not drawn");
            return Ok(());
        }
        let object = match self.object_places.get(&self.object) {
            Some(&known) => known,
            None => {
                self.object_places.insert(self.object.clone(), self.objects.len());
                self.objects.push(self.object.clone());
                self.objects.len() - 1
            }
        };
        let key = (object, self.material);
        // Vectors grow by doubling: twice the size, and the old half while they move.
        import.charge(line.path(), line.place(), self.polygon.len() - 2, 3 * 44)?;
        let part = self.parts.entry(key).or_insert_with(|| {
            self.order.push(key);
            Part::default()
        });
        self.triangles.clear();
        match self.polygon.len() {
            3 => self.triangles.push([0, 1, 2]),
            _ => {
                // Where vertices come later, the shape is not known yet: a fan.
                let at = |corner: &Corner| self.tables.positions.get(corner[0] as usize).copied();
                let corners: Vec<[f32; 3]> = self.polygon.iter().map_while(at).collect();
                if corners.len() == self.polygon.len() {
                    polygon::triangulate(&corners, |triangle| self.triangles.push(triangle));
                } else {
                    self.triangles.extend((1..self.polygon.len() - 1).map(|i| [0, i, i + 1]));
                }
            }
        }
        for triangle in &self.triangles {
            part.corners.extend(triangle.map(|corner| self.polygon[corner]));
            part.groups.push(self.group);
        }
        Ok(())
    }

    fn finish(mut self, import: &mut Import<'_>, path: &Path) -> Result<Scene, Error> {
        if let Some(unknown) = self.unknown.take() {
            import.warn(format!("lines with unknown keywords are ignored, the first is {unknown}"));
        }
        let mut scene = Scene {
            name: path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default(),
            ..Scene::default()
        };
        let mut names = vec![None; self.material_names.len() + 1];
        for (name, index) in self.material_names.drain() {
            names[index] = Some(name);
        }
        mtl::load(import, path, &self.libraries, &names, &mut scene)?;
        if !self.tables.colors.is_empty() {
            self.tables.colors.resize(self.tables.positions.len(), [1.0; 3]);
        }
        for (index, name) in self.objects.iter().enumerate() {
            scene.meshes.push(Mesh { name: name.clone(), primitives: Vec::new() });
            scene.nodes.push(Node {
                name: name.clone(),
                parent: None,
                parent_from_node: Local::Trs(vergence_geom::Trs::identity()),
                mesh: Some(index),
                skin: None,
                light: None,
                camera: None,
                label: None,
            });
        }
        let count = self.order.len();
        for (done, key) in self.order.into_iter().enumerate() {
            import.progress("meshes", done, count);
            if let Some(part) = self.parts.remove(&key) {
                let mut primitive = build(import, path, &self.tables, part)?;
                primitive.material = key.1;
                let normal_map = scene.materials[key.1].normal_texture;
                if normal_map.is_some() && !primitive.uv0.is_empty() {
                    let triangles = primitive.indices.len() / 3;
                    import.charge(path, "normal map", triangles, surface::TANGENT_BYTES_PER_TRIANGLE)?;
                    surface::tangents(&mut primitive, 0);
                }
                scene.meshes[key.0].primitives.push(primitive);
            }
        }
        import.progress("meshes", count, count);
        Ok(scene)
    }
}

/// Corners that agree in everything become one vertex; missing normals are computed.
fn build(import: &mut Import<'_>, path: &Path, tables: &Tables, part: Part) -> Result<Primitive, Error> {
    let count = part.corners.len();
    // Index, and for the worst case (each corner its own vertex) everything that a vertex has, and the table's entry.
    let has_uv = part.corners.iter().any(|corner| corner[1] != NONE);
    let has_colors = !tables.colors.is_empty();
    let vertex = 12 + 12 + 4 + 8 * usize::from(has_uv) + 16 * usize::from(has_colors);
    let mut primitive = Primitive::default();
    primitive.indices.reserve_exact(count);
    let mut point = Vec::new();
    let mut vertices: HashMap<Corner, u32> = HashMap::new();
    let mut charged = 0;
    import.charge(path, "faces", count, 4)?;
    for corner in &part.corners {
        let next = point.len();
        if next >= charged {
            // In steps, as the vectors and the table grow.
            let step = charged.max(1024);
            import.charge(path, "faces", step, vertex + 40)?;
            charged += step;
        }
        let index = *vertices.entry(*corner).or_insert_with(|| {
            point.push(corner[0]);
            primitive.positions.push(tables.positions[corner[0] as usize]);
            if has_uv {
                primitive.uv0.push(tables.uvs.get(corner[1] as usize).copied().unwrap_or([0.0; 2]));
            }
            if has_colors {
                let [r, g, b] = tables.colors[corner[0] as usize];
                primitive.colors.push([r, g, b, 1.0]);
            }
            primitive.normals.push(tables.normals.get(corner[2] as usize).copied().unwrap_or([0.0; 3]));
            next as u32
        });
        primitive.indices.push(index);
    }
    drop(vertices);
    if part.corners.iter().all(|corner| corner[2] != NONE) {
        surface::unit_normals(&mut primitive);
        return Ok(primitive);
    }
    import.charge(path, "normals", count, 12 + 12 + 4 + 8)?;
    let smoothing = |triangle: usize| match part.groups[triangle] {
        None => Smoothing::ByAngle,
        Some(0) => Smoothing::Flat,
        Some(group) => Smoothing::Group(group),
    };
    let given = part.corners.iter().any(|corner| corner[2] != NONE).then(|| primitive.normals.clone());
    let before = primitive.normals.len();
    surface::creased_normals(&mut primitive, &point, smoothing);
    if let Some(given) = given {
        // Some corners have their own normal: they keep it.
        for (normal, given) in primitive.normals[..before].iter_mut().zip(given) {
            if given != [0.0; 3] {
                *normal = given;
            }
        }
        surface::unit_normals(&mut primitive);
    }
    Ok(primitive)
}
