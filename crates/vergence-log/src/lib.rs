#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod chunk;
mod error;
mod header;
mod lane;
mod message;
mod messages;
mod reader;
mod recorder;
mod records;
pub mod schema;
mod sink;
pub mod wire;
mod writer;

pub use error::Error;
pub use header::{FORMAT_VERSION, Header};
pub use lane::Lane;
pub use message::{ClockKind, Message, Stream, StreamDesc, Times};
pub use reader::{Attachment, Ending, Entry, Limits, Place, Reader, StreamInfo};
pub use recorder::{Compression, Options, Recorder, Status};
