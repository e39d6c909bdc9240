//! Mapping files: which usages, or which bytes, of which devices are which streams.

use std::path::Path;

use serde::Deserialize;
use vergence_sense::{ReadingKind, SourceStream};
use vergence_time::ClockKnobs;

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
    most_drift_ppm: Option<u32>,
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
    /// How much the device's clock may be off, parts per million.
    pub(super) most_drift_ppm: u32,
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
    /// Added to what the scale gives.
    pub(super) shift: f64,
    /// An axis: held to −1 to 1, and what is nearer to zero than this is zero.
    pub(super) axis: Option<f64>,
}

impl Place {
    /// The value of the number in a report.
    pub(super) fn value(&self, number: f64) -> f64 {
        let value = number * self.scale + self.shift;
        match self.axis {
            Some(step) if value.abs() <= step => 0.0,
            Some(_) => value.clamp(-1.0, 1.0),
            None => value,
        }
    }
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
    /// Where, and how many nanoseconds so many ticks are.
    pub(super) time: Option<(Place, (u64, u64))>,
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
        let place = |report, slot| Place { report, slot, scale: 1.0, shift: 0.0, axis: None };
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

/// The page of sensors.
const SENSORS: u16 = 0x20;
const G_M_S2: f64 = 9.806_65;

/// What one of a unit is in SI: nibbles of a system (centimetres, radians, inches or degrees; grams or slugs) and of the powers of
/// length, mass, time, temperature, current and light (Device Class Definition for HID 1.11, 6.2.2.7). `None` where it is none.
fn in_si(unit: u32) -> Option<f64> {
    let (length, mass): (f64, f64) = match unit & 0xF {
        0 if unit == 0 => return Some(1.0),
        1 => (0.01, 1e-3),
        2 => (1.0, 1e-3),
        3 => (0.0254, 14.593_903),
        4 => (std::f64::consts::PI / 180.0, 14.593_903),
        _ => return None,
    };
    // Four bits, two's complement.
    let power = |place: u32| ((unit >> (4 * place)) as i32) << 28 >> 28;
    let is_fahrenheit = unit & 0xF > 2 && power(4) != 0;
    (unit >> 28 == 0 && !is_fahrenheit).then(|| length.powi(power(1)) * mass.powi(power(2)))
}

/// What a field counts, in SI (microteslas, of magnetometers): the sensor page's usages have units of their own where the descriptor
/// names none, and some that are written like no other's (as in the kernel's table of sensors).
fn to_si(field: &super::descriptor::FieldLayout) -> f64 {
    let degrees = std::f64::consts::PI / 180.0;
    let unit = match (field.usage, field.unit) {
        // g, where nothing or "g" is said; metres per second squared.
        ((SENSORS, 0x0453..=0x0455), 0 | 0x1A) => Some(G_M_S2),
        ((SENSORS, 0x0453..=0x0455), 0x11E0) => Some(1.0),
        // Degrees per second, radians per second.
        ((SENSORS, 0x0457..=0x0459), 0 | 0x15 | 0xF014) => Some(degrees),
        ((SENSORS, 0x0457..=0x0459), 0xF012) => Some(1.0),
        // Milligauss, in microteslas; gauss.
        ((SENSORS, 0x0485..=0x0487), 0) => Some(0.1),
        ((SENSORS, 0x0485..=0x0487), 0x01E1_F000) => Some(100.0),
        ((SENSORS, 0x0485..=0x0487), unit) => in_si(unit).map(|teslas| teslas * 1e6),
        (_, unit) => in_si(unit),
    };
    let unit = unit.unwrap_or_else(|| {
        let ((page, usage), unit) = (field.usage, field.unit);
        log::warn!("usage {page:02x}:{usage:04x}: unit {unit:#x} is not understood: its numbers are taken as they are");
        1.0
    });
    10f64.powi(i32::from(field.exponent)) * unit
}

/// An axis that rests in its middle, though all its numbers are positive: X to Rz of the generic desktop page.
fn rests_in_the_middle(usage: (u16, u16)) -> bool {
    matches!(usage, (0x01, 0x30..=0x35))
}

/// Nanoseconds of so many ticks, of a clock that the descriptor says the unit of: seconds, times ten to the exponent.
fn tick(field: &super::descriptor::FieldLayout) -> Option<(u64, u64)> {
    const SECONDS: u32 = 0x1001;
    let is_said = field.unit == SECONDS || (field.unit == 0 && field.exponent != 0);
    let power = i32::from(field.exponent) + 9;
    let ten = |power: i32| 10u64.checked_pow(power.unsigned_abs());
    if !is_said {
        None
    } else if power >= 0 {
        Some((ten(power)?, 1))
    } else {
        Some((1, ten(power)?))
    }
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
        if raw.least_latency.is_some_and(|least| least.seconds() < 0.0) {
            let offset = text.find("least_latency").unwrap_or(0);
            return Err(at(offset, "expected a latency that is not negative"));
        }
        let most_drift_ppm = raw.most_drift_ppm.unwrap_or(ClockKnobs::MOST_DRIFT_PPM);
        if !ClockKnobs::DRIFTS_PPM.contains(&most_drift_ppm) {
            let offset = text.find("most_drift_ppm").unwrap_or(0);
            return Err(at(
                offset,
                &format!("expected 10 to 50000 parts per million, found {most_drift_ppm}"),
            ));
        }
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
            let frame = if gaze_point { "display" } else { "" };
            let stream = SourceStream::new(raw.name, kind).unit(raw.unit).frame(frame);
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
            most_drift_ppm,
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
                    let (low, high) = (f64::from(field.logical.0), f64::from(field.logical.1));
                    match wanted.stream.kind {
                        ReadingKind::Axis | ReadingKind::Vector2 if high > low => {
                            let way = high - low;
                            if low >= 0.0 && rests_in_the_middle(field.usage) {
                                place.scale *= 2.0 / way;
                                place.shift = -own * (low + high) / way;
                                // The middle of an even count of numbers is between two of them; both are rest.
                                place.axis = Some(own.abs() / way * 1.000_001);
                            } else {
                                // What it can be becomes −1 to 1, or 0 to 1.
                                place.scale /= low.abs().max(high.abs());
                                place.axis = Some(0.0);
                            }
                        }
                        ReadingKind::Axis | ReadingKind::Vector2 => place.axis = Some(0.0),
                        ReadingKind::Button => {}
                        // Its scale is for descriptors that say nothing.
                        ReadingKind::Gaze if field.unit != 0 => place.scale = to_si(&field),
                        _ => place.scale *= to_si(&field),
                    }
                }
                places.push(place);
            }
            Some(Resolved { stream: wanted.stream.clone(), gaze_point: wanted.gaze_point, places })
        };
        let place = |locator: &Locator| locator.resolve(layout).map(|(place, _)| place);
        Plan {
            streams: self.wanted.iter().filter_map(resolve).collect(),
            sequence: self.sequence.as_ref().and_then(place),
            time: self.time.as_ref().and_then(|(locator, tick_ns)| {
                let (place, field) = locator.resolve(layout)?;
                Some((place, field.as_ref().and_then(tick).unwrap_or((*tick_ns, 1))))
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::descriptor::FieldLayout;
    use super::*;

    fn field(usage: (u16, u16), unit: u32, exponent: i8, logical: (i32, i32)) -> FieldLayout {
        let slot = Slot { bit: 0, bits: 16, number: Number::Signed };
        FieldLayout { usage, within: Vec::new(), slot, logical, exponent, unit }
    }

    #[test]
    fn units_are_what_the_descriptor_says() {
        let degrees = std::f64::consts::PI / 180.0;
        for (usage, unit, exponent, wanted) in [
            (0x0457, 0, -2, degrees * 1e-2),
            (0x0457, 0x15, 0, degrees),
            (0x0457, 0xF014, -2, degrees * 1e-2),
            (0x0457, 0xF012, -3, 1e-3),
            (0x0453, 0, -3, 9.806_65e-3),
            (0x0453, 0x1A, 0, 9.806_65),
            (0x0453, 0x11E0, -2, 1e-2),
            // Centimetres per second squared, by the book; inches.
            (0x0453, 0xE011, 0, 1e-2),
            (0x0453, 0xE013, 0, 0.0254),
            (0x0485, 0, 0, 0.1),
            (0x0485, 0x01E1_F000, 0, 100.0),
            // What nobody understands passes as it is.
            (0x0453, 0x77, 0, 1.0),
        ] {
            let found = to_si(&field((0x20, usage), unit, exponent, (0, 0)));
            assert!((found / wanted - 1.0).abs() < 1e-12, "{usage:x} {unit:x}: {found}, {wanted}");
        }
        assert_eq!(tick(&field((0x20, 0x0529), 0x1001, -6, (0, 0))), Some((1000, 1)));
        assert_eq!(tick(&field((0x20, 0x0529), 0x1001, -10, (0, 0))), Some((1, 10)));
        assert_eq!(tick(&field((0x20, 0x0529), 0, -6, (0, 0))), Some((1000, 1)));
        assert_eq!(tick(&field((0x20, 0x0529), 0, 0, (0, 0))), None);
    }

    #[test]
    fn axes_rest_at_zero_and_reach_both_ends() {
        // Usage, logical range, and numbers with what they are.
        let six = Mapping::shipped().into_iter().find(|mapping| mapping.name == "6-DoF controller").unwrap();
        let plan = |logical: (i32, i32)| {
            let fields = vec![field((0x01, 0x30), 0, 0, logical)];
            let reports = vec![super::super::descriptor::ReportLayout { id: None, bytes: 2, fields }];
            six.plan(&Layout { reports }).streams[0].places[0]
        };
        for (logical, all) in [
            ((0, 255), vec![(0.0, -1.0), (127.0, 0.0), (128.0, 0.0), (255.0, 1.0), (191.0, 127.0 / 255.0)]),
            ((0, 1024), vec![(0.0, -1.0), (512.0, 0.0), (1024.0, 1.0), (768.0, 0.5)]),
            ((-350, 350), vec![(-350.0, -1.0), (0.0, 0.0), (350.0, 1.0), (35.0, 0.1), (400.0, 1.0)]),
        ] {
            let place = plan(logical);
            for (number, wanted) in all {
                let found = place.value(number);
                assert!((found - wanted).abs() < 1e-9, "{logical:?}: {number} is {found}, not {wanted}");
            }
        }
    }

    #[test]
    fn the_example_of_the_documentation_is_a_mapping() {
        let text = include_str!("../../MAPPING.md");
        let example =
            text.split("```toml\n").nth(2).and_then(|rest| rest.split("```").next()).expect("the second");
        let mapping = Mapping::parse(Path::new("MAPPING.md"), example).unwrap();
        assert!(mapping.sequence.is_some() && mapping.time.is_some() && mapping.least_latency_s > 0.0);
        assert_eq!(mapping.streams().collect::<Vec<_>>(), ["imu"]);
    }

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
