//! `vergence plan`: what a scene requires, and what is therefore built, requested and opened.

use std::path::PathBuf;

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
        let scene = loading::scene(&self.scene)?;
        let requests = Requests {
            normal_maps: !self.no_normal_maps,
            hand_joints: self.with.contains(&Stream::Hands),
            eye_gaze: self.with.contains(&Stream::Gaze),
        };
        let report = Plan::of(&scene, &requests).report();
        if self.json {
            println!("{}", json!({ "scene": scene.name, "plan": report }));
        } else {
            print!("{}\n{report}", scene.name);
        }
        Ok(())
    }
}
