/// What can be wrong with pictures and settings.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// A picture whose pixels do not fill it, or that has none.
    #[error(
        "expected {expected} bytes for {width} x {height} pixels with {stride} bytes a row, found {found}"
    )]
    Pixels {
        /// Width, pixels.
        width: usize,
        /// Height, pixels.
        height: usize,
        /// Bytes from one row to the next.
        stride: usize,
        /// Bytes that this takes.
        expected: usize,
        /// Bytes that are there.
        found: usize,
    },
    /// A picture of another size than was announced.
    #[error("camera {camera}: expected a picture of {expected:?} pixels, found {found:?}")]
    Size {
        /// The camera, from 0.
        camera: usize,
        /// Width and height announced.
        expected: [u32; 2],
        /// Width and height found.
        found: [usize; 2],
    },
    /// Another number of pictures than cameras.
    #[error("expected {expected} pictures, one for each camera, found {found}")]
    Cameras {
        /// Cameras of the rig.
        expected: usize,
        /// Pictures given.
        found: usize,
    },
    /// A setting outside of its range.
    #[error("{name}: expected {expected}, found {found}")]
    Knob {
        /// Which one.
        name: &'static str,
        /// Its range.
        expected: &'static str,
        /// What it was.
        found: String,
    },
}
