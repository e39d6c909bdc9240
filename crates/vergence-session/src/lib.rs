//! Runs a scene on a headset: plan, headset, renderer, and the frame loop that joins them.
//!
//! [`run`] makes what the plan says and nothing else, shows the scene until it is told to stop, and reports what a user
//! would want to know: which headset and why, frames shown and missed, our own CPU time per frame, and how old the pose
//! of a picture was when it was handed to the GPU. Whatever happens to the headset meanwhile is said in a sentence, and
//! what can be recovered from is.
//!
//! The simulated headset is an OpenXR runtime that is linked in: the path to it is the path to a real one.
//!
//! ```no_run
//! use vergence_session::{RunConfig, run};
//! let scene = std::sync::Arc::new(vergence_scene::load("room.glb".as_ref(), &vergence_scene::Limits::default())?);
//! let report = run(&scene, &RunConfig { frames: Some(300), ..RunConfig::default() }, &mut |_| {})?;
//! println!("{} frames on {}", report.frames, report.headset);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
// One unsafe block: naming the embedded runtime's entry point.
#![deny(unsafe_code)]

mod book;
mod capture;
mod config;
mod cost;
mod desk;
mod error;
mod frame_loop;
mod headset;
mod markers;
mod place;
mod pose_log;
mod provenance;
mod recording;
mod replay;
mod report;
mod resolved;
mod run;
mod said_log;
mod stop;
mod tally;
mod targets;
mod touch;
mod verify;

pub use config::{CaptureConfig, HeadsetChoice, RecordConfig, RunConfig};
pub use cost::{Cost, cost_of};
pub use error::Error;
pub use markers::with_markers;
pub use place::start_of;
pub use provenance::scene_hash;
pub use replay::{ReplayConfig, ReplayReport, SessionLog, replay};
pub use report::{Milliseconds, PassReport, RecordReport, RunReport, Touch};
pub use run::{Happening, run};
pub use stop::Stop;
pub use vergence_xr_sim::{Fault, FaultPlan};
pub use verify::Comparison;
