//! The file of knobs of odometry.

use std::path::Path;

use vergence_slam::Params;
use vergence_slam::dataset::{MOST_APART, Opening};
use vergence_time::Span;
use vergence_vision::TrackerKnobs;

use crate::failure::Failure;

/// A file of knobs.
#[derive(Clone, Debug, Default, serde::Deserialize, serde::Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Pictures are made smaller by this whole number first; pixels below are those of the smaller pictures.
    pub reduce: Option<usize>,
    /// Side of the cells that hold a point each, pixels.
    pub cell_px: Option<usize>,
    /// Points in a cell; cost and accuracy grow with it.
    pub per_cell: Option<usize>,
    /// Levels of the pyramids.
    pub levels: Option<usize>,
    /// Side of the patches, pixels.
    pub window_px: Option<usize>,
    /// FAST's threshold, grey levels.
    pub threshold: Option<u8>,
    /// Standard deviation of a tracked corner, pixels.
    pub pixel_px: Option<f64>,
    /// Factor on the inertial unit's noise.
    pub noise_factor: Option<f64>,
    /// Latest frames that are kept whole.
    pub states: Option<usize>,
    /// Keyframes.
    pub keyframes: Option<usize>,
    /// Steps of the minimisation per frame.
    pub iterations: Option<usize>,
    /// Share of known points below which a frame becomes a keyframe.
    pub known_share: Option<f64>,
    /// Time between two keyframes at least, s.
    pub keyframe_gap_s: Option<f64>,
    /// Frames that are all kept at the start.
    pub first_frames: Option<usize>,
    /// Most points that take part.
    pub points: Option<usize>,
    /// Residual at which a corner's weight begins to fall, standard deviations.
    pub huber: Option<f64>,
    /// Residual beyond which a sighting is thrown away, pixels.
    pub outlier_px: Option<f64>,
    /// Standard deviation of depth, as a share of its square, 1/m.
    pub depth_inverse_m: Option<f64>,
    /// Strength of gravity, m/s².
    pub gravity_m_s2: Option<f64>,
    /// Readings at or beyond this rate are saturated, rad/s.
    pub gyr_range_rad_s: Option<f64>,
    /// Whether cameras that are turned against what they see end the run.
    pub check_mounting: Option<bool>,
    /// Pictures of different cameras that are not farther apart are of one instant, ms.
    pub pair_within_ms: Option<f64>,
}

impl Config {
    pub fn read(path: &Path) -> Result<Self, Failure> {
        let text = std::fs::read_to_string(path)
            .map_err(|error| Failure::Call(format!("{}: {error}", path.display())))?;
        toml::from_str(&text).map_err(|error| Failure::Call(format!("{}: {error}", path.display())))
    }

    /// The keys of the file with their defaults, as they would stand there.
    pub fn help() -> String {
        let (tracker, params) = (TrackerKnobs::default(), Params::default());
        let lines = [
            (
                "reduce",
                "1".to_owned(),
                "pictures are made smaller by it first, 1 to 8; pixels below are of the smaller ones",
            ),
            (
                "cell_px",
                tracker.cell_px.to_string(),
                "side of the cells that hold points; small: more points, more time",
            ),
            ("per_cell", tracker.per_cell.to_string(), "points in a cell"),
            ("levels", tracker.flow.levels.to_string(), "of the pyramids; few: fast motion is lost"),
            ("window_px", tracker.flow.window_px.to_string(), "side of the patches"),
            ("threshold", tracker.threshold.to_string(), "of FAST, grey levels"),
            ("pixel_px", params.pixel_px.to_string(), "standard deviation of a tracked corner"),
            ("huber", params.huber.to_string(), "residual at which a corner's weight falls, deviations"),
            ("outlier_px", params.outlier_px.to_string(), "residual beyond which a sighting is thrown away"),
            ("noise_factor", params.noise_factor.to_string(), "on the inertial unit's noise"),
            ("gyr_range_rad_s", "17.45".to_owned(), "readings at or beyond it are saturated"),
            ("gravity_m_s2", params.gravity_m_s2.to_string(), "strength of gravity"),
            (
                "depth_inverse_m",
                params.depth_inverse_m.to_string(),
                "deviation of depth, a share of its square",
            ),
            ("states", params.states.to_string(), "latest frames that are kept whole"),
            ("keyframes", params.keyframes.to_string(), "drift falls with it, time grows with its square"),
            ("keyframe_gap_s", params.keyframe_gap_s.to_string(), "time between two keyframes at least"),
            (
                "known_share",
                params.known_share.to_string(),
                "of known points below which a frame becomes one",
            ),
            (
                "first_frames",
                params.first_frames.to_string(),
                "all kept at the start, until gravity is known",
            ),
            ("points", params.points.to_string(), "most that take part"),
            ("iterations", params.iterations.to_string(), "steps of the minimisation per frame"),
            (
                "check_mounting",
                params.check_mounting.to_string(),
                "false: cameras that seem turned do not end the run",
            ),
            (
                "pair_within_ms",
                Opening::default().pair_within.as_millis_f64().to_string(),
                "pictures of two cameras that are no farther apart are of one instant, 0 to 100",
            ),
        ];
        let lines = lines.map(|(key, value, what)| format!("  {:24} # {what}\n", format!("{key} = {value}")));
        format!(
            "F.toml, with its defaults (`trade slam` measures what they cost and bring):\n{}",
            lines.concat()
        )
    }

    /// What the file says of the inertial unit itself.
    pub fn apply(&self, unit: Option<&mut vergence_slam::Inertial>) {
        if let Some((unit, range)) = unit.zip(self.gyr_range_rad_s) {
            unit.gyr_range_rad_s = range;
        }
    }

    /// Pictures that are no farther apart are of one instant.
    pub fn pair_within(&self) -> Result<Span, Failure> {
        let Some(millis) = self.pair_within_ms else { return Ok(Opening::default().pair_within) };
        let span = Span::from_secs_f64(millis * 1e-3).filter(|span| (Span::ZERO..=MOST_APART).contains(span));
        span.ok_or_else(|| Failure::Call(format!("pair_within_ms: expected 0 to 100, found {millis}")))
    }

    /// The tracker's and the estimator's knobs.
    pub fn resolve(&self) -> Result<(TrackerKnobs, Params), Failure> {
        let (mut knobs, mut params) = (TrackerKnobs::default(), Params::default());
        let set = |into: &mut usize, value: Option<usize>| *into = value.unwrap_or(*into);
        set(&mut knobs.cell_px, self.cell_px);
        set(&mut knobs.per_cell, self.per_cell);
        set(&mut knobs.flow.levels, self.levels);
        set(&mut knobs.flow.window_px, self.window_px);
        knobs.threshold = self.threshold.unwrap_or(knobs.threshold);
        knobs.least_threshold = knobs.least_threshold.min(knobs.threshold);
        set(&mut params.states, self.states);
        set(&mut params.keyframes, self.keyframes);
        set(&mut params.iterations, self.iterations);
        params.pixel_px = self.pixel_px.unwrap_or(params.pixel_px);
        params.noise_factor = self.noise_factor.unwrap_or(params.noise_factor);
        params.known_share = self.known_share.unwrap_or(params.known_share);
        params.keyframe_gap_s = self.keyframe_gap_s.unwrap_or(params.keyframe_gap_s);
        set(&mut params.first_frames, self.first_frames);
        set(&mut params.points, self.points);
        params.huber = self.huber.unwrap_or(params.huber);
        params.outlier_px = self.outlier_px.unwrap_or(params.outlier_px);
        params.depth_inverse_m = self.depth_inverse_m.unwrap_or(params.depth_inverse_m);
        params.gravity_m_s2 = self.gravity_m_s2.unwrap_or(params.gravity_m_s2);
        params.check_mounting = self.check_mounting.unwrap_or(params.check_mounting);
        params.checked().map_err(|error| Failure::call(&error))?;
        Ok((knobs, params))
    }
}
