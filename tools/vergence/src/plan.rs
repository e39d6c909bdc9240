//! `vergence plan`: what a scene requires, and what is therefore built, requested and opened.

use std::path::PathBuf;
use std::sync::Arc;

use serde_json::json;
use vergence_plan::{Plan, Requests};

use crate::failure::Failure;
use crate::loading;
use crate::stream::Stream;

/// Says what a scene requires, and what is therefore built, requested and opened
#[derive(clap::Args)]
pub struct Args {
    /// A .glb, .gltf, .obj, .ply or scene .toml
    scene: PathBuf,
    /// Streams to open beyond what the scene needs
    #[arg(long, value_delimiter = ',', value_name = "STREAM")]
    with: Vec<Stream>,
    /// Leaves normal maps out
    #[arg(long)]
    no_normal_maps: bool,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

impl Args {
    /// Makes the plan and prints it.
    pub fn run(self) -> Result<(), Failure> {
        // As a run draws it.
        let scene = vergence_session::with_markers(&Arc::new(loading::scene(&self.scene)?));
        let requests = Requests {
            normal_maps: !self.no_normal_maps,
            hand_joints: self.with.contains(&Stream::Hands),
            eye_gaze: self.with.contains(&Stream::Gaze),
            ..Requests::default()
        };
        let plan = Plan::of(&scene, &requests);
        let report = plan.report();
        let built = vergence_session::cost_of(&scene, &plan);
        if let Err(error) = &built {
            if error.is_wrong_call() {
                return Err(Failure::call(error));
            }
            log::warn!("what is built was not counted: {error}");
        }
        let built = built.ok();
        if self.json {
            println!(
                "{}",
                json!({ "scene": scene.name, "plan": report, "built": built, "warnings": scene.warnings })
            );
        } else {
            print!("{}\n{report}", scene.name);
            if let Some(built) = built {
                print!("{built}");
            }
        }
        Ok(())
    }
}
