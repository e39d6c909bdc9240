use nalgebra::{Matrix3, UnitQuaternion, Vector2, Vector3};

use super::low_pass::{LowPass, LowPassCoefficients};
use super::saved::saved;
use super::turn::{headed, level, renormalised, turn, wrapped};
use super::{Clean, Core};

/// Knobs of VQF, with the names and defaults of its authors.
#[derive(Clone, Copy, Debug, PartialEq, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VqfParams {
    /// Time constant of the accelerometer's low-pass, seconds; 0.5 to 30. Default 3.
    pub tau_acc_s: f64,
    /// Time constant of the heading's correction, seconds; 1 to 100. Default 9.
    pub tau_mag_s: f64,
    /// Whether the bias is estimated while the sensor moves. Costs a third of the time of a sample.
    pub motion_bias: bool,
    /// Whether the bias is estimated at rest.
    pub rest_bias: bool,
    /// Whether a disturbed magnetic field is recognised and not followed.
    pub magnetic_rejection: bool,
    /// Standard deviation of the bias at the start, degrees per second. Default 0.5.
    pub bias_sigma_start_deg_s: f64,
    /// Time in which the uncertainty of the bias grows by 0.1 degrees per second, seconds. Default 100.
    pub bias_forgetting_s: f64,
    /// Largest bias, degrees per second; also the largest mean rate that counts as rest. Default 2.
    pub bias_clip_deg_s: f64,
    /// Standard deviation of the bias that motion alone leaves, degrees per second. Default 0.1.
    pub bias_sigma_motion_deg_s: f64,
    /// Weight of the pull to zero of the bias about the vertical, which motion alone does not show. Default 0.0001.
    pub bias_vertical_forgetting: f64,
    /// Standard deviation of the bias that rest leaves, degrees per second. Default 0.03.
    pub bias_sigma_rest_deg_s: f64,
    /// How long it must be still to count as rest, seconds. Default 1.5.
    pub rest_min_s: f64,
    /// Time constant of the low-pass from which deviations are taken, seconds. Default 0.5.
    pub rest_filter_s: f64,
    /// Largest deviation of the rate at rest, degrees per second. Default 2.
    pub rest_gyr_deg_s: f64,
    /// Largest deviation of the specific force at rest, metres per second squared. Default 0.5.
    pub rest_acc_m_s2: f64,
    /// Time constant of the low-pass of norm and dip of the field, seconds. Default 0.05.
    pub mag_current_s: f64,
    /// Time constant with which the reference of norm and dip follows, seconds. Default 20.
    pub mag_reference_s: f64,
    /// Largest deviation of the norm, relative. Default 0.1.
    pub mag_norm_threshold: f64,
    /// Largest deviation of the dip, degrees. Default 10.
    pub mag_dip_threshold_deg: f64,
    /// How long another field must be homogeneous to be accepted, seconds. Default 20.
    pub mag_new_s: f64,
    /// The same for the first field. Default 5.
    pub mag_new_first_s: f64,
    /// Only samples with at least this rate count for acceptance, degrees per second. Default 20.
    pub mag_new_min_gyr_deg_s: f64,
    /// How long the field must be undisturbed to be used again, seconds. Default 0.5.
    pub mag_min_undisturbed_s: f64,
    /// How long a disturbed field is not used at all, seconds. Default 60.
    pub mag_max_rejection_s: f64,
    /// How much slower a disturbed field is followed after that. Default 2.
    pub mag_rejection_factor: f64,
}

impl VqfParams {
    /// All of it: bias estimation and magnetic rejection.
    pub const FULL: Self = Self {
        tau_acc_s: 3.0,
        tau_mag_s: 9.0,
        motion_bias: true,
        rest_bias: true,
        magnetic_rejection: true,
        bias_sigma_start_deg_s: 0.5,
        bias_forgetting_s: 100.0,
        bias_clip_deg_s: 2.0,
        bias_sigma_motion_deg_s: 0.1,
        bias_vertical_forgetting: 0.0001,
        bias_sigma_rest_deg_s: 0.03,
        rest_min_s: 1.5,
        rest_filter_s: 0.5,
        rest_gyr_deg_s: 2.0,
        rest_acc_m_s2: 0.5,
        mag_current_s: 0.05,
        mag_reference_s: 20.0,
        mag_norm_threshold: 0.1,
        mag_dip_threshold_deg: 10.0,
        mag_new_s: 20.0,
        mag_new_first_s: 5.0,
        mag_new_min_gyr_deg_s: 20.0,
        mag_min_undisturbed_s: 0.5,
        mag_max_rejection_s: 60.0,
        mag_rejection_factor: 2.0,
    };

    /// The filter only.
    pub const BASIC: Self =
        Self { motion_bias: false, rest_bias: false, magnetic_rejection: false, ..Self::FULL };
}

impl Default for VqfParams {
    fn default() -> Self {
        Self::FULL
    }
}

/// What follows from the knobs and the period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VqfCoefficients {
    period_s: f64,
    acc: LowPassCoefficients,
    rest: LowPassCoefficients,
    mag: LowPassCoefficients,
    heading_gain: f64,
    reference_gain: f64,
    bias_clip: f64,
    /// (rad/s)², as all variances of the bias.
    bias_p0: f64,
    bias_v: f64,
    bias_motion_w: f64,
    bias_vertical_w: f64,
    bias_rest_w: f64,
    rest_gyr_squared: f64,
    rest_acc_squared: f64,
    dip_threshold: f64,
    new_min_gyr: f64,
}

/// The share of a difference that a first-order low-pass takes over in one period.
pub(crate) fn gain(tau_s: f64, period_s: f64) -> f64 {
    if tau_s > 0.0 { 1.0 - (-period_s / tau_s).exp() } else { 1.0 }
}

impl VqfCoefficients {
    /// For samples every `period_s` seconds.
    pub fn new(params: &VqfParams, period_s: f64) -> Self {
        let square_rad = |deg: f64| deg.to_radians().powi(2);
        // The system noise lets the deviation grow to 0.1 degrees per second in the forgetting time.
        let bias_v = square_rad(0.1) * period_s / params.bias_forgetting_s;
        // The weight with which the filter settles at the given deviation.
        let settling = |deg: f64| square_rad(deg).powi(2) / bias_v + square_rad(deg);
        let bias_motion_w = settling(params.bias_sigma_motion_deg_s);
        Self {
            period_s,
            acc: LowPassCoefficients::new(params.tau_acc_s, period_s),
            rest: LowPassCoefficients::new(params.rest_filter_s, period_s),
            mag: LowPassCoefficients::new(params.mag_current_s, period_s),
            heading_gain: gain(params.tau_mag_s, period_s),
            reference_gain: gain(params.mag_reference_s, period_s),
            bias_clip: params.bias_clip_deg_s.to_radians(),
            bias_p0: square_rad(params.bias_sigma_start_deg_s),
            bias_v,
            bias_motion_w,
            bias_vertical_w: bias_motion_w / params.bias_vertical_forgetting.max(1e-10),
            bias_rest_w: settling(params.bias_sigma_rest_deg_s),
            rest_gyr_squared: square_rad(params.rest_gyr_deg_s),
            rest_acc_squared: params.rest_acc_m_s2.powi(2),
            dip_threshold: params.mag_dip_threshold_deg.to_radians(),
            new_min_gyr: params.mag_new_min_gyr_deg_s.to_radians(),
        }
    }
}

/// All that changes from sample to sample.
#[derive(Clone, Debug, PartialEq)]
pub struct VqfState {
    /// Strapdown integration: an inertial frame that drifts slowly, from the sensor.
    pub(crate) inertial_from_sensor: UnitQuaternion<f64>,
    /// Inclination correction: an earth frame with any heading, from the inertial one.
    pub(crate) level_from_inertial: UnitQuaternion<f64>,
    /// Heading of the levelled frame, radians.
    pub(crate) heading: f64,
    pub(crate) bias: Vector3<f64>,
    pub(crate) bias_p: Matrix3<f64>,
    acc_low: LowPass<3>,
    rotation_low: LowPass<9>,
    bias_low: LowPass<2>,
    rest_gyr_low: LowPass<3>,
    rest_acc_low: LowPass<3>,
    rest_gyr: Vector3<f64>,
    rest_s: f64,
    pub(crate) at_rest: bool,
    mag_low: LowPass<2>,
    pub(crate) mag_reference: Vector2<f64>,
    mag_candidate: Vector2<f64>,
    mag_candidate_s: f64,
    mag_undisturbed_s: f64,
    mag_rejected_s: f64,
    pub(crate) mag_disturbed: bool,
    /// Gain of the fast start of the heading; 0 once it is over.
    heading_start: f64,
}

saved!(VqfState {
    inertial_from_sensor,
    level_from_inertial,
    heading,
    bias,
    bias_p,
    acc_low,
    rotation_low,
    bias_low,
    rest_gyr_low,
    rest_acc_low,
    rest_gyr,
    rest_s,
    at_rest,
    mag_low,
    mag_reference,
    mag_candidate,
    mag_candidate_s,
    mag_undisturbed_s,
    mag_rejected_s,
    mag_disturbed,
    heading_start,
});

/// VQF, the versatile quaternion-based filter of Laidig and Seel (Information Fusion 91, 2023): the accelerometer is
/// low-passed in an almost inertial frame, where the motion's acceleration averages out.
#[derive(Clone, Debug)]
pub struct Vqf {
    params: VqfParams,
    coefficients: VqfCoefficients,
    pub(crate) state: VqfState,
}

impl Vqf {
    /// A filter at its start, for samples every `period_s` seconds.
    pub fn new(params: VqfParams, period_s: f64) -> Self {
        let coefficients = VqfCoefficients::new(&params, period_s);
        let state = VqfState {
            inertial_from_sensor: UnitQuaternion::identity(),
            level_from_inertial: UnitQuaternion::identity(),
            heading: 0.0,
            bias: Vector3::zeros(),
            bias_p: Matrix3::identity() * coefficients.bias_p0,
            acc_low: LowPass::default(),
            rotation_low: LowPass::default(),
            bias_low: LowPass::default(),
            rest_gyr_low: LowPass::default(),
            rest_acc_low: LowPass::default(),
            rest_gyr: Vector3::zeros(),
            rest_s: 0.0,
            at_rest: false,
            mag_low: LowPass::default(),
            mag_reference: Vector2::zeros(),
            mag_candidate: Vector2::zeros(),
            mag_candidate_s: 0.0,
            mag_undisturbed_s: 0.0,
            mag_rejected_s: params.mag_max_rejection_s,
            mag_disturbed: true,
            heading_start: 1.0,
        };
        Self { params, coefficients, state }
    }

    #[inline]
    fn gyr(&mut self, sample: &Clean) {
        let (s, c) = (&mut self.state, &self.coefficients);
        if self.params.rest_bias || self.params.magnetic_rejection {
            s.rest_gyr = s.rest_gyr_low.step(&sample.gyr_rad_s, &c.rest);
            let deviation = (sample.gyr_rad_s - s.rest_gyr).norm_squared();
            if deviation >= c.rest_gyr_squared || s.rest_gyr.amax() > c.bias_clip {
                s.rest_s = 0.0;
                s.at_rest = false;
            }
        }
        let step = turn(&((sample.gyr_rad_s - s.bias) * sample.step_s));
        s.inertial_from_sensor = renormalised(s.inertial_from_sensor.into_inner() * step);
    }

    #[inline]
    fn acc(&mut self, acc: &Vector3<f64>) {
        let (s, c) = (&mut self.state, &self.coefficients);
        if self.params.rest_bias {
            let mean = s.rest_acc_low.step(acc, &c.rest);
            if (acc - mean).norm_squared() >= c.rest_acc_squared {
                s.rest_s = 0.0;
                s.at_rest = false;
            } else {
                s.rest_s += c.period_s;
                s.at_rest = s.rest_s >= self.params.rest_min_s;
            }
        }
        let inertial_from_sensor = s.inertial_from_sensor.to_rotation_matrix();
        let mean = s.acc_low.step(&(inertial_from_sensor * acc), &c.acc);
        let up = s.level_from_inertial * mean;
        let length = up.norm();
        if length < 1e-9 {
            return;
        }
        let up = up / length;
        s.level_from_inertial = renormalised(level(&up) * s.level_from_inertial.into_inner());
        if self.params.motion_bias || self.params.rest_bias {
            let r = s.level_from_inertial.to_rotation_matrix() * inertial_from_sensor;
            self.estimate_bias(r.matrix(), &up);
        }
    }

    #[inline]
    fn estimate_bias(&mut self, r: &Matrix3<f64>, up: &Vector3<f64>) {
        let (s, c) = (&mut self.state, &self.coefficients);
        let bias_in_level = r * s.bias;
        let bias_mean = s.bias_low.step(&bias_in_level.xy(), &c.acc);
        let flat = nalgebra::SVector::<f64, 9>::from_column_slice(r.as_slice());
        let flat = s.rotation_low.step(&flat, &c.acc);
        for i in 0..3 {
            if s.bias_p[(i, i)] < c.bias_p0 {
                s.bias_p[(i, i)] += c.bias_v;
            }
        }
        let (rows, mut error, w) = if s.at_rest && self.params.rest_bias {
            (Matrix3::identity(), s.rest_gyr - s.bias, Vector3::repeat(c.bias_rest_w))
        } else if self.params.motion_bias {
            let mean = Matrix3::from_column_slice(flat.as_slice());
            let expected = mean * s.bias;
            // Rate of the inclination's correction: what the bias has turned the frame by in one period.
            let error = Vector3::new(
                bias_mean.x - up.y / c.period_s - expected.x,
                bias_mean.y + up.x / c.period_s - expected.y,
                -expected.z,
            );
            (mean, error, Vector3::new(c.bias_motion_w, c.bias_motion_w, c.bias_vertical_w))
        } else {
            return;
        };
        error = error.map(|value| value.clamp(-c.bias_clip, c.bias_clip));
        // The three components are independent, so one after the other gives what the inverse of a matrix would.
        let before = s.bias;
        for i in 0..3 {
            let row = rows.row(i).transpose();
            let p_row = s.bias_p * row;
            let gain = p_row / (w[i] + row.dot(&p_row));
            let innovation = error[i] - row.dot(&(s.bias - before));
            s.bias += gain * innovation;
            s.bias_p -= gain * p_row.transpose();
        }
        s.bias = s.bias.map(|value| value.clamp(-c.bias_clip, c.bias_clip));
    }

    #[inline]
    fn mag(&mut self, mag: &Vector3<f64>) {
        let (p, s, c) = (&self.params, &mut self.state, &self.coefficients);
        let field = s.level_from_inertial * (s.inertial_from_sensor * mag);
        if p.magnetic_rejection {
            let norm = field.norm();
            let dip = -(field.z / norm).clamp(-1.0, 1.0).asin();
            let now = s.mag_low.step(&Vector2::new(norm, dip), &c.mag);
            let near = |reference: &Vector2<f64>| {
                (now.x - reference.x).abs() < p.mag_norm_threshold * reference.x
                    && (now.y - reference.y).abs() < c.dip_threshold
            };
            if near(&s.mag_reference) {
                s.mag_undisturbed_s += c.period_s;
                if s.mag_undisturbed_s >= p.mag_min_undisturbed_s {
                    s.mag_disturbed = false;
                    s.mag_reference += (now - s.mag_reference) * c.reference_gain;
                }
            } else {
                s.mag_undisturbed_s = 0.0;
                s.mag_disturbed = true;
            }
            if near(&s.mag_candidate) {
                if s.rest_gyr.norm_squared() >= c.new_min_gyr * c.new_min_gyr {
                    s.mag_candidate_s += c.period_s;
                }
                s.mag_candidate += (now - s.mag_candidate) * c.reference_gain;
                let first = s.mag_reference.x == 0.0 && s.mag_candidate_s >= p.mag_new_first_s;
                if s.mag_disturbed && (first || s.mag_candidate_s >= p.mag_new_s) {
                    s.mag_reference = s.mag_candidate;
                    s.mag_disturbed = false;
                    s.mag_undisturbed_s = p.mag_min_undisturbed_s;
                }
            } else {
                s.mag_candidate_s = 0.0;
                s.mag_candidate = now;
            }
        }
        let disagreement = wrapped(field.x.atan2(field.y) - s.heading);
        let mut k = c.heading_gain;
        if p.magnetic_rejection {
            if !s.mag_disturbed {
                s.mag_rejected_s = (s.mag_rejected_s - p.mag_rejection_factor * c.period_s).max(0.0);
            } else if s.mag_rejected_s <= p.mag_max_rejection_s {
                s.mag_rejected_s += c.period_s;
                k = 0.0;
            } else {
                k /= p.mag_rejection_factor;
            }
        }
        if s.heading_start != 0.0 {
            k = k.max(s.heading_start);
            s.heading_start /= s.heading_start + 1.0;
            if s.heading_start * p.tau_mag_s < c.period_s {
                s.heading_start = 0.0;
            }
        }
        s.heading = wrapped(s.heading + k * disagreement);
    }
}

impl Core for Vqf {
    type State = VqfState;

    #[inline]
    fn step(&mut self, sample: &Clean) {
        self.gyr(sample);
        if let Some(acc) = &sample.acc_m_s2 {
            self.acc(acc);
        }
        if let Some(mag) = &sample.mag_ut {
            self.mag(mag);
        }
    }

    fn lost(&mut self, gap_s: f64) {
        let (s, c) = (&mut self.state, &self.coefficients);
        s.acc_low = LowPass::default();
        s.rotation_low = LowPass::default();
        s.bias_low = LowPass::default();
        s.rest_gyr_low = LowPass::default();
        s.rest_acc_low = LowPass::default();
        s.rest_s = 0.0;
        s.at_rest = false;
        s.mag_low = LowPass::default();
        s.heading_start = 1.0;
        for i in 0..3 {
            s.bias_p[(i, i)] = (s.bias_p[(i, i)] + c.bias_v * gap_s / c.period_s).min(c.bias_p0);
        }
    }

    fn earth_from_sensor(&self) -> UnitQuaternion<f64> {
        let s = &self.state;
        headed(s.heading, &(s.level_from_inertial * s.inertial_from_sensor))
    }

    fn gyro_bias_rad_s(&self) -> Vector3<f64> {
        self.state.bias
    }

    fn state(&self) -> &VqfState {
        &self.state
    }

    fn set_state(&mut self, state: VqfState) {
        self.state = state;
    }
}
