#![doc = include_str!("../README.md")]
// An OpenXR runtime is a set of C functions over pointers that an application hands in, and Vulkan handles.
#![allow(unsafe_code)]
#![warn(missing_docs)]

mod action;
mod binding;
mod clock;
mod compose;
mod config;
mod entry;
mod error;
mod event;
mod extension;
pub mod fault;
mod features;
mod ffi;
mod frame;
mod graphics;
mod hand;
mod handle;
pub mod headset;
mod input;
mod instance;
mod interaction;
mod layer;
pub mod motion;
mod path;
mod pose;
mod refresh;
mod session;
mod source;
mod space;
mod swapchain;
mod system;
mod view;
mod vulkan;

pub use config::{Capture, ClockMode, ComposedEye, ComposedFrame, Config, Control, Haptic, Runtime};
pub use entry::get_instance_proc_addr;
pub use error::Error;
pub use fault::{Fault, FaultPlan};
pub use headset::Profile;
pub use motion::{Controller, Hand, Motion, PoseProvider, Presence, Replay, Script, Still, Tracked};
