//! What each convention does to the answer: the same trials, one knob changed at a time.

use crate::analysis::{Analysis, analyse_with};
use crate::convention::{Axis, Conventions, Difficulty, Frame, MeanTime, Outliers, Reach};
use crate::trial::DataSet;

/// The answer with one knob set otherwise.
#[derive(Clone, Debug, PartialEq)]
pub struct Alternative {
    /// Its name; empty for the conventions as they are.
    pub knob: &'static str,
    /// Its value.
    pub value: String,
    /// Mean of means along the axis, bits/s.
    pub tp: Option<f64>,
    /// The same in all dimensions.
    pub tp_xy: Option<f64>,
    /// Trials that the outlier policy left out.
    pub left_out: u64,
}

/// The answer by `conventions`, then by each value of each knob that throughput depends on and that differs from theirs.
/// Each costs one analysis without paths: about a microsecond per trial.
/// None for tunnels, which have no throughput.
pub fn alternatives(data: &DataSet, conventions: &Conventions) -> Vec<Alternative> {
    if conventions.difficulty == Difficulty::Steering {
        return Vec::new();
    }
    let names = |all: &[&str]| all.iter().map(|&name| name.to_owned()).collect::<Vec<_>>();
    let mut values: Vec<(&'static str, Vec<String>)> = vec![
        ("id", [Difficulty::Shannon, Difficulty::Fitts].map(|value| value.to_string()).to_vec()),
        ("we_factor", names(&["sqrt(2*pi*e)", "4.133"])),
        ("axis", Axis::ALL.iter().map(|value| value.to_string()).collect()),
    ];
    if data.dimensions > 1 {
        values.push(("frame", Frame::ALL.iter().map(|value| value.to_string()).collect()));
        values.push(("reach", Reach::ALL.iter().map(|value| value.to_string()).collect()));
    }
    values.push(("mean_time", MeanTime::ALL.iter().map(|value| value.to_string()).collect()));
    // Without a metronome nobody is out of its time.
    let metronome = data.trials.iter().any(|trial| trial.temporal_outlier.is_some());
    let policies = Outliers::ALL.iter().filter(|policy| metronome || **policy != Outliers::Temporal);
    values.push(("outliers", policies.map(|value| value.to_string()).collect()));
    let own = conventions.listed();
    let with = |knob: &'static str, value: &str, conventions: &Conventions| {
        let analysis = analyse_with(data, conventions, false);
        let left_out = |analysis: &Analysis| analysis.rows.iter().map(|row| row.outliers).sum();
        Alternative {
            knob,
            value: value.to_owned(),
            tp: analysis.tp_mean_of_means(),
            tp_xy: analysis.tp_xy_mean_of_means(),
            left_out: left_out(&analysis),
        }
    };
    let mut found = vec![with("", "", conventions)];
    for (knob, values) in values {
        for value in values {
            let mut changed = conventions.clone();
            if own.contains(&(knob, value.clone())) || changed.set(knob, &value).is_err() {
                continue;
            }
            found.push(with(knob, &value, &changed));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::{ColumnMap, Tool, import};

    #[test]
    fn one_knob_at_a_time() {
        let mut text = String::from("participant,condition,mt_s,dx,dy,amplitude,width\n");
        for i in 0..60u32 {
            let noise = f64::from(i.wrapping_mul(2_654_435_761) >> 16) / 65_536.0 - 0.5;
            text += &format!("P{},c,{},{},{},100,20\n", i % 3, 0.5 + 0.1 * noise, 30.0 * noise, 10.0 * noise);
        }
        let found = import(Tool::Csv, "t", &text, &ColumnMap::default()).unwrap();
        let all = alternatives(&found.data, &found.conventions);
        let of = |knob: &str, value: &str| {
            all.iter().find(|one| one.knob == knob && one.value == value).unwrap().clone()
        };
        let own = of("", "");
        // Two of difficulty less one, and so on; ours are not there twice.
        assert_eq!(all.len(), 1 + 1 + 1 + 2 + 1 + 1 + 1 + 4);
        // A factor that is 6.5e-5 larger makes throughput a little smaller.
        let other = of("we_factor", "4.133").tp.unwrap() / own.tp.unwrap() - 1.0;
        assert!((-1e-4..-1e-6).contains(&other), "{other}");
        assert_eq!(of("frame", "world").tp, own.tp);
        let misses = of("outliers", "misses");
        assert!(misses.left_out > 0 && misses.tp > own.tp && own.left_out == 0, "{misses:?} {own:?}");
        // By log2(2 A/W) it is what log2(A/W + 1) says of twice the amplitude, less a little.
        assert!(of("id", "fitts").tp > own.tp);
    }
}
