//! Laws of the fits and the tables, against textbook numbers and against each other.

use proptest::prelude::*;
use vergence_stats::{Decimal, Error, Observation, linear, one_way, regress, repeated};

fn exact(values: &[f64]) -> Vec<Decimal> {
    values.iter().map(|value| Decimal::from_f64(*value).expect("a number that is finite")).collect()
}

fn observation(subject: usize, group: Option<&str>, levels: &[usize], value: f64) -> Observation {
    let levels = levels.iter().map(usize::to_string).collect();
    let value = Decimal::from_f64(value).expect("a number that is finite");
    Observation { subject: subject.to_string(), group: group.map(str::to_owned), levels, value }
}

fn near(found: f64, expected: f64) {
    assert!((found - expected).abs() < 1e-9 * expected.abs().max(1.0), "{found} instead of {expected}");
}

#[test]
fn fits_without_noise_or_freedom() {
    let line = linear(&[1.0, 2.0, 3.0], &[1.0, 3.0, 5.0]).unwrap();
    assert_eq!((line.coefficients.as_slice(), line.r2, line.f), ([-1.0, 2.0].as_slice(), Some(1.0), None));
    let two = linear(&[1.0, 2.0], &[1.0, 3.0]).unwrap();
    assert_eq!((two.residual_sd, two.standard_errors.clone(), two.p_of(1)), (None, None, None));
    let flat = linear(&[1.0, 2.0, 3.0], &[4.0, 4.0, 4.0]).unwrap();
    assert_eq!((flat.r2, flat.f, flat.coefficients[1]), (None, None, 0.0));
    assert!(matches!(linear(&[1.0], &[1.0]), Err(Error::TooFew { .. })));
    assert!(matches!(linear(&[2.0, 2.0, 2.0], &[1.0, 2.0, 3.0]), Err(Error::Dependent { column: 1 })));
    assert!(matches!(linear(&[f64::NAN, 1.0], &[1.0, 2.0]), Err(Error::NotANumber { .. })));
    assert!(matches!(linear(&[1.0, 2.0], &[1.0]), Err(Error::Length { .. })));
    // The extremes of a double's range are no harder than its middle.
    let wide = linear(&[1e-300, 2e-300, 4e-300], &[1e300, 2e300, 4e300]).unwrap();
    assert!(wide.coefficients[1].is_infinite() && wide.r2 == Some(1.0));
    let far = linear(&[1e15, 1e15 + 1.0, 1e15 + 2.0], &[0.0, 1.0, 2.0]).unwrap();
    assert_eq!(far.coefficients, [-1e15, 1.0]);
}

#[test]
fn a_plane_has_its_numbers() {
    let (a, b) = ([1.0, 2.0, 3.0, 4.0, 5.0], [2.0, 1.0, 4.0, 3.0, 6.0]);
    let y = [3.1, 3.9, 7.2, 7.8, 11.1];
    let fit = regress(&exact(&y), &[exact(&a), exact(&b)], true).unwrap();
    let rss: f64 = (0..5)
        .map(|i| y[i] - fit.coefficients[0] - fit.coefficients[1] * a[i] - fit.coefficients[2] * b[i])
        .map(|r| r * r)
        .sum();
    near(fit.rss, rss);
    near(fit.residual_sd.unwrap(), (rss / 2.0).sqrt());
    let (low, high) = fit.interval(1, 0.95).unwrap();
    near((high - low) / 2.0, 4.302652729911275 * fit.standard_errors.as_ref().unwrap()[1]);
    let through_zero = regress(&exact(&[2.0, 4.1]), &[exact(&[1.0, 2.0])], false).unwrap();
    near(through_zero.coefficients[0], 10.2 / 5.0);
    assert_eq!(through_zero.df, [1, 1]);
}

#[test]
fn groups_without_variance() {
    let same = one_way(&[exact(&[1.0, 1.0]), exact(&[2.0, 2.0])]).unwrap();
    assert_eq!((same.f, same.eta2, same.cohen_f), (None, Some(1.0), None));
    assert!(one_way(&[exact(&[1.0, 2.0]), Vec::new()]).is_err());
    assert!(one_way(&[exact(&[1.0]), exact(&[2.0])]).is_err());
}

#[test]
fn within_subjects_is_the_textbook_table() {
    // Two-way layout by hand: SS rows, columns and rest of a 4 × 3 table.
    let table = [[45.0, 50.0, 55.0], [42.0, 42.0, 45.0], [36.0, 41.0, 43.0], [39.0, 35.0, 40.0]];
    let observations: Vec<Observation> =
        (0..4).flat_map(|s| (0..3).map(move |c| observation(s, None, &[c], table[s][c]))).collect();
    let result = repeated(&observations, &["time"], None).unwrap();
    let grand = table.iter().flatten().sum::<f64>() / 12.0;
    let column = |c: usize| table.iter().map(|row| row[c]).sum::<f64>() / 4.0;
    let row = |s: usize| table[s].iter().sum::<f64>() / 3.0;
    let between: f64 = (0..3).map(|c| 4.0 * (column(c) - grand).powi(2)).sum();
    let error: f64 = (0..4)
        .flat_map(|s| (0..3).map(move |c| (s, c)))
        .map(|(s, c)| (table[s][c] - row(s) - column(c) + grand).powi(2))
        .sum();
    let effect = &result.effects[0];
    near(effect.ss[0], between);
    near(effect.ss[1], error);
    assert_eq!(effect.df, [2.0, 6.0]);
    let epsilon = effect.epsilon_gg.unwrap();
    assert!((0.5..=1.0).contains(&epsilon) && effect.p_gg.unwrap() >= effect.p.unwrap());
    // Box's formula from the covariance matrix of the three columns.
    let cov = |a: usize, b: usize| {
        (0..4).map(|s| (table[s][a] - column(a)) * (table[s][b] - column(b))).sum::<f64>() / 3.0
    };
    let mean_diagonal = (0..3).map(|i| cov(i, i)).sum::<f64>() / 3.0;
    let mean_all = (0..9).map(|i| cov(i / 3, i % 3)).sum::<f64>() / 9.0;
    let mean_row = |i: usize| (0..3).map(|j| cov(i, j)).sum::<f64>() / 3.0;
    let squares: f64 = (0..9).map(|i| cov(i / 3, i % 3).powi(2)).sum();
    let rows: f64 = (0..3).map(|i| mean_row(i).powi(2)).sum();
    let top = 9.0 * (mean_diagonal - mean_all).powi(2);
    near(epsilon, top / (2.0 * (squares - 6.0 * rows + 9.0 * mean_all * mean_all)));
}

#[test]
fn two_levels_are_a_paired_t() {
    let (a, b) = ([5.1, 6.2, 7.9, 4.4, 6.6], [5.9, 6.8, 8.1, 5.6, 6.4]);
    let observations: Vec<Observation> =
        (0..5).flat_map(|s| [observation(s, None, &[0], a[s]), observation(s, None, &[1], b[s])]).collect();
    let effect = &repeated(&observations, &["tool"], None).unwrap().effects[0];
    let differences: vergence_stats::Moments = (0..5).map(|s| b[s] - a[s]).collect();
    let t = differences.mean().unwrap() / (differences.sd().unwrap() / 5f64.sqrt());
    near(effect.f.unwrap(), t * t);
    assert_eq!(effect.epsilon_gg, None);
}

#[test]
fn a_mixed_design_splits_its_sums() {
    // Balanced: the between line is a one-way analysis of subject means, times the number of cells.
    let values = [
        [3.0, 5.0, 9.0],
        [2.0, 6.0, 7.0],
        [4.0, 4.0, 8.0],
        [6.0, 7.0, 8.0],
        [7.0, 9.0, 9.0],
        [5.0, 8.0, 7.0],
    ];
    let group = |s: usize| if s < 3 { "novice" } else { "expert" };
    let observations: Vec<Observation> = (0..6)
        .flat_map(|s| (0..3).map(move |c| observation(s, Some(group(s)), &[c], values[s][c])))
        .collect();
    let result = repeated(&observations, &["width"], Some("skill")).unwrap();
    let names: Vec<&str> = result.effects.iter().map(|effect| effect.name.as_str()).collect();
    assert_eq!(names, ["skill", "width", "skill × width"]);
    let means: Vec<f64> = values.iter().map(|row| row.iter().sum::<f64>() / 3.0).collect();
    let between = one_way(&[exact(&means[..3]), exact(&means[3..])]).unwrap();
    near(result.effects[0].f.unwrap(), between.f.unwrap());
    assert_eq!(result.effects[0].df, [1.0, 4.0]);
    assert_eq!(result.effects[2].df, [2.0, 8.0]);
    let all: Vec<f64> = values.iter().flatten().copied().collect();
    let grand = all.iter().sum::<f64>() / 18.0;
    let total: f64 = all.iter().map(|value| (value - grand).powi(2)).sum();
    let parts: f64 = result.effects.iter().map(|e| e.ss[0]).sum::<f64>()
        + result.effects[0].ss[1]
        + result.effects[1].ss[1];
    near(parts, total);
}

#[test]
fn repeated_measures_are_exact_whatever_offset_they_share() {
    // 10 subjects in three conditions, two decimals; F in exact fractions by the sums of squares of the two-way table.
    let hundredths: Vec<[i64; 3]> =
        (0..10).map(|s: i64| [s * 37 % 101, 40 + s * 53 % 97, 20 + s * 71 % 89]).collect();
    let row = |s: usize| hundredths[s].iter().sum::<i64>();
    let column = |c: usize| hundredths.iter().map(|row| row[c]).sum::<i64>();
    let all: i64 = (0..3).map(column).sum();
    let squares: i64 = hundredths.iter().flatten().map(|value| value * value).sum();
    // Times 30.
    let columns = 3 * (0..3).map(|c| column(c).pow(2)).sum::<i64>() - all * all;
    let rows = 10 * (0..10).map(|s| row(s).pow(2)).sum::<i64>() - all * all;
    let error = 30 * squares - all * all - columns - rows;
    let expected = (columns * 18) as f64 / (error * 2) as f64;
    for offset in ["", "1000000", "1000000000000", "100000000000000000000"] {
        let observations: Vec<Observation> = (0..30)
            .map(|i| {
                let value = format!("{offset}{:03}", hundredths[i / 3][i % 3] + 100);
                let (whole, decimals) = value.split_at(value.len() - 2);
                let value: Decimal = format!("{whole}.{decimals}").parse().unwrap();
                Observation { value, ..observation(i / 3, None, &[i % 3], 0.0) }
            })
            .collect();
        let effect = &repeated(&observations, &["w"], None).unwrap().effects[0];
        assert_eq!(effect.f, Some(expected), "offset {offset}");
    }
}

#[test]
fn without_error_there_is_no_f() {
    // Subjects differ by a constant that no double has, and by nothing else.
    let observations: Vec<Observation> = (0..12)
        .map(|i| {
            let value: Decimal = format!("{}.{}", i / 3, [1, 2, 7][i % 3]).parse().unwrap();
            Observation { value, ..observation(i / 3, None, &[i % 3], 0.0) }
        })
        .collect();
    let effect = &repeated(&observations, &["w"], None).unwrap().effects[0];
    assert_eq!((effect.f, effect.p, effect.partial_eta2), (None, None, Some(1.0)));
    assert_eq!((effect.ss[1], effect.epsilon_gg), (0.0, Some(1.0)));
}

#[test]
fn several_values_in_a_cell_are_averaged_and_counted() {
    let single = [[1.0, 2.5], [2.0, 4.0], [4.0, 4.5]];
    let one: Vec<Observation> =
        (0..6).map(|i| observation(i / 2, None, &[i % 2], single[i / 2][i % 2])).collect();
    // The same means of one, two or three rows.
    let mut many = one.clone();
    for i in [1, 2, 2] {
        let value = single[i / 2][i % 2];
        many.push(observation(i / 2, None, &[i % 2], value));
    }
    many.push(observation(0, None, &[0], 0.0));
    many.push(observation(0, None, &[0], 2.0));
    let (one, many) = (repeated(&one, &["w"], None).unwrap(), repeated(&many, &["w"], None).unwrap());
    assert_eq!(one.effects, many.effects);
    assert_eq!((one.per_cell, many.per_cell, many.observations), ([1, 1], [1, 3], 11));
}

#[test]
fn broken_designs_are_named() {
    let whole =
        [observation(1, None, &[0], 1.0), observation(1, None, &[1], 2.0), observation(2, None, &[0], 3.0)];
    let error = repeated(&whole, &["w"], None).unwrap_err();
    assert_eq!(error, Error::MissingCell { subject: "2".into(), cell: "1".into() });
    let two = [observation(1, Some("a"), &[0], 1.0), observation(1, Some("b"), &[1], 2.0)];
    assert!(matches!(repeated(&two, &["w"], Some("g")), Err(Error::TwoGroups { .. })));
    assert!(matches!(repeated(&whole, &["w", "v"], None), Err(Error::Levels { .. })));
    assert!(matches!(repeated(&[], &["w"], None), Err(Error::TooFew { .. })));
    let one = [observation(1, None, &[0], 1.0), observation(2, None, &[0], 2.0)];
    assert!(matches!(repeated(&one, &["w"], None), Err(Error::Constant { .. })));
}

proptest! {
    #[test]
    fn an_offset_changes_no_f(values in prop::collection::vec(0u32..100, 12), offset in 0u64..1_000_000_000_000) {
        let group = |from: usize, add: u64| -> Vec<Decimal> {
            values[from..from + 4].iter().map(|v| format!("{}.{v:02}", add).parse().unwrap()).collect()
        };
        let plain = one_way(&[group(0, 0), group(4, 0), group(8, 0)]).unwrap();
        let moved = one_way(&[group(0, offset), group(4, offset), group(8, offset)]).unwrap();
        prop_assert_eq!((plain.f, plain.ss), (moved.f, moved.ss));
    }

    #[test]
    fn residuals_are_orthogonal(points in prop::collection::vec((-9.0..9.0f64, -9.0..9.0f64), 3..20)) {
        let (x, y): (Vec<f64>, Vec<f64>) = points.into_iter().unzip();
        if let Ok(line) = linear(&x, &y) {
            let residual = |i: usize| y[i] - line.coefficients[0] - line.coefficients[1] * x[i];
            prop_assert!((0..x.len()).map(residual).sum::<f64>().abs() < 1e-6);
            prop_assert!((0..x.len()).map(|i| residual(i) * x[i]).sum::<f64>().abs() < 1e-5);
            prop_assert!(line.r2.is_none_or(|r2| (0.0..=1.0).contains(&r2)));
        }
    }

    #[test]
    fn repeated_never_panics(values in prop::collection::vec(-1e6..1e6f64, 12), same in any::<bool>()) {
        let observations: Vec<Observation> = (0..12)
            .map(|i| observation(i / 4, Some(if i < 4 { "a" } else { "b" }), &[i % 2, i / 2 % 2], if same { 1.0 } else { values[i] }))
            .collect();
        let result = repeated(&observations, &["v", "w"], Some("g")).unwrap();
        prop_assert_eq!(result.effects.len(), 7);
        for effect in &result.effects {
            prop_assert!(effect.p.is_none_or(|p| (0.0..=1.0).contains(&p)));
        }
    }
}
