use crate::filter::low_pass::LowPassCoefficients;

/// Knobs of `vergence`. Costs are those of one sample and are all alike: the knobs are numbers, not steps.
#[derive(Clone, Copy, Debug, PartialEq, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VergenceParams {
    /// How far readings lag behind the motion (low-pass in the sensor, transport), seconds; 0 to 0.02. The orientation given
    /// is turned on by as much. Wrong by 1 ms: 0.3° at 300°/s. A property of the unit that its samples do not tell
    /// ([`Unit`](crate::Unit)). Default 0.
    pub latency_s: f64,
    /// How much of its step a rate is the mean of; 0 (what the sensor says at the end of the step) to 1 (all of it). What is not,
    /// is half of the step ahead; of steps longer than 10 ms no more than 5 ms: who gives less than 100 Hz averages. Default 1.
    pub gyr_averaged: f64,
    /// How much later the accelerometer reads than the gyroscope, seconds; −0.01 to 0.01. Default 0.
    pub acc_lag_s: f64,
    /// How much later the magnetometer reads than the gyroscope, seconds; −0.02 to 0.02. Default 0.
    pub mag_lag_s: f64,
    /// Time constant of the accelerometer's low-pass in the inertial frame, seconds; 1 to 10. Small: acceleration of the
    /// sensor tilts the estimate. Large: gyroscope errors do. Default 3.
    pub tau_acc_s: f64,
    /// Window over which observations are gathered before the calibration is corrected, seconds; 0.02 to 0.5. Small: costs
    /// more. Large: reacts late. Default 0.1.
    pub window_s: f64,
    /// Standard deviation of the bias at the start, degrees per second; 0.05 to 5. Default 1.
    pub bias_sigma_deg_s: f64,
    /// Largest bias, degrees per second; also the largest mean rate that counts as rest. A unit that rests before it ever
    /// does anything else may have up to 20, once it has rested for three seconds. Default 2.
    pub bias_limit_deg_s: f64,
    /// How much the bias wanders within 100 s, degrees per second; 0.005 to 0.2. Default 0.08.
    pub bias_wander_deg_s: f64,
    /// Standard deviation of the gyroscope's scale and cross-axis factors at the start; 0 to 0.03 (0: not estimated). One for
    /// all nine, so that the frame of the sensor does not matter. Default 0.006.
    pub factor_sigma: f64,
    /// How much is doubted of what was learned about these factors: of their square `s` with variance `v` the share
    /// `s / (s + doubt v)` of the factors is applied; 0 to 2. Large: a good gyroscope is left alone, a bad one corrected late.
    /// Default 0.25.
    pub factor_doubt: f64,
    /// Noise of the rate seen in the tilt's correction in motion, degrees per second over one second; 0.1 to 3. Small: learns
    /// fast and follows acceleration. Default 0.35.
    pub tilt_noise_deg_s: f64,
    /// The same before there was a rest; 0.3 to 3. Small: what levelling from motion takes is believed to be bias. Default 1.5.
    pub tilt_noise_before_rest_deg_s: f64,
    /// The most that one window's deviation counts for, degrees per second; 0.3 to 10. Default 1.
    pub tilt_outlier_deg_s: f64,
    /// How much the variance of that noise grows with the square of the horizontal acceleration, s⁴/m²; 0 to 1. Default 0.006.
    pub tilt_noise_per_acc: f64,
    /// Noise of the mean rate at rest, degrees per second over one second, beside what it is seen to scatter by; 0.001 to 0.1.
    /// Default 0.01.
    pub rest_noise_deg_s: f64,
    /// How long it must be still to count as rest, seconds. Default 1.5.
    pub rest_min_s: f64,
    /// Largest deviation of a window's mean rate from that of the last half second at rest, degrees per second. Default 1.
    pub rest_gyr_deg_s: f64,
    /// The same of the specific force, metres per second squared. Default 0.2.
    pub rest_acc_m_s2: f64,
    /// Longest time for which the start goes on without a rest, seconds; 6 to 60: gravity, bias and field are looked for together.
    /// Default 20.
    pub start_s: f64,
    /// Strength of the acceleration in motion that the start supposes, each axis, metres per second squared; 1 to 10. Small: a bias
    /// is believed earlier. Default 6.
    pub start_acc_m_s2: f64,
    /// Angular frequency that most of that acceleration is supposed to have, radians per second; 4 to 12. Default 8.
    pub start_pulse_rad_s: f64,
    /// Standard deviation of the magnetometer's offset at the start, microteslas; 0.2 to 10. Large: learns an offset that was
    /// there from the start fast, and takes an uneven field for one. Default 0.8.
    pub offset_sigma_ut: f64,
    /// Unevenness of the field, microteslas over one second of motion; 1 to 20. Large: the heading follows the gyroscope
    /// longer. Default 6.
    pub field_noise_ut: f64,
    /// Deviation beyond which a reading loses weight, microteslas; 1 to 10. Default 2.5.
    pub field_outlier_ut: f64,
    /// Mean rate at which readings count half of what they do in fast motion, degrees per second: the unevenness is the same
    /// all the time where nothing moves. Default 60.
    pub field_motion_deg_s: f64,
    /// Deviation that stays with the sensor beyond which a magnet was attached or removed, microteslas. Default 2.5.
    pub jump_ut: f64,
    /// How fast an attached magnet is learned: variance per second gained by the offset, relative to the square of the
    /// deviation; 0.1 to 20. Default 5.
    pub jump_offset: f64,
    /// The same for the field itself while it has not been confirmed by turning; 0 to 3. Large: recovers from a disturbed
    /// start, and is misled by a magnet in the room. Default 0.3.
    pub jump_field: f64,
}

impl Default for VergenceParams {
    fn default() -> Self {
        Self {
            latency_s: 0.0,
            gyr_averaged: 1.0,
            acc_lag_s: 0.0,
            mag_lag_s: 0.0,
            tau_acc_s: 3.0,
            window_s: 0.1,
            bias_sigma_deg_s: 1.0,
            bias_limit_deg_s: 2.0,
            bias_wander_deg_s: 0.08,
            factor_sigma: 0.006,
            factor_doubt: 0.25,
            tilt_noise_deg_s: 0.35,
            tilt_noise_before_rest_deg_s: 1.5,
            tilt_outlier_deg_s: 1.0,
            tilt_noise_per_acc: 0.006,
            rest_noise_deg_s: 0.01,
            rest_min_s: 1.5,
            rest_gyr_deg_s: 1.0,
            rest_acc_m_s2: 0.2,
            start_s: 20.0,
            start_acc_m_s2: 6.0,
            start_pulse_rad_s: 8.0,
            offset_sigma_ut: 0.8,
            field_noise_ut: 6.0,
            field_outlier_ut: 2.5,
            field_motion_deg_s: 60.0,
            jump_ut: 2.5,
            jump_offset: 5.0,
            jump_field: 0.3,
        }
    }
}

/// The longest step that a rate of an instant may stand for, seconds.
const LONGEST_INSTANT_S: f64 = 0.01;

impl VergenceParams {
    /// From the orientation that the steps end with to now, seconds: a step is turned by the newest rate, half a period ahead of the
    /// mean of its two ends.
    fn ahead_s(&self, period_s: f64) -> f64 {
        self.latency_s - 0.5 * (1.0 - self.gyr_averaged) * period_s.min(LONGEST_INSTANT_S)
    }

    /// The same unit seen backwards in time: a reading that lags is ahead, and a step is turned by the reading at its other end.
    pub(crate) fn mirrored(&self, period_s: f64) -> Self {
        Self {
            latency_s: -self.ahead_s(period_s) - period_s,
            gyr_averaged: 1.0,
            acc_lag_s: -self.acc_lag_s,
            mag_lag_s: -self.mag_lag_s,
            ..*self
        }
    }
}

/// Window of the start, seconds: short against the motion, longer than vibration.
const START_WINDOW_S: f64 = 0.015;

/// Time constant of the means that rest is told by, seconds.
const REST_TAU_S: f64 = 0.5;

/// What follows from the knobs and the period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VergenceCoefficients {
    pub(super) period_s: f64,
    /// From the middle of a sample's step to now.
    pub(super) ahead_s: f64,
    /// From the orientation to the reading that belongs to it.
    pub(super) acc_lag_s: f64,
    pub(super) mag_lag_s: f64,
    /// Samples per window.
    pub(super) window: f64,
    pub(super) window_s: f64,
    pub(super) acc: LowPassCoefficients,
    /// What one window adds to the means that rest is told by.
    pub(super) rest_share: f64,
    pub(super) windows: LowPassCoefficients,
    pub(super) rest_gyr_squared: f64,
    pub(super) rest_acc_squared: f64,
    /// (rad/s)², as all variances of the bias.
    pub(super) bias_p: f64,
    pub(super) bias_limit: f64,
    pub(super) bias_wander: f64,
    pub(super) tilt_r: f64,
    pub(super) tilt_r_before_rest: f64,
    pub(super) tilt_most: f64,
    pub(super) start_window_s: f64,
    /// What noise of the rate adds to the variance of up in the start, per second.
    pub(super) start_q: f64,
    pub(super) rest_r: f64,
    pub(super) field_r: f64,
    pub(super) outlier_squared: f64,
    pub(super) motion: f64,
    pub(super) jump_squared: f64,
}

impl VergenceCoefficients {
    /// For samples every `period_s` seconds.
    pub fn new(params: &VergenceParams, period_s: f64) -> Self {
        let square_rad = |deg: f64| deg.to_radians().powi(2);
        let window = (params.window_s / period_s).round().max(1.0);
        let window_s = window * period_s;
        Self {
            period_s,
            ahead_s: params.ahead_s(period_s),
            acc_lag_s: params.acc_lag_s + 0.5 * period_s,
            mag_lag_s: params.mag_lag_s + 0.5 * period_s,
            window,
            window_s,
            acc: LowPassCoefficients::new(params.tau_acc_s, period_s),
            rest_share: 1.0 - (-window_s / REST_TAU_S).exp(),
            windows: LowPassCoefficients::new(params.tau_acc_s, window_s),
            rest_gyr_squared: square_rad(params.rest_gyr_deg_s),
            rest_acc_squared: params.rest_acc_m_s2.powi(2),
            bias_p: square_rad(params.bias_sigma_deg_s),
            bias_limit: params.bias_limit_deg_s.to_radians(),
            bias_wander: square_rad(params.bias_wander_deg_s) / 100.0 * window_s,
            tilt_r: square_rad(params.tilt_noise_deg_s) / window_s,
            tilt_r_before_rest: square_rad(params.tilt_noise_before_rest_deg_s) / window_s,
            tilt_most: params.tilt_outlier_deg_s.to_radians(),
            // Less than a whole window by rounding is one.
            start_window_s: (START_WINDOW_S - 0.5 * period_s).max(0.5 * period_s),
            start_q: square_rad(params.tilt_noise_deg_s),
            rest_r: square_rad(params.rest_noise_deg_s) / window_s,
            field_r: params.field_noise_ut.powi(2) / window_s,
            outlier_squared: params.field_outlier_ut.powi(2),
            motion: params.field_motion_deg_s.to_radians(),
            jump_squared: params.jump_ut.powi(2),
        }
    }
}
