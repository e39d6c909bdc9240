//! The BROAD score: how far an estimate is from the truth, total, about the vertical and of the vertical.

use nalgebra::UnitQuaternion;
use vergence_time::Timestamp;

/// Root mean square errors over the scored samples, radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Score {
    /// Of the whole rotation.
    pub total_rad: f64,
    /// About the vertical.
    pub heading_rad: f64,
    /// Of the vertical.
    pub inclination_rad: f64,
    /// About the vertical, after one turn that brings the first second of movement to zero: drift since recentring.
    pub start_heading_rad: f64,
    /// Of the whole rotation, after the same turn.
    pub start_total_rad: f64,
    /// Of the whole rotation, after the one turn that fits best: drift about the mean.
    pub mean_total_rad: f64,
    /// Samples that were scored.
    pub samples: usize,
}

/// An instant, the estimate for it and the truth.
pub type Pair = (Timestamp, UnitQuaternion<f64>, UnitQuaternion<f64>);

/// The first second of movement, over which the start is aligned, in nanoseconds.
const START_NS: i64 = 1_000_000_000;

/// Scores pairs of estimate and truth, in order of time; both take sensor-frame vectors to the same earth frame with z up.
/// `None` where there is no pair. Source of the formulas: Laidig, Caruso, Cereatti, Seel, BROAD, Data 6(7):72, 2021.
pub fn score(pairs: &[Pair]) -> Option<Score> {
    let first = pairs.first()?.0;
    let errors: Vec<UnitQuaternion<f64>> =
        pairs.iter().map(|(_, estimate, truth)| estimate * truth.inverse()).collect();
    let started = pairs
        .iter()
        .take_while(|(at, _, _)| at.as_nanos().saturating_sub(first.as_nanos()) < START_NS)
        .count();
    let circular_mean = |errors: &[UnitQuaternion<f64>]| {
        let (sine, cosine) = errors.iter().fold((0.0, 0.0), |(sine, cosine), e| {
            let angle = 2.0 * e.k.atan2(e.w);
            (sine + angle.sin(), cosine + angle.cos())
        });
        sine.atan2(cosine)
    };
    let total = |e: &UnitQuaternion<f64>| 2.0 * e.w.abs().min(1.0).acos();
    let heading = |e: &UnitQuaternion<f64>| 2.0 * e.k.abs().atan2(e.w.abs());
    let inclination = |e: &UnitQuaternion<f64>| 2.0 * e.w.hypot(e.k).min(1.0).acos();
    let rms = |turned_rad: f64, angle: &dyn Fn(&UnitQuaternion<f64>) -> f64| {
        let turn = UnitQuaternion::from_euler_angles(0.0, 0.0, -turned_rad);
        let sum: f64 = errors.iter().map(|e| angle(&(turn * e)).powi(2)).sum();
        (sum / errors.len() as f64).sqrt()
    };
    let (start, mean) = (circular_mean(&errors[..started]), circular_mean(&errors));
    Some(Score {
        total_rad: rms(0.0, &total),
        heading_rad: rms(0.0, &heading),
        inclination_rad: rms(0.0, &inclination),
        start_heading_rad: rms(start, &heading),
        start_total_rad: rms(start, &total),
        mean_total_rad: rms(mean, &total),
        samples: errors.len(),
    })
}
