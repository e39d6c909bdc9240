//! Where a recording stands still.

use std::ops::Range;

use vergence_sense::Imu;
use vergence_time::Timestamp;

/// Length of the pieces that are looked at, s.
const PIECE_S: f64 = 0.25;

/// A stretch is at least this long, s, after its first and last piece are cut off.
const LEAST_S: f64 = 1.0;

/// Standard deviations within a piece below which it is still whatever the sensor: gyroscope (rad/s), accelerometer
/// (m/s²). A noisier sensor is measured by its own quietest tenth.
const QUIET: (f64, f64) = (0.012, 0.06);

/// Pieces of one stretch agree within this: gyroscope (rad/s), accelerometer (m/s²).
const ALIKE: (f64, f64) = (0.03, 0.25);

struct Piece {
    from: usize,
    to: usize,
    means: [nalgebra::Vector3<f64>; 2],
    deviations: [f64; 2],
}

impl Piece {
    fn of(samples: &[(Timestamp, Imu)], from: usize, to: usize) -> Self {
        let n = (to - from) as f64;
        let read = |which: usize, (_, imu): &(Timestamp, Imu)| [imu.gyr_rad_s, imu.acc_m_s2][which];
        let mean = |which: usize| {
            samples[from..to].iter().map(|s| read(which, s)).sum::<nalgebra::Vector3<f64>>() / n
        };
        let means = [mean(0), mean(1)];
        let spread = |which: usize| {
            (samples[from..to].iter().map(|s| (read(which, s) - means[which]).norm_squared()).sum::<f64>()
                / n)
                .sqrt()
        };
        Self { from, to, means, deviations: [spread(0), spread(1)] }
    }
}

/// The stretches, as ranges of samples, in which the sensor neither turns nor is shaken, at least a second long; their
/// ends, where a hand takes hold, are cut off. Turning evenly about the vertical looks the same and is not told apart.
/// Samples that are not finite end a stretch.
pub fn still_stretches(samples: &[(Timestamp, Imu)]) -> Vec<Range<usize>> {
    let mut pieces = Vec::new();
    let mut from = 0;
    for index in 0..samples.len() {
        let (time, imu) = &samples[index];
        let since = time.since(samples[from].0).map_or(f64::INFINITY, |span| span.as_secs_f64());
        let step =
            if index > 0 { time.since(samples[index - 1].0).map_or(-1.0, |s| s.as_secs_f64()) } else { 0.0 };
        let broken = !imu.gyr_rad_s.iter().chain(imu.acc_m_s2.iter()).all(|x| x.is_finite())
            || (index > 0 && !(step > 0.0 && step < PIECE_S));
        if broken {
            pieces.push(None);
            from = index + 1;
        } else if since >= PIECE_S {
            if index - from >= 2 {
                pieces.push(Some(Piece::of(samples, from, index)));
            }
            from = index;
        }
        if from >= samples.len() {
            break;
        }
    }
    let bar = |which: usize, least: f64| {
        let mut all: Vec<f64> = pieces.iter().flatten().map(|piece| piece.deviations[which]).collect();
        all.sort_by(f64::total_cmp);
        all.get(all.len() / 10).map_or(least, |quiet| least.max(2.0 * quiet))
    };
    let bars = [bar(0, QUIET.0), bar(1, QUIET.1)];
    let mut stretches = Vec::new();
    let mut open: Vec<&Piece> = Vec::new();
    let mut close = |open: &mut Vec<&Piece>| {
        if let [_, inner @ .., _] = open.as_slice()
            && let (Some(first), Some(last)) = (inner.first(), inner.last())
        {
            let seconds =
                samples[last.to - 1].0.since(samples[first.from].0).map_or(0.0, |s| s.as_secs_f64());
            if seconds >= LEAST_S * 0.95 {
                stretches.push(first.from..last.to);
            }
        }
        open.clear();
    };
    for piece in &pieces {
        let quiet = piece.as_ref().filter(|p| p.deviations[0] <= bars[0] && p.deviations[1] <= bars[1]);
        let Some(quiet) = quiet else {
            close(&mut open);
            continue;
        };
        let alike = open.last().is_none_or(|last| {
            let apart = |which: usize| (last.means[which] - quiet.means[which]).norm();
            apart(0) <= ALIKE.0.max(bars[0]) && apart(1) <= ALIKE.1.max(bars[1])
        });
        if !alike {
            close(&mut open);
        }
        open.push(quiet);
    }
    close(&mut open);
    stretches
}

#[cfg(test)]
mod tests {
    use vergence_time::Span;

    use super::*;
    use crate::model::ImuModel;
    use crate::motion::{Earth, Wander, WanderParams};

    #[test]
    fn rests_are_found_and_nothing_else() {
        let rests = vec![(0.0, 4.0), (8.0, 10.5), (15.0, 18.0)];
        let params = WanderParams { rests_s: rests.clone(), ..WanderParams::default() };
        let motion = Wander::new(2, &params).unwrap();
        let mut model = ImuModel::consumer(200.0, 3);
        model.gyr.bias = nalgebra::Vector3::new(0.2, -0.1, 0.05);
        let mut samples: Vec<_> = model
            .record(&motion, &Earth::MID_LATITUDE, Span::from_millis(20_000))
            .map(|s| (s.captured, s.value))
            .collect();
        let found = still_stretches(&samples);
        assert_eq!(found.len(), 3, "{found:?}");
        for (range, (from, to)) in found.iter().zip(rests) {
            let seconds = |index: usize| samples[index].0.as_nanos() as f64 * 1e-9;
            assert!(seconds(range.start) >= from && seconds(range.end - 1) <= to + 0.25, "{range:?}");
            assert!(seconds(range.end - 1) - seconds(range.start) > (to - from) - 1.1);
        }
        samples[400].1.acc_m_s2.x = f64::NAN;
        assert_eq!(
            still_stretches(&samples).len(),
            4 - usize::from(samples[400].0.as_nanos() < 1_500_000_000)
        );
        assert_eq!(still_stretches(&[]), Vec::<Range<usize>>::new());
    }
}
