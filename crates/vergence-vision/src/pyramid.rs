use crate::Gray;
use crate::simd::{Task, vectorised};

/// One picture of a pyramid, with its edge pixels repeated outwards so that patches may reach over the edge.
#[derive(Clone, Debug)]
pub struct Level {
    width: usize,
    height: usize,
    stride: usize,
    pixels: Vec<u8>,
}

/// A picture and its halves, quarters and so on. Pixel (x, y) of level n lies over pixel (2ⁿ x, 2ⁿ y) of the picture.
#[derive(Clone, Debug)]
pub struct Pyramid {
    levels: Vec<Level>,
    /// One row of sums down the columns, with two pixels on each side.
    sums: Vec<u16>,
}

impl Level {
    /// How far the edge pixels are repeated.
    pub const BORDER: usize = 32;

    pub(crate) fn new(width: usize, height: usize) -> Self {
        let stride = (width + 2 * Self::BORDER).next_multiple_of(32);
        Self { width, height, stride, pixels: vec![0; stride * (height + 2 * Self::BORDER)] }
    }

    /// Pixels in a row, without the border.
    #[inline]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows, without the border.
    #[inline]
    pub fn height(&self) -> usize {
        self.height
    }

    /// `count` pixels of row `y` from column `x` on; both may reach [`Level::BORDER`] pixels over the edge.
    ///
    /// # Panics
    /// Farther outside.
    #[inline]
    pub fn run(&self, x: isize, y: isize, count: usize) -> &[u8] {
        let border = Self::BORDER as isize;
        let row = (y + border) as usize;
        let start = row * self.stride + (x + border) as usize;
        &self.pixels[start..start + count]
    }

    /// Where pixel (0, 0) stands in [`Level::raw`].
    #[inline]
    pub(crate) fn origin(&self) -> usize {
        Self::BORDER * self.stride + Self::BORDER
    }

    /// All pixels with their border, and the bytes from one row to the next.
    #[inline]
    pub(crate) fn raw(&self) -> (&[u8], usize) {
        (&self.pixels, self.stride)
    }

    /// The picture without its border.
    pub fn gray(&self) -> Gray<'_> {
        let pixels = &self.pixels[self.origin()..];
        Gray::new(self.width, self.height, self.stride, pixels).expect("a level holds all of its rows")
    }

    pub(crate) fn row_mut(&mut self, y: usize) -> &mut [u8] {
        let start = self.origin() + y * self.stride;
        &mut self.pixels[start..start + self.width]
    }

    /// Takes the pixels of a picture of the same size, and leaves the border.
    pub(crate) fn copy(&mut self, picture: &Gray) {
        for y in 0..self.height {
            self.row_mut(y).copy_from_slice(picture.row(y));
        }
    }

    /// Fills the border.
    pub(crate) fn repeat_edges(&mut self) {
        let (border, stride, width) = (Self::BORDER, self.stride, self.width);
        for y in 0..self.height {
            let row = &mut self.pixels[(y + border) * stride..][..stride];
            let (first, last) = (row[border], row[border + width - 1]);
            row[..border].fill(first);
            row[border + width..].fill(last);
        }
        let top = border * stride;
        let bottom = (border + self.height - 1) * stride;
        for k in 0..border {
            self.pixels.copy_within(top..top + stride, k * stride);
            self.pixels.copy_within(bottom..bottom + stride, bottom + (k + 1) * stride);
        }
    }
}

impl Pyramid {
    /// Room for `levels` pictures (at least one), the first of `width` × `height`; fewer where one would be narrower than 16 pixels.
    pub fn new(width: usize, height: usize, levels: usize) -> Self {
        const NARROWEST: usize = 16;
        let (mut w, mut h) = (width.max(1), height.max(1));
        let mut all = vec![Level::new(w, h)];
        while all.len() < levels && w.div_ceil(2) >= NARROWEST && h.div_ceil(2) >= NARROWEST {
            (w, h) = (w.div_ceil(2), h.div_ceil(2));
            all.push(Level::new(w, h));
        }
        Self { levels: all, sums: vec![0; width.max(1) + 8] }
    }

    /// Takes `picture` as the first level and makes the others: a binomial filter of five taps, then every second pixel.
    ///
    /// # Panics
    /// Where the picture is not of the size that [`Pyramid::new`] was told.
    pub fn build(&mut self, picture: &Gray) {
        let first = &mut self.levels[0];
        assert_eq!((picture.width(), picture.height()), (first.width, first.height), "size of the picture");
        first.copy(picture);
        first.repeat_edges();
        for n in 1..self.levels.len() {
            let (above, below) = self.levels.split_at_mut(n);
            let (from, to) = (&above[n - 1], &mut below[0]);
            vectorised(Halve { from, to, sums: &mut self.sums });
            to.repeat_edges();
        }
    }

    /// The pictures, largest first.
    #[inline]
    pub fn levels(&self) -> &[Level] {
        &self.levels
    }
}

/// Fills `to` with the filtered half of `from`.
struct Halve<'a> {
    from: &'a Level,
    to: &'a mut Level,
    sums: &'a mut [u16],
}

impl Task for Halve<'_> {
    type Out = ();

    #[inline(always)]
    fn run(self) {
        let width = self.from.width + 5;
        let sums = &mut self.sums[..width];
        for y in 0..self.to.height {
            let centre = 2 * y as isize;
            let [a, b, c, d, e]: [&[u8]; 5] =
                std::array::from_fn(|k| self.from.run(-2, centre + k as isize - 2, width));
            for i in 0..width {
                let outer = u16::from(a[i]) + u16::from(e[i]);
                let inner = u16::from(b[i]) + u16::from(d[i]);
                sums[i] = outer + 4 * inner + 6 * u16::from(c[i]);
            }
            let row = self.to.row_mut(y);
            for (pixel, s) in row.iter_mut().zip(sums.windows(5).step_by(2)) {
                // At most 16 · 16 · 255 + 128 = 65,408.
                let sum = s[0] + s[4] + 4 * (s[1] + s[3]) + 6 * s[2] + 128;
                *pixel = (sum >> 8) as u8;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_level_is_the_binomial_mean_of_the_one_above() {
        for (width, height) in [(64, 48), (75, 33), (34, 35)] {
            let pixels: Vec<u8> = (0..width * height).map(|i| (i * 7919 % 251) as u8).collect();
            let picture = Gray::new(width, height, width, &pixels).unwrap();
            let mut pyramid = Pyramid::new(width, height, 3);
            pyramid.build(&picture);
            for pair in pyramid.levels().windows(2) {
                let (above, below) = (&pair[0], &pair[1]);
                assert_eq!(
                    (below.width(), below.height()),
                    (above.width().div_ceil(2), above.height().div_ceil(2))
                );
                for y in 0..below.height() as isize {
                    for x in 0..below.width() as isize {
                        let taps = [1u32, 4, 6, 4, 1];
                        let mut sum = 128;
                        for (j, v) in (-2..).zip(taps) {
                            for (i, h) in (-2..).zip(taps) {
                                sum += v * h * u32::from(above.run(2 * x + i, 2 * y + j, 1)[0]);
                            }
                        }
                        assert_eq!(u32::from(below.run(x, y, 1)[0]), sum >> 8, "{x} {y} of {width}x{height}");
                    }
                }
            }
        }
    }

    #[test]
    fn edges_are_repeated() {
        let pixels: Vec<u8> = (0..20 * 17).map(|i| (i % 256) as u8).collect();
        let mut pyramid = Pyramid::new(20, 17, 1);
        pyramid.build(&Gray::new(20, 17, 20, &pixels).unwrap());
        let level = &pyramid.levels()[0];
        assert_eq!(level.run(-32, -32, 1)[0], pixels[0]);
        assert_eq!(level.run(51, 48, 1)[0], pixels[20 * 17 - 1]);
        assert_eq!(level.run(-5, 3, 1)[0], pixels[60]);
    }
}
