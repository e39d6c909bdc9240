use crate::Gray;
use crate::simd::{Task, vectorised};

/// A corner of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Corner {
    /// Column of its centre.
    pub x: u32,
    /// Row of its centre.
    pub y: u32,
    /// The largest threshold at which it still is a corner, grey levels.
    pub score: u8,
}

/// Finds corners as FAST-9/16 does: nine pixels in a row, of the sixteen on a circle of radius 3, are all brighter or all darker
/// than the centre by more than a threshold (Rosten and Drummond, "Machine learning for high-speed corner detection", 2006). Keeps
/// its buffers from picture to picture.
#[derive(Clone, Debug, Default)]
pub struct FastDetector {
    /// Scores of three rows, one pixel wider on each side.
    scores: [Vec<u8>; 3],
    /// Columns of the corners of each of the three rows.
    columns: [Vec<u32>; 3],
}

/// The circle, clockwise from the top.
const CIRCLE: [(isize, isize); 16] = [
    (0, -3),
    (1, -3),
    (2, -2),
    (3, -1),
    (3, 0),
    (3, 1),
    (2, 2),
    (1, 3),
    (0, 3),
    (-1, 3),
    (-2, 2),
    (-3, 1),
    (-3, 0),
    (-3, -1),
    (-2, -2),
    (-1, -3),
];
const ARC: u8 = 9;
const RADIUS: usize = 3;
/// Pixels that are looked at together.
const LANES: usize = 32;

impl FastDetector {
    /// Corners of `picture` that stand out by more than `threshold` grey levels and more than each of their eight neighbours,
    /// in rows from the top, from left to right in each; none within 3 pixels of the edge. Appended to `found`.
    pub fn detect(&mut self, picture: &Gray, threshold: u8, found: &mut Vec<Corner>) {
        let (width, height) = (picture.width(), picture.height());
        if width <= 2 * RADIUS || height <= 2 * RADIUS {
            return;
        }
        for scores in &mut self.scores {
            scores.clear();
            scores.resize(width + 2, 0);
        }
        self.columns.iter_mut().for_each(Vec::clear);
        for y in RADIUS..=height - RADIUS {
            let now = y % 3;
            for &x in &self.columns[now] {
                self.scores[now][x as usize + 1] = 0;
            }
            self.columns[now].clear();
            if y < height - RADIUS {
                vectorised(Row {
                    rows: std::array::from_fn(|k| picture.row(y + k - RADIUS)),
                    threshold,
                    scores: &mut self.scores[now],
                    columns: &mut self.columns[now],
                });
            }
            let (above, middle) = ((y + 1) % 3, (y + 2) % 3);
            for &x in &self.columns[middle] {
                let x = x as usize;
                let score = self.scores[middle][x + 1];
                let beside = self.scores[middle][x].max(self.scores[middle][x + 2]);
                let most = |row: usize| {
                    let near = &self.scores[row][x..x + 3];
                    near[0].max(near[1]).max(near[2])
                };
                if score > beside.max(most(above)).max(most(now)) {
                    found.push(Corner { x: x as u32, y: y as u32 - 1, score });
                }
            }
        }
    }
}

/// The corners of one row and their scores.
struct Row<'a> {
    rows: [&'a [u8]; 7],
    threshold: u8,
    scores: &'a mut [u8],
    columns: &'a mut Vec<u32>,
}

type Lanes = [u8; LANES];

#[inline(always)]
fn each(f: impl Fn(usize) -> u8) -> Lanes {
    std::array::from_fn(f)
}

impl Row<'_> {
    /// The pixels of the circle's position `k` around the `LANES` centres from column `x` on.
    #[inline(always)]
    fn ring(&self, k: usize, x: usize) -> &Lanes {
        let (dx, dy) = CIRCLE[k];
        let row = self.rows[(dy + RADIUS as isize) as usize];
        let start = (x as isize + dx) as usize;
        row[start..start + LANES].try_into().expect("as many pixels as lanes")
    }

    /// Which of the `LANES` pixels from column `x` on are corners: 255, else 0.
    #[inline(always)]
    fn flag(&self, x: usize) -> Lanes {
        let centre: &Lanes = self.rows[RADIUS][x..x + LANES].try_into().expect("as many pixels as lanes");
        let threshold = self.threshold;
        let high = each(|i| centre[i].saturating_add(threshold));
        let low = each(|i| centre[i].saturating_sub(threshold));
        let out = |value: bool| if value { 255u8 } else { 0 };
        // An arc of nine meets every pair of opposite pixels.
        let mut bright = [255u8; LANES];
        let mut dark = [255u8; LANES];
        for k in [0, 4, 2, 6] {
            let (a, b) = (self.ring(k, x), self.ring(k + 8, x));
            bright = each(|i| bright[i] & (out(a[i] > high[i]) | out(b[i] > high[i])));
            dark = each(|i| dark[i] & (out(a[i] < low[i]) | out(b[i] < low[i])));
            if k == 4 || k == 6 {
                let any = (0..LANES).fold(0, |any, i| any | bright[i] | dark[i]);
                if any == 0 {
                    return [0; LANES];
                }
            }
        }
        let mut longest = [0u8; LANES];
        let (mut bright, mut dark) = ([0u8; LANES], [0u8; LANES]);
        for k in 0..16 + ARC as usize - 1 {
            let pixel = self.ring(k % 16, x);
            bright = each(|i| (bright[i].wrapping_add(1)) & out(pixel[i] > high[i]));
            dark = each(|i| (dark[i].wrapping_add(1)) & out(pixel[i] < low[i]));
            longest = each(|i| longest[i].max(bright[i]).max(dark[i]));
        }
        each(|i| out(longest[i] >= ARC))
    }

    /// The largest threshold at which the pixel at column `x` still is a corner; −1 where it never is.
    #[inline(always)]
    fn score(&self, x: usize) -> i16 {
        let centre = i16::from(self.rows[RADIUS][x]);
        let mut difference = [0i16; 32];
        for (k, (dx, dy)) in CIRCLE.iter().enumerate() {
            let row = self.rows[(dy + RADIUS as isize) as usize];
            let d = i16::from(row[(x as isize + dx) as usize]) - centre;
            difference[k] = d;
            difference[k + 16] = d;
        }
        // Least and greatest of 2, 4, 8 and 9 neighbours, for all places on the circle at once.
        let arcs = |pick: fn(i16, i16) -> i16| -> [i16; 16] {
            let d = &difference;
            let two: [i16; 30] = std::array::from_fn(|k| pick(d[k], d[k + 1]));
            let four: [i16; 28] = std::array::from_fn(|k| pick(two[k], two[k + 2]));
            let eight: [i16; 24] = std::array::from_fn(|k| pick(four[k], four[k + 4]));
            std::array::from_fn(|k| pick(eight[k], d[k + 8]))
        };
        let brighter = arcs(Ord::min).into_iter().max().unwrap_or(0);
        let darker = -arcs(Ord::max).into_iter().min().unwrap_or(0);
        brighter.max(darker) - 1
    }
}

impl Task for Row<'_> {
    type Out = ();

    #[inline(always)]
    fn run(self) {
        let width = self.rows[0].len();
        let end = width - RADIUS;
        let mut x = RADIUS;
        while x < end {
            // The last lanes of a row are looked at together with some that came before; a narrow part goes one by one.
            let mut flags = [0u8; LANES];
            let from = if x + LANES <= end {
                flags = self.flag(x);
                x
            } else if end >= RADIUS + LANES {
                let from = end - LANES;
                flags = self.flag(from);
                flags[..x - from].fill(0);
                from
            } else {
                for (i, flag) in flags.iter_mut().enumerate().take(end - x) {
                    *flag = if self.score(x + i) >= i16::from(self.threshold) { 255 } else { 0 };
                }
                x
            };
            for (word, eight) in flags.chunks_exact(8).enumerate() {
                let mut bits = u64::from_le_bytes(eight.try_into().expect("eight bytes"));
                while bits != 0 {
                    let i = bits.trailing_zeros() as usize / 8;
                    bits &= !(0xff << (8 * i));
                    let column = from + 8 * word + i;
                    self.scores[column + 1] = self.score(column).clamp(0, 255) as u8;
                    self.columns.push(column as u32);
                }
            }
            x = from + LANES;
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// The definition, pixel by pixel.
    fn is_corner(picture: &Gray, x: usize, y: usize, threshold: i32) -> bool {
        let at = |dx: isize, dy: isize| {
            i32::from(picture.row((y as isize + dy) as usize)[(x as isize + dx) as usize])
        };
        let centre = at(0, 0);
        (0..16).any(|start| {
            let arc = |test: &dyn Fn(i32) -> bool| {
                (0..9).all(|k| {
                    let (dx, dy) = CIRCLE[(start + k) % 16];
                    test(at(dx, dy))
                })
            };
            arc(&|p| p > centre + threshold) || arc(&|p| p < centre - threshold)
        })
    }

    fn by_definition(picture: &Gray, threshold: u8) -> Vec<Corner> {
        let inside = |x: usize, y: usize| {
            (RADIUS..picture.width() - RADIUS).contains(&x)
                && (RADIUS..picture.height() - RADIUS).contains(&y)
        };
        let score = |x: usize, y: usize| {
            if !inside(x, y) || !is_corner(picture, x, y, i32::from(threshold)) {
                return 0;
            }
            (i32::from(threshold)..256).take_while(|t| is_corner(picture, x, y, *t)).last().unwrap_or(0)
        };
        let mut all = Vec::new();
        for y in RADIUS..picture.height() - RADIUS {
            for x in RADIUS..picture.width() - RADIUS {
                let own = score(x, y);
                let near = (y - 1..=y + 1).flat_map(|v| (x - 1..=x + 1).map(move |u| (u, v)));
                if own > 0 && near.filter(|p| *p != (x, y)).all(|(u, v)| score(u, v) < own) {
                    all.push(Corner { x: x as u32, y: y as u32, score: own as u8 });
                }
            }
        }
        all
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]

        #[test]
        fn corners_are_those_of_the_definition(
            width in 1usize..90, height in 1usize..24, threshold in 1u8..60, coarse in 1u8..128, seed in any::<u64>(),
        ) {
            let mut state = seed;
            let pixels: Vec<u8> = (0..width * height).map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 56) as u8 / coarse * coarse
            }).collect();
            let picture = Gray::new(width, height, width, &pixels).unwrap();
            let mut found = Vec::new();
            let mut detector = FastDetector::default();
            detector.detect(&picture, threshold, &mut found);
            if width > 6 && height > 6 {
                prop_assert_eq!(&found, &by_definition(&picture, threshold));
            } else {
                prop_assert!(found.is_empty());
            }
            // What was found before leaves no trace.
            let mut again = Vec::new();
            detector.detect(&picture, threshold, &mut again);
            prop_assert_eq!(found, again);
        }
    }
}
