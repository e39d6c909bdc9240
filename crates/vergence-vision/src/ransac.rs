//! Models that most of the data agree with, found by guesses from few of them.

use crate::dice::Dice;

/// How long [`consensus`] looks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RansacKnobs {
    /// Chooses the guesses: the same seed, the same answer.
    pub seed: u64,
    /// Guesses at most. Default 1000.
    pub most: usize,
    /// It stops where a better model would have been met with this probability, 0 to 1. Default 0.999.
    pub confidence: f64,
}

impl Default for RansacKnobs {
    fn default() -> Self {
        Self { seed: 1, most: 1000, confidence: 0.999 }
    }
}

/// The model that the most of `count` data agree with, and which of them do (ascending). `guess` makes models of `sample` different
/// data (their numbers, in any order); `agrees` says whether a datum fits. `None` where no guess gave a model that more than
/// `sample` data agree with. After M. Fischler, R. Bolles, "Random Sample Consensus", 1981.
pub fn consensus<M>(
    count: usize,
    sample: usize,
    knobs: &RansacKnobs,
    mut guess: impl FnMut(&[usize], &mut Vec<M>),
    mut agrees: impl FnMut(&M, usize) -> bool,
) -> Option<(M, Vec<usize>)> {
    if sample == 0 || count < sample {
        return None;
    }
    let mut dice = Dice(knobs.seed);
    let (mut best, mut found): (Option<M>, Vec<usize>) = (None, Vec::new());
    let (mut chosen, mut models, mut fine) = (Vec::with_capacity(sample), Vec::new(), Vec::new());
    let (mut tried, mut enough) = (0, knobs.most);
    while tried < enough {
        tried += 1;
        chosen.clear();
        while chosen.len() < sample {
            let one = dice.below(count);
            if !chosen.contains(&one) {
                chosen.push(one);
            }
        }
        models.clear();
        guess(&chosen, &mut models);
        for model in models.drain(..) {
            fine.clear();
            fine.extend((0..count).filter(|k| agrees(&model, *k)));
            if fine.len() > found.len().max(sample) {
                std::mem::swap(&mut found, &mut fine);
                best = Some(model);
                let all_fine = (found.len() as f64 / count as f64).powi(sample as i32);
                let needed = (1.0 - knobs.confidence).ln() / (1.0 - all_fine).ln();
                // All agree: the logarithm is −∞, and one guess was enough.
                enough =
                    if needed < knobs.most as f64 { (needed.ceil() as usize).max(1) } else { knobs.most };
            }
        }
    }
    best.map(|model| (model, found))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_among_outliers_is_found_and_the_same_seed_finds_the_same() {
        let mut dice = Dice(3);
        let data: Vec<(f64, f64)> = (0..200)
            .map(|k| {
                let x = f64::from(k) * 0.1;
                let noise = dice.below(1000) as f64 * 1e-5;
                (x, if k % 5 < 3 { dice.below(1000) as f64 * 0.1 } else { 2.0 * x + 1.0 + noise })
            })
            .collect();
        let found = |seed| {
            let line = |k: &[usize], into: &mut Vec<(f64, f64)>| {
                let slope = (data[k[1]].1 - data[k[0]].1) / (data[k[1]].0 - data[k[0]].0);
                into.push((slope, data[k[0]].1 - slope * data[k[0]].0));
            };
            let near = |m: &(f64, f64), k: usize| (m.0 * data[k].0 + m.1 - data[k].1).abs() < 0.05;
            consensus(data.len(), 2, &RansacKnobs { seed, ..RansacKnobs::default() }, line, near).unwrap()
        };
        let (line, fine) = found(1);
        assert!((line.0 - 2.0).abs() < 0.01 && (80..85).contains(&fine.len()), "{line:?} {}", fine.len());
        assert_eq!(found(1), (line, fine));
        assert!(found(2).1.len() >= 80);
    }

    #[test]
    fn too_few_data_and_useless_guesses_give_nothing() {
        let knobs = RansacKnobs::default();
        assert!(consensus(1, 2, &knobs, |_, into| into.push(()), |(), _| true).is_none());
        assert!(consensus(9, 2, &knobs, |_, _: &mut Vec<()>| {}, |(), _| true).is_none());
        assert!(consensus(9, 2, &knobs, |_, into| into.push(()), |(), k| k < 2).is_none());
    }
}
