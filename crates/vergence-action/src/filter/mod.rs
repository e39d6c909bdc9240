//! Smoothing of what devices say: less jitter for more lag, in physical terms.
//!
//! All filters are fed samples with their times, at any rate; they read no clock and allocate nothing. Of `N` numbers at once,
//! such as the three of a position: the one euro filter then judges the speed of the whole. A sample that is not finite changes
//! nothing; the last result is given again. One that is not later than the one before takes its place: of what a device says at
//! once, the last holds.
//!
//! What each knob costs in lag and gains in steadiness, on recorded motion: `vergence trade filters`.

mod double_exponential;
pub mod judge;
mod low_pass;
mod one_euro;

use vergence_time::{Span, Timestamp};

pub use double_exponential::DoubleExponentialParams;
pub use low_pass::LowPassParams;
pub use one_euro::OneEuroParams;

use double_exponential::DoubleExponential;
use low_pass::LowPass;
use one_euro::OneEuro;

/// A filter's kind and its knobs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Smoothing {
    /// Nothing is smoothed, nothing lags.
    #[default]
    None,
    /// First-order low-pass.
    LowPass(LowPassParams),
    /// Brown's double exponential smoothing.
    DoubleExponential(DoubleExponentialParams),
    /// The one euro filter.
    OneEuro(OneEuroParams),
}

impl Smoothing {
    /// Its name in files and tables.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::None => "none",
            Self::LowPass(_) => "low-pass",
            Self::DoubleExponential(_) => "double-exponential",
            Self::OneEuro(_) => "one-euro",
        }
    }

    /// Why these knobs cannot be used: `None` where they can.
    pub fn fault(&self) -> Option<KnobError> {
        match self {
            Self::None => None,
            Self::LowPass(params) => params.fault(),
            Self::DoubleExponential(params) => params.fault(),
            Self::OneEuro(params) => params.fault(),
        }
    }

    /// A filter with these knobs, that has seen nothing.
    ///
    /// # Errors
    /// Where a knob is out of its range.
    pub fn smoother<const N: usize>(&self) -> Result<Smoother<N>, KnobError> {
        if let Some(fault) = self.fault() {
            return Err(fault);
        }
        let state = match *self {
            Self::None => State::None,
            Self::LowPass(params) => State::LowPass(LowPass::new(params)),
            Self::DoubleExponential(params) => State::DoubleExponential(DoubleExponential::new(params)),
            Self::OneEuro(params) => State::OneEuro(OneEuro::new(params)),
        };
        Ok(Smoother { state, last: None, before: None })
    }
}

/// A knob out of its range.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{knob}: expected {expected}, found {found}")]
pub struct KnobError {
    /// Which.
    pub knob: &'static str,
    /// Its range.
    pub expected: &'static str,
    /// What was given.
    pub found: f64,
}

/// The first of (name, value, lowest, highest, range in words) that is out of its range.
fn first_fault(knobs: &[(&'static str, f64, f64, f64, &'static str)]) -> Option<KnobError> {
    let wrong = knobs.iter().find(|(_, found, low, high, _)| !(*low..=*high).contains(found));
    wrong.map(|&(knob, found, _, _, expected)| KnobError { knob, expected, found })
}

/// A filter at work on `N` numbers.
#[derive(Clone, Debug)]
pub struct Smoother<const N: usize> {
    state: State<N>,
    last: Last<N>,
    /// Both as they were before the last sample, which another one may take the place of.
    before: Option<(State<N>, Last<N>)>,
}

/// The last sample's time, and what came out.
type Last<const N: usize> = Option<(Timestamp, [f64; N])>;

#[derive(Clone, Copy, Debug)]
enum State<const N: usize> {
    None,
    LowPass(LowPass<N>),
    DoubleExponential(DoubleExponential<N>),
    OneEuro(OneEuro<N>),
}

impl<const N: usize> Smoother<N> {
    /// Whether it gives what it is given.
    pub const fn is_none(&self) -> bool {
        matches!(self.state, State::None)
    }

    /// Feeds one sample and gives the smoothed value at its time. The first one passes as it is.
    pub fn update(&mut self, at: Timestamp, value: [f64; N]) -> [f64; N] {
        if !value.iter().all(|x| x.is_finite()) {
            return self.last.map_or([0.0; N], |(_, smooth)| smooth);
        }
        let mut at = at;
        match (self.last, self.before) {
            (Some((latest, _)), Some((state, last))) if at <= latest => {
                at = latest;
                (self.state, self.last) = (state, last);
            }
            _ => self.before = Some((self.state, self.last)),
        }
        let passed_s = self.last.and_then(|(before, _)| at.since(before)).map(Span::as_secs_f64);
        let smooth = match &mut self.state {
            State::None => value,
            State::LowPass(filter) => filter.update(passed_s, value),
            State::DoubleExponential(filter) => filter.update(passed_s, value),
            State::OneEuro(filter) => filter.update(passed_s, value),
        };
        // Sums of numbers near the largest overflow; such a sample is none.
        if !smooth.iter().all(|x| x.is_finite()) {
            self.reset();
            return value;
        }
        self.last = Some((at, smooth));
        smooth
    }

    /// Forgets what it has seen: after a loss, or a jump that is none of the device's.
    pub fn reset(&mut self) {
        // The next sample is the first one again: no filter then reads what it kept.
        (self.last, self.before) = (None, None);
    }
}
