//! How much CPU time this thread spends inside the runtime, so that our own share of a frame can be told apart.

use vergence_gpu::{driver_time, thread_cpu_ns};
use vergence_time::Span;

/// Adds up calls into the runtime.
#[derive(Debug, Default)]
pub(crate) struct RuntimeClock {
    spent_ns: u64,
}

impl RuntimeClock {
    /// Runs a call into the runtime. What the call itself spends inside Vulkan on this thread is left to the clock of the
    /// graphics device, so that nothing is counted twice.
    pub(crate) fn during<R>(&mut self, call: impl FnOnce() -> R) -> R {
        let (cpu_before, driver_before) = (thread_cpu_ns(), driver_time().ns);
        let result = call();
        let cpu = thread_cpu_ns().saturating_sub(cpu_before);
        let driver = driver_time().ns.saturating_sub(driver_before);
        self.spent_ns = self.spent_ns.saturating_add(cpu.saturating_sub(driver));
        result
    }

    pub(crate) fn spent(&self) -> Span {
        Span::from_nanos(i64::try_from(self.spent_ns).unwrap_or(i64::MAX))
    }
}
