//! `vergence imu`: orientation from inertial units; one file per verb.

mod calibrate;
mod compare;
mod eval;
mod input;
mod noise;
mod output;
mod predict;
mod run;
mod truth;

pub use input::{Corrections, corrected};

use crate::failure::Failure;

/// Orientation from inertial units: filters, their score, calibration, noise, prediction
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(clap::Subcommand)]
enum Verb {
    Run(run::Args),
    Eval(eval::Args),
    Compare(compare::Args),
    Calibrate(calibrate::Args),
    Noise(noise::Args),
    Predict(predict::Args),
}

impl Args {
    /// Runs the verb.
    pub fn run(self) -> Result<(), Failure> {
        match self.verb {
            Verb::Run(verb) => verb.run(),
            Verb::Eval(verb) => verb.run(),
            Verb::Compare(verb) => verb.run(),
            Verb::Calibrate(verb) => verb.run(),
            Verb::Noise(verb) => verb.run(),
            Verb::Predict(verb) => verb.run(),
        }
    }
}
