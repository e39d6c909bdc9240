//! Rows as tables and as one JSON object, for other programs: every number with all its digits.

use std::fmt::Write as _;

use serde_json::{Map, Value, json};

use crate::alternatives::Alternative;
use crate::analysis::{Analysed, Analysis, Fit, Row};
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
        ("errors", Some(row.errors as f64)),
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
    text += ",block,instruction\n";
    for row in &analysis.rows {
        let key = &row.key;
        let _ =
            write!(text, "{},{},{}", quoted(&key.participant), quoted(&key.session), quoted(&key.condition));
        for (_, value) in numbers(row) {
            let _ = write!(text, ",{}", cell(value));
        }
        let _ =
            writeln!(text, ",{},{}", quoted(&key.block), quoted(row.instruction.as_deref().unwrap_or("")));
    }
    text
}

/// One row per trial, practice too. It can be analysed again without a map.
pub fn trials_csv(trials: &[Analysed<'_>]) -> String {
    let mut text = String::from(
        "participant,session,block,condition,instruction,index,practice,amplitude,width,mt_s,error,outlier",
    );
    for place in ["from", "to", "start", "end"] {
        for axis in ["x", "y", "z"] {
            let _ = write!(text, ",{place}_{axis}");
        }
    }
    text += ",dx_axis,ae_axis,ae_straight";
    for name in PathMeasures::NAMES {
        let _ = write!(text, ",{name}");
    }
    text += "\n";
    for one in trials {
        let t = one.trial;
        let texts = [&t.participant, &t.session, &t.block, &t.condition].map(|text| quoted(text));
        let _ = write!(
            text,
            "{},{},{},{},{},{},{},{},{},{}",
            texts.join(","),
            quoted(t.instruction.as_deref().unwrap_or("")),
            t.index,
            u8::from(t.practice),
            cell(t.amplitude),
            cell(t.width),
            t.mt_s,
            u8::from(t.error),
            u8::from(one.outlier),
            [t.from, Some(t.to), t.start, Some(t.end)]
                .map(|point| match point {
                    Some([x, y, z]) => format!("{x},{y},{z}"),
                    None => ",,".to_owned(),
                })
                .join(",")
        );
        let end = one.end;
        for value in [end.map(|end| end.dx), end.map(|end| end.ae), end.map(|end| end.ae_xy)] {
            let _ = write!(text, ",{}", cell(value));
        }
        for value in one.path.unwrap_or_default().values() {
            let _ = write!(text, ",{}", cell(value));
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
        object.insert("instruction".into(), json!(row.instruction));
        for (name, value) in numbers(row) {
            let whole = ["n", "trials", "errors", "outliers"].contains(&name);
            let value = if whole { json!(value.map(|value| value as u64)) } else { json!(value) };
            object.insert(name.into(), value);
        }
        for (name, level) in &row.factors {
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
    let stability = analysis.stability.as_ref().map(|stability| {
        let levels = stability.levels.iter().map(|level| {
            json!({"instruction": level.name, "sequences": level.sequences, "mt_s": level.mt_s, "sd_x": level.sd, "tp": level.tp, "error_rate": level.error_rate})
        });
        json!({"levels": levels.collect::<Vec<_>>(), "tp_cv": stability.cv})
    });
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
            "error_rate": analysis.error_rate(),
            "mt_s": analysis.mean(|row| row.ends.mt_s),
            "ide": analysis.mean(|row| row.ends.x.ide),
            "trials": analysis.trials(),
            "participants": analysis.participants(),
            "sequences": analysis.rows.len(),
            "length_unit": analysis.length_unit,
            "dimensions": analysis.dimensions,
            "conventions": conventions,
            "exclusions": analysis.exclusions.iter().map(|(what, n)| json!({"what": what, "n": n})).collect::<Vec<_>>(),
            "instructions": stability,
            "who": who,
            "alternatives": alternatives.collect::<Vec<_>>(),
            "conditional_accuracy": accuracy.collect::<Vec<_>>(),
            "error_model": model,
            "fits": fits.collect::<Vec<_>>(),
        },
    })
}
