//! The map from a device's clock to the session's.
//!
//! A reading leaves the device at `d` on its clock and arrives at `a` on ours; `a − d` is the offset of the clocks plus the
//! latency, and latency only ever adds. So the offset is the *lower edge* of the points (d, a − d), and drift is its slope.
//! Of all lines that lie below all points, the one with the least mean distance to them is the edge of their lower convex
//! hull above the mean of d (Moon, Skelly, Towsley: Estimation and removal of clock skew from network delay measurements,
//! INFOCOM 1999). It is kept over a sliding window of which each tenth of a second leaves its lowest point, so that cost
//! and memory do not grow with the rate.

use std::collections::VecDeque;

use crate::{Counter, Span, Timestamp};

/// Parts of the window, each of which keeps its lowest point.
const BINS: i64 = 600;
/// Latencies scatter by tens of milliseconds: over less than this, a slope says nothing.
const FIRST_SLOPE_NS: f64 = 1e9;
/// A slope that is known is not given up for one over less than this.
const NEXT_SLOPE_NS: f64 = 5e9;
/// After this, what looks like another slope is a step.
const SURE_SLOPE_NS: f64 = 10e9;
/// Another slope must come nearer to the points than the one so far, by more the shorter they were watched.
const DOUBT_NS: f64 = 1.25e9;
const DOUBT_LEAST_NS: f64 = 20_000.0;
/// No oscillator is worse.
const MOST_DRIFT: f64 = 0.05;
/// A counter that goes back by more was set; less may be a matter of order.
const BACK_NS: i64 = -1_000_000_000;
/// Nothing arrives this much before it can: the counter was set forward.
const EARLY_NS: f64 = -1e9;
/// No latency is longer: the counter was set back, or the host slept.
const LATE_NS: f64 = 10e9;
/// So many bins, of so many, with a reading earlier than the line allows are another offset, not luck: it would have come
/// before.
const LOW_BINS: usize = 5;
const LOW_FOR: usize = 20;
const LOW_NS: f64 = -250_000.0;
/// So many bins in a row, all above a level above which there were at most half as many in a row before, are another
/// offset, not a busy bus. The more there are, the smaller a difference they prove.
const HIGH_RUNS: [usize; 4] = [10, 20, 40, 80];
/// A step must come this much nearer to the points than a slope.
const STEP: f64 = 1.25;
/// Smaller differences are left to the window's end.
const HIGH_NS: f64 = 300_000.0;

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
}

impl ClockKnobs {
    /// A counter, no declared latency, a window of a minute.
    pub const fn new(counter: Counter) -> Self {
        Self { counter, least_latency: Span::ZERO, window: Span::from_millis(60_000) }
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
}

#[derive(Clone, Copy, Debug, Default)]
struct Point {
    device_ns: i64,
    /// Arrival less device time.
    offset_ns: i64,
}

/// Offset as a function of device time.
#[derive(Clone, Copy, Debug, Default)]
struct Line {
    through: Point,
    slope: f64,
}

impl Line {
    fn offset_ns(&self, device_ns: i64) -> i64 {
        let along = device_ns.saturating_sub(self.through.device_ns) as f64;
        self.through.offset_ns.saturating_add((self.slope * along) as i64)
    }

    /// How far a point lies above.
    fn above_ns(&self, point: Point) -> i64 {
        point.offset_ns.saturating_sub(self.offset_ns(point.device_ns))
    }

    fn residual_ns(&self, point: Point) -> f64 {
        self.above_ns(point) as f64
    }
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
///     assert!(millis < 20 || mapped == captured);
/// }
/// ```
#[derive(Clone, Debug)]
pub struct ClockMap {
    knobs: ClockKnobs,
    bin_ns: i64,
    ticks: i128,
    last: Option<Last>,
    /// Closed bins, oldest first: the lowest point of each.
    bins: VecDeque<Point>,
    /// Places in `bins` of the hull's corners.
    hull: Vec<usize>,
    open: Point,
    open_since: Timestamp,
    /// As learnt when the last bin was closed.
    settled: Line,
    /// The same, lowered by what has arrived earlier since.
    line: Line,
    /// Over how long the slope was learnt, at most.
    slope_ns: f64,
    /// Bins since one was too early, and how many of them were.
    low_for: usize,
    low_bins: usize,
    residual_ns: f64,
    excess_ns: f64,
    jumps: u32,
}

impl ClockMap {
    /// A map that has learnt nothing.
    pub fn new(knobs: ClockKnobs) -> Self {
        let window_ns = knobs.window.as_nanos().clamp(6_000_000_000, 600_000_000_000);
        Self {
            knobs,
            bin_ns: window_ns / BINS,
            ticks: 0,
            last: None,
            bins: VecDeque::with_capacity(BINS as usize + 1),
            hull: Vec::with_capacity(BINS as usize + 1),
            open: Point::default(),
            open_since: Timestamp::default(),
            settled: Line::default(),
            line: Line::default(),
            slope_ns: 0.0,
            low_for: 0,
            low_bins: 0,
            residual_ns: 0.0,
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
        if back || !(EARLY_NS..=LATE_NS).contains(&(above_ns as f64)) {
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

    /// Forgets every point; what is known of the drift stays.
    fn begin(&mut self, point: Point, arrived: Timestamp) {
        self.bins.clear();
        (self.open, self.open_since) = (point, arrived);
        self.line.through = point;
        self.settled = self.line;
        (self.low_for, self.low_bins) = (0, 0);
    }

    /// The open bin is over.
    fn close(&mut self) {
        if self.bins.len() == BINS as usize {
            self.bins.pop_front();
        }
        self.bins.push_back(self.open);
        if self.was_set_forward() || self.was_set_back() {
            self.jumps = self.jumps.saturating_add(1);
            self.settled = self.line;
        } else if self.low_for == 0 {
            self.fit();
            self.settled = self.line;
        }
    }

    /// Readings keep coming earlier than they could.
    fn was_set_forward(&mut self) -> bool {
        let early = self.settled.residual_ns(self.open) < LOW_NS;
        if self.low_for == 0 && !(early && self.bins.len() > 2 * LOW_FOR) {
            return false;
        }
        self.low_for += 1;
        self.low_bins += usize::from(early);
        if self.low_bins < LOW_BINS {
            if self.low_for >= LOW_FOR {
                (self.low_for, self.low_bins) = (0, 0);
            }
            return false;
        }
        let old = self.bins.len() - self.low_for;
        (self.low_for, self.low_bins) = (0, 0);
        if self.is_drift(old, old) {
            return false;
        }
        // The line went down with the first of them.
        self.bins.drain(..old);
        true
    }

    /// Readings do not come any more as early as they did, and never before failed to for so long.
    fn was_set_back(&mut self) -> bool {
        let residual = |&point: &Point| self.settled.residual_ns(point).max(0.0);
        let Some(run) = HIGH_RUNS.into_iter().find(|&run| {
            let Some(old) = self.bins.len().checked_sub(run).filter(|&old| old >= 3 * run) else {
                return false;
            };
            let lowest = self.bins.range(old..).map(residual).fold(f64::INFINITY, f64::min);
            if lowest < HIGH_NS {
                return false;
            }
            let mut longest = (0, 0);
            for high in self.bins.range(..old).map(|point| residual(point) >= lowest) {
                longest.1 = if high { longest.1 + 1 } else { 0 };
                longest.0 = longest.1.max(longest.0);
            }
            longest.0 < run / 2
        }) else {
            return false;
        };
        // The first of them may hold readings of before.
        let (old, new) = (self.bins.len() - run, self.bins.len() - run / 2);
        self.line.through = self.lowest_from(new);
        if self.is_drift(old, new) {
            return false;
        }
        self.bins.drain(..new);
        true
    }

    /// Whether drift that was not known explains the points nearly as well as a step between the bins before `old` and
    /// those from `new` on; the line is then the drifting one.
    fn is_drift(&mut self, old: usize, new: usize) -> bool {
        if self.slope_ns >= SURE_SLOPE_NS {
            return false;
        }
        let Some(fitted) = self.fitted() else { return false };
        let end = self.bins.len();
        let above = |line: &Line, range| self.bins.range(range).map(|&p| line.residual_ns(p)).sum::<f64>();
        let step = above(&self.settled, 0..old) + above(&self.line, new..end);
        let is_drift = above(&fitted, 0..old) + above(&fitted, new..end) < STEP * step;
        if is_drift {
            self.line = fitted;
        }
        is_drift
    }

    /// Learns the line anew, where it has been watched for long enough.
    fn fit(&mut self) {
        let (Some(first), Some(last)) = (self.bins.front(), self.bins.back()) else { return };
        let watched_ns = last.device_ns.saturating_sub(first.device_ns) as f64;
        if watched_ns < if self.slope_ns > 0.0 { NEXT_SLOPE_NS } else { FIRST_SLOPE_NS } {
            return;
        }
        let Some(fitted) = self.fitted() else { return };
        let kept = Line { through: self.lowest_from(0), slope: self.line.slope };
        let (fits, keeps) = (self.mean_above(&fitted), self.mean_above(&kept));
        // Oscillators are better than what scattered latency over a short time makes of them.
        let doubt = 1.0 + DOUBT_NS / watched_ns;
        let better = keeps > fits * doubt + DOUBT_LEAST_NS;
        self.line = if better { fitted } else { kept };
        self.residual_ns = fits.min(keeps);
        if better || watched_ns >= NEXT_SLOPE_NS {
            self.slope_ns = self.slope_ns.max(watched_ns);
        }
    }

    /// The line below all points with the least mean distance to them.
    fn fitted(&mut self) -> Option<Line> {
        let &first = self.bins.front()?;
        let along = |point: Point| point.device_ns.saturating_sub(first.device_ns) as f64;
        let up = |point: Point| point.offset_ns.saturating_sub(first.offset_ns) as f64;
        self.hull.clear();
        let mut sum = 0.0;
        for (index, &point) in self.bins.iter().enumerate() {
            sum += along(point);
            // Device time may stand still or go back a little: only what is ahead can be a corner.
            if self.hull.last().is_some_and(|&corner| along(point) <= along(self.bins[corner])) {
                continue;
            }
            while let [.., a, b] = self.hull[..] {
                let (a, b) = (self.bins[a], self.bins[b]);
                let cross =
                    (along(b) - along(a)) * (up(point) - up(a)) - (up(b) - up(a)) * (along(point) - along(a));
                if cross > 0.0 {
                    break;
                }
                self.hull.pop();
            }
            self.hull.push(index);
        }
        let mean = sum / self.bins.len() as f64;
        let edge = self.hull.windows(2).map(|pair| (self.bins[pair[0]], self.bins[pair[1]]));
        let (a, b) = edge.reduce(|edge, next| if along(next.0) <= mean { next } else { edge })?;
        let slope = (up(b) - up(a)) / (along(b) - along(a));
        (slope.abs() <= MOST_DRIFT).then_some(Line { through: b, slope })
    }

    /// The point that a line of the present slope below the points from this bin on goes through.
    fn lowest_from(&self, first: usize) -> Point {
        let lower = |low: Point, point: Point| {
            if (Line { through: low, ..self.line }).residual_ns(point) < 0.0 { point } else { low }
        };
        self.bins.range(first..).copied().reduce(lower).unwrap_or(self.open)
    }

    fn mean_above(&self, line: &Line) -> f64 {
        self.bins.iter().map(|&point| line.residual_ns(point)).sum::<f64>() / self.bins.len() as f64
    }

    /// How it stands.
    pub fn state(&self) -> ClockState {
        ClockState {
            // Offset that grows with the device's time: it counts too little.
            drift_ppm: (self.slope_ns > 0.0).then(|| -self.line.slope / (1.0 + self.line.slope) * 1e6),
            residual: Span::from_nanos(self.residual_ns as i64),
            excess: Span::from_nanos(self.excess_ns as i64),
            jumps: self.jumps,
        }
    }
}
