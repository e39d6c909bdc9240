use vergence_time::Span;

use super::{
    Complementary, ComplementaryParams, Filter, Integration, Limits, Madgwick, MadgwickParams, Mahony,
    MahonyParams, Stream, Vergence, VergenceParams, Vqf, VqfParams,
};

/// Which sensors are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axes {
    /// Gyroscope and accelerometer: the heading is relative.
    Six,
    /// And the magnetometer.
    Nine,
}

/// The filters by name, each with its default parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Gyroscope only.
    Integration,
    /// First-order pull to up and north.
    Complementary,
    /// Gradient descent.
    Madgwick,
    /// Explicit complementary filter with bias.
    Mahony,
    /// VQF without bias estimation and magnetic rejection.
    VqfBasic,
    /// VQF.
    Vqf,
    /// Our own.
    Vergence,
}

impl Kind {
    /// Every kind.
    pub const ALL: [Self; 7] = [
        Self::Integration,
        Self::Complementary,
        Self::Madgwick,
        Self::Mahony,
        Self::VqfBasic,
        Self::Vqf,
        Self::Vergence,
    ];

    /// The name in configuration and on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Integration => "integration",
            Self::Complementary => "complementary",
            Self::Madgwick => "madgwick",
            Self::Mahony => "mahony",
            Self::VqfBasic => "vqf-basic",
            Self::Vqf => "vqf",
            Self::Vergence => "vergence",
        }
    }

    /// The kind with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// A filter of this kind at its start, for samples every `period`.
    pub fn filter(self, axes: Axes, period: Span) -> Box<dyn Filter> {
        let limits = Limits::default();
        let period_s = period.as_secs_f64();
        match self {
            Self::Integration => Box::new(Stream::new(Integration::default(), axes, period, limits)),
            Self::Complementary => Box::new(Stream::new(
                Complementary::new(ComplementaryParams::default()),
                axes,
                period,
                limits,
            )),
            Self::Madgwick => {
                Box::new(Stream::new(Madgwick::new(MadgwickParams::default()), axes, period, limits))
            }
            Self::Mahony => Box::new(Stream::new(Mahony::new(MahonyParams::default()), axes, period, limits)),
            Self::VqfBasic => {
                Box::new(Stream::new(Vqf::new(VqfParams::BASIC, period_s), axes, period, limits))
            }
            Self::Vqf => Box::new(Stream::new(Vqf::new(VqfParams::FULL, period_s), axes, period, limits)),
            Self::Vergence => Box::new(Stream::new(
                Vergence::new(VergenceParams::default(), period_s),
                axes,
                period,
                limits,
            )),
        }
    }
}
