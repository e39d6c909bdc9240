//! A gamepad as a source.

use std::sync::Arc;
use std::time::Duration;

use evdev::AbsoluteAxisCode;
use vergence_sense::{Axis, Button, Event, Progress, Reading, Sample, Sink, Source, SourceStream, Vector2};
use vergence_time::{Clock, Span, Timestamp};

use super::layout::{From, Layout, Output, State};
use super::reading::{Connection, OpenNode, stamped};
use crate::config::Config;
use crate::connection::{EVENTS, tell};
use crate::error::Error;
use crate::found::Found;

const SYN: u16 = 0;
const KEY: u16 = 1;
const ABS: u16 = 3;

/// A gamepad as a source: sticks (−1 to 1, x to the right, y away from the person), triggers (0 to 1) and buttons, named by
/// where they are; a sample for each change, and for each control when the pad is connected. A pad that is unplugged offers
/// nothing until it comes back, under any name that its node has then.
pub struct GamepadSource {
    connection: Connection,
    node: Option<OpenNode>,
    clock: Arc<dyn Clock>,
    config: Config,
    streams: Vec<SourceStream>,
    outputs: Vec<Output>,
    layout: Layout,
    /// Lowest and highest number of each axis.
    ranges: Box<[(i32, i32); 64]>,
    state: State,
    /// As said last.
    said: State,
}

impl GamepadSource {
    /// Opens the pad.
    ///
    /// # Errors
    /// Where it is gone, or may not be opened.
    pub fn open(device: &Found, config: &Config, clock: Arc<dyn Clock>) -> Result<Self, Error> {
        let (connection, node) =
            Connection::open(device, clock.now()).map_err(|error| Error::open(device, error))?;
        let layout = node.layout(config);
        let mut streams = vec![SourceStream::new("events", vergence_sense::ReadingKind::Event)];
        let (own, outputs): (Vec<_>, Vec<_>) = layout.streams().into_iter().unzip();
        streams.extend(own);
        Ok(Self {
            connection,
            node: None,
            clock,
            config: config.clone(),
            streams,
            outputs,
            layout,
            ranges: Box::new([(0, 0); 64]),
            state: State::AT_REST,
            said: State::AT_REST,
        })
    }

    /// −1 to 1 of an axis' range; 0 where it has none.
    fn share(&self, axis: u16, value: i32) -> f32 {
        let (low, high) = self.ranges.get(usize::from(axis)).copied().unwrap_or((0, 0));
        if high <= low {
            return 0.0;
        }
        let (low, high, value) = (f64::from(low), f64::from(high), f64::from(value));
        // The middle of an even count of numbers is between two of them; both are rest.
        let share = (2.0 * value - low - high) / (high - low);
        let step = 1.0 / (high - low);
        if share.abs() <= step * 1.000_001 { 0.0 } else { share.clamp(-1.0, 1.0) as f32 }
    }

    fn take(&mut self, kind: u16, code: u16, value: i32) {
        let (from_key, number) = match kind {
            // Held keys repeat with 2.
            KEY => (true, if value == 0 { 0.0 } else { 1.0 }),
            ABS => (false, self.share(code, value)),
            _ => return,
        };
        for binding in &self.layout.bindings {
            let is_meant = match binding.from {
                From::Key(key) => from_key && key == code,
                From::Axis { axis, .. } => !from_key && axis == code,
            };
            if is_meant {
                self.state.take(binding, number);
            }
        }
    }

    /// Says what has changed, or everything.
    fn say(&mut self, all: bool, captured: Timestamp, arrived: Timestamp, sink: &mut dyn Sink) {
        for (index, output) in self.outputs.iter().enumerate() {
            let (now, before) = (&self.state, &self.said);
            let (value, has_changed) = match *output {
                Output::Button(place) => (
                    Reading::Button(Button(Some(now.buttons[place]))),
                    now.buttons[place] != before.buttons[place],
                ),
                Output::Trigger(number) => (
                    Reading::Axis(Axis(Some(now.number(number)))),
                    now.number(number) != before.number(number),
                ),
                // Away from the person is up; the kernel counts down.
                Output::Stick(x, y) => (
                    Reading::Vector2(Vector2(Some([now.number(x), -now.number(y)]))),
                    now.number(x) != before.number(x) || now.number(y) != before.number(y),
                ),
            };
            if all || has_changed {
                sink.take(EVENTS + 1 + index, Sample { captured, arrived, value });
            }
        }
        self.said = self.state.clone();
    }

    fn connect(&mut self, until: Timestamp, sink: &mut dyn Sink) -> bool {
        let Some((node, open)) = self.connection.again(until, &*self.clock) else { return false };
        self.layout = node.layout(&self.config);
        self.state = State::AT_REST;
        self.ranges.fill((0, 0));
        let absolute = open.device.get_absinfo().map(|axes| axes.collect::<Vec<_>>()).unwrap_or_default();
        for (AbsoluteAxisCode(axis), info) in &absolute {
            if let Some(range) = self.ranges.get_mut(usize::from(*axis)) {
                *range = (info.minimum(), info.maximum());
            }
        }
        for (AbsoluteAxisCode(axis), info) in &absolute {
            self.take(ABS, *axis, info.value());
        }
        for key in open.device.get_key_state().iter().flat_map(|keys| keys.iter()) {
            self.take(KEY, key.code(), 1);
        }
        self.node = Some(open);
        let now = self.clock.now();
        tell(sink, now, Event::new("connected", ""));
        self.say(true, now, now, sink);
        true
    }

    fn lose(&mut self, sink: &mut dyn Sink) {
        let now = self.clock.now();
        self.node = None;
        self.connection.lost(now);
        tell(sink, now, Event::new("disconnected", "the pad does not answer any more"));
        for (index, output) in self.outputs.iter().enumerate() {
            let value = match output {
                Output::Button(_) => Reading::Button(Button(None)),
                Output::Trigger(_) => Reading::Axis(Axis(None)),
                Output::Stick(..) => Reading::Vector2(Vector2(None)),
            };
            sink.take(EVENTS + 1 + index, Sample { captured: now, arrived: now, value });
        }
    }
}

impl Source for GamepadSource {
    fn streams(&self) -> &[SourceStream] {
        &self.streams
    }

    fn advance(&mut self, until: Timestamp, sink: &mut dyn Sink) -> Progress {
        loop {
            let left = until.since(self.clock.now()).map_or(i64::MAX, Span::as_nanos);
            if left <= 0 {
                return Progress::Idle;
            }
            let Some(mut node) = self.node.take() else {
                if self.connect(until, sink) {
                    return Progress::Gave;
                }
                continue;
            };
            let waited = node.wait(Duration::from_nanos(left.unsigned_abs()));
            let mut gave = false;
            let read = match waited {
                Ok(false) => Ok(()),
                Ok(true) => node.device.fetch_events().map(|events| {
                    let arrived = self.clock.now();
                    for event in events {
                        let kind = event.event_type().0;
                        if kind == SYN && event.code() == 0 {
                            let captured = stamped(event.timestamp(), arrived);
                            self.say(false, captured, arrived, sink);
                            gave = true;
                        } else {
                            self.take(kind, event.code(), event.value());
                        }
                    }
                }),
                Err(error) => Err(error),
            };
            match read {
                Err(error) if error.kind() != std::io::ErrorKind::WouldBlock => {
                    log::debug!("gamepad: {error}");
                    drop(node);
                    self.lose(sink);
                    return Progress::Gave;
                }
                _ => self.node = Some(node),
            }
            if gave {
                return Progress::Gave;
            }
        }
    }
}
