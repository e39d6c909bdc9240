//! What happens in a session, beside what devices say.

use std::borrow::Cow;

use vergence_time::{Span, Timestamp};

/// Something that happened: a state, a change, a loss. The name says what, in one word of lower case
/// (`state`, `recentred`, `hands_changed`, `hidden_area_changed`, `refresh_rate`, `time_fault`, `events_lost`, …);
/// the rest says what there is to say about it.
#[derive(Clone, Debug, PartialEq)]
pub struct Event {
    /// What.
    pub name: Cow<'static, str>,
    /// In words: the state's name, the device's path.
    pub text: Cow<'static, str>,
    /// From when on it holds, where that is not the instant it was said.
    pub at: Option<Timestamp>,
    /// The number before, or how many; NaN where there is none.
    pub before: f64,
    /// The number after; NaN where there is none.
    pub after: f64,
}

impl Event {
    /// Something without numbers.
    pub const fn new(name: &'static str, text: &'static str) -> Self {
        Self {
            name: Cow::Borrowed(name),
            text: Cow::Borrowed(text),
            at: None,
            before: f64::NAN,
            after: f64::NAN,
        }
    }
}

/// The points of one frame, session time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameTiming {
    /// Counted from 0.
    pub frame: u64,
    /// The runtime let us go.
    pub wait_returned: Timestamp,
    /// We began.
    pub begun: Timestamp,
    /// The picture was handed over; `None` where the frame was given back empty.
    pub submitted: Option<Timestamp>,
    /// When the runtime expects it to be seen.
    pub predicted_display: Timestamp,
    /// What the runtime says of the time between frames.
    pub predicted_period: Span,
    /// The runtime wants a picture.
    pub should_render: bool,
    /// When it was seen, where the runtime tells.
    pub presented: Option<Timestamp>,
    /// The display time that the runtime gave, before the guard against absurd times: as predicted where it was believed.
    pub raw_display: Timestamp,
    /// The period that the runtime gave, before the guard.
    pub raw_period: Span,
    /// The frame was ended. One that was not is that in which the session was lost or given up.
    pub ended: bool,
}

/// A call of a running session that did not simply succeed: it failed, or what it returned is a qualified success.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CallResult {
    /// The entry point: `xrLocateViews`.
    pub call: Cow<'static, str>,
    /// Which of its calls, counted from 1 since the last frame was waited for.
    pub nth: u32,
    /// It was called for a frame that had been waited for and not yet been handed over.
    pub in_frame: bool,
    /// What it returned, as OpenXR counts results.
    pub code: i32,
    /// The same in words: `ERROR_SESSION_LOST`.
    pub result: Cow<'static, str>,
}

/// What identifies the pictures of one frame: a hash per view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameHash {
    /// Counted from 0, as in [`FrameTiming`].
    pub frame: u64,
    /// Which view, counted from 0.
    pub view: u32,
    /// Of the colour picture, as the renderer wrote it.
    pub hash: [u8; 32],
}

/// One number; its unit is the stream's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scalar(pub f64);
