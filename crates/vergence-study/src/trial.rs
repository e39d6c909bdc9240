//! The trial model: what every importer fills and every measure reads.

use std::collections::BTreeMap;

/// A place, in the data set's length unit; 1D tasks use x only, 2D tasks x and y.
pub type Point = [f64; 3];

/// Where the cursor was at one time.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct CursorSample {
    /// Seconds since the trial began; any rate, in order of time.
    pub t_s: f64,
    /// Where.
    pub position: Point,
}

/// One movement to one target.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Trial {
    /// Pseudonym.
    pub participant: String,
    /// One sitting; with `block` and `condition` it names a sequence.
    pub session: String,
    /// Block within the session.
    pub block: String,
    /// The condition's name, such as `A1024-W96`.
    pub condition: String,
    /// The speed-accuracy instruction, where there were several.
    pub instruction: Option<String>,
    /// Levels of the design's other factors, by name.
    #[serde(default)]
    pub factors: BTreeMap<String, String>,
    /// Place in its sequence, from 0.
    pub index: u32,
    /// Not analysed: made to get used to the task.
    pub practice: bool,
    /// How often its sequence had been made before.
    #[serde(default)]
    pub attempt: u32,
    /// Not analysed: its sequence was made again, for too many misses.
    #[serde(default)]
    pub repeated: bool,
    /// Nominal distance between the targets, in the data set's length unit.
    pub amplitude: Option<f64>,
    /// Nominal width of the target along the axis; none where it is unbounded (an edge of the screen).
    pub width: Option<f64>,
    /// Centre of the target that the movement comes from.
    pub from: Option<Point>,
    /// Centre of the target.
    pub to: Point,
    /// Where the movement began.
    pub start: Option<Point>,
    /// Where the selection was made.
    pub end: Point,
    /// Movement time, seconds.
    pub mt_s: f64,
    /// The target was missed; none where neither the recording nor the target's width says.
    pub error: Option<bool>,
    /// The path, where it was recorded.
    #[serde(default)]
    pub samples: Vec<CursorSample>,
    /// What the recording tool measured of the path, where the path itself is not there.
    pub measured: Option<PathMeasures>,
    /// The recording tool's own flags.
    #[serde(default)]
    pub spatial_outlier: Option<bool>,
    /// Outside of the time band of a metronome.
    #[serde(default)]
    pub temporal_outlier: Option<bool>,
}

impl Trial {
    /// Whether it is one of those that are analysed, as far as outlier policies let it.
    pub fn counts(&self) -> bool {
        !self.practice && !self.repeated
    }
}

/// Measures of a path (MacKenzie, Kauppinen and Silfverberg 2001) and its submovements. Lengths in the data set's unit.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PathMeasures {
    /// Target re-entries: entries after the first.
    pub tre: Option<f64>,
    /// Task axis crossings.
    pub tac: Option<f64>,
    /// Movement direction changes: turns of the coordinate across the axis.
    pub mdc: Option<f64>,
    /// Orthogonal direction changes: turns of the coordinate along the axis.
    pub odc: Option<f64>,
    /// Movement variability: standard deviation (n − 1) of the distance from the axis.
    pub mv: Option<f64>,
    /// Movement error: mean absolute distance from the axis.
    pub me: Option<f64>,
    /// Movement offset: mean signed distance from the axis; its sign depends on the axis' direction.
    pub mo: Option<f64>,
    /// Peaks of the smoothed speed.
    pub submovements: Option<f64>,
    /// Times that the far side of the target was passed.
    pub overshoots: Option<f64>,
}

impl PathMeasures {
    /// The measures' names, as they head columns, in the order of [`PathMeasures::values`].
    pub const NAMES: [&'static str; 9] =
        ["tre", "tac", "mdc", "odc", "mv", "me", "mo", "submovements", "overshoots"];

    /// In the order of [`PathMeasures::NAMES`].
    pub fn values(&self) -> [Option<f64>; 9] {
        let Self { tre, tac, mdc, odc, mv, me, mo, submovements, overshoots } = *self;
        [tre, tac, mdc, odc, mv, me, mo, submovements, overshoots]
    }

    /// The inverse of [`PathMeasures::values`].
    pub fn from_values(values: [Option<f64>; 9]) -> Self {
        let [tre, tac, mdc, odc, mv, me, mo, submovements, overshoots] = values;
        Self { tre, tac, mdc, odc, mv, me, mo, submovements, overshoots }
    }
}

/// Trials that belong together, with what is known of all of them.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct DataSet {
    /// The unit of every length: `m`, `px`, `mm`, `rad`.
    pub length_unit: String,
    /// 1, 2 or 3.
    pub dimensions: usize,
    /// In the order of recording.
    pub trials: Vec<Trial>,
}
