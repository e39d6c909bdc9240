//! `vergence log`: what is in a session log, whether it is well, and other logs made out of it.

mod euroc;
mod export;
mod gather;
mod import;
mod table;

use std::path::{Path, PathBuf};

use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use vergence_config::Duration;
use vergence_log::{
    Diff, Error, Limits, Part, Reader, Repair, Survey, cut, diff, first_arrival, merge, repair,
};
use vergence_time::{Span, Timestamp};

pub use gather::{INERTIAL_UNIT, TRUTHS};

use crate::failure::Failure;

/// Says what is in a session log, mends it, cuts, merges and compares logs
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(clap::Subcommand)]
enum Verb {
    /// What is in a log: its session and its streams, with type, unit, frame, rate, gaps, count, bytes
    Info(One),
    /// Whether a log is well: complete, cut off or of a recording that failed, whole, in order of time, nothing dropped; how arrival follows
    /// capture (exit status 1 where it is not)
    Check(One),
    /// Writes everything that is whole in a damaged log to a new one, and says what is missing
    Repair(RepairArgs),
    /// Writes a part of a log, in time, in streams or both, to a new one
    Cut(CutArgs),
    /// Merges logs into the order of arrival; a stream whose name an earlier log has, too, is put below the name of its file
    Merge(MergeArgs),
    /// Where two logs part: the first difference of each stream, bit for bit; streams of host time are not compared
    /// (exit status 1 where they differ)
    Diff(DiffArgs),
    /// Makes a log out of another recording: EuRoC, TUM, BROAD, XDF, a table
    Import(import::ImportArgs),
    /// Writes a log for other programs: CSV, Parquet, TUM, EuRoC
    Export(export::ExportArgs),
}

#[derive(clap::Args)]
struct One {
    /// A session log (.mcap)
    file: PathBuf,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(clap::Args)]
struct RepairArgs {
    /// A session log (.mcap)
    file: PathBuf,
    /// The new log [default: FILE with .repaired before its ending]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(clap::Args)]
struct CutArgs {
    /// A session log (.mcap)
    file: PathBuf,
    /// The new log
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// From this time on, counted from the first arrival, as in 2.5s or 300ms [default: the beginning]
    #[arg(long, value_name = "TIME")]
    from: Option<Duration>,
    /// Before this time, counted from the first arrival [default: the end]
    #[arg(long, value_name = "TIME")]
    until: Option<Duration>,
    /// Streams by name, with all that lie below (/hand keeps /hand/left) [default: all]
    #[arg(long, value_delimiter = ',', value_name = "STREAM")]
    streams: Vec<String>,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(clap::Args)]
struct MergeArgs {
    /// Session logs (.mcap); at the same instant the first comes first
    #[arg(required = true, num_args = 2..)]
    files: Vec<PathBuf>,
    /// The new log
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(clap::Args)]
struct DiffArgs {
    /// A session log (.mcap)
    a: PathBuf,
    /// Another
    b: PathBuf,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

impl Args {
    /// Does it and prints what came of it.
    pub fn run(self) -> Result<(), Failure> {
        match self.verb {
            Verb::Info(one) => info(&one),
            Verb::Check(one) => check(&one),
            Verb::Repair(args) => args.run(),
            Verb::Cut(args) => args.run(),
            Verb::Merge(args) => args.run(),
            Verb::Diff(args) => args.run(),
            Verb::Import(args) => args.run(),
            Verb::Export(args) => args.run(),
        }
    }
}

/// A file that is not there, or is a folder, is a wrong call; everything else is work that failed.
pub(crate) fn failed(error: &Error) -> Failure {
    match error {
        Error::Read { source, .. }
            if matches!(source.kind(), std::io::ErrorKind::NotFound | std::io::ErrorKind::IsADirectory) =>
        {
            Failure::call(error)
        }
        Error::Request(_) | Error::NoStream { .. } => Failure::call(error),
        _ => Failure::work(error),
    }
}

/// A bar of bytes on stderr, where that is a terminal.
fn with_bar<T>(work: impl FnOnce(&mut dyn FnMut(u64, u64)) -> Result<T, Error>) -> Result<T, Failure> {
    let bar = ProgressBar::new(0);
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {bytes}/{total_bytes} {eta}") {
        bar.set_style(style);
    }
    let done = work(&mut |read, all| {
        bar.set_length(all);
        bar.set_position(read);
    });
    bar.finish_and_clear();
    done.map_err(|error| failed(&error))
}

fn print_json(value: &impl Serialize) -> Result<(), Failure> {
    let text = serde_json::to_string(value).map_err(|error| Failure::work(&error))?;
    println!("{text}");
    Ok(())
}

fn survey(file: &Path) -> Result<Survey, Failure> {
    with_bar(|progress| Survey::of(&mut Reader::open(file)?, progress))
}

fn info(one: &One) -> Result<(), Failure> {
    let survey = survey(&one.file)?;
    if one.json {
        return print_json(&survey);
    }
    for (key, value) in survey.session.iter().filter(|(_, value)| !value.is_empty()) {
        match value.lines().count() {
            0 | 1 if value.len() <= 200 => println!("{key:16} {value}"),
            0 | 1 => println!("{key:16} {} characters, with --json", value.len()),
            lines => println!("{key:16} {lines} lines"),
        }
    }
    println!(
        "{:16} {:.3} s, {} messages, {} bytes",
        "holds", survey.duration_s, survey.messages, survey.bytes
    );
    for name in survey.metadata.iter().chain(&survey.attachments) {
        println!("{:16} {name}", "with");
    }
    println!("{}", ending(&survey));
    table(&survey);
    Ok(())
}

fn ending(survey: &Survey) -> String {
    let end = match (survey.cut_off_at, &survey.failed) {
        (Some(at), Some(why)) => format!("ended early at byte {at}: the recording failed ({why})"),
        (Some(at), None) => format!("cut off at byte {at}: 'vergence log repair' gives what is whole"),
        (None, Some(why)) => format!("complete, of a recording that failed ({why})"),
        (None, None) => "complete".to_owned(),
    };
    match &survey.repaired {
        Some(note) => format!("{end}, repaired ({note})"),
        None => end,
    }
}

/// What `record` said, too.
fn device_gaps(survey: &Survey) {
    if let (gaps @ 1.., missing) = survey.device_gaps() {
        println!("{gaps} gaps told by devices, {missing} readings missing by their numbers");
    }
}

fn table(survey: &Survey) {
    device_gaps(survey);
    let width = survey.streams.iter().map(|stream| stream.name.len()).max().unwrap_or(0).max(6);
    println!(
        "\n{:width$}  {:12} {:20} {:8} {:8} {:>9} {:>5} {:>8} {:>10}",
        "stream", "type", "unit", "frame", "clock", "rate Hz", "gaps", "count", "bytes"
    );
    for stream in &survey.streams {
        let rate = stream.rate_hz.map_or_else(|| "-".to_owned(), |rate| format!("{rate:.1}"));
        println!(
            "{:width$}  {:12} {:20} {:8} {:8} {rate:>9} {:>5} {:>8} {:>10}",
            stream.name,
            stream.type_name,
            stream.unit,
            stream.frame,
            stream.clock,
            stream.gaps,
            stream.count,
            stream.bytes
        );
    }
    let noted: Vec<_> = survey.streams.iter().filter(|stream| !stream.notes.is_empty()).collect();
    if !noted.is_empty() {
        println!("\n{:width$}  note", "stream");
    }
    for stream in noted {
        /// A recording may have thousands of columns.
        const SHOWN: usize = 40;
        for (key, value) in stream.notes.iter().take(SHOWN) {
            match value.chars().nth(200) {
                None => println!("{:width$}  {key} = {value}", stream.name),
                Some(_) => println!("{:width$}  {key}: {} characters, with --json", stream.name, value.len()),
            }
        }
        if stream.notes.len() > SHOWN {
            println!("{:width$}  and {} more, with --json", stream.name, stream.notes.len() - SHOWN);
        }
    }
}

#[derive(Serialize)]
struct Checked<'a> {
    well: bool,
    #[serde(flatten)]
    survey: &'a Survey,
}

fn check(one: &One) -> Result<(), Failure> {
    let survey = survey(&one.file)?;
    let well = survey.is_well();
    if one.json {
        print_json(&Checked { well, survey: &survey })?;
    } else {
        println!("{}", ending(&survey));
        device_gaps(&survey);
        for finding in &survey.findings {
            let stream = if finding.stream.is_empty() { "the file" } else { &finding.stream };
            println!("byte {}, {stream}: {}: {}", finding.offset, finding.kind, finding.sentence);
        }
        let more = survey.findings_count - survey.findings.len() as u64;
        if more > 0 {
            println!("and {more} more");
        }
        let width = survey.streams.iter().map(|stream| stream.name.len()).max().unwrap_or(0).max(6);
        println!(
            "\n{:width$}  {:>8} {:>7} {:>5} {:>10} {:>10} {:>10} {:>10} {:>10} {:>11}",
            "stream",
            "count",
            "missing",
            "gaps",
            "longest s",
            "delay ms",
            "min",
            "max",
            "drift ppm",
            "residual ms"
        );
        for stream in &survey.streams {
            print!(
                "{:width$}  {:>8} {:>7} {:>5} {:>10.4}",
                stream.name, stream.count, stream.missing, stream.gaps, stream.longest_gap_s
            );
            match stream.delay {
                Some(delay) => println!(
                    " {:>10.3} {:>10.3} {:>10.3} {:>10.2} {:>11.4}",
                    delay.mean_ms, delay.min_ms, delay.max_ms, delay.drift_ppm, delay.residual_ms
                ),
                None => println!(),
            }
        }
    }
    if well {
        return Ok(());
    }
    let what = match (survey.complete, &survey.failed) {
        (true, _) => "is complete, and not well",
        (false, Some(_)) => "ended early: the recording failed",
        (false, None) => "was cut off",
    };
    let findings = match survey.findings_count {
        0 => String::new(),
        1 => " (1 finding)".to_owned(),
        count => format!(" ({count} findings)"),
    };
    Err(Failure::Work(format!("{}: {what}{findings}", one.file.display())))
}

#[derive(Serialize)]
struct Written<'a, T: Serialize> {
    output: &'a Path,
    #[serde(flatten)]
    what: T,
}

impl RepairArgs {
    fn run(self) -> Result<(), Failure> {
        let output = self.output.unwrap_or_else(|| self.file.with_extension("repaired.mcap"));
        let found: Repair = with_bar(|progress| repair(&self.file, &output, Limits::default(), progress))?;
        let nothing = found.messages == 0 && !found.was_complete;
        if self.json {
            print_json(&Written { output: &output, what: &found })?;
        } else if !nothing {
            told(&output, &found);
        }
        if nothing {
            // A log without a message would pass for a recording.
            std::fs::remove_file(&output).map_err(|error| Failure::unwritable(&output, &error))?;
            let file = self.file.display();
            return Err(Failure::Work(format!("{file}: no message in it is whole; nothing was written")));
        }
        Ok(())
    }
}

/// What a repair came to, for people.
fn told(output: &Path, found: &Repair) {
    println!("{}: {} messages", output.display(), found.messages);
    match found.cut_off_at {
        Some(at) if found.recording_failed => {
            println!("missing: what came after byte {at}, where the recording failed");
        }
        Some(at) => println!(
            "missing: what came after byte {at} ({} bytes there are no whole record)",
            found.lost_bytes_at_end
        ),
        None if found.was_complete => println!("the log was complete"),
        None => println!("the log was damaged: what is whole is kept"),
    }
    for place in &found.damaged {
        println!("damaged: {place}");
    }
    let more = found.damaged_count.saturating_sub(found.damaged.len() as u64);
    if more > 0 {
        println!("damaged: {more} more places");
    }
    for (number, count) in &found.unannounced {
        println!("missing: {count} messages of stream number {number}, whose announcement is lost");
    }
    if found.missing > 0 {
        println!("missing: {} messages, by their numbers", found.missing);
    }
    for name in &found.lost_attachments {
        println!("missing: attachment {name}, which is damaged");
    }
}

impl CutArgs {
    fn run(self) -> Result<(), Failure> {
        let start = first_arrival(&self.file).map_err(|error| failed(&error))?.unwrap_or_default();
        let instant = |time: Option<Duration>| -> Result<Option<Timestamp>, Failure> {
            let Some(time) = time else { return Ok(None) };
            let span = Span::from_secs_f64(time.seconds());
            let instant = span.and_then(|span| start.checked_add(span));
            instant
                .map(Some)
                .ok_or_else(|| Failure::Call("a time that far away cannot be counted".to_owned()))
        };
        let part = Part { from: instant(self.from)?, until: instant(self.until)?, streams: self.streams };
        let kept = with_bar(|progress| cut(&self.file, &self.output, &part, progress))?;
        if self.json {
            print_json(&Written { output: &self.output, what: &kept })?;
        } else {
            println!("{}: {} messages, {} left out", self.output.display(), kept.messages, kept.left_out);
        }
        if kept.messages == 0 && kept.left_out > 0 {
            return Err(Failure::Work(format!("{}: nothing of it lies there", self.file.display())));
        }
        Ok(())
    }
}

impl MergeArgs {
    fn run(self) -> Result<(), Failure> {
        let files: Vec<&Path> = self.files.iter().map(PathBuf::as_path).collect();
        let merged = with_bar(|progress| merge(&files, &self.output, progress))?;
        if self.json {
            return print_json(&Written { output: &self.output, what: merged });
        }
        println!("{}: {} messages", self.output.display(), merged.messages);
        for (old, new) in &merged.renamed {
            println!("{old} of a later log is {new}");
        }
        Ok(())
    }
}

impl DiffArgs {
    fn run(self) -> Result<(), Failure> {
        let found: Diff = with_bar(|progress| diff(&self.a, &self.b, progress))?;
        if self.json {
            print_json(&found)?;
        } else {
            for stream in &found.streams {
                let said = match (&stream.first_difference, stream.not_compared) {
                    (_, Some(why)) => format!("not compared: {why}"),
                    (None, _) => format!("{} equal", stream.equal_until),
                    (Some(difference), _) => {
                        let at = |ns: Option<i64>| ns.map_or_else(|| "-".to_owned(), |ns| format!("{ns} ns"));
                        format!(
                            "first difference at message {} (arrived {} | {}): {}",
                            difference.index,
                            at(difference.arrived_a_ns),
                            at(difference.arrived_b_ns),
                            difference.sentence
                        )
                    }
                };
                println!("{}: {said}", stream.name);
            }
        }
        if found.equal {
            return Ok(());
        }
        let differ = found.streams.iter().filter(|stream| stream.first_difference.is_some()).count();
        Err(Failure::Work(format!("{differ} of {} streams differ", found.streams.len())))
    }
}
