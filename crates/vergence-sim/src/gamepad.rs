//! A gamepad in somebody's hands, as the wire has it: sticks that do not rest in the middle, do not reach the corner, and tremble.

use vergence_inertial::Dice;
use vergence_time::Timestamp;

use crate::Error;

/// What the hands do.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Held {
    /// Left stick: x right, y away, in the unit disc.
    pub left: [f64; 2],
    /// Right stick.
    pub right: [f64; 2],
    /// Left and right trigger, 0 to 1.
    pub triggers: [f64; 2],
    /// Buttons that are down: sums of [`button`]s.
    pub buttons: u16,
}

/// The buttons, by where they are, as the wired Xbox 360 controller has them in its reports.
pub mod button {
    /// Cross of direction buttons: up.
    pub const UP: u16 = 0x0001;
    /// Down.
    pub const DOWN: u16 = 0x0002;
    /// Left.
    pub const LEFT: u16 = 0x0004;
    /// Right.
    pub const RIGHT: u16 = 0x0008;
    /// Start, menu.
    pub const START: u16 = 0x0010;
    /// Back, view.
    pub const BACK: u16 = 0x0020;
    /// Left stick, pressed.
    pub const LEFT_STICK: u16 = 0x0040;
    /// Right stick, pressed.
    pub const RIGHT_STICK: u16 = 0x0080;
    /// Left shoulder.
    pub const LEFT_SHOULDER: u16 = 0x0100;
    /// Right shoulder.
    pub const RIGHT_SHOULDER: u16 = 0x0200;
    /// The middle.
    pub const GUIDE: u16 = 0x0400;
    /// South (A).
    pub const SOUTH: u16 = 0x1000;
    /// East (B).
    pub const EAST: u16 = 0x2000;
    /// West (X).
    pub const WEST: u16 = 0x4000;
    /// North (Y).
    pub const NORTH: u16 = 0x8000;
}

/// How worn the pad is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Where a stick that nobody touches rests, share of its way (standard deviation over seeds), 0 to 0.5.
    pub rest: f64,
    /// Noise of a stick, share of its way, 0 to 0.5.
    pub noise: f64,
    /// How far a stick reaches, share of the range of its numbers, 0.1 to 1.5; above 1 it is held at the range's end.
    pub reach: f64,
}

impl Default for Params {
    /// A pad of some years.
    fn default() -> Self {
        Self { rest: 0.03, noise: 0.002, reach: 0.95 }
    }
}

/// A pad. Pure in (seed, time).
#[derive(Clone, Copy, Debug)]
pub struct Gamepad {
    seed: u64,
    params: Params,
}

impl Gamepad {
    /// Length of a report, bytes.
    pub const REPORT: usize = 20;

    /// A pad.
    ///
    /// # Errors
    /// Where a parameter is out of its range.
    pub fn new(seed: u64, params: &Params) -> Result<Self, Error> {
        crate::in_ranges(&[
            ("rest", params.rest, 0.0, 0.5, "0 to 0.5"),
            ("noise", params.noise, 0.0, 0.5, "0 to 0.5"),
            ("reach", params.reach, 0.1, 1.5, "0.1 to 1.5"),
        ])?;
        Ok(Self { seed, params: *params })
    }

    /// The report at `time`: the wired Xbox 360 controller's 20 bytes (two of header, buttons, triggers, four stick axes of
    /// 16 bits, six of zero).
    pub fn report(&self, time: Timestamp, held: &Held) -> [u8; Self::REPORT] {
        let mut report = [0; Self::REPORT];
        report[1] = Self::REPORT as u8;
        report[2..4].copy_from_slice(&held.buttons.to_le_bytes());
        for (byte, trigger) in report[4..6].iter_mut().zip(held.triggers) {
            *byte = (trigger.clamp(0.0, 1.0) * 255.0).round() as u8;
        }
        let [rest, noise] = [0, 1].map(|stream| Dice::new(self.seed, stream));
        let axes = [held.left[0], held.left[1], held.right[0], held.right[1]];
        for (axis, value) in axes.into_iter().enumerate() {
            let luck = noise.normal((time.as_nanos() as u64).wrapping_mul(4).wrapping_add(axis as u64));
            let is = value * self.params.reach
                + self.params.rest * rest.normal(axis as u64)
                + self.params.noise * luck;
            let number = (is * 32_767.0).round().clamp(-32_768.0, 32_767.0) as i16;
            report[6 + 2 * axis..8 + 2 * axis].copy_from_slice(&number.to_le_bytes());
        }
        report
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis(report: &[u8], axis: usize) -> f64 {
        f64::from(i16::from_le_bytes([report[6 + 2 * axis], report[7 + 2 * axis]])) / 32_767.0
    }

    #[test]
    fn without_wear_the_report_is_what_the_hands_do() {
        let pad = Gamepad::new(1, &Params { rest: 0.0, noise: 0.0, reach: 1.0 }).unwrap();
        let held = Held {
            left: [1.0, -1.0],
            right: [0.5, f64::NAN],
            triggers: [1.0, 0.5],
            buttons: button::SOUTH | button::LEFT_SHOULDER,
        };
        let report = pad.report(Timestamp::from_nanos(7), &held);
        assert_eq!(report[..6], [0, 20, 0, 0x11, 255, 128]);
        assert_eq!((axis(&report, 0), axis(&report, 1), axis(&report, 3)), (1.0, -1.0, 0.0));
        assert!((axis(&report, 2) - 0.5).abs() < 1e-4);
    }

    #[test]
    fn a_worn_stick_rests_beside_the_middle_and_trembles() {
        let pad = Gamepad::new(2, &Params::default()).unwrap();
        let rests: Vec<f64> = (0..1000)
            .map(|k| axis(&pad.report(Timestamp::from_nanos(k * 4_000_000), &Held::default()), 0))
            .collect();
        let mean = rests.iter().sum::<f64>() / 1000.0;
        let spread = (rests.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / 1000.0).sqrt();
        assert!(mean.abs() > 1e-3 && mean.abs() < 0.15 && (spread - 0.002).abs() < 3e-4, "{mean} {spread}");
        assert_eq!(
            pad.report(Timestamp::default(), &Held::default()),
            pad.report(Timestamp::default(), &Held::default())
        );
        assert!(Gamepad::new(2, &Params { reach: 0.0, ..Params::default() }).is_err());
    }
}
