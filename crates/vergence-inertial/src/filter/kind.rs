use std::path::Path;

use vergence_time::Span;

use super::{
    Complementary, Core, Filter, Integration, Limits, Madgwick, Mahony, Params, Stream, Vergence,
    VergenceParams, Vqf, VqfParams, read_params, read_unit_params,
};
use crate::{Error, Unit};

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

    /// A filter of this kind at its start, for samples every `period` of a unit of which nothing is known.
    pub fn filter(self, axes: Axes, period: Span) -> Box<dyn Filter> {
        self.of(Unit::Unknown, axes, period)
    }

    /// The same for a unit that is known.
    pub fn of(self, unit: Unit, axes: Axes, period: Span) -> Box<dyn Filter> {
        // Without a file nothing can be wrong in it.
        self.made(axes, period, &mut Defaults(unit)).unwrap_or_else(|never| match never {})
    }

    /// The same with parameters from the file `config`; what it does not name is as for that unit.
    ///
    /// # Errors
    /// Those of [`read_params`]; [`Error::Mismatch`] for a filter without parameters.
    pub fn configured(
        self,
        unit: Unit,
        axes: Axes,
        period: Span,
        config: &Path,
    ) -> Result<Box<dyn Filter>, Error> {
        if self == Self::Integration {
            return Err(Error::Mismatch {
                path: config.to_owned(),
                expected: "a filter with parameters".to_owned(),
                found: self.name().to_owned(),
            });
        }
        self.made(axes, period, &mut FromFile(config, unit))
    }

    fn made<S: Source>(self, axes: Axes, period: Span, from: &mut S) -> Result<Box<dyn Filter>, S::Error> {
        fn stream(core: impl Core + 'static, axes: Axes, period: Span) -> Box<dyn Filter> {
            Box::new(Stream::new(core, axes, period, Limits::default()))
        }
        let period_s = period.as_secs_f64();
        Ok(match self {
            Self::Integration => stream(Integration::default(), axes, period),
            Self::Complementary => stream(Complementary::new(from.params()?), axes, period),
            Self::Madgwick => stream(Madgwick::new(from.params()?), axes, period),
            Self::Mahony => stream(Mahony::new(from.params()?), axes, period),
            Self::VqfBasic => {
                let params = VqfParams {
                    motion_bias: false,
                    rest_bias: false,
                    magnetic_rejection: false,
                    ..from.params()?
                };
                stream(Vqf::new(params, period_s), axes, period)
            }
            Self::Vqf => stream(Vqf::new(from.params()?, period_s), axes, period),
            Self::Vergence => stream(Vergence::new(from.vergence()?, period_s), axes, period),
        })
    }
}

/// Where parameters come from.
trait Source {
    type Error;
    fn params<P: Params + Default>(&mut self) -> Result<P, Self::Error>;
    /// Of the one filter that heeds the unit.
    fn vergence(&mut self) -> Result<VergenceParams, Self::Error>;
}

struct Defaults(Unit);

impl Source for Defaults {
    type Error = std::convert::Infallible;
    fn params<P: Params + Default>(&mut self) -> Result<P, Self::Error> {
        Ok(P::default())
    }

    fn vergence(&mut self) -> Result<VergenceParams, Self::Error> {
        Ok(self.0.params())
    }
}

struct FromFile<'a>(&'a Path, Unit);

impl Source for FromFile<'_> {
    type Error = Error;
    fn params<P: Params + Default>(&mut self) -> Result<P, Error> {
        read_params(self.0)
    }

    fn vergence(&mut self) -> Result<VergenceParams, Error> {
        read_unit_params(self.0, self.1)
    }
}
