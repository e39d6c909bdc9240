//! How far a picture is from a reference picture: RMSE, PSNR, SSIM and FLIP.
//!
//! Measures that people can compare with other people's: SSIM is Wang's (as scikit-image computes it with a
//! Gaussian window), FLIP is Andersson's (as NVIDIA's `flip-evaluator` computes it); both are checked against values
//! recorded from those programs (`references/oracle.py`). All work on [`Picture`]s: display-encoded sRGB in 0…1,
//! rows from the top. Nothing here returns NaN: a picture with a value that is not finite is refused when it is
//! made, pictures of different size are refused when they are compared. It depends on nothing else of Vergence.
//!
//! ```
//! use vergence_fidelity::{DEFAULT_PIXELS_PER_DEGREE, Picture, flip, rmse, ssim};
//! let reference = Picture::from_rgb8(16, 16, &[128; 16 * 16 * 3]).unwrap();
//! let test = Picture::from_rgb8(16, 16, &[130; 16 * 16 * 3]).unwrap();
//! assert!((rmse(&reference, &test).unwrap() - 2.0 / 255.0).abs() < 1e-7);
//! assert!(ssim(&reference, &test).unwrap() > 0.99);
//! assert!(flip(&reference, &test, DEFAULT_PIXELS_PER_DEGREE).unwrap().mean < 0.1);
//! ```
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
