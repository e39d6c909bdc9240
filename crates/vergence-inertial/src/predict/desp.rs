//! Double exponential smoothing of poses: J. LaViola, "Double Exponential Smoothing: An Alternative to Kalman
//! Filter-Based Predictive Tracking", IPT/EGVE 2003.

use nalgebra::{Quaternion, SVector, UnitQuaternion, Vector3, Vector4};
use vergence_time::Timestamp;

use super::{PredictPosition, PredictRotation, ahead_s, follows};

/// Share of the newest pose in the smoothed one.
pub(super) const SMOOTHING: f64 = 0.7;

/// `N` numbers smoothed once and twice.
#[derive(Clone, Debug)]
struct Twice<const N: usize> {
    share: f64,
    last: Option<Timestamp>,
    /// Mean time between the observations, s.
    period_s: f64,
    once: SVector<f64, N>,
    twice: SVector<f64, N>,
}

impl<const N: usize> Twice<N> {
    fn new(share: f64) -> Self {
        Self { share, last: None, period_s: 0.0, once: SVector::zeros(), twice: SVector::zeros() }
    }

    fn observe(&mut self, time: Timestamp, since: Option<f64>, value: &SVector<f64, N>) {
        self.last = Some(time);
        let Some(seconds) = since else {
            (self.once, self.twice, self.period_s) = (*value, *value, 0.0);
            return;
        };
        self.period_s =
            if self.period_s == 0.0 { seconds } else { self.period_s + 0.05 * (seconds - self.period_s) };
        self.once += (value - self.once) * self.share;
        self.twice += (self.once - self.twice) * self.share;
    }

    fn predict(&self, time: Timestamp) -> Option<SVector<f64, N>> {
        let periods = if self.period_s > 0.0 { ahead_s(self.last?, time) / self.period_s } else { 0.0 };
        self.last?;
        let ahead = self.share / (1.0 - self.share) * periods;
        Some(self.once * (2.0 + ahead) - self.twice * (1.0 + ahead))
    }
}

/// Orientations, as four numbers that are normalised again.
#[derive(Clone, Debug)]
pub struct DespRotation(Twice<4>);

impl DespRotation {
    /// `share`: of the newest pose in the smoothed one, above 0 and below 1.
    pub fn new(share: f64) -> Self {
        Self(Twice::new(share))
    }
}

impl PredictRotation for DespRotation {
    fn observe(&mut self, time: Timestamp, world_from_body: &UnitQuaternion<f64>, _: &Vector3<f64>) {
        let coords: Vector4<f64> = world_from_body.coords;
        let Some(since) = follows(self.0.last, time, coords.iter()) else { return };
        let near = if self.0.once.dot(&coords) < 0.0 { -coords } else { coords };
        self.0.observe(time, since, &near);
    }

    fn predict(&self, time: Timestamp) -> Option<UnitQuaternion<f64>> {
        let coords = self.0.predict(time)?;
        // Observations that cancel leave nothing to normalise.
        let found = UnitQuaternion::try_new(Quaternion::from_vector(coords), 1e-6);
        Some(found.unwrap_or_else(|| UnitQuaternion::new_normalize(Quaternion::from_vector(self.0.once))))
            .filter(|q| q.coords.iter().all(|x| x.is_finite()))
    }
}

/// Positions.
#[derive(Clone, Debug)]
pub struct DespPosition(Twice<3>);

impl DespPosition {
    /// `share`: of the newest position in the smoothed one, above 0 and below 1.
    pub fn new(share: f64) -> Self {
        Self(Twice::new(share))
    }
}

impl PredictPosition for DespPosition {
    fn observe(&mut self, time: Timestamp, position_m: &Vector3<f64>) {
        if let Some(since) = follows(self.0.last, time, position_m.iter()) {
            self.0.observe(time, since, position_m);
        }
    }

    fn predict(&self, time: Timestamp) -> Option<Vector3<f64>> {
        self.0.predict(time)
    }
}
