//! A gamepad as a source.

use std::sync::Arc;
use std::sync::mpsc::RecvTimeoutError;
use std::time::{Duration, SystemTime};

use evdev::AbsoluteAxisCode;
use vergence_sense::{Axis, Button, Event, Progress, Reading, Sample, Sink, Source, SourceStream, Vector2};
use vergence_time::{Clock, Span, Timestamp};

use super::hub::{Element, Signal, Subscription, subscribe};
use super::layout::{Binding, COMMON, Layout, Number, Output, State};
use super::node::{NO_UDEV, Node, gilrs_finds_pads, look_up_node};
use super::reading::OpenNode;
use crate::config::Config;
use crate::connection::{EVENTS, tell};
use crate::error::Error;
use crate::found::Found;

const KEY: u16 = 1;
const ABS: u16 = 3;
/// A source that is asked to end does so after this.
const LONGEST_WAIT: Duration = Duration::from_millis(100);

/// In the order of [`super::layout::BUTTONS`].
const NAMED: [gilrs::Button; COMMON] = {
    use gilrs::Button as B;
    [
        B::South,
        B::East,
        B::West,
        B::North,
        B::LeftTrigger,
        B::RightTrigger,
        B::LeftThumb,
        B::RightThumb,
        B::Start,
        B::Select,
        B::Mode,
        B::DPadUp,
        B::DPadDown,
        B::DPadLeft,
        B::DPadRight,
    ]
};

/// A gamepad as a source: sticks (−1 to 1, x to the right, y away from the person), triggers (0 to 1) and buttons, named by
/// where they are; a sample for each change, and for each control when the pad is connected. A pad that is unplugged offers
/// nothing until it comes back, under any name that its node has then.
pub struct GamepadSource {
    subscription: Subscription,
    clock: Arc<dyn Clock>,
    config: Config,
    streams: Vec<SourceStream>,
    outputs: Vec<Output>,
    layout: Layout,
    /// What gilrs' mappings cannot say of the pad.
    by_code: Vec<Binding>,
    path: String,
    /// Lowest and highest number of each axis.
    ranges: Box<[(i32, i32); 64]>,
    state: State,
    /// As said last.
    said: State,
    /// Of what has changed and is not said: when the kernel had it and when it arrived, and the kernel's stamp.
    pending: Option<(Timestamp, Timestamp, SystemTime)>,
}

impl GamepadSource {
    /// Opens the pad.
    ///
    /// # Errors
    /// Where it is gone, or may not be opened, or gilrs cannot find it for want of udev.
    pub fn open(device: &Found, config: &Config, clock: Arc<dyn Clock>) -> Result<Self, Error> {
        let refuse = |error: std::io::Error| Error::open(device, error);
        let node = look_up_node(device).ok_or_else(|| refuse(std::io::ErrorKind::NotFound.into()))?;
        OpenNode::open(&node.found.path).map_err(refuse)?;
        if !gilrs_finds_pads() {
            return Err(Error::open(device, NO_UDEV));
        }
        let layout = node.layout(&config.gamepad_mappings);
        let mut streams = vec![SourceStream::new("events", vergence_sense::ReadingKind::Event)];
        let (own, outputs): (Vec<_>, Vec<_>) = layout.streams().into_iter().unzip();
        streams.extend(own);
        Ok(Self {
            subscription: subscribe(device, &config.gamepad_mappings, clock.clone()).map_err(refuse)?,
            clock,
            config: config.clone(),
            streams,
            outputs,
            layout,
            by_code: Vec::new(),
            path: node.found.path,
            ranges: Box::new([(0, 0); 64]),
            state: State::AT_REST,
            said: State::AT_REST,
            pending: None,
        })
    }

    /// −1 to 1 of an axis' range; 0 where it has none.
    fn share(&self, axis: u16, value: f64) -> f32 {
        let (low, high) = self.ranges.get(usize::from(axis)).copied().unwrap_or((0, 0));
        if high <= low {
            return 0.0;
        }
        let (low, high) = (f64::from(low), f64::from(high));
        // The middle of an even count of numbers is between two of them; both are rest.
        let share = (2.0 * value - low - high) / (high - low);
        let step = 1.0 / (high - low);
        if share.abs() <= step * 1.000_001 { 0.0 } else { share.clamp(-1.0, 1.0) as f32 }
    }

    /// The kernel's number out of gilrs' for it, which is one step short of −1 where the count of numbers is even.
    fn number(&self, axis: u16, value: f32) -> f64 {
        let (low, high) = self.ranges.get(usize::from(axis)).copied().unwrap_or((0, 0));
        let (low, high, value) = (f64::from(low), f64::from(high), f64::from(value));
        let way = high - low;
        if way % 2.0 == 1.0 {
            (low - 1.0 + f64::midpoint(value, 1.0) * (way + 1.0)).round()
        } else {
            (low + f64::midpoint(value, 1.0) * way).round()
        }
    }

    /// Takes a change, as gilrs names it.
    fn take(&mut self, element: Element, value: f32, (kind, code): (u16, u16)) {
        if self.by_code.iter().any(|binding| binding.input() == (kind, code)) {
            let value = match element {
                Element::Axis(_) if kind == ABS => self.share(code, self.number(code, value)),
                Element::Key(_) if kind == KEY => value,
                _ => return,
            };
            let bindings = self.by_code.iter().filter(|binding| binding.input() == (kind, code));
            bindings.for_each(|binding| self.state.take(binding, value));
            return;
        }
        match element {
            Element::Key(button) => {
                if let Some(place) = NAMED.iter().position(|own| *own == button) {
                    self.state.buttons[place] = value > 0.5;
                }
            }
            Element::Way(gilrs::Button::LeftTrigger2) => self.state.set(Number::LeftTrigger, value),
            Element::Way(gilrs::Button::RightTrigger2) => self.state.set(Number::RightTrigger, value),
            Element::Way(_) => {}
            Element::Axis(axis) => {
                use gilrs::Axis as A;
                // The kernel counts down.
                let is_turned = matches!(axis, A::LeftStickY | A::RightStickY | A::DPadY);
                let value = self.share(code, self.number(code, if is_turned { -value } else { value }));
                let mut ways = |negative, positive| {
                    for (button, is_down) in [(negative, value < -0.5), (positive, value > 0.5)] {
                        if let Some(place) = NAMED.iter().position(|own| *own == button) {
                            self.state.buttons[place] = is_down;
                        }
                    }
                };
                match axis {
                    A::LeftStickX => self.state.set(Number::LeftX, value),
                    A::LeftStickY => self.state.set(Number::LeftY, value),
                    A::RightStickX => self.state.set(Number::RightX, value),
                    A::RightStickY => self.state.set(Number::RightY, value),
                    A::DPadX => ways(gilrs::Button::DPadLeft, gilrs::Button::DPadRight),
                    A::DPadY => ways(gilrs::Button::DPadUp, gilrs::Button::DPadDown),
                    _ => {}
                }
            }
        }
    }

    /// How the pad stands, which gilrs says only of what changes. A pad that is gone by now stands as it stood.
    fn look(&mut self) {
        let Ok(open) = OpenNode::open(&self.path) else { return };
        let absolute = open.device.get_absinfo().map(|axes| axes.collect::<Vec<_>>()).unwrap_or_default();
        self.ranges.fill((0, 0));
        for (AbsoluteAxisCode(axis), info) in &absolute {
            if let Some(range) = self.ranges.get_mut(usize::from(*axis)) {
                *range = (info.minimum(), info.maximum());
            }
        }
        self.state = State::AT_REST;
        let keys = open.device.get_key_state().unwrap_or_default();
        let axes: Vec<(u16, f32)> = absolute
            .iter()
            .map(|(AbsoluteAxisCode(axis), info)| (*axis, self.share(*axis, f64::from(info.value()))))
            .collect();
        for binding in &self.layout.bindings {
            let value = match binding.input() {
                (KEY, key) => Some(if keys.contains(evdev::KeyCode(key)) { 1.0 } else { 0.0 }),
                (_, own) => axes.iter().find(|(axis, _)| *axis == own).map(|(_, value)| *value),
            };
            if let Some(value) = value {
                self.state.take(binding, value);
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

    fn connect(&mut self, node: &Node, sink: &mut dyn Sink) {
        self.layout = node.layout(&self.config.gamepad_mappings);
        self.by_code = self.layout.for_gilrs(&node.gilrs_guid, &node.codes).1;
        self.path.clone_from(&node.found.path);
        self.pending = None;
        self.look();
        let now = self.clock.now();
        tell(sink, now, Event::new("connected", ""));
        self.say(true, now, now, sink);
    }

    /// Takes what the thread of gilrs says; whether something was given to the sink.
    fn follow(&mut self, signal: Signal, sink: &mut dyn Sink) -> bool {
        match signal {
            Signal::Connected(node) => self.connect(&node, sink),
            Signal::Lost => self.lose(sink),
            Signal::Changed { element, value, input, captured, arrived, stamp } => {
                // What has one stamp changed at once.
                let is_another = self.pending.is_some_and(|(.., own)| own != stamp);
                let gave = is_another && self.say_pending(sink);
                self.pending.get_or_insert((captured, arrived, stamp));
                self.take(element, value, input);
                return gave;
            }
            Signal::Settled => return self.say_pending(sink),
        }
        true
    }

    fn say_pending(&mut self, sink: &mut dyn Sink) -> bool {
        let Some((captured, arrived, _)) = self.pending.take() else { return false };
        let has_changed = self.state != self.said;
        self.say(false, captured, arrived, sink);
        has_changed
    }

    fn lose(&mut self, sink: &mut dyn Sink) {
        let now = self.clock.now();
        self.pending = None;
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
            let longest = Duration::from_nanos(left.unsigned_abs()).min(LONGEST_WAIT);
            let mut gave = match self.subscription.signals.recv_timeout(longest) {
                Ok(signal) => self.follow(signal, sink),
                Err(RecvTimeoutError::Timeout) => false,
                Err(RecvTimeoutError::Disconnected) => {
                    // Only where gilrs' thread panicked.
                    self.clock.sleep_until(until);
                    return Progress::Idle;
                }
            };
            if self.subscription.has_missed() {
                while let Ok(signal) = self.subscription.signals.try_recv() {
                    gave |= self.follow(signal, sink);
                }
                self.look();
                self.pending = None;
                let now = self.clock.now();
                gave |= self.state != self.said;
                self.say(false, now, now, sink);
            }
            if gave {
                return Progress::Gave;
            }
        }
    }
}
