//! What a stream of a serial device is, in the words of `SERIAL.md`.

use std::borrow::Cow;

use vergence_sense::{Reading, ReadingKind, SourceStream};

use crate::values::reading;

/// No stream has more values.
pub(super) const MOST_VALUES: usize = 9;

/// How a number is on the wire; little-endian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    F32,
    F64,
}

impl Format {
    const ALL: [(&'static str, Self); 8] = [
        ("u8", Self::U8),
        ("i8", Self::I8),
        ("u16", Self::U16),
        ("i16", Self::I16),
        ("u32", Self::U32),
        ("i32", Self::I32),
        ("f32", Self::F32),
        ("f64", Self::F64),
    ];

    const fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// As many numbers as there are places for, each times its scale. The format is looked at once, and not for each number.
    fn read(self, bytes: &[u8], scale: &[f64; MOST_VALUES], values: &mut [f64]) {
        fn each<const N: usize>(
            bytes: &[u8],
            scale: &[f64; MOST_VALUES],
            values: &mut [f64],
            number: impl Fn([u8; N]) -> f64,
        ) {
            for ((value, bytes), scale) in values.iter_mut().zip(bytes.as_chunks().0).zip(scale) {
                *value = number(*bytes) * scale;
            }
        }
        match self {
            Self::U8 => each(bytes, scale, values, |[byte]| f64::from(byte)),
            Self::I8 => each(bytes, scale, values, |[byte]| f64::from(byte.cast_signed())),
            Self::U16 => each(bytes, scale, values, |bytes| f64::from(u16::from_le_bytes(bytes))),
            Self::I16 => each(bytes, scale, values, |bytes| f64::from(i16::from_le_bytes(bytes))),
            Self::U32 => each(bytes, scale, values, |bytes| f64::from(u32::from_le_bytes(bytes))),
            Self::I32 => each(bytes, scale, values, |bytes| f64::from(i32::from_le_bytes(bytes))),
            Self::F32 => each(bytes, scale, values, |bytes| f64::from(f32::from_le_bytes(bytes))),
            Self::F64 => each(bytes, scale, values, f64::from_le_bytes),
        }
    }
}

/// What a stream of a serial device is: `NAME KIND FORMAT [SCALE…] [UNIT]`.
#[derive(Clone, Debug, PartialEq)]
pub struct Description {
    name: String,
    kind: ReadingKind,
    values: usize,
    format: Format,
    scale: [f64; MOST_VALUES],
    unit: String,
}

/// What a payload says.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Payload {
    Value(Reading<'static>),
    /// It fits, and has no value: numbers that are none.
    Nothing,
    /// It has another length.
    Misfit,
}

/// Why a description makes no sense.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("description of a stream: expected {expected}, found '{found}'")]
pub struct DescriptionError {
    expected: &'static str,
    found: String,
}

const KINDS: [(&str, ReadingKind, usize); 7] = [
    ("imu", ReadingKind::Imu, 6),
    ("scalar", ReadingKind::Scalar, 1),
    ("axis", ReadingKind::Axis, 1),
    ("button", ReadingKind::Button, 1),
    ("vector2", ReadingKind::Vector2, 2),
    ("gaze", ReadingKind::Gaze, 6),
    ("pose", ReadingKind::Pose, 7),
];

impl std::str::FromStr for Description {
    type Err = DescriptionError;

    fn from_str(text: &str) -> Result<Self, DescriptionError> {
        let refuse = |expected, found: &str| {
            Err(DescriptionError { expected, found: found.chars().take(60).collect() })
        };
        let mut words = text.split_ascii_whitespace();
        let name = words.next().unwrap_or("");
        let allowed = |c: char| c.is_ascii_alphanumeric() || "_-/".contains(c);
        if name.is_empty()
            || name.len() > 64
            || !name.chars().all(allowed)
            || name.split('/').any(str::is_empty)
        {
            return refuse("a name of 1 to 64 letters, digits, '_', '-', '/'", name);
        }
        let word = words.next().unwrap_or("");
        let Some(&(_, kind, values)) = KINDS.iter().find(|kind| kind.0 == word) else {
            return refuse("imu, scalar, axis, button, vector2, gaze or pose", word);
        };
        let word = words.next().unwrap_or("");
        let Some(&(_, format)) = Format::ALL.iter().find(|format| format.0 == word) else {
            return refuse("u8, i8, u16, i16, u32, i32, f32 or f64", word);
        };
        let (mut scales, mut unit) = (Vec::new(), String::new());
        for word in words {
            match word.parse::<f64>() {
                Ok(scale) if scale.is_finite() && unit.is_empty() && scales.len() < MOST_VALUES => {
                    scales.push(scale);
                }
                Err(_) if unit.is_empty() && word.len() <= 16 => unit = word.to_owned(),
                _ => return refuse("finite scales, then a unit", word),
            }
        }
        let values = match (kind, scales.len()) {
            // With a magnetometer.
            (ReadingKind::Imu, 9) => 9,
            (_, 0 | 1) => values,
            (_, count) if count == values => values,
            _ => return refuse("no scale, one, or one for each value", text),
        };
        let mut scale = [scales.first().copied().unwrap_or(1.0); MOST_VALUES];
        if scales.len() > 1 {
            scale[..scales.len()].copy_from_slice(&scales);
        }
        Ok(Self { name: name.to_owned(), kind, values, format, scale, unit })
    }
}

impl Description {
    /// As a stream of a source, under this name.
    pub(super) fn stream(&self, name: String) -> SourceStream {
        SourceStream::new(name, self.kind).unit(self.unit.clone())
    }

    pub(super) fn name(&self) -> &str {
        &self.name
    }

    /// How long payloads are.
    pub(super) fn bytes(&self) -> usize {
        self.values * self.format.bytes()
    }

    /// What a payload says.
    pub(super) fn read(&self, payload: &[u8]) -> Payload {
        let bytes = self.format.bytes();
        let mut count = self.values;
        if payload.len() != count * bytes {
            // An inertial unit with a magnetometer and one scale for all.
            if self.kind != ReadingKind::Imu || payload.len() != 9 * bytes {
                return Payload::Misfit;
            }
            count = 9;
        }
        let mut values = [0.0; MOST_VALUES];
        self.format.read(payload, &self.scale, &mut values[..count]);
        reading(self.kind, &values[..count]).map_or(Payload::Nothing, Payload::Value)
    }
}

/// A name that none of `streams` has yet.
pub(super) fn unique(name: &str, streams: &[SourceStream]) -> Cow<'static, str> {
    let taken = |name: &str| streams.iter().any(|stream| stream.name == name);
    if !taken(name) {
        return name.to_owned().into();
    }
    (2u32..).map(|n| format!("{name}~{n}")).find(|name| !taken(name)).unwrap_or_default().into()
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use vergence_sense::{Axis, Button, Scalar};

    use super::*;

    #[test]
    fn payloads_are_read_as_described() {
        let imu: Description = "imu imu i16 0.5 0.5 0.5 2 2 2".parse().unwrap();
        let payload: Vec<u8> = [1i16, -2, 3, 4, -5, 6].iter().flat_map(|v| v.to_le_bytes()).collect();
        let Payload::Value(Reading::Imu(read)) = imu.read(&payload) else { panic!("no inertial unit") };
        assert_eq!(read.gyr_rad_s, Vector3::new(0.5, -1.0, 1.5));
        assert_eq!(read.acc_m_s2, Vector3::new(8.0, -10.0, 12.0));
        assert_eq!(imu.read(&payload[..11]), Payload::Misfit);
        let heart: Description = "heart scalar u8 bpm".parse().unwrap();
        assert_eq!(heart.read(&[72]), Payload::Value(Reading::Scalar(Scalar(72.0))));
        assert_eq!(heart.stream("heart".into()).unit, "bpm");
        for (format, bytes, wanted) in [
            ("i8", vec![0xFE], -2.0),
            ("u16", vec![1, 2], 513.0),
            ("u32", vec![0, 0, 0, 128], 2_147_483_648.0),
            ("i32", vec![0, 0, 0, 128], -2_147_483_648.0),
            ("f32", 0.25f32.to_le_bytes().to_vec(), 0.25),
            ("f64", (-7.5f64).to_le_bytes().to_vec(), -7.5),
        ] {
            let one: Description = format!("x scalar {format}").parse().unwrap();
            assert_eq!(one.read(&bytes), Payload::Value(Reading::Scalar(Scalar(wanted))), "{format}");
        }
    }

    #[test]
    fn nonsense_is_refused_with_what_was_expected() {
        for text in [
            "",
            "a",
            "a imu",
            "a b u8",
            "a//b scalar u8",
            "é scalar u8",
            "a imu i16 1 2",
            "a scalar u8 1e999",
            "a scalar u8 bpm 3",
            "a scalar u8 1 2",
        ] {
            let error = text.parse::<Description>().unwrap_err().to_string();
            assert!(error.contains("expected") && error.contains("found"), "{text}: {error}");
        }
        let gaze: Description = "eye gaze f32".parse().unwrap();
        assert_eq!(gaze.read(&[0; 24]), Payload::Value(Reading::Gaze(None)));
        let nan: Vec<u8> = [f32::NAN; 6].iter().flat_map(|v| v.to_le_bytes()).collect();
        assert_eq!(gaze.read(&nan), Payload::Value(Reading::Gaze(None)));
        for (kind, wanted) in [
            ("scalar", Payload::Nothing),
            ("axis", Payload::Value(Reading::Axis(Axis(None)))),
            ("button", Payload::Value(Reading::Button(Button(None)))),
        ] {
            let one: Description = format!("x {kind} f32").parse().unwrap();
            assert_eq!(one.read(&nan[..4]), wanted, "{kind}");
        }
    }
}
