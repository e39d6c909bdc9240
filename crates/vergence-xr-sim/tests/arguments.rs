//! What an application may hand in by mistake: null pointers and structures of another type, to every kind of function.

#![allow(clippy::unwrap_used, reason = "a test fails where it cannot go on")]
#![allow(unsafe_code, reason = "the runtime is called through its C interface")]

use std::ptr::{null, null_mut};

use openxr as xr;
use vergence_xr_sim::{Config, Runtime, get_instance_proc_addr};
use xr::sys;

/// A structure that says to be of a type that no function takes, large enough for any.
#[repr(C, align(16))]
struct Wrong {
    ty: sys::StructureType,
    rest: [u64; 1024],
}

/// Calls each function with a null pointer and with a wrong structure: where the specification wants a structure, both
/// are `XR_ERROR_VALIDATION_FAILURE`.
macro_rules! refuse {
    ($wrong:ident: $($function:ident ($($before:expr),*; $($after:expr),*)),+ $(,)?) => { $(
        // SAFETY: handles are valid; the pointers are null or to a structure that is large enough for every type.
        let codes = unsafe {
            [
                ($function)($($before,)* null_mut::<Wrong>().cast() $(, $after)*),
                ($function)($($before,)* (&raw mut $wrong).cast() $(, $after)*),
            ]
        };
        assert_eq!(codes, [sys::Result::ERROR_VALIDATION_FAILURE; 2], stringify!($function));
    )+ };
}

#[test]
fn structures_that_are_missing_or_of_another_type_are_refused() {
    Runtime::configure(Config::default());
    // SAFETY: the runtime follows the specification.
    let entry = unsafe { xr::Entry::from_get_instance_proc_addr(get_instance_proc_addr, &()).unwrap() };
    let mut extensions = xr::ExtensionSet::default();
    extensions.mnd_headless = true;
    let version = xr::Version::new(1, 0, 0);
    let info = xr::ApplicationInfo { application_name: "test", api_version: version, ..Default::default() };
    let instance = entry.create_instance(&info, &extensions, &[], &()).unwrap();
    let system = instance.system(xr::FormFactor::HEAD_MOUNTED_DISPLAY).unwrap();
    // SAFETY: a headless session has no graphics binding.
    let (session, _waiter, _stream) = unsafe {
        instance.create_session::<xr::Headless>(system, &xr::headless::SessionCreateInfo {}).unwrap()
    };
    session.begin(xr::ViewConfigurationType::PRIMARY_STEREO).unwrap();
    let space = session.create_reference_space(xr::ReferenceSpaceType::VIEW, xr::Posef::IDENTITY).unwrap();
    let set = instance.create_action_set("set", "Set", 0).unwrap();
    let (i, s, p, a) = (instance.as_raw(), session.as_raw(), space.as_raw(), set.as_raw());
    let stereo = xr::ViewConfigurationType::PRIMARY_STEREO;
    let (one, mut count) = (sys::Time::from_nanos(1), 0_u32);
    let mut wrong = Wrong { ty: sys::StructureType::from_raw(0x7fff_fff0), rest: [0; 1024] };
    let sys_entry = entry.fp();
    let create_instance = sys_entry.create_instance;
    let fp = instance.fp();
    let xr::raw::Instance {
        get_instance_properties,
        poll_event,
        get_system,
        get_system_properties,
        get_view_configuration_properties,
        create_session,
        create_action_set,
        suggest_interaction_profile_bindings,
        create_action,
        create_reference_space,
        create_action_space,
        create_swapchain,
        locate_space,
        locate_views,
        wait_frame,
        end_frame,
        begin_session,
        attach_session_action_sets,
        sync_actions,
        get_action_state_boolean,
        get_action_state_float,
        get_action_state_vector2f,
        get_action_state_pose,
        enumerate_bound_sources_for_action,
        get_input_source_localized_name,
        apply_haptic_feedback,
        stop_haptic_feedback,
        ..
    } = *fp;
    let user = instance.string_to_path("/user/hand/left").unwrap();
    let mut instance_out = sys::Instance::default();
    let (mut session_out, mut space_out) = (sys::Session::default(), sys::Space::default());
    let (mut set_out, mut action_out) = (sys::ActionSet::default(), sys::Action::default());
    let (mut chain_out, mut system_out) = (sys::Swapchain::default(), sys::SystemId::NULL);
    assert_ne!(user, xr::Path::NULL);
    refuse! { wrong:
        create_instance(; &mut instance_out),
        get_instance_properties(i;),
        poll_event(i;),
        get_system(i; &mut system_out),
        get_system_properties(i, system;),
        get_view_configuration_properties(i, system, stereo;),
        create_session(i; &mut session_out),
        create_action_set(i; &mut set_out),
        suggest_interaction_profile_bindings(i;),
        create_action(a; &mut action_out),
        create_reference_space(s; &mut space_out),
        create_action_space(s; &mut space_out),
        create_swapchain(s; &mut chain_out),
        locate_space(p, p, one;),
        locate_views(s; null_mut(), 0, &mut count, null_mut()),
        wait_frame(s, null();),
        end_frame(s;),
        begin_session(s;),
        attach_session_action_sets(s;),
        sync_actions(s;),
        get_action_state_boolean(s; null_mut()),
        get_action_state_float(s; null_mut()),
        get_action_state_vector2f(s; null_mut()),
        get_action_state_pose(s; null_mut()),
        enumerate_bound_sources_for_action(s; 0, &mut count, null_mut()),
        get_input_source_localized_name(s; 0, &mut count, null_mut()),
        apply_haptic_feedback(s; null()),
        stop_haptic_feedback(s;),
    }
    assert!(wrong.rest.iter().all(|&word| word == 0), "nothing was written to a structure that was refused");
    assert_eq!(wrong.ty.into_raw(), 0x7fff_fff0);
}

/// A chain that bites its own tail, and one with structures that nobody knows, do no harm.
#[test]
fn chains_may_be_long_unknown_or_a_ring() {
    Runtime::configure(Config::default());
    // SAFETY: the runtime follows the specification.
    let entry = unsafe { xr::Entry::from_get_instance_proc_addr(get_instance_proc_addr, &()).unwrap() };
    let mut extensions = xr::ExtensionSet::default();
    extensions.mnd_headless = true;
    let version = xr::Version::new(1, 0, 0);
    let info = xr::ApplicationInfo { application_name: "test", api_version: version, ..Default::default() };
    let instance = entry.create_instance(&info, &extensions, &[], &()).unwrap();
    let system = instance.system(xr::FormFactor::HEAD_MOUNTED_DISPLAY).unwrap();
    let mut ring = sys::BaseOutStructure { ty: sys::StructureType::from_raw(0x7fff_fff1), next: null_mut() };
    ring.next = &raw mut ring;
    let info = sys::SessionCreateInfo {
        ty: sys::SessionCreateInfo::TYPE,
        next: (&raw const ring).cast(),
        create_flags: sys::SessionCreateFlags::EMPTY,
        system_id: system,
    };
    let mut session = sys::Session::default();
    // SAFETY: the structures live during the call.
    let code = unsafe { (instance.fp().create_session)(instance.as_raw(), &info, &mut session) };
    assert_eq!(code, sys::Result::SUCCESS);
}
