//! 3DFitts (Unity): one JSON per test, positions in metres. Targets are listed in the order of presentation, so trial i
//! goes from target i to target i + 1; the ids in the file say where they stand on the ring.

use std::collections::BTreeMap;

use serde::Deserialize;

use super::Imported;
use crate::Error;
use crate::convention::Conventions;
use crate::trial::{DataSet, Point, Trial};

#[derive(Deserialize)]
struct File {
    test: Test,
}

#[derive(Deserialize)]
struct Test {
    configuration: Configuration,
    data: Data,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Configuration {
    target_width: f64,
    target_distance: f64,
    targets_positions: Vec<Vector>,
}

#[derive(Clone, Copy, Deserialize)]
struct Vector {
    x: f64,
    y: f64,
    #[serde(default)]
    z: f64,
}

impl From<Vector> for Point {
    fn from(v: Vector) -> Self {
        [v.x, v.y, v.z]
    }
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Data {
    #[serde(default)]
    timestamp: String,
    #[serde(default)]
    participant: Option<serde_json::Value>,
    #[serde(default)]
    plane_orientation: String,
    blocks_data: Vec<Block>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Block {
    block_id: i64,
    trials_data: Vec<One>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct One {
    trial_id: u32,
    trial_duration: f64,
    initial_position: Vector,
    final_position: Vector,
    missed_target: bool,
}

pub(super) fn read(stem: &str, text: &str) -> Result<Imported, Error> {
    let file: File = serde_json::from_str(text.trim_start_matches('\u{feff}'))
        .map_err(|error| Error::Json { line: error.line() as u64, message: error.to_string() })?;
    let Test { configuration, data } = file.test;
    let targets = &configuration.targets_positions;
    if targets.len() < 2 {
        return Err(Error::Empty { what: "targets" });
    }
    let plane = if data.plane_orientation.is_empty() { "-".to_owned() } else { data.plane_orientation };
    let (a, w) = (configuration.target_distance, configuration.target_width);
    // The participant is not in the file; where a later version names one, it is used.
    let participant = match data.participant {
        Some(serde_json::Value::String(name)) => name,
        Some(serde_json::Value::Number(number)) => number.to_string(),
        _ => "unknown".to_owned(),
    };
    let session = if data.timestamp.is_empty() { stem.to_owned() } else { data.timestamp };
    let mut trials = Vec::new();
    for block in data.blocks_data {
        for one in block.trials_data {
            let i = one.trial_id as usize % targets.len();
            trials.push(Trial {
                participant: participant.clone(),
                session: session.clone(),
                block: block.block_id.to_string(),
                condition: format!("{plane}-A{a}-W{w}"),
                factors: BTreeMap::from([("plane".to_owned(), plane.clone())]),
                index: one.trial_id,
                amplitude: Some(a),
                width: Some(w),
                from: Some(targets[i].into()),
                to: targets[(i + 1) % targets.len()].into(),
                start: Some(one.initial_position.into()),
                end: one.final_position.into(),
                mt_s: one.trial_duration,
                error: one.missed_target,
                ..Trial::default()
            });
        }
    }
    if trials.is_empty() {
        return Err(Error::Empty { what: "trials" });
    }
    let data = DataSet { length_unit: "m".to_owned(), dimensions: 3, trials };
    Ok(Imported { data, conventions: Conventions::threedfitts(), warnings: Vec::new() })
}
