//! Which control of which device has which path: one table per interaction profile.
//!
//! Source of the paths: OpenXR 1.1 specification, "Interaction Profile Paths" (simple, Touch, Index, Vive, Windows
//! Mixed Reality) and XR_EXT_hand_interaction.

use vergence_sense::Hand;

use crate::{Action, Control, Kind};

/// A device, as OpenXR knows it.
#[derive(Debug, PartialEq, Eq)]
pub struct Profile {
    /// For people.
    pub name: &'static str,
    /// OpenXR's path of the profile.
    pub path: &'static str,
    /// Extension without which the runtime refuses the profile.
    pub extension: Option<&'static str>,
    components: &'static [Component],
}

/// One component of a device.
#[derive(Debug, PartialEq, Eq)]
struct Component {
    control: Control,
    /// The path below the hand where a pressed-or-not is wanted; for poses and pulses the only path.
    digital: &'static str,
    /// The path where a range or a direction is wanted; none where the device has no such thing.
    analog: Option<&'static str>,
    /// Which hands have it.
    hands: &'static [Hand],
}

/// A proposal to a runtime: this action follows this component.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Suggestion {
    /// Place of the action in the slice that was given.
    pub action: usize,
    /// Whose component.
    pub hand: Hand,
    /// The component, below the hand's path.
    pub component: &'static str,
}

impl Suggestion {
    /// The component's full path.
    pub fn path(&self) -> String {
        format!("/user/hand/{}/{}", self.hand.name(), self.component)
    }
}

/// What to propose to a runtime for the device `profile`, so that each of `actions` can be done with it. Actions for
/// which the device has nothing are left out. A pressed-or-not on a range is left to the runtime's own threshold,
/// which knows the device; a range on a pressed-or-not is 0 or 1, as OpenXR converts it.
pub fn suggestions<'a>(
    profile: &'static Profile,
    actions: &'a [Action],
) -> impl Iterator<Item = Suggestion> + 'a {
    actions.iter().enumerate().flat_map(move |(index, action)| {
        let components = profile.components.iter().filter(move |c| c.control == action.control);
        components.flat_map(move |component| {
            let path = match action.kind {
                Kind::Pose | Kind::Haptic | Kind::Button => Some(component.digital),
                Kind::Axis => Some(component.analog.unwrap_or(component.digital)),
                Kind::Vector2 => component.analog,
            };
            path.into_iter().flat_map(move |component_path| {
                component.hands.iter().map(move |&hand| Suggestion {
                    action: index,
                    hand,
                    component: component_path,
                })
            })
        })
    })
}

const BOTH: &[Hand] = &[Hand::Left, Hand::Right];
const LEFT: &[Hand] = &[Hand::Left];
const RIGHT: &[Hand] = &[Hand::Right];

const fn only(control: Control, digital: &'static str, hands: &'static [Hand]) -> Component {
    Component { control, digital, analog: None, hands }
}

const fn both(control: Control, digital: &'static str, analog: &'static str) -> Component {
    Component { control, digital, analog: Some(analog), hands: BOTH }
}

const AIM: Component = only(Control::Aim, "input/aim/pose", BOTH);
const GRIP: Component = only(Control::Grip, "input/grip/pose", BOTH);
const HAPTIC: Component = only(Control::Haptic, "output/haptic", BOTH);
const STICK: Component = both(Control::Thumbstick, "input/thumbstick/click", "input/thumbstick");
const STICK_CLICK: Component = only(Control::ThumbstickClick, "input/thumbstick/click", BOTH);
const MENU: Component = only(Control::Menu, "input/menu/click", BOTH);

/// Every device that is known, the most capable first; the simplest, which every runtime has, last.
pub static PROFILES: [Profile; 6] = [
    Profile {
        name: "Meta Touch",
        path: "/interaction_profiles/oculus/touch_controller",
        extension: None,
        components: &[
            AIM,
            GRIP,
            HAPTIC,
            both(Control::Trigger, "input/trigger/value", "input/trigger/value"),
            both(Control::Squeeze, "input/squeeze/value", "input/squeeze/value"),
            STICK,
            STICK_CLICK,
            only(Control::Primary, "input/x/click", LEFT),
            only(Control::Primary, "input/a/click", RIGHT),
            only(Control::Secondary, "input/y/click", LEFT),
            only(Control::Secondary, "input/b/click", RIGHT),
            // The right one belongs to the system.
            only(Control::Menu, "input/menu/click", LEFT),
        ],
    },
    Profile {
        name: "Valve Index",
        path: "/interaction_profiles/valve/index_controller",
        extension: None,
        components: &[
            AIM,
            GRIP,
            HAPTIC,
            both(Control::Trigger, "input/trigger/click", "input/trigger/value"),
            both(Control::Squeeze, "input/squeeze/value", "input/squeeze/value"),
            STICK,
            STICK_CLICK,
            only(Control::Primary, "input/a/click", BOTH),
            only(Control::Secondary, "input/b/click", BOTH),
        ],
    },
    Profile {
        name: "HTC Vive",
        path: "/interaction_profiles/htc/vive_controller",
        extension: None,
        components: &[
            AIM,
            GRIP,
            HAPTIC,
            both(Control::Trigger, "input/trigger/click", "input/trigger/value"),
            only(Control::Squeeze, "input/squeeze/click", BOTH),
            both(Control::Thumbstick, "input/trackpad/click", "input/trackpad"),
            only(Control::ThumbstickClick, "input/trackpad/click", BOTH),
            MENU,
        ],
    },
    Profile {
        name: "Windows Mixed Reality",
        path: "/interaction_profiles/microsoft/motion_controller",
        extension: None,
        components: &[
            AIM,
            GRIP,
            HAPTIC,
            both(Control::Trigger, "input/trigger/value", "input/trigger/value"),
            only(Control::Squeeze, "input/squeeze/click", BOTH),
            STICK,
            STICK_CLICK,
            MENU,
        ],
    },
    Profile {
        name: "bare hands",
        path: "/interaction_profiles/ext/hand_interaction_ext",
        extension: Some("XR_EXT_hand_interaction"),
        components: &[
            AIM,
            GRIP,
            both(Control::Trigger, "input/aim_activate_ext/value", "input/aim_activate_ext/value"),
            both(Control::Squeeze, "input/grasp_ext/value", "input/grasp_ext/value"),
        ],
    },
    Profile {
        name: "simple controller",
        path: "/interaction_profiles/khr/simple_controller",
        extension: None,
        components: &[AIM, GRIP, HAPTIC, only(Control::Trigger, "input/select/click", BOTH), MENU],
    },
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::POINT_AND_GRASP;

    #[test]
    fn paths_are_well_formed_and_no_action_is_bound_twice_to_one() {
        for profile in &PROFILES {
            assert!(profile.path.starts_with("/interaction_profiles/"), "{}", profile.name);
            let mut seen = std::collections::BTreeSet::new();
            for suggestion in suggestions(profile, &POINT_AND_GRASP) {
                let is_output = POINT_AND_GRASP[suggestion.action].kind == Kind::Haptic;
                let wanted = if is_output { "/output/" } else { "/input/" };
                assert!(suggestion.path().contains(wanted), "{}", suggestion.path());
                assert!(seen.insert((suggestion.action, suggestion.path())), "{}", suggestion.path());
            }
        }
    }

    /// A direction needs a component with two coordinates: none is proposed for a device without one.
    #[test]
    fn a_direction_is_never_bound_to_a_button() {
        for profile in &PROFILES {
            for suggestion in suggestions(profile, &POINT_AND_GRASP) {
                if POINT_AND_GRASP[suggestion.action].kind == Kind::Vector2 {
                    assert!(["input/thumbstick", "input/trackpad"].contains(&suggestion.component));
                }
            }
        }
    }

    #[test]
    fn the_menu_of_touch_is_left_only() {
        let menu = POINT_AND_GRASP.iter().position(|a| a.name == "menu").unwrap();
        let hands: Vec<Hand> = suggestions(&PROFILES[0], &POINT_AND_GRASP)
            .filter(|s| s.action == menu)
            .map(|s| s.hand)
            .collect();
        assert_eq!(hands, [Hand::Left]);
    }
}
