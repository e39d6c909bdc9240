/// How a thumbstick is read: nothing near the middle, everything near the rim, straight between.
///
/// Radial: the direction is kept. Small `inner` lets a worn stick drift; large `inner` loses slow movement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeadZone {
    inner: f32,
    outer: f32,
}

/// Why a dead zone makes no sense.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeadZoneError {
    inner: f32,
    outer: f32,
}

impl std::fmt::Display for DeadZoneError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { inner, outer } = self;
        write!(f, "dead zone: expected 0 <= inner < outer <= 1, found inner {inner}, outer {outer}")
    }
}

impl std::error::Error for DeadZoneError {}

impl Default for DeadZone {
    /// Nothing below 0.15 of the way, everything from 0.95 on.
    fn default() -> Self {
        Self { inner: 0.15, outer: 0.95 }
    }
}

impl DeadZone {
    /// Nothing up to `inner`, everything from `outer` on (fractions of the way to the rim).
    ///
    /// # Errors
    /// Unless 0 ≤ `inner` < `outer` ≤ 1.
    pub fn new(inner: f32, outer: f32) -> Result<Self, DeadZoneError> {
        // Written so that NaN is refused.
        if inner >= 0.0 && inner < outer && outer <= 1.0 {
            Ok(Self { inner, outer })
        } else {
            Err(DeadZoneError { inner, outer })
        }
    }

    /// The stick's deflection with the dead zone taken out; its length is at most 1. Zero for what is not finite.
    pub fn apply(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        let length = x.hypot(y);
        if !length.is_finite() || length <= self.inner {
            return [0.0; 2];
        }
        let wanted = ((length - self.inner) / (self.outer - self.inner)).min(1.0);
        [x / length * wanted, y / length * wanted]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_in_the_middle_everything_at_the_rim_and_the_direction_is_kept() {
        let zone = DeadZone::default();
        assert_eq!(zone.apply([0.1, -0.1]), [0.0; 2]);
        assert_eq!(zone.apply([0.0, -1.0]), [0.0, -1.0]);
        let [x, y] = zone.apply([0.3, 0.4]);
        assert!((y / x - 4.0 / 3.0).abs() < 1e-6 && x > 0.0);
        // Runtimes may give corners of the square.
        let [x, y] = zone.apply([1.0, 1.0]);
        assert!((x.hypot(y) - 1.0).abs() < 1e-6);
        assert_eq!(zone.apply([f32::NAN, 0.0]), [0.0; 2]);
    }

    #[test]
    fn nonsense_is_refused() {
        for (inner, outer) in [(-0.1, 0.9), (0.5, 0.5), (0.2, 1.1), (f32::NAN, 0.9)] {
            assert!(DeadZone::new(inner, outer).is_err(), "{inner} {outer}");
        }
    }
}
