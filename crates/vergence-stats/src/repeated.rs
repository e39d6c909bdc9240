use std::collections::BTreeMap;

use num_bigint::BigInt;
use num_integer::Integer as _;
use num_rational::BigRational;
use num_traits::{One as _, Zero as _};

use crate::{
    Decimal, Error,
    decimal::{power_of_ten, to_f64},
    distribution::p_of_f,
    exact::Scaled,
};

/// One value of one subject in one cell of the design.
#[derive(Clone, Debug, PartialEq)]
pub struct Observation {
    /// Who.
    pub subject: String,
    /// The level of the between-subjects factor, where there is one.
    pub group: Option<String>,
    /// The level of each within-subject factor, in the order of the factors.
    pub levels: Vec<String>,
    /// What was measured.
    pub value: Decimal,
}

/// One line of the table: a main effect or an interaction, against its own error.
#[derive(Clone, Debug, PartialEq)]
pub struct Effect {
    /// Such as `width` or `group × width`.
    pub name: String,
    /// F; none where the error does not vary.
    pub f: Option<f64>,
    /// Degrees of freedom of effect and error.
    pub df: [f64; 2],
    /// Sums of squares of effect and error.
    pub ss: [f64; 2],
    /// Mean squares of effect and error.
    pub ms: [f64; 2],
    /// Probability of an F at least as large without the effect, sphericity assumed.
    pub p: Option<f64>,
    /// Greenhouse and Geisser's ε (1959): 1 where sphericity holds, 1/df where it is worst; none between subjects.
    pub epsilon_gg: Option<f64>,
    /// Huynh and Feldt's ε (1976, corrected by Lecoutre 1991), at most 1.
    pub epsilon_hf: Option<f64>,
    /// p with degrees of freedom times Greenhouse and Geisser's ε.
    pub p_gg: Option<f64>,
    /// p with degrees of freedom times Huynh and Feldt's ε.
    pub p_hf: Option<f64>,
    /// Partial η² = SS / (SS + SS error).
    pub partial_eta2: Option<f64>,
    /// Generalised η² (Olejnik and Algina 2003), every factor taken as manipulated: SS / (SS + all SS error).
    pub generalised_eta2: Option<f64>,
}

/// Analysis of variance with repeated measures.
#[derive(Clone, Debug, PartialEq)]
pub struct Repeated {
    /// The between effect first where there is one, then each within effect with its interaction with the group.
    pub effects: Vec<Effect>,
    /// How many subjects.
    pub subjects: usize,
    /// How many groups; 1 without a between factor.
    pub groups: usize,
    /// How many observations there were.
    pub observations: usize,
    /// The least and the most observations of one subject in one cell: above 1 they were averaged.
    pub per_cell: [usize; 2],
}

/// Sum and count of a subject's values in each cell.
type Cells = BTreeMap<Vec<usize>, (BigInt, usize)>;

/// Whole numbers: all that follows is exact until an answer is rounded once.
struct Design<'a> {
    /// Levels of each within factor, in order of first appearance.
    levels: Vec<Vec<&'a str>>,
    /// One row per subject, one column per cell (the last factor fastest), times `unit`.
    values: Vec<Vec<BigInt>>,
    /// One in the response's unit.
    unit: BigInt,
    /// The group of each row.
    group: Vec<usize>,
    /// How many subjects each group has.
    sizes: Vec<usize>,
    per_cell: [usize; 2],
}

/// Within-subject factors `within` (one name per level in each observation), fully crossed, and where the observations
/// name groups a between factor `between`. Several values of a subject in a cell are averaged first. Groups may differ
/// in size: main effects are of unweighted means (type III). Sums are exact, each answer is rounded once, whatever offset the
/// values share; time grows with subjects × cells².
///
/// # Errors
/// Where a subject lacks a cell or has two groups, fewer than two subjects per group on average, or no factor varies.
pub fn repeated(
    observations: &[Observation],
    within: &[&str],
    between: Option<&str>,
) -> Result<Repeated, Error> {
    let design = arranged(observations, within.len())?;
    let (subjects, groups) = (design.values.len(), design.sizes.len());
    if subjects <= groups {
        return Err(Error::TooFew { what: "subjects", expected: groups + 1, found: subjects });
    }
    let mut effects: Vec<(Effect, BigRational)> = Vec::new();
    let mut all_errors = BigRational::zero();
    for subset in 0..1usize << within.len() {
        let contrasts = contrasts(&design.levels, subset);
        let names: Vec<&str> =
            within.iter().enumerate().filter(|(i, _)| subset >> i & 1 == 1).map(|(_, name)| *name).collect();
        if contrasts.is_empty() {
            return Err(Error::Constant { what: "levels of a within-subject factor" });
        }
        let stratum = Stratum::new(&contrasts, &design);
        all_errors += &stratum.error;
        if !names.is_empty() {
            let effect = stratum.effect(names.join(" × "), &stratum.within, stratum.dimensions);
            effects.push((effect, stratum.within.clone()));
        }
        if groups > 1 {
            let name = between.unwrap_or("group").to_owned();
            let name = names.iter().fold(name, |name, own| name + " × " + own);
            let df = stratum.dimensions * (groups - 1);
            effects.push((stratum.effect(name, &stratum.interaction, df), stratum.interaction.clone()));
        }
    }
    if effects.is_empty() {
        return Err(Error::TooFew { what: "factors", expected: 1, found: 0 });
    }
    let of_all = |(mut effect, ss): (Effect, BigRational)| {
        effect.generalised_eta2 = share(&ss, &all_errors);
        effect
    };
    let effects = effects.into_iter().map(of_all).collect();
    let per_cell = design.per_cell;
    Ok(Repeated { effects, subjects, groups, observations: observations.len(), per_cell })
}

/// part / (part + rest), where that is something.
fn share(part: &BigRational, rest: &BigRational) -> Option<f64> {
    let whole = part + rest;
    (!whole.is_zero()).then(|| to_f64(&(part / whole)))
}

fn whole(count: usize) -> BigRational {
    BigRational::from(BigInt::from(count))
}

/// The part of the variance that one set of contrasts sees.
struct Stratum {
    within: BigRational,
    interaction: BigRational,
    error: BigRational,
    dimensions: usize,
    /// Subjects minus groups.
    free: usize,
    epsilon_gg: f64,
    epsilon_hf: f64,
}

impl Stratum {
    fn new(contrasts: &[Contrast], design: &Design<'_>) -> Self {
        let d = contrasts.len();
        let groups = design.sizes.len();
        let score = |row: &Vec<BigInt>, contrast: &Contrast| -> BigInt {
            row.iter().zip(&contrast.weights).map(|(value, weight)| value * weight).sum()
        };
        let scores: Vec<Vec<BigInt>> = design
            .values
            .iter()
            .map(|row| contrasts.iter().map(|contrast| score(row, contrast)).collect())
            .collect();
        let mut sums = vec![vec![BigInt::zero(); d]; groups];
        for (row, &group) in scores.iter().zip(&design.group) {
            sums[group].iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
        }
        // Means of groups times `common` are whole, and so are squares over the contrasts' lengths times `lengths`.
        let common = design.sizes.iter().fold(BigInt::one(), |common, size| common.lcm(&BigInt::from(*size)));
        let shares: Vec<BigInt> = design.sizes.iter().map(|size| &common / size).collect();
        let lengths = contrasts.iter().fold(BigInt::one(), |all, contrast| all.lcm(&contrast.length2));
        let weights: Vec<BigInt> = contrasts.iter().map(|contrast| &lengths / &contrast.length2).collect();
        let residuals: Vec<Vec<BigInt>> = scores
            .iter()
            .zip(&design.group)
            .map(|(row, &group)| {
                let one = |(value, sum): (&BigInt, &BigInt)| value * &common - sum * &shares[group];
                row.iter().zip(&sums[group]).map(one).collect()
            })
            .collect();
        let product = |i: usize, j: usize| -> BigInt { residuals.iter().map(|row| &row[i] * &row[j]).sum() };
        let (mut trace, mut squares) = (BigInt::zero(), BigInt::zero());
        for i in 0..d {
            for j in 0..=i {
                let own = product(i, j);
                if i == j {
                    trace += &own * &weights[i];
                }
                let both = &own * &own * &weights[i] * &weights[j];
                squares += if i == j { both } else { 2 * both };
            }
        }
        let unit2 = &design.unit * &design.unit;
        let n: usize = design.sizes.iter().sum();
        let (mut within, mut interaction) = (BigInt::zero(), BigRational::zero());
        for j in 0..d {
            let unweighted: BigInt = sums.iter().zip(&shares).map(|(sum, share)| &sum[j] * share).sum();
            within += &unweighted * &unweighted * &weights[j];
            let apart: BigInt = sums.iter().zip(&shares).map(|(sum, share)| &sum[j] * &sum[j] * share).sum();
            let total: BigInt = sums.iter().map(|sum| &sum[j]).sum();
            let apart =
                BigRational::new(apart, common.clone()) - BigRational::new(&total * &total, BigInt::from(n));
            interaction += apart * BigRational::from(weights[j].clone());
        }
        let uncertainty: BigInt = shares.iter().sum();
        let free = n - groups;
        let dimensions = d as f64;
        // Without any error sphericity has nothing to fail on.
        let gg = if squares.is_zero() {
            1.0
        } else {
            to_f64(&BigRational::new(&trace * &trace, BigInt::from(d) * &squares))
        };
        let gg = gg.clamp(1.0 / dimensions, 1.0);
        let spare = dimensions * (free as f64 - dimensions * gg);
        let hf = if spare > 0.0 { ((free as f64 + 1.0) * dimensions * gg - 2.0) / spare } else { 1.0 };
        Self {
            within: BigRational::new(within, &common * uncertainty * &lengths * &unit2),
            interaction: interaction / BigRational::from(&lengths * &unit2),
            error: BigRational::new(trace, &common * &common * &lengths * &unit2),
            dimensions: d,
            free,
            epsilon_gg: gg,
            epsilon_hf: hf.clamp(gg, 1.0),
        }
    }

    fn effect(&self, name: String, ss: &BigRational, df: usize) -> Effect {
        let error_df = self.free * self.dimensions;
        let ms = [ss / whole(df), &self.error / whole(error_df)];
        let f = (!ms[1].is_zero()).then(|| to_f64(&(&ms[0] / &ms[1])));
        let df = [df as f64, error_df as f64];
        let p = |epsilon: f64| f.and_then(|f| p_of_f(f, df[0] * epsilon, df[1] * epsilon));
        let several = self.dimensions > 1;
        let inside = |value: f64| several.then_some(value);
        Effect {
            name,
            f,
            df,
            ss: [to_f64(ss), to_f64(&self.error)],
            ms: ms.map(|ms| to_f64(&ms)),
            p: p(1.0),
            epsilon_gg: inside(self.epsilon_gg),
            epsilon_hf: inside(self.epsilon_hf),
            p_gg: if several { p(self.epsilon_gg) } else { None },
            p_hf: if several { p(self.epsilon_hf) } else { None },
            partial_eta2: share(ss, &self.error),
            generalised_eta2: None,
        }
    }
}

/// Whole weights of the cells, and the sum of their squares.
#[derive(Clone)]
struct Contrast {
    weights: Vec<BigInt>,
    length2: BigInt,
}

/// Orthogonal contrasts over the cells for one subset of the factors: Helmert's where a factor is in it, the sum where it is
/// not.
fn contrasts(levels: &[Vec<&str>], subset: usize) -> Vec<Contrast> {
    let mut all = vec![Contrast { weights: vec![BigInt::one()], length2: BigInt::one() }];
    for (i, factor) in levels.iter().enumerate() {
        let count = factor.len();
        let own: Vec<Vec<i64>> = if subset >> i & 1 == 1 {
            let row = |k: usize| {
                let weight = |column: usize| match column.cmp(&k) {
                    std::cmp::Ordering::Less => 1,
                    std::cmp::Ordering::Equal => -(k as i64),
                    std::cmp::Ordering::Greater => 0,
                };
                (0..count).map(weight).collect()
            };
            (1..count).map(row).collect()
        } else {
            vec![vec![1; count]]
        };
        let cross = |left: &Contrast, right: &Vec<i64>| Contrast {
            weights: left.weights.iter().flat_map(|a| right.iter().map(move |b| a * *b)).collect(),
            length2: &left.length2 * right.iter().map(|b| b * b).sum::<i64>(),
        };
        all = all
            .iter()
            .flat_map(|left| own.iter().map(|right| cross(left, right)).collect::<Vec<_>>())
            .collect();
    }
    all
}

fn arranged<'a>(observations: &'a [Observation], factors: usize) -> Result<Design<'a>, Error> {
    if observations.is_empty() {
        return Err(Error::TooFew { what: "observations", expected: 1, found: 0 });
    }
    let mut levels: Vec<Vec<&str>> = vec![Vec::new(); factors];
    let mut groups: Vec<Option<&str>> = Vec::new();
    let mut subjects: Vec<(&str, usize, Cells)> = Vec::new();
    let mut row_of: BTreeMap<&str, usize> = BTreeMap::new();
    let all: Vec<Decimal> = observations.iter().map(|observation| observation.value.clone()).collect();
    let Scaled { values: numbers, places } = Scaled::new(&all);
    for (observation, number) in observations.iter().zip(numbers) {
        if observation.levels.len() != factors {
            return Err(Error::Levels { expected: factors, found: observation.levels.len() });
        }
        let cell =
            levels.iter_mut().zip(&observation.levels).map(|(known, level)| place(known, level.as_str()));
        let cell: Vec<usize> = cell.collect();
        let group = place(&mut groups, observation.group.as_deref());
        let row = *row_of.entry(&observation.subject).or_insert_with(|| {
            subjects.push((&observation.subject, group, BTreeMap::new()));
            subjects.len() - 1
        });
        if subjects[row].1 != group {
            let name = |group: usize| groups[group].unwrap_or("").to_owned();
            return Err(Error::TwoGroups {
                subject: observation.subject.clone(),
                first: name(subjects[row].1),
                second: name(group),
            });
        }
        let sum = subjects[row].2.entry(cell).or_default();
        *sum = (&sum.0 + number, sum.1 + 1);
    }
    let counts = || subjects.iter().flat_map(|(_, _, own)| own.values().map(|(_, count)| *count));
    let per_cell = [counts().min().unwrap_or(0), counts().max().unwrap_or(0)];
    let counts = counts().fold(BigInt::one(), |all, count| all.lcm(&BigInt::from(count)));
    let cells: usize = levels.iter().map(Vec::len).product();
    let mut values = Vec::with_capacity(subjects.len());
    for (subject, _, own) in &subjects {
        let mut row = Vec::with_capacity(cells);
        for cell in 0..cells {
            let mut rest = cell;
            let mut indices: Vec<usize> = levels
                .iter()
                .rev()
                .map(|known| {
                    let index = rest % known.len();
                    rest /= known.len();
                    index
                })
                .collect();
            indices.reverse();
            let Some((sum, count)) = own.get(&indices) else {
                let names: Vec<&str> = indices.iter().zip(&levels).map(|(i, known)| known[*i]).collect();
                return Err(Error::MissingCell { subject: (*subject).to_owned(), cell: names.join(" × ") });
            };
            row.push(sum * (&counts / count));
        }
        values.push(row);
    }
    let group: Vec<usize> = subjects.iter().map(|(_, group, _)| *group).collect();
    let sizes = (0..groups.len()).map(|g| group.iter().filter(|own| **own == g).count()).collect();
    Ok(Design { levels, values, unit: counts * power_of_ten(places), group, sizes, per_cell })
}

fn place<T: PartialEq>(known: &mut Vec<T>, level: T) -> usize {
    known.iter().position(|own| *own == level).unwrap_or_else(|| {
        known.push(level);
        known.len() - 1
    })
}
