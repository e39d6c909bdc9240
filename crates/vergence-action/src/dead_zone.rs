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

/// In which way a stick is dead.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Shape {
    /// Within a circle: every direction alike, for looking and walking.
    #[default]
    Radial,
    /// Each axis for itself, within a cross: easy to hold straight, for menus and vehicles.
    Axial,
}

/// A dead zone that remembers whether the stick was moved: once it is, it stays so until `hysteresis` below `inner`.
///
/// No creep: what comes back to rest gives exactly zero. Full range: just above rest it is small, at `outer` it is 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rest {
    zone: DeadZone,
    shape: Shape,
    hysteresis: f32,
    is_moved: [bool; 2],
}

impl Rest {
    /// A stick at rest. `hysteresis`: by how much deflection must fall below `zone`'s inner bound to be at rest again; 0 to
    /// that bound. Small: a stick held at the bound flickers; large: slow movements end late.
    ///
    /// # Errors
    /// Where it is not within 0 and the inner bound.
    pub fn new(zone: DeadZone, shape: Shape, hysteresis: f32) -> Result<Self, DeadZoneError> {
        if (0.0..=zone.inner).contains(&hysteresis) {
            Ok(Self { zone, shape, hysteresis, is_moved: [false; 2] })
        } else {
            Err(DeadZoneError { inner: zone.inner - hysteresis, outer: zone.outer })
        }
    }

    /// The deflection, −1 to 1 on each axis, with the dead zone taken out. Zero for what is not finite.
    pub fn apply(&mut self, [x, y]: [f32; 2]) -> [f32; 2] {
        match self.shape {
            Shape::Radial => {
                self.is_moved[0] = self.moves(x.hypot(y), 0);
                if self.is_moved[0] { self.open().apply([x, y]) } else { [0.0; 2] }
            }
            Shape::Axial => {
                let axis = |rest: &mut Self, value: f32, axis: usize| {
                    rest.is_moved[axis] = rest.moves(value.abs(), axis);
                    if rest.is_moved[axis] { rest.open().apply([value, 0.0])[0] } else { 0.0 }
                };
                [axis(self, x, 0), axis(self, y, 1)]
            }
        }
    }

    /// The zone while the stick is moved.
    fn open(&self) -> DeadZone {
        DeadZone { inner: self.zone.inner - self.hysteresis, outer: self.zone.outer }
    }

    fn moves(&self, deflection: f32, axis: usize) -> bool {
        let bound = if self.is_moved[axis] { self.open().inner } else { self.zone.inner };
        deflection.is_finite() && deflection > bound
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stick_that_trembles_at_the_bound_does_not_flicker_and_one_that_comes_back_does_not_creep() {
        let mut rest = Rest::new(DeadZone::new(0.15, 0.95).unwrap(), Shape::Radial, 0.03).unwrap();
        assert_eq!(rest.apply([0.149, 0.0]), [0.0; 2]);
        let changes =
            (0..100).map(|k| rest.apply([0.15 + if k % 2 == 0 { 0.01 } else { -0.01 }, 0.0])[0] > 0.0);
        assert!(changes.collect::<Vec<_>>().iter().all(|moved| *moved));
        assert_eq!(rest.apply([0.119, 0.0]), [0.0; 2]);
        assert_eq!(rest.apply([0.14, 0.0]), [0.0; 2]);
        assert_eq!(rest.apply([0.0, -1.0]), [0.0, -1.0]);
        assert_eq!(rest.apply([f32::NAN, 0.0]), [0.0; 2]);
        // Worn sticks that rest beside the middle, each on its own axis.
        let mut rest = Rest::new(DeadZone::default(), Shape::Axial, 0.0).unwrap();
        let [x, y] = rest.apply([0.1, 0.55]);
        assert!(x == 0.0 && (y - 0.5).abs() < 1e-6);
        assert!(Rest::new(DeadZone::default(), Shape::Axial, 0.2).is_err());
        assert!(Rest::new(DeadZone::default(), Shape::Axial, f32::NAN).is_err());
    }

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
