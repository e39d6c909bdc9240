//! Paths: MacKenzie, Kauppinen and Silfverberg 2001 (TRE, TAC, MDC, ODC, MV, ME, MO), submovements and overshoots. "Beside
//! the axis" is across it in 2D and in an upright plane; where the axis runs in depth it is above or below.

use crate::convention::{Conventions, PathRule};
use crate::measure::ends::{across, axis_of};
use crate::trial::{CursorSample, PathMeasures, Point, Trial};

/// Rate of FittsStudy's resampling, milliseconds per sample.
const STEP_MS: f64 = 10.0;
/// Standard deviation of its Gaussian, samples.
const SIGMA: f64 = 5.0;
/// Half the length of its kernel, samples.
const HALF: usize = 15;

/// The measures of a trial's recorded path; those that the recording tool gave where no path is there. None for fewer
/// than two samples or an axis without length.
/// `dimensions`: in one, targets reach as far across the axis as anybody goes.
pub fn of_path(trial: &Trial, conventions: &Conventions, dimensions: usize) -> Option<PathMeasures> {
    let (origin, along) = axis_of(trial, conventions)?;
    if trial.samples.len() < 2 {
        return trial.measured;
    }
    // Where the axis runs in depth, "beside" it is above and below it, as in the frame of the ends.
    let [beside, _] = across(along, along[2] == 0.0)?;
    let place = |p: Point, direction: Point| (0..3).map(|i| (p[i] - origin[i]) * direction[i]).sum::<f64>();
    let half_width = trial.width.map(|width| 0.5 * width);
    let centre = place(trial.to, along);
    let inside = |sample: &CursorSample| {
        let offset = match dimensions {
            1 => (place(sample.position, along) - centre).powi(2),
            _ => (0..3).map(|i| (sample.position[i] - trial.to[i]).powi(2)).sum(),
        };
        // GoFitts takes the edge for outside.
        let edge = conventions.path != PathRule::GoFitts;
        half_width.is_some_and(|half| offset < half * half || edge && offset == half * half)
    };
    let entries = trial.samples.iter().fold((0u32, false), |(count, was), sample| {
        let is = inside(sample);
        (count + u32::from(is && !was), is)
    });
    let far_side = half_width.map(|half| centre + half);
    let over = far_side.map(|far| {
        let raw = trial.samples.iter().map(|sample| place(sample.position, along) > far);
        raw.fold((0u32, false), |(count, was), is| (count + u32::from(is && !was), is)).0
    });
    if conventions.path == PathRule::GoFitts {
        let measures = as_gofitts(trial, conventions, (origin, along), &inside);
        return Some(PathMeasures { overshoots: over.map(f64::from), ..measures });
    }
    let smoothed;
    let points = match conventions.path {
        PathRule::Thresholds | PathRule::GoFitts => &trial.samples,
        PathRule::Smoothed => {
            smoothed = smooth(&resample(&trial.samples));
            &smoothed
        }
    };
    let x: Vec<f64> = points.iter().map(|sample| place(sample.position, along)).collect();
    let y: Vec<f64> = points.iter().map(|sample| place(sample.position, beside)).collect();
    let n = y.len() as f64;
    let mean = y.iter().sum::<f64>() / n;
    let squares: f64 = y.iter().map(|value| (value - mean).powi(2)).sum();
    let (band, jump) = match conventions.path {
        PathRule::Thresholds | PathRule::GoFitts => (conventions.crossing_band, conventions.turn_jump),
        PathRule::Smoothed => (0.0, 0.0),
    };
    Some(PathMeasures {
        tre: half_width.map(|_| f64::from(entries.0.saturating_sub(1))),
        tac: Some(f64::from(crossings(&y, band))),
        mdc: Some(f64::from(turns(&y, jump))),
        odc: Some(f64::from(turns(&x, jump))),
        mv: (n > 1.0).then(|| (squares / (n - 1.0)).sqrt()),
        me: Some(y.iter().map(|value| value.abs()).sum::<f64>() / n),
        mo: Some(mean),
        submovements: Some(f64::from(submovements(&trial.samples))),
        overshoots: over.map(f64::from),
    })
}

/// The measures by GoFitts' rules (MacKenzie's AccuracyMeasures): see [`PathRule::GoFitts`].
fn as_gofitts(
    trial: &Trial,
    conventions: &Conventions,
    (origin, along): (Point, Point),
    inside: &dyn Fn(&CursorSample) -> bool,
) -> PathMeasures {
    let samples = &trial.samples;
    let entered = runs(samples.iter().map(inside).collect());
    let entries = entered.windows(2).filter(|pair| pair[1].1).count() as u32;
    // The angle of the axis is taken within a quarter turn of the right.
    let right = if along[0] < 0.0 { -1.0 } else { 1.0 };
    let cut = |p: Point| [(p[0] - origin[0]).trunc(), (p[1] - origin[1]).trunc()];
    let turned = samples.iter().map(|sample| {
        let [x, y] = cut(sample.position);
        (x * along[0] + y * along[1], right * (y * along[0] - x * along[1]))
    });
    let (x, y): (Vec<f64>, Vec<f64>) = turned.unzip();
    let jumps = |values: &[f64]| {
        let steps: Vec<bool> = values.windows(2).map(|pair| pair[1] >= pair[0]).collect();
        let last = steps.len().saturating_sub(1);
        let ends = runs(steps);
        let long = ends.windows(2).filter(|pair| {
            let (from, to) = (pair[0].0, pair[1].0);
            to < last && (values[from] - values[to]).abs() > conventions.turn_jump
        });
        long.count() as f64
    };
    // Along the axis it looks the other way where the axis points to the left; which way is up does not matter to turns
    // but for steps of nothing.
    let ahead: Vec<f64> = x.iter().map(|x| -right * x).collect();
    let n = y.len() as f64;
    let mean = y.iter().sum::<f64>() / n;
    let squares: f64 = y.iter().map(|value| (value - mean).powi(2)).sum();
    PathMeasures {
        tre: trial.width.map(|_| f64::from(entries.saturating_sub(1))),
        tac: Some(f64::from(crossings(&y, conventions.crossing_band))),
        mdc: Some(jumps(&y)),
        odc: Some(jumps(&ahead)),
        mv: (n > 1.0).then(|| (squares / (n - 1.0)).sqrt()),
        me: Some(y.iter().map(|value| value.abs()).sum::<f64>() / n),
        mo: Some(mean),
        submovements: Some(f64::from(submovements(samples))),
        overshoots: None,
    }
}

/// Where each run of equal values begins, and its value, after runs of one and then of two inside of others were taken for
/// these, from the first on.
fn runs(mut values: Vec<bool>) -> Vec<(usize, bool)> {
    for length in [1, 2] {
        for i in 0..values.len().saturating_sub(length + 2) {
            let (outer, inner) = (values[i], i + 1..i + 1 + length);
            if values[i + 1 + length] == outer && values[inner.clone()].iter().all(|value| *value != outer) {
                values[inner].fill(outer);
            }
        }
    }
    let mut found: Vec<(usize, bool)> = Vec::new();
    for (i, value) in values.into_iter().enumerate() {
        if found.last().is_none_or(|(_, last)| *last != value) {
            found.push((i, value));
        }
    }
    found
}

/// Changes of side, once beyond `band` on the other one.
fn crossings(y: &[f64], band: f64) -> u32 {
    let mut side = 0.0;
    let mut count = 0;
    for value in y {
        if value.abs() > band {
            if side * value < 0.0 {
                count += 1;
            }
            side = value.signum();
        }
    }
    count
}

/// Changes of direction, where the way back is longer than `jump`.
fn turns(values: &[f64], jump: f64) -> u32 {
    let Some(first) = values.first() else { return 0 };
    let (mut extreme, mut direction, mut count) = (*first, 0.0, 0);
    for value in values {
        let step = value - extreme;
        if direction == 0.0 {
            if step.abs() > jump {
                direction = step.signum();
                extreme = *value;
            }
        } else if step * direction > 0.0 {
            extreme = *value;
        } else if step.abs() > jump {
            count += 1;
            direction = -direction;
            extreme = *value;
        }
    }
    count
}

/// Peaks of the smoothed speed (FittsStudy's rule: resampled at 100 Hz, Gaussian of 5 samples; a plateau counts once).
pub fn submovements(samples: &[CursorSample]) -> u32 {
    let even = resample(samples);
    let mut speed: Vec<f64> = vec![0.0];
    speed.extend(even.windows(2).map(|pair| {
        let distance: f64 = (0..3).map(|i| (pair[1].position[i] - pair[0].position[i]).powi(2)).sum();
        let dt = pair[1].t_s - pair[0].t_s;
        if dt > 0.0 { distance.sqrt() / dt } else { 0.0 }
    }));
    let speed = filtered(&speed);
    speed.windows(3).filter(|w| w[0] < w[1] && w[1] >= w[2]).count() as u32
}

/// One sample every 10 ms by linear interpolation, from the first on.
fn resample(samples: &[CursorSample]) -> Vec<CursorSample> {
    let (Some(first), Some(last)) = (samples.first(), samples.last()) else { return Vec::new() };
    let step = STEP_MS * 1e-3;
    // An hour is no movement: bounds memory where a clock is broken.
    let count = (((last.t_s - first.t_s) / step + 1e-9).floor().clamp(0.0, 360_000.0)) as usize;
    let mut even = Vec::with_capacity(count + 2);
    let mut at = 0;
    for i in 0..=count {
        let t_s = first.t_s + i as f64 * step;
        while at + 2 < samples.len() && samples[at + 1].t_s < t_s {
            at += 1;
        }
        let (a, b) = (samples[at], samples[(at + 1).min(samples.len() - 1)]);
        let share = if b.t_s > a.t_s { ((t_s - a.t_s) / (b.t_s - a.t_s)).clamp(0.0, 1.0) } else { 0.0 };
        let mut position = a.position;
        for (own, other) in position.iter_mut().zip(b.position) {
            *own += share * (other - *own);
        }
        even.push(CursorSample { t_s, position });
    }
    let expected = ((last.t_s - first.t_s) / step - 1e-9).ceil();
    if even.len() as f64 == expected - 1.0 {
        even.push(*last);
    }
    even
}

fn kernel() -> [f64; 2 * HALF + 1] {
    std::array::from_fn(|i| {
        let x = i as f64 - HALF as f64;
        (-x * x / (2.0 * SIGMA * SIGMA)).exp() / ((2.0 * std::f64::consts::PI).sqrt() * SIGMA)
    })
}

/// Convolved; beyond the ends there is nothing.
fn filtered(values: &[f64]) -> Vec<f64> {
    let kernel = kernel();
    (0..values.len())
        .map(|i| {
            let near = i.saturating_sub(HALF)..(i + HALF + 1).min(values.len());
            near.map(|j| values[j] * kernel[j + HALF - i]).sum()
        })
        .collect()
}

/// Positions convolved as FittsStudy does: the ends continue, and the kernel (whose sum is 0.9981) is not normalised, so
/// that a path is drawn towards the origin of the screen by 0.2 %.
fn smooth(samples: &[CursorSample]) -> Vec<CursorSample> {
    let kernel = kernel();
    let last = samples.len() as i64 - 1;
    (0..=last)
        .map(|i| {
            let mut position = [0.0; 3];
            for (k, weight) in kernel.iter().enumerate() {
                let from = samples[(i + k as i64 - HALF as i64).clamp(0, last) as usize];
                position.iter_mut().zip(from.position).for_each(|(own, other)| *own += weight * other);
            }
            CursorSample { t_s: samples[i as usize].t_s, position }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn trial(points: &[(f64, f64)]) -> Trial {
        let samples = points.iter().enumerate();
        let samples =
            samples.map(|(i, (x, y))| CursorSample { t_s: 0.02 * i as f64, position: [*x, *y, 0.0] });
        Trial {
            from: Some([0.0; 3]),
            to: [100.0, 0.0, 0.0],
            width: Some(10.0),
            samples: samples.collect(),
            ..Trial::default()
        }
    }

    #[test]
    fn a_path_counted_by_hand() {
        // Above, below, above the axis; into the target, through it, back; one step back on the way.
        let path =
            [(0.0, 1.0), (30.0, 4.0), (25.0, -2.0), (60.0, -3.0), (97.0, 1.0), (108.0, 0.5), (101.0, 0.0)];
        let m = of_path(&trial(&path), &Conventions::default(), 2).unwrap();
        assert_eq!(
            (m.tre, m.tac, m.mdc, m.odc, m.overshoots),
            (Some(1.0), Some(2.0), Some(3.0), Some(3.0), Some(1.0))
        );
        assert!((m.mo.unwrap() - 1.5 / 7.0).abs() < 1e-12 && (m.me.unwrap() - 11.5 / 7.0).abs() < 1e-12);
        let banded = Conventions { crossing_band: 2.5, turn_jump: 6.0, ..Conventions::default() };
        let m = of_path(&trial(&path), &banded, 2).unwrap();
        assert_eq!((m.tac, m.odc), (Some(1.0), Some(1.0)));
    }

    #[test]
    fn gofitts_counts_by_hand() {
        assert_eq!(runs([1, 0, 1, 1, 0, 0, 1, 0].map(|i| i == 1).to_vec()), [(0, true), (7, false)]);
        // Up 9 (the step back at 12 is none: smoothing goes from the first on), down 11, up 3, down: one turn of y behind a run
        // beyond the jump of 10.
        let y = [0.0, 6.0, 12.0, 8.0, 9.0, 4.0, 1.0, -2.0, -1.0, 0.0, 1.0, 0.0, -1.0, -2.0];
        let path: Vec<(f64, f64)> = y.iter().enumerate().map(|(i, y)| (8.0 * i as f64, *y)).collect();
        let right = of_path(&trial(&path), &Conventions::gofitts(), 2).unwrap();
        assert_eq!(
            (right.mdc, right.odc, right.tac, right.tre),
            (Some(1.0), Some(0.0), Some(0.0), Some(0.0))
        );
        let mean = y.iter().sum::<f64>() / 14.0;
        assert!((right.mo.unwrap() - mean).abs() < 1e-12 && mean > 2.0);
        // To the left, seen from the other side: above is still above.
        let mirrored: Vec<(f64, f64)> = path.iter().map(|(x, y)| (-x, *y)).collect();
        let left = Trial { to: [-100.0, 0.0, 0.0], ..trial(&mirrored) };
        assert!((of_path(&left, &Conventions::gofitts(), 2).unwrap().mo.unwrap() - mean).abs() < 1e-12);
        let nominal = of_path(&left, &Conventions::default(), 2).unwrap();
        assert!((nominal.mo.unwrap() + mean).abs() < 1e-12);
    }

    #[test]
    fn a_ribbon_is_left_along_the_axis_alone() {
        // In, out, in again, 60 beside the middle.
        let path = [(0.0, 60.0), (97.0, 60.0), (108.0, 60.0), (101.0, 60.0)];
        let of = |dimensions| of_path(&trial(&path), &Conventions::default(), dimensions).unwrap().tre;
        assert_eq!((of(1), of(2)), (Some(1.0), Some(0.0)));
    }

    #[test]
    fn a_path_in_depth_has_a_side_too() {
        const HALF: f64 = std::f64::consts::FRAC_1_SQRT_2;
        // The same arc to the right, ahead, and half up: above the axis by as much.
        let of = |turn: fn(f64, f64) -> [f64; 3]| {
            let samples = (0..21).map(|i| {
                let t = f64::from(i) / 20.0;
                CursorSample { t_s: t, position: turn(100.0 * t, 8.0 * t * (1.0 - t)) }
            });
            let t = Trial {
                from: Some([0.0; 3]),
                to: turn(100.0, 0.0),
                width: Some(10.0),
                samples: samples.collect(),
                ..Trial::default()
            };
            of_path(&t, &Conventions::default(), 2).unwrap()
        };
        let right = of(|x, y| [x, y, 0.0]);
        for other in [of(|x, y| [0.0, y, -x]), of(|x, y| [0.0, HALF * (x + y), HALF * (y - x)])] {
            assert!((right.me.unwrap() - other.me.unwrap()).abs() < 1e-12 && right.me > Some(1.0));
            assert!((right.mo.unwrap() - other.mo.unwrap()).abs() < 1e-12, "{right:?} {other:?}");
        }
    }

    #[test]
    fn no_path_no_measures() {
        let one = trial(&[(0.0, 0.0)]);
        assert_eq!(of_path(&one, &Conventions::default(), 2), None);
        let told = PathMeasures { tac: Some(2.0), ..PathMeasures::default() };
        let imported = Trial { measured: Some(told), samples: Vec::new(), ..one };
        assert_eq!(of_path(&imported, &Conventions::default(), 2), Some(told));
        assert_eq!(submovements(&[]), 0);
    }

    #[test]
    fn two_bursts_are_two_submovements() {
        let speed = |t: f64| (-((t - 0.4) / 0.1).powi(2)).exp() + 0.3 * (-((t - 1.2) / 0.1).powi(2)).exp();
        let mut x = 0.0;
        let points: Vec<(f64, f64)> = (0..80)
            .map(|i| {
                x += speed(0.02 * f64::from(i)) * 100.0 * 0.02;
                (x, 0.0)
            })
            .collect();
        assert_eq!(submovements(&trial(&points).samples), 2);
    }

    proptest! {
        #[test]
        fn any_path_has_finite_measures(points in prop::collection::vec((-1e3..1e3f64, -1e3..1e3f64), 0..60), smoothed in any::<bool>()) {
            let conventions = if smoothed { Conventions { path: PathRule::Smoothed, ..Conventions::default() } } else { Conventions::default() };
            if let Some(m) = of_path(&trial(&points), &conventions, 2) {
                for value in m.values().into_iter().flatten() {
                    prop_assert!(value.is_finite());
                }
                prop_assert!(m.me.unwrap() + 1e-9 >= m.mo.unwrap().abs());
            }
        }
    }
}
