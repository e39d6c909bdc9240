//! Faults: what a runtime may do to an application, done on purpose, at a chosen call.
//!
//! The border of the runtime asks here before every call. Which codes an entry point may return is read from the
//! registry of OpenXR (`registry`); a fault that no conforming runtime could show is refused, but for the bad values,
//! which runtimes have been seen to give.

mod active;
mod plan;
mod registry;
#[cfg(test)]
mod registry_test;

use openxr_sys as sys;

use crate::entry;
use crate::error::Error;

pub(crate) use active::{Active, bent_count, bent_fov, bent_pose, bent_time};
pub use plan::{FaultPlan, Hit};
pub(crate) use plan::{effect, hang};

/// A value that a conforming runtime never gives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum BadValue {
    /// Position and orientation are NaN, though the flags say that they are valid.
    NanPose,
    /// The orientation is 0 0 0 0.
    ZeroQuaternion,
    /// All four angles of the field of view are 0.
    FovZero,
    /// The field of view is 180° wide and high.
    Fov180,
    /// An enumeration says one more than there is.
    CountGrows,
    /// An enumeration says one less than there is.
    CountShrinks,
    /// An enumeration is empty.
    Nothing,
    /// The predicted display time is negative.
    TimeNegative,
    /// The predicted display time is a second earlier than it should be.
    TimeBackwards,
    /// The predicted display time is 27 days ahead.
    TimeFar,
    /// The predicted period is 16,570 hours.
    PeriodHuge,
}

impl BadValue {
    const ALL: [(&'static str, Self); 11] = [
        ("NAN_POSE", Self::NanPose),
        ("ZERO_QUATERNION", Self::ZeroQuaternion),
        ("FOV_ZERO", Self::FovZero),
        ("FOV_180", Self::Fov180),
        ("COUNT_GROWS", Self::CountGrows),
        ("COUNT_SHRINKS", Self::CountShrinks),
        ("NOTHING", Self::Nothing),
        ("TIME_NEGATIVE", Self::TimeNegative),
        ("TIME_BACKWARDS", Self::TimeBackwards),
        ("TIME_FAR", Self::TimeFar),
        ("PERIOD_HUGE", Self::PeriodHuge),
    ];

    /// Whether the entry point gives such a value at all.
    fn fits(self, entry_point: &str) -> bool {
        match self {
            Self::NanPose | Self::ZeroQuaternion => {
                matches!(
                    entry_point,
                    "xrLocateViews"
                        | "xrLocateSpace"
                        | "xrLocateSpaces"
                        | "xrLocateSpacesKHR"
                        | "xrLocateHandJointsEXT"
                )
            }
            Self::FovZero | Self::Fov180 => entry_point == "xrLocateViews",
            Self::CountGrows | Self::CountShrinks | Self::Nothing => {
                // The mask's two counts are fields of a structure.
                entry_point == "xrGetVisibilityMaskKHR"
                    || entry::NAMES.iter().any(|(name, counts)| *name == entry_point && *counts)
            }
            Self::TimeNegative | Self::TimeBackwards | Self::TimeFar | Self::PeriodHuge => {
                entry_point == "xrWaitFrame"
            }
        }
    }
}

/// What happens to a call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Effect {
    /// It returns this. An error comes in place of the call; after a qualified success the call was done.
    Code(sys::Result),
    /// It is done, and gives this.
    Bad(BadValue),
    /// It never returns.
    Hang,
}

impl Effect {
    /// Whether the call is left out. Of the successes, these two say that nothing was done.
    pub(crate) fn replaces_call(self) -> Option<sys::Result> {
        match self {
            Self::Code(code)
                if code.into_raw() < 0
                    || matches!(code, sys::Result::TIMEOUT_EXPIRED | sys::Result::EVENT_UNAVAILABLE) =>
            {
                Some(code)
            }
            _ => None,
        }
    }

    fn name(self) -> String {
        match self {
            Self::Code(code) => format!("{code:?}"),
            Self::Bad(bad) => BadValue::ALL
                .iter()
                .find(|(_, value)| *value == bad)
                .map_or("?", |(name, _)| *name)
                .to_owned(),
            Self::Hang => "HANG".to_owned(),
        }
    }
}

/// One fault: an entry point, what it does, and at which of its calls.
///
/// As text `xrWaitFrame=ERROR_SESSION_LOST@100`: the 100th call, counted from 1 over all instances of a run. `@100-120`
/// is each of these calls, `@100+` each from the 100th on; without `@` it is each call.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    entry_point: &'static str,
    effect: Effect,
    first: u64,
    last: u64,
}

impl Fault {
    /// Reads a fault.
    ///
    /// # Errors
    /// [`Error::Fault`] for an entry point that the runtime lacks, a code that the registry does not list for it, a value
    /// that it does not give, and calls that are none; the error lists what there is.
    pub fn parse(text: &str) -> Result<Self, Error> {
        let wrong = |expected: String, found: &str| Error::Fault {
            text: text.to_owned(),
            expected,
            found: format!("\"{found}\""),
        };
        let (name, rest) = text.split_once('=').ok_or_else(|| wrong("FUNCTION=CODE[@CALLS]".into(), text))?;
        let entry_point =
            entry_points().find(|known| *known == name).ok_or_else(|| wrong(one_of(entry_points()), name))?;
        let (what, calls) = rest.split_once('@').unwrap_or((rest, "1+"));
        let bare = what.strip_prefix("XR_").unwrap_or(what);
        let effect = effects(entry_point)
            .find(|effect| effect.name() == bare)
            .ok_or_else(|| wrong(one_of(effects(entry_point).map(Effect::name)), what))?;
        let number = |digits: &str| digits.parse::<u64>().ok().filter(|&call| call > 0);
        let range = if let Some(from) = calls.strip_suffix('+') {
            number(from).map(|first| (first, u64::MAX))
        } else if let Some((from, to)) = calls.split_once('-') {
            number(from).zip(number(to)).filter(|(first, last)| first <= last)
        } else {
            number(calls).map(|call| (call, call))
        };
        let (first, last) = range
            .ok_or_else(|| wrong("calls counted from 1, as in @100, @100-120 or @100+".into(), calls))?;
        Ok(Self { entry_point, effect, first, last })
    }

    /// Of which entry point it is.
    pub const fn entry_point(&self) -> &'static str {
        self.entry_point
    }

    fn holds(&self, entry_point: &str, call: u64) -> bool {
        self.entry_point == entry_point && (self.first..=self.last).contains(&call)
    }
}

impl std::fmt::Display for Fault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}={}", self.entry_point, self.effect.name())?;
        match (self.first, self.last) {
            (first, u64::MAX) => write!(f, "@{first}+"),
            (first, last) if first == last => write!(f, "@{first}"),
            (first, last) => write!(f, "@{first}-{last}"),
        }
    }
}

fn one_of<T: std::fmt::Display>(known: impl Iterator<Item = T>) -> String {
    let known: Vec<String> = known.map(|one| one.to_string()).collect();
    format!("one of {}", known.join(", "))
}

/// Every entry point of the runtime, by its name.
pub fn entry_points() -> impl Iterator<Item = &'static str> {
    entry::NAMES.iter().map(|(name, _)| *name)
}

/// What can be done to an entry point: the codes that the registry documents, the values that it gives, and no return.
fn effects(entry_point: &str) -> impl Iterator<Item = Effect> + use<'_> {
    let codes = registry::RESULTS.iter().find(|(name, _)| *name == entry_point).map_or(&[][..], |(_, c)| *c);
    let bad = BadValue::ALL.iter().map(|(_, value)| *value).filter(|value| value.fits(entry_point));
    codes.iter().copied().map(Effect::Code).chain(bad.map(Effect::Bad)).chain([Effect::Hang])
}

/// The codes that the registry documents for an entry point: qualified successes, then errors, without `XR_`.
pub fn documented(entry_point: &str) -> Vec<String> {
    effects(entry_point).filter(|e| matches!(e, Effect::Code(_))).map(Effect::name).collect()
}

/// The bad values that an entry point can give, by the names that [`Fault::parse`] takes.
pub fn bad_values(entry_point: &str) -> Vec<String> {
    effects(entry_point).filter(|e| matches!(e, Effect::Bad(_))).map(Effect::name).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_says_what_it_was_read_from() {
        for text in [
            "xrWaitFrame=ERROR_SESSION_LOST@100",
            "xrWaitFrame=TIME_FAR@3-9",
            "xrLocateViews=NAN_POSE@2+",
            "xrWaitSwapchainImage=TIMEOUT_EXPIRED@1",
            "xrWaitFrame=HANG@5",
        ] {
            assert_eq!(Fault::parse(text).unwrap().to_string(), text);
        }
        let each = Fault::parse("xrEndFrame=XR_ERROR_LAYER_INVALID").unwrap();
        assert_eq!(each.to_string(), "xrEndFrame=ERROR_LAYER_INVALID@1+");
        let some = Fault::parse("xrEndFrame=ERROR_LAYER_INVALID@3-4").unwrap();
        assert_eq!((1..6).filter(|&call| some.holds("xrEndFrame", call)).collect::<Vec<_>>(), [3, 4]);
        assert!(!some.holds("xrBeginFrame", 3));
    }

    /// Nothing that no conforming runtime could do, and the list of what there is.
    #[test]
    fn what_is_not_documented_is_refused_with_the_list() {
        for (text, listed) in [
            ("xrWaitFrame", "FUNCTION=CODE"),
            ("xrWaitForFrame=ERROR_SESSION_LOST", "xrWaitFrame"),
            ("xrWaitFrame=ERROR_PATH_INVALID@1", "ERROR_SESSION_NOT_RUNNING"),
            ("xrWaitFrame=NAN_POSE", "PERIOD_HUGE"),
            ("xrPollEvent=TIME_FAR", "ERROR_INSTANCE_LOST"),
            ("xrWaitFrame=ERROR_SESSION_LOST@0", "@100-120"),
            ("xrWaitFrame=ERROR_SESSION_LOST@9-3", "@100-120"),
            ("xrWaitFrame=ERROR_SESSION_LOST@x", "@100-120"),
            ("xrWaitFrame=SUCCESS", "SESSION_LOSS_PENDING"),
        ] {
            let error = Fault::parse(text).unwrap_err().to_string();
            assert!(error.contains(listed) && error.contains(text), "{error}");
        }
    }

    #[test]
    fn enumerations_have_counts_and_frames_have_times() {
        assert_eq!(bad_values("xrEnumerateSwapchainFormats"), ["COUNT_GROWS", "COUNT_SHRINKS", "NOTHING"]);
        assert_eq!(bad_values("xrWaitFrame"), ["TIME_NEGATIVE", "TIME_BACKWARDS", "TIME_FAR", "PERIOD_HUGE"]);
        assert_eq!(bad_values("xrLocateViews").len(), 7);
        assert!(bad_values("xrDestroySession").is_empty());
        assert!(documented("xrBeginFrame").iter().any(|code| code == "FRAME_DISCARDED"));
    }
}
