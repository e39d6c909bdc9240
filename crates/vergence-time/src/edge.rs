//! The lower edge of scattered points, in pieces of one slope: how a clock map tells latency, drift and steps apart.
//!
//! Each tenth of a second of a device's readings leaves its lowest point (device time, arrival less device time). The
//! points lie above an edge of which the slope is the drift, one for all, and which is broken wherever the clock was set.
//! Slope: quantile regression (Koenker, Bassett: Regression quantiles, Econometrica 46, 1978) of the lowest quarter, each
//! piece with an offset of its own, held near what oscillators are and near what is known by a prior that costs a squared
//! deviation. A quarter of the points carries it, so that neither load that lasts nor two lucky points turn it, as they
//! turn the edge of the convex hull. Offset: the lowest point. Steps: where breaking the edge makes the points so much
//! likelier, as exponentially scattered ones, that chance does not explain it.

use std::collections::VecDeque;
use std::ops::Range;

/// Points of the window.
pub(crate) const BINS: usize = 600;
/// Pieces of the edge that are in the window at a time.
const PIECES: usize = 8;
/// More points are fitted as so many groups' lowest.
const GROUPS: usize = 120;
/// The quantile whose slope the edge has.
const QUANTILE: f64 = 0.08;
/// The quantile that a step moves by this share of what it moves the lowest.
const WHOLE: f64 = 0.25;
const MOVED: f64 = 0.25;
/// Narrows the slope to a millionth of where it is looked for.
const SEARCH: usize = 28;
/// Neighbouring points share their load: so many count as one.
const ALIKE: f64 = 2.0;
/// Points are not told apart better than clocks tick and interrupts come.
const LEAST_SCATTER_NS: f64 = 20_000.0;
/// Oscillators differ by this share of the most that they may.
const USUAL_DRIFT: f64 = 0.03;
/// How far a drift that has been learnt is expected to move, as a share of the most.
const USUAL_CHANGE: f64 = 0.0012;
/// Of a drift that is known, this share of what a bin says otherwise is believed.
const SLOWLY: f64 = 0.004;
/// A drift is known after this.
const KNOWN_NS: f64 = 15e9;
/// Over less than this, scattered latency says nothing of the drift.
pub(crate) const FIRST_SLOPE_NS: f64 = 1e9;
/// Logarithm of how much likelier a step makes the points than none.
const PROOF: f64 = 11.0;
/// The same of a piece that is told by its lowest.
const FEW_PROOF: f64 = 30.0;
/// Smaller steps are left to the window's end.
const STEP_NS: f64 = 500_000.0;
/// For so long must readings come late before a clock counts as set back: a load may keep them back.
const LATE_FOR_NS: i64 = 6_000_000_000;
/// So many points must be early, or late.
const STEP_BINS: usize = 10;
/// Readings that come early for less may be of a drift that is not known yet. The line goes down with them at once.
const EARLY_FOR_NS: i64 = 4_000_000_000;
/// A row of late points is no step where one of more than two thirds of its length was there before.
const SHORTER: usize = 3;
/// A piece of so few points is told by its lowest: a clock that was set, or a device that began anew, as it was opened.
const FEW_BINS: usize = 3;
/// So many points then prove as much as they ever will.
const ENOUGH_BINS: f64 = 60.0;
/// So many deviations from what is known are surprising, more are not more so.
const SURPRISE: f64 = 3.0;
/// A slope that is known is learnt anew after so many points.
const FIT_EVERY: u32 = 5;
/// A slope of so many points ago is not turned by a step that is not found yet.
const PROBATION: u32 = 50;

/// The earliest reading of a tenth of a second.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Point {
    pub(crate) device_ns: i64,
    /// Arrival less device time.
    pub(crate) offset_ns: i64,
}

impl Point {
    fn arrived_ns(self) -> i64 {
        self.device_ns.saturating_add(self.offset_ns)
    }
}

/// Offset as a function of device time.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Line {
    pub(crate) through: Point,
    pub(crate) slope: f64,
}

impl Line {
    fn offset_ns(&self, device_ns: i64) -> i64 {
        let along = device_ns.saturating_sub(self.through.device_ns) as f64;
        self.through.offset_ns.saturating_add((self.slope * along) as i64)
    }

    /// How far a point lies above.
    pub(crate) fn above_ns(&self, point: Point) -> i64 {
        point.offset_ns.saturating_sub(self.offset_ns(point.device_ns))
    }
}

/// What a slope costs.
#[derive(Clone, Copy, Debug)]
struct Fit {
    slope: f64,
    /// Minus the logarithm of the likelihood of the points and of the slope.
    cost: f64,
}

/// The window of points, and the edge beneath them. Allocates when it is made, never after.
#[derive(Clone, Debug)]
pub(crate) struct Edge {
    /// Oldest first, each with its piece.
    bins: VecDeque<(Point, u8)>,
    piece: u8,
    most_slope: f64,
    window_ns: i64,
    /// What is known of the slope, and over how long it was learnt.
    known: f64,
    is_known: bool,
    /// As it was a while ago, and less of a while ago.
    slopes: [f64; 2],
    learnt_ns: f64,
    closed: u32,
    /// For the fit: points relative to the last, by pieces, and where each piece ends.
    along: Vec<f64>,
    up: Vec<f64>,
    ends: [usize; PIECES],
    heights: Vec<f64>,
    slope: f64,
    residual_ns: f64,
}

impl Edge {
    pub(crate) fn new(most_slope: f64, window_ns: i64) -> Self {
        Self {
            bins: VecDeque::with_capacity(BINS + 1),
            piece: 0,
            most_slope,
            window_ns,
            known: 0.0,
            is_known: false,
            slopes: [0.0; 2],
            learnt_ns: 0.0,
            closed: 0,
            along: Vec::with_capacity(BINS + 1),
            up: Vec::with_capacity(BINS + 1),
            ends: [0; PIECES],
            heights: Vec::with_capacity(BINS + 1),
            slope: 0.0,
            residual_ns: 0.0,
        }
    }

    /// The slope, where it has been watched for long enough to be one.
    pub(crate) fn slope(&self) -> Option<f64> {
        (self.learnt_ns >= FIRST_SLOPE_NS).then_some(self.slope)
    }

    /// Mean distance of the points of the present piece from the edge.
    pub(crate) fn residual_ns(&self) -> f64 {
        self.residual_ns
    }

    /// The clock was set: what follows has an offset of its own.
    pub(crate) fn begin(&mut self) {
        if !self.bins.is_empty() {
            self.piece = self.free_piece();
        }
    }

    /// A piece's number that is free: the oldest gives way.
    fn free_piece(&mut self) -> u8 {
        let piece = (self.piece + 1) % PIECES as u8;
        self.bins.retain(|bin| bin.1 != piece);
        piece
    }

    /// Takes the lowest point of a tenth of a second; the line as it is after it, and whether the clock was found set.
    pub(crate) fn close(&mut self, open: Point) -> (Line, bool) {
        if self.bins.len() == BINS {
            self.bins.pop_front();
        }
        self.bins.push_back((open, self.piece));
        let stepped = self.learn();
        let slope = self.slope;
        let line = |through| Line { through, slope };
        let here = || self.bins.iter().filter(|bin| bin.1 == self.piece).map(|bin| bin.0);
        let lowest = here().reduce(|low, point| if line(low).above_ns(point) < 0 { point } else { low });
        let line = line(lowest.unwrap_or(open));
        let (mut sum, mut count) = (0.0, 0.0);
        for point in here() {
            sum += line.above_ns(point) as f64;
            count += 1.0;
        }
        self.residual_ns = sum / f64::max(count, 1.0);
        (line, stepped)
    }

    /// Learns the slope, and looks for a step.
    fn learn(&mut self) -> bool {
        self.closed = self.closed.wrapping_add(1);
        if self.is_known && !self.closed.is_multiple_of(FIT_EVERY) {
            return false;
        }
        let Some(one) = self.fit() else { return false };
        self.slope = one.slope;
        // What was known before is not yet turned by a step.
        let slopes = [one.slope, self.slopes[0], self.known];
        let found = slopes.into_iter().find_map(|slope| self.step(slope, one.cost));
        if let Some(slope) = found {
            (self.slope, self.slopes) = (slope, [slope; 2]);
        }
        if self.closed.is_multiple_of(PROBATION) {
            self.slopes = [self.slopes[1], self.slope];
        }
        if self.learnt_ns >= KNOWN_NS {
            let share = if self.is_known { SLOWLY * f64::from(FIT_EVERY) } else { 1.0 };
            self.known += (self.slopes[0] - self.known) * share;
            self.is_known = true;
        }
        found.is_some()
    }

    /// Breaks the present piece where, with this slope, it is most likely broken, unless the edge is likely enough unbroken.
    /// The slope that the edge then has.
    fn step(&mut self, slope: f64, cost: f64) -> Option<f64> {
        self.gather(self.slope, 1);
        let end = self.ends[usize::from(self.piece)];
        let from = if self.piece == 0 { 0 } else { self.ends[usize::from(self.piece) - 1] };
        self.heights.clear();
        for place in from..end {
            self.heights.push(self.up[place] - slope * self.along[place]);
        }
        let at = likeliest_break(&self.heights, &mut self.up)?;
        let (old, new) = self.heights.split_at(at);
        let lowest = |heights: &[f64]| heights.iter().copied().fold(f64::INFINITY, f64::min);
        let (level, step) = (lowest(new), lowest(new) - lowest(old));
        let since = self.bins.back()?.0.arrived_ns().saturating_sub(self.nth_here(at)?.arrived_ns());
        let least = if step < 0.0 { EARLY_FOR_NS } else { LATE_FOR_NS };
        if step.abs() < STEP_NS
            || new.len() < STEP_BINS
            || since < least.min(self.window_ns / 4)
            || step > 0.0 && longest_above(old, level) * SHORTER >= new.len() * 2
        {
            return None;
        }
        let mean = |heights: &[f64], lowest: f64| {
            heights.iter().map(|height| height - lowest).sum::<f64>() / heights.len() as f64
        };
        let by_lowest = at <= FEW_BINS && step > 0.0 && {
            let scatter = mean(new, level).max(LEAST_SCATTER_NS);
            f64::min(new.len() as f64, ENOUGH_BINS) / ALIKE * (step / scatter).ln_1p() >= FEW_PROOF
        };
        // A step moves the whole scatter, load and luck only its end.
        let (old, new) = self.heights.split_at_mut(at);
        if (quantile_of(new, WHOLE) - quantile_of(old, WHOLE)) / step < MOVED {
            return None;
        }
        // Tentatively.
        let (before, piece) = (self.piece, self.free_piece());
        // Pieces that gave way are no points of this one.
        let mut place = 0;
        for bin in &mut self.bins {
            if bin.1 == before {
                if place >= at {
                    bin.1 = piece;
                }
                place += 1;
            }
        }
        let broken = self.fit()?;
        if cost - broken.cost < PROOF && !by_lowest {
            for bin in &mut self.bins {
                if bin.1 == piece {
                    bin.1 = before;
                }
            }
            return None;
        }
        self.piece = piece;
        Some(broken.slope)
    }

    fn nth_here(&self, nth: usize) -> Option<Point> {
        self.bins.iter().filter(|bin| bin.1 == self.piece).nth(nth).map(|bin| bin.0)
    }

    /// Points relative to the last, by pieces, grouped by so many whose lowest it is for this slope.
    fn gather(&mut self, slope: f64, group: usize) {
        self.along.clear();
        self.up.clear();
        let last = self.bins.back().map_or(Point::default(), |bin| bin.0);
        for piece in 0..PIECES {
            let mut in_group = 0;
            for &(point, of) in &self.bins {
                if usize::from(of) != piece {
                    continue;
                }
                let along = point.device_ns.saturating_sub(last.device_ns) as f64;
                let up = point.offset_ns.saturating_sub(last.offset_ns) as f64;
                match (self.along.last_mut(), self.up.last_mut()) {
                    (Some(a), Some(u)) if in_group > 0 => {
                        if up - slope * along < *u - slope * *a {
                            (*a, *u) = (along, up);
                        }
                    }
                    _ => {
                        self.along.push(along);
                        self.up.push(up);
                    }
                }
                in_group = (in_group + 1) % group;
            }
            self.ends[piece] = self.along.len();
        }
    }

    fn pieces(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        let from = [0].into_iter().chain(self.ends);
        from.zip(self.ends).map(|(from, to)| from..to)
    }

    /// The likeliest slope.
    fn fit(&mut self) -> Option<Fit> {
        let group = self.bins.len().div_ceil(GROUPS);
        self.gather(self.slope, group);
        let mut watched = 0.0;
        for piece in self.pieces() {
            let along = self.along.get(piece)?;
            watched += along.last().zip(along.first()).map_or(0.0, |(a, b)| (a - b).abs());
        }
        self.learnt_ns = self.learnt_ns.max(watched);
        let count = self.along.len();
        if watched < FIRST_SLOPE_NS || count < 4 {
            return None;
        }
        let used = self.pieces().filter(|piece| !piece.is_empty()).count();
        let free = f64::max(count as f64 - 1.0 - used as f64, 1.0);
        let best = |loss: &mut dyn FnMut(f64) -> f64, most: f64| {
            // Golden section: the loss is convex.
            const GOLDEN: f64 = 0.618_033_988_749_894_9;
            let (mut low, mut high) = (-most, most);
            let (mut a, mut b) = (high - GOLDEN * (high - low), low + GOLDEN * (high - low));
            let (mut at_a, mut at_b) = (loss(a), loss(b));
            for _ in 0..SEARCH {
                if at_a <= at_b {
                    (high, b, at_b) = (b, a, at_a);
                    a = high - GOLDEN * (high - low);
                    at_a = loss(a);
                } else {
                    (low, a, at_a) = (a, b, at_b);
                    b = low + GOLDEN * (high - low);
                    at_b = loss(b);
                }
            }
            (low + high) / 2.0
        };
        let most = self.most_slope;
        let free_slope = best(&mut |slope| self.loss(slope), most);
        let scatter = (self.loss(free_slope) / free).max(LEAST_SCATTER_NS);
        let narrow = if self.is_known { (KNOWN_NS / self.learnt_ns).powi(2) } else { 1.0 };
        let usual = most * (USUAL_DRIFT * narrow).max(USUAL_CHANGE);
        let known = self.known;
        let prior = |slope: f64| {
            let off = (slope - known).abs() / usual;
            if off < SURPRISE { off * off / 2.0 } else { SURPRISE * (off - SURPRISE / 2.0) }
        };
        let slope = best(&mut |slope| self.loss(slope) / scatter + prior(slope), most);
        let mean = (self.loss(slope) / free).max(LEAST_SCATTER_NS);
        Some(Fit { slope, cost: count as f64 / ALIKE * mean.ln() + prior(slope) })
    }

    /// Sum of the quantile's losses over all points.
    fn loss(&mut self, slope: f64) -> f64 {
        let mut sum = 0.0;
        let mut from = 0;
        for to in self.ends {
            if to - from > 1 {
                self.heights.clear();
                for (along, up) in self.along[from..to].iter().zip(&self.up[from..to]) {
                    self.heights.push(up - slope * along);
                }
                let level = quantile_of(&mut self.heights, QUANTILE);
                for height in &self.heights {
                    let above = height - level;
                    sum += if above > 0.0 { QUANTILE * above } else { (QUANTILE - 1.0) * above };
                }
            }
            from = to;
        }
        sum
    }
}

/// Reorders.
fn quantile_of(heights: &mut [f64], quantile: f64) -> f64 {
    let place = (heights.len() as f64 * quantile) as usize;
    *heights.select_nth_unstable_by(place.min(heights.len() - 1), f64::total_cmp).1
}

/// Before which of the heights a break brings two level lines beneath them nearest to them; the lines have at least one each.
fn likeliest_break(heights: &[f64], later: &mut Vec<f64>) -> Option<usize> {
    let count = heights.len();
    // Sums of the heights above the lowest, from each on.
    later.clear();
    later.resize(count, 0.0);
    let (mut sum, mut lowest) = (0.0, f64::INFINITY);
    for (place, &height) in heights.iter().enumerate().rev() {
        lowest = lowest.min(height);
        sum += height;
        later[place] = sum - lowest * (count - place) as f64;
    }
    let (mut sum, mut lowest) = (0.0, f64::INFINITY);
    let mut best = None;
    for (place, &height) in heights.iter().enumerate().take(count.saturating_sub(1)) {
        lowest = lowest.min(height);
        sum += height;
        let all = sum - lowest * (place + 1) as f64 + later[place + 1];
        if best.is_none_or(|(least, _)| all < least) {
            best = Some((all, place + 1));
        }
    }
    best.map(|best| best.1)
}

/// The most heights in a row that are all at or above a level.
fn longest_above(heights: &[f64], level: f64) -> usize {
    let (mut longest, mut here) = (0, 0);
    for &height in heights {
        here = if height >= level { here + 1 } else { 0 };
        longest = longest.max(here);
    }
    longest
}
