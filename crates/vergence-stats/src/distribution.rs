use statrs::distribution::{ContinuousCDF as _, FisherSnedecor, Normal, StudentsT};

/// Probability of an F of at least `f` with `df1` and `df2` degrees of freedom (which may be fractions); none where
/// they are not positive or `f` is not a number.
pub fn p_of_f(f: f64, df1: f64, df2: f64) -> Option<f64> {
    if f.is_nan() {
        return None;
    }
    Some(FisherSnedecor::new(df1, df2).ok()?.sf(f.max(0.0)))
}

/// Two-sided probability of a t at least as far from zero.
pub fn p_of_t(t: f64, df: f64) -> Option<f64> {
    if t.is_nan() {
        return None;
    }
    Some((2.0 * StudentsT::new(0.0, 1.0, df).ok()?.sf(t.abs())).min(1.0))
}

/// The t below which a share `p` of the distribution lies.
pub fn t_quantile(p: f64, df: f64) -> Option<f64> {
    ((0.0..=1.0).contains(&p)).then(|| StudentsT::new(0.0, 1.0, df).ok().map(|t| t.inverse_cdf(p)))?
}

/// Share of the standard normal distribution below `z`.
pub fn normal_cdf(z: f64) -> f64 {
    Normal::standard().cdf(z)
}

/// The z below which a share `p` (0 to 1, exclusive) of the standard normal distribution lies.
pub fn normal_quantile(p: f64) -> Option<f64> {
    (p > 0.0 && p < 1.0).then(|| Normal::standard().inverse_cdf(p))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_of_textbooks() {
        assert!((p_of_f(4.351243478, 1.0, 20.0).unwrap() - 0.05).abs() < 1e-8);
        assert!((t_quantile(0.975, 10.0).unwrap() - 2.228138852).abs() < 1e-8);
        assert!((normal_quantile(0.975).unwrap() - 1.959963985).abs() < 1e-8);
        assert!((p_of_t(2.228138852, 10.0).unwrap() - 0.05).abs() < 1e-9);
        assert_eq!(p_of_f(f64::NAN, 1.0, 2.0), None);
        assert_eq!(p_of_f(1.0, 0.0, 2.0), None);
        assert_eq!(normal_quantile(0.0), None);
    }
}
