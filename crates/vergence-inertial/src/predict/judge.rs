//! How well a method predicts a recording.

use nalgebra::UnitQuaternion;
use vergence_geom::{log, slerp};
use vergence_time::{Span, Timestamp};

use super::Method;
use crate::Recording;
use crate::filter::Filter;

/// A recording as a predictor sees it, and what it is judged by.
#[derive(Clone, Debug, Default)]
pub struct Track {
    /// Ascending.
    pub times: Vec<Timestamp>,
    /// A filter's orientations: world from body.
    pub estimates: Vec<UnitQuaternion<f64>>,
    /// The gyroscope without the filter's bias, rad/s in body axes.
    pub rates_rad_s: Vec<nalgebra::Vector3<f64>>,
    /// The truth where there is one.
    pub truths: Vec<Option<UnitQuaternion<f64>>>,
    /// Whether predictions made at this observation count.
    pub counts: Vec<bool>,
}

/// Angles between prediction and what came true, degrees.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Judgement {
    /// Predictions that were judged.
    pub samples: usize,
    /// Mean.
    pub mean_deg: f64,
    /// 95 of 100 are below.
    pub p95_deg: f64,
    /// Worst.
    pub worst_deg: f64,
}

impl Judgement {
    fn of(mut angles_rad: Vec<f64>) -> Option<Self> {
        angles_rad.sort_by(f64::total_cmp);
        let worst = *angles_rad.last()?;
        let samples = angles_rad.len();
        Some(Self {
            samples,
            mean_deg: (angles_rad.iter().sum::<f64>() / samples as f64).to_degrees(),
            p95_deg: angles_rad[(samples * 95 / 100).min(samples - 1)].to_degrees(),
            worst_deg: worst.to_degrees(),
        })
    }
}

/// The orientation at `time` between observations; `None` beyond the last one, in a gap of more than 50 ms, or where one
/// of the neighbours is missing. `cursor` remembers the place; times ascend from call to call.
fn at(
    times: &[Timestamp],
    value: impl Fn(usize) -> Option<UnitQuaternion<f64>>,
    time: Timestamp,
    cursor: &mut usize,
) -> Option<UnitQuaternion<f64>> {
    while *cursor < times.len() && times[*cursor] < time {
        *cursor += 1;
    }
    let next = *cursor;
    if times.get(next) == Some(&time) {
        return value(next);
    }
    let before = next.checked_sub(1)?;
    let gap = times.get(next)?.since(times[before])?;
    let part = time.since(times[before])?.as_secs_f64() / gap.as_secs_f64();
    (gap <= Span::from_millis(50)).then_some(())?;
    Some(slerp(&value(before)?, &value(next)?, part))
}

/// How one method did at one horizon.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct AtHorizon {
    /// Against what the filter later says itself; `None` where nothing could be judged.
    pub by_estimate: Option<Judgement>,
    /// Against the truth: the way since the prediction was made is compared, so that the filter's own error does not
    /// count. `None` where there is no truth.
    pub by_truth: Option<Judgement>,
}

/// Runs `method` once over `track` and compares its predictions at each of `horizons` with what came true.
pub fn judge(method: Method, track: &Track, horizons: &[Span]) -> Vec<AtHorizon> {
    let mut predictor = method.rotation();
    let mut angles = vec![(Vec::new(), Vec::new()); horizons.len()];
    let mut cursors = vec![(0, 0); horizons.len()];
    for (index, time) in track.times.iter().enumerate() {
        let now = &track.estimates[index];
        predictor.observe(*time, now, &track.rates_rad_s[index]);
        if !track.counts[index] {
            continue;
        }
        for (place, horizon) in horizons.iter().enumerate() {
            let Some(then) = time.checked_add(*horizon) else { continue };
            let Some(predicted) = predictor.predict(then) else { continue };
            let ((by_estimate, by_truth), cursors) = (&mut angles[place], &mut cursors[place]);
            if let Some(estimate) =
                at(&track.times, |k| track.estimates.get(k).copied(), then, &mut cursors.0)
            {
                by_estimate.push(log(&(predicted.inverse() * estimate)).norm());
            }
            let truth_then =
                at(&track.times, |k| track.truths.get(k).copied().flatten(), then, &mut cursors.1);
            if let (Some(truth_now), Some(truth_then)) =
                (track.truths.get(index).copied().flatten(), truth_then)
            {
                let way = now.inverse() * predicted;
                by_truth.push(log(&(way.inverse() * (truth_now.inverse() * truth_then))).norm());
            }
        }
    }
    let judged = |(by_estimate, by_truth)| AtHorizon {
        by_estimate: Judgement::of(by_estimate),
        by_truth: Judgement::of(by_truth),
    };
    angles.into_iter().map(judged).collect()
}

impl Track {
    /// `filter` over `recording`. Predictions count in movement, or, where the recording does not say when that is, after
    /// the first five seconds.
    pub fn of(recording: &Recording, filter: &mut dyn Filter) -> Self {
        let mut track = Self::default();
        let start = recording.samples.first().map(|(at, _)| *at);
        for (index, (at, imu)) in recording.samples.iter().enumerate() {
            filter.update(*at, imu);
            let truth = recording.truth.get(index);
            let settled =
                start.and_then(|start| at.since(start)).is_some_and(|since| since > Span::from_millis(5000));
            track.times.push(*at);
            track.estimates.push(filter.earth_from_sensor());
            track.rates_rad_s.push(imu.gyr_rad_s - filter.gyro_bias_rad_s());
            track.truths.push(truth.and_then(|truth| truth.earth_from_sensor));
            track.counts.push(truth.map_or(settled, |truth| truth.movement));
        }
        track
    }
}
