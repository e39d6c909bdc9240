//! What each pose of a trajectory is worth, as a table beside it, and whether that was true.

use std::io::Write;
use std::path::Path;

use vergence_time::Timestamp;

use crate::evaluate::{Align, Evaluation, compare};
use crate::trajectory::{Trajectory, read_text};
use crate::{Error, Estimate, State};

/// One line: when, and how far the pose of that time can be trusted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Judgement {
    /// Of the frame.
    pub time: Timestamp,
    /// Whether it may be used.
    pub state: State,
    /// Standard deviation of the position since the start (root of the trace), m; may be infinite.
    pub position_sigma_m: f64,
    /// Of the rotation since the start, rad; may be infinite.
    pub rotation_sigma_rad: f64,
}

const HEADER: &str =
    "#time_ns,state,position_sigma_m,rotation_sigma_rad,seen,thrown_away,keyframe,map,residual_px";

/// Writes a line for each frame (CSV): time, state in one word ([`State::word`]), standard deviations, points of the map that it sees, points
/// that were thrown away, whether it is a keyframe, which map it is in, and what is left between where points are seen and where they
/// should be.
///
/// # Errors
/// Those of `out`.
pub fn write(estimates: &[Estimate], mut out: impl Write) -> std::io::Result<()> {
    writeln!(out, "{HEADER}")?;
    for e in estimates {
        writeln!(
            out,
            "{},{},{:.6},{:.6},{},{},{},{},{:.3}",
            e.time.as_nanos(),
            e.state.word(),
            e.position_sigma_m,
            e.rotation_sigma_rad,
            e.known,
            e.outliers,
            u8::from(e.keyframe),
            e.map,
            e.residual_px
        )?;
    }
    out.flush()
}

/// Reads such a table; what stands behind the standard deviations is not looked at.
///
/// # Errors
/// File, line and column of the first fault; no lines.
pub fn read(path: &Path) -> Result<Vec<Judgement>, Error> {
    parse(&read_text(path)?, path)
}

fn parse(text: &str, path: &Path) -> Result<Vec<Judgement>, Error> {
    let mut all: Vec<Judgement> = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let mut words = line.split(',').map(str::trim);
        let mut next = || words.next().unwrap_or_default();
        let wrong = |column: usize, expected: &str, found: &str| {
            let found: String = found.chars().take(40).collect();
            Error::content(path, (index + 1, column), expected, found)
        };
        let (time, state) = (next(), next());
        let nanos = time.parse().map_err(|_| wrong(1, "whole nanoseconds", time))?;
        let known = State::of_word(state).ok_or_else(|| {
            let words: Vec<&str> = State::ALL.iter().map(|state| state.word()).collect();
            wrong(2, &words.join(", "), state)
        })?;
        let mut sigma = |column: usize| {
            let word = next();
            let value = word.parse().ok().filter(|sigma: &f64| *sigma >= 0.0);
            value.ok_or_else(|| wrong(column, "a standard deviation", word))
        };
        let time = Timestamp::from_nanos(nanos);
        if let Some(last) = all.last().filter(|last| last.time >= time) {
            let expected = format!("a time after {} ns", last.time.as_nanos());
            return Err(wrong(1, &expected, &format!("{nanos} ns")));
        }
        let (position_sigma_m, rotation_sigma_rad) = (sigma(3)?, sigma(4)?);
        all.push(Judgement { time, state: known, position_sigma_m, rotation_sigma_rad });
    }
    if all.is_empty() {
        return Err(Error::file(path, "states of poses", "none"));
    }
    Ok(all)
}

/// How the poses that are said to be tracked do, and whether they keep their own bounds.
#[derive(Clone, Debug, PartialEq)]
pub struct Trust {
    /// Frames with a state.
    pub frames: usize,
    /// Of these, those that are [`State::Tracked`].
    pub tracked: usize,
    /// The tracked ones alone, aligned for themselves.
    pub evaluation: Evaluation,
    /// For each matched tracked pose: its error in its own standard deviations.
    pub sigmas: Vec<f64>,
    /// The largest of them, and when that is.
    pub worst: (f64, Timestamp),
    /// Share of them that is at most 3.
    pub within_three: f64,
}

/// Compares what is tracked of an estimate, by its states, with the truth; `turned` as [`Trajectory::read_places`] says it. A state belongs to
/// the pose of its very time.
///
/// Standard deviations are those since the start, and errors are taken after an alignment over all that is tracked: with the first
/// poses, whose deviation is next to nothing, an error is counted against the deviation of the middle pose where that is larger than their own,
/// as an alignment puts part of the later drift there.
///
/// # Errors
/// No state at the time of a pose; fewer than three tracked poses that match the truth.
pub fn trust(
    estimate: &Trajectory,
    states: &[Judgement],
    truth: &Trajectory,
    align: Align,
    turned: bool,
) -> Result<Trust, Error> {
    let of =
        |time: Timestamp| states.binary_search_by_key(&time, |state| state.time).ok().map(|i| &states[i]);
    let judged = estimate.poses.iter().filter(|pose| of(pose.0).is_some()).count();
    if judged == 0 {
        return Err(Error::Unmatched {
            expected: "states of the estimate's poses".to_owned(),
            found: format!("none of {} at the times of {} poses", states.len(), estimate.poses.len()),
        });
    }
    let tracked = |time: Timestamp| of(time).filter(|state| state.state == State::Tracked);
    let kept: Vec<_> = estimate.poses.iter().filter(|pose| tracked(pose.0).is_some()).copied().collect();
    let count = kept.len();
    let kept = Trajectory { poses: kept };
    let evaluation = compare(&kept, truth, align, turned)?;
    // The pair's time is that of the shorter trajectory: within ten milliseconds of the pose's.
    let deviation = |time: Timestamp| {
        let after = kept.poses.partition_point(|pose| pose.0 < time);
        let near = kept.poses[after.saturating_sub(1)..].iter().take(2);
        let near = near.min_by_key(|pose| pose.0.as_nanos().abs_diff(time.as_nanos()))?;
        tracked(near.0).map(|state| state.position_sigma_m)
    };
    let mut deviations: Vec<f64> = evaluation
        .pairs
        .iter()
        .filter_map(|pair| deviation(pair.0))
        .filter(|sigma| sigma.is_finite())
        .collect();
    let middle = deviations.len() / 2;
    let least = if deviations.is_empty() {
        0.0
    } else {
        *deviations.select_nth_unstable_by(middle, f64::total_cmp).1
    };
    let mut sigmas = Vec::with_capacity(evaluation.pairs.len());
    let mut worst = (0.0, evaluation.pairs.first().map_or(Timestamp::default(), |pair| pair.0));
    for (time, ours, theirs) in &evaluation.pairs {
        let error = (ours.translation.vector - theirs.translation.vector).norm();
        let sigma = deviation(*time).unwrap_or(0.0).max(least);
        let ratio = if error > 0.0 { error / sigma } else { 0.0 };
        sigmas.push(ratio);
        if ratio > worst.0 {
            worst = (ratio, *time);
        }
    }
    let within = sigmas.iter().filter(|ratio| **ratio <= 3.0).count();
    let within_three = within as f64 / sigmas.len() as f64;
    Ok(Trust { frames: states.len(), tracked: count, evaluation, sigmas, worst, within_three })
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use proptest::prelude::*;
    use vergence_geom::Rigid;
    use vergence_inertial::preintegrate::Biases;

    use super::*;

    fn estimate(k: i64, state: State, sigma: f64) -> Estimate {
        let t = k as f64 * 0.05;
        Estimate {
            time: Timestamp::from_nanos(1_400_000_000_000_000_000 + k * 50_000_000),
            world_from_body: Rigid::new(
                Vector3::new(t.sin(), t.cos(), 0.3 * (3.0 * t).sin()),
                Vector3::new(0.0, t, 0.0),
            ),
            velocity_m_s: Vector3::zeros(),
            biases: Biases::default(),
            state,
            position_sigma_m: sigma,
            rotation_sigma_rad: 0.5 * sigma,
            keyframe: k % 2 == 0,
            map: 3,
            known: 12,
            outliers: 1,
            residual_px: 0.25,
        }
    }

    fn read_back(estimates: &[Estimate]) -> Vec<Judgement> {
        let mut table = Vec::new();
        write(estimates, &mut table).unwrap();
        parse(std::str::from_utf8(&table).unwrap(), Path::new("s.csv")).unwrap()
    }

    #[test]
    fn what_is_written_is_read_again_in_the_same_words() {
        let states = State::ALL.into_iter().zip(0..);
        let estimates: Vec<_> = states.map(|(state, k)| estimate(k, state, 0.01)).collect();
        let mut table = Vec::new();
        write(&estimates, &mut table).unwrap();
        let table = String::from_utf8(table).unwrap();
        assert!(
            table.contains("\n1400000000050000000,finding-gravity,0.010000,0.005000,12,1,0,3,0.250\n"),
            "{table}"
        );
        for (read, written) in read_back(&estimates).iter().zip(&estimates) {
            assert_eq!((read.time, read.state), (written.time, written.state));
            assert_eq!((read.position_sigma_m, read.rotation_sigma_rad), (0.01, 0.005));
        }
        // What nothing is known of is infinitely far off.
        assert_eq!(read_back(&[estimate(0, State::Lost, f64::INFINITY)])[0].position_sigma_m, f64::INFINITY);
    }

    #[test]
    fn faults_have_a_place() {
        for (text, place) in [
            ("1,tracked,0.1,x", "s.csv:1:4: expected a standard deviation, found x"),
            ("1,tracked,-0.1,0", "s.csv:1:3: expected a standard deviation, found -0.1"),
            ("1,tracked,NaN,0", "s.csv:1:3: expected a standard deviation"),
            (
                "1,Tracked,0,0",
                "s.csv:1:2: expected waiting, finding-gravity, finding-depth, finding-corners,",
            ),
            ("1.5,tracked,0,0", "s.csv:1:1: expected whole nanoseconds, found 1.5"),
            ("1,lost,0,0\n1,lost,0,0", "s.csv:2:1: expected a time after 1 ns, found 1 ns"),
            ("#\n", "s.csv: expected states of poses, found none"),
        ] {
            let said = parse(text, Path::new("s.csv")).unwrap_err().to_string();
            assert!(said.starts_with(place), "{said}");
        }
    }

    #[test]
    fn only_what_is_tracked_is_held_to_its_word() {
        let truth: Vec<_> = (0..200).map(|k| estimate(k, State::Tracked, 0.01)).collect();
        let poses = |all: &[Estimate]| Trajectory {
            poses: all.iter().map(|e| (e.time, e.world_from_body)).collect(),
        };
        let mut ours = truth.clone();
        // Provisional poses that are far off, and one tracked pose that is five deviations off.
        for e in &mut ours[..40] {
            (e.state, e.world_from_body.translation.z) = (State::FindingDepth, 3.0);
        }
        ours[120].world_from_body.translation.x += 0.05;
        let (estimate, truth) = (poses(&ours), poses(&truth));
        let found = trust(&estimate, &read_back(&ours), &truth, Align::Se3, true).unwrap();
        assert_eq!((found.frames, found.tracked, found.evaluation.matched), (200, 160, 160));
        assert!(
            found.evaluation.ate_max_m < 0.051 && found.evaluation.ate_rmse_m < 0.01,
            "{}",
            found.evaluation.ate_rmse_m
        );
        assert!((found.worst.0 - 5.0).abs() < 0.1 && found.worst.1 == ours[120].time, "{:?}", found.worst);
        assert_eq!(found.within_three, 159.0 / 160.0);
        // A truth with fewer poses than the estimate: pairs have its times.
        let sparse = Trajectory { poses: truth.poses.iter().step_by(7).copied().collect() };
        let found = trust(&estimate, &read_back(&ours), &sparse, Align::Se3, true).unwrap();
        assert_eq!((found.evaluation.matched, found.within_three), (23, 1.0));
        // States of another run.
        let mut other = ours.clone();
        other.iter_mut().for_each(|e| e.time = Timestamp::from_nanos(e.time.as_nanos() + 1));
        let said = trust(&estimate, &read_back(&other), &truth, Align::Se3, true).unwrap_err().to_string();
        assert!(said.contains("none of 200 at the times of 200 poses"), "{said}");
        // Nothing tracked.
        ours.iter_mut().for_each(|e| e.state = State::Lost);
        assert!(trust(&estimate, &read_back(&ours), &truth, Align::Se3, true).is_err());
    }

    proptest! {
        #[test]
        fn damaged_tables_never_panic(text in "[-0-9.,a-zNI#\n]{0,300}") {
            let _ = parse(&text, Path::new("t"));
        }
    }
}
