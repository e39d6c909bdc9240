//! Input: synchronizing actions with the controllers, and what the application then reads.

use std::collections::HashMap;
use std::sync::Arc;

use openxr_sys as sys;
use vergence_sense::{Body, ControlState};
use vergence_time::Timestamp;

use crate::action::{Action, ActionSet, hand_of};
use crate::binding::{self, Binding};
use crate::event::Event;
use crate::ffi::{In, Out, XrResult, array};
use crate::handle;
use crate::interaction::{self, InteractionProfile};
use crate::motion::{Controller, Hand, Replay, Tracked};
use crate::session::Session;

/// From here on an analog input counts as pressed.
const PRESSED: f32 = 0.5;

const HANDS: [Hand; 2] = [Hand::Left, Hand::Right];

/// What a session listens to.
#[derive(Default)]
pub(crate) struct Input {
    sets: Option<Vec<Arc<ActionSet>>>,
    profiles: [Option<&'static InteractionProfile>; 2],
    bindings: Vec<Binding>,
    /// The eyes' bindings are among them.
    has_eyes: bool,
    /// By action and, where only one hand counts, that hand.
    values: HashMap<(sys::Action, Option<Hand>), Value>,
}

#[derive(Clone, Copy, Default)]
struct Value {
    value: [f32; 2],
    changed: bool,
    last_change: Timestamp,
    active: bool,
}

impl Input {
    pub(crate) fn attached(&self) -> bool {
        self.sets.is_some()
    }

    pub(crate) fn attach(&mut self, sets: Vec<Arc<ActionSet>>) {
        self.sets = Some(sets);
    }

    pub(crate) fn profile(&self, hand: Hand) -> Option<&'static InteractionProfile> {
        self.profiles[hand as usize]
    }

    /// Whether the eyes are listened to.
    pub(crate) fn has_eyes(&self) -> bool {
        self.has_eyes
    }

    /// The bindings of an action, of one hand or of all that there are.
    pub(crate) fn bindings_of<'a>(
        &'a self,
        action: &'a Action,
        hand: Option<Hand>,
    ) -> impl Iterator<Item = &'a Binding> {
        self.bindings.iter().filter(move |binding| {
            binding.action.handle == action.handle && hand.is_none_or(|hand| binding.hand == Some(hand))
        })
    }

    /// # Errors
    /// `XR_ERROR_ACTIONSET_NOT_ATTACHED` where the set is not among those of the session.
    pub(crate) fn check_attached(&self, set: &ActionSet) -> XrResult<()> {
        let attached =
            self.sets.as_ref().is_some_and(|sets| sets.iter().any(|other| other.handle == set.handle));
        if attached { Ok(()) } else { Err(sys::Result::ERROR_ACTIONSET_NOT_ATTACHED) }
    }
}

/// The action behind a handle, the hand that a subaction path restricts to, and whether the set is attached.
pub(crate) fn select(
    session: &Session,
    action: sys::Action,
    subaction: sys::Path,
) -> XrResult<(Arc<Action>, Option<Hand>)> {
    let action = handle::get::<Action>(action)?;
    action.check_subaction(&session.instance, subaction)?;
    let hand = match subaction {
        sys::Path::NULL => None,
        path => hand_of(session.instance.lock().paths.text(path)?),
    };
    session.lock().input.check_attached(&action.set)?;
    Ok((action, hand))
}

struct Active {
    set: sys::ActionSet,
    hand: Option<Hand>,
    priority: u32,
}

/// The input (`/input/trigger`) that a component belongs to: what sets of different priority compete for.
fn input_of(subpath: &str) -> &str {
    subpath.match_indices('/').nth(2).map_or(subpath, |(end, _)| &subpath[..end])
}

pub(crate) fn sync_actions(session: &Session, info: In<sys::ActionsSyncInfo>) -> XrResult {
    let info = info.get()?;
    // SAFETY: the application hands over as many sets as it says.
    let wanted = unsafe { array(info.active_action_sets, info.count_active_action_sets) }?;
    let mut active = Vec::with_capacity(wanted.len());
    for wanted in wanted {
        let set = handle::get::<ActionSet>(wanted.action_set)?;
        session.lock().input.check_attached(&set)?;
        let hand = match wanted.subaction_path {
            sys::Path::NULL => None,
            path => {
                let shared = session.instance.lock();
                Some(hand_of(shared.paths.text(path)?).ok_or(sys::Result::ERROR_PATH_UNSUPPORTED)?)
            }
        };
        active.push(Active { set: set.handle, hand, priority: set.priority });
    }
    let now = session.instance.clock.now();
    let inner = &mut *session.lock();
    // Not "now": between two frames that is anybody's guess, and what is read would not be the same twice.
    let motion_time = inner.motion_time(inner.frames.input_time.unwrap_or(now));
    let focused = inner.is_focused();
    let controllers = HANDS.map(|hand| session.instance.config.motion.controller(hand, motion_time));
    if focused {
        choose_profiles(session, &mut inner.input, &controllers);
    } else {
        active.clear();
    }
    update(&mut inner.input, &active, &controllers, now);
    Ok(if focused { sys::Result::SUCCESS } else { sys::Result::SESSION_NOT_FOCUSED })
}

/// Interaction profiles change while actions are synchronized, never else.
fn choose_profiles(session: &Session, input: &mut Input, controllers: &[Controller; 2]) {
    let sets = input.sets.clone().unwrap_or_default();
    let mut changed = false;
    for hand in HANDS {
        let connected = controllers[hand as usize].connected;
        let profile = if connected { binding::choose_profile(session, hand) } else { None };
        let before = input.profiles[hand as usize];
        if profile.map(|profile| profile.path) == before.map(|profile| profile.path) {
            continue;
        }
        changed = true;
        input.profiles[hand as usize] = profile;
        input.bindings.retain(|binding| binding.hand != Some(hand));
        if let Some(profile) = profile {
            input.bindings.extend(binding::resolve(session, Some(hand), profile, &sets));
        }
    }
    if !input.has_eyes
        && session.instance.sees_gaze()
        && let Some(profile) = interaction::profile(interaction::GAZE)
    {
        let bindings = binding::resolve(session, None, profile, &sets);
        input.has_eyes = !bindings.is_empty();
        changed |= input.has_eyes;
        input.bindings.extend(bindings);
    }
    if changed && session.replay().is_none() {
        session.instance.push_event(Event::InteractionProfileChanged { session: session.handle });
    }
}

fn update(input: &mut Input, active: &[Active], controllers: &[Controller; 2], now: Timestamp) {
    let is_active = |binding: &Binding| {
        active.iter().find(|active| {
            active.set == binding.action.set.handle
                && active.hand.is_none_or(|hand| Some(hand) == binding.hand)
        })
    };
    // The highest priority that listens to each input keeps it to itself.
    let mut highest: HashMap<(Option<Hand>, &str), u32> = HashMap::new();
    for binding in &input.bindings {
        if let Some(active) = is_active(binding) {
            let priority = highest.entry((binding.hand, input_of(binding.component.subpath))).or_default();
            *priority = (*priority).max(active.priority);
        }
    }
    let mut found: HashMap<(sys::Action, Option<Hand>), [f32; 2]> = HashMap::new();
    for binding in &input.bindings {
        let Some(active) = is_active(binding) else { continue };
        let outranked = highest
            .get(&(binding.hand, input_of(binding.component.subpath)))
            .is_some_and(|&highest| highest > active.priority);
        if outranked {
            continue;
        }
        let mut read = match binding.hand {
            Some(hand) => interaction::read(&controllers[hand as usize], binding.component.subpath),
            None => [0.0; 2],
        };
        if binding.action.kind == sys::ActionType::BOOLEAN_INPUT {
            read = [f32::from(u8::from(read[0] >= PRESSED)), 0.0];
        }
        for key in [None, binding.hand] {
            let value = found.entry((binding.action.handle, key)).or_default();
            *value = stronger(*value, read);
        }
    }
    for (key, value) in input.values.iter_mut() {
        if !found.contains_key(key) {
            *value = Value { last_change: value.last_change, ..Value::default() };
        }
    }
    for (key, read) in found {
        let value = input.values.entry(key).or_default();
        value.changed = value.active && value.value != read;
        if value.changed || !value.active {
            value.last_change = now;
        }
        (value.value, value.active) = (read, true);
    }
}

/// Of several sources the one that is pushed farthest counts ("Multiple Inputs" of the specification).
fn stronger(a: [f32; 2], b: [f32; 2]) -> [f32; 2] {
    if b[0].hypot(b[1]) > a[0].hypot(a[1]) { b } else { a }
}

fn state_of(session: &Session, info: In<sys::ActionStateGetInfo>, kind: sys::ActionType) -> XrResult<Value> {
    let info = info.get()?;
    let (action, hand) = select(session, info.action, info.subaction_path)?;
    if action.kind != kind {
        return Err(sys::Result::ERROR_ACTION_TYPE_MISMATCH);
    }
    // A subaction that is no hand (a gamepad, say) has nothing bound here.
    if info.subaction_path != sys::Path::NULL && hand.is_none() {
        return Ok(Value::default());
    }
    match (session.replay(), hand) {
        (Some(replay), Some(hand)) => return Ok(said(replay, &action, hand)),
        (Some(replay), None) if binding::is_gaze(&session.instance, &action) => {
            return Ok(Value { active: replay.locates(Body::Gaze), ..Value::default() });
        }
        _ => {}
    }
    Ok(session.lock().input.values.get(&(action.handle, hand)).copied().unwrap_or_default())
}

/// What a recording says that an action read.
fn said(replay: &Replay, action: &Action, hand: Hand) -> Value {
    if action.kind == sys::ActionType::POSE_INPUT {
        let body = replay.action(&action.name).map(|place| Body::Action(place, hand));
        return Value { active: body.is_some_and(|body| replay.locates(body)), ..Value::default() };
    }
    let value = match replay.control(&action.name, hand) {
        Some(ControlState::Button(button)) => button.0.map(|on| [f32::from(u8::from(on)), 0.0]),
        Some(ControlState::Axis(axis)) => axis.0.map(|value| [value, 0.0]),
        Some(ControlState::Vector2(vector)) => vector.0,
        None => None,
    };
    Value { value: value.unwrap_or_default(), active: value.is_some(), ..Value::default() }
}

fn time_of(value: &Value) -> sys::Time {
    sys::Time::from_nanos(if value.active { value.last_change.as_nanos() } else { 0 })
}

pub(crate) fn get_action_state_boolean(
    session: &Session,
    info: In<sys::ActionStateGetInfo>,
    mut out: Out<sys::ActionStateBoolean>,
) -> XrResult {
    let state = out.fill()?;
    let value = state_of(session, info, sys::ActionType::BOOLEAN_INPUT)?;
    state.current_state = (value.value[0] >= PRESSED).into();
    state.changed_since_last_sync = value.changed.into();
    state.last_change_time = time_of(&value);
    state.is_active = value.active.into();
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn get_action_state_float(
    session: &Session,
    info: In<sys::ActionStateGetInfo>,
    mut out: Out<sys::ActionStateFloat>,
) -> XrResult {
    let state = out.fill()?;
    let value = state_of(session, info, sys::ActionType::FLOAT_INPUT)?;
    state.current_state = value.value[0];
    state.changed_since_last_sync = value.changed.into();
    state.last_change_time = time_of(&value);
    state.is_active = value.active.into();
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn get_action_state_vector2f(
    session: &Session,
    info: In<sys::ActionStateGetInfo>,
    mut out: Out<sys::ActionStateVector2f>,
) -> XrResult {
    let state = out.fill()?;
    let value = state_of(session, info, sys::ActionType::VECTOR2F_INPUT)?;
    state.current_state = sys::Vector2f { x: value.value[0], y: value.value[1] };
    state.changed_since_last_sync = value.changed.into();
    state.last_change_time = time_of(&value);
    state.is_active = value.active.into();
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn get_action_state_pose(
    session: &Session,
    info: In<sys::ActionStateGetInfo>,
    mut out: Out<sys::ActionStatePose>,
) -> XrResult {
    let state = out.fill()?;
    let value = state_of(session, info, sys::ActionType::POSE_INPUT)?;
    state.is_active = value.active.into();
    Ok(sys::Result::SUCCESS)
}

impl Session {
    /// Where a pose action is at an instant of session time: controller coordinates to stage coordinates. Nothing is
    /// known of an action that was not active when actions were last synchronized.
    pub(crate) fn action_pose(&self, action: &Action, subaction: sys::Path, at: Timestamp) -> Tracked {
        let Ok((_, hand)) = select(self, action.handle, subaction) else { return Tracked::Lost };
        let inner = self.lock();
        let value = inner.input.values.get(&(action.handle, hand)).copied().unwrap_or_default();
        let Some(binding) = inner.input.bindings_of(action, hand).next().filter(|_| value.active) else {
            return Tracked::Lost;
        };
        let (hand, subpath) = (binding.hand, binding.component.subpath);
        let motion_time = inner.motion_time(at);
        drop(inner);
        let Some(hand) = hand else { return self.instance.config.motion.gaze(motion_time) };
        let controller = self.instance.config.motion.controller(hand, motion_time);
        if subpath.starts_with("/input/aim/") { controller.aim } else { controller.grip }
    }
}
