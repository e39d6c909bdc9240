//! The interaction profiles that applications may suggest bindings for, and which control of the simulated
//! controllers each of their components reads.

use std::sync::OnceLock;

use openxr_sys::ActionType;

use crate::action::EYES;
use crate::extension::Extension;
use crate::instance::Instance;
use crate::motion::Controller;

/// An interaction profile.
#[derive(Debug)]
pub(crate) struct InteractionProfile {
    pub path: &'static str,
    pub title: &'static str,
    /// The minor version of core OpenXR 1 that it came with.
    pub since_minor: u16,
    /// The extension that it came with, where it is none of the core.
    pub extension: Option<Extension>,
    pub components: Vec<Component>,
}

/// That of the eyes (XR_EXT_eye_gaze_interaction).
pub(crate) const GAZE: &str = "/interaction_profiles/ext/eye_gaze_interaction";

impl InteractionProfile {
    /// Whether an application with this instance may suggest bindings for it.
    pub(crate) fn is_offered(&self, instance: &Instance) -> bool {
        self.since_minor <= instance.minor && self.extension.is_none_or(|extension| instance.has(extension))
    }
}

/// One input or output of an interaction profile.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Component {
    /// The top-level user path.
    pub user: &'static str,
    /// From the user path on, such as `/input/trigger/value`.
    pub subpath: &'static str,
    pub kind: ActionType,
    pub since_minor: u16,
}

/// Every profile of core OpenXR 1.0 and 1.1, and that of the eyes.
pub(crate) fn profiles() -> &'static [InteractionProfile] {
    static PROFILES: OnceLock<Vec<InteractionProfile>> = OnceLock::new();
    PROFILES.get_or_init(|| parse(include_str!("../interaction/profiles.txt")))
}

/// The profile of this path.
pub(crate) fn profile(path: &str) -> Option<&'static InteractionProfile> {
    profiles().iter().find(|profile| profile.path == path)
}

/// The order in which a profile stands in for the controllers where the application has no suggestion for theirs.
pub(crate) const STAND_INS: [&str; 5] = [
    "/interaction_profiles/oculus/touch_controller",
    "/interaction_profiles/valve/index_controller",
    "/interaction_profiles/htc/vive_controller",
    "/interaction_profiles/microsoft/motion_controller",
    "/interaction_profiles/khr/simple_controller",
];

fn parse(text: &'static str) -> Vec<InteractionProfile> {
    let mut profiles: Vec<InteractionProfile> = Vec::new();
    let minor = |version: &str| if version == "1.0" { 0 } else { 1 };
    for line in text.lines().filter(|line| !line.is_empty() && !line.starts_with('#')) {
        if let Some(rest) = line.strip_prefix("profile ") {
            let mut words = rest.splitn(3, ' ');
            let (Some(version), Some(path), Some(title)) = (words.next(), words.next(), words.next()) else {
                continue;
            };
            profiles.push(InteractionProfile {
                path,
                title,
                since_minor: if version == "1.1" { 1 } else { 0 },
                extension: Extension::named(version),
                components: Vec::new(),
            });
        } else if let Some(profile) = profiles.last_mut() {
            let mut words = line.split(' ');
            let (Some(users), Some(subpath), Some(kind)) = (words.next(), words.next(), words.next()) else {
                continue;
            };
            let since_minor = words.next().map_or(profile.since_minor, minor);
            let kind = match kind {
                "boolean" => ActionType::BOOLEAN_INPUT,
                "float" => ActionType::FLOAT_INPUT,
                "vector2" => ActionType::VECTOR2F_INPUT,
                "pose" => ActionType::POSE_INPUT,
                _ => ActionType::VIBRATION_OUTPUT,
            };
            profile.components.extend(users.split('+').map(|user| {
                let user = match user {
                    "left" => "/user/hand/left",
                    "right" => "/user/hand/right",
                    "head" => "/user/head",
                    "eyes" => EYES,
                    _ => "/user/gamepad",
                };
                Component { user, subpath, kind, since_minor }
            }));
        }
    }
    profiles
}

/// What a component of a controller reads now; booleans are 0 or 1, scalars are in the first element.
pub(crate) fn read(controller: &Controller, subpath: &str) -> [f32; 2] {
    let mut names = subpath.trim_start_matches("/input/").splitn(2, '/');
    let (input, component) = (names.next().unwrap_or_default(), names.next().unwrap_or_default());
    let on = |pressed: bool| [f32::from(u8::from(pressed)), 0.0];
    /// From here on a pulled trigger counts as a click.
    const CLICKED: f32 = 0.5;
    let analog = |value: f32, touched: bool| match component {
        "click" => on(value >= CLICKED),
        "touch" | "proximity" => on(touched || value > 0.0),
        _ => [value, 0.0],
    };
    let button = |pressed: bool, touched: bool| match component {
        "touch" | "proximity" => on(pressed || touched),
        _ => on(pressed),
    };
    let [trigger_touch, stick_touch, primary_touch, secondary_touch] = controller.touches;
    let stick = controller.stick;
    match input {
        "trigger" => analog(controller.trigger, trigger_touch),
        "squeeze" => analog(controller.squeeze, false),
        "select" => on(controller.trigger >= CLICKED),
        "menu" => on(controller.menu),
        "a" | "x" => button(controller.primary, primary_touch),
        "b" | "y" => button(controller.secondary, secondary_touch),
        "thumbstick" | "trackpad" => match component {
            "x" => [stick[0], 0.0],
            "y" => [stick[1], 0.0],
            "click" => on(controller.stick_click),
            "touch" => on(stick_touch || controller.stick_click || stick != [0.0; 2]),
            "force" => on(controller.stick_click),
            _ => stick,
        },
        _ => [0.0; 2],
    }
}

/// What a person calls a component, such as "trigger": for `xrGetInputSourceLocalizedName`.
pub(crate) fn component_title(subpath: &str) -> String {
    let name = subpath.trim_start_matches("/input/").trim_start_matches("/output/").replace('/', " ");
    let mut letters = name.replace('_', " ").chars().collect::<Vec<_>>();
    if let Some(first) = letters.first_mut() {
        *first = first.to_ascii_uppercase();
    }
    letters.into_iter().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Tracked;

    #[test]
    fn the_table_is_whole() {
        let core = || profiles().iter().filter(|p| p.extension.is_none());
        assert_eq!((core().count(), core().filter(|p| p.since_minor == 0).count()), (22, 9));
        assert_eq!(
            profile(GAZE).map(|gaze| (gaze.extension, gaze.components.len())),
            Some((Some(Extension::EyeGaze), 1))
        );
        let simple = profile("/interaction_profiles/khr/simple_controller").unwrap();
        assert_eq!(simple.components.iter().filter(|c| c.since_minor == 0).count(), 10);
        assert!(profiles().iter().all(|p| !p.components.is_empty() && !p.title.is_empty()));
        assert!(STAND_INS.iter().all(|path| profile(path).is_some()));
    }

    #[test]
    fn components_read_the_control_they_are_named_for() {
        let mut controller = Controller::idle(Tracked::Lost, Tracked::Lost);
        controller.trigger = 0.75;
        controller.stick = [-0.5, 0.25];
        controller.primary = true;
        for (subpath, value) in [
            ("/input/trigger/value", [0.75, 0.0]),
            ("/input/trigger/click", [1.0, 0.0]),
            ("/input/trigger/touch", [1.0, 0.0]),
            ("/input/select/click", [1.0, 0.0]),
            ("/input/thumbstick", [-0.5, 0.25]),
            ("/input/thumbstick/y", [0.25, 0.0]),
            ("/input/x/click", [1.0, 0.0]),
            ("/input/y/click", [0.0, 0.0]),
            ("/input/squeeze/value", [0.0, 0.0]),
        ] {
            assert_eq!(read(&controller, subpath), value, "{subpath}");
        }
    }
}
