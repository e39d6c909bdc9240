//! Spaces: reference spaces, spaces that follow an action, and where they are.

use std::sync::Arc;

use nalgebra::Vector3;
use openxr_sys as sys;
use vergence_geom::Rigid;
use vergence_sense::{Body, RawLocation};
use vergence_time::{Span, Timestamp};

use crate::action::{Action, hand_of};
use crate::binding::is_gaze;
use crate::clock::valid_time;
use crate::fault::bent_pose;
use crate::ffi::{Buffer, In, Out, XrResult, array, chained_out};
use crate::handle::{self, Object};
use crate::motion::Tracked;
use crate::pose::{from_raw, from_xr, to_xr, to_xr_vector};
use crate::session::Session;

/// What a space is fixed to.
enum Origin {
    View,
    Local,
    LocalFloor,
    Stage,
    Action(Arc<Action>, sys::Path),
}

pub(crate) struct Space {
    pub session: Arc<Session>,
    origin: Origin,
    origin_from_space: Rigid,
}

impl Object for Space {
    type Handle = sys::Space;
}

/// The space behind a handle, if its session is not lost.
pub(crate) fn get(handle: sys::Space) -> XrResult<Arc<Space>> {
    let space = handle::get::<Space>(handle)?;
    space.session.check_lost()?;
    Ok(space)
}

/// Half the step over which velocities are taken: short against any motion of a person, long against the rounding
/// of positions.
pub(crate) const VELOCITY_STEP: Span = Span::from_nanos(500_000);

impl Space {
    /// Where the space is at an instant of session time: its coordinates to those of the stage.
    pub(crate) fn stage_from_space(&self, at: Timestamp) -> Tracked {
        let stage_from_origin = match &self.origin {
            Origin::Stage => Tracked::Seen(Rigid::identity()),
            Origin::Local => Tracked::Seen(self.session.lock().stage_from_local_at(at)),
            Origin::LocalFloor => {
                let mut floor = self.session.lock().stage_from_local_at(at);
                floor.translation.y = 0.0;
                Tracked::Seen(floor)
            }
            Origin::View => self.session.head(at),
            Origin::Action(action, subaction) => self.session.action_pose(action, *subaction, at),
        };
        stage_from_origin.map(|stage_from_origin| stage_from_origin * self.origin_from_space)
    }

    /// The space LOCAL itself.
    pub(crate) fn is_local(&self) -> bool {
        matches!(self.origin, Origin::Local) && self.origin_from_space == Rigid::identity()
    }

    /// What a recording says of where this space is in `base`.
    fn said(&self, base: &Space, at: Timestamp) -> Option<RawLocation> {
        let replay = self.session.replay()?;
        if !base.is_local() || self.origin_from_space != Rigid::identity() {
            return None;
        }
        let body = match &self.origin {
            Origin::View => Body::Head,
            Origin::LocalFloor | Origin::Stage => Body::Floor,
            Origin::Action(action, sys::Path::NULL) => {
                is_gaze(&self.session.instance, action).then_some(Body::Gaze)?
            }
            Origin::Action(action, subaction) => {
                let hand = hand_of(self.session.instance.lock().paths.text(*subaction).ok()?)?;
                Body::Action(replay.action(&action.name)?, hand)
            }
            Origin::Local => return None,
        };
        replay.place(body, at)
    }

    fn is(&self, other: &Space) -> bool {
        match (&self.origin, &other.origin) {
            (Origin::Action(a, a_path), Origin::Action(b, b_path)) => Arc::ptr_eq(a, b) && a_path == b_path,
            (a, b) => std::mem::discriminant(a) == std::mem::discriminant(b),
        }
    }
}

/// Where `space` is in `base`, with what is known about it.
pub(crate) fn locate(space: &Space, base: &Space, at: Timestamp) -> (Option<Rigid>, sys::SpaceLocationFlags) {
    if space.is(base) {
        // Fixed to the same thing: known whether that is seen or not.
        let seen = matches!(space.stage_from_space(at), Tracked::Seen(_));
        let base_from_space = base.origin_from_space.inverse() * space.origin_from_space;
        return (Some(base_from_space), flags_of(seen));
    }
    match (base.stage_from_space(at), space.stage_from_space(at)) {
        (Tracked::Lost, _) | (_, Tracked::Lost) => (None, sys::SpaceLocationFlags::EMPTY),
        (base, space) => {
            let seen = matches!((base, space), (Tracked::Seen(_), Tracked::Seen(_)));
            let pose = base.pose().zip(space.pose()).map(|(base, space)| base.inverse() * space);
            (pose, flags_of(seen))
        }
    }
}

/// What is known of a place that may be read.
pub(crate) fn flags_of(is_tracked: bool) -> sys::SpaceLocationFlags {
    use sys::SpaceLocationFlags as F;
    let valid = F::ORIENTATION_VALID | F::POSITION_VALID;
    if is_tracked { valid | F::ORIENTATION_TRACKED | F::POSITION_TRACKED } else { valid }
}

/// Velocities of `space` in `base`, in the axes of `base`: metres and radians per second, by the central difference.
fn velocity(space: &Space, base: &Space, at: Timestamp) -> Option<(Vector3<f64>, Vector3<f64>)> {
    if space.is(base) {
        return Some((Vector3::zeros(), Vector3::zeros()));
    }
    let back = Span::from_nanos(-VELOCITY_STEP.as_nanos());
    let (before, after) = (at.saturating_add(back), at.saturating_add(VELOCITY_STEP));
    Some(velocity_between(&locate(space, base, before).0?, &locate(space, base, after).0?))
}

/// From where something was [`VELOCITY_STEP`] before to where it is as long after.
pub(crate) fn velocity_between(a: &Rigid, b: &Rigid) -> (Vector3<f64>, Vector3<f64>) {
    let seconds = 2.0 * VELOCITY_STEP.as_secs_f64();
    let linear = (b.translation.vector - a.translation.vector) / seconds;
    let angular = (b.rotation * a.rotation.inverse()).scaled_axis() / seconds;
    (linear, angular)
}

fn check_session(space: &Space, base: &Space) -> XrResult<()> {
    let same = Arc::ptr_eq(&space.session, &base.session);
    if same { Ok(()) } else { Err(sys::Result::ERROR_VALIDATION_FAILURE) }
}

pub(crate) fn enumerate_reference_spaces(
    session: &Session,
    mut buffer: Buffer<sys::ReferenceSpaceType>,
) -> XrResult {
    use sys::ReferenceSpaceType as R;
    if session.instance.has_local_floor() {
        buffer.give(&[R::VIEW, R::LOCAL, R::LOCAL_FLOOR, R::STAGE])
    } else {
        buffer.give(&[R::VIEW, R::LOCAL, R::STAGE])
    }
}

fn reference(session: &Session, ty: sys::ReferenceSpaceType) -> XrResult<Origin> {
    match ty {
        sys::ReferenceSpaceType::VIEW => Ok(Origin::View),
        sys::ReferenceSpaceType::LOCAL => Ok(Origin::Local),
        sys::ReferenceSpaceType::STAGE => Ok(Origin::Stage),
        sys::ReferenceSpaceType::LOCAL_FLOOR if session.instance.has_local_floor() => Ok(Origin::LocalFloor),
        _ if format!("{ty:?}").parse::<i32>().is_ok() => Err(sys::Result::ERROR_VALIDATION_FAILURE),
        _ => Err(sys::Result::ERROR_REFERENCE_SPACE_UNSUPPORTED),
    }
}

pub(crate) fn create_reference_space(
    session: Arc<Session>,
    info: In<sys::ReferenceSpaceCreateInfo>,
    mut out: Out<sys::Space>,
) -> XrResult {
    let info = info.get()?;
    out.check()?;
    let origin = reference(&session, info.reference_space_type)?;
    let origin_from_space = from_xr(&info.pose_in_reference_space)?;
    let parent = sys::Handle::into_raw(session.handle);
    let (handle, _) = handle::insert(parent, |_| Space { session, origin, origin_from_space });
    out.set(handle)?;
    Ok(sys::Result::SUCCESS)
}

/// The simulated user stands in a room of 4 m by 4 m.
pub(crate) fn get_reference_space_bounds_rect(
    session: &Session,
    ty: sys::ReferenceSpaceType,
    mut out: Out<sys::Extent2Df>,
) -> XrResult {
    let origin = reference(session, ty)?;
    out.check()?;
    if matches!(origin, Origin::Stage) {
        out.set(sys::Extent2Df { width: 4.0, height: 4.0 })?;
        Ok(sys::Result::SUCCESS)
    } else {
        out.set(sys::Extent2Df { width: 0.0, height: 0.0 })?;
        Ok(sys::Result::SPACE_BOUNDS_UNAVAILABLE)
    }
}

pub(crate) fn create_action_space(
    session: Arc<Session>,
    info: In<sys::ActionSpaceCreateInfo>,
    mut out: Out<sys::Space>,
) -> XrResult {
    let info = info.get()?;
    out.check()?;
    let action = handle::get::<Action>(info.action)?;
    if action.kind != sys::ActionType::POSE_INPUT {
        return Err(sys::Result::ERROR_ACTION_TYPE_MISMATCH);
    }
    action.check_subaction(&session.instance, info.subaction_path)?;
    let origin_from_space = from_xr(&info.pose_in_action_space)?;
    let parent = sys::Handle::into_raw(session.handle);
    let origin = Origin::Action(action, info.subaction_path);
    let (handle, _) = handle::insert(parent, |_| Space { session, origin, origin_from_space });
    out.set(handle)?;
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn destroy_space(space: sys::Space) -> XrResult {
    handle::remove::<Space>(space)?;
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn velocity_flags() -> sys::SpaceVelocityFlags {
    sys::SpaceVelocityFlags::LINEAR_VALID | sys::SpaceVelocityFlags::ANGULAR_VALID
}

pub(crate) fn locate_space(
    space: &Space,
    base: &Space,
    time: sys::Time,
    mut out: Out<sys::SpaceLocation>,
) -> XrResult {
    check_session(space, base)?;
    let location = out.fill()?;
    let at = valid_time(time)?;
    let sampled = chained_out::<sys::EyeGazeSampleTimeEXT>(location.next);
    if let Some(said) = space.said(base, at) {
        location.location_flags = sys::SpaceLocationFlags::from_raw(u64::from(said.validity.0));
        location.pose = bent_pose(from_raw(&said.pose));
        if let Some(out) = chained_out::<sys::SpaceVelocity>(location.next) {
            out.velocity_flags = sys::SpaceVelocityFlags::EMPTY;
        }
        if let Some(out) = sampled {
            out.time = time;
        }
        return Ok(sys::Result::SUCCESS);
    }
    let (pose, flags) = locate(space, base, at);
    location.location_flags = flags;
    if let Some(out) = sampled {
        // The gaze is known for each instant.
        out.time = if pose.is_some() { time } else { sys::Time::from_nanos(0) };
    }
    location.pose = bent_pose(pose.map_or(sys::Posef::IDENTITY, |pose| to_xr(&pose)));
    if let Some(out) = chained_out::<sys::SpaceVelocity>(location.next) {
        let found = velocity(space, base, at);
        out.velocity_flags = found.map_or(sys::SpaceVelocityFlags::EMPTY, |_| velocity_flags());
        let (linear, angular) = found.unwrap_or_default();
        (out.linear_velocity, out.angular_velocity) = (to_xr_vector(&linear), to_xr_vector(&angular));
    }
    Ok(sys::Result::SUCCESS)
}

/// `xrLocateSpaces` of OpenXR 1.1 and XR_KHR_locate_spaces.
pub(crate) fn locate_spaces(
    session: &Session,
    info: In<sys::SpacesLocateInfo>,
    mut out: Out<sys::SpaceLocations>,
) -> XrResult {
    let info = info.get()?;
    let locations = out.fill()?;
    let at = valid_time(info.time)?;
    let base = get(info.base_space)?;
    if !std::ptr::eq(&*base.session, session)
        || info.space_count == 0
        || locations.location_count != info.space_count
    {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    if locations.locations.is_null() || !locations.locations.is_aligned() {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    // SAFETY: the application hands over as many handles as it says.
    let spaces = unsafe { array(info.spaces, info.space_count) }?;
    let spaces = spaces.iter().map(|&space| get(space)).collect::<XrResult<Vec<_>>>()?;
    let mut velocities = chained_out::<sys::SpaceVelocities>(locations.next);
    if let Some(velocities) = &velocities
        && (velocities.velocity_count != info.space_count || velocities.velocities.is_null())
    {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    for (index, space) in spaces.iter().enumerate() {
        check_session(space, &base)?;
        let (pose, location_flags) = locate(space, &base, at);
        let pose = bent_pose(pose.map_or(sys::Posef::IDENTITY, |pose| to_xr(&pose)));
        // SAFETY: the application lends room for `location_count` elements, which equals the number of spaces.
        unsafe { locations.locations.add(index).write(sys::SpaceLocationData { location_flags, pose }) };
        if let Some(velocities) = &mut velocities {
            let found = velocity(space, &base, at);
            let (linear, angular) = found.unwrap_or_default();
            let data = sys::SpaceVelocityData {
                velocity_flags: found.map_or(sys::SpaceVelocityFlags::EMPTY, |_| velocity_flags()),
                linear_velocity: to_xr_vector(&linear),
                angular_velocity: to_xr_vector(&angular),
            };
            // SAFETY: as above, with `velocity_count`.
            unsafe { velocities.velocities.add(index).write(data) };
        }
    }
    Ok(sys::Result::SUCCESS)
}
