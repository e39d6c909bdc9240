use std::fmt;

/// Something that can be turned, and where to.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Knob {
    /// As configuration files call it.
    pub name: String,
    /// Of its values; empty where there is none.
    pub unit: String,
    /// The positions that are measured.
    pub values: Vec<Value>,
}

impl Knob {
    /// A name, a unit, and the positions that are measured.
    pub fn new(name: impl Into<String>, unit: impl Into<String>, values: Vec<Value>) -> Self {
        Self { name: name.into(), unit: unit.into(), values }
    }
}

/// A position of a knob.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
#[serde(untagged)]
pub enum Value {
    /// On or off.
    Switch(bool),
    /// A whole number.
    Count(u32),
    /// Any number.
    Number(f64),
    /// One of several kinds.
    Kind(String),
}

impl From<bool> for Value {
    fn from(value: bool) -> Self {
        Self::Switch(value)
    }
}

impl From<u32> for Value {
    fn from(value: u32) -> Self {
        Self::Count(value)
    }
}

impl From<f64> for Value {
    fn from(value: f64) -> Self {
        Self::Number(value)
    }
}

impl From<&str> for Value {
    fn from(value: &str) -> Self {
        Self::Kind(value.to_owned())
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Switch(value) => f.write_str(if *value { "on" } else { "off" }),
            Self::Count(value) => value.fmt(f),
            Self::Number(value) => value.fmt(f),
            Self::Kind(value) => value.fmt(f),
        }
    }
}

/// Where all knobs stand: name and value, in the trade's order.
#[derive(Clone, Debug, PartialEq)]
pub struct Setting(pub Vec<(String, Value)>);

impl Setting {
    /// Where the knob `name` stands.
    pub fn get(&self, name: &str) -> Option<&Value> {
        self.0.iter().find(|(knob, _)| knob == name).map(|(_, value)| value)
    }
}

impl fmt::Display for Setting {
    /// Such as `msaa 4, normal_maps on`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, (name, value)) in self.0.iter().enumerate() {
            write!(f, "{}{name} {value}", if index == 0 { "" } else { ", " })?;
        }
        Ok(())
    }
}

impl serde::Serialize for Setting {
    /// As a map, in the trade's order.
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().map(|(name, value)| (name, value)))
    }
}
