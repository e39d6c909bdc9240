//! The date of the computer's clock, for people.

use std::time::{SystemTime, UNIX_EPOCH};

/// Nanoseconds since 1970 by the computer's clock; negative before.
pub(crate) fn wall_ns() -> i64 {
    match SystemTime::now().duration_since(UNIX_EPOCH) {
        Ok(since) => i64::try_from(since.as_nanos()).unwrap_or(i64::MAX),
        Err(before) => i64::try_from(before.duration().as_nanos()).map_or(i64::MIN, |ns| -ns),
    }
}

/// `2026-03-01` (UTC), from nanoseconds since 1970. Source: H. Hinnant, "chrono-Compatible Low-Level Date Algorithms".
pub(crate) fn date_of(wall_ns: i64) -> String {
    let days = wall_ns.div_euclid(86_400_000_000_000) + 719_468;
    let era = days.div_euclid(146_097);
    let of_era = days.rem_euclid(146_097);
    let year_of_era = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted = (5 * of_year + 2) / 153;
    let day = of_year - (153 * shifted + 2) / 5 + 1;
    let month = if shifted < 10 { shifted + 3 } else { shifted - 9 };
    let year = year_of_era + 400 * era + i64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}")
}

#[cfg(test)]
mod tests {
    use super::date_of;

    #[test]
    fn dates() {
        let day = 86_400_000_000_000;
        assert_eq!(
            (date_of(0).as_str(), date_of(-1).as_str(), date_of(19_782 * day).as_str()),
            ("1970-01-01", "1969-12-31", "2024-02-29")
        );
        assert_eq!(date_of(19_783 * day), "2024-03-01");
    }
}
