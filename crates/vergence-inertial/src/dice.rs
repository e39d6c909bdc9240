//! Random numbers that are a function of (seed, stream, index): no state, so that a noise can be asked for at any time
//! in any order and is the same. The crates of random numbers keep a state that must be stepped through.

/// Finaliser of SplitMix64 (G. Steele et al., OOPSLA 2014): every bit of the output hangs on every bit of the input.
fn mix(mut z: u64) -> u64 {
    z = z.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// One of many independent sequences of one seed.
///
/// ```
/// use vergence_inertial::Dice;
/// let noise = Dice::new(7, 0);
/// assert_eq!(noise.normal(1000), Dice::new(7, 0).normal(1000));
/// assert_ne!(noise.normal(1000), Dice::new(7, 1).normal(1000));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Dice(u64);

impl Dice {
    /// The sequence number `stream` of `seed`.
    pub fn new(seed: u64, stream: u64) -> Self {
        Self(mix(mix(seed) ^ stream.wrapping_mul(0xd6e8_feb8_6659_fd93)))
    }

    /// 64 bits.
    pub fn bits(self, index: u64) -> u64 {
        mix(self.0 ^ mix(index))
    }

    /// In 0..1, never 0.
    pub fn uniform(self, index: u64) -> f64 {
        ((self.bits(index) >> 11) as f64 + 0.5) * (1.0 / (1u64 << 53) as f64)
    }

    /// Mean 0, variance 1 (Box and Muller).
    pub fn normal(self, index: u64) -> f64 {
        let radius = (-2.0 * self.uniform(index).ln()).sqrt();
        let angle = std::f64::consts::TAU * Self(!self.0).uniform(index);
        radius * angle.cos()
    }

    /// A Wiener process at whole `tick`s: 0 at tick 0, increments independent, of variance 1 per tick. By halving the
    /// interval between two powers of two (Lévy's construction): at most 64 draws for any tick, none remembered.
    pub fn walk(self, tick: u64) -> f64 {
        /// Ticks above are held there: 146 years at 1 kHz.
        const LAST: u64 = 1 << 42;
        let tick = tick.min(LAST - 1);
        if tick == 0 {
            return 0.0;
        }
        let level = tick.ilog2();
        let (mut low, mut high) = (1u64 << level, 2u64 << level);
        // At 2^m: the first tick, then the doublings, each named by a bit that no tick has.
        let power = |m: u32| {
            let doubled = |l: u32| self.normal(1 << 63 | u64::from(l)) * ((1u64 << l) as f64).sqrt();
            self.normal(1 << 62) + (0..m).map(doubled).sum::<f64>()
        };
        let (mut at_low, mut at_high) = (power(level), power(level + 1));
        while tick != low {
            let middle = low + (high - low) / 2;
            let deviation = ((high - low) as f64).sqrt() / 2.0;
            // (low, high) is named by its middle: no other interval of this halving has it.
            let at_middle = 0.5 * (at_low + at_high) + deviation * self.normal(middle);
            if tick < middle {
                (high, at_high) = (middle, at_middle)
            } else {
                (low, at_low) = (middle, at_middle)
            }
        }
        at_low
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_those_of_the_normal_distribution() {
        const N: u64 = 200_000;
        let dice = Dice::new(7, 3);
        let moment = |p: i32| (0..N).map(|k| dice.normal(k).powi(p)).sum::<f64>() / N as f64;
        let found = [moment(1), moment(2), moment(3), moment(4)];
        // Five standard errors.
        for (found, (expected, error)) in
            found.iter().zip([(0.0, 1.0), (1.0, 2.0), (0.0, 15.0), (3.0, 96.0f64)])
        {
            assert!((found - expected).abs() < 5.0 * (error / N as f64).sqrt(), "{found} {expected}");
        }
    }

    #[test]
    fn the_walk_has_independent_increments_of_one_variance() {
        for lag in [1u64, 7, 64] {
            const N: u64 = 20_000;
            let dice = Dice::new(11, lag);
            let steps: Vec<f64> = (0..N).map(|k| dice.walk((k + 1) * lag) - dice.walk(k * lag)).collect();
            let variance = steps.iter().map(|s| s * s).sum::<f64>() / N as f64 / lag as f64;
            let next = steps.windows(2).map(|w| w[0] * w[1]).sum::<f64>() / N as f64 / lag as f64;
            let bar = 5.0 * (2.0 / N as f64).sqrt();
            assert!((variance - 1.0).abs() < bar && next.abs() < bar, "{lag}: {variance} {next}");
        }
        // Many seeds, one far tick.
        let far = 1_000_003u64;
        let spread = (0..2000).map(|s| Dice::new(s, 0).walk(far).powi(2)).sum::<f64>() / 2000.0 / far as f64;
        assert!((spread - 1.0).abs() < 5.0 * (2.0f64 / 2000.0).sqrt(), "{spread}");
        assert_eq!(Dice::new(1, 1).walk(0), 0.0);
        assert!(Dice::new(1, 1).walk(u64::MAX).is_finite());
    }

    #[test]
    fn streams_do_not_hang_together() {
        const N: u64 = 100_000;
        for (a, b) in [((1, 0), (1, 1)), ((1, 0), (2, 0)), ((0, 1), (1, 0))] {
            let (a, b) = (Dice::new(a.0, a.1), Dice::new(b.0, b.1));
            let together = (0..N).map(|k| a.normal(k) * b.normal(k)).sum::<f64>() / N as f64;
            assert!(together.abs() < 5.0 / (N as f64).sqrt(), "{together}");
        }
    }
}
