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
//! Every key may be missing: the renderer's default stands then. Ranges are checked by who draws, which knows the
//! device.

use std::path::Path;

use serde::{Deserialize, Serialize};

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
    #[serde(skip_serializing_if = "Option::is_none")]
    pub msaa: Option<u32>,
    /// Texture samples along the line of sight.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub anisotropy: Option<f32>,
    /// Width and height relative to what the headset recommends.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub render_scale: Option<f64>,
    /// Whether normal maps are used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub normal_maps: Option<bool>,
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
    }
}
