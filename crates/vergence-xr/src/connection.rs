//! From nothing to a runtime with a headset: loader or embedded runtime, extensions, instance, system.

use std::ffi::c_char;

use openxr::sys;
use vergence_plan::Extension;

use crate::error::{Error, In};
use crate::list::list;

const STEREO: openxr::ViewConfigurationType = openxr::ViewConfigurationType::PRIMARY_STEREO;
const MONO: openxr::ViewConfigurationType = openxr::ViewConfigurationType::PRIMARY_MONO;

/// How to find the runtime.
#[derive(Clone, Copy, Debug)]
pub enum Way {
    /// The system's OpenXR loader, which finds the runtime that the user has chosen.
    Loader,
    /// A runtime that is linked into this process.
    Embedded(EmbeddedRuntime),
}

/// The entry point of a runtime that is linked into this process.
#[derive(Clone, Copy, Debug)]
pub struct EmbeddedRuntime {
    get_instance_proc_addr: sys::pfn::GetInstanceProcAddr,
}

impl EmbeddedRuntime {
    /// Names a runtime by its `xrGetInstanceProcAddr`.
    ///
    /// # Safety
    /// The function must conform to OpenXR: for every core name it gives a function with that name's semantics.
    pub const unsafe fn new(get_instance_proc_addr: sys::pfn::GetInstanceProcAddr) -> Self {
        Self { get_instance_proc_addr }
    }
}

/// A runtime with a headset: instance and system.
pub struct Connection {
    pub(crate) instance: openxr::Instance,
    pub(crate) system: openxr::SystemId,
    pub(crate) view_configuration: openxr::ViewConfigurationType,
    pub(crate) blend_mode: openxr::EnvironmentBlendMode,
    extensions: Vec<String>,
    description: Description,
    views: Vec<ViewSize>,
}

/// What a runtime says of itself and of the headset.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Description {
    /// Name and version of the runtime.
    pub runtime: String,
    /// Name of the headset.
    pub headset: String,
    /// Version of OpenXR that was agreed on, as `1.1`.
    pub api: String,
}

/// How large the picture of one eye should and can be, in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ViewSize {
    /// Width and height that match the display.
    pub recommended: (u32, u32),
    /// The largest that are accepted.
    pub largest: (u32, u32),
}

impl Connection {
    /// Finds a runtime and its headset and asks for `extensions`: those that are required must be there, the others are
    /// used where they are offered. Asks for OpenXR 1.1 first and for 1.0 where that is refused.
    ///
    /// # Errors
    /// No loader, no runtime, no headset, a required extension missing; see [`Error::state`] for whether waiting helps.
    pub fn open(way: Way, app_name: &str, extensions: &[Extension]) -> Result<Self, Error> {
        let entry = entry(way)?;
        let offered = offered_extensions(&entry)?;
        let mut chosen = Vec::with_capacity(extensions.len());
        for extension in extensions {
            if offered.iter().any(|name| name == extension.name) {
                chosen.push(extension.name.to_owned());
            } else if extension.required {
                return Err(Error::MissingExtension {
                    runtime: "that was found".into(),
                    name: extension.name.into(),
                    found: offered.len(),
                });
            } else {
                log::info!("{} is not offered ({})", extension.name, extension.why);
            }
        }
        let (instance, api) = create_instance(&entry, app_name, &chosen)?;
        let runtime = runtime_name(&instance).during("xrGetInstanceProperties")?;
        let system =
            instance.system(openxr::FormFactor::HEAD_MOUNTED_DISPLAY).map_err(|result| match result {
                sys::Result::ERROR_FORM_FACTOR_UNAVAILABLE | sys::Result::ERROR_FORM_FACTOR_UNSUPPORTED => {
                    Error::NoHeadset { runtime: runtime.clone(), result }
                }
                result => Error::of("xrGetSystem", result),
            })?;
        let headset = headset_name(&instance, system).during("xrGetSystemProperties")?;
        let view_configuration = view_configuration(&instance, system)?;
        let views = view_sizes(&instance, system, view_configuration)?;
        let blend_mode = blend_mode(&instance, system, view_configuration)?;
        Ok(Self {
            instance,
            system,
            view_configuration,
            blend_mode,
            extensions: chosen,
            description: Description { runtime, headset, api },
            views,
        })
    }

    /// What the runtime says of itself.
    pub const fn description(&self) -> &Description {
        &self.description
    }

    /// One per view: two for stereo.
    pub fn views(&self) -> &[ViewSize] {
        &self.views
    }

    /// The extensions that are in use, all of them asked for.
    pub fn extensions(&self) -> &[String] {
        &self.extensions
    }

    pub(crate) fn has(&self, extension: &str) -> bool {
        self.extensions.iter().any(|name| name == extension)
    }

    /// Whether the headset sees where its user looks, and the runtime says so.
    pub(crate) fn sees_gaze(&self) -> bool {
        if !self.has("XR_EXT_eye_gaze_interaction") {
            return false;
        }
        let mut gaze = sys::SystemEyeGazeInteractionPropertiesEXT {
            ty: sys::SystemEyeGazeInteractionPropertiesEXT::TYPE,
            next: std::ptr::null_mut(),
            supports_eye_gaze_interaction: sys::FALSE,
        };
        let mut properties = sys::SystemProperties::out((&raw mut gaze).cast());
        // SAFETY: instance and system belong together; both structures say what they are and live through the call.
        let result = unsafe {
            (self.instance.fp().get_system_properties)(
                self.instance.as_raw(),
                self.system,
                properties.as_mut_ptr(),
            )
        };
        result == sys::Result::SUCCESS && gaze.supports_eye_gaze_interaction != sys::FALSE
    }

    /// Whether the runtime's clock can be read.
    pub(crate) fn has_clock(&self) -> bool {
        self.has("XR_KHR_convert_timespec_time")
    }

    /// The runtime's clock, where it can be read.
    pub(crate) fn now(&self) -> Option<Result<vergence_time::Timestamp, openxr::sys::Result>> {
        if !self.has_clock() {
            return None;
        }
        let now = self.instance.now();
        Some(now.map(|now| vergence_time::Timestamp::from_nanos(now.as_nanos())))
    }
}

fn entry(way: Way) -> Result<openxr::Entry, Error> {
    match way {
        Way::Loader => {
            // SAFETY: the file by this name in the linker's path is the system's OpenXR loader; who puts something else
            // there owns the process anyway.
            unsafe { openxr::Entry::load(&()) }.map_err(|error| match error {
                openxr::EntryError::Load(error) => Error::NoLoader { detail: error.to_string() },
                openxr::EntryError::Xr(result) => Error::NoRuntime { call: "the loader's start", result },
            })
        }
        Way::Embedded(runtime) => {
            // SAFETY: whoever made the EmbeddedRuntime guarantees that it conforms to OpenXR.
            unsafe { openxr::Entry::from_get_instance_proc_addr(runtime.get_instance_proc_addr, &()) }
                .map_err(|result| Error::NoRuntime { call: "xrGetInstanceProcAddr", result })
        }
    }
}

/// Names of the extensions that a runtime and the implicit layers offer.
fn offered_extensions(entry: &openxr::Entry) -> Result<Vec<String>, Error> {
    let enumerate = entry.fp().enumerate_instance_extension_properties;
    let empty = sys::ExtensionProperties {
        ty: sys::ExtensionProperties::TYPE,
        next: std::ptr::null_mut(),
        extension_name: [0; sys::MAX_EXTENSION_NAME_SIZE],
        extension_version: 0,
    };
    let call = "xrEnumerateInstanceExtensionProperties";
    let properties = list(call, empty, |capacity, count, items| {
        // SAFETY: `items` is null or has `capacity` initialised elements.
        unsafe { enumerate(std::ptr::null(), capacity, count, items) }
    })
    .map_err(|error| match error {
        Error::Call { call, result } => Error::NoRuntime { call, result },
        Error::InstanceLost { call } => {
            Error::NoRuntime { call, result: sys::Result::ERROR_RUNTIME_UNAVAILABLE }
        }
        error => error,
    })?;
    Ok(properties.iter().map(|p| text(&p.extension_name)).collect())
}

/// The runtime's name and version. The crate's own way trusts the runtime to end its name with a NUL and to write UTF-8.
fn runtime_name(instance: &openxr::Instance) -> openxr::Result<String> {
    let mut properties = sys::InstanceProperties {
        ty: sys::InstanceProperties::TYPE,
        next: std::ptr::null_mut(),
        runtime_version: openxr::Version::new(0, 0, 0),
        runtime_name: [0; sys::MAX_RUNTIME_NAME_SIZE],
    };
    // SAFETY: the instance lives; the structure says what it is and lives through the call.
    let result = unsafe { (instance.fp().get_instance_properties)(instance.as_raw(), &raw mut properties) };
    if result != sys::Result::SUCCESS {
        return Err(result);
    }
    Ok(format!("{} {}", text(&properties.runtime_name), properties.runtime_version))
}

/// The headset's name; as for the runtime's.
fn headset_name(instance: &openxr::Instance, system: openxr::SystemId) -> openxr::Result<String> {
    let mut properties = sys::SystemProperties {
        ty: sys::SystemProperties::TYPE,
        next: std::ptr::null_mut(),
        system_id: system,
        vendor_id: 0,
        system_name: [0; sys::MAX_SYSTEM_NAME_SIZE],
        graphics_properties: sys::SystemGraphicsProperties {
            max_swapchain_image_height: 0,
            max_swapchain_image_width: 0,
            max_layer_count: 0,
        },
        tracking_properties: sys::SystemTrackingProperties {
            orientation_tracking: sys::FALSE,
            position_tracking: sys::FALSE,
        },
    };
    // SAFETY: instance and system belong together; the structure says what it is and lives through the call.
    let result =
        unsafe { (instance.fp().get_system_properties)(instance.as_raw(), system, &raw mut properties) };
    if result != sys::Result::SUCCESS {
        return Err(result);
    }
    Ok(text(&properties.system_name))
}

/// A fixed array up to its first NUL or its end.
fn text(chars: &[c_char]) -> String {
    let bytes: Vec<u8> = chars.iter().take_while(|&&c| c != 0).map(|&c| c as u8).collect();
    String::from_utf8_lossy(&bytes).into_owned()
}

fn create_instance(
    entry: &openxr::Entry,
    app_name: &str,
    extensions: &[String],
) -> Result<(openxr::Instance, String), Error> {
    let with_nul: Vec<Vec<u8>> = extensions.iter().map(|name| [name.as_bytes(), b"\0"].concat()).collect();
    let set: openxr::ExtensionSet = with_nul.iter().map(Vec::as_slice).collect();
    // The crate asserts that the name fits.
    let mut name_end = app_name.len().min(sys::MAX_APPLICATION_NAME_SIZE - 1);
    while !app_name.is_char_boundary(name_end) {
        name_end -= 1;
    }
    let mut refused = sys::Result::ERROR_API_VERSION_UNSUPPORTED;
    for (minor, api) in [(1, "1.1"), (0, "1.0")] {
        let info = openxr::ApplicationInfo {
            application_name: &app_name[..name_end],
            application_version: 0,
            engine_name: "vergence",
            engine_version: 0,
            api_version: openxr::Version::new(1, minor, 0),
        };
        match entry.create_instance(&info, &set, &[], &()) {
            Ok(instance) => return Ok((instance, api.to_owned())),
            Err(result) => refused = result,
        }
        if refused != sys::Result::ERROR_API_VERSION_UNSUPPORTED {
            break;
        }
    }
    Err(Error::NoRuntime { call: "xrCreateInstance", result: refused })
}

fn view_configuration(
    instance: &openxr::Instance,
    system: openxr::SystemId,
) -> Result<openxr::ViewConfigurationType, Error> {
    let enumerate = instance.fp().enumerate_view_configurations;
    let offered = list("xrEnumerateViewConfigurations", STEREO, |capacity, count, items| {
        // SAFETY: the instance lives; `items` is null or has `capacity` elements.
        unsafe { enumerate(instance.as_raw(), system, capacity, count, items) }
    })?;
    [STEREO, MONO].into_iter().find(|wanted| offered.contains(wanted)).ok_or_else(|| Error::Unsupported {
        what: "view configuration",
        expected: "stereo or mono".into(),
        found: format!("{offered:?}"),
    })
}

/// The first that is offered: the one that the runtime likes best.
fn blend_mode(
    instance: &openxr::Instance,
    system: openxr::SystemId,
    view_configuration: openxr::ViewConfigurationType,
) -> Result<openxr::EnvironmentBlendMode, Error> {
    const OPAQUE: openxr::EnvironmentBlendMode = openxr::EnvironmentBlendMode::OPAQUE;
    let enumerate = instance.fp().enumerate_environment_blend_modes;
    let offered = list("xrEnumerateEnvironmentBlendModes", OPAQUE, |capacity, count, items| {
        // SAFETY: the instance lives; `items` is null or has `capacity` elements.
        unsafe { enumerate(instance.as_raw(), system, view_configuration, capacity, count, items) }
    })?;
    Ok(offered.first().copied().unwrap_or(OPAQUE))
}

fn view_sizes(
    instance: &openxr::Instance,
    system: openxr::SystemId,
    view_configuration: openxr::ViewConfigurationType,
) -> Result<Vec<ViewSize>, Error> {
    let enumerate = instance.fp().enumerate_view_configuration_views;
    let empty = sys::ViewConfigurationView {
        ty: sys::ViewConfigurationView::TYPE,
        next: std::ptr::null_mut(),
        recommended_image_rect_width: 0,
        max_image_rect_width: 0,
        recommended_image_rect_height: 0,
        max_image_rect_height: 0,
        recommended_swapchain_sample_count: 0,
        max_swapchain_sample_count: 0,
    };
    let listed = list("xrEnumerateViewConfigurationViews", empty, |capacity, count, items| {
        // SAFETY: the instance lives; `items` is null or has `capacity` initialised elements.
        unsafe { enumerate(instance.as_raw(), system, view_configuration, capacity, count, items) }
    })?;
    let views: Vec<ViewSize> = listed
        .iter()
        .map(|view| ViewSize {
            recommended: (view.recommended_image_rect_width, view.recommended_image_rect_height),
            largest: (view.max_image_rect_width, view.max_image_rect_height),
        })
        .collect();
    let expected = if view_configuration == STEREO { 2 } else { 1 };
    if views.len() != expected {
        return Err(Error::Unsupported {
            what: "number of views",
            expected: expected.to_string(),
            found: views.len().to_string(),
        });
    }
    Ok(views)
}
