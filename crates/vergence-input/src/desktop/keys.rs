//! What keys and buttons are called: as bindings name them, behind `key.` and `mouse.`, so that one word holds everywhere.

use vergence_window::PointerButton;

/// The three buttons that every mouse has.
pub(super) const BUTTONS: [&str; 3] = ["left", "right", "middle"];
/// What only who asks for them gets: desktops and browsers use them too.
pub(super) const EXTRA: [&str; 5] = ["back", "forward", "button6", "button7", "button8"];

/// The name of a key after its place on the keyboard: `KeyA` is `a`, `Digit2` is `2`, `ArrowUp` is `up`, `ShiftLeft` is
/// `left_shift`, `NumpadAdd` is `numpad_add`; `None` for what is no word.
pub(super) fn key(code: &str) -> Option<String> {
    let is_word = !code.is_empty() && code.len() <= 32 && code.bytes().all(|c| c.is_ascii_alphanumeric());
    if !is_word {
        return None;
    }
    let code =
        ["Key", "Digit", "Arrow"].iter().find_map(|kind| rest_of(code.strip_prefix(kind)?)).unwrap_or(code);
    let (code, side) = match (code.strip_suffix("Left"), code.strip_suffix("Right")) {
        (Some(rest), _) if !rest.is_empty() => (rest, "left_"),
        (_, Some(rest)) if !rest.is_empty() => (rest, "right_"),
        _ => (code, ""),
    };
    let mut name = side.to_owned();
    for (place, c) in code.chars().enumerate() {
        if c.is_ascii_uppercase() && place > 0 {
            name.push('_');
        }
        name.push(c.to_ascii_lowercase());
    }
    Some(name)
}

fn rest_of(rest: &str) -> Option<&str> {
    (!rest.is_empty()).then_some(rest)
}

/// The place of a button in [`BUTTONS`] with [`EXTRA`] behind; `None` for one that has no name. X11 counts the wheel's ways as
/// buttons 4 to 7, so that a mouse's fourth is its 8.
pub(super) fn button(button: PointerButton) -> Option<usize> {
    match button {
        PointerButton::Left => Some(0),
        PointerButton::Right => Some(1),
        PointerButton::Middle => Some(2),
        PointerButton::Other(number @ 8..=12) => Some(usize::from(number) - 8 + BUTTONS.len()),
        PointerButton::Other(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_called_as_bindings_call_them() {
        for (code, name) in [
            ("KeyA", "a"),
            ("Digit2", "2"),
            ("ArrowUp", "up"),
            ("ArrowLeft", "left"),
            ("ShiftLeft", "left_shift"),
            ("BracketRight", "right_bracket"),
            ("NumpadAdd", "numpad_add"),
            ("F12", "f12"),
            ("Space", "space"),
            ("PageDown", "page_down"),
            ("Left", "left"),
        ] {
            assert_eq!(key(code).as_deref(), Some(name), "{code}");
        }
        for no_word in ["", "Key A", "schlüssel", "Unidentified(7)"] {
            assert_eq!(key(no_word), None, "{no_word}");
        }
    }

    #[test]
    fn buttons_beyond_three_follow_them() {
        let all: Vec<&str> = BUTTONS.into_iter().chain(EXTRA).collect();
        let name = |own| button(own).map(|place| all[place]);
        assert_eq!(name(PointerButton::Middle), Some("middle"));
        assert_eq!(name(PointerButton::Other(8)), Some("back"));
        assert_eq!(name(PointerButton::Other(9)), Some("forward"));
        assert_eq!(name(PointerButton::Other(12)), Some("button8"));
        assert_eq!((name(PointerButton::Other(13)), name(PointerButton::Other(4))), (None, None));
    }
}
