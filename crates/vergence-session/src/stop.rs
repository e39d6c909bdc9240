use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A way to end a run from outside, as a signal or another thread does: the session then ends as it should, and the
/// report is of what was shown so far.
#[derive(Clone, Debug, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    /// Stops the run before its next frame.
    pub fn stop(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether the run was told to stop.
    pub fn is_stopped(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// The switch itself, for handlers of signals: `true` stops.
    pub fn switch(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.0)
    }
}
