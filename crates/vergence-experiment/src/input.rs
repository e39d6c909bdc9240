//! What moves the cursor.

use std::fmt;
use std::str::FromStr;

use crate::error::Error;

/// What moves the cursor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input {
    /// A mouse, on a desktop.
    Mouse,
    /// A controller's tip, or its ray.
    Controller,
    /// A bare hand; selects by pinching.
    Hand,
    /// The gaze, for rays.
    Gaze,
    /// The simulated person of this seed.
    Simulated(u64),
}

impl fmt::Display for Input {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Mouse => f.write_str("mouse"),
            Self::Controller => f.write_str("controller"),
            Self::Hand => f.write_str("hand"),
            Self::Gaze => f.write_str("gaze"),
            Self::Simulated(seed) => write!(f, "simulated:{seed}"),
        }
    }
}

impl FromStr for Input {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        match text {
            "mouse" => Ok(Self::Mouse),
            "controller" => Ok(Self::Controller),
            "hand" => Ok(Self::Hand),
            "gaze" => Ok(Self::Gaze),
            _ => text
                .strip_prefix("simulated:")
                .and_then(|seed| seed.parse().ok())
                .map(Self::Simulated)
                .ok_or_else(|| {
                    Error::Call(format!(
                        "--input: expected mouse, controller, hand, gaze or simulated:SEED (a whole number), found {text:?}"
                    ))
                }),
        }
    }
}
