//! Instances: what an application switched on, and what it shares between its sessions.

use std::collections::HashMap;
use std::ffi::c_char;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use openxr_sys as sys;

use crate::clock::RuntimeClock;
use crate::config::{Command, Config, Runtime};
use crate::event::{Event, Events};
use crate::extension::{Extension, Extensions};
use crate::ffi::{Buffer, In, Out, XrResult, array, field_text, text, text_field};
use crate::handle::{self, Object};
use crate::path::Paths;
use crate::session::Session;
use crate::vulkan::VulkanEntry;

/// The newest OpenXR that the runtime knows.
pub(crate) const API_VERSION: sys::Version = sys::CURRENT_API_VERSION;

pub(crate) struct Instance {
    pub handle: sys::Instance,
    pub config: Arc<Config>,
    /// 0 for OpenXR 1.0, 1 for 1.1.
    pub minor: u16,
    pub extensions: Extensions,
    pub clock: RuntimeClock,
    lost: AtomicBool,
    state: Mutex<InstanceState>,
}

#[derive(Default)]
pub(crate) struct InstanceState {
    pub paths: Paths,
    pub events: Events,
    /// Name and localized name of each action set that lives.
    pub action_set_names: Vec<(sys::ActionSet, String, String)>,
    /// The last suggestion for each interaction profile.
    pub suggestions: HashMap<&'static str, Vec<(sys::Action, String)>>,
    pub graphics_requirements_asked: bool,
    pub vulkan: Option<VulkanEntry>,
    pub session: Weak<Session>,
}

impl Object for Instance {
    type Handle = sys::Instance;
}

impl Instance {
    pub(crate) fn lock(&self) -> MutexGuard<'_, InstanceState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn has(&self, extension: Extension) -> bool {
        self.extensions.contains(extension)
    }

    /// # Errors
    /// `XR_ERROR_INSTANCE_LOST` once the instance is lost.
    pub(crate) fn check_lost(&self) -> XrResult<()> {
        if self.lost.load(Ordering::Acquire) { Err(sys::Result::ERROR_INSTANCE_LOST) } else { Ok(()) }
    }

    /// From now on every call with the instance fails, but its destruction.
    pub(crate) fn lose(&self) {
        self.lost.store(true, Ordering::Release);
    }

    /// Does what the embedding program asked for since the last time.
    pub(crate) fn attend(&self) {
        let session = self.lock().session.upgrade();
        while let Some(command) = self.config.control.take() {
            if command == Command::LoseInstance {
                self.push_event(Event::InstanceLossPending { time: self.clock.now() });
            } else if let Some(session) = &session {
                session.obey(command);
            }
        }
        if let Some(session) = &session {
            session.poll_presence();
        }
    }

    /// Where no event waits, the next one of a recording happens.
    pub(crate) fn follow_replay(&self) {
        let shared = self.lock();
        let session = if shared.events.is_empty() { shared.session.upgrade() } else { None };
        drop(shared);
        if let Some(session) = session {
            session.follow_replay();
        }
    }

    pub(crate) fn push_event(&self, event: Event) {
        self.lock().events.push(event);
    }
}

/// The instance behind a handle, if it is not lost.
pub(crate) fn get(handle: sys::Instance) -> XrResult<Arc<Instance>> {
    let instance = handle::get::<Instance>(handle)?;
    instance.check_lost()?;
    Ok(instance)
}

pub(crate) fn create_instance(info: In<sys::InstanceCreateInfo>, mut out: Out<sys::Instance>) -> XrResult {
    let info = info.get()?;
    out.check()?;
    if info.create_flags != sys::InstanceCreateFlags::EMPTY {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    let application = &info.application_info;
    let name = field_text(&application.application_name).ok_or(sys::Result::ERROR_NAME_INVALID)?;
    field_text(&application.engine_name).ok_or(sys::Result::ERROR_NAME_INVALID)?;
    if name.is_empty() {
        return Err(sys::Result::ERROR_NAME_INVALID);
    }
    let version = application.api_version;
    if version.major() != 1 || version.minor() > API_VERSION.minor() {
        return Err(sys::Result::ERROR_API_VERSION_UNSUPPORTED);
    }
    // The runtime has no layers of its own; a loader takes its layers out of the list.
    if info.enabled_api_layer_count != 0 {
        return Err(sys::Result::ERROR_API_LAYER_NOT_PRESENT);
    }
    let mut extensions = Extensions::default();
    // SAFETY: the application hands over as many names as it says.
    for &name in unsafe { array(info.enabled_extension_names, info.enabled_extension_count) }? {
        // SAFETY: each is a zero-terminated string.
        let name = unsafe { text(name, usize::MAX) }?;
        extensions.insert(Extension::named(name).ok_or(sys::Result::ERROR_EXTENSION_NOT_PRESENT)?);
    }
    let config = Runtime::configured();
    let clock = RuntimeClock::start(config.clock, config.begins);
    let (handle, _) = handle::insert(0, |handle| Instance {
        handle,
        config,
        minor: version.minor(),
        extensions,
        clock,
        lost: AtomicBool::new(false),
        state: Mutex::default(),
    });
    out.set(handle)?;
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn destroy_instance(instance: sys::Instance) -> XrResult {
    handle::remove::<Instance>(instance)?;
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn get_instance_properties(_: &Instance, mut out: Out<sys::InstanceProperties>) -> XrResult {
    let properties = out.fill()?;
    let part = |text: &str| text.parse().unwrap_or(0);
    properties.runtime_version = sys::Version::new(
        part(env!("CARGO_PKG_VERSION_MAJOR")) as u16,
        part(env!("CARGO_PKG_VERSION_MINOR")) as u16,
        part(env!("CARGO_PKG_VERSION_PATCH")),
    );
    properties.runtime_name = text_field("Vergence simulated runtime");
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn enumerate_api_layer_properties(mut buffer: Buffer<sys::ApiLayerProperties>) -> XrResult {
    buffer.give_typed(0, |_, _| ())
}

pub(crate) fn enumerate_instance_extension_properties(
    layer: *const c_char,
    mut buffer: Buffer<sys::ExtensionProperties>,
) -> XrResult {
    if !layer.is_null() {
        return Err(sys::Result::ERROR_API_LAYER_NOT_PRESENT);
    }
    buffer.give_typed(Extension::ALL.len(), |index, properties| {
        let (_, name, version) = Extension::ALL[index];
        properties.extension_name = text_field(name);
        properties.extension_version = version;
    })
}

/// A name from the registry, or the number with its prefix, as the specification words it.
fn name_or_number(debug: String, prefix: &str, unknown: &str, value: i32) -> String {
    if debug.parse::<i32>().is_ok() { format!("{unknown}{value}") } else { format!("{prefix}{debug}") }
}

pub(crate) fn result_to_string(
    _: &Instance,
    value: sys::Result,
    mut out: Out<[c_char; sys::MAX_RESULT_STRING_SIZE]>,
) -> XrResult {
    let raw = value.into_raw();
    let unknown = if raw < 0 { "XR_UNKNOWN_FAILURE_" } else { "XR_UNKNOWN_SUCCESS_" };
    out.set(text_field(&name_or_number(format!("{value:?}"), "XR_", unknown, raw)))?;
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn structure_type_to_string(
    _: &Instance,
    value: sys::StructureType,
    mut out: Out<[c_char; sys::MAX_STRUCTURE_NAME_SIZE]>,
) -> XrResult {
    let raw = value.into_raw();
    let name = name_or_number(format!("{value:?}"), "XR_TYPE_", "XR_UNKNOWN_STRUCTURE_TYPE_", raw);
    out.set(text_field(&name))?;
    Ok(sys::Result::SUCCESS)
}
