//! The window of a run: it mirrors what the eyes see, and where the headset is simulated, mouse and keys move its user.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use nalgebra::{UnitQuaternion, Vector3};
use vergence_geom::Rigid;
use vergence_gpu as gpu;
use vergence_time::Timestamp;
use vergence_window::{Event, PointerButton, Window};
use vergence_xr_sim::{Controller, Hand, PoseProvider, Tracked};

use crate::error::Error;

/// Size of the window at the start, pixels: two eyes side by side.
const SIZE: (u32, u32) = (1280, 640);
/// Turning by the mouse, radians per count.
const TURN_RAD: f64 = 0.003;
/// Moving by keys, metres per second; three times as fast with Shift.
const MOVE_M_S: f64 = 1.4;
/// A finger rests on the trigger: what the eyes rest on is pointed at before anything was taken.
const RESTING: f32 = 0.1;
/// Looking up and down ends short of the poles.
const STEEPEST_RAD: f64 = 1.5;
/// A pause longer than this (a window being dragged) moves nobody further, seconds.
const LONGEST_STEP_S: f64 = 0.1;

/// What the keys and the mouse do now, and where that has led.
#[derive(Debug)]
struct Explorer {
    position_m: Vector3<f64>,
    yaw_rad: f64,
    pitch_rad: f64,
    trigger: bool,
}

impl Explorer {
    fn stage_from_head(&self) -> Rigid {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), self.yaw_rad)
            * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), self.pitch_rad);
        Rigid::from_parts(self.position_m.into(), turn)
    }
}

/// The simulated user whom mouse and keys move. Answers with where they are now, whatever instant is asked for.
#[derive(Clone, Debug)]
pub(crate) struct ByHand(Arc<Mutex<Explorer>>);

impl Default for ByHand {
    fn default() -> Self {
        Self(Arc::new(Mutex::new(Explorer {
            position_m: Vector3::new(0.0, 1.6, 0.0),
            yaw_rad: 0.0,
            pitch_rad: 0.0,
            trigger: false,
        })))
    }
}

impl ByHand {
    fn with<R>(&self, look: impl FnOnce(&mut Explorer) -> R) -> R {
        look(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl PoseProvider for ByHand {
    fn head(&self, _at: Timestamp) -> Tracked {
        self.with(|explorer| Tracked::Seen(explorer.stage_from_head()))
    }

    /// The right hand points where the eyes look; its trigger is the right mouse button or the space bar.
    fn controller(&self, hand: Hand, _at: Timestamp) -> Controller {
        self.with(|explorer| {
            let head = explorer.stage_from_head();
            let side = if hand == Hand::Left { -1.0 } else { 1.0 };
            let grip = Tracked::Seen(head * Rigid::translation(0.2 * side, -0.35, -0.4));
            match hand {
                // It does nothing, so it points at nothing.
                Hand::Left => Controller::idle(grip, Tracked::Lost),
                Hand::Right => Controller {
                    trigger: if explorer.trigger { 1.0 } else { RESTING },
                    ..Controller::idle(grip, Tracked::Seen(head))
                },
            }
        })
    }
}

/// Which of the keys that matter are down.
#[derive(Clone, Copy, Debug, Default)]
struct Keys {
    right: f64,
    left: f64,
    up: f64,
    down: f64,
    ahead: f64,
    back: f64,
    fast: bool,
}

impl Keys {
    fn set(&mut self, key: &str, pressed: bool) {
        let amount = if pressed { 1.0 } else { 0.0 };
        match key {
            "KeyD" | "ArrowRight" => self.right = amount,
            "KeyA" | "ArrowLeft" => self.left = amount,
            "KeyE" | "PageUp" => self.up = amount,
            "KeyQ" | "PageDown" => self.down = amount,
            "KeyW" | "ArrowUp" => self.ahead = amount,
            "KeyS" | "ArrowDown" => self.back = amount,
            "ShiftLeft" | "ShiftRight" => self.fast = pressed,
            _ => {}
        }
    }

    /// x right, y up, z back.
    fn direction(&self) -> Vector3<f64> {
        let direction = Vector3::new(self.right - self.left, self.up - self.down, self.back - self.ahead);
        direction * if self.fast { 3.0 } else { 1.0 }
    }
}

/// The window, and what is done in it.
pub(crate) struct Desk {
    window: Window,
    mirror: Option<gpu::Mirror>,
    user: ByHand,
    keys: Keys,
    looking: bool,
    last_step: Instant,
    closed: bool,
}

impl Desk {
    /// Opens the window.
    pub(crate) fn open() -> Result<Self, Error> {
        Ok(Self {
            window: Window::open("Vergence", SIZE)?,
            mirror: None,
            user: ByHand::default(),
            keys: Keys::default(),
            looking: false,
            last_step: Instant::now(),
            closed: false,
        })
    }

    /// The display for the Vulkan instance.
    pub(crate) fn display(&self) -> Option<raw_window_handle::RawDisplayHandle> {
        self.window.display()
    }

    /// Whom mouse and keys move.
    pub(crate) fn user(&self) -> ByHand {
        self.user.clone()
    }

    /// Mirrors what this device draws from now on.
    pub(crate) fn attach(&mut self, device: &Arc<gpu::Device>) -> Result<(), Error> {
        self.mirror = Some(gpu::Mirror::new(device, self.window.handle(), self.window.size())?);
        Ok(())
    }

    /// Lets go of the device; before the device goes.
    pub(crate) fn detach(&mut self) {
        self.mirror = None;
    }

    /// Follows mouse and keys. Whether the user wants the run to end.
    pub(crate) fn follow(&mut self) -> bool {
        let Self { window, mirror, user, keys, looking, closed, .. } = self;
        window.poll(|event| match event {
            Event::CloseRequested => *closed = true,
            Event::Resized { width, height } => {
                if let Some(mirror) = mirror {
                    mirror.resize((width, height));
                }
            }
            Event::Focused(false) => (*keys, *looking) = (Keys::default(), false),
            Event::Key { key, pressed, .. } => match key.as_str() {
                "Escape" => *closed |= pressed,
                "Space" => user.with(|user| user.trigger = pressed),
                key => keys.set(key, pressed),
            },
            Event::Button { button: PointerButton::Left, pressed } => *looking = pressed,
            Event::Button { button: PointerButton::Right, pressed } => {
                user.with(|user| user.trigger = pressed)
            }
            Event::PointerMoved { dx, dy } if *looking => user.with(|user| {
                // The scene is dragged: to the right means to look to the left.
                user.yaw_rad = (user.yaw_rad + dx * TURN_RAD) % std::f64::consts::TAU;
                user.pitch_rad = (user.pitch_rad + dy * TURN_RAD).clamp(-STEEPEST_RAD, STEEPEST_RAD);
            }),
            _ => {}
        });
        let step_s = self.last_step.elapsed().as_secs_f64().min(LONGEST_STEP_S);
        self.last_step = Instant::now();
        let direction = self.keys.direction();
        self.user.with(|user| {
            let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), user.yaw_rad);
            user.position_m += turn * direction * (MOVE_M_S * step_s);
        });
        self.closed
    }

    /// Shows what was drawn; where the window is not ready, the headset does not wait for it.
    pub(crate) fn show(&mut self, image: &Arc<gpu::Image>, views: u32) -> Result<(), Error> {
        if let Some(mirror) = &mut self.mirror {
            mirror.present(image, views, gpu::Use::ColorAttachment)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_right_hand_points_where_the_eyes_look() {
        let user = ByHand::default();
        user.with(|u| (u.yaw_rad, u.pitch_rad, u.trigger) = (0.5, -0.2, true));
        let at = Timestamp::from_nanos(0);
        let right = user.controller(Hand::Right, at);
        assert_eq!((right.aim, right.trigger), (user.head(at), 1.0));
        let ahead = user.head(at).pose().unwrap().rotation * -Vector3::z();
        assert!(ahead.x < 0.0 && ahead.y < 0.0, "left and down: {ahead}");
    }

    #[test]
    fn opposite_keys_cancel_and_letting_go_stops() {
        let mut keys = Keys::default();
        keys.set("KeyW", true);
        keys.set("ArrowDown", true);
        assert_eq!(keys.direction(), Vector3::zeros());
        keys.set("ArrowDown", false);
        keys.set("ShiftLeft", true);
        assert_eq!(keys.direction(), Vector3::new(0.0, 0.0, -3.0));
        keys.set("KeyW", false);
        assert_eq!(keys.direction(), Vector3::zeros());
    }
}
