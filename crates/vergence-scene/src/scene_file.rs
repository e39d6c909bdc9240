//! Scene files (`.toml`): models, simple solids, lights, labels, the user's start and what can be touched.
//!
//! Coordinates are `[x, y, z]`: strings with a unit (`"10000 km"`), or plain numbers in metres, kept in `f64`.
//! Colours are `"#rrggbb"` (sRGB, as on a screen) or `[r, g, b]` (linear). Angles have a unit. Paths are relative to
//! the scene file and cannot leave its folder. Unknown keys are errors. `samples/room.toml` shows every table.

mod raw;

use std::collections::HashMap;
use std::path::Path;

use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use toml::Spanned;
use vergence_geom::{Rigid, Trs};

use crate::Error;
use crate::import::{Bytes, Import};
use crate::model::{
    Alpha, Label, Light, LightKind, Local, Material, Mesh, Mip, Node, Primitive, Sampler, Scene, Shading,
    Skin, Texture, TextureRef, Touchable, Track, Wrap,
};
use crate::{shapes, surface};

/// Largest scene file, bytes: what is large belongs into models.
const MAX_BYTES: usize = 1 << 20;

/// Reads the scene file `bytes` that lies at `path`.
pub(crate) fn load(import: &mut Import<'_>, path: &Path, bytes: Bytes) -> Result<Scene, Error> {
    if bytes.len() > MAX_BYTES {
        return Err(Error::TooLarge {
            path: path.to_owned(),
            place: "file".into(),
            what: "bytes of a scene file",
            allowed: MAX_BYTES as u64,
            found: bytes.len() as u64,
        });
    }
    let text = std::str::from_utf8(&bytes).map_err(|error| {
        Error::invalid(path, format!("byte {}", error.valid_up_to()), "expected UTF-8, found other bytes")
    })?;
    let raw: raw::SceneFile = vergence_config::parse(path, text)?;
    let mut builder = Builder {
        import,
        path,
        text,
        scene: Scene {
            name: raw.name.clone().unwrap_or_else(|| {
                path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
            }),
            ambient: raw.ambient.map_or([0.0; 3], |color| color.0),
            background: raw.background.map_or([0.0; 3], |color| color.0),
            ..Scene::default()
        },
        materials: HashMap::new(),
        models: HashMap::new(),
        images: HashMap::new(),
    };
    builder.materials(&raw)?;
    builder.start(&raw)?;
    let count = raw.models.len();
    for (done, model) in raw.models.iter().enumerate() {
        builder.import.progress("models", done, count);
        builder.model(model)?;
    }
    builder.import.progress("models", count, count);
    for shape in &raw.shapes {
        builder.shape(shape)?;
    }
    for light in &raw.lights {
        builder.light(light)?;
    }
    for label in &raw.labels {
        builder.label(label)?;
    }
    let Builder { import, scene, .. } = builder;
    let missing: String = crate::text::Text::missing(&scene.labels).into_iter().collect();
    if !missing.is_empty() {
        import.warn(format!("characters that the font lacks are drawn as boxes: {missing:?}"));
    }
    Ok(scene)
}

/// A model file that has been loaded: where its tables start in the scene's, and what each instance copies.
struct Loaded {
    meshes: usize,
    scene: Scene,
}

struct Builder<'a, 'b> {
    import: &'a mut Import<'b>,
    path: &'a Path,
    text: &'a str,
    scene: Scene,
    materials: HashMap<String, usize>,
    models: HashMap<String, Loaded>,
    images: HashMap<String, usize>,
}

impl Builder<'_, '_> {
    fn invalid<T>(&self, at: &Spanned<T>, message: impl AsRef<str>) -> Error {
        vergence_config::invalid_at(self.path, self.text, at.span().start, message.as_ref()).into()
    }

    /// Where `at` stands, for errors of files that it names.
    fn place<T>(&self, at: &Spanned<T>) -> String {
        let before = self.text.get(..at.span().start).unwrap_or_default();
        let line = before.matches('\n').count() + 1;
        let column = before.chars().rev().take_while(|&c| c != '\n').count() + 1;
        format!("{line}:{column}")
    }

    fn start(&mut self, raw: &raw::SceneFile) -> Result<(), Error> {
        let Some(start) = &raw.start else { return Ok(()) };
        let raw::Start { position, yaw } = start.get_ref();
        let translation = self.position(start, position)?.into();
        let rotation =
            UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw.map_or(0.0, |yaw| yaw.radians()));
        self.scene.world_from_start = Some(Rigid::from_parts(translation, rotation));
        Ok(())
    }

    fn position<T>(&self, at: &Spanned<T>, position: &[raw::Coordinate; 3]) -> Result<Vector3<f64>, Error> {
        let position = Vector3::from(position.each_ref().map(|c| c.0));
        if position.amax() <= 1e12 {
            return Ok(position);
        }
        Err(self.invalid(at, "expected a position within 1e12 m of the origin, found one farther away"))
    }

    fn placement<T>(&self, at: &Spanned<T>, placement: &raw::Placement) -> Result<Trs, Error> {
        let turn = placement.rotation.unwrap_or_default();
        let angle = |angle: Option<vergence_config::Angle>| angle.map_or(0.0, |angle| angle.radians());
        // Yaw about y first as seen from the world, then pitch about the turned x, then roll about the turned z.
        let rotation = UnitQuaternion::from_rotation_matrix(
            &(Rotation3::from_axis_angle(&Vector3::y_axis(), angle(turn.yaw))
                * Rotation3::from_axis_angle(&Vector3::x_axis(), angle(turn.pitch))
                * Rotation3::from_axis_angle(&Vector3::z_axis(), angle(turn.roll))),
        );
        let scale = match placement.scale {
            None => Vector3::repeat(1.0),
            Some(raw::Scale(scale)) => Vector3::from(scale),
        };
        Ok(Trs { translation: self.position(at, &placement.position)?, rotation, scale })
    }

    /// Adds a node at the top of the hierarchy; returns its index.
    fn node(&mut self, name: &str, trs: Trs) -> Result<usize, Error> {
        self.import.charge(self.path, "nodes", 1, 2 * size_of::<Node>() + name.len())?;
        self.scene.nodes.push(Node {
            name: name.to_owned(),
            parent: None,
            parent_from_node: Local::Trs(trs),
            mesh: None,
            skin: None,
            light: None,
            camera: None,
            label: None,
        });
        Ok(self.scene.nodes.len() - 1)
    }

    fn touchable<T>(&mut self, at: &Spanned<T>, name: &str, node: usize) -> Result<(), Error> {
        if name.is_empty() {
            return Err(self.invalid(at, "expected a name for what can be touched, found none"));
        }
        if self.scene.touchables.iter().any(|other| other.name == name) {
            return Err(self.invalid(
                at,
                format!("expected a name of its own for each touchable, found {name:?} twice"),
            ));
        }
        self.scene.touchables.push(Touchable { name: name.to_owned(), node });
        Ok(())
    }

    fn model(&mut self, at: &Spanned<raw::Model>) -> Result<(), Error> {
        let raw = at.get_ref();
        let file = raw.file.get_ref();
        if !self.models.contains_key(file) {
            let loaded = self.load_model(&raw.file)?;
            self.models.insert(file.clone(), loaded);
        }
        let root = self.node(&raw.name, self.placement(at, &raw.placement())?)?;
        let Some(loaded) = self.models.get(file) else { return Ok(()) };
        let model = &loaded.scene;
        let keys: usize = model.animations.iter().flat_map(|clip| &clip.tracks).map(track_bytes).sum();
        let joints: usize = model.skins.iter().map(|skin| skin.joints.len()).sum();
        self.import.charge(self.path, "nodes of models", 2 * model.nodes.len(), size_of::<Node>())?;
        self.import.charge(self.path, "joints of models", joints, 112)?;
        self.import.charge(self.path, "animations of models", keys, 1)?;

        let base = self.scene.nodes.len();
        let (skins, lights, cameras) =
            (self.scene.skins.len(), self.scene.lights.len(), self.scene.cameras.len());
        self.scene.nodes.extend(model.nodes.iter().map(|node| Node {
            parent: Some(node.parent.map_or(root, |parent| base + parent)),
            mesh: node.mesh.map(|mesh| loaded.meshes + mesh),
            skin: node.skin.map(|skin| skins + skin),
            light: node.light.map(|light| lights + light),
            camera: node.camera.map(|camera| cameras + camera),
            ..node.clone()
        }));
        self.scene.skins.extend(model.skins.iter().map(|skin| Skin {
            joints: skin.joints.iter().map(|joint| base + joint).collect(),
            ..skin.clone()
        }));
        self.scene.lights.extend(&model.lights);
        self.scene.cameras.extend(&model.cameras);
        let clips = self.scene.animations.len();
        self.scene.animations.extend(model.animations.iter().map(|clip| {
            let mut clip = clip.clone();
            clip.tracks.iter_mut().for_each(|track| track.node += base);
            clip
        }));
        match &raw.animations {
            None => self.scene.playing.extend(model.playing.iter().map(|clip| clips + clip)),
            Some(names) => {
                for name in names {
                    let clip = model.animations.iter().position(|clip| clip.name == *name.get_ref());
                    let Some(clip) = clip else {
                        let known: Vec<&str> =
                            model.animations.iter().map(|clip| clip.name.as_str()).collect();
                        return Err(self.invalid(
                            name,
                            format!(
                                "expected one of the animations {known:?} of {file:?}, found {:?}",
                                name.get_ref()
                            ),
                        ));
                    };
                    self.scene.playing.push(clips + clip);
                }
            }
        }
        if raw.touchable {
            self.touchable(at, &raw.name, root)?;
        }
        for name in &raw.touchables {
            let wanted = name.get_ref();
            let found = self.scene.nodes[base..].iter().position(|node| node.name == *wanted);
            let Some(found) = found else {
                return Err(
                    self.invalid(name, format!("expected the name of a node of {file:?}, found {wanted:?}"))
                );
            };
            self.touchable(name, wanted, base + found)?;
        }
        Ok(())
    }

    /// Loads a model and appends its meshes and looks to the scene's.
    fn load_model(&mut self, file: &Spanned<String>) -> Result<Loaded, Error> {
        let place = self.place(file);
        let resolved = self.import.resolve(self.path, &place, file.get_ref())?;
        let bytes = self.import.read_beside(self.path, &place, file.get_ref())?;
        let before = self.import.take_warnings();
        let extension = resolved.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        let mut model = match extension.as_deref() {
            Some("glb" | "gltf") => crate::gltf::load(self.import, &resolved, bytes)?,
            Some("obj") => crate::obj::load(self.import, &resolved, bytes)?,
            Some("ply") => crate::ply::load(self.import, &resolved, bytes)?,
            _ => {
                return Err(self.invalid(
                    file,
                    format!("expected a .glb, .gltf, .obj or .ply file, found {:?}", file.get_ref()),
                ));
            }
        };
        let own = self.import.take_warnings();
        for warning in before {
            self.import.warn(warning);
        }
        for warning in own {
            self.import.warn(format!("{}: {warning}", file.get_ref()));
        }
        let scene = &mut self.scene;
        let (meshes, materials, textures, images) =
            (scene.meshes.len(), scene.materials.len(), scene.textures.len(), scene.images.len());
        scene.images.append(&mut model.images);
        scene.textures.extend(
            model.textures.iter().map(|texture| Texture { image: images + texture.image, ..*texture }),
        );
        let shifted = |texture: &mut Option<TextureRef>| {
            if let Some(texture) = texture {
                texture.texture += textures;
            }
        };
        for mut material in model.materials.drain(..) {
            if let Shading::MetallicRoughness { texture, .. } = &mut material.shading {
                shifted(texture);
            }
            shifted(&mut material.base_color_texture);
            shifted(&mut material.normal_texture);
            shifted(&mut material.occlusion_texture);
            shifted(&mut material.emissive_texture);
            scene.materials.push(material);
        }
        for mut mesh in model.meshes.drain(..) {
            mesh.primitives.iter_mut().for_each(|primitive| primitive.material += materials);
            scene.meshes.push(mesh);
        }
        Ok(Loaded { meshes, scene: model })
    }

    fn materials(&mut self, raw: &raw::SceneFile) -> Result<(), Error> {
        for (name, at) in &raw.materials {
            let material = at.get_ref();
            let unit = |what: &str, value: Option<f32>, default: f32| match value {
                Some(value) if !(0.0..=1.0).contains(&value) => {
                    Err(self.invalid(at, format!("expected {what} from 0 to 1, found {value}")))
                }
                value => Ok(value.unwrap_or(default)),
            };
            let metallic = unit("metallic", material.metallic, 0.0)?;
            let roughness = unit("roughness", material.roughness, 0.7)?;
            let alpha = unit("opacity", material.opacity, 1.0)?;
            let normal_scale = material.normal_scale.unwrap_or(1.0);
            if !(-10.0..=10.0).contains(&normal_scale) {
                return Err(self.invalid(at, format!("expected normal_scale up to 10, found {normal_scale}")));
            }
            let tile = material.tile.map_or([1.0; 2], |tile| tile.0);
            if !tile.iter().all(|length| (1e-6..=1e6).contains(length)) {
                return Err(self.invalid(at, format!("expected tile from 1e-6 to 1e6 m, found {tile:?}")));
            }
            let per_metre = tile.map(|length| (1.0 / length) as f32);
            let emissive_texture = self.texture(material.emissive_texture.as_ref(), per_metre)?;
            let emissive = match (material.emissive, emissive_texture) {
                (Some(color), _) => color.0,
                (None, Some(_)) => [1.0; 3],
                (None, None) => [0.0; 3],
            };
            let base_color_texture = self.texture(material.texture.as_ref(), per_metre)?;
            let normal_texture = self.texture(material.normal_texture.as_ref(), per_metre)?;
            let texture = self.texture(material.roughness_texture.as_ref(), per_metre)?;
            let [r, g, b] = material.color.map_or([1.0; 3], |color| color.0);
            self.materials.insert(name.clone(), self.scene.materials.len());
            self.scene.materials.push(Material {
                name: name.clone(),
                shading: if material.unlit {
                    Shading::Unlit
                } else {
                    Shading::MetallicRoughness { metallic, roughness, texture, ior: 1.5 }
                },
                base_color: [r, g, b, alpha],
                base_color_texture,
                normal_texture,
                normal_scale,
                emissive,
                emissive_texture,
                // An opacity that is given, even 1, is a wish to blend by the texture's alpha.
                alpha: if material.opacity.is_some() { Alpha::Blend } else { Alpha::Opaque },
                double_sided: material.double_sided,
                ..Material::default()
            });
        }
        Ok(())
    }

    fn texture(
        &mut self,
        file: Option<&Spanned<String>>,
        per_metre: [f32; 2],
    ) -> Result<Option<TextureRef>, Error> {
        let Some(file) = file else { return Ok(None) };
        let name = file.get_ref();
        let image = match self.images.get(name) {
            Some(&known) => known,
            None => {
                let place = self.place(file);
                let image = match self.import.resolve(self.path, &place, name) {
                    Err(error @ Error::Missing { .. }) => crate::picture::stand_in(self.import, name, &error),
                    resolved => {
                        let resolved = resolved?;
                        let bytes = self.import.read_beside(self.path, &place, name)?;
                        let image = crate::picture::decode(self.import, &resolved, "image", name, &bytes)?;
                        self.import.release(bytes);
                        image
                    }
                };
                self.scene.images.push(image.into());
                self.images.insert(name.clone(), self.scene.images.len() - 1);
                self.scene.images.len() - 1
            }
        };
        let sampler = Sampler {
            wrap_u: Wrap::Repeat,
            wrap_v: Wrap::Repeat,
            mag_linear: true,
            min_linear: true,
            mip: Some(Mip::Linear),
        };
        self.scene.textures.push(Texture { image, sampler });
        Ok(Some(TextureRef {
            texture: self.scene.textures.len() - 1,
            uv_set: 0,
            uv_from_uv: [[per_metre[0], 0.0, 0.0], [0.0, per_metre[1], 0.0]],
        }))
    }

    fn shape(&mut self, at: &Spanned<raw::Shape>) -> Result<(), Error> {
        let raw = at.get_ref();
        let mut primitive = self.solid(at)?;
        primitive.material = match &raw.material {
            None => self.plain(),
            Some(name) => *self.materials.get(name.get_ref()).ok_or_else(|| {
                let mut known: Vec<&String> = self.materials.keys().collect();
                known.sort();
                self.invalid(
                    name,
                    format!("expected one of the materials {known:?}, found {:?}", name.get_ref()),
                )
            })?,
        };
        if self.scene.materials[primitive.material].normal_texture.is_some() {
            let triangles = primitive.indices.len() / 3;
            self.import.charge(self.path, "normal map", triangles, surface::TANGENT_BYTES_PER_TRIANGLE)?;
            surface::tangents(&mut primitive, 0);
        }
        let node = self.node(&raw.name, self.placement(at, &raw.placement())?)?;
        self.scene.meshes.push(Mesh { name: raw.name.clone(), primitives: vec![primitive] });
        self.scene.nodes[node].mesh = Some(self.scene.meshes.len() - 1);
        if raw.touchable {
            self.touchable(at, &raw.name, node)?;
        }
        Ok(())
    }

    /// The material of shapes that name none: made when the first one asks.
    fn plain(&mut self) -> usize {
        *self.materials.entry(String::new()).or_insert_with(|| {
            self.scene.materials.push(Material {
                shading: Shading::MetallicRoughness {
                    metallic: 0.0,
                    roughness: 0.7,
                    texture: None,
                    ior: 1.5,
                },
                base_color: [0.6, 0.6, 0.6, 1.0],
                ..Material::default()
            });
            self.scene.materials.len() - 1
        })
    }

    fn solid(&mut self, at: &Spanned<raw::Shape>) -> Result<Primitive, Error> {
        let raw = at.get_ref();
        let segments = raw.segments.unwrap_or(48);
        if !(3..=1024).contains(&segments) {
            return Err(self.invalid(at, format!("expected 3 to 1024 segments, found {segments}")));
        }
        let rings = match &raw.kind {
            raw::Kind::Lathe => raw.profile.as_ref().map_or(0, Vec::len),
            _ => segments as usize / 2 + 1,
        };
        // Position, normal, texture coordinates, indices, and the tables that compute normals.
        self.import.charge(self.path, "shapes", (segments as usize + 1) * rings.max(4), 400)?;
        let lengths = |what: &str, values: &[raw::Coordinate]| {
            for value in values {
                if !(value.0 > 0.0 && value.0 <= 1e9) {
                    return Err(self
                        .invalid(at, format!("expected {what} above 0 and up to 1e9 m, found {}", value.0)));
                }
            }
            Ok(())
        };
        let missing =
            |what: &str| self.invalid(at, format!("expected {what} for this kind of shape, found none"));
        match raw.kind {
            raw::Kind::Box => {
                let size = raw.size.as_deref().ok_or_else(|| missing("size = [x, y, z]"))?;
                let [x, y, z] = size else { return Err(missing("size = [x, y, z]")) };
                lengths("size", size)?;
                Ok(shapes::cuboid([x.0 as f32, y.0 as f32, z.0 as f32]))
            }
            raw::Kind::Rectangle => {
                let size = raw.size.as_deref().ok_or_else(|| missing("size = [width, height]"))?;
                let [width, height] = size else { return Err(missing("size = [width, height]")) };
                lengths("size", size)?;
                Ok(shapes::rectangle(width.0 as f32, height.0 as f32))
            }
            raw::Kind::Sphere => {
                let radius = raw.radius.ok_or_else(|| missing("a radius"))?;
                lengths("radius", &[radius])?;
                Ok(shapes::sphere(radius.0 as f32, segments))
            }
            raw::Kind::Cylinder => {
                let radius = raw.radius.ok_or_else(|| missing("a radius"))?;
                let height = raw.height.ok_or_else(|| missing("a height"))?;
                lengths("radius and height", &[radius, height])?;
                Ok(shapes::cylinder(radius.0 as f32, height.0 as f32, segments))
            }
            raw::Kind::Lathe => {
                let profile = raw.profile.as_ref().ok_or_else(|| missing("a profile"))?;
                let sound = |[r, h]: &[raw::Coordinate; 2]| (0.0..=1e9).contains(&r.0) && h.0.abs() <= 1e9;
                if profile.len() < 2 || !profile.iter().all(sound) {
                    return Err(self.invalid(
                        at,
                        "expected a profile of at least two [radius, height], radius not negative",
                    ));
                }
                let profile: Vec<[f32; 2]> = profile.iter().map(|p| p.map(|c| c.0 as f32)).collect();
                Ok(shapes::lathe(&profile, segments))
            }
        }
    }

    fn light(&mut self, at: &Spanned<raw::Light>) -> Result<(), Error> {
        let raw = at.get_ref();
        if !(0.0..=1e12).contains(&raw.intensity) {
            return Err(
                self.invalid(at, format!("expected an intensity from 0 to 1e12, found {}", raw.intensity))
            );
        }
        let range_m = match &raw.range {
            Some(range) if range.0.is_nan() || range.0 <= 0.0 => {
                return Err(self.invalid(at, format!("expected a range above 0 m, found {}", range.0)));
            }
            range => range.as_ref().map(|range| range.0 as f32),
        };
        let (inner, outer) =
            (raw.inner.map_or(0.0, |a| a.radians()), raw.outer.map_or(0.785, |a| a.radians()));
        let kind = match raw.kind {
            raw::LightKind::Directional => LightKind::Directional,
            raw::LightKind::Point => LightKind::Point { range_m },
            raw::LightKind::Spot => {
                if !(0.0 <= inner && inner < outer && outer <= std::f64::consts::FRAC_PI_2) {
                    return Err(self.invalid(
                        at,
                        format!(
                            "expected 0 <= inner < outer <= 90 deg, found {} and {}",
                            inner.to_degrees(),
                            outer.to_degrees()
                        ),
                    ));
                }
                LightKind::Spot { range_m, inner_rad: inner as f32, outer_rad: outer as f32 }
            }
        };
        let translation = match &raw.position {
            Some(position) => self.position(at, position)?,
            None => Vector3::zeros(),
        };
        let target = match &raw.target {
            Some(target) => self.position(at, target)?,
            None => translation - Vector3::y(),
        };
        let direction = target - translation;
        let Some(direction) = nalgebra::Unit::try_new(direction, 1e-9) else {
            return Err(
                self.invalid(at, "expected a target away from the light's position, found the same place")
            );
        };
        // A light shines along −z of its node.
        let rotation = UnitQuaternion::rotation_between_axis(&-Vector3::z_axis(), &direction)
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::PI));
        let node = self.node(&raw.name, Trs { translation, rotation, scale: Vector3::repeat(1.0) })?;
        let color = raw.color.map_or([1.0; 3], |color| color.0);
        self.scene.lights.push(Light { color, intensity: raw.intensity as f32, kind });
        self.scene.nodes[node].light = Some(self.scene.lights.len() - 1);
        Ok(())
    }

    fn label(&mut self, at: &Spanned<raw::Label>) -> Result<(), Error> {
        let raw = at.get_ref();
        let cap_height_m = raw.cap_height.metres();
        if !(cap_height_m > 0.0 && cap_height_m <= 1e6) {
            return Err(
                self.invalid(at, format!("expected a cap_height from 0 to 1e6 m, found {cap_height_m}"))
            );
        }
        let node = self.node(&raw.name, self.placement(at, &raw.placement())?)?;
        let [r, g, b] = raw.color.map_or([1.0; 3], |color| color.0);
        self.scene.labels.push(Label {
            text: raw.text.clone(),
            cap_height_m: cap_height_m as f32,
            color: [r, g, b, 1.0],
            billboard: raw.billboard,
        });
        self.scene.nodes[node].label = Some(self.scene.labels.len() - 1);
        Ok(())
    }
}

fn track_bytes(track: &Track) -> usize {
    use crate::model::Values;
    let values = match &track.values {
        Values::Translation(keys) | Values::Scale(keys) => keys.len() * 12,
        Values::Rotation(keys) => keys.len() * 16,
    };
    values + 4 * track.times_secs.len() + size_of::<Track>()
}
