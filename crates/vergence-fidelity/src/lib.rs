#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod convolve;
mod flip;
mod picture;
mod pointwise;
mod resample;
mod srgb;
mod ssim;

pub use flip::{DEFAULT_PIXELS_PER_DEGREE, ErrorMap, flip, pixels_per_degree};
pub use picture::Picture;
pub use pointwise::{psnr_db, rmse};
pub use srgb::{encoded_from_linear, linear_from_encoded};
pub use ssim::{ssim, ssim_luma};

/// Why two pictures cannot be compared.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// The pictures have different sizes.
    #[error(
        "expected a picture of {expected_width} x {expected_height} pixels, found {found_width} x {found_height}"
    )]
    Size {
        /// Of the reference.
        expected_width: usize,
        /// Of the reference.
        expected_height: usize,
        /// Of the picture under test.
        found_width: usize,
        /// Of the picture under test.
        found_height: usize,
    },
    /// The slice does not hold the picture that its size promises.
    #[error("expected {expected} values for {width} x {height} pixels, found {found}")]
    Length {
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
        /// Values that the size asks for.
        expected: usize,
        /// Values in the slice.
        found: usize,
    },
    /// The picture is smaller than the measure's window, or empty.
    #[error("expected at least {expected} x {expected} pixels, found {width} x {height}")]
    TooSmall {
        /// Side of the smallest picture.
        expected: usize,
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// A value is NaN or infinite.
    #[error("expected finite values, found {found} at pixel ({x}, {y})")]
    NotFinite {
        /// Column.
        x: usize,
        /// Row, from the top.
        y: usize,
        /// The value.
        found: f32,
    },
    /// A parameter is out of its domain.
    #[error("{name}: expected {expected}, found {found}")]
    Parameter {
        /// Which one.
        name: &'static str,
        /// Its domain.
        expected: &'static str,
        /// What was given.
        found: f64,
    },
}
