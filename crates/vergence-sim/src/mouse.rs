//! A mouse and a touch screen under a hand.

use vergence_inertial::Dice;
use vergence_time::Timestamp;

use crate::Error;
use crate::person::Hand;

/// How a mouse reads its table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mouse {
    counts_per_m: f64,
    rate_hz: f64,
}

/// One report of a mouse.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MouseReport {
    /// When.
    pub captured: Timestamp,
    /// Counts to the right.
    pub dx: i16,
    /// Counts towards the user, as devices count.
    pub dy: i16,
    /// Bit 0: the left button.
    pub buttons: u8,
}

/// An inch, metres.
const INCH_M: f64 = 0.0254;

/// The instant of sample number `index` at a rate, from time 0.
fn tick(index: u64, rate_hz: f64) -> Timestamp {
    Timestamp::from_nanos((index as f64 / rate_hz * 1e9).round() as i64)
}

impl Mouse {
    /// A mouse of `cpi` counts per inch (1 to 100,000) that reports `rate_hz` times a second (1 to 10,000).
    ///
    /// # Errors
    /// Where one is out of its range.
    pub fn new(cpi: f64, rate_hz: f64) -> Result<Self, Error> {
        crate::in_ranges(&[
            ("cpi", cpi, 1.0, 100_000.0, "1 to 100,000"),
            ("rate_hz", rate_hz, 1.0, 10_000.0, "1 to 10,000 Hz"),
        ])?;
        Ok(Self { counts_per_m: cpi / INCH_M, rate_hz })
    }

    /// Report number `index`, counted from time 0, of a mouse under `hand` (x to the right, y away). What is less than a
    /// count is not lost but comes later: the sum of all reports is where the hand is, to a count.
    pub fn report(&self, index: u64, hand: impl Fn(Timestamp) -> Hand) -> MouseReport {
        let captured = tick(index, self.rate_hz);
        let now = hand(captured);
        let before = hand(tick(index.saturating_sub(1), self.rate_hz));
        let counts = |metres: f64| (metres * self.counts_per_m).round() as i64;
        let moved =
            |to: f64, from: f64| (counts(to) - counts(from)).clamp(i16::MIN.into(), i16::MAX.into()) as i16;
        MouseReport {
            captured,
            dx: moved(now.position_m.x, before.position_m.x),
            dy: moved(-now.position_m.y, -before.position_m.y),
            buttons: u8::from(now.is_pressed),
        }
    }
}

/// How a screen feels fingers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Screen {
    seed: u64,
    pixels_per_m: f64,
    rate_hz: f64,
    noise_px: f64,
}

/// What a finger does on a screen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TouchPhase {
    /// Comes down.
    Down,
    /// Is there.
    Stays,
    /// Has gone.
    Up,
}

/// One report of a screen that is touched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TouchReport {
    /// When.
    pub captured: Timestamp,
    /// What.
    pub phase: TouchPhase,
    /// To the right and down from the screen's middle, pixels.
    pub position_px: [f64; 2],
}

impl Screen {
    /// A screen of `ppi` pixels per inch (1 to 10,000), `rate_hz` reports a second (1 to 10,000), and `noise_px` pixels of
    /// noise (standard deviation, 0 to 1000).
    ///
    /// # Errors
    /// Where one is out of its range.
    pub fn new(seed: u64, ppi: f64, rate_hz: f64, noise_px: f64) -> Result<Self, Error> {
        crate::in_ranges(&[
            ("ppi", ppi, 1.0, 10_000.0, "1 to 10,000"),
            ("rate_hz", rate_hz, 1.0, 10_000.0, "1 to 10,000 Hz"),
            ("noise_px", noise_px, 0.0, 1000.0, "0 to 1000"),
        ])?;
        Ok(Self { seed, pixels_per_m: ppi / INCH_M, rate_hz, noise_px })
    }

    /// Report number `index`, counted from time 0, under a finger that touches while the hand presses; `None` where nothing
    /// touches.
    pub fn report(&self, index: u64, hand: impl Fn(Timestamp) -> Hand) -> Option<TouchReport> {
        let captured = tick(index, self.rate_hz);
        let now = hand(captured);
        let was = index.checked_sub(1).is_some_and(|before| hand(tick(before, self.rate_hz)).is_pressed);
        let phase = match (was, now.is_pressed) {
            (false, true) => TouchPhase::Down,
            (true, true) => TouchPhase::Stays,
            (true, false) => TouchPhase::Up,
            (false, false) => return None,
        };
        let noise = Dice::new(self.seed, 0);
        let place = |metres: f64, axis: u64| {
            // Sensors give whole sixteenths of a pixel at best.
            let exact = metres * self.pixels_per_m + self.noise_px * noise.normal(2 * index + axis);
            (16.0 * exact).round() / 16.0
        };
        Some(TouchReport {
            captured,
            phase,
            position_px: [place(now.position_m.x, 0), place(-now.position_m.y, 1)],
        })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    fn circle(time: Timestamp) -> Hand {
        let t_s = time.as_nanos() as f64 * 1e-9;
        let (sin, cos) = (3.0 * t_s).sin_cos();
        Hand { position_m: Vector3::new(0.05 * cos, 0.05 * sin, 0.0), is_pressed: (t_s % 1.0) < 0.25 }
    }

    #[test]
    fn the_reports_of_a_mouse_add_up_to_where_the_hand_is() {
        for (cpi, rate) in [(400.0, 125.0), (1600.0, 1000.0), (26_000.0, 8000.0)] {
            let mouse = Mouse::new(cpi, rate).unwrap();
            let mut sum = [0i64; 2];
            let start = circle(Timestamp::from_nanos(0)).position_m;
            for index in 0..2 * rate as u64 {
                let report = mouse.report(index, circle);
                sum = [sum[0] + i64::from(report.dx), sum[1] + i64::from(report.dy)];
                let moved = (circle(report.captured).position_m - start) * cpi / INCH_M;
                assert!((sum[0] as f64 - moved.x).abs() <= 1.0 && (sum[1] as f64 + moved.y).abs() <= 1.0);
            }
        }
        assert!(Mouse::new(0.0, 125.0).is_err() && Mouse::new(400.0, f64::NAN).is_err());
    }

    #[test]
    fn a_finger_comes_down_once_and_goes_once() {
        let screen = Screen::new(1, 160.0, 60.0, 0.3).unwrap();
        let reports: Vec<TouchReport> = (0..300).filter_map(|index| screen.report(index, circle)).collect();
        let count = |phase| reports.iter().filter(|report| report.phase == phase).count();
        assert_eq!((count(TouchPhase::Down), count(TouchPhase::Up)), (5, 5));
        for report in &reports {
            let exact = circle(report.captured).position_m * 160.0 / INCH_M;
            assert!((report.position_px[0] - exact.x).hypot(report.position_px[1] + exact.y) < 2.0);
        }
    }
}
