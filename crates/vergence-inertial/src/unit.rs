//! What is known of an inertial unit beyond its readings.

use crate::filter::VergenceParams;

/// The unit that a recording is of, as far as its timing is known: nothing in the samples tells how late all of them are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Unit {
    /// Nothing is known: rates are means over their step and no sensor is late, as VQF has it.
    #[default]
    Unknown,
    /// The one of the BROAD recordings: all its readings are 4.05 ms late, those of the magnetometer 5 ms more (eight recordings
    /// and their cameras agree to 0.2 ms). Between 100 Hz and its 286 Hz and beyond, copies hold what it said at an instant.
    Broad,
}

impl Unit {
    /// Every unit.
    pub const ALL: [Self; 2] = [Self::Unknown, Self::Broad];

    /// The name on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::Broad => "broad",
        }
    }

    /// The unit with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|unit| unit.name() == name)
    }

    /// The defaults of `vergence` with the timing of this unit.
    pub fn params(self) -> VergenceParams {
        match self {
            Self::Unknown => VergenceParams::default(),
            Self::Broad => VergenceParams {
                latency_s: 0.00405,
                gyr_averaged: 0.0,
                acc_lag_s: 0.0004,
                mag_lag_s: 0.005,
                ..VergenceParams::default()
            },
        }
    }
}
