//! Rows as tables and as one JSON object, for other programs: every number with all its digits.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

use serde_json::{Map, Value, json};

use crate::alternatives::Alternative;
use crate::analysis::{Analysed, Analysis, Fit, Row};
use crate::tradeoff::Stability;
use crate::trial::PathMeasures;

fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

fn cell(value: Option<f64>) -> String {
    value.map_or_else(String::new, |value| value.to_string())
}

/// The first columns of the table of trials.
const TRIAL_COLUMNS: &str = "participant,session,block,condition,instruction,index,practice,attempt,repeated,amplitude,width,mt_s,error,outlier";

/// Names and values of a row's numbers, in the order of the columns.
fn numbers(row: &Row) -> Vec<(&'static str, Option<f64>)> {
    let ends = &row.ends;
    let mut all = vec![
        ("amplitude", row.amplitude),
        ("width", row.width),
        ("n", Some(row.n as f64)),
        ("mt_s", ends.mt_s),
        ("error_rate", ends.error_rate),
        ("ae", ends.x.amplitude),
        ("sd_x", ends.x.sd),
        ("we", ends.x.we),
        ("ide", ends.x.ide),
        ("tp", ends.x.tp),
        ("ae_xy", ends.xy.amplitude),
        ("sd_xy", ends.xy.sd),
        ("we_xy", ends.xy.we),
        ("ide_xy", ends.xy.ide),
        ("tp_xy", ends.xy.tp),
    ];
    all.extend(PathMeasures::NAMES.into_iter().zip(row.path.values()));
    all.extend([
        ("id", row.id),
        ("mt_sd_s", ends.mt_sd_s),
        ("bias", ends.bias),
        ("trials", Some(row.trials as f64)),
        ("errors", (row.judged > 0).then_some(row.errors as f64)),
        ("outliers", Some(row.outliers as f64)),
        ("we_error", row.by_errors.we),
        ("ide_error", row.by_errors.ide),
        ("tp_error", row.by_errors.tp),
    ]);
    all
}

/// One row per sequence: `participant, session, condition, amplitude, width, n, mt_s, …`. Lengths in the data set's unit,
/// times in seconds, difficulties in bits, throughputs in bits/s; an empty cell has no value.
pub fn conditions_csv(analysis: &Analysis) -> String {
    let mut text = String::from("participant,session,condition");
    let blank = Row::default();
    for (name, _) in numbers(analysis.rows.first().unwrap_or(&blank)) {
        let _ = write!(text, ",{name}");
    }
    text += ",block,instruction";
    let factors = factors_of(analysis.rows.iter().map(|row| &row.key.factors));
    for name in &factors {
        let _ = write!(text, ",{}", quoted(&factor_column(name)));
    }
    text += "\n";
    for row in &analysis.rows {
        let key = &row.key;
        let _ =
            write!(text, "{},{},{}", quoted(&key.participant), quoted(&key.session), quoted(&key.condition));
        for (_, value) in numbers(row) {
            let _ = write!(text, ",{}", cell(value));
        }
        let _ = write!(text, ",{},{}", quoted(&key.block), quoted(key.instruction.as_deref().unwrap_or("")));
        for name in &factors {
            let _ = write!(text, ",{}", quoted(key.factors.get(name).map_or("", String::as_str)));
        }
        text += "\n";
    }
    text
}

/// Whether one of our tables (or of objects in JSON) has a column of that name, or a map gives the name a meaning.
pub(crate) fn is_column(name: &str) -> bool {
    let own = numbers(&Row::default());
    own.iter().any(|(own, _)| *own == name)
        || TRIAL_COLUMNS.split(',').any(|own| own == name)
        || crate::import::is_known(name)
}

/// The column of a factor in our tables: no other column has such a name.
pub fn factor_column(name: &str) -> String {
    format!("factor_{name}")
}

/// Names of all factors, in order.
fn factors_of<'a>(all: impl Iterator<Item = &'a BTreeMap<String, String>>) -> Vec<String> {
    let names: BTreeSet<&String> = all.flat_map(BTreeMap::keys).collect();
    names.into_iter().cloned().collect()
}

/// One row per trial, practice too. It can be analysed again without a map.
/// The columns of other factors are named as [`factor_column`] says.
pub fn trials_csv(trials: &[Analysed<'_>]) -> String {
    let factors = factors_of(trials.iter().map(|one| &one.trial.factors));
    let spatial = trials.iter().any(|one| one.trial.spatial_outlier.is_some());
    let temporal = trials.iter().any(|one| one.trial.temporal_outlier.is_some());
    let mut text = String::from(TRIAL_COLUMNS);
    for place in ["from", "to", "start", "end"] {
        for axis in ["x", "y", "z"] {
            let _ = write!(text, ",{place}_{axis}");
        }
    }
    text += ",dx_axis,ae_axis,ae_straight";
    for name in PathMeasures::NAMES {
        let _ = write!(text, ",{name}");
    }
    for (name, there) in [("spatial_outlier", spatial), ("temporal_outlier", temporal)] {
        let _ = if there { write!(text, ",{name}") } else { Ok(()) };
    }
    for name in &factors {
        let _ = write!(text, ",{}", quoted(&factor_column(name)));
    }
    text += "\n";
    for one in trials {
        let t = one.trial;
        let texts = [&t.participant, &t.session, &t.block, &t.condition].map(|text| quoted(text));
        let _ = write!(
            text,
            "{},{},{},{},{},{},{},{},{},{},{},{}",
            texts.join(","),
            quoted(t.instruction.as_deref().unwrap_or("")),
            t.index,
            u8::from(t.practice),
            t.attempt,
            u8::from(t.repeated),
            cell(t.amplitude),
            cell(t.width),
            t.mt_s,
            t.error.map_or_else(String::new, |error| u8::from(error).to_string()),
            u8::from(one.outlier),
            [t.from, Some(t.to), t.start, Some(t.end)]
                .map(|point| match point {
                    Some([x, y, z]) => format!("{x},{y},{z}"),
                    None => ",,".to_owned(),
                })
                .join(",")
        );
        let end = one.end;
        for value in [end.map(|end| end.dx), end.and_then(|end| end.ae), end.and_then(|end| end.ae_xy)] {
            let _ = write!(text, ",{}", cell(value));
        }
        for value in one.path.unwrap_or_default().values() {
            let _ = write!(text, ",{}", cell(value));
        }
        for (flag, there) in [(t.spatial_outlier, spatial), (t.temporal_outlier, temporal)] {
            let flag = flag.map_or_else(String::new, |flag| u8::from(flag).to_string());
            let _ = if there { write!(text, ",{flag}") } else { Ok(()) };
        }
        for name in &factors {
            let _ = write!(text, ",{}", quoted(t.factors.get(name).map_or("", String::as_str)));
        }
        text += "\n";
    }
    text
}

fn fit(fit: &Fit) -> Value {
    json!({"a": fit.a, "b": fit.b, "r": fit.r, "n": fit.n, "a_interval_95": fit.intervals[0], "b_interval_95": fit.intervals[1], "tp_inverse": 1.0 / fit.b})
}

/// Everything as one object: `conditions` (as the table has them) and `summary`.
pub fn summary_json(analysis: &Analysis, alternatives: &[Alternative]) -> Value {
    let row = |row: &Row| {
        let mut object = Map::new();
        object.insert("participant".into(), json!(row.key.participant));
        object.insert("session".into(), json!(row.key.session));
        object.insert("condition".into(), json!(row.key.condition));
        object.insert("block".into(), json!(row.key.block));
        object.insert("instruction".into(), json!(row.key.instruction));
        for (name, value) in numbers(row) {
            let whole = ["n", "trials", "errors", "outliers"].contains(&name);
            let value = if whole { json!(value.map(|value| value as u64)) } else { json!(value) };
            object.insert(name.into(), value);
        }
        for (name, level) in &row.key.factors {
            object.entry(name.clone()).or_insert_with(|| json!(level));
        }
        Value::Object(object)
    };
    let conventions: Map<String, Value> = analysis
        .conventions
        .listed()
        .into_iter()
        .map(|(name, value)| (name.to_owned(), json!(value)))
        .collect();
    let levels = |stability: &Stability| {
        let levels = stability.levels.iter().map(|level| {
            json!({"instruction": level.name, "level": level.name, "sequences": level.sequences, "mt_s": level.mt_s, "sd_x": level.sd, "tp": level.tp, "tp_sd_of_people": level.tp_sd_of_people, "error_rate": level.error_rate})
        });
        json!({"levels": levels.collect::<Vec<_>>(), "tp_cv": stability.cv})
    };
    let factors: Map<String, Value> =
        analysis.factors.iter().map(|(name, own)| (name.clone(), levels(own))).collect();
    let stability = analysis.stability.as_ref().map(levels);
    let accuracy = analysis.accuracy.iter().map(|(name, bins)| {
        let bins = bins.iter().map(|bin| json!({"mt_s": bin.mt_s, "error_rate": bin.error_rate, "n": bin.n}));
        json!({"instruction": name, "bins": bins.collect::<Vec<_>>()})
    });
    let alternatives = alternatives.iter().map(|one| {
        json!({"knob": one.knob, "value": one.value, "tp_mean_of_means": one.tp, "tp_xy_mean_of_means": one.tp_xy, "left_out": one.left_out})
    });
    let who = analysis.who.as_ref().map(|who| {
        json!({"alpha": who.alpha, "k": who.k, "x0_s": who.x0_s, "y0": who.y0, "front": who.front.name(), "points": who.points[0], "front_points": who.points[1], "fitted_points": who.points[2], "r2": who.r2})
    });
    let model = analysis.error_model.as_ref().map(|model| json!({"m": model.m, "b": model.b, "r": model.r}));
    let fits = analysis.fits.iter().map(|(participant, session, own)| {
        json!({"participant": participant, "session": session, "fit": fit(own)})
    });
    json!({
        "conditions": analysis.rows.iter().map(row).collect::<Vec<_>>(),
        "summary": {
            "tp_mean_of_means": analysis.tp_mean_of_means(),
            "tp_xy_mean_of_means": analysis.tp_xy_mean_of_means(),
            "tp_error_mean_of_means": analysis.mean(|row| row.by_errors.tp),
            "tp_mean_of_participants": analysis.tp_mean_of_participants(),
            "a": analysis.fit.map(|fit| fit.a),
            "b": analysis.fit.map(|fit| fit.b),
            "r": analysis.fit.and_then(|fit| fit.r),
            "fit": analysis.fit.as_ref().map(fit),
            "fit_xy": analysis.fit_xy.as_ref().map(fit),
            "fit_nominal": analysis.fit_nominal.as_ref().map(fit),
            "steering_rate": analysis.steering_rate(),
            "error_rate": analysis.error_rate(),
            "mt_s": analysis.mean(|row| row.ends.mt_s),
            "ide": analysis.mean(|row| row.ends.x.ide),
            "trials": analysis.counts.trials,
            "participants": analysis.counts.participants,
            "sequences": analysis.rows.len(),
            "length_unit": analysis.length_unit,
            "dimensions": analysis.dimensions,
            "conventions": conventions,
            "exclusions": analysis.exclusions.iter().map(|(what, n)| json!({"what": what, "n": n})).collect::<Vec<_>>(),
            "instructions": stability,
            "factors": factors,
            "who": who,
            "alternatives": alternatives.collect::<Vec<_>>(),
            "conditional_accuracy": accuracy.collect::<Vec<_>>(),
            "error_model": model,
            "warnings": analysis.warnings,
            "fits": fits.collect::<Vec<_>>(),
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::{analyse, analyse_trials};
    use crate::import::{ColumnMap, Tool, import};

    #[test]
    fn what_is_written_is_what_is_read() {
        let mut text = String::from(
            "participant,condition,hand,mt_s,dx,dy,amplitude,width,spatial_outlier,temporal_outlier\n",
        );
        for i in 0..48u32 {
            let noise = f64::from(i.wrapping_mul(2_654_435_761) >> 16) / 65_536.0 - 0.5;
            let (spatial, temporal) = (u32::from(i % 7 == 0), u32::from(i % 5 == 0));
            text += &format!(
                "P{},\"c,1\",h{},{},{},{},100,20,{spatial},{temporal}\n",
                i % 2,
                i % 3,
                0.5 + 0.1 * noise,
                9.0 * noise,
                noise
            );
        }
        let map = ColumnMap::parse("m".as_ref(), "[factors]\nhand = \"hand\"").unwrap();
        let first = import(Tool::Csv, "t", &text, &map).unwrap();
        let again = ColumnMap::parse("m".as_ref(), "[factors]\nhand = \"factor_hand\"").unwrap();
        for policy in ["keep", "spatial", "temporal"] {
            let mut conventions = first.conventions.clone();
            conventions.set("outliers", policy).unwrap();
            let table = trials_csv(&analyse_trials(&first.data, &conventions));
            let second = import(Tool::Csv, "t", &table, &again).unwrap();
            let (a, b) = (analyse(&first.data, &conventions), analyse(&second.data, &conventions));
            assert_eq!(a.rows.len(), 6);
            assert_eq!(a.exclusions, b.exclusions);
            for (a, b) in a.rows.iter().zip(&b.rows) {
                assert_eq!((&a.key, a.n, a.ends.x.tp), (&b.key, b.n, b.ends.x.tp));
            }
        }
        let analysis = analyse(&first.data, &first.conventions);
        assert!(
            conditions_csv(&analysis).lines().next().unwrap().ends_with(",block,instruction,factor_hand")
        );
    }
}
