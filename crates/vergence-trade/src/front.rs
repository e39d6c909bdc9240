use std::cmp::Ordering;

use crate::{Error, Measurement, Trade, Value};

/// What a choice must keep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Limit {
    /// At most this cost; the smallest error within it is chosen.
    Cost(f64),
    /// At most this error; the smallest cost within it is chosen.
    Error(f64),
    /// At most both; the smallest cost is chosen.
    Both {
        /// At most this cost.
        cost: f64,
        /// At most this error.
        error: f64,
    },
}

impl Limit {
    /// That of whoever may name a cost, an error, both or none.
    pub fn of(cost: Option<f64>, error: Option<f64>) -> Option<Self> {
        match (cost, error) {
            (Some(cost), Some(error)) => Some(Self::Both { cost, error }),
            (Some(cost), None) => Some(Self::Cost(cost)),
            (None, error) => error.map(Self::Error),
        }
    }
}

impl Trade {
    /// The measurements that no other one beats (`cost` and `error` are indices of scales): each has a smaller error
    /// than all cheaper ones, by more than the errors' noise ([`Self::with_error_noise`]). Indices into [`Self::measurements`], from the
    /// cheapest; of equal ones, the first that was recorded. O(n log n).
    ///
    /// # Panics
    /// Where an index is not below the number of scales.
    pub fn pareto(&self, cost: usize, error: usize) -> Vec<usize> {
        self.front(cost, error, self.error_noise)
    }

    fn front(&self, cost: usize, error: usize, noise: f64) -> Vec<usize> {
        let mut order: Vec<(usize, f64, f64)> = self.finite(cost, error).collect();
        order.sort_by(|a, b| ascending(a.1, b.1).then(ascending(a.2, b.2)).then(a.0.cmp(&b.0)));
        let mut least_error = f64::INFINITY;
        let mut front = Vec::new();
        for (index, _, error) in order {
            if error < least_error * (1.0 - noise) || least_error == f64::INFINITY {
                least_error = error;
                front.push(index);
            }
        }
        front
    }

    /// The setting to use: always on the front of the two scales; for a limit of the error on that without noise, as the limit is kept or not. Index
    /// into [`Self::measurements`].
    ///
    /// # Errors
    /// Where no measurement keeps the limit (NaN keeps none); it says which comes nearest.
    ///
    /// # Panics
    /// Where an index is not below the number of scales.
    pub fn choose(&self, cost: usize, error: usize, limit: Limit) -> Result<usize, Error> {
        let noise = if matches!(limit, Limit::Cost(_)) { self.error_noise } else { 0.0 };
        let front = self.front(cost, error, noise);
        let value = |index: &usize| &self.measurements[*index];
        // The front runs from cheap and wrong to dear and right.
        let (chosen, nearest, scale, most) = match limit {
            Limit::Cost(most) => (
                front.iter().rfind(|i| value(i).costs[cost] <= most),
                front.first().map(|i| (value(i).costs[cost], i)),
                &self.costs[cost],
                most,
            ),
            Limit::Error(most) => (
                front.iter().find(|i| value(i).errors[error] <= most),
                front.last().map(|i| (value(i).errors[error], i)),
                &self.errors[error],
                most,
            ),
            Limit::Both { cost: dearest, error: most } => {
                let cheapest = self.choose(cost, error, Limit::Error(most))?;
                let found = self.measurements[cheapest].costs[cost];
                // The cheapest that errs so little is the one that comes nearest.
                let nearest = front.iter().find(|i| **i == cheapest);
                (
                    nearest.filter(|_| found <= dearest),
                    nearest.map(|i| (found, i)),
                    &self.costs[cost],
                    dearest,
                )
            }
        };
        chosen.copied().ok_or_else(|| Error::NothingFits {
            scale: scale.title(),
            limit: most,
            nearest: nearest.map(|(found, i)| (found, value(i).setting.to_string())),
        })
    }

    /// Pairs of values of one knob that nothing tells apart: with all other knobs equal, all errors are equal to the
    /// last bit (a driver that takes a knob as on or off, a scene that does not use it). Index of the knob, then
    /// of its two values. O(n² · values).
    pub fn indistinct(&self) -> Vec<(usize, usize, usize)> {
        let mut pairs = Vec::new();
        for (k, knob) in self.knobs.iter().enumerate() {
            for b in 1..knob.values.len() {
                for a in 0..b {
                    if self.same_errors(k, &knob.values[a], &knob.values[b]) {
                        pairs.push((k, a, b));
                    }
                }
            }
        }
        pairs
    }

    /// Whether knob `k` at `a` and at `b` was measured at least once with all others equal, and never differed.
    fn same_errors(&self, k: usize, a: &Value, b: &Value) -> bool {
        let at = |value: &'_ Value| -> Vec<&Measurement> {
            self.measurements.iter().filter(|m| m.setting.0[k].1 == *value).collect()
        };
        let others = |m: &Measurement, n: &Measurement| {
            m.setting.0.iter().zip(&n.setting.0).enumerate().all(|(i, (x, y))| i == k || x == y)
        };
        let (at_a, at_b) = (at(a), at(b));
        let mut twins =
            at_a.iter().flat_map(|m| at_b.iter().filter(|n| others(m, n)).map(move |n| (m, n))).peekable();
        let bits = |m: &Measurement| m.errors.iter().map(|e| e.to_bits()).collect::<Vec<_>>();
        twins.peek().is_some() && twins.all(|(m, n)| bits(m) == bits(n))
    }

    fn finite(&self, cost: usize, error: usize) -> impl Iterator<Item = (usize, f64, f64)> + '_ {
        assert!(cost < self.costs.len() && error < self.errors.len(), "no such scale");
        let values = move |(index, m): (usize, &Measurement)| (index, m.costs[cost], m.errors[error]);
        self.measurements.iter().enumerate().map(values).filter(|(_, c, e)| c.is_finite() && e.is_finite())
    }
}

/// Of finite numbers; 0 and −0 are equal.
fn ascending(a: f64, b: f64) -> Ordering {
    a.partial_cmp(&b).unwrap_or(Ordering::Equal)
}
