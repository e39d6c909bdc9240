//! One trial as a message of the session's log.

use vergence_log::schema::{Field, Kind, Schema};
use vergence_log::wire::{Decoder, Encoder, Value, WireError};
use vergence_log::{Message, Times};
use vergence_sense::Sample;
use vergence_study::{CursorSample, PathMeasures, Point, Trial};
use vergence_time::Timestamp;

/// Where a trial is in its participant's plan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize)]
pub struct Place {
    /// Counted from 0.
    pub block: u32,
    /// Within the block, counted from 0.
    pub trial: u32,
    /// 0, and one more for each time that its sequence was repeated.
    pub attempt: u32,
}

/// One trial that has ended.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Record {
    /// What happened.
    pub trial: Trial,
    /// What it was of the plan.
    pub place: Place,
    /// When the movement began, session time.
    pub began: Timestamp,
    /// The computer's clock when it ended, nanoseconds since 1970.
    pub wall_ns: i64,
}

impl Message for Record {
    const NAME: &'static str = "Trial";
    const UNIT: &'static str = "";
    const SCHEMA: &'static Schema = &Schema {
        name: "vergence.Trial",
        about: "One movement to one target. Lengths have the unit that the header's note length_unit names; NaN and empty lists stand for what is not known.",
        fields: &[
            Field::one("captured_ns", 1, Kind::Sfixed64, "session time of the selection, nanoseconds"),
            Field::one("arrived_ns", 2, Kind::Sfixed64, "session time at which it was written, nanoseconds"),
            Field::one("participant", 3, Kind::String, "pseudonym"),
            Field::one("session", 4, Kind::String, "sitting"),
            Field::one("block", 5, Kind::String, "block of the session"),
            Field::one("condition", 6, Kind::String, "name of the condition"),
            Field::one(
                "instruction",
                7,
                Kind::String,
                "speed-accuracy instruction; empty where there is one only",
            ),
            Field::many("factors", 8, Kind::String, "NAME=LEVEL of the design's other factors"),
            Field::one("index", 9, Kind::Uint32, "place in its sequence, from 0"),
            Field::one("practice", 10, Kind::Bool, "not analysed"),
            Field::one("plan_block", 11, Kind::Uint32, "block of the plan, from 0"),
            Field::one("plan_trial", 12, Kind::Uint32, "trial of that block, from 0"),
            Field::one("attempt", 13, Kind::Uint32, "how often its sequence was repeated before"),
            Field::one("amplitude", 14, Kind::Double, "nominal distance of the targets"),
            Field::one("width", 15, Kind::Double, "nominal width of the target along the axis"),
            Field::many("from", 16, Kind::Double, "x y z of the centre of the target before"),
            Field::many("to", 17, Kind::Double, "x y z of the centre of the target"),
            Field::many("start", 18, Kind::Double, "x y z where the movement began"),
            Field::many("end", 19, Kind::Double, "x y z of the selection"),
            Field::one("mt_s", 20, Kind::Double, "movement time, seconds"),
            Field::one("error", 21, Kind::Bool, "the target was missed"),
            Field::one("spatial_outlier", 22, Kind::Uint32, "0 not known, 1 no, 2 yes"),
            Field::one(
                "temporal_outlier",
                23,
                Kind::Uint32,
                "outside of the time band: 0 not known, 1 no, 2 yes",
            ),
            Field::many(
                "sample_t_s",
                24,
                Kind::Double,
                "times of the cursor's samples since the start, seconds",
            ),
            Field::many("sample_xyz", 25, Kind::Double, "their places, three numbers each"),
            Field::many(
                "measured",
                26,
                Kind::Double,
                "path measures that the recording tool took, in the order tre tac mdc odc mv me mo submovements overshoots",
            ),
            Field::one("began_ns", 27, Kind::Sfixed64, "session time of the start, nanoseconds"),
            Field::one(
                "wall_ns",
                28,
                Kind::Sfixed64,
                "the computer's clock at the end, nanoseconds since 1970",
            ),
            Field::one("error_unknown", 29, Kind::Bool, "nothing says whether the target was missed"),
            Field::one("repeated", 30, Kind::Bool, "not analysed: its sequence was made again"),
        ],
    };

    fn encode(&self, times: Times, _frame: &str, out: &mut Encoder<'_>) {
        let Self { trial, place, began, wall_ns } = self;
        out.sfixed64(1, times.captured.as_nanos());
        out.sfixed64(2, times.arrived.as_nanos());
        out.text(3, &trial.participant);
        out.text(4, &trial.session);
        out.text(5, &trial.block);
        out.text(6, &trial.condition);
        out.text(7, trial.instruction.as_deref().unwrap_or(""));
        for (name, level) in &trial.factors {
            out.text(8, &format!("{name}={level}"));
        }
        out.uint(9, u64::from(trial.index));
        out.bool(10, trial.practice);
        out.uint(11, u64::from(place.block));
        out.uint(12, u64::from(place.trial));
        out.uint(13, u64::from(place.attempt));
        out.double(14, trial.amplitude.unwrap_or(f64::NAN));
        out.double(15, trial.width.unwrap_or(f64::NAN));
        packed(16, trial.from.iter().flatten().copied(), out);
        packed(17, trial.to, out);
        packed(18, trial.start.iter().flatten().copied(), out);
        packed(19, trial.end, out);
        out.double(20, trial.mt_s);
        out.bool(21, trial.error == Some(true));
        out.uint(22, flag(trial.spatial_outlier));
        out.uint(23, flag(trial.temporal_outlier));
        packed(24, trial.samples.iter().map(|sample| sample.t_s), out);
        packed(25, trial.samples.iter().flat_map(|sample| sample.position), out);
        let measured = trial.measured.iter().flat_map(PathMeasures::values);
        packed(26, measured.map(|value| value.unwrap_or(f64::NAN)), out);
        out.sfixed64(27, began.as_nanos());
        out.sfixed64(28, *wall_ns);
        out.bool(29, trial.error.is_none());
        out.bool(30, trial.repeated);
    }

    fn decode(bytes: &[u8]) -> Result<Sample<Self>, WireError> {
        let (mut captured, mut arrived) = (Timestamp::default(), Timestamp::default());
        let mut record = Self::default();
        let (mut times, mut places) = (Vec::new(), Vec::new());
        let trial = &mut record.trial;
        trial.mt_s = f64::NAN;
        let (mut error, mut error_unknown) = (false, false);
        Decoder::new(bytes).each(|number, value| {
            let text = || value.text().map(str::to_owned);
            match number {
                1 => captured = Timestamp::from_nanos(value.sfixed64()?),
                2 => arrived = Timestamp::from_nanos(value.sfixed64()?),
                3 => trial.participant = text()?,
                4 => trial.session = text()?,
                5 => trial.block = text()?,
                6 => trial.condition = text()?,
                7 => trial.instruction = Some(text()?).filter(|text| !text.is_empty()),
                8 => {
                    let (name, level) = value.text()?.split_once('=').ok_or(WireError::Shape {
                        expected: "NAME=LEVEL",
                        found: "text without an equals sign",
                    })?;
                    trial.factors.insert(name.to_owned(), level.to_owned());
                }
                9 => trial.index = small(value)?,
                10 => trial.practice = value.bool()?,
                11 => record.place.block = small(value)?,
                12 => record.place.trial = small(value)?,
                13 => record.place.attempt = small(value)?,
                14 => trial.amplitude = Some(value.double()?).filter(|value| !value.is_nan()),
                15 => trial.width = Some(value.double()?).filter(|value| !value.is_nan()),
                16 => trial.from = point(value)?,
                17 => trial.to = point(value)?.unwrap_or_default(),
                18 => trial.start = point(value)?,
                19 => trial.end = point(value)?.unwrap_or_default(),
                20 => trial.mt_s = value.double()?,
                21 => error = value.bool()?,
                22 => trial.spatial_outlier = unflag(value)?,
                23 => trial.temporal_outlier = unflag(value)?,
                24 => times = numbers(value)?,
                25 => places = numbers(value)?,
                26 => trial.measured = measured(&numbers(value)?),
                27 => record.began = Timestamp::from_nanos(value.sfixed64()?),
                28 => record.wall_ns = value.sfixed64()?,
                29 => error_unknown = value.bool()?,
                30 => trial.repeated = value.bool()?,
                _ => {}
            }
            Ok(())
        })?;
        trial.error = (!error_unknown).then_some(error);
        trial.attempt = record.place.attempt;
        if places.len() != 3 * times.len() {
            return Err(WireError::Value {
                what: "the cursor's places",
                expected: "three numbers for each time",
                found: format!("{} numbers for {} times", places.len(), times.len()),
            });
        }
        let places = places.chunks_exact(3).map(|p| [p[0], p[1], p[2]]);
        trial.samples =
            times.iter().zip(places).map(|(&t_s, position)| CursorSample { t_s, position }).collect();
        Ok(Sample { captured, arrived, value: record })
    }
}

/// Packed `double`s, which protocol buffers write as bytes.
fn packed(field: u32, values: impl IntoIterator<Item = f64>, out: &mut Encoder<'_>) {
    let bytes: Vec<u8> = values.into_iter().flat_map(|value| value.to_bits().to_le_bytes()).collect();
    out.bytes(field, &bytes);
}

fn numbers(value: Value<'_>) -> Result<Vec<f64>, WireError> {
    let (whole, rest) = value.bytes()?.as_chunks::<8>();
    if !rest.is_empty() {
        return Err(WireError::Shape {
            expected: "a list of doubles",
            found: "bytes that are no multiple of 8",
        });
    }
    Ok(whole.iter().map(|bytes| f64::from_bits(u64::from_le_bytes(*bytes))).collect())
}

fn point(value: Value<'_>) -> Result<Option<Point>, WireError> {
    match numbers(value)?[..] {
        [] => Ok(None),
        [x, y, z] => Ok(Some([x, y, z])),
        ref other => Err(WireError::Value {
            what: "a place",
            expected: "three numbers or none",
            found: other.len().to_string(),
        }),
    }
}

fn measured(values: &[f64]) -> Option<PathMeasures> {
    let values: [f64; 9] = values.try_into().ok()?;
    Some(PathMeasures::from_values(values.map(|value| Some(value).filter(|value| !value.is_nan()))))
}

fn small(value: Value<'_>) -> Result<u32, WireError> {
    let found = value.uint()?;
    u32::try_from(found).map_err(|_| WireError::Value {
        what: "a count",
        expected: "at most 32 bits",
        found: found.to_string(),
    })
}

fn flag(value: Option<bool>) -> u64 {
    value.map_or(0, |value| 1 + u64::from(value))
}

fn unflag(value: Value<'_>) -> Result<Option<bool>, WireError> {
    Ok(match value.uint()? {
        0 => None,
        other => Some(other == 2),
    })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use proptest::prelude::*;

    fn full() -> Record {
        let sample =
            |i: i32| CursorSample { t_s: f64::from(i) / 90.0, position: [f64::from(i), -0.0, 1e-300] };
        Record {
            trial: Trial {
                participant: "P07".into(),
                session: "1".into(),
                block: "2".into(),
                condition: "A0.35m-W0.01m".into(),
                instruction: Some("fast".into()),
                factors: BTreeMap::from([("hand".into(), "left=right".into())]),
                index: 14,
                practice: true,
                attempt: 2,
                repeated: true,
                amplitude: Some(0.35),
                width: None,
                from: Some([1.0, 2.0, 3.0]),
                to: [4.0, 5.0, 6.0],
                start: None,
                end: [0.1, f64::MIN_POSITIVE, -0.0],
                mt_s: 0.777,
                error: Some(true),
                samples: (0..70).map(sample).collect(),
                measured: Some(PathMeasures { tre: Some(1.0), mo: Some(-2.0), ..PathMeasures::default() }),
                spatial_outlier: Some(false),
                temporal_outlier: Some(true),
            },
            place: Place { block: 1, trial: 179, attempt: 2 },
            began: Timestamp::from_nanos(-5),
            wall_ns: i64::MAX,
        }
    }

    fn bytes_of(record: &Record, times: Times) -> Vec<u8> {
        let mut bytes = Vec::new();
        record.encode(times, "", &mut Encoder::new(&mut bytes));
        bytes
    }

    #[test]
    fn a_trial_comes_back_bit_for_bit() {
        for record in [full(), Record { trial: Trial { mt_s: 1.0, ..Trial::default() }, ..Record::default() }]
        {
            let times = Times::new(Timestamp::from_nanos(-7), Timestamp::from_nanos(9));
            let back = Record::decode(&bytes_of(&record, times)).unwrap();
            assert_eq!((back.captured, back.arrived), (times.captured, times.arrived));
            assert_eq!(back.value, record);
        }
    }

    proptest! {
        #[test]
        fn damage_is_an_error_and_no_panic(at in any::<usize>(), byte in any::<u8>(), cut in any::<usize>()) {
            let mut bytes = bytes_of(&full(), Times::at(Timestamp::default()));
            let at = at % bytes.len();
            bytes[at] = byte;
            let _ = Record::decode(&bytes);
            bytes.truncate(cut % bytes.len());
            let _ = Record::decode(&bytes);
        }
    }
}
