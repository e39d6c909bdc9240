//! `vergence slam`: where a rig is, and how well that is known; one file per verb.

mod eval;
pub mod knobs;
mod poses;
pub mod run;

use crate::failure::Failure;

/// Visual-inertial odometry: runs it, and its error against a truth
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(clap::Subcommand)]
enum Verb {
    Eval(eval::Args),
    Run(Box<run::Args>),
}

impl Args {
    /// Runs the verb.
    pub fn run(self) -> Result<(), Failure> {
        match self.verb {
            Verb::Eval(verb) => verb.run(),
            Verb::Run(verb) => verb.run(),
        }
    }
}
