use serde::de::{Deserialize, Deserializer, Error as _};

macro_rules! quantity {
    ($(#[$doc:meta])* $name:ident, $what:literal, $getter:ident, $getter_doc:literal, [$($unit:literal = $factor:expr),+ $(,)?]) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
        pub struct $name(f64);

        impl $name {
            #[doc = concat!("From ", $getter_doc, ".")]
            pub const fn new($getter: f64) -> Self {
                Self($getter)
            }

            #[doc = concat!("In ", $getter_doc, ".")]
            pub const fn $getter(self) -> f64 {
                self.0
            }

            fn parse(text: &str) -> Result<Self, String> {
                let expected = || {
                    format!(concat!("expected a", $what, " such as \"1.5 {}\" (units: {}), found \"{}\""),
                        [$($unit),+][0], [$($unit),+].join(", "), text)
                };
                let text = text.trim();
                let split = text.find(|c: char| c.is_alphabetic() && c != 'e' && c != 'E' || c == '%')
                    .ok_or_else(expected)?;
                let (number, unit) = text.split_at(split);
                let number: f64 = number.trim().parse().map_err(|_| expected())?;
                let factor = match unit {
                    $($unit => $factor,)+
                    _ => return Err(expected()),
                };
                if number.is_finite() { Ok(Self(number * factor)) } else { Err(expected()) }
            }
        }

        impl std::str::FromStr for $name {
            type Err = String;

            fn from_str(text: &str) -> Result<Self, String> {
                Self::parse(text)
            }
        }

        impl<'de> Deserialize<'de> for $name {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                struct Text;
                impl serde::de::Visitor<'_> for Text {
                    type Value = $name;
                    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                        write!(f, concat!("a", $what, " with its unit, such as \"1.5 {}\""), [$($unit),+][0])
                    }
                    fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<$name, E> {
                        $name::parse(text).map_err(E::custom)
                    }
                }
                deserializer.deserialize_str(Text).map_err(D::Error::custom)
            }
        }
    };
}

quantity! {
    /// A length, kept in metres.
    Length, " length", metres, "metres",
    ["m" = 1.0, "km" = 1e3, "cm" = 1e-2, "mm" = 1e-3, "um" = 1e-6]
}
quantity! {
    /// An angle, kept in radians.
    Angle, "n angle", radians, "radians",
    ["deg" = std::f64::consts::PI / 180.0, "rad" = 1.0, "mrad" = 1e-3]
}
quantity! {
    /// A duration, kept in seconds.
    Duration, " duration", seconds, "seconds",
    ["s" = 1.0, "ms" = 1e-3, "us" = 1e-6, "ns" = 1e-9, "min" = 60.0]
}
quantity! {
    /// A frequency, kept in hertz.
    Frequency, " frequency", hertz, "hertz",
    ["Hz" = 1.0, "kHz" = 1e3]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_become_si() {
        assert_eq!(Length::parse("63 mm").unwrap().metres(), 63.0 * 1e-3);
        assert_eq!(Length::parse("1e4km").unwrap().metres(), 1e7);
        assert_eq!(Angle::parse("-90 deg").unwrap().radians(), -std::f64::consts::FRAC_PI_2);
        assert_eq!(Duration::parse("2 min").unwrap().seconds(), 120.0);
        assert_eq!(Frequency::parse("90Hz").unwrap().hertz(), 90.0);
    }

    #[test]
    fn a_number_without_a_unit_or_with_a_wrong_one_is_refused() {
        for text in ["63", "mm", "63 Hz", "NaN m", "inf m", "", "1..2 m", "63 mmm"] {
            let error = Length::parse(text).unwrap_err();
            assert!(error.starts_with("expected a length such as \"1.5 m\""), "{text}: {error}");
        }
    }
}
