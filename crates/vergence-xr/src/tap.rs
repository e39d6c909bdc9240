//! A place to listen: what the runtime says and is told, in the order of the calls.

use std::any::Any;

use openxr::{Fovf, Posef, SpaceLocationFlags, ViewStateFlags, sys};
use vergence_sense::{CallResult, RawLocation, RawPose, RawView, RawViews, Said, Validity};

use crate::error::{Error, In, check};

/// Hears what a session's calls say, in their order, on the thread of the frame loop. Must neither wait nor fail: what it
/// cannot keep it drops and counts.
pub trait Tap: Any + Send {
    /// One answer, or what the runtime was told.
    fn hear(&mut self, said: &Said);
}

/// The calls of a running session: each that does not simply succeed is heard. Those that make and end one are not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Call {
    PollEvent,
    BeginSession,
    EndSession,
    RequestExitSession,
    WaitFrame,
    BeginFrame,
    EndFrame,
    ConvertTimespecTimeToTime,
    LocateViews,
    LocateSpace,
    LocateHandJoints,
    SyncActions,
    GetActionStateBoolean,
    GetActionStateFloat,
    GetActionStateVector2f,
    GetActionStatePose,
    ApplyHapticFeedback,
    AcquireSwapchainImage,
    WaitSwapchainImage,
    ReleaseSwapchainImage,
}

/// The names of the calls whose results a tap hears ([`Said::Result`]): a result gives its place in this list.
pub const HEARD_CALLS: [&str; 20] = [
    "xrPollEvent",
    "xrBeginSession",
    "xrEndSession",
    "xrRequestExitSession",
    "xrWaitFrame",
    "xrBeginFrame",
    "xrEndFrame",
    "xrConvertTimespecTimeToTimeKHR",
    "xrLocateViews",
    "xrLocateSpace",
    "xrLocateHandJointsEXT",
    "xrSyncActions",
    "xrGetActionStateBoolean",
    "xrGetActionStateFloat",
    "xrGetActionStateVector2f",
    "xrGetActionStatePose",
    "xrApplyHapticFeedback",
    "xrAcquireSwapchainImage",
    "xrWaitSwapchainImage",
    "xrReleaseSwapchainImage",
];

impl Call {
    pub(crate) const fn name(self) -> &'static str {
        HEARD_CALLS[self as usize]
    }
}

/// Where a tap may be; costs a test where there is none.
#[derive(Default)]
pub(crate) struct Ear {
    pub(crate) tap: Option<Box<dyn Tap>>,
    /// Calls since the last frame was waited for.
    counts: [u32; HEARD_CALLS.len()],
    /// A frame was waited for and not yet handed over.
    in_frame: bool,
    /// A call succeeded with the word that the session will be lost.
    loss_is_pending: bool,
}

impl Ear {
    pub(crate) fn of(tap: Box<dyn Tap>) -> Self {
        Self { tap: Some(tap), ..Self::default() }
    }

    pub(crate) fn hear(&mut self, said: impl FnOnce() -> Said) {
        if let Some(tap) = &mut self.tap {
            let said = said();
            match said {
                Said::Frame { .. } => self.in_frame = true,
                Said::Submitted { .. } => self.in_frame = false,
                _ => {}
            }
            tap.hear(&said);
        }
    }

    pub(crate) const fn loss_is_pending(&self) -> bool {
        self.loss_is_pending
    }

    /// The frame that was waited for is not handed over any more: the session stops.
    pub(crate) fn abandon_frame(&mut self) {
        self.in_frame = false;
    }

    /// From here on calls are counted anew: a frame was waited for.
    pub(crate) fn next_frame(&mut self) {
        self.counts = [0; HEARD_CALLS.len()];
    }

    /// The answer of a call, which is heard where it failed.
    pub(crate) fn answer<T>(&mut self, call: Call, answer: Result<T, sys::Result>) -> Result<T, Error> {
        let failed = answer.as_ref().err().copied();
        self.count(call, failed);
        answer.during(call.name())
    }

    /// The answer of a raw call, which is heard where it is anything but success: a success, also a qualified one.
    pub(crate) fn check(&mut self, call: Call, result: sys::Result) -> Result<sys::Result, Error> {
        self.loss_is_pending |= result == sys::Result::SESSION_LOSS_PENDING;
        self.count(call, Some(result).filter(|result| *result != sys::Result::SUCCESS));
        check(call.name(), result)
    }

    fn count(&mut self, call: Call, result: Option<sys::Result>) {
        let Some(tap) = &mut self.tap else { return };
        let nth = &mut self.counts[call as usize];
        *nth = nth.saturating_add(1);
        if let Some(result) = result {
            tap.hear(&Said::Result(CallResult {
                call: call.name().into(),
                nth: *nth,
                in_frame: self.in_frame,
                code: result.into_raw(),
                result: format!("{result:?}").into(),
            }));
        }
    }
}

pub(crate) fn raw_pose(pose: &Posef) -> RawPose {
    let (p, q) = (pose.position, pose.orientation);
    RawPose { position_m: [p.x, p.y, p.z], orientation_xyzw: [q.x, q.y, q.z, q.w] }
}

pub(crate) fn raw_location(flags: SpaceLocationFlags, pose: &Posef) -> RawLocation {
    // The four flags have the values of ours.
    let validity = Validity((flags.into_raw() & 15) as u8);
    RawLocation { pose: raw_pose(pose), validity, velocity: None }
}

/// As many views as there are; what would not fit is left out.
pub(crate) fn raw_views(flags: ViewStateFlags, views: impl Iterator<Item = (Posef, Fovf)>) -> RawViews {
    let mut raw = [RawView { pose: RawPose::IDENTITY, fov_rad: [0.0; 4] }; RawViews::MOST];
    let mut count = 0;
    for ((pose, fov), place) in views.zip(&mut raw) {
        let fov_rad = [fov.angle_left, fov.angle_right, fov.angle_up, fov.angle_down];
        *place = RawView { pose: raw_pose(&pose), fov_rad };
        count += 1;
    }
    RawViews::new(Validity((flags.into_raw() & 15) as u8), &raw[..count]).unwrap_or(RawViews::NONE)
}
