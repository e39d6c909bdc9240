//! The knobs on which tools and papers differ, each with a name.

use std::fmt;
use std::str::FromStr;

use crate::Error;

/// √(2πe): the width of a uniform target that carries as much information as a normal spread of one SD.
pub const SQRT_2_PI_E: f64 = 4.132_731_354_122_493;

macro_rules! named {
    ($(#[$doc:meta])* $name:ident $what:literal { $($(#[$variant_doc:meta])* $variant:ident = $text:literal),+ $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $name {
            $($(#[$variant_doc])* $variant),+
        }

        impl $name {
            /// Every value.
            pub const ALL: &'static [Self] = &[$(Self::$variant),+];

            /// As it is written in options, logs and reports.
            pub fn name(self) -> &'static str {
                match self { $(Self::$variant => $text),+ }
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(self.name())
            }
        }

        impl FromStr for $name {
            type Err = Error;

            fn from_str(text: &str) -> Result<Self, Error> {
                Self::ALL.iter().copied().find(|value| value.name() == text).ok_or_else(|| Error::Knob {
                    what: $what,
                    expected: Self::ALL.iter().map(|value| value.name()).collect::<Vec<_>>().join(", "),
                    found: text.to_owned(),
                })
            }
        }
    };
}

named! {
    /// Index of difficulty: bits, and for tunnels a number without unit.
    Difficulty "index of difficulty" {
        /// log2(A/W + 1): MacKenzie 1992.
        Shannon = "shannon",
        /// log2(2A/W): Fitts 1954.
        Fitts = "fitts",
        /// A/W: Accot and Zhai 1997, for tunnels. Where a tunnel is left says nothing of accuracy, so that there are no effective
        /// measures and no throughput: times, shares of those who left it, paths, and T = a + b A/W.
        Steering = "steering",
        /// log2(α/ω³ + 1)², bits²: Kopper, Bowman, Silva and McMahan 2010, for rays (radians).
        Angular = "angular",
        /// 2 √(A/W): the term of Meyer et al. 1988 with two submovements; no unit.
        Meyer = "meyer",
    }
}

named! {
    /// The line along which ends are measured.
    Axis "task axis" {
        /// From the centre of the last target to the centre of this one; the amplitude from the actual start, along it.
        Nominal = "nominal",
        /// From the actual start to the centre of the target, as FittsStudy.
        Start = "start",
        /// As nominal, but amplitudes are nominal distance + dx, and in serial tasks + the dx before it, as GoFitts.
        Serial = "serial",
    }
}

named! {
    /// The frame in which bivariate ends are compared.
    Frame "frame of the bivariate spread" {
        /// Turned so that each trial's axis is the same direction.
        Task = "task",
        /// Not turned: distances from the target's centre as recorded.
        World = "world",
    }
}

named! {
    /// The amplitude of bivariate measures.
    Reach "bivariate amplitude" {
        /// Straight distance from start to end.
        Straight = "straight",
        /// The same as the univariate one.
        Axis = "axis",
    }
}

named! {
    /// The mean movement time of a sequence.
    MeanTime "mean movement time" {
        /// Of the numbers as they are.
        Exact = "exact",
        /// Cut to whole milliseconds, as FittsStudy does.
        WholeMs = "whole-ms",
    }
}

named! {
    /// Which trials are left out of effective measures and times (errors are counted among all).
    Outliers "outlier policy" {
        /// None.
        Keep = "keep",
        /// Misses that end before half the amplitude or more than 2 W from the centre (MacKenzie and Isokoski 2008, as FittsStudy).
        Spatial = "spatial",
        /// Ends or times more than 3 SD from the mean of their sequence.
        ThreeSd = "3sd",
        /// Times more than 3 scaled MAD from the median of their sequence.
        Mad = "3mad",
        /// Times outside of 75 % to 125 % of the metronome's, as FittsStudy.
        Temporal = "temporal",
        /// Missed targets.
        Misses = "misses",
    }
}

named! {
    /// How paths become counts.
    PathRule "path rule" {
        /// Samples as they are; crossings beyond a dead band, turns beyond a jump.
        Thresholds = "thresholds",
        /// As GoFitts counts: from the start's centre cut to whole units, directions without runs of one or two steps, turns
        /// behind runs that are longer than the jump; the axis always points to the right, which is the sign of MO.
        GoFitts = "gofitts",
        /// Resampled at 100 Hz, smoothed by a Gaussian of 5 samples, then every change of sign (FittsStudy).
        Smoothed = "smoothed",
    }
}

named! {
    /// Which points of a cloud of speeds and accuracies are its front.
    Front "front" {
        /// The lower left convex hull, from the fastest point to the most accurate one.
        Convex = "convex",
        /// The points that none is both faster and more accurate than.
        Pareto = "pareto",
        /// All.
        All = "all",
    }
}

/// All knobs. The default is ours: √(2πe), nominal axis, nothing left out.
#[derive(Clone, Debug, PartialEq)]
pub struct Conventions {
    /// Index of difficulty, nominal and effective.
    pub difficulty: Difficulty,
    /// We = factor · SD.
    pub we_factor: f64,
    /// Task axis.
    pub axis: Axis,
    /// Bivariate frame.
    pub frame: Frame,
    /// Bivariate amplitude.
    pub reach: Reach,
    /// Mean movement time.
    pub mean_time: MeanTime,
    /// Which trials are left out.
    pub outliers: Outliers,
    /// Path counts.
    pub path: PathRule,
    /// Dead band of axis crossings for [`PathRule::Thresholds`] and [`PathRule::GoFitts`], length unit (GoFitts: 5 px).
    pub crossing_band: f64,
    /// Least jump of a turn for the same, length unit (GoFitts: 10 px).
    pub turn_jump: f64,
    /// Sequences with fewer trials are not analysed.
    pub least_trials: usize,
    /// Asymptote of the movement time in the weighted homographic law, seconds: what no haste gets below. Larger: smaller
    /// weights of time.
    pub who_x0_s: f64,
    /// Asymptote of the relative spread in that law: what no care gets below. Points below it are not fitted.
    pub who_y0: f64,
    /// Which sequences that law is fitted to.
    pub who_front: Front,
}

impl Default for Conventions {
    fn default() -> Self {
        Self {
            difficulty: Difficulty::Shannon,
            we_factor: SQRT_2_PI_E,
            axis: Axis::Nominal,
            frame: Frame::Task,
            reach: Reach::Straight,
            mean_time: MeanTime::Exact,
            outliers: Outliers::Keep,
            path: PathRule::Thresholds,
            crossing_band: 0.0,
            turn_jump: 0.0,
            least_trials: 2,
            who_x0_s: 0.0,
            who_y0: 0.0,
            who_front: Front::Convex,
        }
    }
}

impl Conventions {
    /// Those of FittsStudy 4.2: 4.133, axis from the start, misses far away left out, whole milliseconds.
    pub fn fittsstudy() -> Self {
        Self {
            we_factor: 4.133,
            axis: Axis::Start,
            mean_time: MeanTime::WholeMs,
            outliers: Outliers::Spatial,
            path: PathRule::Smoothed,
            ..Self::default()
        }
    }

    /// For 3DFitts, which computes nothing itself: ours, with the spread in the world's frame.
    pub fn threedfitts() -> Self {
        Self { frame: Frame::World, reach: Reach::Axis, ..Self::default() }
    }

    /// Those of GoFitts and FittsTaskTwo.
    pub fn gofitts() -> Self {
        Self {
            axis: Axis::Serial,
            path: PathRule::GoFitts,
            crossing_band: 5.0,
            turn_jump: 10.0,
            ..Self::default()
        }
    }

    /// Sets one knob by its name and value as in [`Conventions::listed`].
    ///
    /// # Errors
    /// Where there is no such knob or value.
    pub fn set(&mut self, knob: &str, value: &str) -> Result<(), Error> {
        let number = |least: f64| {
            let parsed = value.parse::<f64>().ok().filter(|v| v.is_finite() && *v >= least);
            parsed.ok_or_else(|| Error::Knob {
                what: "number",
                expected: if least == f64::MIN_POSITIVE {
                    "above 0".to_owned()
                } else {
                    format!("of at least {least}")
                },
                found: value.to_owned(),
            })
        };
        match knob {
            "id" => self.difficulty = value.parse()?,
            "we_factor" if value == "sqrt(2*pi*e)" => self.we_factor = SQRT_2_PI_E,
            "we_factor" => self.we_factor = number(f64::MIN_POSITIVE)?,
            "axis" => self.axis = value.parse()?,
            "frame" => self.frame = value.parse()?,
            "reach" => self.reach = value.parse()?,
            "mean_time" => self.mean_time = value.parse()?,
            "outliers" => self.outliers = value.parse()?,
            "path" => self.path = value.parse()?,
            "crossing_band" => self.crossing_band = number(0.0)?,
            "turn_jump" => self.turn_jump = number(0.0)?,
            "least_trials" => self.least_trials = number(1.0)? as usize,
            "who_x0_s" => self.who_x0_s = number(0.0)?,
            "who_y0" => self.who_y0 = number(0.0)?,
            "who_front" => self.who_front = value.parse()?,
            _ => {
                return Err(Error::Knob {
                    what: "convention",
                    expected: self.listed().iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", "),
                    found: knob.to_owned(),
                });
            }
        }
        Ok(())
    }

    /// Names and values of all knobs, as written into logs and reports.
    pub fn listed(&self) -> Vec<(&'static str, String)> {
        let factor = if self.we_factor == SQRT_2_PI_E {
            "sqrt(2*pi*e)".to_owned()
        } else {
            self.we_factor.to_string()
        };
        vec![
            ("id", self.difficulty.to_string()),
            ("we_factor", factor),
            ("axis", self.axis.to_string()),
            ("frame", self.frame.to_string()),
            ("reach", self.reach.to_string()),
            ("mean_time", self.mean_time.to_string()),
            ("outliers", self.outliers.to_string()),
            ("path", self.path.to_string()),
            ("crossing_band", self.crossing_band.to_string()),
            ("turn_jump", self.turn_jump.to_string()),
            ("least_trials", self.least_trials.to_string()),
            ("who_x0_s", self.who_x0_s.to_string()),
            ("who_y0", self.who_y0.to_string()),
            ("who_front", self.who_front.to_string()),
        ]
    }
}
