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
    /// Where a row may have corners; whole words of eight.
    maybe: Vec<u8>,
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
const RADIUS: usize = 3;
/// Pixels that are scored together.
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
        self.maybe.clear();
        self.maybe.resize(width.next_multiple_of(8), 0);
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
                    maybe: &mut self.maybe,
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
    maybe: &'a mut [u8],
}

impl Row<'_> {
    /// Marks the columns that an arc of nine is possible in: it meets every pair of opposite pixels.
    #[inline(always)]
    fn mark(&mut self) {
        let count = self.rows[0].len() - 2 * RADIUS;
        let ring: [&[u8]; 16] = std::array::from_fn(|k| {
            let (dx, dy) = CIRCLE[k];
            let start = (RADIUS as isize + dx) as usize;
            &self.rows[(dy + RADIUS as isize) as usize][start..start + count]
        });
        let centre = &self.rows[RADIUS][RADIUS..RADIUS + count];
        let maybe = &mut self.maybe[..count];
        for i in 0..count {
            let (mut least, mut most) = (255u8, 0u8);
            for k in 0..8 {
                let (a, b) = (ring[k][i], ring[k + 8][i]);
                least = least.min(a.max(b));
                most = most.max(a.min(b));
            }
            let out = least.saturating_sub(centre[i]).max(centre[i].saturating_sub(most));
            maybe[i] = u8::from(out > self.threshold);
        }
    }

    /// How far the best arc of nine stands out, less 1: the largest threshold at which the pixel still is a corner. For up to `LANES`
    /// columns at once.
    #[inline(always)]
    fn score(&self, columns: &[u32]) -> [u8; LANES] {
        let mut ring = [[0u8; LANES]; 16];
        let mut centre = [0u8; LANES];
        for (i, &x) in columns.iter().enumerate() {
            let x = x as usize;
            centre[i] = self.rows[RADIUS][x];
            let near: [&[u8; 2 * RADIUS + 1]; 7] = std::array::from_fn(|y| {
                self.rows[y][x - RADIUS..=x + RADIUS].try_into().expect("seven pixels")
            });
            for (ring, (dx, dy)) in ring.iter_mut().zip(CIRCLE) {
                ring[i] = near[(dy + RADIUS as isize) as usize][(dx + RADIUS as isize) as usize];
            }
        }
        let mut scores = [0; LANES];
        for i in 0..LANES {
            let at = |k: usize| ring[k % 16][i];
            // Least and greatest of 2, 4, 8 and 9 neighbours, for all places on the circle at once.
            let arcs = |pick: fn(u8, u8) -> u8| -> [u8; 16] {
                let two: [u8; 16] = std::array::from_fn(|k| pick(at(k), at(k + 1)));
                let four: [u8; 16] = std::array::from_fn(|k| pick(two[k], two[(k + 2) % 16]));
                let eight: [u8; 16] = std::array::from_fn(|k| pick(four[k], four[(k + 4) % 16]));
                std::array::from_fn(|k| pick(eight[k], at(k + 8)))
            };
            let (mut brightest, mut darkest) = (0, 255);
            for (low, high) in arcs(Ord::min).into_iter().zip(arcs(Ord::max)) {
                brightest = brightest.max(low);
                darkest = darkest.min(high);
            }
            let out = brightest.saturating_sub(centre[i]).max(centre[i].saturating_sub(darkest));
            scores[i] = out.saturating_sub(1);
        }
        scores
    }
}

impl Task for Row<'_> {
    type Out = ();

    #[inline(always)]
    fn run(mut self) {
        self.mark();
        let count = self.rows[0].len() - 2 * RADIUS;
        let (mut waiting, mut columns) = (0, [0u32; LANES]);
        let maybe = std::mem::take(&mut self.maybe);
        for (word, eight) in maybe[..count.next_multiple_of(8)].chunks_exact(8).enumerate() {
            let mut bits = u64::from_le_bytes(eight.try_into().expect("eight bytes"));
            while bits != 0 {
                columns[waiting] = (RADIUS + 8 * word) as u32 + bits.trailing_zeros() / 8;
                waiting += 1;
                bits &= bits - 1;
                if waiting == LANES {
                    self.keep(&columns);
                    waiting = 0;
                }
            }
        }
        self.keep(&columns[..waiting]);
    }
}

impl Row<'_> {
    #[inline(always)]
    fn keep(&mut self, columns: &[u32]) {
        if columns.is_empty() {
            return;
        }
        let scores = self.score(columns);
        for (&column, score) in columns.iter().zip(scores) {
            if score >= self.threshold && score > 0 {
                self.scores[column as usize + 1] = score;
                self.columns.push(column);
            }
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
