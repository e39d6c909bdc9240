//! What the hands do in the scene: pointing, taking, walking.

use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use vergence_action::DeadZone;
use vergence_geom::{Ray, Rigid};
use vergence_scene::Scene;
use vergence_sense::{Axis, Button, Hand, Haptic, Pose};
use vergence_time::Span;
use vergence_xr::{Client, Error, Reading};

use crate::report::Touch;
use crate::targets::Targets;

/// Touches that are kept for the report.
const KEPT: usize = 1000;
/// How far a grab or trigger must be pulled to take something …
const TAKE: f32 = 0.6;
/// … and let go to release it: apart, so that a trembling finger does neither.
const RELEASE: f32 = 0.4;
/// Speed of walking by thumbstick, metres per second.
const WALK_M_S: f64 = 1.5;

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

    /// Takes what happened so far.
    pub(crate) fn into_touches(self) -> Vec<Touch> {
        self.touches
    }

    /// Follows the hands through one frame; call after the input was read. Gives how far the user walks, in world
    /// coordinates.
    pub(crate) fn follow(
        &mut self,
        client: &mut Client,
        world_from_local: &Rigid,
        head: Option<&Rigid>,
        frame: u64,
        period: Span,
    ) -> Result<Vector3<f64>, Error> {
        let mut walked = Vector3::zeros();
        for hand in Hand::BOTH {
            self.follow_hand(client, world_from_local, hand, frame)?;
            walked += self.walk(client, world_from_local, head, hand, period);
        }
        Ok(walked)
    }

    fn follow_hand(
        &mut self,
        client: &mut Client,
        world_from_local: &Rigid,
        hand: Hand,
        frame: u64,
    ) -> Result<(), Error> {
        let doing = self.doing[hand.index()];
        let ray = match client.reading(self.actions.aim, hand) {
            Some(Reading::Pose(pose)) => ray_of(world_from_local, &pose),
            _ => None,
        };
        let pointed = ray.and_then(|ray| self.targets.hit(&ray));
        let pull = self.pull(client, hand);
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
            (None, Some(target)) => self.happened(client, hand, frame, "grabbed", target, &Haptic::TICK)?,
            (Some(target), None) => self.happened(client, hand, frame, "released", target, &Haptic::TICK)?,
            _ => {}
        }
        self.doing[hand.index()] = Doing { pointed, held };
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
        period: Span,
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
        (level(Vector3::x()) * right + level(-Vector3::z()) * ahead) * (WALK_M_S * period.as_secs_f64())
    }
}

fn ray_of(world_from_local: &Rigid, aim: &Pose) -> Option<Ray> {
    let world_from_aim = world_from_local * aim.reference_from_device()?;
    Some(Ray {
        origin: Point3::from(world_from_aim.translation.vector),
        direction: world_from_aim.rotation * -Vector3::z_axis(),
    })
}
