//! The Vulkan instance: our own, made through an OpenXR runtime, or somebody else's; and the validation messages it collects.

use std::collections::VecDeque;
use std::ffi::{CStr, CString, c_char, c_void};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use ash::vk;
use raw_window_handle::RawDisplayHandle;

use crate::error::{At, Error};

const VALIDATION_LAYER: &CStr = c"VK_LAYER_KHRONOS_validation";
/// Messages kept until they are drained; more are only counted.
const MESSAGES_KEPT: usize = 1000;

/// Keeps the drivers loaded until the process ends, by an instance without layers that is never destroyed.
///
/// With the last instance the loader unloads the drivers. Mesa's (seen: llvmpipe 22.3.6) leaves something to be run at the end of
/// each thread that used it, so a thread that ends after the last instance jumps into memory that is gone. Cost: once per
/// process, what the loader's smallest instance costs.
fn keep_drivers(entry: &ash::Entry) {
    static KEPT: OnceLock<(ash::Entry, Option<ash::Instance>)> = OnceLock::new();
    KEPT.get_or_init(|| {
        // SAFETY: the entry is valid and kept beside the instance; the create info names neither layers nor extensions.
        let kept = unsafe { entry.create_instance(&vk::InstanceCreateInfo::default(), None) };
        (entry.clone(), kept.ok())
    });
}

/// Somebody who makes the instance and the device on our behalf: an OpenXR runtime by `XR_KHR_vulkan_enable2`.
///
/// # Safety
///
/// What is returned must be valid handles, made from the create info given (extensions and features may be added, none left
/// out), and must stay valid until the [`Instance`] or [`Device`](crate::Device) made with them has destroyed them.
pub unsafe trait VulkanCreator {
    /// Makes the instance.
    ///
    /// # Safety
    ///
    /// `info` and everything that it points to must be valid.
    unsafe fn create_instance(
        &mut self,
        get_instance_proc_addr: vk::PFN_vkGetInstanceProcAddr,
        info: &vk::InstanceCreateInfo<'_>,
    ) -> Result<vk::Instance, Error>;

    /// The device that the headset is connected to.
    fn physical_device(&mut self, instance: vk::Instance) -> Result<vk::PhysicalDevice, Error>;

    /// Makes the device.
    ///
    /// # Safety
    ///
    /// `info` and everything that it points to must be valid; `physical_device` must be of the instance made before.
    unsafe fn create_device(
        &mut self,
        get_instance_proc_addr: vk::PFN_vkGetInstanceProcAddr,
        physical_device: vk::PhysicalDevice,
        info: &vk::DeviceCreateInfo<'_>,
    ) -> Result<vk::Device, Error>;
}

/// What an instance shall be able to do.
#[derive(Debug, Clone, Default)]
pub struct InstanceDesc<'a> {
    /// Name of the application, for drivers and tools.
    pub app_name: &'a str,
    /// Turns on the Khronos validation layer with synchronization validation, where it is installed (default: off).
    pub validation: bool,
    /// The display whose windows shall be presented to (default: none).
    pub surface: Option<RawDisplayHandle>,
}

/// What the validation layer said, kept until somebody asks.
#[derive(Default)]
pub(crate) struct Messages {
    kept: Mutex<VecDeque<String>>,
    count: AtomicU64,
}

impl Messages {
    fn push(&self, message: String) {
        self.count.fetch_add(1, Ordering::Relaxed);
        log::warn!("vulkan validation: {message}");
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.len() < MESSAGES_KEPT {
            kept.push_back(message);
        }
    }

    fn drain(&self) -> Vec<String> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner).drain(..).collect()
    }
}

/// A Vulkan instance and the loader it came from.
pub struct Instance {
    pub(crate) entry: ash::Entry,
    pub(crate) raw: ash::Instance,
    pub(crate) surface: Option<ash::khr::surface::Instance>,
    pub(crate) debug_utils: bool,
    messenger: Option<(ash::ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT)>,
    // The messenger's callback points into this allocation, so it is freed last (fields drop in order, after `drop`).
    messages: Arc<Messages>,
    validation: bool,
    owned: bool,
}

impl Instance {
    /// Loads Vulkan and makes an instance, or has `creator` make it.
    ///
    /// # Errors
    ///
    /// No loader, a loader older than 1.3, a missing surface extension, or a refusal by the creator.
    pub fn new(desc: &InstanceDesc<'_>, creator: Option<&mut dyn VulkanCreator>) -> Result<Arc<Self>, Error> {
        // SAFETY: loading runs the initialisers of the system's Vulkan loader, which do nothing to this process's memory that
        // Rust could notice; the library stays loaded as long as the entry, which every object keeps alive.
        let entry =
            unsafe { ash::Entry::load() }.map_err(|error| Error::NoLoader { detail: error.to_string() })?;
        // SAFETY: the entry was just loaded.
        let version = unsafe { entry.try_enumerate_instance_version() }
            .at("vkEnumerateInstanceVersion")?
            .unwrap_or(vk::API_VERSION_1_0);
        if version < vk::API_VERSION_1_3 {
            return Err(Error::OldLoader { found: version_text(version) });
        }

        // SAFETY: the entry is valid.
        let layers = unsafe { entry.enumerate_instance_layer_properties() }.unwrap_or_default();
        let validation =
            desc.validation && layers.iter().any(|layer| layer.layer_name_as_c_str() == Ok(VALIDATION_LAYER));
        if desc.validation && !validation {
            log::warn!(
                "the Vulkan validation layer is not installed (apt-get install vulkan-validationlayers)"
            );
        }

        let mut extensions: Vec<*const c_char> = Vec::new();
        if let Some(display) = desc.surface {
            let names = ash_window::enumerate_required_extensions(display).map_err(|result| {
                Error::Surface { detail: format!("this kind of display has no Vulkan surface ({result})") }
            })?;
            // SAFETY: the entry is valid.
            let offered = unsafe { entry.enumerate_instance_extension_properties(None) }
                .at("vkEnumerateInstanceExtensionProperties")?;
            for &name in names {
                // SAFETY: ash-window gives pointers to static nul-terminated strings.
                let wanted = unsafe { CStr::from_ptr(name) };
                if !offered.iter().any(|e| e.extension_name_as_c_str() == Ok(wanted)) {
                    return Err(Error::MissingExtension {
                        name: wanted.to_string_lossy().into_owned(),
                        by: "the Vulkan instance".into(),
                    });
                }
                extensions.push(name);
            }
        }
        let mut layer_names: Vec<*const c_char> = Vec::new();
        if validation {
            layer_names.push(VALIDATION_LAYER.as_ptr());
            extensions.push(ash::ext::debug_utils::NAME.as_ptr());
        }
        // Layers may give this extension up for a newer one; without it they validate all the same, but not synchronization.
        // SAFETY: the entry is valid, the layer's name a C string.
        let of_layer = unsafe { entry.enumerate_instance_extension_properties(Some(VALIDATION_LAYER)) };
        let synchronization = validation
            && of_layer.is_ok_and(|offered| {
                let wanted = ash::ext::validation_features::NAME;
                offered.iter().any(|e| e.extension_name_as_c_str() == Ok(wanted))
            });
        if synchronization {
            extensions.push(ash::ext::validation_features::NAME.as_ptr());
        } else if validation {
            log::warn!("the Vulkan validation layer does not validate synchronization");
        }

        keep_drivers(&entry);
        let messages = Arc::new(Messages::default());
        let app_name = CString::new(desc.app_name.replace('\0', "")).unwrap_or_default();
        let app = vk::ApplicationInfo::default()
            .application_name(&app_name)
            .engine_name(c"vergence")
            .api_version(vk::API_VERSION_1_3);
        let enabled = [vk::ValidationFeatureEnableEXT::SYNCHRONIZATION_VALIDATION];
        let mut features = vk::ValidationFeaturesEXT::default().enabled_validation_features(&enabled);
        let mut messenger_info = messenger_info(&messages);
        let mut info = vk::InstanceCreateInfo::default()
            .application_info(&app)
            .enabled_layer_names(&layer_names)
            .enabled_extension_names(&extensions);
        if validation {
            info = info.push_next(&mut messenger_info);
        }
        if synchronization {
            info = info.push_next(&mut features);
        }
        let get = entry.static_fn().get_instance_proc_addr;
        let handle = match creator {
            // SAFETY: `info` borrows only locals that live until the end of this function.
            Some(creator) => unsafe { creator.create_instance(get, &info) }?,
            None => {
                // SAFETY: as above; the extensions were checked.
                match unsafe { entry.create_instance(&info, None) } {
                    Err(vk::Result::ERROR_INCOMPATIBLE_DRIVER) => {
                        return Err(Error::NoDevice { detail: "the loader is there, but no driver".into() });
                    }
                    made => made.at("vkCreateInstance")?.handle(),
                }
            }
        };
        // SAFETY: the handle was just made, by the loader or by a creator who promises that it is valid.
        let raw = unsafe { ash::Instance::load(entry.static_fn(), handle) };
        let messenger = if validation {
            let utils = ash::ext::debug_utils::Instance::new(&entry, &raw);
            // SAFETY: debug_utils is enabled; the callback's user data lives in `messages`, freed after the messenger.
            let messenger =
                unsafe { utils.create_debug_utils_messenger(&self::messenger_info(&messages), None) }
                    .at("vkCreateDebugUtilsMessengerEXT")?;
            Some((utils, messenger))
        } else {
            None
        };
        let surface = desc.surface.map(|_| ash::khr::surface::Instance::new(&entry, &raw));
        Ok(Arc::new(Self {
            entry,
            raw,
            surface,
            debug_utils: validation,
            messenger,
            messages,
            validation,
            owned: true,
        }))
    }

    /// Wraps an instance that somebody else owns; it is never destroyed here.
    ///
    /// # Safety
    ///
    /// `get_instance_proc_addr` and `instance` must be valid, of Vulkan 1.3 or newer, and outlive everything made from the result.
    pub(crate) unsafe fn adopt(
        get_instance_proc_addr: vk::PFN_vkGetInstanceProcAddr,
        instance: vk::Instance,
    ) -> Arc<Self> {
        // SAFETY: the caller guarantees both.
        let entry = unsafe { ash::Entry::from_static_fn(ash::StaticFn { get_instance_proc_addr }) };
        // SAFETY: the caller guarantees both.
        let raw = unsafe { ash::Instance::load(entry.static_fn(), instance) };
        Arc::new(Self {
            entry,
            raw,
            surface: None,
            debug_utils: false,
            messenger: None,
            messages: Arc::default(),
            validation: false,
            owned: false,
        })
    }

    /// Whether the validation layer is active.
    pub fn validation(&self) -> bool {
        self.validation
    }

    /// What the validation layer said since the last call (warnings and errors), oldest first; at most 1000 are kept.
    pub fn validation_messages(&self) -> Vec<String> {
        self.messages.drain()
    }

    /// How many messages the validation layer has given altogether.
    pub fn validation_count(&self) -> u64 {
        self.messages.count.load(Ordering::Relaxed)
    }

    /// The raw handle, for an OpenXR session binding.
    pub fn handle(&self) -> vk::Instance {
        self.raw.handle()
    }

    /// The loader's entry point, for somebody who adopts the device.
    pub fn get_instance_proc_addr(&self) -> vk::PFN_vkGetInstanceProcAddr {
        self.entry.static_fn().get_instance_proc_addr
    }

    /// That there is a device that [`Device::new`](crate::Device::new) would choose by itself.
    ///
    /// # Errors
    ///
    /// As there: `VERGENCE_GPU` names none, there is none, or none can do what is required.
    pub fn check_devices(&self) -> Result<(), Error> {
        crate::select::choose(self).map(|_| ())
    }

    /// Every device that the loader offers, suitable or not, for a diagnosis: name, Vulkan version, driver, and what it lacks.
    ///
    /// # Errors
    ///
    /// When the devices cannot be listed.
    pub fn describe_devices(&self) -> Result<Vec<DeviceSummary>, Error> {
        crate::select::summaries(self)
    }
}

/// One device as the loader lists it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DeviceSummary {
    /// Name given by the driver.
    pub name: String,
    /// Driver and its version.
    pub driver: String,
    /// Highest Vulkan version, such as `1.3.230`.
    pub vulkan: String,
    /// `discrete`, `integrated`, `software`, `virtual` or `other`.
    pub kind: &'static str,
    /// What it lacks for this crate; empty means suitable.
    pub missing: Vec<String>,
}

impl Drop for Instance {
    fn drop(&mut self) {
        if let Some((utils, messenger)) = &self.messenger {
            // SAFETY: made by `new` on this instance, destroyed once.
            unsafe { utils.destroy_debug_utils_messenger(*messenger, None) };
        }
        if self.owned {
            // SAFETY: every object made from the instance holds an Arc of it, so none is left.
            unsafe { self.raw.destroy_instance(None) };
        }
    }
}

fn messenger_info(messages: &Arc<Messages>) -> vk::DebugUtilsMessengerCreateInfoEXT<'static> {
    vk::DebugUtilsMessengerCreateInfoEXT::default()
        .message_severity(
            vk::DebugUtilsMessageSeverityFlagsEXT::ERROR | vk::DebugUtilsMessageSeverityFlagsEXT::WARNING,
        )
        .message_type(
            vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION | vk::DebugUtilsMessageTypeFlagsEXT::PERFORMANCE,
        )
        .pfn_user_callback(Some(on_message))
        .user_data(Arc::as_ptr(messages).cast_mut().cast())
}

/// Called by the validation layer, on any thread.
unsafe extern "system" fn on_message(
    _severity: vk::DebugUtilsMessageSeverityFlagsEXT,
    _kind: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    user: *mut c_void,
) -> vk::Bool32 {
    if data.is_null() || user.is_null() {
        return vk::FALSE;
    }
    // SAFETY: `user` is the Messages of the instance, which outlives its messenger; it is shared and locks inside.
    let messages = unsafe { &*user.cast::<Messages>() };
    // SAFETY: the layer gives a valid structure for the time of the call.
    let data = unsafe { &*data };
    // SAFETY: the message is null or a nul-terminated string.
    let text = unsafe { data.message_as_c_str() }.map(|t| t.to_string_lossy().into_owned());
    messages.push(text.unwrap_or_default());
    vk::FALSE
}

/// `1.3.230` from a packed version.
pub(crate) fn version_text(version: u32) -> String {
    format!(
        "{}.{}.{}",
        vk::api_version_major(version),
        vk::api_version_minor(version),
        vk::api_version_patch(version)
    )
}
