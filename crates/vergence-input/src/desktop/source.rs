//! A window's events as a source.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, channel, sync_channel};
use std::sync::{Arc, Weak};
use std::time::Duration;

use vergence_sense::{
    Button, Event, Progress, Reading, ReadingKind, Sample, Sink, Source, SourceStream, Touch, TouchPhase,
    Vector2,
};
use vergence_time::{Clock, Span, Timestamp};
use vergence_window::{Event as Said, Window};

use super::keys::{BUTTONS, EXTRA, button, key};
use crate::connection::{EVENTS, tell};
use crate::error::Error;

const POINTER: usize = EVENTS + 1;
const TOUCH: usize = POINTER + 1;
const MOVE: usize = TOUCH + 1;
const WHEEL: usize = MOVE + 1;
/// Of the first of the mouse's buttons; keys follow the last.
const FIRST_BUTTON: usize = WHEEL + 1;

/// Keyboards have fewer keys.
const MOST_KEYS: usize = 512;
/// So many events may wait for a reader; the rest is counted.
const WAITING: usize = 4096;
/// A window of our own looks this often whether somebody still listens.
const TURN: Duration = Duration::from_millis(100);
/// A source that is asked to end does so after this.
const LONGEST_WAIT: Duration = Duration::from_millis(100);
const TITLE: &str = "Vergence: keys, mouse and touches in this window are read";
const SIZE: (u32, u32) = (640, 480);

/// Knobs of a [`DesktopSource`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DesktopConfig {
    /// Whether a mouse's buttons beyond three are read. Default no: desktops and browsers use them too.
    pub extra_mouse_buttons: bool,
}

/// Where whoever has the window puts its events. May be copied.
#[derive(Clone)]
pub struct DesktopFeed {
    events: SyncSender<(Timestamp, Said)>,
    clock: Arc<dyn Clock>,
    missed: Arc<AtomicU64>,
    listener: Weak<()>,
}

impl DesktopFeed {
    /// Passes on what a window told, and waits for nobody: what finds 4096 events waiting is counted, and a `gap` of the source.
    pub fn tell(&self, event: Said) {
        if let Err(TrySendError::Full(_)) = self.events.try_send((self.clock.now(), event)) {
            self.missed.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Whether the source is still there.
    pub fn is_heard(&self) -> bool {
        self.listener.strong_count() > 0
    }
}

/// Keyboard, mouse and touch screen of a window as a source, a sample for each change:
///
/// - `pointer`: a [`Touch`] of contact 0, in pixels of the window; it hovers until the left button is down, and is cancelled where it
///   leaves the window;
/// - `touch`: fingers, the same way;
/// - `mouse/move`: what the mouse itself counts, x to the right, y away from the user, also where the pointer cannot go on;
///   `mouse/wheel`: lines to the right and away from the user;
/// - `mouse/left`, `mouse/right`, `mouse/middle`, and with [`DesktopConfig::extra_mouse_buttons`] `mouse/back`, `mouse/forward`,
///   `mouse/button6` to `mouse/button8`;
/// - `key/a`, `key/left_shift`, …: each key from when it is first used, named by its place on the keyboard.
///
/// What is held when the window loses the keyboard offers nothing from then on, since nobody says when it is let go. Windows say
/// when events arrive, not when they happened.
pub struct DesktopSource {
    events: Receiver<(Timestamp, Said)>,
    missed: Arc<AtomicU64>,
    _listens: Arc<()>,
    clock: Arc<dyn Clock>,
    streams: Vec<SourceStream>,
    /// Place of each key's stream, by the window's name for it; `None` for those that are no words.
    keys: BTreeMap<String, Option<usize>>,
    /// How many buttons of the mouse are read.
    buttons: usize,
    /// Of each stream: it is a button that is down.
    is_down: Vec<bool>,
    pointer: Option<[f64; 2]>,
    has_begun: bool,
    is_over: bool,
}

/// Before any key was met.
pub(super) fn own_streams(extra_mouse_buttons: bool) -> Vec<SourceStream> {
    let mut streams = vec![
        SourceStream::new("events", ReadingKind::Event),
        SourceStream::new("pointer", ReadingKind::Touch).unit("px").frame("window"),
        SourceStream::new("touch", ReadingKind::Touch).unit("px").frame("window"),
        SourceStream::new("mouse/move", ReadingKind::Vector2).unit("counts"),
        SourceStream::new("mouse/wheel", ReadingKind::Vector2).unit("lines"),
    ];
    let extra = if extra_mouse_buttons { &EXTRA[..] } else { &[] };
    let buttons = BUTTONS.iter().chain(extra);
    streams.extend(buttons.map(|name| SourceStream::new(format!("mouse/{name}"), ReadingKind::Button)));
    streams
}

impl DesktopSource {
    /// Opens a window of its own, on a thread of its own, until the source is dropped or the user closes it; then the source ends.
    ///
    /// # Errors
    /// Where there is no display, or another thread of the process has windows.
    pub fn open(config: DesktopConfig, clock: Arc<dyn Clock>) -> Result<Self, Error> {
        let refuse = |error: &dyn std::error::Error| Error::open(&super::found(), error);
        let (feed, source) = Self::fed(config, clock);
        let (said, heard) = channel();
        let run = move || {
            let mut window = match Window::open(TITLE, SIZE) {
                Ok(window) => window,
                Err(error) => {
                    let _ = said.send(Err(error));
                    return;
                }
            };
            let _ = said.send(Ok(()));
            let mut is_open = true;
            while is_open && feed.is_heard() {
                window.wait(TURN, |event| {
                    is_open &= event != Said::CloseRequested;
                    feed.tell(event);
                });
            }
        };
        std::thread::Builder::new().name("desktop".to_owned()).spawn(run).map_err(|error| refuse(&error))?;
        match heard.recv() {
            Ok(Ok(())) => Ok(source),
            Ok(Err(error)) => Err(refuse(&error)),
            Err(error) => Err(refuse(&error)),
        }
    }

    /// Reads what is put into the feed, by whoever has the window; ends when no copy of the feed is left. `clock` stamps.
    pub fn fed(config: DesktopConfig, clock: Arc<dyn Clock>) -> (DesktopFeed, Self) {
        let (sender, events) = sync_channel(WAITING);
        let missed = Arc::new(AtomicU64::new(0));
        let listens = Arc::new(());
        let feed = DesktopFeed {
            events: sender,
            clock: clock.clone(),
            missed: missed.clone(),
            listener: Arc::downgrade(&listens),
        };
        let streams = own_streams(config.extra_mouse_buttons);
        let source = Self {
            events,
            missed,
            _listens: listens,
            clock,
            buttons: streams.len() - FIRST_BUTTON,
            is_down: vec![false; streams.len()],
            streams,
            keys: BTreeMap::new(),
            pointer: None,
            has_begun: false,
            is_over: false,
        };
        (feed, source)
    }

    /// The place of a key's stream, which appears where it is met first.
    fn key(&mut self, code: String, sink: &mut dyn Sink) -> Option<usize> {
        if let Some(place) = self.keys.get(&code) {
            return *place;
        }
        if self.keys.len() >= MOST_KEYS {
            return None;
        }
        let place = key(&code).map(|name| {
            let stream = SourceStream::new(format!("key/{name}"), ReadingKind::Button);
            let place = self.streams.len();
            sink.appears(place, &stream);
            self.streams.push(stream);
            self.is_down.push(false);
            place
        });
        self.keys.insert(code, place);
        place
    }

    fn press(&mut self, place: usize, is_down: bool, at: Timestamp, sink: &mut dyn Sink) {
        self.is_down[place] = is_down;
        give(sink, place, at, Reading::Button(Button(Some(is_down))));
    }

    fn point(&self, phase: TouchPhase, at: Timestamp, sink: &mut dyn Sink) -> bool {
        let Some(position) = self.pointer else { return false };
        give(sink, POINTER, at, Reading::Touch(Touch { contact: 0, position, phase }));
        true
    }

    /// Takes an event; whether it gave something.
    fn take(&mut self, event: Said, at: Timestamp, sink: &mut dyn Sink) -> bool {
        match event {
            Said::Key { repeated: true, .. } | Said::CloseRequested => return false,
            Said::Key { key, pressed, .. } => {
                let Some(place) = self.key(key, sink) else { return false };
                self.press(place, pressed, at, sink);
            }
            Said::PointerAt { x, y } => {
                self.pointer = Some([x, y]);
                let is_down = self.is_down[FIRST_BUTTON];
                self.point(if is_down { TouchPhase::Moves } else { TouchPhase::Hovers }, at, sink);
            }
            Said::PointerLeft => {
                let gave = self.point(TouchPhase::Cancelled, at, sink);
                self.pointer = None;
                return gave;
            }
            Said::PointerMoved { dx, dy } => {
                give(sink, MOVE, at, Reading::Vector2(Vector2(Some([dx as f32, -dy as f32]))));
            }
            Said::Wheel { right, up } => {
                give(sink, WHEEL, at, Reading::Vector2(Vector2(Some([right as f32, up as f32]))));
            }
            Said::Button { button: which, pressed } => {
                let Some(place) = button(which).filter(|place| *place < self.buttons) else { return false };
                self.press(FIRST_BUTTON + place, pressed, at, sink);
                if place == 0 {
                    self.point(if pressed { TouchPhase::Begins } else { TouchPhase::Ends }, at, sink);
                }
            }
            Said::Touch { contact, x, y, phase } => {
                give(sink, TOUCH, at, Reading::Touch(Touch { contact, position: [x, y], phase }));
            }
            Said::Focused(true) => tell(sink, at, Event::new("focused", "the window has the keyboard")),
            Said::Focused(false) => {
                tell(sink, at, Event::new("unfocused", "the window has the keyboard no more"));
                self.let_go(at, sink);
            }
            Said::Resized { width, height } => {
                let (before, after) = (f64::from(width), f64::from(height));
                let event = Event::new("resized", "the window's width (before) and height (after), pixels");
                tell(sink, at, Event { before, after, ..event });
            }
        }
        true
    }

    /// Nobody knows any more of what is held.
    fn let_go(&mut self, at: Timestamp, sink: &mut dyn Sink) {
        for (place, is_down) in self.is_down.iter_mut().enumerate() {
            if std::mem::take(is_down) {
                give(sink, place, at, Reading::Button(Button(None)));
            }
        }
    }
}

fn give(sink: &mut dyn Sink, place: usize, at: Timestamp, value: Reading<'_>) {
    sink.take(place, Sample { captured: at, arrived: at, value });
}

impl Source for DesktopSource {
    fn streams(&self) -> &[SourceStream] {
        &self.streams
    }

    fn advance(&mut self, until: Timestamp, sink: &mut dyn Sink) -> Progress {
        if self.is_over {
            return Progress::Ended;
        }
        let now = self.clock.now();
        if !std::mem::replace(&mut self.has_begun, true) {
            tell(sink, now, Event::new("connected", ""));
            return Progress::Gave;
        }
        loop {
            let left = until.since(self.clock.now()).map_or(i64::MAX, Span::as_nanos);
            if left <= 0 {
                return Progress::Idle;
            }
            let longest = Duration::from_nanos(left.unsigned_abs()).min(LONGEST_WAIT);
            let mut gave = false;
            match self.events.recv_timeout(longest) {
                Ok((at, event)) => gave |= self.take(event, at, sink),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    let now = self.clock.now();
                    self.let_go(now, sink);
                    tell(sink, now, Event::new("disconnected", "the window was closed"));
                    self.is_over = true;
                    gave = true;
                }
            }
            let missed = self.missed.swap(0, Ordering::Relaxed);
            if missed > 0 {
                let event = Event::new("gap", "events came faster than they were read");
                tell(sink, self.clock.now(), Event { after: missed as f64, ..event });
                gave = true;
            }
            if gave {
                return Progress::Gave;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use vergence_time::HostClock;
    use vergence_window::PointerButton;

    use super::*;

    type Samples = Vec<(usize, Sample<Reading<'static>>)>;

    fn fed(extra_mouse_buttons: bool) -> (DesktopFeed, DesktopSource) {
        DesktopSource::fed(DesktopConfig { extra_mouse_buttons }, Arc::new(HostClock::start()))
    }

    /// Everything that comes until the feed is gone, as `name: value`.
    fn all(feed: DesktopFeed, mut source: DesktopSource) -> Vec<(String, Reading<'static>)> {
        drop(feed);
        let mut samples = Samples::new();
        while source.advance(Timestamp::from_nanos(i64::MAX), &mut samples) != Progress::Ended {}
        samples.into_iter().map(|(place, s)| (source.streams[place].name.clone(), s.value)).collect()
    }

    fn named(name: &str, value: Reading<'static>) -> (String, Reading<'static>) {
        (name.to_owned(), value)
    }

    fn pressed(name: &str, is_down: Option<bool>) -> (String, Reading<'static>) {
        named(name, Reading::Button(Button(is_down)))
    }

    #[test]
    fn what_a_window_tells_is_said_by_its_streams() {
        let (feed, source) = fed(false);
        let key = |key: &str, pressed, repeated| Said::Key { key: key.to_owned(), pressed, repeated };
        let click = |button, pressed| Said::Button { button, pressed };
        for event in [
            Said::PointerAt { x: 3.0, y: 4.0 },
            click(PointerButton::Left, true),
            Said::PointerAt { x: 5.0, y: 4.0 },
            click(PointerButton::Left, false),
            Said::PointerLeft,
            Said::PointerMoved { dx: 2.0, dy: 3.0 },
            Said::Wheel { right: 0.0, up: 1.0 },
            Said::Touch { contact: 4, x: 1.0, y: 2.0, phase: TouchPhase::Begins },
            // Who did not ask for it does not get it.
            click(PointerButton::Other(8), true),
            key("ShiftLeft", true, false),
            key("ShiftLeft", true, true),
            key("no word", true, false),
            key("KeyA", true, false),
            key("KeyA", false, false),
            Said::Focused(false),
        ] {
            feed.tell(event);
        }
        assert!(feed.is_heard());
        let touch = |contact, position, phase| Reading::Touch(Touch { contact, position, phase });
        let vector = |x, y| Reading::Vector2(Vector2(Some([x, y])));
        let said: Vec<_> = all(feed, source).into_iter().filter(|(name, _)| name != "events").collect();
        let wanted = [
            named("pointer", touch(0, [3.0, 4.0], TouchPhase::Hovers)),
            pressed("mouse/left", Some(true)),
            named("pointer", touch(0, [3.0, 4.0], TouchPhase::Begins)),
            named("pointer", touch(0, [5.0, 4.0], TouchPhase::Moves)),
            pressed("mouse/left", Some(false)),
            named("pointer", touch(0, [5.0, 4.0], TouchPhase::Ends)),
            named("pointer", touch(0, [5.0, 4.0], TouchPhase::Cancelled)),
            // Away from the user is up.
            named("mouse/move", vector(2.0, -3.0)),
            named("mouse/wheel", vector(0.0, 1.0)),
            named("touch", touch(4, [1.0, 2.0], TouchPhase::Begins)),
            pressed("key/left_shift", Some(true)),
            pressed("key/a", Some(true)),
            pressed("key/a", Some(false)),
            // Still held when the window lost the keyboard.
            pressed("key/left_shift", None),
        ];
        assert_eq!(said, wanted);
    }

    #[test]
    fn buttons_beyond_three_are_for_who_asks() {
        let (feed, source) = fed(true);
        assert_eq!(source.streams().len(), FIRST_BUTTON + BUTTONS.len() + EXTRA.len());
        for number in [8, 9, 13] {
            feed.tell(Said::Button { button: PointerButton::Other(number), pressed: true });
        }
        let said = all(feed, source);
        let buttons: Vec<_> = said.iter().filter(|(_, value)| value.kind() == ReadingKind::Button).collect();
        let [back, forward] = ["mouse/back", "mouse/forward"].map(|name| pressed(name, Some(true)));
        // Both are let go of when the window closes.
        let gone = ["mouse/back", "mouse/forward"].map(|name| pressed(name, None));
        assert_eq!(buttons, [&back, &forward, &gone[0], &gone[1]]);
    }

    #[test]
    fn what_is_left_out_is_counted_and_the_end_is_said() {
        let (feed, source) = fed(false);
        for step in 0..WAITING + 7 {
            feed.tell(Said::PointerAt { x: step as f64, y: 0.0 });
        }
        let said = all(feed, source);
        assert_eq!(said.iter().filter(|(name, _)| name == "pointer").count(), WAITING);
        let events: Vec<(&str, f64)> = said
            .iter()
            .filter_map(
                |(_, value)| if let Reading::Event(e) = value { Some((&*e.name, e.after)) } else { None },
            )
            .collect();
        let names: Vec<&str> = events.iter().map(|(name, _)| *name).collect();
        assert_eq!(names, ["connected", "gap", "disconnected"]);
        assert_eq!(events[1].1, 7.0);
    }

    #[test]
    fn keys_without_end_make_no_streams_without_end() {
        let (feed, mut source) = fed(false);
        let mut samples = Samples::new();
        for number in 0..2 * MOST_KEYS {
            feed.tell(Said::Key { key: format!("Key{number}"), pressed: true, repeated: false });
            if number % 64 == 63 {
                let now = source.clock.now();
                while source.advance(now.saturating_add(Span::from_millis(1)), &mut samples) == Progress::Gave
                {
                }
            }
        }
        assert_eq!(source.streams().len(), FIRST_BUTTON + BUTTONS.len() + MOST_KEYS);
    }
}
