use nalgebra::Vector2;

use crate::brief::{ANGLES, Descriptor, PATCH, Pattern};
use crate::pyramid::Level;
use crate::simd::{Task, vectorised};
use crate::{Corner, Error, FastDetector, Gray};

/// How [`Orb`] finds and describes points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrbKnobs {
    /// Points in a picture, 1 to 100,000. Default 1000. Time of describing and matching grows with it.
    pub features: usize,
    /// Levels of the pyramid, 1 to 16. Default 8. Few: points are lost when their distance changes.
    pub levels: usize,
    /// A level is this much smaller than the one before, 1.05 to 2. Default 1.2.
    pub scale: f64,
    /// Threshold of FAST, grey levels, 3 to 100. Default 20.
    pub threshold: u8,
    /// Descriptors are not turned with the patch (BRIEF): for cameras that stay upright, where they tell more. Default false.
    pub upright: bool,
}

impl Default for OrbKnobs {
    fn default() -> Self {
        Self { features: 1000, levels: 8, scale: 1.2, threshold: 20, upright: false }
    }
}

/// A corner with a scale and a direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keypoint {
    /// Where, pixels right and down of the centre of the upper left pixel, in the picture itself.
    pub pixel: Vector2<f64>,
    /// The level that it was found on, from 0.
    pub level: u8,
    /// How much larger than in the picture a pixel of that level is.
    pub scale: f64,
    /// From its centre to its brightness' centroid, clockwise from the right, −π to π radians.
    pub angle_rad: f32,
    /// Harris' measure, comparable within a level and a picture.
    pub response: f32,
}

/// Finds oriented corners on several scales and describes each by 256 bits: FAST, ranked by Harris' measure, with the direction of the
/// intensity centroid, and comparisons of smoothed pixels in that direction (E. Rublee, V. Rabaud, K. Konolige, G. Bradski, "ORB: an
/// efficient alternative to SIFT or SURF", ICCV 2011). Keeps its buffers from picture to picture.
#[derive(Clone, Debug)]
pub struct Orb {
    knobs: OrbKnobs,
    size: [usize; 2],
    levels: Vec<Scaled>,
    pattern: Pattern,
    fast: FastDetector,
    corners: Vec<Corner>,
    ranked: Vec<(f32, Corner)>,
    /// One row of a picture between two of its rows, and sums down the columns.
    row: Vec<u16>,
    sums: Vec<u32>,
}

#[derive(Clone, Debug)]
struct Scaled {
    picture: Level,
    /// Smoothed, without border.
    smooth: Vec<u8>,
    /// The source column of each column, and how much of the next one, of 256.
    columns: Vec<(u32, u16)>,
    rows: Vec<(u32, u16)>,
    factor: [f64; 2],
    quota: usize,
}

/// A point must be this far from the edge of its level, pixels: its patch is inside.
const MARGIN: u32 = PATCH as u32 + 1;

impl Orb {
    /// For pictures of `width` × `height` pixels. Levels too small for a patch are left out.
    ///
    /// # Errors
    /// A knob outside of its range; a picture too small for a patch, or too large for [`Gray`].
    pub fn new(width: usize, height: usize, knobs: OrbKnobs) -> Result<Self, Error> {
        let check = |sound: bool, name, expected, found: String| {
            if sound { Ok(()) } else { Err(Error::Knob { name, expected, found }) }
        };
        let k = &knobs;
        check((1..=100_000).contains(&k.features), "features", "1 to 100000", k.features.to_string())?;
        check((1..=16).contains(&k.levels), "levels", "1 to 16", k.levels.to_string())?;
        check((1.05..=2.0).contains(&k.scale), "scale", "1.05 to 2", k.scale.to_string())?;
        check((3..=100).contains(&k.threshold), "threshold", "3 to 100", k.threshold.to_string())?;
        let least = 2 * MARGIN as usize + 1;
        let fits = |side: usize| (least..=65_535).contains(&side);
        check(fits(width) && fits(height), "size", "33 to 65535", format!("{width} x {height}"))?;
        let mut levels: Vec<Scaled> = Vec::new();
        for n in 0..knobs.levels {
            let shrink = knobs.scale.powi(n as i32);
            let [w, h] = [width, height].map(|side| (side as f64 / shrink).round() as usize);
            if w < least || h < least {
                break;
            }
            let before = levels.last().map_or([w, h], |l| [l.picture.width(), l.picture.height()]);
            levels.push(Scaled {
                picture: Level::new(w, h),
                smooth: vec![0; w * h],
                columns: places(before[0], w),
                rows: places(before[1], h),
                factor: [width as f64 / w as f64, height as f64 / h as f64],
                quota: 0,
            });
        }
        // As many for each pixel of every level's side.
        let total: f64 = (0..levels.len()).map(|n| knobs.scale.powi(-(n as i32))).sum();
        let (mut given, count) = (0, levels.len());
        for (n, level) in levels.iter_mut().enumerate() {
            let share = (knobs.features as f64 * knobs.scale.powi(-(n as i32)) / total).round() as usize;
            level.quota =
                if n + 1 == count { knobs.features - given } else { share.min(knobs.features - given) };
            given += level.quota;
        }
        Ok(Self {
            size: [width, height],
            levels,
            pattern: Pattern::new(),
            fast: FastDetector::default(),
            corners: Vec::new(),
            ranked: Vec::new(),
            row: vec![0; width + 32],
            sums: vec![0; width + 32],
            knobs,
        })
    }

    /// The settings.
    pub fn knobs(&self) -> &OrbKnobs {
        &self.knobs
    }

    /// Finds and describes the points of `picture`, coarser levels later, in rows on each; what was in the lists is dropped.
    ///
    /// # Errors
    /// A picture of another size.
    pub fn detect(
        &mut self,
        picture: &Gray,
        points: &mut Vec<Keypoint>,
        descriptors: &mut Vec<Descriptor>,
    ) -> Result<(), Error> {
        let found = [picture.width(), picture.height()];
        if found != self.size {
            return Err(Error::Size { camera: 0, expected: self.size.map(|side| side as u32), found });
        }
        points.clear();
        descriptors.clear();
        for n in 0..self.levels.len() {
            let (above, rest) = self.levels.split_at_mut(n);
            let level = &mut rest[0];
            match above.last() {
                None => level.picture.copy(picture),
                Some(larger) => vectorised(Shrink { from: &larger.picture, to: level, row: &mut self.row }),
            }
            level.picture.repeat_edges();
            let (w, h) = (level.picture.width() as u32, level.picture.height() as u32);
            self.corners.clear();
            self.fast.detect(&level.picture.gray(), self.knobs.threshold, &mut self.corners);
            let inside = |c: &Corner| c.x >= MARGIN && c.y >= MARGIN && c.x + MARGIN < w && c.y + MARGIN < h;
            self.corners.retain(inside);
            // Twice as many by FAST's score, then the best of these by Harris' measure; ties in rows.
            if self.corners.len() > 2 * level.quota {
                let order = |a: &Corner, b: &Corner| (b.score, a.y, a.x).cmp(&(a.score, b.y, b.x));
                self.corners.select_nth_unstable_by(2 * level.quota, order);
                self.corners.truncate(2 * level.quota);
            }
            let picture = &level.picture;
            self.ranked.clear();
            let ranked = self.corners.iter().map(|corner| (vectorised(Harris { picture, corner }), *corner));
            self.ranked.extend(ranked);
            if self.ranked.len() > level.quota {
                let order = |a: &(f32, Corner), b: &(f32, Corner)| {
                    b.0.total_cmp(&a.0).then((a.1.y, a.1.x).cmp(&(b.1.y, b.1.x)))
                };
                self.ranked.select_nth_unstable_by(level.quota, order);
                self.ranked.truncate(level.quota);
            }
            if self.ranked.is_empty() {
                continue;
            }
            self.ranked.sort_unstable_by_key(|(_, corner)| (corner.y, corner.x));
            vectorised(Smooth { from: &level.picture, to: &mut level.smooth, sums: &mut self.sums });
            for (response, corner) in &self.ranked {
                let (x, y) = (corner.x as usize, corner.y as usize);
                let [across, down] = vectorised(Centroid { picture: &level.picture, x, y });
                let angle_rad = down.atan2(across);
                let turn = if self.knobs.upright { 0 } else { turn_of(angle_rad) };
                descriptors.push(self.pattern.describe(&level.smooth, w as usize, x, y, turn));
                // Pixels are centred on whole numbers: edges of the pictures coincide, not centres of the first pixels.
                let place = |at: u32, axis: usize| (f64::from(at) + 0.5) * level.factor[axis] - 0.5;
                points.push(Keypoint {
                    pixel: Vector2::new(place(corner.x, 0), place(corner.y, 1)),
                    level: n as u8,
                    scale: self.knobs.scale.powi(n as i32),
                    angle_rad,
                    response: *response,
                });
            }
        }
        Ok(())
    }
}

/// The nearest of the pattern's directions.
fn turn_of(angle_rad: f32) -> usize {
    let turns = angle_rad * (ANGLES as f32 / std::f32::consts::TAU);
    (turns.round() as i32).rem_euclid(ANGLES as i32) as usize
}

/// Where `to` pixels lie between `from` ones, as the first of two and the share of the second, of 256.
fn places(from: usize, to: usize) -> Vec<(u32, u16)> {
    let step = from as f64 / to as f64;
    let place = |i: usize| {
        let at = ((i as f64 + 0.5) * step - 0.5).max(0.0);
        let first = (at as usize).min(from.saturating_sub(2));
        (first as u32, ((at - first as f64).min(1.0) * 256.0).round() as u16)
    };
    (0..to).map(place).collect()
}

/// Linear interpolation between the pixels of the larger level.
struct Shrink<'a> {
    from: &'a Level,
    to: &'a mut Scaled,
    row: &'a mut [u16],
}

impl Task for Shrink<'_> {
    type Out = ();

    #[inline(always)]
    fn run(self) {
        let width = self.from.width();
        let row = &mut self.row[..width + 1];
        for (y, &(first, share)) in self.to.rows.iter().enumerate() {
            let above = self.from.run(0, first as isize, width + 1);
            let below = self.from.run(0, first as isize + 1, width + 1);
            for ((sum, &a), &b) in row.iter_mut().zip(above).zip(below) {
                *sum = u16::from(a) * (256 - share) + u16::from(b) * share;
            }
            let out = self.to.picture.row_mut(y);
            for (pixel, &(column, share)) in out.iter_mut().zip(&self.to.columns) {
                let pair = &row[column as usize..column as usize + 2];
                let share = u32::from(share);
                let sum = u32::from(pair[0]) * (256 - share) + u32::from(pair[1]) * share;
                *pixel = ((sum + (1 << 15)) >> 16) as u8;
            }
        }
    }
}

/// A Gaussian of 2 pixels over seven, as whole numbers that sum to 256.
const TAPS: [u32; 7] = [18, 34, 49, 54, 49, 34, 18];

struct Smooth<'a> {
    from: &'a Level,
    to: &'a mut [u8],
    sums: &'a mut [u32],
}

impl Task for Smooth<'_> {
    type Out = ();

    #[inline(always)]
    fn run(self) {
        let width = self.from.width();
        let sums = &mut self.sums[..width + 6];
        for (y, out) in self.to.chunks_exact_mut(width).enumerate() {
            let rows: [&[u8]; 7] =
                std::array::from_fn(|k| self.from.run(-3, y as isize + k as isize - 3, width + 6));
            for (x, sum) in sums.iter_mut().enumerate() {
                // At most 255 · 256: sixteen bits.
                let pair = |k: usize| (u16::from(rows[k][x]) + u16::from(rows[6 - k][x])) * TAPS[k] as u16;
                *sum = u32::from(pair(0) + pair(1) + pair(2) + u16::from(rows[3][x]) * TAPS[3] as u16);
            }
            for (x, pixel) in out.iter_mut().enumerate() {
                let near: &[u32; 7] = sums[x..x + 7].try_into().expect("seven sums");
                let pair = |k: usize| (near[k] + near[6 - k]) * TAPS[k];
                *pixel = ((pair(0) + pair(1) + pair(2) + near[3] * TAPS[3] + (1 << 15)) >> 16) as u8;
            }
        }
    }
}

/// C. Harris and M. Stephens' measure over 7 × 7 pixels with Sobel's slopes, k = 0.04.
struct Harris<'a> {
    picture: &'a Level,
    corner: &'a Corner,
}

impl Task for Harris<'_> {
    type Out = f32;

    #[inline(always)]
    fn run(self) -> f32 {
        let (x, y) = (self.corner.x as isize, self.corner.y as isize);
        let (mut xx, mut xy, mut yy) = ([0i32; 8], [0i32; 8], [0i32; 8]);
        for dy in -3..=3 {
            let row = |k: isize| -> [i32; 10] {
                let pixels = self.picture.run(x - 4, y + dy + k, 10);
                std::array::from_fn(|i| i32::from(pixels[i]))
            };
            let (above, middle, below) = (row(-1), row(0), row(1));
            for i in 0..8 {
                // The eighth lane is beyond the block.
                let keep = i32::from(i < 7);
                let by_x = (above[i + 2] - above[i] + 2 * (middle[i + 2] - middle[i]) + below[i + 2]
                    - below[i])
                    * keep;
                let by_y = (below[i] - above[i] + 2 * (below[i + 1] - above[i + 1]) + below[i + 2]
                    - above[i + 2])
                    * keep;
                xx[i] += by_x * by_x;
                xy[i] += by_x * by_y;
                yy[i] += by_y * by_y;
            }
        }
        let sum = |lanes: [i32; 8]| lanes.iter().map(|l| i64::from(*l)).sum::<i64>() as f32;
        let (xx, xy, yy) = (sum(xx), sum(xy), sum(yy));
        xx * yy - xy * xy - 0.04 * (xx + yy) * (xx + yy)
    }
}

/// Half widths of the rows of a disc of radius 15.
const DISC: [u8; PATCH + 1] = [15, 15, 15, 15, 14, 14, 14, 13, 13, 12, 11, 10, 9, 8, 6, 3];

/// First moments of brightness over a disc (P. Rosin, "Measuring corner properties", CVIU 73(2), 1999): right and down.
struct Centroid<'a> {
    picture: &'a Level,
    x: usize,
    y: usize,
}

impl Task for Centroid<'_> {
    type Out = [f32; 2];

    #[inline(always)]
    fn run(self) -> [f32; 2] {
        const SIDE: usize = 2 * PATCH + 1;
        let (mut across, mut down) = (0i32, 0i32);
        for dy in -(PATCH as isize)..=PATCH as isize {
            let pixels = self.picture.run(self.x as isize - PATCH as isize, self.y as isize + dy, SIDE + 1);
            let half = i16::from(DISC[dy.unsigned_abs()]);
            let (mut sum, mut moment) = (0i32, 0i32);
            for (i, &pixel) in pixels.iter().enumerate() {
                let dx = i as i16 - PATCH as i16;
                let pixel = if dx.abs() <= half { i16::from(pixel) } else { 0 };
                sum += i32::from(pixel);
                moment += i32::from(pixel * dx);
            }
            across += moment;
            down += dy as i32 * sum;
        }
        [across as f32, down as f32]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{MatchKnobs, match_all};

    const SIDE: usize = 240;

    /// Squares of any grey, as of paper scattered on a table.
    fn paper() -> Vec<u8> {
        let mut state = 7u64;
        let mut draw = |below: u64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 33) % below) as usize
        };
        let mut pixels = vec![90; SIDE * SIDE];
        for _ in 0..300 {
            let (x, y, w, h, grey) = (draw(230), draw(230), 4 + draw(30), 4 + draw(30), draw(256));
            for v in y..(y + h).min(SIDE) {
                pixels[v * SIDE + x..v * SIDE + (x + w).min(SIDE)].fill(grey as u8);
            }
        }
        pixels
    }

    fn found(orb: &mut Orb, pixels: &[u8]) -> (Vec<Keypoint>, Vec<Descriptor>) {
        let (mut points, mut descriptors) = (Vec::new(), Vec::new());
        orb.detect(&Gray::new(SIDE, SIDE, SIDE, pixels).unwrap(), &mut points, &mut descriptors).unwrap();
        (points, descriptors)
    }

    fn share_right(
        a: &(Vec<Keypoint>, Vec<Descriptor>),
        b: &(Vec<Keypoint>, Vec<Descriptor>),
        map: impl Fn(Vector2<f64>) -> Vector2<f64>,
    ) -> (usize, f64) {
        let matches = match_all(&a.1, &b.1, &MatchKnobs::default());
        let right = |m: &&crate::Match| {
            let (from, to) = (&a.0[m.first], &b.0[m.second]);
            (map(from.pixel) - to.pixel).norm() < 2.0 * from.scale
        };
        (matches.len(), matches.iter().filter(right).count() as f64 / matches.len().max(1) as f64)
    }

    #[test]
    fn a_quarter_turn_and_half_the_light_change_nothing() {
        let mut orb = Orb::new(SIDE, SIDE, OrbKnobs { features: 300, ..OrbKnobs::default() }).unwrap();
        let pixels = paper();
        let before = found(&mut orb, &pixels);
        assert!(before.0.len() > 200 && before.0.len() <= 300, "{}", before.0.len());
        assert_eq!(before, found(&mut orb, &pixels), "what was before leaves no trace");
        // now(x, y) = before(y, SIDE − 1 − x), and darker.
        let turned: Vec<u8> =
            (0..SIDE * SIDE).map(|i| pixels[(SIDE - 1 - i % SIDE) * SIDE + i / SIDE] / 2 + 30).collect();
        let now = found(&mut orb, &turned);
        let map = |p: Vector2<f64>| Vector2::new((SIDE - 1) as f64 - p.y, p.x);
        let (count, share) = share_right(&before, &now, map);
        assert!(count > 100 && share > 0.95, "{count} {share}");
        // Without direction, a quarter turn is too much.
        let upright = OrbKnobs { features: 300, upright: true, ..OrbKnobs::default() };
        let mut orb = Orb::new(SIDE, SIDE, upright).unwrap();
        let (count, share) = share_right(&found(&mut orb, &pixels), &found(&mut orb, &turned), map);
        assert!((count as f64) * share < 30.0, "{count} {share}");
        let dark: Vec<u8> = pixels.iter().map(|p| p / 2 + 30).collect();
        let (count, share) = share_right(&found(&mut orb, &pixels), &found(&mut orb, &dark), |p| p);
        assert!(count > 100 && share > 0.95, "{count} {share}");
    }

    #[test]
    fn what_comes_nearer_is_found_on_another_level() {
        let mut orb = Orb::new(SIDE, SIDE, OrbKnobs { features: 300, ..OrbKnobs::default() }).unwrap();
        let pixels = paper();
        let before = found(&mut orb, &pixels);
        // 1.44 times as large around the upper left corner, which two levels are.
        let at = |x: f64, y: f64| {
            let (left, top) = (x as usize, y as usize);
            let (fx, fy) = (x - left as f64, y - top as f64);
            let pixel = |x: usize, y: usize| f64::from(pixels[y.min(SIDE - 1) * SIDE + x.min(SIDE - 1)]);
            let row = |y: usize| pixel(left, y) * (1.0 - fx) + pixel(left + 1, y) * fx;
            (row(top) * (1.0 - fy) + row(top + 1) * fy) as u8
        };
        let near: Vec<u8> =
            (0..SIDE * SIDE).map(|i| at((i % SIDE) as f64 / 1.44, (i / SIDE) as f64 / 1.44)).collect();
        let now = found(&mut orb, &near);
        let (count, share) = share_right(&before, &now, |p| p * 1.44);
        assert!(count > 40 && share > 0.75, "{count} {share}");
    }

    #[test]
    fn flat_and_small_pictures_have_no_points_and_wrong_ones_are_refused() {
        let mut orb = Orb::new(SIDE, SIDE, OrbKnobs::default()).unwrap();
        assert!(found(&mut orb, &vec![128; SIDE * SIDE]).0.is_empty());
        let mut smallest = Orb::new(33, 33, OrbKnobs::default()).unwrap();
        let pixels: Vec<u8> = (0..33 * 33).map(|i| (i * 97 % 251) as u8).collect();
        let picture = Gray::new(33, 33, 33, &pixels).unwrap();
        let (mut points, mut descriptors) = (Vec::new(), Vec::new());
        smallest.detect(&picture, &mut points, &mut descriptors).unwrap();
        assert!(points.len() <= 1);
        assert!(orb.detect(&picture, &mut points, &mut descriptors).is_err());
        assert!(Orb::new(32, 400, OrbKnobs::default()).is_err());
        let plain = OrbKnobs::default();
        for bad in [
            OrbKnobs { features: 0, ..plain },
            OrbKnobs { levels: 0, ..plain },
            OrbKnobs { scale: f64::NAN, ..plain },
            OrbKnobs { threshold: 2, ..plain },
        ] {
            assert!(Orb::new(SIDE, SIDE, bad).is_err(), "{bad:?}");
        }
    }
}
