//! How far an estimated trajectory is from the true one.

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use vergence_geom::{Rigid, log, mean};
use vergence_time::{Span, Timestamp};

use crate::Error;
use crate::trajectory::{Rotations, Trajectory};

/// What may be moved before the error is taken: estimates have no absolute place, and one camera alone has no scale.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Align {
    /// Turned and shifted for the least squared distance between positions (Umeyama 1991).
    #[default]
    Se3,
    /// Scaled, too.
    Sim3,
    /// Left as it is.
    None,
}

/// Errors over pairs of poses that are a fixed number of frames apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Relative {
    /// Frames from the first to the second: the span over the median period, rounded.
    pub frames: usize,
    /// How many pairs; all that there are.
    pub pairs: usize,
    /// Root mean square of the translation error, metres.
    pub rmse_m: f64,
    /// Root mean square of the rotation error, radians.
    pub rmse_rad: f64,
}

/// What the estimate does while the truth stands still.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rest {
    /// For how long it stands.
    pub span: Span,
    /// Root mean square distance of the estimate from its own mean over each second, metres.
    pub jitter_m: f64,
    /// Largest distance between the means of two such seconds of one rest, beyond what the truth moved, metres.
    pub drift_m: f64,
}

/// The comparison of two trajectories.
#[derive(Clone, Debug, PartialEq)]
pub struct Evaluation {
    /// Absolute trajectory error: root mean square distance of aligned positions, metres.
    pub ate_rmse_m: f64,
    /// The largest of these distances.
    pub ate_max_m: f64,
    /// Over one second; `None` where the match is shorter.
    pub rpe_1s: Option<Relative>,
    /// Over five seconds.
    pub rpe_5s: Option<Relative>,
    /// The factor that would fit the estimate to the truth best, whatever was aligned (1: the right size); 1 where it does
    /// not move. See [`Evaluation::known_scale`].
    pub scale: f64,
    /// How far the truth moves: root mean square distance of the matched true positions from their mean, metres.
    pub spread_m: f64,
    /// Share of the true poses that have an estimate within three quarters of its period, at least [`MATCH_NS`].
    pub coverage: f64,
    /// Pairs of poses that were compared.
    pub matched: usize,
    /// At rest; `None` where the truth never stands for a second.
    pub rest: Option<Rest>,
    /// The pairs: when, the aligned estimate, the truth.
    pub pairs: Vec<(Timestamp, Rigid, Rigid)>,
}

impl Evaluation {
    /// The scale, where the truth moves enough (a centimetre: ten times what the noise of a motion capture system is) to say one.
    pub fn known_scale(&self) -> Option<f64> {
        (self.spread_m > MOVES_M).then_some(self.scale)
    }
}

/// Which of two trajectories.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Whose {
    /// The estimate.
    Estimate,
    /// The truth.
    Truth,
}

/// A trajectory whose quaternions have their numbers in another order than its format says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reordered {
    /// Whose quaternions.
    pub whose: Whose,
    /// How they were read.
    pub as_read: Rotations,
    /// Root mean square of the rotation error over a second as they were read, radians.
    pub as_read_rad: f64,
    /// The same in the other order.
    pub reordered_rad: f64,
}

/// A truth that moves by less has no scale, m: see [`Evaluation::known_scale`].
const MOVES_M: f64 = 0.01;
/// Rotations that err by less over a second are in the right order, rad; those in another order must err by less than this share.
const TURNED_RAD: f64 = 0.1;
const REORDERED: f64 = 0.25;

/// Whether the rotations of one of two trajectories agree with the other's much better (four times) with the numbers of their quaternions in
/// the other order than their file was read in ([`Trajectory::read_places`]; what is `None` is not doubted).
pub fn reordered(
    (estimate, read): (&Trajectory, Rotations),
    (truth, truth_read): (&Trajectory, Rotations),
) -> Option<Reordered> {
    const SECOND: i64 = 1_000_000_000;
    let error = |estimate: &Trajectory, truth: &Trajectory| {
        let pairs = matches(estimate, truth);
        if pairs.len() < 3 {
            return None;
        }
        let period = median_period(&pairs);
        // A match of less than a second has steps at least.
        let found = relative(&pairs, SECOND, period).or_else(|| relative(&pairs, period, period));
        found.map(|relative| relative.rmse_rad)
    };
    let as_read_rad = error(estimate, truth).filter(|error| *error > TURNED_RAD)?;
    // Both together say the same as neither: what is read as w last is doubted first.
    let mut doubted = [(Whose::Estimate, read), (Whose::Truth, truth_read)];
    doubted.sort_by_key(|(_, read)| *read == Rotations::ScalarFirst);
    let mut best: Option<Reordered> = None;
    for (whose, as_read) in doubted.into_iter().filter(|(_, read)| *read != Rotations::None) {
        let found = match whose {
            Whose::Estimate => error(&in_other_order(estimate, as_read), truth),
            Whose::Truth => error(estimate, &in_other_order(truth, as_read)),
        };
        let Some(reordered_rad) = found.filter(|error| *error < REORDERED * as_read_rad) else { continue };
        if best.is_none_or(|best| reordered_rad + 1e-4 < 0.5 * best.reordered_rad) {
            best = Some(Reordered { whose, as_read, as_read_rad, reordered_rad });
        }
    }
    best
}

/// With the numbers of each quaternion taken the other way than they were read.
fn in_other_order(trajectory: &Trajectory, as_read: Rotations) -> Trajectory {
    let turn = |(at, pose): &(Timestamp, Rigid)| {
        let [x, y, z, w] = [pose.rotation.i, pose.rotation.j, pose.rotation.k, pose.rotation.w];
        let q = match as_read {
            Rotations::ScalarFirst => Quaternion::new(z, w, x, y),
            _ => Quaternion::new(x, y, z, w),
        };
        (*at, Rigid::from_parts(pose.translation, UnitQuaternion::new_normalize(q)))
    };
    Trajectory { poses: trajectory.poses.iter().map(turn).collect() }
}

/// Poses this far apart in time are still the same pose, nanoseconds.
pub const MATCH_NS: i64 = 10_000_000;
/// Within a second the truth at rest stays this close to where it was, metres (what a motion capture system's noise is below), and
/// this close to its orientation, radians.
const REST_M: f64 = 0.005;
const REST_RAD: f64 = 0.01;

/// Compares as `evo_ape` and `evo_rpe --delta_unit f --all_pairs` do: each pose of the shorter trajectory with the nearest of the longer
/// one within 10 ms.
///
/// # Errors
/// Fewer than three poses match.
pub fn evaluate(estimate: &Trajectory, truth: &Trajectory, align: Align) -> Result<Evaluation, Error> {
    compare(estimate, truth, align, true)
}

/// As [`evaluate`], where one of the two says positions only ([`Trajectory::read_places`]): there are no relative errors, as those are taken in the
/// body's axes.
///
/// # Errors
/// Fewer than three poses match.
pub fn evaluate_places(estimate: &Trajectory, truth: &Trajectory, align: Align) -> Result<Evaluation, Error> {
    compare(estimate, truth, align, false)
}

pub(crate) fn compare(
    estimate: &Trajectory,
    truth: &Trajectory,
    align: Align,
    turned: bool,
) -> Result<Evaluation, Error> {
    let mut pairs = matches(estimate, truth);
    if pairs.len() < 3 {
        return Err(unmatched(estimate, truth, pairs.len()));
    }
    let fit = fit(&pairs, turned);
    let (rotation, scale) = match align {
        Align::Se3 => (fit.rotation, 1.0),
        Align::Sim3 => (fit.rotation, fit.scale),
        Align::None => (Matrix3::identity(), 1.0),
    };
    let shift = if align == Align::None {
        Vector3::zeros()
    } else {
        fit.true_mean - rotation * fit.estimated_mean * scale
    };
    let turn = UnitQuaternion::from_matrix(&rotation);
    for (_, estimated, _) in &mut pairs {
        estimated.translation.vector = rotation * estimated.translation.vector * scale + shift;
        estimated.rotation = turn * estimated.rotation;
    }
    let distance =
        |(_, a, b): &(Timestamp, Rigid, Rigid)| (a.translation.vector - b.translation.vector).norm();
    let squares: f64 = pairs.iter().map(|pair| distance(pair).powi(2)).sum();
    let period = estimate.period().map_or(1, |span| span.as_nanos().max(1));
    let matched_period = median_period(&pairs);
    Ok(Evaluation {
        ate_rmse_m: (squares / pairs.len() as f64).sqrt(),
        ate_max_m: pairs.iter().map(distance).fold(0.0, f64::max),
        rpe_1s: relative(&pairs, 1_000_000_000, matched_period).filter(|_| turned),
        rpe_5s: relative(&pairs, 5_000_000_000, matched_period).filter(|_| turned),
        scale: fit.scale,
        spread_m: fit.spread_m,
        coverage: coverage(estimate, truth, (period / 4 * 3).max(MATCH_NS)),
        matched: pairs.len(),
        rest: rest(&pairs),
        pairs,
    })
}

/// From when to when each of two trajectories is, and what may be wrong with that.
fn unmatched(estimate: &Trajectory, truth: &Trajectory, count: usize) -> Error {
    let ends = |trajectory: &Trajectory| {
        let (first, last) = (trajectory.poses.first(), trajectory.poses.last());
        first.zip(last).map_or((0, 0), |(first, last)| (first.0.as_nanos(), last.0.as_nanos()))
    };
    let (ours, theirs) = (ends(estimate), ends(truth));
    let seconds = |nanos: i64| nanos as f64 * 1e-9;
    let apart = ours.0 > theirs.1 || theirs.0 > ours.1;
    // What begins within a day of zero has no date.
    let undated = |ends: (i64, i64)| ends.0.abs() < 86_400_000_000_000;
    let hint = match (apart, undated(ours), undated(theirs)) {
        (true, true, false) => "; do the estimate's times begin at 0?".to_owned(),
        (true, false, true) => "; do the truth's times begin at 0?".to_owned(),
        (true, ..) => {
            format!(
                "; the two begin {:.3} s apart: are they of one clock?",
                seconds(ours.0) - seconds(theirs.0)
            )
        }
        (false, ..) => String::new(),
    };
    Error::Unmatched {
        expected: "three poses or more at the same times (within 10 ms)".to_owned(),
        found: format!(
            "{count} among {} estimated from {:.3} to {:.3} s and {} true from {:.3} to {:.3} s{hint}",
            estimate.poses.len(),
            seconds(ours.0),
            seconds(ours.1),
            truth.poses.len(),
            seconds(theirs.0),
            seconds(theirs.1)
        ),
    }
}

/// The pose nearest in time, and how far off it is; the earlier of two that are as near.
fn nearest(poses: &[(Timestamp, Rigid)], at: Timestamp) -> Option<(usize, u64)> {
    let after = poses.partition_point(|pose| pose.0 <= at);
    let off = |index: usize| Some((index, poses.get(index)?.0.as_nanos().abs_diff(at.as_nanos())));
    let (earlier, later) = (after.checked_sub(1).and_then(off), off(after));
    match (earlier, later) {
        (Some(a), Some(b)) => Some(if b.1 < a.1 { b } else { a }),
        (a, b) => a.or(b),
    }
}

fn matches(estimate: &Trajectory, truth: &Trajectory) -> Vec<(Timestamp, Rigid, Rigid)> {
    let most = MATCH_NS.unsigned_abs();
    let longer_truth = truth.poses.len() >= estimate.poses.len();
    let (short, long) = if longer_truth { (estimate, truth) } else { (truth, estimate) };
    short
        .poses
        .iter()
        .filter_map(|(at, pose)| {
            let (index, off) = nearest(&long.poses, *at)?;
            let other = long.poses[index].1;
            (off <= most).then_some(if longer_truth { (*at, *pose, other) } else { (*at, other, *pose) })
        })
        .collect()
}

fn coverage(estimate: &Trajectory, truth: &Trajectory, most: i64) -> f64 {
    let near =
        |at: Timestamp| nearest(&estimate.poses, at).is_some_and(|(_, off)| off <= most.unsigned_abs());
    let covered = truth.poses.iter().filter(|pose| near(pose.0)).count();
    covered as f64 / truth.poses.len() as f64
}

/// What fits estimated positions to true ones.
struct Fit {
    rotation: Matrix3<f64>,
    scale: f64,
    spread_m: f64,
    estimated_mean: Vector3<f64>,
    true_mean: Vector3<f64>,
}

/// S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns", PAMI 13(4), 1991. Where positions do
/// not say the rotation (all on a line or a point), orientations do, if there are any (`turned`).
fn fit(pairs: &[(Timestamp, Rigid, Rigid)], turned: bool) -> Fit {
    let count = pairs.len() as f64;
    let estimated_mean = pairs.iter().map(|pair| pair.1.translation.vector).sum::<Vector3<f64>>() / count;
    let true_mean = pairs.iter().map(|pair| pair.2.translation.vector).sum::<Vector3<f64>>() / count;
    let (mut covariance, mut variance, mut spread) = (Matrix3::zeros(), 0.0, 0.0);
    for (_, estimated, truth) in pairs {
        let (x, y) = (estimated.translation.vector - estimated_mean, truth.translation.vector - true_mean);
        covariance += y * x.transpose() / count;
        variance += x.norm_squared() / count;
        spread += y.norm_squared() / count;
    }
    let spread_m = f64::sqrt(spread);
    let svd = covariance.svd(true, true);
    let (u, vt) = (svd.u.unwrap_or_else(Matrix3::identity), svd.v_t.unwrap_or_else(Matrix3::identity));
    let d = svd.singular_values;
    let determined = d.iter().filter(|d| **d > f64::EPSILON).count() >= 2;
    if !determined && turned {
        let turns: Vec<_> = pairs.iter().map(|pair| pair.2.rotation * pair.1.rotation.inverse()).collect();
        let turn = mean(turns.iter().map(|turn| (1.0, turn))).unwrap_or(turns[0]);
        let rotation = turn.to_rotation_matrix().into_inner();
        return Fit { rotation, scale: 1.0, spread_m, estimated_mean, true_mean };
    }
    let mut signs = Vector3::repeat(1.0);
    if u.determinant() * vt.determinant() < 0.0 {
        signs[d.imin()] = -1.0;
    }
    let rotation = u * Matrix3::from_diagonal(&signs) * vt;
    let scale = if variance > 0.0 { d.dot(&signs) / variance } else { 1.0 };
    Fit { rotation, scale, spread_m, estimated_mean, true_mean }
}

fn median_period(pairs: &[(Timestamp, Rigid, Rigid)]) -> i64 {
    let mut steps: Vec<i64> =
        pairs.windows(2).map(|pair| pair[1].0.as_nanos().saturating_sub(pair[0].0.as_nanos())).collect();
    let middle = steps.len() / 2;
    (*steps.select_nth_unstable(middle).1).max(1)
}

fn relative(pairs: &[(Timestamp, Rigid, Rigid)], span: i64, period: i64) -> Option<Relative> {
    let frames = usize::try_from((span + period / 2) / period).ok()?.max(1);
    let count = pairs.len().checked_sub(frames).filter(|count| *count > 0)?;
    let (mut metres, mut radians) = (0.0, 0.0);
    for (a, b) in pairs.iter().zip(&pairs[frames..]) {
        let error = (a.2.inv_mul(&b.2)).inv_mul(&a.1.inv_mul(&b.1));
        metres += error.translation.vector.norm_squared();
        radians += log(&error.rotation).norm_squared();
    }
    Some(Relative {
        frames,
        pairs: count,
        rmse_m: (metres / count as f64).sqrt(),
        rmse_rad: (radians / count as f64).sqrt(),
    })
}

fn rest(pairs: &[(Timestamp, Rigid, Rigid)]) -> Option<Rest> {
    const SECOND: i64 = 1_000_000_000;
    let (mut squares, mut count, mut nanos, mut drift_m) = (0.0, 0usize, 0, 0f64);
    // The first second of the rest that the last one belongs to: where, estimated and true.
    let mut start: Option<(Vector3<f64>, Vector3<f64>)> = None;
    let mut from = 0;
    while from < pairs.len() {
        let begin = pairs[from].0.as_nanos();
        let to = from + pairs[from..].partition_point(|pair| pair.0.as_nanos() - begin < SECOND);
        let second = &pairs[from..to];
        let truth = second[0].2;
        let stands = second.iter().all(|pair| {
            (pair.2.translation.vector - truth.translation.vector).norm() < REST_M
                && pair.2.rotation.angle_to(&truth.rotation) < REST_RAD
        });
        // A last piece of less than half a second says little.
        let whole = to < pairs.len() || second.len() > 1 && pairs[to - 1].0.as_nanos() - begin > SECOND / 2;
        if stands && second.len() > 1 && whole {
            let centre = |pick: fn(&(Timestamp, Rigid, Rigid)) -> Vector3<f64>| {
                second.iter().map(pick).sum::<Vector3<f64>>() / second.len() as f64
            };
            let estimated = centre(|pair| pair.1.translation.vector);
            let real = centre(|pair| pair.2.translation.vector);
            squares +=
                second.iter().map(|pair| (pair.1.translation.vector - estimated).norm_squared()).sum::<f64>();
            count += second.len();
            nanos += pairs[to - 1].0.as_nanos() - begin;
            let (a, b) = *start.get_or_insert((estimated, real));
            drift_m = drift_m.max(((estimated - a) - (real - b)).norm());
        } else {
            start = None;
        }
        from = to;
    }
    (count > 0).then(|| Rest {
        span: Span::from_nanos(nanos),
        jitter_m: (squares / count as f64).sqrt(),
        drift_m,
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn knot(count: i64, noise_m: f64) -> Trajectory {
        let pose = |k: i64| {
            let t = k as f64 * 0.05;
            let wobble = Vector3::new((t * 91.0).sin(), (t * 77.0).cos(), (t * 51.0).sin()) * noise_m;
            let place =
                Vector3::new((2.0 * t).sin() + t * 0.1, (3.0 * t).cos(), (5.0 * t).sin() * 0.4) + wobble;
            let turn = UnitQuaternion::from_euler_angles(t * 0.3, (t * 0.7).sin(), t);
            (
                Timestamp::from_nanos(1_400_000_000_000_000_000 + k * 50_000_000),
                Rigid::from_parts(place.into(), turn),
            )
        };
        Trajectory { poses: (0..count).map(pose).collect() }
    }

    proptest! {
        #[test]
        fn alignment_takes_out_what_was_put_in(
            x in -3.0..3.0f64, y in -3.0..3.0f64, z in -3.0..3.0f64, scale in 0.3..3.0f64,
        ) {
            let truth = knot(300, 0.0);
            let other = Rigid::new(Vector3::new(z * 9.0, x, y), Vector3::new(x, y, z));
            let moved = |s: f64| Trajectory {
                poses: truth.poses.iter().map(|(at, pose)| {
                    let mut pose = other * pose;
                    pose.translation.vector *= s;
                    (*at, pose)
                }).collect(),
            };
            let rigid = evaluate(&moved(1.0), &truth, Align::Se3).unwrap();
            prop_assert!(rigid.ate_rmse_m < 1e-10 && (rigid.scale - 1.0).abs() < 1e-10);
            prop_assert!(rigid.rpe_1s.unwrap().rmse_m < 1e-10 && rigid.rpe_1s.unwrap().rmse_rad < 1e-10);
            let scaled = evaluate(&moved(scale), &truth, Align::Sim3).unwrap();
            prop_assert!(scaled.ate_rmse_m < 1e-10 && (scaled.scale * scale - 1.0).abs() < 1e-10);
            let wrong = evaluate(&moved(1.01 * scale.max(1.0)), &truth, Align::Se3).unwrap();
            prop_assert!(wrong.ate_rmse_m > 1e-3);
        }
    }

    #[test]
    fn quaternions_in_another_order_are_told() {
        use Rotations::{ScalarFirst, ScalarLast};
        let (truth, estimate) = (knot(300, 0.0), knot(300, 1e-3));
        for (a, b) in [(ScalarLast, ScalarLast), (ScalarLast, ScalarFirst)] {
            assert_eq!(reordered((&estimate, a), (&truth, b)), None);
        }
        // A right estimate that errs badly is no matter of the order.
        let mut turning = estimate.clone();
        for (k, (_, pose)) in turning.poses.iter_mut().enumerate() {
            pose.rotation *= UnitQuaternion::from_euler_angles(0.0, 0.02 * k as f64, 0.0);
        }
        assert_eq!(reordered((&turning, ScalarLast), (&truth, ScalarLast)), None);
        // Written w x y z and read as x y z w, beside a truth in either format; and the other way round.
        let wrong = in_other_order(&estimate, ScalarFirst);
        for of_truth in [ScalarLast, ScalarFirst] {
            let found = reordered((&wrong, ScalarLast), (&truth, of_truth)).unwrap();
            assert_eq!((found.whose, found.as_read), (Whose::Estimate, ScalarLast));
            assert!(found.as_read_rad > 0.1 && found.reordered_rad < 0.01, "{found:?}");
        }
        let found =
            reordered((&estimate, ScalarLast), (&in_other_order(&truth, ScalarFirst), ScalarLast)).unwrap();
        assert_eq!((found.whose, found.as_read), (Whose::Truth, ScalarLast));
        let wrong = in_other_order(&estimate, ScalarLast);
        let found = reordered((&wrong, ScalarFirst), (&truth, ScalarFirst)).unwrap();
        assert_eq!((found.whose, found.as_read), (Whose::Estimate, ScalarFirst));
        assert_eq!(reordered((&wrong, Rotations::None), (&truth, Rotations::None)), None);
    }

    #[test]
    fn positions_alone_have_an_absolute_error_only() {
        let (truth, mut places) = (knot(200, 0.0), knot(200, 2e-3));
        let whole = evaluate(&places, &truth, Align::Se3).unwrap();
        places.poses.iter_mut().for_each(|(_, pose)| pose.rotation = UnitQuaternion::identity());
        let found = evaluate_places(&places, &truth, Align::Se3).unwrap();
        assert_eq!((found.ate_rmse_m, found.scale), (whole.ate_rmse_m, whole.scale));
        assert_eq!((found.rpe_1s, found.rpe_5s), (None, None));
        // On a line, whose rotation about itself nobody knows.
        let line = |k: i64| (Timestamp::from_nanos(k * 50_000_000), Rigid::translation(k as f64, 0.0, 0.0));
        let straight = Trajectory { poses: (0..20).map(line).collect() };
        let found = evaluate_places(&straight, &straight, Align::Se3).unwrap();
        assert!(found.ate_rmse_m < 1e-9, "{}", found.ate_rmse_m);
        let same = Trajectory { poses: (0..20).map(|k| (line(k).0, Rigid::identity())).collect() };
        assert!(evaluate_places(&same, &same, Align::Sim3).unwrap().ate_rmse_m == 0.0);
    }

    #[test]
    fn what_hardly_moves_has_no_scale() {
        let truth = knot(200, 0.0);
        assert!(evaluate(&truth, &truth, Align::Se3).unwrap().known_scale().is_some());
        let mut still = truth.clone();
        still.poses.iter_mut().for_each(|(_, pose)| pose.translation.vector *= 1e-3);
        assert_eq!(evaluate(&still, &still, Align::Se3).unwrap().known_scale(), None);
    }

    #[test]
    fn times_that_do_not_meet_have_their_units_and_a_reason() {
        let truth = knot(100, 0.0);
        let said = |estimate: &Trajectory, truth: &Trajectory| {
            evaluate(estimate, truth, Align::Se3).unwrap_err().to_string()
        };
        let shifted = |nanos: i64| {
            let pose =
                |(at, pose): &(Timestamp, Rigid)| (Timestamp::from_nanos(at.as_nanos() + nanos), *pose);
            Trajectory { poses: truth.poses.iter().map(pose).collect() }
        };
        let relative = shifted(-1_400_000_000_000_000_000);
        let found = said(&relative, &truth);
        assert!(
            found.contains("100 estimated from 0.000 to 4.950 s and 100 true from 1400000000.000"),
            "{found}"
        );
        assert!(found.ends_with("; do the estimate's times begin at 0?"), "{found}");
        assert!(said(&truth, &relative).ends_with("; do the truth's times begin at 0?"));
        let found = said(&shifted(3_600_000_000_000), &truth);
        assert!(found.ends_with("; the two begin 3600.000 s apart: are they of one clock?"), "{found}");
        // In between each other: nothing is known of the reason.
        assert!(said(&shifted(25_000_000), &truth).ends_with(" s"));
    }

    #[test]
    fn coverage_counts_what_has_an_estimate() {
        let truth = knot(400, 0.0);
        let mut half = truth.clone();
        half.poses.retain(|pose| pose.0 >= truth.poses[200].0);
        let found = evaluate(&half, &truth, Align::Se3).unwrap();
        assert_eq!((found.matched, found.coverage), (200, 0.5));
        // Truth at ten times the rate is covered, too.
        let mut sparse = truth.clone();
        sparse.poses = truth.poses.iter().step_by(10).copied().collect();
        let found = evaluate(&sparse, &truth, Align::Se3).unwrap();
        assert!(found.coverage > 0.98, "{}", found.coverage);
    }

    #[test]
    fn standing_still_has_jitter_and_drift() {
        let still = |drift_m_s: f64, jitter_m: f64| {
            let pose = |k: i64| {
                let x = k as f64 * 0.05 * drift_m_s + if k % 2 == 0 { jitter_m } else { -jitter_m };
                (Timestamp::from_nanos(k * 50_000_000), Rigid::translation(x, 1.0, 2.0))
            };
            Trajectory { poses: (0..100).map(pose).collect() }
        };
        let found = evaluate(&still(0.0, 4e-4), &still(0.0, 0.0), Align::Se3).unwrap();
        let rest = found.rest.unwrap();
        assert!((rest.jitter_m - 4e-4).abs() < 1e-12 && rest.drift_m < 1e-12, "{rest:?}");
        let found = evaluate(&still(1e-3, 0.0), &still(0.0, 0.0), Align::Se3).unwrap();
        assert!((found.rest.unwrap().drift_m - 4e-3).abs() < 1e-9, "{:?}", found.rest);
        assert!(evaluate(&knot(100, 0.0), &knot(100, 0.0), Align::Se3).unwrap().rest.is_none());
    }

    #[test]
    fn what_does_not_meet_is_refused() {
        let truth = knot(100, 0.0);
        let mut late = truth.clone();
        for pose in &mut late.poses {
            pose.0 = Timestamp::from_nanos(pose.0.as_nanos() + 3_600_000_000_000);
        }
        let error = evaluate(&late, &truth, Align::Se3).unwrap_err().to_string();
        assert!(error.starts_with("expected three poses or more"), "{error}");
    }
}
