//! What an embedding program says about the headset before it creates an instance, and what it can do meanwhile.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex, PoisonError};

use vergence_geom::{Rigid, View};
use vergence_time::{Span, Timestamp};

use crate::fault::FaultPlan;
use crate::headset::Profile;
use crate::motion::{Hand, PoseProvider, Presence, Still};

/// What the clock reads at first. Not 0, which OpenXR does not take for a time.
pub(crate) const EPOCH: Timestamp = Timestamp::from_nanos(1_000_000_000);

/// How time passes for the session.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ClockMode {
    /// Frames are exactly one display period apart, however long they take: faster than real time where the
    /// application is, without a dropped frame where it is slower. Nothing sleeps.
    #[default]
    Virtual,
    /// `xrWaitFrame` waits for the wall clock; a late application skips periods.
    RealTime,
}

/// The simulated headset, its user and its clock.
pub struct Config {
    /// What headset it is.
    pub profile: Profile,
    /// What moves it.
    pub motion: Box<dyn PoseProvider>,
    /// How time passes.
    pub clock: ClockMode,
    /// What the clock reads when an instance is created; after 0. A program that connects anew after a loss names a later
    /// instant than before, so that its session time runs on.
    pub begins: Timestamp,
    /// After so many frames with `shouldRender` the runtime asks the application to end; `None`: never.
    pub frames: Option<u64>,
    /// Who gets the composed pictures; `None`: nothing is composed.
    pub capture: Option<Capture>,
    /// Whether applications are asked to render at all (`shouldRender`); `false` runs everything but the pictures.
    pub render: bool,
    /// A hand on the headset, for whoever embeds the runtime.
    pub control: Control,
    /// What the runtime does wrong.
    pub faults: FaultPlan,
}

impl Default for Config {
    /// The headset `default`, standing still, on a virtual clock that begins at 1 s, without end, without pictures.
    fn default() -> Self {
        Self {
            profile: Profile::default(),
            motion: Box::new(Still::default()),
            clock: ClockMode::Virtual,
            begins: EPOCH,
            frames: None,
            capture: None,
            render: true,
            control: Control::default(),
            faults: FaultPlan::default(),
        }
    }
}

static PROCESS: Mutex<Option<Arc<Config>>> = Mutex::new(None);

thread_local! {
    static CONFIGURED: RefCell<Option<Arc<Config>>> = const { RefCell::new(None) };
}

/// The runtime, as the program that embeds it sees it.
#[derive(Debug)]
pub struct Runtime;

impl Runtime {
    /// Sets what every OpenXR instance is that *this thread* creates from now on. (OpenXR has no argument for it;
    /// per thread, so that sessions in several threads do not meet.)
    pub fn configure(config: Config) {
        CONFIGURED.set(Some(Arc::new(config)));
    }

    /// Sets what every OpenXR instance is that is created from now on by a thread for which nothing else
    /// [is set](Self::configure): where the runtime is a library, whoever creates instances knows nothing of it.
    pub fn configure_process(config: Config) {
        *PROCESS.lock().unwrap_or_else(PoisonError::into_inner) = Some(Arc::new(config));
    }

    pub(crate) fn configured() -> Arc<Config> {
        let of_process = || PROCESS.lock().unwrap_or_else(PoisonError::into_inner).clone();
        CONFIGURED.with_borrow(Clone::clone).or_else(of_process).unwrap_or_else(|| {
            CONFIGURED.with_borrow_mut(|own| own.get_or_insert_with(Default::default).clone())
        })
    }
}

/// Receives each composed stereo picture, on the thread that called `xrEndFrame`.
#[derive(Clone)]
pub struct Capture(Arc<dyn Fn(ComposedFrame) + Send + Sync>);

impl Capture {
    /// Hands every frame to `receive`; the application's `xrEndFrame` returns when that does.
    pub fn new(receive: impl Fn(ComposedFrame) + Send + Sync + 'static) -> Self {
        Self(Arc::new(receive))
    }

    /// Queues every frame. The queue is not bounded: for tests and short runs.
    pub fn channel() -> (Self, Receiver<ComposedFrame>) {
        let (send, receive) = channel();
        // A receiver that was dropped wants no more pictures.
        let send = Mutex::new(send);
        let capture = Self::new(move |frame| {
            let _ = send.lock().unwrap_or_else(PoisonError::into_inner).send(frame);
        });
        (capture, receive)
    }

    pub(crate) fn give(&self, frame: ComposedFrame) {
        (self.0)(frame);
    }
}

/// What the user saw in one frame.
#[derive(Clone, Debug)]
pub struct ComposedFrame {
    /// Counted from 0, over the frames that were composed.
    pub number: u64,
    /// When it was on the display, session time.
    pub display_time: Timestamp,
    /// Pixels of one eye: width, height.
    pub size: (u32, u32),
    /// Where the head truly was at the display time: head coordinates to stage coordinates.
    pub stage_from_head: Rigid,
    /// The same in the space LOCAL: head coordinates to local coordinates.
    pub local_from_head: Rigid,
    /// The left eye, then the right one.
    pub eyes: [ComposedEye; 2],
}

/// What one eye saw.
#[derive(Clone, Debug)]
pub struct ComposedEye {
    /// Where the eye truly was, in the space LOCAL, and what it sees.
    pub view_in_local: View,
    /// RGBA, 8 bits each, sRGB encoded, rows from the top.
    pub rgba: Vec<u8>,
}

/// A vibration that an application asked for, or its end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Haptic {
    /// When `xrApplyHapticFeedback` or `xrStopHapticFeedback` was called, session time.
    pub at: Timestamp,
    /// Which controller.
    pub hand: Hand,
    /// Nanoseconds; `None` for the shortest that there is.
    pub duration: Option<Span>,
    /// In hertz; 0 where the runtime may choose.
    pub frequency_hz: f32,
    /// 0 (which ends a vibration) … 1.
    pub amplitude: f32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Command {
    Recentre,
    Exit,
    LoseSession,
    LoseInstance,
    Presence(Presence),
    HiddenArea(bool),
}

/// Vibrations that are kept: an application that vibrates in every frame for hours takes no more memory than this.
const HAPTICS_KEPT: usize = 4096;

#[derive(Debug, Default)]
struct Desk {
    commands: VecDeque<Command>,
    haptics: VecDeque<Haptic>,
}

/// A hand on the simulated headset: what a person, the system or a cable can do to a real one. Clones are the same
/// hand. Commands take effect at the next `xrPollEvent` or `xrWaitFrame`.
#[derive(Clone, Debug, Default)]
pub struct Control(Arc<Mutex<Desk>>);

impl Control {
    fn push(&self, command: Command) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).commands.push_back(command);
    }

    pub(crate) fn take(&self) -> Option<Command> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).commands.pop_front()
    }

    pub(crate) fn record(&self, haptic: Haptic) {
        let haptics = &mut self.0.lock().unwrap_or_else(PoisonError::into_inner).haptics;
        if haptics.len() >= HAPTICS_KEPT {
            haptics.pop_front();
        }
        haptics.push_back(haptic);
    }

    /// Makes where the head is now, and where it looks, the new origin of LOCAL.
    pub fn recentre(&self) {
        self.push(Command::Recentre);
    }

    /// The system asks the application to end.
    pub fn ask_to_exit(&self) {
        self.push(Command::Exit);
    }

    /// Every call with the session fails from now on with `XR_ERROR_SESSION_LOST`.
    pub fn lose_session(&self) {
        self.push(Command::LoseSession);
    }

    /// Announces that the instance will be lost; once the application has polled that event, every call with the instance
    /// fails with `XR_ERROR_INSTANCE_LOST`.
    pub fn lose_instance(&self) {
        self.push(Command::LoseInstance);
    }

    /// The headset is put on, covered by a menu, or taken off.
    pub fn set_presence(&self, presence: Presence) {
        self.push(Command::Presence(presence));
    }

    /// Whether the lenses hide what the profile says (at first they do), or nothing; the application is told that it changed.
    pub fn set_hidden_area(&self, hides: bool) {
        self.push(Command::HiddenArea(hides));
    }

    /// The vibrations so far, in the order of the calls; the last 4096.
    pub fn haptics(&self) -> Vec<Haptic> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).haptics.iter().copied().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_vibrations_are_kept() {
        let control = Control::default();
        let each = |nanos| Haptic {
            at: Timestamp::from_nanos(nanos),
            hand: Hand::Left,
            duration: None,
            frequency_hz: 0.0,
            amplitude: 1.0,
        };
        (0..5000).for_each(|nanos| control.record(each(nanos)));
        assert!(control.haptics().into_iter().eq((5000 - 4096..5000).map(each)));
    }
}
