//! The BROAD score: how far an estimate is from the truth, total, about the vertical and of the vertical.

use nalgebra::UnitQuaternion;
use vergence_geom::slerp;
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

/// Between estimates that are further apart nothing is interpolated, in nanoseconds.
const GAP_NS: i64 = 250_000_000;

/// Each instant of the truth with the estimate of that time, interpolated on the shortest way between the estimates before and after it where
/// they are at most a quarter of a second apart; and how many instants have no estimate. Both in order of time.
pub fn paired(
    estimate: &[(Timestamp, UnitQuaternion<f64>)],
    truth: impl Iterator<Item = (Timestamp, UnitQuaternion<f64>)>,
) -> (Vec<Pair>, usize) {
    let mut missing = 0;
    let at = |time: Timestamp| {
        let after = estimate.partition_point(|(at, _)| *at < time);
        let to = estimate.get(after)?;
        if to.0 == time {
            return Some(to.1);
        }
        let from = estimate.get(after.checked_sub(1)?)?;
        let (way, whole) = (time.since(from.0)?, to.0.since(from.0)?);
        let part = way.as_secs_f64() / whole.as_secs_f64();
        (whole.as_nanos() <= GAP_NS).then(|| slerp(&from.1, &to.1, part))
    };
    let pair = |(time, truth): (Timestamp, UnitQuaternion<f64>)| {
        let found = at(time);
        missing += usize::from(found.is_none());
        found.map(|estimate| (time, estimate, truth))
    };
    (truth.filter_map(pair).collect(), missing)
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn estimates_of_another_rate_are_interpolated_but_not_over_gaps() {
        let turned = |ms: i64| {
            (
                Timestamp::from_nanos(ms * 1_000_000),
                UnitQuaternion::from_euler_angles(0.0, 0.0, ms as f64 * 1e-3),
            )
        };
        let truth: Vec<_> = (0..200).map(|k| turned(5 * k)).collect();
        // Every third row, half a millisecond late; a hole of 0.3 s.
        let estimate: Vec<_> = (0..67)
            .map(|k| turned(15 * k))
            .filter(|(at, _)| !(300..=600).contains(&(at.as_nanos() / 1_000_000)))
            .collect();
        let (pairs, missing) = paired(&estimate, truth.iter().copied());
        assert!(pairs.iter().all(|(_, estimate, truth)| estimate.angle_to(truth) < 1e-7));
        // From 290 ms (the last estimate is at 285) to 610 ms; the last estimate is at 990 ms.
        assert_eq!((pairs.len(), missing), (200 - 65 - 1, 65 + 1));
        let (same, none) = paired(&truth, truth.iter().copied());
        assert!(none == 0 && same.iter().all(|(_, estimate, truth)| estimate == truth));
        assert_eq!(paired(&[], truth.iter().copied()), (Vec::new(), 200));
    }
}
