//! Materials of OBJ files (MTL): Blinn-Phong with textures.
//!
//! Colours are sRGB, as exporters write them. Libraries and textures that are missing, or lie outside of the scene's
//! folder, are named in a warning: the shape can be drawn without them, a stand-in for the texture on it.

use std::collections::{HashMap, HashSet};
use std::path::Path;

use crate::Error;
use crate::import::Import;
use crate::lines::{Line, Lines, linear_from_srgb};
use crate::model::{Alpha, Material, Mip, Sampler, Scene, Shading, Texture, TextureRef, Wrap};

const SAMPLER: Sampler = Sampler {
    wrap_u: Wrap::Repeat,
    wrap_v: Wrap::Repeat,
    mag_linear: true,
    min_linear: true,
    mip: Some(Mip::Linear),
};

/// Fills `scene.materials` with one material for each of `names`; `None`, and names that no library has, give a plain
/// one. `libraries` are file names and where `path` names them.
pub(crate) fn load(
    import: &mut Import<'_>,
    path: &Path,
    libraries: &[(String, String)],
    names: &[Option<String>],
    scene: &mut Scene,
) -> Result<(), Error> {
    let mut materials: HashMap<String, Material> = HashMap::new();
    let used: HashSet<&String> = names.iter().flatten().collect();
    for (library, place) in libraries {
        let file = library.replace('\\', "/");
        let (resolved, bytes) = match import
            .resolve(path, place, &file)
            .and_then(|resolved| Ok((resolved, import.read_beside(path, place, &file)?)))
        {
            Ok(found) => found,
            Err(error) => {
                import.warn(format!("the materials of {library:?} are not used: {error}"));
                continue;
            }
        };
        let mut current: Option<Material> = None;
        let mut lines = Lines::new(&resolved, &bytes);
        while let Some(mut line) = lines.next_line() {
            let keyword = line.word().unwrap_or_default();
            if keyword == b"newmtl" {
                let next = Material { name: line.rest(), ..plain() };
                if let Some(done) = current.replace(next) {
                    materials.insert(done.name.clone(), done);
                }
                continue;
            }
            // Only what the scene uses is read: textures of other materials may be missing.
            if let Some(material) = &mut current
                && used.contains(&material.name)
            {
                statement(import, &resolved, keyword, &mut line, material, scene)?;
            }
        }
        if let Some(done) = current {
            materials.insert(done.name.clone(), done);
        }
    }
    for name in names {
        let known = name.as_ref().and_then(|name| materials.get(name).cloned());
        scene
            .materials
            .push(known.unwrap_or_else(|| Material { name: name.clone().unwrap_or_default(), ..plain() }));
    }
    Ok(())
}

/// A light grey, dull surface.
fn plain() -> Material {
    let grey = linear_from_srgb(0.8);
    Material {
        shading: Shading::BlinnPhong { specular: [0.0; 3], shininess: 1.0 },
        base_color: [grey, grey, grey, 1.0],
        ..Material::default()
    }
}

fn statement(
    import: &mut Import<'_>,
    path: &Path,
    keyword: &[u8],
    line: &mut Line<'_>,
    material: &mut Material,
    scene: &mut Scene,
) -> Result<(), Error> {
    match keyword {
        b"Kd" => {
            let [r, g, b] = color(import, line)?;
            material.base_color = [r, g, b, material.base_color[3]];
        }
        b"Ks" => {
            let new = color(import, line)?;
            if let Shading::BlinnPhong { specular, .. } = &mut material.shading {
                *specular = new;
            }
        }
        b"Ns" => {
            let new = line.number(import)?.clamp(1.0, 1e4);
            if let Shading::BlinnPhong { shininess, .. } = &mut material.shading {
                *shininess = new;
            }
        }
        b"Ke" => material.emissive = color(import, line)?,
        b"d" | b"Tr" => {
            let value = line.number(import)?.clamp(0.0, 1.0);
            let alpha = if keyword == b"d" { value } else { 1.0 - value };
            material.base_color[3] = alpha;
            material.alpha = if alpha < 1.0 { Alpha::Blend } else { Alpha::Opaque };
        }
        b"illum" if line.word() == Some(b"0") => material.shading = Shading::Unlit,
        b"map_Kd" => material.base_color_texture = texture(import, path, line, scene)?,
        b"map_Ke" => {
            material.emissive_texture = texture(import, path, line, scene)?;
            if material.emissive_texture.is_some() && material.emissive == [0.0; 3] {
                material.emissive = [1.0; 3];
            }
        }
        b"norm" => material.normal_texture = texture(import, path, line, scene)?,
        b"map_Bump" | b"map_bump" | b"bump" => {
            import.warn("bump maps (heights) are not drawn; normal maps (norm) are")
        }
        b"map_Ks" | b"map_Ns" | b"map_d" | b"map_Ka" | b"map_Tr" | b"disp" | b"decal" | b"refl" => {
            import.warn(format!("{} textures are not drawn", String::from_utf8_lossy(keyword)));
        }
        _ => {}
    }
    Ok(())
}

fn color(import: &mut Import<'_>, line: &mut Line<'_>) -> Result<[f32; 3], Error> {
    let r = line.number(import)?;
    let (g, b) = match (line.optional_number(import)?, line.optional_number(import)?) {
        (Some(g), Some(b)) => (g, b),
        _ => (r, r),
    };
    Ok([r, g, b].map(linear_from_srgb))
}

fn texture(
    import: &mut Import<'_>,
    path: &Path,
    line: &mut Line<'_>,
    scene: &mut Scene,
) -> Result<Option<TextureRef>, Error> {
    let place = line.place();
    let mut sampler = SAMPLER;
    let (mut scale, mut offset) = ([1.0, 1.0], [0.0, 0.0]);
    let mut file = line.rest();
    // Options stand before the file name, which may hold spaces.
    while let Some(rest) = file.strip_prefix('-') {
        let (option, rest) = rest.split_once(char::is_whitespace).unwrap_or((rest, ""));
        let mut values: Vec<f32> = Vec::new();
        let mut rest = rest.trim_start();
        let wanted = if matches!(option, "s" | "o" | "t") { 3 } else { 1 };
        let mut first_word = "";
        for at in 0..wanted {
            let (word, tail) = rest.split_once(char::is_whitespace).unwrap_or((rest, ""));
            let value = crate::lines::number(import, word.as_bytes());
            if at > 0 && value.is_none() {
                break;
            }
            first_word = if at == 0 { word } else { first_word };
            values.extend(value);
            rest = tail.trim_start();
        }
        match (option, values.as_slice()) {
            ("s", [u, v, ..]) => scale = [*u, *v],
            ("o", [u, v, ..]) => offset = [*u, *v],
            ("clamp", _) if first_word == "on" => {
                (sampler.wrap_u, sampler.wrap_v) = (Wrap::ClampToEdge, Wrap::ClampToEdge);
            }
            _ => {}
        }
        file = rest.to_owned();
    }
    let relative = file.replace('\\', "/");
    let name = relative.trim_start_matches("./").to_owned();
    let image = match scene.images.iter().position(|image| image.name == name) {
        Some(known) => known,
        None => {
            let image = match import.read_beside(path, &place, &relative) {
                Ok(bytes) => {
                    let resolved = import.resolve(path, &place, &relative)?;
                    let image = crate::picture::decode(import, &resolved, "image", &name, &bytes)?;
                    import.release(bytes);
                    image
                }
                // Also names outside of the folder, which exporters write: nothing is read there.
                Err(error) => crate::picture::stand_in(import, &name, &error),
            };
            scene.images.push(image.into());
            scene.images.len() - 1
        }
    };
    scene.textures.push(Texture { image, sampler });
    let texture = scene.textures.len() - 1;
    // v' = s_v · v + o_v upwards; the model's v runs downwards.
    let uv_from_uv = [[scale[0], 0.0, offset[0]], [0.0, scale[1], 1.0 - scale[1] - offset[1]]];
    Ok(Some(TextureRef { texture, uv_set: 0, uv_from_uv }))
}
