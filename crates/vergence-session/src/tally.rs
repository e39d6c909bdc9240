//! What is counted and measured once per frame; allocates before the first frame only.

use vergence_time::{Span, Timestamp};

use crate::report::Milliseconds;

/// Frames whose times are kept; later ones overwrite the oldest.
const KEPT: usize = 1 << 16;

/// Times of the last frames.
#[derive(Debug)]
pub(crate) struct Series {
    nanos: Vec<i64>,
    next: usize,
}

impl Default for Series {
    fn default() -> Self {
        Self { nanos: Vec::with_capacity(KEPT), next: 0 }
    }
}

impl Series {
    pub(crate) fn add(&mut self, span: Span) {
        if self.nanos.len() < KEPT {
            self.nanos.push(span.as_nanos());
        } else {
            self.nanos[self.next] = span.as_nanos();
            self.next = (self.next + 1) % KEPT;
        }
    }

    /// Nearest-rank percentiles.
    pub(crate) fn percentiles(&self) -> Milliseconds {
        let mut sorted = self.nanos.clone();
        sorted.sort_unstable();
        let at = |percent: usize| {
            let rank = (sorted.len() * percent).div_ceil(100).saturating_sub(1);
            sorted.get(rank).map_or(0.0, |&nanos| Span::from_nanos(nanos).as_millis_f64())
        };
        Milliseconds { p50: at(50), p95: at(95), p99: at(99), max: at(100) }
    }
}

/// Counts over a whole run, losses and all.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    pub(crate) frames: u64,
    /// Frames that were waited for, shown or not.
    pub(crate) paced: u64,
    pub(crate) missed: u64,
    pub(crate) losses: u32,
    pub(crate) frame_cpu: Series,
    pub(crate) pose_age: Series,
    /// Session time of the frames of sessions that are over.
    before: Span,
    first: Option<Timestamp>,
    last: Option<Timestamp>,
}

impl Tally {
    /// A frame will be shown at `display`, one `period` after the one before where none was missed.
    pub(crate) fn shown(&mut self, display: Timestamp, period: Span) {
        self.frames += 1;
        if let Some(gap) = self.last.and_then(|last| display.since(last)) {
            // A frame is missed where the gap is nearer to two periods than to one.
            let periods = gap.as_secs_f64() / period.as_secs_f64().max(1e-9);
            self.missed += (periods.round() as u64).saturating_sub(1);
        }
        self.first.get_or_insert(display);
        self.last = Some(display);
    }

    /// A pause that is nobody's fault: the headset was off, or the session lost.
    pub(crate) fn pause(&mut self) {
        self.before = self.elapsed();
        (self.first, self.last) = (None, None);
    }

    /// Session time so far.
    pub(crate) fn elapsed(&self) -> Span {
        let now = self.first.zip(self.last).and_then(|(first, last)| last.since(first)).unwrap_or(Span::ZERO);
        Span::from_nanos(self.before.as_nanos().saturating_add(now.as_nanos()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_nearest_ranks() {
        let mut series = Series::default();
        assert_eq!(series.percentiles(), Milliseconds::default());
        for ms in (1..=200).rev() {
            series.add(Span::from_millis(ms));
        }
        let Milliseconds { p50, p95, p99, max } = series.percentiles();
        assert_eq!((p50, p95, p99, max), (100.0, 190.0, 198.0, 200.0));
    }

    #[test]
    fn gaps_are_missed_frames_and_pauses_are_not() {
        let mut tally = Tally::default();
        let period = Span::from_millis(10);
        for ms in [10, 20, 30, 51, 60, 200] {
            if ms == 200 {
                tally.pause();
            }
            tally.shown(Timestamp::from_nanos(ms * 1_000_000), period);
        }
        assert_eq!((tally.frames, tally.missed), (6, 1));
        assert_eq!(tally.elapsed(), Span::from_millis(50));
    }
}
