//! The map from a device's clock to the session's.
//!
//! A reading leaves the device at `d` on its clock and arrives at `a` on ours; `a − d` is the offset of the clocks plus the
//! latency, and latency only ever adds. So the offset is the *lower edge* of the points (d, a − d), and drift is its slope.
//! The `edge` module finds it, over a sliding window of which each tenth of a second leaves its lowest point, so that cost
//! and memory do not grow with the rate.

use crate::edge::{BINS, Edge, Line, Point};
use crate::{Counter, Span, Timestamp};

/// A counter that goes back by more was set; less may be a matter of order.
const BACK_NS: i64 = -250_000_000;
/// Nothing arrives this much before it can: the counter was set forward.
const EARLY_NS: i64 = -1_000_000_000;
/// No latency is longer: the counter was set back, or the host slept.
const LATE_NS: i64 = 10_000_000_000;

/// A drift of this share of the bound is held back by it: what is known of oscillators pulls it a little below.
const AT_BOUND: f64 = 0.97;

/// Knobs of a [`ClockMap`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockKnobs {
    /// What the device counts.
    pub counter: Counter,
    /// What the fastest reading takes from capture to arrival, where the maker declares it: subtracted. It cannot be
    /// measured from one side; without it, times are late by it, all by the same.
    pub least_latency: Span,
    /// How far back readings count, 6 s to 10 min, default 60 s. Short: follows a clock that warms up, and errs more where
    /// fast readings are rare. Memory: 600 points at any length.
    pub window: Span,
    /// No oscillator of the device is worse, parts per million, 10 to 50,000, default 5000: ceramic resonators. Of a device
    /// with a crystal, 200 makes the map surer while it has little to go by; an RC oscillator may need 30,000.
    pub most_drift_ppm: u32,
}

impl ClockKnobs {
    /// What ceramic resonators are off by at most, parts per million.
    pub const MOST_DRIFT_PPM: u32 = 5000;
    /// What may be said of a clock, parts per million.
    pub const DRIFTS_PPM: std::ops::RangeInclusive<u32> = 10..=50_000;

    /// A counter, no declared latency, a window of a minute.
    pub const fn new(counter: Counter) -> Self {
        Self {
            counter,
            least_latency: Span::ZERO,
            window: Span::from_millis(60_000),
            most_drift_ppm: Self::MOST_DRIFT_PPM,
        }
    }

    fn drift_bound_ppm(&self) -> u32 {
        self.most_drift_ppm.clamp(*Self::DRIFTS_PPM.start(), *Self::DRIFTS_PPM.end())
    }
}

/// How a [`ClockMap`] stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockState {
    /// How much faster the device's clock runs than ours, parts per million; `None` in the first second.
    pub drift_ppm: Option<f64>,
    /// Mean distance of the fastest readings of each tenth of a second from the line: how well the map is pinned down.
    pub residual: Span,
    /// How much longer than the fastest the last reading took.
    pub excess: Span,
    /// How often the device's clock was found set, forward, back, or begun anew.
    pub jumps: u32,
    /// The drift is as much as [`ClockKnobs::most_drift_ppm`] allows: it may be more, and times err until that is raised.
    pub drift_is_at_bound: bool,
}

#[derive(Clone, Copy, Debug)]
struct Last {
    raw: u64,
    device_ns: i64,
    arrived: Timestamp,
    captured: Timestamp,
}

/// Maps the readings of a device's counter to session time: offset and drift are learnt from when readings arrive.
///
/// Robust to latency that only ever adds, to counters that wrap, to devices that begin anew and to clocks that are set.
/// Results are never later than the arrival, and never run backwards where the device's clock does not. Allocates when it is made, never
/// after.
///
/// ```
/// use vergence_time::{ClockKnobs, ClockMap, Counter, Span, Timestamp};
/// let least_latency = Span::from_millis(1);
/// let mut map = ClockMap::new(ClockKnobs { least_latency, ..ClockKnobs::new(Counter::MICROS_32) });
/// for millis in 0..3000i64 {
///     // Readings take 1 ms or 8 ms; the device's clock began elsewhere and will wrap.
///     let captured = Timestamp::from_nanos(millis * 1_000_000);
///     let raw = u64::from(4_294_000_000u32.wrapping_add(millis as u32 * 1000));
///     let latency = Span::from_millis(if millis % 3 == 0 { 1 } else { 8 });
///     let mapped = map.map(raw, captured.saturating_add(latency));
///     assert!(millis < 20 || (mapped.as_nanos() - captured.as_nanos()).abs() < 1000);
/// }
/// ```
#[derive(Clone, Debug)]
pub struct ClockMap {
    knobs: ClockKnobs,
    bin_ns: i64,
    ticks: i128,
    last: Option<Last>,
    /// The earliest readings of each tenth of a second that is over.
    edge: Edge,
    open: Point,
    open_since: Timestamp,
    /// As the edge was learnt, lowered by what has arrived earlier since.
    line: Line,
    excess_ns: f64,
    jumps: u32,
}

impl ClockMap {
    /// A map that has learnt nothing.
    pub fn new(knobs: ClockKnobs) -> Self {
        let window_ns = knobs.window.as_nanos().clamp(6_000_000_000, 600_000_000_000);
        Self {
            knobs,
            bin_ns: window_ns / BINS as i64,
            ticks: 0,
            last: None,
            edge: Edge::new(f64::from(knobs.drift_bound_ppm()) * 1e-6, window_ns),
            open: Point::default(),
            open_since: Timestamp::default(),
            line: Line::default(),
            excess_ns: 0.0,
            jumps: 0,
        }
    }

    /// When the reading with the counter at `raw`, which arrived at `arrived`, was captured. Readings are given in the
    /// order of arrival, or in that of the device. Bits of `raw` above the counter's width are passed over.
    pub fn map(&mut self, raw: u64, arrived: Timestamp) -> Timestamp {
        let raw = self.knobs.counter.mask(raw);
        let Some(last) = self.last else {
            self.begin(Point { device_ns: 0, offset_ns: arrived.as_nanos() }, arrived);
            return self.answer(raw, 0, arrived, arrived);
        };
        let meanwhile = arrived.since(last.arrived).unwrap_or(Span::ZERO);
        self.ticks = self.ticks.saturating_add(self.knobs.counter.ticks_between(last.raw, raw, meanwhile));
        let device_ns = self.knobs.counter.nanos_of(self.ticks);
        let point = Point { device_ns, offset_ns: arrived.as_nanos().saturating_sub(device_ns) };
        let mut above_ns = self.line.above_ns(point);
        let back = device_ns.saturating_sub(last.device_ns) < BACK_NS;
        if back || !(EARLY_NS..=LATE_NS).contains(&above_ns) {
            self.jumps = self.jumps.saturating_add(1);
            self.begin(point, arrived);
            above_ns = 0;
        } else {
            let age = arrived.since(self.open_since).map_or(i64::MAX, Span::as_nanos);
            if age >= self.bin_ns || age < BACK_NS {
                self.close();
                (self.open, self.open_since) = (point, arrived);
                above_ns = self.line.above_ns(point);
            } else if (Line { through: self.open, ..self.line }).above_ns(point) < 0 {
                self.open = point;
            }
            if above_ns < 0 {
                self.line.through = point;
                above_ns = 0;
            }
        }
        self.excess_ns = above_ns as f64;
        let earliest = arrived.as_nanos().saturating_sub(above_ns);
        self.answer(raw, device_ns, arrived, Timestamp::from_nanos(earliest).min(arrived))
    }

    fn answer(&mut self, raw: u64, device_ns: i64, arrived: Timestamp, earliest: Timestamp) -> Timestamp {
        let least = Span::from_nanos(self.knobs.least_latency.as_nanos().max(0).saturating_neg());
        let captured = earliest.saturating_add(least);
        let not_before =
            self.last.filter(|last| device_ns >= last.device_ns).map_or(captured, |l| l.captured);
        let captured = captured.max(not_before).min(arrived);
        self.last = Some(Last { raw, device_ns, arrived, captured });
        captured
    }

    /// The clock was set, by so much that one reading shows it; what is known of the drift stays.
    fn begin(&mut self, point: Point, arrived: Timestamp) {
        self.edge.begin();
        (self.open, self.open_since) = (point, arrived);
        self.line.through = point;
    }

    /// The open bin is over.
    fn close(&mut self) {
        let (line, was_set) = self.edge.close(self.open);
        self.line = line;
        self.jumps = self.jumps.saturating_add(u32::from(was_set));
    }

    /// How it stands.
    pub fn state(&self) -> ClockState {
        ClockState {
            // Offset that grows with the device's time: it counts too little.
            drift_ppm: self.edge.slope().map(|slope| -slope / (1.0 + slope) * 1e6),
            residual: Span::from_nanos(self.edge.residual_ns() as i64),
            excess: Span::from_nanos(self.excess_ns as i64),
            jumps: self.jumps,
            drift_is_at_bound: self
                .edge
                .slope()
                .is_some_and(|slope| slope.abs() > AT_BOUND * 1e-6 * f64::from(self.knobs.drift_bound_ppm())),
        }
    }
}
