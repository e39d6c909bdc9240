#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod breaks;
mod chunk;
mod cut;
mod diff;
mod error;
mod fields;
mod file;
pub mod foreign;
mod header;
mod lane;
mod merge;
mod message;
mod messages;
mod reader;
mod recorder;
mod records;
mod repair;
mod rewrite;
pub mod schema;
mod sink;
mod source;
mod survey;
pub mod wire;
mod writer;

pub use breaks::Breaks;
pub use cut::{Kept, Part, cut, first_arrival};
pub use diff::{Diff, Difference, StreamDiff, diff};
pub use error::Error;
pub use fields::FieldDiff;
pub use file::sync_folder_of;
pub use header::{FORMAT_VERSION, Header};
pub use lane::Lane;
pub use merge::{Merged, merge};
pub use message::{ClockKind, Message, Stream, StreamDesc, Times};
pub use messages::{Compressed, Row};
pub use reader::{Attachment, Ending, Entry, Limits, Place, Reader, StreamInfo};
pub use recorder::{Compression, Options, Recorder, Status};
pub use repair::{Repair, repair};
pub use source::{LogSource, SourceLane};
pub use survey::{Delay, Finding, StreamSurvey, Survey};
