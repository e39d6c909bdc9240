use crate::{Error, srgb::encoded_from_linear};

/// A picture as a display gets it: sRGB-encoded red, green, blue in 0…1, interleaved, rows from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    width: usize,
    height: usize,
    rgb: Vec<f32>,
}

impl Picture {
    /// From 8-bit sRGB: `3 · width · height` bytes, interleaved, rows from the top.
    ///
    /// # Errors
    /// Where the slice has another length, or the picture is empty.
    pub fn from_rgb8(width: usize, height: usize, rgb: &[u8]) -> Result<Self, Error> {
        check_length(width, height, 3, rgb.len())?;
        Ok(Self { width, height, rgb: rgb.iter().map(|&v| f32::from(v) / 255.0).collect() })
    }

    /// From 8-bit sRGB with alpha, which is ignored: `4 · width · height` bytes, interleaved, rows from the top.
    ///
    /// # Errors
    /// Where the slice has another length, or the picture is empty.
    pub fn from_rgba8(width: usize, height: usize, rgba: &[u8]) -> Result<Self, Error> {
        check_length(width, height, 4, rgba.len())?;
        let rgb = rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).map(|v| f32::from(v) / 255.0);
        Ok(Self { width, height, rgb: rgb.collect() })
    }

    /// From sRGB-encoded values, `3 · width · height` of them, interleaved, rows from the top. Values outside of 0…1
    /// are clamped, as a display does.
    ///
    /// # Errors
    /// Where the slice has another length, the picture is empty, or a value is not finite.
    pub fn from_encoded(width: usize, height: usize, rgb: &[f32]) -> Result<Self, Error> {
        check_length(width, height, 3, rgb.len())?;
        if let Some(index) = rgb.iter().position(|v| !v.is_finite()) {
            let pixel = index / 3;
            return Err(Error::NotFinite { x: pixel % width, y: pixel / width, found: rgb[index] });
        }
        Ok(Self { width, height, rgb: rgb.iter().map(|v| v.clamp(0.0, 1.0)).collect() })
    }

    /// From linear light, `3 · width · height` values, interleaved, rows from the top; 1 is the display's white.
    /// Values outside of 0…1 are clamped.
    ///
    /// # Errors
    /// As [`Self::from_encoded`].
    pub fn from_linear(width: usize, height: usize, rgb: &[f32]) -> Result<Self, Error> {
        let mut picture = Self::from_encoded(width, height, rgb)?;
        picture.rgb.iter_mut().for_each(|v| *v = encoded_from_linear(*v));
        Ok(picture)
    }

    /// Pixels per row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// sRGB-encoded values in 0…1: three per pixel, interleaved, rows from the top.
    pub fn rgb(&self) -> &[f32] {
        &self.rgb
    }

    /// Rounded to 8 bits: `3 · width · height` bytes.
    pub fn to_rgb8(&self) -> Vec<u8> {
        self.rgb.iter().map(|v| (v * 255.0 + 0.5) as u8).collect()
    }

    /// One of red (0), green (1), blue (2).
    pub(crate) fn channel(&self, channel: usize) -> impl Iterator<Item = f32> + '_ {
        self.rgb.iter().skip(channel).step_by(3).copied()
    }

    pub(crate) fn from_parts(width: usize, height: usize, rgb: Vec<f32>) -> Self {
        Self { width, height, rgb }
    }

    pub(crate) fn same_size(&self, test: &Self) -> Result<(), Error> {
        if (self.width, self.height) == (test.width, test.height) {
            return Ok(());
        }
        Err(Error::Size {
            expected_width: self.width,
            expected_height: self.height,
            found_width: test.width,
            found_height: test.height,
        })
    }
}

fn check_length(width: usize, height: usize, channels: usize, found: usize) -> Result<(), Error> {
    if width == 0 || height == 0 {
        return Err(Error::TooSmall { expected: 1, width, height });
    }
    let expected = width.saturating_mul(height).saturating_mul(channels);
    if expected == found { Ok(()) } else { Err(Error::Length { width, height, expected, found }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_picture_is_refused_with_its_place() {
        assert_eq!(Picture::from_rgb8(0, 4, &[]), Err(Error::TooSmall { expected: 1, width: 0, height: 4 }));
        let short = Picture::from_rgba8(2, 2, &[0; 15]).unwrap_err();
        assert_eq!(short.to_string(), "expected 16 values for 2 x 2 pixels, found 15");
        assert!(Picture::from_rgb8(usize::MAX, 2, &[0; 6]).is_err());
        let mut values = [0.5f32; 12];
        values[7] = f32::NAN;
        let nan = Picture::from_encoded(2, 2, &values).unwrap_err();
        assert_eq!(nan.to_string(), "expected finite values, found NaN at pixel (0, 1)");
        values[7] = f32::INFINITY;
        assert!(Picture::from_linear(2, 2, &values).is_err());
        values[7] = 7.0;
        assert_eq!(Picture::from_linear(2, 2, &values).unwrap().to_rgb8()[7], 255);
    }

    #[test]
    fn eight_bits_survive() {
        let bytes: Vec<u8> = (0..=254).collect();
        assert_eq!(Picture::from_rgb8(5, 17, &bytes).unwrap().to_rgb8(), bytes);
    }
}
