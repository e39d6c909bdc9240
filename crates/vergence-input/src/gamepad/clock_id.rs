//! The one system call that `evdev` lacks: on which clock a node stamps its events.

#![expect(unsafe_code, reason = "the request has no safe wrapper in the crates that are used")]

use std::os::fd::AsFd;

use rustix::ioctl::{Setter, ioctl, opcode};

/// `EVIOCSCLOCKID` of linux/input.h.
const SET_CLOCK: rustix::ioctl::Opcode = opcode::write::<i32>(b'E', 0xA0);
/// `CLOCK_MONOTONIC`, which no correction of the wall clock moves.
const MONOTONIC: i32 = 1;

/// From now on the node stamps with the monotonic clock.
///
/// # Errors
/// Where the node is gone, or is none.
pub(super) fn stamp_with_the_monotonic_clock(node: impl AsFd) -> std::io::Result<()> {
    // SAFETY: the kernel defines the request as one that reads an int behind the pointer, which `Setter` passes; it writes nothing.
    unsafe { ioctl(node, Setter::<SET_CLOCK, i32>::new(MONOTONIC)) }.map_err(Into::into)
}
