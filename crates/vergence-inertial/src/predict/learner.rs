//! The mean rate of the next moments as a weighted sum of the last ones, with weights learnt while it runs.
//!
//! For each of a few horizons, recursive least squares with forgetting: what turned out to be the mean rate over the
//! horizon, against the rates that were known at its beginning. Three axes share one set of weights, so that turning the
//! sensor changes nothing. The prior is the constant rate, held as strongly as readings with the floor of noise are;
//! noise in the readings lowers the weights of the far past, as it does in every regression. Where the learnt weights
//! have lately been no better than the constant rate, they give way to it; and they never lead further from it than twice
//! what it usually errs by.

use nalgebra::{SMatrix, SVector, Vector3};
use vergence_time::Timestamp;

/// Rates that are weighted.
const LAGS: usize = 8;
/// How long before the newest one, s; at least one observation apart.
const LAGS_S: [f64; LAGS] = [0.0, 0.0035, 0.007, 0.0105, 0.0175, 0.028, 0.0455, 0.07];
/// Horizons whose weights are learnt.
const NODES: usize = 6;
/// s; between them, and down to zero, the mean rate is linear in the horizon, as it is at constant acceleration.
const NODES_S: [f64; NODES] = [0.010, 0.020, 0.031, 0.045, 0.065, 0.100];
/// Observations that are remembered: those of the farthest horizon with its farthest rate, at the least spacing.
const MOST: usize = 128;
/// Observations nearer to each other than this are taken together, s.
const LEAST_SPACING_S: f64 = 0.0018;
/// The weights of one horizon are solved for once in this many observations, by turns.
const TURN: usize = 12;

/// How many root mean square errors of the constant rate the learnt weights may lead away from it. Over eight recordings of hands, 21 ms
/// ahead, mean of the means and worst of all: without a bound 0.176° and 17°; 4: 0.177° and 7.4°; 2.5: 0.180° and 6.6°; 2: 0.186° and
/// 6.4°; 1.5: 0.199° and 6.2° (the constant rate: 0.561° and 8.0°).
const MOST_ERRORS: f64 = 2.0;

type Weights = SVector<f64, LAGS>;

/// Knobs of the learner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LearnerParams {
    /// How long a motion is remembered, s of motion; 2. Short follows a change of motion soon and is less exact.
    pub memory_s: f64,
    /// Noise that every rate is thought to have at least, rad/s or m/s. Large stays with the constant rate for longer.
    pub floor: f64,
    /// Slower than this is rest, in which nothing is forgotten, rad/s or m/s.
    pub moving: f64,
}

impl LearnerParams {
    /// For gyroscopes.
    pub const ROTATION: Self = Self { memory_s: 2.0, floor: 0.003, moving: 0.2 };
    /// For positions in metres.
    pub const POSITION: Self = Self { memory_s: 2.0, floor: 0.003, moving: 0.05 };
}

/// Something that moves on: the integral of a rate.
pub(super) trait Path: Copy {
    /// The constant rate that leads to `later` in `seconds`.
    fn mean_rate_to(&self, later: &Self, seconds: f64) -> Vector3<f64>;
}

#[derive(Clone, Copy, Debug)]
struct Entry<P> {
    time: Timestamp,
    at: P,
    rates: [Vector3<f64>; LAGS],
    /// Mean rates that were foretold with the weights of then.
    foretold: [Vector3<f64>; NODES],
}

/// One horizon.
#[derive(Clone, Debug)]
struct Node {
    products: SMatrix<f64, LAGS, LAGS>,
    targets: Weights,
    weights: Weights,
    /// Running squared errors of what was foretold and of the constant rate.
    erred: f64,
    constant_erred: f64,
    /// What these are sums of, in observations.
    remembered: f64,
}

/// Learns one signal of three axes.
#[derive(Clone, Debug)]
pub(super) struct Learner<P> {
    params: LearnerParams,
    ring: Vec<Entry<P>>,
    newest: usize,
    observed: usize,
    /// Mean spacing of the observations, s.
    spacing_s: f64,
    nodes: [Node; NODES],
}

fn constant() -> Weights {
    let mut weights = Weights::zeros();
    weights[0] = 1.0;
    weights
}

impl<P: Path> Learner<P> {
    pub(super) fn new(params: LearnerParams) -> Self {
        let node = || Node {
            products: SMatrix::zeros(),
            targets: Weights::zeros(),
            weights: constant(),
            erred: 0.0,
            constant_erred: 0.0,
            remembered: 0.0,
        };
        Self {
            params,
            ring: Vec::with_capacity(MOST),
            newest: 0,
            observed: 0,
            spacing_s: 0.0,
            nodes: std::array::from_fn(|_| node()),
        }
    }

    /// Forgets the last observations, not what was learnt from them.
    pub(super) fn interrupt(&mut self) {
        self.ring.clear();
        self.newest = 0;
    }

    /// Whether an observation at `time` is far enough from the last one to be taken by itself.
    pub(super) fn wants(&self, time: Timestamp) -> bool {
        let since = self.ring.get(self.newest).and_then(|entry| time.since(entry.time));
        since.is_none_or(|since| since.as_secs_f64() >= LEAST_SPACING_S)
    }

    /// The entry `back` observations before the newest one.
    fn entry(&self, back: usize) -> Option<&Entry<P>> {
        (back < self.ring.len()).then(|| &self.ring[(self.newest + self.ring.len() - back) % self.ring.len()])
    }

    pub(super) fn observe(&mut self, time: Timestamp, at: P, rate: Vector3<f64>) {
        if let Some(since) = self.entry(0).and_then(|last| time.since(last.time)) {
            let seconds = since.as_secs_f64();
            self.spacing_s = if self.spacing_s == 0.0 {
                seconds
            } else {
                self.spacing_s + 0.02 * (seconds - self.spacing_s)
            };
        }
        let spacing = self.spacing_s;
        // Of the entries before this one, the newest is one observation back.
        let rates = std::array::from_fn(|lag| {
            let back = if spacing > 0.0 { ((LAGS_S[lag] / spacing).round() as usize).max(lag) } else { lag };
            match back {
                0 => rate,
                _ => {
                    self.entry((back - 1).min(self.ring.len().saturating_sub(1))).map_or(rate, |e| e.rates[0])
                }
            }
        });
        let foretold = std::array::from_fn(|node| self.foretell(node, &rates));
        let entry = Entry { time, at, rates, foretold };
        if self.ring.len() < MOST {
            self.ring.push(entry);
            self.newest = self.ring.len() - 1;
        } else {
            self.newest = (self.newest + 1) % MOST;
            self.ring[self.newest] = entry;
        }
        self.observed = self.observed.wrapping_add(1);
        if spacing > 0.0 {
            let motion = (rate.norm() / self.params.moving).min(1.0);
            let kept = (1.0 - motion * spacing / self.params.memory_s).max(0.0);
            (0..NODES).for_each(|node| self.learn(node, kept));
            if self.observed.is_multiple_of(TURN / NODES) {
                self.solve(self.observed / (TURN / NODES) % NODES);
            }
        }
    }

    /// What came true of the horizon `node` at the newest observation.
    fn learn(&mut self, node: usize, kept: f64) {
        let back = (NODES_S[node] / self.spacing_s).round().clamp(1.0, (MOST - 1) as f64) as usize;
        let (Some(now), Some(then)) = (self.entry(0), self.entry(back)) else { return };
        let Some(seconds) = now.time.since(then.time).map(|span| span.as_secs_f64()) else { return };
        // After an irregularity the observations are not where they are thought to be.
        if (seconds - back as f64 * self.spacing_s).abs() > 0.25 * seconds {
            return;
        }
        let came_true = then.at.mean_rate_to(&now.at, seconds);
        let (rates, foretold) = (then.rates, then.foretold[node]);
        // A jump of the pose (recentring, a wrong reading) is no motion; 10 000 °/s, or 170 m/s.
        if !rates.iter().chain([&came_true]).all(|rate| rate.norm() < 175.0) {
            return;
        }
        let node = &mut self.nodes[node];
        // Only the lower half, which is all that the solver reads.
        for column in 0..LAGS {
            for row in column..LAGS {
                let product = rates[row].dot(&rates[column]);
                node.products[(row, column)] = node.products[(row, column)] * kept + product;
            }
            node.targets[column] = node.targets[column] * kept + rates[column].dot(&came_true);
        }
        node.erred = node.erred * kept + (came_true - foretold).norm_squared();
        node.constant_erred = node.constant_erred * kept + (came_true - rates[0]).norm_squared();
        node.remembered = node.remembered * kept + 1.0;
    }

    fn solve(&mut self, node: usize) {
        // As strong as the memory is long: at the floor of noise, half.
        let prior = self.params.floor * self.params.floor * self.params.memory_s / self.spacing_s;
        let node = &mut self.nodes[node];
        let mut products = node.products;
        (0..LAGS).for_each(|i| products[(i, i)] += prior);
        let solved = products.cholesky().map(|roots| roots.solve(&(node.targets + constant() * prior)));
        node.weights = solved.filter(|w| w.iter().all(|x| x.is_finite())).unwrap_or_else(constant);
    }

    fn foretell(&self, node: usize, rates: &[Vector3<f64>; LAGS]) -> Vector3<f64> {
        rates.iter().zip(&self.nodes[node].weights).map(|(rate, weight)| rate * *weight).sum()
    }

    /// How far the learnt weights are trusted, 0..=1: all the way where they err by a tenth less than the constant rate.
    fn trust(&self, node: usize) -> f64 {
        const LESS: f64 = 0.1;
        let node = &self.nodes[node];
        if node.constant_erred > 0.0 {
            ((1.0 - node.erred / node.constant_erred) / LESS).clamp(0.0, 1.0)
        } else {
            0.0
        }
    }

    /// How far from the constant rate the learnt weights may lead: [`MOST_ERRORS`] times what it has lately erred by. So a motion of
    /// another kind than what they were learnt from (a blow, the end of a rest) costs little more than the constant rate.
    fn most(&self, node: usize) -> f64 {
        let node = &self.nodes[node];
        MOST_ERRORS * (node.constant_erred / node.remembered.max(1.0)).sqrt()
    }

    /// When and where the newest observation was.
    pub(super) fn last(&self) -> Option<(Timestamp, P)> {
        self.entry(0).map(|entry| (entry.time, entry.at))
    }

    /// The mean rate of the `ahead_s` seconds that follow the newest observation.
    pub(super) fn mean_rate(&self, ahead_s: f64) -> Vector3<f64> {
        let Some(last) = self.entry(0) else { return Vector3::zeros() };
        let rate = last.rates[0];
        let at_node = |node: usize| {
            let way = (self.foretell(node, &last.rates) - rate) * self.trust(node);
            let most = self.most(node);
            rate + way * (most / way.norm().max(most).max(f64::MIN_POSITIVE))
        };
        match NODES_S.iter().position(|node_s| ahead_s <= *node_s) {
            None => at_node(NODES - 1),
            Some(0) => rate.lerp(&at_node(0), ahead_s / NODES_S[0]),
            Some(next) => {
                let (from, to) = (NODES_S[next - 1], NODES_S[next]);
                at_node(next - 1).lerp(&at_node(next), (ahead_s - from) / (to - from))
            }
        }
    }
}
