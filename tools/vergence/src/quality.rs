//! The quality file: what `vergence trade render` writes and `vergence run --quality` reads.
//!
//! ```toml
//! [quality]
//! msaa = 4
//! anisotropy = 8.0
//! render_scale = 1.0
//! normal_maps = true
//! ```
//!
//! Every key may be missing: the renderer's default stands then. What no device can give is refused here, with its place;
//! the rest is checked by who draws, which knows the device.

use std::path::Path;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};
use vergence_render::Quality;

/// The file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct QualityFile {
    /// Its only table.
    pub quality: Knobs,
}

/// The knobs that a file may set.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Knobs {
    /// Samples per pixel for edges.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "msaa")]
    pub msaa: Option<u32>,
    /// Texture samples along the line of sight.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "anisotropy")]
    pub anisotropy: Option<f32>,
    /// Width and height relative to what the headset recommends.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "render_scale")]
    pub render_scale: Option<f64>,
    /// Whether normal maps are used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub normal_maps: Option<bool>,
}

fn msaa<'de, D: Deserializer<'de>>(from: D) -> Result<Option<u32>, D::Error> {
    let found = u32::deserialize(from)?;
    // A set of bits in Vulkan, up to this one.
    let known = found.is_power_of_two() && found <= 64;
    known
        .then_some(Some(found))
        .ok_or_else(|| D::Error::custom(format!("expected 1, 2, 4, 8, 16, 32 or 64, found {found}")))
}

fn anisotropy<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f32>, D::Error> {
    let found = f32::deserialize(from)?;
    let known = found >= 1.0 && found.is_finite();
    known.then_some(Some(found)).ok_or_else(|| D::Error::custom(format!("expected 1 or more, found {found}")))
}

fn render_scale<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f64>, D::Error> {
    let (found, scales) = (f64::deserialize(from)?, Quality::RENDER_SCALES);
    let expected =
        || D::Error::custom(format!("expected {} to {}, found {found}", scales.start(), scales.end()));
    scales.contains(&found).then_some(Some(found)).ok_or_else(expected)
}

impl QualityFile {
    /// Reads the file at `path`.
    ///
    /// # Errors
    /// Where it cannot be read, a key is unknown or a value is of another kind: with file, line and column.
    pub fn read(path: &Path) -> Result<Self, vergence_config::Error> {
        vergence_config::read(path)
    }

    /// The file's text.
    pub fn to_toml(self) -> Result<String, toml::ser::Error> {
        toml::to_string(&self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read() {
        let knobs =
            Knobs { msaa: Some(4), anisotropy: Some(16.0), render_scale: Some(0.7), normal_maps: None };
        let text = QualityFile { quality: knobs }.to_toml().unwrap();
        assert_eq!(vergence_config::parse::<QualityFile>("q.toml", &text).unwrap().quality, knobs);
        let error = vergence_config::parse::<QualityFile>("q.toml", "[quality]\nmsa = 4\n").unwrap_err();
        assert!(error.to_string().starts_with("q.toml:2:1: unknown field `msa`"), "{error}");
        for (wrong, expected) in [
            ("msaa = 3", "q.toml:2:8: expected 1, 2, 4"),
            ("anisotropy = nan", "q.toml:2:14: expected 1 or more"),
            ("render_scale = -3.0", "q.toml:2:16: expected 0.1 to 2, found -3"),
        ] {
            let text = format!("[quality]\n{wrong}\n");
            let error = vergence_config::parse::<QualityFile>("q.toml", &text).unwrap_err().to_string();
            assert!(error.starts_with(expected), "{error}");
        }
    }
}
