//! Runtimes have answered with display times far in the past or in the future and with periods of years. Such a time
//! loses every frame; the guard notices and goes on with its own prediction.

use vergence_time::{Span, Timestamp};

/// Shortest period that is believed: 2 kHz.
const SHORTEST_PERIOD: Span = Span::from_nanos(500_000);
/// Longest period that is believed. Null compositors run at 20 Hz and count late frames as longer periods.
const LONGEST_PERIOD: Span = Span::from_millis(1_000);
/// How far a prediction may run ahead of the runtime's own clock, or jump ahead of the time that has passed.
const LONGEST_LEAD: Span = Span::from_millis(2_000);
/// Period until the runtime has said a better one: 90 Hz.
const FIRST_PERIOD: Span = Span::from_nanos(11_111_111);

/// When a frame will be shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Prediction {
    /// The instant, on the runtime's clock.
    pub display: Timestamp,
    /// The time between frames.
    pub period: Span,
    /// What was wrong with the runtime's own answer, where something was.
    pub fault: Option<TimeFault>,
}

/// What was wrong with a time that a runtime gave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeFault {
    /// Zero or negative.
    NotPositive(Timestamp),
    /// Not after the frame before.
    NotLater(Timestamp),
    /// Further in the future than any display shows.
    FarFuture(Timestamp),
    /// Not a period of a display.
    Period(Span),
}

impl std::fmt::Display for TimeFault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (what, found) = match self {
            Self::NotPositive(t) => ("predicted display time: expected a positive time", t.as_nanos()),
            Self::NotLater(t) => {
                ("predicted display time: expected one after the frame before", t.as_nanos())
            }
            Self::FarFuture(t) => ("predicted display time: expected one within two seconds", t.as_nanos()),
            Self::Period(s) => ("predicted display period: expected 0.5 ms to 1 s", s.as_nanos()),
        };
        write!(f, "{what}, found {found} ns; going on with our own prediction")
    }
}

/// Checks what a runtime predicts against what is possible. One per session.
#[derive(Debug)]
pub struct TimeGuard {
    /// The last frame: its display time, and the host's clock then.
    last: Option<(Timestamp, Timestamp)>,
    period: Span,
}

impl Default for TimeGuard {
    fn default() -> Self {
        Self { last: None, period: FIRST_PERIOD }
    }
}

impl TimeGuard {
    /// A believable version of the runtime's prediction.
    ///
    /// `display` and `period` are what the runtime said; `host_now` is the host's monotonic clock (any epoch);
    /// `runtime_now` is the runtime's own clock, where it can be asked. Source of the cases: reports of runtimes that
    /// predict negative times, times weeks ahead, and periods of thousands of hours.
    pub fn check(
        &mut self,
        display: Timestamp,
        period: Span,
        host_now: Timestamp,
        runtime_now: Option<Timestamp>,
    ) -> Prediction {
        let mut fault = None;
        if (SHORTEST_PERIOD..=LONGEST_PERIOD).contains(&period) {
            self.period = period;
        } else {
            fault = Some(TimeFault::Period(period));
        }
        let time_fault = self.fault_of(display, host_now, runtime_now);
        let guarded = match time_fault {
            None => display,
            Some(_) => self.own_prediction(host_now, runtime_now),
        };
        self.last = Some((guarded, host_now));
        Prediction { display: guarded, period: self.period, fault: time_fault.or(fault) }
    }

    fn fault_of(
        &self,
        display: Timestamp,
        host_now: Timestamp,
        runtime_now: Option<Timestamp>,
    ) -> Option<TimeFault> {
        if display.as_nanos() <= 0 {
            return Some(TimeFault::NotPositive(display));
        }
        let leads = |earlier: Timestamp, allowed: Span| {
            display.since(earlier).is_none_or(|lead| lead.as_nanos() > allowed.as_nanos())
        };
        if runtime_now.is_some_and(|now| leads(now, LONGEST_LEAD)) {
            return Some(TimeFault::FarFuture(display));
        }
        let (last, host_then) = self.last?;
        if display <= last {
            return Some(TimeFault::NotLater(display));
        }
        let passed = host_now.since(host_then).unwrap_or(Span::ZERO);
        let allowed = Span::from_nanos(LONGEST_LEAD.as_nanos().saturating_add(passed.as_nanos()));
        (runtime_now.is_none() && leads(last, allowed)).then_some(TimeFault::FarFuture(display))
    }

    /// The frame before, plus the time that has passed but at least one period.
    fn own_prediction(&self, host_now: Timestamp, runtime_now: Option<Timestamp>) -> Timestamp {
        match self.last {
            Some((last, host_then)) => {
                let passed = host_now.since(host_then).unwrap_or(Span::ZERO);
                last.saturating_add(passed.max(self.period))
            }
            None => runtime_now
                .filter(|now| now.as_nanos() > 0)
                .unwrap_or(Timestamp::from_nanos(1))
                .saturating_add(self.period),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;
    const DAY_NS: i64 = 86_400_000 * MS;

    fn at(ms: i64) -> Timestamp {
        Timestamp::from_nanos(ms * MS)
    }

    fn check(guard: &mut TimeGuard, display_ms: i64, host_ms: i64) -> Prediction {
        guard.check(at(display_ms), Span::from_millis(10), at(host_ms), None)
    }

    #[test]
    fn good_times_pass_untouched_also_late_ones_and_after_a_pause() {
        let mut guard = TimeGuard::default();
        for (display_ms, host_ms) in [(1000, 0), (1010, 10), (1050, 50), (61_050, 60_050)] {
            let p = check(&mut guard, display_ms, host_ms);
            assert_eq!((p.display, p.fault), (at(display_ms), None));
        }
    }

    /// A virtual clock runs faster than the host's.
    #[test]
    fn a_virtual_clock_passes() {
        let mut guard = TimeGuard::default();
        for frame in 1..1000 {
            assert_eq!(check(&mut guard, frame * 50, frame).fault, None);
        }
    }

    #[test]
    fn each_absurd_time_is_replaced_by_the_frame_before_plus_what_has_passed() {
        let wrong = [
            (Timestamp::from_nanos(-5 * DAY_NS), TimeFault::NotPositive(Timestamp::from_nanos(-5 * DAY_NS))),
            (Timestamp::from_nanos(i64::MIN), TimeFault::NotPositive(Timestamp::from_nanos(i64::MIN))),
            (Timestamp::from_nanos(27 * DAY_NS), TimeFault::FarFuture(Timestamp::from_nanos(27 * DAY_NS))),
            (Timestamp::from_nanos(i64::MAX), TimeFault::FarFuture(Timestamp::from_nanos(i64::MAX))),
            (at(1000), TimeFault::NotLater(at(1000))),
        ];
        for (display, fault) in wrong {
            let mut guard = TimeGuard::default();
            check(&mut guard, 1000, 0);
            for frame in 1..100 {
                let p = guard.check(display, Span::from_millis(10), at(frame * 10), None);
                // Once our own prediction has passed it, any fixed time is merely too early.
                assert!(p.fault == Some(fault) || matches!(p.fault, Some(TimeFault::NotLater(_))), "{p:?}");
                assert_eq!(p.display, at(1000 + frame * 10));
            }
            // It recovers as soon as the runtime does.
            assert_eq!(check(&mut guard, 2005, 1005).fault, None);
        }
    }

    #[test]
    fn the_first_time_is_checked_against_the_runtimes_clock_where_it_has_one() {
        let mut guard = TimeGuard::default();
        let far = Timestamp::from_nanos(27 * DAY_NS);
        let p = guard.check(far, Span::from_millis(10), at(0), Some(at(5000)));
        assert_eq!((p.display, p.fault), (at(5010), Some(TimeFault::FarFuture(far))));
    }

    #[test]
    fn absurd_periods_are_replaced_by_the_last_good_one() {
        let mut guard = TimeGuard::default();
        check(&mut guard, 1000, 0);
        for period in [0, -1, 16_570 * 3_600_000 * MS, i64::MAX] {
            let mut next = TimeGuard { last: guard.last, period: guard.period };
            let p = next.check(at(1010), Span::from_nanos(period), at(10), None);
            assert_eq!(p.period, Span::from_millis(10));
            assert_eq!(p.fault, Some(TimeFault::Period(Span::from_nanos(period))));
        }
    }
}
