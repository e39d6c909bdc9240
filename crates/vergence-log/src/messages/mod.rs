//! What the rooms below say, as messages: Foxglove's schemas where they have one, ours where they have none.
//!
//! Ours begin with `captured_ns` (1) and `arrived_ns` (2). Foxglove's keep their own fields and carry what we add from
//! number 1000 on, which a reader with the published schema passes over.

mod control;
mod device;
mod happening;
mod pose;
mod raw;
mod row;

pub use device::Compressed;
pub use row::Row;
use vergence_time::Timestamp;

use crate::message::Times;
use crate::schema::{Field, Kind, Schema};
use crate::wire::{Decoder, Encoder, Value, WireError};

/// Number of `arrived_ns` in a message of Foxglove's; what else we add follows it.
const ARRIVED: u32 = 1000;

const CAPTURED_NS: Field =
    Field::one("captured_ns", 1, Kind::Sfixed64, "session time for which the value holds, nanoseconds");
const ARRIVED_NS: Field =
    Field::one("arrived_ns", 2, Kind::Sfixed64, "session time at which it reached us, nanoseconds");
const ARRIVED_TOO: Field =
    Field::one("arrived_ns", ARRIVED, Kind::Sfixed64, "session time at which it reached us, nanoseconds");

static TIMESTAMP: Schema = Schema {
    name: "google.protobuf.Timestamp",
    about: "An instant: seconds (may be negative) and nanoseconds that count forward from them.",
    fields: &[
        Field::one("seconds", 1, Kind::Int64, "whole seconds, rounded down"),
        Field::one("nanos", 2, Kind::Int32, "0 to 999,999,999"),
    ],
};

/// The schema of a type by its name; `None` for a type of other rooms.
pub(crate) fn schema_of(type_name: &str) -> Option<&'static Schema> {
    use vergence_sense as sense;

    use crate::message::Message;
    macro_rules! find {
        ($($t:ty),*) => {
            [$((<$t>::NAME, <$t>::SCHEMA)),*].into_iter().find(|(name, _)| *name == type_name)
        };
    }
    let found = find!(
        sense::Pose,
        sense::RawLocation,
        sense::RawViews,
        sense::RawJoints,
        sense::HandJoints,
        Option<sense::Gaze>,
        sense::Button,
        sense::Axis,
        sense::Vector2,
        sense::Haptic,
        sense::Event,
        sense::CallResult,
        sense::FrameTiming,
        sense::FrameHash,
        sense::Scalar,
        sense::Imu,
        sense::Touch,
        sense::Image<'_>,
        Compressed<'_>,
        Row
    );
    found.map(|(_, schema)| schema)
}

fn put_times(times: Times, out: &mut Encoder<'_>) {
    out.sfixed64(1, times.captured.as_nanos());
    out.sfixed64(2, times.arrived.as_nanos());
}

fn put_timestamp(field: u32, instant: Timestamp, out: &mut Encoder<'_>) {
    let nanos = instant.as_nanos();
    out.message(field, |out| {
        out.int(1, nanos.div_euclid(1_000_000_000));
        out.int(2, nanos.rem_euclid(1_000_000_000));
    });
}

pub(crate) fn get_timestamp(value: Value<'_>) -> Result<Timestamp, WireError> {
    let (mut seconds, mut nanos) = (0i64, 0i64);
    Decoder::new(value.bytes()?).each(|number, value| {
        match number {
            1 => seconds = value.int()?,
            2 => nanos = value.int()?,
            _ => {}
        }
        Ok(())
    })?;
    // In 128 bits, since the earliest instants round down to a second that does not fit.
    let total = i128::from(seconds) * 1_000_000_000 + i128::from(nanos);
    match i64::try_from(total) {
        Ok(nanos) => Ok(Timestamp::from_nanos(nanos)),
        Err(_) => Err(WireError::Value {
            what: "an instant",
            expected: "292 years around the epoch",
            found: format!("{seconds} s"),
        }),
    }
}

/// Collects the two times of one of our messages.
#[derive(Clone, Copy, Debug, Default)]
struct Gathered {
    captured: Timestamp,
    arrived: Timestamp,
}

impl Gathered {
    /// Takes the field where it is a time; whether it was one.
    fn take(&mut self, number: u32, value: Value<'_>) -> Result<bool, WireError> {
        match number {
            1 => self.captured = Timestamp::from_nanos(value.sfixed64()?),
            2 => self.arrived = Timestamp::from_nanos(value.sfixed64()?),
            _ => return Ok(false),
        }
        Ok(true)
    }

    fn sample<T>(self, value: T) -> vergence_sense::Sample<T> {
        vergence_sense::Sample { captured: self.captured, arrived: self.arrived, value }
    }
}

/// The exact times of a message of ours or of Foxglove's; `None` where the schema is a stranger's.
pub(crate) fn times_of(entry: &crate::Entry<'_>) -> Result<Option<Times>, WireError> {
    if entry.stream.encoding != "protobuf" || !entry.stream.metadata.contains_key("type") {
        return Ok(None);
    }
    let mut times = Times::at(Timestamp::default());
    let foxglove = entry.stream.schema.starts_with("foxglove.");
    Decoder::new(entry.payload).each(|number, value| {
        match (foxglove, number) {
            (true, 1) => times.captured = get_timestamp(value)?,
            (true, ARRIVED) | (false, 2) => times.arrived = Timestamp::from_nanos(value.sfixed64()?),
            (false, 1) => times.captured = Timestamp::from_nanos(value.sfixed64()?),
            _ => {}
        }
        Ok(())
    })?;
    Ok(Some(times))
}
