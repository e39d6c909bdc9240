//! What a filter does to recorded motion: how much jitter it leaves, how far it lags, how far it is off.

use vergence_time::{Span, Timestamp};

use super::{KnobError, Smoothing};

/// A stretch of recorded motion without a gap.
#[derive(Clone, Debug, Default)]
pub struct Stretch {
    /// When, ascending, and where in truth, metres.
    pub truth: Vec<(Timestamp, [f64; 3])>,
    /// What is added to each place by the device, metres; as long.
    pub noise: Vec<[f64; 3]>,
}

/// The judgement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Judged {
    /// **Jitter left**: root of the mean square of what the filter makes of the noise alone (a body at rest, sampled when the motion
    /// was), over that of the noise. 1: nothing is gained.
    pub jitter_left: f64,
    /// **Lag**: the delay of the truth, in steps of 0.1 ms up to [`LONGEST_LAG_S`], to which the filtered motion is nearest in the mean
    /// square.
    pub lag_s: f64,
    /// **Error**: root of the mean square of the distance between the filtered motion and the truth at the same time, metres.
    pub error_m: f64,
}

/// Lag is looked for up to here, seconds.
pub const LONGEST_LAG_S: f64 = 1.0;

/// The first second of each stretch is not judged: filters have just begun.
const SETTLES: Span = Span::from_millis(1000);

/// The mean square distance between filtered samples and the truth so much earlier.
fn mean_square(stretches: &[(&Stretch, Vec<[f64; 3]>)], lag_s: f64, stride: usize) -> f64 {
    let Some(lag) = Span::from_secs_f64(lag_s) else { return f64::NAN };
    let (mut sum, mut count) = (0.0, 0u64);
    for (stretch, filtered) in stretches {
        let Some((first, _)) = stretch.truth.first() else { continue };
        let from = first.saturating_add(SETTLES);
        let mut after = 0;
        for ((at, _), place) in stretch.truth.iter().zip(filtered).step_by(stride) {
            // The truth is not known before its beginning; by then the longest lag has settled too.
            if *at < from {
                continue;
            }
            let then = Timestamp::from_nanos(at.as_nanos().saturating_sub(lag.as_nanos()));
            while after < stretch.truth.len() && stretch.truth[after].0 < then {
                after += 1;
            }
            let Some((high, to)) = stretch.truth.get(after) else { break };
            let (low, from) = stretch.truth[after.saturating_sub(1)];
            let whole = high.since(low).map_or(0.0, Span::as_secs_f64);
            let part = then.since(low).map_or(0.0, Span::as_secs_f64);
            let t = if whole > 0.0 { (part / whole).clamp(0.0, 1.0) } else { 1.0 };
            sum += (0..3).map(|i| (place[i] - (from[i] + (to[i] - from[i]) * t)).powi(2)).sum::<f64>();
            count += 1;
        }
    }
    sum / count as f64
}

/// Judges a filter on recorded motion, sampled as it was recorded. `None` where nothing lasts longer than a second.
///
/// # Errors
/// Where a knob is out of its range.
pub fn judge(smoothing: &Smoothing, stretches: &[Stretch]) -> Result<Option<Judged>, KnobError> {
    let mut rest = (0.0, 0.0);
    let mut moved = Vec::with_capacity(stretches.len());
    for stretch in stretches {
        let (mut resting, mut moving) = (smoothing.smoother::<3>()?, smoothing.smoother::<3>()?);
        let Some((first, _)) = stretch.truth.first() else { continue };
        let from = first.saturating_add(SETTLES);
        let mut filtered = Vec::with_capacity(stretch.truth.len());
        for ((at, place), noise) in stretch.truth.iter().zip(&stretch.noise) {
            let left = resting.update(*at, *noise);
            if *at >= from {
                rest.0 += left.iter().map(|x| x * x).sum::<f64>();
                rest.1 += noise.iter().map(|x| x * x).sum::<f64>();
            }
            filtered.push(moving.update(*at, std::array::from_fn(|i| place[i] + noise[i])));
        }
        moved.push((stretch, filtered));
    }
    let error_m = mean_square(&moved, 0.0, 1).sqrt();
    if error_m.is_nan() {
        return Ok(None);
    }
    // The distance grows on both sides of the lag: coarse steps over all, then finer ones around the best.
    let stride = (moved.iter().map(|(stretch, _)| stretch.truth.len()).sum::<usize>() / 4000).max(1);
    let (mut low_s, mut high_s, mut step_s, mut lag_s) = (0.0, LONGEST_LAG_S, 0.02, 0.0);
    while step_s > 0.5e-4 {
        let mut best = f64::INFINITY;
        let steps = ((high_s - low_s) / step_s).round() as usize;
        for k in 0..=steps {
            let candidate_s = low_s + step_s * k as f64;
            let found = mean_square(&moved, candidate_s, stride);
            if found < best {
                (best, lag_s) = (found, candidate_s);
            }
        }
        (low_s, high_s) = ((lag_s - step_s).max(0.0), (lag_s + step_s).min(LONGEST_LAG_S));
        step_s = if step_s > 0.01 {
            0.002
        } else if step_s > 0.001 {
            1e-4
        } else {
            0.0
        };
    }
    // A noise of zero leaves zero.
    let jitter_left = if rest.1 > 0.0 { (rest.0 / rest.1).sqrt() } else { 0.0 };
    Ok(Some(Judged { jitter_left, lag_s, error_m }))
}

#[cfg(test)]
mod tests {
    use super::super::{DoubleExponentialParams, LowPassParams};
    use super::*;

    /// Even motion of 1 m/s with corners every two seconds, without noise.
    fn zigzag(noise_m: f64) -> Stretch {
        let truth: Vec<(Timestamp, [f64; 3])> = (0..6000)
            .map(|k| {
                let t = 0.005 * f64::from(k);
                (Timestamp::from_nanos(i64::from(k) * 5_000_000), [(t % 4.0 - 2.0).abs(), 0.0, 0.0])
            })
            .collect();
        let noise = (0..6000).map(|k| [if k % 2 == 0 { noise_m } else { -noise_m }, 0.0, 0.0]).collect();
        Stretch { truth, noise }
    }

    #[test]
    fn the_lag_of_a_low_pass_is_its_time_constant() {
        let none = judge(&Smoothing::None, &[zigzag(1e-3)]).unwrap().unwrap();
        assert!(
            (none.jitter_left - 1.0).abs() < 1e-9 && none.lag_s == 0.0 && (none.error_m - 1e-3).abs() < 1e-9
        );
        let low_pass = Smoothing::LowPass(LowPassParams { cutoff_hz: 3.0 });
        let judged = judge(&low_pass, &[zigzag(0.0)]).unwrap().unwrap();
        let lag_s = 1.0 / (std::f64::consts::TAU * 3.0);
        // 1 m/s: as many metres as seconds.
        assert!((judged.lag_s - lag_s).abs() < 2e-3 && (judged.error_m - lag_s).abs() < 4e-3, "{judged:?}");
        let double = Smoothing::DoubleExponential(DoubleExponentialParams { time_s: 0.05, ahead_s: 0.0 });
        assert!(judge(&double, &[zigzag(0.0)]).unwrap().unwrap().lag_s < 0.005);
        assert_eq!(judge(&low_pass, &[]).unwrap(), None);
    }
}
