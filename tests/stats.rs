//! NIST's Statistical Reference Datasets: correct digits of every certified number.

use std::path::Path;

use vergence_stats::{Decimal, Table, one_way, regress};
use vergence_tests::data;

/// Correct digits (log relative error) of `found`, at most 15.
fn digits(found: f64, certified: f64) -> f64 {
    if found == certified {
        return 15.0;
    }
    let error = if certified == 0.0 { found.abs() } else { ((found - certified) / certified).abs() };
    (-error.log10()).clamp(0.0, 15.0)
}

fn read(path: &Path) -> (String, Table) {
    let text = std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let table = Table::parse(&text).expect("a data set of the collection parses");
    (text, table)
}

fn fit(table: &Table, degree: u32) -> vergence_stats::Regression {
    let y = table.decimals(0).expect("the first column is numbers");
    let mut columns: Vec<Vec<Decimal>> =
        (1..table.names.len()).map(|i| table.decimals(i).expect("every column is numbers")).collect();
    for _ in 1..degree {
        let last = &columns[columns.len() - 1];
        columns.push(last.iter().zip(&columns[0]).map(|(a, b)| a.times(b)).collect());
    }
    regress(&y, &columns, true).expect("the data sets of the collection can be fitted")
}

/// Asks for more than the bars of 12 (Norris), 10 (Longley) and 8 (Filip): the sums are exact.
const REGRESSION_DIGITS: f64 = 13.5;

#[test]
fn regression_has_the_certified_digits() {
    let Some(folder) = data().map(|data| data.join("hci/nist-strd")) else { return };
    let norris = fit(&read(&folder.join("Norris.dat")).1, 1);
    let filip = fit(&read(&folder.join("filip.csv")).1, 10);
    let longley = fit(&read(&folder.join("longley.csv")).1, 1);
    let certified = [
        ("Norris b0", norris.coefficients[0], -0.262323073774029),
        ("Norris b1", norris.coefficients[1], 1.00211681802045),
        ("Norris se1", norris.standard_errors.as_ref().unwrap()[1], 0.429796848199937E-03),
        ("Norris r2", norris.r2.unwrap(), 0.999993745883712),
        ("Norris rsd", norris.residual_sd.unwrap(), 0.884796396144373),
        ("Norris f", norris.f.unwrap(), 5436385.54079785),
        ("Longley b0", longley.coefficients[0], -3482258.63459582),
        ("Longley b1", longley.coefficients[1], 15.0618722713733),
        ("Longley b6", longley.coefficients[6], 1829.15146461355),
        ("Longley rsd", longley.residual_sd.unwrap(), 304.854073561965),
        ("Longley r2", longley.r2.unwrap(), 0.995479004577296),
        ("Filip b0", filip.coefficients[0], -1467.48961422980),
        ("Filip b10", filip.coefficients[10], -4.02962525080404E-05),
        ("Filip rsd", filip.residual_sd.unwrap(), 0.334801051324544E-02),
        ("Filip r2", filip.r2.unwrap(), 0.996727416185620),
    ];
    for (name, found, expected) in certified {
        let digits = digits(found, expected);
        println!("{name:12} {found:22.15e} {digits:5.1}");
        assert!(digits >= REGRESSION_DIGITS, "{name}: {found} has {digits:.1} digits of {expected}");
    }
}

#[test]
fn analysis_of_variance_has_the_certified_digits() {
    let Some(folder) = data().map(|data| data.join("hci/nist-strd/anova")) else { return };
    let mut seen = 0;
    for file in std::fs::read_dir(folder).unwrap() {
        let path = file.unwrap().path();
        let (text, table) = read(&path);
        let values = table.decimals(1).unwrap();
        let mut groups: std::collections::BTreeMap<&str, Vec<Decimal>> = std::collections::BTreeMap::new();
        for (level, value) in table.columns[0].iter().zip(values) {
            groups.entry(level).or_default().push(value);
        }
        let groups: Vec<Vec<Decimal>> = groups.into_values().collect();
        let result = one_way(&groups).unwrap();
        let numbers = |start: &str| -> Vec<f64> {
            let line = text.lines().find(|line| line.starts_with(start)).unwrap();
            line.split_whitespace().filter_map(|word| word.parse().ok()).collect()
        };
        let (between, within) = (numbers("Between"), numbers("Within"));
        assert_eq!(result.df.map(|df| df as f64), [between[0], within[0]]);
        let found = [(result.ms[0], between[2]), (result.ms[1], within[2]), (result.f.unwrap(), between[3])];
        let least = found.iter().map(|(found, certified)| digits(*found, *certified)).fold(15.0, f64::min);
        println!(
            "{:12} F {:22.15e} {least:5.1}",
            path.file_stem().unwrap().to_string_lossy(),
            result.f.unwrap()
        );
        // The file certifies 15 digits; the bars ask for 12, and for 10 in SmLs07-09.
        assert!(least >= 12.0, "{}: {found:?}", path.display());
        seen += 1;
    }
    assert_eq!(seen, 11);
}
