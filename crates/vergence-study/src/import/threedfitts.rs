//! 3DFitts (Unity): one JSON per test, positions in metres. Targets are listed in the order of presentation, so trial i
//! goes from target i to target i + 1; the ids in the file say where they stand on the ring.

use std::collections::BTreeMap;

use serde::Deserialize;

use super::Imported;
use crate::Error;
use crate::convention::Conventions;
use crate::trial::{DataSet, Point, Trial};

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct File {
    /// Early versions called it an experiment.
    #[serde(alias = "experiment")]
    test: Option<Test>,
    /// A log of the cursor, beside a test's file.
    frame_data: Option<serde::de::IgnoredAny>,
    #[serde(default)]
    participant_name: Option<String>,
    #[serde(default)]
    device: Option<String>,
    #[serde(default)]
    interaction_technique: Option<String>,
    #[serde(default)]
    plane_orientation: Option<String>,
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
    let Some(Test { configuration, data }) = file.test else {
        // Its clock is not the test's: the path cannot be told from it.
        return Err(if file.frame_data.is_some() {
            Error::Empty { what: "trials (this is a log of the cursor; the test has a file of its own)" }
        } else {
            Error::Header { expected: "a test of 3DFitts ({\"test\": …})" }
        });
    };
    let targets = &configuration.targets_positions;
    if targets.len() < 2 {
        return Err(Error::Empty { what: "targets" });
    }
    let of_test = Some(data.plane_orientation).filter(|plane| !plane.is_empty());
    let plane = of_test.or(file.plane_orientation).filter(|plane| !plane.is_empty());
    let plane = plane.unwrap_or_else(|| "-".to_owned());
    let mut factors = BTreeMap::from([("plane".to_owned(), plane.clone())]);
    for (name, level) in [("device", file.device), ("technique", file.interaction_technique)] {
        factors.extend(level.filter(|level| !level.is_empty()).map(|level| (name.to_owned(), level)));
    }
    let (a, w) = (configuration.target_distance, configuration.target_width);
    let participant = match (data.participant, file.participant_name) {
        (Some(serde_json::Value::String(name)), _) => name,
        (Some(serde_json::Value::Number(number)), _) => number.to_string(),
        (_, Some(name)) if !name.trim().is_empty() => name,
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
                factors: factors.clone(),
                index: one.trial_id,
                amplitude: Some(a),
                width: Some(w),
                from: Some(targets[i].into()),
                to: targets[(i + 1) % targets.len()].into(),
                start: Some(one.initial_position.into()),
                end: one.final_position.into(),
                mt_s: one.trial_duration,
                error: Some(one.missed_target),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_version_is_read() {
        let test = r#"{"configuration": {"targetWidth": 0.02, "targetDistance": 0.2, "targetsPositions": [{"x": 0, "y": 0.1, "z": 0},
            {"x": 0, "y": -0.1}]}, "data": {"timestamp": "now", "blocksData": [{"blockId": 0, "trialsData": [{"trialId": 0,
            "trialDuration": 0.5, "initialPosition": {"x": 0, "y": 0.1, "z": 0}, "finalPosition": {"x": 0, "y": -0.1, "z": 0},
            "missedTarget": false}]}]}}"#;
        let early = read("f", &format!("{{\"experiment\": {test}}}")).unwrap();
        assert_eq!((early.data.trials[0].participant.as_str(), early.data.trials[0].mt_s), ("unknown", 0.5));
        let late = format!(
            "{{\"test\": {test}, \"participantName\": \"P1\", \"device\": \"VIVE\", \"planeOrientation\": \"YZ\"}}"
        );
        let late = read("f", &late).unwrap();
        let trial = &late.data.trials[0];
        assert_eq!((trial.participant.as_str(), trial.condition.as_str()), ("P1", "YZ-A0.2-W0.02"));
        assert_eq!(trial.factors["device"], "VIVE");
        let frames = read("f", r#"{"frameData": [{"Time": 1.0}]}"#).unwrap_err().to_string();
        assert!(frames.contains("a log of the cursor"), "{frames}");
        assert!(read("f", "{}").unwrap_err().to_string().contains("a test of 3DFitts"));
    }
}
