use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use openxr_sys as sys;
use vergence_geom::Rigid;
use vergence_sense::{
    Body, CallResult, ControlState, Event, Hand, RawJoints, RawLocation, RawViews, Said, Tracking,
};
use vergence_time::{Span, Timestamp};

use super::{Controller, PoseProvider, Tracked, held_in_front};
use crate::handle;
use crate::instance::Instance;

/// Marks, among the events of a recording, where a session begins.
pub const SESSION_BEGINS: &str = "session_begins";
/// Marks, among the events of a recording, where the application asked for the end.
pub const EXIT_REQUESTED: &str = "exit_requested";
/// Marks, among the events of a recording, where the run was over, and says how.
pub const RUN_ENDED: &str = "run_ended";
/// How the text of [`RUN_ENDED`] begins where the runtime did not answer any more, or gave no frames.
pub const HUNG: &str = "hung";
/// The call whose results stand among the events, where they came; those of other calls are found by their number.
const POLL: &str = "xrPollEvent";

/// Replays in this process: where there is none, a call asks for nothing more than this.
static REPLAYS: AtomicUsize = AtomicUsize::new(0);

/// What a recording says that a call returned, where that was not simply success. `of` is the handle that the call is about.
pub(crate) fn result_of(entry_point: &'static str, of: u64) -> Option<sys::Result> {
    if REPLAYS.load(Ordering::Relaxed) == 0 || of == 0 {
        return None;
    }
    let instance = handle::root::<Instance>(of)?;
    instance.config.motion.replay()?.result(entry_point)
}

/// A recorded session that the runtime says again: its events, its frames, for each call of a frame the answer that was
/// given, bit for bit, in the order in which calls of that kind were made, and for each call that failed how it did. What
/// was not asked in the recording is answered as by any other motion.
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
    /// The frame that was waited for last.
    current: Told,
    /// The frame that comes; empty after the last one.
    next: Told,
    /// The frame that was waited for last was not handed over.
    in_frame: bool,
    /// Calls since the last frame was waited for.
    calls: BTreeMap<&'static str, u32>,
    /// Sessions that were made and asked for something.
    sessions: u64,
    /// A session was made and has not asked for anything.
    is_new: bool,
    exhausted: bool,
}

/// What was said in one frame: what came before it, [`Said::Frame`], and what came in it.
#[derive(Default)]
struct Told {
    said: Vec<Said>,
    /// What of it was said again.
    given: Vec<bool>,
}

/// The frame that was waited for, as the runtime said it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SaidFrame {
    pub now: Timestamp,
    /// As the application took it.
    shown: Timestamp,
    pub display: Timestamp,
    pub period: Span,
    pub should_render: bool,
}

impl Told {
    fn of(said: Option<Vec<Said>>) -> Self {
        let said = said.unwrap_or_default();
        Self { given: vec![false; said.len()], said }
    }

    /// What was not said again yet, with its place.
    fn left(&self) -> impl Iterator<Item = (usize, &Said)> {
        self.said.iter().enumerate().filter(|(place, _)| !self.given[*place])
    }

    fn has(&self, name: &str) -> bool {
        self.left().any(|(_, said)| matches!(said, Said::Event(event) if event.name == name))
    }
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
    /// Says `frames` again, one list of what was said for each frame: what came before it, then [`Said::Frame`], then what
    /// came in it. `actions` names the actions that places of actions count. `speed` is that of the host's clock: 1 as
    /// recorded, `None` as fast as it can.
    pub fn new(
        frames: impl Iterator<Item = Vec<Said>> + Send + 'static,
        actions: Vec<String>,
        speed: Option<f64>,
    ) -> Self {
        REPLAYS.fetch_add(1, Ordering::Relaxed);
        let mut frames: Box<dyn Iterator<Item = Vec<Said>> + Send> = Box::new(frames);
        let next = Told::of(frames.next());
        Self(Arc::new(Mutex::new(Inner {
            frames,
            actions,
            speed: speed.filter(|speed| *speed > 0.0 && speed.is_finite()),
            started: None,
            next,
            current: Told::default(),
            in_frame: false,
            calls: BTreeMap::new(),
            sessions: 0,
            is_new: false,
            exhausted: false,
        })))
    }

    /// Whether the application asked for the end here; said once.
    pub fn takes_exit_request(&self) -> bool {
        let inner = &mut *self.lock();
        inner.enter_session();
        match inner.pending() {
            Some((place, Said::Event(event))) if event.name == EXIT_REQUESTED => {
                inner.give(place);
                true
            }
            _ => false,
        }
    }

    /// Whether the run was over here without the runtime's doing. Of one whose runtime hung, nothing is known.
    pub fn is_run_over(&self) -> bool {
        let inner = &mut *self.lock();
        inner.enter_session();
        let ends = |event: &Event| event.name == RUN_ENDED && is_left_to_the_application(event);
        !inner.exhausted && matches!(inner.pending(), Some((_, Said::Event(event))) if ends(event))
    }

    /// What the application went by in the frame that was waited for last: when it is shown, the time between frames, whether
    /// the runtime's times were not believed, and whether they were believed anew.
    pub fn taken_times(&self) -> Option<(Timestamp, Span, bool, bool)> {
        let inner = self.lock();
        let frame = |said: &Said| match *said {
            Said::Frame { display, period, .. } => Some((display, period)),
            _ => None,
        };
        let (display, period) = inner.current.said.iter().find_map(frame)?;
        let before = inner.current.said.iter().take_while(|said| !matches!(said, Said::Frame { .. }));
        let named =
            |name: &str| before.clone().any(|said| matches!(said, Said::Event(event) if event.name == name));
        let (is_faulty, rebased) = (named("time_fault"), named("time_rebased"));
        Some((display, period, is_faulty, rebased))
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A session is made. It takes its place in the recording once it asks for something: one that fails before was not
    /// recorded.
    pub(crate) fn begin_session(&self) {
        let inner = &mut *self.lock();
        inner.is_new = true;
        inner.calls.clear();
    }

    /// What comes next; an event is said once.
    pub(crate) fn next(&self) -> Next {
        let inner = &mut *self.lock();
        inner.enter_session();
        if inner.exhausted {
            return Next::End;
        }
        inner.pass_own_events();
        match inner.pending() {
            Some((_, Said::Event(event))) if event.name == SESSION_BEGINS => Next::Lost,
            // The application finds these by itself, before it asks for anything else.
            Some((_, Said::Event(event))) if is_left_to_the_application(event) => Next::Frame,
            Some((place, Said::Event(event))) => {
                let event = event.clone();
                inner.give(place);
                Next::Event(event)
            }
            Some(_) => Next::Frame,
            None if inner.in_frame => Next::Frame,
            None => Next::End,
        }
    }

    /// How a call that is made now ended in the recording, where that was not simply success. Counts the call.
    fn result(&self, entry_point: &'static str) -> Option<sys::Result> {
        let inner = &mut *self.lock();
        if inner.exhausted {
            return None;
        }
        inner.in_frame &= !matches!(entry_point, "xrEndFrame" | "xrEndSession");
        let nth = inner.calls.entry(entry_point).or_default();
        *nth += 1;
        let nth = *nth;
        let place = if entry_point == POLL {
            inner.enter_session();
            inner.pass_own_events();
            inner.pending().and_then(|(place, said)| matches!(said, Said::Result(_)).then_some(place))
        } else {
            let is = |said: &Said, here: bool| {
                matches!(said, Said::Result(CallResult { call, nth: n, in_frame, .. })
                    if call == entry_point && *n == nth && *in_frame == here)
            };
            let here =
                inner.current.left().find(|(_, said)| is(said, true)).map(|(at, _)| Place::Current(at));
            here.or_else(|| {
                inner.next.left().find(|(_, said)| is(said, false)).map(|(at, _)| Place::Next(at))
            })
        };
        let Said::Result(result) = inner.give(place?)? else { return None };
        Some(sys::Result::from_raw(result.code))
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
        inner.enter_session();
        let frame = inner.frame()?;
        inner.advance();
        inner.in_frame = true;
        inner.calls.clear();
        if let Some(speed) = inner.speed {
            let (since, first) = *inner.started.get_or_insert((Instant::now(), frame.shown));
            let passed = frame.shown.since(first).unwrap_or(Span::ZERO).as_secs_f64() / speed;
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

    /// The joints of a hand at the instant `at`.
    pub(crate) fn joints(&self, of: Hand, at: Timestamp) -> Option<RawJoints> {
        self.lock().answer(|said| match said {
            Said::Joints { hand, at: when, joints } if *hand == of && *when == at => Some(*joints),
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

    /// Whether a pose action was located in this frame, be it that this failed.
    pub(crate) fn locates(&self, wanted: Body) -> bool {
        let inner = self.lock();
        let located = |said: &Said| matches!(said, Said::Place { of, .. } if *of == wanted);
        // What was asked next, if that failed, was where something is.
        let next = inner.current.left().map(|(_, said)| said).find(|said| {
            matches!(
                said,
                Said::Place { .. }
                    | Said::Control { .. }
                    | Said::Joints { .. }
                    | Said::Views { .. }
                    | Said::Result(_)
            )
        });
        let fails = matches!(next, Some(Said::Result(result)) if result.call == "xrLocateSpace");
        fails || inner.current.said.iter().any(located)
    }

    /// The place of an action in the recording.
    pub(crate) fn action(&self, name: &str) -> Option<u16> {
        self.lock().action(name)
    }
}

/// That the application asked for the end, or that the run was over though the runtime answered.
fn is_left_to_the_application(event: &Event) -> bool {
    event.name == EXIT_REQUESTED || (event.name == RUN_ENDED && !event.text.starts_with(HUNG))
}

/// Where something stands that was said.
#[derive(Clone, Copy)]
enum Place {
    Current(usize),
    Next(usize),
}

impl Inner {
    fn advance(&mut self) {
        let next = Told::of(self.frames.next());
        self.current = std::mem::replace(&mut self.next, next);
    }

    /// A session that was made takes its place in the recording: behind the next mark.
    fn enter_session(&mut self) {
        if !std::mem::take(&mut self.is_new) {
            return;
        }
        self.current = Told::default();
        self.in_frame = false;
        self.sessions += 1;
        while self.sessions > 1 && !self.next.has(SESSION_BEGINS) && !self.next.said.is_empty() {
            self.next = Told::of(self.frames.next());
        }
        // A part of a recording may begin behind the mark.
        let mark = |(_, said): &(usize, &Said)| matches!(said, Said::Event(e) if e.name == SESSION_BEGINS);
        let mark = self.next.left().find(mark).map(|(place, _)| place);
        if let Some(mark) = mark {
            self.next.given[..=mark].fill(true);
        }
    }

    /// The next event, result of a poll or frame: what is left of the frame under way comes first.
    fn pending(&self) -> Option<(Place, &Said)> {
        let here = self.current.left().filter(|(_, said)| !matches!(said, Said::Frame { .. }));
        let here = here.map(|(at, said)| (Place::Current(at), said));
        // What comes before the next frame comes behind the end of this one.
        let ahead = self.next.left().filter(|_| !self.in_frame);
        let ahead = ahead.map(|(at, said)| (Place::Next(at), said));
        here.chain(ahead).find(|(_, said)| match said {
            Said::Event(_) | Said::Frame { .. } => true,
            Said::Result(result) => result.call == POLL,
            _ => false,
        })
    }

    /// Passes over events that the application makes by itself, meanwhile.
    fn pass_own_events(&mut self) {
        while let Some((place, Said::Event(event))) = self.pending()
            && (matches!(&*event.name, "time_fault" | "time_rebased")
                || (event.name == RUN_ENDED && !is_left_to_the_application(event)))
        {
            self.give(place);
        }
    }

    fn give(&mut self, place: Place) -> Option<&Said> {
        let (list, at) = match place {
            Place::Current(at) => (&mut self.current, at),
            Place::Next(at) => (&mut self.next, at),
        };
        *list.given.get_mut(at)? = true;
        list.said.get(at)
    }

    fn frame(&self) -> Option<SaidFrame> {
        if self.next.has(SESSION_BEGINS) || self.next.has(RUN_ENDED) {
            return None;
        }
        self.next.left().find_map(|(_, said)| match *said {
            Said::Frame { now, display, should_render, raw_display, raw_period, .. } => Some(SaidFrame {
                now,
                shown: display,
                display: raw_display,
                period: raw_period,
                should_render,
            }),
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
        for (said, given) in self.current.said.iter().zip(&mut self.current.given) {
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

impl Drop for Inner {
    fn drop(&mut self) {
        REPLAYS.fetch_sub(1, Ordering::Relaxed);
    }
}

/// As a motion, a replay stands on an assumed floor, LOCAL's origin at the height of the eyes: what pictures are composed
/// with. What was recorded is answered before anybody asks for this.
impl PoseProvider for Replay {
    fn head(&self, _at: Timestamp) -> Tracked {
        let stage_from_local = Rigid::translation(0.0, 1.6, 0.0);
        let head = self.lock().current.said.iter().find_map(|said| match said {
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
