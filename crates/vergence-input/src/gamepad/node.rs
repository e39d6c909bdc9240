//! The input nodes that there are, as the kernel describes them without their being opened.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::database::{self, look_up};
use super::layout::{Codes, Layout, code};
use crate::claim::is_claimed;
use crate::config::Config;
use crate::found::Found;

const SYSTEM: &str = "/sys/class/input";
/// Of input-event-codes.h: properties and buttons that tell kinds of devices apart.
const PROPERTY_ACCELEROMETER: u16 = 6;
const BTN_MOUSE: u16 = 0x110;
const BTN_JOYSTICK: u16 = 0x120;
const BTN_DIGI: u16 = 0x140;
const BTN_WHEEL: u16 = 0x150;
const BTN_DPAD_UP: u16 = 0x220;
/// Drivers that keep the kernel's rules of which button is called what.
const RULED: [&str; 4] = ["xpad", "playstation", "nintendo", "hid-steam"];
const BTN_TRIGGER_HAPPY: std::ops::Range<u16> = 0x2c0..0x2e8;

/// What a node is read as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Gamepad,
    Motion,
}

impl Kind {
    fn adapter(self) -> &'static str {
        match self {
            Self::Gamepad => "gamepad",
            Self::Motion => "motion",
        }
    }
}

/// A node, by what the system says of it.
#[derive(Clone, Debug)]
pub(super) struct Node {
    pub(super) found: Found,
    pub(super) kind: Kind,
    pub(super) codes: Codes,
    guid: [u8; 16],
    /// As gilrs has it: of the numbers, whatever they are.
    pub(super) gilrs_guid: [u8; 16],
    is_xpad: bool,
    keeps_rules: bool,
}

impl Node {
    /// Which control is where: by the lines of the configuration, else by those that are built in, else by the kernel's rules.
    /// A line for another version of the device, read by another driver perhaps, counts less than a driver that keeps the rules.
    pub(super) fn layout(&self, mappings: &[String]) -> Layout {
        let own = mappings.iter().find_map(|text| look_up(text, &self.guid));
        match own.or_else(|| look_up(database::SHIPPED, &self.guid)) {
            Some((line, is_exact)) if is_exact || !self.keeps_rules => Layout::by_line(&line, &self.codes),
            _ => Layout::by_rule(&self.codes, self.is_xpad),
        }
    }
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).map(|text| text.trim().to_owned()).unwrap_or_default()
}

/// Places of the bits in words of the machine's size, hexadecimal, the most significant first.
fn bits(text: &str) -> Vec<u16> {
    let mut places = Vec::new();
    for (index, word) in text.split_whitespace().rev().take(16).enumerate() {
        let Ok(word) = u64::from_str_radix(word, 16) else { return Vec::new() };
        let base = index * usize::BITS as usize;
        places.extend(
            (0..64).filter(|bit| word >> bit & 1 == 1).filter_map(|bit| u16::try_from(base + bit).ok()),
        );
    }
    places
}

/// What a node with these properties, keys and axes is; `None` for what is none of ours (keyboards, mice, tablets, touchpads).
fn kind(properties: &[u16], codes: &Codes) -> Option<Kind> {
    let has = |axes: std::ops::Range<u16>| axes.into_iter().all(|axis| codes.axes.contains(&axis));
    if properties.contains(&PROPERTY_ACCELEROMETER) {
        return has(0..6).then_some(Kind::Motion);
    }
    let any = |range: std::ops::Range<u16>| codes.keys.iter().any(|key| range.contains(key));
    // Pens, fingers, and what moves a pointer.
    if any(BTN_DIGI..BTN_WHEEL) || any(BTN_MOUSE..BTN_JOYSTICK) {
        return None;
    }
    let is_pad = any(BTN_JOYSTICK..BTN_DIGI) || any(BTN_DPAD_UP..BTN_DPAD_UP + 4) || any(BTN_TRIGGER_HAPPY);
    let has_way = has(0..2) || has(code::ABS_HAT0X..code::ABS_HAT0X + 2) || any(BTN_DPAD_UP..BTN_DPAD_UP + 4);
    (is_pad && has_way).then_some(Kind::Gamepad)
}

fn node(folder: &Path) -> Option<Node> {
    let event = folder.file_name()?.to_str()?;
    event.strip_prefix("event")?.parse::<u32>().ok()?;
    let device = folder.join("device");
    let id = |name: &str| u16::from_str_radix(&read(&device.join("id").join(name)), 16).unwrap_or(0);
    let mut codes = Codes {
        keys: bits(&read(&device.join("capabilities/key"))),
        axes: bits(&read(&device.join("capabilities/abs"))),
    };
    codes.keys.retain(|key| *key < code::KEY_MAX);
    codes.axes.retain(|axis| *axis < code::ABS_MAX);
    let kind = kind(&bits(&read(&device.join("properties"))), &codes)?;
    let path = PathBuf::from("/dev/input").join(event);
    let mut found = Found::new(kind.adapter(), path.to_str()?.to_owned());
    let name = read(&device.join("name"));
    let (bus, vendor, product) = (id("bustype"), id("vendor"), id("product"));
    let guid = database::guid(bus, vendor, product, id("version"), &name);
    let gilrs_guid = database::guid_of_numbers(bus, vendor, product, id("version"));
    (found.vendor_id, found.product_id) = (Some(vendor), Some(product));
    found.serial_number = Some(read(&device.join("uniq"))).filter(|uniq| !uniq.is_empty());
    if !name.is_empty() {
        found.name = name;
    }
    let driver = std::fs::read_link(device.join("device/driver")).unwrap_or_default();
    // Whoever makes the same reports has the same trouble with them.
    let driver = driver.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let (is_xpad, keeps_rules) = (driver == "xpad" || vendor == 0x045e, RULED.contains(&driver));
    Some(Node { found, kind, codes, guid, gilrs_guid, is_xpad, keeps_rules })
}

/// Every node that is read here, by its number.
pub(super) fn nodes() -> Vec<Node> {
    // In a container there may be no such folder.
    let Ok(folders) = std::fs::read_dir(SYSTEM) else { return Vec::new() };
    let mut nodes: Vec<Node> = folders.flatten().filter_map(|folder| node(&folder.path())).collect();
    nodes.sort_by_key(|node| (node.found.path.len(), node.found.path.clone()));
    nodes
}

pub(super) const NO_UDEV: &str = "gilrs finds gamepads through udev, which does not run here";

/// gilrs asks udev which nodes are gamepads, or, told so, looks itself.
pub(super) fn gilrs_finds_pads() -> bool {
    let is_there = |path: &str| Path::new(path).exists();
    is_there("/run/udev/control") || is_there("/.flatpak-info") || std::env::var("GILRS_DISABLE_UDEV").is_ok()
}

/// The names of all input nodes, each with the place of its device in the system, which no later device has.
pub(super) fn present() -> BTreeMap<String, PathBuf> {
    let Ok(folders) = std::fs::read_dir(SYSTEM) else { return BTreeMap::new() };
    let events = folders.flatten().filter_map(|folder| {
        let name = folder.file_name().into_string().ok().filter(|name| name.starts_with("event"))?;
        Some((format!("/dev/input/{name}"), std::fs::read_link(folder.path()).ok()?))
    });
    events.collect()
}

/// Gamepads, and inertial units in them.
pub fn found(config: &Config) -> Vec<Found> {
    let describe = |node: Node| {
        let mut found = node.found.clone();
        found.streams = match node.kind {
            Kind::Gamepad => node
                .layout(&config.gamepad_mappings)
                .streams()
                .into_iter()
                .map(|(stream, _)| stream.name)
                .collect(),
            Kind::Motion => vec!["imu".to_owned()],
        };
        found.check_access("input");
        if found.problem.is_none() && node.kind == Kind::Gamepad && !gilrs_finds_pads() {
            found.problem = Some(NO_UDEV.to_owned());
            found.remedy = Some("export GILRS_DISABLE_UDEV=1".to_owned());
        }
        found
    };
    nodes().into_iter().map(describe).collect()
}

/// The node that `device` has now: at its path, else one of the same kind that nobody of this process reads.
pub(super) fn look_up_node(device: &Found) -> Option<Node> {
    let nodes = nodes();
    let mut same =
        nodes.iter().filter(|node| node.found.is_same_device(device) && !is_claimed(&node.found.path));
    let at_path = same.clone().find(|node| node.found.path == device.path);
    at_path.or_else(|| same.next()).cloned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_read_from_the_end() {
        assert_eq!(bits("1 8000000000000001"), [0, 63, 64]);
        assert_eq!(bits("0"), [0u16; 0]);
        assert_eq!(bits("zz"), [0u16; 0]);
    }

    #[test]
    fn pads_are_told_from_everything_else() {
        let kind_of = |properties: &[u16], keys: &[u16], axes: &[u16]| {
            kind(properties, &Codes { keys: keys.to_vec(), axes: axes.to_vec() })
        };
        assert_eq!(kind_of(&[], &[0x130, 0x131], &[0, 1, 3, 4]), Some(Kind::Gamepad));
        assert_eq!(kind_of(&[], &[0x120, 0x121], &[0, 1]), Some(Kind::Gamepad), "a joystick");
        assert_eq!(kind_of(&[], &[0x220, 0x221, 0x222, 0x223, 0x130], &[]), Some(Kind::Gamepad), "no stick");
        assert_eq!(kind_of(&[6], &[], &[0, 1, 2, 3, 4, 5]), Some(Kind::Motion));
        assert_eq!(kind_of(&[6], &[], &[0, 1, 2]), None, "no gyroscope");
        assert_eq!(kind_of(&[], &[0x110, 0x111, 0x112], &[]), None, "a mouse");
        assert_eq!(kind_of(&[0], &[0x110, 0x145, 0x14a], &[0, 1, 0x35, 0x36]), None, "a touchpad");
        assert_eq!(kind_of(&[1], &[0x140, 0x14a, 0x14b], &[0, 1, 0x18]), None, "a tablet");
        assert_eq!(kind_of(&[], &(1..0xf8).collect::<Vec<_>>(), &[]), None, "a keyboard");
        assert_eq!(kind_of(&[], &[0x130], &[]), None, "a remote control");
    }
}
