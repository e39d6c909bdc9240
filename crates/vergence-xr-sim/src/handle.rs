//! Handles: a slot and the generation of its content, so that a stale or invented handle is recognised.

use std::any::Any;
use std::sync::{Arc, PoisonError, RwLock};

use openxr_sys as sys;

use crate::ffi::XrResult;

/// Something that the application knows by a handle.
pub(crate) trait Object: Any + Send + Sync {
    /// The handle type of OpenXR.
    type Handle: sys::Handle;
}

struct Slot {
    generation: u32,
    parent: u64,
    object: Option<Arc<dyn Any + Send + Sync>>,
}

/// Every object of every instance in this process. One table, so that a handle is valid for exactly one object.
static SLOTS: RwLock<Vec<Slot>> = RwLock::new(Vec::new());

fn split(handle: u64) -> Option<(usize, u32)> {
    let index = (handle & 0xffff_ffff).checked_sub(1)?;
    Some((usize::try_from(index).ok()?, (handle >> 32) as u32))
}

fn join(index: usize, generation: u32) -> u64 {
    (u64::from(generation) << 32) | (index as u64 + 1)
}

/// Gives the object that `make` creates a handle; it dies with `parent` (0: with nothing). The object is told its
/// handle when it is made.
pub(crate) fn insert<T: Object>(parent: u64, make: impl FnOnce(T::Handle) -> T) -> (T::Handle, Arc<T>) {
    let mut slots = SLOTS.write().unwrap_or_else(PoisonError::into_inner);
    let free = slots.iter().position(|slot| slot.object.is_none() && slot.generation != u32::MAX);
    let index = free.unwrap_or_else(|| {
        slots.push(Slot { generation: 0, parent: 0, object: None });
        slots.len() - 1
    });
    let slot = &mut slots[index];
    slot.generation += 1;
    slot.parent = parent;
    let handle = <T::Handle as sys::Handle>::from_raw(join(index, slot.generation));
    let object = Arc::new(make(handle));
    slot.object = Some(object.clone());
    (handle, object)
}

/// The object behind a handle.
///
/// # Errors
/// `XR_ERROR_HANDLE_INVALID` where it is null, invented, destroyed, or belongs to another kind of object.
pub(crate) fn get<T: Object>(handle: T::Handle) -> XrResult<Arc<T>> {
    let invalid = sys::Result::ERROR_HANDLE_INVALID;
    let (index, generation) = split(sys::Handle::into_raw(handle)).ok_or(invalid)?;
    let slots = SLOTS.read().unwrap_or_else(PoisonError::into_inner);
    let slot = slots.get(index).filter(|slot| slot.generation == generation).ok_or(invalid)?;
    slot.object.clone().and_then(|object| object.downcast::<T>().ok()).ok_or(invalid)
}

/// The object at the root of what `handle` belongs to: what was made with no parent. `None` where the handle is invalid.
pub(crate) fn root<T: Object>(handle: u64) -> Option<Arc<T>> {
    let slots = SLOTS.read().unwrap_or_else(PoisonError::into_inner);
    let slot_of = |handle: u64| {
        let (index, generation) = split(handle)?;
        slots.get(index).filter(|slot| slot.generation == generation)
    };
    let mut slot = slot_of(handle)?;
    while slot.parent != 0 {
        slot = slot_of(slot.parent)?;
    }
    slot.object.clone()?.downcast::<T>().ok()
}

/// Destroys the object behind a handle and everything that was made from it.
///
/// # Errors
/// As [`get`].
pub(crate) fn remove<T: Object>(handle: T::Handle) -> XrResult<Arc<T>> {
    let object = get::<T>(handle)?;
    let mut dead = Vec::new();
    let mut slots = SLOTS.write().unwrap_or_else(PoisonError::into_inner);
    let mut doomed = vec![sys::Handle::into_raw(handle)];
    while let Some(handle) = doomed.pop() {
        for (index, slot) in slots.iter().enumerate() {
            if slot.object.is_some() && slot.parent == handle {
                doomed.push(join(index, slot.generation));
            }
        }
        if let Some((index, _)) = split(handle) {
            dead.extend(slots.get_mut(index).and_then(|slot| slot.object.take()));
        }
    }
    // Objects run their own destructors, which may come back here: not under the lock. Children go first.
    drop(slots);
    dead.into_iter().rev().for_each(drop);
    Ok(object)
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Parent;
    struct Child;
    impl Object for Parent {
        type Handle = sys::Session;
    }
    impl Object for Child {
        type Handle = sys::Space;
    }

    #[test]
    fn a_handle_dies_with_its_object_and_with_the_parent_and_is_never_used_again() {
        let (session, _) = insert(0, |_| Parent);
        let raw = sys::Handle::into_raw(session);
        let (space, _) = insert(raw, |_| Child);
        let (other, _) = insert(raw, |_| Child);
        assert!(get::<Child>(space).is_ok());
        let as_session = <sys::Session as sys::Handle>::from_raw(sys::Handle::into_raw(space));
        assert_eq!(get::<Parent>(as_session).err(), Some(sys::Result::ERROR_HANDLE_INVALID));
        assert!(remove::<Child>(space).is_ok());
        assert_eq!(remove::<Child>(space).err(), Some(sys::Result::ERROR_HANDLE_INVALID));
        let (again, _) = insert(raw, |_| Child);
        assert_ne!(sys::Handle::into_raw(again), sys::Handle::into_raw(space));
        assert!(remove::<Parent>(session).is_ok());
        for space in [other, again, <sys::Space as sys::Handle>::NULL, sys::Handle::from_raw(u64::MAX)] {
            assert_eq!(get::<Child>(space).err(), Some(sys::Result::ERROR_HANDLE_INVALID));
        }
    }
}
