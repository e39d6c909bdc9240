//! Inertial units and cameras.

use std::borrow::Cow;

use nalgebra::Vector3;
use vergence_sense::{Image, Imu, Sample};
use vergence_time::Timestamp;

use super::pose::VECTOR3;
use super::{ARRIVED, ARRIVED_NS, ARRIVED_TOO, CAPTURED_NS, Gathered, TIMESTAMP};
use super::{get_timestamp, put_times, put_timestamp};
use crate::message::{Message, Times};
use crate::schema::{Field, Kind, Schema};
use crate::wire::{Decoder, Encoder, Value, WireError};

fn put_vector(field: u32, vector: &Vector3<f64>, out: &mut Encoder<'_>) {
    out.message(field, |out| (1..).zip(vector.iter()).for_each(|(axis, &value)| out.double(axis, value)));
}

fn get_vector(value: Value<'_>) -> Result<Vector3<f64>, WireError> {
    let mut vector = [0.0; 3];
    Decoder::new(value.bytes()?).each(|axis, value| {
        if let Some(slot) = vector.get_mut((axis as usize).wrapping_sub(1)) {
            *slot = value.double()?;
        }
        Ok(())
    })?;
    Ok(vector.into())
}

impl Message for Imu {
    const NAME: &'static str = "Imu";
    const UNIT: &'static str = "rad/s, m/s², µT";
    const SCHEMA: &'static Schema = &Schema {
        name: "vergence.Imu",
        about: "One reading of an inertial unit, in its own frame.",
        fields: &[
            CAPTURED_NS,
            ARRIVED_NS,
            Field::one("gyr_rad_s", 3, Kind::Message(&VECTOR3), "angular rate, radians per second"),
            Field::one("acc_m_s2", 4, Kind::Message(&VECTOR3), "specific force, metres per second squared"),
            Field::one(
                "mag_ut",
                5,
                Kind::Message(&VECTOR3),
                "magnetic field, microteslas, where it was read",
            ),
        ],
    };

    fn encode(&self, times: Times, _frame: &str, out: &mut Encoder<'_>) {
        put_times(times, out);
        put_vector(3, &self.gyr_rad_s, out);
        put_vector(4, &self.acc_m_s2, out);
        if let Some(mag_ut) = &self.mag_ut {
            put_vector(5, mag_ut, out);
        }
    }

    fn decode(bytes: &[u8]) -> Result<Sample<Self>, WireError> {
        let mut times = Gathered::default();
        let mut imu = Self { gyr_rad_s: Vector3::zeros(), acc_m_s2: Vector3::zeros(), mag_ut: None };
        Decoder::new(bytes).each(|number, value| {
            match number {
                3 => imu.gyr_rad_s = get_vector(value)?,
                4 => imu.acc_m_s2 = get_vector(value)?,
                5 => imu.mag_ut = Some(get_vector(value)?),
                _ => drop(times.take(number, value)?),
            }
            Ok(())
        })?;
        Ok(times.sample(imu))
    }
}

/// Rows of pixels.
impl Message for Image<'_> {
    const NAME: &'static str = "Image";
    const UNIT: &'static str = "pixels";
    const SCHEMA: &'static Schema = &Schema {
        name: "foxglove.RawImage",
        about: "A picture; from 1000 on what Vergence adds.",
        fields: &[
            Field::one("timestamp", 1, Kind::Message(&TIMESTAMP), "session time of the exposure"),
            Field::one("width", 2, Kind::Fixed32, "pixels per row"),
            Field::one("height", 3, Kind::Fixed32, "rows"),
            Field::one("encoding", 4, Kind::String, "mono8, rgb8, …"),
            Field::one("step", 5, Kind::Fixed32, "bytes from one row to the next"),
            Field::one("data", 6, Kind::Bytes, "rows from the top"),
            Field::one("frame_id", 7, Kind::String, "reference frame of the camera"),
            ARRIVED_TOO,
        ],
    };

    fn encode(&self, times: Times, frame: &str, out: &mut Encoder<'_>) {
        put_timestamp(1, times.captured, out);
        out.fixed32(2, self.width);
        out.fixed32(3, self.height);
        out.text(4, &self.encoding);
        out.fixed32(5, self.step);
        out.bytes(6, &self.data);
        out.text(7, frame);
        out.sfixed64(ARRIVED, times.arrived.as_nanos());
    }

    fn decode(bytes: &[u8]) -> Result<Sample<Self>, WireError> {
        let (mut captured, mut arrived) = (Timestamp::default(), Timestamp::default());
        let mut image =
            Image { width: 0, height: 0, step: 0, encoding: Cow::Borrowed(""), data: Cow::Borrowed(&[]) };
        Decoder::new(bytes).each(|number, value| {
            match number {
                1 => captured = get_timestamp(value)?,
                2 => image.width = value.fixed32()?,
                3 => image.height = value.fixed32()?,
                4 => image.encoding = Cow::Owned(value.text()?.to_owned()),
                5 => image.step = value.fixed32()?,
                6 => image.data = Cow::Owned(value.bytes()?.to_owned()),
                ARRIVED => arrived = Timestamp::from_nanos(value.sfixed64()?),
                _ => {}
            }
            Ok(())
        })?;
        Ok(Sample { captured, arrived, value: image })
    }
}

/// A picture whose data say its size: JPEG, PNG, WebP. Width, height and step are not kept.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Compressed<'a>(pub Image<'a>);

impl Message for Compressed<'_> {
    const NAME: &'static str = "Compressed";
    const UNIT: &'static str = "pixels";
    const SCHEMA: &'static Schema = &Schema {
        name: "foxglove.CompressedImage",
        about: "A compressed picture; from 1000 on what Vergence adds.",
        fields: &[
            Field::one("timestamp", 1, Kind::Message(&TIMESTAMP), "session time of the exposure"),
            Field::one("data", 2, Kind::Bytes, "as compressed"),
            Field::one("format", 3, Kind::String, "jpeg, png, webp"),
            Field::one("frame_id", 4, Kind::String, "reference frame of the camera"),
            ARRIVED_TOO,
        ],
    };

    fn encode(&self, times: Times, frame: &str, out: &mut Encoder<'_>) {
        put_timestamp(1, times.captured, out);
        out.bytes(2, &self.0.data);
        out.text(3, &self.0.encoding);
        out.text(4, frame);
        out.sfixed64(ARRIVED, times.arrived.as_nanos());
    }

    fn decode(bytes: &[u8]) -> Result<Sample<Self>, WireError> {
        let (mut captured, mut arrived) = (Timestamp::default(), Timestamp::default());
        let mut image =
            Image { width: 0, height: 0, step: 0, encoding: Cow::Borrowed(""), data: Cow::Borrowed(&[]) };
        Decoder::new(bytes).each(|number, value| {
            match number {
                1 => captured = get_timestamp(value)?,
                2 => image.data = Cow::Owned(value.bytes()?.to_owned()),
                3 => image.encoding = Cow::Owned(value.text()?.to_owned()),
                ARRIVED => arrived = Timestamp::from_nanos(value.sfixed64()?),
                _ => {}
            }
            Ok(())
        })?;
        Ok(Sample { captured, arrived, value: Self(image) })
    }
}
