use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};

use crate::{Error, distribution::p_of_f};

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
    pub value: f64,
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
    /// How many observations were averaged into cells.
    pub observations: usize,
}

/// Sum and count of a subject's values in each cell.
type Cells = BTreeMap<Vec<usize>, (f64, f64)>;

struct Design<'a> {
    /// Levels of each within factor, in order of first appearance.
    levels: Vec<Vec<&'a str>>,
    /// One row per subject, one column per cell (the last factor fastest).
    values: DMatrix<f64>,
    /// The group of each row.
    group: Vec<usize>,
    groups: usize,
}

/// Within-subject factors `within` (one name per level in each observation), fully crossed, and where the observations
/// name groups a between factor `between`. Several values of a subject in a cell are averaged first. Groups may differ
/// in size: main effects are of unweighted means (type III).
///
/// # Errors
/// Where a subject lacks a cell or has two groups, fewer than two subjects per group on average, or no factor varies.
pub fn repeated(
    observations: &[Observation],
    within: &[&str],
    between: Option<&str>,
) -> Result<Repeated, Error> {
    let design = arranged(observations, within.len())?;
    let subjects = design.values.nrows();
    if subjects <= design.groups {
        return Err(Error::TooFew { what: "subjects", expected: design.groups + 1, found: subjects });
    }
    let sizes = (0..design.groups).map(|g| design.group.iter().filter(|own| **own == g).count() as f64);
    let sizes: Vec<f64> = sizes.collect();
    let mut effects: Vec<Effect> = Vec::new();
    let mut all_errors = 0.0;
    for subset in 0..1usize << within.len() {
        let scores = &design.values * contrasts(&design.levels, subset).transpose();
        let names: Vec<&str> =
            within.iter().enumerate().filter(|(i, _)| subset >> i & 1 == 1).map(|(_, name)| *name).collect();
        if scores.ncols() == 0 {
            return Err(Error::Constant { what: "levels of a within-subject factor" });
        }
        let stratum = Stratum::new(&scores, &design, &sizes);
        all_errors += stratum.error;
        if !names.is_empty() {
            effects.push(stratum.effect(names.join(" × "), stratum.within, stratum.dimensions));
        }
        if design.groups > 1 {
            let name = between.unwrap_or("group").to_owned();
            let name = names.iter().fold(name, |name, own| name + " × " + own);
            let df = stratum.dimensions * (design.groups - 1) as f64;
            effects.push(stratum.effect(name, stratum.interaction, df));
        }
    }
    if effects.is_empty() {
        return Err(Error::TooFew { what: "factors", expected: 1, found: 0 });
    }
    for effect in &mut effects {
        let whole = effect.ss[0] + all_errors;
        effect.generalised_eta2 = (whole > 0.0).then(|| effect.ss[0] / whole);
    }
    Ok(Repeated { effects, subjects, groups: design.groups, observations: observations.len() })
}

/// The part of the variance that one set of contrasts sees.
struct Stratum {
    within: f64,
    interaction: f64,
    error: f64,
    dimensions: f64,
    /// Subjects minus groups.
    free: f64,
    epsilon_gg: f64,
    epsilon_hf: f64,
}

impl Stratum {
    fn new(scores: &DMatrix<f64>, design: &Design<'_>, sizes: &[f64]) -> Self {
        let d = scores.ncols();
        let mut means = DMatrix::zeros(design.groups, d);
        for (row, &group) in scores.row_iter().zip(&design.group) {
            let mut mean = means.row_mut(group);
            mean += row / sizes[group];
        }
        let mut products = DMatrix::zeros(d, d);
        for (row, &group) in scores.row_iter().zip(&design.group) {
            let residual = row - means.row(group);
            products += residual.transpose() * residual;
        }
        let n: f64 = sizes.iter().sum();
        let groups = design.groups as f64;
        let unweighted: DVector<f64> = means.row_mean().transpose();
        let uncertainty = sizes.iter().map(|size| 1.0 / size).sum::<f64>() / (groups * groups);
        let weighted = sizes
            .iter()
            .enumerate()
            .fold(DVector::zeros(d), |sum, (g, size)| sum + means.row(g).transpose() * (size / n));
        let apart = |(g, size): (usize, &f64)| size * (means.row(g).transpose() - &weighted).norm_squared();
        let free = n - groups;
        let (trace, squares) = (products.trace(), products.norm_squared());
        let dimensions = d as f64;
        // Without any error sphericity has nothing to fail on.
        let gg = if squares > 0.0 { trace * trace / (dimensions * squares) } else { 1.0 };
        let gg = gg.clamp(1.0 / dimensions, 1.0);
        let spare = dimensions * (free - dimensions * gg);
        let hf = if spare > 0.0 { ((free + 1.0) * dimensions * gg - 2.0) / spare } else { 1.0 };
        Self {
            within: unweighted.norm_squared() / uncertainty,
            interaction: sizes.iter().enumerate().map(apart).sum(),
            error: trace,
            dimensions,
            free,
            epsilon_gg: gg,
            epsilon_hf: hf.clamp(gg, 1.0),
        }
    }

    fn effect(&self, name: String, ss: f64, df: f64) -> Effect {
        let df = [df, self.free * self.dimensions];
        let ms = [ss / df[0], self.error / df[1]];
        let f = (ms[1] > 0.0).then(|| ms[0] / ms[1]);
        let p = |epsilon: f64| f.and_then(|f| p_of_f(f, df[0] * epsilon, df[1] * epsilon));
        let several = self.dimensions > 1.0;
        let inside = |value: f64| several.then_some(value);
        Effect {
            name,
            f,
            df,
            ss: [ss, self.error],
            ms,
            p: p(1.0),
            epsilon_gg: inside(self.epsilon_gg),
            epsilon_hf: inside(self.epsilon_hf),
            p_gg: if several { p(self.epsilon_gg) } else { None },
            p_hf: if several { p(self.epsilon_hf) } else { None },
            partial_eta2: (ss + self.error > 0.0).then(|| ss / (ss + self.error)),
            generalised_eta2: None,
        }
    }
}

/// Orthonormal contrasts over the cells for one subset of the factors: Helmert's where a factor is in it, the mean
/// (times the root of its levels) where it is not.
fn contrasts(levels: &[Vec<&str>], subset: usize) -> DMatrix<f64> {
    let mut product = DMatrix::from_element(1, 1, 1.0);
    for (i, factor) in levels.iter().enumerate() {
        let count = factor.len();
        let own = if subset >> i & 1 == 1 {
            DMatrix::from_fn(count.saturating_sub(1), count, |row, column| {
                let k = (row + 1) as f64;
                let norm = (k * (k + 1.0)).sqrt();
                match column {
                    c if c <= row => 1.0 / norm,
                    c if c == row + 1 => -k / norm,
                    _ => 0.0,
                }
            })
        } else {
            DMatrix::from_element(1, count, 1.0 / (count as f64).sqrt())
        };
        product = product.kronecker(&own);
    }
    product
}

fn arranged<'a>(observations: &'a [Observation], factors: usize) -> Result<Design<'a>, Error> {
    if observations.is_empty() {
        return Err(Error::TooFew { what: "observations", expected: 1, found: 0 });
    }
    let mut levels: Vec<Vec<&str>> = vec![Vec::new(); factors];
    let mut groups: Vec<Option<&str>> = Vec::new();
    let mut subjects: Vec<(&str, usize, Cells)> = Vec::new();
    let mut row_of: BTreeMap<&str, usize> = BTreeMap::new();
    // Deviations from one value keep a common offset out of the sums of squares.
    let offset = observations[0].value;
    for observation in observations {
        if observation.levels.len() != factors {
            return Err(Error::Levels { expected: factors, found: observation.levels.len() });
        }
        if !observation.value.is_finite() {
            return Err(Error::NotANumber { found: observation.value.to_string() });
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
        *sum = (sum.0 + observation.value - offset, sum.1 + 1.0);
    }
    let cells: usize = levels.iter().map(Vec::len).product();
    let mut values = DMatrix::zeros(subjects.len(), cells);
    for (row, (subject, _, own)) in subjects.iter().enumerate() {
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
            values[(row, cell)] = sum / count;
        }
    }
    let mean = values.mean();
    values.add_scalar_mut(-mean);
    let group = subjects.iter().map(|(_, group, _)| *group).collect();
    Ok(Design { levels, values, group, groups: groups.len() })
}

fn place<T: PartialEq>(known: &mut Vec<T>, level: T) -> usize {
    known.iter().position(|own| *own == level).unwrap_or_else(|| {
        known.push(level);
        known.len() - 1
    })
}
