//! The motors of a gamepad, through gilrs' force feedback.
//!
//! A gilrs of its own: from the first [`Rumble`] of a process to its end, gilrs writes to every pad that has motors, every 50 ms,
//! whether they turn or not, and its thread cannot be ended. Who only reads pads is spared that.

use std::collections::BTreeMap;
use std::fs::OpenOptions;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use gilrs::ff::{BaseEffect, BaseEffectType, Effect, EffectBuilder, Repeat, Replay, Ticks};
use gilrs::{GamepadId, Gilrs, GilrsBuilder, LinuxGamepadExt};
use vergence_time::Span;

use super::node::{NO_UDEV, gilrs_finds_pads, nodes, present};
use crate::error::Error;
use crate::found::Found;

/// Pads that come and go are seen this often.
const TURN: Duration = Duration::from_millis(50);
/// Nodes that came are left alone for so long: gilrs asks a pad for its motors once, when it hears of it, and says nothing where that
/// fails, as it does while uinput has made the node and takes no effects yet.
const SETTLE: Duration = Duration::from_millis(300);
/// gilrs hears of a pad that was just plugged in after less than this.
const PATIENCE: Duration = Duration::from_millis(2000);
/// A pad that is used is not waited for.
const MOST_EVENTS: usize = 1024;
/// gilrs counts time in these.
const TICK_MS: u32 = 50;
/// As long as the kernel can say.
const LONGEST_MS: f64 = 32_767.0;

type Job = Box<dyn FnOnce(&mut Motors) + Send>;

/// The motors of a gamepad. They stand still when it is dropped.
pub struct Rumble {
    device: Found,
    /// Of its effect.
    number: u64,
}

impl Rumble {
    /// Of the pad `device`.
    ///
    /// # Errors
    /// Where it is gone, may not be opened for writing, or has no motors, and where gilrs cannot find it.
    pub fn open(device: &Found) -> Result<Self, Error> {
        still_there(device)?;
        OpenOptions::new().write(true).open(&device.path).map_err(|error| Error::open(device, error))?;
        if !gilrs_finds_pads() {
            return Err(Error::open(device, NO_UDEV));
        }
        let path = device.path.clone();
        let (number, has_motors) = ask(move |motors| {
            motors.last += 1;
            let id = motors.find(&path);
            let pad = id.and_then(|id| motors.gilrs.as_ref()?.connected_gamepad(id));
            (motors.last, pad.map(|pad| pad.is_ff_supported()))
        })
        .ok_or_else(|| Error::open(device, "gilrs does not answer"))?;
        match has_motors {
            Some(true) => Ok(Self { device: device.clone(), number }),
            Some(false) => Err(Error::open(device, "it has no motors")),
            None => Err(Error::open(device, "gilrs does not list it")),
        }
    }

    /// Shakes for `length` (at most 32.767 s, in steps of 50 ms) with shares, 0 to 1, of what the slow strong motor and the fast
    /// weak one can do. It begins within two of those steps.
    ///
    /// # Errors
    /// Where the pad is gone.
    pub fn play(&mut self, strong: f64, weak: f64, length: Span) -> Result<(), Error> {
        still_there(&self.device)?;
        let (effects, ticks) = parts(strong, weak, length);
        let (path, number) = (self.device.path.clone(), self.number);
        let played = ask(move |motors| {
            // What was played before ends, or the two would add up.
            motors.effects.remove(&number);
            let id = motors.find(&path)?;
            let gilrs = motors.gilrs.as_mut()?;
            let mut builder = EffectBuilder::new();
            effects.into_iter().for_each(|effect| {
                builder.add_effect(effect);
            });
            let effect = builder.gamepads(&[id]).repeat(Repeat::For(ticks)).finish(gilrs).ok()?;
            effect.play().ok()?;
            motors.effects.insert(number, effect);
            Some(())
        });
        played.flatten().ok_or_else(|| Error::Gone { device: self.device.name.clone() })
    }

    /// Stands still.
    ///
    /// # Errors
    /// Where the pad is gone.
    pub fn stop(&mut self) -> Result<(), Error> {
        still_there(&self.device)?;
        let number = self.number;
        ask(move |motors| motors.effects.remove(&number).map(drop))
            .map(drop)
            .ok_or_else(|| Error::Gone { device: self.device.name.clone() })
    }
}

impl Drop for Rumble {
    fn drop(&mut self) {
        let number = self.number;
        let _ = ask(move |motors| motors.effects.remove(&number).map(drop));
    }
}

/// gilrs hears of a loss only a while later, and plays to nobody until then: the kernel knows.
fn still_there(device: &Found) -> Result<(), Error> {
    let is_there =
        nodes().iter().any(|node| node.found.path == device.path && node.found.is_same_device(device));
    if is_there { Ok(()) } else { Err(Error::Gone { device: device.name.clone() }) }
}

fn parts(strong: f64, weak: f64, length: Span) -> ([BaseEffect; 2], Ticks) {
    // NaN becomes 0.
    let magnitude = |share: f64| (share.clamp(0.0, 1.0) * f64::from(u16::MAX)).round() as u16;
    let ticks = Ticks::from_ms(length.as_millis_f64().clamp(0.0, LONGEST_MS).ceil() as u32);
    // Behind its end the effect would begin again for one tick, but for the delay.
    let scheduling = Replay { play_for: ticks, with_delay: Ticks::from_ms(4 * TICK_MS), ..Replay::default() };
    let effect = |kind| BaseEffect { kind, scheduling, ..BaseEffect::default() };
    let strong = BaseEffectType::Strong { magnitude: magnitude(strong) };
    ([effect(strong), effect(BaseEffectType::Weak { magnitude: magnitude(weak) })], ticks)
}

/// gilrs with force feedback, and what it plays.
#[derive(Default)]
struct Motors {
    gilrs: Option<Gilrs>,
    effects: BTreeMap<u64, Effect>,
    last: u64,
    /// The nodes that there are, and since when these.
    present: BTreeMap<String, PathBuf>,
    since: Option<Instant>,
}

static MOTORS: Mutex<Option<Sender<Job>>> = Mutex::new(None);

/// What `job` finds on the thread of the motors; `None` where there is no such thread.
fn ask<T: Send + 'static>(job: impl FnOnce(&mut Motors) -> T + Send + 'static) -> Option<T> {
    let (answer, answered) = channel();
    let job: Job = Box::new(move |motors| {
        let _ = answer.send(job(motors));
    });
    {
        let mut motors = MOTORS.lock().unwrap_or_else(PoisonError::into_inner);
        if motors.is_none() {
            let (sender, jobs) = channel();
            std::thread::Builder::new().name("motors".to_owned()).spawn(move || run(&jobs)).ok()?;
            *motors = Some(sender);
        }
        motors.as_ref()?.send(job).ok()?;
    }
    answered.recv().ok()
}

fn run(jobs: &Receiver<Job>) {
    let mut motors = Motors::default();
    motors.build();
    loop {
        match jobs.recv_timeout(TURN) {
            Ok(job) => job(&mut motors),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
        motors.follow();
    }
}

impl Motors {
    /// Whether no node has come or gone for a while.
    fn is_settled(&mut self) -> bool {
        let present = present();
        if present != self.present {
            self.present = present;
            self.since = None;
        }
        self.since.get_or_insert_with(Instant::now).elapsed() >= SETTLE
    }

    fn build(&mut self) {
        while !self.is_settled() {
            std::thread::sleep(TURN);
        }
        self.effects.clear();
        self.gilrs = None;
        let builder = GilrsBuilder::new()
            .with_default_filters(false)
            .add_included_mappings(false)
            .add_env_mappings(false);
        match builder.build() {
            Ok(gilrs) => self.gilrs = Some(gilrs),
            Err(error) => log::warn!("motors: gilrs: {error}"),
        }
    }

    /// Lets gilrs hear who came and went; whether it is time for that.
    fn follow(&mut self) -> bool {
        if !self.is_settled() {
            return false;
        }
        for _ in 0..MOST_EVENTS {
            if self.gilrs.as_mut().is_none_or(|gilrs| gilrs.next_event().is_none()) {
                break;
            }
        }
        true
    }

    fn listed(&self, path: &str) -> Option<GamepadId> {
        let mut pads = self.gilrs.as_ref()?.gamepads();
        pads.find(|(_, pad)| pad.devpath().as_os_str() == path).map(|(id, _)| id)
    }

    /// gilrs' number of the pad at this node. It is made anew where it has not heard of it.
    fn find(&mut self, path: &str) -> Option<GamepadId> {
        let start = Instant::now();
        loop {
            // What is listed before may be a pad that is gone, whose node another one has now.
            let listed = if self.follow() { self.listed(path) } else { None };
            if listed.is_some() {
                return listed;
            }
            if start.elapsed() > PATIENCE {
                break;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        self.build();
        self.listed(path)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_become_numbers_within_their_range() {
        let ([strong, weak], ticks) = parts(2.0, f64::NAN, Span::from_millis(7));
        assert_eq!(strong.kind, BaseEffectType::Strong { magnitude: u16::MAX });
        assert_eq!(weak.kind, BaseEffectType::Weak { magnitude: 0 });
        assert_eq!(ticks, Ticks::from_ms(50));
        assert_eq!(parts(0.0, 0.0, Span::from_millis(1 << 40)).1, Ticks::from_ms(32_767));
    }

    #[test]
    fn a_pad_that_is_not_there_is_an_error() {
        let found = Found::new("gamepad", "/dev/input/event9999".to_owned());
        assert!(matches!(Rumble::open(&found), Err(Error::Gone { .. })));
    }
}
