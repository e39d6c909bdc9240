//! What a log says about its session: one metadata record right behind the file's header.

use std::collections::BTreeMap;

/// Name of the metadata record that describes the session.
pub(crate) const SESSION: &str = "vergence.session";
/// How the name of the library that writes them begins.
pub(crate) const LIBRARY: &str = "vergence-log ";
/// Name of the metadata record that says why a recording ended early.
pub(crate) const FAILED: &str = "vergence.failed";
/// Name of the metadata record that says what a repair found.
pub(crate) const REPAIRED: &str = "vergence.repaired";
/// The format that this crate writes; a reader refuses a later one.
pub const FORMAT_VERSION: u32 = 1;
/// MCAP's profile of our files.
pub const PROFILE: &str = "vergence";

/// The session, as known when the recording starts. What becomes known later is [annotated](crate::Recorder::annotate).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Header {
    /// Who recorded, with version.
    pub application: String,
    /// Which headset, or which other device.
    pub headset: String,
    /// Which runtime, with version.
    pub runtime: String,
    /// The device that drew.
    pub device: String,
    /// Its driver, with version.
    pub driver: String,
    /// `virtual` or `monotonic`.
    pub clock: String,
    /// Where the scene was found.
    pub scene_path: String,
    /// Hash of its content, with the name of the hash in front: `blake3:…`.
    pub scene_hash: String,
    /// The resolved configuration, as TOML or JSON.
    pub configuration: String,
    /// Anything more, by name.
    pub notes: BTreeMap<String, String>,
}

impl Header {
    pub(crate) fn to_map(&self) -> BTreeMap<String, String> {
        let mut map: BTreeMap<String, String> =
            self.notes.iter().map(|(key, value)| (format!("note.{key}"), value.clone())).collect();
        map.insert("format_version".to_owned(), FORMAT_VERSION.to_string());
        for (key, value) in [
            ("application", &self.application),
            ("headset", &self.headset),
            ("runtime", &self.runtime),
            ("device", &self.device),
            ("driver", &self.driver),
            ("clock", &self.clock),
            ("scene_path", &self.scene_path),
            ("scene_hash", &self.scene_hash),
            ("configuration", &self.configuration),
        ] {
            map.insert(key.to_owned(), value.clone());
        }
        map
    }

    pub(crate) fn from_map(map: &BTreeMap<String, String>) -> Self {
        let get = |key: &str| map.get(key).cloned().unwrap_or_default();
        Self {
            application: get("application"),
            headset: get("headset"),
            runtime: get("runtime"),
            device: get("device"),
            driver: get("driver"),
            clock: get("clock"),
            scene_path: get("scene_path"),
            scene_hash: get("scene_hash"),
            configuration: get("configuration"),
            notes: map
                .iter()
                .filter_map(|(key, value)| Some((key.strip_prefix("note.")?.to_owned(), value.clone())))
                .collect(),
        }
    }
}
