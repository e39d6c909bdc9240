//! What can be bound: the names of inputs, and what is printed on the buttons of common pads.

/// What an input says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InputKind {
    /// Down or not.
    Button,
    /// −1 to 1, or 0 to 1.
    Axis,
    /// Two numbers.
    Vector,
    /// Where something is.
    Pose,
    /// What is pointed at.
    Pick,
    /// What is typed.
    Text,
    /// A device's own: whatever it says.
    Any,
}

/// Whose words a menu uses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Layout {
    /// Xbox pads.
    #[default]
    Xbox,
    /// PlayStation pads.
    PlayStation,
}

use InputKind::{Any, Axis, Button, Pick, Pose, Text, Vector};

/// Name, kind, and what it is called on Xbox and PlayStation pads. Buttons are named by where they are, so that a binding holds on
/// any pad.
const PAD: [(&str, InputKind, &str, &str); 24] = [
    ("pad.south", Button, "A", "Cross"),
    ("pad.east", Button, "B", "Circle"),
    ("pad.west", Button, "X", "Square"),
    ("pad.north", Button, "Y", "Triangle"),
    ("pad.left_shoulder", Button, "LB", "L1"),
    ("pad.right_shoulder", Button, "RB", "R1"),
    ("pad.left_trigger", Axis, "LT", "L2"),
    ("pad.right_trigger", Axis, "RT", "R2"),
    ("pad.left_stick", Vector, "Left stick", "Left stick"),
    ("pad.right_stick", Vector, "Right stick", "Right stick"),
    ("pad.left_stick.click", Button, "LS", "L3"),
    ("pad.right_stick.click", Button, "RS", "R3"),
    ("pad.dpad", Vector, "D-pad", "D-pad"),
    ("pad.dpad.up", Button, "D-pad up", "D-pad up"),
    ("pad.dpad.down", Button, "D-pad down", "D-pad down"),
    ("pad.dpad.left", Button, "D-pad left", "D-pad left"),
    ("pad.dpad.right", Button, "D-pad right", "D-pad right"),
    ("pad.start", Button, "Menu", "Options"),
    ("pad.select", Button, "View", "Create"),
    ("pad.guide", Button, "Xbox", "PS"),
    ("pad.touchpad", Vector, "Touchpad", "Touchpad"),
    ("pad.touchpad.click", Button, "Touchpad", "Touchpad"),
    ("pad.paddle_left", Button, "P1", "Left paddle"),
    ("pad.paddle_right", Button, "P2", "Right paddle"),
];

const OTHERS: [(&str, InputKind); 18] = [
    ("mouse.left", Button),
    ("mouse.right", Button),
    ("mouse.middle", Button),
    ("mouse.move", Vector),
    ("mouse.position", Vector),
    ("mouse.wheel", Axis),
    ("touch.down", Button),
    ("touch.position", Vector),
    ("head", Pose),
    ("gaze", Pose),
    ("hit", Pick),
    ("text", Text),
    ("hand.left.aim", Pose),
    ("hand.left.grip", Pose),
    ("hand.right.aim", Pose),
    ("hand.right.grip", Pose),
    ("body.left_foot", Pose),
    ("body.right_foot", Pose),
];

/// Of both hands, behind `hand.left.` and `hand.right.`.
const HAND: [(&str, InputKind); 7] = [
    ("trigger", Axis),
    ("squeeze", Axis),
    ("thumbstick", Vector),
    ("thumbstick.click", Button),
    ("primary", Button),
    ("secondary", Button),
    ("menu", Button),
];

/// Buttons of a mouse beyond three: only for who asks for them, since desktops and browsers use them too.
const EXTRA_MOUSE: [&str; 5] =
    ["mouse.back", "mouse.forward", "mouse.button6", "mouse.button7", "mouse.button8"];

/// Names are at most this long, bytes.
const LONGEST: usize = 64;

/// What the input called `name` says; `None` for no input. Besides the listed ones there are every key (`key.a`,
/// `key.left_shift`), the components of vectors (`pad.left_stick.x`), and devices' own (`device.` and any name of lower case letters,
/// digits, `_`, `.`).
pub fn input_kind(name: &str) -> Option<InputKind> {
    let is_word = |word: &str| {
        !word.is_empty()
            && name.len() <= LONGEST
            && word.bytes().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == b'_')
    };
    if let Some((_, kind, ..)) = PAD.iter().find(|(own, ..)| *own == name) {
        return Some(*kind);
    }
    if let Some((_, kind)) = OTHERS.iter().find(|(own, _)| *own == name) {
        return Some(*kind);
    }
    if EXTRA_MOUSE.contains(&name) {
        return Some(Button);
    }
    if let Some(key) = name.strip_prefix("key.") {
        return is_word(key).then_some(Button);
    }
    if let Some(rest) = name.strip_prefix("device.") {
        return rest.split('.').all(is_word).then_some(Any);
    }
    if let Some(control) = name.strip_prefix("hand.left.").or_else(|| name.strip_prefix("hand.right."))
        && let Some((_, kind)) = HAND.iter().find(|(own, _)| *own == control)
    {
        return Some(*kind);
    }
    let (whole, _) = component(name)?;
    (input_kind(whole)? == Vector).then_some(Axis)
}

/// The vector and the place of its component that `name` stands for: `pad.left_stick.x`.
pub(crate) fn component(name: &str) -> Option<(&str, usize)> {
    let split = |end| name.strip_suffix(end).filter(|whole| input_kind(whole) == Some(Vector));
    split(".x").map(|whole| (whole, 0)).or_else(|| split(".y").map(|whole| (whole, 1)))
}

/// Whether it is one of the extra buttons of a mouse.
pub(crate) fn is_extra_mouse_button(name: &str) -> bool {
    EXTRA_MOUSE.contains(&name)
}

/// What people call it: what is printed on a pad of that layout, else its name.
pub fn label(name: &str, layout: Layout) -> &str {
    let row = PAD.iter().find(|(own, ..)| *own == name);
    row.map_or(name, |(_, _, xbox, playstation)| match layout {
        Layout::Xbox => xbox,
        Layout::PlayStation => playstation,
    })
}

/// The input that is printed so on a pad of that layout: `A` is `pad.south`, `Circle` is `pad.east`.
pub fn labelled(text: &str, layout: Layout) -> Option<&'static str> {
    PAD.iter().map(|row| row.0).find(|name| label(name, layout).eq_ignore_ascii_case(text))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inputs_have_kinds_and_labels() {
        for (name, kind) in [
            ("pad.south", Some(Button)),
            ("pad.left_stick.y", Some(Axis)),
            ("pad.left_stick.z", None),
            ("pad.south.x", None),
            ("hand.left.thumbstick.x", Some(Axis)),
            ("hand.middle.trigger", None),
            ("key.left_shift", Some(Button)),
            ("key.", None),
            ("key.A", None),
            ("device.spacemouse.x", Some(Any)),
            ("mouse.forward", Some(Button)),
            ("", None),
        ] {
            assert_eq!(input_kind(name), kind, "{name}");
        }
        assert_eq!(
            (label("pad.south", Layout::Xbox), label("pad.south", Layout::PlayStation)),
            ("A", "Cross")
        );
        assert_eq!(labelled("circle", Layout::PlayStation), Some("pad.east"));
        assert_eq!(label("key.a", Layout::Xbox), "key.a");
    }
}
