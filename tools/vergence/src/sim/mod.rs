//! `vergence sim`: recordings of devices that are not there; one file per verb.

mod camera;

use crate::failure::Failure;

/// Recordings of simulated devices
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(clap::Subcommand)]
enum Verb {
    Camera(Box<camera::Args>),
}

impl Args {
    /// Runs the verb.
    pub fn run(self) -> Result<(), Failure> {
        match self.verb {
            Verb::Camera(verb) => verb.run(),
        }
    }
}
