//! The last rate goes on, or goes on changing.

use nalgebra::{UnitQuaternion, Vector3};
use vergence_geom::advance;
use vergence_time::Timestamp;

use super::{PredictPosition, PredictRotation, ahead_s, follows};

/// Share of the slope that is believed by the damped method.
pub(super) const DAMPED: f64 = 0.5;

/// The slope is that of this much time before the last observation, but of three observations at least where they are no further
/// apart than the second.
const WINDOW_S: f64 = 0.028;
const LONGEST_S: f64 = 0.25;

/// Most observations that a window holds; of faster ones, the last.
const MOST: usize = 64;

/// Rates of the last moments, and their slope by least squares.
#[derive(Clone, Debug)]
struct Window {
    rates: [(Timestamp, Vector3<f64>); MOST],
    newest: usize,
    length: usize,
}

impl Window {
    fn new() -> Self {
        Self { rates: [(Timestamp::default(), Vector3::zeros()); MOST], newest: 0, length: 0 }
    }

    fn push(&mut self, time: Timestamp, rate: Vector3<f64>) {
        self.newest = (self.newest + 1) % MOST;
        self.rates[self.newest] = (time, rate);
        self.length = (self.length + 1).min(MOST);
    }

    fn rate(&self) -> Vector3<f64> {
        if self.length == 0 { Vector3::zeros() } else { self.rates[self.newest].1 }
    }

    /// Of the rates of the window, per second; zero where fewer than three are near enough.
    fn slope(&self) -> Vector3<f64> {
        let now = self.rates[self.newest].0;
        let seen =
            (0..self.length).map(|k| self.rates[(self.newest + MOST - k) % MOST]).map(|(time, rate)| {
                let ago_s = now.since(time).map_or(f64::INFINITY, |span| span.as_secs_f64());
                (-ago_s, rate)
            });
        // Half a period of 1 kHz of room for jitter at the edge.
        let (mut n, mut t1, mut t2, mut r1, mut rt) = (0.0, 0.0, 0.0, Vector3::zeros(), Vector3::zeros());
        let near =
            |(k, (t, _)): &(usize, (f64, Vector3<f64>))| *t > -WINDOW_S + 5e-4 || (*k < 3 && *t > -LONGEST_S);
        for (_, (t, rate)) in seen.enumerate().take_while(near) {
            n += 1.0;
            t1 += t;
            t2 += t * t;
            r1 += rate;
            rt += rate * t;
        }
        let spread = n * t2 - t1 * t1;
        if n < 3.0 || spread <= 0.0 { Vector3::zeros() } else { (rt * n - r1 * t1) / spread }
    }

    /// The mean rate of the next `ahead_s` seconds.
    fn mean_rate(&self, ahead_s: f64, slope_gain: Option<f64>) -> Vector3<f64> {
        let slope = slope_gain.map_or(Vector3::zeros(), |gain| self.slope() * gain);
        self.rate() + slope * (0.5 * ahead_s)
    }
}

/// Turning at the last rate, with a share of its slope.
#[derive(Clone, Debug)]
pub struct SlopeRotation {
    gain: f64,
    slope_gain: Option<f64>,
    last: Option<(Timestamp, UnitQuaternion<f64>)>,
    window: Window,
}

impl SlopeRotation {
    /// `gain` times the last rate (1; 0: it stays), and `slope_gain` times its slope (1: all of it).
    pub fn new(gain: f64, slope_gain: Option<f64>) -> Self {
        Self { gain, slope_gain, last: None, window: Window::new() }
    }
}

impl PredictRotation for SlopeRotation {
    fn observe(
        &mut self,
        time: Timestamp,
        world_from_body: &UnitQuaternion<f64>,
        rate_in_body_rad_s: &Vector3<f64>,
    ) {
        let numbers = world_from_body.coords.iter().chain(rate_in_body_rad_s.iter());
        let Some(since) = follows(self.last.map(|(last, _)| last), time, numbers) else { return };
        if since.is_none() {
            self.window = Window::new();
        }
        self.window.push(time, *rate_in_body_rad_s);
        self.last = Some((time, *world_from_body));
    }

    fn predict(&self, time: Timestamp) -> Option<UnitQuaternion<f64>> {
        let (last, world_from_body) = self.last?;
        let ahead_s = ahead_s(last, time);
        let way = self.window.mean_rate(ahead_s, self.slope_gain) * (self.gain * ahead_s);
        Some(advance(&world_from_body, &way))
    }
}

/// Moving at the last velocity (between the last two positions), with a share of its slope.
#[derive(Clone, Debug)]
pub struct SlopePosition {
    gain: f64,
    slope_gain: Option<f64>,
    last: Option<(Timestamp, Vector3<f64>)>,
    window: Window,
}

impl SlopePosition {
    /// `gain` times the last velocity (1; 0: it stays), and `slope_gain` times its slope (1: all of it).
    pub fn new(gain: f64, slope_gain: Option<f64>) -> Self {
        Self { gain, slope_gain, last: None, window: Window::new() }
    }
}

impl PredictPosition for SlopePosition {
    fn observe(&mut self, time: Timestamp, position_m: &Vector3<f64>) {
        let Some(since) = follows(self.last.map(|(last, _)| last), time, position_m.iter()) else { return };
        match (since, self.last) {
            (Some(seconds), Some((_, before))) => {
                let velocity = (position_m - before) / seconds;
                if velocity.iter().all(|x| x.abs() < 1e6) {
                    self.window.push(time, velocity);
                }
            }
            _ => self.window = Window::new(),
        }
        self.last = Some((time, *position_m));
    }

    fn predict(&self, time: Timestamp) -> Option<Vector3<f64>> {
        let (last, position_m) = self.last?;
        let ahead_s = ahead_s(last, time);
        Some(position_m + self.window.mean_rate(ahead_s, self.slope_gain) * (self.gain * ahead_s))
    }
}

#[cfg(test)]
mod tests {
    use vergence_time::Span;

    use super::*;

    #[test]
    fn slow_observations_have_a_slope_too() {
        for (rate_hz, known) in [(286, true), (60, true), (25, true), (5, false)] {
            let mut window = Window::new();
            let period = Span::from_nanos(1_000_000_000 / rate_hz);
            for k in 0..100 {
                let t = k as f64 * period.as_secs_f64();
                window.push(Timestamp::from_nanos(k * period.as_nanos()), Vector3::new(2.0 * t, 0.0, -t));
            }
            let expected = if known { Vector3::new(2.0, 0.0, -1.0) } else { Vector3::zeros() };
            assert!((window.slope() - expected).norm() < 1e-9, "{rate_hz} Hz: {}", window.slope());
        }
    }
}
