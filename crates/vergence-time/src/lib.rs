#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod clock;
mod clock_map;
mod counter;
mod edge;

pub use clock::{Clock, HandClock, HostClock};
pub use clock_map::{ClockKnobs, ClockMap, ClockState};
pub use counter::{Counter, CounterError};

/// An instant: nanoseconds since the epoch of its clock. Negative instants are legal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Timestamp(i64);

/// A signed duration in nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Span(i64);

impl Timestamp {
    /// The instant `nanos` nanoseconds after the epoch of its clock.
    pub const fn from_nanos(nanos: i64) -> Self {
        Self(nanos)
    }

    /// Nanoseconds since the epoch of its clock.
    pub const fn as_nanos(self) -> i64 {
        self.0
    }

    /// Reads a decimal number of a unit that is 10^`digits` nanoseconds (seconds 9, milliseconds 6): `1403715273.262142976` to the last
    /// digit, of which a float has too few for times since 1970; further digits are rounded. `1e-3` and the like go through a float.
    /// `None` where it is no number, or does not fit.
    pub fn from_decimal(text: &str, digits: u32) -> Option<Self> {
        let (is_negative, plain) = text.strip_prefix('-').map_or((false, text), |rest| (true, rest));
        let (whole, part) = plain.split_once('.').unwrap_or((plain, ""));
        let is_plain = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
        let mut unit = 10i64.checked_pow(digits)?;
        if !is_plain(whole) || !is_plain(part) || whole.is_empty() {
            return Span::from_secs_f64(text.parse::<f64>().ok()? * (unit as f64 * 1e-9))
                .map(|span| Self(span.0));
        }
        let mut nanos = whole.parse::<i64>().ok()?.checked_mul(unit)?;
        let mut rest = part.bytes();
        while unit > 1 {
            unit /= 10;
            let Some(digit) = rest.next() else { break };
            nanos = nanos.checked_add(i64::from(digit - b'0') * unit)?;
        }
        if unit == 1 && rest.next().is_some_and(|digit| digit >= b'5') {
            nanos = nanos.checked_add(1)?;
        }
        Some(Self(if is_negative { -nanos } else { nanos }))
    }

    /// The span from `earlier` to `self` (negative where `earlier` is later); `None` where it does not fit in
    /// 64 bits.
    pub const fn since(self, earlier: Self) -> Option<Span> {
        match self.0.checked_sub(earlier.0) {
            Some(nanos) => Some(Span(nanos)),
            None => None,
        }
    }

    /// The instant `span` later; `None` on overflow.
    pub const fn checked_add(self, span: Span) -> Option<Self> {
        match self.0.checked_add(span.0) {
            Some(nanos) => Some(Self(nanos)),
            None => None,
        }
    }

    /// The instant `span` later, held at the end of the representable range.
    pub const fn saturating_add(self, span: Span) -> Self {
        Self(self.0.saturating_add(span.0))
    }
}

impl Span {
    /// No time at all.
    pub const ZERO: Self = Self(0);

    /// A span of `nanos` nanoseconds.
    pub const fn from_nanos(nanos: i64) -> Self {
        Self(nanos)
    }

    /// A span of `millis` milliseconds, held at the end of the representable range.
    pub const fn from_millis(millis: i64) -> Self {
        Self(millis.saturating_mul(1_000_000))
    }

    /// The span nearest to `secs` seconds; `None` where `secs` is not finite or does not fit.
    pub fn from_secs_f64(secs: f64) -> Option<Self> {
        let nanos = (secs * 1e9).round();
        // 2^63 is exact in f64; i64::MAX is not.
        (nanos >= -(2f64.powi(63)) && nanos < 2f64.powi(63)).then_some(Self(nanos as i64))
    }

    /// Whole nanoseconds.
    pub const fn as_nanos(self) -> i64 {
        self.0
    }

    /// Seconds, rounded to `f64` (exact up to 104 days).
    pub fn as_secs_f64(self) -> f64 {
        self.0 as f64 * 1e-9
    }

    /// Milliseconds, rounded to `f64`.
    pub fn as_millis_f64(self) -> f64 {
        self.0 as f64 * 1e-6
    }

    /// `factor` times this span; `None` on overflow.
    pub const fn checked_mul(self, factor: i64) -> Option<Self> {
        match self.0.checked_mul(factor) {
            Some(nanos) => Some(Self(nanos)),
            None => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decimals_are_read_to_the_last_digit() {
        let read = |text, digits| Timestamp::from_decimal(text, digits).map(Timestamp::as_nanos);
        assert_eq!(read("1403715273.262142976", 9), Some(1_403_715_273_262_142_976));
        assert_eq!(read("-0.0000000015", 9), Some(-2));
        assert_eq!(
            (read("12.34567891", 6), read("7", 0), read("7.5", 0)),
            (Some(12_345_679), Some(7), Some(8))
        );
        assert_eq!((read("1e-3", 9), read("1.5e3", 3)), (Some(1_000_000), Some(1_500_000)));
        for none in ["", "-", ".", "1.2.3", "x", "NaN", "inf", "9223372036.9", "99999999999999999999"] {
            assert_eq!(read(none, 9), None, "{none}");
        }
    }

    #[test]
    fn subtraction_is_checked() {
        let (first, last) = (Timestamp::from_nanos(i64::MIN), Timestamp::from_nanos(i64::MAX));
        assert_eq!(last.since(first), None);
        assert_eq!(first.checked_add(Span::from_nanos(-1)), None);
        assert_eq!(first.saturating_add(Span::from_nanos(-1)), first);
        assert_eq!(Timestamp::from_nanos(-5).since(Timestamp::from_nanos(7)), Some(Span::from_nanos(-12)));
    }

    #[test]
    fn seconds_round_to_the_nearest_nanosecond_and_refuse_what_does_not_fit() {
        assert_eq!(Span::from_secs_f64(1.000_000_000_4), Some(Span::from_nanos(1_000_000_000)));
        assert_eq!(Span::from_secs_f64(-0.5), Some(Span::from_millis(-500)));
        for secs in [f64::NAN, f64::INFINITY, 1e10, -1e10] {
            assert_eq!(Span::from_secs_f64(secs), None, "{secs}");
        }
    }
}
