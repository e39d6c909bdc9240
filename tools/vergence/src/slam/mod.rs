//! `vergence slam`: where a rig is, and how well that is known; one file per verb.

mod eval;

use crate::failure::Failure;

/// Visual-inertial odometry: its error against a truth
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(clap::Subcommand)]
enum Verb {
    Eval(eval::Args),
}

impl Args {
    /// Runs the verb.
    pub fn run(self) -> Result<(), Failure> {
        match self.verb {
            Verb::Eval(verb) => verb.run(),
        }
    }
}
