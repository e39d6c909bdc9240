//! Errors of the gyroscope, learned from what they tilt.

use nalgebra::{Matrix3, SVector, Vector2, Vector3};

use super::params::{VergenceCoefficients, VergenceParams};
use super::rest::Stillness;
use crate::filter::kalman::Estimate;
use crate::filter::low_pass::LowPass;
use crate::filter::saved::saved;

/// Bias (3), then scale and cross-axis factors (9, row by row): the true rate is `(1 − M)(w − b)`, so that a bias more changes
/// nothing else.
const N: usize = 12;

/// Largest scale or cross-axis factor: worse gyroscopes are broken.
const FACTOR_LIMIT: f64 = 0.05;

/// The rate below which a sample says nothing about factors, radians per second: larger than any bias.
const LEAST_TURN: f64 = 3.0 * std::f64::consts::PI / 180.0;

/// A rest that says a bias smaller than what is known by more than this says that it is another one, radians per second: what was
/// learned before was an even turn.
const OTHER_REST: f64 = 0.3 * std::f64::consts::PI / 180.0;

/// How long motion must contradict a bias beyond the usual limit until that is given up, seconds.
const DOUBTED_S: f64 = 5.0;

/// How much the factors wander, per second (variance): 0.1 % in half an hour.
const FACTOR_WANDER: f64 = 1e-6 / 1800.0;

/// Bias and factors, how well they are known, and the regressors in the low-pass that the accelerometer goes through.
#[derive(Clone, Debug, PartialEq)]
pub struct Rates {
    pub(super) estimate: Estimate<N>,
    /// The bias lies within the limit about this; zero, or what a first rest far from it said.
    centre: Vector3<f64>,
    /// The identity minus `M`, as it is applied.
    correction: Matrix3<f64>,
    /// The share of the factors that is applied: the part of what was learned that is not its own deviation. A good gyroscope has
    /// none, and what is learned of one is chance.
    share: f64,
    rows: LowPass<24>,
    seen: LowPass<2>,
    /// Seconds for which motion has contradicted a centre that is not zero.
    doubted_s: f64,
}

saved!(Rates { estimate, centre, correction, share, rows, seen, doubted_s });

/// What one window of samples says.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TiltWindow {
    /// Sum over samples of the level frame's first two rows, 3 each.
    level: SVector<f64, 6>,
    /// Sum of the same times each component of the rate without its bias: x row (9), y row (9).
    turned: SVector<f64, 18>,
    /// Sum of the corrections of the tilt, radians.
    correction: Vector2<f64>,
    /// Sum of the squared horizontal acceleration.
    acc_squared: f64,
}

saved!(TiltWindow { level, turned, correction, acc_squared });

impl TiltWindow {
    #[inline]
    pub(super) fn add(
        &mut self,
        r: &Matrix3<f64>,
        unbiased: &Vector3<f64>,
        up: &Vector3<f64>,
        acc_level: &Vector3<f64>,
    ) {
        // A rate that may be nothing but bias says nothing about factors.
        let turns = unbiased.norm_squared() > LEAST_TURN * LEAST_TURN;
        for i in 0..2 {
            for j in 0..3 {
                let a = r[(i, j)];
                self.level[3 * i + j] += a;
                if turns {
                    for k in 0..3 {
                        self.turned[9 * i + 3 * j + k] += a * unbiased[k];
                    }
                }
            }
        }
        self.correction.x -= up.y;
        self.correction.y += up.x;
        self.acc_squared += acc_level.x * acc_level.x + acc_level.y * acc_level.y;
    }

    /// The two regressors: what each unknown turns about x and y of the level frame, mean over the window.
    fn rows(&self, samples: f64) -> SVector<f64, 24> {
        let scale = 1.0 / samples;
        SVector::from_fn(|i, _| {
            let (axis, i) = (i / N, i % N);
            scale * if i < 3 { self.level[3 * axis + i] } else { self.turned[9 * axis + i - 3] }
        })
    }
}

impl Rates {
    pub(super) fn new(params: &VergenceParams, c: &VergenceCoefficients) -> Self {
        let mut p = SVector::<f64, N>::zeros();
        for i in 0..3 {
            p[i] = c.bias_p;
        }
        for i in 0..9 {
            p[3 + i] = params.factor_sigma.powi(2);
        }
        Self {
            estimate: Estimate { x: SVector::zeros(), p: nalgebra::SMatrix::from_diagonal(&p) },
            centre: Vector3::zeros(),
            correction: Matrix3::identity(),
            share: 0.0,
            rows: LowPass::default(),
            seen: LowPass::default(),
            doubted_s: 0.0,
        }
    }

    /// The bias, radians per second.
    pub(super) fn bias(&self) -> Vector3<f64> {
        self.estimate.x.fixed_rows::<3>(0).into_owned()
    }

    /// The rate without its bias.
    #[inline]
    pub(super) fn unbiased(&self, gyr: &Vector3<f64>) -> Vector3<f64> {
        gyr - self.bias()
    }

    /// The rate without its bias, without its other known errors.
    #[inline]
    pub(super) fn corrected(&self, unbiased: &Vector3<f64>) -> Vector3<f64> {
        self.correction * unbiased
    }

    /// About what the limits of the bias lie.
    pub(super) fn centre(&self) -> &Vector3<f64> {
        &self.centre
    }

    /// The bias is near `rate`, whatever was thought before.
    pub(super) fn centre_on(&mut self, rate: Vector3<f64>, c: &VergenceCoefficients) {
        self.centre = rate;
        self.doubted_s = 0.0;
        for i in 0..3 {
            self.estimate.forget(i, c.bias_p);
            self.estimate.x[i] = rate[i];
        }
    }

    /// How well each component of the bias is known, (rad/s)².
    pub(super) fn bias_p(&self) -> Vector3<f64> {
        Vector3::from_fn(|i, _| self.estimate.p[(i, i)])
    }

    /// Takes the bias as the start has it.
    pub(super) fn set_bias(&mut self, bias: &Vector3<f64>) {
        self.estimate.x.fixed_rows_mut::<3>(0).copy_from(bias);
    }

    /// Goes on from what the start has found: bias and covariance.
    pub(super) fn begin(&mut self, bias: &Vector3<f64>, p: &Matrix3<f64>, c: &VergenceCoefficients) {
        self.set_bias(bias);
        for i in 0..3 {
            self.estimate.forget(i, 0.0);
        }
        self.estimate.p.fixed_view_mut::<3, 3>(0, 0).copy_from(p);
        if (bias - self.centre).amax() > c.bias_limit {
            self.centre = *bias;
        }
    }

    /// Learns from one window.
    pub(super) fn learn(
        &mut self,
        window: &TiltWindow,
        stillness: Stillness,
        rested_before: bool,
        params: &VergenceParams,
        c: &VergenceCoefficients,
    ) {
        let rows = window.rows(c.window);
        let e = &mut self.estimate;
        let mut applied = e.x;
        applied.fixed_rows_mut::<9>(3).scale_mut(self.share);
        let expected = |axis: usize| rows.fixed_rows::<N>(N * axis).dot(&applied);
        let seen = self.seen.step(&Vector2::new(expected(0), expected(1)), &c.windows);
        let rows = self.rows.step(&rows, &c.windows);
        for i in 0..3 {
            e.widen(i, c.bias_wander, c.bias_p);
        }
        for i in 3..N {
            if e.p[(i, i)] > 0.0 {
                e.p[(i, i)] += FACTOR_WANDER * c.window_s;
            }
        }
        if let Stillness::Rests { rate } = stillness {
            let Some((rate, variance)) = rate else { return };
            let bias = e.x.fixed_rows::<3>(0).into_owned();
            if rate.norm_squared() < bias.norm_squared() && (rate - bias).norm() > OTHER_REST {
                for i in 0..3 {
                    e.forget(i, c.bias_p);
                }
            }
            for i in 0..3 {
                let mut row = SVector::<f64, N>::zeros();
                row[i] = 1.0;
                e.observe(&row, rate[i], variance);
            }
        } else {
            let noise = if rested_before { c.tilt_r } else { c.tilt_r_before_rest };
            let r = noise * (1.0 + params.tilt_noise_per_acc * window.acc_squared / c.window);
            let rows = [0, 1].map(|i| rows.fixed_rows::<N>(N * i).into_owned());
            let predicted = Vector2::new(rows[0].dot(&e.x), rows[1].dot(&e.x));
            // What was taken out already, plus what is left: the rate of the tilt's correction.
            let deviation = seen + window.correction / c.window_s - predicted;
            // Cut as a vector: the heading of the level frame, which is any, must not matter.
            let observed = predicted + deviation * (c.tilt_most / deviation.norm().max(c.tilt_most));
            for (row, y) in rows.iter().zip(observed.iter()) {
                e.observe(row, *y, r);
            }
            let contradicted = deviation.norm() > c.tilt_most;
            self.doubted_s = (self.doubted_s + if contradicted { c.window_s } else { -c.window_s }).max(0.0);
            if self.doubted_s > DOUBTED_S && self.centre != Vector3::zeros() {
                self.centre_on(Vector3::zeros(), c);
            }
        }
        let e = &mut self.estimate;
        for i in 0..N {
            let (centre, limit) = if i < 3 { (self.centre[i], c.bias_limit) } else { (0.0, FACTOR_LIMIT) };
            e.x[i] = e.x[i].clamp(centre - limit, centre + limit);
        }
        let factors = Matrix3::from_row_slice(e.x.fixed_rows::<9>(3).as_slice());
        let size = factors.norm_squared();
        let variance: f64 = (3..N).map(|i| e.p[(i, i)]).sum();
        // The sums of all nine: the frame of the sensor must not matter.
        self.share = if size > 0.0 { size / (size + params.factor_doubt * variance) } else { 0.0 };
        self.correction = Matrix3::identity() - factors * self.share;
    }

    /// Starts the low-passes anew and lets the bias have wandered for `gap_s`.
    pub(super) fn lost(&mut self, gap_s: f64, c: &VergenceCoefficients) {
        self.rows = LowPass::default();
        self.seen = LowPass::default();
        for i in 0..3 {
            self.estimate.widen(i, c.bias_wander * gap_s / c.window_s, c.bias_p);
        }
    }

    /// For time running backwards: rates, and so the bias, change their sign; the factors do not.
    pub(crate) fn reversed(&self, c: &VergenceCoefficients) -> Self {
        let mut estimate = self.estimate;
        for i in 0..3 {
            estimate.x[i] = -estimate.x[i];
            for j in 3..N {
                estimate.p[(i, j)] = -estimate.p[(i, j)];
                estimate.p[(j, i)] = -estimate.p[(j, i)];
            }
        }
        let mut reversed = Self { estimate, centre: -self.centre, ..self.clone() };
        reversed.lost(0.0, c);
        reversed
    }
}
