//! Formulas of Fitts' law and its relatives; each answers `None` where it has no value.

use vergence_stats::{normal_cdf, normal_quantile};

use crate::convention::Difficulty;

/// Index of difficulty (bits, or as [`Difficulty`] says) of amplitude and width in one unit; none where either is not positive and finite.
pub fn difficulty(rule: Difficulty, amplitude: f64, width: f64) -> Option<f64> {
    let ratio = amplitude / width;
    if !(amplitude >= 0.0 && width > 0.0 && ratio.is_finite()) {
        return None;
    }
    match rule {
        Difficulty::Shannon => Some((ratio + 1.0).log2()),
        Difficulty::Fitts => (ratio > 0.0).then(|| (2.0 * ratio).log2()),
        Difficulty::Steering => steering_difficulty(&[(amplitude, width)]),
        Difficulty::Angular => angular_difficulty(amplitude, width, 3.0),
        Difficulty::Meyer => meyer_term(amplitude, width, 2),
    }
}

/// Effective width where only hits and misses are known (MacKenzie 1992; Soukoreff and MacKenzie 2004):
/// W · 2.066 / z(1 − error/2), and 0.5089 W where there are (almost) no misses. `error` is a share from 0 to 1; none
/// where all trials missed.
pub fn width_from_errors(width: f64, error: f64) -> Option<f64> {
    if !(width > 0.0 && (0.0..1.0).contains(&error)) {
        return None;
    }
    if error <= 0.000_049 {
        return Some(0.5089 * width);
    }
    Some(width * 2.066 / normal_quantile(1.0 - 0.5 * error)?)
}

/// Predicted share of misses (Wobbrock, Cutrell, Harada and MacKenzie 2008):
/// 1 − erf(2.066 (W/A)(2^((MT − a)/b) − 1) / √2). Times in one unit; none where `b` is zero.
pub fn predicted_error(amplitude: f64, width: f64, mt: f64, a: f64, b: f64) -> Option<f64> {
    let z = 2.066 * (width / amplitude) * (((mt - a) / b).exp2() - 1.0);
    (!z.is_nan() && b != 0.0).then(|| (2.0 * (1.0 - normal_cdf(z))).clamp(0.0, 1.0))
}

/// Index of difficulty of a rectangle (Accot and Zhai 2003): log2(√((A/W)² + η (A/H)²) + 1), bits.
pub fn rectangle_difficulty(amplitude: f64, width: f64, height: f64, eta: f64) -> Option<f64> {
    let ratio = ((amplitude / width).powi(2) + eta * (amplitude / height).powi(2)).sqrt();
    (amplitude >= 0.0 && width > 0.0 && height > 0.0 && ratio.is_finite()).then(|| (ratio + 1.0).log2())
}

/// Index of difficulty of a tunnel (Accot and Zhai 1997): ∫ ds/W(s), over its centre line given as (length of the
/// piece, width there); no unit. Steering time is a + b times it.
pub fn steering_difficulty(pieces: &[(f64, f64)]) -> Option<f64> {
    pieces.iter().map(|(length, width)| (*length >= 0.0 && *width > 0.0).then(|| length / width)).sum()
}

/// Index of difficulty of ray pointing (Kopper, Bowman, Silva and McMahan 2010): log2(α/ωᵏ + 1)², bits², of amplitude
/// and width in radians; k is about 3.
pub fn angular_difficulty(amplitude_rad: f64, width_rad: f64, k: f64) -> Option<f64> {
    let ratio = amplitude_rad / width_rad.powf(k);
    (amplitude_rad >= 0.0 && width_rad > 0.0 && ratio.is_finite()).then(|| (ratio + 1.0).log2().powi(2))
}

/// Meyer et al. 1988 with n submovements: the term n (A/W)^(1/n) of MT = a + b · term.
pub fn meyer_term(amplitude: f64, width: f64, n: u32) -> Option<f64> {
    let ratio = amplitude / width;
    (n > 0 && ratio >= 0.0 && ratio.is_finite()).then(|| f64::from(n) * ratio.powf(1.0 / f64::from(n)))
}

/// Murata and Iwase 2001: log2(A/W + 1) + c sin θ, bits, θ the direction of the movement in a vertical plane.
pub fn murata_difficulty(amplitude: f64, width: f64, c: f64, theta_rad: f64) -> Option<f64> {
    Some(difficulty(Difficulty::Shannon, amplitude, width)? + c * theta_rad.sin())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn known_values() {
        assert_eq!(difficulty(Difficulty::Shannon, 7.0, 1.0), Some(3.0));
        assert_eq!(difficulty(Difficulty::Fitts, 4.0, 1.0), Some(3.0));
        assert_eq!(difficulty(Difficulty::Fitts, 0.0, 1.0), None);
        assert_eq!(difficulty(Difficulty::Shannon, 1.0, 0.0), None);
        // 4 % misses is what √(2πe) SD means: We = W.
        assert!((width_from_errors(10.0, 0.0388).unwrap() - 10.0).abs() < 0.01);
        assert_eq!(width_from_errors(10.0, 0.0), Some(5.089));
        assert_eq!(width_from_errors(10.0, 1.0), None);
        // At the time that the law predicts, about 4 % miss.
        let mt = 0.1 + 0.2 * 9f64.log2();
        assert!((predicted_error(8.0, 1.0, mt, 0.1, 0.2).unwrap() - 0.0388).abs() < 1e-3);
        assert_eq!(predicted_error(8.0, 1.0, 1.0, 0.0, 0.0), None);
        assert_eq!(steering_difficulty(&[(1.0, 0.1), (2.0, 0.5)]), Some(14.0));
        assert_eq!(steering_difficulty(&[(1.0, 0.0)]), None);
        assert_eq!(meyer_term(16.0, 1.0, 2), Some(8.0));
        assert!((rectangle_difficulty(7.0, 1.0, 1e12, 0.15).unwrap() - 3.0).abs() < 1e-9);
    }

    proptest! {
        #[test]
        fn never_nan(a in any::<f64>(), w in any::<f64>(), e in any::<f64>()) {
            for value in [
                difficulty(Difficulty::Shannon, a, w), difficulty(Difficulty::Fitts, a, w), width_from_errors(w, e),
                predicted_error(a, w, e, 0.1, 0.2), rectangle_difficulty(a, w, e, 0.1), angular_difficulty(a, w, 3.0),
                meyer_term(a, w, 2), steering_difficulty(&[(a, w)]),
            ] {
                prop_assert!(value.is_none_or(|value| !value.is_nan()), "{value:?}");
            }
        }
    }
}
