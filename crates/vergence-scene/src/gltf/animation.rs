//! Animation clips.

use super::accessor::Accessors;
use super::raw;
use crate::Error;
use crate::import::Import;
use crate::model::{Animation, Interpolation, Local, Node, Track, Values};

/// Clip `index`; `position` says where each raw node went in `nodes`.
pub(super) fn animation(
    import: &mut Import<'_>,
    accessors: &Accessors<'_>,
    nodes: &[Node],
    position: &[Option<usize>],
    index: usize,
) -> Result<Animation, Error> {
    let raw = &accessors.root.animations[index];
    let mut tracks = Vec::with_capacity(raw.channels.len());
    for (at, channel) in raw.channels.iter().enumerate() {
        let place = format!("animations[{index}].channels[{at}]");
        let sampler_place = format!("animations[{index}].samplers[{}]", channel.sampler);
        let sampler = raw.samplers.get(channel.sampler).ok_or_else(|| {
            Error::invalid(
                accessors.path,
                format!("{place}.sampler"),
                format!("expected a sampler below {}, found {}", raw.samplers.len(), channel.sampler),
            )
        })?;
        if channel.target.path == "weights" {
            import.warn("morph targets are not drawn yet: their meshes keep their base shape");
            continue;
        }
        let Some(raw_node) = channel.target.node else { continue };
        let known = position.get(raw_node).ok_or_else(|| {
            Error::invalid(
                accessors.path,
                format!("{place}.target.node"),
                format!("expected a node below {}, found {raw_node}", position.len()),
            )
        })?;
        // Nodes outside of the default scene are not there to be moved.
        let Some(node) = *known else { continue };
        if matches!(nodes[node].parent_from_node, Local::Matrix(_)) {
            import.warn("animated nodes that are placed by a matrix keep still");
            continue;
        }
        tracks.push(track(import, accessors, &place, &sampler_place, &channel.target.path, sampler, node)?);
    }
    Ok(Animation { name: raw.name.clone(), tracks })
}

fn track(
    import: &mut Import<'_>,
    accessors: &Accessors<'_>,
    place: &str,
    sampler_place: &str,
    property: &str,
    sampler: &raw::AnimationSampler,
    node: usize,
) -> Result<Track, Error> {
    let path = accessors.path;
    let (interpolation, per_key) = match sampler.interpolation.as_deref() {
        None | Some("LINEAR") => (Interpolation::Linear, 1),
        Some("STEP") => (Interpolation::Step, 1),
        Some("CUBICSPLINE") => (Interpolation::CubicSpline, 3),
        Some(other) => {
            return Err(Error::invalid(
                path,
                format!("{sampler_place}.interpolation"),
                format!("expected \"LINEAR\", \"STEP\" or \"CUBICSPLINE\", found {other:?}"),
            ));
        }
    };
    let times_secs = accessors.scalars(import, sampler.input, &format!("{sampler_place}.input"))?;
    if times_secs.is_empty() {
        return Err(Error::invalid(
            path,
            format!("{sampler_place}.input"),
            "expected at least one key, found none",
        ));
    }
    if let Some(at) = times_secs.windows(2).position(|pair| pair[1] < pair[0]) {
        return Err(Error::invalid(
            path,
            format!("accessors[{}], element {}", sampler.input, at + 1),
            format!(
                "expected times in ascending order, found {} after {}",
                times_secs[at + 1],
                times_secs[at]
            ),
        ));
    }
    let output_place = format!("{sampler_place}.output");
    let output = sampler.output;
    let values = match property {
        "translation" => Values::Translation(accessors.floats::<3>(import, output, &output_place)?),
        "scale" => Values::Scale(accessors.floats::<3>(import, output, &output_place)?),
        "rotation" => {
            let mut keys = accessors.floats::<4>(import, output, &output_place)?;
            for (at, key) in keys.iter_mut().enumerate() {
                let is_value = per_key == 1 || at % 3 == 1;
                if is_value && !unit(key) {
                    return Err(Error::invalid(
                        path,
                        format!("accessors[{output}], element {at}"),
                        format!("expected a unit quaternion, found {key:?}"),
                    ));
                }
            }
            Values::Rotation(keys)
        }
        other => {
            return Err(Error::invalid(
                path,
                format!("{place}.target.path"),
                format!("expected \"translation\", \"rotation\", \"scale\" or \"weights\", found {other:?}"),
            ));
        }
    };
    let found = match &values {
        Values::Translation(keys) | Values::Scale(keys) => keys.len(),
        Values::Rotation(keys) => keys.len(),
    };
    if found != per_key * times_secs.len() {
        return Err(Error::invalid(
            path,
            output_place,
            format!(
                "expected {} values for {} keys, found {found}",
                per_key * times_secs.len(),
                times_secs.len()
            ),
        ));
    }
    Ok(Track { node, times_secs, interpolation, values })
}

/// Makes a quaternion unit length, leaving alone what is so to rounding; `false` where it has no direction.
fn unit(key: &mut [f32; 4]) -> bool {
    let norm = key.iter().map(|&c| f64::from(c) * f64::from(c)).sum::<f64>().sqrt();
    if norm < 1e-6 {
        return false;
    }
    if (norm - 1.0).abs() > 1e-6 {
        *key = key.map(|c| (f64::from(c) / norm) as f32);
    }
    true
}
