//! Messages as rows of a table, whatever their type: what exporters write.

use std::collections::{BTreeMap, HashSet};

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

/// The message's values by column: fields by name, inner ones behind a point, repeated ones by number in brackets; times in
/// nanoseconds. A row of a foreign stream has its stream's own columns. `None` where the type is a stranger's.
///
/// # Errors
/// Where the bytes are no such message, or have more than 4096 columns.
pub fn flat(entry: &Entry<'_>) -> Result<Option<Vec<(String, Cell)>>, WireError> {
    let Some(schema) = schema_of(entry.stream.type_name()) else { return Ok(None) };
    let mut cells = Vec::with_capacity(16);
    walk(schema, entry.payload, "", &mut cells)?;
    let labels = |column: &str| entry.stream.metadata.get(&format!("column.{column}"));
    if entry.is::<Row<'_>>() {
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
