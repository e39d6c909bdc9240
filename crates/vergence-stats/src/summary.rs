use crate::{Moments, t_quantile};

/// The value below which a share `p` (0 to 1) lies, interpolated linearly between order statistics (Hyndman and Fan's
/// type 7, the default of R and NumPy). None of no values, or where one is not a number.
pub fn quantile(values: &[f64], p: f64) -> Option<f64> {
    if values.is_empty() || values.iter().any(|value| value.is_nan()) || !(0.0..=1.0).contains(&p) {
        return None;
    }
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let place = p * (sorted.len() - 1) as f64;
    let (below, share) = (place.floor() as usize, place.fract());
    let above = (below + 1).min(sorted.len() - 1);
    Some(if share == 0.0 { sorted[below] } else { sorted[below] + share * (sorted[above] - sorted[below]) })
}

/// The middle value.
pub fn median(values: &[f64]) -> Option<f64> {
    quantile(values, 0.5)
}

/// Median absolute deviation from the median, times 1.4826: estimates the standard deviation of a normal sample.
pub fn mad(values: &[f64]) -> Option<f64> {
    let centre = median(values)?;
    let distances: Vec<f64> = values.iter().map(|value| (value - centre).abs()).collect();
    Some(1.482_602_218_505_602 * median(&distances)?)
}

/// Skewness with the correction for small samples (G₁ of Joanes and Gill 1998); none of fewer than three values or
/// without variance.
pub fn skewness(values: &[f64]) -> Option<f64> {
    let (n, m2, m3, _) = central(values)?;
    (n > 2.0 && m2 > 0.0).then(|| m3 / m2.powf(1.5) * (n * (n - 1.0)).sqrt() / (n - 2.0))
}

/// Excess kurtosis with the correction for small samples (G₂ of Joanes and Gill 1998); none of fewer than four values
/// or without variance.
pub fn kurtosis(values: &[f64]) -> Option<f64> {
    let (n, m2, _, m4) = central(values)?;
    (n > 3.0 && m2 > 0.0).then(|| {
        let plain = m4 / (m2 * m2) - 3.0;
        (n - 1.0) / ((n - 2.0) * (n - 3.0)) * ((n + 1.0) * plain + 6.0)
    })
}

/// Interval that covers the mean with probability `level`, by Student's t; none of fewer than two values.
pub fn interval_of_mean(values: &[f64], level: f64) -> Option<(f64, f64)> {
    let moments: Moments = values.iter().copied().collect();
    let (mean, sd) = (moments.mean()?, moments.sd()?);
    let n = values.len() as f64;
    let half = t_quantile(0.5 + 0.5 * level, n - 1.0)? * sd / n.sqrt();
    Some((mean - half, mean + half))
}

fn central(values: &[f64]) -> Option<(f64, f64, f64, f64)> {
    let mean = values.iter().copied().collect::<Moments>().mean()?;
    let n = values.len() as f64;
    let moment = |power: i32| values.iter().map(|value| (value - mean).powi(power)).sum::<f64>() / n;
    Some((n, moment(2), moment(3), moment(4)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_samples() {
        let values = [2.0, 8.0, 0.0, 4.0, 1.0, 9.0, 9.0, 0.0];
        // scipy.stats.skew and kurtosis, bias=False.
        assert!((skewness(&values).unwrap() - 0.330_582_2).abs() < 1e-6);
        assert!((kurtosis(&values).unwrap() + 2.098_602_3).abs() < 1e-6);
        assert_eq!(median(&values), Some(3.0));
        assert_eq!(quantile(&[1.0, 2.0, 3.0, 4.0], 0.25), Some(1.75));
        assert_eq!(quantile(&[], 0.5), None);
        assert_eq!(skewness(&[1.0, 1.0, 1.0]), None);
        let (low, high) = interval_of_mean(&[1.0, 2.0, 3.0], 0.95).unwrap();
        assert!((low + 0.484_137_7).abs() < 1e-6 && (high - 4.484_137_7).abs() < 1e-6);
    }
}
