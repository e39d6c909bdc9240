//! `xrGetInstanceProcAddr`: every entry point by its name. Each looks its arguments up, runs inside [`guard`], and
//! nothing else; that is also where a planned fault comes in front of a call.

use std::ffi::c_char;

use openxr_sys as sys;
use sys::pfn;

use crate::extension::Extension;
use crate::ffi::{Buffer, In, Out, XrResult, guard, text};
use crate::handle;
use crate::instance::Instance;
use crate::{
    action, binding, clock, event, frame, hand, input, instance, path, refresh, session, source, space,
    swapchain,
};
use crate::{system, view, vulkan};

/// When a name resolves.
#[derive(Clone, Copy, PartialEq)]
enum When {
    /// Also without an instance.
    Always,
    /// With an instance.
    Core,
    /// With an instance of OpenXR 1.1, or with the extension that it came from.
    Core11(Extension),
    /// With an instance that switched the extension on.
    With(Extension),
}

/// How a raw argument becomes one that the runtime takes.
macro_rules! argument {
    (input $x:ident) => {
        // SAFETY: by OpenXR's implicit valid usage the application hands over null or a pointer valid for the call.
        unsafe { In::new($x) }
    };
    (output $x:ident) => {
        // SAFETY: as for `input`, and nobody else writes there during the call.
        unsafe { Out::new($x) }
    };
    (text64 $x:ident) => {
        // SAFETY: as for `output`; the specification gives the array its 64 bytes.
        unsafe { Out::new($x.cast()) }
    };
    (value $x:ident) => {
        $x
    };
    (handle $x:ident) => {
        $x
    };
    (instance $x:ident) => {
        &*instance::get($x)?
    };
    (shared_instance $x:ident) => {
        instance::get($x)?
    };
    (any_instance $x:ident) => {
        &*handle::get::<Instance>($x)?
    };
    (session $x:ident) => {
        &*session::get($x)?
    };
    (shared_session $x:ident) => {
        session::get($x)?
    };
    (space $x:ident) => {
        &*space::get($x)?
    };
    (swapchain $x:ident) => {
        &*swapchain::get($x)?
    };
    (hand_tracker $x:ident) => {
        &*hand::get($x)?
    };
    (action_set $x:ident) => {
        handle::get::<action::ActionSet>($x)?
    };
}

/// The handle that a call is about, from the first of its arguments; 0 where that is no handle.
macro_rules! first_handle {
    (output $x:ident $($rest:tt)*) => {
        0
    };
    (input $x:ident $($rest:tt)*) => {
        0
    };
    (value $x:ident $($rest:tt)*) => {
        0
    };
    () => {
        0
    };
    ($kind:ident $x:ident $($rest:tt)*) => {
        sys::Handle::into_raw($x)
    };
}

macro_rules! entry_points {
    ($(
        $when:expr, $pfn:ident $name:literal =>
        $function:path { $($kind:ident $x:ident : $ty:ty),* $(; buffer $capacity:ident $count:ident $items:ident : $item:ty)? }
    )+) => {
        /// Every entry point, and whether it fills an array by the two-call idiom.
        pub(crate) const NAMES: &[(&str, bool)] =
            &[$(($name, false $(|| !stringify!($count).is_empty())?)),+];

        fn find(name: &str) -> Option<(When, pfn::VoidFunction)> {
            match name {
                $($name => {
                    unsafe extern "system" fn call(
                        $($x: $ty,)* $($capacity: u32, $count: *mut u32, $items: *mut $item)?
                    ) -> sys::Result {
                        #[allow(clippy::undocumented_unsafe_blocks, reason = "stated once, at `argument`")]
                        guard($name, first_handle!($($kind $x)*), || $function(
                            $(argument!($kind $x),)*
                            // SAFETY: as for `argument!(output …)`: `items` holds `capacity` of them or is null.
                            $(unsafe { Buffer::new($capacity, $count, $items) })?
                        ))
                    }
                    let call: pfn::$pfn = call;
                    // SAFETY: function pointers are of one size; whoever asked for the name knows its type.
                    Some(($when, unsafe { std::mem::transmute::<pfn::$pfn, pfn::VoidFunction>(call) }))
                })+
                _ => None,
            }
        }
    };
}

entry_points! {
    When::Always, GetInstanceProcAddr "xrGetInstanceProcAddr" =>
        resolve { handle instance: sys::Instance, value name: *const c_char, output function: *mut Option<pfn::VoidFunction> }
    When::Always, EnumerateApiLayerProperties "xrEnumerateApiLayerProperties" =>
        instance::enumerate_api_layer_properties { ; buffer capacity count properties: sys::ApiLayerProperties }
    When::Always, EnumerateInstanceExtensionProperties "xrEnumerateInstanceExtensionProperties" =>
        instance::enumerate_instance_extension_properties { value layer: *const c_char; buffer capacity count properties: sys::ExtensionProperties }
    When::Always, CreateInstance "xrCreateInstance" =>
        instance::create_instance { input info: *const sys::InstanceCreateInfo, output out: *mut sys::Instance }
    When::Core, DestroyInstance "xrDestroyInstance" => instance::destroy_instance { handle instance: sys::Instance }
    When::Core, ResultToString "xrResultToString" =>
        instance::result_to_string { any_instance instance: sys::Instance, value value: sys::Result, text64 out: *mut c_char }
    When::Core, StructureTypeToString "xrStructureTypeToString" =>
        instance::structure_type_to_string { any_instance instance: sys::Instance, value value: sys::StructureType, text64 out: *mut c_char }
    When::Core, GetInstanceProperties "xrGetInstanceProperties" =>
        instance::get_instance_properties { instance instance: sys::Instance, output out: *mut sys::InstanceProperties }
    When::Core, PollEvent "xrPollEvent" =>
        event::poll_event { instance instance: sys::Instance, output out: *mut sys::EventDataBuffer }
    When::Core, StringToPath "xrStringToPath" =>
        path::string_to_path { instance instance: sys::Instance, value string: *const c_char, output out: *mut sys::Path }
    When::Core, PathToString "xrPathToString" =>
        path::path_to_string { instance instance: sys::Instance, value path: sys::Path; buffer capacity count text: c_char }
    When::Core, GetSystem "xrGetSystem" =>
        system::get_system { instance instance: sys::Instance, input info: *const sys::SystemGetInfo, output out: *mut sys::SystemId }
    When::Core, GetSystemProperties "xrGetSystemProperties" =>
        system::get_system_properties { instance instance: sys::Instance, value system: sys::SystemId, output out: *mut sys::SystemProperties }
    When::Core, EnumerateEnvironmentBlendModes "xrEnumerateEnvironmentBlendModes" =>
        system::enumerate_environment_blend_modes {
            instance instance: sys::Instance, value system: sys::SystemId, value ty: sys::ViewConfigurationType;
            buffer capacity count modes: sys::EnvironmentBlendMode
        }
    When::Core, EnumerateViewConfigurations "xrEnumerateViewConfigurations" =>
        system::enumerate_view_configurations {
            instance instance: sys::Instance, value system: sys::SystemId; buffer capacity count types: sys::ViewConfigurationType
        }
    When::Core, GetViewConfigurationProperties "xrGetViewConfigurationProperties" =>
        system::get_view_configuration_properties {
            instance instance: sys::Instance, value system: sys::SystemId, value ty: sys::ViewConfigurationType,
            output out: *mut sys::ViewConfigurationProperties
        }
    When::Core, EnumerateViewConfigurationViews "xrEnumerateViewConfigurationViews" =>
        system::enumerate_view_configuration_views {
            instance instance: sys::Instance, value system: sys::SystemId, value ty: sys::ViewConfigurationType;
            buffer capacity count views: sys::ViewConfigurationView
        }
    When::Core, CreateSession "xrCreateSession" =>
        session::create_session { shared_instance instance: sys::Instance, input info: *const sys::SessionCreateInfo, output out: *mut sys::Session }
    When::Core, DestroySession "xrDestroySession" => session::destroy_session { handle session: sys::Session }
    When::Core, BeginSession "xrBeginSession" =>
        session::begin_session { session session: sys::Session, input info: *const sys::SessionBeginInfo }
    When::Core, EndSession "xrEndSession" => session::end_session { session session: sys::Session }
    When::Core, RequestExitSession "xrRequestExitSession" => session::request_exit_session { session session: sys::Session }
    When::Core, WaitFrame "xrWaitFrame" =>
        frame::wait_frame { session session: sys::Session, input info: *const sys::FrameWaitInfo, output out: *mut sys::FrameState }
    When::Core, BeginFrame "xrBeginFrame" =>
        frame::begin_frame { session session: sys::Session, input info: *const sys::FrameBeginInfo }
    When::Core, EndFrame "xrEndFrame" =>
        frame::end_frame { session session: sys::Session, input info: *const sys::FrameEndInfo }
    When::Core, LocateViews "xrLocateViews" =>
        view::locate_views {
            session session: sys::Session, input info: *const sys::ViewLocateInfo, output state: *mut sys::ViewState;
            buffer capacity count views: sys::View
        }
    When::Core, EnumerateReferenceSpaces "xrEnumerateReferenceSpaces" =>
        space::enumerate_reference_spaces { session session: sys::Session; buffer capacity count spaces: sys::ReferenceSpaceType }
    When::Core, CreateReferenceSpace "xrCreateReferenceSpace" =>
        space::create_reference_space {
            shared_session session: sys::Session, input info: *const sys::ReferenceSpaceCreateInfo, output out: *mut sys::Space
        }
    When::Core, GetReferenceSpaceBoundsRect "xrGetReferenceSpaceBoundsRect" =>
        space::get_reference_space_bounds_rect {
            session session: sys::Session, value ty: sys::ReferenceSpaceType, output out: *mut sys::Extent2Df
        }
    When::Core, CreateActionSpace "xrCreateActionSpace" =>
        space::create_action_space {
            shared_session session: sys::Session, input info: *const sys::ActionSpaceCreateInfo, output out: *mut sys::Space
        }
    When::Core, LocateSpace "xrLocateSpace" =>
        space::locate_space {
            space space: sys::Space, space base: sys::Space, value time: sys::Time, output out: *mut sys::SpaceLocation
        }
    When::Core, DestroySpace "xrDestroySpace" => space::destroy_space { handle space: sys::Space }
    When::Core, EnumerateSwapchainFormats "xrEnumerateSwapchainFormats" =>
        swapchain::enumerate_swapchain_formats { session session: sys::Session; buffer capacity count formats: i64 }
    When::Core, CreateSwapchain "xrCreateSwapchain" =>
        swapchain::create_swapchain {
            shared_session session: sys::Session, input info: *const sys::SwapchainCreateInfo, output out: *mut sys::Swapchain
        }
    When::Core, DestroySwapchain "xrDestroySwapchain" => swapchain::destroy_swapchain { handle swapchain: sys::Swapchain }
    When::Core, EnumerateSwapchainImages "xrEnumerateSwapchainImages" =>
        swapchain_images { swapchain swapchain: sys::Swapchain; buffer capacity count images: sys::SwapchainImageBaseHeader }
    When::Core, AcquireSwapchainImage "xrAcquireSwapchainImage" =>
        swapchain::acquire_swapchain_image {
            swapchain swapchain: sys::Swapchain, input info: *const sys::SwapchainImageAcquireInfo, output out: *mut u32
        }
    When::Core, WaitSwapchainImage "xrWaitSwapchainImage" =>
        swapchain::wait_swapchain_image { swapchain swapchain: sys::Swapchain, input info: *const sys::SwapchainImageWaitInfo }
    When::Core, ReleaseSwapchainImage "xrReleaseSwapchainImage" =>
        swapchain::release_swapchain_image { swapchain swapchain: sys::Swapchain, input info: *const sys::SwapchainImageReleaseInfo }
    When::Core, CreateActionSet "xrCreateActionSet" =>
        action::create_action_set {
            shared_instance instance: sys::Instance, input info: *const sys::ActionSetCreateInfo, output out: *mut sys::ActionSet
        }
    When::Core, DestroyActionSet "xrDestroyActionSet" => action::destroy_action_set { handle set: sys::ActionSet }
    When::Core, CreateAction "xrCreateAction" =>
        action::create_action { action_set set: sys::ActionSet, input info: *const sys::ActionCreateInfo, output out: *mut sys::Action }
    When::Core, DestroyAction "xrDestroyAction" => action::destroy_action { handle action: sys::Action }
    When::Core, SuggestInteractionProfileBindings "xrSuggestInteractionProfileBindings" =>
        binding::suggest_interaction_profile_bindings {
            instance instance: sys::Instance, input info: *const sys::InteractionProfileSuggestedBinding
        }
    When::Core, AttachSessionActionSets "xrAttachSessionActionSets" =>
        binding::attach_session_action_sets { session session: sys::Session, input info: *const sys::SessionActionSetsAttachInfo }
    When::Core, GetCurrentInteractionProfile "xrGetCurrentInteractionProfile" =>
        binding::get_current_interaction_profile {
            session session: sys::Session, value user: sys::Path, output out: *mut sys::InteractionProfileState
        }
    When::Core, SyncActions "xrSyncActions" =>
        input::sync_actions { session session: sys::Session, input info: *const sys::ActionsSyncInfo }
    When::Core, GetActionStateBoolean "xrGetActionStateBoolean" =>
        input::get_action_state_boolean {
            session session: sys::Session, input info: *const sys::ActionStateGetInfo, output out: *mut sys::ActionStateBoolean
        }
    When::Core, GetActionStateFloat "xrGetActionStateFloat" =>
        input::get_action_state_float {
            session session: sys::Session, input info: *const sys::ActionStateGetInfo, output out: *mut sys::ActionStateFloat
        }
    When::Core, GetActionStateVector2f "xrGetActionStateVector2f" =>
        input::get_action_state_vector2f {
            session session: sys::Session, input info: *const sys::ActionStateGetInfo, output out: *mut sys::ActionStateVector2f
        }
    When::Core, GetActionStatePose "xrGetActionStatePose" =>
        input::get_action_state_pose {
            session session: sys::Session, input info: *const sys::ActionStateGetInfo, output out: *mut sys::ActionStatePose
        }
    When::Core, EnumerateBoundSourcesForAction "xrEnumerateBoundSourcesForAction" =>
        source::enumerate_bound_sources_for_action {
            session session: sys::Session, input info: *const sys::BoundSourcesForActionEnumerateInfo;
            buffer capacity count sources: sys::Path
        }
    When::Core, GetInputSourceLocalizedName "xrGetInputSourceLocalizedName" =>
        source::get_input_source_localized_name {
            session session: sys::Session, input info: *const sys::InputSourceLocalizedNameGetInfo;
            buffer capacity count text: c_char
        }
    When::Core, ApplyHapticFeedback "xrApplyHapticFeedback" =>
        apply_haptic_feedback {
            session session: sys::Session, input info: *const sys::HapticActionInfo, value feedback: *const sys::HapticBaseHeader
        }
    When::Core, StopHapticFeedback "xrStopHapticFeedback" =>
        source::stop_haptic_feedback { session session: sys::Session, input info: *const sys::HapticActionInfo }
    When::Core11(Extension::LocateSpaces), LocateSpaces "xrLocateSpaces" =>
        space::locate_spaces { session session: sys::Session, input info: *const sys::SpacesLocateInfo, output out: *mut sys::SpaceLocations }
    When::With(Extension::LocateSpaces), LocateSpaces "xrLocateSpacesKHR" =>
        space::locate_spaces { session session: sys::Session, input info: *const sys::SpacesLocateInfo, output out: *mut sys::SpaceLocations }
    When::With(Extension::VulkanEnable2), GetVulkanGraphicsRequirements2KHR "xrGetVulkanGraphicsRequirements2KHR" =>
        vulkan::get_vulkan_graphics_requirements2 {
            instance instance: sys::Instance, value system: sys::SystemId, output out: *mut sys::GraphicsRequirementsVulkanKHR
        }
    When::With(Extension::VulkanEnable2), CreateVulkanInstanceKHR "xrCreateVulkanInstanceKHR" =>
        vulkan::create_vulkan_instance {
            instance instance: sys::Instance, input info: *const sys::VulkanInstanceCreateInfoKHR,
            output out: *mut sys::platform::VkInstance, output result: *mut sys::platform::VkResult
        }
    When::With(Extension::VulkanEnable2), GetVulkanGraphicsDevice2KHR "xrGetVulkanGraphicsDevice2KHR" =>
        vulkan::get_vulkan_graphics_device2 {
            instance instance: sys::Instance, input info: *const sys::VulkanGraphicsDeviceGetInfoKHR,
            output out: *mut sys::platform::VkPhysicalDevice
        }
    When::With(Extension::VulkanEnable2), CreateVulkanDeviceKHR "xrCreateVulkanDeviceKHR" =>
        vulkan::create_vulkan_device {
            instance instance: sys::Instance, input info: *const sys::VulkanDeviceCreateInfoKHR,
            output out: *mut sys::platform::VkDevice, output result: *mut sys::platform::VkResult
        }
    When::With(Extension::VisibilityMask), GetVisibilityMaskKHR "xrGetVisibilityMaskKHR" =>
        view::get_visibility_mask {
            session session: sys::Session, value ty: sys::ViewConfigurationType, value view: u32,
            value mask: sys::VisibilityMaskTypeKHR, output out: *mut sys::VisibilityMaskKHR
        }
    When::With(Extension::HandTracking), CreateHandTrackerEXT "xrCreateHandTrackerEXT" =>
        hand::create_hand_tracker {
            shared_session session: sys::Session, input info: *const sys::HandTrackerCreateInfoEXT,
            output out: *mut sys::HandTrackerEXT
        }
    When::With(Extension::HandTracking), DestroyHandTrackerEXT "xrDestroyHandTrackerEXT" =>
        hand::destroy_hand_tracker { handle tracker: sys::HandTrackerEXT }
    When::With(Extension::HandTracking), LocateHandJointsEXT "xrLocateHandJointsEXT" =>
        hand::locate_hand_joints {
            hand_tracker tracker: sys::HandTrackerEXT, input info: *const sys::HandJointsLocateInfoEXT,
            output out: *mut sys::HandJointLocationsEXT
        }
    When::With(Extension::DisplayRefreshRate), EnumerateDisplayRefreshRatesFB "xrEnumerateDisplayRefreshRatesFB" =>
        refresh::enumerate_display_refresh_rates { session session: sys::Session; buffer capacity count rates: f32 }
    When::With(Extension::DisplayRefreshRate), GetDisplayRefreshRateFB "xrGetDisplayRefreshRateFB" =>
        refresh::get_display_refresh_rate { session session: sys::Session, output out: *mut f32 }
    When::With(Extension::DisplayRefreshRate), RequestDisplayRefreshRateFB "xrRequestDisplayRefreshRateFB" =>
        refresh::request_display_refresh_rate { session session: sys::Session, value rate: f32 }
    When::With(Extension::ConvertTimespecTime), ConvertTimespecTimeToTimeKHR "xrConvertTimespecTimeToTimeKHR" =>
        clock::convert_timespec_to_time {
            instance instance: sys::Instance, value timespec: *const libc::timespec, output out: *mut sys::Time
        }
    When::With(Extension::ConvertTimespecTime), ConvertTimeToTimespecTimeKHR "xrConvertTimeToTimespecTimeKHR" =>
        clock::convert_time_to_timespec {
            instance instance: sys::Instance, value time: sys::Time, output out: *mut libc::timespec
        }
}

/// The images of a swapchain: the one array whose element type depends on the graphics API, which here is Vulkan.
fn swapchain_images(
    swapchain: &swapchain::Swapchain,
    buffer: Buffer<sys::SwapchainImageBaseHeader>,
) -> XrResult {
    swapchain::enumerate_swapchain_images(swapchain, buffer.cast())
}

/// Vibration is the one kind of feedback; others come with extensions.
fn apply_haptic_feedback(
    session: &session::Session,
    info: In<sys::HapticActionInfo>,
    feedback: *const sys::HapticBaseHeader,
) -> XrResult {
    // SAFETY: as for every argument; `In` looks at the type before anything else of the structure.
    let vibration = unsafe { In::new(feedback.cast::<sys::HapticVibration>()) };
    source::apply_haptic_feedback(session, info, vibration)
}

fn resolve(
    instance: sys::Instance,
    name: *const c_char,
    mut out: Out<Option<pfn::VoidFunction>>,
) -> XrResult {
    out.set(None)?;
    // SAFETY: the application hands over a zero-terminated string or null.
    let name = unsafe { text(name, usize::MAX) }?;
    let found = find(name);
    if instance == <sys::Instance as sys::Handle>::NULL {
        let (_, function) =
            found.filter(|(when, _)| *when == When::Always).ok_or(sys::Result::ERROR_HANDLE_INVALID)?;
        out.set(Some(function))?;
        return Ok(sys::Result::SUCCESS);
    }
    let instance = handle::get::<Instance>(instance)?;
    let there = |when: &When| match *when {
        When::Always | When::Core => true,
        When::Core11(extension) => instance.minor >= 1 || instance.has(extension),
        When::With(extension) => instance.has(extension),
    };
    let found = found.filter(|(when, _)| there(when));
    let (_, function) = found.ok_or(sys::Result::ERROR_FUNCTION_UNSUPPORTED)?;
    out.set(Some(function))?;
    Ok(sys::Result::SUCCESS)
}

/// The runtime's `xrGetInstanceProcAddr`: where everything begins, for `openxr::Entry::from_get_instance_proc_addr` as
/// for a loader.
///
/// # Safety
/// `name` is null or zero-terminated; `function` is null or writable.
pub unsafe extern "system" fn get_instance_proc_addr(
    instance: sys::Instance,
    name: *const c_char,
    function: *mut Option<pfn::VoidFunction>,
) -> sys::Result {
    // SAFETY: demanded of the caller.
    let out = unsafe { Out::new(function) };
    guard("xrGetInstanceProcAddr", sys::Handle::into_raw(instance), || resolve(instance, name, out))
}
