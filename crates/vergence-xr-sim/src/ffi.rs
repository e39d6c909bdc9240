//! The border to the application: every pointer that it hands over is looked at here and nowhere else.
//!
//! The functions of the runtime proper take [`In`], [`Out`] and [`Buffer`], which check for null and for the
//! structure type before they give access, so that the rest of the crate is safe code that returns result codes.

use std::ffi::{CStr, c_char, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};

use openxr_sys as sys;

use crate::fault::{self, Active, Effect};
use crate::motion::result_of;

/// What a function of the runtime returns: a success code or an error code of OpenXR.
pub(crate) type XrResult<T = sys::Result> = Result<T, sys::Result>;

/// Runs a function of the runtime, or the fault that is planned for this call or was recorded of it; a panic inside is caught and becomes
/// `XR_ERROR_RUNTIME_FAILURE`. `of` is the handle that is the first argument, 0 where there is none.
pub(crate) fn guard(name: &'static str, of: u64, call: impl FnOnce() -> XrResult) -> sys::Result {
    let effect = fault::effect(name, of).or_else(|| result_of(name, of).map(Effect::Code));
    if let Some(code) = effect.and_then(Effect::replaces_call) {
        return code;
    }
    let _active = match effect {
        Some(Effect::Bad(value)) => Some(Active::new(value)),
        Some(Effect::Hang) => fault::hang(name),
        Some(Effect::Code(_)) | None => None,
    };
    match catch_unwind(AssertUnwindSafe(call)) {
        Ok(Ok(code)) => match effect {
            // The rest of what a planned code can be: a qualified success.
            Some(Effect::Code(qualified)) => qualified,
            _ => code,
        },
        Ok(Err(code)) => {
            log::debug!("{name}: {code:?}");
            code
        }
        Err(_) => {
            log::error!("{name}: the simulated runtime panicked");
            sys::Result::ERROR_RUNTIME_FAILURE
        }
    }
}

/// A structure of OpenXR that starts with its type and a chain pointer.
///
/// # Safety
/// The type is `repr(C)`, starts with `ty: StructureType, next: pointer`, and every bit pattern of its fields is a
/// value (openxr-sys makes enumerations transparent integers).
pub(crate) unsafe trait Typed {
    /// What `ty` must hold.
    const TYPE: sys::StructureType;
}

macro_rules! typed {
    ($($name:ident),+ $(,)?) => { $(
        // SAFETY: openxr-sys generates it `repr(C)` from the registry with `ty` and `next` first and no field
        // that has invalid bit patterns.
        unsafe impl Typed for sys::$name { const TYPE: sys::StructureType = sys::$name::TYPE; }
    )+ };
}

typed!(
    InstanceCreateInfo,
    InstanceProperties,
    ExtensionProperties,
    ApiLayerProperties,
    SystemGetInfo,
    SystemProperties,
    EventDataBuffer,
    SessionCreateInfo,
    SessionBeginInfo,
    ReferenceSpaceCreateInfo,
    ActionSpaceCreateInfo,
    SpaceLocation,
    SpaceVelocity,
    ViewConfigurationProperties,
    ViewConfigurationView,
    SwapchainCreateInfo,
    SwapchainImageVulkanKHR,
    SwapchainImageAcquireInfo,
    SwapchainImageWaitInfo,
    SwapchainImageReleaseInfo,
    FrameWaitInfo,
    FrameState,
    FrameBeginInfo,
    FrameEndInfo,
    CompositionLayerProjection,
    CompositionLayerProjectionView,
    CompositionLayerQuad,
    CompositionLayerDepthInfoKHR,
    ViewLocateInfo,
    ViewState,
    View,
    ActionSetCreateInfo,
    ActionCreateInfo,
    InteractionProfileSuggestedBinding,
    SessionActionSetsAttachInfo,
    InteractionProfileState,
    ActionStateGetInfo,
    ActionStateBoolean,
    ActionStateFloat,
    ActionStateVector2f,
    ActionStatePose,
    ActionsSyncInfo,
    BoundSourcesForActionEnumerateInfo,
    InputSourceLocalizedNameGetInfo,
    HapticActionInfo,
    HapticVibration,
    VisibilityMaskKHR,
    GraphicsBindingVulkanKHR,
    VulkanInstanceCreateInfoKHR,
    VulkanDeviceCreateInfoKHR,
    VulkanGraphicsDeviceGetInfoKHR,
    GraphicsRequirementsVulkanKHR,
    SpacesLocateInfo,
    SpaceLocations,
    SpaceVelocities,
    SystemHandTrackingPropertiesEXT,
    SystemEyeGazeInteractionPropertiesEXT,
    EyeGazeSampleTimeEXT,
    HandTrackerCreateInfoEXT,
    HandJointsLocateInfoEXT,
    HandJointLocationsEXT,
    HandJointVelocitiesEXT,
);

/// A structure that the application hands in.
pub(crate) struct In<'a, T>(*const T, std::marker::PhantomData<&'a T>);

impl<'a, T: Typed> In<'a, T> {
    /// # Safety
    /// `pointer` is null or points to a `T` that lives and is not written during the call (the application's
    /// duty under "Valid Usage" of the OpenXR specification).
    pub(crate) unsafe fn new(pointer: *const T) -> Self {
        Self(pointer, std::marker::PhantomData)
    }

    /// The structure, if it is there and says that it is of the right type.
    pub(crate) fn get(&self) -> XrResult<&'a T> {
        self.optional()?.ok_or(sys::Result::ERROR_VALIDATION_FAILURE)
    }

    /// The structure, if it says that it is of the right type, or `None` where the pointer is null.
    pub(crate) fn optional(&self) -> XrResult<Option<&'a T>> {
        if self.0.is_null() {
            return Ok(None);
        }
        if !self.0.is_aligned() {
            return Err(sys::Result::ERROR_VALIDATION_FAILURE);
        }
        // SAFETY: not null and aligned; that it points to a live structure is what `new` demands. Every typed
        // structure starts with its type.
        let ty = unsafe { self.0.cast::<sys::StructureType>().read() };
        if ty != T::TYPE {
            return Err(sys::Result::ERROR_VALIDATION_FAILURE);
        }
        // SAFETY: as above; the structure says that it is a `T`.
        Ok(Some(unsafe { &*self.0 }))
    }
}

/// A place where the application wants a result.
pub(crate) struct Out<'a, T>(*mut T, std::marker::PhantomData<&'a mut T>);

impl<'a, T> Out<'a, T> {
    /// # Safety
    /// `pointer` is null or points to memory for a `T` that the caller lends for the length of the call.
    pub(crate) unsafe fn new(pointer: *mut T) -> Self {
        Self(pointer, std::marker::PhantomData)
    }

    /// Checks that there is a place.
    pub(crate) fn check(&self) -> XrResult<()> {
        let usable = !self.0.is_null() && self.0.is_aligned();
        if usable { Ok(()) } else { Err(sys::Result::ERROR_VALIDATION_FAILURE) }
    }

    /// Writes the result.
    pub(crate) fn set(&mut self, value: T) -> XrResult<()> {
        self.check()?;
        // SAFETY: not null and aligned; `new` demands that the memory is lent to us.
        unsafe { self.0.write(value) };
        Ok(())
    }
}

impl<'a, T: Typed> Out<'a, T> {
    /// The structure to fill in, if it is there and says that it is of the right type. Only `ty` and `next` are
    /// known to be initialised: the rest is for writing.
    pub(crate) fn fill(&mut self) -> XrResult<&mut T> {
        self.check()?;
        // SAFETY: not null and aligned; `new` demands that the memory is lent to us; every typed structure starts
        // with its type.
        let ty = unsafe { self.0.cast::<sys::StructureType>().read() };
        if ty != T::TYPE {
            return Err(sys::Result::ERROR_VALIDATION_FAILURE);
        }
        // SAFETY: as above; every bit pattern is a value of the fields (`Typed`), which are only written.
        Ok(unsafe { &mut *self.0 })
    }
}

/// The three arguments of the two-call idiom: capacity, count and array.
pub(crate) struct Buffer<'a, T> {
    capacity: u32,
    count: Out<'a, u32>,
    items: *mut T,
}

impl<'a, T> Buffer<'a, T> {
    /// # Safety
    /// `count` and `items` are null or lent for the length of the call, `items` with room for `capacity` elements.
    pub(crate) unsafe fn new(capacity: u32, count: *mut u32, items: *mut T) -> Self {
        // SAFETY: demanded of our caller.
        Self { capacity, count: unsafe { Out::new(count) }, items }
    }

    /// The same arguments for elements of another type: where the type is only known from the call.
    pub(crate) fn cast<U>(self) -> Buffer<'a, U> {
        Buffer { capacity: self.capacity, count: self.count, items: self.items.cast() }
    }

    /// Says how many there are and, where the application asked for them, how many of them may be written.
    fn room(&mut self, found: usize) -> XrResult<Option<usize>> {
        let found = u32::try_from(found).map_err(|_| sys::Result::ERROR_RUNTIME_FAILURE)?;
        let said = fault::bent_count(found);
        self.count.set(said)?;
        if self.capacity == 0 {
            return Ok(None);
        }
        if self.items.is_null() || !self.items.is_aligned() {
            return Err(sys::Result::ERROR_VALIDATION_FAILURE);
        }
        if self.capacity < said {
            return Err(sys::Result::ERROR_SIZE_INSUFFICIENT);
        }
        // Never more is said than is written.
        self.count.set(said.min(found))?;
        Ok(Some(said.min(found) as usize))
    }

    /// Gives plain items.
    pub(crate) fn give(&mut self, found: &[T]) -> XrResult
    where
        T: Copy,
    {
        if let Some(count) = self.room(found.len())? {
            // SAFETY: `room` found an aligned array with space for so many, and there are as many; `new` demands that it
            // is lent to us, and the runtime's own slice cannot lie in it.
            unsafe { std::ptr::copy_nonoverlapping(found.as_ptr(), self.items, count) };
        }
        Ok(sys::Result::SUCCESS)
    }

    /// Gives `found` structures, each filled in by `fill(index, structure)`.
    pub(crate) fn give_typed(&mut self, found: usize, mut fill: impl FnMut(usize, &mut T)) -> XrResult
    where
        T: Typed,
    {
        if let Some(count) = self.room(found)? {
            for index in 0..count {
                // SAFETY: `room` found an array with space for so many, lent to us (`new`).
                let mut place = unsafe { Out::new(self.items.add(index)) };
                fill(index, place.fill()?);
            }
        }
        Ok(sys::Result::SUCCESS)
    }
}

impl Buffer<'_, c_char> {
    /// Gives a text with its terminating zero.
    pub(crate) fn give_text(&mut self, text: &str) -> XrResult {
        let bytes: Vec<c_char> = text.bytes().chain([0]).map(|byte| byte as c_char).collect();
        self.give(&bytes)
    }
}

/// An array inside a structure that the application handed in.
///
/// # Safety
/// `items` is null or points to `count` elements that live and are not written during the call.
pub(crate) unsafe fn array<'a, T>(items: *const T, count: u32) -> XrResult<&'a [T]> {
    if count == 0 {
        return Ok(&[]);
    }
    if items.is_null() || !items.is_aligned() {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    // SAFETY: not null and aligned; the rest is demanded of our caller.
    Ok(unsafe { std::slice::from_raw_parts(items, count as usize) })
}

/// A text that the application handed in, at most `limit` bytes with its zero.
///
/// # Safety
/// `text` is null or points to a zero-terminated string that lives during the call.
pub(crate) unsafe fn text<'a>(text: *const c_char, limit: usize) -> XrResult<&'a str> {
    if text.is_null() {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    // SAFETY: not null; the rest is demanded of our caller.
    let text = unsafe { CStr::from_ptr(text) };
    if text.count_bytes() >= limit {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    text.to_str().map_err(|_| sys::Result::ERROR_VALIDATION_FAILURE)
}

/// A text in a fixed field; `None` where it has no terminating zero or is not UTF-8.
pub(crate) fn field_text(field: &[c_char]) -> Option<&str> {
    let length = field.iter().position(|&c| c == 0)?;
    // SAFETY: `c_char` and `u8` have the same layout; the length is inside the field.
    let bytes = unsafe { std::slice::from_raw_parts(field.as_ptr().cast::<u8>(), length) };
    std::str::from_utf8(bytes).ok()
}

/// A fixed field that holds `text`, cut to what fits with its zero.
pub(crate) fn text_field<const N: usize>(text: &str) -> [c_char; N] {
    let mut field = [0; N];
    for (place, byte) in field.iter_mut().take(N.saturating_sub(1)).zip(text.bytes()) {
        *place = byte as c_char;
    }
    field
}

#[repr(C)]
struct Link {
    ty: sys::StructureType,
    next: *mut c_void,
}

/// How many structures a chain may have: a longer one is taken for a ring.
const LONGEST_CHAIN: usize = 64;

fn find_in_chain(first: *const c_void, wanted: sys::StructureType) -> Option<*mut c_void> {
    let mut link = first.cast::<Link>();
    for _ in 0..LONGEST_CHAIN {
        if link.is_null() || !link.is_aligned() {
            return None;
        }
        // SAFETY: an application may only chain structures that start with type and next (specification, "Valid
        // structure pointer chains").
        let Link { ty, next } = unsafe { link.read() };
        if ty == wanted {
            return Some(link.cast_mut().cast());
        }
        link = next.cast();
    }
    None
}

/// The structure of type `T` in the chain of an input, if one is there.
pub(crate) fn chained<'a, T: Typed>(next: *const c_void) -> Option<&'a T> {
    // SAFETY: it says that it is a `T`; the application keeps its chain alive and unwritten during the call.
    find_in_chain(next, T::TYPE).map(|found| unsafe { &*found.cast::<T>().cast_const() })
}

/// The structure of type `T` in the chain of an output, if one is there, for writing.
pub(crate) fn chained_out<'a, T: Typed>(next: *mut c_void) -> Option<&'a mut T> {
    // SAFETY: it says that it is a `T`; the application lends the chain of an output for writing, and every bit
    // pattern is a value of its fields (`Typed`).
    find_in_chain(next, T::TYPE).map(|found| unsafe { &mut *found.cast::<T>() })
}
