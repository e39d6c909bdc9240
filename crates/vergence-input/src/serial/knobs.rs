//! How a serial device is read, and what became of what it sent.

use vergence_time::{ClockKnobs, Span};

use super::describe::Description;
use super::frame::Tally;
use super::lines::Columns;

/// What a device sends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Format {
    /// Whichever comes first.
    #[default]
    Either,
    /// Frames.
    Frames,
    /// Lines of numbers.
    Lines,
}

/// Knobs of a [`SerialSource`](super::SerialSource).
#[derive(Clone, Debug)]
pub struct SerialConfig {
    /// Bits per second on the wire; USB devices pass over it.
    pub baud: u32,
    /// What comes.
    pub format: Format,
    /// Of devices that do not describe their streams: the number of the stream and what it is.
    pub streams: Vec<(u8, Description)>,
    /// The line of names of devices that send none.
    pub columns: Option<Columns>,
    /// What the fastest reading takes from measurement to arrival, where it is declared. It is subtracted.
    pub least_latency: Span,
    /// How much the device's clock may be off, parts per million, 10 to 50,000. Where it is off by more, times of capture err, and the
    /// event `clock_off` says so.
    pub most_drift_ppm: u32,
}

impl Default for SerialConfig {
    fn default() -> Self {
        Self {
            baud: 115_200,
            format: Format::Either,
            streams: Vec::new(),
            columns: None,
            least_latency: Span::ZERO,
            most_drift_ppm: ClockKnobs::MOST_DRIFT_PPM,
        }
    }
}

/// What became of what a device sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Totals {
    /// Of frames.
    pub frames: Tally,
    /// Lines of numbers.
    pub lines: u64,
    /// Lines that were none.
    pub broken_lines: u64,
    /// What the sequence numbers say is missing.
    pub lost: u64,
    /// Frames of streams that nothing describes, of another length than described, or beyond the most streams that a
    /// device may have.
    pub unread: u64,
}
