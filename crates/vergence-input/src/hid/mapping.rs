//! Mapping files: which usages, or which bytes, of which devices are which streams.

use std::path::Path;

use serde::Deserialize;
use vergence_sense::{ReadingKind, SourceStream};

use super::descriptor::{Layout, Number, Slot};
use crate::error::Error;

/// No stream takes more numbers.
pub(super) const MOST_VALUES: usize = 9;

/// Those that are built in: name and text.
const SHIPPED: [(&str, &str); 3] = [
    ("six-dof.toml", include_str!("../../mappings/six-dof.toml")),
    ("sensor-imu.toml", include_str!("../../mappings/sensor-imu.toml")),
    ("eye-tracker.toml", include_str!("../../mappings/eye-tracker.toml")),
];

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    name: String,
    #[serde(rename = "match")]
    matches: Vec<RawMatch>,
    sequence: Option<toml::Spanned<String>>,
    time: Option<RawTime>,
    #[serde(default)]
    least_latency: Option<vergence_config::Duration>,
    stream: Vec<RawStream>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawMatch {
    vendor: Option<u16>,
    product: Option<u16>,
    usage: Option<toml::Spanned<String>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawTime {
    from: toml::Spanned<String>,
    tick_ns: u64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawStream {
    name: String,
    kind: toml::Spanned<String>,
    from: toml::Spanned<Vec<toml::Spanned<String>>>,
    #[serde(default)]
    scale: Vec<f64>,
    #[serde(default)]
    unit: String,
}

/// Where a number is, before the device is known.
#[derive(Clone, Debug, PartialEq)]
enum Locator {
    /// The field with this usage, inside of a collection with that one where one is named.
    Usage { usage: (u16, u16), within: Option<(u16, u16)> },
    /// Bytes of the report with this number (none where the device has one kind only).
    Bytes { report: Option<u8>, slot: Slot },
}

/// What a stream is made of.
#[derive(Clone, Debug, PartialEq)]
struct Wanted {
    stream: SourceStream,
    /// A gaze that is given as the point looked at and where the two eyes are.
    gaze_point: bool,
    from: Vec<Locator>,
    scale: Vec<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Match {
    vendor: Option<u16>,
    product: Option<u16>,
    usage: Option<(u16, u16)>,
}

/// A mapping file: for which devices it is, and what their reports say.
#[derive(Clone, Debug, PartialEq)]
pub struct Mapping {
    /// For people.
    pub name: String,
    matches: Vec<Match>,
    sequence: Option<Locator>,
    time: Option<(Locator, u64)>,
    /// What the fastest reading takes, seconds.
    pub(super) least_latency_s: f64,
    wanted: Vec<Wanted>,
}

/// What identifies a device, as far as mappings ask.
#[derive(Clone, Debug, Default)]
pub struct Identity {
    /// Of the maker.
    pub vendor_id: u16,
    /// Of the product.
    pub product_id: u16,
    /// Of its outermost collections.
    pub usages: Vec<(u16, u16)>,
}

/// One number of a stream, in the reports of a device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Place {
    pub(super) report: Option<u8>,
    pub(super) slot: Slot,
    pub(super) scale: f64,
    pub(super) clamp: bool,
}

/// A stream, in the reports of a device.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Resolved {
    pub(super) stream: SourceStream,
    pub(super) gaze_point: bool,
    pub(super) places: Vec<Place>,
}

/// A mapping, in the reports of a device.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Plan {
    pub(super) streams: Vec<Resolved>,
    pub(super) sequence: Option<Place>,
    pub(super) time: Option<(Place, u64)>,
}

fn usage(text: &str) -> Result<(u16, u16), String> {
    let refuse =
        || format!("expected a usage such as \"01:30\" (page and usage, hexadecimal), found \"{text}\"");
    let (page, usage) = text.split_once(':').ok_or_else(refuse)?;
    let hex = |text: &str| u16::from_str_radix(text, 16).map_err(|_| refuse());
    Ok((hex(page)?, hex(usage)?))
}

impl std::str::FromStr for Locator {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let Some(bytes) = text.strip_prefix('@') else {
            return Ok(match text.split_once('/') {
                Some((within, inner)) => Self::Usage { usage: usage(inner)?, within: Some(usage(within)?) },
                None => Self::Usage { usage: usage(text)?, within: None },
            });
        };
        let refuse = || {
            format!(
                "expected bytes such as \"@1:7:i16\" (report or -, first byte, u8 i8 u16 i16 u32 i32 u64 f32 f64), found \"{text}\""
            )
        };
        let mut parts = bytes.split(':');
        let (Some(report), Some(byte), Some(format), None) =
            (parts.next(), parts.next(), parts.next(), parts.next())
        else {
            return Err(refuse());
        };
        let report = if report == "-" { None } else { Some(report.parse().map_err(|_| refuse())?) };
        let byte: u16 = byte.parse().map_err(|_| refuse())?;
        let number = match format.as_bytes().first() {
            Some(b'u') => Number::Unsigned,
            Some(b'i') => Number::Signed,
            Some(b'f') => Number::Float,
            _ => return Err(refuse()),
        };
        let bits: usize = format[1..].parse().map_err(|_| refuse())?;
        let known = match number {
            Number::Float => matches!(bits, 32 | 64),
            _ => matches!(bits, 8 | 16 | 32 | 64),
        };
        if !known {
            return Err(refuse());
        }
        Ok(Self::Bytes { report, slot: Slot { bit: usize::from(byte) * 8, bits, number } })
    }
}

impl Locator {
    /// In the reports of a device: the place, and what the descriptor says of the field.
    fn resolve(&self, layout: &Layout) -> Option<(Place, Option<super::descriptor::FieldLayout>)> {
        let place = |report, slot| Place { report, slot, scale: 1.0, clamp: false };
        match self {
            Self::Bytes { report, slot } => Some((place(*report, *slot), None)),
            Self::Usage { usage, within } => layout.reports.iter().find_map(|report| {
                let fits = |field: &&super::descriptor::FieldLayout| {
                    field.usage == *usage && within.is_none_or(|within| field.within.contains(&within))
                };
                let field = report.fields.iter().find(fits)?;
                Some((place(report.id, field.slot), Some(field.clone())))
            }),
        }
    }
}

/// What a field counts, in SI: the sensor page's usages have units of their own where the descriptor names none.
fn to_si(field: &super::descriptor::FieldLayout) -> f64 {
    const SENSORS: u16 = 0x20;
    let unit = match (field.usage, field.unit) {
        // g, where nothing or "g" is said.
        ((SENSORS, 0x0453..=0x0455), 0 | 0x1A) => 9.806_65,
        // Degrees per second.
        ((SENSORS, 0x0457..=0x0459), 0 | 0x15) => std::f64::consts::PI / 180.0,
        // Milligauss, in microteslas.
        ((SENSORS, 0x0485..=0x0487), 0) => 0.1,
        _ => 1.0,
    };
    10f64.powi(i32::from(field.exponent)) * unit
}

impl Mapping {
    /// From the text of a mapping file, naming `path` in errors.
    ///
    /// # Errors
    /// With the place where it is wrong.
    pub fn parse(path: &Path, text: &str) -> Result<Self, Error> {
        let raw: Raw = vergence_config::parse(path, text)?;
        let at = |offset: usize, message: &str| {
            Error::from(vergence_config::invalid_at(path, text, offset, message))
        };
        let locator = |text: &toml::Spanned<String>| {
            text.get_ref().parse::<Locator>().map_err(|message| at(text.span().start, &message))
        };
        let mut matches = Vec::new();
        for raw in raw.matches {
            let known =
                raw.usage.as_ref().map(|text| usage(text.get_ref()).map_err(|m| at(text.span().start, &m)));
            let found = Match { vendor: raw.vendor, product: raw.product, usage: known.transpose()? };
            if found.vendor.is_none() && found.usage.is_none() {
                return Err(at(0, "a match names a vendor or a usage"));
            }
            matches.push(found);
        }
        let mut wanted = Vec::new();
        for raw in raw.stream {
            let (kind, counts): (_, &[usize]) = match raw.kind.get_ref().as_str() {
                "axis" => (ReadingKind::Axis, &[1]),
                "button" => (ReadingKind::Button, &[1]),
                "scalar" => (ReadingKind::Scalar, &[1]),
                "vector2" => (ReadingKind::Vector2, &[2]),
                "imu" => (ReadingKind::Imu, &[6, 9]),
                "gaze" => (ReadingKind::Gaze, &[6]),
                "gaze_point" => (ReadingKind::Gaze, &[8]),
                "pose" => (ReadingKind::Pose, &[7]),
                other => {
                    let message = format!(
                        "expected axis, button, scalar, vector2, imu, gaze, gaze_point or pose, found {other}"
                    );
                    return Err(at(raw.kind.span().start, &message));
                }
            };
            let count = raw.from.get_ref().len();
            if !counts.contains(&count) {
                let message = format!("expected {counts:?} numbers, found {count}");
                return Err(at(raw.from.span().start, &message));
            }
            if !(raw.scale.len() <= 1 || raw.scale.len() == count) || raw.scale.iter().any(|s| !s.is_finite())
            {
                let message = format!("expected no scale, one, or {count}, found {}", raw.scale.len());
                return Err(at(raw.from.span().start, &message));
            }
            let from = raw.from.get_ref().iter().map(locator).collect::<Result<_, _>>()?;
            let gaze_point = raw.kind.get_ref() == "gaze_point";
            let stream = SourceStream::new(raw.name, kind).unit(raw.unit);
            wanted.push(Wanted { stream, gaze_point, from, scale: raw.scale });
        }
        let time = match raw.time {
            Some(raw) => Some((locator(&raw.from)?, raw.tick_ns)),
            None => None,
        };
        Ok(Self {
            name: raw.name,
            matches,
            sequence: raw.sequence.as_ref().map(locator).transpose()?,
            time,
            least_latency_s: raw.least_latency.map_or(0.0, |latency| latency.seconds()),
            wanted,
        })
    }

    /// Reads a mapping file.
    ///
    /// # Errors
    /// Where it cannot be read, or with the place where it is wrong.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| vergence_config::Error::Io { path: path.to_owned(), source })?;
        Self::parse(path, &text)
    }

    /// Those that are built in: a 6-degrees-of-freedom controller, the sensor page's inertial unit, the eye tracker page.
    pub fn shipped() -> Vec<Self> {
        let parse = |(name, text): (&str, &str)| match Self::parse(Path::new(name), text) {
            Ok(mapping) => Some(mapping),
            Err(error) => {
                log::error!("built in: {error}");
                None
            }
        };
        SHIPPED.into_iter().filter_map(parse).collect()
    }

    /// Whether it is for this device.
    pub fn fits(&self, device: &Identity) -> bool {
        self.matches.iter().any(|wanted| {
            wanted.vendor.is_none_or(|vendor| vendor == device.vendor_id)
                && wanted.product.is_none_or(|product| product == device.product_id)
                && wanted.usage.is_none_or(|usage| device.usages.contains(&usage))
        })
    }

    /// Names of its streams.
    pub fn streams(&self) -> impl Iterator<Item = &str> {
        self.wanted.iter().map(|wanted| wanted.stream.name.as_str())
    }

    /// In the reports of a device; streams that it does not have are left out.
    pub(super) fn plan(&self, layout: &Layout) -> Plan {
        let resolve = |wanted: &Wanted| {
            let mut places = Vec::new();
            for (index, locator) in wanted.from.iter().enumerate() {
                let (mut place, field) = locator.resolve(layout)?;
                let own = match wanted.scale.as_slice() {
                    [] => 1.0,
                    [all] => *all,
                    each => each[index],
                };
                place.scale = own;
                if let Some(field) = field {
                    place.scale *= match wanted.stream.kind {
                        // What it can be becomes −1 to 1, or 0 to 1.
                        ReadingKind::Axis | ReadingKind::Vector2 => {
                            let (low, high) = field.logical;
                            let most = f64::from(low).abs().max(f64::from(high).abs());
                            if most > 0.0 { most.recip() } else { 1.0 }
                        }
                        ReadingKind::Button => 1.0,
                        _ => to_si(&field),
                    };
                    place.clamp = matches!(wanted.stream.kind, ReadingKind::Axis | ReadingKind::Vector2);
                }
                places.push(place);
            }
            Some(Resolved { stream: wanted.stream.clone(), gaze_point: wanted.gaze_point, places })
        };
        let place = |locator: &Locator| locator.resolve(layout).map(|(place, _)| place);
        Plan {
            streams: self.wanted.iter().filter_map(resolve).collect(),
            sequence: self.sequence.as_ref().and_then(place),
            time: self.time.as_ref().and_then(|(locator, tick_ns)| Some((place(locator)?, *tick_ns))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_built_in_can_be_read() {
        assert_eq!(Mapping::shipped().len(), SHIPPED.len());
    }

    #[test]
    fn errors_name_the_place() {
        let head = "name = \"x\"\n[[match]]\nvendor = 1\n";
        for (rest, place, says) in [
            ("[[stream]]\nname = \"a\"\nkind = \"axes\"\nfrom = [\"01:30\"]", "m.toml:6:8", "expected axis"),
            (
                "[[stream]]\nname = \"a\"\nkind = \"axis\"\nfrom = [\"0130\"]",
                "m.toml:7:9",
                "expected a usage",
            ),
            (
                "[[stream]]\nname = \"a\"\nkind = \"axis\"\nfrom = [\"@1:2:u9\"]",
                "m.toml:7:9",
                "expected bytes",
            ),
            (
                "[[stream]]\nname = \"a\"\nkind = \"imu\"\nfrom = [\"01:30\"]",
                "m.toml:7:8",
                "numbers, found 1",
            ),
            ("[[stream]]\nnmae = \"a\"", "m.toml:5:1", "unknown field"),
        ] {
            let error =
                Mapping::parse(Path::new("m.toml"), &format!("{head}{rest}")).unwrap_err().to_string();
            assert!(error.starts_with(place) && error.contains(says), "{error}");
        }
    }
}
