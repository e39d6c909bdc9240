//! The images that surfaces sample, on the device.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use vergence_gpu::vk;
use vergence_gpu::{
    BindingDesc, Bound, DescriptorSet, Device, ImageDesc, ImageView, Sampler, SamplerDesc, SetLayout, Upload,
    Use, full_mips,
};
use vergence_scene::model::{Mip, Sampler as SceneSampler, Scene, TextureRef, Wrap};

use crate::Error;
use crate::meshes::at;
use crate::mips::mip_chain;
use crate::surfaces::{TEXTURE_KINDS, is_srgb};

/// A set of descriptors and the layout that pipelines for it share.
#[derive(Clone)]
pub(crate) struct TextureSet {
    pub layout: Arc<SetLayout>,
    /// `None` for surfaces without textures.
    pub set: Option<Arc<DescriptorSet>>,
}

/// Uploads what `sets` refer to, each image once, and makes one descriptor set for each.
pub(crate) fn upload(
    device: &Arc<Device>,
    upload: &mut Upload,
    scene: &Scene,
    sets: &[[Option<TextureRef>; TEXTURE_KINDS]],
    anisotropy: f32,
) -> Result<Vec<TextureSet>, Error> {
    // An image has levels only where a sampler looks at them.
    let mut images: BTreeMap<(usize, bool), bool> = BTreeMap::new();
    for (kind, texture) in sets.iter().flat_map(|set| set.iter().enumerate()) {
        if let Some(texture) = texture {
            let texture = at("textures", &scene.textures, texture.texture)?;
            at("images", &scene.images, texture.image)?;
            *images.entry((texture.image, is_srgb(kind))).or_default() |= texture.sampler.mip.is_some();
        }
    }
    let mut views: BTreeMap<(usize, bool), Arc<ImageView>> = BTreeMap::new();
    for (&(index, srgb), &mipped) in &images {
        views.insert((index, srgb), upload_image(upload, &scene.images[index], srgb, mipped)?);
    }
    let mut samplers: HashMap<SceneSampler, Arc<Sampler>> = HashMap::new();
    let mut layouts: BTreeMap<[bool; TEXTURE_KINDS], Arc<SetLayout>> = BTreeMap::new();
    let mut made = Vec::with_capacity(sets.len());
    for set in sets {
        let used = set.map(|texture| texture.is_some());
        let layout = match layouts.get(&used) {
            Some(layout) => Arc::clone(layout),
            None => {
                let layout = set_layout(device, &used)?;
                layouts.insert(used, Arc::clone(&layout));
                layout
            }
        };
        let mut parts = Vec::new();
        for (kind, texture) in set.iter().enumerate() {
            let Some(texture) = texture else { continue };
            let texture = scene.textures[texture.texture];
            let sampler = match samplers.get(&texture.sampler) {
                Some(sampler) => Arc::clone(sampler),
                None => {
                    let sampler = make_sampler(device, &texture.sampler, anisotropy)?;
                    samplers.insert(texture.sampler, Arc::clone(&sampler));
                    sampler
                }
            };
            parts.push((kind as u32, Arc::clone(&views[&(texture.image, is_srgb(kind))]), sampler));
        }
        let bound: Vec<(u32, u32, Bound<'_>)> = parts
            .iter()
            .flat_map(|(kind, view, sampler)| {
                [(*kind, 0, Bound::Sampled(view)), (*kind + TEXTURE_KINDS as u32, 0, Bound::Sampler(sampler))]
            })
            .collect();
        let set = if bound.is_empty() { None } else { Some(DescriptorSet::new(&layout, &bound)?) };
        made.push(TextureSet { layout, set });
    }
    Ok(made)
}

fn set_layout(device: &Arc<Device>, used: &[bool; TEXTURE_KINDS]) -> Result<Arc<SetLayout>, Error> {
    let fragment = vk::ShaderStageFlags::FRAGMENT;
    let used = (0..TEXTURE_KINDS as u32).filter(|kind| used[*kind as usize]);
    let bindings: Vec<BindingDesc> = used
        .flat_map(|kind| {
            [
                BindingDesc::new(kind, vk::DescriptorType::SAMPLED_IMAGE, fragment),
                BindingDesc::new(kind + TEXTURE_KINDS as u32, vk::DescriptorType::SAMPLER, fragment),
            ]
        })
        .collect();
    Ok(SetLayout::new(device, &bindings)?)
}

fn upload_image(
    upload: &mut Upload,
    image: &vergence_scene::model::Image,
    srgb: bool,
    mipped: bool,
) -> Result<Arc<ImageView>, Error> {
    let (width, height) = (image.width, image.height);
    let expected = 4 * width as usize * height as usize;
    if expected == 0 || image.rgba.len() != expected {
        return Err(Error::range(
            "bytes of an image",
            format!("{width}·{height}·4, not 0"),
            image.rgba.len(),
        ));
    }
    let mips = if mipped { full_mips(width, height) } else { 1 };
    let chain = if mipped { mip_chain(&image.rgba, width, height, srgb) } else { image.rgba.clone() };
    let mut levels = Vec::with_capacity(mips as usize);
    let mut rest = chain.as_slice();
    for mip in 0..mips {
        let texels = (width >> mip).max(1) as usize * (height >> mip).max(1) as usize;
        let (level, after) = rest.split_at(4 * texels);
        levels.push(level);
        rest = after;
    }
    let desc = ImageDesc {
        name: &image.name,
        format: if srgb { vk::Format::R8G8B8A8_SRGB } else { vk::Format::R8G8B8A8_UNORM },
        width,
        height,
        mips,
        usage: vk::ImageUsageFlags::SAMPLED,
        ..ImageDesc::default()
    };
    Ok(upload.image(&desc, &levels, false, Use::SampledAny)?.view()?)
}

fn make_sampler(
    device: &Arc<Device>,
    sampler: &SceneSampler,
    anisotropy: f32,
) -> Result<Arc<Sampler>, Error> {
    let filter = |linear: bool| if linear { vk::Filter::LINEAR } else { vk::Filter::NEAREST };
    let address = |wrap: Wrap| match wrap {
        Wrap::Repeat => vk::SamplerAddressMode::REPEAT,
        Wrap::MirroredRepeat => vk::SamplerAddressMode::MIRRORED_REPEAT,
        Wrap::ClampToEdge => vk::SamplerAddressMode::CLAMP_TO_EDGE,
    };
    // Anisotropy replaces trilinear filtering; who asks for nearest texels gets them.
    let smooth = sampler.mag_linear && sampler.min_linear && sampler.mip == Some(Mip::Linear);
    Ok(Sampler::new(
        device,
        &SamplerDesc {
            mag: filter(sampler.mag_linear),
            min: filter(sampler.min_linear),
            mip: if sampler.mip == Some(Mip::Linear) {
                vk::SamplerMipmapMode::LINEAR
            } else {
                vk::SamplerMipmapMode::NEAREST
            },
            address: [address(sampler.wrap_u), address(sampler.wrap_v)],
            anisotropy: if smooth { anisotropy } else { 1.0 },
            // The largest value that still tells magnification from minification on level 0 (Vulkan, "mag/min").
            max_lod: if sampler.mip.is_some() { vk::LOD_CLAMP_NONE } else { 0.25 },
            compare: None,
        },
    )?)
}
