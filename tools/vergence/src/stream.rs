//! Streams that a caller can ask for beyond what a scene needs.

/// As named on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Stream {
    /// The joints of both hands
    Hands,
    /// Where the user looks
    Gaze,
}
