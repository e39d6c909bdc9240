use vergence_time::Span;

/// Something that is pressed or not; `None` where no device offers it now.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Button(pub Option<bool>);

/// Something that is pulled: 0…1 (triggers) or −1…1; `None` where no device offers it now.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Axis(pub Option<f32>);

/// Something that is pushed in a plane: x to the right, y away from the user, inside the unit disc or, where the stream has a unit (a
/// mouse's `counts`, a wheel's `lines`), how far since the last sample; `None` where no device offers it now.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Vector2(pub Option<[f32; 2]>);

/// What a finger, a pen or a pointer does on a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touch {
    /// Which contact: the same number from the first touch to the last; free for another one after that.
    pub contact: u32,
    /// On the surface: x to the right, y down, in the stream's unit (pixels where it says nothing).
    pub position: [f64; 2],
    /// What happened.
    pub phase: TouchPhase,
}

/// What a contact with a surface does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TouchPhase {
    /// Near, or a pointer without a pressed button: it does not touch.
    Hovers,
    /// It touches from now on.
    Begins,
    /// It has moved.
    Moves,
    /// It does not touch any more.
    Ends,
    /// It was no touch after all, or it left the surface: what it did should be undone.
    Cancelled,
}

/// A pulse that a hand feels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Haptic {
    /// How long; `None`: the shortest that the device can do.
    pub duration: Option<Span>,
    /// `None`: as the runtime likes best.
    pub frequency_hz: Option<f32>,
    /// 0…1.
    pub amplitude: f32,
}

impl Button {
    /// Pressed, and known to be.
    pub fn is_pressed(self) -> bool {
        self.0 == Some(true)
    }
}

impl Axis {
    /// The value; 0 where it is not known or not finite; held in −1…1.
    pub fn or_zero(self) -> f32 {
        self.0.filter(|x| x.is_finite()).unwrap_or(0.0).clamp(-1.0, 1.0)
    }
}

impl Vector2 {
    /// The value; zero where it is not known or not finite.
    pub fn or_zero(self) -> [f32; 2] {
        self.0.filter(|v| v.iter().all(|x| x.is_finite())).unwrap_or([0.0; 2])
    }
}

impl Haptic {
    /// A short tick, as when something is touched.
    pub const TICK: Self = Self { duration: Some(Span::from_millis(20)), frequency_hz: None, amplitude: 0.5 };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_known_does_nothing() {
        assert!(!Button(None).is_pressed() && Button(Some(true)).is_pressed());
        assert_eq!((Axis(None).or_zero(), Axis(Some(f32::NAN)).or_zero()), (0.0, 0.0));
        assert_eq!(Axis(Some(7.0)).or_zero(), 1.0);
        assert_eq!(Vector2(Some([f32::NAN, 1.0])).or_zero(), [0.0; 2]);
    }
}
