use crate::dice::Dice;
use crate::simd::{Task, vectorised};

/// 256 comparisons of smoothed pixels around a point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Descriptor(pub [u64; 4]);

impl Descriptor {
    /// In how many comparisons two of them differ, 0 to 256.
    #[inline(always)]
    pub fn distance(&self, other: &Self) -> u32 {
        let (a, b) = (&self.0, &other.0);
        let different = |k: usize| (a[k] ^ b[k]).count_ones();
        different(0) + different(1) + different(2) + different(3)
    }
}

/// Radius of what is described, pixels.
pub(crate) const PATCH: usize = 15;
/// Directions in which the pattern is kept.
pub(crate) const ANGLES: usize = 64;
const PAIRS: usize = 256;

/// Pairs of places, normally distributed around the point with a fifth of the patch's side as standard deviation (M. Calonder,
/// V. Lepetit, C. Strecha, P. Fua, "BRIEF: binary robust independent elementary features", ECCV 2010), turned into
/// [`ANGLES`] directions.
///
/// The pairs are drawn once and for all, in whole numbers, so that descriptors of different versions can be compared. A pair whose two
/// places are near each other says little and is drawn again.
#[derive(Clone, Debug)]
pub(crate) struct Pattern {
    /// For each direction the right and down offsets of the first places, then those of the second ones.
    turned: Vec<[[i32; PAIRS]; 4]>,
}

/// Nearest that the places of a pair may be, pixels.
const NEAREST: i32 = 4;

impl Pattern {
    pub fn new() -> Self {
        let mut dice = Dice(0);
        // Twelve even numbers of 0..=1024 are nearly normal around their mean; a standard deviation is 1024 here.
        let mut normal = || (0..12).map(|_| (dice.draw() % 1025) as i32).sum::<i32>() - 12 * 512;
        let mut place = || loop {
            // 31 / 5 pixels of standard deviation; 12 variances of 1024² / 12.
            let [x, y] = [0; 2].map(|_: i32| (normal() * 31 / 5 + 512) >> 10);
            if x * x + y * y < (PATCH * PATCH) as i32 {
                return [x, y];
            }
        };
        let mut pairs = Vec::with_capacity(PAIRS);
        while pairs.len() < PAIRS {
            let (a, b) = (place(), place());
            let apart = (a[0] - b[0]).pow(2) + (a[1] - b[1]).pow(2);
            if apart >= NEAREST * NEAREST && !pairs.contains(&(a, b)) {
                pairs.push((a, b));
            }
        }
        let turn = |k: usize| {
            let (sin, cos) = (k as f64 * (std::f64::consts::TAU / ANGLES as f64)).sin_cos();
            let at = |p: [i32; 2]| {
                let [x, y] = p.map(f64::from);
                [(x * cos - y * sin).round() as i32, (x * sin + y * cos).round() as i32]
            };
            let mut turned = [[0; PAIRS]; 4];
            for (i, (a, b)) in pairs.iter().enumerate() {
                let (a, b) = (at(*a), at(*b));
                [turned[0][i], turned[1][i], turned[2][i], turned[3][i]] = [a[0], a[1], b[0], b[1]];
            }
            turned
        };
        Self { turned: (0..ANGLES).map(turn).collect() }
    }

    /// The point at (`x`, `y`) of a smoothed picture, at least [`PATCH`] + 1 pixels inside, with the pattern in direction `turn`.
    pub fn describe(&self, smooth: &[u8], width: usize, x: usize, y: usize, turn: usize) -> Descriptor {
        vectorised(Describe { smooth, width, x, y, places: &self.turned[turn] })
    }
}

struct Describe<'a> {
    smooth: &'a [u8],
    width: usize,
    x: usize,
    y: usize,
    places: &'a [[i32; PAIRS]; 4],
}

impl Task for Describe<'_> {
    type Out = Descriptor;

    #[inline(always)]
    fn run(self) -> Descriptor {
        let width = self.width as i32;
        let start = (self.y - PATCH) * self.width + self.x - PATCH;
        // From the first to the last place that there can be.
        let patch = &self.smooth[start..start + 2 * PATCH * self.width + 2 * PATCH + 1];
        let centre = PATCH as i32 * width + PATCH as i32;
        let [ax, ay, bx, by] = self.places;
        let mut words = [0u64; 4];
        for (n, word) in words.iter_mut().enumerate() {
            let first: [i32; 64] = std::array::from_fn(|i| centre + ay[64 * n + i] * width + ax[64 * n + i]);
            let second: [i32; 64] = std::array::from_fn(|i| centre + by[64 * n + i] * width + bx[64 * n + i]);
            let mut bits = 0;
            for i in 0..64 {
                let less = patch[first[i] as usize] < patch[second[i] as usize];
                bits |= u64::from(less) << i;
            }
            *word = bits;
        }
        Descriptor(words)
    }
}

/// Which descriptors may be matched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatchKnobs {
    /// Most bits that may differ, 0 to 256. Default 64.
    pub most_bits: u32,
    /// The best may have at most this share of the bits of the second best, 0 to 1. Default 0.8; 1 asks nothing.
    pub ratio: f32,
    /// Each must be the best of the other. Default true.
    pub mutual: bool,
}

impl Default for MatchKnobs {
    fn default() -> Self {
        Self { most_bits: 64, ratio: 0.8, mutual: true }
    }
}

/// Two descriptors of the same thing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Match {
    /// Index in the first list.
    pub first: usize,
    /// Index in the second list.
    pub second: usize,
    /// Bits that differ.
    pub bits: u32,
}

/// Compares all of `first` with all of `second`; matches in order of `first`. Of equal ones the earlier is taken.
pub fn match_all(first: &[Descriptor], second: &[Descriptor], knobs: &MatchKnobs) -> Vec<Match> {
    vectorised(All { first, second, knobs })
}

struct All<'a> {
    first: &'a [Descriptor],
    second: &'a [Descriptor],
    knobs: &'a MatchKnobs,
}

impl Task for All<'_> {
    type Out = Vec<Match>;

    #[inline(always)]
    fn run(self) -> Vec<Match> {
        const NONE: u32 = 257;
        let mut back = vec![(NONE, 0u32); self.second.len()];
        let mut best = Vec::with_capacity(self.first.len());
        for (i, a) in self.first.iter().enumerate() {
            let (mut least, mut next, mut at) = (NONE, NONE, 0);
            for (j, (b, back)) in self.second.iter().zip(&mut back).enumerate() {
                let bits = a.distance(b);
                if bits < next {
                    if bits < least {
                        (next, least, at) = (least, bits, j);
                    } else {
                        next = bits;
                    }
                }
                if bits < back.0 {
                    *back = (bits, i as u32);
                }
            }
            best.push((least, next, at));
        }
        let sound = |(first, (bits, next, second)): (usize, (u32, u32, usize))| {
            let near = bits <= self.knobs.most_bits.min(256);
            let clear = self.knobs.ratio >= 1.0 || bits as f32 <= self.knobs.ratio * next as f32;
            let both = !self.knobs.mutual || back.get(second).is_some_and(|b| b.1 as usize == first);
            (near && clear && both).then_some(Match { first, second, bits })
        };
        best.into_iter().enumerate().filter_map(sound).collect()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn some(count: usize, dice: &mut Dice) -> Vec<Descriptor> {
        // Few bits, so that there are ties.
        (0..count).map(|_| Descriptor([dice.draw() & 0xf, 0, dice.draw() & 0x3, u64::MAX])).collect()
    }

    proptest! {
        #[test]
        fn matches_are_those_of_the_definition(
            seed in any::<u64>(), counts in [0usize..20, 0usize..20], most_bits in 0u32..8, ratio in 0.3f32..1.2, mutual: bool,
        ) {
            let mut dice = Dice(seed);
            let (first, second) = (some(counts[0], &mut dice), some(counts[1], &mut dice));
            let knobs = MatchKnobs { most_bits, ratio, mutual };
            let best = |one: &Descriptor, all: &[Descriptor]| {
                all.iter().enumerate().map(|(j, other)| (one.distance(other), j)).min()
            };
            let mut expected = Vec::new();
            for (i, one) in first.iter().enumerate() {
                let Some((bits, j)) = best(one, &second) else { continue };
                let others = second.iter().enumerate().filter(|(k, _)| *k != j);
                let next = others.map(|(_, other)| one.distance(other)).min().unwrap_or(257);
                let both = best(&second[j], &first).is_some_and(|(_, back)| back == i);
                let clear = ratio >= 1.0 || bits as f32 <= ratio * next as f32;
                if bits <= most_bits && clear && (both || !mutual) {
                    expected.push(Match { first: i, second: j, bits });
                }
            }
            prop_assert_eq!(match_all(&first, &second, &knobs), expected);
        }
    }

    #[test]
    fn the_pattern_stays_what_it_is() {
        let pattern = Pattern::new();
        // Descriptors that somebody kept are of no use when these change.
        let sum =
            |k: usize| pattern.turned[0][k].iter().enumerate().map(|(i, x)| (i as i32 + 1) * x).sum::<i32>();
        assert_eq!([sum(0), sum(1), sum(2), sum(3)], SUMS);
        for turned in &pattern.turned {
            for i in 0..PAIRS {
                let square = |x: i32, y: i32| x * x + y * y;
                assert!(square(turned[0][i], turned[1][i]) <= (PATCH as i32 + 1).pow(2));
                assert!(square(turned[2][i], turned[3][i]) <= (PATCH as i32 + 1).pow(2));
                assert!(turned.iter().all(|offsets| offsets[i].unsigned_abs() as usize <= PATCH));
            }
        }
    }

    const SUMS: [i32; 4] = [-31_707, -8_817, 1_140, 137];
}
