//! The speed-accuracy trade itself: what people give up in one to gain in the other.

use vergence_stats::{Moments, linear, quantile};

use std::collections::{BTreeMap, BTreeSet};

use crate::analysis::{Key, Row};
use crate::convention::{Conventions, Front};
use crate::measure::fitts::predicted_error;

/// Guiard and Rioul's weighted homographic law (2015): (y − y0)^(1−α) (x − x0)^α = k, x mean movement time (s), y
/// relative spread (SD over mean amplitude).
///
/// Where the right side is written k^α, that k is this one to the power 1/α. The values published for the table of 2011 (α .60,
/// k .070) describe its front in the form used here, and not in the other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Who {
    /// Weight of time, 0 to 1.
    pub alpha: f64,
    /// Amount of resource: smaller is better.
    pub k: f64,
    /// Asymptote of x, seconds: given, not fitted.
    pub x0_s: f64,
    /// Asymptote of y: given, not fitted.
    pub y0: f64,
    /// Which points were fitted.
    pub front: Front,
    /// How many points there were, how many are on the front, and how many of these lie beyond both asymptotes.
    pub points: [usize; 3],
    /// Of the line in logarithms.
    pub r2: Option<f64>,
}

/// The law of rows: x is each row's mean movement time, y its spread over its mean amplitude.
pub fn who_of(rows: &[Row], conventions: &Conventions) -> Option<Who> {
    who(&speeds_and_spreads(rows), conventions.who_x0_s, conventions.who_y0, conventions.who_front)
}

/// Mean movement time (s) and relative spread of the rows that have both.
pub fn speeds_and_spreads(rows: &[Row]) -> Vec<(f64, f64)> {
    let point =
        |row: &Row| Some((row.ends.mt_s?, row.ends.x.sd? / row.ends.x.amplitude.filter(|a| *a > 0.0)?));
    rows.iter().filter_map(point).collect()
}

/// Fits the front of `points` (x, y) by least squares of ln(y − y0) on ln(x − x0). None where fewer than three of its
/// points lie beyond the asymptotes, or y does not fall along it.
pub fn who(points: &[(f64, f64)], x0_s: f64, y0: f64, front: Front) -> Option<Who> {
    let chosen = front_of(points, front);
    let beyond: Vec<(f64, f64)> = chosen
        .iter()
        .map(|&i| (points[i].0 - x0_s, points[i].1 - y0))
        .filter(|(x, y)| *x > 0.0 && *y > 0.0)
        .map(|(x, y)| (x.ln(), y.ln()))
        .collect();
    if beyond.len() < 3 {
        return None;
    }
    let (x, y): (Vec<f64>, Vec<f64>) = beyond.iter().copied().unzip();
    let line = linear(&x, &y).ok()?;
    let (intercept, slope) = (line.coefficients[0], line.coefficients[1]);
    if slope >= 0.0 {
        return None;
    }
    let alpha = -slope / (1.0 - slope);
    let k = (intercept * (1.0 - alpha)).exp();
    Some(Who { alpha, k, x0_s, y0, front, points: [points.len(), chosen.len(), beyond.len()], r2: line.r2 })
}

/// The indices of the front's points, by x.
pub fn front_of(points: &[(f64, f64)], front: Front) -> Vec<usize> {
    let mut order: Vec<usize> =
        (0..points.len()).filter(|&i| points[i].0.is_finite() && points[i].1.is_finite()).collect();
    order.sort_by(|&a, &b| points[a].0.total_cmp(&points[b].0).then(points[a].1.total_cmp(&points[b].1)));
    if front == Front::All {
        return order;
    }
    let mut kept: Vec<usize> = Vec::new();
    for i in order {
        if kept.last().is_some_and(|&last| points[i].1 >= points[last].1) {
            continue;
        }
        if front == Front::Convex {
            while let [.., a, b] = kept[..] {
                let turn = (points[b].0 - points[a].0) * (points[i].1 - points[a].1)
                    - (points[b].1 - points[a].1) * (points[i].0 - points[a].0);
                if turn > 0.0 {
                    break;
                }
                kept.pop();
            }
        }
        kept.push(i);
    }
    kept
}

/// One instruction (or condition) as a whole.
#[derive(Clone, Debug, PartialEq)]
pub struct Level {
    /// Its name.
    pub name: String,
    /// How many sequences.
    pub sequences: usize,
    /// Means over the sequences: movement time (s), SD of the ends (length unit), throughput (bits/s), share of misses.
    pub mt_s: Option<f64>,
    /// As above.
    pub sd: Option<f64>,
    /// As above.
    pub tp: Option<f64>,
    /// As above.
    pub error_rate: Option<f64>,
    /// Standard deviation of the participants' mean throughputs (n − 1), bits/s.
    pub tp_sd_of_people: Option<f64>,
}

/// How steady throughput is when people trade speed for accuracy.
#[derive(Clone, Debug, PartialEq)]
pub struct Stability {
    /// One per instruction, in order of their names.
    pub levels: Vec<Level>,
    /// Coefficient of variation of the levels' throughputs (n − 1), share; none for fewer than two.
    pub cv: Option<f64>,
}

/// Means by instruction over the rows that have one.
pub fn stability(rows: &[Row]) -> Option<Stability> {
    levels_of(rows, |row| row.key.instruction.as_deref())
}

/// Means by each other factor that has more than one level.
pub(crate) fn by_factors(rows: &[Row]) -> Vec<(String, Stability)> {
    let names: BTreeSet<&String> = rows.iter().flat_map(|row| row.key.factors.keys()).collect();
    let by = |name: &String| {
        let levels = levels_of(rows, |row| row.key.factors.get(name).map(String::as_str))?;
        (levels.levels.len() > 1).then(|| (name.clone(), levels))
    };
    names.into_iter().filter_map(by).collect()
}

fn levels_of(rows: &[Row], of: impl Fn(&Row) -> Option<&str>) -> Option<Stability> {
    let mut names: Vec<&str> = rows.iter().filter_map(&of).collect();
    names.sort_unstable();
    names.dedup();
    if names.is_empty() {
        return None;
    }
    let level = |name: &str| {
        let own: Vec<&Row> = rows.iter().filter(|row| of(row) == Some(name)).collect();
        let mean = |of: &dyn Fn(&Row) -> Option<f64>| {
            own.iter().filter_map(|row| of(row)).collect::<Moments>().mean()
        };
        let mut people: BTreeMap<&str, Moments> = BTreeMap::new();
        for (row, tp) in own.iter().filter_map(|row| Some((row, row.ends.x.tp?))) {
            people.entry(&row.key.participant).or_default().push(tp);
        }
        let people: Moments = people.values().filter_map(Moments::mean).collect();
        Level {
            name: name.to_owned(),
            sequences: own.len(),
            mt_s: mean(&|row| row.ends.mt_s),
            sd: mean(&|row| row.ends.x.sd),
            tp: mean(&|row| row.ends.x.tp),
            error_rate: mean(&|row| row.ends.error_rate),
            tp_sd_of_people: people.sd(),
        }
    };
    let levels: Vec<Level> = names.into_iter().map(level).collect();
    let tps: Moments = levels.iter().filter_map(|level| level.tp).collect();
    let cv = tps.sd().zip(tps.mean()).filter(|(_, mean)| *mean > 0.0).map(|(sd, mean)| sd / mean);
    Some(Stability { levels, cv })
}

/// One bin of a conditional accuracy function.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CafBin {
    /// Mean movement time of the trials in it, seconds.
    pub mt_s: f64,
    /// Share of them that missed.
    pub error_rate: f64,
    /// Trials.
    pub n: usize,
}

/// Conditional accuracy function: trials sorted by movement time into `bins` of about the same size (edges are type-7
/// quantiles), with the share of misses in each. Empty bins are left out.
pub fn conditional_accuracy(trials: &[(f64, bool)], bins: usize) -> Vec<CafBin> {
    let times: Vec<f64> = trials.iter().map(|(mt, _)| *mt).filter(|mt| mt.is_finite()).collect();
    let mut found = Vec::new();
    let mut from = f64::NEG_INFINITY;
    for bin in 1..=bins {
        let Some(to) = quantile(&times, bin as f64 / bins as f64) else { break };
        let own: Vec<&(f64, bool)> =
            trials.iter().filter(|(mt, _)| *mt > from && (*mt <= to || bin == bins)).collect();
        let n = own.len();
        if n > 0 {
            found.push(CafBin {
                mt_s: own.iter().map(|(mt, _)| mt).sum::<f64>() / n as f64,
                error_rate: own.iter().filter(|(_, error)| *error).count() as f64 / n as f64,
                n,
            });
        }
        from = to;
    }
    found
}

/// Means of the sequences' conditional accuracy functions, bin by bin, by instruction (Vincent's averaging): what is slow
/// because it is hard, or because somebody is slow, is not compared with what is fast. Sequences of fewer trials than bins,
/// or with equal times, are left out.
pub(crate) fn mean_accuracy(
    sequences: BTreeMap<Key, Vec<(f64, bool)>>,
    bins: usize,
) -> Vec<(String, Vec<CafBin>)> {
    let mut by: BTreeMap<String, Vec<[Moments; 2]>> = BTreeMap::new();
    let mut counts: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    for (key, trials) in sequences {
        let own = conditional_accuracy(&trials, bins);
        if own.len() < bins {
            continue;
        }
        let name = key.instruction.unwrap_or_default();
        let sums = by.entry(name.clone()).or_insert_with(|| vec![<_>::default(); bins]);
        let counts = counts.entry(name).or_insert_with(|| vec![0; bins]);
        for ((sum, count), bin) in sums.iter_mut().zip(counts).zip(own) {
            sum[0].push(bin.mt_s);
            sum[1].push(bin.error_rate);
            *count += bin.n;
        }
    }
    let mean = |sum: &Moments| sum.mean().unwrap_or_default();
    let bins = |(name, sums): (String, Vec<[Moments; 2]>)| {
        let own = sums.iter().zip(&counts[&name]);
        let own = own.map(|(sum, &n)| CafBin { mt_s: mean(&sum[0]), error_rate: mean(&sum[1]), n }).collect();
        (name, own)
    };
    by.into_iter().map(bins).collect()
}

/// The error model for pointing (Wobbrock et al. 2008): predicted against observed shares of misses.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorModel {
    /// (predicted, observed) of each row that has nominal sizes.
    pub points: Vec<(f64, f64)>,
    /// observed = m · predicted + b.
    pub m: Option<f64>,
    /// As above.
    pub b: Option<f64>,
    /// Correlation.
    pub r: Option<f64>,
}

/// Predicts each row's errors from its sizes, its movement time and the line MT = a + b ID.
pub fn error_model(rows: &[Row], a: f64, b: f64) -> ErrorModel {
    let points: Vec<(f64, f64)> = rows
        .iter()
        .filter_map(|row| {
            let predicted = predicted_error(row.amplitude?, row.width?, row.ends.mt_s?, a, b)?;
            Some((predicted, row.ends.error_rate?))
        })
        .collect();
    let (x, y): (Vec<f64>, Vec<f64>) = points.iter().copied().unzip();
    let line = linear(&x, &y).ok();
    let slope = line.as_ref().map(|line| line.coefficients[1]);
    let r = line
        .as_ref()
        .and_then(|line| line.r2)
        .zip(slope)
        .map(|(r2, slope)| r2.max(0.0).sqrt() * slope.signum());
    ErrorModel { m: slope, b: line.map(|line| line.coefficients[0]), r, points }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_finds_what_made_the_points() {
        let (alpha, k, x0, y0) = (0.6, 0.07, 0.09, 0.002);
        let curve = |x: f64| y0 + (k / (x - x0).powf(alpha)).powf(1.0 / (1.0 - alpha));
        let mut points: Vec<(f64, f64)> =
            (1..20).map(|i| 0.3 + 0.1 * f64::from(i)).map(|x| (x, curve(x))).collect();
        // Worse blocks behind the front change nothing.
        points.extend((1..20).map(|i| 0.3 + 0.1 * f64::from(i)).map(|x| (x + 0.05, 3.0 * curve(x))));
        for front in [Front::Convex, Front::Pareto] {
            let fit = who(&points, x0, y0, front).unwrap();
            assert!((fit.alpha - alpha).abs() < 1e-9 && (fit.k - k).abs() < 1e-9, "{fit:?}");
            assert_eq!(fit.points[0], 38);
        }
        assert_eq!(who(&[(1.0, 1.0)], 0.0, 0.0, Front::All), None);
        assert_eq!(who(&[(1.0, 1.0), (2.0, 2.0)], 0.0, 0.0, Front::All), None);
    }

    #[test]
    fn fronts() {
        let points = [(1.0, 5.0), (2.0, 3.9), (3.0, 1.0), (2.5, 4.0), (4.0, 1.0), (f64::NAN, 0.0)];
        assert_eq!(front_of(&points, Front::Pareto), [0, 1, 2]);
        assert_eq!(front_of(&points, Front::Convex), [0, 2]);
        assert_eq!(front_of(&points, Front::All).len(), 5);
    }

    #[test]
    fn what_is_slow_because_it_is_hard_is_not_taken_for_care() {
        // In each of two conditions haste misses more; the slow one misses more altogether.
        let sequence = |slow: f64, misses: usize| -> Vec<(f64, bool)> {
            (0..50).map(|i| (slow + 0.01 * i as f64, i < misses)).collect()
        };
        let key = |condition: &str| Key { condition: condition.into(), ..Key::default() };
        let all = BTreeMap::from([(key("easy"), sequence(0.3, 5)), (key("hard"), sequence(2.0, 20))]);
        let pooled: Vec<_> = all.values().flatten().copied().collect();
        let pooled = conditional_accuracy(&pooled, 5);
        assert!(pooled[3].error_rate > pooled[1].error_rate);
        let own = mean_accuracy(all, 5);
        let rates: Vec<f64> = own[0].1.iter().map(|bin| bin.error_rate).collect();
        assert_eq!(rates, [0.75, 0.5, 0.0, 0.0, 0.0]);
        assert_eq!(own[0].1.iter().map(|bin| bin.n).sum::<usize>(), 100);
        assert!(
            mean_accuracy(BTreeMap::from([(key("short"), sequence(1.0, 1)[..4].to_vec())]), 5).is_empty()
        );
    }

    #[test]
    fn faster_trials_miss_more() {
        let trials: Vec<(f64, bool)> = (0..100).map(|i| (f64::from(i), i < 20)).collect();
        let bins = conditional_accuracy(&trials, 5);
        assert_eq!(bins.iter().map(|bin| bin.n).sum::<usize>(), 100);
        assert_eq!((bins[0].error_rate, bins[4].error_rate), (1.0, 0.0));
        assert!(conditional_accuracy(&[], 5).is_empty());
    }
}
