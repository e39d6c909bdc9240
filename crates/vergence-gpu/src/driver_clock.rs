//! How much time this thread spends inside the driver, so that our own share of a frame can be told apart.
//!
//! Off by default: a call then costs one relaxed load. Calls that only record are timed by the monotonic clock, of which at most
//! 20 µs count, so that an interruption by another thread is not taken for the driver's work. Larger calls (submit, wait, acquire,
//! present, beginning and ending a recording) are timed by the CPU time of the thread, so that waiting counts as nothing. What the
//! clock itself costs is measured when it is switched on and counted with the driver's time, so that it is not taken for ours.

use std::cell::Cell;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Instant;

use rustix::time::{ClockId, clock_gettime};

static ON: AtomicBool = AtomicBool::new(false);
/// What the clock costs around a call beyond what it measures, in nanoseconds: of quick and of blocking calls.
static COST_NS: [AtomicU64; 2] = [AtomicU64::new(0), AtomicU64::new(0)];
const QUICK: usize = 0;
const BLOCKING: usize = 1;
/// The cost is the median over so many batches of so many empty calls: few batches are interrupted.
const BATCHES: usize = 21;
const CALLS_PER_BATCH: u64 = 50;
/// Most that counts of a quick call; recording one command takes a fraction of it.
const QUICK_MOST_NS: u64 = 20_000;

thread_local! {
    static SPENT_NS: Cell<u64> = const { Cell::new(0) };
    static CALLS: Cell<u64> = const { Cell::new(0) };
}

/// What one thread has spent inside the driver since it started, while the clock was on.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DriverTime {
    /// CPU time inside driver calls and of the clock around them, in nanoseconds.
    pub ns: u64,
    /// Number of timed calls.
    pub calls: u64,
}

/// Switches the clock on or off for the whole process (default: off).
pub fn set_driver_clock(on: bool) {
    if on && !ON.swap(true, Ordering::Relaxed) {
        calibrate(QUICK, || quick(|| ()));
        calibrate(BLOCKING, || blocking(|| ()));
    }
    ON.store(on, Ordering::Relaxed);
}

/// Measures what an empty call costs beyond what it says that it took.
fn calibrate(kind: usize, empty: impl Fn()) {
    COST_NS[kind].store(0, Ordering::Relaxed);
    let said = (SPENT_NS.get(), CALLS.get());
    let mut costs = [0; BATCHES];
    for cost in &mut costs {
        let (start, spent) = (thread_cpu_ns(), SPENT_NS.get());
        (0..CALLS_PER_BATCH).for_each(|_| empty());
        let took = thread_cpu_ns().saturating_sub(start);
        *cost = took.saturating_sub(SPENT_NS.get() - spent) / CALLS_PER_BATCH;
    }
    costs.sort_unstable();
    COST_NS[kind].store(costs[BATCHES / 2], Ordering::Relaxed);
    SPENT_NS.set(said.0);
    CALLS.set(said.1);
}

/// What this thread has spent inside the driver so far; take the difference of two readings.
pub fn driver_time() -> DriverTime {
    DriverTime { ns: SPENT_NS.get(), calls: CALLS.get() }
}

/// CPU time of the calling thread, in nanoseconds since its start.
pub fn thread_cpu_ns() -> u64 {
    let t = clock_gettime(ClockId::ThreadCPUTime);
    (t.tv_sec as u64).wrapping_mul(1_000_000_000).wrapping_add(t.tv_nsec as u64)
}

fn add(kind: usize, ns: u64) {
    let ns = ns + COST_NS[kind].load(Ordering::Relaxed);
    SPENT_NS.set(SPENT_NS.get().wrapping_add(ns));
    CALLS.set(CALLS.get().wrapping_add(1));
}

/// Runs a driver call that records one command.
#[inline(always)]
pub(crate) fn quick<R>(call: impl FnOnce() -> R) -> R {
    if !ON.load(Ordering::Relaxed) {
        return call();
    }
    let start = Instant::now();
    let result = call();
    add(QUICK, (start.elapsed().as_nanos() as u64).min(QUICK_MOST_NS));
    result
}

/// Runs a driver call that may block, or that may take long.
#[inline(always)]
pub(crate) fn blocking<R>(call: impl FnOnce() -> R) -> R {
    if !ON.load(Ordering::Relaxed) {
        return call();
    }
    let start = thread_cpu_ns();
    let result = call();
    add(BLOCKING, thread_cpu_ns().saturating_sub(start));
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_only_while_on_and_never_waiting() {
        set_driver_clock(true);
        let before = driver_time();
        blocking(|| std::thread::sleep(std::time::Duration::from_millis(30)));
        let waited = driver_time();
        quick(|| std::thread::sleep(std::time::Duration::from_millis(2)));
        let quick_spent = driver_time();
        set_driver_clock(false);
        quick(|| ());
        assert_eq!(waited.calls, before.calls + 1);
        assert!(waited.ns - before.ns < 10_000_000, "a sleep is not CPU time: {} ns", waited.ns - before.ns);
        let counted = quick_spent.ns - waited.ns;
        assert!((QUICK_MOST_NS..2_000_000).contains(&counted), "an interruption counts little: {counted} ns");
        assert_eq!(driver_time(), quick_spent);
    }
}
