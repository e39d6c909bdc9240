//! glTF 2.0 (`.gltf`, `.glb`) to a [`Scene`].
//!
//! Understood: all of the core but morph targets, and the extensions in [`SUPPORTED`]. What is not drawn is
//! named in one warning each; a required extension that is not supported is an error.

mod accessor;
mod animation;
mod container;
mod material;
mod mesh;
mod nodes;
mod raw;

use std::path::Path;

use nalgebra::Matrix4;
use vergence_geom::Affine;

use crate::Error;
use crate::import::{Bytes, Import};
use crate::model::{Camera, Light, LightKind, Node, Scene, Skin};
use accessor::Accessors;

/// glTF extensions that are understood.
pub const SUPPORTED: [&str; 6] = [
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_unlit",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
];

/// π/2, and what it may have been rounded up to in a file.
const RIGHT_ANGLE_RAD: f32 = std::f32::consts::FRAC_PI_2 + 1e-4;

/// Bytes that the parsed JSON may take for each object in its text.
const BYTES_PER_JSON_OBJECT: usize = 256;

/// Reads the glTF file `bytes` that lies at `path`.
pub(crate) fn load(import: &mut Import<'_>, path: &Path, bytes: Bytes) -> Result<Scene, Error> {
    let container = container::Container::parse(path, &bytes)?;
    let text = &bytes[container.json.clone()];
    let objects = text.iter().filter(|&&byte| byte == b'{').count();
    import.charge(path, container.json_place, objects, BYTES_PER_JSON_OBJECT)?;
    let root: raw::Root =
        serde_json::from_slice(text).map_err(|error| container.json_error(path, text, &error))?;
    check_version(path, &root.asset)?;
    check_extensions(import, path, &root)?;

    let buffers = container::buffers(import, path, &bytes, &container, &root)?;
    let accessors = Accessors { path, root: &root, buffers: &buffers };
    let looks = material::looks(import, &accessors)?;
    let mut scene = Scene {
        name: path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default(),
        materials: looks.materials,
        textures: looks.textures,
        images: looks.images,
        ..Scene::default()
    };
    let order = nodes::order(path, &root)?;
    add_meshes(import, &accessors, &order, &mut scene)?;
    add_lights(path, &root, &mut scene)?;
    add_cameras(import, path, &root, &mut scene)?;
    add_nodes(path, &root, &order, &mut scene)?;
    add_skins(import, &accessors, &order, &mut scene)?;
    for index in 0..root.animations.len() {
        let clip = animation::animation(import, &accessors, &scene.nodes, &order.position, index)?;
        if !clip.tracks.is_empty() {
            scene.animations.push(clip);
        }
    }
    scene.playing = scene.compatible_clips();
    Ok(scene)
}

fn check_version(path: &Path, asset: &raw::Asset) -> Result<(), Error> {
    let (place, version) = match &asset.min_version {
        Some(minimum) => ("asset.minVersion", minimum.as_str()),
        None => ("asset.version", asset.version.as_str()),
    };
    let is_readable = match asset.min_version {
        Some(_) => version == "2.0",
        None => version == "2" || version.starts_with("2."),
    };
    if is_readable {
        return Ok(());
    }
    Err(Error::invalid(path, place, format!("expected glTF version \"2.0\", found {version:?}")))
}

fn check_extensions(import: &mut Import<'_>, path: &Path, root: &raw::Root) -> Result<(), Error> {
    for (index, name) in root.extensions_required.iter().enumerate() {
        if !SUPPORTED.contains(&name.as_str()) {
            return Err(Error::invalid(
                path,
                format!("extensionsRequired[{index}]"),
                format!("expected one of {}, found {name:?}", SUPPORTED.join(", ")),
            ));
        }
    }
    for name in &root.extensions_used {
        if !SUPPORTED.contains(&name.as_str()) {
            import.warn(format!("the glTF extension {name:?} is not supported: what it adds is not drawn"));
        }
    }
    Ok(())
}

/// The extension `name` among `extensions` of the object at `place`.
fn extension<T: serde::de::DeserializeOwned>(
    path: &Path,
    place: &str,
    extensions: &raw::Extensions,
    name: &str,
) -> Result<Option<T>, Error> {
    let Some(text) = extensions.get(name) else { return Ok(None) };
    serde_json::from_str(text.get())
        .map(Some)
        .map_err(|error| Error::invalid(path, format!("{place}.extensions.{name}"), error))
}

/// Imports the meshes that ordered nodes show; others stay empty and are left out by [`add_nodes`].
fn add_meshes(
    import: &mut Import<'_>,
    accessors: &Accessors<'_>,
    order: &nodes::Order,
    scene: &mut Scene,
) -> Result<(), Error> {
    let count = accessors.root.meshes.len();
    let mut used = vec![false; count];
    for &node in &order.nodes {
        if let Some(mesh) = accessors.root.nodes[node].mesh {
            *used.get_mut(mesh).ok_or_else(|| {
                Error::invalid(
                    accessors.path,
                    format!("nodes[{node}].mesh"),
                    format!("expected a mesh below {count}, found {mesh}"),
                )
            })? = true;
        }
    }
    for (index, used) in used.into_iter().enumerate() {
        import.progress("meshes", index, count);
        scene.meshes.push(if used {
            mesh::mesh(import, accessors, &scene.materials, index)?
        } else {
            crate::model::Mesh::default()
        });
    }
    import.progress("meshes", count, count);
    Ok(())
}

fn add_nodes(path: &Path, root: &raw::Root, order: &nodes::Order, scene: &mut Scene) -> Result<(), Error> {
    for &index in &order.nodes {
        let raw = &root.nodes[index];
        let place = format!("nodes[{index}]");
        let below = |what: &str, value: Option<usize>, count: usize| match value {
            Some(value) if value >= count => Err(Error::invalid(
                path,
                format!("{place}.{what}"),
                format!("expected a {what} below {count}, found {value}"),
            )),
            value => Ok(value),
        };
        let light = extension::<raw::NodeLight>(path, &place, &raw.extensions, "KHR_lights_punctual")?;
        let camera = below("camera", raw.camera, root.cameras.len())?;
        scene.nodes.push(Node {
            name: raw.name.clone(),
            // The parent of a scene's root lies outside of the scene.
            parent: order.parents[index].and_then(|parent| order.position[parent]),
            parent_from_node: nodes::local(path, index, raw)?,
            mesh: raw.mesh.filter(|&mesh| !scene.meshes[mesh].primitives.is_empty()),
            skin: below("skin", raw.skin, root.skins.len())?,
            light: below("light", light.map(|light| light.light), scene.lights.len())?,
            camera: camera.filter(|&camera| root.cameras[camera].perspective.is_some()),
            label: None,
        });
    }
    // Cameras that are not kept leave a gap in the indices.
    let mut kept = 0;
    let places: Vec<usize> = root
        .cameras
        .iter()
        .map(|camera| {
            kept += usize::from(camera.perspective.is_some());
            kept.saturating_sub(1)
        })
        .collect();
    for node in &mut scene.nodes {
        node.camera = node.camera.map(|camera| places[camera]);
    }
    Ok(())
}

fn add_skins(
    import: &mut Import<'_>,
    accessors: &Accessors<'_>,
    order: &nodes::Order,
    scene: &mut Scene,
) -> Result<(), Error> {
    let path = accessors.path;
    for (index, raw) in accessors.root.skins.iter().enumerate() {
        let place = format!("skins[{index}]");
        if raw.joints.is_empty() || raw.joints.len() > usize::from(u16::MAX) {
            return Err(Error::invalid(
                path,
                format!("{place}.joints"),
                format!("expected 1 to {} joints, found {}", u16::MAX, raw.joints.len()),
            ));
        }
        // `nodes::order` has taken every joint in.
        let joints: Vec<usize> =
            raw.joints.iter().filter_map(|&joint| order.position.get(joint).copied().flatten()).collect();
        import.charge(path, &place, joints.len(), size_of::<Affine>() + size_of::<usize>())?;
        let joint_from_mesh = match raw.inverse_bind_matrices {
            None => vec![Affine::identity(); joints.len()],
            Some(index) => {
                let matrices = accessors.matrices(import, index, &format!("{place}.inverseBindMatrices"))?;
                if matrices.len() < joints.len() {
                    return Err(Error::invalid(
                        path,
                        format!("{place}.inverseBindMatrices"),
                        format!(
                            "expected {} matrices, one per joint, found {}",
                            joints.len(),
                            matrices.len()
                        ),
                    ));
                }
                matrices[..joints.len()].iter().map(|matrix| bind_matrix(&matrix.0)).collect()
            }
        };
        scene.skins.push(Skin { name: raw.name.clone(), joints, joint_from_mesh });
    }
    // Meshes may be shown many times: their joints are looked through once.
    let largest_joints: Vec<Option<u16>> = scene
        .meshes
        .iter()
        .map(|mesh| mesh.primitives.iter().flat_map(|p| p.joints.iter().flatten()).max().copied())
        .collect();
    for (node, &raw_node) in scene.nodes.iter_mut().zip(&order.nodes) {
        let (Some(skin), Some(mesh)) = (node.skin, node.mesh) else {
            node.skin = None;
            continue;
        };
        let joints = scene.skins[skin].joints.len();
        if let Some(largest) = largest_joints[mesh].filter(|&largest| usize::from(largest) >= joints) {
            return Err(Error::invalid(
                path,
                format!("nodes[{raw_node}]"),
                format!("expected joint indices of its mesh below {joints} (skins[{skin}]), found {largest}"),
            ));
        }
    }
    Ok(())
}

/// An inverse bind matrix; its last row is (0, 0, 0, 1) by the specification and taken as such.
fn bind_matrix(columns: &[f32; 16]) -> Affine {
    let matrix = Matrix4::from_column_slice(columns).cast::<f64>();
    Affine {
        linear: matrix.fixed_view::<3, 3>(0, 0).into_owned(),
        translation: matrix.fixed_view::<3, 1>(0, 3).into_owned(),
    }
}

fn add_lights(path: &Path, root: &raw::Root, scene: &mut Scene) -> Result<(), Error> {
    let lights = extension::<raw::Lights>(path, "", &root.extensions, "KHR_lights_punctual")?;
    for (index, raw) in lights.unwrap_or_default().lights.iter().enumerate() {
        let place = format!("extensions.KHR_lights_punctual.lights[{index}]");
        let invalid = |what: &str, message: String| Error::invalid(path, format!("{place}.{what}"), message);
        let color = raw.color.unwrap_or([1.0; 3]);
        let intensity = raw.intensity.unwrap_or(1.0);
        if !color.iter().chain([&intensity]).all(|&v| (0.0..=1e12).contains(&v)) {
            return Err(invalid("intensity", "expected numbers from 0 to 1e12, found others".into()));
        }
        let range_m = match raw.range {
            Some(range) if range.is_nan() || range <= 0.0 => {
                return Err(invalid("range", format!("expected more than 0, found {range}")));
            }
            range => range.filter(|range| range.is_finite()),
        };
        let kind = match raw.kind.as_str() {
            "directional" => LightKind::Directional,
            "point" => LightKind::Point { range_m },
            "spot" => {
                let spot = raw.spot.as_ref();
                let inner_rad = spot.and_then(|s| s.inner_cone_angle).unwrap_or(0.0);
                let outer_rad = spot.and_then(|s| s.outer_cone_angle).unwrap_or(std::f32::consts::FRAC_PI_4);
                if !(0.0 <= inner_rad && inner_rad < outer_rad && outer_rad <= RIGHT_ANGLE_RAD) {
                    return Err(invalid(
                        "spot",
                        format!("expected 0 <= inner < outer <= pi/2, found {inner_rad} and {outer_rad}"),
                    ));
                }
                LightKind::Spot { range_m, inner_rad, outer_rad }
            }
            other => {
                return Err(invalid(
                    "type",
                    format!("expected \"directional\", \"point\" or \"spot\", found {other:?}"),
                ));
            }
        };
        scene.lights.push(Light { color, intensity, kind });
    }
    Ok(())
}

fn add_cameras(
    import: &mut Import<'_>,
    path: &Path,
    root: &raw::Root,
    scene: &mut Scene,
) -> Result<(), Error> {
    for (index, raw) in root.cameras.iter().enumerate() {
        let Some(perspective) = &raw.perspective else {
            import.warn("orthographic cameras are not used");
            continue;
        };
        let (fov_y_rad, aspect) = (perspective.yfov, perspective.aspect_ratio);
        if !(fov_y_rad > 0.0 && fov_y_rad < std::f64::consts::PI) {
            return Err(Error::invalid(
                path,
                format!("cameras[{index}].perspective.yfov"),
                format!("expected an angle between 0 and pi, found {fov_y_rad}"),
            ));
        }
        if aspect.is_some_and(|aspect| !(aspect > 0.0 && aspect.is_finite())) {
            return Err(Error::invalid(
                path,
                format!("cameras[{index}].perspective.aspectRatio"),
                "expected more than 0, found less",
            ));
        }
        scene.cameras.push(Camera { fov_y_rad: fov_y_rad as f32, aspect: aspect.map(|a| a as f32) });
    }
    Ok(())
}
