//! Decodes PNG and JPEG within limits.

use std::fmt::Display;
use std::io::Cursor;
use std::path::Path;

use image::{ImageDecoder, ImageReader};

use crate::Error;
use crate::import::Import;
use crate::model::Image;

/// Decodes `bytes` (PNG or JPEG, told by its content) to 8-bit RGBA. `place` is where `path` holds or names it.
pub(crate) fn decode(
    import: &mut Import<'_>,
    path: &Path,
    place: impl Display,
    name: &str,
    bytes: &[u8],
) -> Result<Image, Error> {
    let invalid =
        |message: String| Error::invalid(path, &place, format!("expected a PNG or JPEG image, {message}"));
    let reader = ImageReader::new(Cursor::new(bytes))
        .with_guessed_format()
        .map_err(|error| invalid(format!("found {error}")))?;
    if reader.format().is_none() {
        return Err(invalid("found an unknown format".into()));
    }
    let mut decoder = reader.into_decoder().map_err(|error| invalid(format!("found: {error}")))?;
    let (width, height) = decoder.dimensions();
    import.charge_pixels(path, &place, width, height)?;
    if width == 0 || height == 0 {
        return Err(invalid(format!("found {width} x {height} pixels")));
    }
    // Deflate packs at most 1032 to 1: a header that promises more than the bytes can hold is not believed.
    if u64::from(width) * u64::from(height) / 8 > 1032 * bytes.len() as u64 {
        return Err(invalid(format!("found {width} x {height} pixels in {} bytes", bytes.len())));
    }
    let mut limits = image::Limits::no_limits();
    limits.max_alloc = Some(decoder.total_bytes().saturating_mul(2).saturating_add(1 << 22));
    decoder.set_limits(limits).map_err(|error| invalid(format!("found: {error}")))?;
    let decoded =
        image::DynamicImage::from_decoder(decoder).map_err(|error| invalid(format!("found: {error}")))?;
    Ok(Image { name: name.to_owned(), width, height, rgba: decoded.into_rgba8().into_raw() })
}
