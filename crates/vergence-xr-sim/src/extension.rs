//! The extensions of the runtime.

/// An extension that an application may switch on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Extension {
    VulkanEnable2,
    CompositionLayerDepth,
    VisibilityMask,
    ConvertTimespecTime,
    LocateSpaces,
    LocalFloor,
    DisplayRefreshRate,
    Headless,
    HandTracking,
    EyeGaze,
}

impl Extension {
    /// Each with its name and the revision of the specification that is implemented.
    pub(crate) const ALL: [(Self, &'static str, u32); 10] = [
        (Self::VulkanEnable2, "XR_KHR_vulkan_enable2", 2),
        (Self::CompositionLayerDepth, "XR_KHR_composition_layer_depth", 6),
        (Self::VisibilityMask, "XR_KHR_visibility_mask", 2),
        (Self::ConvertTimespecTime, "XR_KHR_convert_timespec_time", 1),
        (Self::LocateSpaces, "XR_KHR_locate_spaces", 1),
        (Self::LocalFloor, "XR_EXT_local_floor", 1),
        (Self::DisplayRefreshRate, "XR_FB_display_refresh_rate", 1),
        (Self::Headless, "XR_MND_headless", 2),
        (Self::HandTracking, "XR_EXT_hand_tracking", 4),
        (Self::EyeGaze, "XR_EXT_eye_gaze_interaction", 2),
    ];

    pub(crate) fn named(name: &str) -> Option<Self> {
        Self::ALL.iter().find(|(_, known, _)| *known == name).map(|(extension, ..)| *extension)
    }
}

/// Which extensions are on.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Extensions(u32);

impl Extensions {
    pub(crate) fn insert(&mut self, extension: Extension) {
        self.0 |= 1 << extension as u32;
    }

    pub(crate) fn contains(self, extension: Extension) -> bool {
        self.0 & (1 << extension as u32) != 0
    }
}
