//! Gamepads, and the inertial units inside of them, from the Linux kernel's input nodes.
//!
//! Own code rather than `gilrs`, for what was measured of it: of two pads plugged in between two polls it reports one; it stamps
//! with the wall clock; it opens every pad that there is (which makes some wheels turn), names no node, does not give the motion
//! sensors, and cannot be built without libudev. The nodes themselves are read with `evdev`, names come from SDL's
//! database, which is also what `gilrs` reads.

mod clock_id;
pub mod database;
mod layout;
mod motion;
mod node;
mod reading;
mod rumble;
mod source;

pub use motion::MotionSource;
pub use node::found;
pub use rumble::Rumble;
pub use source::GamepadSource;
