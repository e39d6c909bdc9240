//! Pictures from cameras.

use std::borrow::Cow;

/// A picture as a camera gave it: rows from the top, each `step` bytes long; or compressed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image<'a> {
    /// Pixels per row; 0 where it is compressed, since the data say it.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Bytes from one row to the next.
    pub step: u32,
    /// Of pixels: `mono8`, `mono16`, `rgb8`, `rgba8`, `bgr8`, `yuv422`, …; of compressed ones: `jpeg`, `png`, `webp`.
    pub encoding: Cow<'a, str>,
    /// Borrowed from whoever has it, so that a recording copies it once.
    pub data: Cow<'a, [u8]>,
}
