//! Messages as rows of a table, whatever their type: what exporters write.

use std::collections::{BTreeMap, HashMap, HashSet};

use vergence_sense::{
    Axis, Button, CallResult, Event, FrameHash, FrameTiming, Gaze, HandJoints, Haptic, Image, Imu, Pose,
    RawJoints, RawLocation, RawViews, Scalar, Touch, Vector2,
};

use crate::message::Message;
use crate::messages::{Compressed, Row};
use crate::reader::Entry;
use crate::schema::{Field, Kind, Schema};
use crate::wire::{Decoder, Value, WireError};

/// A value of a table.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    /// Floating point; single precision with all its bits.
    Number(f64),
    /// Whole.
    Integer(i64),
    /// Yes or no.
    Truth(bool),
    /// Anything else: text; of bytes, how many.
    Text(String),
}

/// Columns are at most this many.
const MOST_COLUMNS: usize = 4096;

/// The shape of a type that this crate writes, by its name in the file.
pub fn schema_of(type_name: &str) -> Option<&'static Schema> {
    macro_rules! all {
        ($($t:ty),*) => { [$((<$t>::NAME, <$t>::SCHEMA)),*] };
    }
    let all = all!(
        Pose,
        RawLocation,
        RawViews,
        RawJoints,
        HandJoints,
        Option<Gaze>,
        Button,
        Axis,
        Vector2,
        Haptic,
        Event,
        FrameTiming,
        CallResult,
        FrameHash,
        Scalar,
        Imu,
        Touch,
        Image<'_>,
        Compressed<'_>,
        Row<'_>
    );
    all.into_iter().find(|(name, _)| *name == type_name).map(|(_, schema)| schema)
}

/// Note of a foreign stream on the order of its columns, where that is not numbers, whole numbers, texts: their names as fields, with
/// commas between them (`texts[0],numbers[0]`).
pub const ORDER: &str = "order";

/// The message's values by column, `captured_ns` and `arrived_ns` first: fields by name, inner ones behind a point, repeated ones by
/// number in brackets; times in nanoseconds. Parts of poses that may not be read are NaN. A row of a foreign stream has its stream's own
/// columns, in their order. `None` where the type is a stranger's.
///
/// # Errors
/// Where the bytes are no such message, or have more than 4096 columns.
pub fn flat(entry: &Entry<'_>) -> Result<Option<Vec<(String, Cell)>>, WireError> {
    let Some(schema) = schema_of(entry.stream.type_name()) else { return Ok(None) };
    let mut cells = Vec::with_capacity(16);
    walk(schema, entry.payload, "", &mut cells)?;
    if schema.name.starts_with("foxglove.Pose") {
        hide_lost(&mut cells);
    }
    // Foxglove's schemas call the first time otherwise, and have the second one further back.
    if let Some((name, _)) = cells.first_mut().filter(|(name, _)| name == "timestamp_ns") {
        "captured_ns".clone_into(name);
        if let Some(arrived) = cells.iter().position(|(name, _)| name == "arrived_ns") {
            cells[1..=arrived].rotate_right(1);
        }
    }
    if entry.is::<Row<'_>>() {
        if let Some(order) = entry.stream.metadata.get(ORDER) {
            let places: HashMap<&str, usize> = order.split(',').zip(1..).collect();
            // Times have no place there and stay in front.
            cells.sort_by_key(|(column, _)| match column.as_str() {
                "captured_ns" | "arrived_ns" => 0,
                column => places.get(column).copied().unwrap_or(usize::MAX),
            });
        }
        let labels = |column: &str| entry.stream.metadata.get(&format!("column.{column}"));
        // A label that another column has already is none: no two columns are called alike.
        let mut taken: HashSet<String> = cells.iter().map(|(column, _)| column.clone()).collect();
        for (column, _) in &mut cells {
            if let Some(label) = labels(column).filter(|label| taken.insert((*label).clone())) {
                column.clone_from(label);
            }
        }
    }
    Ok(Some(cells))
}

/// Makes positions and orientations that may not be read NaN: zeros would pass for a place.
fn hide_lost(cells: &mut [(String, Cell)]) {
    let shared = cells.iter().find_map(|(name, cell)| match cell {
        Cell::Integer(flags) if name == "validity" => Some(*flags),
        _ => None,
    });
    // One byte for each, in hexadecimal digits.
    let of_each = cells.iter().find_map(|(name, cell)| match cell {
        Cell::Text(digits) if name == "validities" => Some(digits.clone()),
        _ => None,
    });
    let (readable_orientation, readable_position) = (1, 2);
    for (name, cell) in cells {
        let Some((pose, part)) = name.split_once('.').filter(|(pose, _)| pose.starts_with("pose")) else {
            continue;
        };
        let number =
            pose.strip_prefix("poses[").and_then(|rest| rest.strip_suffix(']')?.parse::<usize>().ok());
        let own = number.zip(of_each.as_ref()).and_then(|(number, digits)| {
            i64::from_str_radix(digits.get(2 * number..2 * number + 2)?, 16).ok()
        });
        let needed = if part.starts_with("position") { readable_position } else { readable_orientation };
        // A stream that says nothing of it is believed.
        if own.or(shared).is_some_and(|flags| flags & needed == 0) {
            *cell = Cell::Number(f64::NAN);
        }
    }
}

fn walk(
    schema: &Schema,
    bytes: &[u8],
    before: &str,
    cells: &mut Vec<(String, Cell)>,
) -> Result<(), WireError> {
    let mut counts: BTreeMap<u32, usize> = BTreeMap::new();
    Decoder::new(bytes).each(|number, value| {
        let Some(field) = schema.fields.iter().find(|field| field.number == number) else { return Ok(()) };
        if cells.len() >= MOST_COLUMNS {
            let found = "more".to_owned();
            return Err(WireError::Value { what: "columns of a row", expected: "at most 4096", found });
        }
        let count = counts.entry(number).or_default();
        let name = |packed: Option<usize>| {
            let place = packed.unwrap_or(*count);
            if field.repeated {
                format!("{before}{}[{place}]", field.name)
            } else {
                format!("{before}{}", field.name)
            }
        };
        match (field.kind, value) {
            (Kind::Message(inner), value) if inner.name == "google.protobuf.Timestamp" => {
                let nanos = crate::messages::get_timestamp(value)?.as_nanos();
                cells.push((format!("{}_ns", name(None)), Cell::Integer(nanos)));
            }
            (Kind::Message(inner), value) => walk(inner, value.bytes()?, &format!("{}.", name(None)), cells)?,
            (Kind::Float, Value::Bytes(packed)) if field.repeated => {
                for (place, four) in packed.chunks_exact(4).enumerate().take(MOST_COLUMNS) {
                    let single = f32::from_le_bytes([four[0], four[1], four[2], four[3]]);
                    cells.push((name(Some(place)), Cell::Number(f64::from(single))));
                }
            }
            (_, value) => cells.push((name(None), cell(field, value)?)),
        }
        *count += 1;
        Ok(())
    })
}

fn cell(field: &Field, value: Value<'_>) -> Result<Cell, WireError> {
    let unsigned = |x: u64| i64::try_from(x).map_or_else(|_| Cell::Text(x.to_string()), Cell::Integer);
    Ok(match field.kind {
        Kind::Double => Cell::Number(value.double()?),
        Kind::Float => Cell::Number(f64::from(value.float()?)),
        Kind::Int64 | Kind::Int32 => Cell::Integer(value.int()?),
        Kind::Uint64 | Kind::Uint32 => unsigned(value.uint()?),
        Kind::Sfixed64 => Cell::Integer(value.sfixed64()?),
        Kind::Fixed32 => Cell::Integer(i64::from(value.fixed32()?)),
        Kind::Bool => Cell::Truth(value.bool()?),
        Kind::String => Cell::Text(value.text()?.to_owned()),
        Kind::Bytes => {
            let bytes = value.bytes()?;
            // A hash is told; a picture is not.
            if bytes.len() <= 32 {
                Cell::Text(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
            } else {
                Cell::Text(format!("{} bytes", bytes.len()))
            }
        }
        Kind::Message(_) => Cell::Text(String::new()),
    })
}
