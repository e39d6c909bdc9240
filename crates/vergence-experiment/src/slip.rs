//! Units that were taken for others.

/// What two numbers of the same thing tell by their ratio `found / expected`: the unit slip behind it, for people. `None`
/// where they agree, or differ by something else. Radians and degrees, seconds and milliseconds (or microseconds), metres
/// and millimetres (or centimetres), pixels and millimetres at 96 per inch.
pub fn slip(found: f64, expected: f64) -> Option<&'static str> {
    const KNOWN: [(f64, &str, &str); 5] = [
        (180.0 / std::f64::consts::PI, "degrees for radians", "radians for degrees"),
        (
            1e3,
            "a thousand times too large: milli-units for units (ms for s, mm for m)",
            "a thousandth: units for milli-units (s for ms, m for mm)",
        ),
        (
            1e6,
            "a million times too large: micro-units for units (µs for s)",
            "a millionth: units for micro-units",
        ),
        (100.0, "centimetres for metres", "metres for centimetres"),
        (96.0 / 25.4, "pixels for millimetres", "millimetres for pixels"),
    ];
    let ratio = found / expected;
    if !ratio.is_finite() || ratio <= 0.0 {
        return None;
    }
    let near = |factor: f64| (ratio / factor - 1.0).abs() < 0.02;
    KNOWN.iter().find_map(
        |&(factor, large, small)| {
            if near(factor) { Some(large) } else { near(1.0 / factor).then_some(small) }
        },
    )
}

#[cfg(test)]
mod tests {
    use super::slip;

    #[test]
    fn slips_are_named() {
        assert_eq!(slip(0.35, 0.35), None);
        assert_eq!(slip(0.30, 0.35), None);
        assert_eq!(slip(0.35f64.to_degrees(), 0.35), Some("degrees for radians"));
        assert!(slip(750.0, 0.75).is_some_and(|text| text.contains("ms for s")));
        assert!(slip(0.00075, 0.75).is_some_and(|text| text.contains("thousandth")));
        assert_eq!(slip(10.0 * 96.0 / 25.4, 10.0), Some("pixels for millimetres"));
        assert_eq!((slip(f64::NAN, 1.0), slip(1.0, 0.0), slip(-1.0, 1.0)), (None, None, None));
    }
}
