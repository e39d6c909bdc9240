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

/// Says how the clock stands, once a second, and each time that it was found set.
#[derive(Debug, Default)]
pub(crate) struct ClockReport {
    due: Option<Timestamp>,
    jumps: u32,
}

impl ClockReport {
    pub(crate) fn say(&mut self, state: ClockState, now: Timestamp, sink: &mut dyn Sink) {
        if state.jumps != self.jumps {
            let (before, after) = (f64::from(self.jumps), f64::from(state.jumps));
            self.jumps = state.jumps;
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
        }
    }
}
