//! The OpenXR client: from nothing to pictures in a headset, and back from every loss.
//!
//! One path for every headset: a [`Connection`] is made through the system's loader or straight to a runtime that is
//! linked into the process ([`Way`]); a [`Client`] runs the session on it. Whatever happens outside ends in one of the
//! typed [`State`]s with a sentence for the user; nothing panics. Times that a runtime makes up are replaced
//! ([`TimeGuard`]), poses that may not be read are not read, and the views handed to the runtime are, bit for bit, those
//! that the picture was drawn with.
//!
//! What is not in the plan is not asked for: extensions, actions, hand joints and gaze come from there. The frame loop's
//! calls allocate nothing and take no lock. This crate draws nothing and knows no scene.
//!
//! ```no_run
//! # fn show(device: std::sync::Arc<vergence_gpu::Device>) -> Result<(), vergence_xr::Error> {
//! use vergence_xr::{Client, Connection, SessionDesc, Way};
//! let connection = std::sync::Arc::new(Connection::open(Way::Loader, "example", &[vergence_plan::VULKAN])?);
//! let actions = vergence_action::ActionSet::default();
//! let mut client = Client::new(&connection, &device, &SessionDesc::new(&actions))?;
//! while client.poll()?.is_running() {
//!     let frame = client.wait()?;
//!     client.begin()?;
//!     let eyes = client.locate(frame.prediction.display)?;
//!     // acquire, draw with `eyes`, submit ...
//!     client.end(&frame, eyes.as_ref())?;
//! }
//! # Ok(()) }
//! ```
// OpenXR and Vulkan are C interfaces: raw calls for what the safe crate lacks (depth layers, no allocation per frame).
#![allow(unsafe_code)]

mod client;
mod connection;
mod convert;
mod error;
mod event;
mod hands;
mod hidden_area;
mod input;
mod list;
mod located;
mod opening;
mod runtime_clock;
mod state;
mod swapchain;
mod tap;
mod time_guard;
mod vulkan;
mod waiter;

pub use client::{Attachments, Client, Frame, SessionDesc};
pub use connection::{Connection, Description, EmbeddedRuntime, ViewSize, Way};
pub use error::Error;
pub use event::Notice;
pub use hidden_area::HiddenArea;
pub use input::Reading;
pub use located::{Located, in_world};
pub use opening::Pictures;
pub use state::State;
pub use tap::{HEARD_CALLS, Tap};
pub use time_guard::{Prediction, TimeFault, TimeGuard};
pub use vulkan::Creator;
