//! Materials, textures, samplers, images.

use std::path::Path;
use std::sync::Arc;

use super::accessor::Accessors;
use super::{extension, raw};
use crate::Error;
use crate::import::Import;
use crate::model::{Alpha, Image, Material, Mip, Sampler, Shading, Texture, TextureRef, Wrap};

/// Everything about how surfaces look; `materials` ends with glTF's default material.
pub(super) struct Looks {
    pub materials: Vec<Material>,
    pub textures: Vec<Texture>,
    pub images: Vec<Arc<Image>>,
}

pub(super) fn looks(import: &mut Import<'_>, accessors: &Accessors<'_>) -> Result<Looks, Error> {
    let mut builder = Builder {
        path: accessors.path,
        root: accessors.root,
        textures: Vec::new(),
        by_raw: vec![None; accessors.root.textures.len()],
        images: Vec::new(),
        by_raw_image: vec![None; accessors.root.images.len()],
    };
    let mut materials = Vec::with_capacity(accessors.root.materials.len() + 1);
    for (index, material) in accessors.root.materials.iter().enumerate() {
        materials.push(builder.material(import, index, material)?);
    }
    materials.push(Material::default());
    let mut images = Vec::with_capacity(builder.images.len());
    let count = builder.images.len();
    for (done, &index) in builder.images.iter().enumerate() {
        import.progress("images", done, count);
        images.push(Arc::new(image(import, accessors, index)?));
    }
    import.progress("images", count, count);
    Ok(Looks { materials, textures: builder.textures, images })
}

struct Builder<'a> {
    path: &'a Path,
    root: &'a raw::Root,
    textures: Vec<Texture>,
    /// By raw texture: its place in `textures`.
    by_raw: Vec<Option<usize>>,
    /// Raw images that are used.
    images: Vec<usize>,
    /// By raw image: its place in `images`.
    by_raw_image: Vec<Option<usize>>,
}

impl Builder<'_> {
    fn material(
        &mut self,
        import: &mut Import<'_>,
        index: usize,
        material: &raw::Material,
    ) -> Result<Material, Error> {
        let place = format!("materials[{index}]");
        let (path, extensions) = (self.path, &material.extensions);
        let is_unlit = extensions.contains_key("KHR_materials_unlit");
        let strength =
            extension::<raw::EmissiveStrength>(path, &place, extensions, "KHR_materials_emissive_strength")?
                .and_then(|e| e.emissive_strength)
                .unwrap_or(1.0);
        let ior = extension::<raw::Ior>(path, &place, extensions, "KHR_materials_ior")?
            .and_then(|e| e.ior)
            .unwrap_or(1.5);
        let factor = |name: &str, value: f32, largest: f32| {
            if value >= 0.0 && value <= largest {
                return Ok(value);
            }
            Err(Error::invalid(
                path,
                format!("{place}.{name}"),
                format!("expected a number from 0 to {largest}, found {value}"),
            ))
        };
        let pbr = &material.pbr_metallic_roughness;
        let [r, g, b, a] = pbr.base_color_factor.unwrap_or([1.0; 4]);
        for channel in [r, g, b, a] {
            factor("pbrMetallicRoughness.baseColorFactor", channel, 1.0)?;
        }
        let mut emissive = material.emissive_factor.unwrap_or([0.0; 3]);
        for channel in &mut emissive {
            *channel = factor("emissiveFactor", *channel, 1.0)?
                * factor("extensions.KHR_materials_emissive_strength", strength, 1e9)?;
        }
        let mut texture = |name: &str, info: &Option<raw::TextureInfo>| match info {
            Some(info) => self.texture_ref(import, &format!("{place}.{name}"), info),
            None => Ok(None),
        };
        let shading = if is_unlit {
            Shading::Unlit
        } else {
            Shading::MetallicRoughness {
                metallic: factor("metallicFactor", pbr.metallic_factor.unwrap_or(1.0), 1.0)?,
                roughness: factor("roughnessFactor", pbr.roughness_factor.unwrap_or(1.0), 1.0)?,
                texture: texture("metallicRoughnessTexture", &pbr.metallic_roughness_texture)?,
                // 0 stands for "the specular law of old": full reflectance; 1 for none.
                ior: factor("extensions.KHR_materials_ior", ior, 1e3)?,
            }
        };
        let alpha = match material.alpha_mode.as_deref() {
            None | Some("OPAQUE") => Alpha::Opaque,
            Some("MASK") => {
                Alpha::Mask { cutoff: factor("alphaCutoff", material.alpha_cutoff.unwrap_or(0.5), f32::MAX)? }
            }
            Some("BLEND") => Alpha::Blend,
            Some(other) => {
                return Err(Error::invalid(
                    path,
                    format!("{place}.alphaMode"),
                    format!("expected \"OPAQUE\", \"MASK\" or \"BLEND\", found {other:?}"),
                ));
            }
        };
        let finite = |name: &str, value: f32| {
            let in_range = value.abs() <= 1e6;
            in_range.then_some(value).ok_or_else(|| {
                Error::invalid(
                    path,
                    format!("{place}.{name}"),
                    format!("expected a number up to 1e6, found {value}"),
                )
            })
        };
        Ok(Material {
            name: material.name.clone(),
            shading,
            base_color: [r, g, b, a],
            base_color_texture: texture("baseColorTexture", &pbr.base_color_texture)?,
            normal_texture: texture("normalTexture", &material.normal_texture)?,
            normal_scale: finite(
                "normalTexture.scale",
                material.normal_texture.as_ref().and_then(|t| t.scale).unwrap_or(1.0),
            )?,
            occlusion_texture: texture("occlusionTexture", &material.occlusion_texture)?,
            occlusion_strength: factor(
                "occlusionTexture.strength",
                material.occlusion_texture.as_ref().and_then(|t| t.strength).unwrap_or(1.0),
                1.0,
            )?,
            emissive,
            emissive_texture: texture("emissiveTexture", &material.emissive_texture)?,
            alpha,
            double_sided: material.double_sided,
        })
    }

    fn texture_ref(
        &mut self,
        import: &mut Import<'_>,
        place: &str,
        info: &raw::TextureInfo,
    ) -> Result<Option<TextureRef>, Error> {
        let transform =
            extension::<raw::TextureTransform>(self.path, place, &info.extensions, "KHR_texture_transform")?
                .unwrap_or_default();
        let set = transform.tex_coord.unwrap_or(info.tex_coord);
        let Ok(uv_set @ 0..=1) = u8::try_from(set) else {
            import.warn(format!("textures on TEXCOORD_{set} are not drawn (0 and 1 are)"));
            return Ok(None);
        };
        let Some(texture) = self.texture(import, place, info.index)? else {
            return Ok(None);
        };
        let [ox, oy] = transform.offset.unwrap_or([0.0; 2]);
        let [sx, sy] = transform.scale.unwrap_or([1.0; 2]);
        let (sin, cos) = transform.rotation.unwrap_or(0.0).sin_cos();
        // Counter-clockwise as one sees the image, whose v runs downwards.
        let uv_from_uv = [[cos * sx, sin * sy, ox], [-sin * sx, cos * sy, oy]];
        if !uv_from_uv.iter().flatten().all(|v| v.is_finite()) {
            return Err(Error::invalid(
                self.path,
                format!("{place}.extensions.KHR_texture_transform"),
                "expected finite numbers, found others",
            ));
        }
        Ok(Some(TextureRef { texture, uv_set, uv_from_uv }))
    }

    fn texture(
        &mut self,
        import: &mut Import<'_>,
        place: &str,
        index: usize,
    ) -> Result<Option<usize>, Error> {
        let Some(raw) = self.root.textures.get(index) else {
            return Err(Error::invalid(
                self.path,
                format!("{place}.index"),
                format!("expected a texture below {}, found {index}", self.root.textures.len()),
            ));
        };
        if let Some(known) = self.by_raw[index] {
            return Ok(Some(known));
        }
        let place = format!("textures[{index}]");
        let Some(source) = raw.source else {
            import.warn("textures without a PNG or JPEG source are not drawn");
            return Ok(None);
        };
        if source >= self.root.images.len() {
            return Err(Error::invalid(
                self.path,
                format!("{place}.source"),
                format!("expected an image below {}, found {source}", self.root.images.len()),
            ));
        }
        let image = *self.by_raw_image[source].get_or_insert_with(|| {
            self.images.push(source);
            self.images.len() - 1
        });
        let sampler = match raw.sampler {
            None => sampler(self.path, "", &raw::Sampler::default())?,
            Some(index) => {
                let raw = self.root.samplers.get(index).ok_or_else(|| {
                    Error::invalid(
                        self.path,
                        format!("{place}.sampler"),
                        format!("expected a sampler below {}, found {index}", self.root.samplers.len()),
                    )
                })?;
                sampler(self.path, &format!("samplers[{index}]"), raw)?
            }
        };
        self.textures.push(Texture { image, sampler });
        self.by_raw[index] = Some(self.textures.len() - 1);
        Ok(self.by_raw[index])
    }
}

fn sampler(path: &Path, place: &str, raw: &raw::Sampler) -> Result<Sampler, Error> {
    let unknown = |name: &str, expected: &str, found: u32| {
        Error::invalid(path, format!("{place}.{name}"), format!("expected {expected}, found {found}"))
    };
    let wrap = |name: &str, value: Option<u32>| match value {
        None | Some(10497) => Ok(Wrap::Repeat),
        Some(33648) => Ok(Wrap::MirroredRepeat),
        Some(33071) => Ok(Wrap::ClampToEdge),
        Some(found) => Err(unknown(name, "10497, 33648 or 33071", found)),
    };
    let mag_linear = match raw.mag_filter {
        None | Some(9729) => true,
        Some(9728) => false,
        Some(found) => return Err(unknown("magFilter", "9728 or 9729", found)),
    };
    let (min_linear, mip) = match raw.min_filter {
        None | Some(9987) => (true, Some(Mip::Linear)),
        Some(9728) => (false, None),
        Some(9729) => (true, None),
        Some(9984) => (false, Some(Mip::Nearest)),
        Some(9985) => (true, Some(Mip::Nearest)),
        Some(9986) => (false, Some(Mip::Linear)),
        Some(found) => return Err(unknown("minFilter", "9728, 9729 or 9984 to 9987", found)),
    };
    Ok(Sampler {
        wrap_u: wrap("wrapS", raw.wrap_s)?,
        wrap_v: wrap("wrapT", raw.wrap_t)?,
        mag_linear,
        min_linear,
        mip,
    })
}

fn image(import: &mut Import<'_>, accessors: &Accessors<'_>, index: usize) -> Result<Image, Error> {
    let raw = &accessors.root.images[index];
    let place = format!("images[{index}]");
    let path = accessors.path;
    match (&raw.uri, raw.buffer_view) {
        (Some(uri), _) => {
            let is_data = uri.starts_with("data:");
            let name = if raw.name.is_empty() && !is_data { uri } else { &raw.name };
            let bytes = match super::container::fetch(import, path, &format!("{place}.uri"), uri) {
                Err(error @ Error::Missing { .. }) => {
                    return Ok(crate::picture::stand_in(import, name, &error));
                }
                fetched => fetched?,
            };
            let file = (!is_data).then(|| path.parent().unwrap_or(Path::new("")).join(uri));
            let decoded =
                crate::picture::decode(import, file.as_deref().unwrap_or(path), &place, name, &bytes)?;
            import.release(bytes);
            Ok(decoded)
        }
        (None, Some(view)) => {
            let (bytes, _) = accessors.view(view, &format!("{place}.bufferView"))?;
            crate::picture::decode(import, path, &place, &raw.name, bytes)
        }
        (None, None) => Err(Error::invalid(path, place, "expected a uri or a bufferView, found neither")),
    }
}
