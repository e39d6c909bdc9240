//! Where movements ended: effective amplitude and width, along the axis and in all dimensions. One pass, mergeable.

use vergence_stats::{Moments, Spread};

use crate::convention::{Axis, Conventions, Difficulty, Frame, MeanTime, Reach};
use crate::measure::fitts::difficulty;
use crate::trial::{Point, Trial};

/// Spreads below this share of the amplitude are what rounding leaves of equal ends (1e-16 of coordinates that may be a
/// million amplitudes away from their origin), and nobody's: no spread.
const ROUNDING: f64 = 1e-9;

/// The geometry of one end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct End {
    /// Signed distance from the target's centre along the axis: positive beyond it.
    pub dx: f64,
    /// Amplitude along the axis; none where only the end relative to the target is known.
    pub ae: Option<f64>,
    /// Straight amplitude, or the same as `ae` (see [`Reach`]).
    pub ae_xy: Option<f64>,
    /// End relative to the target's centre, in the frame of the convention.
    pub offset: Point,
}

fn minus(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: Point, b: Point) -> Point {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn length(a: Point) -> f64 {
    dot(a, a).sqrt()
}

fn unit(a: Point) -> Option<Point> {
    let length = length(a);
    (length > 0.0 && length.is_finite()).then(|| a.map(|value| value / length))
}

/// The axis of a trial as (origin, unit direction); none where start and target coincide.
pub fn axis_of(trial: &Trial, conventions: &Conventions) -> Option<(Point, Point)> {
    let origin = match conventions.axis {
        Axis::Start => trial.start.or(trial.from)?,
        Axis::Nominal | Axis::Serial => trial.from.or(trial.start)?,
    };
    Some((origin, unit(minus(trial.to, origin))?))
}

/// The end of a trial; `before` is the signed distance by which the movement before it in a serial task ended beyond
/// its target (0 at the start of a sequence). None for an axis without length.
pub fn end_of(trial: &Trial, conventions: &Conventions, before: f64) -> Option<End> {
    let (origin, along) = axis_of(trial, conventions)?;
    let offset = minus(trial.end, trial.to);
    let dx = dot(offset, along);
    // Without both, `from` says where the movement came from and not how far it went.
    let begin = trial.start.or(trial.amplitude.map(|_| origin));
    let ae = begin.map(|begin| match conventions.axis {
        Axis::Nominal => dot(minus(trial.end, begin), along),
        Axis::Start => dot(minus(trial.end, begin), along).abs(),
        Axis::Serial => length(minus(trial.to, origin)) + dx + before,
    });
    let ae_xy = match conventions.reach {
        Reach::Straight => begin.map(|begin| length(minus(trial.end, begin))),
        Reach::Axis => ae,
    };
    let offset = match conventions.frame {
        Frame::World => offset,
        Frame::Task => {
            let [second, third] = across(along, along[2] == 0.0 && offset[2] == 0.0)?;
            [dx, dot(offset, second), dot(offset, third)]
        }
    };
    Some(End { dx, ae, ae_xy, offset })
}

/// The second and the third direction of the frame of an axis. The second lies in the plane of the axis and y (of the axis
/// and x where it runs along y in depth): in 2D, and where the task is `planar`, that is the perpendicular, turned with the
/// axis.
pub(crate) fn across(along: Point, planar: bool) -> Option<[Point; 2]> {
    let third = if planar {
        [0.0, 0.0, 1.0]
    } else {
        unit(cross(along, [0.0, 1.0, 0.0]))
            .filter(|_| length(cross(along, [0.0, 1.0, 0.0])) > 1e-6)
            .or_else(|| unit(cross(along, [1.0, 0.0, 0.0])))?
    };
    Some([cross(third, along), third])
}

/// What one sequence of trials (participant × session × block × condition) amounts to, in one pass.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sequence {
    ends: Moments,
    amplitudes: Moments,
    straight: Moments,
    spread: Spread,
    times: Moments,
    /// Trials that were not practice.
    pub trials: u64,
    /// Those that missed.
    pub errors: u64,
    /// Those of which it is known whether they missed.
    pub judged: u64,
    /// Those left out by the outlier policy.
    pub outliers: u64,
}

impl Sequence {
    /// Adds a trial that is analysed; `end` as far as its geometry has an answer.
    pub fn push(&mut self, end: Option<End>, mt_s: f64) {
        if let Some(end) = end {
            self.ends.push(end.dx);
            end.ae.into_iter().for_each(|ae| self.amplitudes.push(ae));
            end.ae_xy.into_iter().for_each(|ae| self.straight.push(ae));
            self.spread.push(end.offset);
        }
        self.times.push(mt_s);
    }

    /// Counts a trial that was not practice, whether it is analysed or left out.
    pub fn count(&mut self, error: Option<bool>) {
        self.trials += 1;
        self.judged += u64::from(error.is_some());
        self.errors += u64::from(error == Some(true));
    }

    /// As if the trials of `other` had come after ours.
    pub fn merge(&mut self, other: &Self) {
        self.ends.merge(&other.ends);
        self.amplitudes.merge(&other.amplitudes);
        self.straight.merge(&other.straight);
        self.spread.merge(&other.spread);
        self.times.merge(&other.times);
        self.trials += other.trials;
        self.errors += other.errors;
        self.judged += other.judged;
        self.outliers += other.outliers;
    }

    /// Analysed trials.
    pub fn n(&self) -> u64 {
        self.times.n()
    }

    /// The measures.
    pub fn measures(&self, conventions: &Conventions, dimensions: usize) -> Ends {
        let mt_s = self.times.mean().map(|mean| match conventions.mean_time {
            MeanTime::Exact => mean,
            // A mean of whole milliseconds that rounding left below its value is not cut to the one before.
            MeanTime::WholeMs => (mean * 1e3 + 1e-6).floor() / 1e3,
        });
        let effective = |amplitude: Option<f64>, sd: Option<f64>| {
            // Where a tunnel was left is no aim.
            let sd = sd.filter(|_| conventions.difficulty != Difficulty::Steering);
            // Ends that differ by the rounding of their coordinates alone are the same.
            let rounding = amplitude.map_or(0.0, |amplitude: f64| ROUNDING * amplitude.abs());
            let sd = sd.map(|sd| if sd > rounding { sd } else { 0.0 });
            let we = sd.map(|sd| conventions.we_factor * sd);
            let ide = amplitude.zip(we).and_then(|(a, w)| difficulty(conventions.difficulty, a, w));
            let tp = ide.zip(mt_s).filter(|(_, mt)| *mt > 0.0).map(|(ide, mt)| ide / mt);
            Effective { amplitude, sd, we, ide, tp }
        };
        Ends {
            mt_s,
            mt_sd_s: self.times.sd(),
            error_rate: (self.judged > 0).then(|| self.errors as f64 / self.judged as f64),
            x: effective(self.amplitudes.mean(), self.ends.sd()),
            xy: effective(self.straight.mean(), self.spread.sd(dimensions).filter(|_| dimensions > 1)),
            bias: self.ends.mean(),
        }
    }
}

/// Effective measures in one number of dimensions. Each is none for fewer than two trials; difficulty and throughput
/// also where the spread is zero (they would be infinite).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Effective {
    /// Mean amplitude Ae, length unit.
    pub amplitude: Option<f64>,
    /// Spread of the ends (n − 1), length unit.
    pub sd: Option<f64>,
    /// We = factor · SD, length unit.
    pub we: Option<f64>,
    /// IDe = log2(Ae/We + 1), bits.
    pub ide: Option<f64>,
    /// TP = IDe / mean MT, bits/s.
    pub tp: Option<f64>,
}

/// The measures of one sequence.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ends {
    /// Mean movement time, seconds.
    pub mt_s: Option<f64>,
    /// Standard deviation of the movement times, seconds.
    pub mt_sd_s: Option<f64>,
    /// Share of misses among all trials that were not practice; none where it is not known of any whether it missed.
    pub error_rate: Option<f64>,
    /// Along the axis.
    pub x: Effective,
    /// In all dimensions of the task.
    pub xy: Effective,
    /// Mean signed distance from the centre along the axis: over- (positive) or undershoot, length unit.
    pub bias: Option<f64>,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trial(end: Point) -> Trial {
        Trial {
            from: Some([0.0; 3]),
            start: Some([1.0, 1.0, 0.0]),
            to: [10.0, 0.0, 0.0],
            end,
            mt_s: 1.0,
            ..Trial::default()
        }
    }

    #[test]
    fn three_axes() {
        let t = trial([11.0, 2.0, 0.0]);
        let nominal = end_of(&t, &Conventions::default(), 0.0).unwrap();
        assert_eq!((nominal.dx, nominal.ae, nominal.offset), (1.0, Some(10.0), [1.0, 2.0, 0.0]));
        let serial = end_of(&t, &Conventions::gofitts(), 0.5).unwrap();
        assert_eq!((serial.dx, serial.ae), (1.0, Some(11.5)));
        let start = end_of(&t, &Conventions::fittsstudy(), 0.0).unwrap();
        let u = [9.0 / 82f64.sqrt(), -1.0 / 82f64.sqrt()];
        assert!((start.dx - (u[0] - 2.0 * u[1].abs())).abs() < 1e-12, "{start:?}");
        assert!((start.ae_xy.unwrap() - (100f64 + 1.0).sqrt()).abs() < 1e-12);
        let nowhere = Trial { from: Some([3.0; 3]), start: None, to: [3.0; 3], ..t };
        assert_eq!(end_of(&nowhere, &Conventions::default(), 0.0), None);
    }

    #[test]
    fn few_trials_and_no_spread() {
        let conventions = Conventions::default();
        let mut sequence = Sequence::default();
        assert_eq!(sequence.measures(&conventions, 2), Ends::default());
        sequence.push(end_of(&trial([10.0, 0.0, 0.0]), &conventions, 0.0), 0.5);
        let one = sequence.measures(&conventions, 2);
        assert_eq!((one.mt_s, one.x.sd, one.x.tp), (Some(0.5), None, None));
        sequence.push(end_of(&trial([10.0, 0.0, 0.0]), &conventions, 0.0), 0.7);
        let same = sequence.measures(&conventions, 2);
        assert_eq!((same.x.sd, same.x.we, same.x.ide, same.x.tp), (Some(0.0), Some(0.0), None, None));
    }

    #[test]
    fn what_rounding_leaves_of_equal_ends_is_no_spread() {
        let conventions = Conventions::default();
        let mut sequence = Sequence::default();
        for i in 0..11 {
            let angle = 0.7 * f64::from(i);
            let at = |r: f64| [300.0 + r * angle.cos(), 700.0 + r * angle.sin(), 0.0];
            let t = Trial {
                from: Some(at(-50.0)),
                start: Some(at(-50.0)),
                to: at(50.0),
                end: at(53.0),
                mt_s: 0.5,
                ..Trial::default()
            };
            sequence.push(end_of(&t, &conventions, 0.0), 0.5);
        }
        let found = sequence.measures(&conventions, 2);
        assert_eq!((found.x.sd, found.x.tp, found.xy.sd, found.xy.tp), (Some(0.0), None, Some(0.0), None));
    }

    #[test]
    fn where_a_tunnel_was_left_is_no_aim() {
        let conventions = Conventions { difficulty: Difficulty::Steering, ..Conventions::default() };
        let mut sequence = Sequence::default();
        for x in [10.0, 10.1, 10.3] {
            sequence.push(end_of(&trial([x, 0.0, 0.0]), &conventions, 0.0), 0.5);
        }
        let found = sequence.measures(&conventions, 2);
        assert_eq!((found.mt_s, found.x.sd, found.x.tp, found.xy.tp), (Some(0.5), None, None, None));
    }

    #[test]
    fn the_spread_turns_with_the_axis() {
        // Overshoot by one, whatever the direction: the same place in the task's frame, different ones in the world's.
        let conventions = Conventions::default();
        let (mut task, mut world) = (Sequence::default(), Sequence::default());
        for angle in [0.0f64, 1.0, 2.0, 4.0] {
            let at = |r: f64| [r * angle.cos(), r * angle.sin(), 0.0];
            let t = Trial { from: Some([0.0; 3]), to: at(5.0), end: at(6.0), mt_s: 1.0, ..Trial::default() };
            task.push(end_of(&t, &conventions, 0.0), 1.0);
            world.push(end_of(&t, &Conventions::threedfitts(), 0.0), 1.0);
        }
        assert!(task.measures(&conventions, 2).xy.sd.unwrap() < 1e-12);
        assert!(world.measures(&conventions, 2).xy.sd.unwrap() > 0.5);
    }
}
