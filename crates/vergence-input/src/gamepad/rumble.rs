//! The motors of a gamepad.

use evdev::{Device, FFEffect, FFEffectCode, FFEffectData, FFEffectKind, FFReplay, FFTrigger};
use vergence_time::Span;

use super::node::nodes;
use crate::error::Error;
use crate::found::Found;

/// The motors of a gamepad. Nothing is sent before it is asked for, and they stand still when it is dropped.
pub struct Rumble {
    name: String,
    /// Before the node: an effect ends on a node that is still open.
    effect: Option<FFEffect>,
    device: Device,
}

fn data(strong: f64, weak: f64, length: Span) -> FFEffectData {
    // NaN becomes 0.
    let magnitude = |share: f64| (share.clamp(0.0, 1.0) * f64::from(u16::MAX)).round() as u16;
    let length = (length.as_millis_f64().clamp(0.0, 32_767.0)) as u16;
    FFEffectData {
        direction: 0,
        trigger: FFTrigger::default(),
        replay: FFReplay { length, delay: 0 },
        kind: FFEffectKind::Rumble { strong_magnitude: magnitude(strong), weak_magnitude: magnitude(weak) },
    }
}

impl Rumble {
    /// Of the pad `device`.
    ///
    /// # Errors
    /// Where it is gone, may not be opened for writing, or has no motors.
    pub fn open(device: &Found) -> Result<Self, Error> {
        let is_there =
            nodes().iter().any(|node| node.found.path == device.path && node.found.is_same_device(device));
        if !is_there {
            return Err(Error::Gone { device: device.name.clone() });
        }
        let opened = Device::open(&device.path).map_err(|error| Error::open(device, error))?;
        if !opened.supported_ff().is_some_and(|effects| effects.contains(FFEffectCode::FF_RUMBLE)) {
            return Err(Error::open(device, "it has no motors"));
        }
        Ok(Self { name: device.name.clone(), effect: None, device: opened })
    }

    /// Shakes for `length` (at most 32.767 s) with shares, 0 to 1, of what the slow strong motor and the fast weak one can do.
    ///
    /// # Errors
    /// Where the pad is gone.
    pub fn play(&mut self, strong: f64, weak: f64, length: Span) -> Result<(), Error> {
        let data = data(strong, weak, length);
        let played = match &mut self.effect {
            Some(effect) => effect.update(data).and_then(|()| effect.play(1)),
            None => self.device.upload_ff_effect(data).and_then(|mut effect| {
                let played = effect.play(1);
                self.effect = Some(effect);
                played
            }),
        };
        played.map_err(|_| Error::Gone { device: self.name.clone() })
    }

    /// Stands still.
    ///
    /// # Errors
    /// Where the pad is gone.
    pub fn stop(&mut self) -> Result<(), Error> {
        let Some(effect) = &mut self.effect else { return Ok(()) };
        effect.stop().map_err(|_| Error::Gone { device: self.name.clone() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_become_numbers_within_their_range() {
        let FFEffectKind::Rumble { strong_magnitude, weak_magnitude } =
            data(2.0, f64::NAN, Span::from_millis(7)).kind
        else {
            panic!("a rumble")
        };
        assert_eq!((strong_magnitude, weak_magnitude), (u16::MAX, 0));
        assert_eq!(data(0.0, 0.0, Span::from_millis(1 << 40)).replay.length, 32_767);
    }

    #[test]
    fn a_pad_that_is_not_there_is_an_error() {
        let found = Found::new("gamepad", "/dev/input/event9999".to_owned());
        assert!(matches!(Rumble::open(&found), Err(Error::Gone { .. })));
    }
}
