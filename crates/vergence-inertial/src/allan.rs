//! Allan deviation: which noise a still sensor has, and how much of each.
//!
//! The overlapping estimate of IEEE Std 952-1997, annex C, and the three noises that inertial sensors are described by.

use vergence_sense::Imu;
use vergence_time::Timestamp;

use crate::Error;
use crate::still::still_stretches;

/// Averaging times per factor of ten.
const PER_DECADE: f64 = 12.0;

/// The longest averaging time fits this many times into the recording: with fewer, the deviation says nothing.
const LEAST_CLUSTERS: usize = 9;

/// One point of the curve.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct AllanPoint {
    /// Averaging time, s.
    pub tau_s: f64,
    /// Deviation of means over that time, in the unit of the samples.
    pub deviation: f64,
}

/// What one axis has of each noise; u is the unit of the samples.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct AxisNoise {
    /// Mean of the samples, u: of a gyroscope at rest, its bias.
    pub mean: f64,
    /// White noise: density, u/√Hz (angle or velocity random walk, where it is read off at 1 s).
    pub density: f64,
    /// Bias instability, u: the flicker that no averaging takes away; `None` where nothing of it was seen.
    pub instability: Option<f64>,
    /// Random walk of the bias, u/√s; `None` where the recording is too short to see it.
    pub walk: Option<f64>,
    /// Standard deviations of density, instability and walk, as far as chance goes; 0 where there is none.
    pub deviations: [f64; 3],
    /// The averaging time from which the noises were fitted, s: below it a low-pass in the sensor takes noise away.
    pub from_s: f64,
    /// How far the curve is from the fit, in units of what chance does: beyond 3 there is something else than these noises.
    pub misfit: f64,
    /// The lowest point of the curve: the best that a mean can do.
    pub floor: AllanPoint,
    /// The curve.
    pub curve: Vec<AllanPoint>,
}

impl AxisNoise {
    /// The deviation that the three noises together have at `tau_s`.
    pub fn fitted(&self, tau_s: f64) -> f64 {
        let part = |value: Option<f64>| value.map_or(0.0, |v| v * v);
        let terms = terms(tau_s);
        (self.density.powi(2) * terms[0] + part(self.instability) * terms[1] + part(self.walk) * terms[2])
            .sqrt()
    }
}

/// Noise of an inertial unit, from a recording at rest.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct ImuNoise {
    /// Samples per second.
    pub rate_hz: f64,
    /// Length of what was used: the longest rest, s.
    pub seconds: f64,
    /// Samples that were missing in it and were put in between their neighbours.
    pub filled: usize,
    /// Whether the recording also has motion, which was left out.
    pub moved: bool,
    /// Per axis, rad/s.
    pub gyr: [AxisNoise; 3],
    /// Per axis, m/s².
    pub acc: [AxisNoise; 3],
}

/// Variances at `tau_s` of white noise, flicker and random walk of size one.
fn terms(tau_s: f64) -> [f64; 3] {
    [1.0 / tau_s, 2.0 * std::f64::consts::LN_2 / std::f64::consts::PI, tau_s / 3.0]
}

/// The overlapping Allan deviation of evenly spaced samples, at averaging times from one period to a ninth of the
/// recording. O(samples · log samples). Empty for fewer than nine samples.
pub fn allan_deviation(samples: &[f64], rate_hz: f64) -> Vec<AllanPoint> {
    let mean = samples.iter().sum::<f64>() / samples.len().max(1) as f64;
    let mut sum = 0.0;
    let integral: Vec<f64> = std::iter::once(0.0)
        .chain(samples.iter().map(|x| {
            sum += x - mean;
            sum
        }))
        .collect();
    let most = samples.len() / LEAST_CLUSTERS;
    let mut lengths: Vec<usize> = (0..)
        .map(|k| 10f64.powf(f64::from(k) / PER_DECADE).round() as usize)
        .take_while(|m| *m <= most)
        .collect();
    lengths.dedup();
    let point = |m: usize| {
        let count = integral.len() - 2 * m;
        let square = |i: usize| (integral[i + 2 * m] - 2.0 * integral[i + m] + integral[i]).powi(2);
        let variance = (0..count).map(square).sum::<f64>() / (2.0 * (m * m) as f64 * count as f64);
        AllanPoint { tau_s: m as f64 / rate_hz, deviation: variance.sqrt() }
    };
    lengths.into_iter().map(point).collect()
}

/// Points over which the slope of the curve is taken: half a factor of ten.
const SLOPE_POINTS: usize = 6;
/// A curve that begins flatter than this begins with a low-pass in the sensor, or with something that no averaging takes away.
const FLAT: f64 = -0.4;
/// The slope that says that the low-pass is over; that of white noise is −1/2.
const WHITE: f64 = -0.46;
/// How many times the averaging time at which that begins the fit does.
const CLEAR: f64 = 3.0;
/// What the instability may exceed the least deviation by, beyond what flicker has there by itself.
const MOST_INSTABILITY: f64 = 1.5;

/// The part of the curve that no low-pass in the sensor bends: all of it, unless it begins flat and then falls as white noise does.
fn unbent(curve: &[AllanPoint]) -> &[AllanPoint] {
    let slope = |k: usize| {
        let (a, b) = (&curve[k], &curve[k + SLOPE_POINTS]);
        (b.deviation / a.deviation).ln() / (b.tau_s / a.tau_s).ln()
    };
    let last = curve.len().saturating_sub(SLOPE_POINTS);
    if last == 0 || slope(0) <= FLAT {
        return curve;
    }
    // NaN, where a deviation is zero, is no slope.
    let Some(white) = (0..last).find(|k| slope(*k) <= WHITE) else { return curve };
    // What the low-pass takes falls with the averaging time.
    let from = curve.partition_point(|point| point.tau_s < CLEAR * curve[white].tau_s).min(last);
    &curve[from..]
}

/// Solves the least squares for the terms in `used` (a bit each), others zero; with their standard errors.
fn least_squares(curve: &[AllanPoint], weights: &[f64], used: u8) -> Option<([f64; 3], [f64; 3], f64)> {
    let mut products = nalgebra::Matrix3::zeros();
    let mut targets = nalgebra::Vector3::zeros();
    let row = |point: &AllanPoint| {
        let all = terms(point.tau_s);
        nalgebra::Vector3::from_fn(|i, _| if used >> i & 1 == 1 { all[i] } else { 0.0 })
    };
    for (point, weight) in curve.iter().zip(weights) {
        let x = row(point);
        products += x * x.transpose() * *weight;
        targets += x * (point.deviation.powi(2) * weight);
    }
    for i in (0..3).filter(|i| used >> i & 1 == 0) {
        products[(i, i)] = 1.0;
    }
    // Their sizes differ by many powers of ten.
    let scale = nalgebra::Vector3::from_fn(|i, _| products[(i, i)].sqrt().recip());
    let scaled = nalgebra::Matrix3::from_fn(|i, j| products[(i, j)] * scale[i] * scale[j]);
    let inverse = scaled.try_inverse()?;
    let found = (inverse * targets.component_mul(&scale)).component_mul(&scale);
    let errors =
        std::array::from_fn(|i| if used >> i & 1 == 1 { inverse[(i, i)].sqrt() * scale[i] } else { 0.0 });
    let left = |(point, weight): (&AllanPoint, &f64)| {
        (point.deviation.powi(2) - row(point).dot(&found)).powi(2) * weight
    };
    let cost = curve.iter().zip(weights).map(left).sum();
    Some((found.into(), errors, cost))
}

/// What one axis has of each noise, from `samples` at rest.
///
/// # Errors
/// [`Error::Unusable`] where there are fewer than 1000 samples, or one that is not finite.
pub fn axis_noise(samples: &[f64], rate_hz: f64) -> Result<AxisNoise, Error> {
    const LEAST: usize = 1000;
    let unusable = |expected: String, found: String| Error::Unusable { expected, found };
    if samples.len() < LEAST {
        return Err(unusable(format!("at least {LEAST} samples at rest"), samples.len().to_string()));
    }
    if let Some(index) = samples.iter().position(|x| !x.is_finite()) {
        return Err(unusable("finite samples".into(), format!("{} at sample {index}", samples[index])));
    }
    let curve = allan_deviation(samples, rate_hz);
    let floor = curve.iter().copied().min_by(|a, b| a.deviation.total_cmp(&b.deviation));
    let floor = floor.ok_or_else(|| unusable("a curve".into(), "none".into()))?;
    let mean = samples.iter().sum::<f64>() / samples.len() as f64;
    if floor.deviation <= 0.0 {
        let (deviations, from_s, misfit) = ([0.0; 3], curve[0].tau_s, 0.0);
        let (instability, walk) = (None, None);
        return Ok(AxisNoise {
            mean,
            density: 0.0,
            instability,
            walk,
            deviations,
            from_s,
            misfit,
            floor,
            curve,
        });
    }
    // Relative variance of each point: two over its degrees of freedom; neighbouring points share most of them.
    let length_s = samples.len() as f64 / rate_hz;
    let spacing = std::f64::consts::LN_10 / PER_DECADE;
    let trust = |tau_s: f64| 0.5 * (1.5 * length_s / tau_s - 1.0).max(1.0) * spacing;
    let part = unbent(&curve);
    let fitted = |noises: &[u8]| {
        let mut model: Vec<f64> = part.iter().map(|p| p.deviation.powi(2)).collect();
        let mut best = ([0.0; 3], [0.0; 3], 0.0);
        for _ in 0..4 {
            let weights: Vec<f64> = part.iter().zip(&model).map(|(p, v)| trust(p.tau_s) / (v * v)).collect();
            let allowed = |(found, _, _): &([f64; 3], [f64; 3], f64)| found.iter().all(|x| *x >= 0.0);
            // A noise that is not needed is not there: each one must be worth its place (Akaike).
            let fits = noises.iter().filter_map(|used| {
                let fit = least_squares(part, &weights, *used)?;
                allowed(&fit).then_some((fit.2 + 2.0 * f64::from(used.count_ones()), fit))
            });
            let Some((_, fit)) = fits.min_by(|a, b| a.0.total_cmp(&b.0)) else { break };
            best = fit;
            let variance = |tau_s: f64| terms(tau_s).iter().zip(fit.0).map(|(t, x)| t * x).sum::<f64>();
            model = part.iter().map(|p| variance(p.tau_s).max(1e-6 * p.deviation.powi(2))).collect();
        }
        best
    };
    let mut best = fitted(&[1, 2, 3, 4, 5, 6, 7]);
    // Flicker has no less than this at any averaging time.
    if best.0[1] * terms(1.0)[1] > (MOST_INSTABILITY * floor.deviation).powi(2) {
        best = fitted(&[1, 4, 5]);
    }
    // Two standard errors: less may be chance.
    let seen = |i: usize| (best.0[i] > 2.0 * best.1[i]).then(|| best.0[i].sqrt());
    let deviation = |i: usize| if best.0[i] > 0.0 { 0.5 * best.1[i] / best.0[i].sqrt() } else { 0.0 };
    Ok(AxisNoise {
        mean,
        density: best.0[0].sqrt(),
        instability: seen(1),
        walk: seen(2),
        deviations: [0, 1, 2].map(deviation),
        from_s: part[0].tau_s,
        misfit: (best.2 / (part.len() as f64 * spacing)).sqrt(),
        floor,
        curve,
    })
}

/// Noise of all axes from the longest rest of a recording. Missing samples are put in between their neighbours.
///
/// # Errors
/// [`Error::Unusable`] where there is no rest of 1000 samples.
pub fn imu_noise(samples: &[(Timestamp, Imu)]) -> Result<ImuNoise, Error> {
    let stretches = still_stretches(samples);
    let longest = stretches.iter().max_by_key(|range| range.len()).ok_or_else(|| Error::Unusable {
        expected: "a recording at rest".into(),
        found: format!("no second of rest in {} samples", samples.len()),
    })?;
    let still = &samples[longest.clone()];
    let mut steps: Vec<i64> = still
        .windows(2)
        .filter_map(|w| Some(w[1].0.since(w[0].0)?.as_nanos()))
        .filter(|step| *step > 0)
        .collect();
    steps.sort_unstable();
    let period = steps.get(steps.len() / 2).copied().unwrap_or(1).max(1) as f64;
    // The mean of the steps that are no gaps is the period, without the jitter of each.
    let regular: Vec<f64> = steps.iter().map(|s| *s as f64).filter(|s| *s < 1.5 * period).collect();
    let period = regular.iter().sum::<f64>() / regular.len().max(1) as f64;
    let mut even: Vec<[f64; 6]> = Vec::with_capacity(still.len());
    let mut filled = 0;
    for (index, (time, imu)) in still.iter().enumerate() {
        let read: [f64; 6] =
            std::array::from_fn(|i| if i < 3 { imu.gyr_rad_s[i] } else { imu.acc_m_s2[i - 3] });
        if let (Some(last), true) = (even.last().copied(), index > 0) {
            let step = time.since(still[index - 1].0).map_or(period, |s| s.as_nanos() as f64);
            let missing = ((step / period).round() as usize).saturating_sub(1);
            filled += missing;
            for k in 1..=missing {
                let part = k as f64 / (missing + 1) as f64;
                even.push(std::array::from_fn(|i| last[i] + (read[i] - last[i]) * part));
            }
        }
        even.push(read);
    }
    let rate_hz = 1e9 / period;
    let axis = |i: usize| axis_noise(&even.iter().map(|row| row[i]).collect::<Vec<_>>(), rate_hz);
    Ok(ImuNoise {
        rate_hz,
        seconds: even.len() as f64 / rate_hz,
        filled,
        moved: longest.len() + (rate_hz * 2.0) as usize <= samples.len(),
        gyr: [axis(0)?, axis(1)?, axis(2)?],
        acc: [axis(3)?, axis(4)?, axis(5)?],
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use vergence_time::Span;

    use super::*;
    use crate::dice::Dice;
    use crate::model::ImuModel;
    use crate::motion::{Earth, Still};

    /// The bar of recovered densities.
    const BAR: f64 = 0.05;

    #[test]
    fn the_deviation_of_white_noise_falls_with_the_root_of_time() {
        let dice = Dice::new(1, 1);
        let samples: Vec<f64> = (0..200_000).map(|k| 3.0 + dice.normal(k)).collect();
        let curve = allan_deviation(&samples, 100.0);
        for point in curve.iter().filter(|p| p.tau_s < 10.0) {
            let expected = (1.0 / (point.tau_s * 100.0)).sqrt();
            assert!((point.deviation / expected - 1.0).abs() < 0.08, "{point:?} {expected}");
        }
        // By hand: of 0 1 0 1 …, means of one differ by one, means of two by nothing.
        let teeth: Vec<f64> = (0..40).map(|k| f64::from(k % 2)).collect();
        let curve = allan_deviation(&teeth, 1.0);
        assert!(
            (curve[0].deviation - 0.5f64.sqrt()).abs() < 1e-12 && curve[1].deviation < 1e-12,
            "{curve:?}"
        );
    }

    #[test]
    fn simulated_densities_are_recovered() {
        for (seed, rate_hz) in [(1, 100.0), (2, 50.0), (3, 400.0)] {
            let mut model = ImuModel { seed, ..ImuModel::perfect(rate_hz) };
            (model.gyr.noise_density, model.acc.noise_density) = (1.7e-4, 2e-3);
            (model.gyr.bias, model.drop_probability) = (Vector3::new(0.01, 0.0, -0.2), 0.002);
            model.jitter_s = 1e-4 / (rate_hz / 100.0);
            let still = Still::default();
            let samples: Vec<_> = model
                .record(&still, &Earth::MID_LATITUDE, Span::from_millis((3e7 / rate_hz) as i64))
                .map(|s| (s.captured, s.value))
                .collect();
            let noise = imu_noise(&samples).unwrap();
            assert!(
                (noise.rate_hz / rate_hz - 1.0).abs() < 1e-3 && noise.filled > 10 && !noise.moved,
                "{noise:?}"
            );
            for (axes, truth) in [(&noise.gyr, 1.7e-4), (&noise.acc, 2e-3)] {
                for axis in axes {
                    assert!((axis.density / truth - 1.0).abs() < BAR, "{} {truth}", axis.density);
                    let at_one = axis.fitted(1.0);
                    assert!((at_one / truth - 1.0).abs() < 0.15, "{at_one} {truth}");
                }
            }
            assert!((noise.gyr[2].mean + 0.2).abs() < 1e-4);
        }
    }

    #[test]
    fn density_and_walk_are_told_apart() {
        // 14 h at 5 Hz: the walk rules above 30 s, 1700 times.
        let (mut densities, mut walks) = (0.0, 0.0);
        for axis in 0..3u64 {
            let (white, walk) = (Dice::new(5, axis), Dice::new(6, axis));
            let (density, wandering) = (1e-2, 5.5e-4);
            let sample =
                |k: u64| white.normal(k) * density * 5f64.sqrt() + walk.walk(k) * wandering / 5f64.sqrt();
            let samples: Vec<f64> = (0..250_000).map(sample).collect();
            let noise = axis_noise(&samples, 5.0).unwrap();
            let found = noise.walk.expect("a walk that rules most of the curve is seen");
            assert!((noise.density / density - 1.0).abs() < BAR, "{noise:?}");
            densities += noise.density / density / 3.0;
            walks += found / wandering / 3.0;
        }
        assert!((densities - 1.0).abs() < BAR && (walks - 1.0).abs() < BAR, "{densities} {walks}");
    }

    /// White noise of density one behind a low-pass of second order (Butterworth, by the bilinear transform), at 200 Hz for 600 s.
    fn behind_low_pass(cutoff_hz: f64, seed: u64) -> Vec<f64> {
        let dice = Dice::new(seed, 3);
        let c = (std::f64::consts::PI * cutoff_hz / 200.0).tan();
        let d = c * c + std::f64::consts::SQRT_2 * c + 1.0;
        let (b, a1, a2) =
            (c * c / d, 2.0 * (c * c - 1.0) / d, (1.0 - std::f64::consts::SQRT_2 * c + c * c) / d);
        let (mut first, mut second) = (0.0, 0.0);
        (0..120_000)
            .map(|k| {
                let x = dice.normal(k) * 200f64.sqrt();
                let y = b * x + first;
                first = 2.0 * b * x - a1 * y + second;
                second = b * x - a2 * y;
                y
            })
            .collect()
    }

    #[test]
    fn a_low_pass_in_the_sensor_changes_no_density_and_makes_no_instability() {
        for (seed, cutoff_hz) in [(1, 60.0), (2, 40.0), (3, 20.0), (4, 10.0), (5, 5.0), (6, 20.0), (7, 40.0)]
        {
            let noise = axis_noise(&behind_low_pass(cutoff_hz, seed), 200.0).unwrap();
            let found = (noise.density, noise.deviations[0], noise.from_s, noise.misfit);
            println!("{cutoff_hz} Hz: {found:.3?} {:?}", noise.instability);
            assert!((noise.density - 1.0).abs() < BAR, "{cutoff_hz} Hz: {found:?}");
            assert!(noise.instability.is_none() && noise.misfit < 3.0, "{cutoff_hz} Hz: {noise:?}");
        }
    }

    #[test]
    fn deviations_and_misfit_say_what_a_fit_is_worth() {
        let (mut off, mut misfits) = (Vec::new(), Vec::new());
        for seed in 0..12u64 {
            let (white, walk) = (Dice::new(seed, 0), Dice::new(seed, 1));
            let sample = |k: u64| white.normal(k) * 50f64.sqrt() + walk.walk(k) * 0.03 / 50f64.sqrt();
            let samples: Vec<f64> = (0..50_000).map(sample).collect();
            let noise = axis_noise(&samples, 50.0).unwrap();
            off.push((noise.density - 1.0) / noise.deviations[0]);
            misfits.push(noise.misfit);
            if let Some(found) = noise.walk {
                off.push((found - 0.03) / noise.deviations[2]);
            }
            // A vibration is none of the noises.
            let shaken: Vec<f64> =
                samples.iter().enumerate().map(|(k, x)| x + 10.0 * (0.05 * k as f64).sin()).collect();
            let shaken = axis_noise(&shaken, 50.0).unwrap();
            assert!(shaken.misfit > 3.0, "{}", shaken.misfit);
        }
        println!("{off:.2?} {misfits:.2?}");
        assert!(off.iter().filter(|off| off.abs() > 3.0).count() <= 1, "{off:.2?}");
        assert!(misfits.iter().all(|misfit| *misfit < 3.0), "{misfits:.2?}");
    }

    #[test]
    fn what_is_no_recording_at_rest_is_refused() {
        assert!(
            axis_noise(&[1.0; 10], 100.0).unwrap_err().to_string().contains("expected at least 1000 samples")
        );
        let mut samples = vec![0.0; 2000];
        samples[7] = f64::NAN;
        assert!(axis_noise(&samples, 100.0).unwrap_err().to_string().contains("NaN at sample 7"));
        assert_eq!(axis_noise(&[2.0; 2000], 100.0).unwrap().density, 0.0);
        assert!(imu_noise(&[]).is_err());
    }
}
