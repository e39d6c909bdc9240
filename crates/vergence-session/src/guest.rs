//! Somebody who takes part in a run: is told every frame what the user does, and changes what is shown.

use std::sync::Arc;

use vergence_geom::{Affine, Ray, Rigid};
use vergence_render::Renderer;
use vergence_sense::{Button, Gaze, Hand, Haptic};
use vergence_time::{Span, Timestamp};
use vergence_xr::{Client, Reading};
use vergence_xr_sim::PoseProvider;

/// What the user does in one frame. Poses are in world coordinates; `None` where they are not known.
#[derive(Clone, Debug)]
pub struct Moment {
    /// For when all of it holds: when the frame is to be seen. Session time.
    pub display: Timestamp,
    /// The time between frames.
    pub period: Span,
    /// The point between the eyes, −z ahead.
    pub world_from_head: Option<Rigid>,
    /// Where the hands point from, −z ahead; left, right.
    pub world_from_aim: [Option<Rigid>; 2],
    /// The palms; left, right.
    pub world_from_grip: [Option<Rigid>; 2],
    /// Whether the triggers are pressed; left, right.
    pub selects: [bool; 2],
    /// Where the user looks, where that is read.
    pub gaze: Option<Ray>,
    /// The same as the runtime says it.
    pub told_gaze: Option<ToldGaze>,
}

/// A gaze, before it is placed in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToldGaze {
    /// In the runtime's LOCAL space: y up, −z ahead, its origin where the headset was when it was last recentred.
    pub in_local: Gaze,
    /// When it was measured, and when it was asked for, both on the runtime's clock; the first is to come where the runtime
    /// predicts. `None` where the runtime does not say it.
    pub times: Option<(Timestamp, Timestamp)>,
}

/// What the runtime of a session offers of what was asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Offered {
    /// Where the user looks.
    pub gaze: bool,
    /// The joints of the hands.
    pub hand_joints: bool,
}

/// What a guest may change, from this frame on.
pub struct Stage<'a> {
    pub(crate) renderer: &'a mut Renderer,
    pub(crate) client: &'a mut Client,
}

impl Stage<'_> {
    /// Shows a node of the scene, or does not.
    pub fn show(&mut self, node: usize, shown: bool) {
        self.renderer.show(node, shown);
    }

    /// Places a node of the scene in its parent. A session that is made anew begins with the scene as it is.
    pub fn place(&mut self, node: usize, parent_from_node: &Affine) {
        self.renderer.place(node, parent_from_node);
    }

    /// Lets a hand feel a tick, where it can.
    pub fn tick(&mut self, hand: Hand) {
        if let Some(pulse) = self.client.action("pulse")
            && let Err(error) = self.client.pulse(pulse, hand, &Haptic::TICK)
        {
            log::debug!("{error}");
        }
    }
}

/// Takes part in a run: a study, a game. The hands are read where there is a guest, also while the runtime wants no
/// picture; not while something else has the user's input.
pub trait Guest {
    /// Who wears the simulated headset, in place of the configured motion. Asked once.
    fn wearer(&mut self) -> Option<Arc<dyn PoseProvider>> {
        None
    }

    /// A session has begun; after a loss, another one.
    fn begins(&mut self, offered: Offered) {
        let _ = offered;
    }

    /// One frame. Whether the run goes on.
    fn follow(&mut self, now: &Moment, stage: &mut Stage<'_>) -> bool;
}

/// The moment as the client has read it.
pub(crate) fn moment(
    client: &Client,
    world_from_local: &Rigid,
    head: Option<&Rigid>,
    display: Timestamp,
    period: Span,
) -> Moment {
    let pose = |name: &str| {
        let action = client.action(name);
        Hand::BOTH.map(|hand| match action.and_then(|action| client.reading(action, hand)) {
            Some(Reading::Pose(pose)) => pose.reference_from_device().map(|device| world_from_local * device),
            _ => None,
        })
    };
    let select = client.action("select");
    let gaze = client.gaze();
    Moment {
        display,
        period,
        world_from_head: head.map(|head| world_from_local * head),
        world_from_aim: pose("aim"),
        world_from_grip: pose("grip"),
        selects: Hand::BOTH.map(|hand| {
            let read = select.and_then(|action| client.reading(action, hand));
            matches!(read, Some(Reading::Button(Button(Some(true)))))
        }),
        gaze: gaze.map(|gaze| Ray {
            origin: world_from_local * gaze.origin,
            direction: world_from_local.rotation * gaze.direction,
        }),
        told_gaze: gaze.map(|in_local| ToldGaze { in_local, times: client.gaze_sampled().zip(client.now()) }),
    }
}
