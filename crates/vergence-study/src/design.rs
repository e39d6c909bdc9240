//! Orders: balanced Latin squares, all permutations, seeded shuffles. The same seed and pseudonym give the same order.

use std::fmt;
use std::str::FromStr;

use crate::Error;

/// How levels are ordered from participant to participant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Order {
    /// As listed, for everybody.
    Fixed,
    /// Rows of Williams' design (1949): each level in each place, and after each other level, equally often.
    #[default]
    Williams,
    /// All permutations in turn; at most 8 levels.
    Permutation,
    /// Shuffled by the study's seed and the pseudonym.
    Random,
}

impl Order {
    /// Its name in a study file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fixed => "fixed",
            Self::Williams => "williams",
            Self::Permutation => "permutation",
            Self::Random => "random",
        }
    }

    /// After how many participants the orders are balanced.
    pub fn rows(self, levels: usize) -> usize {
        match self {
            Self::Fixed | Self::Random => 1,
            Self::Williams if levels < 2 => 1,
            Self::Williams => levels * (1 + levels % 2),
            Self::Permutation => (1..=levels).product(),
        }
    }

    /// The order of `levels` for participant number `participant` (from 0); `seed` matters to [`Order::Random`] alone.
    pub fn of(self, levels: usize, participant: u64, seed: u64) -> Vec<usize> {
        let row = (participant % self.rows(levels).max(1) as u64) as usize;
        match self {
            Self::Fixed => (0..levels).collect(),
            Self::Williams => williams(levels).swap_remove(row),
            Self::Permutation => permutation(levels, row),
            Self::Random => shuffled(levels, mixed(seed ^ mixed(participant))),
        }
    }
}

impl FromStr for Order {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let all = [Self::Fixed, Self::Williams, Self::Permutation, Self::Random];
        all.into_iter().find(|order| order.name() == text).ok_or_else(|| Error::Knob {
            what: "order",
            expected: all.map(Self::name).join(", "),
            found: text.to_owned(),
        })
    }
}

impl fmt::Display for Order {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Williams' square of `levels` (n rows where n is even, 2 n where it is odd): each level stands in each place equally
/// often and follows each other level equally often.
pub fn williams(levels: usize) -> Vec<Vec<usize>> {
    if levels < 2 {
        return vec![(0..levels).collect()];
    }
    // 0, 1, n−1, 2, n−2, …: neighbours differ by every amount once.
    let first = (0..levels).map(|i| if i % 2 == 1 { i.div_ceil(2) } else { (levels - i / 2) % levels });
    let first: Vec<usize> = first.collect();
    let row = |shift: usize| first.iter().map(|level| (level + shift) % levels).collect::<Vec<_>>();
    let mut rows: Vec<Vec<usize>> = (0..levels).map(row).collect();
    if levels % 2 == 1 {
        let mirrored: Vec<Vec<usize>> = rows.iter().map(|row| row.iter().rev().copied().collect()).collect();
        rows.extend(mirrored);
    }
    rows
}

/// All orders of `levels` (at most 8) in lexical order.
pub fn permutations(levels: usize) -> Option<Vec<Vec<usize>>> {
    (levels <= 8).then(|| (0..(1..=levels).product()).map(|row| permutation(levels, row)).collect())
}

/// The `row`-th permutation in lexical order.
fn permutation(levels: usize, row: usize) -> Vec<usize> {
    let mut rest: Vec<usize> = (0..levels).collect();
    let mut row = row;
    let mut order = Vec::with_capacity(levels);
    for left in (0..levels).rev() {
        let block: usize = (1..=left).product();
        order.push(rest.remove((row / block).min(rest.len() - 1)));
        row %= block;
    }
    order
}

/// `0..levels` shuffled (Fisher and Yates) by SplitMix64.
pub fn shuffled(levels: usize, seed: u64) -> Vec<usize> {
    let mut order: Vec<usize> = (0..levels).collect();
    let mut state = seed;
    for i in (1..levels).rev() {
        state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        // The bias of the product is below 2^-50 for any list of levels.
        let j = ((u128::from(mixed(state)) * (i as u128 + 1)) >> 64) as usize;
        order.swap(i, j);
    }
    order
}

/// SplitMix64's mixing (Steele, Lea and Flood 2014).
pub(crate) fn mixed(value: u64) -> u64 {
    let value = (value ^ (value >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let value = (value ^ (value >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    value ^ (value >> 31)
}

/// A participant's number: the digits at the end of the pseudonym minus one (P01 is 0), else a hash of it.
pub(crate) fn number_of(pseudonym: &str) -> u64 {
    let digits: String = pseudonym
        .chars()
        .rev()
        .take_while(char::is_ascii_digit)
        .collect::<Vec<_>>()
        .into_iter()
        .rev()
        .collect();
    match digits.parse::<u64>() {
        // One less than a multiple of every usual number of rows: P00 stands before P01, not beside it.
        Ok(0) => 8 * 7 * 6 * 5 * 4 * 3 * 2 - 1,
        Ok(number) => number - 1,
        Err(_) => pseudonym.bytes().fold(0, |hash, byte| mixed(hash ^ u64::from(byte))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn williams_is_balanced() {
        for n in 2..12 {
            let rows = williams(n);
            assert_eq!(rows.len(), Order::Williams.rows(n));
            let each = rows.len() / n;
            for level in 0..n {
                for place in 0..n {
                    assert_eq!(
                        rows.iter().filter(|row| row[place] == level).count(),
                        each,
                        "{n}: {level} at {place}"
                    );
                }
                for next in (0..n).filter(|next| *next != level) {
                    let follows =
                        |row: &Vec<usize>| row.windows(2).filter(|pair| **pair == [level, next]).count();
                    assert_eq!(rows.iter().map(follows).sum::<usize>(), each, "{n}: {level} before {next}");
                }
            }
        }
        assert_eq!((williams(1), williams(0)), (vec![vec![0]], vec![vec![]]));
    }

    #[test]
    fn permutations_are_all() {
        let all = permutations(4).unwrap();
        let mut sorted = all.clone();
        sorted.dedup();
        assert_eq!(
            (all.len(), sorted.len(), all[0].clone(), all[23].clone()),
            (24, 24, vec![0, 1, 2, 3], vec![3, 2, 1, 0])
        );
        assert_eq!(permutations(9), None);
    }

    #[test]
    fn pseudonyms_have_numbers() {
        assert_eq!((number_of("P01"), number_of("P12"), number_of("7")), (0, 11, 6));
        assert_ne!(number_of("anna"), number_of("otto"));
    }

    proptest! {
        #[test]
        fn every_order_is_a_permutation(levels in 0usize..9, participant in any::<u64>(), seed in any::<u64>()) {
            for order in [Order::Fixed, Order::Williams, Order::Permutation, Order::Random] {
                let mut found = order.of(levels, participant, seed);
                prop_assert_eq!(&found, &order.of(levels, participant, seed));
                found.sort_unstable();
                prop_assert_eq!(found, (0..levels).collect::<Vec<_>>());
            }
        }
    }
}
