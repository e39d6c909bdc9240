#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod front;
mod knob;
mod show;

pub use front::Limit;
pub use knob::{Knob, Setting, Value};

/// What is measured, and in which unit; smaller is better.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Scale {
    /// Such as "CPU time".
    pub name: String,
    /// Such as "ms"; empty where there is none.
    pub unit: String,
}

impl Scale {
    /// A name and a unit.
    pub fn new(name: impl Into<String>, unit: impl Into<String>) -> Self {
        Self { name: name.into(), unit: unit.into() }
    }

    /// Such as "CPU time (ms)".
    pub fn title(&self) -> String {
        if self.unit.is_empty() { self.name.clone() } else { format!("{} ({})", self.name, self.unit) }
    }
}

/// What one setting costs and how wrong it is.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Measurement {
    /// Where the knobs stood.
    pub setting: Setting,
    /// One per cost scale of the trade; NaN where it could not be measured.
    pub costs: Vec<f64>,
    /// One per error scale of the trade; NaN where it could not be measured.
    pub errors: Vec<f64>,
}

/// Measurements of one subsystem against one truth.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Trade {
    title: String,
    knobs: Vec<Knob>,
    costs: Vec<Scale>,
    errors: Vec<Scale>,
    /// Errors that differ by less than this share are the same: a front has no steps below it.
    error_noise: f64,
    measurements: Vec<Measurement>,
}

impl Trade {
    /// Without measurements.
    ///
    /// # Errors
    /// Where there is no knob, no cost or no error, a knob has no value, or two knobs have one name.
    pub fn new(
        title: impl Into<String>,
        knobs: Vec<Knob>,
        costs: Vec<Scale>,
        errors: Vec<Scale>,
    ) -> Result<Self, Error> {
        for (what, count) in [("knob", knobs.len()), ("cost", costs.len()), ("error", errors.len())] {
            if count == 0 {
                return Err(Error::Empty { what: what.to_owned() });
            }
        }
        for (index, knob) in knobs.iter().enumerate() {
            if knob.values.is_empty() {
                return Err(Error::Empty { what: format!("value of knob {:?}", knob.name) });
            }
            if knobs[..index].iter().any(|other| other.name == knob.name) {
                return Err(Error::Twice { name: knob.name.clone() });
            }
        }
        Ok(Self { title: title.into(), knobs, costs, errors, error_noise: 0.0, measurements: Vec::new() })
    }

    /// With errors that repeat only so well (0.1: a tenth): a dearer setting must err by more than this share less than a cheaper one to beat
    /// it. 0, and every difference counts, where it is not said.
    #[must_use]
    pub fn with_error_noise(mut self, share: f64) -> Self {
        self.error_noise = share.clamp(0.0, 1.0);
        self
    }

    /// Every combination of the knobs' values: the last knob changes fastest.
    pub fn grid(&self) -> Vec<Setting> {
        let mut settings = vec![Setting(Vec::new())];
        for knob in &self.knobs {
            let with = |setting: &Setting, value: &Value| {
                let mut values = setting.0.clone();
                values.push((knob.name.clone(), value.clone()));
                Setting(values)
            };
            settings = settings.iter().flat_map(|s| knob.values.iter().map(move |v| with(s, v))).collect();
        }
        settings
    }

    /// Records a measurement. Values that are not finite are kept and shown, but never chosen.
    ///
    /// # Errors
    /// Where the numbers of costs or errors are not those of the trade, or the setting names other knobs.
    pub fn push(&mut self, measurement: Measurement) -> Result<(), Error> {
        let counts = [
            ("costs", self.costs.len(), measurement.costs.len()),
            ("errors", self.errors.len(), measurement.errors.len()),
            ("knobs", self.knobs.len(), measurement.setting.0.len()),
        ];
        for (what, expected, found) in counts {
            if expected != found {
                return Err(Error::Count { what, expected, found });
            }
        }
        for (knob, (found, _)) in self.knobs.iter().zip(&measurement.setting.0) {
            if &knob.name != found {
                return Err(Error::Knob { expected: knob.name.clone(), found: found.clone() });
            }
        }
        self.measurements.push(measurement);
        Ok(())
    }

    /// What was traded.
    pub fn title(&self) -> &str {
        &self.title
    }

    /// What can be turned.
    pub fn knobs(&self) -> &[Knob] {
        &self.knobs
    }

    /// The scales of cost.
    pub fn costs(&self) -> &[Scale] {
        &self.costs
    }

    /// The scales of error.
    pub fn errors(&self) -> &[Scale] {
        &self.errors
    }

    /// In the order in which they were recorded.
    pub fn measurements(&self) -> &[Measurement] {
        &self.measurements
    }
}

/// Why there is no trade, or no choice.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// Nothing to turn or to measure.
    #[error("expected at least one {what}, found none")]
    Empty {
        /// What is missing.
        what: String,
    },
    /// Two knobs cannot be told apart.
    #[error("expected knobs of different names, found {name:?} twice")]
    Twice {
        /// The name.
        name: String,
    },
    /// A measurement does not fit the trade.
    #[error("expected {expected} {what}, found {found}")]
    Count {
        /// Of what.
        what: &'static str,
        /// As the trade has.
        expected: usize,
        /// As the measurement has.
        found: usize,
    },
    /// A setting names another knob, or in another order.
    #[error("expected the knob {expected:?}, found {found:?}")]
    Knob {
        /// The trade's.
        expected: String,
        /// The setting's.
        found: String,
    },
    /// No setting keeps the limit.
    #[error("expected a setting with {scale} of at most {limit}, found {}", found(nearest))]
    NothingFits {
        /// The scale that is limited.
        scale: String,
        /// The limit.
        limit: f64,
        /// The smallest value that was measured, and its setting; `None` where nothing finite was measured.
        nearest: Option<(f64, String)>,
    },
}

fn found(nearest: &Option<(f64, String)>) -> String {
    match nearest {
        Some((value, setting)) => format!("at least {value:.6} ({setting})"),
        None => "no finite measurement".to_owned(),
    }
}
