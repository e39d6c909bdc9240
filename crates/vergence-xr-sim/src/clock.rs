//! Session time, and its relation to the host's clock.

use openxr_sys as sys;
use rustix::time::{ClockId, clock_gettime};
use vergence_time::{Clock, HandClock, HostClock, Span, Timestamp};

use crate::config::{ClockMode, EPOCH};
use crate::ffi::{Out, XrResult};
use crate::instance::Instance;

/// The clock of an instance.
pub(crate) struct RuntimeClock {
    clock: Box<dyn Clock>,
    mode: ClockMode,
    /// What it read when it was started.
    begins: Timestamp,
    /// `CLOCK_MONOTONIC` then, nanoseconds.
    host_at_begin: i64,
}

/// The host's clock, set to an instant at its start.
struct From(HostClock, Timestamp);

impl Clock for From {
    fn now(&self) -> Timestamp {
        self.1.saturating_add(Span::from_nanos(self.0.now().as_nanos()))
    }

    fn sleep_until(&self, instant: Timestamp) {
        self.0.sleep_until(instant.saturating_add(Span::from_nanos(self.1.as_nanos().saturating_neg())));
    }
}

fn monotonic_nanos() -> i64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec.saturating_mul(1_000_000_000).saturating_add(now.tv_nsec)
}

impl RuntimeClock {
    pub(crate) fn start(mode: ClockMode, begins: Timestamp) -> Self {
        let begins = begins.max(EPOCH);
        let host_at_begin = monotonic_nanos();
        let clock: Box<dyn Clock> = match mode {
            ClockMode::Virtual => Box::new(HandClock::at(begins)),
            ClockMode::RealTime => Box::new(From(HostClock::start(), begins)),
        };
        Self { clock, mode, begins, host_at_begin }
    }

    pub(crate) fn mode(&self) -> ClockMode {
        self.mode
    }

    pub(crate) fn now(&self) -> Timestamp {
        self.clock.now()
    }

    pub(crate) fn sleep_until(&self, instant: Timestamp) {
        self.clock.sleep_until(instant);
    }

    /// Session time of a reading of `CLOCK_MONOTONIC`. A virtual clock has no relation to the host's: any reading
    /// that was taken since the instance exists means "now", and smaller ones are virtual instants given back by
    /// [`Self::host_from_session`].
    fn session_from_host(&self, nanos: i64) -> i64 {
        match self.mode {
            ClockMode::RealTime => {
                nanos.saturating_sub(self.host_at_begin).saturating_add(self.begins.as_nanos())
            }
            ClockMode::Virtual if nanos >= self.host_at_begin => self.now().as_nanos(),
            ClockMode::Virtual => nanos,
        }
    }

    fn host_from_session(&self, nanos: i64) -> i64 {
        match self.mode {
            ClockMode::RealTime => {
                nanos.saturating_sub(self.begins.as_nanos()).saturating_add(self.host_at_begin)
            }
            ClockMode::Virtual => nanos,
        }
    }
}

/// # Errors
/// `XR_ERROR_TIME_INVALID` for instants that are not after 0.
pub(crate) fn valid_time(time: sys::Time) -> XrResult<Timestamp> {
    if time.as_nanos() > 0 {
        Ok(Timestamp::from_nanos(time.as_nanos()))
    } else {
        Err(sys::Result::ERROR_TIME_INVALID)
    }
}

const SECOND: i64 = 1_000_000_000;

pub(crate) fn convert_timespec_to_time(
    instance: &Instance,
    timespec: *const libc::timespec,
    mut out: Out<sys::Time>,
) -> XrResult {
    out.check()?;
    if timespec.is_null() || !timespec.is_aligned() {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    // SAFETY: not null and aligned; the application lends it for the call.
    let timespec = unsafe { *timespec };
    if !(0..SECOND).contains(&timespec.tv_nsec) || timespec.tv_sec < 0 {
        return Err(sys::Result::ERROR_TIME_INVALID);
    }
    let nanos = timespec.tv_sec.saturating_mul(SECOND).saturating_add(timespec.tv_nsec);
    let time = sys::Time::from_nanos(instance.clock.session_from_host(nanos));
    valid_time(time)?;
    out.set(time)?;
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn convert_time_to_timespec(
    instance: &Instance,
    time: sys::Time,
    mut out: Out<libc::timespec>,
) -> XrResult {
    let nanos = instance.clock.host_from_session(valid_time(time)?.as_nanos());
    if nanos < 0 {
        return Err(sys::Result::ERROR_TIME_INVALID);
    }
    out.set(libc::timespec { tv_sec: nanos / SECOND, tv_nsec: nanos % SECOND })?;
    Ok(sys::Result::SUCCESS)
}
