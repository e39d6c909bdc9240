use crate::{
    Error, Picture,
    srgb::{encoded_from_linear, linear_from_encoded},
};

/// Largest side of a resampled picture, pixels.
const LARGEST_SIDE: usize = 1 << 15;

impl Picture {
    /// Every block of `factor` × `factor` pixels averaged in linear light: a picture drawn `factor` times too large
    /// in each direction becomes one with `factor²` samples per pixel and a box filter of one pixel. O(pixels).
    ///
    /// # Errors
    /// Where `factor` is 0 or does not divide both sides.
    pub fn averaged(&self, factor: usize) -> Result<Self, Error> {
        let divides =
            factor > 0 && self.width().is_multiple_of(factor) && self.height().is_multiple_of(factor);
        if !divides {
            let (name, expected) = ("factor", "a divisor of both sides");
            return Err(Error::Parameter { name, expected, found: factor as f64 });
        }
        let (width, height) = (self.width() / factor, self.height() / factor);
        let mut sums = vec![0.0f32; 3 * width * height];
        for (y, row) in self.rgb().chunks_exact(3 * self.width()).enumerate() {
            let out = &mut sums[3 * width * (y / factor)..3 * width * (y / factor + 1)];
            for (x, pixel) in row.chunks_exact(3).enumerate() {
                let sum = &mut out[3 * (x / factor)..3 * (x / factor) + 3];
                sum.iter_mut().zip(pixel).for_each(|(sum, &value)| *sum += linear_from_encoded(value));
            }
        }
        let scale = 1.0 / (factor * factor) as f32;
        let rgb = sums.iter().map(|sum| encoded_from_linear((sum * scale).clamp(0.0, 1.0))).collect();
        Ok(Self::from_parts(width, height, rgb))
    }

    /// Stretched to `width` × `height` pixels by bilinear interpolation in linear light, pixel centres at half
    /// integers, the edge going on: what a compositor's sampler does with a layer of another size. Shrinking by more
    /// than two skips pixels, as that sampler would. O(result's pixels).
    ///
    /// # Errors
    /// Where a side is 0 or longer than 32768.
    pub fn stretched(&self, width: usize, height: usize) -> Result<Self, Error> {
        for side in [width, height] {
            if !(1..=LARGEST_SIDE).contains(&side) {
                let (name, expected) = ("side of a picture", "1 to 32768 pixels");
                return Err(Error::Parameter { name, expected, found: side as f64 });
            }
        }
        let linear: Vec<f32> = self.rgb().iter().map(|&v| linear_from_encoded(v)).collect();
        let columns = taps(width, self.width());
        let mut rgb = Vec::with_capacity(3 * width * height);
        for [top, bottom] in taps(height, self.height()) {
            for [left, right] in &columns {
                for channel in 0..3 {
                    let at = |x: &Tap, y: &Tap| linear[3 * (y.index * self.width() + x.index) + channel];
                    let upper = left.weight * at(left, &top) + right.weight * at(right, &top);
                    let lower = left.weight * at(left, &bottom) + right.weight * at(right, &bottom);
                    let value = top.weight * upper + bottom.weight * lower;
                    rgb.push(encoded_from_linear(value.clamp(0.0, 1.0)));
                }
            }
        }
        Ok(Self::from_parts(width, height, rgb))
    }
}

struct Tap {
    index: usize,
    weight: f32,
}

/// The two neighbours of each of `to` pixels among `from` pixels.
fn taps(to: usize, from: usize) -> Vec<[Tap; 2]> {
    let tap = |i: usize| {
        let position = ((i as f64 + 0.5) * from as f64 / to as f64 - 0.5).clamp(0.0, (from - 1) as f64);
        let index = position as usize;
        let weight = (position - index as f64) as f32;
        [Tap { index, weight: 1.0 - weight }, Tap { index: (index + 1).min(from - 1), weight }]
    };
    (0..to).map(tap).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn black_and_white_average_to_half_the_light_not_half_the_code() {
        let checker = Picture::from_rgb8(2, 2, &[0, 0, 0, 255, 255, 255, 255, 255, 255, 0, 0, 0]).unwrap();
        let grey = checker.averaged(2).unwrap();
        assert_eq!((grey.width(), grey.height(), grey.to_rgb8()[0]), (1, 1, 188));
        let wide = Picture::from_rgb8(2, 1, &[0, 0, 0, 255, 255, 255]).unwrap().stretched(3, 1).unwrap();
        assert_eq!(wide.to_rgb8(), [0, 0, 0, 188, 188, 188, 255, 255, 255]);
    }

    #[test]
    fn the_same_size_is_the_same_picture() {
        let picture =
            Picture::from_rgb8(3, 2, &std::array::from_fn::<u8, 18, _>(|i| (i * 14) as u8)).unwrap();
        assert_eq!(picture.stretched(3, 2).unwrap().to_rgb8(), picture.to_rgb8());
        assert_eq!(picture.averaged(1).unwrap().to_rgb8(), picture.to_rgb8());
        assert!(picture.averaged(2).is_err() && picture.averaged(0).is_err());
        assert!(picture.stretched(0, 2).is_err());
    }
}
