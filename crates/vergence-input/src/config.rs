//! How devices are read, from a file.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::error::Error;

/// A file may say how devices are read whose adapters are left out.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
#[cfg_attr(
    not(all(feature = "serial", feature = "hid", feature = "gamepad", feature = "desktop")),
    allow(dead_code)
)]
struct Raw {
    #[serde(default)]
    serial: RawSerial,
    #[serde(default)]
    hid: RawHid,
    #[serde(default)]
    gamepad: RawGamepad,
    #[serde(default)]
    desktop: RawDesktop,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
#[cfg_attr(not(feature = "serial"), allow(dead_code))]
struct RawSerial {
    baud: Option<u32>,
    format: Option<RawFormat>,
    least_latency: Option<vergence_config::Duration>,
    columns: Option<String>,
    #[serde(default)]
    streams: BTreeMap<String, String>,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "lowercase")]
#[cfg_attr(not(feature = "serial"), allow(dead_code))]
enum RawFormat {
    Either,
    Frames,
    Lines,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
#[cfg_attr(not(feature = "hid"), allow(dead_code))]
struct RawHid {
    #[serde(default)]
    mappings: Vec<PathBuf>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
#[cfg_attr(not(feature = "gamepad"), allow(dead_code))]
struct RawGamepad {
    #[serde(default)]
    mappings: Vec<PathBuf>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
#[cfg_attr(not(feature = "desktop"), allow(dead_code))]
struct RawDesktop {
    #[serde(default)]
    extra_mouse_buttons: bool,
}

/// How devices are read: what the adapters' defaults do not know of them.
#[derive(Clone, Debug, Default)]
pub struct Config {
    /// For serial devices.
    #[cfg(feature = "serial")]
    pub serial: crate::serial::SerialConfig,
    /// For HID devices: mappings that come before those that are built in.
    #[cfg(feature = "hid")]
    pub hid_mappings: Vec<crate::hid::Mapping>,
    /// For the window of the desktop.
    #[cfg(feature = "desktop")]
    pub desktop: crate::desktop::DesktopConfig,
    /// Texts in the format of SDL's database, whose lines come before those that are built in.
    pub gamepad_mappings: Vec<String>,
}

impl Config {
    /// From a TOML file; paths in it are from where it lies.
    ///
    /// # Errors
    /// With the place in the file where it is wrong.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let raw: Raw = vergence_config::read(path)?;
        Self::resolve(raw, path)
    }

    fn resolve(raw: Raw, path: &Path) -> Result<Self, Error> {
        // Without adapters there is nothing to take over.
        #[cfg(not(any(feature = "serial", feature = "hid", feature = "gamepad")))]
        let _ = (&raw, path);
        #[cfg_attr(
            not(any(feature = "serial", feature = "hid", feature = "gamepad", feature = "desktop")),
            allow(unused_mut)
        )]
        let mut config = Self::default();
        #[cfg(feature = "serial")]
        {
            use crate::serial::Format;
            use crate::serial::lines::Columns;
            let text = std::fs::read_to_string(path).unwrap_or_default();
            let refuse = |word: &str, message: &str| {
                vergence_config::invalid_at(path, &text, text.find(word).unwrap_or(0), message)
            };
            let serial = &mut config.serial;
            if let Some(baud) = raw.serial.baud {
                serial.baud = baud;
            }
            serial.format = match raw.serial.format {
                None | Some(RawFormat::Either) => Format::Either,
                Some(RawFormat::Frames) => Format::Frames,
                Some(RawFormat::Lines) => Format::Lines,
            };
            if let Some(least) = raw.serial.least_latency {
                serial.least_latency =
                    vergence_time::Span::from_secs_f64(least.seconds()).unwrap_or(vergence_time::Span::ZERO);
            }
            for (number, description) in raw.serial.streams {
                let stream = number.parse().ok().filter(|number: &u8| *number > 0);
                let stream =
                    stream.ok_or_else(|| refuse(&number, "expected the number of a stream, 1 to 255"))?;
                let known = description.parse().map_err(|error: crate::serial::DescriptionError| {
                    refuse(&description, &error.to_string())
                })?;
                serial.streams.push((stream, known));
            }
            if let Some(columns) = raw.serial.columns {
                let known = Columns::parse(&columns);
                serial.columns =
                    Some(known.ok_or_else(|| refuse(&columns, "expected names separated by commas"))?);
            }
        }
        #[cfg(feature = "desktop")]
        {
            config.desktop.extra_mouse_buttons = raw.desktop.extra_mouse_buttons;
        }
        #[cfg(any(feature = "gamepad", feature = "hid"))]
        let beside = |mapping: PathBuf| path.parent().unwrap_or(Path::new("")).join(mapping);
        #[cfg(feature = "gamepad")]
        for mapping in raw.gamepad.mappings {
            let mapping = beside(mapping);
            let text = std::fs::read_to_string(&mapping)
                .map_err(|source| vergence_config::Error::Io { path: mapping.clone(), source })?;
            if let Some(Err(wrong)) = crate::gamepad::database::lines(&text).find(Result::is_err) {
                return Err(Error::Mapping { path: mapping, wrong: wrong.to_string() });
            }
            config.gamepad_mappings.push(text);
        }
        #[cfg(feature = "hid")]
        for mapping in raw.hid.mappings {
            config.hid_mappings.push(crate::hid::Mapping::read(&beside(mapping))?);
        }
        Ok(config)
    }
}

#[cfg(all(test, feature = "serial"))]
mod tests {
    use super::*;

    fn config(text: &str) -> Result<Config, Error> {
        let file = tempfile::NamedTempFile::new().expect("a file");
        std::fs::write(file.path(), text).expect("written");
        Config::read(file.path())
    }

    #[test]
    fn the_example_of_the_documentation_is_a_configuration() {
        let text = include_str!("../MAPPING.md");
        let example = text.split("```toml\n").nth(1).and_then(|rest| rest.split("```").next()).unwrap();
        let raw: Raw = toml::from_str(example).unwrap();
        assert_eq!(
            (raw.serial.baud, raw.hid.mappings.len(), raw.serial.streams.len()),
            (Some(921_600), 1, 1)
        );
        assert!(raw.desktop.extra_mouse_buttons && raw.serial.columns.is_some());
    }

    #[test]
    fn a_file_says_what_a_device_does_not() {
        let text = "[serial]\nbaud = 921600\nleast_latency = \"2 ms\"\n[serial.streams]\n1 = \"imu imu i16 0.001\"\n";
        let config = config(text).expect("written");
        assert_eq!((config.serial.baud, config.serial.streams.len()), (921_600, 1));
        assert_eq!(config.serial.least_latency, vergence_time::Span::from_millis(2));
    }

    #[test]
    #[cfg(feature = "hid")]
    fn a_wrong_mapping_is_not_passed_over() {
        let folder = tempfile::tempdir().expect("a folder");
        let (config, mapping) = (folder.path().join("config.toml"), folder.path().join("unit.toml"));
        std::fs::write(&config, "[hid]\nmappings = [\"unit.toml\"]\n").expect("written");
        assert!(Config::read(&config).is_err(), "there is no such file");
        let text = "name = \"unit\"\nsequence = \"@0:u16\"\nmatch = [{ vendor = 1 }]\nstream = []\n";
        std::fs::write(&mapping, text).expect("written");
        let error = Config::read(&config).unwrap_err().to_string();
        assert!(error.contains("unit.toml:2:12: expected bytes such as"), "{error}");
    }

    #[test]
    #[cfg(feature = "gamepad")]
    fn a_wrong_line_of_a_pads_mapping_is_named() {
        let folder = tempfile::tempdir().expect("a folder");
        let (config, mapping) = (folder.path().join("config.toml"), folder.path().join("pads.txt"));
        std::fs::write(&config, "[gamepad]\nmappings = [\"pads.txt\"]\n").expect("written");
        let line = "03000000010000000200000003000000,Pad,a:b0,leftx:a0,platform:Linux,";
        std::fs::write(&mapping, format!("{line}\n")).expect("written");
        assert_eq!(Config::read(&config).expect("good").gamepad_mappings.len(), 1);
        std::fs::write(&mapping, format!("{line}\n{line}q:z\n")).expect("written");
        let error = Config::read(&config).unwrap_err().to_string();
        assert!(error.contains("pads.txt: line 2: expected an input"), "{error}");
    }

    #[test]
    fn errors_name_the_place() {
        for (text, place) in [
            ("[serial]\nbuad = 1", ":2:1"),
            ("[serial.streams]\n1 = \"imu imu i12\"", ":2:6"),
            ("[serial.streams]\n0 = \"imu imu i16\"", ":2:1"),
            ("[serial]\ncolumns = \"1,2\"", ":2:12"),
        ] {
            let error = config(text).unwrap_err().to_string();
            assert!(error.contains(place), "{error}");
        }
    }
}
