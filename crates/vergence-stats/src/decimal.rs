use std::str::FromStr;

use num_bigint::BigInt;
use num_rational::BigRational;
use num_traits::{Float as _, Signed as _, ToPrimitive as _, Zero as _};

use crate::Error;

/// Most digits and most decimal places (either way) that are handled; a double never needs more.
pub const MAX_PLACES: usize = 1_100;

/// A number as it was written: digits and decimal places, without rounding.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Decimal {
    digits: BigInt,
    /// The value is `digits · 10^-places`.
    places: i32,
}

impl Decimal {
    /// The exact value of a double (0.1 becomes the 55 digits it stands for); none where it is not finite.
    pub fn from_f64(value: f64) -> Option<Self> {
        if !value.is_finite() {
            return None;
        }
        let (mantissa, exponent, sign) = value.integer_decode();
        let spare = mantissa.trailing_zeros() % 64;
        let (odd, power) = (BigInt::from(mantissa >> spare) * sign, i32::from(exponent) + spare as i32);
        Some(match u32::try_from(-power) {
            // Over a power of two: as many factors of five make it a power of ten.
            Ok(twos) if mantissa > 0 => Self { digits: odd * BigInt::from(5).pow(twos), places: -power },
            Ok(_) => Self { digits: odd, places: 0 },
            Err(_) => Self { digits: odd << power.unsigned_abs(), places: 0 },
        })
    }

    /// The nearest double; infinite beyond the largest.
    pub fn to_f64(&self) -> f64 {
        to_f64(&BigRational::new(self.scaled(self.places.max(0)), power_of_ten(self.places.max(0))))
    }

    /// The exact product; places and digits add up, so powers of a number written with nine places stay exact.
    pub fn times(&self, other: &Self) -> Self {
        Self { digits: &self.digits * &other.digits, places: self.places.saturating_add(other.places) }
    }

    /// Decimal places: 2 in `1.25`, negative in `12e3`.
    pub(crate) fn places(&self) -> i32 {
        self.places
    }

    /// The value times `10^places`, a whole number; `places` is at least the number's own.
    pub(crate) fn scaled(&self, places: i32) -> BigInt {
        &self.digits * power_of_ten(places - self.places)
    }
}

impl FromStr for Decimal {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let text = text.trim();
        let shown = || text.chars().take(40).collect::<String>();
        let wrong = || Error::NotANumber { found: shown() };
        let long = || Error::TooLong { found: shown() };
        let (mantissa, exponent) = match text.find(['e', 'E']) {
            Some(at) => (&text[..at], text[at + 1..].parse::<i32>().map_err(|_| wrong())?),
            None => (text, 0),
        };
        let (sign, unsigned) = match mantissa.strip_prefix('-') {
            Some(rest) => ("-", rest),
            None => ("", mantissa.strip_prefix('+').unwrap_or(mantissa)),
        };
        let (whole, fraction) = unsigned.split_once('.').unwrap_or((unsigned, ""));
        let is_digits = |part: &str| part.bytes().all(|byte| byte.is_ascii_digit());
        if whole.len() + fraction.len() == 0 || !is_digits(whole) || !is_digits(fraction) {
            return Err(wrong());
        }
        let limit = MAX_PLACES as i32;
        if whole.len() + fraction.len() > MAX_PLACES || !(-limit..=limit).contains(&exponent) {
            return Err(long());
        }
        let digits: BigInt = format!("{sign}{whole}{fraction}").parse().map_err(|_| wrong())?;
        let places = if digits.is_zero() { 0 } else { fraction.len() as i32 - exponent };
        Ok(Self { digits, places })
    }
}

/// `10^exponent`; 1 where the exponent is negative (callers scale up first).
pub(crate) fn power_of_ten(exponent: i32) -> BigInt {
    BigInt::from(10).pow(exponent.max(0) as u32)
}

/// The nearest double of a rational, also where numerator and denominator alone have none.
pub(crate) fn to_f64(value: &BigRational) -> f64 {
    match value.to_f64() {
        Some(double) => double,
        None if value.is_negative() => f64::NEG_INFINITY,
        None => f64::INFINITY,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn decimals_are_read_as_written() {
        for (text, value) in [
            ("1.25", 1.25),
            ("-0.5e3", -500.0),
            (" +12E-2 ", 0.12),
            ("1000000000000.4", 1e12 + 0.4),
            (".5", 0.5),
            ("7.", 7.0),
            ("0e99", 0.0),
        ] {
            assert_eq!(text.parse::<Decimal>().unwrap().to_f64(), value, "{text}");
        }
        for text in
            ["", ".", "-", "1e", "e3", "1..2", "0x10", "nan", "inf", "1 2", "１", "1e9999999999", "--1"]
        {
            assert!(text.parse::<Decimal>().is_err(), "{text}");
        }
        assert!(matches!("1e2000".parse::<Decimal>(), Err(Error::TooLong { .. })));
        assert!(matches!("9".repeat(2000).parse::<Decimal>(), Err(Error::TooLong { .. })));
        assert_eq!(Decimal::from_f64(f64::NAN), None);
        assert_eq!(Decimal::from_f64(f64::INFINITY), None);
    }

    proptest! {
        #[test]
        fn a_double_comes_back(bits in any::<u64>()) {
            let value = f64::from_bits(bits);
            if value.is_finite() {
                prop_assert_eq!(Decimal::from_f64(value).unwrap().to_f64(), value);
            }
        }

        #[test]
        fn text_and_double_agree(value in -1e12..1e12f64) {
            prop_assert_eq!(format!("{value}").parse::<Decimal>().unwrap().to_f64(), value);
            prop_assert_eq!(format!("{value:e}").parse::<Decimal>().unwrap().to_f64(), value);
        }

        #[test]
        fn any_text_is_an_answer(text in ".{0,20}") {
            let _ = text.parse::<Decimal>();
        }
    }
}
