//! Loads a scene, hangs a label where the user looks, and runs it on the headset that is there, else the simulated one.

use nalgebra::{Point3, Vector3};
use vergence_geom::{Ray, Trs};
use vergence_scene::model::{Label, Local, Node, WorldTransforms};
use vergence_scene::{Limits, load, pick::Picker};
use vergence_session::{CaptureConfig, Happening, RunConfig, run, start_of};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let file = std::env::args().nth(1).ok_or("usage: greet SCENE")?;
    let mut scene = load(file.as_ref(), &Limits::default())?;

    // What does a user of 1.7 m see straight ahead?
    let world_from_start = start_of(&scene);
    let gaze = Ray {
        origin: world_from_start * Point3::new(0.0, 1.7, 0.0),
        direction: world_from_start.rotation * -Vector3::z_axis(),
    };
    let hit = Picker::new(&scene).pick(&scene, &WorldTransforms::at_rest(&scene), &gaze, 1e3);
    let distance_m = hit.map_or(2.0, |hit| hit.distance_m.min(2.0));

    // A label of 1 degree at 80 % of that distance, facing the user.
    let place = Trs {
        translation: gaze.at(0.8 * distance_m).coords,
        rotation: world_from_start.rotation,
        scale: Vector3::repeat(1.0),
    };
    let cap_height_m = (0.8 * distance_m * 1f64.to_radians().tan()) as f32;
    let text = format!("ahead: {distance_m:.2} m");
    scene.labels.push(Label { text, cap_height_m, color: [1.0; 4], billboard: true });
    let label = Some(scene.labels.len() - 1);
    scene.nodes.push(Node { label, ..Node::at("greeting", Local::Trs(place)) });

    let capture = CaptureConfig { dir: "target/greet".into(), every: None };
    let config = RunConfig { frames: Some(90), capture: Some(capture), ..RunConfig::default() };
    let report = run(&scene.into(), &config, &mut |happening| {
        if let Happening::Said(sentence) = happening {
            eprintln!("{sentence}");
        }
    })?;
    print!("{report}");
    Ok(())
}
