//! Runtimes have answered with display times far in the past or in the future and with periods of years. Such a time
//! loses every frame; the guard notices and goes on with its own prediction. A runtime whose times run on steadily for a
//! while is believed again: then it is the guard's own base that was wrong.

use vergence_time::{Span, Timestamp};

use crate::client::TakenTimes;

/// Shortest period that is believed: 2 kHz.
const SHORTEST_PERIOD: Span = Span::from_nanos(500_000);
/// Longest period that is believed. Null compositors run at 20 Hz and count late frames as longer periods.
const LONGEST_PERIOD: Span = Span::from_millis(1_000);
/// How far a prediction may run ahead of the runtime's own clock, or jump ahead of the time that has passed.
const LONGEST_LEAD: Span = Span::from_millis(2_000);
/// Period until the runtime has said a better one: 90 Hz.
const FIRST_PERIOD: Span = Span::from_nanos(11_111_111);
/// So many replaced times that run on steadily make the runtime's time the new base.
const STEADY_FAULTS: u32 = 5;

/// When a frame will be shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Prediction {
    /// The instant, on the runtime's clock.
    pub display: Timestamp,
    /// The time between frames.
    pub period: Span,
    /// What was wrong with the runtime's own answer, where something was.
    pub fault: Option<TimeFault>,
    /// Whether the runtime is believed anew after its times were replaced: the time since the frame before means nothing.
    pub rebased: bool,
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

/// What the clocks read when a frame was waited for.
#[derive(Clone, Copy, Debug)]
struct Clocks {
    host: Timestamp,
    runtime: Option<Timestamp>,
}

impl Clocks {
    /// The time since `then`, by the runtime's clock where it can be read: that is the one which a recording has.
    fn since(&self, then: &Self) -> Span {
        let by_runtime = self.runtime.zip(then.runtime).and_then(|(now, then)| now.since(then));
        by_runtime.or_else(|| self.host.since(then.host)).unwrap_or(Span::ZERO)
    }
}

/// Checks what a runtime predicts against what is possible. One per session.
#[derive(Debug)]
pub struct TimeGuard {
    /// The last frame: its display time, and what the clocks read then.
    last: Option<(Timestamp, Clocks)>,
    /// What the runtime said of the last frame, believed or not.
    last_raw: Option<Timestamp>,
    /// Times replaced in a row that ran on steadily.
    steady: u32,
    period: Span,
}

impl Default for TimeGuard {
    fn default() -> Self {
        Self { last: None, last_raw: None, steady: 0, period: FIRST_PERIOD }
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
        let clocks = Clocks { host: host_now, runtime: runtime_now };
        let mut fault = None;
        if (SHORTEST_PERIOD..=LONGEST_PERIOD).contains(&period) {
            self.period = period;
        } else {
            fault = Some(TimeFault::Period(period));
        }
        let mut time_fault = self.fault_of(display, &clocks);
        let is_steady = time_fault.is_some() && self.runs_on(display, &clocks);
        self.steady = if is_steady { self.steady + 1 } else { 0 };
        // Our base was wrong, not the runtime: every right time would be a fault for ever.
        let rebased = self.steady >= STEADY_FAULTS;
        if rebased {
            self.steady = 0;
            time_fault = None;
        }
        let guarded = match time_fault {
            None => display,
            Some(_) => self.own_prediction(&clocks),
        };
        self.last = Some((guarded, clocks));
        self.last_raw = Some(display);
        Prediction { display: guarded, period: self.period, fault: time_fault.or(fault), rebased }
    }

    /// Goes by what an earlier session went by, in place of the prediction that was just made.
    pub(crate) fn take(
        &mut self,
        made: Prediction,
        taken: &TakenTimes,
        raw_display: Timestamp,
    ) -> Prediction {
        let TakenTimes { display, period, is_faulty, rebased } = *taken;
        if let Some((last, _)) = &mut self.last {
            *last = display;
        }
        self.period = period;
        let fault = is_faulty.then(|| made.fault.unwrap_or(TimeFault::NotLater(raw_display)));
        Prediction { display, period, fault, rebased }
    }

    /// Whether a time is possible by itself and follows what the runtime said before as frames do.
    fn runs_on(&self, display: Timestamp, clocks: &Clocks) -> bool {
        let is_far = |now| display.since(now).is_none_or(|lead| lead > LONGEST_LEAD);
        if display.as_nanos() <= 0 || clocks.runtime.is_some_and(is_far) {
            return false;
        }
        let Some(step) = self.last_raw.and_then(|before| display.since(before)) else { return false };
        let passed = self.last.map_or(Span::ZERO, |(_, then)| clocks.since(&then));
        // Half a period to two; a frame that took longer may be followed by as much more.
        let longest = self.period.max(passed).as_nanos().saturating_mul(2);
        (self.period.as_nanos() / 2..=longest).contains(&step.as_nanos())
    }

    fn fault_of(&self, display: Timestamp, clocks: &Clocks) -> Option<TimeFault> {
        if display.as_nanos() <= 0 {
            return Some(TimeFault::NotPositive(display));
        }
        let leads = |earlier: Timestamp, allowed: Span| {
            display.since(earlier).is_none_or(|lead| lead.as_nanos() > allowed.as_nanos())
        };
        if clocks.runtime.is_some_and(|now| leads(now, LONGEST_LEAD)) {
            return Some(TimeFault::FarFuture(display));
        }
        let (last, then) = self.last?;
        if display <= last {
            return Some(TimeFault::NotLater(display));
        }
        let allowed =
            Span::from_nanos(LONGEST_LEAD.as_nanos().saturating_add(clocks.since(&then).as_nanos()));
        (clocks.runtime.is_none() && leads(last, allowed)).then_some(TimeFault::FarFuture(display))
    }

    /// The frame before, plus the time that has passed but at least one period.
    fn own_prediction(&self, clocks: &Clocks) -> Timestamp {
        match self.last {
            Some((last, then)) => last.saturating_add(clocks.since(&then).max(self.period)),
            None => clocks
                .runtime
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

    /// Right times from `first_ms` on, 10 ms apart: the frames that are replaced before the runtime is believed.
    fn replaced_before_belief(guard: &mut TimeGuard, first_ms: i64, runtime_ahead_ms: Option<i64>) -> usize {
        let predictions: Vec<(i64, Prediction)> = (0..50)
            .map(|frame| {
                let (display_ms, host_ms) = (first_ms + 10 * frame, 10 + 10 * frame);
                let runtime_now = runtime_ahead_ms.map(|ahead| at(display_ms - ahead));
                (display_ms, guard.check(at(display_ms), Span::from_millis(10), at(host_ms), runtime_now))
            })
            .collect();
        let replaced = predictions.iter().take_while(|(_, p)| p.fault.is_some()).count();
        for (frame, (display_ms, p)) in predictions.iter().enumerate().skip(replaced) {
            assert_eq!((p.display, p.fault, p.rebased), (at(*display_ms), None, frame == replaced));
        }
        assert!(predictions.iter().take(replaced).all(|(_, p)| !p.rebased));
        replaced
    }

    /// The first right time does not yet run on from anything; five that do are replaced no longer at the fifth.
    #[test]
    fn a_first_time_in_the_far_future_locks_nothing_out() {
        let mut guard = TimeGuard::default();
        let far_ms = 27 * DAY_NS / MS;
        assert_eq!(check(&mut guard, far_ms, 0).fault, None, "nothing to compare it with");
        assert_eq!(replaced_before_belief(&mut guard, 5000, None), 5);
    }

    #[test]
    fn a_first_time_that_is_not_positive_locks_nothing_out() {
        for first_ms in [0, -7000] {
            let mut guard = TimeGuard::default();
            assert!(check(&mut guard, first_ms, 0).fault.is_some());
            assert_eq!(replaced_before_belief(&mut guard, 80_000_000, None), 5);
        }
    }

    #[test]
    fn a_base_two_seconds_ahead_of_the_runtimes_clock_is_left() {
        let mut guard = TimeGuard::default();
        let p = guard.check(at(6900), Span::from_millis(10), at(0), Some(at(5000)));
        assert_eq!(p.fault, None);
        assert_eq!(replaced_before_belief(&mut guard, 5030, Some(20)), 5);
    }

    /// Times that run on steadily but that the runtime's own clock contradicts, or that are no times, stay replaced.
    #[test]
    fn steady_nonsense_is_not_believed() {
        let day = DAY_NS / MS;
        for (first_ms, runtime_ms) in [(27 * day, Some(5000)), (-27 * day, Some(5000)), (-27 * day, None)] {
            let mut guard = TimeGuard::default();
            for frame in 0..100 {
                let runtime_now = runtime_ms.map(|ms| at(ms + 10 * frame));
                let display = at(first_ms + 10 * frame);
                let p = guard.check(display, Span::from_millis(10), at(10 * frame), runtime_now);
                assert!(p.fault.is_some() && !p.rebased, "{p:?}");
            }
        }
    }

    #[test]
    fn absurd_periods_are_replaced_by_the_last_good_one() {
        let mut guard = TimeGuard::default();
        check(&mut guard, 1000, 0);
        for period in [0, -1, 16_570 * 3_600_000 * MS, i64::MAX] {
            let mut next = TimeGuard { last: guard.last, period: guard.period, ..TimeGuard::default() };
            let p = next.check(at(1010), Span::from_nanos(period), at(10), None);
            assert_eq!(p.period, Span::from_millis(10));
            assert_eq!(p.fault, Some(TimeFault::Period(Span::from_nanos(period))));
        }
    }
}
