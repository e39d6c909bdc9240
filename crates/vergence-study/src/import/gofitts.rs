//! GoFitts and FittsTaskTwo (MacKenzie): the trace file (.sd3), three lines (t=, x=, y=) per trial, in pixels and
//! milliseconds. The last sample of a trace is the selection.

use std::collections::BTreeMap;

use super::{Imported, number};
use crate::Error;
use crate::convention::Conventions;
use crate::trial::{CursorSample, DataSet, Trial};

pub(super) fn read(stem: &str, text: &str) -> Result<Imported, Error> {
    let mut header: Option<Vec<&str>> = None;
    let mut trials: Vec<Trial> = Vec::new();
    let mut columns: [Vec<f64>; 3] = Default::default();
    for (i, row) in text.lines().enumerate() {
        let line = i as u64 + 1;
        let cells: Vec<&str> = row.trim().trim_end_matches(',').split(',').map(str::trim).collect();
        let Some(names) = &header else {
            if cells.contains(&"from_x") {
                header = Some(cells.into_iter().filter(|name| !name.starts_with('{')).collect());
            }
            continue;
        };
        if cells == [""] {
            continue;
        }
        if cells.len() <= names.len() {
            return Err(Error::Row { line, expected: names.len() + 1, found: cells.len() });
        }
        let place = |name: &str| names.iter().position(|own| *own == name);
        let text_of = |name: &str| place(name).map_or("", |i| cells[i]);
        let value = |name: &str| -> Result<f64, Error> {
            let i = place(name).ok_or_else(|| Error::Missing { line, column: name.to_owned() })?;
            number(cells[i], name, line)
        };
        let axis = match cells[names.len()] {
            "t=" => 0,
            "x=" => 1,
            "y=" => 2,
            other => {
                let found = other.chars().take(40).collect();
                return Err(Error::Cell {
                    line,
                    column: "trace".to_owned(),
                    expected: "t=, x= or y=",
                    found,
                });
            }
        };
        let values = cells[names.len() + 1..].iter().map(|cell| number(cell, "trace", line));
        columns[axis] = values.collect::<Result<_, _>>()?;
        if axis < 2 {
            continue;
        }
        let [t, x, y] = std::mem::take(&mut columns);
        if t.len() != x.len() || x.len() != y.len() || t.is_empty() {
            return Err(Error::Row { line, expected: t.len(), found: y.len().min(x.len()) });
        }
        let samples = t.iter().zip(&x).zip(&y);
        let samples: Vec<CursorSample> =
            samples.map(|((t, x), y)| CursorSample { t_s: t * 1e-3, position: [*x, *y, 0.0] }).collect();
        let (first, last) = (samples[0], samples[samples.len() - 1]);
        let (a, w) = (value("A")?, value("W")?);
        let (from, to) = ([value("from_x")?, value("from_y")?, 0.0], [value("to_x")?, value("to_y")?, 0.0]);
        let off = (last.position[0] - to[0]).hypot(last.position[1] - to[1]);
        let session = match text_of("Session") {
            "" => stem.to_owned(),
            session => session.to_owned(),
        };
        let mut factors = BTreeMap::new();
        for name in ["Condition", "Group", "TaskType", "SelectionMethod", "InteractionMethod"] {
            if !text_of(name).is_empty() {
                factors.insert(name.to_lowercase(), text_of(name).to_owned());
            }
        }
        let prefix = match text_of("Condition") {
            "" => String::new(),
            name => format!("{name}-"),
        };
        trials.push(Trial {
            participant: text_of("Participant").to_owned(),
            session,
            block: text_of("Block").to_owned(),
            condition: format!("{prefix}A{a}-W{w}"),
            factors,
            index: value("Trial")?.max(1.0) as u32 - 1,
            amplitude: Some(a),
            width: Some(w),
            from: Some(from),
            to,
            start: Some(first.position),
            end: last.position,
            mt_s: last.t_s,
            // The tool counts a pixel beyond the edge as a hit.
            error: off > 0.5 * w + 1.0,
            samples,
            ..Trial::default()
        });
    }
    if header.is_none() {
        return Err(Error::Header {
            expected: "GoFitts' trace columns (…,from_x,from_y,to_x,to_y,{t_x_y})"
        });
    }
    if trials.is_empty() {
        return Err(Error::Empty { what: "trials" });
    }
    // FittsTaskTwo writes a sequence's traces once for each of its trials.
    let mut seen = std::collections::BTreeSet::new();
    let before = trials.len();
    trials.retain(|t| {
        seen.insert((
            t.participant.clone(),
            t.session.clone(),
            t.block.clone(),
            t.condition.clone(),
            t.index,
            t.end.map(f64::to_bits),
        ))
    });
    let copies = before - trials.len();
    let warnings =
        (copies > 0).then(|| format!("{copies} traces were there more than once and are counted once"));
    let data = DataSet { length_unit: "px".to_owned(), dimensions: 2, trials };
    Ok(Imported { data, conventions: Conventions::gofitts(), warnings: warnings.into_iter().collect() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn traces_become_trials() {
        let lead = "GoFitts,P1,C1,S1,G1,T,M,B1,1,100,10,1,0,0,100,0,";
        let text = format!(
            "TRACE DATA\nApp,Participant,Condition,Session,Group,TaskType,SelectionMethod,Block,Sequence,A,W,Trial,from_x,from_y,to_x,to_y,{{t_x_y}}\n{lead}t=,0,10,600,\n{lead}x=,0,50,104,\n{lead}y=,0,2,1,\n"
        );
        let imported = read("f", &text).unwrap();
        let trial = &imported.data.trials[0];
        assert_eq!(
            (trial.mt_s, trial.end, trial.error, trial.samples.len()),
            (0.6, [104.0, 1.0, 0.0], false, 3)
        );
        assert_eq!(trial.condition, "C1-A100-W10");
        assert!(read("f", &text.replace("y=,0,2,1,", "y=,0,2,")).is_err());
        assert!(read("f", "x").is_err());
    }
}
