//! What a runtime says, in single precision, every bit: Foxglove's schemas hold doubles, in which a single survives.

use vergence_sense::{
    JOINTS_PER_HAND, RawJoint, RawJoints, RawLocation, RawPose, RawVelocity, RawView, RawViews, Sample,
    Validity,
};
use vergence_time::Timestamp;

use super::pose::{
    POSE_IN_FRAME, POSES_IN_FRAME, all_joints, check_joints, get_pose, get_validity, put_pose,
};
use super::{ARRIVED, get_timestamp, put_timestamp};
use crate::message::{Message, Times};
use crate::schema::Schema;
use crate::wire::{Decoder, Encoder, Value, WireError};

fn put(field: u32, pose: &RawPose, out: &mut Encoder<'_>) {
    put_pose(
        field,
        pose.position_m,
        pose.orientation_xyzw,
        |out, field, value| out.double_of(field, value),
        out,
    );
}

fn get(value: Value<'_>) -> Result<RawPose, WireError> {
    let (position_m, orientation_xyzw) = get_pose(value, |value| value.single())?;
    Ok(RawPose { position_m, orientation_xyzw })
}

impl Message for RawLocation {
    const NAME: &'static str = "RawLocation";
    const UNIT: &'static str = "m, quaternion xyzw";
    const SCHEMA: &'static Schema = &POSE_IN_FRAME;

    fn encode(&self, times: Times, frame: &str, out: &mut Encoder<'_>) {
        put_timestamp(1, times.captured, out);
        out.text(2, frame);
        put(3, &self.pose, out);
        out.sfixed64(ARRIVED, times.arrived.as_nanos());
        out.uint(1001, u64::from(self.validity.0));
        if let Some(velocity) = &self.velocity {
            out.message(1002, |out| {
                out.floats(1, &velocity.linear_m_s);
                out.floats(2, &velocity.angular_rad_s);
                out.bool(3, velocity.linear_valid);
                out.bool(4, velocity.angular_valid);
            });
        }
    }

    fn decode(bytes: &[u8]) -> Result<Sample<Self>, WireError> {
        let (mut captured, mut arrived) = (Timestamp::default(), Timestamp::default());
        let mut location = Self { pose: RawPose::IDENTITY, validity: Validity(0), velocity: None };
        Decoder::new(bytes).each(|number, value| {
            match number {
                1 => captured = get_timestamp(value)?,
                3 => location.pose = get(value)?,
                ARRIVED => arrived = Timestamp::from_nanos(value.sfixed64()?),
                1001 => location.validity = get_validity(value)?,
                1002 => {
                    let mut velocity = RawVelocity {
                        linear_m_s: [0.0; 3],
                        angular_rad_s: [0.0; 3],
                        linear_valid: false,
                        angular_valid: false,
                    };
                    Decoder::new(value.bytes()?).each(|number, value| {
                        match number {
                            1 => velocity.linear_m_s = value.floats()?,
                            2 => velocity.angular_rad_s = value.floats()?,
                            3 => velocity.linear_valid = value.bool()?,
                            4 => velocity.angular_valid = value.bool()?,
                            _ => {}
                        }
                        Ok(())
                    })?;
                    location.velocity = Some(velocity);
                }
                _ => {}
            }
            Ok(())
        })?;
        Ok(Sample { captured, arrived, value: location })
    }
}

impl Message for RawViews {
    const NAME: &'static str = "RawViews";
    const UNIT: &'static str = "m, quaternion xyzw, rad";
    const SCHEMA: &'static Schema = &POSES_IN_FRAME;

    fn encode(&self, times: Times, frame: &str, out: &mut Encoder<'_>) {
        put_timestamp(1, times.captured, out);
        out.text(2, frame);
        for view in self.views() {
            put(3, &view.pose, out);
        }
        out.sfixed64(ARRIVED, times.arrived.as_nanos());
        out.uint(1001, u64::from(self.validity.0));
        let mut fovs = [0.0; 4 * Self::MOST];
        for (fov, view) in fovs.chunks_exact_mut(4).zip(self.views()) {
            fov.copy_from_slice(&view.fov_rad);
        }
        out.floats(1003, &fovs[..4 * self.views().len()]);
    }

    fn decode(bytes: &[u8]) -> Result<Sample<Self>, WireError> {
        let (mut captured, mut arrived, mut validity) =
            (Timestamp::default(), Timestamp::default(), Validity(0));
        let mut views = [RawView { pose: RawPose::IDENTITY, fov_rad: [0.0; 4] }; Self::MOST];
        let (mut count, mut fovs): (usize, &[u8]) = (0, &[]);
        Decoder::new(bytes).each(|number, value| {
            match number {
                1 => captured = get_timestamp(value)?,
                3 => {
                    if let Some(view) = views.get_mut(count) {
                        view.pose = get(value)?;
                    }
                    count += 1;
                }
                ARRIVED => arrived = Timestamp::from_nanos(value.sfixed64()?),
                1001 => validity = get_validity(value)?,
                1003 => fovs = value.bytes()?,
                _ => {}
            }
            Ok(())
        })?;
        if count > Self::MOST || fovs.len() != 16 * count {
            return Err(WireError::Value {
                what: "views",
                expected: "at most 4, each with 4 angles",
                found: format!("{count}, with {} bytes of angles", fovs.len()),
            });
        }
        for (view, bytes) in views.iter_mut().zip(fovs.chunks_exact(16)) {
            view.fov_rad = Value::Bytes(bytes).floats()?;
        }
        // The count was checked.
        let value = Self::new(validity, &views[..count]).unwrap_or(Self::NONE);
        Ok(Sample { captured, arrived, value })
    }
}

impl Message for RawJoints {
    const NAME: &'static str = "RawJoints";
    const UNIT: &'static str = "m, quaternion xyzw";
    const SCHEMA: &'static Schema = &POSES_IN_FRAME;

    fn encode(&self, times: Times, frame: &str, out: &mut Encoder<'_>) {
        put_timestamp(1, times.captured, out);
        out.text(2, frame);
        for joint in &self.joints {
            put(3, &joint.pose, out);
        }
        out.sfixed64(ARRIVED, times.arrived.as_nanos());
        out.bool(1002, self.is_active);
        out.floats(1004, &self.joints.map(|joint| joint.radius_m));
        out.bytes(1005, &self.joints.map(|joint| joint.validity.0));
    }

    fn decode(bytes: &[u8]) -> Result<Sample<Self>, WireError> {
        let (mut captured, mut arrived) = (Timestamp::default(), Timestamp::default());
        let nothing = RawJoint { pose: RawPose::IDENTITY, validity: Validity(0), radius_m: 0.0 };
        let mut found = Self { is_active: false, joints: [nothing; JOINTS_PER_HAND] };
        let (mut radii, mut validities, mut count) = ([0.0; JOINTS_PER_HAND], [0; JOINTS_PER_HAND], 0);
        Decoder::new(bytes).each(|number, value| {
            match number {
                1 => captured = get_timestamp(value)?,
                3 => {
                    if let Some(joint) = found.joints.get_mut(count) {
                        joint.pose = get(value)?;
                    }
                    count += 1;
                }
                ARRIVED => arrived = Timestamp::from_nanos(value.sfixed64()?),
                1002 => found.is_active = value.bool()?,
                1004 => radii = value.floats()?,
                1005 => validities = all_joints(value.bytes()?)?,
                _ => {}
            }
            Ok(())
        })?;
        check_joints(count)?;
        for ((joint, radius_m), validity) in found.joints.iter_mut().zip(radii).zip(validities) {
            joint.radius_m = radius_m;
            joint.validity = Validity(validity);
        }
        Ok(Sample { captured, arrived, value: found })
    }
}
