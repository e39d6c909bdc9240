#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod conduct;
mod course;
mod date;
mod desktop;
mod error;
mod folder;
mod headset;
mod input;
mod journal;
mod metronome;
mod reading;
mod record;
mod slip;
mod status;
mod stimuli;
mod wearer;

pub use conduct::{Conduct, Ended};
pub use course::{Course, Goal, Reading, Showing, Step};
pub use desktop::{Desk, OnDesktop, on_desktop, window_size};
pub use error::Error;
pub use folder::{Deleted, Folder, Sitting, State};
pub use headset::{InHeadset, check, in_headset};
pub use input::Input;
pub use journal::{About, Journal};
pub use metronome::{Metronome, Sound};
pub use reading::{SessionLog, imported, read, write_log};
pub use record::{Place, Record};
pub use slip::slip;
pub use status::{Finding, Kind, Participant, Status};
