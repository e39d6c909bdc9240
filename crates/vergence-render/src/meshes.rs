//! A scene's meshes as flat arrays, ready to be copied to the device once.

use std::collections::{BTreeMap, HashMap};
use std::hash::Hash;

use nalgebra::Point3;
use vergence_scene::model::{Primitive, Scene, TextureRef};
use vergence_scene::{Coverage, Surface};
use vergence_shaders::Variant;

use crate::Error;
use crate::parts::{Cone, cut};
use crate::surfaces::{Layout, PackedMaterial, TEXTURE_KINDS, pack, push_vertex, used_textures, variant};

/// A part of a mesh at a node: what is culled and drawn.
#[derive(Clone, Debug)]
pub(crate) struct Drawable {
    pub node: usize,
    /// Index into [`Meshes::skins`] where joints move it.
    pub skin: Option<usize>,
    /// Mesh coordinates.
    pub centre: Point3<f64>,
    pub radius_m: f64,
    /// Where its fronts point, if its back is not drawn.
    pub fronts: Option<Cone>,
    /// Index into [`Meshes::kinds`].
    pub kind: usize,
    /// Index into [`Meshes::materials`].
    pub material: u32,
    /// Index into [`Meshes::texture_sets`].
    pub texture_set: usize,
    /// Index into [`Meshes::groups`].
    pub group: usize,
    /// First vertex in the group.
    pub base_vertex: i32,
    pub first_index: u32,
    pub index_count: u32,
}

/// What a pipeline is made for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Kind {
    pub surface: Surface,
    pub variant: Variant,
}

/// Vertices of one layout: where they begin in the buffers, bytes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct GroupPlace {
    pub layout: Layout,
    pub skinned: bool,
    pub moving_offset: u64,
    pub sticking_offset: u64,
}

/// A skin at a node.
#[derive(Clone, Debug)]
pub(crate) struct SkinAt {
    /// Index into [`Scene::skins`].
    pub skin: usize,
    /// First joint in the buffer of all joints of a frame.
    pub first_joint: usize,
    /// For each joint: the ball around the vertices that it moves, mesh coordinates; `None` where it moves none.
    pub reach: Vec<Option<(Point3<f64>, f64)>>,
}

/// Vertices that are skinned by one dispatch.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SkinJob {
    pub skin: usize,
    pub group: usize,
    pub first_vertex: u32,
    pub count: u32,
    pub first_influence: u32,
}

/// Flat arrays and tables.
#[derive(Default)]
pub(crate) struct Meshes {
    pub moving: Vec<f32>,
    pub sticking: Vec<f32>,
    /// Vertices that joints move, mesh coordinates; the result has the same places.
    pub skin_source: Vec<f32>,
    /// Per skinned vertex: two words of joints, four weights.
    pub influences: Vec<u32>,
    pub indices: Vec<u16>,
    pub drawables: Vec<Drawable>,
    pub kinds: Vec<Kind>,
    pub materials: Vec<PackedMaterial>,
    pub texture_sets: Vec<[Option<TextureRef>; TEXTURE_KINDS]>,
    pub groups: Vec<GroupPlace>,
    pub skins: Vec<SkinAt>,
    pub skin_jobs: Vec<SkinJob>,
    /// Number of joints of all skins.
    pub joints: usize,
    /// Triangles of all drawables.
    pub triangles: u64,
}

/// Vertices of one layout while they are collected.
#[derive(Default)]
struct Group {
    moving: Vec<f32>,
    sticking: Vec<f32>,
    vertices: u32,
}

/// Where the parts of a primitive lie, to be shown at several nodes.
struct Placed {
    parts: Vec<PlacedPart>,
    key: (Layout, bool),
}

struct PlacedPart {
    centre: Point3<f64>,
    radius_m: f64,
    fronts: Cone,
    base_vertex: u32,
    vertices: u32,
    first_index: u32,
    index_count: u32,
}

impl Meshes {
    /// Cuts and packs every mesh that a node shows. O(triangles · log).
    pub fn of(scene: &Scene, normal_maps: bool) -> Result<Self, Error> {
        let mut meshes = Self::default();
        let mut groups: BTreeMap<(Layout, bool), Group> = BTreeMap::new();
        // Parts of meshes without skin are shared by all nodes that show them.
        let mut shared: BTreeMap<(usize, usize), Placed> = BTreeMap::new();
        let mut drawn: Vec<((Layout, bool), Drawable)> = Vec::new();
        let mut jobs: Vec<((Layout, bool), SkinJob)> = Vec::new();
        let (mut kinds, mut materials, mut texture_sets) = (Known::new(), Known::new(), Known::new());
        for (node_index, node) in scene.nodes.iter().enumerate() {
            let Some(mesh_index) = node.mesh else { continue };
            let mesh = at("meshes", &scene.meshes, mesh_index)?;
            let with_triangles = mesh.primitives.iter().enumerate().filter(|(_, p)| p.indices.len() >= 3);
            for (primitive_index, primitive) in with_triangles {
                let material = at("materials", &scene.materials, primitive.material)?;
                check_primitive(primitive)?;
                let surface = Surface::of(material, primitive, normal_maps);
                let textures = used_textures(&surface, material);
                let kind = Kind { surface, variant: variant(&surface, &textures) };
                let layout = Layout::of(&kind.variant);
                let skin = match node.skin.filter(|_| !primitive.joints.is_empty()) {
                    Some(skin) => Some(meshes.add_skin(scene, skin, primitive)?),
                    None => None,
                };
                let own;
                let placed = if skin.is_some() {
                    own = meshes.place(primitive, layout, &textures, true, &mut groups);
                    &own
                } else {
                    let key = (mesh_index, primitive_index);
                    &*shared
                        .entry(key)
                        .or_insert_with(|| meshes.place(primitive, layout, &textures, false, &mut groups))
                };
                let kind_index = kinds.index_of(&mut meshes.kinds, kind, kind);
                let packed = pack(material, &textures);
                let material_key = bytemuck::bytes_of(&packed).to_vec();
                let material_index = materials.index_of(&mut meshes.materials, material_key, packed) as u32;
                let texture_key = textures.map(|texture| texture.as_ref().map(texture_key));
                let texture_set = texture_sets.index_of(&mut meshes.texture_sets, texture_key, textures);
                for part in &placed.parts {
                    meshes.triangles += u64::from(part.index_count / 3);
                    if let Some(skin) = skin {
                        let first_influence = meshes.influences.len() as u32 / 6
                            - placed.parts.iter().map(|p| p.vertices).sum::<u32>()
                            + (part.base_vertex - placed.parts[0].base_vertex);
                        let (first_vertex, count) = (part.base_vertex, part.vertices);
                        jobs.push((
                            placed.key,
                            SkinJob { skin, group: 0, first_vertex, count, first_influence },
                        ));
                    }
                    let fronts = (!surface.double_sided && skin.is_none()).then_some(part.fronts);
                    drawn.push((
                        placed.key,
                        Drawable {
                            node: node_index,
                            skin,
                            centre: part.centre,
                            radius_m: part.radius_m,
                            fronts,
                            kind: kind_index,
                            material: material_index,
                            texture_set,
                            group: 0,
                            base_vertex: part.base_vertex as i32,
                            first_index: part.first_index,
                            index_count: part.index_count,
                        },
                    ));
                }
            }
        }
        meshes.finish(groups, drawn, jobs);
        Ok(meshes)
    }

    /// Whether a drawable is blended.
    pub fn is_blended(&self, drawable: &Drawable) -> bool {
        self.kinds[drawable.kind].surface.coverage == Coverage::Blend
    }

    /// Puts the groups one after the other and fills in their numbers.
    fn finish(
        &mut self,
        groups: BTreeMap<(Layout, bool), Group>,
        drawn: Vec<((Layout, bool), Drawable)>,
        jobs: Vec<((Layout, bool), SkinJob)>,
    ) {
        let keys: Vec<(Layout, bool)> = groups.keys().copied().collect();
        let place = |key: &(Layout, bool)| keys.binary_search(key).expect("every key was collected above");
        for ((layout, skinned), group) in groups {
            let moving = if skinned { &mut self.skin_source } else { &mut self.moving };
            self.groups.push(GroupPlace {
                layout,
                skinned,
                moving_offset: 4 * moving.len() as u64,
                sticking_offset: 4 * self.sticking.len() as u64,
            });
            moving.extend(group.moving);
            self.sticking.extend(group.sticking);
        }
        self.drawables = drawn.into_iter().map(|(key, d)| Drawable { group: place(&key), ..d }).collect();
        self.skin_jobs = jobs.into_iter().map(|(key, job)| SkinJob { group: place(&key), ..job }).collect();
    }

    fn place(
        &mut self,
        primitive: &Primitive,
        layout: Layout,
        textures: &[Option<TextureRef>; TEXTURE_KINDS],
        skinned: bool,
        groups: &mut BTreeMap<(Layout, bool), Group>,
    ) -> Placed {
        let key = (layout, skinned);
        let group = groups.entry(key).or_default();
        let mut parts = Vec::new();
        for part in cut(&primitive.positions, &primitive.indices) {
            // Skinning happens in mesh coordinates: joints move vertices away from where the part was.
            let origin = if skinned { Point3::origin() } else { part.centre };
            let base_vertex = group.vertices;
            for &vertex in &part.vertices {
                let vertex = vertex as usize;
                let (moving, sticking) = (&mut group.moving, &mut group.sticking);
                push_vertex(primitive, layout, textures, &origin, vertex, moving, sticking);
                if skinned {
                    let [a, b, c, d] = primitive.joints[vertex].map(u32::from);
                    self.influences.extend([a | b << 16, c | d << 16]);
                    let weights = primitive.weights.get(vertex).copied().unwrap_or([1.0, 0.0, 0.0, 0.0]);
                    self.influences.extend(weights.map(f32::to_bits));
                }
            }
            group.vertices += part.vertices.len() as u32;
            let first_index = self.indices.len() as u32;
            self.indices.extend(&part.indices);
            parts.push(PlacedPart {
                centre: part.centre,
                radius_m: part.radius_m,
                fronts: part.fronts,
                base_vertex,
                vertices: part.vertices.len() as u32,
                first_index,
                index_count: part.indices.len() as u32,
            });
        }
        Placed { parts, key }
    }

    fn add_skin(&mut self, scene: &Scene, skin: usize, primitive: &Primitive) -> Result<usize, Error> {
        let nodes = &at("skins", &scene.skins, skin)?.joints;
        nodes.iter().try_for_each(|&node| at("nodes", &scene.nodes, node).map(drop))?;
        let joints = nodes.len();
        let mut boxes: Vec<Option<([f32; 3], [f32; 3])>> = vec![None; joints];
        for (vertex, influences) in primitive.joints.iter().enumerate() {
            let weights = primitive.weights.get(vertex).copied().unwrap_or([1.0, 0.0, 0.0, 0.0]);
            let p = primitive.positions[vertex];
            for (joint, weight) in influences.iter().zip(weights) {
                let reach = boxes.get_mut(usize::from(*joint)).ok_or(Error::Index {
                    what: "joints",
                    len: joints,
                    found: usize::from(*joint),
                })?;
                if weight > 0.0 {
                    let (least, most) = reach.get_or_insert((p, p));
                    for k in 0..3 {
                        least[k] = least[k].min(p[k]);
                        most[k] = most[k].max(p[k]);
                    }
                }
            }
        }
        let reach = boxes
            .into_iter()
            .map(|both| {
                both.map(|(least, most)| {
                    let least = nalgebra::Vector3::from(least).cast::<f64>();
                    let most = nalgebra::Vector3::from(most).cast::<f64>();
                    (Point3::from((least + most) * 0.5), 0.5 * (most - least).norm())
                })
            })
            .collect();
        self.skins.push(SkinAt { skin, first_joint: self.joints, reach });
        self.joints += joints;
        Ok(self.skins.len() - 1)
    }
}

fn check_primitive(primitive: &Primitive) -> Result<(), Error> {
    let len = primitive.positions.len();
    if let Some(&index) = primitive.indices.iter().find(|index| **index as usize >= len) {
        return Err(Error::Index { what: "vertices", len, found: index as usize });
    }
    let both = [("joints", primitive.joints.len()), ("weights", primitive.weights.len())];
    match both.into_iter().find(|(_, found)| *found != 0 && *found != len) {
        Some((what, found)) => {
            Err(Error::range(what, format!("none or one for each of {len} vertices"), found))
        }
        None => Ok(()),
    }
}

/// An entry of a table that another table refers to.
pub(crate) fn at<'a, T>(what: &'static str, table: &'a [T], index: usize) -> Result<&'a T, Error> {
    table.get(index).ok_or(Error::Index { what, len: table.len(), found: index })
}

/// Where the entries of a table stand, by what tells them apart.
struct Known<K>(HashMap<K, usize>);

impl<K: Eq + Hash> Known<K> {
    fn new() -> Self {
        Self(HashMap::new())
    }

    /// The index of `value` in `table`, appended where it is new.
    fn index_of<T>(&mut self, table: &mut Vec<T>, key: K, value: T) -> usize {
        *self.0.entry(key).or_insert_with(|| {
            table.push(value);
            table.len() - 1
        })
    }
}

/// What tells textures and their coordinates apart: floats by their bits.
fn texture_key(texture: &TextureRef) -> (usize, u8, [[u32; 3]; 2]) {
    (texture.texture, texture.uv_set, texture.uv_from_uv.map(|row| row.map(f32::to_bits)))
}
