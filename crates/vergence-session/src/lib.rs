#![doc = include_str!("../README.md")]
// One unsafe block: naming the embedded runtime's entry point.
#![deny(unsafe_code)]

mod book;
mod capture;
mod config;
mod cost;
mod desk;
mod error;
mod foresight;
mod frame_loop;
mod gaze;
mod guest;
mod headset;
mod markers;
mod motion;
mod odometry;
mod own_file;
mod place;
mod pose_log;
mod provenance;
mod recording;
mod replay;
mod report;
mod resolved;
mod rig_log;
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
pub use gaze::GazeSource;
pub use guest::{Guest, Moment, Offered, Stage, ToldGaze};
pub use markers::with_markers;
pub use motion::open_motion;
pub use own_file::own_file;
pub use place::start_of;
pub use provenance::scene_hash;
pub use replay::{ReplayConfig, ReplayReport, SessionLog, replay};
pub use report::{Milliseconds, OdometryReport, PassReport, RecordReport, RunReport, Touch};
pub use rig_log::{RIG, RigLog, annotate_rig};
pub use run::{Happening, run, run_with};
pub use stop::Stop;
pub use vergence_xr_sim::{Control, Controller, Fault, FaultPlan, PoseProvider, Presence, Tracked};
pub use verify::Comparison;
