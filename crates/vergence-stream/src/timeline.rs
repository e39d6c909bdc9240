//! Many sources, one order.

use std::iter::Peekable;

use vergence_sense::Sample;
use vergence_time::Timestamp;

/// Merges sources into the order of arrival. Each source keeps its own order, also where its times run backwards; at
/// the same instant the source that was named first comes first. Holds one sample per source.
pub struct Timeline<T, I: Iterator<Item = Sample<T>>> {
    sources: Vec<Peekable<I>>,
}

impl<T, I: Iterator<Item = Sample<T>>> Timeline<T, I> {
    /// Of these sources.
    pub fn new(sources: impl IntoIterator<Item = I>) -> Self {
        Self { sources: sources.into_iter().map(Iterator::peekable).collect() }
    }

    /// Drops everything that arrived before `instant`; the position of a replay that begins in the middle.
    pub fn skip_to(&mut self, instant: Timestamp) {
        for source in &mut self.sources {
            while source.next_if(|sample| sample.arrived < instant).is_some() {}
        }
    }
}

impl<T, I: Iterator<Item = Sample<T>>> Iterator for Timeline<T, I> {
    /// Which source, counted from 0, and its sample.
    type Item = (usize, Sample<T>);

    fn next(&mut self) -> Option<Self::Item> {
        let mut first: Option<(usize, Timestamp)> = None;
        for (index, source) in self.sources.iter_mut().enumerate() {
            if let Some(sample) = source.peek()
                && first.is_none_or(|(_, earliest)| sample.arrived < earliest)
            {
                first = Some((index, sample.arrived));
            }
        }
        let (index, _) = first?;
        Some((index, self.sources[index].next()?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(arrived: &[i64]) -> std::vec::IntoIter<Sample<usize>> {
        let sample = |(value, &nanos): (usize, &i64)| {
            let at = Timestamp::from_nanos(nanos);
            Sample { captured: at, arrived: at, value }
        };
        arrived.iter().enumerate().map(sample).collect::<Vec<_>>().into_iter()
    }

    #[test]
    fn arrival_decides_then_the_order_of_the_sources() {
        let order =
            |timeline: Timeline<_, _>| timeline.map(|(source, s)| (source, s.value)).collect::<Vec<_>>();
        let sources = || [samples(&[-3, 5, 5, 9]), samples(&[5, 6, 2]), samples(&[])];
        let wanted = [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (0, 3)];
        assert_eq!(order(Timeline::new(sources())), wanted);
        let mut late = Timeline::new(sources());
        late.skip_to(Timestamp::from_nanos(6));
        assert_eq!(order(late), [(1, 1), (1, 2), (0, 3)]);
    }
}
