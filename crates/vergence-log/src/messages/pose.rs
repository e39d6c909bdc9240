//! Poses in double precision, what we estimate ourselves: `foxglove.PoseInFrame` and `foxglove.PosesInFrame`.

use vergence_sense::{Gaze, HandJoints, JOINTS_PER_HAND, JointPose, Pose, Sample, Validity};
use vergence_time::Timestamp;

use super::{ARRIVED, ARRIVED_NS, ARRIVED_TOO, CAPTURED_NS, Gathered, TIMESTAMP};
use super::{get_timestamp, put_times, put_timestamp};
use crate::message::{Message, Times};
use crate::schema::{Field, Kind, Schema};
use crate::wire::{Decoder, Encoder, Value, WireError};

pub(super) static VECTOR3: Schema = Schema {
    name: "foxglove.Vector3",
    about: "Three coordinates.",
    fields: &[
        Field::one("x", 1, Kind::Double, ""),
        Field::one("y", 2, Kind::Double, ""),
        Field::one("z", 3, Kind::Double, ""),
    ],
};

static QUATERNION: Schema = Schema {
    name: "foxglove.Quaternion",
    about: "A Hamilton quaternion.",
    fields: &[
        Field::one("x", 1, Kind::Double, ""),
        Field::one("y", 2, Kind::Double, ""),
        Field::one("z", 3, Kind::Double, ""),
        Field::one("w", 4, Kind::Double, ""),
    ],
};

static POSE: Schema = Schema {
    name: "foxglove.Pose",
    about: "Position and orientation.",
    fields: &[
        Field::one("position", 1, Kind::Message(&VECTOR3), "metres"),
        Field::one("orientation", 2, Kind::Message(&QUATERNION), "frame from device"),
    ],
};

static VELOCITY: Schema = Schema {
    name: "vergence.Velocity",
    about: "How a device moves in its reference frame, as the runtime said it.",
    fields: &[
        Field::many("linear_m_s", 1, Kind::Float, "x y z, metres per second"),
        Field::many("angular_rad_s", 2, Kind::Float, "x y z, radians per second about the axis"),
        Field::one("linear_valid", 3, Kind::Bool, "the linear part may be read"),
        Field::one("angular_valid", 4, Kind::Bool, "the angular part may be read"),
    ],
};

const FLAGS: &str =
    "1 orientation may be read, 2 position may be read, 4 orientation measured, 8 position measured";

pub(super) static POSE_IN_FRAME: Schema = Schema {
    name: "foxglove.PoseInFrame",
    about: "A pose and its frame; from 1000 on what Vergence adds.",
    fields: &[
        Field::one("timestamp", 1, Kind::Message(&TIMESTAMP), "session time for which the pose holds"),
        Field::one("frame_id", 2, Kind::String, "reference frame"),
        Field::one("pose", 3, Kind::Message(&POSE), "frame from device"),
        ARRIVED_TOO,
        Field::one("validity", 1001, Kind::Uint32, FLAGS),
        Field::one("velocity", 1002, Kind::Message(&VELOCITY), "where it was asked for"),
    ],
};

pub(super) static POSES_IN_FRAME: Schema = Schema {
    name: "foxglove.PosesInFrame",
    about: "Poses and their frame; from 1000 on what Vergence adds.",
    fields: &[
        Field::one("timestamp", 1, Kind::Message(&TIMESTAMP), "session time for which the poses hold"),
        Field::one("frame_id", 2, Kind::String, "reference frame"),
        Field::many("poses", 3, Kind::Message(&POSE), "frame from eye, or frame from joint"),
        ARRIVED_TOO,
        Field::one("validity", 1001, Kind::Uint32, "of all poses, where they share it; as in validities"),
        Field::one("is_active", 1002, Kind::Bool, "the hand is seen"),
        Field::many("fovs_rad", 1003, Kind::Float, "of each eye left, right, up, down, radians"),
        Field::many("radii_m", 1004, Kind::Float, "of each joint, metres"),
        Field::one("validities", 1005, Kind::Bytes, FLAGS),
    ],
};

/// Writes a pose from numbers that are written by `number`.
pub(super) fn put_pose<T: Copy>(
    field: u32,
    position: [T; 3],
    orientation: [T; 4],
    number: fn(&mut Encoder<'_>, u32, T),
    out: &mut Encoder<'_>,
) {
    out.message(field, |pose| {
        pose.message(1, |out| (1..).zip(position).for_each(|(field, value)| number(out, field, value)));
        pose.message(2, |out| (1..).zip(orientation).for_each(|(field, value)| number(out, field, value)));
    });
}

/// Reads a pose whose numbers are read by `number`.
pub(super) fn get_pose<T: Copy + Default>(
    value: Value<'_>,
    number: fn(Value<'_>) -> Result<T, WireError>,
) -> Result<([T; 3], [T; 4]), WireError> {
    fn coordinates<T: Copy, const N: usize>(
        bytes: &[u8],
        number: fn(Value<'_>) -> Result<T, WireError>,
        into: &mut [T; N],
    ) -> Result<(), WireError> {
        Decoder::new(bytes).each(|field, value| {
            if let Some(slot) = into.get_mut((field as usize).wrapping_sub(1)) {
                *slot = number(value)?;
            }
            Ok(())
        })
    }
    let (mut position, mut orientation) = ([T::default(); 3], [T::default(); 4]);
    Decoder::new(value.bytes()?).each(|field, value| match field {
        1 => coordinates(value.bytes()?, number, &mut position),
        2 => coordinates(value.bytes()?, number, &mut orientation),
        _ => Ok(()),
    })?;
    Ok((position, orientation))
}

pub(super) fn get_validity(value: Value<'_>) -> Result<Validity, WireError> {
    let flags = value.uint()?;
    u8::try_from(flags).map(Validity).map_err(|_| WireError::Value {
        what: "validity",
        expected: "flags below 256",
        found: flags.to_string(),
    })
}

impl Message for Pose {
    const NAME: &'static str = "Pose";
    const UNIT: &'static str = "m, quaternion xyzw";
    const SCHEMA: &'static Schema = &POSE_IN_FRAME;

    fn encode(&self, times: Times, frame: &str, out: &mut Encoder<'_>) {
        let (position, orientation) = self.to_exact();
        put_timestamp(1, times.captured, out);
        out.text(2, frame);
        put_pose(3, position, orientation, |out, field, value| out.double(field, value), out);
        out.sfixed64(ARRIVED, times.arrived.as_nanos());
        out.uint(1001, u64::from(Validity::of(self.position_tracking, self.orientation_tracking).0));
    }

    fn decode(bytes: &[u8]) -> Result<Sample<Self>, WireError> {
        let (mut captured, mut arrived, mut validity) =
            (Timestamp::default(), Timestamp::default(), Validity(0));
        let (mut position, mut orientation) = ([0.0; 3], [0.0; 4]);
        Decoder::new(bytes).each(|number, value| {
            match number {
                1 => captured = get_timestamp(value)?,
                3 => (position, orientation) = get_pose(value, |value| value.double())?,
                ARRIVED => arrived = Timestamp::from_nanos(value.sfixed64()?),
                1001 => validity = get_validity(value)?,
                _ => {}
            }
            Ok(())
        })?;
        let value = Self::from_exact(position, validity.position(), orientation, validity.orientation());
        Ok(Sample { captured, arrived, value })
    }
}

impl Message for HandJoints {
    const NAME: &'static str = "HandJoints";
    const UNIT: &'static str = "m, quaternion xyzw";
    const SCHEMA: &'static Schema = &POSES_IN_FRAME;

    fn encode(&self, times: Times, frame: &str, out: &mut Encoder<'_>) {
        put_timestamp(1, times.captured, out);
        out.text(2, frame);
        for joint in &self.0 {
            let (position, orientation) = joint.pose.to_exact();
            put_pose(3, position, orientation, |out, field, value| out.double(field, value), out);
        }
        out.sfixed64(ARRIVED, times.arrived.as_nanos());
        out.floats(1004, &self.0.map(|joint| joint.radius_m));
        let flags =
            |joint: JointPose| Validity::of(joint.pose.position_tracking, joint.pose.orientation_tracking).0;
        out.bytes(1005, &self.0.map(flags));
    }

    fn decode(bytes: &[u8]) -> Result<Sample<Self>, WireError> {
        let (mut captured, mut arrived) = (Timestamp::default(), Timestamp::default());
        let mut poses = [([0.0; 3], [0.0; 4]); JOINTS_PER_HAND];
        let (mut radii, mut validities, mut count) = ([0.0; JOINTS_PER_HAND], [0; JOINTS_PER_HAND], 0);
        Decoder::new(bytes).each(|number, value| {
            match number {
                1 => captured = get_timestamp(value)?,
                3 => {
                    if let Some(pose) = poses.get_mut(count) {
                        *pose = get_pose(value, |value| value.double())?;
                    }
                    count += 1;
                }
                ARRIVED => arrived = Timestamp::from_nanos(value.sfixed64()?),
                1004 => radii = value.floats()?,
                1005 => validities = all_joints(value.bytes()?)?,
                _ => {}
            }
            Ok(())
        })?;
        check_joints(count)?;
        let mut joints = Self::LOST;
        for (index, joint) in joints.0.iter_mut().enumerate() {
            let ((position, orientation), validity) = (poses[index], Validity(validities[index]));
            joint.pose = Pose::from_exact(position, validity.position(), orientation, validity.orientation());
            joint.radius_m = radii[index];
        }
        Ok(Sample { captured, arrived, value: joints })
    }
}

pub(super) fn all_joints(bytes: &[u8]) -> Result<[u8; JOINTS_PER_HAND], WireError> {
    check_joints(bytes.len())?;
    let mut all = [0; JOINTS_PER_HAND];
    all.copy_from_slice(bytes);
    Ok(all)
}

pub(super) fn check_joints(count: usize) -> Result<(), WireError> {
    if count == JOINTS_PER_HAND {
        return Ok(());
    }
    Err(WireError::Value { what: "joints of a hand", expected: "26", found: count.to_string() })
}

/// `None`: the eyes were not seen. Such a message has neither origin nor direction; in version 1 each had.
impl Message for Option<Gaze> {
    const NAME: &'static str = "Gaze";
    const VERSION: u32 = 2;
    const UNIT: &'static str = "m, unit vector";
    const SCHEMA: &'static Schema = &Schema {
        name: "vergence.Gaze",
        about: "Where the user looks.",
        fields: &[
            CAPTURED_NS,
            ARRIVED_NS,
            Field::one("frame_id", 3, Kind::String, "reference frame"),
            Field::one(
                "origin",
                4,
                Kind::Message(&VECTOR3),
                "between the eyes, metres; missing where they are not seen",
            ),
            Field::one(
                "direction",
                5,
                Kind::Message(&VECTOR3),
                "of unit length; missing where the eyes are not seen",
            ),
        ],
    };

    fn encode(&self, times: Times, frame: &str, out: &mut Encoder<'_>) {
        put_times(times, out);
        out.text(3, frame);
        let Some(gaze) = self else { return };
        for (field, vector) in [(4, &gaze.origin.coords), (5, gaze.direction.as_ref())] {
            out.message(field, |out| (1..).zip(vector.iter()).for_each(|(n, &value)| out.double(n, value)));
        }
    }

    fn decode(bytes: &[u8]) -> Result<Sample<Self>, WireError> {
        let (mut times, mut vectors, mut is_seen) = (Gathered::default(), [[0.0; 3]; 2], false);
        Decoder::new(bytes).each(|number, value| {
            is_seen |= number == 5;
            match number {
                4 | 5 => Decoder::new(value.bytes()?).each(|axis, value| {
                    if let Some(slot) = vectors[number as usize - 4].get_mut((axis as usize).wrapping_sub(1))
                    {
                        *slot = value.double()?;
                    }
                    Ok(())
                })?,
                _ => drop(times.take(number, value)?),
            }
            Ok(())
        })?;
        let [origin, direction] = vectors;
        Ok(times.sample(is_seen.then(|| Gaze {
            origin: origin.into(),
            direction: nalgebra::Unit::new_unchecked(direction.into()),
        })))
    }
}
