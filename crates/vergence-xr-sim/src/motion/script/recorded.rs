//! A script out of a recorded session.

use vergence_geom::Rigid;
use vergence_sense::{ControlState, JOINTS_PER_HAND, RawJoints, RawLocation, Said, Tracking};
use vergence_time::{Span, Timestamp};

use super::{Body, EYES_M, RawTracking, Script};
use crate::motion::{AtEnd, HandPose};

impl Script {
    /// What the user of a recorded session did, to be done again in any other: `frames` as for
    /// [`Replay`](crate::motion::Replay), and for each action, by its place, the control that it was read from.
    ///
    /// What stays the same takes no memory; each pose that moves takes 100 bytes per frame. A head and two controllers that
    /// all move take 160 MB for an hour at 90 Hz; the joints of two hands, where they were recorded, 1.1 GB.
    ///
    /// Motion time 0 is when the session began to run, as the clock said at its first frame. The floor is the recorded one,
    /// where it was known.
    pub fn of_session(frames: impl Iterator<Item = Vec<Said>>, parts: &[Option<Part>]) -> Self {
        let mut script = Self::empty(AtEnd::Stop);
        let mut began = None;
        let mut stage_from_local = Rigid::translation(0.0, EYES_M[1], 0.0);
        for frame in frames {
            let mut display = None;
            for said in &frame {
                match said {
                    Said::Frame { now, display: shown, .. } => {
                        let began = *began.get_or_insert(*now);
                        let since = shown.since(began).unwrap_or(Span::ZERO);
                        display = Some(Timestamp::from_nanos(since.as_nanos()))
                            // Keys rise; a clock that does not is passed over.
                            .filter(|at| at.as_nanos() > script.duration.as_nanos());
                    }
                    Said::Place { of: vergence_sense::Body::Floor, location, .. } => {
                        if let Some(floor) = location.read().reference_from_device() {
                            stage_from_local = Rigid::translation(0.0, -floor.translation.y, 0.0);
                        }
                    }
                    _ => {}
                }
            }
            let Some(at) = display else { continue };
            script.duration = Span::from_nanos(at.as_nanos());
            let mut given = Given::default();
            for said in &frame {
                script.take(at, said, parts, &stage_from_local, &mut given);
            }
        }
        script
    }

    /// One thing of a frame; of a body that is located twice the first place counts.
    fn take(
        &mut self,
        at: Timestamp,
        said: &Said,
        parts: &[Option<Part>],
        stage_from_local: &Rigid,
        given: &mut Given,
    ) {
        let part = |action: u16| parts.get(usize::from(action)).copied().flatten();
        match said {
            Said::Place { of: vergence_sense::Body::Head, .. } if given.head => {}
            Said::Place { of: vergence_sense::Body::Head, location, .. } => {
                given.head = true;
                self.head.follow(at, location, stage_from_local);
            }
            Said::Place { of: vergence_sense::Body::Action(action, hand), location, .. } => {
                let held = &mut self.hands[hand.index()];
                let body = match part(*action) {
                    Some(Part::Aim) => &mut held.aim,
                    Some(Part::Grip) => &mut held.grip,
                    _ => return,
                };
                body.follow(at, location, stage_from_local);
            }
            Said::Place { of: vergence_sense::Body::Gaze, location, .. } => {
                self.gaze_in_stage.follow(at, location, stage_from_local);
            }
            Said::Joints { hand, joints, .. } => {
                let pose = recorded_hand(joints, stage_from_local).map(Box::new);
                self.bare[hand.index()].recorded.extend(at, Some(pose));
            }
            Said::Control { action, hand, state, .. } => {
                let held = &mut self.hands[hand.index()];
                let (on, pulled, pushed) = match *state {
                    ControlState::Button(button) => {
                        (button.0, button.0.map(|on| f32::from(u8::from(on))), None)
                    }
                    ControlState::Axis(axis) => (axis.0.map(|pull| pull >= 0.5), axis.0, None),
                    ControlState::Vector2(vector) => (None, None, vector.0),
                };
                match part(*action) {
                    Some(Part::Trigger) => held.trigger.extend(at, pulled),
                    Some(Part::Squeeze) => held.squeeze.extend(at, pulled),
                    Some(Part::Stick) => held.stick.extend(at, pushed),
                    Some(Part::StickClick) => held.stick_click.extend(at, on),
                    Some(Part::Primary) => held.primary.extend(at, on),
                    Some(Part::Secondary) => held.secondary.extend(at, on),
                    Some(Part::Menu) => held.menu.extend(at, on),
                    Some(Part::Aim | Part::Grip) | None => {}
                }
            }
            _ => {}
        }
    }
}

/// A part of a controller that an action was read from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names of the fields of `Controller`")]
pub enum Part {
    Aim,
    Grip,
    Trigger,
    Squeeze,
    Stick,
    StickClick,
    Primary,
    Secondary,
    Menu,
}

/// A recorded hand in stage coordinates; `None` where it was not seen, or not all of it.
fn recorded_hand(joints: &RawJoints, stage_from_local: &Rigid) -> Option<HandPose> {
    if !joints.is_active {
        return None;
    }
    let mut pose = HandPose { is_tracked: true, joints: [(Rigid::identity(), 0.0); JOINTS_PER_HAND] };
    for (raw, (place, radius_m)) in joints.joints.iter().zip(&mut pose.joints) {
        let read = raw.pose.read(raw.validity);
        *place = stage_from_local * read.reference_from_device()?;
        *radius_m = if raw.radius_m.is_finite() { f64::from(raw.radius_m.max(0.0)) } else { 0.0 };
        pose.is_tracked &= read.position_tracking == Tracking::Measured;
    }
    Some(pose)
}

#[derive(Default)]
struct Given {
    head: bool,
}

impl Body {
    /// One more key, where the place of the body was known.
    fn follow(&mut self, at: Timestamp, location: &RawLocation, stage_from_local: &Rigid) {
        let pose = location.read();
        let tracking = match (pose.reference_from_device(), pose.position_tracking) {
            (None, _) => RawTracking::Lost,
            (Some(_), Tracking::Measured) => RawTracking::Seen,
            (Some(_), _) => RawTracking::Held,
        };
        if let Some(local_from_body) = pose.reference_from_device() {
            let stage_from_body = stage_from_local * local_from_body;
            self.position.extend(at, Some(stage_from_body.translation.vector));
            self.rotation.extend(at, Some(stage_from_body.rotation));
        }
        self.tracking.extend(at, Some(tracking));
    }
}
