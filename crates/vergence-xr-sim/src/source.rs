//! What actions are bound to, in words, and vibrations.

use std::ffi::c_char;

use openxr_sys as sys;
use vergence_time::Span;

use crate::action::{Action, EYES, USER_PATHS, hand_of};
use crate::config::Haptic;
use crate::ffi::{Buffer, In, XrResult};
use crate::handle;
use crate::input::select;
use crate::interaction::{self, component_title};
use crate::motion::Hand;
use crate::session::Session;

pub(crate) fn enumerate_bound_sources_for_action(
    session: &Session,
    info: In<sys::BoundSourcesForActionEnumerateInfo>,
    mut buffer: Buffer<sys::Path>,
) -> XrResult {
    let action = handle::get::<Action>(info.get()?.action)?;
    let inner = session.lock();
    inner.input.check_attached(&action.set)?;
    let sources: Vec<sys::Path> =
        inner.input.bindings_of(&action, None).map(|binding| binding.path).collect();
    buffer.give(&sources)
}

pub(crate) fn get_input_source_localized_name(
    session: &Session,
    info: In<sys::InputSourceLocalizedNameGetInfo>,
    mut buffer: Buffer<c_char>,
) -> XrResult {
    use sys::InputSourceLocalizedNameFlags as F;
    let info = info.get()?;
    let known = F::USER_PATH | F::INTERACTION_PROFILE | F::COMPONENT;
    if info.which_components.is_empty() || !known.contains(info.which_components) {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    let path = session.instance.lock().paths.text(info.source_path)?.to_owned();
    let user = USER_PATHS
        .into_iter()
        .chain([EYES])
        .find(|user| path.strip_prefix(user).is_some_and(|rest| rest.is_empty() || rest.starts_with('/')))
        .ok_or(sys::Result::ERROR_PATH_UNSUPPORTED)?;
    let inner = session.lock();
    if !inner.input.attached() {
        return Err(sys::Result::ERROR_ACTIONSET_NOT_ATTACHED);
    }
    let mut words = Vec::new();
    if info.which_components.contains(F::USER_PATH) {
        words.push(match hand_of(user) {
            Some(Hand::Left) => "Left hand".to_owned(),
            Some(Hand::Right) => "Right hand".to_owned(),
            None if user == EYES => "Eyes".to_owned(),
            None => component_title(user.trim_start_matches("/user/")),
        });
    }
    let profile = match hand_of(user) {
        Some(hand) => inner.input.profile(hand),
        None if user == EYES && inner.input.has_eyes() => interaction::profile(interaction::GAZE),
        None => None,
    };
    if info.which_components.contains(F::INTERACTION_PROFILE)
        && let Some(profile) = profile
    {
        words.push(profile.title.to_owned());
    }
    if info.which_components.contains(F::COMPONENT) && path.len() > user.len() {
        words.push(component_title(&path[user.len()..]));
    }
    buffer.give_text(&words.join(" "))
}

/// The hands whose controllers a haptic action reaches.
fn hands(session: &Session, info: &sys::HapticActionInfo) -> XrResult<Vec<Hand>> {
    let (action, hand) = select(session, info.action, info.subaction_path)?;
    if action.kind != sys::ActionType::VIBRATION_OUTPUT {
        return Err(sys::Result::ERROR_ACTION_TYPE_MISMATCH);
    }
    let inner = session.lock();
    if info.subaction_path != sys::Path::NULL && hand.is_none() {
        return Ok(Vec::new());
    }
    let mut hands: Vec<Hand> =
        inner.input.bindings_of(&action, hand).filter_map(|binding| binding.hand).collect();
    hands.sort();
    hands.dedup();
    Ok(hands)
}

fn record(
    session: &Session,
    hands: &[Hand],
    duration: Option<Span>,
    frequency_hz: f32,
    amplitude: f32,
) -> XrResult {
    if !session.lock().is_focused() {
        return Ok(sys::Result::SESSION_NOT_FOCUSED);
    }
    let at = session.instance.clock.now();
    for &hand in hands {
        session.instance.config.control.record(Haptic { at, hand, duration, frequency_hz, amplitude });
    }
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn apply_haptic_feedback(
    session: &Session,
    info: In<sys::HapticActionInfo>,
    feedback: In<sys::HapticVibration>,
) -> XrResult {
    let hands = hands(session, info.get()?)?;
    let vibration = feedback.get()?;
    let nanos = vibration.duration.as_nanos();
    // Comparisons with NaN are false.
    let right = (0.0..=1.0).contains(&vibration.amplitude)
        && vibration.frequency >= 0.0
        && (nanos > 0 || nanos == sys::Duration::MIN_HAPTIC.as_nanos());
    if !right {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    let duration = (nanos > 0).then(|| Span::from_nanos(nanos));
    record(session, &hands, duration, vibration.frequency, vibration.amplitude)
}

pub(crate) fn stop_haptic_feedback(session: &Session, info: In<sys::HapticActionInfo>) -> XrResult {
    let hands = hands(session, info.get()?)?;
    record(session, &hands, Some(Span::ZERO), 0.0, 0.0)
}
