#![doc = include_str!("../README.md")]
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

pub use client::{Attachments, Client, Frame, SessionDesc, TakenTimes, Without};
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
