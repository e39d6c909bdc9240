//! Prediction over recorded hands: the adaptive method is the best at every horizon up to 59 ms and never worse than the
//! constant rate at 100 ms, by the truth of cameras and by what the filter says later.

use std::path::PathBuf;

use vergence_inertial::Recording;
use vergence_inertial::filter::{Axes, Kind};
use vergence_inertial::predict::{AtHorizon, Method, Track, judge};
use vergence_time::Span;

const HORIZONS_MS: [i64; 6] = [10, 21, 31, 42, 59, 100];

/// How much worse than the worst of the constant rate the worst of the adaptive method may be: blows are no motion that it knows
/// (1.35 on the recording with taps at 100 ms; below 1 on the others from 21 ms on).
const WORST: f64 = 1.4;

/// The recordings, or nothing where there are none and none are required.
fn recordings() -> Vec<PathBuf> {
    let folder = std::env::var_os("VERGENCE_DATA").map(|data| PathBuf::from(data).join("broad"));
    let files = folder.and_then(|folder| std::fs::read_dir(folder).ok()).into_iter().flatten().flatten();
    let mut files: Vec<PathBuf> =
        files.map(|file| file.path()).filter(|path| path.extension().is_some_and(|e| e == "gz")).collect();
    files.sort();
    if files.is_empty() {
        let required = std::env::var("VERGENCE_REQUIRE").unwrap_or_default();
        assert!(!required.split(',').any(|what| what == "data"), "no recordings in VERGENCE_DATA/broad");
        println!("skipped: no recordings in VERGENCE_DATA/broad");
    }
    files
}

#[test]
fn the_adaptive_method_is_the_best_over_recorded_hands() {
    let files = recordings();
    let horizons = HORIZONS_MS.map(Span::from_millis);
    // Sums over the recordings: per method, by the estimate and by the truth, per horizon.
    let mut sums = [[[0.0; HORIZONS_MS.len()]; 2]; Method::ALL.len()];
    let means = |judged: &[AtHorizon]| -> [Vec<f64>; 2] {
        let by_estimate = judged.iter().map(|at| at.by_estimate.expect("samples in movement").mean_deg);
        let by_truth = judged.iter().map(|at| at.by_truth.expect("a truth").mean_deg);
        [by_estimate.collect(), by_truth.collect()]
    };
    for path in &files {
        let recording = Recording::read(path).expect("a readable recording");
        let mut filter = Kind::Vqf.filter(Axes::Six, recording.period().expect("samples"));
        let track = Track::of(&recording, filter.as_mut());
        let judged = Method::ALL.map(|method| judge(method, &track, &horizons));
        let all = [0, 1, 2, 3, 4].map(|method| means(&judged[method]));
        let [.., adaptive] = &all;
        let constant = Method::ALL.iter().position(|m| *m == Method::Constant).expect("it is one of all");
        let worst = |method: usize, place: usize| {
            judged[method][place].by_estimate.expect("samples in movement").worst_deg
        };
        for (place, ms) in HORIZONS_MS.iter().enumerate() {
            let (ours, theirs) = (worst(4, place), worst(constant, place));
            assert!(ours <= WORST * theirs, "{}: worst {ours} {theirs} at {ms} ms", path.display());
        }
        let constant = &all[constant];
        for by in 0..2 {
            let (ours, theirs) = (adaptive[by][5], constant[by][5]);
            assert!(ours <= theirs, "{}: {ours} {theirs} at 100 ms", path.display());
        }
        for (sums, means) in sums.iter_mut().zip(&all) {
            for (sums, means) in sums.iter_mut().zip(means) {
                sums.iter_mut().zip(means).for_each(|(sum, mean)| *sum += mean / files.len() as f64);
            }
        }
    }
    if files.is_empty() {
        return;
    }
    for (method, [by_estimate, by_truth]) in Method::ALL.iter().zip(&sums) {
        println!("{:9} by the estimate {by_estimate:6.3?}, by the truth {by_truth:6.3?}", method.name());
    }
    let [others @ .., adaptive] = &sums;
    for other in others {
        for by in 0..2 {
            for place in 0..5 {
                assert!(adaptive[by][place] < other[by][place], "at {} ms", HORIZONS_MS[place]);
            }
        }
    }
}
