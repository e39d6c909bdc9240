use nalgebra::{Matrix2, Matrix6, Vector2, Vector6};

use crate::Level;
use crate::simd::{F8, Task, vectorised};

/// A patch as it was first seen, to which every later sighting of it is brought back: what is followed from frame to frame alone
/// walks away from its point by a little each time.
///
/// The later patch is the first one under an affine map, found by the inverse compositional form of Lucas and Kanade (Baker and Matthews,
/// IJCV 56(3), 2004; for watching over points: Shi and Tomasi, "Good features to track", CVPR 1994). Gradients, and the inverse of their
/// matrix, are made once in the life of a patch; brightness and contrast are projected out of them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Anchor {
    window: usize,
    /// Columns, rounded up to vectors of eight.
    columns: usize,
    /// Values less their mean; zero beyond the window.
    centred: Vec<f32>,
    /// Six planes: how the patch changes with the four entries of the linear map (offsets in half windows) and with the shift.
    slopes: Vec<f32>,
    inverse: Matrix6<f64>,
    energy: f32,
}

/// Where an anchored patch is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Sighting {
    /// The centre.
    pub pixel: Vector2<f64>,
    /// Takes offsets in the anchor to offsets in the picture.
    pub linear: Matrix2<f64>,
    /// Correlation with the anchor, −1 to 1.
    pub likeness: f32,
}

/// Share of the mean squared slope that is added to those of the linear map: what the patch does not show stays as predicted.
const RIDGE: f64 = 1e-2;

impl Anchor {
    /// Takes the patch of `window` pixels (odd) around `pixel`; `false` where it cannot be placed by what it shows.
    pub fn take(&mut self, level: &Level, pixel: &Vector2<f64>, window: usize) -> bool {
        let half = (window / 2) as isize;
        let columns = window.next_multiple_of(8);
        self.window = window;
        self.columns = columns;
        let size = columns * window;
        self.centred.clear();
        self.centred.resize(size, 0.0);
        self.slopes.clear();
        self.slopes.resize(6 * size, 0.0);
        let (left, top) = (pixel.x.floor(), pixel.y.floor());
        let (right, down) = ((pixel.x - left) as f32, (pixel.y - top) as f32);
        let reach = half + 3;
        let (near, far) = (reach as f64 - Level::BORDER as f64, (Level::BORDER as isize - reach) as f64);
        // Not a number is not inside either.
        let inside = left >= near
            && top >= near
            && left < level.width() as f64 + far
            && top < level.height() as f64 + far;
        if !inside {
            return false;
        }
        let value = |dx: isize, dy: isize| {
            let above = level.run(left as isize + dx, top as isize + dy, 2);
            let below = level.run(left as isize + dx, top as isize + dy + 1, 2);
            let mix = |row: &[u8]| f32::from(row[0]) * (1.0 - right) + f32::from(row[1]) * right;
            mix(above) * (1.0 - down) + mix(below) * down
        };
        let scale = 1.0 / half as f32;
        for y in 0..window {
            for x in 0..window {
                let (dx, dy) = (x as isize - half, y as isize - half);
                let by_x = 0.5 * (value(dx + 1, dy) - value(dx - 1, dy));
                let by_y = 0.5 * (value(dx, dy + 1) - value(dx, dy - 1));
                let (ox, oy) = (dx as f32 * scale, dy as f32 * scale);
                let at = y * columns + x;
                self.centred[at] = value(dx, dy);
                for (k, slope) in
                    [by_x * ox, by_x * oy, by_y * ox, by_y * oy, by_x, by_y].into_iter().enumerate()
                {
                    self.slopes[k * size + at] = slope;
                }
            }
        }
        self.project_out()
    }

    /// Takes brightness and contrast out of the slopes and inverts their matrix.
    fn project_out(&mut self) -> bool {
        let (window, columns) = (self.window, self.columns);
        let size = columns * window;
        let count = (window * window) as f32;
        let places = || (0..window).flat_map(|y| (0..window).map(move |x| y * columns + x));
        let mean = places().map(|at| self.centred[at]).sum::<f32>() / count;
        places().for_each(|at| self.centred[at] -= mean);
        self.energy = places().map(|at| self.centred[at].powi(2)).sum();
        if self.energy <= 0.0 {
            return false;
        }
        for plane in self.slopes.chunks_exact_mut(size) {
            let mean = places().map(|at| plane[at]).sum::<f32>() / count;
            places().for_each(|at| plane[at] -= mean);
            let along = places().map(|at| plane[at] * self.centred[at]).sum::<f32>() / self.energy;
            places().for_each(|at| plane[at] -= along * self.centred[at]);
        }
        let mut matrix = Matrix6::zeros();
        for a in 0..6 {
            for b in 0..=a {
                let (first, second) = (&self.slopes[a * size..][..size], &self.slopes[b * size..][..size]);
                let sum: f32 = first.iter().zip(second).map(|(x, y)| x * y).sum();
                matrix[(a, b)] = f64::from(sum);
                matrix[(b, a)] = f64::from(sum);
            }
        }
        let ridge = RIDGE * matrix.diagonal().rows(0, 4).sum() / 4.0;
        for k in 0..4 {
            matrix[(k, k)] += ridge;
        }
        match matrix.cholesky() {
            Some(root) => {
                self.inverse = root.inverse();
                self.inverse.iter().all(|entry| entry.is_finite())
            }
            None => false,
        }
    }

    /// Standard deviation of the patch's place, along its weaker direction, for noise of one grey level a pixel; pixels.
    pub fn spread_px(&self) -> f64 {
        let place = self.inverse.fixed_view::<2, 2>(4, 4);
        let (half_sum, half_difference) =
            (0.5 * (place[(0, 0)] + place[(1, 1)]), 0.5 * (place[(0, 0)] - place[(1, 1)]));
        (half_sum + half_difference.hypot(place[(0, 1)])).sqrt()
    }

    /// Where the patch is in `level`, from a guess of place and linear map on; `None` where it leaves the picture or does not settle.
    pub fn find(
        &self,
        level: &Level,
        pixel: &Vector2<f64>,
        linear: &Matrix2<f64>,
        iterations: usize,
        epsilon_px: f64,
    ) -> Option<Sighting> {
        vectorised(Find { anchor: self, level, pixel: *pixel, linear: *linear, iterations, epsilon_px })
    }
}

struct Find<'a> {
    anchor: &'a Anchor,
    level: &'a Level,
    pixel: Vector2<f64>,
    linear: Matrix2<f64>,
    iterations: usize,
    epsilon_px: f64,
}

impl Find<'_> {
    /// Row `y` of the patch as it is seen, into `row`; all of it is over the picture and its border, see [`Find::inside`].
    #[inline(always)]
    fn read<const N: usize>(&self, y: usize) -> [F8; N] {
        /// Places between pixels are whole numbers of 1/65,536 pixel: cheap to split, and 1e-4 pixel over a row at most.
        const ONE: f64 = 65_536.0;
        let window = self.anchor.window;
        let half = (window / 2) as f64;
        let (raw, stride) = self.level.raw();
        let down = y as f64 - half;
        let (base_x, base_y) = (self.pixel.x.floor(), self.pixel.y.floor());
        // 64 pixels up and left of the centre, so that no place is negative.
        let start =
            self.level.origin() as isize + (base_y as isize - 64) * stride as isize + base_x as isize - 64;
        let first = Vector2::new(self.pixel.x - base_x, self.pixel.y - base_y).add_scalar(64.0)
            + self.linear * Vector2::new(-half, down);
        let whole = |x: f64| (x * ONE) as i32;
        let (x0, y0) = (whole(first.x), whole(first.y));
        let (by_x, by_y) = (whole(self.linear.m11), whole(self.linear.m21));
        std::array::from_fn(|n| {
            let mut above = [0u32; 8];
            let mut below = [0u32; 8];
            let px: [i32; 8] = std::array::from_fn(|i| x0 + by_x * (8 * n + i) as i32);
            let py: [i32; 8] = std::array::from_fn(|i| y0 + by_y * (8 * n + i) as i32);
            for i in 0..8 {
                // Beyond the window: any pixel will do, its weight is zero.
                if 8 * n + i < window {
                    let at =
                        (start + (py[i] >> 16) as isize * stride as isize + (px[i] >> 16) as isize) as usize;
                    let four =
                        |at: usize| u32::from_le_bytes(raw[at..at + 4].try_into().expect("four bytes"));
                    above[i] = four(at);
                    below[i] = four(at + stride);
                }
            }
            let part = |place: i32| (place & 0xffff) as f32 * (1.0 / ONE as f32);
            F8(std::array::from_fn(|i| {
                let (fx, fy) = (part(px[i]), part(py[i]));
                let byte = |word: u32, shift: u32| (word >> shift & 0xff) as i32 as f32;
                let upper = byte(above[i], 0) + (byte(above[i], 8) - byte(above[i], 0)) * fx;
                let lower = byte(below[i], 0) + (byte(below[i], 8) - byte(below[i], 0)) * fx;
                upper + (lower - upper) * fy
            }))
        })
    }

    /// Whether all four corners of the patch are over the picture and its border.
    #[inline(always)]
    fn inside(&self) -> bool {
        let half = (self.anchor.window / 2) as f64;
        let (ax, ay) = (self.linear.row(0).abs().sum() * half, self.linear.row(1).abs().sum() * half);
        let border = Level::BORDER as f64 - 5.0;
        ax < 50.0
            && ay < 50.0
            && self.pixel.x - ax > -border
            && self.pixel.y - ay > -border
            && self.pixel.x + ax < self.level.width() as f64 + border
            && self.pixel.y + ay < self.level.height() as f64 + border
    }
}

impl Find<'_> {
    #[inline(always)]
    fn place<const N: usize>(mut self) -> Option<Sighting> {
        let (window, columns) = (self.anchor.window, 8 * N);
        let size = columns * window;
        let half = (window / 2) as f64;
        let zero = F8::splat(0.0);
        for _ in 0..self.iterations {
            if !self.inside() {
                return None;
            }
            let mut sums = [zero; 6];
            for y in 0..window {
                let row = self.read::<N>(y);
                for (n, &value) in row.iter().enumerate() {
                    for (k, sum) in sums.iter_mut().enumerate() {
                        *sum = *sum + value * F8::load(&self.anchor.slopes[k * size + y * columns + 8 * n..]);
                    }
                }
            }
            let step: Vector6<f64> = self.anchor.inverse * Vector6::from_fn(|k, _| f64::from(sums[k].sum()));
            let linear = Matrix2::new(step[0], step[1], step[2], step[3]) / half;
            let shift = Vector2::new(step[4], step[5]);
            // The map is followed by the inverse of the step.
            let back = (Matrix2::identity() + linear).try_inverse()?;
            self.linear *= back;
            let moved = self.linear * shift;
            self.pixel -= moved;
            let length = moved.norm();
            if !length.is_finite() || length > half {
                return None;
            }
            if length < self.epsilon_px {
                break;
            }
        }
        if !self.inside() {
            return None;
        }
        let mask: [F8; N] =
            std::array::from_fn(|n| F8(std::array::from_fn(|i| if 8 * n + i < window { 1.0 } else { 0.0 })));
        let (mut sum, mut square, mut product) = (zero, zero, zero);
        for y in 0..window {
            let row = self.read::<N>(y);
            for n in 0..N {
                let value = (row[n] - F8::splat(128.0)) * mask[n];
                sum = sum + value;
                square = square + value * value;
                product = product + value * F8::load(&self.anchor.centred[y * columns + 8 * n..]);
            }
        }
        let sum = sum.sum();
        let variance = square.sum() - sum * sum / (window * window) as f32;
        let likeness =
            if variance > 0.0 { product.sum() / (variance * self.anchor.energy).sqrt() } else { -1.0 };
        Some(Sighting { pixel: self.pixel, linear: self.linear, likeness })
    }
}

impl Task for Find<'_> {
    type Out = Option<Sighting>;

    #[inline(always)]
    fn run(self) -> Option<Sighting> {
        match self.anchor.columns {
            8 => self.place::<1>(),
            16 => self.place::<2>(),
            _ => self.place::<3>(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Gray, Pyramid};

    const SIDE: usize = 160;

    /// A smooth texture seen through `map`, in other light.
    fn picture(map: impl Fn(Vector2<f64>) -> Vector2<f64>, gain: f64) -> Pyramid {
        let shade = |p: Vector2<f64>| -> f64 {
            let wave = |k: i32| {
                let k = f64::from(k);
                let (angle, length) = (k * 2.399, 7.0 + 1.9 * k);
                ((p.x * angle.cos() + p.y * angle.sin()) * std::f64::consts::TAU / length + k * k).sin()
            };
            (1..=12).map(wave).sum()
        };
        let pixel = |i: usize| {
            let p = map(Vector2::new((i % SIDE) as f64, (i / SIDE) as f64));
            (120.0 + gain * 11.0 * shade(p)).clamp(0.0, 255.0).round() as u8
        };
        let pixels: Vec<u8> = (0..SIDE * SIDE).map(pixel).collect();
        let mut pyramid = Pyramid::new(SIDE, SIDE, 1);
        pyramid.build(&Gray::new(SIDE, SIDE, SIDE, &pixels).unwrap());
        pyramid
    }

    #[test]
    fn a_patch_is_brought_back_to_what_it_was() {
        let before = picture(|p| p, 1.0);
        let centre = Vector2::new(81.3, 77.6);
        for (window, likeness) in [(11, 0.99), (15, 0.99), (21, 0.99)] {
            let mut anchor = Anchor::default();
            assert!(anchor.take(&before.levels()[0], &centre, window));
            assert!(anchor.spread_px() < 0.1, "{}", anchor.spread_px());
            for linear in [
                Matrix2::new(1.0, 0.0, 0.0, 1.0),
                Matrix2::new(1.1, 0.05, -0.02, 1.05),
                Matrix2::new(0.92, -0.15, 0.16, 0.95),
            ] {
                // Offsets d in the first picture are at goal + linear d in the second one.
                let goal = Vector2::new(84.8, 74.1);
                let inverse = linear.try_inverse().unwrap();
                let now = picture(|p| centre + inverse * (p - goal), 0.8);
                let start = goal + Vector2::new(0.7, -0.6);
                let found = anchor.find(&now.levels()[0], &start, &linear, 15, 1e-3).unwrap();
                let off = (found.pixel - goal).norm();
                assert!(off < 0.05 && found.likeness > likeness, "{window} {linear} {off} {found:?}");
                if window > 11 {
                    // The map itself is found, too, from none.
                    let from_none =
                        anchor.find(&now.levels()[0], &goal, &Matrix2::identity(), 30, 1e-3).unwrap();
                    assert!((from_none.linear - linear).norm() < 0.06, "{window} {linear} {from_none:?}");
                }
            }
        }
    }

    #[test]
    fn what_has_no_place_is_not_taken_and_nothing_is_read_beyond_the_picture() {
        let (textured, flat) = (picture(|p| p, 1.0), picture(|_| Vector2::zeros(), 1.0));
        let striped = picture(|p| Vector2::new(p.x, 0.0), 1.0);
        let mut anchor = Anchor::default();
        let centre = Vector2::new(80.0, 80.0);
        assert!(!anchor.take(&flat.levels()[0], &centre, 15));
        assert!(!anchor.take(&striped.levels()[0], &centre, 15) || anchor.spread_px() > 1.0);
        assert!(anchor.take(&textured.levels()[0], &centre, 15));
        for bad in [f64::NAN, f64::INFINITY, -1e300, 1e300, -40.0, 200.0] {
            let level = &textured.levels()[0];
            assert!(!Anchor::default().take(level, &Vector2::new(80.0, bad), 15), "{bad}");
            let identity = Matrix2::identity();
            assert_eq!(anchor.find(level, &Vector2::new(bad, 80.0), &identity, 9, 0.01), None);
            let found = anchor.find(level, &centre, &(identity * bad), 9, 0.01);
            assert!(found.is_none_or(|found| found.pixel.x.is_finite()), "{bad} {found:?}");
        }
    }
}
