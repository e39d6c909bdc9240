//! `vergence slam eval`: how far an estimated trajectory is from the true one.

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use serde_json::json;
use vergence_report::{Axis, Plot, Point, Series, Style};
use vergence_slam::dataset::Dataset;
use vergence_slam::evaluate::{Align, Evaluation, Relative, evaluate};
use vergence_slam::trajectory::Trajectory;

use crate::failure::Failure;

/// Errors of a trajectory: absolute (ATE), over 1 s and 5 s (RPE, all pairs), scale, coverage, jitter at rest; as `evo` has them
#[derive(clap::Args)]
pub struct Args {
    /// The estimate, TUM format (`t x y z qx qy qz qw`)
    estimate: PathBuf,
    /// The truth: TUM format, EuRoC's truth table, or a recording's folder (EuRoC, 7-Scenes) that has one
    truth: PathBuf,
    /// What may be moved before the error is taken
    #[arg(long, value_enum, default_value_t = Moved::Se3)]
    align: Moved,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
    /// Draws both from above (or from where the most is to be seen) into an SVG
    #[arg(short, long, value_name = "PLOT.svg")]
    output: Option<PathBuf>,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Moved {
    /// Turned and shifted
    Se3,
    /// Turned, shifted and scaled: one camera alone has no scale
    Sim3,
    /// Nothing
    None,
}

impl Args {
    /// Reads both, compares, prints, draws.
    pub fn run(self) -> Result<(), Failure> {
        let failed = |error: vergence_slam::Error| Failure::work(&error);
        let truth_file = truth_in(&self.truth);
        if let Some(output) = &self.output {
            Failure::unless_own("--output", output, &[self.estimate.clone(), truth_file.clone()])?;
        }
        let estimate = Trajectory::read(&self.estimate).map_err(failed)?;
        let truth = if truth_file.is_dir() {
            let nothing = || Failure::Work(format!("{}: expected a truth, found none", truth_file.display()));
            Dataset::open(&truth_file).map_err(failed)?.truth.ok_or_else(nothing)?
        } else {
            Trajectory::read(&truth_file).map_err(failed)?
        };
        let align = match self.align {
            Moved::Se3 => Align::Se3,
            Moved::Sim3 => Align::Sim3,
            Moved::None => Align::None,
        };
        let found = evaluate(&estimate, &truth, align).map_err(failed)?;
        if let Some(path) = &self.output {
            let svg = plot(&found).to_svg().map_err(|error| Failure::work(&error))?;
            std::fs::write(path, svg)
                .map_err(|error| Failure::Work(format!("{}: {error}", path.display())))?;
        }
        if self.json {
            println!("{}", object(&found));
        } else {
            print(&found);
        }
        Ok(())
    }
}

/// The file itself, or what a recording's folder calls its truth.
fn truth_in(path: &Path) -> PathBuf {
    let tables = ["mav0/state_groundtruth_estimate0/data.csv", "state_groundtruth_estimate0/data.csv"];
    let named = tables.iter().chain(&["truth.tum", "gt_tum.txt"]).map(|name| path.join(name));
    named.into_iter().find(|file| file.is_file()).unwrap_or_else(|| path.to_owned())
}

fn object(found: &Evaluation) -> serde_json::Value {
    let metres = |relative: Option<Relative>| relative.map(|relative| relative.rmse_m);
    let degrees = |relative: Option<Relative>| relative.map(|relative| relative.rmse_rad.to_degrees());
    json!({
        "ate_rmse_m": found.ate_rmse_m,
        "ate_max_m": found.ate_max_m,
        "rpe_1s_m": metres(found.rpe_1s),
        "rpe_5s_m": metres(found.rpe_5s),
        "rpe_1s_deg": degrees(found.rpe_1s),
        "rpe_5s_deg": degrees(found.rpe_5s),
        "rpe_1s_frames": found.rpe_1s.map(|relative| relative.frames),
        "scale": found.scale,
        "coverage": found.coverage,
        "matched": found.matched,
        "rest_s": found.rest.map(|rest| rest.span.as_secs_f64()),
        "rest_jitter_m": found.rest.map(|rest| rest.jitter_m),
        "rest_drift_m": found.rest.map(|rest| rest.drift_m),
    })
}

fn print(found: &Evaluation) {
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
            None => println!("{name}          - (the match is shorter)"),
        }
    }
    println!("scale         {:9.4}", found.scale);
    println!("coverage      {:9.4} ({} poses matched)", found.coverage, found.matched);
    if let Some(rest) = found.rest {
        println!(
            "at rest       {:9.4} m jitter rms, {:.4} m drift ({:.1} s)",
            rest.jitter_m,
            rest.drift_m,
            rest.span.as_secs_f64()
        );
    }
}

/// Both trajectories along the two axes of the truth's world in which it moves most.
fn plot(found: &Evaluation) -> Plot {
    let places = || found.pairs.iter().map(|pair| pair.2.translation.vector);
    let count = found.pairs.len().max(1) as f64;
    let mean = places().sum::<Vector3<f64>>() / count;
    let spread = places().map(|p| (p - mean).component_mul(&(p - mean))).sum::<Vector3<f64>>();
    let least = spread.imin();
    let (a, b) = [(1, 2), (0, 2), (0, 1)][least];
    let (t0, names) = (found.pairs.first().map_or(0, |pair| pair.0.as_nanos()), ["x (m)", "y (m)", "z (m)"]);
    let points = |pick: fn(
        &(vergence_time::Timestamp, vergence_geom::Rigid, vergence_geom::Rigid),
    ) -> Vector3<f64>| {
        // More than a thousand points are no better seen.
        let step = found.pairs.len().div_ceil(1000).max(1);
        let point = |pair| {
            let place: Vector3<f64> = pick(pair);
            Point::new(place[a], place[b])
                .with_tooltip(format!("{:.2} s", (pair.0.as_nanos() - t0) as f64 * 1e-9))
        };
        found.pairs.iter().step_by(step).map(point).collect::<Vec<_>>()
    };
    let title = format!("ATE {:.4} m over {} poses", found.ate_rmse_m, found.matched);
    Plot::new(title, Axis::linear(names[a]), Axis::linear(names[b]))
        .with(Series::new("truth", Style::FaintPoints, points(|pair| pair.2.translation.vector)))
        .with(Series::new("estimate", Style::Curve, points(|pair| pair.1.translation.vector)))
}
