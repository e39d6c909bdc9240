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
    most_drift_ppm: Option<u32>,
    columns: Option<String>,
    #[serde(default)]
    streams: BTreeMap<String, String>,
    #[serde(default)]
    device: Vec<RawSerialDevice>,
}

/// What is left out is as `[serial]` says.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[cfg_attr(not(feature = "serial"), allow(dead_code))]
struct RawSerialDevice {
    #[serde(rename = "match")]
    which: String,
    baud: Option<u32>,
    format: Option<RawFormat>,
    least_latency: Option<vergence_config::Duration>,
    most_drift_ppm: Option<u32>,
    columns: Option<String>,
    streams: Option<BTreeMap<String, String>>,
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
    /// For some of them: a path, `vid:pid` (hexadecimal) or a serial number, and how what it means is read. The first that fits counts.
    #[cfg(feature = "serial")]
    pub serial_devices: Vec<(String, crate::serial::SerialConfig)>,
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
            let file = SerialFile { path, text: std::fs::read_to_string(path).unwrap_or_default() };
            let RawSerial { baud, format, least_latency, most_drift_ppm, columns, streams, device } =
                raw.serial;
            let streams = Some(streams).filter(|streams| !streams.is_empty());
            let general = RawSerialDevice {
                which: String::new(),
                baud,
                format,
                least_latency,
                most_drift_ppm,
                columns,
                streams,
            };
            config.serial = file.resolve(&general, config.serial.clone())?;
            for device in device {
                if device.which.trim().is_empty() {
                    return Err(file
                        .refuse("match", "expected a path, VID:PID or a serial number, found nothing")
                        .into());
                }
                let known = file.resolve(&device, config.serial.clone())?;
                config.serial_devices.push((device.which, known));
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

/// The file that says how serial devices are read.
#[cfg(feature = "serial")]
struct SerialFile<'a> {
    path: &'a Path,
    text: String,
}

#[cfg(feature = "serial")]
impl SerialFile<'_> {
    /// What is wrong at the first place where the file has this word.
    fn refuse(&self, word: &str, message: &str) -> vergence_config::Error {
        vergence_config::invalid_at(self.path, &self.text, self.text.find(word).unwrap_or(0), message)
    }

    /// What `raw` says, and else `known`.
    fn resolve(
        &self,
        raw: &RawSerialDevice,
        mut known: crate::serial::SerialConfig,
    ) -> Result<crate::serial::SerialConfig, Error> {
        use crate::serial::Format;
        match raw.baud {
            Some(0) => return Err(self.refuse("baud = 0", "expected bits per second, found 0").into()),
            Some(baud) => known.baud = baud,
            None => {}
        }
        match raw.format {
            None => {}
            Some(RawFormat::Either) => known.format = Format::Either,
            Some(RawFormat::Frames) => known.format = Format::Frames,
            Some(RawFormat::Lines) => known.format = Format::Lines,
        }
        if let Some(least) = raw.least_latency {
            let span = vergence_time::Span::from_secs_f64(least.seconds());
            known.least_latency = span.filter(|span| span.as_nanos() >= 0).ok_or_else(|| {
                let message = format!("expected a latency that is not negative, found {} s", least.seconds());
                self.refuse("least_latency", &message)
            })?;
        }
        if let Some(most) = raw.most_drift_ppm {
            if !vergence_time::ClockKnobs::DRIFTS_PPM.contains(&most) {
                let message = format!("expected 10 to 50000 parts per million, found {most}");
                return Err(self.refuse("most_drift_ppm", &message).into());
            }
            known.most_drift_ppm = most;
        }
        if let Some(streams) = &raw.streams {
            known.streams.clear();
            for (number, description) in streams {
                let stream = number.parse().ok().filter(|number: &u8| *number > 0);
                let stream =
                    stream.ok_or_else(|| self.refuse(number, "expected the number of a stream, 1 to 255"))?;
                let described = description.parse().map_err(|error: crate::serial::DescriptionError| {
                    self.refuse(description, &error.to_string())
                })?;
                known.streams.push((stream, described));
            }
        }
        if let Some(columns) = &raw.columns {
            let names = crate::serial::lines::Columns::parse(columns);
            known.columns = Some(names.map_err(|error| self.refuse(columns, &error.to_string()))?);
        }
        Ok(known)
    }
}

#[cfg(feature = "serial")]
impl Config {
    /// How this serial device is read.
    pub fn serial_of(&self, device: &crate::Found) -> &crate::serial::SerialConfig {
        let ids = device.vendor_id.zip(device.product_id);
        let ids = ids.map(|(vendor, product)| format!("{vendor:04x}:{product:04x}"));
        // A link to the port, as those in /dev/serial/by-id, is the port.
        let real = |path: &str| std::fs::canonicalize(path).ok();
        let fits = |which: &str| {
            which == device.path
                || device.serial_number.as_deref() == Some(which)
                || ids.as_ref().is_some_and(|ids| ids.eq_ignore_ascii_case(which))
                || which.contains('/') && real(which).is_some() && real(which) == real(&device.path)
        };
        let own = self.serial_devices.iter().find(|(which, _)| fits(which));
        own.map_or(&self.serial, |(_, config)| config)
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
        assert_eq!((raw.serial.device.len(), raw.serial.device[0].baud), (1, Some(9600)));
    }

    #[test]
    fn a_file_says_what_a_device_does_not() {
        let text = "[serial]\nbaud = 921600\nleast_latency = \"2 ms\"\n[serial.streams]\n1 = \"imu imu i16 0.001\"\n";
        let config = config(text).expect("written");
        assert_eq!((config.serial.baud, config.serial.streams.len()), (921_600, 1));
        assert_eq!(config.serial.least_latency, vergence_time::Span::from_millis(2));
    }

    #[test]
    fn each_device_may_have_its_own() {
        let config = config(
            "[serial]\nbaud = 9600\ncolumns = \"bpm\"\n\
             [[serial.device]]\nmatch = \"1a86:7523\"\nbaud = 921600\nformat = \"frames\"\nstreams = { 1 = \"imu imu i16\" }\n\
             [[serial.device]]\nmatch = \"/dev/ttyACM7\"\nleast_latency = \"2 ms\"\n\
             [[serial.device]]\nmatch = \"5583\"\nbaud = 300\n",
        )
        .expect("written");
        let found = |path: &str, vendor_id, product_id, serial: Option<&str>| crate::Found {
            vendor_id,
            product_id,
            serial_number: serial.map(str::to_owned),
            ..crate::Found::new("serial", path.to_owned())
        };
        let (imu, other) = (
            found("/dev/ttyUSB0", Some(0x1A86), Some(0x7523), None),
            found("/dev/ttyACM7", Some(1), Some(2), None),
        );
        let own = config.serial_of(&imu);
        assert_eq!((own.baud, own.streams.len(), own.format), (921_600, 1, crate::serial::Format::Frames));
        let own = config.serial_of(&other);
        assert_eq!((own.baud, own.least_latency), (9600, vergence_time::Span::from_millis(2)));
        assert!(own.columns.is_some() && own.streams.is_empty());
        assert_eq!(config.serial_of(&found("/dev/x", Some(1), Some(2), Some("5583"))).baud, 300);
        assert_eq!(config.serial_of(&found("/dev/x", None, None, None)).baud, 9600);
    }

    #[test]
    fn what_cannot_be_is_refused_where_it_stands() {
        for (text, wanted) in [
            ("[serial]\nbaud = 0\n", ":2:1: expected bits per second, found 0"),
            ("[serial]\nleast_latency = \"-1 ms\"\n", ":2:1: expected a latency that is not negative"),
            ("[serial]\ncolumns = \"a;b\"\n", "found 'a;b'"),
            ("[serial]\nmost_drift_ppm = 5\n", ":2:1: expected 10 to 50000 parts per million, found 5"),
            ("[[serial.device]]\nmatch = \"\"\n", ":2:1: expected a path"),
            ("[[serial.device]]\nbaud = 1\n", "match"),
            ("[[serial.device]]\nmatch = \"x\"\nbaud = 0\n", ":3:1"),
        ] {
            let error = config(text).unwrap_err().to_string();
            assert!(error.contains(wanted), "{text}: {error}");
        }
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
        let text = "name = \"unit\"\nleast_latency = \"-1 ms\"\nmatch = [{ vendor = 1 }]\nstream = []\n";
        std::fs::write(&mapping, text).expect("written");
        let error = Config::read(&config).unwrap_err().to_string();
        assert!(error.contains("unit.toml:2:1: expected a latency"), "{error}");
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
