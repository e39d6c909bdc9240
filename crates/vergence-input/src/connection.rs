//! What every device has beside its readings: events of its connection, and how its clock stands.

use vergence_sense::{Event, Reading, ReadingKind, Sample, Scalar, Sink, SourceStream};
use vergence_time::{ClockState, Span, Timestamp};

/// Place of the stream of events: `connected`, `disconnected`, `gap`, …
pub const EVENTS: usize = 0;
/// Place of the stream of the clock's residual.
pub const CLOCK_RESIDUAL: usize = 1;
/// A device that is gone is looked for this often.
pub(crate) const TRY_AGAIN: Span = Span::from_millis(250);

/// The streams that every device with a clock has, in front of its own.
pub(crate) fn own_streams() -> Vec<SourceStream> {
    vec![
        SourceStream::new("events", ReadingKind::Event),
        SourceStream::new("clock/residual", ReadingKind::Scalar).unit("ms").rate_hz(1.0),
    ]
}

/// Says an event.
pub(crate) fn tell(sink: &mut dyn Sink, at: Timestamp, event: Event) {
    sink.take(EVENTS, Sample { captured: at, arrived: at, value: Reading::Event(event) });
}

/// An event with a text of its own.
#[cfg_attr(not(feature = "serial"), allow(dead_code))]
pub(crate) fn event(name: &'static str, text: String) -> Event {
    Event { text: text.into(), ..Event::new(name, "") }
}

/// Seconds of a drift at its bound after which a clock is said to be off, and for how many a clock that was found set counts: a drift
/// far beyond the bound looks like a clock that is set again and again.
const OFF_FOR: u32 = 15;
const SET_COUNTS: u32 = 8;

/// Says how the clock stands, once a second, each time that it was found set, and once that it is off by too much.
#[derive(Debug, Default)]
pub(crate) struct ClockReport {
    due: Option<Timestamp>,
    jumps: u32,
    /// Since the last report.
    was_set: bool,
    /// How long it was off, seconds; falls while it is not.
    off: u32,
}

impl ClockReport {
    pub(crate) fn say(&mut self, state: ClockState, now: Timestamp, sink: &mut dyn Sink) {
        if state.jumps != self.jumps {
            let (before, after) = (f64::from(self.jumps), f64::from(state.jumps));
            (self.jumps, self.was_set) = (state.jumps, true);
            tell(
                sink,
                now,
                Event {
                    before,
                    after,
                    ..Event::new("clock_set", "the device's clock was set or began anew")
                },
            );
        }
        if self.due.is_none_or(|due| now >= due) {
            self.due = now.checked_add(Span::from_millis(1000));
            let value = Reading::Scalar(Scalar(state.residual.as_millis_f64()));
            sink.take(CLOCK_RESIDUAL, Sample { captured: now, arrived: now, value });
            let was_set = std::mem::take(&mut self.was_set);
            if self.off < OFF_FOR {
                self.off = if state.drift_is_at_bound { self.off + 1 } else { self.off.saturating_sub(1) };
                self.off += SET_COUNTS * u32::from(was_set);
                if self.off >= OFF_FOR {
                    let text = "the device's clock is off by as much as most_drift_ppm allows, or more: times of capture err";
                    let after = state.drift_ppm.unwrap_or(f64::NAN);
                    tell(sink, now, Event { after, ..Event::new("clock_off", text) });
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{ClockReport, EVENTS};
    use vergence_sense::{Reading, Sample, Sink};
    use vergence_time::{ClockKnobs, ClockMap, Counter, Timestamp};

    /// Names of events, in their order.
    #[derive(Default)]
    struct Names(Vec<String>);

    impl Sink for Names {
        fn take(&mut self, stream: usize, sample: Sample<Reading<'_>>) {
            if let (EVENTS, Reading::Event(event)) = (stream, sample.value) {
                self.0.push(event.name.to_string());
            }
        }
    }

    /// What is said in a minute of a clock that is off by so much, and set on by so many milliseconds at 20 s.
    fn said(drift_ppm: f64, set_ms: f64) -> Vec<String> {
        let mut map = ClockMap::new(ClockKnobs::new(Counter::MICROS_32));
        let (mut report, mut names, mut dice) = (ClockReport::default(), Names::default(), 1u32);
        for tick in 0..12_000 {
            let at_s = f64::from(tick) * 0.005;
            dice = dice.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let latency_s = 1e-3 + 7e-3 * f64::from(dice >> 8) / f64::from(1 << 24);
            let set_s = if at_s < 20.0 { 0.0 } else { set_ms * 1e-3 };
            let device_us = (at_s * (1.0 + drift_ppm * 1e-6) + set_s) * 1e6;
            let arrived = Timestamp::from_nanos(((at_s + latency_s) * 1e9) as i64);
            map.map((device_us + 1e9) as u64, arrived);
            report.say(map.state(), arrived, &mut names);
        }
        names.0
    }

    #[test]
    fn a_clock_that_is_off_by_more_than_is_allowed_is_said_once() {
        let count = |names: &[String]| names.iter().filter(|name| *name == "clock_off").count();
        for drift_ppm in [-20_000.0, -8000.0, 8000.0, 15_000.0, 40_000.0] {
            let names = said(drift_ppm, 0.0);
            assert_eq!(count(&names), 1, "{drift_ppm}: {names:?}");
        }
        for (drift_ppm, set_ms) in
            [(0.0, 0.0), (4500.0, 0.0), (-4500.0, 37.0), (120.0, 250.0), (120.0, -900.0)]
        {
            let names = said(drift_ppm, set_ms);
            assert_eq!(count(&names), 0, "{drift_ppm}, set by {set_ms} ms: {names:?}");
        }
    }
}
