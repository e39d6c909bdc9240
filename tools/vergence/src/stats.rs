//! `vergence stats`: regression and analysis of variance over a file of numbers.

use std::path::{Path, PathBuf};

use clap::Subcommand;
use serde_json::json;
use vergence_report::{Cell, Column, Table as Printed};
use vergence_stats::{Decimal, Observation, Table, one_way, regress, repeated};

use crate::failure::Failure;

/// Regression and analysis of variance, exact to the last digit
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand)]
enum What {
    /// Linear least squares: coefficients, standard errors, R², residual SD, F
    ///
    /// FILE is CSV (comma, semicolon or tab), columns between blanks, or a NIST StRD .dat, which also says its model.
    Regress(Regress),
    /// Analysis of variance: one-way, within subjects (Greenhouse–Geisser), or mixed
    ///
    /// FILE as for `regress`. Without --within the groups are independent (--between, default: the first column); with
    /// --within the table has one row per subject and cell, and --between makes the design mixed.
    Anova(Anova),
}

#[derive(clap::Args)]
struct Regress {
    /// Rows of numbers
    file: PathBuf,
    /// Column that is explained; default: the first
    #[arg(long, value_name = "COLUMN")]
    response: Option<String>,
    /// Columns that explain it, by comma; default: all others
    #[arg(long, value_name = "COLUMNS", value_delimiter = ',')]
    predictors: Vec<String>,
    /// Powers of the one predictor up to this; default: 1, or what a NIST file says
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=30))]
    degree: Option<u32>,
    /// Through the origin
    #[arg(long)]
    no_intercept: bool,
    /// Print one JSON object at the end instead of a table
    #[arg(long)]
    json: bool,
}

#[derive(clap::Args)]
struct Anova {
    /// Rows of levels and numbers
    file: PathBuf,
    /// Column that is analysed; default: the last
    #[arg(long, value_name = "COLUMN")]
    response: Option<String>,
    /// Column that names each row's group; default: the first, where there is no --within
    #[arg(long, value_name = "COLUMN")]
    between: Option<String>,
    /// Columns with levels that every subject went through, by comma
    #[arg(long, value_name = "COLUMNS", value_delimiter = ',')]
    within: Vec<String>,
    /// Column that names the subject; needed with --within
    #[arg(long, value_name = "COLUMN", requires = "within")]
    subject: Option<String>,
    /// Print one JSON object at the end instead of a table
    #[arg(long)]
    json: bool,
}

impl Args {
    /// Reads, computes and prints.
    pub fn run(self) -> Result<(), Failure> {
        match self.what {
            What::Regress(verb) => verb.run(),
            What::Anova(verb) => verb.run(),
        }
    }
}

fn read(file: &Path) -> Result<Table, Failure> {
    let text = std::fs::read_to_string(file)
        .map_err(|error| Failure::Call(format!("{}: {error}", file.display())))?;
    Table::parse(&text).map_err(|error| in_file(file, &error))
}

fn in_file(file: &Path, error: &vergence_stats::Error) -> Failure {
    let place = match error {
        // As compilers do it, so that editors find the place.
        vergence_stats::Error::Table { line, message } => format!("{}:{line}: {message}", file.display()),
        other => format!("{}: {other}", file.display()),
    };
    Failure::Work(place)
}

/// The product of two columns, exactly: powers of a predictor must not be rounded before they are summed.
fn product(a: &[Decimal], b: &[Decimal]) -> Vec<Decimal> {
    a.iter().zip(b).map(|(a, b)| a.times(b)).collect()
}

fn number(value: Option<f64>) -> Cell {
    value.map_or(Cell::Empty, |value| Cell::Text(short(value)))
}

/// Eight significant digits.
fn short(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 || (1e-4..1e9).contains(&size) {
        let decimals = if value == 0.0 { 0 } else { (7 - size.log10().floor() as i32).max(0) as usize };
        format!("{value:.decimals$}")
    } else {
        format!("{value:.7e}")
    }
}

impl Regress {
    fn run(self) -> Result<(), Failure> {
        let table = read(&self.file)?;
        let fail = |error: vergence_stats::Error| in_file(&self.file, &error);
        let response = self.response.as_deref().map_or(Ok(0), |name| table.column(name)).map_err(fail)?;
        let mut predictors = if self.predictors.is_empty() {
            (0..table.names.len()).filter(|i| *i != response).collect()
        } else {
            self.predictors
                .iter()
                .map(|name| table.column(name))
                .collect::<Result<Vec<_>, _>>()
                .map_err(fail)?
        };
        predictors.dedup();
        let y = table.decimals(response).map_err(fail)?;
        let mut columns = Vec::new();
        let mut names = Vec::new();
        for i in predictors {
            columns.push(table.decimals(i).map_err(fail)?);
            names.push(table.names[i].clone());
        }
        let degree = self.degree.or(table.degree).unwrap_or(1);
        if degree > 1 {
            let [x] = columns.as_slice() else {
                let message = format!("--degree {degree} expects one predictor, found {}", columns.len());
                return Err(Failure::Call(message));
            };
            let x = x.clone();
            for power in 2..=degree {
                columns.push(product(&columns[columns.len() - 1], &x));
                names.push(format!("{}^{power}", names[0]));
            }
        }
        let intercept = !self.no_intercept && table.intercept;
        let fit = regress(&y, &columns, intercept).map_err(fail)?;
        if intercept {
            names.insert(0, "(intercept)".to_owned());
        }
        if self.json {
            let intervals: Option<Vec<_>> = (0..names.len()).map(|i| fit.interval(i, 0.95)).collect();
            let object = json!({
                "response": table.names[response], "names": names, "n": fit.n,
                "coefficients": fit.coefficients, "standard_errors": fit.standard_errors,
                "intervals_95": intervals, "r2": fit.r2, "adjusted_r2": fit.adjusted_r2,
                "residual_sd": fit.residual_sd, "f": fit.f, "p": fit.p, "df": fit.df, "rss": fit.rss,
            });
            println!("{object}");
            return Ok(());
        }
        let titles = ["", "estimate", "standard error", "t", "p", "95 % from", "to"];
        let mut printed = Printed::new(titles.iter().map(|title| Column::new(*title, 0)).collect());
        for (i, name) in names.iter().enumerate() {
            let error = fit.standard_errors.as_ref().map(|errors| errors[i]);
            let t = error.filter(|error| *error > 0.0).map(|error| fit.coefficients[i] / error);
            let interval = fit.interval(i, 0.95);
            printed.push(
                vec![
                    Cell::Text(name.clone()),
                    number(Some(fit.coefficients[i])),
                    number(error),
                    number(t),
                    number(fit.p_of(i)),
                    number(interval.map(|(low, _)| low)),
                    number(interval.map(|(_, high)| high)),
                ],
                false,
            );
        }
        print!("{}", printed.to_text());
        let shown = |value: Option<f64>| value.map_or_else(|| "–".to_owned(), short);
        println!(
            "\n{}, n = {}: R² = {}, residual SD = {}, F({}, {}) = {}, p = {}",
            table.names[response],
            fit.n,
            shown(fit.r2),
            shown(fit.residual_sd),
            fit.df[0],
            fit.df[1],
            shown(fit.f),
            shown(fit.p)
        );
        Ok(())
    }
}

impl Anova {
    fn run(self) -> Result<(), Failure> {
        let table = read(&self.file)?;
        let fail = |error: vergence_stats::Error| in_file(&self.file, &error);
        let last = table.names.len() - 1;
        let response = self.response.as_deref().map_or(Ok(last), |name| table.column(name)).map_err(fail)?;
        if self.within.is_empty() { self.one_way(&table, response) } else { self.repeated(&table, response) }
    }

    fn one_way(&self, table: &Table, response: usize) -> Result<(), Failure> {
        let fail = |error: vergence_stats::Error| in_file(&self.file, &error);
        let first = (0..table.names.len()).find(|i| *i != response).unwrap_or(0);
        let factor = self.between.as_deref().map_or(Ok(first), |name| table.column(name)).map_err(fail)?;
        if factor == response {
            return Err(Failure::Call(
                "expected a column of levels and one of numbers, found one column".to_owned(),
            ));
        }
        let values = table.decimals(response).map_err(fail)?;
        let mut levels: Vec<&str> = Vec::new();
        let mut groups: Vec<Vec<Decimal>> = Vec::new();
        for (level, value) in table.columns[factor].iter().zip(values) {
            let place = levels.iter().position(|own| own == level).unwrap_or_else(|| {
                levels.push(level);
                groups.push(Vec::new());
                levels.len() - 1
            });
            groups[place].push(value);
        }
        let result = one_way(&groups).map_err(fail)?;
        if self.json {
            let object = json!({
                "factor": table.names[factor], "response": table.names[response], "levels": levels,
                "sizes": result.sizes, "means": result.means,
                "f": result.f, "p": result.p, "df": result.df, "ms": result.ms, "ss": result.ss,
                "residual_sd": result.residual_sd, "r2": result.eta2,
                "eta2": result.eta2, "omega2": result.omega2, "cohen_f": result.cohen_f,
            });
            println!("{object}");
            return Ok(());
        }
        let titles = ["", "df", "SS", "MS", "F", "p", "η²", "ω²"];
        let mut printed = Printed::new(titles.iter().map(|title| Column::new(*title, 0)).collect());
        let line = |name: &str, i: usize| {
            vec![
                Cell::Text(name.to_owned()),
                Cell::Text(result.df[i].to_string()),
                number(Some(result.ss[i])),
                number(Some(result.ms[i])),
            ]
        };
        let effect = [number(result.f), number(result.p), number(result.eta2), number(result.omega2)];
        printed.push([line(&table.names[factor], 0), effect.to_vec()].concat(), false);
        printed.push(line("residual", 1), false);
        print!("{}", printed.to_text());
        Ok(())
    }

    fn repeated(&self, table: &Table, response: usize) -> Result<(), Failure> {
        let fail = |error: vergence_stats::Error| in_file(&self.file, &error);
        let Some(subject) = &self.subject else {
            return Err(Failure::Call("--within expects --subject COLUMN".to_owned()));
        };
        let subject = table.column(subject).map_err(fail)?;
        let within: Vec<usize> =
            self.within.iter().map(|name| table.column(name)).collect::<Result<_, _>>().map_err(fail)?;
        let between = self.between.as_deref().map(|name| table.column(name)).transpose().map_err(fail)?;
        let values = table.decimals(response).map_err(fail)?;
        let observations: Vec<Observation> = values
            .iter()
            .enumerate()
            .map(|(row, value)| Observation {
                subject: table.columns[subject][row].clone(),
                group: between.map(|column| table.columns[column][row].clone()),
                levels: within.iter().map(|column| table.columns[*column][row].clone()).collect(),
                value: value.clone(),
            })
            .collect();
        let names: Vec<&str> = self.within.iter().map(String::as_str).collect();
        let result = repeated(&observations, &names, self.between.as_deref()).map_err(fail)?;
        if self.json {
            let effects: Vec<_> = result
                .effects
                .iter()
                .map(|e| {
                    json!({
                        "name": e.name, "f": e.f, "df": e.df, "ss": e.ss, "ms": e.ms, "p": e.p,
                        "epsilon_gg": e.epsilon_gg, "p_gg": e.p_gg, "epsilon_hf": e.epsilon_hf, "p_hf": e.p_hf,
                        "partial_eta2": e.partial_eta2, "generalised_eta2": e.generalised_eta2,
                    })
                })
                .collect();
            let first = &result.effects[0];
            let object = json!({
                "response": table.names[response], "subjects": result.subjects, "groups": result.groups,
                "observations": result.observations, "per_cell": result.per_cell,
                "f": first.f, "df": first.df, "ms": first.ms, "ss": first.ss, "p": first.p, "effects": effects,
            });
            println!("{object}");
            return Ok(());
        }
        let titles = [
            "",
            "df",
            "df error",
            "F",
            "p",
            "ε (GG)",
            "p (GG)",
            "ε (HF)",
            "p (HF)",
            "η² partial",
            "η² general",
        ];
        let mut printed = Printed::new(titles.iter().map(|title| Column::new(*title, 0)).collect());
        for e in &result.effects {
            let row = vec![
                Cell::Text(e.name.clone()),
                Cell::Text(e.df[0].to_string()),
                Cell::Text(e.df[1].to_string()),
                number(e.f),
                number(e.p),
                number(e.epsilon_gg),
                number(e.p_gg),
                number(e.epsilon_hf),
                number(e.p_hf),
                number(e.partial_eta2),
                number(e.generalised_eta2),
            ];
            printed.push(row, false);
        }
        print!("{}", printed.to_text());
        let averaged = match result.per_cell {
            [1, 1] => String::new(),
            [least, most] if least == most => format!(", means of {most} for each subject and cell"),
            [least, most] => format!(", means of {least} to {most} for each subject and cell"),
        };
        println!(
            "\n{} subjects, {} groups, {} observations{averaged}",
            result.subjects, result.groups, result.observations
        );
        Ok(())
    }
}
