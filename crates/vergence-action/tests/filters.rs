//! The filters: their published numbers, their laws, and whatever may be fed to them.

use proptest::prelude::*;
use vergence_action::filter::{DoubleExponentialParams, LowPassParams, OneEuroParams, Smoothing};
use vergence_time::{Span, Timestamp};

fn at(secs: f64) -> Timestamp {
    Timestamp::from_nanos((secs * 1e9).round() as i64)
}

/// What the rounding of the file's inputs can do: they are printed to six significant digits, 5e-6 above 1, and each weighs
/// at most a fifth. The check that comes with the file allows 1e-3.
const INPUTS: f64 = 1e-6;

/// The file prints six significant digits; to half of the last one, and what the inputs' rounding does, ours are the same.
#[test]
fn the_one_euro_filter_gives_its_published_test_file() {
    let text = include_str!("data/one-euro/groundTruth.csv");
    let params = OneEuroParams { least_cutoff_hz: 1.0, beta: 0.1, speed_cutoff_hz: 1.0 };
    let mut filter = Smoothing::OneEuro(params).smoother::<1>().unwrap();
    let half_digit = |value: f64| 0.5 * 10f64.powi(value.abs().log10().floor() as i32 - 5);
    let (mut rows, mut to_the_digit, mut worst) = (0, 0, 0f64);
    for line in text.lines().skip(1) {
        let cells: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
        // The times were k/120 before they were printed.
        let [found] = filter.update(at(f64::from(rows) / 120.0), [cells[2]]);
        assert!((f64::from(rows) / 120.0 - cells[0]).abs() < 1e-5);
        let off = (found - cells[3]).abs();
        assert!(off <= half_digit(cells[3]) + INPUTS, "{line}: {found}");
        worst = worst.max(off);
        rows += 1;
        to_the_digit += u32::from(off <= half_digit(cells[3]));
    }
    println!("{to_the_digit} of {rows} rows to the last printed digit, worst difference {worst:.1e}");
    assert_eq!(rows, 1200);
    assert!(to_the_digit > 1000, "{to_the_digit}");
}

fn all() -> [Smoothing; 4] {
    [
        Smoothing::None,
        Smoothing::LowPass(LowPassParams { cutoff_hz: 3.0 }),
        Smoothing::DoubleExponential(DoubleExponentialParams { time_s: 0.05, ahead_s: 0.0 }),
        Smoothing::OneEuro(OneEuroParams::default()),
    ]
}

#[test]
fn what_rests_stays_and_what_moves_evenly_lags_as_the_knobs_say() {
    for smoothing in all() {
        let mut filter = smoothing.smoother::<3>().unwrap();
        for k in 0..100 {
            assert_eq!(filter.update(at(0.01 * f64::from(k)), [1.0, -2.0, 3.0]), [1.0, -2.0, 3.0]);
        }
    }
    let lag_s = |smoothing: Smoothing| {
        let mut filter = smoothing.smoother::<1>().unwrap();
        let mut last = 0.0;
        for k in 0..20_000 {
            let t = 1e-3 * f64::from(k);
            last = t - filter.update(at(t), [t])[0];
        }
        last
    };
    let [none, low_pass, double, one_euro] = all().map(lag_s);
    assert_eq!(none, 0.0);
    assert!((low_pass - 1.0 / (std::f64::consts::TAU * 3.0)).abs() < 1e-3, "{low_pass}");
    assert!(double.abs() < 1e-9, "{double}");
    // 1 m/s: the cutoff is 31.5 Hz and more, since the speed is taken from the smoothed value to the new one, as published.
    assert!(one_euro > 0.0 && one_euro < 1.0 / (std::f64::consts::TAU * 31.5), "{one_euro}");
    // Ahead by what was asked for.
    let ahead = DoubleExponentialParams { time_s: 0.05, ahead_s: 0.03 };
    assert!((lag_s(Smoothing::DoubleExponential(ahead)) + 0.03).abs() < 1e-6);
}

#[test]
fn a_turned_motion_gives_the_turned_result() {
    let mut straight = all()[3].smoother::<2>().unwrap();
    let mut turned = all()[3].smoother::<2>().unwrap();
    let (sin, cos) = 0.7f64.sin_cos();
    for k in 0..500 {
        let t = 0.01 * f64::from(k);
        let [x, y] = [(3.0 * t).sin(), 0.2 * (17.0 * t).cos()];
        let [a, b] = straight.update(at(t), [x, y]);
        let [c, d] = turned.update(at(t), [cos * x - sin * y, sin * x + cos * y]);
        assert!((cos * a - sin * b - c).abs() < 1e-12 && (sin * a + cos * b - d).abs() < 1e-12);
    }
}

#[test]
fn knobs_out_of_range_are_refused() {
    let wrong = [
        Smoothing::LowPass(LowPassParams { cutoff_hz: 0.0 }),
        Smoothing::DoubleExponential(DoubleExponentialParams { time_s: f64::NAN, ahead_s: 0.0 }),
        Smoothing::OneEuro(OneEuroParams { beta: -1.0, ..OneEuroParams::default() }),
    ];
    for smoothing in wrong {
        assert!(smoothing.smoother::<1>().is_err(), "{smoothing:?}");
    }
    let error = wrong[0].fault().unwrap();
    assert_eq!(error.to_string(), "cutoff: expected 0.001 to 10,000 Hz, found 0");
}

proptest! {
    /// Any times and numbers: what comes out is finite; of a low-pass and the one euro filter it lies within what was put in.
    #[test]
    fn never_nan(
        samples in prop::collection::vec((any::<i64>(), prop::array::uniform2(any::<f64>())), 1..40),
        cutoff_hz in 0.001f64..1e4, beta in 0.0f64..1e6, time_s in 0.0f64..100.0, ahead_s in 0.0f64..1.0,
    ) {
        for smoothing in [
            Smoothing::LowPass(LowPassParams { cutoff_hz }),
            Smoothing::DoubleExponential(DoubleExponentialParams { time_s, ahead_s }),
            Smoothing::OneEuro(OneEuroParams { least_cutoff_hz: cutoff_hz, beta, speed_cutoff_hz: cutoff_hz }),
        ] {
            let mut filter = smoothing.smoother::<2>().unwrap();
            let mut sorted = samples.clone();
            sorted.sort_by_key(|sample| sample.0);
            for (time, value) in samples.iter().chain(&sorted) {
                let out = filter.update(Timestamp::from_nanos(*time), *value);
                prop_assert!(out.iter().all(|x| x.is_finite()), "{smoothing:?} {value:?} {out:?}");
            }
        }
    }

    #[test]
    fn within_what_was_fed(values in prop::collection::vec(-1.0f64..1.0, 1..60), step_ms in 1i64..500, beta in 0.0f64..1e4) {
        for smoothing in [all()[1], Smoothing::OneEuro(OneEuroParams { beta, ..OneEuroParams::default() })] {
            let mut filter = smoothing.smoother::<1>().unwrap();
            let mut now = Timestamp::default();
            for (k, value) in values.iter().enumerate() {
                let [out] = filter.update(now, [*value]);
                let low = values[..=k].iter().copied().fold(f64::MAX, f64::min);
                let high = values[..=k].iter().copied().fold(f64::MIN, f64::max);
                prop_assert!((low - 1e-12..=high + 1e-12).contains(&out));
                now = now.saturating_add(Span::from_millis(step_ms));
            }
        }
    }
}
