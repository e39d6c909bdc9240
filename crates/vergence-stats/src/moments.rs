/// Count, mean and sum of squared deviations in one pass (Welford 1962); mergeable (Chan, Golub and LeVeque 1979).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moments {
    n: u64,
    mean: f64,
    squares: f64,
}

impl Moments {
    /// Adds one value; none that is not finite may be added.
    pub fn push(&mut self, value: f64) {
        self.n += 1;
        let before = value - self.mean;
        self.mean += before / self.n as f64;
        self.squares += before * (value - self.mean);
    }

    /// As if the values of `other` had been added after ours.
    pub fn merge(&mut self, other: &Self) {
        if other.n == 0 {
            return;
        }
        let n = self.n + other.n;
        let apart = other.mean - self.mean;
        let share = other.n as f64 / n as f64;
        self.squares += other.squares + apart * apart * self.n as f64 * share;
        self.mean += apart * share;
        self.n = n;
    }

    /// How many values.
    pub fn n(&self) -> u64 {
        self.n
    }

    /// Their mean; none of none.
    pub fn mean(&self) -> Option<f64> {
        (self.n > 0).then_some(self.mean)
    }

    /// Their variance over n − 1; none of fewer than two.
    pub fn variance(&self) -> Option<f64> {
        (self.n > 1).then(|| self.squares / (self.n - 1) as f64)
    }

    /// Their standard deviation over n − 1; none of fewer than two.
    pub fn sd(&self) -> Option<f64> {
        self.variance().map(f64::sqrt)
    }
}

impl FromIterator<f64> for Moments {
    fn from_iter<I: IntoIterator<Item = f64>>(values: I) -> Self {
        let mut moments = Self::default();
        values.into_iter().for_each(|value| moments.push(value));
        moments
    }
}

/// How far points of up to three dimensions lie from their centroid: √(Σ|p − p̄|²/(n − 1)).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spread([Moments; 3]);

impl Spread {
    /// Adds one point, in any length unit.
    pub fn push(&mut self, point: [f64; 3]) {
        self.0.iter_mut().zip(point).for_each(|(moments, value)| moments.push(value));
    }

    /// As if the points of `other` had been added after ours.
    pub fn merge(&mut self, other: &Self) {
        self.0.iter_mut().zip(&other.0).for_each(|(own, other)| own.merge(other));
    }

    /// The first `dimensions` (1 to 3) taken together; none of fewer than two points.
    pub fn sd(&self, dimensions: usize) -> Option<f64> {
        let variances: Option<f64> = self.0[..dimensions.clamp(1, 3)].iter().map(Moments::variance).sum();
        variances.map(f64::sqrt)
    }

    /// One dimension, 0 to 2, alone.
    pub fn along(&self, dimension: usize) -> &Moments {
        &self.0[dimension.min(2)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn few_values() {
        let mut moments = Moments::default();
        assert_eq!((moments.mean(), moments.sd()), (None, None));
        moments.push(3.0);
        assert_eq!((moments.mean(), moments.sd()), (Some(3.0), None));
        moments.push(3.0);
        assert_eq!(moments.sd(), Some(0.0));
    }

    #[test]
    fn a_large_offset_cancels_nothing() {
        let moments: Moments = [4.0, 7.0, 13.0, 16.0].iter().map(|v| v + 1e9).collect();
        assert_eq!(moments.variance(), Some(30.0));
    }

    proptest! {
        #[test]
        fn merging_is_adding(values in prop::collection::vec(-1e3..1e3f64, 2..40), cut in 0usize..40) {
            let all: Moments = values.iter().copied().collect();
            let cut = cut.min(values.len());
            let mut first: Moments = values[..cut].iter().copied().collect();
            first.merge(&values[cut..].iter().copied().collect());
            prop_assert_eq!(first.n(), all.n());
            prop_assert!((first.mean().unwrap() - all.mean().unwrap()).abs() < 1e-9);
            prop_assert!((first.variance().unwrap() - all.variance().unwrap()).abs() < 1e-6);
        }

        #[test]
        fn spread_does_not_turn(points in prop::collection::vec((-9.0..9.0f64, -9.0..9.0f64), 2..20), angle in 0.0..6.3f64) {
            let (mut straight, mut turned) = (Spread::default(), Spread::default());
            for (x, y) in points {
                straight.push([x, y, 0.0]);
                turned.push([x * angle.cos() - y * angle.sin(), x * angle.sin() + y * angle.cos(), 0.0]);
            }
            prop_assert!((straight.sd(2).unwrap() - turned.sd(2).unwrap()).abs() < 1e-9);
        }
    }
}
