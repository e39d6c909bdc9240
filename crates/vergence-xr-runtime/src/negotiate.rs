//! The one symbol that the loader looks up.

use openxr_sys as sys;
use vergence_xr_sim::{Runtime, get_instance_proc_addr};

use crate::environment;

/// The version of the interface between loader and runtime that is spoken here.
const INTERFACE: u32 = 1;
const OPENXR_1_0: sys::Version = sys::Version::new(1, 0, 0);

/// Tells the loader where the runtime begins, once the environment has said what the headset is.
///
/// Returns `XR_ERROR_INITIALIZATION_FAILED` where the loader speaks another interface or another OpenXR, hands over
/// something else than the two structures, or the environment is wrong (said on stderr).
///
/// # Safety
/// The pointers are null or point to structures that start as the OpenXR loader's interface says; `request` is writable.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn xrNegotiateLoaderRuntimeInterface(
    info: *const sys::NegotiateLoaderInfo,
    request: *mut sys::NegotiateRuntimeRequest,
) -> sys::Result {
    // Nothing unwinds into the loader.
    let agreed = std::panic::catch_unwind(|| {
        // SAFETY: demanded of the caller.
        unsafe { negotiate(info, request) }
    });
    match agreed {
        Ok(Some(())) => sys::Result::SUCCESS,
        _ => sys::Result::ERROR_INITIALIZATION_FAILED,
    }
}

/// # Safety
/// As [`xrNegotiateLoaderRuntimeInterface`].
unsafe fn negotiate(
    info: *const sys::NegotiateLoaderInfo,
    request: *mut sys::NegotiateRuntimeRequest,
) -> Option<()> {
    if info.is_null() || !info.is_aligned() || request.is_null() || !request.is_aligned() {
        return None;
    }
    // SAFETY: not null and aligned; the caller guarantees the header that is looked at first.
    let is_info = unsafe {
        (*info).struct_type == sys::NegotiateLoaderInfo::TYPE
            && (*info).struct_version == sys::NegotiateLoaderInfo::VERSION
            && (*info).struct_size == size_of::<sys::NegotiateLoaderInfo>()
    };
    // SAFETY: as above.
    let is_request = unsafe {
        (*request).struct_type == sys::NegotiateRuntimeRequest::TYPE
            && (*request).struct_version == sys::NegotiateRuntimeRequest::VERSION
            && (*request).struct_size == size_of::<sys::NegotiateRuntimeRequest>()
    };
    if !(is_info && is_request) {
        return None;
    }
    // SAFETY: it says that it is the structure, in its version and size.
    let info = unsafe { &*info };
    let spoken = (info.min_interface_version..=info.max_interface_version).contains(&INTERFACE);
    if !spoken || info.min_api_version > sys::CURRENT_API_VERSION || info.max_api_version < OPENXR_1_0 {
        return None;
    }
    let config = match environment::configuration(|name| std::env::var(name).ok()) {
        Ok(config) => config,
        Err(error) => {
            eprintln!("vergence OpenXR runtime: {error}");
            return None;
        }
    };
    Runtime::configure_process(config);
    // SAFETY: the caller lends the structure for writing, and it says that it is one.
    let request = unsafe { &mut *request };
    request.runtime_interface_version = INTERFACE;
    request.runtime_api_version = sys::CURRENT_API_VERSION;
    request.get_instance_proc_addr = Some(get_instance_proc_addr);
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn loader() -> sys::NegotiateLoaderInfo {
        sys::NegotiateLoaderInfo {
            struct_type: sys::NegotiateLoaderInfo::TYPE,
            struct_version: sys::NegotiateLoaderInfo::VERSION,
            struct_size: size_of::<sys::NegotiateLoaderInfo>(),
            min_interface_version: 1,
            max_interface_version: 1,
            min_api_version: OPENXR_1_0,
            max_api_version: sys::Version::new(1, 1023, 4095),
        }
    }

    fn request() -> sys::NegotiateRuntimeRequest {
        sys::NegotiateRuntimeRequest {
            struct_type: sys::NegotiateRuntimeRequest::TYPE,
            struct_version: sys::NegotiateRuntimeRequest::VERSION,
            struct_size: size_of::<sys::NegotiateRuntimeRequest>(),
            runtime_interface_version: 0,
            runtime_api_version: sys::Version::new(0, 0, 0),
            get_instance_proc_addr: None,
        }
    }

    fn negotiate(info: &sys::NegotiateLoaderInfo, request: &mut sys::NegotiateRuntimeRequest) -> sys::Result {
        // SAFETY: both are structures of the interface.
        unsafe { xrNegotiateLoaderRuntimeInterface(info, request) }
    }

    #[test]
    fn a_loader_of_this_interface_gets_the_entry_point_and_others_get_nothing() {
        let mut agreed = request();
        assert_eq!(negotiate(&loader(), &mut agreed), sys::Result::SUCCESS);
        assert_eq!(agreed.runtime_interface_version, 1);
        assert!(agreed.get_instance_proc_addr.is_some());
        let newer =
            sys::NegotiateLoaderInfo { min_interface_version: 2, max_interface_version: 3, ..loader() };
        let api_2 = sys::NegotiateLoaderInfo { min_api_version: sys::Version::new(2, 0, 0), ..loader() };
        let short = sys::NegotiateLoaderInfo { struct_size: 8, ..loader() };
        for wrong in [newer, api_2, short] {
            let mut refused = request();
            assert_eq!(negotiate(&wrong, &mut refused), sys::Result::ERROR_INITIALIZATION_FAILED);
            assert!(refused.get_instance_proc_addr.is_none());
        }
        let mut other = sys::NegotiateRuntimeRequest { struct_version: 2, ..request() };
        assert_eq!(negotiate(&loader(), &mut other), sys::Result::ERROR_INITIALIZATION_FAILED);
        // SAFETY: null is allowed.
        let nothing = unsafe { xrNegotiateLoaderRuntimeInterface(std::ptr::null(), std::ptr::null_mut()) };
        assert_eq!(nothing, sys::Result::ERROR_INITIALIZATION_FAILED);
    }
}
