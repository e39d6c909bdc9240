use vergence_time::Timestamp;

/// One value over time: its keys, in rising order.
#[derive(Clone, Debug)]
pub(crate) struct Track<T>(Vec<(Timestamp, T)>);

impl<T> Default for Track<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<T> Track<T> {
    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// One more key, later than those before; nothing for `None`. Of keys that say the same the first and the last are
    /// kept: between them it is straight anyway.
    pub(crate) fn extend(&mut self, at: Timestamp, value: Option<T>)
    where
        T: PartialEq,
    {
        debug_assert!(self.0.last().is_none_or(|(last, _)| *last <= at));
        let Some(value) = value else { return };
        match &mut *self.0 {
            [.., (_, before), (last, same)] if *before == value && *same == value => *last = at,
            _ => self.0.push((at, value)),
        }
    }

    /// The last key at or before `at`, and the next one.
    fn around(&self, at: Timestamp) -> [Option<&(Timestamp, T)>; 2] {
        let after = self.0.partition_point(|(time, _)| *time <= at);
        [after.checked_sub(1).and_then(|before| self.0.get(before)), self.0.get(after)]
    }

    /// The value of the last key at or before `at`; `None` before the first one.
    pub(crate) fn held(&self, at: Timestamp) -> Option<&T> {
        self.around(at)[0].map(|(_, value)| value)
    }
}

impl<T: Clone> Track<T> {
    /// Straight from key to key by `mix(before, after, 0…1)`, exact at each; the first value before the first key. `None`
    /// where there is no key.
    pub(crate) fn between(&self, at: Timestamp, mix: impl Fn(&T, &T, f64) -> T) -> Option<T> {
        self.once_begun(at, mix).or_else(|| self.0.first().map(|(_, value)| value.clone()))
    }

    /// As [`Self::between`], but `None` before the first key.
    pub(crate) fn once_begun(&self, at: Timestamp, mix: impl Fn(&T, &T, f64) -> T) -> Option<T> {
        let [before, next] = self.around(at);
        let (time, value) = before?;
        let Some((next_time, next_value)) = next.filter(|_| *time < at) else { return Some(value.clone()) };
        let span = |to: Timestamp| to.since(*time).map_or(f64::INFINITY, |span| span.as_nanos() as f64);
        Some(mix(value, next_value, span(at) / span(*next_time)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_exact_and_between_them_it_is_straight() {
        let mut track = Track::default();
        for (nanos, value) in [(10, 1.0), (20, 3.0), (40, 0.0)] {
            track.extend(Timestamp::from_nanos(nanos), Some(value));
        }
        track.extend(Timestamp::from_nanos(50), None);
        let mix = |a: &f64, b: &f64, t: f64| a + (b - a) * t;
        let at = |nanos| track.between(Timestamp::from_nanos(nanos), mix).unwrap();
        assert_eq!([0, 10, 15, 20, 30, 40, 99].map(at), [1.0, 1.0, 2.0, 3.0, 1.5, 0.0, 0.0]);
        assert_eq!(track.once_begun(Timestamp::from_nanos(9), mix), None);
        assert_eq!(track.held(Timestamp::from_nanos(19)), Some(&1.0));
        let keys = track.0.len();
        for (nanos, value) in [(60, 7.0), (70, 7.0), (80, 7.0), (90, 7.0), (100, 8.0)] {
            track.extend(Timestamp::from_nanos(nanos), Some(value));
        }
        assert_eq!(track.0.len() - keys, 3, "what stays the same takes no memory");
        let at = |nanos| track.between(Timestamp::from_nanos(nanos), mix).unwrap();
        assert_eq!([60, 75, 90, 95, 100].map(at), [7.0, 7.0, 7.0, 7.5, 8.0]);
        assert_eq!(track.held(Timestamp::from_nanos(99)), Some(&7.0));
        assert_eq!(Track::<f64>::default().between(Timestamp::from_nanos(1), mix), None);
    }
}
