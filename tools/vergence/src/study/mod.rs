//! `vergence study`: study files, sittings, recordings of other tools, analysis, report.

mod parquet;
mod run;
mod sql;
mod status;

use std::collections::BTreeSet;
use std::fs::File;
use std::path::{Path, PathBuf};

use clap::{Subcommand, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;
use vergence_experiment::Kind;
use vergence_report::{Cell, Column, Table};
use vergence_study::{
    Alternative, Analysis, ColumnMap, Conventions, Difficulty, Error, Imported, Maps, Study, TEMPLATE, Tool,
    alternatives, analyse, analyse_trials, conditions_csv, factor_column, import, page, stream, summary_json,
    together, trials_csv,
};

use crate::failure::Failure;

/// Tables larger than this are analysed in one pass, without keeping their trials.
const STREAM_BYTES: u64 = 64 << 20;
/// So many times fewer bytes than the text a table takes as Parquet.
const PARQUET_SHRINKS: u64 = 4;

/// Plans, reads and analyses studies of pointing
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand)]
enum What {
    /// Writes a commented study file
    New(New),
    /// Says what is wrong with a study file, and how many trials, minutes and participants it means
    Check(Check),
    Run(Box<run::Run>),
    Status(status::Status),
    Delete(status::Delete),
    /// Effective measures, throughput, paths, speed against accuracy
    ///
    /// A study's folder, or logs of sittings (.mcap), by the conventions that they name.
    /// Recordings of FittsStudy (.csv, .txt, .xml), 3DFitts (.json), GoFitts (.sd1, .sd3) and tables with a column map are
    /// told apart by their content and analysed by the conventions of their tool, which the options replace one by one.
    /// Tables above 64 MiB are analysed in one pass. Builds with --features parquet read .parquet as they read .csv.
    Analyze(Analyze),
    /// One self-contained HTML page: plots, tables, methods, exclusions
    Report(Report),
    /// Turns recordings of another tool into a log, or into a table of trials that needs no map
    Import(Import),
}

impl Args {
    /// Runs it.
    pub fn run(self) -> Result<(), Failure> {
        match self.what {
            What::New(verb) => verb.run(),
            What::Check(verb) => verb.run(),
            What::Run(verb) => verb.run(),
            What::Status(verb) => verb.run(),
            What::Delete(verb) => verb.run(),
            What::Analyze(verb) => verb.run(),
            What::Report(verb) => verb.run(),
            What::Import(verb) => verb.run(),
        }
    }
}

#[derive(clap::Args)]
struct New {
    /// Study file to write
    file: PathBuf,
    /// Replace it where it is there
    #[arg(long)]
    force: bool,
}

impl New {
    fn run(self) -> Result<(), Failure> {
        if self.file.exists() && !self.force {
            return Err(Failure::Call(format!(
                "{} is there already (--force replaces it)",
                self.file.display()
            )));
        }
        write(&self.file, TEMPLATE)?;
        println!("{}", self.file.display());
        Ok(())
    }
}

#[derive(clap::Args)]
struct Check {
    /// Study file
    file: PathBuf,
    /// Print one JSON object at the end instead of text
    #[arg(long)]
    json: bool,
}

impl Check {
    fn run(self) -> Result<(), Failure> {
        let study = Study::parse(&self.file, &text_of(&self.file)?)
            .map_err(|error| Failure::Work(error.to_string()))?;
        let each = (study.practice + study.per_condition) * study.repetitions;
        let conditions = study.conditions().len();
        let trials = conditions * study.instructions.len() * each as usize;
        let (minutes, balanced, warnings) =
            (study.session_s() / 60.0, study.balanced_after(), study.warnings());
        if self.json {
            let object = json!({
                "name": study.name, "conditions": conditions, "instructions": study.instructions.len(),
                "trials_per_participant": trials, "minutes_per_participant": minutes, "participants": study.participants,
                "balanced_after": balanced, "warnings": warnings,
            });
            println!("{object}");
            return Ok(());
        }
        println!(
            "{}: {conditions} conditions × {} instructions × {each} trials = {trials} trials, about {:.0} minutes for each \
             of {} participants; orders are balanced after every {balanced}",
            study.name,
            study.instructions.len(),
            minutes.max(1.0).ceil(),
            study.participants
        );
        for warning in warnings {
            println!("warning: {warning}");
        }
        Ok(())
    }
}

#[derive(Clone, Copy, ValueEnum)]
enum ToolName {
    Fittsstudy,
    #[value(name = "3dfitts")]
    Threedfitts,
    Gofitts,
    Csv,
}

impl From<ToolName> for Tool {
    fn from(name: ToolName) -> Self {
        match name {
            ToolName::Fittsstudy => Self::FittsStudy,
            ToolName::Threedfitts => Self::ThreeDFitts,
            ToolName::Gofitts => Self::GoFitts,
            ToolName::Csv => Self::Csv,
        }
    }
}

/// What is read, and the conventions.
#[derive(clap::Args)]
struct Input {
    /// Recordings, or folders of them
    #[arg(required = true)]
    inputs: Vec<PathBuf>,
    /// The tool that recorded them; default: seen from their content
    #[arg(long, value_enum)]
    tool: Option<ToolName>,
    /// Column map of a table: a .toml, or the name of a shipped one (guiard2011); default: NAME.toml beside NAME.csv,
    /// else columns with our names
    #[arg(long, value_name = "MAP")]
    columns: Option<String>,
    /// We = factor · SD: a number, or sqrt(2*pi*e); default: the tool's, ours is sqrt(2*pi*e)
    #[arg(long, value_name = "FACTOR", allow_negative_numbers = true)]
    we_factor: Option<String>,
    /// Task axis: nominal, start (FittsStudy) or serial (GoFitts); default: the tool's, ours is nominal
    #[arg(long)]
    axis: Option<String>,
    /// Outlier policy: keep, spatial, 3sd, 3mad, temporal or misses; default: the tool's, ours is keep
    #[arg(long)]
    outliers: Option<String>,
    /// Index of difficulty: shannon, fitts, steering (A/W: tunnels), angular (rays) or meyer; default: the tool's, ours is shannon
    #[arg(long)]
    id: Option<String>,
    /// Any other knob, such as frame=world, reach=axis, mean_time=whole-ms, path=smoothed, crossing_band=5,
    /// turn_jump=10, least_trials=5; may be repeated
    #[arg(long = "set", value_name = "KNOB=VALUE")]
    knobs: Vec<String>,
    /// Asymptote x0 of the weighted homographic law, seconds; default: the map's, else 0
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    who_x0: Option<String>,
    /// Asymptote y0 of the weighted homographic law, relative spread; default: the map's, else 0
    #[arg(long, value_name = "SPREAD", allow_negative_numbers = true)]
    who_y0: Option<String>,
    /// Which sequences the law is fitted to: convex, pareto or all; default: the map's, else convex
    #[arg(long, value_name = "FRONT")]
    who_front: Option<String>,
    /// Analyses the rows that a query finds, as in "SELECT * FROM trials WHERE participant <> 'P03'": the inputs, all .csv or
    /// all .parquet, are the table `trials`. In builds with --features sql
    #[arg(long, value_name = "QUERY")]
    sql: Option<String>,
    /// Threads for tables above 64 MiB; 0: as many as there are processors
    #[arg(long, default_value_t = 0)]
    threads: usize,
}

/// Trials in memory, or sums of a table that was too long for that.
enum Found {
    Trials(Imported),
    Sums(Box<Analysis>, Vec<String>),
}

impl Input {
    /// The conventions of the recording, with what the call replaces.
    fn conventions(&self, mut conventions: Conventions) -> Result<Conventions, Failure> {
        let named = [
            ("we_factor", &self.we_factor),
            ("axis", &self.axis),
            ("outliers", &self.outliers),
            ("id", &self.id),
            ("who_x0_s", &self.who_x0),
            ("who_y0", &self.who_y0),
            ("who_front", &self.who_front),
        ];
        let call = |error: Error| Failure::Call(error.to_string());
        for (knob, value) in named {
            if let Some(value) = value {
                conventions.set(knob, value).map_err(call)?;
            }
        }
        for knob in &self.knobs {
            let Some((name, value)) = knob.split_once('=') else {
                return Err(Failure::Call(format!("--set expects KNOB=VALUE, found {knob}")));
            };
            conventions.set(name, value).map_err(call)?;
        }
        Ok(conventions)
    }

    fn map(&self, file: &Path) -> Result<ColumnMap, Failure> {
        let call = |error: Error| Failure::Call(error.to_string());
        let path = match &self.columns {
            Some(name) => match Maps::named(name) {
                Some(map) => return map.map_err(call),
                None => PathBuf::from(name),
            },
            None => {
                let beside = file.with_extension("toml");
                if !beside.is_file() {
                    return Ok(ColumnMap::default());
                }
                beside
            }
        };
        ColumnMap::parse(&path, &text_of(&path)?).map_err(call)
    }

    fn read(&self) -> Result<Found, Failure> {
        let files = files_of(&self.inputs)?;
        if let Some(absent) = files.iter().find(|file| !file.exists()) {
            return Err(Failure::Call(format!("{}: no such file or folder", absent.display())));
        }
        if let Some(file) = files.iter().find(|file| has_ending(file, "toml")) {
            return Err(Failure::Call(format!(
                "expected recordings, or the folder of a study ({}, if it was not named otherwise), found {}",
                file.with_extension("data").display(),
                file.display()
            )));
        }
        if let Some(query) = &self.sql {
            return self.asked(&files, query);
        }
        if files.iter().any(|file| is_log(file)) {
            return self.read_logs(&files);
        }
        let in_file = |file: &Path, error: &Error| {
            let text = error.to_string();
            // As compilers do it, so that editors find the place.
            let text = text.strip_prefix("line ").map_or(format!(": {text}"), |rest| format!(":{rest}"));
            Failure::Work(format!("{}{text}", file.display()))
        };
        let mut parts = Vec::new();
        for file in &files {
            let unreadable = |error: std::io::Error| Failure::Call(format!("{}: {error}", file.display()));
            let bytes = std::fs::metadata(file).map_err(unreadable)?.len();
            if has_ending(file, "parquet") {
                if bytes > STREAM_BYTES / PARQUET_SHRINKS && files.len() == 1 {
                    return self.streamed(&self.map(file)?, parquet::text(file)?, bytes, |error| {
                        in_file(file, error)
                    });
                }
                let mut text = String::new();
                std::io::Read::read_to_string(&mut parquet::text(file)?, &mut text)
                    .map_err(|error| Failure::Work(format!("{}: {error}", file.display())))?;
                let name =
                    file.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
                parts.push(
                    import(Tool::Csv, &name, &text, &self.map(file)?)
                        .map_err(|error| in_file(file, &error))?,
                );
                continue;
            }
            let tool = match self.tool {
                Some(tool) => tool.into(),
                None => Tool::guess(&head_of(file).map_err(unreadable)?),
            };
            if tool == Tool::Csv && bytes > STREAM_BYTES && files.len() == 1 {
                let input = File::open(file).map_err(unreadable)?;
                return self.streamed(&self.map(file)?, input, bytes, |error| in_file(file, error));
            }
            let map = if tool == Tool::Csv { self.map(file)? } else { ColumnMap::default() };
            let name = file.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
            parts.push(import(tool, &name, &text_of(file)?, &map).map_err(|error| in_file(file, &error))?);
        }
        let mut all = together(parts).map_err(|error| Failure::Work(error.to_string()))?;
        all.conventions = self.conventions(all.conventions)?;
        Ok(Found::Trials(all))
    }

    /// The rows that a query finds, in memory where they may be few.
    fn asked(&self, files: &[PathBuf], query: &str) -> Result<Found, Failure> {
        let mut map = self.map(&files[0])?;
        let rows = sql::rows(files, &map, query)?;
        map.delimiter = None;
        let bytes: u64 =
            files.iter().filter_map(|file| std::fs::metadata(file).ok()).map(|data| data.len()).sum();
        let in_rows = |error: &Error| Failure::Work(format!("--sql: {error}"));
        let shrinks = if files.iter().any(|file| has_ending(file, "parquet")) { PARQUET_SHRINKS } else { 1 };
        if bytes > STREAM_BYTES / shrinks {
            return self.streamed(&map, rows, bytes, in_rows);
        }
        let text = std::io::read_to_string(rows).map_err(|error| Failure::Work(error.to_string()))?;
        let mut all = import(Tool::Csv, "--sql", &text, &map).map_err(|error| in_rows(&error))?;
        all.conventions = self.conventions(all.conventions)?;
        Ok(Found::Trials(all))
    }

    fn streamed(
        &self,
        map: &ColumnMap,
        input: impl std::io::Read + Send,
        bytes: u64,
        in_file: impl Fn(&Error) -> Failure,
    ) -> Result<Found, Failure> {
        let conventions =
            self.conventions(map.resolved().map_err(|error| Failure::Call(error.to_string()))?)?;
        let threads = match self.threads {
            0 => std::thread::available_parallelism().map_or(1, usize::from),
            threads => threads,
        };
        let bar = progress(bytes);
        let found = stream(input, map, Some(&conventions), threads, |read| bar.set_position(read));
        bar.finish_and_clear();
        let found = found.map_err(|error| in_file(&error))?;
        Ok(Found::Sums(Box::new(found.analysis), found.warnings))
    }

    fn read_logs(&self, files: &[PathBuf]) -> Result<Found, Failure> {
        if let Some(other) = files.iter().find(|file| !is_log(file)) {
            return Err(Failure::Call(format!(
                "expected logs (.mcap) or recordings of another tool, found both ({} among logs)",
                other.display()
            )));
        }
        let bar = ProgressBar::new(files.len() as u64);
        let logs: Result<Vec<_>, _> =
            files.iter().inspect(|_| bar.inc(1)).map(|file| vergence_experiment::read(file)).collect();
        bar.finish_and_clear();
        let logs = logs.map_err(|error| Failure::work(&error))?;
        let mut all = vergence_experiment::imported(&logs).map_err(|error| Failure::work(&error))?;
        all.conventions = self.conventions(all.conventions)?;
        // What `status` says of a study's folder is said of its analysis.
        for input in self.inputs.iter().filter(|input| input.join("manifest.json").is_file()) {
            let folder = vergence_experiment::Folder::open(input).map_err(|error| Failure::work(&error))?;
            let status = vergence_experiment::Status::of(&folder).map_err(|error| Failure::work(&error))?;
            let wrong = status.findings.iter().filter(|finding| finding.kind < Kind::Incomplete);
            all.warnings.extend(wrong.map(|finding| format!("{}: {}", finding.file, finding.text)));
        }
        Ok(Found::Trials(all))
    }

    /// Refuses outputs that are recordings or column maps that are read.
    fn check_outputs(&self, option: &str, outputs: &[PathBuf]) -> Result<(), Failure> {
        let mut read = files_of(&self.inputs)?;
        read.extend(self.columns.iter().map(PathBuf::from));
        // Nor is anything written among the logs of a study, whose only copies they are.
        let is_data = |output: &&PathBuf| {
            let folder = output.parent().filter(|folder| !folder.as_os_str().is_empty());
            folder.unwrap_or(Path::new(".")).join("manifest.json").is_file()
        };
        if let Some(output) = outputs.iter().find(is_data) {
            return Err(Failure::Call(format!(
                "{option} {}: expected a place outside of the folder of a study's data",
                output.display()
            )));
        }
        let maps: Vec<PathBuf> = read.iter().map(|file| file.with_extension("toml")).collect();
        // A map that is not there is not read.
        read.extend(maps.into_iter().filter(|map| map.is_file()));
        outputs.iter().try_for_each(|output| Failure::unless_own(option, output, &read))
    }

    fn analysis(&self) -> Result<(Analysis, Option<Imported>, Vec<String>), Failure> {
        match self.read()? {
            Found::Sums(analysis, mut notes) => {
                notes.extend(analysis.warnings.iter().cloned());
                Ok((*analysis, None, notes))
            }
            Found::Trials(all) => {
                let analysis = analyse(&all.data, &all.conventions);
                let mut notes = all.warnings.clone();
                notes.extend(analysis.warnings.iter().cloned());
                Ok((analysis, Some(all), notes))
            }
        }
    }
}

#[derive(clap::Args)]
struct Analyze {
    #[command(flatten)]
    input: Input,
    /// Print one JSON object at the end instead of a table
    #[arg(long)]
    json: bool,
    /// Write trials.csv (not for tables above 64 MiB) and conditions.csv there
    #[arg(long, value_name = "DIR")]
    csv: Option<PathBuf>,
}

impl Analyze {
    fn run(self) -> Result<(), Failure> {
        if let Some(folder) = &self.csv {
            let outputs = ["conditions.csv", "trials.csv", "trials.toml"].map(|name| folder.join(name));
            self.input.check_outputs("--csv", &outputs)?;
        }
        let (analysis, trials, notes) = self.input.analysis()?;
        for note in &notes {
            log::warn!("{note}");
        }
        if let Some(folder) = &self.csv {
            std::fs::create_dir_all(folder)
                .map_err(|error| Failure::Work(format!("{}: {error}", folder.display())))?;
            write(&folder.join("conditions.csv"), &conditions_csv(&analysis))?;
            if let Some(all) = &trials {
                write(&folder.join("trials.csv"), &trials_csv(&analyse_trials(&all.data, &all.conventions)))?;
                write(&folder.join("trials.toml"), &map_of(all))?;
            }
        }
        if self.json {
            let others = others(&trials);
            println!("{}", summary_json(&analysis, &others));
            return Ok(());
        }
        print!("{}", text_table(&analysis));
        let shown = |value: Option<f64>, decimals: usize| {
            value.map_or_else(|| "–".to_owned(), |value| format!("{value:.decimals$}"))
        };
        println!(
            "\n{} participants, {} sequences, {} trials, {}",
            analysis.counts.participants,
            analysis.counts.sequences,
            analysis.counts.trials,
            match analysis.error_rate() {
                Some(rate) => format!("misses {:.1} %", 100.0 * rate),
                None => "misses not known".to_owned(),
            }
        );
        if analysis.conventions.difficulty == Difficulty::Steering {
            println!("tunnels: {} of A/W per second (mean of means)", shown(analysis.steering_rate(), 3));
            if let Some(fit) = &analysis.fit_nominal {
                println!("T = {:.4} s + {:.4} s · A/W, r = {}", fit.a, fit.b, shown(fit.r, 4));
            }
        } else {
            println!(
                "throughput: {} bits/s along the axis, {} in all dimensions (means of means)",
                shown(analysis.tp_mean_of_means(), 3),
                shown(analysis.tp_xy_mean_of_means(), 3)
            );
        }
        if let Some(fit) = &analysis.fit {
            println!("MT = {:.4} s + {:.4} s/bit · IDe, r = {}", fit.a, fit.b, shown(fit.r, 4));
        }
        if let Some(stability) = analysis.stability.as_ref().filter(|stability| stability.levels.len() > 1) {
            for level in &stability.levels {
                println!(
                    "  {}: MT {} s, SD {} {}, TP {} bits/s",
                    level.name,
                    shown(level.mt_s, 3),
                    shown(level.sd, digits(level.sd)),
                    analysis.length_unit,
                    shown(level.tp, 3)
                );
            }
            println!("  throughput varies by {} %", shown(stability.cv.map(|cv| 100.0 * cv), 1));
        }
        for (name, factor) in &analysis.factors {
            for level in &factor.levels {
                println!(
                    "  {name} {}: MT {} s, TP {} bits/s (SD over people {}), misses {} %",
                    level.name,
                    shown(level.mt_s, 3),
                    shown(level.tp, 3),
                    shown(level.tp_sd_of_people, 3),
                    shown(level.error_rate.map(|rate| 100.0 * rate), 1)
                );
            }
        }
        if let Some(who) = &analysis.who {
            println!(
                "(y − y0)^(1−α) (x − x0)^α = k: α = {:.3}, k = {:.4}; x0 = {} s, y0 = {}, {} front of {} of {} sequences, {} of it fitted",
                who.alpha,
                who.k,
                who.x0_s,
                who.y0,
                who.front.name(),
                who.points[1],
                who.points[0],
                who.points[2]
            );
        }
        let knobs: Vec<String> = analysis
            .conventions
            .listed()
            .into_iter()
            .map(|(name, value)| format!("{name} {value}"))
            .collect();
        println!("conventions: {}", knobs.join(", "));
        for (what, count) in analysis.exclusions.iter().filter(|(_, count)| *count > 0) {
            println!("left out: {count} {what}");
        }
        Ok(())
    }
}

/// Decimals with which a length has four digits.
fn digits(value: Option<f64>) -> usize {
    value
        .filter(|value| *value > 0.0)
        .map_or(3, |value| (3.0 - value.log10().floor()).clamp(0.0, 9.0) as usize)
}

/// The first rows; all of them are in conditions.csv.
fn text_table(analysis: &Analysis) -> String {
    const MOST: usize = 60;
    let titles = [
        ("participant", 0),
        ("session", 0),
        ("block", 0),
        ("condition", 0),
        ("instruction", 0),
        ("n", 0),
        ("MT (s)", 3),
        ("misses", 3),
        ("Ae", 4),
        ("We", 4),
        ("IDe", 3),
        ("TP", 3),
        ("TP all", 3),
    ];
    let mut table =
        Table::new(titles.into_iter().map(|(title, decimals)| Column::new(title, decimals)).collect());
    let number = |value: Option<f64>| value.map_or(Cell::Empty, Cell::Number);
    for row in analysis.rows.iter().take(MOST) {
        let key = &row.key;
        let ends = &row.ends;
        let mut cells: Vec<Cell> = [&key.participant, &key.session, &key.block, &key.condition]
            .map(|text| Cell::Text(text.clone()))
            .to_vec();
        cells.push(key.instruction.clone().map_or(Cell::Empty, Cell::Text));
        cells.push(Cell::Number(row.n as f64));
        cells.extend(
            [ends.mt_s, ends.error_rate, ends.x.amplitude, ends.x.we, ends.x.ide, ends.x.tp, ends.xy.tp]
                .map(number),
        );
        table.push(cells, false);
    }
    let more = analysis.rows.len().saturating_sub(MOST);
    let rest =
        if more > 0 { format!("  … and {more} more (--csv DIR writes all)\n") } else { String::new() };
    table.without_empty_columns().to_text() + &rest
}

#[derive(clap::Args)]
struct Report {
    #[command(flatten)]
    input: Input,
    /// Page to write
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Heads the page [default: the study's name, else "Pointing study"]
    #[arg(long)]
    title: Option<String>,
}

impl Report {
    fn run(self) -> Result<(), Failure> {
        self.input.check_outputs("--output", std::slice::from_ref(&self.output))?;
        if !["html", "htm"].iter().any(|ending| has_ending(&self.output, ending)) {
            return Err(Failure::Call(format!(
                "expected an output that ends in .html, found {}",
                self.output.display()
            )));
        }
        let (analysis, trials, notes) = self.input.analysis()?;
        let folder = match &self.input.inputs[..] {
            [folder] => vergence_experiment::Folder::open(folder).ok(),
            _ => None,
        };
        let study = folder.as_ref().map(vergence_experiment::Folder::study);
        let named = || study.map(|study| study.name.clone());
        let title = self.title.clone().or_else(named).unwrap_or_else(|| "Pointing study".to_owned());
        let described = study.map_or_else(Vec::new, Study::described);
        let page = page(&title, &analysis, &others(&trials), &notes, &described)
            .map_err(|error| Failure::work(&error))?;
        write(&self.output, &page.to_html())?;
        println!("{}", self.output.display());
        Ok(())
    }
}

#[derive(clap::Args)]
struct Import {
    /// The tool that recorded them
    #[arg(value_enum)]
    from: ToolName,
    #[command(flatten)]
    input: Input,
    /// Log to write (.mcap), or a table of trials (.csv, or .parquet in builds that have it), whose conventions go to a
    /// .toml beside it
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

impl Import {
    fn run(mut self) -> Result<(), Failure> {
        let is_table = has_ending(&self.output, "csv");
        let is_parquet = has_ending(&self.output, "parquet");
        if is_parquet {
            parquet::available()?;
        }
        if !is_table && !is_parquet && !is_log(&self.output) {
            return Err(Failure::Call(format!(
                "expected an output that ends in .mcap, .csv or .parquet, found {}",
                self.output.display()
            )));
        }
        let mut outputs = vec![self.output.clone()];
        if is_table || is_parquet {
            outputs.push(self.output.with_extension("toml"));
        }
        self.input.check_outputs("--output", &outputs)?;
        self.input.tool = Some(self.from);
        let all = match self.input.read()? {
            Found::Trials(all) => all,
            Found::Sums(..) => {
                return Err(Failure::Call(
                    "this table is above 64 MiB: `study analyze` reads it as it is".to_owned(),
                ));
            }
        };
        for note in &all.warnings {
            log::warn!("{note}");
        }
        if is_table || is_parquet {
            let table = trials_csv(&analyse_trials(&all.data, &all.conventions));
            if is_parquet {
                parquet::write(&self.output, &table)?;
            } else {
                write(&self.output, &table)?;
            }
            write(&self.output.with_extension("toml"), &map_of(&all))?;
        } else {
            let application = concat!("vergence ", env!("CARGO_PKG_VERSION"));
            vergence_experiment::write_log(&self.output, &all, application)
                .map_err(|error| Failure::work(&error))?;
        }
        println!("{}: {} trials", self.output.display(), all.data.trials.len());
        Ok(())
    }
}

/// What each convention does, where the trials are at hand.
fn others(trials: &Option<Imported>) -> Vec<Alternative> {
    trials.as_ref().map_or_else(Vec::new, |all| alternatives(&all.data, &all.conventions))
}

/// The map that reads our own table again by the same conventions.
fn map_of(all: &Imported) -> String {
    let mut text = format!(
        "length_unit = {:?}\ndimensions = {}\n\n[conventions]\n",
        all.data.length_unit, all.data.dimensions
    );
    for (name, value) in all.conventions.listed() {
        text += &format!("{name} = {value:?}\n");
    }
    let names: BTreeSet<&String> = all.data.trials.iter().flat_map(|trial| trial.factors.keys()).collect();
    if !names.is_empty() {
        text += "\n[factors]\n";
    }
    for name in names {
        text += &format!("{name:?} = {:?}\n", factor_column(name));
    }
    text
}

/// Files as given, and those of folders that look like recordings, by name.
fn files_of(inputs: &[PathBuf]) -> Result<Vec<PathBuf>, Failure> {
    let mut files = Vec::new();
    for input in inputs {
        if !input.is_dir() {
            files.push(input.clone());
            continue;
        }
        if input.join("manifest.json").is_file() {
            let folder = vergence_experiment::Folder::open(input).map_err(|error| Failure::work(&error))?;
            let logs = folder.sittings().iter().map(|sitting| input.join(&sitting.file));
            files.extend(logs.filter(|log| log.is_file()));
            continue;
        }
        let unreadable = |error: std::io::Error| Failure::Call(format!("{}: {error}", input.display()));
        let mut own = Vec::new();
        for entry in std::fs::read_dir(input).map_err(unreadable)? {
            let path = entry.map_err(unreadable)?.path();
            let known = path.extension().is_some_and(|own| {
                ["csv", "json", "xml", "sd1", "sd3", "txt", "mcap", "parquet"].iter().any(|e| own == *e)
            });
            if known && path.is_file() {
                own.push(path);
            }
        }
        // Beside the traces, GoFitts writes the same trials once more; 3DFitts logs the cursor beside its tests.
        if own.iter().any(|file| has_ending(file, "sd3")) {
            own.retain(|file| !has_ending(file, "sd1"));
        }
        let is_frames = |file: &PathBuf| {
            file.file_name().is_some_and(|name| name.to_string_lossy().contains("FrameData"))
        };
        if !own.iter().all(is_frames) {
            own.retain(|file| !is_frames(file));
        }
        if own.is_empty() {
            return Err(Failure::Call(format!(
                "{}: expected recordings (.csv, .json, .xml, .sd1, .sd3, .txt, .mcap, .parquet), found none",
                input.display()
            )));
        }
        own.sort();
        files.extend(own);
    }
    Ok(files)
}

fn is_log(file: &Path) -> bool {
    has_ending(file, "mcap")
}

fn has_ending(file: &Path, ending: &str) -> bool {
    file.extension().is_some_and(|own| own == ending)
}

fn head_of(file: &Path) -> std::io::Result<String> {
    use std::io::Read as _;
    let mut head = Vec::new();
    File::open(file)?.take(2048).read_to_end(&mut head)?;
    Ok(String::from_utf8_lossy(&head).into_owned())
}

fn progress(bytes: u64) -> ProgressBar {
    let bar = ProgressBar::new(bytes);
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {bytes} of {total_bytes}, {eta}") {
        bar.set_style(style);
    }
    bar
}

fn text_of(file: &Path) -> Result<String, Failure> {
    let bytes = std::fs::read(file).map_err(|error| Failure::Call(format!("{}: {error}", file.display())))?;
    String::from_utf8(bytes).map_err(|error| {
        let before = &error.as_bytes()[..error.utf8_error().valid_up_to()];
        let line = 1 + before.iter().filter(|byte| **byte == b'\n').count();
        Failure::Work(format!("{}:{line}: expected text in UTF-8, found a byte that is none", file.display()))
    })
}

fn write(file: &Path, text: &str) -> Result<(), Failure> {
    std::fs::write(file, text).map_err(|error| Failure::Work(format!("{}: {error}", file.display())))
}
