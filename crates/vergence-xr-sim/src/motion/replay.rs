use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use vergence_geom::Rigid;
use vergence_sense::{Body, ControlState, Event, Hand, RawLocation, RawViews, Said, Tracking};
use vergence_time::{Span, Timestamp};

use super::{Controller, PoseProvider, Tracked, held_in_front};

/// Marks, among the events of a recording, where a session begins.
pub const SESSION_BEGINS: &str = "session_begins";
/// Marks, among the events of a recording, where the application asked for the end.
pub const EXIT_REQUESTED: &str = "exit_requested";

/// A recorded session that the runtime says again: its events, its frames, and for each call of a frame the answer that was
/// given, bit for bit, in the order in which calls of that kind were made. What was not asked in the recording is answered
/// as by any other motion.
///
/// Clones are the same replay: a session that was lost in the recording goes on in the next one.
#[derive(Clone)]
pub struct Replay(Arc<Mutex<Inner>>);

struct Inner {
    frames: Box<dyn Iterator<Item = Vec<Said>> + Send>,
    actions: Vec<String>,
    speed: Option<f64>,
    /// When the first frame was waited for: host time, and when it is displayed.
    started: Option<(Instant, Timestamp)>,
    /// The frame that comes; empty after the last one.
    next: Vec<Said>,
    /// How many of its events were said.
    events_said: usize,
    current: Vec<Said>,
    /// Which of its answers were given.
    given: Vec<bool>,
    exhausted: bool,
}

/// What the runtime says of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SaidFrame {
    pub now: Timestamp,
    pub display: Timestamp,
    pub period: Span,
    pub should_render: bool,
}

/// What comes next in the recording.
pub(crate) enum Next {
    Event(Event),
    /// Frames until the next event.
    Frame,
    /// The session is over: another one follows.
    Lost,
    /// The recording is over.
    End,
}

impl std::fmt::Debug for Replay {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Replay")
    }
}

impl Replay {
    /// Says `frames` again, one list of what was said for each frame: its events, then [`Said::Frame`], then the answers.
    /// `actions` names the actions that places of actions count. `speed` is that of the host's clock: 1 as recorded, `None`
    /// as fast as it can.
    pub fn new(
        frames: impl Iterator<Item = Vec<Said>> + Send + 'static,
        actions: Vec<String>,
        speed: Option<f64>,
    ) -> Self {
        let mut frames: Box<dyn Iterator<Item = Vec<Said>> + Send> = Box::new(frames);
        let next = frames.next().unwrap_or_default();
        Self(Arc::new(Mutex::new(Inner {
            frames,
            actions,
            speed: speed.filter(|speed| *speed > 0.0 && speed.is_finite()),
            started: None,
            next,
            events_said: 0,
            current: Vec::new(),
            given: Vec::new(),
            exhausted: false,
        })))
    }

    /// Whether the application asked for the end here; said once.
    pub fn takes_exit_request(&self) -> bool {
        let inner = &mut *self.lock();
        let asked = matches!(inner.event(), Some(event) if event.name == EXIT_REQUESTED);
        inner.events_said += usize::from(asked);
        asked
    }

    /// Whether everything was said again.
    pub fn is_over(&self) -> bool {
        let inner = &mut *self.lock();
        inner.exhausted || (inner.event().is_none() && inner.frame().is_none())
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A session is made: what is left of the one before is passed over.
    pub(crate) fn begin_session(&self) {
        let inner = &mut *self.lock();
        (inner.current, inner.given) = (Vec::new(), Vec::new());
        loop {
            match inner.event() {
                Some(event) if event.name == SESSION_BEGINS => {
                    inner.events_said += 1;
                    return;
                }
                Some(_) => inner.events_said += 1,
                // No mark: a recording of one session, or its rest.
                None => return,
            }
        }
    }

    /// What comes next; an event is said once.
    pub(crate) fn next(&self) -> Next {
        let inner = &mut *self.lock();
        if inner.exhausted {
            return Next::End;
        }
        while let Some(event) = inner.event() {
            match &*event.name {
                SESSION_BEGINS => return Next::Lost,
                // These the application does by itself.
                EXIT_REQUESTED | "time_fault" | "time_rebased" => inner.events_said += 1,
                _ => {
                    let event = event.clone();
                    inner.events_said += 1;
                    return Next::Event(event);
                }
            }
        }
        if inner.frame().is_some() { Next::Frame } else { Next::End }
    }

    /// Nothing more is said from here on.
    pub(crate) fn exhaust(&self) {
        self.lock().exhausted = true;
    }

    pub(crate) fn is_exhausted(&self) -> bool {
        self.lock().exhausted
    }

    /// The frame that is waited for; waits as long as the speed asks for. `None` where there is none.
    pub(crate) fn wait(&self) -> Option<SaidFrame> {
        let inner = &mut *self.lock();
        let frame = inner.frame()?;
        inner.current = std::mem::replace(&mut inner.next, inner.frames.next().unwrap_or_default());
        inner.events_said = 0;
        inner.given.clear();
        inner.given.resize(inner.current.len(), false);
        if let Some(speed) = inner.speed {
            let (since, first) = *inner.started.get_or_insert((Instant::now(), frame.display));
            let passed = frame.display.since(first).unwrap_or(Span::ZERO).as_secs_f64() / speed;
            let due = Duration::try_from_secs_f64(passed).unwrap_or_default();
            std::thread::sleep(due.saturating_sub(since.elapsed()));
        }
        Some(frame)
    }

    /// The eyes at the instant `at`.
    pub(crate) fn views(&self, at: Timestamp) -> Option<RawViews> {
        self.lock().answer(|said| match said {
            Said::Views { at: when, views } if *when == at => Some(*views),
            _ => None,
        })
    }

    /// A body at the instant `at`.
    pub(crate) fn place(&self, body: Body, at: Timestamp) -> Option<RawLocation> {
        self.lock().answer(|said| match said {
            Said::Place { of, at: when, location } if *of == body && *when == at => Some(*location),
            _ => None,
        })
    }

    /// What a control read in this frame.
    pub(crate) fn control(&self, name: &str, of: Hand) -> Option<ControlState> {
        let inner = &mut *self.lock();
        let place = inner.action(name)?;
        inner.answer(|said| match said {
            Said::Control { action, hand, state, .. } if *action == place && *hand == of => Some(*state),
            _ => None,
        })
    }

    /// Whether a pose action was located in this frame.
    pub(crate) fn locates(&self, name: &str, hand: Hand) -> bool {
        let inner = self.lock();
        let place = inner.action(name);
        place.is_some_and(|place| {
            let wanted = Body::Action(place, hand);
            inner.current.iter().any(|said| matches!(said, Said::Place { of, .. } if *of == wanted))
        })
    }

    /// The place of an action in the recording.
    pub(crate) fn action(&self, name: &str) -> Option<u16> {
        self.lock().action(name)
    }
}

impl Inner {
    fn event(&self) -> Option<&Event> {
        match self.next.get(self.events_said)? {
            Said::Event(event) => Some(event),
            _ => None,
        }
    }

    fn frame(&self) -> Option<SaidFrame> {
        let ahead = self.next.get(self.events_said..)?;
        let another = |said: &Said| matches!(said, Said::Event(event) if event.name == SESSION_BEGINS);
        if ahead.iter().any(another) {
            return None;
        }
        ahead.iter().find_map(|said| match *said {
            Said::Frame { now, display, period, should_render } => {
                Some(SaidFrame { now, display, period, should_render })
            }
            _ => None,
        })
    }

    fn action(&self, name: &str) -> Option<u16> {
        let place = self.actions.iter().position(|action| action == name)?;
        u16::try_from(place).ok()
    }

    /// The first answer that was not given yet; where all were, the last one again.
    fn answer<T>(&mut self, pick: impl Fn(&Said) -> Option<T>) -> Option<T> {
        let mut last = None;
        for (said, given) in self.current.iter().zip(&mut self.given) {
            if let Some(found) = pick(said) {
                if !std::mem::replace(given, true) {
                    return Some(found);
                }
                last = Some(found);
            }
        }
        last
    }
}

/// As a motion, a replay stands on an assumed floor, LOCAL's origin at the height of the eyes: what pictures are composed
/// with. What was recorded is answered before anybody asks for this.
impl PoseProvider for Replay {
    fn head(&self, _at: Timestamp) -> Tracked {
        let stage_from_local = Rigid::translation(0.0, 1.6, 0.0);
        let head = self.lock().current.iter().find_map(|said| match said {
            Said::Place { of: Body::Head, location, .. } => Some(*location),
            _ => None,
        });
        let Some(head) = head.map(|location| location.read()) else { return Tracked::Lost };
        match head.reference_from_device() {
            Some(pose) if head.position_tracking == Tracking::Measured => {
                Tracked::Seen(stage_from_local * pose)
            }
            Some(pose) => Tracked::Held(stage_from_local * pose),
            None => Tracked::Lost,
        }
    }

    fn controller(&self, hand: Hand, at: Timestamp) -> Controller {
        held_in_front(&self.head(at), hand)
    }

    fn replay(&self) -> Option<&Replay> {
        Some(self)
    }
}
