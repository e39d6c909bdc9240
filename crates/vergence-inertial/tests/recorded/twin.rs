//! VQF as one reads it in the paper: every step spelled out with rotation matrices, no coefficient worked out ahead, matrices
//! inverted where the mathematics says so. Slow, and the measure of the fast one.

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use vergence_inertial::filter::VqfParams;

/// A Butterworth low-pass that takes the mean of what it saw until `tau` has passed.
struct LowPass {
    tau: f64,
    ts: f64,
    seen: Vec<f64>,
    /// The last two inputs and outputs, once it runs.
    memory: Option<[f64; 4]>,
}

impl LowPass {
    fn new(tau: f64, ts: f64) -> Self {
        Self { tau, ts, seen: Vec::new(), memory: None }
    }

    fn step(&mut self, x: f64) -> f64 {
        let Some([x1, x2, y1, y2]) = self.memory else {
            self.seen.push(x);
            let mean = self.seen.iter().sum::<f64>() / self.seen.len() as f64;
            if self.seen.len() as f64 * self.ts >= self.tau {
                self.memory = Some([mean; 4]);
            }
            return mean;
        };
        // The analogue filter 1 / (s² + √2 s + 1), s = (1 − z⁻¹) / (c (1 + z⁻¹)).
        let cutoff = 2f64.sqrt() / (2.0 * std::f64::consts::PI * self.tau);
        let c = (std::f64::consts::PI * cutoff * self.ts).tan();
        let root = 2f64.sqrt();
        let right = c * c * (x + 2.0 * x1 + x2) - (2.0 * c * c - 2.0) * y1 - (1.0 - root * c + c * c) * y2;
        let y = right / (1.0 + root * c + c * c);
        self.memory = Some([x, x1, y, y1]);
        y
    }
}

fn low<const N: usize>(tau: f64, ts: f64) -> [LowPass; N] {
    std::array::from_fn(|_| LowPass::new(tau, ts))
}

fn each<const N: usize>(filters: &mut [LowPass; N], x: impl Fn(usize) -> f64) -> [f64; N] {
    std::array::from_fn(|i| filters[i].step(x(i)))
}

pub struct Twin {
    p: VqfParams,
    ts: f64,
    gyr_quat: UnitQuaternion<f64>,
    acc_quat: UnitQuaternion<f64>,
    delta: f64,
    bias: Vector3<f64>,
    /// In (0.01 °/s)², as the paper has it.
    cov: Matrix3<f64>,
    acc_low: [LowPass; 3],
    r_low: [LowPass; 9],
    bias_low: [LowPass; 2],
    rest_gyr_low: [LowPass; 3],
    rest_acc_low: [LowPass; 3],
    rest_gyr: Vector3<f64>,
    rest_t: f64,
    mag_low: [LowPass; 2],
    reference: (f64, f64),
    candidate: (f64, f64),
    candidate_t: f64,
    undisturbed_t: f64,
    rejected_t: f64,
    disturbed: bool,
    samples_of_heading: f64,
    heading_started: bool,
}

fn gain(tau: f64, ts: f64) -> f64 {
    1.0 - (-ts / tau).exp()
}

impl Twin {
    pub fn new(p: VqfParams, ts: f64) -> Self {
        Self {
            p,
            ts,
            gyr_quat: UnitQuaternion::identity(),
            acc_quat: UnitQuaternion::identity(),
            delta: 0.0,
            bias: Vector3::zeros(),
            cov: Matrix3::identity() * (100.0 * p.bias_sigma_start_deg_s).powi(2),
            acc_low: low(p.tau_acc_s, ts),
            r_low: low(p.tau_acc_s, ts),
            bias_low: low(p.tau_acc_s, ts),
            rest_gyr_low: low(p.rest_filter_s, ts),
            rest_acc_low: low(p.rest_filter_s, ts),
            rest_gyr: Vector3::zeros(),
            rest_t: 0.0,
            mag_low: low(p.mag_current_s, ts),
            reference: (0.0, 0.0),
            candidate: (0.0, 0.0),
            candidate_t: 0.0,
            undisturbed_t: 0.0,
            rejected_t: p.mag_max_rejection_s,
            disturbed: true,
            samples_of_heading: 0.0,
            heading_started: false,
        }
    }

    pub fn orientation(&self) -> UnitQuaternion<f64> {
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.delta) * self.acc_quat * self.gyr_quat
    }

    pub fn step(&mut self, gyr: &Vector3<f64>, acc: &Vector3<f64>, mag: Option<&Vector3<f64>>) {
        let (p, ts) = (self.p, self.ts);
        let clip = p.bias_clip_deg_s.to_radians();

        // Rest: the low-passed readings, and how far the readings are from them.
        self.rest_gyr = Vector3::from(each(&mut self.rest_gyr_low, |i| gyr[i]));
        let rest_acc = Vector3::from(each(&mut self.rest_acc_low, |i| acc[i]));
        let turns =
            (gyr - self.rest_gyr).norm() >= p.rest_gyr_deg_s.to_radians() || self.rest_gyr.amax() > clip;
        if turns {
            self.rest_t = 0.0;
        }
        // The accelerometer comes after the gyroscope and counts its own sample, as in the original.
        self.rest_t = if (acc - rest_acc).norm() < p.rest_acc_m_s2 { self.rest_t + ts } else { 0.0 };
        let at_rest = self.rest_t >= p.rest_min_s;

        // Strapdown integration.
        self.gyr_quat *= UnitQuaternion::new((gyr - self.bias) * ts);

        // Inclination: the specific force, low-passed in the inertial frame, is taken up.
        let inertial = self.gyr_quat * acc;
        let mean = Vector3::from(each(&mut self.acc_low, |i| inertial[i]));
        let up = (self.acc_quat * mean).normalize();
        let w = ((up.z + 1.0) / 2.0).sqrt();
        let correction = Quaternion::new(w, 0.5 * up.y / w, -0.5 * up.x / w, 0.0);
        self.acc_quat = UnitQuaternion::new_normalize(correction * self.acc_quat.into_inner());

        if p.motion_bias || p.rest_bias {
            self.estimate_bias(&up, at_rest);
        }
        if let Some(mag) = mag {
            self.correct_heading(mag);
        }
    }

    fn estimate_bias(&mut self, up: &Vector3<f64>, at_rest: bool) {
        let (p, ts) = (self.p, self.ts);
        let r = (self.acc_quat * self.gyr_quat).to_rotation_matrix().into_inner();
        let now = r * self.bias;
        let bias_mean = each(&mut self.bias_low, |i| now[i]);
        let r_mean = Matrix3::from_column_slice(&each(&mut self.r_low, |i| r.as_slice()[i]));
        let v = (0.1f64 * 100.0).powi(2) * ts / p.bias_forgetting_s;
        let settle = |sigma: f64| (sigma * 100.0).powi(4) / v + (sigma * 100.0).powi(2);
        for i in 0..3 {
            if self.cov[(i, i)] < (100.0 * p.bias_sigma_start_deg_s).powi(2) {
                self.cov[(i, i)] += v;
            }
        }
        let (h, e, w) = if at_rest && p.rest_bias {
            (Matrix3::identity(), self.rest_gyr - self.bias, Vector3::repeat(settle(p.bias_sigma_rest_deg_s)))
        } else if p.motion_bias {
            let seen = r_mean * self.bias;
            let e =
                Vector3::new(-up.y / ts + bias_mean[0] - seen.x, up.x / ts + bias_mean[1] - seen.y, -seen.z);
            let motion = settle(p.bias_sigma_motion_deg_s);
            (r_mean, e, Vector3::new(motion, motion, motion / p.bias_vertical_forgetting))
        } else {
            return;
        };
        let clip = p.bias_clip_deg_s.to_radians();
        let e = e.map(|value| value.clamp(-clip, clip));
        let s = Matrix3::from_diagonal(&w) + h * self.cov * h.transpose();
        let k = self.cov * h.transpose() * s.try_inverse().expect("weights are positive");
        self.bias = (self.bias + k * e).map(|value| value.clamp(-clip, clip));
        self.cov -= k * h * self.cov;
    }

    fn correct_heading(&mut self, mag: &Vector3<f64>) {
        let (p, ts) = (self.p, self.ts);
        let field = self.acc_quat * (self.gyr_quat * mag);
        let mut k = gain(p.tau_mag_s, ts);
        if p.magnetic_rejection {
            let raw = [field.norm(), -(field.z / field.norm()).asin()];
            let [norm, dip] = each(&mut self.mag_low, |i| raw[i]);
            let near = |reference: (f64, f64)| {
                (norm - reference.0).abs() < p.mag_norm_threshold * reference.0
                    && (dip - reference.1).abs() < p.mag_dip_threshold_deg.to_radians()
            };
            let follow = gain(p.mag_reference_s, ts);
            if near(self.reference) {
                self.undisturbed_t += ts;
                if self.undisturbed_t >= p.mag_min_undisturbed_s {
                    self.disturbed = false;
                    self.reference.0 += follow * (norm - self.reference.0);
                    self.reference.1 += follow * (dip - self.reference.1);
                }
            } else {
                self.undisturbed_t = 0.0;
                self.disturbed = true;
            }
            if near(self.candidate) {
                if self.rest_gyr.norm() >= p.mag_new_min_gyr_deg_s.to_radians() {
                    self.candidate_t += ts;
                }
                self.candidate.0 += follow * (norm - self.candidate.0);
                self.candidate.1 += follow * (dip - self.candidate.1);
                let needed = if self.reference.0 == 0.0 { p.mag_new_first_s } else { p.mag_new_s };
                if self.disturbed && self.candidate_t >= needed {
                    self.reference = self.candidate;
                    self.disturbed = false;
                    self.undisturbed_t = p.mag_min_undisturbed_s;
                }
            } else {
                self.candidate_t = 0.0;
                self.candidate = (norm, dip);
            }
            if !self.disturbed {
                self.rejected_t = (self.rejected_t - p.mag_rejection_factor * ts).max(0.0);
            } else if self.rejected_t <= p.mag_max_rejection_s {
                self.rejected_t += ts;
                k = 0.0;
            } else {
                k /= p.mag_rejection_factor;
            }
        }
        // The start: the mean of all samples so far, until that moves less than the steady gain would.
        if !self.heading_started {
            self.samples_of_heading += 1.0;
            k = k.max(1.0 / self.samples_of_heading);
            self.heading_started = p.tau_mag_s / (self.samples_of_heading + 1.0) < ts;
        }
        let turn = 2.0 * std::f64::consts::PI;
        let off = field.x.atan2(field.y) - self.delta;
        self.delta += k * (off - turn * (off / turn).round());
        self.delta -= turn * (self.delta / turn).round();
    }
}
