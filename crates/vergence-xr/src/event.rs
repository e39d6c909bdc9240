//! What the runtime announces, as things that happened to the user.

use openxr::{Event, ReferenceSpaceType};
use vergence_time::Timestamp;

use crate::state::{Lifecycle, State, Step};
use crate::time_guard::TimeFault;

/// Notices that are kept until they are asked for; the newest are left out beyond, and counted. What a session must act on
/// is kept all the same: see [`Notices::push`].
const NOTICES_KEPT: usize = 256;

/// Something that happened.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Notice {
    /// The session is in another state.
    State(State),
    /// The user or the runtime moved the origin of LOCAL space: it holds from that instant on.
    Recentred {
        /// When.
        at: Timestamp,
    },
    /// A hand holds another device, or none.
    HandsChanged,
    /// What the lenses hide has changed.
    HiddenAreaChanged,
    /// The display's rate has changed.
    RefreshRate {
        /// Before, Hz.
        from_hz: f32,
        /// Now, Hz.
        to_hz: f32,
    },
    /// The runtime's time was absurd and has been replaced.
    Time(TimeFault),
    /// The runtime could not keep all its events.
    EventsLost(u32),
    /// The runtime said poses or fields of view that are none; the last ones stay.
    Nonsense,
    /// The runtime says with an answer that the session will be lost.
    LossPending,
    /// The runtime threw a frame away, because the next one was begun before it ended.
    FrameDiscarded,
}

impl std::fmt::Display for Notice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::State(state) => f.write_str(state.sentence()),
            Self::Recentred { .. } => f.write_str("the headset was recentred"),
            Self::HandsChanged => f.write_str("a hand holds another device"),
            Self::HiddenAreaChanged => f.write_str("the lenses hide another part of the picture"),
            Self::RefreshRate { from_hz, to_hz } => {
                write!(f, "the display's rate went from {from_hz} to {to_hz} Hz")
            }
            Self::Time(fault) => write!(f, "the runtime's {fault}"),
            Self::EventsLost(count) => write!(f, "the runtime lost {count} events"),
            Self::Nonsense => f.write_str(
                "the runtime's views: expected poses and fields of view, found something that is none; going on with the last ones",
            ),
            Self::LossPending => f.write_str("the runtime says that the session will be lost"),
            Self::FrameDiscarded => f.write_str("the runtime threw a frame away that had not ended"),
        }
    }
}

/// An event as a tap hears it: as the runtime said it, before anything was made of it. `None` for what concerns others.
pub(crate) fn said(
    event: &Event<'_>,
    session: &openxr::Session<openxr::Vulkan>,
) -> Option<vergence_sense::Event> {
    use vergence_sense::Event as Said;
    let at = |time: openxr::Time| Some(Timestamp::from_nanos(time.as_nanos()));
    Some(match event {
        Event::SessionStateChanged(changed) if changed.session() == session.as_raw() => {
            let state = session_state_name(changed.state());
            Said { at: at(changed.time()), ..Said::new("session_state", state) }
        }
        Event::ReferenceSpaceChangePending(change) if change.session() == session.as_raw() => {
            let space = match change.reference_space_type() {
                ReferenceSpaceType::LOCAL => "LOCAL",
                ReferenceSpaceType::STAGE => "STAGE",
                ReferenceSpaceType::LOCAL_FLOOR => "LOCAL_FLOOR",
                _ => "other",
            };
            Said { at: at(change.change_time()), ..Said::new("space_changing", space) }
        }
        Event::InstanceLossPending(loss) => {
            Said { at: at(loss.loss_time()), ..Said::new("instance_loss_pending", "") }
        }
        Event::InteractionProfileChanged(_) => Said::new("interaction_profile_changed", ""),
        Event::VisibilityMaskChangedKHR(_) => Said::new("visibility_mask_changed", ""),
        Event::DisplayRefreshRateChangedFB(changed) => Said {
            before: f64::from(changed.from_display_refresh_rate()),
            after: f64::from(changed.to_display_refresh_rate()),
            ..Said::new("refresh_rate_changed", "")
        },
        Event::EventsLost(lost) => {
            Said { after: f64::from(lost.lost_event_count()), ..Said::new("events_lost", "") }
        }
        _ => return None,
    })
}

/// As the specification names it.
const fn session_state_name(state: openxr::SessionState) -> &'static str {
    use openxr::SessionState as S;
    match state {
        S::IDLE => "IDLE",
        S::READY => "READY",
        S::SYNCHRONIZED => "SYNCHRONIZED",
        S::VISIBLE => "VISIBLE",
        S::FOCUSED => "FOCUSED",
        S::STOPPING => "STOPPING",
        S::LOSS_PENDING => "LOSS_PENDING",
        S::EXITING => "EXITING",
        _ => "UNKNOWN",
    }
}

/// What has happened and was not asked for yet; allocates once.
#[derive(Debug)]
pub(crate) struct Notices {
    kept: Vec<Notice>,
    left_out: u64,
}

impl Default for Notices {
    fn default() -> Self {
        Self { kept: Vec::with_capacity(NOTICES_KEPT + ROOM), left_out: 0 }
    }
}

/// Room beyond [`NOTICES_KEPT`]: for the first and the last of several recentrings, and for a change of what is hidden.
const ROOM: usize = 3;

impl Notices {
    /// Keeps a notice. Where there is no room, recentrings become the earliest and the latest of them, between which the
    /// floor is asked for, and several changes of what is hidden become one.
    pub(crate) fn push(&mut self, notice: Notice) {
        if self.kept.len() < NOTICES_KEPT {
            self.kept.push(notice);
            return;
        }
        // At most two behind those that are kept in any case.
        let beyond = self.kept.iter_mut().skip(NOTICES_KEPT).filter_map(|kept| match kept {
            Notice::Recentred { at } => Some(at),
            _ => None,
        });
        match notice {
            Notice::Recentred { at: new } => {
                let mut several = beyond;
                match (several.next(), several.next()) {
                    (Some(first), Some(last)) => {
                        let (low, high) = ((*first).min(new), (*last).max(new));
                        (*first, *last) = (low, high);
                        self.left_out += 1;
                    }
                    (Some(first), None) => {
                        let (low, high) = ((*first).min(new), (*first).max(new));
                        *first = low;
                        self.kept.push(Notice::Recentred { at: high });
                    }
                    (None, _) => self.kept.push(notice),
                }
            }
            Notice::HiddenAreaChanged if !self.kept.contains(&notice) => self.kept.push(notice),
            _ => self.left_out += 1,
        }
    }

    pub(crate) fn drain(&mut self) -> impl Iterator<Item = Notice> + '_ {
        self.kept.drain(..)
    }

    /// How many notices were left out since the last call, because nobody had asked for those before them.
    pub(crate) fn take_left_out(&mut self) -> u64 {
        std::mem::take(&mut self.left_out)
    }

    /// Takes an event and says what must be called.
    pub(crate) fn take(
        &mut self,
        event: &Event<'_>,
        lifecycle: &mut Lifecycle,
        session: &openxr::Session<openxr::Vulkan>,
    ) -> Step {
        match event {
            Event::SessionStateChanged(changed) if changed.session() == session.as_raw() => {
                return lifecycle.on_session_state(changed.state());
            }
            Event::InstanceLossPending(_) => lifecycle.on_loss(),
            Event::ReferenceSpaceChangePending(change)
                if change.session() == session.as_raw()
                    && change.reference_space_type() == ReferenceSpaceType::LOCAL =>
            {
                self.push(Notice::Recentred { at: Timestamp::from_nanos(change.change_time().as_nanos()) });
            }
            Event::InteractionProfileChanged(_) => self.push(Notice::HandsChanged),
            Event::VisibilityMaskChangedKHR(_) => self.push(Notice::HiddenAreaChanged),
            Event::DisplayRefreshRateChangedFB(changed) => self.push(Notice::RefreshRate {
                from_hz: changed.from_display_refresh_rate(),
                to_hz: changed.to_display_refresh_rate(),
            }),
            Event::EventsLost(lost) => self.push(Notice::EventsLost(lost.lost_event_count())),
            _ => {}
        }
        Step::Nothing
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// However much happens before anybody asks: what a session must act on is told, and the rest is counted.
    #[test]
    fn what_must_be_acted_on_is_never_left_out() {
        let mut notices = Notices::default();
        let room = notices.kept.capacity();
        (0..NOTICES_KEPT + 10).for_each(|_| notices.push(Notice::HandsChanged));
        assert_eq!(notices.take_left_out(), 10);
        let at = |nanos| Notice::Recentred { at: Timestamp::from_nanos(nanos) };
        for nanos in [50, 40, 70, 60] {
            notices.push(at(nanos));
            notices.push(Notice::HiddenAreaChanged);
        }
        assert_eq!((notices.kept.capacity(), notices.take_left_out()), (room, 2 + 3));
        let told: Vec<Notice> = notices.drain().skip(NOTICES_KEPT).collect();
        assert_eq!(told, [at(40), Notice::HiddenAreaChanged, at(70)]);
    }
}
