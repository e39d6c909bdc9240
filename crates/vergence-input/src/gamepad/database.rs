//! SDL's database of gamepads: a line for each, saying which of its buttons, axes and hats is where.
//!
//! Source of the format: SDL 2 and 3, "SDL_GameControllerDB"; the order in which the numbers count a node's buttons and axes
//! is that of SDL's Linux driver.

use std::fmt;

/// What is built in.
pub const SHIPPED: &str = include_str!("../../mappings/sdl/gamecontrollerdb.txt");
/// Longer lines than this there are none.
const LONGEST: usize = 4096;

/// Which part of a way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Half {
    /// All of it.
    Whole,
    /// From the middle up.
    Positive,
    /// From the middle down.
    Negative,
}

/// An input of the device, by SDL's numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Input {
    /// The button with this number.
    Button(u8),
    /// The axis with this number.
    Axis {
        /// Its number.
        axis: u8,
        /// The part of it.
        half: Half,
        /// The other way round.
        is_inverted: bool,
    },
    /// A direction of a hat: 1 up, 2 right, 4 down, 8 left.
    Hat(u8, u8),
}

/// What a line says: this input is that element.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Binding<'a> {
    /// SDL's word: `a`, `leftx`, `dpup`, …
    pub element: &'a str,
    /// The part of the element that the input moves.
    pub half: Half,
    /// What moves it.
    pub input: Input,
}

/// A line of the database.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Line<'a> {
    /// Bus, checksum of the name, vendor, product, version, as the system has them; `None` for a name instead of 16 bytes (`xinput`).
    pub guid: Option<[u8; 16]>,
    /// For people.
    pub name: &'a str,
    /// `Linux`, `Windows`, …; empty where it is not said.
    pub platform: &'a str,
    /// In the order of the line.
    pub bindings: Vec<Binding<'a>>,
}

/// A line that is none.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wrong {
    /// Its number, from 1.
    pub line: usize,
    /// What was expected there.
    pub expected: &'static str,
    /// What was found.
    pub found: String,
}

impl fmt::Display for Wrong {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}: expected {}, found '{}'", self.line, self.expected, self.found)
    }
}

/// The lines of a database, each with its number; comments and empty lines are left out.
pub fn lines(text: &str) -> impl Iterator<Item = Result<Line<'_>, Wrong>> {
    text.lines().enumerate().filter_map(|(index, line)| {
        let line = line.trim();
        (!line.is_empty() && !line.starts_with('#')).then(|| parse(index + 1, line))
    })
}

/// The line for a device with these 16 bytes, and whether it is for this version of it; else the first for another version.
pub fn look_up<'a>(text: &'a str, guid: &[u8; 16]) -> Option<(Line<'a>, bool)> {
    let candidates = lines(text).filter_map(Result::ok).filter(|line| {
        let Some(own) = line.guid else { return false };
        (line.platform == "Linux" || line.platform.is_empty())
            // Checksums are of the names, which differ between kernels.
            && own[..2] == guid[..2]
            && own[4..12] == guid[4..12]
    });
    let mut any = None;
    for line in candidates {
        if line.guid.is_some_and(|own| own[12..] == guid[12..]) {
            return Some((line, true));
        }
        any = any.or(Some((line, false)));
    }
    // Without vendor and product, the bytes are of the name, and all of them count.
    any.filter(|_| guid[4..6] != [0; 2] && guid[6..8] == [0; 2])
}

/// The 16 bytes of a device on Linux.
pub fn guid(bus: u16, vendor: u16, product: u16, version: u16, name: &str) -> [u8; 16] {
    let mut guid = guid_of_numbers(bus, vendor, product, version);
    if vendor == 0 || product == 0 {
        guid[4..].fill(0);
        for (to, from) in guid[4..15].iter_mut().zip(name.bytes()) {
            *to = from;
        }
    }
    guid
}

/// The 16 bytes of these numbers, as gilrs has them for every device.
pub(super) fn guid_of_numbers(bus: u16, vendor: u16, product: u16, version: u16) -> [u8; 16] {
    let mut guid = [0; 16];
    for (at, number) in [(0, bus), (4, vendor), (8, product), (12, version)] {
        guid[at..at + 2].copy_from_slice(&number.to_le_bytes());
    }
    guid
}

fn parse(number: usize, line: &str) -> Result<Line<'_>, Wrong> {
    let wrong =
        |expected, found: &str| Wrong { line: number, expected, found: found.chars().take(40).collect() };
    if line.len() > LONGEST {
        return Err(wrong("at most 4096 bytes", line));
    }
    let mut parts = line.split(',');
    let id = parts.next().unwrap_or_default();
    let guid = hex(id);
    let is_word = !id.is_empty()
        && id.len() < 32
        && id.bytes().all(|c| c.is_ascii_alphanumeric() || c == b'_' || c == b'*');
    if guid.is_none() && !is_word {
        return Err(wrong("32 hexadecimal digits", id));
    }
    let name = parts.next().ok_or_else(|| wrong("a name behind a comma", line))?;
    let mut parsed = Line { guid, name, platform: "", bindings: Vec::new() };
    for part in parts {
        let part = part.trim();
        if part.is_empty() {
            continue;
        }
        let (key, value) =
            part.split_once(':').ok_or_else(|| wrong("an element, a colon, an input", part))?;
        match key {
            "platform" => parsed.platform = value,
            // Of SDL's own settings, of no matter for where a button is.
            "hint" | "crc" | "type" | "face" | "sdk>=" | "sdk<=" => {}
            _ => {
                let (half, element) = match key.as_bytes().first() {
                    Some(b'+') => (Half::Positive, &key[1..]),
                    Some(b'-') => (Half::Negative, &key[1..]),
                    _ => (Half::Whole, key),
                };
                if element.is_empty() || !element.bytes().all(|c| c.is_ascii_alphanumeric() || c == b'_') {
                    return Err(wrong("the name of an element", key));
                }
                let input =
                    input(value).ok_or_else(|| wrong("an input such as b0, a1, -a2, a3~, h0.4", part))?;
                parsed.bindings.push(Binding { element, half, input });
            }
        }
    }
    Ok(parsed)
}

fn hex(text: &str) -> Option<[u8; 16]> {
    if text.len() != 32 || !text.bytes().all(|c| c.is_ascii_hexdigit()) {
        return None;
    }
    let mut bytes = [0; 16];
    for (index, byte) in bytes.iter_mut().enumerate() {
        *byte = u8::from_str_radix(text.get(2 * index..2 * index + 2)?, 16).ok()?;
    }
    Some(bytes)
}

fn input(text: &str) -> Option<Input> {
    let number = |text: &str| {
        // `parse` takes a sign.
        if text.bytes().all(|c| c.is_ascii_digit()) { text.parse::<u8>().ok() } else { None }
    };
    let (half, rest) = match text.as_bytes().first()? {
        b'+' => (Half::Positive, &text[1..]),
        b'-' => (Half::Negative, &text[1..]),
        _ => (Half::Whole, text),
    };
    if let Some(axis) = rest.strip_prefix('a') {
        let (axis, is_inverted) = axis.strip_suffix('~').map_or((axis, false), |axis| (axis, true));
        return Some(Input::Axis { axis: number(axis)?, half, is_inverted });
    }
    if half != Half::Whole {
        return None;
    }
    if let Some(button) = rest.strip_prefix('b') {
        return Some(Input::Button(number(button)?));
    }
    let (hat, direction) = rest.strip_prefix('h')?.split_once('.')?;
    let (hat, direction) = (number(hat)?, number(direction)?);
    matches!(direction, 1 | 2 | 4 | 8).then_some(Input::Hat(hat, direction))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn every_line_that_is_shipped_is_read() {
        let (mut read, mut linux) = (0, 0);
        for line in lines(SHIPPED) {
            let line = line.unwrap_or_else(|wrong| panic!("{wrong}"));
            read += 1;
            linux += usize::from(line.platform == "Linux" && line.guid.is_some() && line.bindings.len() > 3);
        }
        assert!(read > 2000 && linux > 700, "{read} {linux}");
    }

    #[test]
    fn a_wrong_line_is_reported_with_its_number() {
        let good = "03000000010000000200000003000000,Pad,a:b0,leftx:a0,platform:Linux,";
        for (bad, expected) in [
            ("0300,Pad", ""),
            ("03000000010000000200000003,Pad,a:c0", "an input such as b0, a1, -a2, a3~, h0.4"),
            ("03-0,Pad,a:b0", "32 hexadecimal digits"),
            ("03000000010000000200000003000000", "a name behind a comma"),
            ("03000000010000000200000003000000,Pad,a", "an element, a colon, an input"),
            ("03000000010000000200000003000000,Pad,a:b256", "an input such as b0, a1, -a2, a3~, h0.4"),
            ("03000000010000000200000003000000,Pad,a:h0.3", "an input such as b0, a1, -a2, a3~, h0.4"),
            ("03000000010000000200000003000000,Pad,a:b+1", "an input such as b0, a1, -a2, a3~, h0.4"),
            ("03000000010000000200000003000000,Pad,é:b1", "the name of an element"),
        ] {
            let text = format!("# head\n\n{good}\n{bad}\n{good}");
            let each: Vec<_> = lines(&text).collect();
            assert_eq!(each.len(), 3);
            match &each[1] {
                Err(wrong) => assert_eq!((wrong.line, wrong.expected), (4, expected), "{bad}"),
                Ok(_) => assert_eq!(expected, "", "{bad}"),
            }
        }
    }

    #[test]
    fn a_pad_is_found_by_its_version_or_without() {
        let known = look_up(SHIPPED, &guid(3, 0x045e, 0x028e, 0x0114, "Microsoft X-Box 360 pad"));
        assert_eq!(known.map(|(line, exact)| (line.name.contains("360"), exact)), Some((true, true)));
        let other = look_up(SHIPPED, &guid(3, 0x045e, 0x028e, 0x7777, "other"));
        assert_eq!(other.map(|(_, exact)| exact), Some(false));
        assert!(look_up(SHIPPED, &guid(3, 0xfff7, 0xfff7, 1, "none")).is_none());
        assert!(look_up(SHIPPED, &guid(5, 0, 0, 1, "no pad is called this")).is_none());
    }

    proptest! {
        #[test]
        fn any_text_is_read_or_refused(text in "(03000000[0-9a-f]{24},)?[ -~é,:\n]{0,200}") {
            let count = text.lines().filter(|line| !line.trim().is_empty() && !line.trim().starts_with('#')).count();
            prop_assert_eq!(lines(&text).count(), count);
        }
    }
}
