use num_bigint::BigInt;
use num_rational::BigRational;
use num_traits::Zero as _;

use crate::{
    Decimal, Error,
    decimal::{power_of_ten, to_f64},
    distribution::{p_of_f, p_of_t, t_quantile},
    exact::{Scaled, root, solve},
};

/// A linear least-squares fit. What a fit without residual degrees of freedom, or of a constant response, does not
/// have is `None`.
#[derive(Clone, Debug, PartialEq)]
pub struct Regression {
    /// The intercept first where there is one, then one per predictor; response unit over predictor unit.
    pub coefficients: Vec<f64>,
    /// Of each coefficient, in its unit.
    pub standard_errors: Option<Vec<f64>>,
    /// Share of the variance explained: 1 − RSS/TSS; without an intercept TSS is taken about zero.
    pub r2: Option<f64>,
    /// The same, corrected for the number of predictors.
    pub adjusted_r2: Option<f64>,
    /// Residual standard deviation √(RSS/df), response unit.
    pub residual_sd: Option<f64>,
    /// Mean square of the model over mean square of the residuals.
    pub f: Option<f64>,
    /// Probability of an F at least as large when no predictor matters.
    pub p: Option<f64>,
    /// Degrees of freedom of the model and of the residuals.
    pub df: [usize; 2],
    /// Residual sum of squares, response unit squared.
    pub rss: f64,
    /// Number of observations.
    pub n: usize,
    /// Whether the first coefficient is an intercept.
    pub intercept: bool,
}

impl Regression {
    /// Two-sided p of coefficient `index` being zero.
    pub fn p_of(&self, index: usize) -> Option<f64> {
        let error = *self.standard_errors.as_ref()?.get(index)?;
        if error == 0.0 {
            return None;
        }
        p_of_t(self.coefficients.get(index)? / error, self.df[1] as f64)
    }

    /// Interval that covers coefficient `index` with probability `level` (such as 0.95).
    pub fn interval(&self, index: usize, level: f64) -> Option<(f64, f64)> {
        let half =
            t_quantile(0.5 + 0.5 * level, self.df[1] as f64)? * self.standard_errors.as_ref()?.get(index)?;
        let centre = self.coefficients.get(index)?;
        Some((centre - half, centre + half))
    }
}

/// Fits `response` by `predictors` (columns of the same length), with an intercept where asked for.
///
/// Normal equations in whole numbers, solved without rounding; each answer is then rounded once. O(n p² + p³) products
/// of big numbers: 100 000 rows of four predictors take about a second.
///
/// # Errors
/// Where columns differ in length, there are fewer rows than coefficients, or a predictor depends on the others.
pub fn regress(
    response: &[Decimal],
    predictors: &[Vec<Decimal>],
    intercept: bool,
) -> Result<Regression, Error> {
    let n = response.len();
    if let Some((column, found)) = predictors.iter().map(Vec::len).enumerate().find(|(_, len)| *len != n) {
        return Err(Error::Length { column, expected: n, found });
    }
    let mut columns: Vec<Scaled> = Vec::new();
    if intercept {
        columns.push(Scaled::ones(n));
    }
    columns.extend(predictors.iter().map(|column| Scaled::new(column)));
    let p = columns.len();
    if n < p.max(1) || p == 0 {
        return Err(Error::TooFew { what: "observations", expected: p.max(1), found: n });
    }
    let y = Scaled::new(response);
    let gram: Vec<Vec<BigInt>> = columns.iter().map(|a| columns.iter().map(|b| a.dot(b)).collect()).collect();
    let right: Vec<BigInt> = columns.iter().map(|column| column.dot(&y)).collect();
    let solved = solve(&gram, &right)?;

    // A coefficient in the scaled columns' units is 10^(y.places − column.places) of the real one's.
    let places = |column: &Scaled, value: BigRational, times: i32| {
        let shift = times * (column.places - y.places);
        let ten = BigRational::from(power_of_ten(shift.abs()));
        if shift >= 0 { value * ten } else { value / ten }
    };
    let coefficient = |i: usize| BigRational::new(solved.solution[i].clone(), solved.determinant.clone());
    let coefficients =
        columns.iter().enumerate().map(|(i, column)| to_f64(&places(column, coefficient(i), 1))).collect();

    // RSS = y·y − b·(Xᵀy), TSS = y·y − n ȳ², both exact.
    let squares = y.dot(&y);
    let explained: BigRational =
        solved.solution.iter().zip(&right).map(|(b, r)| b * r).sum::<BigInt>().into();
    let explained = explained / BigRational::from(solved.determinant.clone());
    let rss = BigRational::from(squares.clone()) - &explained;
    let correction = if intercept {
        let sum: BigInt = y.values.iter().sum();
        BigRational::new(&sum * &sum, BigInt::from(n))
    } else {
        BigRational::zero()
    };
    let tss = BigRational::from(squares) - correction;
    let df = [p - usize::from(intercept), n - p];
    let real = |value: &BigRational| value / BigRational::from(power_of_ten(2 * y.places));
    let whole = |count: usize| BigRational::from(BigInt::from(count));

    let variance = (df[1] > 0).then(|| &rss / whole(df[1]));
    let standard_errors = variance.as_ref().map(|variance| {
        let of = |(i, column): (usize, &Scaled)| {
            let inverse = BigRational::new(solved.inverse_diagonal[i].clone(), solved.determinant.clone());
            root(&places(column, variance * inverse, 2))
        };
        columns.iter().enumerate().map(of).collect()
    });
    let r2 = (!tss.is_zero()).then(|| whole(1) - &rss / &tss);
    let adjusted_r2 = match (&r2, df[1]) {
        (Some(r2), 1..) => {
            let loss = (whole(1) - r2) * whole(n - usize::from(intercept)) / whole(df[1]);
            Some(to_f64(&(whole(1) - loss)))
        }
        _ => None,
    };
    let f = match &variance {
        Some(variance) if !variance.is_zero() && df[0] > 0 => Some((&tss - &rss) / whole(df[0]) / variance),
        _ => None,
    };
    let f = f.map(|f| to_f64(&f));
    Ok(Regression {
        coefficients,
        standard_errors,
        r2: r2.map(|r2| to_f64(&r2)),
        adjusted_r2,
        residual_sd: variance.map(|variance| root(&real(&variance))),
        p: f.and_then(|f| p_of_f(f, df[0] as f64, df[1] as f64)),
        f,
        df,
        rss: to_f64(&real(&rss)),
        n,
        intercept,
    })
}

/// The line through points (x, y): `coefficients` are intercept and slope.
///
/// # Errors
/// Those of [`regress`], and where a number is not finite.
pub fn linear(x: &[f64], y: &[f64]) -> Result<Regression, Error> {
    let exact = |values: &[f64]| -> Result<Vec<Decimal>, Error> {
        let of = |value: &f64| {
            Decimal::from_f64(*value).ok_or_else(|| Error::NotANumber { found: value.to_string() })
        };
        values.iter().map(of).collect()
    };
    regress(&exact(y)?, &[exact(x)?], true)
}
