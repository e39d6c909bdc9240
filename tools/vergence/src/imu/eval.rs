//! `vergence imu eval`: the BROAD score of an estimate.

use std::path::PathBuf;

use serde_json::json;
use vergence_inertial::{Error, Recording, read_orientations, score};

use crate::failure::Failure;

/// Scores orientations against the truth of a recording, in degrees (root mean square over the movement)
#[derive(clap::Args)]
pub struct Args {
    /// What `imu run` wrote: `t_s,qw,qx,qy,qz`
    estimate: PathBuf,
    /// The recording with the columns `gt_qw,…` and `movement`
    truth: PathBuf,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

impl Args {
    /// Reads both and prints the score.
    pub fn run(self) -> Result<(), Failure> {
        let failed = |error: Error| Failure::work(&error);
        let estimate = read_orientations(&self.estimate).map_err(failed)?;
        let recording = Recording::read(&self.truth).map_err(failed)?;
        let pairs = recording.scored(&estimate, &self.estimate).map_err(failed)?;
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
        if self.json {
            let mut object = serde_json::Map::new();
            for (name, angle_rad) in rows {
                object.insert(name.to_owned(), json!(angle_rad.to_degrees()));
            }
            object.insert("samples".to_owned(), json!(score.samples));
            println!("{}", serde_json::Value::Object(object));
        } else {
            for (name, angle_rad) in rows {
                println!("{name:18} {:8.3}", angle_rad.to_degrees());
            }
            println!("{:18} {:8}", "samples", score.samples);
        }
        Ok(())
    }
}
