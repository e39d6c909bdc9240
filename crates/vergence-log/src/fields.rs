//! Messages taken apart into named values, so that people can be told what differs.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::schema::{Kind, Schema};
use crate::wire::{Decoder, Value, WireError};

/// Fields that are told; a picture's or a hand's may all differ.
const TOLD: usize = 8;
/// Messages inside of messages that are taken apart.
const DEPTH: usize = 8;

/// A field that two messages differ in.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct FieldDiff {
    /// `pose.position.x`, `poses[1].orientation.w`.
    pub name: String,
    /// In the first log; `None` where the field is not there.
    pub a: Option<String>,
    /// In the second log.
    pub b: Option<String>,
}

/// The values of a message by their names, in the order of the fields' numbers.
#[derive(Default)]
struct Named(BTreeMap<(Vec<(u32, usize)>, String), String>);

impl Named {
    fn of(schema: Option<&Schema>, bytes: &[u8]) -> Option<Self> {
        let mut named = Self::default();
        named.take(schema, bytes, &[], "", DEPTH).ok()?;
        Some(named)
    }

    fn put(&mut self, path: &[(u32, usize)], name: String, value: String) {
        self.0.insert((path.to_vec(), name), value);
    }

    fn take(
        &mut self,
        schema: Option<&Schema>,
        bytes: &[u8],
        above: &[(u32, usize)],
        prefix: &str,
        depth: usize,
    ) -> Result<(), WireError> {
        let mut seen: BTreeMap<u32, usize> = BTreeMap::new();
        let mut fields = Vec::new();
        Decoder::new(bytes).each(|number, value| {
            fields.push((number, value));
            Ok(())
        })?;
        for (number, value) in fields {
            let index = seen.entry(number).or_default();
            let path: Vec<(u32, usize)> = above.iter().copied().chain([(number, *index)]).collect();
            let field = schema.and_then(|schema| schema.fields.iter().find(|field| field.number == number));
            let Some(field) = field else {
                self.put(&path, format!("{prefix}field {number}"), shape(value));
                *index += 1;
                continue;
            };
            let place = if field.repeated { format!("[{index}]") } else { String::new() };
            let name = format!("{prefix}{}", field.name);
            match (field.kind, value) {
                (Kind::Message(inner), Value::Bytes(bytes)) if depth > 0 => {
                    self.take(Some(inner), bytes, &path, &format!("{name}{place}."), depth - 1)?;
                }
                (Kind::Float, Value::Bytes(packed)) => {
                    for (index, bytes) in packed.chunks_exact(4).enumerate() {
                        let number = f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
                        let path: Vec<(u32, usize)> = path.iter().copied().chain([(0, index)]).collect();
                        self.put(&path, format!("{name}[{index}]"), format!("{number:?}"));
                    }
                }
                (kind, value) => self.put(&path, format!("{name}{place}"), word(kind, value)),
            }
            *index += 1;
        }
        Ok(())
    }
}

fn shape(value: Value<'_>) -> String {
    match value {
        Value::Varint(number) => number.to_string(),
        Value::Fixed64(bits) => format!("{bits:#018x}"),
        Value::Fixed32(bits) => format!("{bits:#010x}"),
        Value::Bytes(bytes) => some_bytes(bytes),
    }
}

fn some_bytes(bytes: &[u8]) -> String {
    let start: String = bytes.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
    let more = if bytes.len() > 8 { "…" } else { "" };
    format!("{} bytes {start}{more}", bytes.len())
}

fn word(kind: Kind, value: Value<'_>) -> String {
    match (kind, value) {
        // With the sign of 0, and enough digits to tell two numbers apart.
        (Kind::Double, Value::Fixed64(bits)) => format!("{:?}", f64::from_bits(bits)),
        (Kind::Float, Value::Fixed32(bits)) => format!("{:?}", f32::from_bits(bits)),
        (Kind::Sfixed64, Value::Fixed64(bits)) => (bits as i64).to_string(),
        (Kind::Int64 | Kind::Int32, Value::Varint(number)) => (number as i64).to_string(),
        (Kind::Bool, Value::Varint(number)) => (number != 0).to_string(),
        (Kind::String, Value::Bytes(bytes)) => {
            let text = String::from_utf8_lossy(bytes);
            if text.chars().count() > 60 {
                format!("{:?}…", text.chars().take(60).collect::<String>())
            } else {
                format!("{text:?}")
            }
        }
        (_, value) => shape(value),
    }
}

/// What two messages of one schema differ in, the first of it, and how much there is in all; nothing where one of them
/// cannot be taken apart. Without a schema fields have their numbers for names.
pub(crate) fn differing(schema: Option<&Schema>, a: &[u8], b: &[u8]) -> (Vec<FieldDiff>, usize) {
    let (Some(a), Some(b)) = (Named::of(schema, a), Named::of(schema, b)) else { return (Vec::new(), 0) };
    let mut told = Vec::new();
    let mut count = 0;
    let mut names: Vec<&(Vec<(u32, usize)>, String)> = a.0.keys().chain(b.0.keys()).collect();
    names.sort();
    names.dedup();
    for name in names {
        let (a, b) = (a.0.get(name), b.0.get(name));
        if a == b {
            continue;
        }
        count += 1;
        if told.len() < TOLD {
            told.push(FieldDiff { name: name.1.clone(), a: a.cloned(), b: b.cloned() });
        }
    }
    (told, count)
}
