#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod bindings;
mod curve;
mod dead_zone;
pub mod filter;
mod layout;
mod live;
mod mapper;
mod profile;
mod wiring;

pub use bindings::{Bind, Bindings, BoundAction, Chooses, Conflict, Error, Logical, Watched};
pub use curve::Curve;
pub use dead_zone::{DeadZone, DeadZoneError, Rest, Shape};
pub use layout::{InputKind, Layout, input_kind, label, labelled};
pub use live::{Change, LiveBindings};
pub use mapper::{InputId, Mapper, Reading, Value};
pub use profile::{PROFILES, Profile, Suggestion, suggestions};
pub use wiring::Wiring;

/// Something that the user can do, with either hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Action {
    /// Lower case letters, digits, `-`, `_`, `.`; unique within a set. Logs and runtimes call it so.
    pub name: &'static str,
    /// What a rebinding menu shows to people.
    pub label: &'static str,
    /// What it yields or takes.
    pub kind: Kind,
    /// What it is meant for.
    pub control: Control,
}

/// What an action yields, or takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kind {
    /// Where something is.
    Pose,
    /// Pressed or not.
    Button,
    /// 0…1.
    Axis,
    /// A direction in a plane.
    Vector2,
    /// Takes pulses that the hand feels.
    Haptic,
}

impl Kind {
    /// One word for people.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Pose => "pose",
            Self::Button => "button",
            Self::Axis => "axis",
            Self::Vector2 => "vector2",
            Self::Haptic => "haptic",
        }
    }
}

/// What an action is meant for, whatever the device calls it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Control {
    /// A ray from the hand: origin and −z.
    Aim,
    /// The palm's frame.
    Grip,
    /// The main finger: trigger, pinch, select.
    Trigger,
    /// The other fingers: squeeze, grasp.
    Squeeze,
    /// A direction for the thumb.
    Thumbstick,
    /// Pressing that.
    ThumbstickClick,
    /// The lower or only face button.
    Primary,
    /// The upper face button.
    Secondary,
    /// The menu of the application.
    Menu,
    /// The motor.
    Haptic,
}

/// Actions that belong together; a runtime is given the whole set.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ActionSet {
    /// As for [`Action::name`].
    pub name: &'static str,
    /// As for [`Action::label`].
    pub label: &'static str,
    /// Names are unique.
    pub actions: Vec<Action>,
}

/// What it takes to point at things, to take them, and to feel it.
pub const POINT_AND_GRASP: [Action; 7] = [
    Action { name: "aim", label: "Point", kind: Kind::Pose, control: Control::Aim },
    Action { name: "grip", label: "Hand", kind: Kind::Pose, control: Control::Grip },
    Action { name: "select", label: "Select", kind: Kind::Button, control: Control::Trigger },
    Action { name: "grab", label: "Grab", kind: Kind::Axis, control: Control::Squeeze },
    Action { name: "move", label: "Move", kind: Kind::Vector2, control: Control::Thumbstick },
    Action { name: "menu", label: "Menu", kind: Kind::Button, control: Control::Menu },
    Action { name: "pulse", label: "Feel", kind: Kind::Haptic, control: Control::Haptic },
];

#[cfg(test)]
mod tests {
    use super::*;

    /// OpenXR's rule for names of actions.
    #[test]
    fn names_are_well_formed_and_unique() {
        let allowed = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || "-_.".contains(c);
        for (index, action) in POINT_AND_GRASP.iter().enumerate() {
            assert!(!action.name.is_empty() && action.name.chars().all(allowed), "{}", action.name);
            assert!(POINT_AND_GRASP[..index].iter().all(|other| other.name != action.name));
        }
    }

    /// Every action of the set can be done with every device that has the control at all; nothing is left without
    /// any binding.
    #[test]
    fn every_action_is_bound_somewhere_and_aim_and_select_everywhere() {
        for action in POINT_AND_GRASP {
            let bound = |profile: &'static Profile| suggestions(profile, &[action]).count() > 0;
            assert!(PROFILES.iter().any(bound), "{}", action.name);
            if ["aim", "grip", "select"].contains(&action.name) {
                assert!(PROFILES.iter().all(bound), "{}", action.name);
            }
        }
    }
}
