//! What the hands do in the scene: pointing, taking, walking.
//!
//! A hand that lies still means nothing: it points at nothing and nothing is logged of it until it has pulled something, or
//! has moved by itself, against the room and against the user's head (which carries along hands that are held in front of it).

use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use vergence_action::DeadZone;
use vergence_geom::{Ray, Rigid};
use vergence_scene::Scene;
use vergence_sense::{Axis, Button, Hand, Haptic};
use vergence_time::{Span, Timestamp};
use vergence_xr::{Client, Error, Reading};

use crate::report::Touch;
use crate::targets::Targets;

/// Touches that are kept for the report.
const KEPT: usize = 1000;
/// How far a grab or trigger must be pulled to take something …
const TAKE: f32 = 0.6;
/// … and let go to release it: apart, so that a trembling finger does neither.
const RELEASE: f32 = 0.4;
/// A pull that means something: more than springs and dust make.
const FELT: f32 = 0.05;
/// A hand that has not moved farther than this, metres and radians, lies still.
const STILL_M: f64 = 0.02;
const STILL_RAD: f64 = 0.05;
/// Speed of walking by thumbstick, metres per second.
const WALK_M_S: f64 = 1.5;
/// The longest time walked in one frame: after a longer one nobody knows where the thumbstick was meanwhile.
const LONGEST_STEP: Span = Span::from_millis(100);

/// Places of the actions in the plan's set, where they are in it.
struct Actions {
    aim: usize,
    select: Option<usize>,
    grab: Option<usize>,
    walk: Option<usize>,
    pulse: Option<usize>,
}

/// What a hand does.
#[derive(Clone, Copy, Debug, Default)]
struct Doing {
    pointed: Option<usize>,
    held: Option<usize>,
    /// Where it points from, world coordinates; `None` where that is not known, or it lies still.
    world_from_aim: Option<Rigid>,
    /// To what it points at, metres.
    distance_m: Option<f64>,
    stillness: Stillness,
}

/// Whether a hand has ever done something.
#[derive(Clone, Copy, Debug, Default)]
struct Stillness {
    is_over: bool,
    /// Where it was at first, and whether it has moved from there: in LOCAL, and before the user.
    at_first: [Option<Rigid>; 2],
    has_moved: [bool; 2],
}

impl Stillness {
    /// Follows a hand that is at `local_from_aim` and pulls so much.
    fn follow(&mut self, local_from_aim: Option<&Rigid>, local_from_head: Option<&Rigid>, pull: f32) {
        self.is_over |= pull > FELT;
        let (false, Some(aim), Some(head)) = (self.is_over, local_from_aim, local_from_head) else { return };
        let local_from_user = Rigid::from_parts(head.translation, vergence_geom::yaw(&head.rotation));
        for (which, now) in [*aim, local_from_user.inverse() * aim].iter().enumerate() {
            let first = self.at_first[which].get_or_insert(*now);
            let moved_m = (now.translation.vector - first.translation.vector).norm();
            self.has_moved[which] |= moved_m > STILL_M || now.rotation.angle_to(&first.rotation) > STILL_RAD;
        }
        self.is_over = self.has_moved == [true; 2];
    }
}

/// Follows the hands. Nothing exists of it where nothing can be touched.
pub(crate) struct Touching {
    actions: Actions,
    targets: Targets,
    doing: [Doing; 2],
    dead_zone: DeadZone,
    touches: Vec<Touch>,
}

impl Touching {
    /// `None` where the scene has nothing to touch or the session has no actions.
    pub(crate) fn new(scene: &Arc<Scene>, client: &Client) -> Option<Self> {
        let aim = client.action("aim")?;
        let targets = Targets::new(scene)?;
        Some(Self {
            actions: Actions {
                aim,
                select: client.action("select"),
                grab: client.action("grab"),
                walk: client.action("move"),
                pulse: client.action("pulse"),
            },
            targets,
            doing: [Doing::default(); 2],
            dead_zone: DeadZone::default(),
            touches: Vec::with_capacity(KEPT),
        })
    }

    /// Moves what can be touched to where it is `time` after the start of the scene's clips.
    pub(crate) fn move_targets(&mut self, time: Span) {
        self.targets.move_to(time);
    }

    /// LOCAL's origin has moved: hands that lie still are somewhere else in it.
    pub(crate) fn recentred(&mut self) {
        for doing in &mut self.doing {
            doing.stillness.at_first = [None; 2];
        }
    }

    /// Where a hand points from, −z ahead, as of the frame that was followed last; `None` where it does not.
    pub(crate) fn aim(&self, hand: Hand) -> Option<&Rigid> {
        self.doing[hand.index()].world_from_aim.as_ref()
    }

    /// How far away what it points at is, metres.
    pub(crate) fn distance_m(&self, hand: Hand) -> Option<f64> {
        self.doing[hand.index()].distance_m
    }

    /// What it points at, among the scene's touchables.
    pub(crate) fn pointed(&self, hand: Hand) -> Option<usize> {
        self.doing[hand.index()].pointed
    }

    /// What it has taken, among the scene's touchables.
    pub(crate) fn held(&self, hand: Hand) -> Option<usize> {
        self.doing[hand.index()].held
    }

    /// Takes what happened so far.
    pub(crate) fn into_touches(self) -> Vec<Touch> {
        self.touches
    }

    /// Follows the hands through one frame; call after the input was read. Gives how far the user walks in the time
    /// `step`, in world coordinates.
    pub(crate) fn follow(
        &mut self,
        client: &mut Client,
        world_from_local: &Rigid,
        head: Option<&Rigid>,
        frame: u64,
        step: Span,
    ) -> Result<Vector3<f64>, Error> {
        let mut walked = Vector3::zeros();
        for hand in Hand::BOTH {
            self.follow_hand(client, world_from_local, head, hand, frame)?;
            walked += self.walk(client, world_from_local, head, hand, step);
        }
        Ok(walked)
    }

    fn follow_hand(
        &mut self,
        client: &mut Client,
        world_from_local: &Rigid,
        head: Option<&Rigid>,
        hand: Hand,
        frame: u64,
    ) -> Result<(), Error> {
        let doing = self.doing[hand.index()];
        let local_from_aim = match client.reading(self.actions.aim, hand) {
            Some(Reading::Pose(pose)) => pose.reference_from_device(),
            _ => None,
        };
        let pull = self.pull(client, hand);
        let mut stillness = doing.stillness;
        stillness.follow(local_from_aim.as_ref(), head, pull);
        let world_from_aim = local_from_aim.filter(|_| stillness.is_over).map(|aim| world_from_local * aim);
        let hit = world_from_aim.as_ref().and_then(|aim| self.targets.hit(&ray_along(aim)));
        let (pointed, distance_m) = hit.unzip();
        let held = match doing.held {
            Some(held) if pull > RELEASE => Some(held),
            Some(_) => None,
            None if pull > TAKE => pointed,
            None => None,
        };
        if pointed != doing.pointed
            && let Some(target) = pointed
        {
            self.happened(
                client,
                hand,
                frame,
                "pointed",
                target,
                &Haptic { amplitude: 0.2, ..Haptic::TICK },
            )?;
        }
        match (doing.held, held) {
            (None, Some(target)) => self.happened(client, hand, frame, "taken", target, &Haptic::TICK)?,
            (Some(target), None) => self.happened(client, hand, frame, "released", target, &Haptic::TICK)?,
            _ => {}
        }
        self.doing[hand.index()] = Doing { pointed, held, world_from_aim, distance_m, stillness };
        Ok(())
    }

    /// The stronger of trigger and squeeze, 0…1.
    fn pull(&self, client: &Client, hand: Hand) -> f32 {
        let of = |action: Option<usize>| match action.and_then(|action| client.reading(action, hand)) {
            Some(Reading::Button(Button(Some(true)))) => 1.0,
            Some(Reading::Axis(axis @ Axis(_))) => axis.or_zero(),
            _ => 0.0,
        };
        of(self.actions.select).max(of(self.actions.grab))
    }

    fn happened(
        &mut self,
        client: &mut Client,
        hand: Hand,
        frame: u64,
        what: &'static str,
        target: usize,
        haptic: &Haptic,
    ) -> Result<(), Error> {
        let name = self.targets.name(target);
        log::info!("frame {frame}: {hand} hand {what} {name}");
        if self.touches.len() < KEPT {
            self.touches.push(Touch { frame, hand: hand.name(), what, name: name.to_owned() });
        }
        match self.actions.pulse {
            Some(pulse) => client.pulse(pulse, hand, haptic),
            None => Ok(()),
        }
    }

    /// Along the level part of the direction in which the head looks.
    fn walk(
        &self,
        client: &Client,
        world_from_local: &Rigid,
        head: Option<&Rigid>,
        hand: Hand,
        step: Span,
    ) -> Vector3<f64> {
        let stick = match self.actions.walk.and_then(|walk| client.reading(walk, hand)) {
            Some(Reading::Vector2(stick)) => self.dead_zone.apply(stick.or_zero()),
            _ => [0.0; 2],
        };
        let Some(head) = head.filter(|_| stick != [0.0; 2]) else { return Vector3::zeros() };
        let level = |direction: Vector3<f64>| {
            let world = world_from_local.rotation * (head.rotation * direction);
            Vector3::new(world.x, 0.0, world.z).try_normalize(1e-6).unwrap_or_else(Vector3::zeros)
        };
        let [right, ahead] = stick.map(f64::from);
        (level(Vector3::x()) * right + level(-Vector3::z()) * ahead) * (WALK_M_S * step.as_secs_f64())
    }
}

/// The session time that a frame shown at `display` adds to the one before, `last`: one `period` where there is none, more
/// where frames were missed, and never longer than [`LONGEST_STEP`].
pub(crate) fn step(last: Option<Timestamp>, display: Timestamp, period: Span) -> Span {
    let passed = last.and_then(|last| display.since(last)).unwrap_or(period);
    passed.clamp(Span::ZERO, LONGEST_STEP)
}

fn ray_along(world_from_aim: &Rigid) -> Ray {
    Ray {
        origin: Point3::from(world_from_aim.translation.vector),
        direction: world_from_aim.rotation * -Vector3::z_axis(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether a hand means something after it went `by`, with a head that turned by so much.
    fn means(by: f64, head_rad: f64, is_carried: bool, pull: f32) -> bool {
        let mut stillness = Stillness::default();
        let ahead = Rigid::translation(0.2, -0.3, -0.4);
        let turn = Rigid::rotation(Vector3::y() * head_rad);
        let carrier = if is_carried { turn } else { Rigid::identity() };
        stillness.follow(Some(&ahead), Some(&Rigid::identity()), 0.0);
        let now = carrier * Rigid::translation(by, 0.0, 0.0) * ahead;
        stillness.follow(Some(&now), Some(&turn), pull);
        stillness.is_over
    }

    #[test]
    fn who_walks_goes_as_far_as_time_does() {
        let at = |ms: i64| Timestamp::from_nanos(ms * 1_000_000);
        let period = Span::from_millis(10);
        let after = |last: Option<i64>, now| step(last.map(at), at(now), period);
        assert_eq!(after(None, 50), period);
        assert_eq!(after(Some(40), 50), period);
        assert_eq!(after(Some(20), 50), Span::from_millis(30), "two frames were missed");
        assert_eq!(after(Some(0), 5000), LONGEST_STEP, "the headset lay on the table");
        assert_eq!(after(Some(60), 50), Span::ZERO, "time does not go back");
    }

    #[test]
    fn a_hand_that_lies_still_or_is_carried_along_means_nothing() {
        assert!(!means(0.0, 0.0, false, 0.0));
        assert!(!means(0.01, 0.5, false, 0.0), "trembles on the table while the user looks around");
        assert!(!means(0.01, 0.5, true, 0.0), "is held before the user who turns");
        assert!(means(0.1, 0.0, false, 0.0), "is moved");
        assert!(means(0.0, 0.0, false, 0.1), "is pulled");
    }
}
