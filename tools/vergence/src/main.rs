//! The one command-line tool of Vergence: parse, resolve, call the library, print.
//!
//! One verb, one file. A verb is a `clap::Args` struct with a method `run(self) -> Result<(), Failure>`; it prints
//! for people, or with `--json` one object as the last thing on stdout. Logs and progress go to stderr. Exit status:
//! 0 done, 1 the work failed, 2 the call was wrong.

mod bindings;
mod devices;
mod doctor;
mod failure;
mod framing;
mod imu;
mod loading;
mod log;
mod logging;
mod plan;
mod quality;
mod record;
mod render;
mod replay;
mod run;
mod sim;
mod slam;
mod stats;
mod stream;
mod study;
mod timing;
mod trade;

use std::io::Write;
use std::os::unix::process::CommandExt;
use std::process::{Command, ExitCode};

use clap::{Parser, Subcommand};

use crate::failure::Failure;

/// Open XR and interaction-research toolkit.
#[derive(Parser)]
#[command(name = "vergence", version, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    verb: Verb,
    /// Say more on stderr: -v what is done, -vv in detail
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    verbose: u8,
}

#[derive(Subcommand)]
enum Verb {
    Plan(plan::Args),
    Devices(devices::Args),
    Doctor(doctor::Args),
    Imu(imu::Args),
    Log(log::Args),
    Record(record::Args),
    Render(render::Args),
    Replay(replay::Args),
    Run(Box<run::Args>),
    Sim(sim::Args),
    Slam(slam::Args),
    Stats(stats::Args),
    Study(study::Args),
    Trade(trade::Args),
}

impl Verb {
    fn run(self) -> Result<(), Failure> {
        match self {
            Self::Plan(verb) => verb.run(),
            Self::Devices(verb) => verb.run(),
            Self::Doctor(verb) => verb.run(),
            Self::Imu(verb) => verb.run(),
            Self::Log(verb) => verb.run(),
            Self::Record(verb) => verb.run(),
            Self::Render(verb) => verb.run(),
            Self::Replay(verb) => verb.run(),
            Self::Run(verb) => verb.run(),
            Self::Sim(verb) => verb.run(),
            Self::Slam(verb) => verb.run(),
            Self::Stats(verb) => verb.run(),
            Self::Study(verb) => verb.run(),
            Self::Trade(verb) => verb.run(),
        }
    }
}

/// That there is no OpenXR runtime is said here in one sentence; the loader takes five lines for it, and reads whether it
/// may from the environment, which a program may change safely only for its successor.
fn quiet_loader() {
    const LOADER_SAYS: &str = "XR_LOADER_DEBUG";
    if std::env::var_os(LOADER_SAYS).is_some() {
        return;
    }
    let mut arguments = std::env::args_os();
    let name = arguments.next().unwrap_or_default();
    if let Ok(program) = std::env::current_exe() {
        // Returns only where it fails: then the loader says its five lines.
        let error = Command::new(program).arg0(name).args(arguments).env(LOADER_SAYS, "none").exec();
        ::log::debug!("{error}");
    }
}

/// Who reads what is printed may have enough of it (`… | head`): then this process ends without a word, with the status that a
/// shell gives to a process which writes to a pipe that nobody reads. Rust ignores the signal, and `println!` panics; the
/// signal's own way would also end a run whose runtime or display goes away. Where what is printed finds no room (a full disk),
/// that is one sentence, and the work has failed.
fn end_where_printing_fails() {
    const NOBODY_READS: i32 = 128 + 13;
    let usual = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        let says = panic.payload_as_str().unwrap_or_default();
        if let Some(why) = says.strip_prefix("failed printing to std") {
            if why.contains("Broken pipe") {
                std::process::exit(NOBODY_READS);
            }
            // Nothing else can be said where this fails as well; the status says it.
            let _ = writeln!(std::io::stderr(), "vergence: printing failed: std{why}");
            std::process::exit(1);
        }
        usual(panic);
    }));
}

/// A file that may not grow any more (`ulimit -f`) is a failed write like that to a full disk, which is told; the signal of old
/// would end the process instead.
fn live_through_full_files() {
    // What the handler notes is of no use: that there is one makes the write fail with an error.
    let noted = std::sync::Arc::default();
    if let Err(error) = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, noted) {
        ::log::debug!("{error}");
    }
}

fn main() -> ExitCode {
    end_where_printing_fails();
    live_through_full_files();
    let cli = Cli::parse();
    logging::start(cli.verbose);
    if cli.verbose == 0
        && matches!(cli.verb, Verb::Run(_) | Verb::Doctor(_) | Verb::Record(_) | Verb::Devices(_))
    {
        quiet_loader();
    }
    match cli.verb.run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(),
    }
}
