//! Bindings: what applications suggest, and what becomes of it when a session begins to listen.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use openxr_sys as sys;

use crate::action::{Action, ActionSet, EYES, USER_PATHS, hand_of};
use crate::extension::Extension;
use crate::ffi::{In, Out, XrResult, array};
use crate::handle;
use crate::instance::Instance;
use crate::interaction::{self, Component, InteractionProfile, STAND_INS};
use crate::motion::Hand;
use crate::session::Session;

/// One action that listens to, or drives, one component of a controller.
#[derive(Clone)]
pub(crate) struct Binding {
    pub action: Arc<Action>,
    /// `None` where the eyes do it.
    pub hand: Option<Hand>,
    pub component: &'static Component,
    /// The whole path of the component.
    pub path: sys::Path,
}

/// The component that a binding path names, for an action of a kind. A path that ends at the input, such as
/// `…/input/trigger`, takes the component that suits the action.
fn find_component(
    profile: &'static InteractionProfile,
    minor: u16,
    path: &str,
    kind: sys::ActionType,
) -> Option<&'static Component> {
    let mut candidates: Vec<&Component> = profile
        .components
        .iter()
        .filter(|component| component.since_minor <= minor)
        .filter(|component| {
            path.strip_prefix(component.user).is_some_and(|sub| {
                !sub.is_empty() && (sub == component.subpath || is_input_of(sub, component.subpath))
            })
        })
        .collect();
    let exact = |component: &&Component| path.len() == component.user.len() + component.subpath.len();
    let suits = |component: &&Component| {
        let order: &[&str] = match kind {
            sys::ActionType::BOOLEAN_INPUT => &["/click", "/value", "/force", "/touch"],
            sys::ActionType::FLOAT_INPUT => &["/value", "/force", "/click"],
            sys::ActionType::POSE_INPUT => &["/pose"],
            _ => &[],
        };
        order.iter().position(|end| component.subpath.ends_with(end)).unwrap_or(order.len())
    };
    candidates.sort_by_key(|component| (!exact(component), suits(component)));
    candidates.first().copied()
}

/// Whether `sub` is the input (`/input/trigger`) of which `subpath` is a component (`/input/trigger/value`).
fn is_input_of(sub: &str, subpath: &str) -> bool {
    sub.matches('/').count() == 2 && subpath.strip_prefix(sub).is_some_and(|rest| rest.starts_with('/'))
}

/// Whether an action of a kind can listen to a component of a kind ("Suggested Bindings" of the specification).
fn converts(action: sys::ActionType, component: sys::ActionType) -> bool {
    use sys::ActionType as T;
    action == component
        || matches!(
            (action, component),
            (T::BOOLEAN_INPUT, T::FLOAT_INPUT) | (T::FLOAT_INPUT, T::BOOLEAN_INPUT)
        )
}

pub(crate) fn suggest_interaction_profile_bindings(
    instance: &Instance,
    info: In<sys::InteractionProfileSuggestedBinding>,
) -> XrResult {
    let info = info.get()?;
    if info.count_suggested_bindings == 0 {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    // SAFETY: the application hands over as many bindings as it says.
    let suggested = unsafe { array(info.suggested_bindings, info.count_suggested_bindings) }?;
    let shared = &mut *instance.lock();
    let path = shared.paths.text(info.interaction_profile)?;
    let profile = interaction::profile(path)
        .filter(|profile| profile.is_offered(instance))
        .ok_or(sys::Result::ERROR_PATH_UNSUPPORTED)?;
    let mut bindings = Vec::with_capacity(suggested.len());
    for suggestion in suggested {
        let action = handle::get::<Action>(suggestion.action)?;
        if action.set.attached.load(Ordering::Acquire) {
            return Err(sys::Result::ERROR_ACTIONSETS_ALREADY_ATTACHED);
        }
        let path = shared.paths.text(suggestion.binding)?;
        find_component(profile, instance.minor, path, action.kind)
            .ok_or(sys::Result::ERROR_PATH_UNSUPPORTED)?;
        bindings.push((suggestion.action, path.to_owned()));
    }
    shared.suggestions.insert(profile.path, bindings);
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn attach_session_action_sets(
    session: &Session,
    info: In<sys::SessionActionSetsAttachInfo>,
) -> XrResult {
    let info = info.get()?;
    if info.count_action_sets == 0 {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    // SAFETY: the application hands over as many handles as it says.
    let sets = unsafe { array(info.action_sets, info.count_action_sets) }?;
    let sets = sets.iter().map(|&set| handle::get::<ActionSet>(set)).collect::<XrResult<Vec<_>>>()?;
    let inner = &mut *session.lock();
    if inner.input.attached() {
        return Err(sys::Result::ERROR_ACTIONSETS_ALREADY_ATTACHED);
    }
    for set in &sets {
        set.attached.store(true, Ordering::Release);
    }
    inner.input.attach(sets);
    Ok(sys::Result::SUCCESS)
}

/// The profile that a hand's controller appears as: its own where the application suggested bindings for it, else
/// one that stands in for it.
pub(crate) fn choose_profile(session: &Session, hand: Hand) -> Option<&'static InteractionProfile> {
    let shared = session.instance.lock();
    let own = session.instance.config.profile.controllers.as_str();
    [own].into_iter().chain(STAND_INS).find_map(|path| {
        let profile = interaction::profile(path)?;
        let has_hand = profile.components.iter().any(|component| hand_of(component.user) == Some(hand));
        (has_hand && shared.suggestions.contains_key(profile.path)).then_some(profile)
    })
}

/// The bindings of a hand, or of the eyes, under a profile, of the actions in these sets.
pub(crate) fn resolve(
    session: &Session,
    hand: Option<Hand>,
    profile: &'static InteractionProfile,
    sets: &[Arc<ActionSet>],
) -> Vec<Binding> {
    let shared = &mut *session.instance.lock();
    let Some(suggestions) = shared.suggestions.get(profile.path) else { return Vec::new() };
    let mut bindings = Vec::new();
    for (action, path) in suggestions {
        // An action may have been destroyed since.
        let Ok(action) = handle::get::<Action>(*action) else { continue };
        let Some(component) = find_component(profile, session.instance.minor, path, action.kind) else {
            continue;
        };
        let attached = sets.iter().any(|set| Arc::ptr_eq(set, &action.set));
        if !attached || hand_of(component.user) != hand || !converts(action.kind, component.kind) {
            continue;
        }
        let whole = format!("{}{}", component.user, component.subpath);
        if let Ok(path) = shared.paths.intern(&whole) {
            bindings.push(Binding { action, hand, component, path });
        }
    }
    bindings
}

/// Whether an action is what the application reads the gaze by: the eyes' is the only binding that it has.
pub(crate) fn is_gaze(instance: &Instance, action: &Action) -> bool {
    let suggestions = &instance.lock().suggestions;
    let of = |profile: &str| {
        suggestions.get(profile).is_some_and(|all| all.iter().any(|(of, _)| *of == action.handle))
    };
    of(interaction::GAZE)
}

pub(crate) fn get_current_interaction_profile(
    session: &Session,
    user: sys::Path,
    mut out: Out<sys::InteractionProfileState>,
) -> XrResult {
    let user = session.instance.lock().paths.text(user)?.to_owned();
    let of_eyes = user == EYES && session.instance.has(Extension::EyeGaze);
    if !of_eyes && !USER_PATHS.contains(&user.as_str()) {
        return Err(sys::Result::ERROR_PATH_UNSUPPORTED);
    }
    let state = out.fill()?;
    let inner = session.lock();
    if !inner.input.attached() {
        return Err(sys::Result::ERROR_ACTIONSET_NOT_ATTACHED);
    }
    let profile = match hand_of(&user) {
        Some(hand) => inner.input.profile(hand),
        None if of_eyes && inner.input.has_eyes() => interaction::profile(interaction::GAZE),
        None => None,
    };
    state.interaction_profile = match profile {
        Some(profile) => session.instance.lock().paths.intern(profile.path)?,
        None => sys::Path::NULL,
    };
    Ok(sys::Result::SUCCESS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_that_ends_at_the_input_takes_the_component_that_suits() {
        let touch = interaction::profile("/interaction_profiles/oculus/touch_controller").unwrap();
        let find = |path: &str, kind| find_component(touch, 0, path, kind).map(|component| component.subpath);
        let boolean = sys::ActionType::BOOLEAN_INPUT;
        assert_eq!(find("/user/hand/left/input/trigger", boolean), Some("/input/trigger/value"));
        assert_eq!(find("/user/hand/left/input/x", boolean), Some("/input/x/click"));
        assert_eq!(
            find("/user/hand/left/input/thumbstick", sys::ActionType::VECTOR2F_INPUT),
            Some("/input/thumbstick")
        );
        assert_eq!(find("/user/hand/left/input/grip", sys::ActionType::POSE_INPUT), Some("/input/grip/pose"));
        for wrong in [
            "/user/hand/left/input/a/click",
            "/user/hand/left",
            "/user/hand/left/input",
            "/user/head/input/x/click",
        ] {
            assert_eq!(find(wrong, boolean), None, "{wrong}");
        }
        // Came with OpenXR 1.1.
        let surface = "/user/hand/left/input/grip_surface/pose";
        assert!(find_component(touch, 0, surface, sys::ActionType::POSE_INPUT).is_none());
        assert!(find_component(touch, 1, surface, sys::ActionType::POSE_INPUT).is_some());
    }
}
