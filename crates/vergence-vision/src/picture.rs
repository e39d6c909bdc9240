use crate::Error;

/// A grey picture that somebody else owns: rows from top to bottom, one byte a pixel.
#[derive(Clone, Copy, Debug)]
pub struct Gray<'a> {
    width: usize,
    height: usize,
    stride: usize,
    pixels: &'a [u8],
}

impl<'a> Gray<'a> {
    /// A picture of `width` × `height` pixels whose rows begin `stride` bytes apart.
    ///
    /// # Errors
    /// No pixels, a stride below the width, too few bytes, sides above 65,535.
    pub fn new(width: usize, height: usize, stride: usize, pixels: &'a [u8]) -> Result<Self, Error> {
        const LARGEST: usize = 65_535;
        let expected = stride.saturating_mul(height.saturating_sub(1)).saturating_add(width);
        let sound = width > 0 && height > 0 && width <= LARGEST && height <= LARGEST && stride >= width;
        if !sound || pixels.len() < expected {
            return Err(Error::Pixels { width, height, stride, expected, found: pixels.len() });
        }
        Ok(Self { width, height, stride, pixels })
    }

    /// Pixels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Row `y`, from 0 at the top.
    ///
    /// # Panics
    /// Where there is no such row.
    #[inline]
    pub fn row(&self, y: usize) -> &'a [u8] {
        assert!(y < self.height, "row {y} of {}", self.height);
        &self.pixels[y * self.stride..][..self.width]
    }

    /// The part of `width` × `height` pixels whose upper left pixel is (`x`, `y`); `None` where it is not all inside.
    pub fn part(&self, x: usize, y: usize, width: usize, height: usize) -> Option<Self> {
        let inside = x.checked_add(width)? <= self.width && y.checked_add(height)? <= self.height;
        let start = y * self.stride + x;
        (inside && width > 0 && height > 0).then(|| Self {
            width,
            height,
            stride: self.stride,
            pixels: &self.pixels[start..],
        })
    }
}
