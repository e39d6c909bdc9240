//! Which trials are left out, and why.

use vergence_stats::{Moments, mad, median};

use crate::convention::{Conventions, Outliers};
use crate::measure::ends::End;
use crate::trial::Trial;

/// Whether each trial of one sequence is left out by the policy. Rules that compare a trial with its sequence answer
/// "no" where fewer than three trials are there to compare.
pub fn left_out(trials: &[(&Trial, Option<End>)], conventions: &Conventions) -> Vec<bool> {
    match conventions.outliers {
        Outliers::Keep => vec![false; trials.len()],
        Outliers::Misses => trials.iter().map(|(trial, _)| trial.error == Some(true)).collect(),
        Outliers::Spatial => trials.iter().map(|(trial, end)| is_spatial(trial, *end)).collect(),
        Outliers::Temporal => trials.iter().map(|(trial, _)| trial.temporal_outlier == Some(true)).collect(),
        Outliers::ThreeSd => {
            let times =
                beyond(&trials.iter().map(|(trial, _)| Some(trial.mt_s)).collect::<Vec<_>>(), three_sd);
            let ends =
                beyond(&trials.iter().map(|(_, end)| end.map(|end| end.dx)).collect::<Vec<_>>(), three_sd);
            times.into_iter().zip(ends).map(|(time, end)| time || end).collect()
        }
        Outliers::Mad => {
            beyond(&trials.iter().map(|(trial, _)| Some(trial.mt_s)).collect::<Vec<_>>(), three_mad)
        }
    }
}

/// A miss that ended before half the amplitude or more than twice the width from the target's centre; what the
/// recording tool said, where it did.
pub fn is_spatial(trial: &Trial, end: Option<End>) -> bool {
    if let Some(flag) = trial.spatial_outlier {
        return flag;
    }
    let (Some(end), Some(amplitude), Some(width)) = (end, trial.amplitude, trial.width) else { return false };
    let planar = end.offset[1] != 0.0 || end.offset[2] != 0.0;
    let distance = end.offset.iter().map(|value| value * value).sum::<f64>().sqrt();
    let (reach, away) = if planar { (end.ae_xy, distance) } else { (end.ae.map(f64::abs), end.dx.abs()) };
    trial.error == Some(true) && (reach.is_some_and(|reach| reach < 0.5 * amplitude) || away > 2.0 * width)
}

fn three_sd(values: &[f64]) -> Option<(f64, f64)> {
    let moments: Moments = values.iter().copied().collect();
    moments.mean().zip(moments.sd())
}

fn three_mad(values: &[f64]) -> Option<(f64, f64)> {
    median(values).zip(mad(values))
}

/// More than three `scale` from `centre`.
fn beyond(values: &[Option<f64>], rule: fn(&[f64]) -> Option<(f64, f64)>) -> Vec<bool> {
    let known: Vec<f64> = values.iter().flatten().copied().collect();
    match rule(&known).filter(|(_, scale)| known.len() > 2 && *scale > 0.0) {
        Some((centre, scale)) => {
            values.iter().map(|value| value.is_some_and(|v| (v - centre).abs() > 3.0 * scale)).collect()
        }
        None => vec![false; values.len()],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_rule_finds_its_own() {
        let mut trials: Vec<Trial> = (0..20)
            .map(|i| Trial {
                mt_s: 1.0 + 0.01 * f64::from(i % 5),
                amplitude: Some(10.0),
                width: Some(1.0),
                ..Trial::default()
            })
            .collect();
        trials[3].mt_s = 9.0;
        trials[7].error = Some(true);
        let end = End { dx: 0.0, ae: Some(10.0), ae_xy: Some(10.0), offset: [0.0; 3] };
        let far = End { dx: 2.5, ae: Some(12.5), ae_xy: Some(12.5), offset: [2.5, 0.0, 0.0] };
        let pairs: Vec<(&Trial, Option<End>)> = trials
            .iter()
            .enumerate()
            .map(|(i, trial)| (trial, Some(if i == 7 { far } else { end })))
            .collect();
        let found = |policy: Outliers| {
            let conventions = Conventions { outliers: policy, ..Conventions::default() };
            let left = left_out(&pairs, &conventions);
            (0..20).filter(|i| left[*i]).collect::<Vec<_>>()
        };
        assert_eq!(found(Outliers::Keep), Vec::<usize>::new());
        assert_eq!(found(Outliers::Misses), [7]);
        assert_eq!(found(Outliers::Spatial), [7]);
        assert_eq!(found(Outliers::ThreeSd), [3, 7]);
        assert_eq!(found(Outliers::Mad), [3]);
        assert_eq!(
            left_out(&pairs[..2], &Conventions { outliers: Outliers::ThreeSd, ..Conventions::default() }),
            [false; 2]
        );
    }
}
