//! The Vulkan features that composition needs, added to what an application asks for.

use std::ffi::c_void;
use std::mem::offset_of;

use vergence_gpu::vk;
use vk::{Bool32, StructureType as S};

/// Structures in one chain; longer ones are taken for circles.
const MOST_LINKS: usize = 64;

/// A feature, and where the application may have named it already.
struct Wanted {
    /// The structure of a whole Vulkan version, and where the feature stands in it, bytes.
    version: S,
    offset: usize,
    /// The structure of the extension that it came from; the feature is its first.
    alone: S,
}

const WANTED: [Wanted; 6] = {
    type F11 = vk::PhysicalDeviceVulkan11Features<'static>;
    type F12 = vk::PhysicalDeviceVulkan12Features<'static>;
    type F13 = vk::PhysicalDeviceVulkan13Features<'static>;
    const fn wanted(version: S, offset: usize, alone: S) -> Wanted {
        Wanted { version, offset, alone }
    }
    let (v11, v12, v13) = (
        S::PHYSICAL_DEVICE_VULKAN_1_1_FEATURES,
        S::PHYSICAL_DEVICE_VULKAN_1_2_FEATURES,
        S::PHYSICAL_DEVICE_VULKAN_1_3_FEATURES,
    );
    [
        wanted(v11, offset_of!(F11, multiview), S::PHYSICAL_DEVICE_MULTIVIEW_FEATURES),
        wanted(v12, offset_of!(F12, timeline_semaphore), S::PHYSICAL_DEVICE_TIMELINE_SEMAPHORE_FEATURES),
        wanted(v12, offset_of!(F12, host_query_reset), S::PHYSICAL_DEVICE_HOST_QUERY_RESET_FEATURES),
        wanted(v13, offset_of!(F13, dynamic_rendering), S::PHYSICAL_DEVICE_DYNAMIC_RENDERING_FEATURES),
        wanted(v13, offset_of!(F13, synchronization2), S::PHYSICAL_DEVICE_SYNCHRONIZATION_2_FEATURES),
        wanted(v13, offset_of!(F13, maintenance4), S::PHYSICAL_DEVICE_MAINTENANCE_4_FEATURES),
    ]
};

/// The feature structure of an extension: up to four switches after type and next.
#[repr(C)]
struct Alone {
    kind: S,
    next: *mut c_void,
    switches: [Bool32; 4],
}

/// Switches that were turned on for one call; dropping it puts the application's structures back as they were, then
/// the structures that were chained in front go.
pub(crate) struct Features {
    added: [Alone; WANTED.len()],
    turned: Vec<*mut Bool32>,
}

impl Features {
    /// Turns the features on in the application's own structures where it has them, since Vulkan forbids to name a
    /// feature twice, and gives structures for the others; [`Features::chain`] puts them in front.
    ///
    /// # Safety
    /// `chain` is a chain of Vulkan structures that nobody else reads or writes until this is dropped.
    pub unsafe fn turn_on(chain: *const c_void) -> Self {
        let added =
            WANTED.map(|wanted| Alone { kind: wanted.alone, next: std::ptr::null_mut(), switches: [0; 4] });
        let mut this = Self { added, turned: Vec::with_capacity(WANTED.len()) };
        for (wanted, added) in WANTED.iter().zip(&mut this.added) {
            let first_switch = offset_of!(Alone, switches);
            // SAFETY: the chain is one of Vulkan structures, says the caller.
            let place = unsafe { find(chain, wanted.version) }.map(|link| (link, wanted.offset)).or_else(
                // SAFETY: as above.
                || unsafe { find(chain, wanted.alone) }.map(|link| (link, first_switch)),
            );
            let Some((link, offset)) = place else {
                added.switches[0] = vk::TRUE;
                continue;
            };
            // SAFETY: the structure is of the type that has the switch there, and nobody else looks at it now.
            let switch = unsafe { link.byte_add(offset).cast::<Bool32>() };
            // SAFETY: as above.
            if unsafe { switch.read() } == vk::FALSE {
                // SAFETY: as above; the destructor puts it back.
                unsafe { switch.write(vk::TRUE) };
                this.turned.push(switch);
            }
        }
        this
    }

    /// The chain with what is missing in front of it; good while this is neither moved nor dropped.
    pub fn chain(&mut self, chain: *const c_void) -> *const c_void {
        let mut first = chain;
        for added in self.added.iter_mut().filter(|added| added.switches[0] == vk::TRUE) {
            added.next = first.cast_mut();
            first = (&raw const *added).cast();
        }
        first
    }
}

impl Drop for Features {
    fn drop(&mut self) {
        for switch in &self.turned {
            // SAFETY: it was written before, through the chain that is still the application's.
            unsafe { switch.write(vk::FALSE) };
        }
    }
}

/// The first structure of a kind.
///
/// # Safety
/// `chain` is a chain of Vulkan structures.
unsafe fn find(chain: *const c_void, kind: S) -> Option<*mut c_void> {
    let mut link = chain.cast::<vk::BaseInStructure<'_>>();
    for _ in 0..MOST_LINKS {
        if link.is_null() {
            return None;
        }
        // SAFETY: chained structures of Vulkan start with type and next.
        let base = unsafe { *link };
        if base.s_type == kind {
            return Some(link.cast_mut().cast());
        }
        link = base.p_next;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use vk::{
        PhysicalDeviceFeatures2, PhysicalDeviceTimelineSemaphoreFeatures, PhysicalDeviceVulkan13Features,
    };

    fn kinds(mut link: *const c_void) -> Vec<S> {
        let mut kinds = Vec::new();
        while !link.is_null() {
            // SAFETY: the chains below are whole.
            let base = unsafe { *link.cast::<vk::BaseInStructure<'_>>() };
            kinds.push(base.s_type);
            link = base.p_next.cast();
        }
        kinds
    }

    #[test]
    fn the_applications_structures_are_used_for_the_call_and_given_back() {
        let mut f13 = PhysicalDeviceVulkan13Features::default().maintenance4(true);
        let mut timeline = PhysicalDeviceTimelineSemaphoreFeatures::default();
        let mut head = PhysicalDeviceFeatures2::default().push_next(&mut timeline).push_next(&mut f13);
        let chain = (&raw mut head).cast::<c_void>().cast_const();
        let before = kinds(chain);
        // SAFETY: the chain is whole and only this test looks at it.
        let mut features = unsafe { Features::turn_on(chain) };
        let all = kinds(features.chain(chain));
        let added = [S::PHYSICAL_DEVICE_MULTIVIEW_FEATURES, S::PHYSICAL_DEVICE_HOST_QUERY_RESET_FEATURES];
        assert_eq!(all.len(), before.len() + added.len());
        assert!(added.iter().all(|kind| all.contains(kind)));
        // SAFETY: they live here.
        let now = unsafe {
            let on = find(chain, S::PHYSICAL_DEVICE_VULKAN_1_3_FEATURES).unwrap();
            let timeline = find(chain, S::PHYSICAL_DEVICE_TIMELINE_SEMAPHORE_FEATURES).unwrap();
            (
                on.cast::<PhysicalDeviceVulkan13Features<'_>>().read(),
                timeline.cast::<PhysicalDeviceTimelineSemaphoreFeatures<'_>>().read(),
            )
        };
        assert_eq!((now.0.dynamic_rendering, now.0.synchronization2, now.0.maintenance4), (1, 1, 1));
        assert_eq!(now.0.private_data, 0);
        assert_eq!(now.1.timeline_semaphore, 1);
        drop(features);
        assert_eq!((f13.dynamic_rendering, f13.synchronization2, f13.maintenance4), (0, 0, 1));
        assert_eq!(timeline.timeline_semaphore, 0);
    }

    #[test]
    fn without_structures_every_feature_is_chained_once() {
        // SAFETY: an empty chain.
        let mut features = unsafe { Features::turn_on(std::ptr::null()) };
        assert_eq!(kinds(features.chain(std::ptr::null())).len(), WANTED.len());
    }
}
