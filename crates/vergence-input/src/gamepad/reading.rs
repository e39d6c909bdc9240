//! Reading from a node: waiting, the time of each event on the session's clock, loss and return.

use std::fs::OpenOptions;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::OpenOptionsExt;
use std::time::{Duration, SystemTime};

use evdev::Device;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use vergence_time::{Clock, Span, Timestamp};

use super::clock_id::stamp_with_the_monotonic_clock;
use super::node::{Node, look_up_node};
use crate::claim::Claim;
use crate::connection::TRY_AGAIN;
use crate::found::Found;

/// An event cannot be older than this and wait in the kernel: what is was stamped by another clock.
const OLDEST: Span = Span::from_millis(2000);
/// A source that is asked to end does so after this.
const LONGEST_WAIT: Duration = Duration::from_millis(100);

/// A node that is open.
pub(super) struct OpenNode {
    pub(super) device: Device,
    _claim: Claim,
}

impl OpenNode {
    /// Opens a node to be read without waiting, stamped by the monotonic clock.
    pub(super) fn open(path: &str) -> std::io::Result<Self> {
        let nonblocking = rustix::fs::OFlags::NONBLOCK.bits().cast_signed();
        // For reading only: who only looks must not be able to move a wheel.
        let file = OpenOptions::new().read(true).custom_flags(nonblocking).open(path)?;
        stamp_with_the_monotonic_clock(&file)?;
        Ok(Self { device: Device::from_fd(OwnedFd::from(file))?, _claim: Claim::on(path) })
    }

    /// Whether something is there to be read, after at most `longest`; an error is found by reading.
    pub(super) fn wait(&self, longest: Duration) -> std::io::Result<bool> {
        let mut nodes = [PollFd::from_borrowed_fd(self.device.as_fd(), PollFlags::IN)];
        let longest = longest.min(LONGEST_WAIT);
        let limit = Timespec { tv_sec: 0, tv_nsec: longest.subsec_nanos().into() };
        match poll(&mut nodes, Some(&limit)) {
            Ok(count) => Ok(count > 0),
            Err(rustix::io::Errno::INTR) => Ok(false),
            Err(error) => Err(error.into()),
        }
    }
}

/// When, on the session's clock, which reads `now`, the kernel stamped an event; `now` itself where it stamped with another clock
/// than the monotonic one.
pub(super) fn stamped(stamp: SystemTime, now: Timestamp) -> Timestamp {
    now.saturating_add(Span::from_nanos(-age(stamp, rustix::time::ClockId::Monotonic).as_nanos()))
}

/// The same of a stamp of the wall clock, of which only the difference counts: one that was set meanwhile, by more than an event may
/// wait, is not believed.
pub(super) fn stamped_by_wall_clock(stamp: SystemTime, now: Timestamp) -> Timestamp {
    now.saturating_add(Span::from_nanos(-age(stamp, rustix::time::ClockId::Realtime).as_nanos()))
}

fn age(stamp: SystemTime, clock: rustix::time::ClockId) -> Span {
    let now = rustix::time::clock_gettime(clock);
    let now = i128::from(now.tv_sec) * 1_000_000_000 + i128::from(now.tv_nsec);
    let stamp = stamp
        .duration_since(SystemTime::UNIX_EPOCH)
        .map_or(i128::MAX, |since| i128::try_from(since.as_nanos()).unwrap_or(i128::MAX));
    match i64::try_from(now.saturating_sub(stamp)) {
        Ok(nanos) if (0..=OLDEST.as_nanos()).contains(&nanos) => Span::from_nanos(nanos),
        _ => Span::ZERO,
    }
}

/// The node of a device that may go and come back.
pub(super) struct Connection {
    wanted: Found,
    /// Opened already, not yet said.
    first: Option<(Node, OpenNode)>,
    try_at: Timestamp,
}

impl Connection {
    pub(super) fn open(device: &Found, now: Timestamp) -> std::io::Result<(Self, Node)> {
        let node = look_up_node(device).ok_or(std::io::ErrorKind::NotFound)?;
        let open = OpenNode::open(&node.found.path)?;
        Ok((Self { wanted: device.clone(), first: Some((node.clone(), open)), try_at: now }, node))
    }

    /// The node, where it is there; else waits until it is looked for again, or `until`.
    pub(super) fn again(&mut self, until: Timestamp, clock: &dyn Clock) -> Option<(Node, OpenNode)> {
        if let Some(first) = self.first.take() {
            return Some(first);
        }
        let now = clock.now();
        if now < self.try_at {
            clock.sleep_until(until.min(self.try_at));
            return None;
        }
        let node = look_up_node(&self.wanted);
        let open = node.and_then(|node| OpenNode::open(&node.found.path).ok().map(|open| (node, open)));
        self.try_at = now.saturating_add(TRY_AGAIN);
        open
    }

    pub(super) fn lost(&mut self, now: Timestamp) {
        self.try_at = now.saturating_add(TRY_AGAIN);
    }
}
