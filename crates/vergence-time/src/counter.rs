use crate::Span;

/// A device's counter as it is written on the wire: it has a width, wraps, and counts at a nominal rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Counter {
    bits: u32,
    nanos: u64,
    ticks: u64,
}

/// Why a counter makes no sense.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "counter: expected 8 to 64 bits and a tick of 1 ps to 1000 s, found {bits} bits and {nanos} ns in {ticks} ticks"
)]
pub struct CounterError {
    bits: u32,
    nanos: u64,
    ticks: u64,
}

impl Counter {
    /// Microseconds in 32 bits: wraps after 71.6 minutes.
    pub const MICROS_32: Self = Self { bits: 32, nanos: 1_000, ticks: 1 };
    /// Nanoseconds in 64 bits.
    pub const NANOS_64: Self = Self { bits: 64, nanos: 1, ticks: 1 };

    /// A counter of `bits` bits of which `ticks` ticks last `nanos` nanoseconds, nominally.
    ///
    /// # Errors
    /// Unless there are 8 to 64 bits and a tick lasts between 1 ps and 1000 s.
    pub const fn new(bits: u32, nanos: u64, ticks: u64) -> Result<Self, CounterError> {
        let fits = bits >= 8
            && bits <= 64
            && nanos > 0
            && ticks > 0
            && ticks / nanos <= 1_000
            && nanos / ticks <= 1_000_000_000_000;
        if fits { Ok(Self { bits, nanos, ticks }) } else { Err(CounterError { bits, nanos, ticks }) }
    }

    /// Bits of the counter.
    pub const fn bits(self) -> u32 {
        self.bits
    }

    /// Ticks from reading `before` to reading `after`: of all the numbers that these may stand for, the one nearest to
    /// what passed meanwhile. Negative where the counter went back.
    pub(crate) fn ticks_between(self, before: u64, after: u64, meanwhile: Span) -> i128 {
        // Nearly always the shortest way round is right, and cheap; 128 bits are for the rest.
        let free = 64 - self.bits;
        let short = (after.wrapping_sub(before) << free) as i64 >> free;
        // Compared in nanoseconds times ticks, by products only: this is done for each reading.
        let (nanos, ticks) = (self.nanos as f64, self.ticks as f64);
        let half = (1u64 << (self.bits - 1)) as f64;
        let off = (short as f64 * nanos - meanwhile.as_nanos() as f64 * ticks).abs();
        if off < 0.98 * half * nanos {
            return i128::from(short);
        }
        let least = i128::from(after) - i128::from(before);
        let period = 1i128 << self.bits;
        let expected = i128::from(meanwhile.as_nanos()) * i128::from(self.ticks) / i128::from(self.nanos);
        // Rounded to the nearest, down at a tie.
        let wraps = (2 * (expected - least) + period).div_euclid(2 * period);
        least + wraps * period
    }

    /// How long so many ticks last nominally, rounded down, held at the ends of the representable range.
    pub(crate) fn nanos_of(self, ticks: i128) -> i64 {
        let short = i64::try_from(ticks).ok().zip(i64::try_from(self.nanos).ok());
        if let (1, Some(all)) = (self.ticks, short.and_then(|(ticks, nanos)| ticks.checked_mul(nanos))) {
            return all;
        }
        let all = ticks.saturating_mul(i128::from(self.nanos));
        // A division in 128 bits takes longer than everything else.
        let nanos = if self.ticks == 1 { all } else { all.div_euclid(i128::from(self.ticks)) };
        i64::try_from(nanos).unwrap_or(if nanos < 0 { i64::MIN } else { i64::MAX })
    }

    /// A reading as the counter can show it.
    pub(crate) const fn mask(self, raw: u64) -> u64 {
        if self.bits == 64 { raw } else { raw & ((1 << self.bits) - 1) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wraps_are_counted_also_those_that_passed_unseen() {
        let sony = Counter::new(16, 16_000, 3).unwrap();
        let wrap = Span::from_nanos(sony.nanos_of(1 << 16));
        assert_eq!(sony.ticks_between(65_530, 4, Span::from_nanos(55_000)), 10);
        let three = wrap.checked_mul(3).unwrap();
        assert_eq!(sony.ticks_between(100, 101, three), (3 << 16) + 1);
        let micros = Counter::MICROS_32;
        assert_eq!(micros.ticks_between(u64::from(u32::MAX), 999, Span::from_millis(1)), 1000);
        // A device that began anew went back; it did not wait for 71 minutes.
        assert_eq!(micros.ticks_between(50_000_000, 0, Span::from_millis(30)), -50_000_000);
        let nanos = Counter::NANOS_64;
        assert_eq!(nanos.ticks_between(u64::MAX, 4, Span::ZERO), 5);
        assert_eq!(nanos.ticks_between(4, u64::MAX, Span::ZERO), -5);
    }

    #[test]
    fn what_cannot_be_is_refused_and_what_does_not_fit_is_held() {
        for (bits, nanos, ticks) in [(7, 1, 1), (65, 1, 1), (32, 0, 1), (32, 1, 0), (32, 1, 1_001)] {
            assert!(Counter::new(bits, nanos, ticks).is_err(), "{bits} {nanos} {ticks}");
        }
        assert_eq!(Counter::MICROS_32.nanos_of(i128::from(i64::MAX)), i64::MAX);
        assert_eq!(Counter::MICROS_32.nanos_of(-i128::from(i64::MAX)), i64::MIN);
        assert_eq!(Counter::new(8, 1, 3).unwrap().nanos_of(-1), -1);
    }
}
