//! A scene file as it stands: keys, types and units checked, nothing else.

use std::collections::BTreeMap;

use serde::Deserialize;
use serde::de::{Deserializer, Error as _, SeqAccess, Visitor};
use toml::Spanned;
use vergence_config::{Angle, Length};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SceneFile {
    pub name: Option<String>,
    pub background: Option<Color>,
    pub ambient: Option<Color>,
    pub start: Option<Spanned<Start>>,
    #[serde(default, rename = "material")]
    pub materials: BTreeMap<String, Spanned<Material>>,
    #[serde(default, rename = "model")]
    pub models: Vec<Spanned<Model>>,
    #[serde(default, rename = "shape")]
    pub shapes: Vec<Spanned<Shape>>,
    #[serde(default, rename = "light")]
    pub lights: Vec<Spanned<Light>>,
    #[serde(default, rename = "label")]
    pub labels: Vec<Spanned<Label>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Start {
    #[serde(default)]
    pub position: [Coordinate; 3],
    pub yaw: Option<Angle>,
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Turn {
    pub yaw: Option<Angle>,
    pub pitch: Option<Angle>,
    pub roll: Option<Angle>,
}

/// Where something stands: the keys `position`, `rotation`, `scale` of a table.
pub(super) struct Placement {
    pub position: [Coordinate; 3],
    pub rotation: Option<Turn>,
    pub scale: Option<Scale>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Model {
    #[serde(default)]
    pub name: String,
    pub file: Spanned<String>,
    #[serde(default)]
    pub position: [Coordinate; 3],
    pub rotation: Option<Turn>,
    pub scale: Option<Scale>,
    pub animations: Option<Vec<Spanned<String>>>,
    #[serde(default)]
    pub touchable: bool,
    #[serde(default)]
    pub touchables: Vec<Spanned<String>>,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Kind {
    Box,
    Rectangle,
    Sphere,
    Cylinder,
    Lathe,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Shape {
    #[serde(default)]
    pub name: String,
    pub kind: Kind,
    pub size: Option<Vec<Coordinate>>,
    pub radius: Option<Coordinate>,
    pub height: Option<Coordinate>,
    pub profile: Option<Vec<[Coordinate; 2]>>,
    pub segments: Option<u32>,
    pub material: Option<Spanned<String>>,
    #[serde(default)]
    pub position: [Coordinate; 3],
    pub rotation: Option<Turn>,
    pub scale: Option<Scale>,
    #[serde(default)]
    pub touchable: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Material {
    pub color: Option<Color>,
    pub texture: Option<Spanned<String>>,
    pub normal_texture: Option<Spanned<String>>,
    pub normal_scale: Option<f32>,
    pub roughness_texture: Option<Spanned<String>>,
    pub metallic: Option<f32>,
    pub roughness: Option<f32>,
    pub opacity: Option<f32>,
    pub emissive: Option<Color>,
    pub emissive_texture: Option<Spanned<String>>,
    /// The textures repeat after this length (or these: across, down).
    pub tile: Option<Tile>,
    #[serde(default)]
    pub unlit: bool,
    #[serde(default)]
    pub double_sided: bool,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum LightKind {
    Directional,
    Point,
    Spot,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Light {
    #[serde(default)]
    pub name: String,
    pub kind: LightKind,
    pub color: Option<Color>,
    pub intensity: f64,
    pub position: Option<[Coordinate; 3]>,
    pub target: Option<[Coordinate; 3]>,
    pub range: Option<Coordinate>,
    pub inner: Option<Angle>,
    pub outer: Option<Angle>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Label {
    #[serde(default)]
    pub name: String,
    pub text: String,
    pub cap_height: Length,
    pub color: Option<Color>,
    #[serde(default)]
    pub billboard: bool,
    #[serde(default)]
    pub position: [Coordinate; 3],
    pub rotation: Option<Turn>,
}

impl Model {
    pub fn placement(&self) -> Placement {
        Placement { position: self.position, rotation: self.rotation, scale: self.scale }
    }
}

impl Shape {
    pub fn placement(&self) -> Placement {
        Placement { position: self.position, rotation: self.rotation, scale: self.scale }
    }
}

impl Label {
    pub fn placement(&self) -> Placement {
        Placement { position: self.position, rotation: self.rotation, scale: None }
    }
}

/// A length: a number in metres, or a string with its unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Coordinate(pub f64);

impl<'de> Deserialize<'de> for Coordinate {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Expected;
        impl Visitor<'_> for Expected {
            type Value = Coordinate;
            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("a length: a number in metres, or a string with its unit such as \"1.5 m\"")
            }
            fn visit_f64<E: serde::de::Error>(self, metres: f64) -> Result<Coordinate, E> {
                if metres.is_finite() {
                    Ok(Coordinate(metres))
                } else {
                    Err(E::custom("expected a finite length"))
                }
            }
            fn visit_i64<E: serde::de::Error>(self, metres: i64) -> Result<Coordinate, E> {
                Ok(Coordinate(metres as f64))
            }
            fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<Coordinate, E> {
                Length::deserialize(serde::de::value::StrDeserializer::new(text))
                    .map(|length| Coordinate(length.metres()))
            }
        }
        deserializer.deserialize_any(Expected)
    }
}

/// One length, or two.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Tile(pub [f64; 2]);

impl<'de> Deserialize<'de> for Tile {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Expected;
        impl<'de> Visitor<'de> for Expected {
            type Value = Tile;
            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("a length (a number in metres, or a string with its unit), or two of them")
            }
            fn visit_f64<E>(self, metres: f64) -> Result<Tile, E> {
                Ok(Tile([metres; 2]))
            }
            fn visit_i64<E>(self, metres: i64) -> Result<Tile, E> {
                Ok(Tile([metres as f64; 2]))
            }
            fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<Tile, E> {
                Length::deserialize(serde::de::value::StrDeserializer::new(text))
                    .map(|length| Tile([length.metres(); 2]))
            }
            fn visit_seq<A: SeqAccess<'de>>(self, seq: A) -> Result<Tile, A::Error> {
                let [u, v] =
                    <[Coordinate; 2]>::deserialize(serde::de::value::SeqAccessDeserializer::new(seq))?;
                Ok(Tile([u.0, v.0]))
            }
        }
        deserializer.deserialize_any(Expected)
    }
}

/// One factor, or three: up to 1e9, and something is left. One or two of three may be 0: that is flat.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Scale(pub [f64; 3]);

impl Scale {
    fn checked<E: serde::de::Error>(self) -> Result<Self, E> {
        let Self(factors) = self;
        if factors.iter().all(|factor| factor.abs() <= 1e9) && factors != [0.0; 3] {
            return Ok(self);
        }
        Err(E::custom(format_args!(
            "expected a scale up to 1e9 that leaves something to see, found {factors:?}"
        )))
    }
}

impl<'de> Deserialize<'de> for Scale {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Expected;
        impl<'de> Visitor<'de> for Expected {
            type Value = Scale;
            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("a factor, or three of them")
            }
            fn visit_f64<E: serde::de::Error>(self, factor: f64) -> Result<Scale, E> {
                Scale([factor; 3]).checked()
            }
            fn visit_i64<E: serde::de::Error>(self, factor: i64) -> Result<Scale, E> {
                Scale([factor as f64; 3]).checked()
            }
            fn visit_seq<A: SeqAccess<'de>>(self, seq: A) -> Result<Scale, A::Error> {
                let factors = <[f64; 3]>::deserialize(serde::de::value::SeqAccessDeserializer::new(seq))?;
                Scale(factors).checked()
            }
        }
        deserializer.deserialize_any(Expected)
    }
}

/// Linear RGB: `"#rrggbb"` is decoded from sRGB, `[r, g, b]` is taken as it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Color(pub [f32; 3]);

impl<'de> Deserialize<'de> for Color {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Expected;
        impl<'de> Visitor<'de> for Expected {
            type Value = Color;
            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("a colour: \"#rrggbb\" (sRGB) or [r, g, b] (linear)")
            }
            fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<Color, E> {
                let digits = text.strip_prefix('#').filter(|d| d.len() == 6 && d.is_ascii());
                let value = digits.and_then(|digits| u32::from_str_radix(digits, 16).ok());
                let value = value.ok_or_else(|| {
                    E::custom(format!("expected a colour such as \"#ffcc88\", found {text:?}"))
                })?;
                let channel =
                    |shift: u32| crate::lines::linear_from_srgb((value >> shift & 0xFF) as f32 / 255.0);
                Ok(Color([channel(16), channel(8), channel(0)]))
            }
            fn visit_seq<A: SeqAccess<'de>>(self, seq: A) -> Result<Color, A::Error> {
                let color = <[f32; 3]>::deserialize(serde::de::value::SeqAccessDeserializer::new(seq))?;
                if color.iter().all(|c| (0.0..=1e9).contains(c)) {
                    Ok(Color(color))
                } else {
                    Err(A::Error::custom(format!("expected a colour from 0 to 1e9, found {color:?}")))
                }
            }
        }
        deserializer.deserialize_any(Expected)
    }
}
