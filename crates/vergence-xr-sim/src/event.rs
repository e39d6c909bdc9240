//! The queue of events of an instance.

use std::collections::VecDeque;

use openxr_sys as sys;
use vergence_time::Timestamp;

use crate::ffi::{Out, XrResult};
use crate::instance::Instance;

/// How many events wait at most; what comes after is counted and reported as lost.
const LONGEST_QUEUE: usize = 1024;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Event {
    StateChanged {
        session: sys::Session,
        state: sys::SessionState,
        time: Timestamp,
    },
    LocalSpaceChanging {
        session: sys::Session,
        space: sys::ReferenceSpaceType,
        time: Timestamp,
        pose: sys::Posef,
    },
    InteractionProfileChanged {
        session: sys::Session,
    },
    RefreshRateChanged {
        from_hz: f32,
        to_hz: f32,
    },
    VisibilityMaskChanged {
        session: sys::Session,
    },
    InstanceLossPending {
        time: Timestamp,
    },
}

impl Event {
    fn session(&self) -> Option<sys::Session> {
        match *self {
            Self::StateChanged { session, .. }
            | Self::LocalSpaceChanging { session, .. }
            | Self::VisibilityMaskChanged { session }
            | Self::InteractionProfileChanged { session } => Some(session),
            Self::RefreshRateChanged { .. } | Self::InstanceLossPending { .. } => None,
        }
    }
}

#[derive(Default)]
pub(crate) struct Events {
    queue: VecDeque<Event>,
    lost: u32,
}

impl Events {
    pub(crate) fn push(&mut self, event: Event) {
        if self.queue.len() < LONGEST_QUEUE {
            self.queue.push_back(event);
        } else {
            self.lost = self.lost.saturating_add(1);
        }
    }

    /// So many more are reported as lost.
    pub(crate) fn lose(&mut self, count: u32) {
        self.lost = self.lost.saturating_add(count);
    }

    /// Whether nothing waits to be told.
    pub(crate) fn is_empty(&self) -> bool {
        self.queue.is_empty() && self.lost == 0
    }

    /// Forgets what concerns a session that is no more.
    pub(crate) fn forget(&mut self, session: sys::Session) {
        self.queue.retain(|event| event.session() != Some(session));
    }

    fn pop(&mut self, place: &mut sys::EventDataBuffer) -> bool {
        if self.lost > 0 {
            let lost_event_count = std::mem::take(&mut self.lost);
            let ty = sys::EventDataEventsLost::TYPE;
            write(place, sys::EventDataEventsLost { ty, next: std::ptr::null(), lost_event_count });
            return true;
        }
        let Some(event) = self.queue.pop_front() else { return false };
        let next = std::ptr::null();
        let time = |time: Timestamp| sys::Time::from_nanos(time.as_nanos());
        match event {
            Event::StateChanged { session, state, time: at } => {
                let ty = sys::EventDataSessionStateChanged::TYPE;
                write(place, sys::EventDataSessionStateChanged { ty, next, session, state, time: time(at) });
            }
            Event::LocalSpaceChanging { session, space, time: at, pose } => {
                let event = sys::EventDataReferenceSpaceChangePending {
                    ty: sys::EventDataReferenceSpaceChangePending::TYPE,
                    next,
                    session,
                    reference_space_type: space,
                    change_time: time(at),
                    pose_valid: sys::TRUE,
                    pose_in_previous_space: pose,
                };
                write(place, event);
            }
            Event::InteractionProfileChanged { session } => {
                let ty = sys::EventDataInteractionProfileChanged::TYPE;
                write(place, sys::EventDataInteractionProfileChanged { ty, next, session });
            }
            Event::RefreshRateChanged { from_hz, to_hz } => {
                let event = sys::EventDataDisplayRefreshRateChangedFB {
                    ty: sys::EventDataDisplayRefreshRateChangedFB::TYPE,
                    next,
                    from_display_refresh_rate: from_hz,
                    to_display_refresh_rate: to_hz,
                };
                write(place, event);
            }
            Event::VisibilityMaskChanged { session } => {
                let event = sys::EventDataVisibilityMaskChangedKHR {
                    ty: sys::EventDataVisibilityMaskChangedKHR::TYPE,
                    next,
                    session,
                    view_configuration_type: sys::ViewConfigurationType::PRIMARY_STEREO,
                    view_index: 0,
                };
                write(place, event);
            }
            Event::InstanceLossPending { time: at } => {
                let ty = sys::EventDataInstanceLossPending::TYPE;
                write(place, sys::EventDataInstanceLossPending { ty, next, loss_time: time(at) });
            }
        }
        true
    }
}

/// Lays an event into the application's buffer, which is made for the largest of them.
fn write<T: Copy>(place: &mut sys::EventDataBuffer, event: T) {
    const { assert!(size_of::<T>() <= size_of::<sys::EventDataBuffer>()) };
    const { assert!(align_of::<T>() <= align_of::<sys::EventDataBuffer>()) };
    // SAFETY: the buffer is larger than the event and at least as strictly aligned (checked above); the event
    // structures are plain data.
    unsafe { std::ptr::from_mut(place).cast::<T>().write(event) };
}

pub(crate) fn poll_event(instance: &Instance, mut out: Out<sys::EventDataBuffer>) -> XrResult {
    let place = out.fill()?;
    instance.attend();
    instance.check_lost()?;
    instance.follow_replay();
    let shared = &mut *instance.lock();
    let last = matches!(shared.events.queue.front(), Some(Event::InstanceLossPending { .. }));
    let found = shared.events.pop(place);
    if last {
        instance.lose();
    }
    Ok(if found { sys::Result::SUCCESS } else { sys::Result::EVENT_UNAVAILABLE })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_does_not_fit_is_counted() {
        let mut events = Events::default();
        for _ in 0..LONGEST_QUEUE + 3 {
            events.push(Event::RefreshRateChanged { from_hz: 90.0, to_hz: 72.0 });
        }
        let mut place = sys::EventDataBuffer {
            ty: sys::EventDataBuffer::TYPE,
            next: std::ptr::null(),
            varying: [0; 4000],
        };
        assert!(events.pop(&mut place));
        assert_eq!(place.ty, sys::EventDataEventsLost::TYPE);
        assert_eq!(place.varying[..4], 3u32.to_ne_bytes());
        for _ in 0..LONGEST_QUEUE {
            assert!(events.pop(&mut place));
        }
        assert!(!events.pop(&mut place));
    }
}
