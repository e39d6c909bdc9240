//! XDF's times made one clock's: offsets between the sender's and the recorder's clock, resets of the sender's, and evenly spaced samples.
//! The rules and thresholds are those of pyxdf 1.17 (`load_xdf` without arguments), so that both read the same numbers.

use std::ops::Range;

/// A new segment where two offsets are so many seconds further apart than usual, …
const RESET_TIME_S: f64 = 5.0;
/// … and so many median deviations, …
const RESET_TIME_DEVIATIONS: f64 = 5.0;
/// … and the offset jumps by so many seconds more than usual, …
const RESET_OFFSET_S: f64 = 1.0;
/// … and so many median deviations.
const RESET_OFFSET_DEVIATIONS: f64 = 10.0;
/// Deviations from the line beyond this are weighed linearly, seconds.
const WINSOR_S: f64 = 1e-4;
/// Samples further apart than this, and than [`BREAK_SAMPLES`] of them, are not evened across, seconds.
const BREAK_S: f64 = 1.0;
/// As above.
const BREAK_SAMPLES: f64 = 500.0;

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let middle = sorted.len() / 2;
    if sorted.len().is_multiple_of(2) { 0.5 * (sorted[middle - 1] + sorted[middle]) } else { sorted[middle] }
}

fn differences(values: &[f64]) -> Vec<f64> {
    values.windows(2).map(|pair| pair[1] - pair[0]).collect()
}

/// Which differences stand out by both measures.
fn glitches(differences: &[f64], deviations: f64, seconds: f64) -> Vec<bool> {
    let middle = median(differences);
    let off: Vec<f64> = differences.iter().map(|d| (d - middle).abs()).collect();
    let usual = median(&off) + f64::EPSILON;
    off.iter().map(|off| off / usual > deviations && *off > seconds).collect()
}

/// Ranges of `count` things that are cut behind each place where `is_cut`.
fn segments(count: usize, is_cut: impl Fn(usize) -> bool) -> Vec<Range<usize>> {
    let mut all = Vec::new();
    let mut from = 0;
    for place in 0..count.saturating_sub(1) {
        if is_cut(place) {
            all.push(from..place + 1);
            from = place + 1;
        }
    }
    all.push(from..count);
    all
}

/// The line y = a + b (x − o) that minimises Huber's loss with threshold 1, by the alternating direction method of multipliers (S. Boyd
/// et al., Foundations and Trends in Machine Learning 3, 2011, section 6.4): 1000 steps. `o` is the mean of `x`: times of weeks times
/// their squares would leave too few digits. `None` where x does not vary.
fn robust_line(x: &[f64], y: &[f64]) -> Option<(f64, f64, f64)> {
    const STEPS: usize = 1000;
    let n = x.len() as f64;
    let (origin, base) = (x.iter().map(|t| t - x[0]).sum::<f64>() / n + x[0], y[0]);
    let x: Vec<f64> = x.iter().map(|x| x - origin).collect();
    let y: Vec<f64> = y.iter().map(|y| y - base).collect();
    let (sum, square) = x.iter().fold((0.0, 0.0), |(s, q), x| (s + x, q + x * x));
    // The mean is zero but for rounding.
    let mean = sum / n;
    let spread = square - sum * mean;
    if !(spread > 0.0 && spread.is_finite()) {
        return None;
    }
    let (mut z, mut u) = (vec![0.0; y.len()], vec![0.0; y.len()]);
    let (mut a, mut b) = (0.0, 0.0);
    for _ in 0..STEPS {
        let (mut r1, mut r2) = (0.0, 0.0);
        for i in 0..y.len() {
            let wanted = y[i] + z[i] - u[i];
            r1 += wanted;
            r2 += x[i] * wanted;
        }
        b = (r2 - mean * r1) / spread;
        a = r1 / n - b * mean;
        for i in 0..y.len() {
            let d = a + b * x[i] - y[i] + u[i];
            let shrunk = if d == 0.0 { 0.0 } else { (1.0 - 2.0 / d.abs()).max(0.0) };
            z[i] = 0.5 * d + 0.5 * shrunk * d;
            u[i] = d - z[i];
        }
    }
    Some((base + a, b, origin))
}

/// Moves `stamps_s` from the sender's clock to the recorder's, by `offsets` (when it was measured, by how much it is off), seconds.
pub(super) fn synchronise(stamps_s: &mut [f64], offsets: &[(f64, f64)]) {
    if stamps_s.is_empty() || offsets.is_empty() {
        return;
    }
    let (times, values): (Vec<f64>, Vec<f64>) = offsets.iter().copied().unzip();
    let ranges = if offsets.len() > 1 {
        let (time_steps, value_steps) = (differences(&times), differences(&values));
        let late = glitches(&time_steps, RESET_TIME_DEVIATIONS, RESET_TIME_S);
        let jumps = glitches(&value_steps, RESET_OFFSET_DEVIATIONS, RESET_OFFSET_S);
        segments(offsets.len(), |place| time_steps[place] < 0.0 || late[place] && jumps[place])
    } else {
        segments(1, |_| false)
    };
    let mut from = 0;
    for (index, range) in ranges.iter().enumerate() {
        let (a, b, origin) = if range.len() > 1 {
            let x: Vec<f64> = times[range.clone()].iter().map(|t| t / WINSOR_S).collect();
            let y: Vec<f64> = values[range.clone()].iter().map(|v| v / WINSOR_S).collect();
            robust_line(&x, &y).map_or((0.0, 0.0, 0.0), |(a, b, origin)| (a * WINSOR_S, b, origin * WINSOR_S))
        } else {
            (values[range.start], 0.0, 0.0)
        };
        // Of several segments, each has the samples that are nearer to its last offset than to the next one's first.
        let until = match times.get(range.end).filter(|_| index + 1 < ranges.len()) {
            Some(next) => {
                let last = times[range.end - 1];
                let nearer = |t: &f64| (t - last).abs() < (t - next).abs();
                from + stamps_s[from..].iter().position(|t| !nearer(t)).unwrap_or(stamps_s.len() - from)
            }
            None => stamps_s.len(),
        };
        for stamp in &mut stamps_s[from..until] {
            *stamp += a + b * (*stamp - origin);
        }
        from = until;
    }
}

/// Spaces the samples of a stream of a nominal rate evenly, between breaks, by least squares.
pub(super) fn even_out(stamps_s: &mut [f64], nominal_hz: f64) {
    if stamps_s.is_empty() || nominal_hz.is_nan() || nominal_hz <= 0.0 {
        return;
    }
    let longest = BREAK_S.max(BREAK_SAMPLES / nominal_hz);
    let steps = differences(stamps_s);
    for range in segments(stamps_s.len(), |place| steps[place].abs() > longest) {
        let n = range.len() as f64;
        if range.len() < 2 {
            continue;
        }
        // About the middle, where the two unknowns do not hang together.
        let middle = 0.5 * (n - 1.0);
        let base = stamps_s[range.start];
        let (mut sum, mut product) = (0.0, 0.0);
        for (i, stamp) in stamps_s[range.clone()].iter().enumerate() {
            sum += stamp - base;
            product += (i as f64 - middle) * (stamp - base);
        }
        let slope = product / (n * (n * n - 1.0) / 12.0);
        let mean = sum / n;
        for (i, stamp) in stamps_s[range].iter_mut().enumerate() {
            *stamp = base + (mean + slope * (i as f64 - middle));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_offset_that_jumps_moves_each_part_by_its_own() {
        // Two lives of one clock: 1000 to 1100 s, off by 10 s; then, started anew, 0 to 100 s, off by 1120 s.
        let life = |from: f64, off: f64| (0..20).map(move |k| (from + 5.0 * f64::from(k), off));
        let offsets: Vec<(f64, f64)> = life(1000.0, 10.0).chain(life(0.0, 1120.0)).collect();
        let mut stamps: Vec<f64> = (1000..1100).chain(0..100).map(f64::from).collect();
        synchronise(&mut stamps, &offsets);
        for (k, stamp) in stamps.iter().enumerate() {
            let expected = 1010.0 + k as f64 + if k < 100 { 0.0 } else { 10.0 };
            assert!((stamp - expected).abs() < 1e-6, "{k}: {stamp}");
        }
    }

    #[test]
    fn outliers_do_not_bend_the_line() {
        let mut offsets: Vec<(f64, f64)> =
            (0..100).map(|k| (f64::from(k), 1.0 + 1e-5 * f64::from(k))).collect();
        offsets[37].1 += 0.5;
        let mut stamps = [50.0];
        synchronise(&mut stamps, &offsets);
        assert!((stamps[0] - 51.0005).abs() < 1e-4, "{}", stamps[0]);
    }

    #[test]
    fn jitter_goes_and_breaks_stay() {
        let mut stamps: Vec<f64> = (0..1000)
            .map(|k| {
                f64::from(k) * 0.01 + if k % 2 == 0 { 1e-3 } else { -1e-3 } + if k < 500 { 0.0 } else { 30.0 }
            })
            .collect();
        even_out(&mut stamps, 100.0);
        let steps = differences(&stamps);
        assert!(
            steps.iter().enumerate().all(|(k, s)| (s - if k == 499 { 30.01 } else { 0.01 }).abs() < 1e-4)
        );
        let mut nothing: [f64; 0] = [];
        even_out(&mut nothing, 100.0);
        synchronise(&mut nothing, &[(0.0, 1.0)]);
    }
}
