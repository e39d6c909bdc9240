//! GoFitts and FittsTaskTwo (MacKenzie): the trace file (.sd3), three lines (t=, x=, y=) per trial, in pixels and
//! milliseconds, of which the last sample of a trace is the selection; and the file of trials (.sd1), with the tool's own
//! effective amplitudes, deviations along the axis and path measures.

use std::collections::BTreeMap;

use super::{Imported, number};
use crate::Error;
use crate::convention::{Axis, Conventions};
use crate::trial::{CursorSample, DataSet, PathMeasures, Trial};

/// What the columns of an .sd1 begin with, in every version, with a `Row` before it where files were merged.
pub(super) fn is_trials(head: &str) -> bool {
    let first = head.trim_start_matches('\u{feff}').lines().next().unwrap_or("");
    first.trim_start_matches("Row,").starts_with("App,Participant,Condition,") && first.contains(",Ae,dx,")
}

pub(super) fn read(stem: &str, text: &str) -> Result<Imported, Error> {
    if is_trials(text) { table(stem, text) } else { traces(stem, text) }
}

/// The .sd1: Ae and dx as the tool computed them, the correction for serial tasks included in the versions that make it, so
/// that means and throughputs are those of its .sd2.
fn table(stem: &str, text: &str) -> Result<Imported, Error> {
    let mut rows = text.trim_start_matches('\u{feff}').lines().enumerate();
    let cells_of = |row: &'_ str| {
        row.trim().trim_end_matches(',').split(',').map(|cell| cell.trim().to_owned()).collect::<Vec<_>>()
    };
    let header = rows.next().map(|(_, row)| cells_of(row)).unwrap_or_default();
    let place = |names: &[&str]| header.iter().position(|own| names.contains(&own.as_str()));
    let mut trials = Vec::new();
    for (i, row) in rows.filter(|(_, row)| !row.trim().is_empty()) {
        let (line, cells) = (i as u64 + 1, cells_of(row));
        if cells.len() != header.len() {
            return Err(Error::Row { line, expected: header.len(), found: cells.len() });
        }
        let text_of = |name: &str| place(&[name]).map_or("", |i| cells[i].as_str());
        let value = |names: &[&str]| -> Result<f64, Error> {
            let i = place(names).ok_or_else(|| Error::Missing { line: 1, column: names[0].to_owned() })?;
            number(&cells[i], names[0], line)
        };
        let (a, w, ae, dx) = (value(&["A"])?, value(&["W"])?, value(&["Ae"])?, value(&["dx"])?);
        let path = |name: &str| value(&[name]).ok();
        trials.push(Trial {
            index: value(&["Trial"])?.max(0.0) as u32,
            amplitude: Some(a),
            width: Some(w),
            // Along the axis alone.
            from: Some([0.0; 3]),
            to: [a, 0.0, 0.0],
            start: Some([a + dx - ae, 0.0, 0.0]),
            end: [a + dx, 0.0, 0.0],
            mt_s: value(&["MT(ms)", "MT"])? * 1e-3,
            error: Some(value(&["Error", "Errors"])? != 0.0),
            measured: Some(PathMeasures {
                tre: path("TRE"),
                tac: path("TAC"),
                mdc: path("MDC"),
                odc: path("ODC"),
                mv: path("MV"),
                me: path("ME"),
                mo: path("MO"),
                ..PathMeasures::default()
            }),
            ..named(stem, a, w, text_of)
        });
    }
    if trials.is_empty() {
        return Err(Error::Empty { what: "trials" });
    }
    let data = DataSet { length_unit: "px".to_owned(), dimensions: 1, trials };
    let conventions = Conventions { axis: Axis::Nominal, ..Conventions::gofitts() };
    Ok(Imported { data, conventions, warnings: Vec::new() })
}

/// Whose trial it is, by the columns that both files have.
fn named<'a>(stem: &str, a: f64, w: f64, text_of: impl Fn(&'static str) -> &'a str) -> Trial {
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
    Trial {
        participant: text_of("Participant").to_owned(),
        session,
        block: text_of("Block").to_owned(),
        condition: format!("{prefix}A{a}-W{w}"),
        factors,
        ..Trial::default()
    }
}

fn traces(stem: &str, text: &str) -> Result<Imported, Error> {
    let mut header: Option<Vec<&str>> = None;
    let mut trials: Vec<Trial> = Vec::new();
    let mut sequences: Vec<String> = Vec::new();
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
        let flat = text_of("TaskType") == "1D";
        let apart = (to[0] - from[0]).hypot(to[1] - from[1]);
        let off = [last.position[0] - to[0], last.position[1] - to[1]];
        let error = if flat {
            // Ribbons: along the axis alone.
            let dx = if apart > 0.0 {
                (off[0] * (to[0] - from[0]) + off[1] * (to[1] - from[1])) / apart
            } else {
                off[0]
            };
            dx.abs() > 0.5 * w
        } else {
            // The tool counts a pixel beyond the edge as a hit.
            off[0].hypot(off[1]) > 0.5 * w + 1.0
        };
        sequences.push(text_of("Sequence").to_owned());
        trials.push(Trial {
            index: value("Trial")?.max(1.0) as u32 - 1,
            amplitude: Some(a),
            width: Some(w),
            from: Some(from),
            to,
            start: Some(first.position),
            end: last.position,
            mt_s: last.t_s,
            error: Some(error),
            samples,
            ..named(stem, a, w, text_of)
        });
    }
    if header.is_none() {
        return Err(Error::Header {
            expected: "GoFitts' trace columns (…,from_x,from_y,to_x,to_y,{t_x_y}) or those of its trials (App,Participant,…,Ae,dx,…)",
        });
    }
    if trials.is_empty() {
        return Err(Error::Empty { what: "trials" });
    }
    // The same sizes may come twice in a block, as sequences of their own: the later ones get a number.
    let mut known: BTreeMap<[String; 4], Vec<String>> = BTreeMap::new();
    for (trial, sequence) in trials.iter_mut().zip(sequences) {
        let Trial { participant, session, block, condition, .. } = &*trial;
        let key = [participant, session, block, condition].map(String::clone);
        let own = known.entry(key).or_default();
        let place = own.iter().position(|other| *other == sequence).unwrap_or_else(|| {
            own.push(sequence);
            own.len() - 1
        });
        if place > 0 {
            trial.condition = format!("{}-{}", trial.condition, place + 1);
        }
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
    let flat = trials.iter().all(|trial| trial.factors.get("tasktype").is_some_and(|kind| kind == "1D"));
    let data = DataSet { length_unit: "px".to_owned(), dimensions: if flat { 1 } else { 2 }, trials };
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
            (0.6, [104.0, 1.0, 0.0], Some(false), 3)
        );
        assert_eq!(trial.condition, "C1-A100-W10");
        assert!(read("f", &text.replace("y=,0,2,1,", "y=,0,2,")).is_err());
        assert!(read("f", "x").is_err());
    }

    #[test]
    fn ribbons_are_one_dimension_and_sequences_are_apart() {
        let mut text = String::from(
            "TRACE DATA\nApp,Participant,Condition,Session,TaskType,Block,Sequence,A,W,Trial,from_x,from_y,to_x,to_y,{t_x_y}\n",
        );
        for sequence in [1, 2] {
            for (trial, x) in [(1, 104.0), (2, 98.0), (3, 101.0)] {
                let lead = format!("GoFitts,P1,C1,S1,1D,B1,{sequence},100,20,{trial},0,0,100,0,");
                text += &format!(
                    "{lead}t=,0,10,600,\n{lead}x=,0,50,{},\n{lead}y=,0,60,60,\n",
                    x + f64::from(sequence)
                );
            }
        }
        let found = read("f", &text).unwrap();
        assert_eq!(found.data.dimensions, 1);
        // Sixty beside the middle, and still hits.
        assert!(found.data.trials.iter().all(|trial| trial.error == Some(false)));
        let analysis = crate::analyse(&found.data, &found.conventions);
        assert_eq!(analysis.rows.len(), 2);
        // Nothing is carried over: (100 + 5) + (100 − 1 + 5) + (100 + 2 − 1) and one more of each in the second.
        for (row, expected) in analysis.rows.iter().zip([310.0, 315.0]) {
            assert!((row.ends.x.amplitude.unwrap() - expected / 3.0).abs() < 1e-12, "{:?}", row.ends);
        }
        // A movement that is missing carries nothing either.
        let gap: Vec<&str> = text.lines().filter(|line| !line.contains(",1,100,20,2,")).collect();
        let found = read("f", &gap.join("\n")).unwrap();
        let analysis = crate::analyse(&found.data, &found.conventions);
        assert!((analysis.rows[0].ends.x.amplitude.unwrap() - (105.0 + 102.0) / 2.0).abs() < 1e-12);
    }

    #[test]
    fn its_own_trials_give_its_own_throughput() {
        // Two versions of the header; what the tool's summary says of these three: mean Ae 99, SD of dx 2, mean MT 0.6 s.
        for (lead, names, error) in [
            ("", "Block,Trial", "Errors"),
            ("Row,", "Session,Group,TaskType,SelectionMethod,Block,Trial", "Error"),
        ] {
            let mut text = format!(
                "{lead}App,Participant,Condition,{names},A,W,Ae,dx,PT(ms),ST(ms),MT(ms),{error},TRE,TAC,MDC,ODC,MV,ME,MO,\n"
            );
            for (i, (ae, dx)) in [(97.0, -2.0), (99.0, 0.0), (101.0, 2.0)].into_iter().enumerate() {
                let row = if lead.is_empty() { String::new() } else { format!("{},", i + 1) };
                let place = if lead.is_empty() { "B01" } else { "S1,G1,2D,MB,B01" };
                text += &format!(
                    "{row}GoFitts,P1,C1,{place},{i},100.0,10.0,{ae},{dx},500,100,600,0,0,1,2,0,1.5,2.5,-0.5,\n"
                );
            }
            assert_eq!(crate::Tool::guess(&text), crate::Tool::GoFitts);
            let found = read("f", &text).unwrap();
            assert_eq!(
                (found.data.trials[0].index, found.data.trials[2].measured.unwrap().mo),
                (0, Some(-0.5))
            );
            let analysis = crate::analyse(&found.data, &found.conventions);
            let ends = analysis.rows[0].ends;
            assert!(
                (ends.x.amplitude.unwrap() - 99.0).abs() < 1e-12 && (ends.x.sd.unwrap() - 2.0).abs() < 1e-12
            );
            assert_eq!((ends.mt_s, ends.xy.tp, ends.error_rate), (Some(0.6), None, Some(0.0)));
            let damaged = read("f", &text.replace(",99,", ",x,")).unwrap_err().to_string();
            assert!(damaged.starts_with("line 3, column \"Ae\": expected a finite number"), "{damaged}");
        }
    }
}
