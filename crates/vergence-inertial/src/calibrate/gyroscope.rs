//! Which of the stretches that look still are rests, and the bias that the gyroscope has in them.
//!
//! A stretch is quiet by the standard of the quietest that the recording has. Where nothing in it rests (a drone in flight, a hand that waves slowly),
//! that standard is a bad one: then the mean rates of the stretches differ by far more than a bias does.

use nalgebra::Vector3;

use super::Rest;

/// Mean rates of rests are alike within this, rad/s (1 °/s): biases wander by less within a recording, and a hand that holds a unit still for
/// a second turns it by less.
const ALIKE_RAD_S: f64 = 0.0175;

/// A bias counts as seen where its deviation is less than this, rad/s (0.2 °/s): what is not seen is left to the filter, which
/// begins with 0 and a deviation of 1 °/s and finds it in motion.
const ENOUGH_RAD_S: f64 = 0.0035;

/// What the still stretches tell.
pub(super) struct Told {
    /// rad/s; exactly 0 about axes that were not seen.
    pub bias: Vector3<f64>,
    /// Standard deviations, rad/s.
    pub deviations: Vector3<f64>,
    /// Whether each stretch is a rest.
    pub at_rest: Vec<bool>,
    /// What was not seen.
    pub not_observed: Vec<String>,
}

/// The stretches that have one rate, by their length more than half of all; none where there are no such.
fn at_rest(stretches: &[Rest]) -> Vec<bool> {
    let alike = |one: &Rest| -> Vec<bool> {
        stretches.iter().map(|other| (other.gyr - one.gyr).norm() <= ALIKE_RAD_S).collect()
    };
    let length = |chosen: &[bool]| -> usize {
        stretches.iter().zip(chosen).filter(|(_, chosen)| **chosen).map(|(rest, _)| rest.samples).sum()
    };
    let mut best = vec![false; stretches.len()];
    for chosen in stretches.iter().map(alike) {
        if length(&chosen) > length(&best) {
            best = chosen;
        }
    }
    let all: usize = stretches.iter().map(|rest| rest.samples).sum();
    if 2 * length(&best) > all { best } else { vec![false; stretches.len()] }
}

/// The bias, from stretches whose samples scatter with `variance`, (rad/s)² of one axis.
pub(super) fn told(stretches: &[Rest], variance: f64) -> Told {
    let at_rest = at_rest(stretches);
    let mut not_observed = Vec::new();
    let fastest = |moving: bool| {
        let few = stretches.iter().zip(&at_rest).filter(|(_, rest)| moving != **rest);
        few.map(|(stretch, _)| stretch.gyr.norm()).fold(0.0, f64::max).to_degrees()
    };
    let moving = at_rest.iter().filter(|rest| !**rest).count();
    let rests: Vec<&Rest> =
        stretches.iter().zip(&at_rest).filter(|(_, rest)| **rest).map(|(stretch, _)| stretch).collect();
    if rests.is_empty() {
        not_observed.push(format!(
            "rests: none of {moving} stretches that look still is one, they turn at different rates of up to {:.1} °/s; laying the unit down would tell",
            fastest(true)
        ));
    } else if moving > 0 {
        not_observed.push(format!(
            "rests: {moving} of {} stretches that look still are none, they turn at up to {:.1} °/s",
            stretches.len(),
            fastest(true)
        ));
    }
    // Of stretches that are no rests only how far they differ is told.
    let used = if rests.is_empty() { stretches.iter().collect() } else { rests };
    let (mean, deviations) = mean(&used, variance);
    let seen: [bool; 3] =
        std::array::from_fn(|axis| at_rest.contains(&true) && deviations[axis] < ENOUGH_RAD_S);
    let missing: Vec<&str> =
        ["x", "y", "z"].into_iter().zip(seen).filter(|(_, seen)| !seen).map(|(name, _)| name).collect();
    if !missing.is_empty() {
        not_observed
            .push(format!("gyroscope: bias about {}; laying the unit down would tell", missing.join(" ")));
    }
    let bias = Vector3::from_fn(|axis, _| if seen[axis] { mean[axis] } else { 0.0 });
    Told { bias, deviations, at_rest, not_observed }
}

/// Weighted mean of the rests, its standard deviation widened by how much they disagree (a bias that wanders).
fn mean(rests: &[&Rest], variance: f64) -> (Vector3<f64>, Vector3<f64>) {
    let samples: f64 = rests.iter().map(|rest| rest.samples as f64).sum();
    let mean = rests.iter().map(|rest| rest.gyr * rest.samples as f64).sum::<Vector3<f64>>() / samples;
    let spread = Vector3::from_fn(|axis, _| {
        let between: f64 =
            rests.iter().map(|rest| (rest.gyr[axis] - mean[axis]).powi(2) * rest.samples as f64).sum();
        let between = if rests.len() > 2 { between / (rests.len() - 1) as f64 } else { 0.0 };
        (variance.max(between) / samples).sqrt()
    });
    (mean, spread)
}
