#![doc = include_str!("../README.md")]
// The loader calls a C function and hands over two structures.
#![allow(unsafe_code)]
#![warn(missing_docs)]

mod capture;
mod environment;
mod negotiate;

pub use environment::{Error, configuration};
pub use negotiate::xrNegotiateLoaderRuntimeInterface;
