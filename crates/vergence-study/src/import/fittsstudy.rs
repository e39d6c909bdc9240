//! FittsStudy (Wobbrock): its table of results (87 columns, one row per trial) and its XML log with every cursor sample.

use std::collections::BTreeMap;

use super::{Imported, number, truth};
use crate::Error;
use crate::convention::Conventions;
use crate::trial::{CursorSample, DataSet, PathMeasures, Point, Trial};

pub(super) fn read(stem: &str, text: &str) -> Result<Imported, Error> {
    if text.trim_start_matches('\u{feff}').trim_start().starts_with('<') {
        xml(stem, text)
    } else {
        table(stem, text)
    }
}

fn condition(a: f64, w: f64, percent: Option<f64>) -> String {
    match percent.filter(|percent| *percent > 0.0) {
        Some(percent) => format!("A{a}-W{w}-MT{percent}"),
        None => format!("A{a}-W{w}"),
    }
}

fn table(stem: &str, text: &str) -> Result<Imported, Error> {
    let mut header: Option<BTreeMap<&str, usize>> = None;
    let mut width = 0;
    let mut trials = Vec::new();
    let mut circular = true;
    for (i, row) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        let line = i as u64 + 1;
        let cells: Vec<&str> = row.trim_end().split(',').map(str::trim).collect();
        let Some(places) = &header else {
            if cells.contains(&"Circular?") && cells.contains(&"StartX") {
                width = cells.len();
                header = Some(cells.iter().enumerate().map(|(i, name)| (*name, i)).collect());
            }
            continue;
        };
        if row.trim().is_empty() {
            continue;
        }
        if cells.len() != width {
            return Err(Error::Row { line, expected: width, found: cells.len() });
        }
        let cell = |name: &'static str| {
            places.get(name).map(|i| cells[*i]).ok_or(Error::Missing { line, column: name.to_owned() })
        };
        let value = |name: &'static str| number(cell(name)?, name, line);
        let flag = |name: &'static str| truth(cell(name)?, name, line);
        let optional = |name: &'static str| -> Option<f64> { value(name).ok() };
        circular = flag("Circular?")?;
        let (a, w) = (value("A")?, value("W")?);
        let percent = optional("MT%");
        let block = cell("Block")?.to_owned();
        let name = condition(a, w, percent);
        // The same sizes may come twice in a block; FittsStudy keeps them apart by the condition's number.
        let number_of = cell("Condition")?.to_owned();
        let index = value("Trial")?.max(1.0) as u32 - 1;
        let to = [value("TargetX")?, value("TargetY")?, 0.0];
        let measured = PathMeasures {
            tre: optional("Entries").map(|entries| (entries - 1.0).max(0.0)),
            tac: optional("TAC"),
            mdc: optional("MDC"),
            odc: optional("ODC"),
            mv: optional("MV"),
            me: optional("ME"),
            mo: optional("MO"),
            submovements: optional("Submovements"),
            overshoots: optional("Overshoots"),
        };
        trials.push(Trial {
            participant: cell("Subject")?.to_owned(),
            session: stem.to_owned(),
            block,
            condition: name,
            instruction: percent.filter(|p| *p > 0.0).map(|p| format!("metronome {p}")),
            factors: BTreeMap::from([("condition_number".to_owned(), number_of)]),
            index,
            practice: flag("Practice?")?,
            attempt: 0,
            repeated: false,
            amplitude: Some(a),
            width: Some(w),
            from: None,
            to,
            start: Some([value("StartX")?, value("StartY")?, 0.0]),
            end: [value("EndX")?, value("EndY")?, 0.0],
            mt_s: value("MTe")? * 1e-3,
            error: Some(flag("Error?")?),
            samples: Vec::new(),
            measured: Some(measured),
            spatial_outlier: Some(flag("SpatialOutlier?")?),
            temporal_outlier: Some(flag("TemporalOutlier?")?),
        });
    }
    if header.is_none() {
        return Err(Error::Header {
            expected: "FittsStudy's columns (Subject,Circular?,Block,…,StartX,…)"
        });
    }
    finished(trials, circular)
}

fn finished(trials: Vec<Trial>, circular: bool) -> Result<Imported, Error> {
    if trials.is_empty() {
        return Err(Error::Empty { what: "trials" });
    }
    let dimensions = if circular { 2 } else { 1 };
    let trials = separated(trials);
    let data = DataSet { length_unit: "px".to_owned(), dimensions, trials };
    Ok(Imported { data, conventions: Conventions::fittsstudy(), warnings: Vec::new() })
}

/// Where one block holds two conditions of the same sizes, the later ones get a number: FittsStudy analyses them apart.
fn separated(mut trials: Vec<Trial>) -> Vec<Trial> {
    let mut numbers: BTreeMap<(String, String), Vec<String>> = BTreeMap::new();
    for trial in &mut trials {
        let number = trial.factors.remove("condition_number").unwrap_or_default();
        let known = numbers.entry((trial.block.clone(), trial.condition.clone())).or_default();
        let place = known.iter().position(|own| *own == number).unwrap_or_else(|| {
            known.push(number);
            known.len() - 1
        });
        if place > 0 {
            trial.condition = format!("{}-{}", trial.condition, place + 1);
        }
    }
    trials
}

/// The numbers in `{X=1, Y=2, Time=3}`, in order.
fn numbers<const N: usize>(text: &str, what: &str, line: u64) -> Result<[f64; N], Error> {
    let found: Vec<f64> = text
        .split(['{', '}', ',', '='])
        .filter_map(|part| part.trim().parse::<f64>().ok())
        .filter(|value| value.is_finite())
        .collect();
    found.try_into().map_err(|_| Error::Cell {
        line,
        column: what.to_owned(),
        expected: "numbers as in {X=1, Y=2, …}",
        found: text.chars().take(60).collect(),
    })
}

/// One start tag: its name and attributes. The log has no text, no entities beyond quotes and no comments inside tags.
struct Tag<'a> {
    name: &'a str,
    attributes: BTreeMap<&'a str, &'a str>,
    line: u64,
}

impl<'a> Tag<'a> {
    fn get(&self, name: &str) -> Result<&'a str, Error> {
        let found = self.attributes.get(name).copied();
        found.ok_or_else(|| Error::Missing { line: self.line, column: name.to_owned() })
    }

    fn value(&self, name: &str) -> Result<f64, Error> {
        number(self.get(name)?, name, self.line)
    }

    fn flag(&self, name: &str) -> Result<bool, Error> {
        truth(self.get(name)?, name, self.line)
    }
}

/// The start tags of a document, in order.
fn tags(text: &str) -> impl Iterator<Item = Result<Tag<'_>, Error>> {
    let mut rest = text;
    let mut line = 1u64;
    let mut lines_in = move |part: &str| {
        line += part.matches('\n').count() as u64;
        line
    };
    std::iter::from_fn(move || {
        loop {
            let open = rest.find('<')?;
            let at = lines_in(&rest[..open]);
            rest = &rest[open + 1..];
            // A quoted '>' is part of its attribute.
            let mut quoted = false;
            let Some(close) = rest.find(|c: char| {
                quoted ^= c == '"';
                c == '>' && !quoted
            }) else {
                rest = "";
                return Some(Err(Error::Xml { line: at, expected: "the end of a tag" }));
            };
            let inner = &rest[..close];
            lines_in(inner);
            rest = &rest[close + 1..];
            if inner.starts_with(['?', '!', '/']) {
                continue;
            }
            let inner = inner.trim_end_matches('/');
            let (name, mut tail) = inner.split_once(char::is_whitespace).unwrap_or((inner, ""));
            let mut attributes = BTreeMap::new();
            while let Some((key, after)) = tail.split_once("=\"") {
                let Some((value, next)) = after.split_once('"') else {
                    return Some(Err(Error::Xml { line: at, expected: "the end of an attribute" }));
                };
                attributes.insert(key.trim(), value);
                tail = next;
            }
            return Some(Ok(Tag { name, attributes, line: at }));
        }
    })
}

fn xml(stem: &str, text: &str) -> Result<Imported, Error> {
    let mut subject = None;
    let mut circular = true;
    let mut current = None;
    let mut trials: Vec<Trial> = Vec::new();
    for tag in tags(text) {
        let tag = tag?;
        match tag.name {
            "Fitts_Study" => subject = Some(tag.get("subject")?.to_owned()),
            "Condition" => {
                circular = tag.flag("circular")?;
                let percent = tag.value("MTPct").ok();
                let name = condition(tag.value("A")?, tag.value("W")?, percent);
                current = Some((
                    tag.get("block")?.to_owned(),
                    tag.get("index")?.to_owned(),
                    name,
                    percent,
                    tag.value("A")?,
                    tag.value("W")?,
                ));
            }
            "Trial" => {
                let Some((block, number_of, name, percent, a, w)) = &current else {
                    return Err(Error::Xml {
                        line: tag.line,
                        expected: "a <Condition> before the first <Trial>",
                    });
                };
                if !tag.flag("completed").unwrap_or(true) {
                    continue;
                }
                let [sx, sy, st] = numbers(tag.get("start")?, "start", tag.line)?;
                let [ex, ey, et] = numbers(tag.get("end")?, "end", tag.line)?;
                let (from, to): (Point, Point) = if circular {
                    let [x0, y0, _] = numbers(tag.get("lastCircle")?, "lastCircle", tag.line)?;
                    let [x1, y1, _] = numbers(tag.get("thisCircle")?, "thisCircle", tag.line)?;
                    ([x0, y0, 0.0], [x1, y1, 0.0])
                } else {
                    // Ribbons: only x matters, so the axis is level.
                    let [x0, _, w0, _] = numbers(tag.get("lastRect")?, "lastRect", tag.line)?;
                    let [x1, _, w1, _] = numbers(tag.get("thisRect")?, "thisRect", tag.line)?;
                    ([x0 + 0.5 * w0, sy, 0.0], [x1 + 0.5 * w1, sy, 0.0])
                };
                trials.push(Trial {
                    participant: subject.clone().unwrap_or_default(),
                    session: stem.to_owned(),
                    block: block.clone(),
                    condition: name.clone(),
                    instruction: percent.filter(|p| *p > 0.0).map(|p| format!("metronome {p}")),
                    factors: BTreeMap::from([("condition_number".to_owned(), number_of.clone())]),
                    index: tag.value("number")?.max(1.0) as u32 - 1,
                    practice: tag.flag("practice")?,
                    attempt: 0,
                    repeated: false,
                    amplitude: Some(*a),
                    width: Some(*w),
                    from: Some(from),
                    to,
                    start: Some([sx, sy, 0.0]),
                    end: [ex, ey, 0.0],
                    mt_s: (et - st) * 1e-3,
                    error: Some(tag.flag("error")?),
                    samples: Vec::new(),
                    measured: None,
                    spatial_outlier: tag.flag("spatialOutlier").ok(),
                    temporal_outlier: tag.flag("temporalOutlier").ok(),
                });
            }
            "move" => {
                let Some(trial) = trials.last_mut() else { continue };
                let [x, y, t] = numbers(tag.get("point")?, "point", tag.line)?;
                let sample = CursorSample { t_s: t * 1e-3, position: [x, y, 0.0] };
                // FittsStudy keeps the last of several samples at one place.
                match trial.samples.last_mut() {
                    Some(last) if *last == sample => *last = sample,
                    _ => trial.samples.push(sample),
                }
            }
            _ => {}
        }
    }
    if subject.is_none() {
        return Err(Error::Header { expected: "<Fitts_Study subject=…>" });
    }
    finished(trials, circular)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const XML: &str = r#"<?xml version="1.0"?>
<Fitts_Study subject="7" circular="true" conditions="1">
 <Condition block="0" index="0" circular="true" MTPct="-1" A="100" W="10">
  <Trial number="1" practice="false" completed="true" lastCircle="{X=0, Y=0, Radius=5}" thisCircle="{X=100, Y=0, Radius=5}"
    error="false" spatialOutlier="false" temporalOutlier="false" start="{X=1, Y=1, Time=0}" end="{X=99.5, Y=2, Time=640}">
   <Movement count="2"><move index="0" point="{X=1, Y=1, Time=0}" /><move index="1" point="{X=99.5, Y=2, Time=630}" /></Movement>
  </Trial>
 </Condition>
</Fitts_Study>"#;

    #[test]
    fn a_log_becomes_trials() {
        let imported = read("s", XML).unwrap();
        let trial = &imported.data.trials[0];
        assert_eq!(
            (trial.participant.as_str(), trial.condition.as_str(), trial.mt_s),
            ("7", "A100-W10", 0.64)
        );
        assert_eq!((trial.end, trial.samples.len(), trial.from), ([99.5, 2.0, 0.0], 2, Some([0.0; 3])));
        let error = read("s", &XML.replace("{X=1, Y=1, Time=0}\" end", "{X=1, Y=1}\" end")).unwrap_err();
        assert!(error.to_string().starts_with("line 4, column \"start\": "), "{error}");
        let error = read("s", "<Fitts_Study subject=\"1\"><Condition").unwrap_err();
        assert!(error.to_string().contains("the end of a tag"), "{error}");
    }

    proptest! {
        #[test]
        fn damage_is_an_error_and_no_panic(at in 0usize..700, byte in 0u8..128) {
            let mut text = XML.as_bytes().to_vec();
            let at = at % text.len();
            text[at] = byte;
            let text = String::from_utf8(text).unwrap();
            let _ = read("s", &text);
            let _ = read("s", &text[..at]);
        }
    }
}
