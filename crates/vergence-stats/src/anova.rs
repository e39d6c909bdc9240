use num_bigint::BigInt;
use num_rational::BigRational;
use num_traits::Zero as _;

use crate::{
    Decimal, Error,
    decimal::{power_of_ten, to_f64},
    distribution::p_of_f,
    exact::{Scaled, root},
};

/// One-way analysis of variance between independent groups.
#[derive(Clone, Debug, PartialEq)]
pub struct OneWay {
    /// Mean square between over mean square within; none where nothing varies within groups.
    pub f: Option<f64>,
    /// Probability of an F at least as large when all groups have one mean.
    pub p: Option<f64>,
    /// Degrees of freedom between and within.
    pub df: [usize; 2],
    /// Sums of squares between and within, response unit squared.
    pub ss: [f64; 2],
    /// Mean squares between and within.
    pub ms: [f64; 2],
    /// Residual standard deviation, response unit.
    pub residual_sd: f64,
    /// Effect size η² = SS between / SS total (also R²).
    pub eta2: Option<f64>,
    /// Effect size ω², less biased than η²; may be below zero.
    pub omega2: Option<f64>,
    /// Effect size f = √(η²/(1−η²)), Cohen 1988.
    pub cohen_f: Option<f64>,
    /// Mean of each group.
    pub means: Vec<f64>,
    /// Size of each group.
    pub sizes: Vec<usize>,
}

/// Compares the means of `groups`; sums are exact, each answer is rounded once. Empty groups are left out.
///
/// # Errors
/// Where there are fewer than two groups that hold something, or no group holds two values.
pub fn one_way(groups: &[Vec<Decimal>]) -> Result<OneWay, Error> {
    let groups: Vec<&Vec<Decimal>> = groups.iter().filter(|group| !group.is_empty()).collect();
    if groups.len() < 2 {
        return Err(Error::TooFew { what: "groups", expected: 2, found: groups.len() });
    }
    let all: Vec<Decimal> = groups.iter().flat_map(|group| group.iter().cloned()).collect();
    let n = all.len();
    let df = [groups.len() - 1, n - groups.len()];
    if df[1] == 0 {
        return Err(Error::TooFew { what: "values", expected: groups.len() + 1, found: n });
    }
    let scaled = Scaled::new(&all);
    let squares = BigRational::from(scaled.dot(&scaled));
    let mut rest = scaled.values.as_slice();
    let mut total = BigInt::zero();
    let mut by_group = BigRational::zero();
    let mut means = Vec::new();
    for group in &groups {
        let (own, others) = rest.split_at(group.len());
        rest = others;
        let sum: BigInt = own.iter().sum();
        by_group += BigRational::new(&sum * &sum, BigInt::from(group.len()));
        means.push(to_f64(&BigRational::new(
            sum.clone(),
            BigInt::from(group.len()) * power_of_ten(scaled.places),
        )));
        total += sum;
    }
    let correction = BigRational::new(&total * &total, BigInt::from(n));
    let unit = BigRational::from(power_of_ten(2 * scaled.places));
    let ss = [(&by_group - correction) / &unit, (squares - by_group) / &unit];
    let whole = |count: usize| BigRational::from(BigInt::from(count));
    let ms = [&ss[0] / whole(df[0]), &ss[1] / whole(df[1])];
    let sum = &ss[0] + &ss[1];
    let f = (!ms[1].is_zero()).then(|| to_f64(&(&ms[0] / &ms[1])));
    let varies = !sum.is_zero();
    Ok(OneWay {
        p: f.and_then(|f| p_of_f(f, df[0] as f64, df[1] as f64)),
        f,
        df,
        residual_sd: root(&ms[1]),
        eta2: varies.then(|| to_f64(&(&ss[0] / &sum))),
        omega2: varies.then(|| to_f64(&((&ss[0] - whole(df[0]) * &ms[1]) / (&sum + &ms[1])))),
        cohen_f: (!ss[1].is_zero()).then(|| root(&(&ss[0] / &ss[1]))),
        ss: [to_f64(&ss[0]), to_f64(&ss[1])],
        ms: [to_f64(&ms[0]), to_f64(&ms[1])],
        means,
        sizes: groups.iter().map(|group| group.len()).collect(),
    })
}
