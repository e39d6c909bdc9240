//! How much of each kind lives on a device.

use std::sync::atomic::{AtomicI64, Ordering};

macro_rules! census {
    ($($(#[$doc:meta])* $name:ident),* $(,)?) => {
        /// How many objects of each kind exist on a device at this moment, and their bytes.
        #[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
        pub struct Census { $($(#[$doc])* pub $name: u64),* }

        /// The counters behind [`Census`].
        #[derive(Default)]
        pub(crate) struct Counters { $(pub $name: AtomicI64),* }

        impl Counters {
            pub fn read(&self) -> Census {
                Census { $($name: u64::try_from(self.$name.load(Ordering::Relaxed)).unwrap_or(0)),* }
            }
        }
    };
}

census! {
    /// Buffers.
    buffers,
    /// Bytes of memory bound to buffers.
    buffer_bytes,
    /// Images that own their memory.
    images,
    /// Bytes of memory bound to images.
    image_bytes,
    /// Images that somebody else owns.
    borrowed_images,
    /// Image views.
    image_views,
    /// Samplers.
    samplers,
    /// Shader modules.
    shader_modules,
    /// Pipeline layouts.
    pipeline_layouts,
    /// Graphics pipelines.
    graphics_pipelines,
    /// Compute pipelines.
    compute_pipelines,
    /// Descriptor set layouts.
    set_layouts,
    /// Descriptor sets.
    sets,
    /// Command buffers.
    command_buffers,
    /// Timelines made by [`Timeline::new`](crate::Timeline::new).
    timelines,
    /// Swapchains on windows.
    swapchains,
}

impl Counters {
    pub(crate) fn add(counter: &AtomicI64, n: u64) {
        counter.fetch_add(n as i64, Ordering::Relaxed);
    }

    pub(crate) fn sub(counter: &AtomicI64, n: u64) {
        counter.fetch_sub(n as i64, Ordering::Relaxed);
    }
}
