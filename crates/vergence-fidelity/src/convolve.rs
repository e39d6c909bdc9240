/// One channel of a picture: `width · height` values, rows from the top.
#[derive(Clone)]
pub(crate) struct Plane<T> {
    pub width: usize,
    pub height: usize,
    pub values: Vec<T>,
}

/// What the filters compute in: `f32` where a thousandth of a just noticeable difference is enough, `f64` where
/// nearly equal numbers are subtracted.
pub(crate) trait Real: Copy + Default + std::ops::Mul<Output = Self> + std::ops::AddAssign {}
impl Real for f32 {}
impl Real for f64 {}

impl<T: Real> Plane<T> {
    pub fn new(width: usize, height: usize, values: Vec<T>) -> Self {
        debug_assert_eq!(values.len(), width * height);
        Self { width, height, values }
    }

    /// Correlates with `horizontal` along rows and `vertical` along columns (odd lengths, the middle is the
    /// pixel itself); outside of the picture the edge goes on. O(pixels · taps).
    pub fn filtered(&self, horizontal: &[T], vertical: &[T]) -> Self {
        self.rows_filtered(horizontal).columns_filtered(vertical)
    }

    /// The horizontal half of [`Self::filtered`].
    pub fn rows_filtered(&self, kernel: &[T]) -> Self {
        let radius = kernel.len() / 2;
        let mut values = vec![T::default(); self.values.len()];
        let mut padded = vec![T::default(); self.width + 2 * radius];
        for (row, out) in self.values.chunks_exact(self.width).zip(values.chunks_exact_mut(self.width)) {
            padded[..radius].fill(row[0]);
            padded[radius..radius + self.width].copy_from_slice(row);
            padded[radius + self.width..].fill(row[self.width - 1]);
            for (tap, &weight) in kernel.iter().enumerate() {
                accumulate(out, &padded[tap..tap + self.width], weight);
            }
        }
        Self { width: self.width, height: self.height, values }
    }

    /// The vertical half of [`Self::filtered`].
    pub fn columns_filtered(&self, kernel: &[T]) -> Self {
        let radius = kernel.len() / 2;
        let mut values = vec![T::default(); self.values.len()];
        for (y, out) in values.chunks_exact_mut(self.width).enumerate() {
            for (tap, &weight) in kernel.iter().enumerate() {
                let from = (y + tap).saturating_sub(radius).min(self.height - 1);
                accumulate(out, &self.values[from * self.width..(from + 1) * self.width], weight);
            }
        }
        Self { width: self.width, height: self.height, values }
    }
}

fn accumulate<T: Real>(out: &mut [T], values: &[T], weight: T) {
    for (out, &value) in out.iter_mut().zip(values) {
        *out += weight * value;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_separable_filter_equals_the_sum_over_its_window() {
        let (width, height) = (7usize, 5usize);
        let values: Vec<f64> = (0..35).map(|i| f64::from((i * i * 7 + 3 * i) % 31)).collect();
        let plane = Plane::new(width, height, values.clone());
        let (horizontal, vertical) = ([1.0, -2.0, 0.5, 4.0, 3.0], [0.25, 2.0, -1.0]);
        let filtered = plane.filtered(&horizontal, &vertical);
        for y in 0..height {
            for x in 0..width {
                let mut sum = 0.0;
                for (j, v) in vertical.iter().enumerate() {
                    for (i, h) in horizontal.iter().enumerate() {
                        let from_x = (x + i).saturating_sub(2).min(width - 1);
                        let from_y = (y + j).saturating_sub(1).min(height - 1);
                        sum += v * h * values[from_y * width + from_x];
                    }
                }
                assert!((filtered.values[y * width + x] - sum).abs() < 1e-9, "{x} {y}");
            }
        }
    }
}
