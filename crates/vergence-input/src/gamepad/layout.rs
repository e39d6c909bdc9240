//! Which event code of a node is which control of a pad, by where it is.

use vergence_sense::{ReadingKind, SourceStream};

use super::database::{Half, Input, Line};

/// Controls that are pressed or not: the name of the stream, and SDL's word.
pub(super) const BUTTONS: [(&str, &str); 24] = [
    ("south", "a"),
    ("east", "b"),
    ("west", "x"),
    ("north", "y"),
    ("left_shoulder", "leftshoulder"),
    ("right_shoulder", "rightshoulder"),
    ("left_stick/click", "leftstick"),
    ("right_stick/click", "rightstick"),
    ("start", "start"),
    ("select", "back"),
    ("guide", "guide"),
    ("dpad/up", "dpup"),
    ("dpad/down", "dpdown"),
    ("dpad/left", "dpleft"),
    ("dpad/right", "dpright"),
    ("touchpad/click", "touchpad"),
    ("paddle_right", "paddle1"),
    ("paddle_left", "paddle2"),
    ("paddle_right_2", "paddle3"),
    ("paddle_left_2", "paddle4"),
    ("misc_1", "misc1"),
    ("misc_2", "misc2"),
    ("misc_3", "misc3"),
    ("misc_4", "misc4"),
];

/// So many of them, from the first, gilrs has names for.
pub(super) const COMMON: usize = 15;

/// Numbers behind the sticks and triggers, and SDL's word.
const NUMBERS: [(Number, &str); 6] = [
    (Number::LeftX, "leftx"),
    (Number::LeftY, "lefty"),
    (Number::RightX, "rightx"),
    (Number::RightY, "righty"),
    (Number::LeftTrigger, "lefttrigger"),
    (Number::RightTrigger, "righttrigger"),
];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Number {
    LeftX,
    LeftY,
    RightX,
    RightY,
    LeftTrigger,
    RightTrigger,
}

/// Codes of linux/input-event-codes.h.
pub(super) mod code {
    pub(crate) const BTN_JOYSTICK: u16 = 0x120;
    pub(crate) const KEY_MAX: u16 = 0x2ff;
    pub(crate) const ABS_HAT0X: u16 = 0x10;
    pub(crate) const ABS_HAT3Y: u16 = 0x17;
    pub(crate) const ABS_MAX: u16 = 0x3f;
}

/// An input, by the kernel's codes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum From {
    Key(u16),
    Axis { axis: u16, half: Half, is_inverted: bool },
}

/// What an input moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum To {
    /// Place in [`BUTTONS`].
    Button(usize),
    Number(Number, Half),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Binding {
    pub(super) from: From,
    pub(super) to: To,
}

impl Binding {
    /// The kernel's type and code of the input.
    pub(super) fn input(&self) -> (u16, u16) {
        match self.from {
            From::Key(key) => (1, key),
            From::Axis { axis, .. } => (3, axis),
        }
    }
}

/// What a node has: keys and absolute axes, ascending.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Codes {
    pub(super) keys: Vec<u16>,
    pub(super) axes: Vec<u16>,
}

/// Where everything is, on one pad.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Layout {
    pub(super) bindings: Vec<Binding>,
}

fn is_hat(axis: &u16) -> bool {
    (code::ABS_HAT0X..=code::ABS_HAT3Y).contains(axis)
}

impl Layout {
    /// As a line of the database says; what it names and the node lacks is left out.
    pub(super) fn by_line(line: &Line<'_>, codes: &Codes) -> Self {
        // SDL counts joystick buttons first, then those below.
        let keys =
            |from: u16, to: u16| codes.keys.iter().copied().filter(move |key| (from..to).contains(key));
        let keys: Vec<u16> =
            keys(code::BTN_JOYSTICK, code::KEY_MAX).chain(keys(0, code::BTN_JOYSTICK)).collect();
        let axes: Vec<u16> = codes.axes.iter().copied().filter(|axis| !is_hat(axis)).collect();
        // A hat is there when one of its two axes is.
        let hats: Vec<u16> = (code::ABS_HAT0X..=code::ABS_HAT3Y)
            .step_by(2)
            .filter(|x| codes.axes.contains(x) || codes.axes.contains(&(x + 1)))
            .collect();
        let from = |input: Input| {
            Some(match input {
                Input::Button(number) => From::Key(*keys.get(usize::from(number))?),
                Input::Axis { axis, half, is_inverted } => {
                    From::Axis { axis: *axes.get(usize::from(axis))?, half, is_inverted }
                }
                Input::Hat(number, direction) => {
                    let x = *hats.get(usize::from(number))?;
                    let axis = if matches!(direction, 2 | 8) { x } else { x + 1 };
                    // Up and left are negative.
                    let half = if matches!(direction, 1 | 8) { Half::Negative } else { Half::Positive };
                    From::Axis { axis, half, is_inverted: false }
                }
            })
        };
        let to = |element: &str, half| {
            let button = BUTTONS.iter().position(|(_, own)| *own == element).map(To::Button);
            let number =
                || NUMBERS.iter().find(|(_, own)| *own == element).map(|(n, _)| To::Number(*n, half));
            button.or_else(number)
        };
        let bind = |binding: &super::database::Binding<'_>| {
            Some(Binding { from: from(binding.input)?, to: to(binding.element, binding.half)? })
        };
        Self { bindings: line.bindings.iter().filter_map(bind).collect() }
    }

    /// As the kernel's rules for drivers say (Documentation/input/gamepad.rst). `is_xpad`: the driver of Xbox pads, older than
    /// the rules, calls west north and north west.
    pub(super) fn by_rule(codes: &Codes, is_xpad: bool) -> Self {
        let (west, north) = if is_xpad { (0x133, 0x134) } else { (0x134, 0x133) };
        let keys = [
            (0x130, "south"),
            (0x131, "east"),
            (west, "west"),
            (north, "north"),
            (0x136, "left_shoulder"),
            (0x137, "right_shoulder"),
            (0x13d, "left_stick/click"),
            (0x13e, "right_stick/click"),
            (0x13b, "start"),
            (0x13a, "select"),
            (0x13c, "guide"),
            (0x220, "dpad/up"),
            (0x221, "dpad/down"),
            (0x222, "dpad/left"),
            (0x223, "dpad/right"),
        ];
        let (whole, is_inverted) = (Half::Whole, false);
        let axis = |axis, half| From::Axis { axis, half, is_inverted };
        let mut bindings = Vec::new();
        for (key, name) in keys {
            if let Some(place) = BUTTONS.iter().position(|(own, _)| *own == name) {
                bindings.push(Binding { from: From::Key(key), to: To::Button(place) });
            }
        }
        for (code, half, name) in [
            (0x10, Half::Negative, "dpad/left"),
            (0x10, Half::Positive, "dpad/right"),
            (0x11, Half::Negative, "dpad/up"),
            (0x11, Half::Positive, "dpad/down"),
        ] {
            if let Some(place) = BUTTONS.iter().position(|(own, _)| *own == name) {
                bindings.push(Binding { from: axis(code, half), to: To::Button(place) });
            }
        }
        for (code, number) in [
            (0, Number::LeftX),
            (1, Number::LeftY),
            (3, Number::RightX),
            (4, Number::RightY),
            (2, Number::LeftTrigger),
            (5, Number::RightTrigger),
        ] {
            bindings.push(Binding { from: axis(code, whole), to: To::Number(number, whole) });
        }
        // Triggers without a way are buttons.
        for (key, trigger, number) in [(0x138, 2, Number::LeftTrigger), (0x139, 5, Number::RightTrigger)] {
            if !codes.axes.contains(&trigger) {
                bindings.push(Binding { from: From::Key(key), to: To::Number(number, whole) });
            }
        }
        bindings.retain(|binding| match binding.from {
            From::Key(key) => codes.keys.contains(&key),
            From::Axis { axis, .. } => codes.axes.contains(&axis),
        });
        Self { bindings }
    }

    /// What gilrs is told, as a line of SDL's format by its own counting of buttons and axes, and what such a line cannot tell it
    /// (it takes of an axis the whole, upright, and names neither paddles nor more than the common buttons), which stays by code.
    pub(super) fn for_gilrs(&self, guid: &[u8; 16], codes: &Codes) -> (String, Vec<Binding>) {
        use std::fmt::Write as _;
        let keys = [(0x100, 0x110), (code::BTN_JOYSTICK, u16::MAX), (0, 0x100), (0x110, code::BTN_JOYSTICK)];
        let keys: Vec<u16> = keys
            .iter()
            .flat_map(|(from, to)| codes.keys.iter().copied().filter(move |key| (*from..*to).contains(key)))
            .collect();
        let part = |binding: &Binding| {
            let element = match binding.to {
                To::Button(place) => BUTTONS.get(..COMMON)?.get(place)?.1,
                To::Number(number, Half::Whole) => NUMBERS.iter().find(|(own, _)| *own == number)?.1,
                To::Number(..) => return None,
            };
            let is_way = matches!(element, "leftx" | "lefty" | "rightx" | "righty");
            let input = match binding.from {
                From::Key(key) if !is_way => format!("b{}", keys.iter().position(|own| *own == key)?),
                From::Axis { axis, half: Half::Whole, is_inverted: false } => {
                    format!("a{}", codes.axes.iter().position(|own| *own == axis)?)
                }
                From::Axis { axis, half, is_inverted: false } => match (axis, half, element) {
                    (0x11, Half::Negative, "dpup") => "h0.1".to_owned(),
                    (0x10, Half::Positive, "dpright") => "h0.2".to_owned(),
                    (0x11, Half::Positive, "dpdown") => "h0.4".to_owned(),
                    (0x10, Half::Negative, "dpleft") => "h0.8".to_owned(),
                    _ => return None,
                },
                _ => return None,
            };
            Some(format!("{element}:{input},"))
        };
        // What is bound more than once gilrs takes for the last of it, except the two ways of a hat.
        let is_known = |binding: &Binding| {
            let mut same = self.bindings.iter().filter(|other| other.input() == binding.input());
            let count = self.bindings.iter().filter(|other| other.input() == binding.input()).count();
            same.all(|other| part(other).is_some())
                && (count == 1 || matches!(binding.from, From::Axis { axis: 0x10 | 0x11, .. }) && count == 2)
        };
        let mut line = String::with_capacity(512);
        for byte in guid {
            let _ = write!(line, "{byte:02x}");
        }
        line.push_str(",pad,");
        let (told, rest): (Vec<Binding>, Vec<Binding>) = self.bindings.iter().partition(|b| is_known(b));
        line.extend(told.iter().filter_map(part));
        line.push_str("platform:Linux,");
        (line, rest)
    }

    /// Streams of the pad, with what each is made of.
    pub(super) fn streams(&self) -> Vec<(SourceStream, Output)> {
        let has = |number| self.bindings.iter().any(|b| matches!(b.to, To::Number(own, _) if own == number));
        let mut streams = Vec::new();
        for (name, x, y) in
            [("left_stick", Number::LeftX, Number::LeftY), ("right_stick", Number::RightX, Number::RightY)]
        {
            if has(x) || has(y) {
                streams.push((SourceStream::new(name, ReadingKind::Vector2), Output::Stick(x, y)));
            }
        }
        for (name, number) in [("left_trigger", Number::LeftTrigger), ("right_trigger", Number::RightTrigger)]
        {
            if has(number) {
                streams.push((SourceStream::new(name, ReadingKind::Axis), Output::Trigger(number)));
            }
        }
        for (place, (name, _)) in BUTTONS.iter().enumerate() {
            if self.bindings.iter().any(|binding| binding.to == To::Button(place)) {
                streams.push((SourceStream::new(*name, ReadingKind::Button), Output::Button(place)));
            }
        }
        streams
    }
}

/// What a stream of a pad is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Output {
    Stick(Number, Number),
    Trigger(Number),
    Button(usize),
}

/// What the controls are, by what has come so far.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct State {
    pub(super) buttons: [bool; BUTTONS.len()],
    numbers: [f32; NUMBERS.len()],
}

impl State {
    pub(super) const AT_REST: Self = Self { buttons: [false; BUTTONS.len()], numbers: [0.0; NUMBERS.len()] };

    pub(super) fn number(&self, number: Number) -> f32 {
        self.numbers[number as usize]
    }

    pub(super) fn set(&mut self, number: Number, value: f32) {
        self.numbers[number as usize] = value;
    }

    /// Takes what an input is now: −1 to 1, of keys 0 or 1.
    pub(super) fn take(&mut self, binding: &Binding, value: f32) {
        let is_trigger = |number| matches!(number, Number::LeftTrigger | Number::RightTrigger);
        let (value, from) = match binding.from {
            From::Key(_) => (value, Half::Positive),
            From::Axis { half, is_inverted, .. } => {
                let value = if is_inverted { -value } else { value };
                match half {
                    Half::Whole => (value, half),
                    Half::Positive => (value.max(0.0), half),
                    Half::Negative => ((-value).max(0.0), half),
                }
            }
        };
        match binding.to {
            // Of a whole axis, beyond the middle.
            To::Button(place) => self.buttons[place] = value > 0.5,
            To::Number(number, half) => {
                let value = match (from, half) {
                    // A trigger's rest is its axis' end.
                    (Half::Whole, _) if is_trigger(number) => f32::midpoint(value, 1.0),
                    (_, Half::Negative) => -value,
                    // A key or half an axis, over the whole way of a stick.
                    (Half::Positive | Half::Negative, Half::Whole) if !is_trigger(number) => {
                        2.0 * value - 1.0
                    }
                    _ => value,
                };
                // Two halves of a stick are two inputs: the one at rest must not undo the other.
                let own = &mut self.numbers[number as usize];
                let undone = match half {
                    Half::Whole => false,
                    Half::Positive => value == 0.0 && *own < 0.0,
                    Half::Negative => value == 0.0 && *own > 0.0,
                };
                if !undone {
                    *own = value;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gamepad::database::{SHIPPED, guid, lines, look_up};

    /// As the driver xpad has them.
    pub(super) fn xbox() -> Codes {
        Codes {
            keys: vec![0x130, 0x131, 0x133, 0x134, 0x136, 0x137, 0x13a, 0x13b, 0x13c, 0x13d, 0x13e],
            axes: vec![0, 1, 2, 3, 4, 5, 0x10, 0x11],
        }
    }

    fn place(name: &str) -> usize {
        BUTTONS.iter().position(|(own, _)| *own == name).unwrap()
    }

    /// The database and the kernel's rules are two sources: they say the same of the pad that both know best.
    #[test]
    fn the_database_and_the_rules_agree_on_an_xbox_pad() {
        let codes = xbox();
        let (line, _) = look_up(SHIPPED, &guid(3, 0x045e, 0x028e, 0x0114, "")).unwrap();
        let (known, rule) = (Layout::by_line(&line, &codes), Layout::by_rule(&codes, true));
        for binding in &rule.bindings {
            assert!(known.bindings.contains(binding), "{binding:?} is not in {known:?}");
        }
        assert_eq!(known.bindings.len(), rule.bindings.len());
        assert_eq!(known.streams().len(), 2 + 2 + 15);
    }

    #[test]
    fn gilrs_is_told_by_its_own_counting_and_the_rest_stays() {
        let bind = |from, to| Binding { from, to };
        let axis = |axis, half, is_inverted| From::Axis { axis, half, is_inverted };
        let (whole, stick) = (Half::Whole, To::Number(Number::LeftX, Half::Whole));
        let kept = [
            bind(axis(1, whole, true), To::Number(Number::LeftY, whole)),
            bind(axis(2, Half::Positive, false), To::Button(place("dpad/right"))),
            bind(axis(2, Half::Negative, false), To::Button(place("dpad/left"))),
            bind(From::Key(0x2c0), To::Button(place("paddle_left"))),
        ];
        let told = [
            bind(From::Key(0x130), To::Button(place("south"))),
            bind(From::Key(0x1), To::Button(place("start"))),
            bind(axis(0, whole, false), stick),
            bind(axis(0x10, Half::Negative, false), To::Button(place("dpad/left"))),
            bind(axis(0x10, Half::Positive, false), To::Button(place("dpad/right"))),
            bind(axis(5, whole, false), To::Number(Number::RightTrigger, whole)),
        ];
        let codes = Codes { keys: vec![0x1, 0x100, 0x130, 0x2c0], axes: vec![0, 1, 2, 5, 0x10, 0x11] };
        let layout = Layout { bindings: [&told[..], &kept[..]].concat() };
        let (line, rest) = layout.for_gilrs(&guid(3, 1, 2, 3, ""), &codes);
        // gilrs counts 0x100 first, then joystick buttons, then keys.
        let elements = "a:b1,start:b3,leftx:a0,dpleft:h0.8,dpright:h0.2,righttrigger:a3,";
        assert_eq!(line, format!("03000000010000000200000003000000,pad,{elements}platform:Linux,"));
        assert_eq!(rest, kept);
        assert!(lines(&line).all(|line| line.is_ok()), "SDL's format as well");
    }

    #[test]
    fn every_line_of_the_database_makes_streams_without_a_panic() {
        let codes = Codes { keys: (0x100..0x2ff).collect(), axes: (0..0x3f).collect() };
        let mut most = 0;
        for line in lines(SHIPPED).filter_map(Result::ok) {
            let layout = Layout::by_line(&line, &codes);
            most = most.max(layout.streams().len());
            let mut state = State::AT_REST;
            for binding in &layout.bindings {
                for value in [-1.0, 0.0, 1.0] {
                    state.take(binding, value);
                }
            }
            assert!(state.numbers.iter().all(|number| number.abs() <= 1.0), "{line:?} {state:?}");
        }
        assert!(most >= 20);
    }

    #[test]
    fn ways_are_read_whole_half_and_the_other_way_round() {
        let axis = |half, is_inverted| From::Axis { axis: 0, half, is_inverted };
        let number = |number, half| To::Number(number, half);
        for (from, to, values) in [
            (axis(Half::Whole, false), number(Number::LeftX, Half::Whole), [-1.0, 0.0, 1.0]),
            (axis(Half::Whole, true), number(Number::LeftX, Half::Whole), [1.0, 0.0, -1.0]),
            (axis(Half::Whole, false), number(Number::LeftTrigger, Half::Whole), [0.0, 0.5, 1.0]),
            (axis(Half::Positive, false), number(Number::LeftTrigger, Half::Whole), [0.0, 0.0, 1.0]),
            (axis(Half::Negative, false), number(Number::LeftTrigger, Half::Whole), [1.0, 0.0, 0.0]),
            (axis(Half::Positive, false), number(Number::LeftX, Half::Negative), [0.0, 0.0, -1.0]),
        ] {
            for (input, expected) in [-1.0, 0.0, 1.0].into_iter().zip(values) {
                let mut state = State::AT_REST;
                let To::Number(which, _) = to else { unreachable!() };
                state.take(&Binding { from, to }, input);
                assert_eq!(state.number(which), expected, "{from:?} {to:?} {input}");
            }
        }
        let mut state = State::AT_REST;
        let up = Binding { from: axis(Half::Negative, false), to: To::Button(place("dpad/up")) };
        state.take(&up, -1.0);
        assert!(state.buttons[place("dpad/up")]);
        state.take(&up, 1.0);
        assert!(!state.buttons[place("dpad/up")]);
    }

    #[test]
    fn the_half_at_rest_does_not_undo_the_other() {
        let half = |key, half| Binding { from: From::Key(key), to: To::Number(Number::RightX, half) };
        let (left, right) = (half(1, Half::Negative), half(2, Half::Positive));
        let mut state = State::AT_REST;
        state.take(&left, 1.0);
        state.take(&right, 0.0);
        assert_eq!(state.number(Number::RightX), -1.0);
        state.take(&left, 0.0);
        assert_eq!(state.number(Number::RightX), 0.0);
    }
}
