//! What work took: CPU time of the process or the thread, and the least of many measurements.

use rustix::time::{ClockId, clock_gettime};

/// CPU time of all threads of this process, milliseconds.
pub fn process_cpu_ms() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 * 1e-6
}

/// CPU time of this thread, nanoseconds: what else the machine does counts only as far as it fills caches.
pub fn thread_cpu_ns() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 * 1e9 + time.tv_nsec as f64
}

/// The least one; infinite without any.
pub fn least(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::INFINITY, f64::min)
}

/// The median; NaN without any.
pub fn median(values: &[f64]) -> f64 {
    vergence_stats::median(values).unwrap_or(f64::NAN)
}
