//! Events, results of calls, frame times, hashes of pictures.

use std::borrow::Cow;

use vergence_sense::{CallResult, Event, FrameHash, FrameTiming, Sample};
use vergence_time::{Span, Timestamp};

use super::{ARRIVED_NS, CAPTURED_NS, Gathered, put_times};
use crate::message::{Message, Times};
use crate::schema::{Field, Kind, Schema};
use crate::wire::{Decoder, Encoder, WireError};

impl Message for Event {
    const NAME: &'static str = "Event";
    const UNIT: &'static str = "";
    const SCHEMA: &'static Schema = &Schema {
        name: "vergence.Event",
        about: "Something that happened in the session.",
        fields: &[
            CAPTURED_NS,
            ARRIVED_NS,
            Field::one("name", 3, Kind::String, "what, in one word of lower case"),
            Field::one("text", 4, Kind::String, "in words: the state's name, the device's path"),
            Field::one("has_at", 5, Kind::Bool, "at_ns says something"),
            Field::one("at_ns", 6, Kind::Sfixed64, "session time from which on it holds, nanoseconds"),
            Field::one("before", 7, Kind::Double, "the number before, or how many; NaN where there is none"),
            Field::one("after", 8, Kind::Double, "the number after; NaN where there is none"),
        ],
    };

    fn encode(&self, times: Times, _frame: &str, out: &mut Encoder<'_>) {
        put_times(times, out);
        out.text(3, &self.name);
        out.text(4, &self.text);
        out.bool(5, self.at.is_some());
        out.sfixed64(6, self.at.unwrap_or_default().as_nanos());
        out.double(7, self.before);
        out.double(8, self.after);
    }

    fn decode(bytes: &[u8]) -> Result<Sample<Self>, WireError> {
        let mut times = Gathered::default();
        let mut event = Self { name: Cow::Borrowed(""), ..Self::new("", "") };
        let (mut has_at, mut at) = (false, Timestamp::default());
        Decoder::new(bytes).each(|number, value| {
            match number {
                3 => event.name = Cow::Owned(value.text()?.to_owned()),
                4 => event.text = Cow::Owned(value.text()?.to_owned()),
                5 => has_at = value.bool()?,
                6 => at = Timestamp::from_nanos(value.sfixed64()?),
                7 => event.before = value.double()?,
                8 => event.after = value.double()?,
                _ => drop(times.take(number, value)?),
            }
            Ok(())
        })?;
        event.at = has_at.then_some(at);
        Ok(times.sample(event))
    }
}

impl Message for FrameTiming {
    const NAME: &'static str = "FrameTiming";
    const UNIT: &'static str = "ns";
    const SCHEMA: &'static Schema = &Schema {
        name: "vergence.FrameTiming",
        about: "The points of one frame, session time, nanoseconds.",
        fields: &[
            CAPTURED_NS,
            ARRIVED_NS,
            Field::one("frame", 3, Kind::Uint64, "counted from 0"),
            Field::one("wait_returned_ns", 4, Kind::Sfixed64, "the runtime let us go"),
            Field::one("begun_ns", 5, Kind::Sfixed64, "we began"),
            Field::one("submitted", 6, Kind::Bool, "a picture was handed over"),
            Field::one("submitted_ns", 7, Kind::Sfixed64, "when"),
            Field::one("predicted_display_ns", 8, Kind::Sfixed64, "when it is expected to be seen"),
            Field::one("predicted_period_ns", 9, Kind::Sfixed64, "time between frames"),
            Field::one("should_render", 10, Kind::Bool, "the runtime wants a picture"),
            Field::one("presented", 11, Kind::Bool, "the runtime told when it was seen"),
            Field::one("presented_ns", 12, Kind::Sfixed64, "when it was seen"),
            Field::one(
                "raw_display_ns",
                13,
                Kind::Sfixed64,
                "what the runtime gave for predicted_display_ns",
            ),
            Field::one("raw_period_ns", 14, Kind::Sfixed64, "what the runtime gave for predicted_period_ns"),
            Field::one("abandoned", 15, Kind::Bool, "the session was lost or given up in this frame"),
        ],
    };

    fn encode(&self, times: Times, _frame: &str, out: &mut Encoder<'_>) {
        put_times(times, out);
        out.uint(3, self.frame);
        out.sfixed64(4, self.wait_returned.as_nanos());
        out.sfixed64(5, self.begun.as_nanos());
        out.bool(6, self.submitted.is_some());
        out.sfixed64(7, self.submitted.unwrap_or_default().as_nanos());
        out.sfixed64(8, self.predicted_display.as_nanos());
        out.sfixed64(9, self.predicted_period.as_nanos());
        out.bool(10, self.should_render);
        out.bool(11, self.presented.is_some());
        out.sfixed64(12, self.presented.unwrap_or_default().as_nanos());
        out.sfixed64(13, self.raw_display.as_nanos());
        out.sfixed64(14, self.raw_period.as_nanos());
        out.bool(15, !self.ended);
    }

    fn decode(bytes: &[u8]) -> Result<Sample<Self>, WireError> {
        let mut times = Gathered::default();
        let start = Timestamp::default();
        let mut timing = Self {
            frame: 0,
            wait_returned: start,
            begun: start,
            submitted: None,
            predicted_display: start,
            predicted_period: Span::ZERO,
            should_render: false,
            presented: None,
            raw_display: start,
            raw_period: Span::ZERO,
            ended: true,
        };
        // Logs of earlier versions lack them.
        let (mut raw_display, mut raw_period) = (None, None);
        let (mut has_submitted, mut submitted, mut has_presented, mut presented) =
            (false, start, false, start);
        Decoder::new(bytes).each(|number, value| {
            let instant = || value.sfixed64().map(Timestamp::from_nanos);
            match number {
                3 => timing.frame = value.uint()?,
                4 => timing.wait_returned = instant()?,
                5 => timing.begun = instant()?,
                6 => has_submitted = value.bool()?,
                7 => submitted = instant()?,
                8 => timing.predicted_display = instant()?,
                9 => timing.predicted_period = Span::from_nanos(value.sfixed64()?),
                10 => timing.should_render = value.bool()?,
                11 => has_presented = value.bool()?,
                12 => presented = instant()?,
                13 => raw_display = Some(instant()?),
                14 => raw_period = Some(Span::from_nanos(value.sfixed64()?)),
                15 => timing.ended = !value.bool()?,
                _ => drop(times.take(number, value)?),
            }
            Ok(())
        })?;
        timing.submitted = has_submitted.then_some(submitted);
        timing.presented = has_presented.then_some(presented);
        timing.raw_display = raw_display.unwrap_or(timing.predicted_display);
        timing.raw_period = raw_period.unwrap_or(timing.predicted_period);
        Ok(times.sample(timing))
    }
}

impl Message for CallResult {
    const NAME: &'static str = "CallResult";
    const UNIT: &'static str = "";
    const SCHEMA: &'static Schema = &Schema {
        name: "vergence.CallResult",
        about: "A call of the session that failed, or whose success was a qualified one.",
        fields: &[
            CAPTURED_NS,
            ARRIVED_NS,
            Field::one("call", 3, Kind::String, "the entry point: xrLocateViews"),
            Field::one("nth", 4, Kind::Uint32, "its number since the last frame was waited for, from 1"),
            Field::one("in_frame", 5, Kind::Bool, "for a frame that was waited for and not yet handed over"),
            Field::one("code", 6, Kind::Int32, "as OpenXR counts results"),
            Field::one("result", 7, Kind::String, "the same in words: ERROR_SESSION_LOST"),
        ],
    };

    fn encode(&self, times: Times, _frame: &str, out: &mut Encoder<'_>) {
        put_times(times, out);
        out.text(3, &self.call);
        out.uint(4, u64::from(self.nth));
        out.bool(5, self.in_frame);
        out.int(6, i64::from(self.code));
        out.text(7, &self.result);
    }

    fn decode(bytes: &[u8]) -> Result<Sample<Self>, WireError> {
        let mut times = Gathered::default();
        let empty = Cow::Borrowed("");
        let mut found = Self { call: empty.clone(), nth: 0, in_frame: false, code: 0, result: empty };
        Decoder::new(bytes).each(|number, value| {
            match number {
                3 => found.call = Cow::Owned(value.text()?.to_owned()),
                4 => found.nth = u32::try_from(value.uint()?).unwrap_or(u32::MAX),
                5 => found.in_frame = value.bool()?,
                6 => found.code = i32::try_from(value.int()?).unwrap_or(i32::MIN),
                7 => found.result = Cow::Owned(value.text()?.to_owned()),
                _ => drop(times.take(number, value)?),
            }
            Ok(())
        })?;
        Ok(times.sample(found))
    }
}

impl Message for FrameHash {
    const NAME: &'static str = "FrameHash";
    const UNIT: &'static str = "";
    const SCHEMA: &'static Schema = &Schema {
        name: "vergence.FrameHash",
        about: "What identifies the picture of one view of one frame.",
        fields: &[
            CAPTURED_NS,
            ARRIVED_NS,
            Field::one("frame", 3, Kind::Uint64, "counted from 0"),
            Field::one("view", 4, Kind::Uint32, "counted from 0"),
            Field::one("hash", 5, Kind::Bytes, "32 bytes; the stream's metadata says of what and how"),
        ],
    };

    fn encode(&self, times: Times, _frame: &str, out: &mut Encoder<'_>) {
        put_times(times, out);
        out.uint(3, self.frame);
        out.uint(4, u64::from(self.view));
        out.bytes(5, &self.hash);
    }

    fn decode(bytes: &[u8]) -> Result<Sample<Self>, WireError> {
        let mut times = Gathered::default();
        let mut found = Self { frame: 0, view: 0, hash: [0; 32] };
        Decoder::new(bytes).each(|number, value| {
            match number {
                3 => found.frame = value.uint()?,
                4 => found.view = u32::try_from(value.uint()?).unwrap_or(u32::MAX),
                5 => {
                    let bytes = value.bytes()?;
                    found.hash = bytes.try_into().map_err(|_| WireError::Value {
                        what: "a hash",
                        expected: "32 bytes",
                        found: format!("{} bytes", bytes.len()),
                    })?;
                }
                _ => drop(times.take(number, value)?),
            }
            Ok(())
        })?;
        Ok(times.sample(found))
    }
}
