//! The one command-line tool of Vergence: parse, resolve, call the library, print.
//!
//! One verb, one file. A verb is a `clap::Args` struct with a method `run(self) -> Result<(), Failure>`; it prints
//! for people, or with `--json` one object as the last thing on stdout. Logs and progress go to stderr. Exit status:
//! 0 done, 1 the work failed, 2 the call was wrong.

mod doctor;
mod failure;
mod framing;
mod imu;
mod loading;
mod log;
mod logging;
mod plan;
mod quality;
mod render;
mod replay;
mod run;
mod stats;
mod stream;
mod study;
mod trade;

use std::process::ExitCode;

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
    Doctor(doctor::Args),
    Imu(imu::Args),
    Log(log::Args),
    Render(render::Args),
    Replay(replay::Args),
    Run(Box<run::Args>),
    Stats(stats::Args),
    Study(study::Args),
    Trade(trade::Args),
}

impl Verb {
    fn run(self) -> Result<(), Failure> {
        match self {
            Self::Plan(verb) => verb.run(),
            Self::Doctor(verb) => verb.run(),
            Self::Imu(verb) => verb.run(),
            Self::Log(verb) => verb.run(),
            Self::Render(verb) => verb.run(),
            Self::Replay(verb) => verb.run(),
            Self::Run(verb) => verb.run(),
            Self::Stats(verb) => verb.run(),
            Self::Study(verb) => verb.run(),
            Self::Trade(verb) => verb.run(),
        }
    }
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    logging::start(cli.verbose);
    match cli.verb.run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(),
    }
}
