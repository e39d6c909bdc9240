//! `vergence slam eval`: how far an estimated trajectory is from the true one.

use std::path::PathBuf;

use nalgebra::Vector3;
use serde_json::json;
use vergence_geom::Rigid;
use vergence_report::{Axis, Plot, Point, Series, Style};
use vergence_slam::State;
use vergence_slam::evaluate::{Align, Evaluation, Relative, Whose, evaluate, evaluate_places, reordered};
use vergence_slam::states::{self, Judgement, Trust, trust};
use vergence_slam::trajectory::Rotations;
use vergence_time::Timestamp;

use crate::failure::Failure;
use crate::slam::poses::{Poses, Role};

/// Errors of a trajectory: absolute (ATE), over 1 s and 5 s (RPE, all pairs), scale, coverage, jitter at rest; as `evo` has them
#[derive(clap::Args)]
pub struct Args {
    /// The estimate: TUM format (`t x y z qx qy qz qw`; times in seconds, or whole nanoseconds), or a session log with a stream of poses
    estimate: PathBuf,
    /// The truth: TUM format, EuRoC's truth table (nanoseconds, commas, w first), positions alone (`t x y z`), a recording's folder
    /// (EuRoC, 7-Scenes) that has one, or a session log with a stream /truth
    truth: PathBuf,
    /// What may be moved before the error is taken
    #[arg(long, value_enum, default_value_t = Moved::Se3)]
    align: Moved,
    /// What `slam run --states` wrote beside the estimate: tracked poses alone, too, and whether they keep their standard deviations
    #[arg(long, value_name = "F.csv")]
    states: Option<PathBuf>,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
    /// Draws both from above (or from where the most is to be seen), and below it the error over time, into an SVG
    #[arg(short, long, value_name = "PLOT.svg")]
    output: Option<PathBuf>,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Moved {
    /// Turned and shifted
    Se3,
    /// Turned, shifted and scaled: one camera alone has no scale
    Sim3,
    /// Nothing
    None,
}

/// A scale that is farther from 1 is a matter of its own.
const OTHER_SIZE: f64 = 0.1;
/// A scale means something where what is left after it is taken out is at most this share of the motion.
const SHAPE: f64 = 0.3;

impl Args {
    /// Reads both, compares, prints, draws.
    pub fn run(self) -> Result<(), Failure> {
        let failed = |error: vergence_slam::Error| Failure::work(&error);
        let read = [Poses::file(&self.estimate), Poses::file(&self.truth)];
        if let Some(output) = &self.output {
            Failure::unless_own("--output", output, &[&read[..], self.states.as_slice()].concat())?;
        }
        let estimate = Poses::read(&self.estimate, Role::Estimate)?;
        let truth = Poses::read(&self.truth, Role::Truth)?;
        let align = match self.align {
            Moved::Se3 => Align::Se3,
            Moved::Sim3 => Align::Sim3,
            Moved::None => Align::None,
        };
        let turned = estimate.is_turned() && truth.is_turned();
        let compare = if turned { evaluate } else { evaluate_places };
        let found = compare(&estimate.trajectory, &truth.trajectory, align).map_err(failed)?;
        let judged = self.states.as_deref().map(states::read).transpose().map_err(failed)?;
        let tracked = judged.as_deref().map(|states| {
            trust(&estimate.trajectory, states, &truth.trajectory, align, turned).map_err(failed)
        });
        let tracked = tracked.transpose()?;
        let warnings = self.doubts(&found, &estimate, &truth, align)?;
        for warning in &warnings {
            eprintln!("vergence: {warning}");
        }
        if let Some(path) = &self.output {
            let svg = Plot::stacked(&plots(&found, judged.as_deref()));
            let svg = svg.map_err(|error| Failure::work(&error))?;
            std::fs::write(path, svg)
                .map_err(|error| Failure::Work(format!("{}: {error}", path.display())))?;
        }
        if self.json {
            println!("{}", object(&found, tracked.as_ref(), &warnings));
        } else {
            print(&found, tracked.as_ref());
        }
        Ok(())
    }

    /// What may be wrong with the question.
    fn doubts(
        &self,
        found: &Evaluation,
        estimate: &Poses,
        truth: &Poses,
        align: Align,
    ) -> Result<Vec<String>, Failure> {
        let mut all = Vec::new();
        let both_turned = estimate.is_turned() && truth.is_turned();
        let read = |poses: &Poses| poses.written.unwrap_or(Rotations::None);
        let order = reordered((&estimate.trajectory, read(estimate)), (&truth.trajectory, read(truth)));
        if let Some(order) = order.filter(|_| both_turned) {
            let of = if order.whose == Whose::Estimate { estimate } else { truth };
            let (is, taken) = match order.as_read {
                Rotations::ScalarFirst => ("last", "first (EuRoC: qw qx qy qz)"),
                _ => ("first", "last (TUM: qx qy qz qw)"),
            };
            all.push(format!(
                "{}: is w the {is} number of its quaternions? It was taken for the {taken}; rotations err by {:.1} deg over 1 s so, and by {:.1} \
                 deg the other way",
                of.from.display(),
                order.as_read_rad.to_degrees(),
                order.reordered_rad.to_degrees()
            ));
        }
        let other_size = found.known_scale().filter(|scale| (scale - 1.0).abs() > OTHER_SIZE);
        if let Some(scale) = other_size.filter(|_| align == Align::Se3) {
            // Where the shape is another, too, its size says little.
            let scaled = evaluate_places(&estimate.trajectory, &truth.trajectory, Align::Sim3);
            let scaled = scaled.map_err(|error| Failure::work(&error))?;
            if scaled.ate_rmse_m < SHAPE * found.spread_m {
                all.push(format!(
                    "the estimate is {:.2} times as large as the truth; one camera alone has no scale: --align sim3 takes it out (ATE {:.4} m)",
                    1.0 / scale,
                    scaled.ate_rmse_m
                ));
            }
        }
        if !both_turned {
            let of = if truth.is_turned() { estimate } else { truth };
            all.push(format!(
                "{}: positions alone, so without relative errors; where they are of another point of the body than the other's, the error has its \
                 swing about it, too",
                of.from.display()
            ));
        }
        Ok(all)
    }
}

fn object(found: &Evaluation, tracked: Option<&Trust>, warnings: &[String]) -> serde_json::Value {
    let metres = |relative: Option<Relative>| relative.map(|relative| relative.rmse_m);
    let degrees = |relative: Option<Relative>| relative.map(|relative| relative.rmse_rad.to_degrees());
    let tracked = tracked.map(|trust| {
        json!({
            "frames": trust.frames,
            State::Tracked.word(): trust.tracked,
            "matched": trust.evaluation.matched,
            "ate_rmse_m": trust.evaluation.ate_rmse_m,
            "ate_max_m": trust.evaluation.ate_max_m,
            "worst_sigmas": trust.worst.0,
            "worst_at_ns": trust.worst.1.as_nanos(),
            "within_3_sigmas": trust.within_three,
        })
    });
    json!({
        "ate_rmse_m": found.ate_rmse_m,
        "ate_max_m": found.ate_max_m,
        "rpe_1s_m": metres(found.rpe_1s),
        "rpe_5s_m": metres(found.rpe_5s),
        "rpe_1s_deg": degrees(found.rpe_1s),
        "rpe_5s_deg": degrees(found.rpe_5s),
        "rpe_1s_frames": found.rpe_1s.map(|relative| relative.frames),
        "scale": found.known_scale(),
        "coverage": found.coverage,
        "matched": found.matched,
        "rest_s": found.rest.map(|rest| rest.span.as_secs_f64()),
        "rest_jitter_m": found.rest.map(|rest| rest.jitter_m),
        "rest_drift_m": found.rest.map(|rest| rest.drift_m),
        "states": tracked,
        "warnings": warnings,
    })
}

fn print(found: &Evaluation, tracked: Option<&Trust>) {
    println!("ATE           {:9.4} m rms, {:.4} m at most", found.ate_rmse_m, found.ate_max_m);
    for (name, relative) in [("RPE over 1 s", found.rpe_1s), ("RPE over 5 s", found.rpe_5s)] {
        match relative {
            Some(r) => println!(
                "{name}  {:9.4} m, {:.3} deg rms ({} pairs, {} frames apart)",
                r.rmse_m,
                r.rmse_rad.to_degrees(),
                r.pairs,
                r.frames
            ),
            None => println!("{name}          - (the match is shorter, or there are no rotations)"),
        }
    }
    match found.known_scale() {
        Some(scale) => println!("scale         {scale:9.4}"),
        None => println!("scale                 - (the truth hardly moves)"),
    }
    println!("coverage      {:9.4} ({} poses matched)", found.coverage, found.matched);
    if let Some(rest) = found.rest {
        println!(
            "at rest       {:9.4} m jitter rms, {:.4} m drift ({:.1} s)",
            rest.jitter_m,
            rest.drift_m,
            rest.span.as_secs_f64()
        );
    }
    if let Some(trust) = tracked {
        let evaluation = &trust.evaluation;
        println!(
            "tracked       {:9.4} m rms, {:.4} m at most: {} of {} frames, aligned for themselves",
            evaluation.ate_rmse_m, evaluation.ate_max_m, trust.tracked, trust.frames
        );
        let begins = evaluation.pairs.first().map_or(trust.worst.1, |pair| pair.0);
        println!(
            "  their error {:9.2} of their standard deviations at worst (after {:.2} s), {:.1} % within 3",
            trust.worst.0,
            since_s(begins, trust.worst.1),
            trust.within_three * 100.0
        );
    }
}

fn since_s(begins: Timestamp, time: Timestamp) -> f64 {
    time.since(begins).map_or(0.0, vergence_time::Span::as_secs_f64)
}

/// More points than this are no better seen.
const MOST_POINTS: usize = 1000;

type Pair = (Timestamp, Rigid, Rigid);

/// Both trajectories along the two axes of the truth's world in which it moves most; and how far they are apart, over time.
fn plots(found: &Evaluation, states: Option<&[Judgement]>) -> [Plot; 2] {
    let places = || found.pairs.iter().map(|pair| pair.2.translation.vector);
    let count = found.pairs.len().max(1) as f64;
    let mean = places().sum::<Vector3<f64>>() / count;
    let spread = places().map(|p| (p - mean).component_mul(&(p - mean))).sum::<Vector3<f64>>();
    let least = spread.imin();
    let (a, b) = [(1, 2), (0, 2), (0, 1)][least];
    let (begins, names) =
        (found.pairs.first().map_or(Timestamp::default(), |pair| pair.0), ["x (m)", "y (m)", "z (m)"]);
    let step = found.pairs.len().div_ceil(MOST_POINTS).max(1);
    let way = |pick: fn(&Pair) -> &Rigid| -> Vec<Point> {
        let point = |pair: &Pair| {
            let place = pick(pair).translation.vector;
            Point::new(place[a], place[b])
        };
        found.pairs.iter().step_by(step).map(point).collect()
    };
    let title = format!("ATE {:.4} m over {} poses", found.ate_rmse_m, found.matched);
    let map = Plot::new(title, Axis::linear(names[a]), Axis::linear(names[b]))
        .with(Series::new("truth", Style::Curve, way(|pair| &pair.2)))
        .with(Series::new("estimate", Style::Path, way(|pair| &pair.1)))
        .as_map();
    let at = |time: Timestamp| since_s(begins, time);
    // Of the poses in each step, the one that errs most.
    let worst = found.pairs.chunks(step).filter_map(|pairs| {
        let error = |pair: &Pair| (pair.1.translation.vector - pair.2.translation.vector).norm();
        let found = pairs.iter().max_by(|a, b| error(a).total_cmp(&error(b)))?;
        Some((found.0, error(found)))
    });
    let worst: Vec<(Timestamp, f64)> = worst.collect();
    let highest = worst.iter().map(|point| point.1).fold(0.0, f64::max);
    let last = found.pairs.last().map_or(0.0, |pair| at(pair.0));
    let error = worst.iter().map(|(time, error)| Point::new(at(*time), *error)).collect();
    let (mut bounds, mut untracked) = (Vec::new(), Vec::new());
    if let Some(states) = states {
        // What is far beyond every error says nothing more.
        let most = (3.0 * highest).max(1e-4);
        let within = || states.iter().filter(|state| (0.0..=last).contains(&at(state.time)));
        let bound = |state: &Judgement| Point::new(at(state.time), (3.0 * state.position_sigma_m).min(most));
        bounds = within().step_by(states.len().div_ceil(MOST_POINTS).max(1)).map(bound).collect();
        let marked = within().filter(|state| state.state != State::Tracked);
        untracked =
            marked.map(|state| Point::new(at(state.time), 0.0).with_tooltip(state.state.word())).collect();
    }
    let named =
        |name: &str, points: &[Point]| if points.is_empty() { String::new() } else { name.to_owned() };
    let over_time = Plot::new(
        "Distance from the truth",
        Axis::linear("since the first pose (s)").with_range(0.0, last.max(1e-3)),
        Axis::linear("distance (m)"),
    )
    .with_size(760, 320)
    .with(Series::new(named("three standard deviations (cut off above)", &bounds), Style::Path, bounds))
    .with(Series::new("estimate", Style::Path, error))
    .with(Series::new(named("not tracked", &untracked), Style::FaintPoints, untracked));
    [map, over_time]
}
