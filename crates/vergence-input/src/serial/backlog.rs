//! What a port held as it was opened: it arrived at one time, and was measured as far apart as the device's clock says.

use vergence_sense::{Reading, Sample, Sink, SourceStream};
use vergence_time::{Span, Timestamp};

use crate::connection::{CLOCK_RESIDUAL, EVENTS};

/// No port holds more; a longer step of the device's clock is one that was set.
const LONGEST_NS: i64 = 60_000_000_000;

/// A device's time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ticks {
    /// Microseconds that wrap.
    Micros32(u32),
    Nanos(u64),
}

impl Ticks {
    /// How much later it is than `before`; `None` where the clock was set meanwhile.
    fn since(self, before: Self) -> Option<i64> {
        let nanos = match (self, before) {
            (Self::Micros32(now), Self::Micros32(before)) => i64::from(now.wrapping_sub(before)) * 1000,
            (Self::Nanos(now), Self::Nanos(before)) => i64::try_from(now.checked_sub(before)?).ok()?,
            _ => return None,
        };
        (nanos <= LONGEST_NS).then_some(nanos)
    }
}

/// Holds samples back until all have come.
pub(super) struct Backlog<'a> {
    sink: &'a mut dyn Sink,
    held: Vec<(usize, Sample<Reading<'static>>)>,
}

impl<'a> Backlog<'a> {
    pub(super) fn new(sink: &'a mut dyn Sink) -> Self {
        Self { sink, held: Vec::new() }
    }

    /// Gives what was held, with times of capture as far apart as `ticks` are, which are those of the readings in their order. The
    /// one that came soonest after it was measured says how the clocks stand to each other. None is captured earlier than `not_before`.
    pub(super) fn finish(mut self, ticks: &[Option<Ticks>], not_before: Timestamp) {
        let is_reading = |place: usize| place != EVENTS && place != CLOCK_RESIDUAL;
        let mut readings: Vec<_> =
            self.held.iter_mut().filter(|(place, _)| is_reading(*place)).zip(ticks).collect();
        let mut from = 0;
        while from < readings.len() {
            // Up to where the clock is another.
            let (mut elapsed, mut to) = (vec![0i64], from + 1);
            while let (Some(before), Some(Some(now))) =
                (readings[to - 1].1, readings.get(to).map(|next| next.1))
                && let Some(step) = now.since(*before)
            {
                elapsed.push(elapsed[to - 1 - from].saturating_add(step));
                to += 1;
            }
            if readings[from].1.is_some() {
                let run = &mut readings[from..to];
                let offset = run
                    .iter()
                    .zip(&elapsed)
                    .map(|(((_, sample), _), at)| sample.captured.as_nanos().saturating_sub(*at));
                let offset = Timestamp::from_nanos(offset.min().unwrap_or(0));
                for (((_, sample), _), at) in run.iter_mut().zip(&elapsed) {
                    let captured = offset.saturating_add(Span::from_nanos(*at));
                    sample.captured = captured.max(not_before).min(sample.captured);
                }
            }
            from = to;
        }
        for (place, sample) in self.held {
            self.sink.take(place, sample);
        }
    }
}

impl Sink for Backlog<'_> {
    fn appears(&mut self, place: usize, stream: &SourceStream) {
        self.sink.appears(place, stream);
    }

    fn take(&mut self, place: usize, sample: Sample<Reading<'_>>) {
        self.held.take(place, sample);
    }
}

#[cfg(test)]
mod tests {
    use vergence_sense::{Event, Scalar};

    use super::*;

    #[test]
    fn readings_that_come_at_once_are_as_far_apart_as_the_device_says() {
        let at = Timestamp::from_nanos;
        let mut given: Vec<(usize, Sample<Reading<'static>>)> = Vec::new();
        let mut backlog = Backlog::new(&mut given);
        let mut ticks = Vec::new();
        let reading = || Reading::Scalar(Scalar(1.0));
        // Over the wrap; the last two come by themselves, the very last late. Then the device begins anew.
        for (index, arrived) in [900i64, 900, 900, 901, 907, 908, 908].into_iter().enumerate() {
            if index == 2 {
                let value = Reading::Event(Event::new("gap", ""));
                backlog.take(EVENTS, Sample { captured: at(arrived), arrived: at(arrived), value });
            }
            let arrived = at(arrived * 1_000_000);
            backlog.take(2, Sample { captured: arrived, arrived, value: reading() });
            let since = if index < 5 { u32::MAX - 1500 } else { 0 };
            ticks.push(Some(Ticks::Micros32(since.wrapping_add(if index < 5 {
                index as u32 * 1000
            } else {
                index as u32
            }))));
        }
        let arrived = at(909_000_000);
        backlog.take(2, Sample { captured: arrived, arrived, value: reading() });
        ticks.push(None);
        backlog.finish(&ticks, at(898_500_000));
        let captured: Vec<i64> = given
            .iter()
            .filter(|given| given.0 == 2)
            .map(|(_, sample)| sample.captured.as_nanos() / 1000)
            .collect();
        assert_eq!(given.len(), 9);
        assert_eq!(captured, [898_500, 899_000, 900_000, 901_000, 902_000, 907_999, 908_000, 909_000]);
        assert!(given.iter().all(|(_, sample)| sample.captured <= sample.arrived));
    }
}
