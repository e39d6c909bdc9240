//! What holds for any measurements: few values, so that ties are common, and values that are no numbers.

#![allow(clippy::unwrap_used)] // helpers of tests, too
use proptest::prelude::*;
use vergence_trade::{Error, Knob, Limit, Measurement, Scale, Setting, Trade, Value};

fn trade(values: &[(f64, f64)]) -> Trade {
    let knob = Knob::new("k", "", vec![Value::from(0)]);
    let mut trade =
        Trade::new("t", vec![knob], vec![Scale::new("c", "ms")], vec![Scale::new("e", "")]).unwrap();
    for (index, &(cost, error)) in values.iter().enumerate() {
        let setting = Setting(vec![("k".into(), Value::from(index as u32))]);
        trade.push(Measurement { setting, costs: vec![cost], errors: vec![error] }).unwrap();
    }
    trade
}

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        8 => (0..6i32).prop_map(|v| f64::from(v) * 0.5),
        1 => Just(-0.0),
        1 => Just(f64::NAN),
        1 => Just(f64::INFINITY),
        1 => Just(f64::NEG_INFINITY),
        2 => -1e9..1e9f64,
    ]
}

fn finite((cost, error): (f64, f64)) -> bool {
    cost.is_finite() && error.is_finite()
}

/// Nowhere worse and somewhere better.
fn beats(a: (f64, f64), b: (f64, f64)) -> bool {
    finite(a) && a.0 <= b.0 && a.1 <= b.1 && (a.0 < b.0 || a.1 < b.1)
}

proptest! {
    #[test]
    fn nothing_beats_the_front_and_the_front_covers_everything(
        values in prop::collection::vec((number(), number()), 0..40)
    ) {
        let front = trade(&values).pareto(0, 0);
        prop_assert_eq!(front.is_empty(), !values.iter().any(|v| finite(*v)));
        for &i in &front {
            prop_assert!(finite(values[i]) && !values.iter().any(|v| beats(*v, values[i])));
        }
        for v in values.iter().filter(|v| finite(**v)) {
            let covered = front.iter().any(|&i| beats(values[i], *v) || values[i] == *v);
            prop_assert!(covered);
        }
        for pair in front.windows(2) {
            prop_assert!(values[pair[0]].0 < values[pair[1]].0 && values[pair[0]].1 > values[pair[1]].1);
        }
    }

    #[test]
    fn a_choice_keeps_its_limit_is_the_best_that_does_and_is_never_beaten(
        values in prop::collection::vec((number(), number()), 0..40),
        most in number(),
        other in number(),
    ) {
        let trade = trade(&values);
        for limit in [Limit::Cost(most), Limit::Error(most), Limit::Both { cost: other, error: most }] {
            let keeps = |v: (f64, f64)| finite(v) && match limit {
                Limit::Cost(_) => v.0 <= most,
                Limit::Error(_) => v.1 <= most,
                Limit::Both { .. } => v.0 <= other && v.1 <= most,
            };
            match trade.choose(0, 0, limit) {
                Ok(i) => {
                    prop_assert!(keeps(values[i]) && !values.iter().any(|v| beats(*v, values[i])));
                    for v in values.iter().filter(|v| keeps(**v)) {
                        let no_worse = match limit {
                            Limit::Cost(_) => values[i].1 <= v.1,
                            Limit::Error(_) | Limit::Both { .. } => values[i].0 <= v.0,
                        };
                        prop_assert!(no_worse);
                    }
                }
                Err(Error::NothingFits { nearest, .. }) => {
                    prop_assert!(!values.iter().any(|v| keeps(*v)));
                    prop_assert_eq!(nearest.is_some(), values.iter().any(|v| finite(*v)));
                }
                Err(other) => prop_assert!(false, "{}", other),
            }
        }
    }

    #[test]
    fn everything_can_be_shown(values in prop::collection::vec((number(), number()), 0..20)) {
        let trade = trade(&values);
        let svg = trade.plot(0, 0, Some(0)).to_svg().unwrap();
        prop_assert!(!svg.contains("NaN") && svg.ends_with("</svg>\n"));
        prop_assert_eq!(trade.table(0, 0).to_text().lines().count(), values.len() + 1);
        let json = serde_json::to_value(&trade).unwrap();
        prop_assert_eq!(json["measurements"].as_array().unwrap().len(), values.len());
    }
}

#[test]
fn of_equal_measurements_the_first_is_taken() {
    let trade = trade(&[(2.0, 1.0), (1.0, 2.0), (1.0, 2.0), (2.0, 1.0), (1.0, 3.0)]);
    assert_eq!(trade.pareto(0, 0), [1, 0]);
    assert_eq!(trade.choose(0, 0, Limit::Cost(1.5)), Ok(1));
    assert_eq!(trade.choose(0, 0, Limit::Error(1.0)), Ok(0));
    let error = trade.choose(0, 0, Limit::Error(0.5)).unwrap_err();
    assert_eq!(error.to_string(), "expected a setting with e of at most 0.5, found at least 1.000000 (k 0)");
    let both = |cost, error| trade.choose(0, 0, Limit::of(Some(cost), Some(error)).unwrap());
    assert_eq!((both(2.0, 1.0), both(5.0, 2.5)), (Ok(0), Ok(1)));
    let error = both(1.5, 1.5).unwrap_err();
    assert_eq!(
        error.to_string(),
        "expected a setting with c (ms) of at most 1.5, found at least 2.000000 (k 0)"
    );
}

#[test]
fn what_does_not_fit_is_refused() {
    let knob = || Knob::new("msaa", "", vec![Value::from(1), Value::from(4)]);
    let (cost, error) = (|| vec![Scale::new("c", "")], || vec![Scale::new("e", "")]);
    assert!(Trade::new("t", vec![], cost(), error()).is_err());
    assert!(Trade::new("t", vec![knob(), knob()], cost(), error()).is_err());
    assert!(Trade::new("t", vec![Knob::new("a", "", vec![])], cost(), error()).is_err());
    let mut trade = Trade::new("t", vec![knob()], cost(), error()).unwrap();
    let setting = trade.grid()[1].clone();
    assert_eq!(setting.to_string(), "msaa 4");
    let bad = Measurement { setting: setting.clone(), costs: vec![], errors: vec![1.0] };
    assert_eq!(trade.push(bad).unwrap_err().to_string(), "expected 1 costs, found 0");
    let other = Setting(vec![("x".into(), Value::from(true))]);
    let bad = Measurement { setting: other, costs: vec![1.0], errors: vec![1.0] };
    assert_eq!(trade.push(bad).unwrap_err().to_string(), "expected the knob \"msaa\", found \"x\"");
    trade.push(Measurement { setting, costs: vec![1.0], errors: vec![f64::NAN] }).unwrap();
    assert!(trade.pareto(0, 0).is_empty());
    let json = serde_json::to_string(&trade).unwrap();
    assert!(json.contains("\"setting\":{\"msaa\":4},\"costs\":[1.0],\"errors\":[null]"), "{json}");
}

#[test]
fn a_knob_that_turns_nothing_is_noticed() {
    let knobs = vec![
        Knob::new("a", "", [1.0, 2.0, 3.0].map(Value::from).into()),
        Knob::new("b", "", vec![Value::from(false), Value::from(true)]),
    ];
    let mut trade = Trade::new("t", knobs, vec![Scale::new("c", "")], vec![Scale::new("e", "")]).unwrap();
    assert!(trade.indistinct().is_empty(), "nothing was measured");
    // 2 and 3 are the same; b always matters.
    for (setting, error) in trade.grid().into_iter().zip([1.0, 2.0, 0.5, 0.75, 0.5, 0.75]) {
        trade.push(Measurement { setting, costs: vec![1.0], errors: vec![error] }).unwrap();
    }
    assert_eq!(trade.indistinct(), [(0, 1, 2)]);
    let setting = trade.grid()[5].clone();
    trade.push(Measurement { setting, costs: vec![1.0], errors: vec![0.76] }).unwrap();
    assert!(trade.indistinct().is_empty(), "once they differed");
}

#[test]
fn errors_that_differ_by_noise_make_no_front() {
    let measured =
        [(1.0, 1.0), (2.0, 0.95), (3.0, 0.89), (4.0, 0.85), (5.0, 0.4), (6.0, 0.3999), (7.0, f64::NAN)];
    let (exact, coarse) = (trade(&measured), trade(&measured).with_error_noise(0.1));
    assert_eq!(exact.pareto(0, 0), [0, 1, 2, 3, 4, 5]);
    assert_eq!(coarse.pareto(0, 0), [0, 2, 4]);
    // A budget takes what is better by more than noise; a limit of the error is kept to the letter.
    assert_eq!(coarse.choose(0, 0, Limit::Cost(4.5)), Ok(2));
    assert_eq!(coarse.choose(0, 0, Limit::Cost(9.0)), Ok(4));
    assert_eq!(coarse.choose(0, 0, Limit::Error(0.86)), Ok(3));
    assert_eq!(coarse.choose(0, 0, Limit::Error(0.39995)), Ok(5));
}
