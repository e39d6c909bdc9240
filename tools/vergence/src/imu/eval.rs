//! `vergence imu eval`: the BROAD score of an estimate.

use std::path::PathBuf;

use serde_json::json;
use vergence_inertial::score;

use super::truth::{self, Truth};
use crate::failure::Failure;

/// Scores orientations against a truth, in degrees (root mean square over the movement)
///
/// Where the estimate has the rows of the recording, each row is scored; else (another rate, other times, a part) every instant of the truth,
/// with the estimate interpolated where its rows are at most 0.25 s apart. Of a trajectory's world only the vertical is known: then
/// the heading counts only after aligning the start.
#[derive(clap::Args)]
pub struct Args {
    /// What `imu run` or another tool wrote: `t_s,qw,qx,qy,qz`, or a trajectory in the TUM format (`t x y z qx qy qz qw`)
    estimate: PathBuf,
    /// A recording with the columns `gt_qw,…` and `movement`, or a log of it; a trajectory in the TUM format, EuRoC's truth (its table or
    /// a folder around it), or orientations `t_s,qw,qx,qy,qz`
    truth: PathBuf,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

impl Args {
    /// Reads both and prints the score.
    pub fn run(self) -> Result<(), Failure> {
        let (estimate, knows_north) = truth::track(&self.estimate)?;
        let truth = Truth::read(&self.truth)?;
        let (pairs, missing) = truth.pairs(&estimate, &self.estimate, &self.truth)?;
        let Some(score) = score(&pairs) else {
            return Err(Failure::Work(format!("{} has no truth during movement", self.truth.display())));
        };
        let rows = [
            ("total_deg", score.total_rad),
            ("heading_deg", score.heading_rad),
            ("inclination_deg", score.inclination_rad),
            ("start_heading_deg", score.start_heading_rad),
            ("start_total_deg", score.start_total_rad),
            ("mean_total_deg", score.mean_total_rad),
        ];
        let absolute = if knows_north && truth.knows_north() { 0 } else { 2 };
        let rows = &rows[absolute..];
        if self.json {
            let mut object = serde_json::Map::new();
            for (name, angle_rad) in rows {
                object.insert((*name).to_owned(), json!(angle_rad.to_degrees()));
            }
            object.insert("samples".to_owned(), json!(score.samples));
            object.insert("without_estimate".to_owned(), json!(missing));
            println!("{}", serde_json::Value::Object(object));
        } else {
            for (name, angle_rad) in rows {
                println!("{name:18} {:8.3}", angle_rad.to_degrees());
            }
            println!("{:18} {:8}", "samples", score.samples);
            if missing > 0 {
                println!("{:18} {missing:8}", "without estimate");
            }
        }
        Ok(())
    }
}
