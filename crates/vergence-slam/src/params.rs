//! The knobs of odometry.

use nalgebra::Vector3;
use vergence_inertial::preintegrate::NoiseDensities;

use crate::Error;

/// What the inertial unit is taken to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inertial {
    /// White noise, as its data sheet or an Allan deviation says.
    pub noise: NoiseDensities,
    /// Random walk of the gyroscope's bias, rad/s/√s.
    pub gyr_walk: f64,
    /// Random walk of the accelerometer's bias, m/s²/√s.
    pub acc_walk: f64,
    /// Readings at or beyond this rate (rad/s) are held to be saturated: their noise is taken a hundredfold.
    pub gyr_range_rad_s: f64,
}

impl Inertial {
    /// The unit of the EuRoC recordings (ADIS16448), as their calibration says.
    pub const EUROC: Self = Self {
        noise: NoiseDensities { gyr_rad_s_rthz: 1.6968e-4, acc_m_s2_rthz: 2e-3 },
        gyr_walk: 1.9393e-5,
        acc_walk: 3e-3,
        // ±1000 degrees/s.
        gyr_range_rad_s: 17.45,
    };
}

/// Knobs; each default is what the half-real flights are measured with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// The inertial unit; `None`: images alone.
    pub inertial: Option<Inertial>,
    /// Factor on the white noise of the unit, 1..20: vibration, saturation and time stamps make it worse than its sheet. Too
    /// small: the images are not believed; too large: gravity is found late. 4.
    pub noise_factor: f64,
    /// Strength of gravity, m/s²; 9.80665.
    pub gravity_m_s2: f64,
    /// Standard deviation of a tracked corner, pixels; 0.5.
    pub pixel_px: f64,
    /// Residual at which a corner's weight begins to fall (Huber), in standard deviations; 2.
    pub huber: f64,
    /// Residual beyond which a sighting is thrown away after a solution, pixels; 3.
    pub outlier_px: f64,
    /// Standard deviation of a depth reading, as a share of its square in 1/m (0.003: 3 mm at 1 m, 27 mm at 3 m).
    pub depth_inverse_m: f64,
    /// Latest frames that are kept with velocity and biases; 3. Cost grows with it.
    pub states: usize,
    /// Keyframes; 7. Cost grows with its square, drift falls with it.
    pub keyframes: usize,
    /// Steps of the minimisation for each frame at most; 4.
    pub iterations: usize,
    /// A frame becomes a keyframe where less than this share of its tracks are known points; 0.7.
    pub known_share: f64,
    /// Time between two keyframes at least, s; 0.125 (every third frame of 20 Hz).
    pub keyframe_gap_s: f64,
    /// Frames that are all kept at the start, until gravity is known; 12. Each is one of the unknowns, so their number counts, not their time.
    pub first_frames: usize,
    /// Most points that take part; 400.
    pub points: usize,
    /// Whether the cameras' places on the body are held against what is seen and felt, and a misfit ends the run; true. It costs about a
    /// millisecond a frame while it looks, in the first seconds.
    pub check_mounting: bool,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            inertial: Some(Inertial::EUROC),
            noise_factor: 4.0,
            gravity_m_s2: 9.80665,
            pixel_px: 0.5,
            huber: 2.0,
            outlier_px: 3.0,
            depth_inverse_m: 0.003,
            states: 3,
            keyframes: 7,
            iterations: 4,
            known_share: 0.7,
            keyframe_gap_s: 0.125,
            first_frames: 12,
            points: 400,
            check_mounting: true,
        }
    }
}

impl Params {
    /// These, where each is in its range.
    ///
    /// # Errors
    /// The first knob outside of its range.
    pub fn checked(&self) -> Result<Self, Error> {
        let check = |fine: bool, name, expected, found: f64| {
            if fine { Ok(()) } else { Err(Error::Knob { name, expected, found }) }
        };
        let within = |x: f64, low: f64, high: f64| (low..=high).contains(&x);
        check(within(self.noise_factor, 1.0, 100.0), "noise_factor", "1 to 100", self.noise_factor)?;
        check(within(self.gravity_m_s2, 0.1, 30.0), "gravity_m_s2", "0.1 to 30", self.gravity_m_s2)?;
        check(within(self.pixel_px, 0.01, 10.0), "pixel_px", "0.01 to 10", self.pixel_px)?;
        check(within(self.huber, 0.5, 100.0), "huber", "0.5 to 100", self.huber)?;
        check(within(self.outlier_px, 0.5, 100.0), "outlier_px", "0.5 to 100", self.outlier_px)?;
        check(within(self.keyframe_gap_s, 0.0, 10.0), "keyframe_gap_s", "0 to 10", self.keyframe_gap_s)?;
        check(within(self.known_share, 0.0, 1.0), "known_share", "0 to 1", self.known_share)?;
        check(within(self.depth_inverse_m, 1e-5, 1.0), "depth_inverse_m", "1e-5 to 1", self.depth_inverse_m)?;
        if let Some(unit) = &self.inertial {
            let noises = [
                unit.noise.gyr_rad_s_rthz,
                unit.noise.acc_m_s2_rthz,
                unit.gyr_walk,
                unit.acc_walk,
                unit.gyr_range_rad_s,
            ];
            let wrong = noises.into_iter().find(|noise| !(*noise > 0.0 && *noise < 1e6));
            check(wrong.is_none(), "inertial", "noise and range above 0", wrong.unwrap_or_default())?;
        }
        let counts = [
            (self.states, 2, 20, "states", "2 to 20"),
            (self.keyframes, 2, 30, "keyframes", "2 to 30"),
            (self.iterations, 1, 50, "iterations", "1 to 50"),
            (self.first_frames, 3, 60, "first_frames", "3 to 60"),
            (self.points, 10, 5000, "points", "10 to 5000"),
        ];
        for (value, low, high, name, expected) in counts {
            check((low..=high).contains(&value), name, expected, value as f64)?;
        }
        Ok(*self)
    }

    /// Acceleration of free fall in the world (y up).
    pub fn gravity(&self) -> Vector3<f64> {
        Vector3::new(0.0, -self.gravity_m_s2, 0.0)
    }
}
