//! Buttons, axes, directions, pulses, plain numbers.

use vergence_sense::{Axis, Button, Haptic, Sample, Scalar, Touch, TouchPhase, Vector2};
use vergence_time::Span;

use super::{ARRIVED_NS, CAPTURED_NS, Gathered, put_times};
use crate::message::{Message, Times};
use crate::schema::{Field, Kind, Schema};
use crate::wire::{Decoder, Encoder, WireError};

const OFFERED: Field =
    Field::one("offered", 3, Kind::Bool, "a device offers it now; else the value says nothing");

impl Message for Button {
    const NAME: &'static str = "Button";
    const UNIT: &'static str = "bool";
    const SCHEMA: &'static Schema = &Schema {
        name: "vergence.Button",
        about: "Something that is pressed or not.",
        fields: &[CAPTURED_NS, ARRIVED_NS, OFFERED, Field::one("pressed", 4, Kind::Bool, "pressed")],
    };

    fn encode(&self, times: Times, _frame: &str, out: &mut Encoder<'_>) {
        put_times(times, out);
        out.bool(3, self.0.is_some());
        out.bool(4, self.0 == Some(true));
    }

    fn decode(bytes: &[u8]) -> Result<Sample<Self>, WireError> {
        let (mut times, mut offered, mut pressed) = (Gathered::default(), false, false);
        Decoder::new(bytes).each(|number, value| {
            match number {
                3 => offered = value.bool()?,
                4 => pressed = value.bool()?,
                _ => drop(times.take(number, value)?),
            }
            Ok(())
        })?;
        Ok(times.sample(Self(offered.then_some(pressed))))
    }
}

impl Message for Axis {
    const NAME: &'static str = "Axis";
    const UNIT: &'static str = "1";
    const SCHEMA: &'static Schema = &Schema {
        name: "vergence.Axis",
        about: "Something that is pulled: 0 to 1, or -1 to 1.",
        fields: &[
            CAPTURED_NS,
            ARRIVED_NS,
            OFFERED,
            Field::one("value", 4, Kind::Float, "as the runtime said it, every bit"),
        ],
    };

    fn encode(&self, times: Times, _frame: &str, out: &mut Encoder<'_>) {
        put_times(times, out);
        out.bool(3, self.0.is_some());
        out.float(4, self.0.unwrap_or(0.0));
    }

    fn decode(bytes: &[u8]) -> Result<Sample<Self>, WireError> {
        let (mut times, mut offered, mut pulled) = (Gathered::default(), false, 0.0);
        Decoder::new(bytes).each(|number, value| {
            match number {
                3 => offered = value.bool()?,
                4 => pulled = value.float()?,
                _ => drop(times.take(number, value)?),
            }
            Ok(())
        })?;
        Ok(times.sample(Self(offered.then_some(pulled))))
    }
}

impl Message for Vector2 {
    const NAME: &'static str = "Vector2";
    const UNIT: &'static str = "1";
    const SCHEMA: &'static Schema = &Schema {
        name: "vergence.Vector2",
        about: "Something that is pushed in a plane, inside the unit disc.",
        fields: &[
            CAPTURED_NS,
            ARRIVED_NS,
            OFFERED,
            Field::one("x", 4, Kind::Float, "to the right"),
            Field::one("y", 5, Kind::Float, "away from the user"),
        ],
    };

    fn encode(&self, times: Times, _frame: &str, out: &mut Encoder<'_>) {
        put_times(times, out);
        let [x, y] = self.0.unwrap_or_default();
        out.bool(3, self.0.is_some());
        out.float(4, x);
        out.float(5, y);
    }

    fn decode(bytes: &[u8]) -> Result<Sample<Self>, WireError> {
        let (mut times, mut offered, mut pushed) = (Gathered::default(), false, [0.0; 2]);
        Decoder::new(bytes).each(|number, value| {
            match number {
                3 => offered = value.bool()?,
                4 => pushed[0] = value.float()?,
                5 => pushed[1] = value.float()?,
                _ => drop(times.take(number, value)?),
            }
            Ok(())
        })?;
        Ok(times.sample(Self(offered.then_some(pushed))))
    }
}

impl Message for Haptic {
    const NAME: &'static str = "Haptic";
    const UNIT: &'static str = "ns, Hz, 1";
    const SCHEMA: &'static Schema = &Schema {
        name: "vergence.Haptic",
        about: "A pulse that a hand was made to feel.",
        fields: &[
            CAPTURED_NS,
            ARRIVED_NS,
            Field::one("has_duration", 3, Kind::Bool, "else: the shortest that the device can do"),
            Field::one("duration_ns", 4, Kind::Sfixed64, "how long, nanoseconds; 0 stops"),
            Field::one("has_frequency", 5, Kind::Bool, "else: as the runtime likes best"),
            Field::one("frequency_hz", 6, Kind::Float, "hertz"),
            Field::one("amplitude", 7, Kind::Float, "0 to 1"),
        ],
    };

    fn encode(&self, times: Times, _frame: &str, out: &mut Encoder<'_>) {
        put_times(times, out);
        out.bool(3, self.duration.is_some());
        out.sfixed64(4, self.duration.unwrap_or(Span::ZERO).as_nanos());
        out.bool(5, self.frequency_hz.is_some());
        out.float(6, self.frequency_hz.unwrap_or(0.0));
        out.float(7, self.amplitude);
    }

    fn decode(bytes: &[u8]) -> Result<Sample<Self>, WireError> {
        let mut times = Gathered::default();
        let (mut has_duration, mut duration, mut has_frequency, mut frequency_hz) = (false, 0, false, 0.0);
        let mut amplitude = 0.0;
        Decoder::new(bytes).each(|number, value| {
            match number {
                3 => has_duration = value.bool()?,
                4 => duration = value.sfixed64()?,
                5 => has_frequency = value.bool()?,
                6 => frequency_hz = value.float()?,
                7 => amplitude = value.float()?,
                _ => drop(times.take(number, value)?),
            }
            Ok(())
        })?;
        Ok(times.sample(Self {
            duration: has_duration.then_some(Span::from_nanos(duration)),
            frequency_hz: has_frequency.then_some(frequency_hz),
            amplitude,
        }))
    }
}

impl Message for Scalar {
    const NAME: &'static str = "Scalar";
    const UNIT: &'static str = "";
    const SCHEMA: &'static Schema = &Schema {
        name: "vergence.Scalar",
        about: "One number, in the stream's unit.",
        fields: &[CAPTURED_NS, ARRIVED_NS, Field::one("value", 3, Kind::Double, "in the stream's unit")],
    };

    fn encode(&self, times: Times, _frame: &str, out: &mut Encoder<'_>) {
        put_times(times, out);
        out.double(3, self.0);
    }

    fn decode(bytes: &[u8]) -> Result<Sample<Self>, WireError> {
        let (mut times, mut scalar) = (Gathered::default(), 0.0);
        Decoder::new(bytes).each(|number, value| {
            match number {
                3 => scalar = value.double()?,
                _ => drop(times.take(number, value)?),
            }
            Ok(())
        })?;
        Ok(times.sample(Self(scalar)))
    }
}

const PHASES: [TouchPhase; 5] =
    [TouchPhase::Hovers, TouchPhase::Begins, TouchPhase::Moves, TouchPhase::Ends, TouchPhase::Cancelled];

impl Message for Touch {
    const NAME: &'static str = "Touch";
    const UNIT: &'static str = "px";
    const SCHEMA: &'static Schema = &Schema {
        name: "vergence.Touch",
        about: "What a finger, a pen or a pointer does on a surface.",
        fields: &[
            CAPTURED_NS,
            ARRIVED_NS,
            Field::one("contact", 3, Kind::Uint32, "the same from the first touch to the last"),
            Field::one("x", 4, Kind::Double, "to the right, in the stream's unit"),
            Field::one("y", 5, Kind::Double, "down, in the stream's unit"),
            Field::one("phase", 6, Kind::Uint32, "0 hovers, 1 begins, 2 moves, 3 ends, 4 cancelled"),
        ],
    };

    fn encode(&self, times: Times, _frame: &str, out: &mut Encoder<'_>) {
        put_times(times, out);
        out.uint(3, u64::from(self.contact));
        out.double(4, self.position[0]);
        out.double(5, self.position[1]);
        out.uint(6, PHASES.iter().position(|phase| *phase == self.phase).unwrap_or(0) as u64);
    }

    fn decode(bytes: &[u8]) -> Result<Sample<Self>, WireError> {
        let (mut times, mut contact, mut position, mut phase) = (Gathered::default(), 0, [0.0; 2], 0);
        Decoder::new(bytes).each(|number, value| {
            match number {
                3 => contact = value.uint()?,
                4 => position[0] = value.double()?,
                5 => position[1] = value.double()?,
                6 => phase = value.uint()?,
                _ => drop(times.take(number, value)?),
            }
            Ok(())
        })?;
        let refuse =
            |what, expected, found: u64| Err(WireError::Value { what, expected, found: found.to_string() });
        let Ok(contact) = u32::try_from(contact) else { return refuse("a contact", "32 bits", contact) };
        let Some(&phase) = usize::try_from(phase).ok().and_then(|phase| PHASES.get(phase)) else {
            return refuse("what a contact does", "0 to 4", phase);
        };
        Ok(times.sample(Self { contact, position, phase }))
    }
}
