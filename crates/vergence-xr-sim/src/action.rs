//! Action sets and actions: what an application wants to know and do, before anything is bound.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use openxr_sys as sys;

use crate::ffi::{In, Out, XrResult, array, field_text};
use crate::handle::{self, Object};
use crate::instance::Instance;
use crate::motion::Hand;

/// The top-level user paths that a subaction may have.
pub(crate) const USER_PATHS: [&str; 5] =
    ["/user/hand/left", "/user/hand/right", "/user/head", "/user/gamepad", "/user/treadmill"];

pub(crate) struct ActionSet {
    pub handle: sys::ActionSet,
    pub instance: Arc<Instance>,
    pub priority: u32,
    /// Once attached to a session nothing about it may change.
    pub attached: AtomicBool,
    /// Handle, name and localized name of each action that lives.
    names: Mutex<Vec<(sys::Action, String, String)>>,
}

pub(crate) struct Action {
    pub handle: sys::Action,
    pub set: Arc<ActionSet>,
    pub name: String,
    pub kind: sys::ActionType,
    pub subactions: Vec<sys::Path>,
}

impl Object for ActionSet {
    type Handle = sys::ActionSet;
}

impl Object for Action {
    type Handle = sys::Action;
}

impl Action {
    /// Which hand a subaction path restricts to: `None` for the null path.
    ///
    /// # Errors
    /// `XR_ERROR_PATH_INVALID` for a path of no instance, `XR_ERROR_PATH_UNSUPPORTED` for one that the action was not
    /// created with.
    pub(crate) fn check_subaction(&self, instance: &Instance, path: sys::Path) -> XrResult<()> {
        if path == sys::Path::NULL {
            return Ok(());
        }
        instance.lock().paths.text(path)?;
        if self.subactions.contains(&path) { Ok(()) } else { Err(sys::Result::ERROR_PATH_UNSUPPORTED) }
    }
}

/// The top-level user path of the eyes, with XR_EXT_eye_gaze_interaction.
pub(crate) const EYES: &str = "/user/eyes_ext";

/// The hand that a top-level user path names.
pub(crate) fn hand_of(user_path: &str) -> Option<Hand> {
    match user_path {
        "/user/hand/left" => Some(Hand::Left),
        "/user/hand/right" => Some(Hand::Right),
        _ => None,
    }
}

/// A name and the name to show, if both are such.
fn names<'a>(
    name: &'a [std::ffi::c_char],
    localized: &'a [std::ffi::c_char],
) -> XrResult<(&'a str, &'a str)> {
    let name = field_text(name).filter(|name| !name.is_empty()).ok_or(sys::Result::ERROR_NAME_INVALID)?;
    let localized = field_text(localized)
        .filter(|name| !name.is_empty())
        .ok_or(sys::Result::ERROR_LOCALIZED_NAME_INVALID)?;
    let allowed = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || matches!(c, '-' | '_' | '.');
    if !name.chars().all(allowed) {
        return Err(sys::Result::ERROR_PATH_FORMAT_INVALID);
    }
    Ok((name, localized))
}

fn check_new<H>(known: &[(H, String, String)], name: &str, localized: &str) -> XrResult<()> {
    if known.iter().any(|(_, other, _)| other == name) {
        return Err(sys::Result::ERROR_NAME_DUPLICATED);
    }
    if known.iter().any(|(_, _, other)| other == localized) {
        return Err(sys::Result::ERROR_LOCALIZED_NAME_DUPLICATED);
    }
    Ok(())
}

pub(crate) fn create_action_set(
    instance: Arc<Instance>,
    info: In<sys::ActionSetCreateInfo>,
    mut out: Out<sys::ActionSet>,
) -> XrResult {
    let info = info.get()?;
    out.check()?;
    let (name, localized) = names(&info.action_set_name, &info.localized_action_set_name)?;
    check_new(&instance.lock().action_set_names, name, localized)?;
    let parent = sys::Handle::into_raw(instance.handle);
    let (handle, set) = handle::insert(parent, |handle| ActionSet {
        handle,
        instance,
        priority: info.priority,
        attached: AtomicBool::new(false),
        names: Mutex::default(),
    });
    set.instance.lock().action_set_names.push((handle, name.to_owned(), localized.to_owned()));
    out.set(handle)?;
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn destroy_action_set(set: sys::ActionSet) -> XrResult {
    let set = handle::remove::<ActionSet>(set)?;
    set.instance.lock().action_set_names.retain(|(other, ..)| *other != set.handle);
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn create_action(
    set: Arc<ActionSet>,
    info: In<sys::ActionCreateInfo>,
    mut out: Out<sys::Action>,
) -> XrResult {
    let info = info.get()?;
    out.check()?;
    if set.attached.load(Ordering::Acquire) {
        return Err(sys::Result::ERROR_ACTIONSETS_ALREADY_ATTACHED);
    }
    let (name, localized) = names(&info.action_name, &info.localized_action_name)?;
    use sys::ActionType as T;
    if ![T::BOOLEAN_INPUT, T::FLOAT_INPUT, T::VECTOR2F_INPUT, T::POSE_INPUT, T::VIBRATION_OUTPUT]
        .contains(&info.action_type)
    {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    // SAFETY: the application hands over as many paths as it says.
    let subactions = unsafe { array(info.subaction_paths, info.count_subaction_paths) }?;
    for (index, &path) in subactions.iter().enumerate() {
        let shared = set.instance.lock();
        let text = shared.paths.text(path)?;
        if !USER_PATHS.contains(&text) || subactions[..index].contains(&path) {
            return Err(sys::Result::ERROR_PATH_UNSUPPORTED);
        }
    }
    let mut names = set.names.lock().unwrap_or_else(PoisonError::into_inner);
    check_new(&names, name, localized)?;
    let parent = sys::Handle::into_raw(set.handle);
    let (handle, _) = handle::insert(parent, |handle| Action {
        handle,
        set: set.clone(),
        name: name.to_owned(),
        kind: info.action_type,
        subactions: subactions.to_vec(),
    });
    names.push((handle, name.to_owned(), localized.to_owned()));
    out.set(handle)?;
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn destroy_action(action: sys::Action) -> XrResult {
    let action = handle::remove::<Action>(action)?;
    let mut names = action.set.names.lock().unwrap_or_else(PoisonError::into_inner);
    names.retain(|(other, ..)| *other != action.handle);
    Ok(sys::Result::SUCCESS)
}
