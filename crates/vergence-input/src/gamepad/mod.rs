//! Gamepads, and the inertial units inside of them, from the Linux kernel's input nodes.
//!
//! Pads are read with `gilrs`, on one thread for all of them, and shaken with its force feedback. What was measured of it
//! (0.11, Linux) is mended here: of two pads plugged in between two of its looks it reports one, so that what it lists is compared
//! with the nodes that there are, and it is made anew where they differ; it lists tablets and touchpads where udev does not run;
//! it stamps with the wall clock; it does not say how a pad stands when it is connected; 0 of a stick is half a step beside the
//! middle; once it may shake pads, it writes to every one of them 20 times a second, so that it may only from the first
//! [`Rumble`] on. Motion sensors it does not give: they are read with `evdev`. It needs libudev to be built; without the feature
//! `gamepad` nothing does.

mod clock_id;
pub mod database;
mod hub;
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
