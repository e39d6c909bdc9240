use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Instant;

use crate::{Span, Timestamp};

/// Something that knows the time and can wait for it.
pub trait Clock: Send + Sync {
    /// The present instant on this clock. Never runs backwards.
    fn now(&self) -> Timestamp;

    /// Returns at `instant` or, where that has passed, at once.
    fn sleep_until(&self, instant: Timestamp);
}

/// The monotonic clock of the host, counted from its creation.
#[derive(Debug)]
pub struct HostClock {
    epoch: Instant,
}

impl HostClock {
    /// A clock that reads zero now.
    pub fn start() -> Self {
        Self { epoch: Instant::now() }
    }
}

impl Clock for HostClock {
    fn now(&self) -> Timestamp {
        Timestamp::from_nanos(i64::try_from(self.epoch.elapsed().as_nanos()).unwrap_or(i64::MAX))
    }

    fn sleep_until(&self, instant: Timestamp) {
        let left = instant.since(self.now()).unwrap_or(Span::ZERO).as_nanos();
        if let Ok(nanos @ 1..) = u64::try_from(left) {
            std::thread::sleep(std::time::Duration::from_nanos(nanos));
        }
    }
}

/// A virtual clock: stands still until somebody moves it; waiting moves it at once.
#[derive(Debug, Default)]
pub struct HandClock {
    nanos: AtomicI64,
}

impl HandClock {
    /// A clock that reads `start`.
    pub fn at(start: Timestamp) -> Self {
        Self { nanos: AtomicI64::new(start.as_nanos()) }
    }

    /// Moves the clock to `instant`; an earlier instant leaves it where it is.
    pub fn advance_to(&self, instant: Timestamp) {
        self.nanos.fetch_max(instant.as_nanos(), Ordering::AcqRel);
    }
}

impl Clock for HandClock {
    fn now(&self) -> Timestamp {
        Timestamp::from_nanos(self.nanos.load(Ordering::Acquire))
    }

    fn sleep_until(&self, instant: Timestamp) {
        self.advance_to(instant);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hand_clock_waits_without_time_and_never_goes_back() {
        let clock = HandClock::at(Timestamp::from_nanos(10));
        clock.sleep_until(Timestamp::from_nanos(25));
        assert_eq!(clock.now(), Timestamp::from_nanos(25));
        clock.advance_to(Timestamp::from_nanos(5));
        assert_eq!(clock.now(), Timestamp::from_nanos(25));
    }

    #[test]
    fn the_host_clock_waits() {
        let clock = HostClock::start();
        let until = clock.now().saturating_add(Span::from_millis(3));
        clock.sleep_until(until);
        assert!(clock.now() >= until);
    }
}
